"""File, next to a csv table, with the rows that a user's function returned, and a description of this function."""

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
    require_resume,
)
from thinlayer.system.folder import append_sealed, move_away, read_sealed_lines
from thinlayer.system.table import Row

GENERATOR_TEXT = (
    "an iterator or generator of random numbers that goes on from row to row; make one in each run, from a number of the "
    "case, np.random.default_rng(int(case['seed']))"
)
FORMAT_VERSION = 2  # version of the file's format: 2 since each row has a line


class RowFile:
    """File next to a csv table with the rows that a user's function returned, from which a later run goes on.

    Each line is JSON: a row, or the description of the function that made the rows after it. The description covers the
    code of the function and the objects it refers to. Data that the function changes itself, such as a list of its
    results, are left out. If several rows took random numbers from the same generator or iterator, a later run cannot
    continue. Several processes may add rows at the same time. The methods are called on one rank.

    Attributes:
        table: path of the csv table.
        path: path of the file of rows, the table's name + ".json".

    Args:
        table: path of the csv table.
        run: the function that returns a row.
        kind: what the table is called in messages, "sweep" or "ensemble".
    """

    def __init__(self, table: Path, run: Callable[..., object], kind: str) -> None:
        self.table, self.path = table, table.with_name(f"{table.name}.json")
        self._run, self._noun, self._origin = run, kind, describe(run)
        self._has_origin = False  # whether this object has written the description

    def resume(self, resume: Resume) -> list[Row]:
        """Return the rows of an earlier run, or move its files out of the way.

        Args:
            resume: False: table and rows are moved to a new folder previous-1, previous-2, ... True: the rows are
                returned. "anyway": so are rows of another function, and rows that took random numbers from one
                generator.

        Raises:
            InputError: there is a table without rows; the file of rows is damaged; its rows are of another function, or
                took random numbers from one generator.
        """
        if not resume:
            move_away(self.table.parent, [self.table.name, self.path.name])
        name, remedy = str(self.table), "give another name, remove it, or resume='anyway'"
        if self.table.exists() and not self.path.exists():
            reason = f"{self.path.name}, which describes its origin, does not exist"
            raise InputError(f"{name!r} cannot be resumed: {reason}; give another name, or remove the table")
        lines = read_sealed_lines(self.path)
        origins = [line["made from"] for line in lines if "made from" in line]
        if lines and not origins:
            raise InputError(f"{str(self.path)!r} cannot be read (it has no description); remove it to start anew")
        changing = [path for line in lines for path in line.get("changing", ())]
        changes = [change for origin in origins for change in differences(origin, self._origin)]
        new = [change for change in changes if _changed_path(*change) not in changing]
        if resume != "anyway" and any(line.get("drawn") for line in lines):
            raise InputError(f"{name!r} cannot be resumed: its rows were drawn from {GENERATOR_TEXT}; {remedy}")
        if resume != "anyway" and new:
            raise InputError(f"{name!r} is the table of another {self._noun} ({differences_text(new)}); {remedy}")
        return [line["row"] for line in lines if "row" in line]

    def rows(self) -> list[Row]:
        """Return the rows so far, of all processes."""
        return [line["row"] for line in read_sealed_lines(self.path) if "row" in line]

    def add(self, row: Row, *, drawn: bool) -> None:
        """Append a row to the file, which is on the disk when this method returns.

        Args:
            row: the row.
            drawn: whether making it has advanced a generator of random numbers or an iterator.
        """
        changes = differences(self._origin, describe(self._run))
        changing = [path for change in changes if (path := _changed_path(*change))]
        origin = [] if self._has_origin else [{"format": FORMAT_VERSION, "made from": self._origin}]
        append_sealed(self.path, *origin, {"row": row, "changing": changing, "drawn": drawn})
        self._has_origin = True


def require_csv(out: object, resume: object) -> None:
    """Raise InputError unless the arguments `out` and `resume` of a sweep or an ensemble are valid.

    `out` must be None or the name of a file, not of a folder. `resume` must be False, True or "anyway".
    """
    require_resume(resume)
    if out is not None and (not isinstance(out, (str, Path)) or Path(out).is_dir()):
        raise InputError(f"out is {out!r:.200}; give the name of a csv file, not of a folder, or None")


def checked_row(row: Mapping[str, object], row_name: str, reserved: Collection[str]) -> Row:
    """Return a row that a user has given, with entries that are floats, texts or None.

    Args:
        row: name of a column -> entry.
        row_name: what the row is called in messages.
        reserved: names of columns that the row must not have.

    Raises:
        InputError: the row has a column in `reserved`; an entry is neither a number nor a text nor None; a whole number
            is too large for a float to represent it exactly.
    """
    require(isinstance(row, Mapping), row_name, row, "it must be a mapping of names to numbers or texts")
    entries: Row = {}
    for name, value in row.items():
        if not isinstance(name, str) or name in reserved:
            raise InputError(f"{row_name} has {name!r}; names of columns are texts, other than {', '.join(reserved)}")
        if not (value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool))):
            raise InputError(f"{row_name}: {name} = {value!r} is neither a number nor a text")
        entry = entries[name] = value if value is None or isinstance(value, str) else float(value)
        if isinstance(value, Integral) and value != entry:
            raise InputError(f"{row_name}: {name} = {value!r}, of which a table keeps {entry:.17g}; take it below 2^53")
    return entries


def _changed_path(path: tuple[str, ...], former: object, _: object) -> list[str] | None:
    """Return where two descriptions of a function differ, as a path of keys; None if they differ in code, not in data.

    Args:
        path: keys that lead to the difference.
        former: value there in the earlier description; if it has none, the last key of the returned path is "*", as for
            any new entry.
        _: value in the present description, not used.
    """
    if {CODE_KEY, FILE_KEY, SAME_KEY} & {*path}:
        return None
    return [*path[:-1], "*"] if former is MISSING_VALUE else [*path]
