"""Sweeps, shared by several studies: the meshed layer against the interface law over decreasing thickness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from forms import BulkLaw
from forms.kinematics import Expr
from forms.law import Law
from geometry.joint import Joint
from thinlayer import Structure, Surface, Table, ThinLayer, compare, plotting, solve
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import LawOnS
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.output.comparison import Where
from thinlayer.output.plotting.curves import ERRORS
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

Floors = Mapping[str, tuple[float, float]]  # traction or jump -> range of the relative error that a wrong law leaves


@dataclass(frozen=True)
class Sweep:
    """One structure, solved with its layer meshed and with the interface law.

    Attributes:
        record: where to write.
        joint: the joint.
        setup: data of the structure besides the joint, see `thinlayer.Structure`.
        layer: thickness -> the layer.
        instead: a law in place of the layer's in the interface model alone, to show the error of a wrong law.
        bodies, cells_through: of the meshed layer, see `Structure.full`; `bodies` also of interface models of order 1.
        where: part of S to measure on, see `thinlayer.compare`.
        times: ends of the steps to march, from rest under loads that are there from t = 0 on; the last states are
            compared. None: a static solve.
        beside: end of a column's name -> thickness -> the layer of a further law, whose errors are columns of the table.
        more: full and interface model's solutions -> further columns of the table.
        case: name of the sweep among those of the study, in names of files and checks.
    """

    record: Record
    joint: Joint
    setup: dict[str, Any]
    layer: Callable[[float], ThinLayer]
    bodies: str = "kept"
    cells_through: int = 4
    where: Callable[[Expr], Expr] | None = None
    times: Sequence[float] | None = None
    beside: Mapping[str, Callable[[float], ThinLayer]] = field(default_factory=dict)
    more: Callable[[Solution, Solution], dict[str, Any]] | None = None
    case: str = ""
    instead: BulkLaw | LawOnS | None = None

    @property
    def structure(self) -> Structure:
        """The structure without its layer."""
        return Structure(self.joint, **self.setup)

    def solved(self, eps: float) -> tuple[Solution, Solution]:
        """The full and the interface model's state, or history, for a thickness."""
        full, limit = self.models(eps)
        return self._solved(full, f"full_{eps:g}"), self._solved(limit, f"interface_{eps:g}")

    def models(self, eps: float) -> tuple[FullModel, InterfaceModel]:
        """The full and the interface model for a thickness."""
        structure, layer, other = self.structure, self.layer(eps), self.instead
        full = structure.full(layer, bodies=self.bodies, cells_through=self.cells_through)
        if isinstance(other, LawOnS):
            return full, structure.interface(other)
        return full, self._interface(structure, layer if other is None else ThinLayer(other, eps, at=1.0))

    def _interface(self, structure: Structure, layer: ThinLayer) -> InterfaceModel:
        return structure.interface(layer, bodies=self.bodies if layer.order else "kept")

    def _solved(self, model: Model, name: str) -> Solution:
        if self.times is None:
            return self.record.solved(solve(model))
        return self.record.march(model, self.times, self._named(name))

    def _named(self, name: str) -> str:
        stem, dot, kind = name.partition(".")
        return f"{stem}_{self.case}{dot}{kind}" if self.case else name

    def run(
        self,
        eps: Sequence[float],
        order: tuple[float, float | None] | None,
        *,
        pictured: Callable[[Sequence[float]], float] | None = max,
        title: str = "",
        unit: str = "",
    ) -> Table:
        """Sweep, print the laws, draw one thickness, check the last observed orders.

        Args:
            eps: thicknesses, lengths.
            order: range that the last observed orders of traction and jump must lie in; None for an open end, or for no
                such check.
            pictured: chooses the thickness to draw the deformed structures of; None for no picture.
            title, unit: of that picture.
        """
        shown = pictured(eps) if pictured else None

        def compare_at(e: float) -> dict[str, float]:
            full, limit = self.solved(e)
            if e == shown:
                states = {f"meshed layer, eps = {e:g} {unit}".rstrip(): last(full), "interface law": last(limit)}
                plotting.deformed(states, save=self.record.path(self._named("deformed.png")), title=title, unit=unit)
            row = compare(full, limit, where=self.where) | elastic_fraction(self.layer(e).law)
            for end, layer in self.beside.items():
                other = self._solved(self._interface(self.structure, layer(e)), f"interface{end}_{e:g}")
                found = compare(full, other, where=self.where)
                row |= {f"{name}{end}": found[name] for name in ERRORS.values()}
            return row | (self.more(full, limit) if self.more else {})

        law = self.layer(eps[0]).law
        self.record.say(f"meshed layer {law}, on S {self.instead}" if self.instead else law)
        table = self.record.sweep(compare_at, eps, self._named("table.csv"))
        low, high = order or (None, None)
        for name in ("traction", "jump") if order and len(eps) > 1 else ():
            reaction = name == "traction" and "error_reaction" in table.columns
            what = f"last observed order of the {name}" + (f", {self.case}" if self.case else "")
            value = last_order(table, "error_reaction" if reaction else f"error_{name}")
            self.record.check(what, value, low=low, high=high)
        return table


