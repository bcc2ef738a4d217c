"""Table: rows of numbers with names, committed to a csv file one by one; files that are replaced as a whole."""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from forms.base import InputError
from geometry.parallel import on_root
from thinlayer.errors import ModelError

Row = dict[str, float | str | None]


@contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """A file that replaces another one once it is complete on the disk; after an error nothing of it is left."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.part")
    try:
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def hash_of(path: Path) -> str | None:
    """Hash of the content of a file; None if there is no file."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


class ColumnError(InputError, KeyError):
    """A column that a table does not have."""


class Table:
    """Rows with the same columns. On several ranks all have the same table, and rank 0 alone touches files.

    A csv file has no types: entries that `float` accepts are read back as numbers ("007" is 7), and "" as None.

    Attributes:
        rows: the rows so far; None stands for an empty entry.
        path: csv file to which each row is written at once, or None.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]] = (), path: str | Path | None = None) -> None:
        self.rows: list[Row] = []
        self.path = Path(path) if path else None
        for row in rows:
            self.append(row)

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row, and commit it to the file: flushed to the disk before this returns. Collective, if there is a file.

        Raises:
            ModelError: other columns than the first row's, or a name of a column that is no text.
            OSError: the file could not be written; on all ranks.
        """
        if self.rows and list(row) != self.columns:
            raise ModelError(f"a row with columns {list(row)} does not fit a table with columns {self.columns}")
        if wrong := [name for name in row if not isinstance(name, str)]:
            raise ModelError(f"a table's columns have texts for names, not {', '.join(map(repr, wrong))}")
        self.rows.append(dict(row))
        if self.path is not None:
            on_root(None, self._append_last)

    def _append_last(self) -> None:
        assert self.path is not None
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w" if len(self.rows) == 1 else "a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if len(self.rows) == 1:
                writer.writerow(self.columns)
            writer.writerow([_text(value) for value in self.rows[-1].values()])
            file.flush()
            os.fsync(file.fileno())

    def write(self, path: str | Path, comm: MPI.Intracomm | None = None) -> None:
        """Write all rows to a csv file, which is replaced as a whole. Collective.

        Args:
            path: the file.
            comm: communicator whose rank 0 writes (default: the world).

        Raises:
            OSError: the file could not be written; on all ranks.
        """
        on_root(comm, lambda: self.put(Path(path)))

    def put(self, path: Path) -> None:
        """Write all rows, on this rank."""
        with replaced(path) as file:
            file.write(self.content())

    def to_pandas(self) -> Any:
        """The rows as a pandas.DataFrame.

        Raises:
            ModelError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise ModelError(
                "pandas is not installed: `./fenicsx python3 -m pip install --no-deps --target packages pandas`, then run "
                "with PYTHONPATH=packages"
            ) from error
        return pandas.DataFrame(self.rows, columns=self.columns)

    def content(self) -> bytes:
        """All rows as csv."""
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(self.columns)
        writer.writerows([_text(value) for value in row.values()] for row in self.rows)
        return text.getvalue().encode()

    @classmethod
    def load(cls, path: str | Path, comm: MPI.Intracomm | None = None) -> Table:
        """Read a table back from its csv file; a last line that was cut short is left out. Collective.

        Args:
            path: the file.
            comm: communicator whose rank 0 reads (default: the world).

        Raises:
            FileNotFoundError: there is no file. ModelError: it cannot be read, or is no table. On all ranks.
        """
        return on_root(comm, lambda: cls.load_here(Path(path)))

    @classmethod
    def load_here(cls, path: Path) -> Table:
        """Read a table as `load` does, on this rank alone."""
        table = cls()
        try:
            with path.open(encoding="utf-8", newline="") as file:  # texts may have line ends of their own
                read = [row for row in _whole_rows(file.read()) if row]
        except FileNotFoundError:
            raise
        except (OSError, ValueError, csv.Error) as error:
            raise ModelError(f"{str(path)!r} cannot be read as a table: {error}") from error
        for number, row in enumerate(read[1:], 2):
            if len(row) != len(read[0]):
                columns = f"{len(read[0])} columns"
                raise ModelError(f"{str(path)!r} is no whole table: line {number} has {len(row)} entries for {columns}")
        table.rows = [dict(zip(read[0], map(_value, row), strict=True)) for row in read[1:]]
        return table

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self.rows[0]) if self.rows else []

    def __repr__(self) -> str:
        return f"Table({len(self)} rows of {', '.join(self.columns) or 'nothing'})"

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """A column as numbers, NaN where empty."""
        if column not in self.columns:
            raise ColumnError(f"no column {column!r}; columns: {', '.join(self.columns)}")
        return np.array([np.nan if row[column] is None else row[column] for row in self.rows], float)

    def __str__(self) -> str:
        shown = RichTable(box=None, header_style="bold")
        for name in self.columns:
            shown.add_column(Text(name), justify="right", no_wrap=True)
        for row in self.rows:
            shown.add_row(*[Text(_short(value)) for value in row.values()])
        out = io.StringIO()
        Console(file=out, width=1000, no_color=True).print(shown)
        return "\n".join(line.rstrip() for line in out.getvalue().rstrip("\n").split("\n"))


def _whole_rows(text: str) -> Iterator[list[str]]:
    """The complete rows of a csv file; a last row with an open quote is left out."""
    reader = csv.reader(io.StringIO(text[: text.rfind("\n") + 1], newline=""), strict=True)
    try:
        yield from reader
    except csv.Error as error:
        if "unexpected end" not in str(error):
            raise


def read_back(value: float | str | None) -> float | str | None:
    """A value after writing and reading."""
    return _value(value) if isinstance(value, str) else value


def _text(value: float | str | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else repr(float(value))


def _value(text: str) -> float | str | None:
    if text == "":
        return None
    try:
        return float(text)
    except ValueError:
        return text


def _short(value: float | str | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.4g}"
