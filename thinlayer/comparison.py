"""Full layer against interface law: differences on S, and sweeps of them as eps -> 0."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from forms.kinematics import Expr
from forms.law import LawError
from thinlayer.loads import ModelError
from thinlayer.progress import track
from thinlayer.state import State
from thinlayer.surface import Surface
from thinlayer.table import Row, Table
from thinlayer.time.history import SAME_TIME, History

Where = Callable[[Expr], Expr]
ERRORS = ("eps", "error_traction", "error_jump")


def compare(
    full: State | History, interface: State | History, *, where: Where | None = None, at: float | None = None
) -> dict[str, float]:
    """How far the interface law is from the meshed layer. Collective.

    Tractions are the bodies' reactions on S, jumps are differences at matched points of both faces (`Surface`).

    Args:
        full: state of a full model, or its history.
        interface: state of the interface model of the same joint, or its history.
        where: part of S to measure on, a function of the coordinates that returns a UFL condition, such as
            `lambda x: x[0] > 1` or `lambda x: ufl.And(x[0] > 1, x[0] < 9)`; default all of S.
        at: time of the states to take from histories; default the last.

    Returns:
        eps; error_traction and error_jump: L2(S) norms of the differences over those of the interface model's fields;
        traction and jump: these norms (stress and length, times length^(1/2) in 2D).

    Raises:
        ModelError: the states are not a full and an interface model of the same joint, or are of two times; `where` is no
            condition, or holds nowhere on S.
    """
    for one in (full, interface):
        if not isinstance(one, (State, History)):
            raise ModelError(f"compare takes states or histories, as solve and march return them, not {one!r}")
    full, interface = (_state(one, at) for one in (full, interface))
    if (full.model.kind, interface.model.kind) != ("full", "interface"):
        raise ModelError(
            f"compare needs a full and an interface model, not {full.model.kind} and {interface.model.kind}"
        )
    if full.model.joint is not interface.model.joint:
        raise ModelError("compare needs two models of the same joint")
    if abs(full.t - interface.t) > SAME_TIME * max(abs(full.t), abs(interface.t)):
        raise ModelError(f"compare needs states of the same time, not t = {full.t:g} and {interface.t:g}")
    if full.model.element != interface.model.element:
        raise ModelError(f"compare needs one element, not {full.model.element} and {interface.model.element}")
    assert full.model.layer is not None
    assert interface.model.layer is not None
    if full.model.layer.eps != interface.model.layer.eps:
        what = f"compare needs one thickness, not {full.model.layer.eps} and {interface.model.layer.eps}"
        raise ModelError(f"{what}; give laws of jumps the layer's too, as ThinLayer(law, eps)")
    surface = Surface(interface.model)
    part = 1 if where is None else _part(surface, where)
    row = {"eps": float(full.model.layer.eps)}
    sizes = {}
    for name, field in (("traction", surface.traction), ("jump", surface.jump)):
        limit = field(interface)
        sizes[name] = surface.norm(limit, part)
        row[f"error_{name}"] = surface.norm(field(full) - limit, part) / sizes[name] if sizes[name] else math.nan
    return row | sizes


def _state(one: State | History, at: float | None) -> State:
    if isinstance(one, State):
        return one
    return one.last if at is None else one.at(at)


def _part(surface: Surface, where: Where) -> Expr:
    """1 on a part of S, 0 elsewhere."""
    try:
        part = ufl.conditional(where(ufl.SpatialCoordinate(surface.model.domain.mesh)), 1.0, 0.0)
    except Exception as error:
        raise ModelError(
            f"where is no function of coordinates that returns a UFL condition, as x[0] > 1 or ufl.And(a, b) are: {error}"
        ) from error
    if surface.integral(part) <= 0:
        raise ModelError("where holds nowhere on S, or on less than its quadrature points see")
    return part


def observed_orders(eps: Iterable[float], errors: Iterable[float]) -> list[float | None]:
    """Observed order between each row and the one before it, log(e_k-1/e_k)/log(eps_k-1/eps_k); None for the first."""
    x, e = np.log(np.array(list(eps), float)), np.log(np.array(list(errors), float))
    return [None, *(np.diff(e) / np.diff(x)).tolist()]


def sweep(
    run: Callable[[float], Mapping[str, Any]],
    eps: Iterable[float],
    out: str | Path | None = None,
    resume: bool = False,
) -> Table:
    """A table of comparisons over decreasing thickness, with observed orders. Collective.

    Args:
        run: eps -> a row with error_traction and error_jump, such as `compare` returns.
        eps: thicknesses, > 0 and different.
        out: csv file; each row is on the disk before the next one is computed, and stays if a later one fails.
        resume: keep the rows that `out` already has, and compute the others.

    Raises:
        LawError: a thickness out of range or given twice, `out` is a folder. ModelError: a row lacks these columns.
    """
    if out is not None and Path(out).is_dir():
        raise LawError(f"{str(out)!r} is a folder; give the name of a csv file")
    try:
        values = sorted((float(e) for e in eps), reverse=True)
    except (TypeError, ValueError) as error:
        raise LawError(f"eps is {eps!r}; a sweep needs different thicknesses > 0") from error
    if not values or values[-1] <= 0 or not np.isfinite(values).all() or len(set(values)) != len(values):
        raise LawError(f"eps is {values}; a sweep needs different thicknesses > 0")
    root = MPI.COMM_WORLD.rank == 0
    rows = MPI.COMM_WORLD.bcast(_rows_of(out) if resume and out is not None and root else {})
    for e in track(values, "sweep", "eps = {:g}"):
        if e not in rows:
            rows[e] = _row(run, e)
            if root and out is not None:
                _with_orders(rows).write(out)
    table = _with_orders(rows)
    return table


def _row(run: Callable[[float], Mapping[str, Any]], eps: float) -> Row:
    row = run(eps)
    if not isinstance(row, Mapping):
        raise ModelError(f"run(eps) returns {row!r}; return what compare returns")
    if missing := {*ERRORS} - row.keys():
        raise ModelError(f"run(eps) returns a row without {', '.join(sorted(missing))}; return what compare returns")
    return dict(row)


def _with_orders(rows: Mapping[float, Row]) -> Table:
    """The table of rows by thickness, descending, with the observed orders between each row and the one before."""
    ordered = [rows[e] for e in sorted(rows, reverse=True)]
    columns = {name: [math.nan if row[name] is None else float(row[name] or 0.0) for row in ordered] for name in ERRORS}
    orders = {name: observed_orders(columns["eps"], columns[f"error_{name}"]) for name in ("traction", "jump")}
    table = Table()
    for k, row in enumerate(ordered):
        first = {name: row[name] for name in ERRORS}
        rest = {name: value for name, value in row.items() if name not in ERRORS}
        table.append(first | {f"order_{name}": orders[name][k] for name in orders} | rest)
    return table


def _rows_of(path: str | Path) -> dict[float, Row]:
    """Thickness -> row, without orders, of a sweep's table; on one rank."""
    if not Path(path).exists():
        return {}
    rows = Table.load(path).rows
    if any(not {*ERRORS} <= row.keys() or not isinstance(row["eps"], float) for row in rows):
        raise ModelError(f"{str(path)!r} is not the table of a sweep; give another name, or remove it")
    return {float(row["eps"]): {n: v for n, v in row.items() if not n.startswith("order_")} for row in rows}  # type: ignore[arg-type]