def elastic_fraction(law: Law) -> dict[str, float]:
    """The column h of a law that has an elastic fraction, for a table; of a stack the largest."""
    laws = [one for _, one in law.sublayers]
    fractions = [one.parameters()["elastic_fraction"] for one in laws if "elastic_fraction" in one.parameters()]
    return {"h": max(fractions)} if fractions else {}


def middle(eps: Sequence[float]) -> float:
    """The thickness in the middle of a sweep."""
    return sorted(eps)[len(eps) // 2]


def last(solution: Solution) -> State:
    """The state itself, or the last one of a history."""
    return solution if isinstance(solution, State) else solution.last


def layer_of(solution: Solution) -> ThinLayer:
    """The only layer of a model, with its thickness."""
    (layer,) = last(solution).model.layers.values()
    assert layer.thin is not None, "a layer with a thickness"
    return layer.thin


def last_order(table: Table, column: str, by: str = "eps") -> float:
    """The last observed order of a column of errors; NaN where there is none."""
    return table.orders(column, of=by)[-1] or math.nan


def by_reaction(full: Solution, limit: Solution, where: Where | None = None) -> dict[str, float]:
    """Error of the traction whose forces are the bodies' reactions; those of both laws' own nearly cancel the next term."""
    surface, part = Surface(last(limit).model), where or 1.0
    meshed, wanted = (surface.reaction(last(one)) for one in (full, limit))
    return {"error_reaction": surface.norm(meshed - wanted, part) / surface.norm(wanted, part)}


def check_floors(record: Record, name: str, wrong: Table, right: Table, floors: Floors) -> None:
    """Check the errors that a wrong law leaves, that they no longer fall, and that they are not the right law's."""
    for of, (low, high) in floors.items():
        errors = wrong[f"error_{of}"]
        record.check(f"error of the {of} that {name} leaves", errors[-1], low=low, high=high)
        record.check(f"error of the {of}, {name} over right law", errors[-1] / right[f"error_{of}"][-1], low=4.0)
        if len(errors) > 1:
            record.check(f"last observed order of the {of}, {name}", wrong[f"order_{of}"][-1], low=-0.2, high=0.2)


def table_of(case: str) -> str:
    """Name of the table of a sweep."""
    return f"table_{case.replace(' ', '_')}.csv" if case else "table.csv"


def draw_rates(
    record: Record,
    title: str,
    cases: Mapping[str, str] = {"": ""},
    *,
    apart: bool = False,
    name: str = "rates",
    **drawn: Any,
) -> None:
    """Draw rates.png from the tables of the study's sweeps.

    Args:
        record: the run.
        title: of the picture.
        cases: label -> case of a sweep.
        apart: whether the jump gets a picture of its own, rates_jump.png: for many cases.
        name: of the picture, without .png.
        drawn: of `plotting.rates`.
    """
    tables = {label: record.path(table_of(case)) for label, case in cases.items()}
    if not apart:
        plotting.rates(tables, save=record.path(f"{name}.png"), title=title, **drawn)
    for one, end in (("traction", ""), ("jump", "_jump")) if apart else ():
        save, errors = record.path(f"{name}{end}.png"), {one: f"error_{one}"}
        plotting.rates(tables, save=save, title=f"{title}: {one}", errors=errors)
