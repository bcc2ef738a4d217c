"""Full layer against interface law: differences on S, and sweeps of them as eps -> 0."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI
from ufl.algorithms.analysis import extract_coefficients, extract_constants

from forms.kinematics import Expr
from forms.law import LawError
from geometry.parallel import on_root
from thinlayer.discretisation.kinds import FullModel, InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.files.folder import LOCK, moved_away, owned
from thinlayer.files.progress import track
from thinlayer.files.table import Row, Table, hash_of, read_back, replaced
from thinlayer.identity.identity import CODE, MISSING, SAME, differences, referred
from thinlayer.output.surface import Surface
from thinlayer.parallel.agreement import on_all, require_same
from thinlayer.time.history import SAME_TIME, History
from thinlayer_base import is_number

Where = Callable[[Expr], Expr]
ERRORS = ("eps", "error_traction", "error_jump")
ORDERS = ("order_traction", "order_jump")  # what a sweep adds
SAME_EPS = 1e-9  # relative: thicknesses that are computed in two ways
SAME_PROFILE = 1e-9  # relative


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
        at: time of the states to take from histories; default the last. A state must be of this time.

    Returns:
        eps; error_traction and error_jump: L2(S) norms of the differences over those of the interface model's fields;
        traction and jump: these norms (stress and length, times length^(1/2) in 2D).

    Raises:
        ModelError: the states are not a full and an interface model of the same structure (joint, bodies, supports, loads,
            plane, element, thickness), or are of two times; `where` is no condition, or holds nowhere on S.
    """
    for one in (full, interface):
        if not isinstance(one, (State, History)):
            raise ModelError(f"compare takes states or histories, as solve and march return them, not {one!r}")
    if at is not None and not (is_number(at) and math.isfinite(at)):
        raise ModelError(f"compare: at is {at!r}; give a time, a finite number")
    full, interface = (_state(one, at) for one in (full, interface))
    meshed, limit = full.model, interface.model
    if not (isinstance(meshed, FullModel) and isinstance(limit, InterfaceModel)):
        raise ModelError(f"compare needs a full and an interface model, not {meshed.name} and {limit.name}")
    if full.model.joint is not interface.model.joint:
        raise ModelError("compare needs two models of the same joint")
    if abs(full.t - interface.t) > SAME_TIME * max(abs(full.t), abs(interface.t)):
        raise ModelError(f"compare needs states of the same time, not t = {full.t:g} and {interface.t:g}")
    if full.model.element != interface.model.element:
        raise ModelError(f"compare needs one element, not {full.model.element} and {interface.model.element}")
    if limit.thin_layer and meshed.layer.eps != limit.thin_layer.eps:
        raise ModelError(f"compare needs one thickness, not {meshed.layer.eps} and {limit.thin_layer.eps}")
    on_root(meshed.comm, lambda: _require_same_structure(meshed, limit))
    surface = Surface(limit)
    part = 1 if where is None else _part(surface, where)
    row = {"eps": float(meshed.layer.eps)}
    sizes = {}
    for name, field in (("traction", surface.traction), ("jump", surface.jump)):
        by_law = field(interface)
        sizes[name] = surface.norm(by_law, part)
        row[f"error_{name}"] = surface.norm(field(full) - by_law, part) / sizes[name] if sizes[name] else math.nan
    return row | sizes


def _state(one: State | History, at: float | None) -> State:
    if isinstance(one, State):
        if at is not None and not abs(one.t - at) <= SAME_TIME * max(abs(one.t), abs(at)):
            raise ModelError(
                f"compare: a state is of t = {one.t:g}, not of at = {at:g}; give its history, or leave out at"
            )
        return one
    return one.last if at is None else one.at(at)


def _require_same_structure(full: FullModel, interface: InterfaceModel) -> None:
    """Raise ModelError unless both models have the same data but for the layer's law."""
    there, here = (
        model.made_from | {"supports": model.made_from["supports"][: len(model.supports.given)]}
        for model in (full, interface)
    )
    for name in ("plane", "bodies", "supports", "loads"):
        if there[name] != here[name]:
            raise ModelError(f"compare needs the same {name}, not {there[name]} and {here[name]}")
    if interface.thin_layer is None:  # a law on S knows no thickness
        return
    one, other = (full.joint.relative_thickness(layer.profile) for layer in (full.layer, interface.thin_layer))
    if not np.allclose(one, other, rtol=SAME_PROFILE, atol=0.0):
        raise ModelError("compare needs the same profile of the thickness in both models")


