"""Balance of forces of a model in a time step, as PETSc vectors and matrices summed over its parts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array
from forms.work import Term
from geometry.inflating.inflation import points_on_middle
from geometry.topology import Indices, IntArray
from thinlayer.discretisation.form_compilation import compiled_terms
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.prescribed_strains import VaryingStrainIntegrals
from thinlayer.discretisation.rigid_motions import model_motions
from thinlayer.discretisation.state import Audit, Configuration, Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.bubble_part import BubblePart, EnrichedPart
from thinlayer.parts.compiled_part import SAMPLED_STEP_FRACTIONS, CompiledPart
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.form_part import LinearPart
from thinlayer.parts.mean_stress_part import MeanStressPart
from thinlayer.parts.part import DISPLACEMENT_KEY, Block, MeasuresError, Part, TimeStep
from thinlayer.parts.pressure_part import PressurePart, flows_along_surface
from thinlayer.solving.linear_solvers import MULTIGRID_PC_TYPES, SharedMatrices, orthonormalise, set_field_split
from thinlayer.solving.part_sum import ForceScale, PartSum, TangentMatrix, UnknownLayout, augmented_in_place
from thinlayer.solving.reactions import RigidMotions, SupportReactions
from thinlayer.system.ranks import destroy

ENERGY_ROUNDING = 1e-12  # relative change of the unknown whose energy counts as rounding
TIME_LINEARITY_TOLERANCE = 1e-9  # relative deviation from a straight line in time that still counts as rounding


class Equations(PartSum):
    """Residual and tangent of a model's balance of forces in a time step. All methods are collective.

    The vector of unknowns has the displacements u first, then unknowns of single parts, such as pressures. Inclined
    supports, rigid plates and other multi-point constraints prescribe u = T y, see `Constraints`. The vector then has y
    in place of u. The constructor is collective too.

    Attributes:
        parts: the parts whose forces are summed, such as bodies, layers, contact and springs.
        traits: properties of all parts together: a flag is set if one part has it.
        field_parts: the parts with unknowns of their own.
        depends_on_dt: whether the tangent depends on the length of the step.
        failed: number of points where laws failed in the last evaluation of the residual.
        bodies, layers: the parts of the bodies, and of the layers.
        u: displacements at which the residual was last evaluated.
        loads: nodal forces of the loads in the balance of the step. With the fraction theta of `TimeStep`, they are
            theta times those at its end plus 1 - theta times those at its start.
        external: `loads` minus those forces of parts that do not depend on the unknowns.
        bc_dofs, bc_rows: local numbers of the constrained unknowns of this rank, and their global numbers.
        prescribed: values of the unknowns `bc_dofs` at the end of the step.
        constraints: the constraints u = T y of the displacements.
        mean_stiffness: mean diagonal entry of the stiffness at rest: of K, and of those bodies that are not in K.
        homotopy_parameter: parameter that chooses a law between the given law (0) and an elastic law (1).
        factor: linear solver with the factor of the last tangent, which may be that of another model of the
            `ModelFamily`.
        scale: the reference forces with which residuals are compared.
    """

    def __init__(self, model: Model) -> None:
        self.model, self.comm = model, model.comm
        self.constraints = model.constraints
        self._strain_integrals = VaryingStrainIntegrals(model.terms, model.coordinates)
        self.u, self._mid_u = fem.Function(model.V), fem.Function(model.V)
        self._shared = matrices = SharedMatrices.acquire(model)
        self.bodies = matrices.bodies = matrices.bodies or body_parts(model)
        self.layers = layer_parts(model, self.constraints.bc_dofs, matrices.bodies)
        user_parts = [part for definition in model.parts if (part := definition.part(model)) is not None]
        self._unshared_parts = [*self.layers, *user_parts]
        super().__init__([*matrices.bodies, *self._unshared_parts])
        fields = {DISPLACEMENT_KEY: self.u, **{p.key: p.field for p in self.field_parts}}
        self._layout = UnknownLayout(self.comm, fields)
        matrices.matrix = self._matrix = matrices.matrix or TangentMatrix(self.comm, self._layout.sizes)
        self.factor = matrices.factor
        self.n_displacements = self._layout.sizes[DISPLACEMENT_KEY]
        self._T = self._layout.extended_to_all_fields(self.constraints.T)
        self._reduced_tangent: PETSc.Mat | None = None
        self.bc_dofs = self._bc_dofs_and_values(None)[0].astype(np.int32)
        self.bc_rows = self._layout.global_rows(self.bc_dofs)
        diag = sum_diagonals_at_rest(self.parts, self.u.x.petsc_vec.duplicate())
        self._rigid_motions = RigidMotions(model, float(diag.norm()))
        (self.block_of, self.nesting), self.last_body = self._rigid_motions.nested_blocks, [None, *matrices.bodies][-1]
        self.n_blocks = self.nesting.shape[0]
        self.scale = ForceScale(self.norms(diag.array_r), max(part.cancelling for part in self.parts), self.nesting)
        self.mean_stiffness = float(diag.norm(PETSc.NormType.NORM_1)) / diag.getSize()
        self._reactions = SupportReactions(model, self.parts)
        self._forces, self.loads, self.external = (self.u.x.petsc_vec.duplicate() for _ in range(3))
        self.homotopy_parameter, self._relative_residual = 0.0, 0.0

    # ---------------------------------------------------------------- unknowns
    def create_vector(self) -> PETSc.Vec:
        """Return a new vector of unknowns, filled with zeros."""
        return self._layout.create_vector()

    def put_state(self, state: Configuration, x: PETSc.Vec) -> None:
        """Write the unknowns of `state` into the vector `x`, as initial values of the next time step."""
        values = self._layout.split(x.array)
        values[DISPLACEMENT_KEY][:] = self.constraints.unknowns(state.u.x.array[: self.n_displacements])
        for part in self.field_parts:
            values[part.key][:] = part.own_values_before(state)

    def _set_unknowns(self, x: PETSc.Vec) -> None:
        """Copy the vector of unknowns `x` into the displacements `u` and the fields of parts with own unknowns."""
        self._layout.copy_to_fields(x)
        if self._T is not None:
            owned = self.u.x.array[: self.n_displacements]
            owned[:] = self.constraints.displacements(owned)
            self.u.x.scatter_forward()

    def _bc_dofs_and_values(self, t: float | None) -> tuple[IntArray, Array]:
        """Return the local numbers, ascending, of the constrained unknowns, and their values at time `t`.

        If `t` is None, the values are zeros.
        """
        bc_dofs = self.constraints.bc_dofs.astype(np.int64)
        values = np.zeros(len(bc_dofs)) if t is None else self.constraints.bc_values(t)
        offset = self.n_displacements
        for part in self.field_parts:
            part_dofs, own_values = part.own_prescribed(t)
            bc_dofs, values = np.append(bc_dofs, offset + part_dofs), np.append(values, own_values)
            offset += self._layout.sizes[part.key]
        return bc_dofs, values

    @cached_property
    def K(self) -> PETSc.Mat:
        """Stiffness matrix of those forces of parts that are linear in the displacements."""
        blocks = [Block(part.K, kept=True) for part in self.parts if part.K is not None]
        return TangentMatrix(self.comm, {DISPLACEMENT_KEY: self.n_displacements}).fill(blocks)

    def apply_bcs(self, A: PETSc.Mat, x: PETSc.Vec | None = None, b: PETSc.Vec | None = None) -> None:
        """Apply the Dirichlet conditions to a matrix, and optionally to a right-hand side.

        Rows and columns of constrained unknowns become those of the identity, times the mean stiffness.

        Args:
            A: the matrix; changed in place.
            x: vector with the prescribed values at constrained unknowns.
            b: right-hand side. It is changed such that the solution has the values of `x` at constrained unknowns.
        """
        A.zeroRowsColumns(self.bc_rows, self.mean_stiffness or 1.0, x, b)

    @cached_property
    def near_null(self) -> list[PETSc.Vec]:
        """Orthonormal vectors of unknowns that are the rigid motions of the whole structure."""
        motions = model_motions(self.model).values()
        vectors = [self.create_vector() for _ in motions]
        for x, motion in zip(vectors, motions, strict=True):
            x.array[: self.n_displacements] = self.constraints.unknowns(motion.x.array[: self.n_displacements])
        return orthonormalise(vectors)

    def set_preconditioner_data(self, ksp: PETSc.KSP, A: PETSc.Mat) -> None:
        """Pass to a linear solver the data that its preconditioner needs besides the matrix.

        Algebraic multigrid gets the rigid motions. PCFIELDSPLIT gets the blocks of displacements and of pressures.
        Others need nothing.

        Args:
            ksp: the linear solver.
            A: matrix of the linear solver: a tangent with Dirichlet conditions applied.
        """
        pc_type = ksp.getPC().getType()
        if pc_type in MULTIGRID_PC_TYPES:
            A.setNearNullSpace(PETSc.NullSpace().create(vectors=self.near_null, comm=A.comm))
        elif pc_type == "fieldsplit" and self.field_parts:
            set_field_split(ksp.getPC(), A, self._layout, self.near_null)

    # ---------------------------------------------------------------- uniqueness
    def require_unique(self, r: PETSc.Vec | None = None) -> None:
        """Raise LooseBody if a connected piece of the bodies can move freely.

        A piece moves freely if the tangents of the parts do not resist one of its rigid motions. The tangents are those
        at the displacements of the last residual. If some part may resist less than its tangent says, nothing is
        tested.

        Resistance at a node counts only if its force exceeds the residual at which solvers stop. With `r` it must also
        exceed the norm of this residual in the node's block, see `ForceScale`.

        Args:
            r: residual at the last displacements; None: it is not considered.
        """
        if not self.traits.weakens:
            limits, threshold = self.scale.max_norms(self._max_abs(self.u.x.array)), self.u.x.petsc_vec.duplicate()
            limits = limits if r is None else np.maximum(limits, self.residual_norms(r))
            threshold.array[:] = limits[self.block_of]
            self._rigid_motions.require_resisted(self.resisting_blocks(self._relative_residual, threshold))
            destroy(threshold)

    # ---------------------------------------------------------------- a step
    def rest_state(self, t: float) -> State:
        """Return the state at rest at time `t`, before the first step: displacements are zero, and stresses too.

        A scalar field has its initial value. If none is given, non-linear problems start from the mean of what supports
        prescribe, as laws may be singular at zero.
        """
        model, report = self.model, Report("rest", 0, 0.0, 0.0)
        dissipated, u = dict.fromkeys(model.sums_by_seam_and_bodies({}), 0.0), model.unknown_at_rest(t)
        if model.n_components == 1 and model.structure.initial is None and not model.linear:
            u.x.array[:] = model.structure.mean_support
        memory, stresses = self.memory_at_rest, self.stresses_at_rest
        return State(u, t, memory, stresses=stresses, at_rest=True, model=model, report=report, dissipated=dissipated)

    def begin(self, interval: TimeStep) -> None:
        """Begin a time step: compute its loads and prescribed displacements, and call `begin` of all parts.

        Args:
            interval: the time step.

        Raises:
            InputError: loads, prescribed displacements or prescribed strains are not finite at the times of the step.
        """
        self.interval, old = interval, interval.old
        self.loads.set(0.0)
        for t, weight in ((interval.t, interval.theta), (old.t, 1 - interval.theta)):
            if weight:
                self.loads.axpy(weight, self.loads_at(t))
        self.prescribed = self._bc_dofs_and_values(interval.t)[1]
        self._strain_integrals_at(interval.t)
        max_prescribed = self._max_abs(self.prescribed)
        if self.model.strain:  # it moves the sides of the periodic cell, as supports would
            strain_displacement = float(np.abs(self.model.strain.tensor_at(interval.t)).max()) * self.model.strain.size
            max_prescribed = max(max_prescribed, strain_displacement)
        # if loads end at zero, so may all forces
        max_u = max([float(old.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)), *(part.distance for part in self.parts)])
        if self.mean_stiffness:  # about the displacement of an elastic response
            max_u = max(max_u, float(self.loads.norm()) / (self.mean_stiffness * math.sqrt(self.loads.getSize())))
        self.scale.begin(self.norms(self.loads.array_r), max_prescribed, max_u)
        self.begin_parts(interval)
        self.external.set(0.0)
        for part in self.parts:
            part.add_constant_forces(self.external)
        self.external.aypx(-1.0, self.loads)

    def loads_at(self, t: float) -> PETSc.Vec:
        """Return a new vector of the nodal forces of the loads at time `t`.

        It includes forces and moments that act on rigid plates or other multi-point constraints, as equivalent nodal
        forces.

        Raises:
            InputError: loads are not finite, or nothing balances them in a periodic joint.
        """
        b = self.model.forces.nodal_forces_at(self.model.V, t)
        self.model.supports.require_balanced_loads(b, t)
        b.array[:] += self.constraints.loads_at(t)
        return b

    def prescribed_forces(self) -> PETSc.Vec:
        """Return a new vector of forces on the unknowns in this time step, which do not depend on the unknowns.

        They are the forces `external` on the displacements, and the loads of parts on their own unknowns.
        """
        return self.forces_on_unknowns(self.external, [part.load for part in self.field_parts])

    def configuration(self, x: PETSc.Vec) -> Configuration:
        """Return the configuration at the end of the time step: the displacements and other fields of unknowns `x`."""
        self._set_unknowns(x)
        fields = {part.key: part.own_result() for part in self.field_parts}
        return Configuration(self.u.copy(), self.interval.t, fields=fields)

    def prescribed_forces_at(self, t: float) -> PETSc.Vec:
        """Return a new vector of forces on the unknowns at time `t`: loads, and parts' loads on their own unknowns."""
        return self.forces_on_unknowns(self.loads_at(t), [part.own_load_at(t) for part in self.field_parts])

    def forces_on_unknowns(self, forces: PETSc.Vec, part_loads: Sequence[Array] = ()) -> PETSc.Vec:
        """Return a new vector of forces on the unknowns, for given nodal forces and loads of parts.

        With constraints u = T y of the displacements, the forces on y are T^t times the nodal forces.

        Args:
            forces: nodal forces on the displacements u.
            part_loads: arrays of loads on the own unknowns of parts, in the order of `field_parts`. (): no loads.
        """
        out = self.create_vector()
        self._put_forces(forces.array_r, part_loads, out)
        return out

    def _put_forces(self, forces: Array, part_loads: Sequence[Array], out: PETSc.Vec) -> None:
        fields = self._layout.split(out.array)
        fields[DISPLACEMENT_KEY][:] = self.constraints.forces_on_y(forces)
        for part, values in zip(self.field_parts, part_loads, strict=False):
            fields[part.key][:] = values

    def initial_residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the residual at the step's initial unknowns `x` into `out`, and add it to the reference forces.

        It is not added in two cases, in which it would be too large. In a periodic cell under a mean strain, stiff
        bodies would follow the strain with large forces, however soft the layer. With a homotopy law, which is nearly
        elastic, a layer that has slipped far has large forces, too.
        """
        self.residual(x, out)
        if self.model.strain is None and not self.homotopy_parameter:
            self.scale.include_initial_residual(self.residual_norms(out))

    def residual(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the residual at unknowns `x` into `out`.

        It consists of internal forces minus loads, then of the residuals of parts' own equations. Internal forces are
        NaN if a law failed.
        """
        self._set_unknowns(x)
        theta, mid = self.interval.theta, self._mid_u.x.petsc_vec
        self.u.x.petsc_vec.copy(mid)
        mid.scale(theta)
        mid.axpy(1 - theta, self.interval.old.u.x.petsc_vec)
        self._mid_u.x.scatter_forward()
        part_norms = self.forces(self.u, self._mid_u, self._forces)
        common_norms = np.zeros(self.n_blocks)
        # a mean strain or stress acts on all blocks alike, and so does inertia: waves pass from block to block
        common_norms[: None if self.model.strain or self.model.stress or self.traits.inert else 1] = max(
            part_norms, default=0.0
        )
        self.scale.update_stresses(np.maximum(self.body_norms, common_norms))
        self._forces.axpy(-1.0, self.loads)
        forces = np.full(self.n_displacements, np.nan) if self.failed else self._forces.array_r
        self._put_forces(forces, [part.own_residual() for part in self.field_parts], out)
        self._relative_residual = self.relative_norm(out) if self.traits.singular else 0.0

    def tangent(self) -> PETSc.Mat:
        """Return the tangent at the unknowns of the last residual, without Dirichlet conditions.

        It is the derivative of the residual with respect to the unknowns. Each call overwrites the same matrix.

        Raises:
            InputError: a law declares a symmetric tangent, but its tangent is not symmetric.
        """
        tangent = self._matrix.fill(self.blocks(self._relative_residual))
        if self._T is None:
            return tangent
        self._reduced_tangent = tangent.ptap(self._T, result=self._reduced_tangent)
        self._reduced_tangent.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return self._reduced_tangent

    def on_unknowns(self, A: PETSc.Mat) -> PETSc.Mat:
        """Return the matrix of the unknowns, which may be `A`, for a matrix `A` of nodal displacements. Collective."""
        if self._T is None and not self.field_parts:
            return A
        full = TangentMatrix(self.comm, self._layout.sizes).fill([Block(A, kept=True)])
        return full if self._T is None else full.ptap(self._T)

    @contextmanager
    def constrained_tangent(
        self, x: PETSc.Vec | None = None, b: PETSc.Vec | None = None, *, in_place: bool = False
    ) -> Iterator[PETSc.Mat]:
        """Within a `with` block, return the tangent at the last residual's unknowns, with Dirichlet conditions.

        Args:
            x: vector whose values at constrained unknowns the solution shall have; None: zero values.
            b: right-hand side, to which the forces due to these values are added; None if `x` is None.
            in_place: whether, to save memory, the matrix of the bodies may be changed into the tangent. It is restored
                at the end of the block, so that the tangent may serve only to be factorised in the block. Without
                effect if `x` is given.
        """
        only_u = x is None and self._T is None and not self.field_parts
        first, *others = self.blocks(self._relative_residual) if in_place and only_u else [Block(None)]
        if first.kept and first.factor == 1:
            with augmented_in_place(self.comm, first.matrix, others, self.bc_rows, self.mean_stiffness or 1.0) as A:
                yield A
        else:
            A = self.tangent()
            self.apply_bcs(A, x, b)
            yield A

    def set_homotopy(self, parameter: float) -> None:
        """Choose the laws of all parts between the given law (`parameter` 0) and an elastic law (1)."""
        self.homotopy_parameter = parameter
        for part in self.parts:
            part.set_homotopy(parameter)

    def accept(self, x: PETSc.Vec, report: Report) -> State:
        """Return the state at the end of the time step, with its energies and reactions.

        Args:
            x: unknowns that the solver has found.
            report: the solver's report on its effort and accuracy.

        Raises:
            SolveError: `x` is not an equilibrium, even if the solver converged.
            LooseBody: a law that can release a body, such as contact, has done so.
        """
        out, x0 = self.create_vector(), self.create_vector()
        self.residual(x, out)
        self.require_equilibrium(out)
        if self.traits.releases:
            self.require_unique(out)
        self._require_bounded_jumps()
        self.put_state(self.interval.old, x0)
        bc_forces, u0 = out.array_r[self.bc_dofs], self.interval.old.u.x.array
        du_bc, du = x.array_r[self.bc_dofs] - x0.array_r[self.bc_dofs], (self.u.x.array - u0)[: self.n_displacements]
        works = bc_forces @ x.array_r[self.bc_dofs], bc_forces @ du_bc + self.loads.array_r @ du
        prescribed_work, supplied = map(float, self.comm.allreduce(np.array(works)))
        outcomes, end = self.end_parts(self.u, self.interval.t)
        end = replace(end, reactions=self.reactions())
        energy_names = ("supplied", "before", "dissipated", "remainder", "after")
        added, before, lost, remainder, after = (sum(getattr(o, k) for o in outcomes.values()) for k in energy_names)
        energies = (supplied + added, after - before, lost, remainder)
        noise = self.mean_stiffness * (ENERGY_ROUNDING * self._max_abs(self.u.x.array)) ** 2
        audit = Audit(*energies, after) if any(not abs(E) < noise for E in energies) else Audit(total=after)
        state = State(**vars(end), model=self.model, report=report, audit=audit, prescribed_work=prescribed_work)
        dissipated = self.model.sums_by_seam_and_bodies({key: outcome.dissipated for key, outcome in outcomes.items()})
        return replace(state, sudden=self.interval.dt == 0 and self.interval.old.at_rest, dissipated=dissipated)

    def reactions(self) -> Array:
        """Return the reactions (n, k) at the end of the time step: k components of force and moment at n supports.

        The rows are in the order of `Model.held_places`: supports, rigid plates and rigid bases. Moments are about
        `Model.centre`. The reactions belong to the last evaluation of the residual.
        """
        return self._reactions.reactions_at_end(self._forces, self.interval, self.loads_at)

    def _require_bounded_jumps(self) -> None:
        """Raise SolveError if the jumps of a layer exceed the size of the model.

        Only layers with bounded stresses or in contact are tested. Beyond a limit load their displacements grow without
        bound, until the rounding errors of forces hide the residual.
        """
        model_size = self.model.joint.size
        for part in self.layers:
            if (part.traits.bounded or part.traits.releases) and isinstance(part, MeasuresError):
                squared_jumps = self.comm.allreduce(float((part.error_measure(self.u) ** 2).sum()))
                if not squared_jumps <= part.unit_jump_measure() * model_size**2:
                    text = f"{part.key!r} jumps farther than the model's size, {model_size:.3g}"
                    advice = "loads may be beyond their limit; march from less"
                    raise SolveError(f"what the solver returned is not an equilibrium: {text}", advice=advice)

    # ---------------------------------------------------------------- time
    def is_linear_in_time(self, start: float, end: float) -> bool:
        """Whether loads, prescribed values and parameters of laws vary linearly in time from `start` to `end`.

        This is tested at a few times in between.
        """
        start_data, end_data = self.data_at(start), self.data_at(end)
        for fraction in SAMPLED_STEP_FRACTIONS:
            mid_data = self.data_at(start + fraction * (end - start))
            for a, b, c in zip(start_data, end_data, mid_data, strict=True):
                error = self._max_abs((1 - fraction) * a + fraction * b - c)
                if error > TIME_LINEARITY_TOLERANCE * self._max_abs(np.array([a, b, c])):
                    return False
        return True

    def _max_abs(self, values: Array) -> float:
        """Return the largest absolute value of all ranks' `values`; 0 if there are none."""
        return float(self.comm.allreduce(float(np.abs(values).max(initial=0.0)), max))

    def data_at(self, t: float) -> list[Array]:
        """Return arrays of this rank with all data that vary in time, at time `t`; InputError if one is out of range.

        They are the loads, the prescribed displacements, integrals of prescribed strains, and parameters of laws.
        """
        for part in self.parts:
            part.set_time(t)
        parameters = [values for part in self.parts for values in part.parameters()]
        loads, displacements = self.loads_at(t).array_r.copy(), self.constraints.bc_values(t)
        return [loads, displacements, *self._strain_integrals_at(t), *parameters]

    def _strain_integrals_at(self, t: float) -> list[Array]:
        if self.model.strain:  # it has its own error for values that are not finite
            self.model.strain.tensor_at(t)
        return self._strain_integrals.integrals_at(t)

    # ---------------------------------------------------------------- end
    def destroy(self) -> None:
        """Free the matrices of this model, and leave shared ones to the next model of its `ModelFamily`."""
        destroy(*self._unshared_parts)
        self._shared.release(self.model)


