"""Linear solves on one process with a matrix whose entries change and whose pattern does not."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.linear_solvers import DIRECT
from thinlayer.solving.petsc import PREFIX, defaults, solve_linear


class SparseSolver:
    """Solves (base + more) x = b; MUMPS orders the unknowns once. PETSc options are read under our prefix.

    Args:
        base: the constant part.
        largest: a matrix whose pattern has all entries that `more` may have.
    """

    def __init__(self, base: scipy.sparse.csr_matrix, largest: scipy.sparse.csr_matrix) -> None:
        self._size = base.shape[0]
        keys = np.unique(np.concatenate([self._keys(base), self._keys(largest)]))
        rows, columns = np.divmod(keys, self._size)
        self._places = keys
        self._base = np.zeros(len(keys))
        self._put(self._base, base)
        starts = np.searchsorted(rows, np.arange(self._size + 1)).astype(PETSc.IntType)
        csr = starts, columns.astype(PETSc.IntType), self._base
        self._starts, self._columns = csr[:2]
        self._matrix = PETSc.Mat().createAIJ(base.shape, csr=csr, comm=PETSc.COMM_SELF)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setOperators(self._matrix)
        with defaults({**DIRECT, "pc_type": "lu"}):
            self._ksp.setFromOptions()
        self._b, self._x = self._matrix.createVecs()

    def _keys(self, A: scipy.sparse.csr_matrix) -> np.ndarray:
        rows = np.repeat(np.arange(self._size, dtype=np.int64), np.diff(A.indptr))
        return rows * self._size + A.indices

    def _put(self, data: Array, A: scipy.sparse.csr_matrix) -> None:
        """Add the entries of A, each of which stands once."""
        data[np.searchsorted(self._places, self._keys(A))] += A.data

    def solve(self, more: scipy.sparse.csr_matrix, b: Array) -> Array:
        """x; not finite if the matrix is singular."""
        data = self._base.copy()
        self._put(data, more)
        self._matrix.setValuesCSR(self._starts, self._columns, data)
        self._matrix.assemble()
        self._b.array[:] = b
        with defaults({**DIRECT, "pc_type": "lu"}):
            solve_linear(self._ksp, self._b, self._x)
        if self._ksp.getConvergedReason() <= 0:
            return np.full(self._size, np.nan)
        return self._x.array_r.copy()

    def close(self) -> None:
        """Free matrix and factor."""
        for thing in (self._ksp, self._matrix, self._b, self._x):
            thing.destroy()
