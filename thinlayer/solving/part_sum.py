"""Sum of the parts of a balance of forces, layout of its unknowns, its tangent, and its reference forces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import reduce
from operator import or_
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from forms.base import Array, InputError
from geometry.topology import Indices, IntArray
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.state import Configuration
from thinlayer.errors import SolveError
from thinlayer.parts.part import Block, FieldPart, Memory, Part, PartTraits, StepOutcome, SwitchesPhases, TimeStep
from thinlayer.pointwise.quadrature import set_owned_values
from thinlayer.system.ranks import destroy, send

SOLVER_RESIDUAL = 1e-10  # residual at which solvers stop, relative to the forces
ACCEPTED_RESIDUAL = 1e-6  # largest residual of an accepted state, relative to the forces
MACHINE_EPSILON = float(np.finfo(float).eps)
FORCE_ROUNDING = 1e-14  # rounding of summed forces, relative to stiffness times displacement
MIN_DIVISOR = 1e-300  # divisor instead of zero if there are no forces
PartType = TypeVar("PartType", bound=Part)
PetscIndices = npt.NDArray[PETSc.IntType]  # global numbers of unknowns
SUBSET_PATTERN = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
DIFFERENT_PATTERN = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN


class ForceScale:
    """Reference forces with which the residuals of a time step are compared, one for each of k blocks of unknowns.

    Blocks are the whole model, then each connected piece of the bodies, then the nodes of a piece on each seam, and all
    meshed layers. Each block can be out of balance independently of the others. Norms are Euclidean, over the unknowns
    of each block: arrays (k,) in the order of the blocks.

    The rules are:

    1. The residual in a block is divided by the reference force of the block. This is the largest of three norms: of
       the loads, of the nodal forces of the last stresses, and of the residual at the start of the step.
    2. All forces may be rounding errors: if supports move stiff bodies, loads end at zero, or soft springs let stiff
       bodies move far. Rounding errors of forces are about 1e-14 of stiffness times displacement. Divided by the 1e-6
       of rule 5, this is a lower bound of the reference force.
    3. Solvers stop where the residual in each block is at most 1e-10 of the reference force. They also stop where it is
       at most the rounding error of stiffness times displacement.
    4. A residual as small as the rounding error due to prescribed displacements is always allowed, since no solver can
       reduce it.
    5. A state is accepted if its residual is at most 1e-6 of the reference force in each block, or at most that of rule
        4.

    A relative residual does not change if all forces are multiplied by a factor, as by other units. Nor does it change
    if supports and bodies move together like a rigid body.

    Args:
        stiffness: (k,) norms of the diagonal of the bodies' stiffness.
        spring_norm: norm of the diagonal of the stiffness of springs that resist differences of displacements.
        nesting: (k, k) sparse matrix, with the entry (i, j) = 1 if block j lies within block i. Rounding errors in block
            j are then those of the forces on block i. None: no block lies within another.

    Attributes:
        stiffness: the argument.
        forces: (k,) reference forces by rules 1 and 2, for the last residual.
        max_displacement: largest displacement that is known: of those prescribed, of the previous state, and of the
            response of an elastic layer.
    """

    def __init__(self, stiffness: Array | float, spring_norm: float = 0.0, nesting: csr_matrix | None = None) -> None:
        self.stiffness: Array = np.atleast_1d(stiffness)
        self._nesting = nesting
        self._largest_stiffness = np.maximum(self.stiffness, spring_norm)
        self.begin(0.0, 0.0, 0.0)

    def begin(self, load_norms: Array | float, max_prescribed: float, old_displacement: float) -> None:
        """Start the reference forces of a new time step, in k blocks of unknowns.

        Args:
            load_norms: (k,) norms of the nodal forces of the loads.
            max_prescribed: largest displacement that supports prescribe.
            old_displacement: largest displacement of the previous state.
        """
        self._loads, self._initial_residual = np.atleast_1d(load_norms), 0.0 * self.stiffness
        self.max_displacement = max(max_prescribed, old_displacement)
        self._support_rounding: Array = MACHINE_EPSILON * self.stiffness * max_prescribed
        self.update_stresses(0.0)

    def include_initial_residual(self, residual_norms: Array) -> None:
        """Count the residual at the start of the step among the reference forces.

        It may be the only force of the step.

        Args:
            residual_norms: (k,) norms of this residual in k blocks of unknowns.
        """
        self._initial_residual = np.where(np.isfinite(residual_norms), residual_norms, 0.0)

    def include_displacement(self, elastic: float) -> None:
        """Count the displacement `elastic` as known, which bounds rounding errors of the forces.

        It is the largest displacement in the response of an elastic layer. Displacements of other iterates may be far
        too large, and are not counted.
        """
        self.max_displacement = max(self.max_displacement, elastic)

    def update_stresses(self, stress_norms: Array | float) -> None:
        """Update the reference forces for a new residual.

        Args:
            stress_norms: (k,) norms of the nodal forces of its stresses, in k blocks of unknowns.
        """
        self._least_by_rounding = FORCE_ROUNDING / ACCEPTED_RESIDUAL * self.stiffness * self.max_displacement
        self.least_forces = np.maximum(np.maximum(self._loads, self._initial_residual), self._least_by_rounding)
        self.forces: Array = np.fmax(self.least_forces, stress_norms)
        if self._nesting is not None:
            self.forces = np.maximum(self.forces, FORCE_ROUNDING / ACCEPTED_RESIDUAL * (self._nesting.T @ self.forces))

    @property
    def is_only_rounding(self) -> bool:
        """Whether the reference force of the whole model is only that of rounding errors, as where supports move."""
        return bool(self.forces[0] <= self._least_by_rounding[0])

    def force_rounding(self, largest_displacement: float) -> Array:
        """Return the norms (k,) of the rounding errors of the forces in k blocks of unknowns.

        Args:
            largest_displacement: largest displacement among the unknowns.
        """
        return np.asarray(MACHINE_EPSILON * self._largest_stiffness * largest_displacement)

    def max_norms(self, largest_displacement: float) -> Array:
        """Return the norms (k,) of the residual, in k blocks of unknowns, at which solvers stop.

        Args:
            largest_displacement: largest displacement among the unknowns.
        """
        rounding = np.minimum(self.force_rounding(largest_displacement), self.allowed_residual)
        return np.asarray(np.maximum(np.maximum(SOLVER_RESIDUAL * self.forces, self._support_rounding), rounding))

    @property
    def allowed_residual(self) -> Array:
        """Norms (k,), in k blocks of unknowns, that the residual of an accepted state must not exceed."""
        return np.asarray(np.maximum(ACCEPTED_RESIDUAL * self.forces, self._support_rounding))

    def relative_norm(self, norms: Array) -> float:
        """Return the largest ratio of a residual's norm to the reference force, over k blocks of unknowns.

        Args:
            norms: (k,) norms of the residual in the blocks.
        """
        return float((norms / np.maximum(self.forces, MIN_DIVISOR)).max())


class PartSum:
    """Sum of the parts of a balance of forces, such as bodies, layers and contact. All methods are collective.

    Attributes:
        parts: the parts.
        traits: properties of all parts together: a flag is set if one part has it.
        field_parts: the parts with unknowns of their own, such as pressures.
        depends_on_dt: whether the tangent depends on the length of the step.
        failed: number of points where laws failed in the last evaluation.
        comm: communicator; subclasses set it.
        bc_dofs: local numbers of the constrained unknowns of this rank; subclasses set them.
        scale: the reference forces with which residuals are compared; subclasses set them.
        block_of: (n,) number >= 1 of the innermost block of `ForceScale` that contains the unknown, for the first n
            unknowns of this rank. All others belong to block 0, the whole model, alone.
        n_blocks: number k of blocks, including block 0.
        nesting: (k, k) sparse matrix that adds to a block's sum the sums of the blocks within it. The entry (i, j) is 1
            if j = i, or if block j lies within block i. Row and column 0 are those of the identity, as the sum over the
            whole model is computed directly. None: no block lies within another.
        last_body: the last one of those parts that are bodies.
        body_norms: (k,) norms of the nodal forces of all bodies together, in the last evaluation.
    """

    comm: MPI.Intracomm
    bc_dofs: Indices
    scale: ForceScale
    block_of: IntArray = np.empty(0, np.int64)
    n_blocks: int = 1
    nesting: csr_matrix | None = None
    last_body: Part | None = None
    body_norms: Array | float = 0.0

    def __init__(self, parts: Iterable[Part]) -> None:
        self.parts = list(parts)
        self.traits = reduce(or_, (part.traits for part in self.parts), PartTraits())
        self.field_parts = [part for part in self.parts if isinstance(part, FieldPart)]
        for part in self.parts:
            if part.field is not None and not isinstance(part, FieldPart):
                raise InputError(f"the part {part.key!r} has a field of its own; derive it from FieldPart")
        dt_flags = (part.traits.rate or (part.traits.remembers and not part.traits.switches) for part in self.parts)
        self.depends_on_dt, self.failed = any(dt_flags), 0

    def of_kind(self, kind: type[PartType]) -> list[PartType]:
        """Return the parts that are instances of the class `kind`."""
        return [part for part in self.parts if isinstance(part, kind)]

    def names_with_trait(self, trait: str) -> list[str]:
        """Return the names of the laws, or of parts without a law, whose flag `trait` of `PartTraits` is set."""
        return [name for part in self.parts for name, traits in part.law_traits().items() if getattr(traits, trait)]

    def refuse_traits(self, reasons: Mapping[str, str]) -> None:
        """Raise InputError if a law or part has one of the given properties.

        Args:
            reasons: name of a flag of `PartTraits` -> message of the error, in which {} stands for the name of the law
                or part.
        """
        for trait, reason in reasons.items():
            for name in self.names_with_trait(trait):
                raise InputError(reason.format(name))

    # ---------------------------------------------------------------- a step
    @property
    def memory_at_rest(self) -> dict[str, Memory]:
        """Initial memory (internal variables) of the parts that have one, by the parts' keys."""
        return {part.key: rest for part in self.parts if (rest := part.rest()) is not None}

    @property
    def stresses_at_rest(self) -> dict[str, Array]:
        """Zero stresses (points, components), by the parts' keys, of parts whose stresses are stored in states."""
        memory, widths = self.memory_at_rest, {part.key: part.stress_width for part in self.parts if part.stress_width}
        return {key: np.zeros((len(memory[key]), width)) for key, width in widths.items() if key in memory}

    def begin_parts(self, interval: TimeStep) -> None:
        """Begin the time step `interval` in all parts."""
        for part in self.parts:
            part.begin(interval)

    def forces(self, u: fem.Function, mid: fem.Function, out: PETSc.Vec, temp: PETSc.Vec | None = None) -> list[float]:
        """Evaluate all parts at given displacements, and write the sum of their nodal forces into `out`.

        Args:
            u: displacements at the end of the step.
            mid: displacements at the time of the step at which forces balance.
            out: vector of the nodal forces; overwritten.
            temp: work vector of the same layout, for the norms of each part's forces; None: parts choose their norms.

        Returns:
            A norm for each part: that of its nodal forces if `temp` is given, else the result of `Part.add_forces`.
        """
        out.set(0.0)
        part_norms = []
        for part in self.parts:
            part.evaluate(u, mid)
            if temp is None:
                part_norms.append(part.add_forces(out))
            else:
                temp.set(0.0)
                part.add_forces(temp)
                part_norms.append(float(temp.norm()))
                out.axpy(1.0, temp)
            if part is self.last_body:
                self.body_norms = self.norms(out.array_r)
        self.failed = sum(part.failed for part in self.parts)
        return part_norms

    def failure_text(self) -> str:
        """Say which part failed in the last call of `forces`, and where; "" if none failed."""
        return next(filter(None, [part.failure() for part in self.parts]), "")

    def blocks(self, relative_residual: float = 0.0) -> list[Block]:
        """Return the matrices of all parts that add up to the tangent at the last evaluation.

        Args:
            relative_residual: norm of the last residual relative to the reference forces. Parts use it to regularise
                singular tangents. It may be 0 if there are none.
        """
        return [block for part in self.parts for block in part.tangents(relative_residual)]

    def resisting_blocks(self, relative_residual: float, least_forces: PETSc.Vec) -> list[Block]:
        """Return the matrices of those parts that can resist rigid motions of the bodies, at the last evaluation.

        Args:
            relative_residual: norm of the last residual relative to the reference forces. Parts use it to regularise
                singular tangents. It may be 0 if there are none.
            least_forces: vector of nodal forces. Forces that do not exceed them do not count as resistance.
        """
        parts = [part for part in self.parts if not part.traits.within_bodies]
        return [block for part in parts for block in part.reliable_tangents(relative_residual, least_forces)]

    @property
    def max_phase_gain(self) -> float:
        """Largest energy that a column of a layer would gain by changing its phase; <= 0 if none would gain energy.

        A phase is a branch of a law whose stress is not monotone. A column is a facet of S, or in a meshed layer the
        cells above the facet. The value is -inf without phases.
        """
        return max((part.phase_gain() for part in self.parts if isinstance(part, SwitchesPhases)), default=-math.inf)

    def switch(self) -> bool:
        """Change the phase of each column to that of lowest energy in the last evaluation; return whether any changes.

        A phase is a branch of a law whose stress is not monotone. A column is a facet of S, or in a meshed layer the
        cells above the facet.
        """
        return any([part.switch_phases() for part in self.parts if isinstance(part, SwitchesPhases)])

    def end_parts(self, u: fem.Function, t: float) -> tuple[dict[str, StepOutcome], Configuration]:
        """End the time step in all parts, at the displacements `u` of their last evaluation and time `t`.

        Returns:
            Energies and memory of the parts over the step, by key, and the configuration at the end of the step.
        """
        outcomes = {part.key: part.commit() for part in self.parts}
        memory = {key: outcome.memory for key, outcome in outcomes.items() if outcome.memory is not None}
        if unsaved := [part.key for part in self.parts if part.traits.remembers and part.key not in memory]:
            raise InputError(f"the part {unsaved[0]!r} remembers; let its commit return StepOutcome(..., memory=...)")
        fields = {part.key: part.own_result() for part in self.field_parts}
        stored = {key: outcome.after for key, outcome in outcomes.items() if outcome.kept}
        stresses = {key: outcome.stress for key, outcome in outcomes.items() if outcome.stress is not None}
        return outcomes, Configuration(u.copy(), t, memory, fields, stored, stresses=stresses)

    # ---------------------------------------------------------------- tests of balance
    def norms(self, values: Array) -> Array:
        """Return the Euclidean norms (k,), over all ranks, of forces in each of k blocks of unknowns.

        Block 0 is the whole model. The others are those of `ForceScale`. A block includes the blocks within it.

        Args:
            values: forces on this rank's unknowns.
        """
        squares = values * values
        # without unknowns `bincount` counts in integers
        sums = np.bincount(self.block_of, squares[: len(self.block_of)], self.n_blocks).astype(float)
        sums = sums if self.nesting is None else self.nesting @ sums
        sums[0] = squares.sum()
        return np.asarray(np.sqrt(self.comm.allreduce(sums)))

    def residual_norms(self, r: PETSc.Vec) -> Array:
        """Return the norms (k,) of the residual `r` in k blocks of unknowns; constrained unknowns do not count."""
        values = r.array_r.copy()
        values[self.bc_dofs] = 0.0
        return self.norms(values)

    def relative_norm(self, r: PETSc.Vec) -> float:
        """Return the largest ratio of the residual's norm to the reference force, over all blocks of unknowns.

        Args:
            r: the residual.
        """
        return self.scale.relative_norm(self.residual_norms(r))

    def max_norms(self, x: PETSc.Vec) -> Array:
        """Return the norms (k,) of the residual, in k blocks of unknowns, at which solvers stop.

        Args:
            x: the unknowns, whose largest entry decides on the size of rounding errors.
        """
        return self.scale.max_norms(float(x.norm(PETSc.NormType.INFINITY)))

    def is_balanced(self, x: PETSc.Vec, r: PETSc.Vec) -> bool:
        """Whether the residual `r` at unknowns `x` is so small that solvers stop."""
        return bool((self.residual_norms(r) <= self.max_norms(x)).all())

    def require_equilibrium(self, r: PETSc.Vec) -> None:
        """Raise SolveError unless the residual `r` is small enough for an accepted state in each block of unknowns.

        By the rules of `ForceScale` it must be at most 1e-6 of the reference force, except for rounding errors. PETSc
        options do not change this test. It therefore detects a solver that stopped too early.
        """
        norms, scale = self.residual_norms(r), self.scale
        if (norms <= scale.allowed_residual).all():
            return
        details = f", allowed: {ACCEPTED_RESIDUAL:g}" + (f"; {self.failure_text()}" if self.failed else "")
        text = f"{scale.relative_norm(norms):.1e} of the forces of loads and stresses is out of balance"
        advice = "do PETSc options (of a script, a command line, PETSC_OPTIONS or a file petscrc) end the solve early?"
        raise SolveError(f"what the solver returned is not an equilibrium: {text}{details}", advice=advice)