# ---------------------------------------------------------------- parts of a model
def body_parts(model: Model) -> list[Part]:
    """Return the parts of the balance of forces that come from a model's bodies. Collective.

    One part has all laws in UFL forms. Each compiled law has a part of its own. Under a prescribed mean stress, the
    unknown mean strain of the periodic cell is a further part. The parts have different keys, their names in states and
    files.

    The first part is that of the laws in UFL forms, even if there are none. In a model with bodies its matrix `K` has
    the nonzero pattern of the bodies' stiffness.
    """
    form_part = LinearPart("forms", model.V, model.bodies, model.layer_terms)
    parts: list[Part] = [form_part, *_compiled_parts(model, model.bodies)]
    if model.stress:
        parts.append(MeanStressPart(model.V, model.cell_terms, model.stress, model.volume, model.comm))
    return parts


def layer_parts(model: Model, bc_dofs: Indices, from_bodies: Sequence[Part]) -> list[Part]:
    """Return the parts of the balance of forces that come from a model's layers. Collective.

    They are laws in UFL forms, compiled laws, pressures of incompressible layers, and contact laws. The parts have
    different keys, their names in states and files.

    Args:
        model: the model.
        bc_dofs: local numbers of this rank's displacement components that supports prescribe.
        from_bodies: the parts of the bodies, as `body_parts` returns them. The largest stiffness of the layers, or of
            the bodies if layers have none, scales the equations of pressures: residuals have the unit of forces.
    """
    ufl_terms = [p for p in model.layer_terms if not p.law.traits.compiled]
    terms_by_key = {key: [p for p in ufl_terms if p.key == key] for key in dict.fromkeys(p.key for p in ufl_terms)}
    parts: list[Part] = [LinearPart(f"{key}/forms", model.V, key_terms) for key, key_terms in terms_by_key.items()]
    for layer in model.layers.values():
        parts += _enriched_parts(model, layer)
    parts += _compiled_parts(model, [p for p in model.layer_terms if not p.bubble_strain])
    if constrained := [p for p in model.layer_terms if p.law.traits.constrained]:
        scale = _largest_stiffness(model, parts) or _largest_stiffness(model, from_bodies) or 1.0
        joint = model.domain.joint  # its vertices are those of the mesh; `model.joint` is the joint before inflating
        masters = joint.masters if joint.periods else None
        parts += [PressurePart(model.V, p, scale, model.origin, _zero_p_points(model, p), masters) for p in constrained]
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, model.contact_surface(name), bc_dofs, model.layers[name].key))
    return parts


