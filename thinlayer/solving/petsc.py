"""PETSc options, with errors for those that no solver reads; solves by PETSc; functions that petsc4py lacks.

Functions that petsc4py lacks are called in PETSc's C library, for example:

- `set_schur_unknowns` and `schur_complement`: Schur complements by MUMPS. Without them the condensation of a bar of 256
  square cells needs 514 more solves.
- `was_read`: whether PETSc has read an option. Without it misspelt options would be ignored silently.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cache

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array, InputError
from geometry.topology import Indices
from thinlayer.errors import SolveError

PREFIX = "thinlayer_"
# PETSc's error codes that a wrong value of an option can cause: not supported, wrong, out of range, wrong state, user's
# function missing, unknown type, no such factorisation
OPTION_ERROR_CODES = (56, 62, 63, 73, 83, 86, 92)
OptionValue = str | int | float | bool | None
Options = Mapping[str, OptionValue]  # names without the prefix -> values
OptionDict = dict[str, OptionValue]  # the same, as a dictionary
_DEFAULT_NAMES: set[str] = set()  # names, with their prefix, of the options that `set_defaults` has set
C_POINTER = ctypes.c_void_p
C_ARGUMENTS = {  # name of a function -> types of its arguments; all functions return PETSc's error code
    "PetscOptionsUsed": (C_POINTER, ctypes.c_char_p, C_POINTER),
    "MatFactorSetSchurIS": (C_POINTER, C_POINTER),
    "MatFactorCreateSchurComplement": (C_POINTER, C_POINTER, C_POINTER),
    "MatCopy": (C_POINTER, C_POINTER, ctypes.c_int),
    "MatDestroy": (C_POINTER,),
    "PCMGSetResidual": (C_POINTER, ctypes.c_int32, C_POINTER, C_POINTER),
}


@contextmanager
def set_defaults(options: Options, prefix: str = PREFIX) -> Iterator[None]:
    """Within a `with` block, set options in PETSc's database, except those that the user has set there.

    Args:
        options: {name without the prefix: value}.
        prefix: text that precedes all these names in the database.
    """
    database = PETSc.Options()
    user_settings = database.getAll()  # hasName would mark the option as read
    settings = {prefix + name: value for name, value in options.items() if prefix + name not in user_settings}
    for name, value in settings.items():
        database.setValue(name, value)
    _DEFAULT_NAMES.update(settings)
    try:
        yield
    finally:
        for name in settings:
            database.delValue(name)
        _DEFAULT_NAMES.difference_update(settings)


def db_options() -> dict[str, str]:
    """Return the options in PETSc's database with the prefix "thinlayer_", as {name without the prefix: value}."""
    options = PETSc.Options().getAll().items()
    return {name.removeprefix(PREFIX): value for name, value in options if name.startswith(PREFIX)}


def user_has_set(name: str, user_options: Options) -> bool:
    """Whether the user has set an option, in a script or in PETSc's database.

    Args:
        name: name of the option without the prefix "thinlayer_".
        user_options: options that a script has passed, {name without prefix: value}.
    """
    return name in user_options or name in db_options()


def user_value(name: str, user_options: Options) -> str | None:
    """Return the value that the user has given to an option; None: the user has not set it.

    A value in PETSc's database, as from a command line, overrides that of a script.

    Args:
        name: name of the option without the prefix "thinlayer_".
        user_options: options that a script has passed, {name without prefix: value}.
    """
    value = db_options().get(name, user_options.get(name))
    return None if value is None else str(value)


def command_line_text() -> str:
    """Return the options in PETSc's database with the prefix "thinlayer_", as text of a command line."""
    return " ".join(f"-{PREFIX}{name} {value}".rstrip() for name, value in sorted(db_options().items()))


def _user_option_names(defaults: Collection[str]) -> list[str]:
    """Return the names, without prefix, of the options in PETSc's database that the user has set.

    Args:
        defaults: names, without prefix, of this package's defaults. They count as the user's only if the user set them.
    """
    return sorted(name for name in db_options() if name not in defaults or PREFIX + name not in _DEFAULT_NAMES)