# ---------------------------------------------------------------- unknowns and tangent
class UnknownLayout:
    """Order of this rank's unknowns in a vector: all values of one field, then those of the next. Collective.

    Args:
        comm: communicator.
        fields: key of a field -> function whose values are unknowns, in the order of the vector, displacements first.
    """

    def __init__(self, comm: MPI.Intracomm, fields: Mapping[str, fem.Function]) -> None:
        self.comm, self.fields = comm, fields
        dofmaps = {key: f.function_space.dofmap for key, f in fields.items()}
        self.sizes = {key: int(dofmap.index_map.size_local * dofmap.index_map_bs) for key, dofmap in dofmaps.items()}
        self._ends = np.cumsum([*self.sizes.values()])

    def create_vector(self) -> PETSc.Vec:
        """Return a new vector of unknowns, filled with zeros."""
        return PETSc.Vec().createMPI((int(self._ends[-1]), None), comm=self.comm)

    def split(self, values: Array) -> dict[str, Array]:
        """Split `values` of this rank's unknowns by field: key of the field -> part of `values` that belongs to it.

        The results are views, so that changes of them change `values`.
        """
        return dict(zip(self.sizes, np.split(values, self._ends[:-1]), strict=True))

    def copy_to_fields(self, x: PETSc.Vec) -> None:
        """Copy a vector `x` of unknowns into the functions of their fields, and update ghosts."""
        for key, values in self.split(x.array_r).items():
            set_owned_values(self.fields[key], values)

    def extended_to_all_fields(self, T: PETSc.Mat | None) -> PETSc.Mat | None:
        """Extend the matrix `T` of constraints u = T y on displacements by the identity for all other unknowns.

        If `T` is None, there are no constraints, and the result is None.
        """
        if T is None or len(self.sizes) == 1:
            return T
        identity = _diagonal_matrix(self.comm, int(self._ends[-1] - self._ends[0]), 1.0)
        return block_matrix([[T, None], [None, identity]], self.comm)

    def global_rows(self, local_dofs: Indices) -> PetscIndices:
        """Return the global numbers (n,) of the unknowns that have the numbers `local_dofs` (n,) on this rank."""
        n = int(self._ends[-1])
        return np.asarray(self.comm.scan(n) - n + local_dofs, PETSc.IntType)