def _part(surface: Surface, where: Where) -> Expr:
    """1 on a part of S, 0 elsewhere."""
    mesh = surface.model.domain.mesh
    with on_all(surface.model.comm):
        try:
            condition = where(ufl.SpatialCoordinate(mesh))
            part = ufl.conditional(condition, 1.0, 0.0)
        except Exception as error:
            raise ModelError(
                "where is no function of coordinates that returns a UFL condition, as x[0] > 1 or ufl.And(a, b) are: "
                f"{error}"
            ) from error
        # a text tells more, but names functions and constants by numbers that each rank counts by itself
        named = extract_coefficients(part) or extract_constants(part)
        shown = (part * ufl.dx(domain=mesh)).signature() if named else str(condition)
    require_same(surface.model.comm, where=shown)
    if surface.integral(part) <= 0:
        raise ModelError("where holds nowhere on S, or on less than its quadrature points see")
    return part


def observed_orders(eps: Iterable[float], errors: Iterable[float]) -> list[float | None]:
    """Observed order between each row and the one before it, log(e_k-1/e_k)/log(eps_k-1/eps_k).

    None for the first row, and where one of the two errors is zero or not finite.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        x, e = np.log(np.array(list(eps), float)), np.log(np.array(list(errors), float))
        orders = np.diff(e) / np.diff(x)
    return [None, *(order if math.isfinite(order) else None for order in orders.tolist())]


def sweep(
    run: Callable[[float], Mapping[str, Any]],
    eps: Iterable[float],
    out: str | Path | None = None,
    resume: bool = False,
) -> Table:
    """A table of comparisons over decreasing thickness, with observed orders. Collective.

    Args:
        run: eps -> a row with error_traction and error_jump, such as `compare` returns; the same on all ranks.
        eps: thicknesses, > 0 and different.
        out: csv file; each row is on the disk before the next one is computed, and stays if a later one fails. Beside it
            stands out.json, which tells what the rows were made from: the code of `run` and what it refers to. The file of
            another sweep, or of anything else, is moved to previous-1, previous-2, ... in its folder.
        resume: keep the rows that `out` already has, and compute the others.

    Raises:
        LawError: a thickness out of range or given twice. ModelError: a row of another thickness, lacking columns or with
            others than the first; `out` is a folder, cannot be written, another run writes it, or it is to be resumed and
            is another sweep's. OSError: a row could not be written. All of them on all ranks.
    """
    with on_all(MPI.COMM_WORLD):
        if out is not None and Path(out).is_dir():
            raise ModelError(f"out: {str(out)!r} is a folder; give the name of a csv file")
        try:
            given = () if isinstance(eps, str) else tuple(eps)
            if not given or not all(map(is_number, given)):
                raise TypeError("thicknesses are numbers")
            values = sorted(map(float, given), reverse=True)
        except (TypeError, ValueError) as error:
            raise LawError(f"eps is {eps!r}; a sweep needs different thicknesses > 0") from error
        if values[-1] <= 0 or not np.isfinite(values).all() or len(set(values)) != len(values):
            raise LawError(f"eps is {values}; a sweep needs different thicknesses > 0")
    require_same(MPI.COMM_WORLD, eps=values, out=out and str(out), resume=resume)
    path = None if out is None else Path(out)
    with nullcontext() if path is None else owned(path.parent, name=f".{path.name}{LOCK}"):
        file = None if path is None else SweepFile(path, run)
        rows = {} if file is None else on_root(None, lambda: file.begin(resume))
        for e in track(values, "sweep", "eps = {:g}"):
            if e not in rows:
                rows[e] = _row(run, e, next(iter(rows.values()), None))
                if file is not None:
                    table = _with_orders(rows)
                    on_root(None, lambda table=table: file.write(table))  # type: ignore[misc]
        return _with_orders(rows)


class SweepFile:
    """The csv file of a sweep, and beside it the one that says what its rows were made from; on one rank.

    What `run` itself changes as it goes, such as a list of what it has found, is no part of that; what stands beside it,
    and code, are.
    """

    def __init__(self, path: Path, run: Callable[[float], Mapping[str, Any]]) -> None:
        self.path, self.beside, self._run = path, path.with_name(f"{path.name}.json"), run
        self._made_from = referred(run)
        self._changing: set[tuple[str, ...]] = set()

    def begin(self, resume: bool) -> dict[float, Row]:
        """Thickness -> row, without orders, of the rows that are kept; errors as in `sweep`."""
        if not self.path.exists():
            return {}
        problem = self._problem()
        if problem and resume:
            raise ModelError(f"{problem}; give another name, or remove it")
        if problem:
            moved_away(self.path.parent, [self.path.name, self.beside.name])
        if not resume:
            return {}
        rows = Table.got(self.path).rows
        if any(not isinstance(row.get(name), float) for row in rows for name in ERRORS):
            raise ModelError(f"{str(self.path)!r} is not the table of a sweep; give another name, or remove it")
        return {float(row["eps"]): {n: v for n, v in row.items() if n not in ORDERS} for row in rows}  # type: ignore[arg-type]

    def _problem(self) -> str | None:
        """Why the table that is there is not of this sweep."""
        name = str(self.path)
        if not self.beside.exists():
            return (
                f"{name!r} is not the table of a sweep: there is no {self.beside.name} that tells what it was made from"
            )
        try:
            content = json.loads(self.beside.read_text(encoding="utf-8"))
            there, changing, hashes = (
                dict(content["made from"]),
                {*map(tuple, content["changing"])},
                [*content["sha256"]],
            )
        except (OSError, ValueError, LookupError, TypeError) as error:
            return f"{str(self.beside)!r} cannot be read ({error})"
        if hash_of(self.path) not in hashes:
            return f"{name!r} is not the table of a sweep: it has been changed since one wrote it"
        self._changing = changing
        found = [one for one in differences(there, self._made_from) if _changed(*one) not in changing]
        what = "; ".join(f"{'.'.join(path)}: {_short(one)} there, {_short(two)} here" for path, one, two in found)
        return f"{name!r} is the table of another sweep ({what})" if found else None

    def write(self, table: Table) -> None:
        """Replace the table. The file beside it names the old and the new one, and is written first."""
        changed = (_changed(*one) for one in differences(self._made_from, referred(self._run)))
        self._changing |= {path for path in changed if path}
        hashes = [hash_of(self.path), hashlib.sha256(table.content()).hexdigest()]
        content = {"made from": self._made_from, "changing": sorted(self._changing), "sha256": hashes}
        with replaced(self.beside) as file:
            file.write(json.dumps(content, indent=1).encode() + b"\n")
        table.put(self.path)


def _changed(path: tuple[str, ...], one: Any, _: Any) -> tuple[str, ...] | None:
    """What has changed where two descriptions differ: a value, or that there are further ones ("*"); None for code."""
    if {CODE, SAME} & {*path}:
        return None
    return (*path[:-1], "*") if one is MISSING else path


def _short(value: Any) -> str:
    if value is MISSING:
        return "nothing"
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 200 else f"{text[:200]} ..."


def _row(run: Callable[[float], Mapping[str, Any]], eps: float, first: Row | None) -> Row:
    """The row of a thickness, as any rank's error is all ranks'."""
    what = "return what compare returns"
    with on_all(MPI.COMM_WORLD):
        row = run(eps)
    problem = _flaw(row, eps, first)
    if problem := next(filter(None, MPI.COMM_WORLD.allgather(problem)), None):
        raise ModelError(f"run({eps:g}) returns {problem}; {what}")
    row = {name: read_back(row[name]) for name in (*ERRORS, *(n for n in row if n not in ERRORS))} | {"eps": eps}
    return row if first is None else {name: row[name] for name in first}


def _flaw(row: Any, eps: float, first: Row | None) -> str | None:
    """What is wrong with a row."""
    if not isinstance(row, Mapping):
        return repr(row)
    if missing := {*ERRORS} - row.keys():
        return f"a row without {', '.join(sorted(missing))}"
    if taken := [name for name in row if name in ORDERS or not isinstance(name, str)]:
        return f"a row with {taken[0]!r}; names of columns are texts, and the sweep itself adds {', '.join(ORDERS)}"
    for name, value in row.items():
        if not (value is None or isinstance(value, str) or (isinstance(value, Real) and not isinstance(value, bool))):
            return f"{name} = {value!r}, which is neither a number nor a text"
        if name in ERRORS and not isinstance(value, Real):
            return f"{name} = {value!r}, which is no number"
    if not abs(float(row["eps"]) - eps) <= SAME_EPS * eps:
        return f"a row of another thickness, eps = {float(row['eps']):g}"
    if first is not None and set(row) != set(first):
        return f"a row with the columns {', '.join(row)}, where the first row has {', '.join(first)}"
    return None


def _with_orders(rows: Mapping[float, Row]) -> Table:
    """The table of rows by thickness, descending, with the observed orders between each row and the one before."""
    ordered = [rows[e] for e in sorted(rows, reverse=True)]
    columns = {name: [float(row[name]) for row in ordered] for name in ERRORS}  # type: ignore[arg-type]
    orders = {name: observed_orders(columns["eps"], columns[f"error_{name}"]) for name in ("traction", "jump")}
    table = Table()
    for k, row in enumerate(ordered):
        first = {name: row[name] for name in ERRORS}
        rest = {name: value for name, value in row.items() if name not in ERRORS}
        table.append(first | {f"order_{name}": orders[name][k] for name in orders} | rest)
    return table
