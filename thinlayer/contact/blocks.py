"""Matrices in blocks, which multiply faster, for the hierarchies of algebraic multigrid."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse
from petsc4py import PETSc


@contextmanager
def faster_products(*, serial: bool) -> Iterator[None]:
    """Galerkin products by way of A P, a fifth off the setup for more memory; PETSc reads no prefix there."""
    database, name = PETSc.Options(), "matptap_via"
    ours = serial and not database.hasName(name)
    if ours:
        database.setValue(name, "rap")
    try:
        yield
    finally:
        if ours:
            database.delValue(name)


def in_blocks(A: PETSc.Mat, d: int) -> PETSc.Mat:
    """A matrix in blocks of d x d, which multiplies twice as fast; PETSc's own conversion is slow."""
    indptr, indices, values = A.getValuesCSR()
    shape = (A.getLocalSize()[0], A.getSize()[1])
    blocks = scipy.sparse.csr_matrix((values, indices, indptr), shape=shape, copy=False).tobsr((d, d))
    del indptr, indices, values
    ints: Sequence[Any] = [a.astype(PETSc.IntType, copy=False) for a in (blocks.indptr, blocks.indices)]
    return PETSc.Mat().createBAIJ(A.getSizes(), d, csr=(*ints, blocks.data), comm=A.comm)


def multiply_in_blocks(cycle: PETSc.PC, fine: PETSc.Mat) -> None:
    """Give a hierarchy of GAMG its matrices in blocks, `fine` on the finest level."""
    library = ctypes.CDLL(PETSc.__file__)
    number = np.ctypeslib.as_ctypes_type(PETSc.IntType)
    library.PCMGSetResidual.argtypes = [ctypes.c_void_p, number, ctypes.c_void_p, ctypes.c_void_p]
    finest = cycle.getMGLevels() - 1
    for level in range(finest, 0, -1):
        smoother, P = cycle.getMGSmoother(level), cycle.getMGInterpolation(level)
        A = smoother.getOperators()[0]
        matrix = fine if level == finest else in_blocks(A, A.getBlockSize())
        smoother.setOperators(matrix, matrix)
        library.PCMGSetResidual(cycle.handle, level, None, matrix.handle)
        if level < finest:
            matrix.destroy()
        size = math.gcd(*P.getBlockSizes())
        if size > 1:
            blocks = in_blocks(P, size)
            cycle.setMGInterpolation(level, blocks)
            cycle.setMGRestriction(level, blocks)
            blocks.destroy()
    cycle.setReusePreconditioner(True)
    cycle.setOperators(fine, fine)  # lets go of the matrix it was built from