class TangentMatrix:
    """Tangent of several fields, whose blocks are sums of matrices of parts. Collective.

    Every call of `fill` overwrites the same matrix.

    Args:
        comm: communicator.
        sizes: key of a field -> its number of unknowns on this rank, in the order of the unknowns.

    Attributes:
        comm, sizes: the arguments.
    """

    def __init__(self, comm: MPI.Intracomm, sizes: Mapping[str, int]) -> None:
        self.comm, self.sizes = comm, sizes
        self._block_sums: dict[tuple[str, str], PETSc.Mat] = {}
        self._block_matrix: PETSc.Mat | None = None

    def fill(self, blocks: Sequence[Block]) -> PETSc.Mat:
        """Add up matrices of parts, each in the rows and columns of its fields, and return the sum as one matrix.

        The first call fixes the nonzero pattern. Matrices that their parts do not use again (`Block.kept`) are
        destroyed.

        Args:
            blocks: the matrices, with the keys of the fields of their rows and columns.
        """
        for field_pair in dict.fromkeys((block.row, block.column) for block in blocks):
            self._sum_blocks(field_pair, [block for block in blocks if (block.row, block.column) == field_pair])
        destroy(*(block.matrix for block in blocks if not block.kept))
        return self._join_blocks() if len(self.sizes) > 1 else next(iter(self._block_sums.values()))

    def _sum_blocks(self, field_pair: tuple[str, str], blocks: Sequence[Block]) -> None:
        if field_pair in self._block_sums:
            A = self._block_sums[field_pair]
            A.zeroEntries()
            for block in blocks:
                A.axpy(block.factor, block.matrix, SUBSET_PATTERN)
            return
        A = blocks[0].matrix.copy()
        A.scale(blocks[0].factor)
        for block in blocks[1:]:
            A.axpy(block.factor, block.matrix, DIFFERENT_PATTERN)
        if len(blocks) > 1:  # PETSc's own LU finds zero pivots in a matrix merged by axpy, but not in its copy
            A = A.copy()
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._block_sums[field_pair] = A

    def _join_blocks(self) -> PETSc.Mat:
        block_rows = [[self._block_sums.get((row, column)) for column in self.sizes] for row in self.sizes]
        for k, n in enumerate(self.sizes.values()):
            block_rows[k][k] = block_rows[k][k] or _diagonal_matrix(self.comm, n, 0.0)
        self._block_matrix = block_matrix(block_rows, self.comm, self._block_matrix)
        self._block_matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return self._block_matrix

    def destroy(self) -> None:
        """Free the matrices."""
        destroy(*self._block_sums.values(), self._block_matrix)


