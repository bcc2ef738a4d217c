"""The balance of forces of a model over a time step, as PETSc vectors and matrices: the sum of its parts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array
from geometry.topology import IntArray
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.prescribed_strains import VaryingStrainIntegrals
from thinlayer.discretisation.rigid_motions import model_motions
from thinlayer.discretisation.state import Audit, Configuration, Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.build_parts import body_parts, diagonal_at_rest, layer_parts
from thinlayer.parts.compiled_part import SAMPLE_FRACTIONS
from thinlayer.parts.part import DISPLACEMENT_KEY, Block, MeasuresError, TimeStep
from thinlayer.solving.linear_solvers import MULTIGRID_TYPES, SharedMatrices, orthonormal, set_field_split
from thinlayer.solving.part_sum import (
    ForceScale,
    PartSum,
    PetscIndices,
    TangentMatrix,
    UnknownLayout,
    augmented_in_place,
)
from thinlayer.solving.reactions import RigidMotions, SupportReactions
from thinlayer.system.ranks import destroy

LINEARITY_TOLERANCE = 1e-9  # relative deviation from a straight line in time that still counts as rounding


class Equations(PartSum):
    """Residual and tangent of a model's balance of forces over a time step. All methods are collective.

    The unknowns are the displacements, then the own unknowns of parts, such as pressures. With inclined supports, rigid
    plates or other multi-point constraints, other unknowns y take the places of the displacements u = T y, see
    `Constraints`. The constructor is collective too.

    Attributes:
        parts: the parts whose forces are summed.
        traits: properties of all parts together: a flag is set if one part has it.
        with_own: the parts with unknowns of their own.
        depends_on_dt: whether the tangent depends on the length of the step.
        failed: number of points where laws failed in the last residual.
        bodies, layers: the parts of the bodies, and of the layers.
        u: displacements of the last residual.
        loads: nodal forces of the loads in the balance of the present step.
        external: `loads` minus the parts' forces that do not depend on the unknowns.
        bc_dofs: local numbers of the constrained unknowns of this rank.
        prescribed: prescribed values of `bc_dofs` at the end of the step.
        constraints: the constraints u = T y of the displacements.
        mean_stiffness: mean size of the diagonal entries of K and of the tangents at rest of bodies that are not in K.
        homotopy_parameter: continuation parameter of the parts' laws: 0 is the law itself, 1 an elastic law.
        factor: linear solver with the factor of a tangent, of this model or of another model of its `ModelFamily`.
        scale: the reference forces for residuals; it includes the norms that `Part.add_forces` returns.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.comm = model, model.comm
        self.constraints = model.constraints
        self._strains = VaryingStrainIntegrals(model.terms, model.coordinates)
        self.u, self._mid = fem.Function(model.V), fem.Function(model.V)
        self._shared = matrices = SharedMatrices.acquire(model)
        self.bodies = matrices.bodies = matrices.bodies or body_parts(model)
        self.layers = layer_parts(model, self.constraints.bc_dofs, matrices.bodies)
        user_parts = [part for definition in model.parts if (part := definition.part(model)) is not None]
        self._own_parts = [*self.layers, *user_parts]
        super().__init__([*matrices.bodies, *self._own_parts])
        self._layout = UnknownLayout(self.comm, {DISPLACEMENT_KEY: self.u, **{p.key: p.field for p in self.with_own}})
        matrices.matrix = self._matrix = matrices.matrix or TangentMatrix(self.comm, self._layout.sizes)
        self.factor = matrices.factor
        self.n_displacements = self._layout.sizes[DISPLACEMENT_KEY]
        self._T = self._layout.widened(self.constraints.T)
        self._product: PETSc.Mat | None = None
        self.bc_dofs = self._prescribed(None)[0].astype(np.int32)
        diag = diagonal_at_rest(self.parts, self.u.x.petsc_vec.duplicate())
        self._rigid = RigidMotions(model, float(diag.norm()))
        (self.block_of, self.nesting), self.last_body = self._rigid.blocks, [None, *matrices.bodies][-1]
        self.n_blocks = self.nesting.shape[0]
        self.scale = ForceScale(self.norms(diag.array_r), max(part.cancelling for part in self.parts), self.nesting)
        self.mean_stiffness = float(diag.norm(PETSc.NormType.NORM_1)) / diag.getSize()
        self._reactions = SupportReactions(model, self.parts)
        self._forces, self.loads, self.external = (self.u.x.petsc_vec.duplicate() for _ in range(3))
        self.homotopy_parameter, self._relative_residual = 0.0, 0.0

    # ---------------------------------------------------------------- unknowns
    def vector(self) -> PETSc.Vec:
        """New zero vector of unknowns."""
        return self._layout.vector()

    def put_state(self, state: Configuration, x: PETSc.Vec) -> None:
        """Write into x the unknowns of a state, from which a step after this state starts."""
        values = self._layout.split(x.array)
        values[DISPLACEMENT_KEY][:] = self.constraints.unknowns(state.u.x.array[: self.n_displacements])
        for part in self.with_own:
            values[part.key][:] = part.own_start(state)

    def _set_unknowns(self, x: PETSc.Vec) -> None:
        """Copy unknowns x into the displacements u and the parts' own functions."""
        self._layout.put(x)
        if self._T is not None:
            owned = self.u.x.array[: self.n_displacements]
            owned[:] = self.constraints.displacements(owned)
            self.u.x.scatter_forward()

    def _prescribed(self, t: float | None) -> tuple[IntArray, Array]:
        """Local numbers of the constrained unknowns, increasing, and their values at time t (zeros if t is None)."""
        bc_dofs = self.constraints.bc_dofs.astype(np.int64)
        values = np.zeros(len(bc_dofs)) if t is None else self.constraints.values(t)
        first = self.n_displacements
        for part in self.with_own:
            part_dofs, own_values = part.own_prescribed(t)
            bc_dofs, values = np.append(bc_dofs, first + part_dofs), np.append(values, own_values)
            first += self._layout.sizes[part.key]
        return bc_dofs, values

    @property
    def bc_rows(self) -> PetscIndices:
        """Global numbers of the constrained unknowns."""
        return self._layout.rows(self.bc_dofs)

    @cached_property
    def K(self) -> PETSc.Mat:
        """Matrix of the forces that are linear in the displacements."""
        blocks = [Block(part.K, kept=True) for part in self.parts if part.K is not None]
        return TangentMatrix(self.comm, {DISPLACEMENT_KEY: self.n_displacements}).fill(blocks)

    def apply_bcs(self, A: PETSc.Mat, x: PETSc.Vec | None = None, b: PETSc.Vec | None = None) -> None:
        """Replace rows and columns of constrained unknowns in A by a mean stiffness times the identity.

        With x, its values at these unknowns enter the right-hand side b, so that the solution has these values.
        """
        A.zeroRowsColumns(self.bc_rows, self.mean_stiffness or 1.0, x, b)

    @cached_property
    def near_null(self) -> list[PETSc.Vec]:
        """Orthonormal vectors of unknowns that are rigid motions of the whole structure."""
        motions = model_motions(self.model).values()
        vectors = [self.vector() for _ in motions]
        for x, motion in zip(vectors, motions, strict=True):
            x.array[: self.n_displacements] = self.constraints.unknowns(motion.x.array[: self.n_displacements])
        return orthonormal(vectors)

    def set_preconditioner_data(self, ksp: PETSc.KSP, A: PETSc.Mat) -> None:
        """Pass rigid motions, or the blocks of displacements and pressures, to the preconditioner of a linear solver.

        Args:
            ksp: the linear solver. Algebraic multigrid gets the rigid motions; PCFIELDSPLIT gets the blocks.
            A: its matrix: a tangent with Dirichlet conditions applied.
        """
        kind = ksp.getPC().getType()
        if kind in MULTIGRID_TYPES:
            A.setNearNullSpace(PETSc.NullSpace().create(vectors=self.near_null, comm=A.comm))
        elif kind == "fieldsplit" and self.with_own:
            set_field_split(ksp.getPC(), A, self._layout, self.near_null)

    # ---------------------------------------------------------------- uniqueness
    def require_unique(self, r: PETSc.Vec | None = None) -> None:
        """Raise LooseBody if a connected piece of the bodies can move freely.

        The test uses the tangents, at the last u, of the parts that resist rigid motions. It is skipped if a part may
        resist less than its tangent does. A force at a node counts as resistance only if it exceeds the residual at
        which solvers stop. If the residual r is given, it must also exceed the norm of r on the block of the node.
        """
        if not self.traits.weakens:
            block_forces, rounding = self.scale.target(self._largest(self.u.x.array)), self.u.x.petsc_vec.duplicate()
            block_forces = block_forces if r is None else np.maximum(block_forces, self.residual_norms(r))
            rounding.array[:] = block_forces[self.block_of]
            self._rigid.require_resisted(self.resisting(self._relative_residual, rounding))
            destroy(rounding)

    # ---------------------------------------------------------------- a step
    def rest(self, t: float) -> State:
        """State at rest at time t, before the first step: displacements and stresses are zero."""
        model, report = self.model, Report("rest", 0, 0.0, 0.0)
        dissipated, u = dict.fromkeys(model.by_place({}), 0.0), fem.Function(model.V)
        memory, stresses = self.memory_at_rest, self.stresses_at_rest
        return State(u, t, memory, stresses=stresses, at_rest=True, model=model, report=report, dissipated=dissipated)

    def begin(self, interval: TimeStep) -> None:
        """Begin the time step `interval`: set its loads and prescribed displacements, and begin it in all parts.

        Raises:
            InputError: loads, prescribed displacements or prescribed strains that are not finite at the times of the
                step.
        """
        self.interval, old = interval, interval.old
        self.loads.set(0.0)
        for t, share in ((interval.t, interval.theta), (old.t, 1 - interval.theta)):
            if share:
                self.loads.axpy(share, self.loads_at(t))
        self.prescribed = self._prescribed(interval.t)[1]
        self._strains_at(interval.t)
        largest_displacement = self._largest(self.prescribed)
        if self.model.strain:  # it moves the sides of the periodic cell, as supports would
            strain_displacement = float(np.abs(self.model.strain.at(interval.t)).max()) * self.model.strain.size
            largest_displacement = max(largest_displacement, strain_displacement)
        # if loads end at zero, so may all forces
        max_u = max([float(old.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)), *(part.distance for part in self.parts)])
        if self.mean_stiffness:  # about the displacement of an elastic response
            max_u = max(max_u, float(self.loads.norm()) / (self.mean_stiffness * math.sqrt(self.loads.getSize())))
        self.scale.begin(self.norms(self.loads.array_r), largest_displacement, max_u)
        self.begin_parts(interval)
        self.external.set(0.0)
        for part in self.parts:
            part.add_fixed(self.external)
        self.external.aypx(-1.0, self.loads)

    def loads_at(self, t: float) -> PETSc.Vec:
        """New vector of the nodal forces of the loads at time t.

        Forces and moments prescribed for multi-point constraints, such as rigid plates, are included, as nodal forces
        with these resultants.

        Raises:
            InputError: loads that are not finite, or that nothing balances in a periodic joint.
        """
        b = self.model.forces.nodal_at(self.model.V, t)
        self.model.supports.require_balance(b, t)
        b.array[:] += self.constraints.loads_at(t)
        return b

    def prescribed_forces(self) -> PETSc.Vec:
        """New vector of forces on the unknowns in this step: `external`, and the parts' loads on their own unknowns."""
        return self.on_unknowns(self.external, [part.load for part in self.with_own])

    def configuration(self, x: PETSc.Vec) -> Configuration:
        """Configuration at the end of the present step, with the displacements and own fields of unknowns x."""
        self._set_unknowns(x)
        fields = {part.key: part.own_result() for part in self.with_own}
        return Configuration(self.u.copy(), self.interval.t, fields=fields)

    def prescribed_forces_at(self, t: float) -> PETSc.Vec:
        """New vector of forces on the unknowns at time t: the loads, and the parts' loads on their own unknowns."""
        return self.on_unknowns(self.loads_at(t), [part.load_at(t) for part in self.with_own])

    def on_unknowns(self, forces: PETSc.Vec, part_loads: Sequence[Array] = ()) -> PETSc.Vec:
        """New vector of forces on the unknowns, from nodal forces, and from loads on the parts' own unknowns.

        Args:
            forces: nodal forces.
            part_loads: for each part with own unknowns an array of loads on them; (): no loads.
        """
        out = self.vector()
        self._put_forces(forces.array_r, part_loads, out)
        return out

    def _put_forces(self, forces: Array, part_loads: Sequence[Array], out: PETSc.Vec) -> None:
        fields = self._layout.split(out.array)
        fields[DISPLACEMENT_KEY][:] = self.constraints.forces(forces)
        for part, values in zip(self.with_own, part_loads, strict=False):
            fields[part.key][:] = values

    def start(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the residual at the initial unknowns x of the step into `out`, and pass its norms to the force scale.

        In a periodic cell under a mean strain the norms are not passed: stiff bodies alone would follow the strain,
        with large forces however soft the layer. Nor are they passed for homotopy laws (between an elastic law and the
        given law), in which a layer that has slipped far is elastic.
        """
        self.residual(x, out)
        if self.model.strain is None and not self.homotopy_parameter:
            self.scale.start(self.residual_norms(out))

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the residual at x into `out`: internal forces minus loads, then the parts' own residuals.

        All forces are NaN if a part failed.
        """
        self._set_unknowns(x)
        theta, mid = self.interval.theta, self._mid.x.petsc_vec
        self.u.x.petsc_vec.copy(mid)
        mid.scale(theta)
        mid.axpy(1 - theta, self.interval.old.u.x.petsc_vec)
        self._mid.x.scatter_forward()
        part_norms = self.forces(self.u, self._mid, self._forces)
        all_norms = np.zeros(self.n_blocks)
        # a mean strain or stress acts on all blocks alike
        all_norms[: None if self.model.strain or self.model.stress else 1] = max(part_norms, default=0.0)
        self.scale.update_stresses(np.maximum(self.body_norms, all_norms))
        self._forces.axpy(-1.0, self.loads)
        forces = np.full(self.n_displacements, np.nan) if self.failed else self._forces.array_r
        self._put_forces(forces, [part.own_residual() for part in self.with_own], out)
        self._relative_residual = self.relative(out) if self.traits.singular else 0.0

    def tangent(self) -> PETSc.Mat:
        """Tangent at the unknowns of the last residual, without Dirichlet conditions. Each call fills the same matrix.

        Raises:
            InputError: a law declares a symmetric tangent, but its tangent is not symmetric.
        """
        tangent = self._matrix.fill(self.blocks(self._relative_residual))
        if self._T is None:
            return tangent
        self._product = tangent.ptap(self._T, result=self._product)
        self._product.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return self._product

    @contextmanager
    def with_supports(
        self, x: PETSc.Vec | None = None, b: PETSc.Vec | None = None, *, lend: bool = False
    ) -> Iterator[PETSc.Mat]:
        """Within a `with` block, the tangent at the unknowns of the last residual, with Dirichlet conditions applied.

        Args:
            x: vector whose values at constrained unknowns the solution shall have; None: zero.
            b: right-hand side, to which the forces of these values are added; None with x = None.
            lend: whether the bodies' matrix may be changed in place to serve as the tangent, if x is None. Nothing but
                a factorisation may then use the bodies' matrix within the block.
        """
        only_u = x is None and self._T is None and not self.with_own
        first, *others = self.blocks(self._relative_residual) if lend and only_u else [Block(None)]
        if first.kept and first.factor == 1:
            with augmented_in_place(self.comm, first.matrix, others, self.bc_rows, self.mean_stiffness or 1.0) as A:
                yield A
        else:
            A = self.tangent()
            self.apply_bcs(A, x, b)
            yield A

    def set_homotopy(self, parameter: float) -> None:
        """Set the continuation parameter of the laws: 0 is the given law, 1 an elastic law."""
        self.homotopy_parameter = parameter
        for part in self.parts:
            part.set_homotopy(parameter)

    def accept(self, x: PETSc.Vec, report: Report) -> State:
        """Return the state at the end of the step, for its solution x and the solver's report.

        Raises:
            SolveError: x is not an equilibrium, even if the solver converged. LooseBody: a law that can release a body,
                such as contact, has done so.
        """
        out, x0 = self.vector(), self.vector()
        self.residual(x, out)
        self.require_equilibrium(out)
        if self.traits.releases:
            self.require_unique(out)
        self._require_bounded_jumps()
        self.put_state(self.interval.old, x0)
        bc_forces, u0 = out.array_r[self.bc_dofs], self.interval.old.u.x.array
        moved, du = x.array_r[self.bc_dofs] - x0.array_r[self.bc_dofs], (self.u.x.array - u0)[: self.n_displacements]
        works = bc_forces @ x.array_r[self.bc_dofs], bc_forces @ moved + self.loads.array_r @ du
        prescribed_work, supplied = map(float, self.comm.allreduce(np.array(works)))
        outcomes, end = self.end_parts(self.u, self.interval.t)
        end = replace(end, reactions=self.reactions())
        names = ("supplied", "before", "dissipated", "remainder", "after")
        added, start, lost, remainder, total = (sum(getattr(o, name) for o in outcomes.values()) for name in names)
        audit = Audit(supplied + added, total - start, lost, remainder, total)
        state = State(**vars(end), model=self.model, report=report, audit=audit, prescribed_work=prescribed_work)
        dissipated = self.model.by_place({key: outcome.dissipated for key, outcome in outcomes.items()})
        return replace(state, sudden=self.interval.dt == 0 and self.interval.old.at_rest, dissipated=dissipated)

    def reactions(self) -> Array:
        """Reactions (n, k) at the end of the step, for the last residual: k components of force and moment.

        The n rows are the places `Model.holders`: supports, plates and rigid bases. Moments are about `Model.centre`.
        """
        return self._reactions.at_end(self._forces, self.interval, self.loads_at)

    def _require_bounded_jumps(self) -> None:
        """Raise SolveError if the jumps of a layer with bounded stresses, or in contact, exceed the size of the model.

        Beyond a limit load displacements grow without bound. The rounding of forces then grows until it hides the
        residual.
        """
        size = self.model.joint.size
        for part in self.layers:
            if (part.traits.bounded or part.traits.releases) and isinstance(part, MeasuresError):
                squared_jumps = self.comm.allreduce(float((part.error_measure(self.u) ** 2).sum()))
                if not squared_jumps <= part.unit_jump_measure() * size**2:
                    text = f"{part.key!r} jumps farther than the model's size, {size:.3g}"
                    advice = "loads may be beyond their limit; march from less"
                    raise SolveError(f"what the solver returned is not an equilibrium: {text}", advice=advice)

    # ---------------------------------------------------------------- time
    def check_times(self, times: list[float]) -> None:
        """Raise InputError if loads, prescribed displacements or parameters of laws are out of range at these times."""
        for t in times:
            self._data_at(t)

    def linear_in_time(self, start: float, end: float) -> bool:
        """Whether loads, supports and parameters of laws are linear from time `start` to `end`, by a few samples."""
        start_data, end_data = self._data_at(start), self._data_at(end)
        for share in SAMPLE_FRACTIONS:
            data = self._data_at(start + share * (end - start))
            for a, b, c in zip(start_data, end_data, data, strict=True):
                error = self._largest((1 - share) * a + share * b - c)
                if error > LINEARITY_TOLERANCE * self._largest(np.array([a, b, c])):
                    return False
        return True

    def _largest(self, values: Array) -> float:
        """Largest absolute value of numbers on all ranks; 0 if there are none."""
        return float(self.comm.allreduce(float(np.abs(values).max(initial=0.0)), max))

    def _data_at(self, t: float) -> list[Array]:
        """Loads, prescribed displacements, prescribed strains and varying parameters at time t, on this rank."""
        for part in self.parts:
            part.at_time(t)
        varying = [values for part in self.parts for values in part.parameters()]
        return [self.loads_at(t).array_r.copy(), self.constraints.values(t), *self._strains_at(t), *varying]

    def _strains_at(self, t: float) -> list[Array]:
        if self.model.strain:  # it has its own error for values that are not finite
            self.model.strain.at(t)
        return self._strains.integrals(t)

    # ---------------------------------------------------------------- end
    def destroy(self) -> None:
        """Free the matrices, except those that other models of the `ModelFamily` may use."""
        destroy(*self._own_parts)
        self._shared.release(self.model)
