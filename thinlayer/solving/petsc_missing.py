"""PETSc functions that petsc4py lacks, called by name in the library to which petsc4py is linked.

- `schur_of` and `keep_unknowns`: MUMPS's Schur complement. Without it a bar with 256 squares would take 514 solves more.
- `was_read`: whether PETSc has read an option. Without it misspelt options would be ignored silently.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

POINTER = ctypes.c_void_p
ARGUMENTS = {  # name of a function -> types of its arguments; all functions return PETSc's error code
    "PetscOptionsUsed": (POINTER, ctypes.c_char_p, POINTER),
    "MatFactorSetSchurIS": (POINTER, POINTER),
    "MatFactorCreateSchurComplement": (POINTER, POINTER, POINTER),
    "MatCopy": (POINTER, POINTER, ctypes.c_int),
    "MatDestroy": (POINTER,),
}


@cache
def function(name: str) -> Any:
    """The function of this name, one of ARGUMENTS.

    Raises:
        ImportError: the library of this PETSc has no such function.
    """
    try:
        found = getattr(ctypes.CDLL(PETSc.__file__), name)
    except (OSError, AttributeError) as error:
        version = ".".join(map(str, PETSc.Sys.getVersion()))
        raise ImportError(
            f"PETSc {version}, which petsc4py loads from {PETSc.__file__}, does not export its function {name}, which "
            "petsc4py lacks; use a petsc4py that is linked to a shared library of PETSc 3.22 or newer"
        ) from error
    found.argtypes = ARGUMENTS[name]
    return found


def _call(name: str, *arguments: Any) -> None:
    if code := function(name)(*arguments):
        raise PETSc.Error(code)


def was_read(option: str) -> bool:
    """Whether PETSc has read an option of its database; the name includes the prefix."""
    used = ctypes.c_int(0)
    _call("PetscOptionsUsed", None, option.encode(), ctypes.byref(used))
    return bool(used.value)


def keep_unknowns(factor: PETSc.Mat, unknowns: npt.NDArray[Any]) -> None:
    """Tell a factor, before the factorisation, which unknowns (c,) to keep: it then computes their Schur complement."""
    places = PETSc.IS().createGeneral(unknowns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    _call("MatFactorSetSchurIS", factor.handle, places.handle)
    places.destroy()


def schur_of(factor: PETSc.Mat, c: int) -> npt.NDArray[np.float64]:
    """Copy (c, c) of the Schur complement of the c unknowns that a Cholesky factor keeps; its upper triangle is set."""
    out = np.empty((c, c))
    dense = PETSc.Mat().createDense((c, c), array=out.T, comm=PETSc.COMM_SELF)  # PETSc stores columns
    inside, status = POINTER(), ctypes.c_int()
    _call("MatFactorCreateSchurComplement", factor.handle, ctypes.byref(inside), ctypes.byref(status))
    _call("MatCopy", inside, dense.handle, 0)
    _call("MatDestroy", ctypes.byref(inside))
    dense.destroy()
    return out
