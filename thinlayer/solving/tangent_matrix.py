"""The order of the unknowns, the tangent as one matrix of the parts' blocks, its factor, and what families keep of them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.work import Term
from thinlayer.discretisation.model import Model
from thinlayer.parts.part import DISPLACEMENTS, Block, Part
from thinlayer.solving.petsc import PREFIX

SAME, SUBSET, DIFFERENT = (
    PETSc.Mat.Structure.SAME_NONZERO_PATTERN,
    PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN,
    PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN,
)


class Layout:
    """The unknowns of this rank, field after field. Collective.

    Args:
        comm: communicator.
        fields: key -> the function whose values are unknowns, in the order of the unknowns.
    """

    def __init__(self, comm: MPI.Intracomm, fields: Mapping[str, fem.Function]) -> None:
        self.comm, self.fields = comm, fields
        maps = {
            key: (f.function_space.dofmap.index_map, f.function_space.dofmap.index_map_bs) for key, f in fields.items()
        }
        self.sizes = {key: int(imap.size_local * bs) for key, (imap, bs) in maps.items()}
        self._ends = np.cumsum([*self.sizes.values()])

    def vector(self) -> PETSc.Vec:
        """A vector of unknowns, zero."""
        return PETSc.Vec().createMPI((int(self._ends[-1]), None), comm=self.comm)

    def split(self, values: npt.NDArray[np.float64]) -> dict[str, npt.NDArray[np.float64]]:
        """The unknowns of this rank, split by key; the arrays are views."""
        return dict(zip(self.sizes, np.split(values, self._ends[:-1]), strict=True))

    def put(self, x: PETSc.Vec) -> None:
        """Write unknowns into their functions, ghosts included."""
        for key, values in self.split(x.array_r).items():
            f = self.fields[key]
            f.x.array[: len(values)] = values
            f.x.scatter_forward()

    def widened(self, T: PETSc.Mat | None) -> PETSc.Mat | None:
        """A matrix of displacements on all unknowns, the others as they are; None of None. The caller destroys it."""
        if T is None:
            return None
        size, n = int(self._ends[-1]), self.sizes[DISPLACEMENTS]
        counts = np.array(self.comm.allgather((n, size)))
        first_u, first = (np.cumsum(column) - column for column in counts.T)
        begins, columns, values = T.getValuesCSR()
        rank = np.searchsorted(first_u, columns, side="right") - 1
        columns = np.append(columns - first_u[rank] + first[rank], first[self.comm.rank] + np.arange(n, size))
        begins = np.append(begins, begins[-1] + 1 + np.arange(size - n))
        csr = begins.astype(PETSc.IntType), columns.astype(PETSc.IntType), np.append(values, np.ones(size - n))
        return PETSc.Mat().createAIJ(((size, None), (size, None)), csr=csr, comm=self.comm)

    def rows(self, local: npt.NDArray[np.int32]) -> npt.NDArray[PETSc.IntType]:
        """Global numbers of unknowns of this rank."""
        n = int(self._ends[-1])
        return (self.comm.scan(n) - n + local).astype(PETSc.IntType)


class TangentMatrix:
    """A matrix of sums of blocks; every `fill` writes into the same matrix. Collective.

    Args:
        comm: communicator.
        sizes: key of a block -> its number of unknowns on this rank, in the order of the unknowns.

    Attributes:
        comm, sizes: the arguments.
    """

    def __init__(self, comm: MPI.Intracomm, sizes: Mapping[str, int]) -> None:
        self.comm, self.sizes = comm, sizes
        self._sums: dict[tuple[str, str], PETSc.Mat] = {}
        self._whole: PETSc.Mat | None = None

    def fill(self, blocks: Sequence[Block]) -> PETSc.Mat:
        """The matrix of these blocks; no entries may lie outside those of the first call. Destroys blocks not kept."""
        places: dict[tuple[str, str], list[Block]] = {}
        for block in blocks:
            places.setdefault((block.row, block.column), []).append(block)
        for place, here in places.items():
            self._add(place, here)
        for block in blocks:
            if not block.kept:
                block.matrix.destroy()
        if len(self.sizes) == 1:
            (A,) = self._sums.values()
            return A
        return self._side_by_side()

    def _add(self, place: tuple[str, str], blocks: Sequence[Block]) -> None:
        if place in self._sums:
            A = self._sums[place]
            A.zeroEntries()
            for block in blocks:
                A.axpy(block.factor, block.matrix, SUBSET)
            return
        A = blocks[0].matrix.copy()
        A.scale(blocks[0].factor)
        for block in blocks[1:]:
            A.axpy(block.factor, block.matrix, DIFFERENT)
        if len(blocks) > 1:  # PETSc's own LU finds zero pivots in what axpy has merged, none in a copy
            merged, A = A, A.copy()
            merged.destroy()
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._sums[place] = A

    def _side_by_side(self) -> PETSc.Mat:
        rows = [[self._sums.get((row, column)) for column in self.sizes] for row in self.sizes]
        empty = []
        for k, n in enumerate(self.sizes.values()):
            if rows[k][k] is None:
                rows[k][k] = _zero_diagonal(self.comm, n)
                empty.append(rows[k][k])
        nest = PETSc.Mat().createNest(rows, comm=self.comm)
        whole = nest.convert("aij", PETSc.Mat())
        for thing in (nest, *empty):
            thing.destroy()
        if self._whole is None:
            whole.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            self._whole = whole
        else:
            whole.copy(self._whole, SAME)
            whole.destroy()
        return self._whole

    def destroy(self) -> None:
        """Free the matrices."""
        for matrix in (*self._sums.values(), self._whole):
            if matrix is not None:
                matrix.destroy()


def _zero_diagonal(comm: MPI.Intracomm, n: int) -> PETSc.Mat:
    """A matrix with n rows on this rank that stores zeros on its diagonal: `zeroRowsColumns` needs stored entries."""
    places = np.arange(n + 1, dtype=PETSc.IntType)
    first = comm.scan(n) - n
    csr = (places, (first + places[:-1]).astype(PETSc.IntType), np.zeros(n))
    return PETSc.Mat().createAIJ(((n, None), (n, None)), csr=csr, comm=comm)


class Factor:
    """A KSP and the matrix that it has factored. Collective.

    Attributes:
        ksp: the solver; None: there is none.
        of: what the factored matrix depends on; None: not known.
    """

    def __init__(self) -> None:
        self.ksp: Any = None
        self.of: Hashable = None
        self._options: dict[str, Any] = {}

    def renew(self, A: PETSc.Mat, of: Hashable, tell: Callable[[PETSc.KSP, PETSc.Mat], None]) -> bool:
        """Take another matrix, which is factored by the next solve.

        Args:
            A: the matrix.
            of: what it depends on.
            tell: function that tells a solver what is known of the matrix, see `Equations.tell`.

        Returns:
            Whether the solver stays: it then orders the unknowns anew only if A has another nonzero pattern.
        """
        options = {name: value for name, value in PETSc.Options().getAll().items() if name.startswith(PREFIX)}
        stays = self.ksp is not None and options == self._options and self.ksp.getPC().getType() != "fieldsplit"
        if not stays:
            self.destroy()
            self.ksp = PETSc.KSP().create(A.comm)
            self.ksp.setOptionsPrefix(PREFIX)
        self.ksp.setOperators(A)
        if not stays:
            self.ksp.setFromOptions()
        tell(self.ksp, A)
        self._options, self.of = options, of
        return stays

    def destroy(self) -> None:
        """Free the solver and its factor."""
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp = self.of = None


class Kept:
    """Matrices of the equations of a model, which may serve other models of its family.

    Attributes:
        bodies: parts that depend on mesh and bodies alone; empty: they are yet to be made.
        matrix: the tangent; None: it is yet to be made.
        factor: of the tangent.
    """

    def __init__(self) -> None:
        self.bodies: Sequence[Part] = ()
        self.matrix: TangentMatrix | None = None
        self.factor = Factor()
        self._terms: Sequence[Term] = ()
        self._pattern: Any = None

    @classmethod
    def of(cls, model: Model) -> Kept:
        """What the model's family has, made fit for this model; new if it has nothing."""
        kept = model.family.kept or cls()
        model.family.kept = None
        pattern = (
            [(p.key, type(p.law), p.law.traits, len(p.law.sublayers)) for p in model.layer_terms],
            [(name, type(one.law), one.thin and one.thin.order) for name, one in model.layers.items()],
        )
        if pattern != kept._pattern:
            kept._free_matrix()
        if model.layer_terms is not kept._terms:
            kept.factor.of = None
        kept._terms, kept._pattern = model.layer_terms, pattern
        return kept

    def give_back(self, model: Model) -> None:
        """Leave all to the family if it has other models, else free it."""
        if model.family.several:
            if model.family.kept is not None:  # by another solver at the same time
                model.family.kept.destroy()
            model.family.kept = self
        else:
            self.destroy()

    def _free_matrix(self) -> None:
        self.factor.destroy()
        if self.matrix is not None:
            self.matrix.destroy()
        self.matrix = None

    def destroy(self) -> None:
        """Free all matrices."""
        self._free_matrix()
        for part in self.bodies:
            part.destroy()
        self.bodies = ()