@contextmanager
def augmented_in_place(
    comm: MPI.Intracomm, K: PETSc.Mat, added: Sequence[Block], bc_rows: PetscIndices, diagonal: float
) -> Iterator[PETSc.Mat]:
    """Within a `with` block, add matrices to `K` and apply Dirichlet conditions, then restore `K`. Collective.

    `K` is changed in place, because a copy would need the same memory again.

    Args:
        comm: communicator.
        K: a matrix with a symmetric nonzero pattern.
        added: the matrices to add. Those that their parts do not use again (`Block.kept`) are destroyed.
        bc_rows: global numbers of the constrained rows and columns, which become `diagonal` times those of the identity.
        diagonal: diagonal entry of constrained rows.
    """
    # as the pattern is symmetric, the columns of these rows are the rows with entries in constrained columns
    bc_submatrix = K.createSubMatrix(PETSc.IS().createGeneral(bc_rows, comm=K.comm))
    columns = np.unique(bc_submatrix.getValuesCSR()[1])
    bc_submatrix.destroy()
    rows = [bc_rows, send(comm, np.searchsorted(K.getOwnershipRanges(), columns, "right") - 1, columns)]
    rows += [K.getOwnershipRange()[0] + np.flatnonzero(np.diff(block.matrix.getRowIJ()[0])) for block in added]
    changed = np.unique(np.concatenate(rows)).astype(PETSc.IntType)
    saved_rows = K.createSubMatrix(PETSc.IS().createGeneral(changed, comm=K.comm))
    try:
        for block in added:
            pattern = SUBSET_PATTERN if _fits_pattern(comm, block.matrix, saved_rows, changed) else DIFFERENT_PATTERN
            K.axpy(block.factor, block.matrix, pattern)
        destroy(*(block.matrix for block in added if not block.kept))
        K.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        K.zeroRowsColumns(bc_rows, diagonal)
        yield K
    finally:
        K.zeroRows(changed, 0.0)
        K.setValuesIJV(*saved_rows.getValuesCSR(), rowmap=changed)
        K.assemble()
        K.setOption(PETSc.Mat.Option.SPD, False)
        saved_rows.destroy()


