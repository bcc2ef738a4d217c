"""The csv file of a table that grows row by row, and the file beside it that describes what its rows were made from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from thinlayer.errors import ModelError
from thinlayer.files.folder import moved_away
from thinlayer.files.table import Row, Table, hash_of, replaced
from thinlayer.identity import (
    CODE,
    FILE,
    MISSING,
    SAME,
    Resume,
    described,
    differences,
    in_words,
    random_states,
    require_resume,
)

GENERATOR = (
    "an iterator or generator of random numbers that goes on from row to row; make one in each run, from a number of the "
    "case, np.random.default_rng(int(case['seed']))"
)


class RowFile:
    """A csv file of rows that a user's function gives, and beside it what they were made from; on one rank.

    The description leaves out data that the function itself changes, such as a list of its results. Where rows are drawn
    from a generator of random numbers, or an iterator, that goes on from row to row, they cannot be resumed.

    Args:
        path: the csv file; the description is path.json.
        run: the function.
        kind: what the table is, for messages: "sweep", "ensemble".
        numbers: columns that hold a number in every row.
    """

    def __init__(self, path: Path, run: Callable[..., Any], kind: str, numbers: Sequence[str]) -> None:
        self.path, self.beside, self._run = path, path.with_name(f"{path.name}.json"), run
        self._kind, self._numbers = kind, numbers
        self._made_from = described(run)
        self._changing: set[tuple[str, ...]] = set()
        self._drawn = False  # whether rows have moved a generator of random numbers
        self.watch(run)

    def watch(self, run: Any) -> None:
        """Look at the generators of this function from now on, or of several."""
        self._watched, self._states = run, random_states(run, shared=True)

    def begin(self, resume: Resume) -> list[Row]:
        """The rows that are kept.

        Raises:
            ModelError: the file is to be resumed and has other rows than those of this function; with "anyway" it may.
        """
        if not self.path.exists():
            return []
        problem = self._problem(anyway=resume == "anyway")
        if problem and resume:
            raise ModelError(f"{problem}; give another name, remove it, or resume='anyway'")
        if problem:
            moved_away(self.path.parent, [self.path.name, self.beside.name])
        if not resume:
            return []
        rows = Table.load_here(self.path).rows
        if any(not isinstance(row.get(name), float) for row in rows for name in self._numbers):
            raise ModelError(
                f"{str(self.path)!r} is not the table of {_a(self._kind)}; give another name, or remove it"
            )
        return rows

    def _problem(self, *, anyway: bool) -> str | None:
        """Reason why the existing table does not belong to this function; None if it does."""
        name, beside = str(self.path), self.beside.name
        if not self.beside.exists():
            return (
                f"{name!r} is not the table of {_a(self._kind)}: there is no {beside} that tells what it is made from"
            )
        try:
            content = json.loads(self.beside.read_text(encoding="utf-8"))
            there, changing = content["made from"], {*map(tuple, content["changing"])}
            hashes, drawn = [*content["sha256"]], bool(content["drawn"])
        except (OSError, ValueError, LookupError, TypeError) as error:
            return f"{str(self.beside)!r} cannot be read ({error})"
        if hash_of(self.path) not in hashes:
            return f"{name!r} is not the table of {_a(self._kind)}: it has been changed since one wrote it"
        self._changing, self._drawn = changing, drawn and anyway
        if anyway:
            return None
        if drawn:
            return f"{name!r} cannot be resumed: its rows were drawn from {GENERATOR}"
        found = [one for one in differences(there, self._made_from) if _changed(*one) not in changing]
        return f"{name!r} is the table of another {self._kind} ({in_words(found)})" if found else None

    def write(self, table: Table) -> None:
        """Replace the table. The file beside it names the old and the new one, and is written first."""
        changed = (_changed(*one) for one in differences(self._made_from, described(self._run)))
        self._changing |= {path for path in changed if path}
        self._drawn |= random_states(self._watched, shared=True) != self._states
        hashes = [hash_of(self.path), hashlib.sha256(table.content()).hexdigest()]
        content = {
            "made from": self._made_from,
            "changing": sorted(self._changing),
            "sha256": hashes,
            "drawn": self._drawn,
        }
        with replaced(self.beside) as file:
            file.write(json.dumps(content, indent=1).encode() + b"\n")
        table.put(self.path)


def require_csv(out: Any, resume: Any) -> None:
    """Raise ModelError unless `out` may be the name of a csv file, or None, and `resume` a choice."""
    require_resume(resume)
    if not (out is None or isinstance(out, (str, Path))):
        raise ModelError(f"out is {out!r}; it must be the name of a csv file, or None")
    if out is not None and Path(out).is_dir():
        raise ModelError(f"out: {str(out)!r} is a folder; give the name of a csv file")


def _changed(path: tuple[str, ...], one: Any, _: Any) -> tuple[str, ...] | None:
    """Path of a changed value, with "*" for values that only one description has; None for code."""
    if {CODE, FILE, SAME} & {*path}:
        return None
    return (*path[:-1], "*") if one is MISSING else path


def _a(kind: str) -> str:
    """The noun with its article."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
