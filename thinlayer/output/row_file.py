"""JSON file, next to a csv table, with the rows that a user's function returned, and a description of this function."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import Any

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
from thinlayer.system.folder import move_away, read_sealed, write_sealed
from thinlayer.system.table import Row

GENERATOR_TEXT = (
    "an iterator or generator of random numbers that goes on from row to row; make one in each run, from a number of the "
    "case, np.random.default_rng(int(case['seed']))"
)
FORMAT_VERSION = 1  # version of the file's format
RESUME_HINT = "give another name, remove it, or resume='anyway'"


class RowFile:
    """JSON file of the rows that a user's function returned, with a description of the function, for use on one rank.

    The description shows whether the rows of an earlier run are those of the same function. It covers the code of the
    function and the objects it refers to. Data that the function changes itself, such as a list of its results, are
    left out. If several rows took random numbers from the same generator or iterator, a later run cannot continue.

    Args:
        path: name of the JSON file.
        run: the function that returns a row.
        kind: what the table is called in messages, "sweep" or "ensemble".
    """

    def __init__(self, path: Path, run: Callable[..., object], kind: str) -> None:
        self.path, self._run, self._noun = path, run, kind
        self._content: dict[str, Any] = {"format": FORMAT_VERSION, "made from": describe(run)}
        self._content |= {"changing": [], "drawn": False, "rows": []}

    def read(self, resume: Resume) -> list[Row]:
        """Read the rows of an earlier run from the file; the file keeps them when `add` adds rows.

        Args:
            resume: "anyway": accept also rows of another function, and rows that took random numbers from one
                generator. True or False: such rows raise an error.

        Returns:
            The rows; [] if there is no file.

        Raises:
            InputError: the file is damaged; its rows are of another function, or took random numbers from one
                generator.
        """
        if self.path.exists():
            stored, name = read_sealed(self.path), str(self.path)
            changes = differences(stored["made from"], self._content["made from"])
            new = [change for change in changes if _changed_path(*change) not in stored["changing"]]
            if stored["drawn"] and resume != "anyway":
                text = f"its rows were drawn from {GENERATOR_TEXT}; {RESUME_HINT}"
                raise InputError(f"{name!r} cannot be resumed: {text}")
            if new and resume != "anyway":
                text = f"{differences_text(new)}); {RESUME_HINT}"
                raise InputError(f"{name!r} is the table of another {self._noun} ({text}")
            self._content |= {key: stored[key] for key in ("changing", "drawn", "rows")}
        return [*self._content["rows"]]

    def add(self, row: Row, *, drawn: bool) -> None:
        """Append a row to the file, which is on the disk when this method returns.

        Args:
            row: the row.
            drawn: whether making it has advanced a generator of random numbers or an iterator.
        """
        changes = differences(self._content["made from"], describe(self._run))
        paths = [path for change in changes if (path := _changed_path(*change))]
        self._content["changing"] += [path for path in paths if path not in self._content["changing"]]
        self._content["drawn"] |= drawn
        self._content["rows"].append(row)
        write_sealed(self.path, self._content)


def require_csv(out: object, resume: object) -> None:
    """Raise InputError unless the arguments `out` and `resume` of a sweep or an ensemble are valid.

    `out` must be None or the name of a file, not of a folder. `resume` must be False, True or "anyway".
    """
    require_resume(resume)
    if out is not None and (not isinstance(out, (str, Path)) or Path(out).is_dir()):
        raise InputError(f"out is {out!r:.200}; give the name of a csv file, not of a folder, or None")


def move_or_check_files(table: Path, record: Path, resume: Resume) -> None:
    """Move the files of an earlier run to another folder, or check that this run can continue from them.

    Args:
        table: name of the csv file.
        record: name of the file, or folder of files, that has the table's rows and the description of their function.
        resume: False: table and record are moved to a new folder previous-1, previous-2, ... True or "anyway": they
            stay.

    Raises:
        InputError: the run is to continue from a table without a record.
    """
    if not resume:
        move_away(table.parent, [table.name, record.name])
    elif table.exists() and not record.exists():
        reason = f"{record.name}, which describes its origin, does not exist"
        raise InputError(f"{str(table)!r} cannot be resumed: {reason}; give another name, or remove the table")


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
