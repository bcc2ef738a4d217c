"""Sweeps: comparisons of models for decreasing thickness eps, with observed rates of convergence."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from forms.base import InputError, is_finite, require
from forms.kinematics import PLANE_STRAIN, ScalarField
from geometry.parallel import default_comm, on_root
from thinlayer.output.row_file import RowFile, checked_row, require_csv
from thinlayer.system.fingerprint import Resume, random_states
from thinlayer.system.folder import LOCK_FILE, lock_from_root
from thinlayer.system.progress import track
from thinlayer.system.ranks import errors_on_all, require_same
from thinlayer.system.table import Row, Table

TRACTION_ERRORS = tuple(f"error_{kind.quantities.traction}" for kind in (PLANE_STRAIN, ScalarField))  # each row has one
ORDER_COLUMNS = tuple(name.replace("error", "order") for name in (*TRACTION_ERRORS, "error_jump"))  # a sweep adds them
RowFunction = Callable[..., Mapping[str, object]]  # of a thickness
THICKNESS_TOLERANCE = 1e-9  # relative difference of equal thicknesses


def sweep(run: RowFunction, eps: Iterable[float], out: str | Path | None = None, resume: Resume = False) -> Table:
    """Compute a table of errors for several thicknesses eps, with their observed rates of convergence. Collective.

    The rate between two rows is the slope of the error over eps on logarithmic axes.

    Args:
        run: function that takes a thickness eps and returns a row, name -> number or text, the same on all ranks. The
            row has at least "eps", "error_traction" (for a scalar field "error_flux") and "error_jump", as `compare`
            returns them.
        eps: the thicknesses, > 0 and different.
        out: csv file for the table; None: no file. Each row is on the disk before the next one is computed, and stays
            if a later one fails. The file called `out` + ".json" has the rows, and a description of `run` and of the
            data that it refers to.
        resume: False: compute all rows; both files of an earlier sweep are moved to a folder previous-1, previous-2,
            ... True: keep the rows that are in the files, and compute the others. "anyway": keep also rows of another
            `run`.

    Returns:
        The table, the largest thickness first. The columns "order_traction" (or "order_flux") and "order_jump" have the
        rates.

    Raises:
        InputError: a thickness out of range or repeated; a row of another thickness, without the required columns, or
            with other columns than the first row; `out` is a folder, cannot be written, or is written by another run;
            rows in `out` are of another `run`, and `resume` is True. All ranks raise these errors.
        OSError: a row could not be written.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, compare, solve, sweep
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> def run(eps):
        ...     layer = ThinLayer(glue, eps, at=0.1)
        ...     full, limit = plates.full(layer, cells_through=1), plates.interface(layer)
        ...     return compare(solve(full), solve(limit))
        ...
        >>> table = sweep(run, [0.1, 0.05])
        >>> print(table.columns)
        ['eps', 'error_traction', 'error_jump', 'order_traction', 'order_jump', 'traction', 'jump']
    """
    with errors_on_all(default_comm()):
        require_csv(out, resume)
        require(callable(run), "run", run, "it must be a function of a thickness")
        thicknesses = tuple(eps) if np.iterable(eps) and not isinstance(eps, str) else ()
        sorted_eps = sorted({float(e) for e in thicknesses if is_finite(e) and e > 0}, reverse=True)
        require(0 < len(thicknesses) == len(sorted_eps), "eps", eps, "a sweep needs different thicknesses > 0")
    require_same(default_comm(), eps=sorted_eps, out=out and str(out), resume=resume)
    path, rows, file = None if out is None else Path(out), dict[float, Row](), None
    with lock_from_root(path and path.parent, name=f".{path and path.name}{LOCK_FILE}"):
        if path is not None:
            file = RowFile(path, run, "sweep")
            stored_rows = on_root(None, partial(file.resume, resume))
            rows = {float(row["eps"]): row for row in stored_rows}  # type: ignore[arg-type]
        for e in track(sorted_eps, "sweep", "eps = {:g}"):
            if e not in rows:
                states = random_states(run)
                rows[e] = _compute_row(run, e, next(iter(rows.values()), None))
                if file is not None:
                    on_root(None, partial(file.add, rows[e], drawn=random_states(run) != states))
            if path is not None:  # also if the row is old: a killed run may have written it only to the json file
                _table_with_orders(rows).write(path)
        return _table_with_orders(rows)


def _compute_row(run: RowFunction, eps: float, first_row: Row | None) -> Row:
    """Compute the row of one thickness by the user's function, and check it. Collective.

    Args:
        run: the user's function.
        eps: the thickness.
        first_row: the first row of the table, whose columns the new row must have; None: there is none.

    Raises:
        InputError: the row has another thickness, lacks a number, or has other columns; errors of `run`. All ranks
            raise these errors.
    """
    text = f"the row that run({eps:g}) returns"
    with errors_on_all(default_comm()):
        row = checked_row(run(eps), text, ORDER_COLUMNS)
        needed = needed_columns(row)
        if lacking := [name for name in needed if not isinstance(row.get(name), float)]:
            raise InputError(f"{text} has no number {', '.join(lacking)}; return what compare returns")
        if not abs(row["eps"] - eps) <= THICKNESS_TOLERANCE * eps:  # type: ignore[operator]
            raise InputError(f"{text} is of another thickness, eps = {row['eps']:g}; take the argument of run")
        if first_row is not None and row.keys() != first_row.keys():
            raise InputError(f"{text} has columns {', '.join(row)}, where the first row has {', '.join(first_row)}")
    columns = first_row or (*needed, *(name for name in row if name not in needed))
    return {name: row[name] for name in columns} | {"eps": eps}


def _table_with_orders(rows: Mapping[float, Row]) -> Table:
    """Make a sweep's table from `rows`, thickness -> row: largest thickness first, with rates of convergence."""
    table = Table(rows[e] for e in sorted(rows, reverse=True))
    needed = needed_columns(table.rows[0])
    orders = {error.replace("error", "order"): table.orders(error) for error in needed[1:]}
    for k, row in enumerate(table.rows):
        table.rows[k] = {key: row[key] for key in needed} | {key: values[k] for key, values in orders.items()} | row
    return table


def needed_columns(row: Collection[str]) -> tuple[str, str, str]:
    """Return the names of the columns that a row must have, for tractions or for a scalar field's fluxes."""
    return "eps", next((name for name in TRACTION_ERRORS if name in row), TRACTION_ERRORS[0]), "error_jump"