def _fits_pattern(comm: MPI.Intracomm, matrix: PETSc.Mat, rows: PETSc.Mat, row_numbers: PetscIndices) -> bool:
    """Whether all nonzeros of `matrix` in certain rows have places in the nonzero pattern of `rows`. Collective.

    Args:
        comm: communicator.
        matrix: a matrix.
        rows: matrix that consists of the same rows of another matrix, which has the size of `matrix`.
        row_numbers: global numbers of these rows.
    """
    pattern, allowed = local_csr(matrix)[row_numbers - matrix.getOwnershipRange()[0]], local_csr(rows)
    pattern.data[:], allowed.data[:] = 1.0, 1.0  # stored entries may be zero
    return bool(comm.allreduce(pattern.multiply(allowed).nnz == pattern.nnz, MPI.LAND))


def block_matrix(
    blocks: Sequence[Sequence[PETSc.Mat | None]], comm: MPI.Intracomm, into: PETSc.Mat | None = None
) -> PETSc.Mat:
    """Join blocks to one matrix.

    Args:
        blocks: rows of blocks; None stands for a block of zeros.
        comm: communicator.
        into: earlier result with the same nonzero pattern, which is overwritten and returned; None: a new matrix.

    Returns:
        The matrix. Each rank owns its rows and columns of all blocks, in the order of the blocks.
    """
    return PETSc.Mat().createNest(blocks, comm=comm).convert("aij", into or PETSc.Mat())


def _diagonal_matrix(comm: MPI.Intracomm, n: int, value: float) -> PETSc.Mat:
    """Return a diagonal matrix with `n` rows on this rank, all with the diagonal entry `value`.

    Entries are stored even if they are zero, as `zeroRowsColumns` needs them.
    """
    indptr = np.arange(n + 1, dtype=PETSc.IntType)
    csr = indptr, (comm.scan(n) - n + indptr[:-1]).astype(PETSc.IntType), np.full(n, value)
    return PETSc.Mat().createAIJ(((n, None), (n, None)), csr=csr, comm=comm)
