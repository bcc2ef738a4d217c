"""Table: rows of numbers with names, committed to a csv file one by one."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table as RichTable

Row = dict[str, float | str | None]


@contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """A file that takes the place of another one when it is whole and on the disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.part")
    with partial.open("wb") as file:
        yield file
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    os.fsync(folder)
    os.close(folder)


class Table:
    """Rows with the same columns.

    Attributes:
        rows: the rows so far; None stands for an empty entry.
        path: csv file that each row is written to as it comes, or None.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]] = (), path: str | Path | None = None) -> None:
        self.rows: list[Row] = []
        self.path = Path(path) if path else None
        for row in rows:
            self.append(row)

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row, and commit it to the file: flushed to the disk before this returns.

        Raises:
            ValueError: other columns than the first row's.
        """
        if self.rows and list(row) != self.columns:
            raise ValueError(f"a row with columns {list(row)} does not fit a table with columns {self.columns}")
        self.rows.append(dict(row))
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w" if len(self.rows) == 1 else "a", newline="") as file:
            writer = csv.writer(file)
            if len(self.rows) == 1:
                writer.writerow(self.columns)
            writer.writerow([_text(value) for value in row.values()])
            file.flush()
            os.fsync(file.fileno())

    def write(self, path: str | Path) -> None:
        """Write all rows to a csv file, which is replaced as a whole."""
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(self.columns)
        writer.writerows([_text(value) for value in row.values()] for row in self.rows)
        with replaced(Path(path)) as file:
            file.write(text.getvalue().encode())

    @classmethod
    def load(cls, path: str | Path) -> Table:
        """Read a table back from its csv file; a last line that was cut short is left out."""
        table = cls()
        lines = Path(path).read_text().splitlines(keepends=True)
        whole = [line for line in lines if line.endswith("\n")]
        table.rows = [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(whole)]
        return table

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(self.rows[0]) if self.rows else []

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """A column as numbers, NaN where empty."""
        if column not in self.columns:
            raise KeyError(f"no column {column!r}; columns: {', '.join(self.columns)}")
        return np.array([np.nan if row[column] is None else row[column] for row in self.rows], float)

    def __str__(self) -> str:
        shown = RichTable(box=None, header_style="bold")
        for name in self.columns:
            shown.add_column(name, justify="right", no_wrap=True)
        for row in self.rows:
            shown.add_row(*[_short(value) for value in row.values()])
        out = io.StringIO()
        Console(file=out, width=1000, no_color=True).print(shown)
        return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


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
