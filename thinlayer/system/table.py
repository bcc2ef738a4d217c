"""Table: rows of numbers and texts in named columns, which may be written to a csv file as they are added."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from forms.base import InputError, import_optional, unknown_name_message
from geometry.parallel import on_root
from thinlayer.system.folder import replace_file

Entry = float | str | None  # None: empty
Row = dict[str, Entry]
ColumnValues = Mapping[str, Any]  # column -> entry, or entries, as a user gives them


MAX_WHOLE_NUMBER = 1e7  # from which on whole numbers are printed with four digits


class ColumnError(InputError, KeyError):
    """Error for a column that a table does not have, or that has texts where numbers are needed."""


class Table:
    """Rows of numbers and texts, all with the same columns.

    All MPI ranks have the same table, and only rank 0 reads and writes files. A csv file has no types. When it is read,
    entries that `float` accepts become numbers ("007" becomes 7), and empty entries become None.

    Attributes:
        rows: the rows so far; each is a dict, name of a column -> number, text, or None for an empty entry.
        path: csv file to which added rows are written at once; None: no file.

    Example:
        >>> from thinlayer import Table
        >>> table = Table([{"eps": 0.1, "error": 0.04}, {"eps": 0.05, "error": 0.01}])
        >>> print(table["error"], table.columns)
        [0.04 0.01] ['eps', 'error']
        >>> [f"{order:.2f}" for order in table.orders("error")[1:]]
        ['2.00']
        >>> print(table)
         eps  error
         0.1   0.04
        0.05   0.01
    """

    def __init__(self, rows: Iterable[ColumnValues] = (), path: str | Path | None = None) -> None:
        self.rows: list[Row] = []
        self.path = Path(path) if path else None
        self.extend(rows)

    def append(self, row: ColumnValues) -> None:
        """Add a row; if the table has a file, the row is on the disk when this returns. Collective if it has a file.

        Args:
            row: name of a column -> entry.

        Raises:
            InputError: the row has other columns than the first row, or a name of a column is not a text.
            OSError: the file could not be written; on all ranks.
        """
        self.extend([row])

    def extend(self, rows: Iterable[ColumnValues]) -> None:
        """Add several rows; if the table has a file, write it once, after the last row. Collective if it has a file.

        Args:
            rows: for each row, name of a column -> entry.

        Raises:
            InputError: a row has other columns than the first row, or a name of a column is not a text.
            OSError: the file could not be written; on all ranks.
        """
        n_before = len(self.rows)
        for row in rows:
            if self.rows and list(row) != self.columns:
                raise InputError(f"a row with columns {list(row)} does not fit a table with columns {self.columns}")
            if wrong_names := [name for name in row if not isinstance(name, str)]:
                raise InputError(f"names of a table's columns must be texts, not {', '.join(map(repr, wrong_names))}")
            self.rows.append(dict(row))
        if self.path is not None and len(self.rows) > n_before:
            self.write(self.path)

    def write(self, path: str | Path, comm: MPI.Intracomm | None = None) -> None:
        """Write all rows to a csv file, in place of what it had before. Collective.

        Args:
            path: path of the file.
            comm: communicator whose rank 0 writes; None: all ranks, in an `ensemble` those of the group.

        Raises:
            OSError: the file could not be written; on all ranks.
        """
        on_root(comm, lambda: self.write_on_this_rank(Path(path)))

    def write_on_this_rank(self, path: Path) -> None:
        """Write all rows to the csv file `path`, on the one rank that calls this."""
        buffer = io.StringIO()
        writer = csv.writer(buffer)
        writer.writerow(self.columns)
        writer.writerows([_entry_text(value, repr) for value in row.values()] for row in self.rows)
        with replace_file(path) as file:
            file.write(buffer.getvalue().encode())

    @classmethod
    def of(cls, columns: ColumnValues) -> Table:
        """Make a table from its columns.

        Args:
            columns: name of a column -> its entries, of the same number in all columns; or one entry, repeated in all
                rows.

        Raises:
            InputError: the columns have different numbers of entries.
        """
        arrays = [np.atleast_1d(np.asarray(column, object)) for column in columns.values()]
        try:
            rows = zip(*np.broadcast_arrays(*arrays), strict=True)
        except ValueError:
            sizes_text = ", ".join(f"{name} {len(column)}" for name, column in zip(columns, arrays, strict=True))
            raise InputError(f"columns of a table need the same number of entries, or one; not {sizes_text}") from None
        return cls(dict(zip(columns, row, strict=True)) for row in rows)

    @classmethod
    def load(cls, path: str | Path, comm: MPI.Intracomm | None = None) -> Table:
        """Return the table in a csv file. Collective.

        Args:
            path: path of the file.
            comm: communicator whose rank 0 reads; None: all ranks, in an `ensemble` those of the group.

        Raises:
            FileNotFoundError: the file does not exist; on all ranks.
            InputError: the file cannot be read, or does not contain a table; on all ranks.
        """

        def read() -> list[list[str]]:
            try:
                with Path(path).open(encoding="utf-8", newline="") as file:  # texts may have line ends of their own
                    return [row for row in csv.reader(file, strict=True) if row]
            except FileNotFoundError:
                raise
            except (OSError, ValueError, csv.Error) as error:
                raise InputError(f"{str(path)!r} cannot be read as a table: {error}") from error

        names, *rows = on_root(comm, read) or [[]]
        problems = ["columns have the same name"] * (len({*names}) < len(names))
        line_sizes = enumerate(map(len, rows), 2)
        problems += [f"line {k} has {n} entries for {len(names)} columns" for k, n in line_sizes if n != len(names)]
        if problems:
            raise InputError(f"{str(path)!r} is not a whole table: {problems[0]}")
        return cls(dict(zip(names, map(_parse_entry, row), strict=True)) for row in rows)

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in order; [] for a table without rows."""
        return list(self.rows[0]) if self.rows else []

    def orders(self, errors: str, of: str = "eps") -> list[float | None]:
        """Return the observed rate of convergence between each row and the row before it.

        With errors e and sizes h in rows k - 1 and k, the rate is log(e[k-1]/e[k]) / log(h[k-1]/h[k]).

        Args:
            errors: name of the column of errors.
            of: name of the column of sizes, such as a thickness or a cell size.

        Returns:
            For each row the rate; None in the first row, and where an error is zero or missing.

        Raises:
            ColumnError: a column does not exist or has texts.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            orders = np.diff(np.log(self[errors])) / np.diff(np.log(self[of]))
        return [None, *(order if math.isfinite(order) else None for order in orders.tolist())]

    def split(self, column: str) -> dict[Any, Table]:
        """Split the table by the values in a column: return value -> table of the rows with this value.

        Args:
            column: name of the column.

        Raises:
            ColumnError: there is no such column.
        """
        values = dict.fromkeys(self._entries(column))
        return {value: Table(row for row in self if row[column] == value) for value in values}

    def __repr__(self) -> str:
        return f"Table({len(self)} rows of {', '.join(self.columns) or 'nothing'})"

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, column: str) -> npt.NDArray[np.float64]:
        """Return the entries of a column as an array (rows,) of numbers; empty entries are NaN.

        Args:
            column: name of the column.

        Raises:
            ColumnError: there is no such column, or it has texts.
        """
        entries = [np.nan if value is None else value for value in self._entries(column)]
        try:
            return np.array(entries, float)
        except ValueError as error:
            raise ColumnError(f"the column {column!r} has texts: {error}") from None

    def _entries(self, column: str) -> list[Entry]:
        if column not in self.columns:
            raise ColumnError(unknown_name_message("column", column, self.columns))
        return [row[column] for row in self.rows]

    def to_pandas(self) -> Any:
        """Return the table as a DataFrame of pandas; empty entries are NaN in columns of numbers, otherwise None.

        Raises:
            InputError: pandas is not installed.
        """
        return import_optional("pandas").DataFrame(self.rows, columns=self.columns)

    def _texts(self) -> list[list[str]]:
        rows = ([_entry_text(value, _short_number) for value in row.values()] for row in self.rows)
        return [self.columns, *rows]

    def _repr_html_(self) -> str:
        """Return the table as HTML, which notebooks display."""
        rows = ("".join(f"<td>{escape(text)}</td>" for text in texts) for texts in self._texts())
        return f"<table><tr>{'</tr><tr>'.join(rows)}</tr></table>".replace("td>", "th>", 2 * len(self.columns))

    def __str__(self) -> str:
        lines = self._texts()
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded_lines = (map(str.rjust, line, widths) for line in lines)
        return "\n".join("  ".join(entries).rstrip() for entries in padded_lines)


def _short_number(value: float) -> str:
    return f"{value:.0f}" if value.is_integer() and abs(value) < MAX_WHOLE_NUMBER else f"{value:.4g}"


def _entry_text(value: Entry, format_number: Callable[[float], str]) -> str:
    return "" if value is None else value if isinstance(value, str) else format_number(float(value))


def _parse_entry(text: str) -> Entry:
    with suppress(ValueError):
        return float(text)
    return text or None
