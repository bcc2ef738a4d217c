"""A sparse symmetric matrix condensed to a few unknowns: MUMPS's Cholesky factor with Schur complement, through PETSc.

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
from petsc4py import PETSc

from forms.base import ThinlayerError
from thinlayer.solving.contact.gauss_seidel import pointers
from thinlayer.solving.petsc import PREFIX, OptionValue, defaults, keep_unknowns, schur_of
from thinlayer.system.compilation import own_library

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

Rows = tuple[npt.NDArray[Any], npt.NDArray[Any], Array]
SOURCE = Path(__file__).with_name("schur.c")
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
        raise FactorError(
            "the nonzero pattern of the stiffness matrix is not symmetric, or not made of blocks of nodes"
        )
    entries[rows[kept]] += springs  # the first entry of a row is its diagonal
    csr = rows.astype(PETSc.IntType, copy=False), columns.astype(PETSc.IntType, copy=False), entries
    out = PETSc.Mat().createAIJWithArrays((n * d, n * d), csr, comm=PETSc.COMM_SELF)
    for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
        out.setOption(option, True)
    return out
