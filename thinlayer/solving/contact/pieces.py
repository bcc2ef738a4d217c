"""A sparse symmetric stiffness condensed to a few unknowns, piece by piece: it stays sparse, and pieces may float."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.contact.schur import FactorError
from thinlayer.solving.linear_solvers import DIRECT
from thinlayer.solving.petsc import PREFIX, defaults

Indices = npt.NDArray[Any]
AT_ONCE = 64  # number of right-hand sides that are solved together


def in_petsc(A: scipy.sparse.csr_matrix) -> PETSc.Mat:
    """A copy of a matrix on this process."""
    csr = A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType), A.data
    return PETSc.Mat().createAIJ(A.shape, csr=csr, comm=PETSc.COMM_SELF)


class Condensation:
    """K_cc - K_ci K_ii^-1 K_ic for the kept unknowns c and the inner ones i; the others are held.

    The inner unknowns alone are factorised, with all kept ones at rest: this is regular for a piece that only its contact
    holds. A column of every piece is found with one right-hand side, as pieces do not see each other.

    PETSc options of the factor are read under our prefix followed by "inner_".

    Args:
        K: stiffness on one process, symmetric.
        kept: (c,) the unknowns that stay.
        inner: (m,) the unknowns that are eliminated.

    Attributes:
        stiffness: (c, c) condensed stiffness.
        solves: number of right-hand sides that it took.

    Raises:
        FactorError: the stiffness of the inner unknowns is not positive definite.
    """

    def __init__(self, K: scipy.sparse.csr_matrix, kept: Indices, inner: Indices) -> None:
        self._kept, self._inner = kept, inner
        self._coupling = K[inner][:, kept]
        self._factorise(K[inner][:, inner])
        piece = connected_components(K, directed=False)[1][kept]
        order = np.argsort(piece, kind="stable")
        starts = np.searchsorted(piece[order], piece[order])
        column = np.empty(len(kept), np.int64)
        column[order] = np.arange(len(kept)) - starts  # number of an unknown in its piece
        self.solves = int(column.max(initial=-1)) + 1
        of_piece = np.full((int(piece.max(initial=-1)) + 1, self.solves), -1)
        of_piece[piece, column] = np.arange(len(kept))
        gathered = scipy.sparse.csr_matrix(
            (np.ones(len(kept)), (np.arange(len(kept)), column)), shape=(len(kept), self.solves)
        )
        right = (self._coupling @ gathered).toarray()
        less = self._coupling.T @ self._solve(right)
        row, at = np.nonzero(of_piece[piece] >= 0)
        full = scipy.sparse.csr_matrix((less[row, at], (row, of_piece[piece][row, at])), shape=(len(kept),) * 2)
        stiffness = K[kept][:, kept] - full
        self.stiffness = ((stiffness + stiffness.T) / 2).tocsr()

    def _factorise(self, A: scipy.sparse.csr_matrix) -> None:
        A.sort_indices()
        self._matrix = in_petsc(A)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            self._matrix.setOption(option, True)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setOptionsPrefix(PREFIX + "inner_")
        self._pc.setOperators(self._matrix)
        with defaults({f"inner_{name}": value for name, value in DIRECT.items() if not name.startswith("ksp_")}):
            self._pc.setType("cholesky")
            self._pc.setFromOptions()
            self._pc.setUp()
        if self._pc.getFailedReason():
            self.close()
            raise FactorError("the stiffness of the bodies inside is not positive definite")

    def _solve(self, b: Array) -> Array:
        """K_ii^-1 b for (m, k) right-hand sides."""
        out = np.zeros(b.shape)
        factor = self._pc.getFactorMatrix()
        for first in range(0, b.shape[1] if len(b) else 0, AT_ONCE):
            some = slice(first, first + AT_ONCE)
            given = np.asfortranarray(b[:, some])
            found = np.zeros_like(given, order="F")
            B, X = (PETSc.Mat().createDense(given.shape, array=a, comm=PETSc.COMM_SELF) for a in (given, found))
            factor.matSolve(B, X)
            out[:, some] = X.getDenseArray()
            B.destroy()
            X.destroy()
        return out

    def condense(self, b: Array) -> Array:
        """Forces (c,) on the kept unknowns, for forces b on all."""
        return np.asarray(b[self._kept] - self._coupling.T @ self._solve(b[self._inner, None])[:, 0])

    def expand(self, b: Array, kept: Array, out: Array) -> None:
        """Write kept (c,) and inner unknowns into `out`, under forces b on all unknowns."""
        out[self._kept] = kept
        out[self._inner] = self._solve((b[self._inner] - self._coupling @ kept)[:, None])[:, 0]

    def close(self) -> None:
        """Free the factor."""
        self._pc.destroy()
        self._matrix.destroy()
