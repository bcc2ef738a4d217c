"""A sparse symmetric matrix condensed to a few unknowns: MUMPS's Cholesky factor with Schur complement, through PETSc."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.compiling.compiled import library
from thinlayer.solving.options import PREFIX, OptionValue, defaults
from thinlayer_base import ThinlayerError

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int32]

SOURCE = Path(__file__).with_name("schur.c")
SPARSE = 0.05  # share of non-zeros up to which a right-hand side is sparse
INVERTED = 2  # MAT_FACTOR_SCHUR_INVERTED
OPTIONS: dict[str, OptionValue] = {
    "mat_mumps_icntl_7": 0,  # minimum degree: beside a Schur complement MUMPS has no other ordering but METIS's
    "mat_mumps_icntl_8": 0,  # no scaling: that takes time and changes nothing here
}


class FactorError(ThinlayerError, RuntimeError):
    """A matrix that is not positive definite, or that MUMPS could not factorise for another reason."""


class SchurFactor:
    """Factor of a symmetric positive definite matrix A + diag(springs) on one process; the springs act on c unknowns.

    PETSc options mat_mumps_NAME are read under our prefix.

    Args:
        A: sparse matrix (AIJ) of n nodes with d rows each, in d x d blocks; only read.
        d: rows of a node.
        kept: (c,) the unknowns to condense to.
        springs: (c,) what makes A definite there, > 0.
        order: (n,) nodes in the order that MUMPS sees them in.

    Raises:
        FactorError: MUMPS failed.
    """

    def __init__(self, A: PETSc.Mat, d: int, kept: npt.NDArray[Any], springs: Array, order: npt.NDArray[Any]) -> None:
        self._order = (order[:, None] * np.int32(d) + np.arange(d, dtype=np.int32)).ravel()
        self._place = np.empty_like(self._order)
        self._place[self._order] = np.arange(len(self._order), dtype=np.int32)
        self._kept, self._springs = self._place[kept], springs
        upper = _upper_triangle(A, d, order, self._kept, springs)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._factorise(upper)
        upper.destroy()

    def _factorise(self, upper: PETSc.Mat) -> None:
        pc = self._pc
        pc.setOptionsPrefix(PREFIX)
        pc.setOperators(upper)
        pc.setType("cholesky")
        pc.setFactorSolverType("mumps")
        with defaults(OPTIONS):
            pc.setFactorSetUpSolverType()
            self._factor = pc.getFactorMatrix()
            self._factor.setOptionsPrefix(PREFIX)
            places = PETSc.IS().createGeneral(self._kept.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
            _call("MatFactorSetSchurIS", self._factor.handle, places.handle)
            pc.setUp()
        places.destroy()
        if self._factor.getMumpsInfog(1) < 0 or pc.getFailedReason():
            code = self._factor.getMumpsInfog(1)
            self.close()
            raise FactorError(f"MUMPS could not factorise the stiffness matrix: INFOG(1) = {code}")

    def take_complement(self) -> Array:
        """Schur complement of A without the springs, (c, c), C-contiguous; once, and before the other methods."""
        c = len(self._kept)
        S, status, data = ctypes.c_void_p(), ctypes.c_int(), ctypes.POINTER(ctypes.c_double)()
        _call("MatFactorGetSchurComplement", self._factor.handle, ctypes.byref(S), ctypes.byref(status))
        _call("MatDenseGetArray", S, ctypes.byref(data))
        inside = np.ctypeslib.as_array(data, (c, c))  # columns in rows: the upper triangle is there
        out = np.triu(inside)
        out += np.triu(inside, 1).T
        out[np.diag_indices(c)] -= self._springs
        # An inverse so simple that what PETSc then does to the condensed forces can be undone; about as large as the true
        # one, for the sake of rounding, and a power of two.
        self._inverse = 2.0 ** -np.round(np.log2(out.diagonal().mean()))
        inside[:] = 0.0
        inside[np.diag_indices(c)] = self._inverse
        _call("MatDenseRestoreArray", S, ctypes.byref(data))
        _call("MatFactorRestoreSchurComplement", self._factor.handle, ctypes.byref(S), INVERTED)
        return out

    def condense(self, b: Array) -> Array:
        """Right-hand side (c,) of the condensed system for a right-hand side of A."""
        self._factor.setMumpsIcntl(26, 1)  # forward elimination alone
        try:
            return self._solve(b[self._order])[self._kept] / self._inverse
        finally:
            self._factor.setMumpsIcntl(26, -1)

    def expand(self, b: Array, condensed: Array, kept: Array) -> Array:
        """All unknowns, from the right-hand side, what `condense` made of it, and the kept unknowns (c,)."""
        moved = b[self._order]
        moved[self._kept] += kept / self._inverse - condensed
        out = self._solve(moved)
        out[self._kept] = kept  # without the rounding, which a stiff layer makes much of
        return out[self._place]

    def _solve(self, b: Array) -> Array:
        """MUMPS's solution in its order, which is faster for a right-hand side declared to be sparse."""
        places = np.flatnonzero(b)
        if not len(places):  # which MUMPS takes for an error
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


