"""The order of the unknowns in a vector: displacements first, then the parts' own unknowns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.parts.part import DISPLACEMENTS


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
