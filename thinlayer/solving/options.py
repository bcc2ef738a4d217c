"""PETSc options: our defaults, which the user's options override, and errors for options that no solver reads."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc

from forms.base import InputError
from thinlayer.solving.petsc_missing import was_read

PREFIX = "thinlayer_"
# PETSc's error codes that a wrong value of an option can cause: not supported, wrong, out of range, wrong state, user's
# function missing, unknown type, no such factorisation
OPTION_ERRORS = (56, 62, 63, 73, 83, 86, 92)
OptionValue = str | int | float | bool | None
_PLACED: set[str] = set()  # names, without the prefix, of the options that `defaults` has put into PETSc's database


class OptionError(InputError):
    """A PETSc option that no solver reads."""


@contextmanager
def defaults(options: Mapping[str, OptionValue]) -> Iterator[None]:
    """Within a `with` block, PETSc's database has these options under our prefix, unless the user has set them."""
    database = PETSc.Options()
    theirs = database.getAll()  # hasName would mark the option as read
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


def value_of(name: str, given: Mapping[str, OptionValue]) -> str | None:
    """The user's value of an option, in PETSc's database or in a script; None: not set."""
    found = PETSc.Options().getAll().get(PREFIX + name, given.get(name))
    return None if found is None else str(found)


def given_elsewhere() -> str:
    """The options under our prefix in PETSc's database, written as on a command line."""
    found = sorted(PETSc.Options().getAll().items())
    return " ".join(f"-{name} {value}".rstrip() for name, value in found if name.startswith(PREFIX))


def unread() -> list[str]:
    """Names, without the prefix, of options under our prefix that are set and that no solver has read."""
    ours = [name for name in PETSc.Options().getAll() if name.startswith(PREFIX)]
    return [name.removeprefix(PREFIX) for name in ours if not was_read(name)]


def require_all_read(solver: str, ours: Collection[str]) -> None:
    """Raise OptionError if the last solve has not read all options that the user has set; ours may stay unread."""
    names = [name for name in unread() if name not in _PLACED.intersection(ours)]
    if names:
        listed = ", ".join(f"-{PREFIX}{name}" for name in names)
        raise OptionError(
            f"PETSc options not read by the {solver} solver: {listed}; a direct solver has no tolerances, "
            f"-{PREFIX}ksp_view and -{PREFIX}snes_view show what is at work"
        )


def require_known_values(error: PETSc.Error, ours: Collection[str]) -> None:
    """Raise OptionError if a wrong value of one of the user's options may have caused a PETSc error."""
    if error.ierr in OPTION_ERRORS:
        found = {k.removeprefix(PREFIX): v for k, v in PETSc.Options().getAll().items() if k.startswith(PREFIX)}
        theirs = [name for name in found if name not in _PLACED.intersection(ours)]
        given = ", ".join(f"-{PREFIX}{name} {found[name]}" for name in theirs)
        if theirs:
            raise OptionError(f"PETSc does not take the value of one of these options: {given}") from error