def _upper_triangle(A: PETSc.Mat, d: int, order: npt.NDArray[Any], kept: Indices, springs: Array) -> PETSc.Mat:
    """Matrix with the upper triangle of A + springs, nodes renumbered; all that MUMPS reads of a symmetric one.

    `kept` has the new numbers of the springs' unknowns.
    """
    n = len(order)
    order = np.ascontiguousarray(order, np.int32)
    place = np.empty(n, np.int32)
    place[order] = np.arange(n, dtype=np.int32)
    with _read(A) as (begins, indices, data):
        size = (len(indices) + n * d) // 2
        rows, columns, entries = np.empty(n * d + 1, np.int32), np.empty(size, np.int32), np.empty(size)
        c = library(SOURCE)
        kinds = {"int32": "int32_t[]", "float64": "double[]"}
        arrays = (begins, indices, data, place, order, rows, columns, entries)
        filled = c.lib.upper_triangle(n, d, size, *(c.ffi.from_buffer(kinds[a.dtype.name], a) for a in arrays))
    if filled != size:
        raise FactorError("the pattern of the stiffness matrix is not symmetric, or not one of nodes")
    entries[rows[kept]] += springs  # the first entry of a row is its diagonal
    csr = rows.astype(PETSc.IntType, copy=False), columns.astype(PETSc.IntType, copy=False), entries
    out = PETSc.Mat().createAIJWithArrays((n * d, n * d), csr, comm=PETSc.COMM_SELF)
    for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
        out.setOption(option, True)
    return out


@contextmanager
def _read(A: PETSc.Mat) -> Iterator[tuple[Indices, Indices, Array]]:
    """Beginnings of rows, columns and entries of a matrix; where integers are short, the matrix's own arrays."""
    integer = np.ctypeslib.as_ctypes_type(PETSc.IntType)
    rows, done = integer(), ctypes.c_int()
    begins, columns, data = ctypes.POINTER(integer)(), ctypes.POINTER(integer)(), ctypes.POINTER(ctypes.c_double)()
    layout = 0, 0, 0, ctypes.byref(rows), ctypes.byref(begins), ctypes.byref(columns), ctypes.byref(done)
    _call("MatGetRowIJ", A.handle, *layout)
    _call("MatSeqAIJGetArrayRead", A.handle, ctypes.byref(data))
    try:
        places = np.ctypeslib.as_array(begins, (rows.value + 1,))
        length = int(places[-1])
        indices = np.ctypeslib.as_array(columns, (length,))
        entries = np.ctypeslib.as_array(data, (length,))
        yield np.ascontiguousarray(places, np.int32), np.ascontiguousarray(indices, np.int32), entries
    finally:
        _call("MatSeqAIJRestoreArrayRead", A.handle, ctypes.byref(data))
        _call("MatRestoreRowIJ", A.handle, *layout)


# Arguments of functions of PETSc's that petsc4py lacks: pointers, and integers of PETSc's or of C.
_POINTER, _INTEGER = ctypes.c_void_p, np.ctypeslib.as_ctypes_type(PETSc.IntType)
_ROWS = (_POINTER, _INTEGER, ctypes.c_int, ctypes.c_int, *[_POINTER] * 4)
_ARGUMENTS = {
    "MatFactorSetSchurIS": (_POINTER, _POINTER),
    "MatFactorGetSchurComplement": (_POINTER, _POINTER, _POINTER),
    "MatFactorRestoreSchurComplement": (_POINTER, _POINTER, ctypes.c_int),
    "MatDenseGetArray": (_POINTER, _POINTER),
    "MatDenseRestoreArray": (_POINTER, _POINTER),
    "MatSeqAIJGetArrayRead": (_POINTER, _POINTER),
    "MatSeqAIJRestoreArrayRead": (_POINTER, _POINTER),
    "MatGetRowIJ": _ROWS,
    "MatRestoreRowIJ": _ROWS,
}


@cache
def _function(name: str) -> Any:
    function = getattr(ctypes.CDLL(PETSc.__file__), name)
    function.argtypes = _ARGUMENTS[name]
    return function


def _call(name: str, *arguments: Any) -> None:
    if code := _function(name)(*arguments):
        raise PETSc.Error(code)
