"""Rows returned by a user's function, stored in a file with a description of their origin, next to their csv file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from numbers import Integral, Real
from pathlib import Path

from forms.base import InputError, require
from thinlayer.system.fingerprint import (
    CODE_KEY,
    FILE_KEY,
    MISSING_VALUE,
    SAME_KEY,
    Resume,
    describe,
    differences,
    differences_text,
    random_states,
    require_resume,
)
from thinlayer.system.folder import move_away, read_sealed, write_sealed
from thinlayer.system.table import Row

GENERATOR_MESSAGE = (
    "an iterator or generator of random numbers that goes on from row to row; make one in each run, from a number of the "
    "case, np.random.default_rng(int(case['seed']))"
)
FILE_FORMAT = 1  # version of the file's format
RESUME_HINT = "give another name, remove it, or resume='anyway'"


class RowFile:
    """A file of rows returned by a user's function, and of a description of this function; on one rank.

    The description includes the objects that the function refers to, except data that it changes itself, such as a list
    of its results. Rows cannot be resumed if they are drawn from a random generator, or an iterator, that several rows
    share.

    Args:
        path: the file, JSON.
        run: the function.
        kind: kind of the table, for messages: "sweep", "ensemble".
    """

    def __init__(self, path: Path, run: Callable[..., object], kind: str) -> None:
        self.path, self._run, self._kind = path, run, kind
        self._made_from, self._rows = describe(run), list[Row]()
        self._changing: set[tuple[str, ...]] = set()
        self._drawn = False  # whether making rows has advanced a random generator
        self.watch(run)

    def watch(self, run: object) -> None:
        """Watch the random generators and iterators of a function, or of several functions, from now on."""
        self._watched, self._states = run, random_states(run, shared=True)

    def read(self, resume: Resume) -> list[Row]:
        """The rows in the file, to which `add` appends rows; with "anyway" also rows of another function.

        Raises:
            InputError: the file is damaged; its rows are of another function, or cannot be resumed.
        """
        if not self.path.exists():
            return []
        content, name = read_sealed(self.path), str(self.path)
        self._changing, self._drawn = {*map(tuple, content["changing"])}, content["drawn"]
        changes = differences(content["made from"], self._made_from)
        new = [change for change in changes if _changed_path(*change) not in self._changing]
        if self._drawn and resume != "anyway":
            raise InputError(f"{name!r} cannot be resumed: its rows were drawn from {GENERATOR_MESSAGE}; {RESUME_HINT}")
        if new and resume != "anyway":
            raise InputError(f"{name!r} is the table of another {self._kind} ({differences_text(new)}); {RESUME_HINT}")
        self._rows = content["rows"]
        return [*self._rows]

    def add(self, row: Row) -> None:
        """Append a row; it is on the disk when this method returns."""
        self._rows.append(row)
        changed = (_changed_path(*change) for change in differences(self._made_from, describe(self._run)))
        self._changing |= {path for path in changed if path}
        self._drawn |= random_states(self._watched, shared=True) != self._states
        about = {"made from": self._made_from, "changing": sorted(self._changing), "drawn": self._drawn}
        write_sealed(self.path, {"format": FILE_FORMAT, **about, "rows": self._rows})


def require_csv(out: object, resume: object) -> None:
    """Raise InputError unless `out` is None or may be the name of a csv file, and `resume` is a valid choice."""
    require_resume(resume)
    if out is not None and (not isinstance(out, (str, Path)) or Path(out).is_dir()):
        raise InputError(f"out is {out!r:.200}; give the name of a csv file, not of a folder, or None")


def make_room(table: Path, record: Path, resume: Resume) -> None:
    """Move a table that is not resumed away, with its record; raise InputError if it cannot be resumed."""
    if not resume:
        move_away(table.parent, [table.name, record.name])
    elif table.exists() and not record.exists():
        lacking = f"{record.name}, which describes its origin, does not exist"
        raise InputError(f"{str(table)!r} cannot be resumed: {lacking}; give another name, or remove the table")


def checked_row(row: Mapping[str, object], what: str, taken: Collection[str]) -> Row:
    """Return a user's row with its entries as floats, texts or None.

    Raises:
        InputError: the row has a column in `taken`, or entries that are neither numbers nor texts; `what` names the
            row.
    """
    require(isinstance(row, Mapping), what, row, "it must be a mapping of names to numbers or texts")
    entries: Row = {}
    for name, value in row.items():
        if not isinstance(name, str) or name in taken:
            raise InputError(f"{what} has {name!r}; names of columns are texts, other than {', '.join(taken)}")
        if not (value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool))):
            raise InputError(f"{what}: {name} = {value!r} is neither a number nor a text")
        kept = entries[name] = value if value is None or isinstance(value, str) else float(value)
        if isinstance(value, Integral) and value != kept:
            raise InputError(f"{what}: {name} = {value!r}, of which a table keeps {kept:.17g}; take it below 2^53")
    return entries


def _changed_path(path: tuple[str, ...], value: object, _: object) -> tuple[str, ...] | None:
    """Path of a changed value, ending in "*" if only one description has the value; None for code."""
    if {CODE_KEY, FILE_KEY, SAME_KEY} & {*path}:
        return None
    return (*path[:-1], "*") if value is MISSING_VALUE else path