def require_options_read(solver: str, defaults: Collection[str]) -> None:
    """Raise InputError unless PETSc has read all options that the user has set.

    Args:
        solver: name of the solver, for the message.
        defaults: names, without prefix, of this package's defaults, which need not be read.
    """
    if unread := ", ".join(f"-{PREFIX}{name}" for name in _user_option_names(defaults) if not was_read(PREFIX + name)):
        remedy = f"a direct solver has no tolerances, -{PREFIX}ksp_view and -{PREFIX}snes_view show what is at work"
        raise InputError(f"PETSc options not read by the {solver} solver: {unread}; {remedy}")


@contextmanager
def set_options(defaults: Options, user_options: Options | None = None) -> Iterator[None]:
    """Within a `with` block, set options in PETSc's database, and translate PETSc's errors.

    If an option has several values, that in the database counts first, then that of a script, then the default.

    Args:
        defaults: defaults of this package, {name without prefix: value}.
        user_options: options that a script has passed, {name without prefix: value}; None: none.

    Raises:
        InputError: PETSc does not accept the value of one of the user's options.
        SolveError: PETSc, or a library that it calls, has failed. A march can then try a shorter step.
    """
    user_options = user_options or {}
    with set_defaults({**defaults, **user_options}):
        try:
            yield
        except PETSc.Error as error:
            options, user_names = db_options(), _user_option_names(defaults.keys() - user_options.keys())
            if error.ierr in OPTION_ERROR_CODES and user_names:
                options_text = ", ".join(f"-{PREFIX}{name} {options[name]}" for name in user_names)
                raise InputError(f"PETSc does not take the value of one of these options: {options_text}") from error
            message_lines = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines()]
            raise SolveError(f"PETSc: {message_lines[-1] if message_lines else ''} (error {error.ierr})") from error


@cache
def c_function(name: str) -> Callable[..., int]:
    """Return a function of PETSc's C library; its result is PETSc's error code.

    Args:
        name: name of the function, a key of `C_ARGUMENTS`.

    Raises:
        ImportError: the library of this PETSc has no such function.
    """
    try:
        function: ctypes._NamedFuncPointer = getattr(ctypes.CDLL(PETSc.__file__), name)
    except (OSError, AttributeError) as error:
        remedy = "use a petsc4py that is linked to a shared library of PETSc 3.22 or newer"
        raise ImportError(f"PETSc, from {PETSc.__file__}, does not export its function {name}; {remedy}") from error
    function.argtypes = C_ARGUMENTS[name]
    return function


def _checked_call(name: str, *arguments: object) -> None:
    if code := c_function(name)(*arguments):
        raise PETSc.Error(code)


def was_read(option: str) -> bool:
    """Whether PETSc has read an option of its database; the name `option` includes the prefix."""
    was_used = ctypes.c_int(0)
    _checked_call("PetscOptionsUsed", None, option.encode(), ctypes.byref(was_used))
    return bool(was_used.value)


