"""PETSc options: our defaults, the user's word over them, and an error for options nothing has read."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc

from forms.base import InputError
from thinlayer.solving.petsc_missing import was_read

PREFIX = "thinlayer_"
# PETSc's errors that values of options lead to: not supported, wrong, out of range, wrong state, user's function missing,
# unknown type, no such factorisation
OF_OPTIONS = (56, 62, 63, 73, 83, 86, 92)
OptionValue = str | int | float | bool | None
_PLACED: set[str] = set()  # names in PETSc's database, without the prefix, that are there by `defaults`


class OptionError(InputError):
    """A PETSc option that no solver reads."""


@contextmanager
def defaults(options: Mapping[str, OptionValue]) -> Iterator[None]:
    """Put options under our prefix into PETSc's database, where the user has not set them, for the time of a block."""
    database = PETSc.Options()
    theirs = database.getAll()  # hasName would count as reading
    ours = {PREFIX + name: value for name, value in options.items() if PREFIX + name not in theirs}
    for name, value in ours.items():
        database.setValue(name, value)
        _PLACED.add(name.removeprefix(PREFIX))
    try:
        yield
    finally:
        for name in ours:
            database.delValue(name)
            _PLACED.discard(name.removeprefix(PREFIX))


def is_set(name: str, given: Mapping[str, OptionValue]) -> bool:
    """Whether the user has set an option, in a script or in PETSc's database."""
    return name in given or PREFIX + name in PETSc.Options().getAll()


def given_elsewhere() -> str:
    """The options under our prefix that are in PETSc's database, as on a command line."""
    found = sorted(PETSc.Options().getAll().items())
    return " ".join(f"-{name} {value}".rstrip() for name, value in found if name.startswith(PREFIX))


def unread() -> list[str]:
    """Names under our prefix that are set and no solver has read, without the prefix."""
    ours = [name for name in PETSc.Options().getAll() if name.startswith(PREFIX)]
    return [name.removeprefix(PREFIX) for name in ours if not was_read(name)]


def require_all_read(solver: str, ours: Collection[str]) -> None:
    """Raise OptionError if the user has set options that the solver, just used, has not read; our own may stay unread."""
    names = [name for name in unread() if name not in _PLACED.intersection(ours)]
    if names:
        listed = ", ".join(f"-{PREFIX}{name}" for name in names)
        raise OptionError(
            f"PETSc options not read by the {solver} solver: {listed}; a direct solver has no tolerances, "
            f"-{PREFIX}ksp_view and -{PREFIX}snes_view show what is at work"
        )


def require_known_values(error: PETSc.Error, ours: Collection[str]) -> None:
    """Raise OptionError instead of a PETSc error that says that the value of an option is not known or out of range."""
    if error.ierr in OF_OPTIONS:
        found = {k.removeprefix(PREFIX): v for k, v in PETSc.Options().getAll().items() if k.startswith(PREFIX)}
        theirs = [name for name in found if name not in _PLACED.intersection(ours)]
        given = ", ".join(f"-{PREFIX}{name} {found[name]}" for name in theirs)
        if theirs:
            raise OptionError(f"a PETSc option has a value that PETSc does not take, among: {given}") from error