def _largest_stiffness(model: Model, parts: Sequence[Part]) -> float:
    """Return the largest diagonal entry of the stiffness of `parts` before loading, force per displacement. Collective.

    It is 0 if no part has any stiffness then.
    """
    diagonal_sums = fem.Function(model.V)  # must outlive its PETSc vector
    return max(0.0, float(sum_diagonals_at_rest(parts, diagonal_sums.x.petsc_vec).max()[1]))


def _compiled_parts(model: Model, terms: Iterable[Term]) -> list[CompiledPart]:
    terms_by_key = compiled_terms(terms).items()
    return [CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric) for key, term in terms_by_key]


def _enriched_parts(model: Model, layer: SeamLayer) -> list[Part]:
    terms = compiled_terms(p for p in model.layer_terms if p.bubble_strain and p.key == layer.key)
    if not terms:
        return []
    assert isinstance(model, InterfaceModel)
    bubble = BubblePart(model, layer)
    return [*(EnrichedPart(key, model, term, bubble) for key, term in terms.items()), bubble]


def sum_diagonals_at_rest(parts: Sequence[Part], out: PETSc.Vec) -> PETSc.Vec:
    """Write the diagonal of the stiffness before loading, summed over `parts`, into `out`; return `out`. Collective.

    `out` has an entry, force per displacement, for each displacement component. The stiffness of a part is its matrix
    `K`. Parts of bodies that are not in `K` give their diagonal by their method `sum_diagonals_at_rest`.
    """
    out.set(0.0)  # a subproblem of layers alone has no bodies
    diagonals = [part.K.getDiagonal() for part in parts if part.K is not None]
    diagonals += [diagonal for part in parts if (diagonal := part.diagonal_at_rest()) is not None]
    for diagonal in diagonals:
        out.axpy(1.0, diagonal)
    destroy(*diagonals)
    return out


def _zero_p_points(model: Model, term: Term) -> Array | None:
    """Return coordinates (n, d) of the n vertices of S where a layer's pressure is zero; d: number of dimensions.

    They lie at free ends, where no support holds the side of the layer. Ends whose cells are longer than the length
    over which the pressure falls to zero are left out.

    Args:
        model: the model with the layer.
        term: virtual work of the layer's law.

    Returns:
        The coordinates, on a curved S midway between its sides. None: the law is not an interface law of order 1 with a
        pressure.
    """
    if not flows_along_surface(term):
        return None
    layer = next(layer for layer in model.layers.values() if layer.key == term.key)
    applicability = model.applicability[layer.name]
    return points_on_middle(model.domain.joint)[np.unique(applicability.loose_rim[~applicability.coarse_mask].vertices)]
