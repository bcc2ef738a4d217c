"""The balance of forces of a model over a time step, as PETSc vectors and matrices: the sum of its parts."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.discretisation.load_history import LoadHistory, linear_in_time
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Audit, Configuration, Report, State
from thinlayer.errors import LooseBody
from thinlayer.parts.making import diagonal_at_rest, parts_of
from thinlayer.parts.part import DISPLACEMENTS, Interval
from thinlayer.solving.balance import free_norm, require_equilibrium
from thinlayer.solving.force_scale import ForceScale
from thinlayer.solving.layout import Layout
from thinlayer.solving.part_sum import PartSum
from thinlayer.solving.tangent_matrix import DIFFERENT, TangentMatrix
from thinlayer.solving.uniqueness import RigidMotions


class Equations(PartSum):
    """Residual and tangent of a model. The unknowns are the displacements, then the parts' own unknowns.

    The constructor and all methods are collective.

    Attributes:
        parts, traits, failed: as in `PartSum`.
        history: the loads and supports over time.
        u: displacements of the last residual.
        loads: nodal forces of the loads in the balance of the present step.
        prescribed: displacements that supports prescribe at the end of the step.
        mean_stiffness: mean size of the diagonal entries of K and of the tangents at rest of bodies that are not in K.
        eased: ease of the parts; 0 is the parts themselves.
        scale: the forces that residuals are compared with; it knows the sizes that `Part.add_forces` returns.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.comm = model, model.comm
        self.history = LoadHistory(model)
        self.held = self.history.held
        self.u, self._mid = fem.Function(model.V), fem.Function(model.V)
        super().__init__(parts_of(model, self.held))
        self._with_own = [part for part in self.parts if part.field is not None]
        fields = {part.key: part.field for part in self._with_own if part.field is not None}
        self._layout = Layout(self.comm, {DISPLACEMENTS: self.u, **fields})
        self._matrix = TangentMatrix(self.comm, self._layout.sizes)
        self.n_displacements = self._layout.sizes[DISPLACEMENTS]
        diagonal = diagonal_at_rest(self.parts)
        cancelling = max(part.cancelling for part in self.parts)
        self.scale = ForceScale(float(diagonal.norm()), cancelling)
        self.mean_stiffness = float(diagonal.norm(PETSc.NormType.NORM_1)) / diagonal.getSize()
        diagonal.destroy()
        self._tangent: PETSc.Mat | None = None
        self._forces, self.loads = self.u.x.petsc_vec.duplicate(), self.u.x.petsc_vec.duplicate()
        self.eased, self._relative_residual = 0.0, 0.0

    # ---------------------------------------------------------------- unknowns
    def vector(self) -> PETSc.Vec:
        """A vector of unknowns, zero."""
        return self._layout.vector()

    def put_state(self, state: Configuration, x: PETSc.Vec) -> None:
        """Write into x the unknowns from which a step after this state starts."""
        values = self._layout.split(x.array)
        values[DISPLACEMENTS][:] = state.u.x.array[: self.n_displacements]
        for part in self._with_own:
            values[part.key][:] = part.own_start(state)

    @property
    def held_rows(self) -> npt.NDArray[PETSc.IntType]:
        """Global numbers, among the unknowns, of the held displacements."""
        return self._layout.rows(self.held)

    @cached_property
    def K(self) -> PETSc.Mat:
        """Matrix of the forces that are linear in the displacements."""
        first, *others = [part.K for part in self.parts if part.K is not None]
        K = first if not others else first.copy()
        for other in others:
            K.axpy(1.0, other, DIFFERENT)
        return K

    # ---------------------------------------------------------------- uniqueness
    @cached_property
    def _rigid(self) -> RigidMotions:
        return RigidMotions(self.model, self.held, self.scale.stiffness)

    def require_unique(self, unbalanced: PETSc.Vec | None = None) -> None:
        """Raise LooseBody if a connected piece of the bodies can move freely.

        The test uses the last tangent or, if parts can release bodies, the tangent at the last u of the parts that resist
        rigid motions. There is no test if a part may resist less than its tangent does. The error tells where `unbalanced`
        forces lead.
        """
        if self.traits.weakens:
            return
        if not self.traits.releases:
            if self._tangent is not None:
                self._rigid.require_resisted(self._tangent)
            return
        resisting = TangentMatrix(self.comm, {DISPLACEMENTS: self.n_displacements})
        self._rigid.require_resisted(resisting.fill(self.blocks(self._relative_residual, rigid=True)), unbalanced)
        resisting.destroy()

    def loose_body(self, x: PETSc.Vec) -> LooseBody | None:
        """Which body parts have released at the unknowns x, of which the search for an equilibrium knows no better ones."""
        if not self.traits.releases:
            return None
        out = self.vector()
        self.residual(x, out)
        out.scale(-1.0)
        try:
            self.require_unique(out)
        except LooseBody as loose:
            return loose
        finally:
            out.destroy()
        return None

    # ---------------------------------------------------------------- a step
    def rest(self, t: float) -> State:
        """The state at rest, before the first step."""
        model, report = self.model, Report("rest", 0, 0.0, 0.0)
        lost, u = dict.fromkeys(model.by_place({}), 0.0), fem.Function(model.V)
        memory, stresses = self.memory_at_rest, self.stresses_at_rest
        return State(u, t, memory, stresses=stresses, model=model, report=report, dissipated=lost)

    def begin(self, interval: Interval) -> None:
        """Begin a step: set its loads and supports, and begin it in all parts.

        Raises:
            ModelError: loads or supports that are not finite at the times of the step.
        """
        self.interval, old = interval, interval.old
        self.loads.set(0.0)
        for t, share in ((interval.t, interval.theta), (old.t, 1 - interval.theta)):
            if share:
                b = self.history.loads_at(t)
                self.loads.axpy(share, b)
                b.destroy()
        self.prescribed = self.history.prescribed_at(interval.t)
        largest_displacement = self.comm.allreduce(float(np.abs(self.prescribed).max(initial=0.0)), max)
        if self.model.strain:  # moves the sides of the cell, as supports would
            across = float(np.abs(self.model.strain.at(interval.t)).max()) * self.model.strain.size
            largest_displacement = max(largest_displacement, across)
        moved = float(old.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))  # forces may end at zero where loads do
        self.scale.begin(float(self.loads.norm()), largest_displacement, moved)
        self.begin_parts(interval)

    def start(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Compute the residual at the displacements before the step, and tell the force scale its norm.

        Not under a mean strain: these forces would be those of stiff bodies that follow it alone, however soft the layer.
        """
        self.residual(x, out)
        if self.model.strain is None:
            self.scale.start(free_norm(self, out))

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Internal forces less loads, then the parts' own residuals. All forces are NaN if a part failed."""
        self._layout.put(x)
        theta, mid = self.interval.theta, self._mid.x.petsc_vec
        self.u.x.petsc_vec.copy(mid)
        mid.scale(theta)
        mid.axpy(1 - theta, self.interval.old.u.x.petsc_vec)
        self._mid.x.scatter_forward()
        self.scale.see(*self.forces(self.u, self._mid, self._forces))
        self._forces.axpy(-1.0, self.loads)
        rows = self._layout.split(out.array)
        rows[DISPLACEMENTS][:] = np.nan if self.failed else self._forces.array_r
        for part in self._with_own:
            rows[part.key][:] = part.own_residual()
        self._relative_residual = self.scale.relative(free_norm(self, out)) if self.traits.singular else 0.0

    def tangent(self) -> PETSc.Mat:
        """Tangent at the unknowns of the last residual, without supports. Each call fills the same matrix.

        Raises:
            LawError: a law declares a symmetric tangent and has another one.
        """
        self._tangent = self._matrix.fill(self.blocks(self._relative_residual))
        return self._tangent

    def ease(self, ease: float) -> None:
        """Replace laws by eased ones: 0 is the law itself, 1 an elastic one."""
        self.eased = ease
        for part in self.parts:
            part.ease(ease)

    def accept(self, x: PETSc.Vec, report: Report) -> State:
        """The state at the end of the step, for its solution x.

        Raises:
            SolveError: x is no equilibrium, even if the solver converged. LooseBody: parts released a body.
        """
        out, change = self.vector(), self.u.x.petsc_vec.duplicate()
        self.residual(x, out)
        require_equilibrium(self, x, out)
        if self.traits.releases:
            self.require_unique()
        self.u.x.petsc_vec.copy(change)
        change.axpy(-1.0, self.interval.old.u.x.petsc_vec)
        at_supports = self.comm.allreduce(float(out.array_r[self.held] @ change.array_r[self.held]))
        supplied = float(self.loads.dot(change)) + at_supports
        out.destroy()
        change.destroy()
        found, end = self.end_parts(self.u, self.interval.t)
        every = found.values()
        audit = Audit(
            supplied + sum(one.supplied for one in every),
            sum(one.after - one.before for one in every),
            sum(one.dissipated for one in every),
            sum(one.remainder for one in every),
            sum(one.after for one in every),
        )
        dissipated = self.model.by_place({key: one.dissipated for key, one in found.items()})
        return State(**vars(end), model=self.model, report=report, audit=audit, dissipated=dissipated)

    def squares_of_strains(self, x: PETSc.Vec) -> dict[str, float]:
        """Integrals of the squares of strains or jumps that unknowns x cause, by the keys of parts that measure them."""
        self._layout.put(x)
        nothing = self._forces.duplicate()
        local = {part.key: float((part.error_measure(self.u, nothing) ** 2).sum()) for part in self.parts}
        nothing.destroy()
        return {key: self.comm.allreduce(value) for key, value in local.items()}

    # ---------------------------------------------------------------- time
    def check_times(self, times: list[float]) -> None:
        """Raise ModelError (loads, supports) or LawError (parameters of laws) for values out of range at these times."""
        for t in times:
            self._given_at(t)

    def linear_in_time(self, start: float, end: float) -> bool:
        """Whether loads, supports and parameters of laws are linear between two times. Tested at a few times."""
        return linear_in_time(self._given_at, start, end, self.comm)

    def _given_at(self, t: float) -> list[npt.NDArray[np.float64]]:
        """Loads, prescribed displacements and varying parameters at time t, on this rank."""
        given = self.history.given_at(t)
        for part in self.parts:
            part.at_time(t)
            given += part.parameters()
        return given

    # ---------------------------------------------------------------- end
    def destroy(self) -> None:
        """Free the matrices."""
        for thing in (*self.parts, self.K, self._matrix, self._forces, self.loads):
            thing.destroy()

    @property
    def comms(self) -> list[MPI.Intracomm]:
        """Communicators of the PETSc objects."""
        V = self.model.V
        return [self.comm, V.mesh.comm, V.dofmap.index_map.comm, *(comm for part in self.parts for comm in part.comms)]
