"""A sparse symmetric matrix condensed to a few unknowns: by a Schur complement of MUMPS's, or piece by piece, sparse.

Savings of time of a contact solve, measured on the bar of `performance`: copying the triangle in C saves 13 % against
scipy.sparse and 10 % against PETSc's own permutation, 3 % of them by reading ahead; sparse right-hand sides save 6 %, the
order of nodes 5 % with 128 squares and 25 to 30 % with 256.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from forms.base import Array, ThinlayerError
from geometry.topology import Indices
from thinlayer.solving.contact.gauss_seidel import pointers
from thinlayer.solving.linear_solvers import DIRECT
from thinlayer.solving.petsc import PREFIX, OptionValue, defaults, keep_unknowns, schur_of
from thinlayer.system.compilation import own_library

Rows = tuple[npt.NDArray[Any], npt.NDArray[Any], Array]
SOURCE = Path(__file__).with_name("schur.c")
AT_ONCE = 64  # number of right-hand sides that are solved together, piece by piece
SPARSE = 0.05  # largest share of non-zeros of a right-hand side that is treated as sparse
OPTIONS: dict[str, OptionValue] = {
    "mat_mumps_icntl_7": 0,  # minimum degree: with a Schur complement MUMPS offers only this and METIS
    "mat_mumps_icntl_8": 0,  # no scaling: it takes time and changes nothing here
}


class FactorError(ThinlayerError, RuntimeError):
    """MUMPS could not factorise a matrix, for instance because it is not positive definite."""


class SchurFactor:
    """Factor of a symmetric positive definite matrix A + diag(springs) on one process; the springs act on c unknowns.

    PETSc options mat_mumps_NAME are read under our prefix.

    Args:
        A: row starts, columns and entries of a sparse matrix of n nodes with d rows each, in d x d blocks; only read.
        d: number of rows of a node.
        kept: (c,) the unknowns that stay after condensation.
        springs: (c,) stiffness added to these unknowns, > 0, so that the factorised matrix is definite.
        order: (n,) nodes in the order in which MUMPS gets them.

    Raises:
        FactorError: MUMPS failed.
    """

    def __init__(self, A: Rows, d: int, kept: npt.NDArray[Any], springs: Array, order: npt.NDArray[Any]) -> None:
        self._order = (order[:, None] * np.int32(d) + np.arange(d, dtype=np.int32)).ravel()
        self._place = np.empty_like(self._order)
        self._place[self._order] = np.arange(len(self._order), dtype=np.int32)
        self._kept, self._springs = self._place[kept], springs
        upper = _upper_triangle(A, d, order, self._kept, springs)
        self._pc = pc = PETSc.PC().create(PETSc.COMM_SELF)
        pc.setOptionsPrefix(PREFIX)
        pc.setOperators(upper)
        pc.setType("cholesky")
        pc.setFactorSolverType("mumps")
        with defaults(OPTIONS):
            pc.setFactorSetUpSolverType()
            self._factor = pc.getFactorMatrix()
            self._factor.setOptionsPrefix(PREFIX)
            keep_unknowns(self._factor, self._kept)
            pc.setUp()
        upper.destroy()
        code = self._factor.getMumpsInfog(1)
        if code < 0 or pc.getFailedReason():
            self.close()
            raise FactorError(f"MUMPS could not factorise the stiffness matrix: INFOG(1) = {code}")

    @cached_property
    def complement(self) -> Array:
        """Schur complement of A without the springs, (c, c), C-contiguous."""
        found = schur_of(self._factor, len(self._kept))
        out = np.triu(found)
        out += np.triu(found, 1).T
        out[np.diag_indices(len(out))] -= self._springs
        return out

    def _forces(self, kept: Array) -> Array:
        """Forces (c,) of the complement, springs included, for values of the kept unknowns."""
        return np.asarray(self.complement @ kept + self._springs * kept)

    def condense(self, b: Array) -> Array:
        """Right-hand side (c,) of the condensed system for a right-hand side of A."""
        self._factor.setMumpsIcntl(26, 1)  # solve for the kept unknowns only
        found = self._forces(self._solve(b[self._order])[self._kept])
        self._factor.setMumpsIcntl(26, -1)
        return found

    def expand(self, b: Array, condensed: Array, kept: Array) -> Array:
        """All unknowns, from the right-hand side b, the result of `condense` for b, and the kept unknowns (c,)."""
        moved = b[self._order]
        moved[self._kept] += self._forces(kept) - condensed
        out = self._solve(moved)
        out[self._kept] = kept  # a stiff layer would magnify their rounding
        return out[self._place]

    def _solve(self, b: Array) -> Array:
        """MUMPS's solution in its order; a sparse right-hand side is declared as such, which is faster."""
        places = np.flatnonzero(b)
        if not len(places):  # MUMPS fails for an empty sparse right-hand side
            return np.zeros_like(b)
        if len(places) > SPARSE * len(b):
            given, found = PETSc.Vec().createWithArray(b, comm=PETSc.COMM_SELF), np.empty_like(b)
            out = PETSc.Vec().createWithArray(found, comm=PETSc.COMM_SELF)
            self._factor.solve(given, out)
            given.destroy()
            out.destroy()
            return found
        rows = np.array([0, len(places)], PETSc.IntType)
        csr = rows, places.astype(PETSc.IntType), b[places]
        row = PETSc.Mat().createAIJ((1, len(b)), csr=csr, comm=PETSc.COMM_SELF)
        column = PETSc.Mat().createTranspose(row)
        found = np.empty((len(b), 1))
        X = PETSc.Mat().createDense((len(b), 1), array=found, comm=PETSc.COMM_SELF)
        self._factor.matSolve(column, X)
        for matrix in (row, column, X):
            matrix.destroy()
        return found[:, 0]

    def close(self) -> None:
        """Free the factor."""
        self._pc.destroy()


def _upper_triangle(A: Rows, d: int, order: npt.NDArray[Any], kept: Indices, springs: Array) -> PETSc.Mat:
    """The upper triangle of A + springs with renumbered nodes; MUMPS does not read the rest of a symmetric matrix.

    `kept` has the new numbers of the springs' unknowns.
    """
    n = len(order)
    order = np.ascontiguousarray(order, np.int32)
    place = np.empty(n, np.int32)
    place[order] = np.arange(n, dtype=np.int32)
    begins, indices, data = A
    size = (len(indices) + n * d) // 2
    rows, columns, entries = np.empty(n * d + 1, np.int32), np.empty(size, np.int32), np.empty(size)
    c = own_library(SOURCE)
    given = (begins.astype(np.int32, copy=False), indices.astype(np.int32, copy=False), data, place, order)
    filled = c.lib.upper_triangle(n, d, size, *pointers(c, *given, rows, columns, entries))
    if filled != size:
        raise FactorError("the nonzero pattern of the stiffness is not symmetric, or not made of blocks of nodes")
    entries[rows[kept]] += springs  # the first entry of a row is its diagonal
    csr = rows.astype(PETSc.IntType, copy=False), columns.astype(PETSc.IntType, copy=False), entries
    out = PETSc.Mat().createAIJWithArrays((n * d, n * d), csr, comm=PETSc.COMM_SELF)
    for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
        out.setOption(option, True)
    return out


# ---------------------------------------------------------------- piece by piece
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

    def __init__(self, K: scipy.sparse.csr_matrix, kept: npt.NDArray[Any], inner: npt.NDArray[Any]) -> None:
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
        of_piece[piece, column] = rows = np.arange(len(kept))
        gathered = scipy.sparse.csr_matrix((np.ones(len(kept)), (rows, column)), shape=(len(kept), self.solves))
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