def set_schur_unknowns(factor: PETSc.Mat, unknowns: Indices) -> None:
    """Set the unknowns for which a factorisation will compute the Schur complement.

    Args:
        factor: matrix of the factor, before the factorisation.
        unknowns: (c,) numbers of the unknowns.
    """
    index_set = PETSc.IS().createGeneral(unknowns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    _checked_call("MatFactorSetSchurIS", factor.handle, index_set.handle)


def schur_complement(factor: PETSc.Mat, c: int) -> Array:
    """Return a copy (c, c) of the Schur complement in a Cholesky factor; only its upper triangle is set.

    Args:
        factor: matrix of the factor, after the factorisation.
        c: number of the unknowns that `set_schur_unknowns` has set.
    """
    out = np.empty((c, c))
    dense = PETSc.Mat().createDense((c, c), array=out.T, comm=PETSc.COMM_SELF)  # PETSc stores columns
    mumps_matrix, status = C_POINTER(), ctypes.c_int()
    _checked_call("MatFactorCreateSchurComplement", factor.handle, ctypes.byref(mumps_matrix), ctypes.byref(status))
    _checked_call("MatCopy", mumps_matrix, dense.handle, 0)
    _checked_call("MatDestroy", ctypes.byref(mumps_matrix))
    return out


def faster_products(*, serial: bool) -> AbstractContextManager[None]:
    """Within a `with` block, let PETSc compute triple products P^T A P faster, but with more memory.

    Args:
        serial: whether there is one rank. Otherwise nothing changes.
    """
    return set_defaults({"matptap_via": "rap"} if serial else {}, prefix="")


def lean_products() -> AbstractContextManager[None]:
    """Within a `with` block, let PETSc save memory in products of matrices.

    It frees the data with which it could compute the same product again for other values.
    """
    return set_defaults({"mat_product_clear": True}, prefix="")


def convert_to_baij(A: PETSc.Mat, into: PETSc.Mat | None = None) -> PETSc.Mat:
    """Convert a matrix to PETSc's block format BAIJ, which multiplies faster, and return the result.

    This is faster than PETSc's own conversion.

    Args:
        A: the matrix, with its block size set.
        into: matrix that becomes the result; None: `A` itself is converted.
    """
    indptr, indices, values = A.getValuesCSR()
    d, shape = A.getBlockSize(), (A.getLocalSize()[0], A.getSize()[1])
    blocks = scipy.sparse.csr_matrix((values, indices, indptr), shape=shape, copy=False).tobsr((d, d))
    del indptr, indices, values  # they are copies, and take memory
    index_arrays = (a.astype(PETSc.IntType, copy=False) for a in (blocks.indptr, blocks.indices))
    target = into or A
    target.setSizes(A.getSizes(), d)
    target.setType("baij")
    target.setPreallocationCSR((*index_arrays, blocks.data))
    return target


def set_residual_matrix(pc: PETSc.PC, level: int, A: PETSc.Mat) -> None:
    """Set the matrix `A` with which level number `level` of a multigrid preconditioner (PCMG) computes residuals."""
    _checked_call("PCMGSetResidual", pc.handle, level, None, A.handle)


def solve_linear(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
    """Solve A x = b by the linear solver `ksp`, with its matrix A. Collective.

    Args:
        ksp: the linear solver.
        b: right-hand side, which never changes.
        x: the solution; overwritten.

    Raises:
        PETSc.Error: PETSc, or a library that it calls, has failed. Do not use `ksp` again, as its vectors stay locked.
    """
    ksp.solve(b.copy(), x)  # PETSc leaves the right-hand side locked after an error


def solve_nonlinear(snes: PETSc.SNES, x: PETSc.Vec) -> None:
    """Solve a nonlinear system by an SNES, from `x`, which becomes the solution. Collective.

    After an error PETSc leaves the solution or the residual locked for ever. Therefore the SNES works on a copy of `x`,
    and is destroyed after an error.

    Args:
        snes: the solver.
        x: initial unknowns, then the solution; unchanged after an error.

    Raises:
        Exception: the error of a function that PETSc has called.
        PETSc.Error: PETSc itself has failed.
    """
    iterate = x.copy()
    try:
        snes.solve(None, iterate)
    except PETSc.Error as error:
        snes.destroy()
        if error.__cause__ is not None:
            raise error.__cause__ from None
        raise
    iterate.copy(x)


def reason_name(reasons: type, value: int) -> str:
    """Return PETSc's name of the reason why a solver stopped.

    Args:
        reasons: the class `ConvergedReason` of the solver's type.
        value: number of the reason.
    """
    name_of = {v: name for name, v in vars(reasons).items() if isinstance(v, int) and not name.startswith("_")}
    return name_of.get(value, str(value))
