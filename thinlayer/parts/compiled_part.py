"""Forces of a compiled law at its quadrature points, as a part of the balance of forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.check import ASYMMETRY_MESSAGE
from forms.law_tangents import depends_on_step_length
from forms.tensors import MANDEL_PAIRS
from forms.work import Term
from thinlayer.discretisation.key import LAYER_KIND
from thinlayer.discretisation.state import Configuration
from thinlayer.discretisation.time_functions import TimeLevel
from thinlayer.parts.part import Block, FileOrder, Part, PartTraits, Softening, StepOutcome, TimeStep
from thinlayer.pointwise.compiled_term import ColumnTerm, CompiledTerm
from thinlayer.pointwise.quadrature import MeshOrigin, add_integral_to_nodes
from thinlayer.system.ranks import destroy

ASYMMETRY_TOLERANCE = 1e-8  # skew part of a tangent, relative to its size, that still counts as rounding error
SLOPE_STEP = 1e-6  # change of a strain or memory, over the largest, for central differences of a law's response
KINK_TOLERANCE = 1e-3  # difference of the slopes on both sides of a value, over the slopes, that is a kink
KINK_MESSAGE = (
    "derivative: {} has a kink in the step to t = {:g}, as where it yields and loads stay; change times or loads"
)
UNDERFLOW_LIMIT = 1e-300  # smallest such change
CHANGE_TOLERANCE = 1e-12  # relative difference of parameters at several times that counts as rounding error
SAMPLED_STEP_FRACTIONS = (0.21, 0.5, 0.83)  # fractions of a step at which parameters are sampled for changes in time


def prescribed_strain_function(points: CompiledTerm) -> Callable[[float], Array]:
    """Return a function of the time that computes a law's prescribed strains at its quadrature points. Collective.

    The function is collective, too. It returns an array (points, m) with the m Mandel components `points.mandel`, zeros
    if no strain is prescribed.

    Args:
        points: the law with its quadrature points.
    """
    time_level, strain = TimeLevel(), points.term.prescribed_strain
    if strain is None:
        return lambda t: np.zeros((points.count, len(points.mandel)))
    form = points.strain_form(time_level.at_level(strain))

    def strains_at(t: float) -> Array:
        time_level.set_time(t)
        return points.strain_values(form)

    return strains_at


class CompiledPart(Part):
    """Forces, tangent, energies and memory (internal variables) of one compiled law in a body or a layer.

    Args:
        key: name of the part in states and files.
        V: space of the displacements.
        term: virtual work of the law, with its strain and its measure.
        origin: relation of the mesh to the joint, the undistributed mesh from which it was made; needed to write files.
            None: there is no joint.
        symmetric: whether solvers assume that the tangent is symmetric; the part then checks it in each iteration.

    Attributes:
        points: the law at its quadrature points.
        law: the law.
    """

    stress_width = len(MANDEL_PAIRS)

    def __init__(
        self, key: str, V: fem.FunctionSpace, term: Term, origin: MeshOrigin | None = None, *, symmetric: bool = False
    ) -> None:
        self.key, self._symmetric = key, symmetric
        by_columns = term.law.traits.softens and term.measure.integral_type() == "cell"
        self.points = (ColumnTerm if by_columns else CompiledTerm)(V, term, origin)
        self._strain_at = prescribed_strain_function(self.points)
        self.comm, self.law = self.points.comm, term.law
        self._t, self._in_body = 0.0, term.n is None
        self._tangent: PETSc.Mat | None = None
        self.traits = replace(PartTraits.of(self.law), within_bodies=self._in_body)

    def law_traits(self) -> dict[str, PartTraits]:
        return {type(law.law_3d).__name__: PartTraits.of(law) for _, law in self.law.sublayers}

    def destroy(self) -> None:
        destroy(self.points, self._tangent)

    # ---------------------------------------------------------------- a step
    def rest(self) -> Array:
        return self.points.rest()

    def set_time(self, t: float) -> None:
        self._t = t
        self.points.set_time(t)

    def parameters(self) -> list[Array]:
        material = self.points.material
        return [material.parameters] if material.varies else []

    def set_homotopy(self, parameter: float) -> None:
        self.points.set_homotopy(parameter)
        self.points.set_time(self._t)

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        # Laws with rate have no response to sudden strains: strains prescribed at the start were always present.
        sudden, self._prescribed_strain = interval.old.at_rest and not self.law.traits.rate, self._strain_at(interval.t)
        old_prescribed = np.zeros_like(self._prescribed_strain) if sudden else self._strain_at(interval.old.t)
        self._e_increment = self._prescribed_strain - old_prescribed
        self._e_old = self._strain(interval.old.u, interval.old) + old_prescribed
        self._memory = interval.old.memory[self.key]
        self.set_time(interval.balance_time)

    def _strain(self, u: fem.Function, state: Configuration | None = None) -> Array:
        """Return the strains (points, m) without prescribed ones, of displacements `u` of a state; None: trial values."""
        return self.points.strain(u.x.petsc_vec)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._e = self._strain(u) + self._prescribed_strain
        self._response = self.points.respond(self._e, self._e_old, self._memory, self.interval.dt, self.interval.theta)
        self.failed = self.comm.allreduce(self._response.n_failed)

    def failure(self) -> str:
        if not self.failed:
            return ""
        message = next(filter(None, self.comm.allgather(self.points.failure(self._response))))
        return f"the law of {self.key!r} failed at {self.failed} points: {message}"

    def add_forces(self, out: PETSc.Vec) -> float:
        forces = self.points.forces(self._response.stress)
        out.axpy(1.0, forces)
        return float(forces.norm()) if self._in_body else 0.0

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        points = self.points
        density = points.region_function((self._response.stress * points.strain(z.x.petsc_vec)).sum(axis=1))
        weighted = points.region.plus_side(density) * points.term.weight
        add_integral_to_nodes(weighted, z.function_space, points.measure, out, points.region.entity_maps)

    def tangents(self, relative_residual: float) -> list[Block]:
        """Return the tangent matrices at the displacements of the last call of `evaluate`.

        They are derivatives of nodal forces by displacements.

        Args:
            relative_residual: norm of the last residual over the reference force. If the tangent may be singular, a
                multiple of the tangent before loading is added, which grows with this number.

        Raises:
            InputError: the tangent is not symmetric, but solvers assume it and read only half of the matrix.
        """
        if self._symmetric and (skew := self.comm.allreduce(self._response.asymmetry, MPI.MAX)) > ASYMMETRY_TOLERANCE:
            raise InputError(ASYMMETRY_MESSAGE.format(type(self.law.law_3d).__name__, skew))
        self._tangent = self.points.stiffness(self._response.tangent, relative_residual, self._tangent)
        return [Block(matrix, kept=True) for matrix in (self._tangent, *self.points.constant_matrices)]

    # ---------------------------------------------------------------- an accepted step
    def commit(self) -> StepOutcome:
        """Return energies over the accepted step, and memory and stresses at its end, for the last call of `evaluate`.

        The law computes the remainder of the energy balance. If parameters vary in place or time, the remainder is
        instead the work, minus the growth of stored energy, minus the dissipated energy.
        """
        response, interval = self._response, self.interval
        before = interval.old.stored[self.key] if self.key in interval.old.stored else self._initial_stored_energy()
        after, dissipated, remainder = map(float, self.comm.allreduce(self.points.weights @ response.energies))
        supplied = self.comm.allreduce(float(self.points.weights @ (response.stress * self._e_increment).sum(axis=1)))
        if self.points.material.varies:
            if interval.t != self._t:
                after = self._stored_energy_at(interval.t)
            works = self.points.weights @ (response.stress * (self._e - self._e_old)).sum(axis=1)
            remainder = self.comm.allreduce(float(works)) - (after - before) - dissipated
        stress = self.points.projected(response.full_stress)
        if interval.theta < 1:  # extrapolate from old.t + theta dt to the end of the step
            stress = np.asarray((stress - (1 - interval.theta) * interval.old.stresses[self.key]) / interval.theta)
        return StepOutcome(before, after, dissipated, remainder, response.memory, supplied=supplied, stress=stress)

    def strain_in(self, state: Configuration) -> Array:
        """Return the strains (points, m) in a state, prescribed ones included, as Mandel components. Collective."""
        return np.asarray(self._strain(state.u, state) + self._strain_at(state.t))

    def dissipated(self) -> Array:
        """Return the energies (points,) that are dissipated in the step around each point, for the last `evaluate`."""
        return np.asarray(self.points.weights * self._response.energies[:, 1])

    def _initial_stored_energy(self) -> float:
        """Return the energy stored at the start of the first step by strains that are prescribed from the outset.

        Laws that depend on strain rates take such strains as always present. For all other laws they are applied in the
        first step, so that no energy is stored before it.
        """
        if self.points.term.prescribed_strain is None:
            return 0.0
        return float(self.comm.allreduce(self.points.stored_energy(self._e_old, self._memory, self.interval.dt)))

    def _stored_energy_at(self, t: float) -> float:
        """Return the stored energy of the last evaluated strains and memory, with the law's parameters of time `t`.

        The method then sets the parameters back to their values before the call.
        """
        t_old = self._t
        self.set_time(t)
        stored = self.points.stored_energy(self._e, self._response.memory, self.interval.dt)
        self.set_time(t_old)
        return float(self.comm.allreduce(stored))

    # ---------------------------------------------------------------- derivatives
    def memory_forces(self, weights: Array) -> PETSc.Vec:
        return self._forces_of_slopes(self._slopes("e", weights, None))

    def pullback(self, weights: Array, z: fem.Function) -> tuple[PETSc.Vec, Array]:
        z_strain = self.points.strain(z.x.petsc_vec)
        return self._forces_of_slopes(self._slopes("e_old", weights, z_strain)), self._slopes(
            "memory", weights, z_strain
        )

    def _forces_of_slopes(self, slopes: Array) -> PETSc.Vec:
        return self.points.forces(slopes / self.points.weights[:, None]).copy()

    def _slopes(self, name: str, weights: Array, z_strain: Array | None) -> Array:
        """Return derivatives (points, k) of memory times weights minus the work of the stresses, by central differences.

        Args:
            name: argument of the law by whose k components they are taken: "e", "e_old" or "memory".
            weights: (points, values) factors of the memory at the end of the step.
            z_strain: (points, m) strains in which the stresses do work; None: no work.
        """
        arguments = {"e": self._e, "e_old": self._e_old, "memory": self._memory}
        x = arguments[name]
        largest = [self.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX) for values in (x, self._e)]
        h = SLOPE_STEP * max(*largest, UNDERFLOW_LIMIT)

        def values_at(x: Array) -> Array:
            e, e_old, memory = (arguments | {name: x}).values()
            response = self.points.respond(e, e_old, memory, self.interval.dt, self.interval.theta)
            values: Array = np.einsum("pj,pj->p", weights, response.memory)
            if z_strain is not None:
                values = values - self.points.weights * np.einsum("pm,pm->p", z_strain, response.stress)
            return values

        slopes: Array = np.zeros_like(x)
        middle, sums = values_at(x), np.zeros(2)
        for column, direction in enumerate(h * np.eye(x.shape[1])):
            plus, minus = values_at(x + direction), values_at(x - direction)
            slopes[:, column] = (plus - minus) / (2 * h)
            sums += np.abs([plus - 2 * middle + minus, plus - minus]).sum(axis=1)
        kink, change, size = self.comm.allreduce(np.array([*sums, SLOPE_STEP * np.abs(middle).sum()]))
        if kink > KINK_TOLERANCE * max(change, size):
            raise InputError(KINK_MESSAGE.format(f"the law of {self.key!r}", self.interval.t))
        return slopes

    def phase_gain(self) -> float:
        switching = self.points.switching
        return switching.phase_gain(self._response.memory) if switching else -np.inf

    def switch_phases(self) -> bool:
        switching = self.points.switching
        new_memory = switching.switched(self._response.memory, self._memory) if switching else None
        self._memory = self._memory if new_memory is None else new_memory
        return new_memory is not None

    # ---------------------------------------------------------------- questions
    def diagonal_at_rest(self) -> PETSc.Vec | None:
        if not self._in_body:
            return None
        A = self.points.stiffness(self.points.tangent_at_rest())
        diagonal = A.getDiagonal()
        A.destroy()
        return diagonal

    def undeclared_softening(self) -> Softening | None:
        if self._in_body or not self.law.traits.may_soften:
            return None
        local_count = self.points.count_softening_points(self._e, self._e_old, self._memory, self._response)
        count, term = self.comm.allreduce(local_count), self.points.term
        return (type(term.law.law_3d).__name__, f"at {count} points of the {term.key or LAYER_KIND}") if count else None

    def relaxing_law_name(self) -> str:
        return next((type(law.law_3d).__name__ for _, law in self.law.sublayers if depends_on_step_length(law)), "")

    def instantaneous_nonlinear_law(self, times: Sequence[float]) -> tuple[str, bool] | None:
        for (_, law), change_in_time in zip(self.law.sublayers, self._sublayers_that_change(times), strict=True):
            if not depends_on_step_length(law) and (change_in_time or not law.traits.linear):
                return type(law.law_3d).__name__, bool(change_in_time)
        return None

    def _sublayers_that_change(self, times: Sequence[float]) -> Array:
        """Return a mask (sublayers,), True for each sublayer of the law whose parameters change in time. Collective.

        The parameters are compared at `times`, which ascend, and at some times between them.
        """
        points = self.points
        points.set_time(times[0])
        old = points.material.sublayer_parameters
        vary = np.zeros(len(old), int)
        for a, b in pairwise(times if points.material.varies else ()):
            for fraction in (*SAMPLED_STEP_FRACTIONS, 1.0):
                points.set_time(a + fraction * (b - a))
                new = points.material.sublayer_parameters
                vary |= [not np.allclose(*pair, rtol=CHANGE_TOLERANCE, atol=0.0) for pair in zip(old, new, strict=True)]
        return np.asarray(self.comm.allreduce(vary) > 0)

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        if self._in_body:
            out.axpy(1.0, self.points.forces(state.stresses[self.key][:, self.points.mandel]))

    def error_measure(self, u: fem.Function) -> Array:
        weighted: Array = self.points.strain(u.x.petsc_vec) * np.sqrt(np.abs(self.points.weights))[:, None]
        return weighted.ravel()

    def unit_jump_measure(self) -> float:
        norm_B = float(self.points.B.norm(PETSc.NormType.INFINITY))
        return norm_B**2 * float(self.comm.allreduce(float(np.abs(self.points.weights).sum())))

    @property
    def file_order(self) -> FileOrder:
        """Order in which values at the quadrature points are written to files, by cells or facets of the joint.

        Cells or facets are sorted by their number in the joint, the undistributed mesh. Points of one facet are sorted
        by their coordinates. Their local order would depend on the cell from which the facet is seen.
        """
        points = self.points
        if points.region.dim < points.dim:
            return FileOrder.by_place(points.entity_numbers, points.cells, points.x)
        return FileOrder(points.entity_numbers, points.cells)
