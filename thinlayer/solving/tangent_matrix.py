"""The tangent as one matrix: the sum of the blocks that parts of the balance add."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.parts.part import Block

SAME, SUBSET, DIFFERENT = (
    PETSc.Mat.Structure.SAME_NONZERO_PATTERN,
    PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN,
    PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN,
)


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
