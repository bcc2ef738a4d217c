"""Frictional layer that opens, meshed, against Coulomb contact on S: error O(eps), with stick, sliding and separation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from forms import HolonomicCoulomb, IncrementalCoulomb, MohrCoulombMonodirectional
from forms.base import Array
from studies.problems import pressed
from studies.sweeping import Sweep, draw_rates, last, layer_of, table_of
from thinlayer import Structure, Surface, Table, ThinLayer, compare, march, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.solving.history import History, Solution

MODULI = {"lmbda": 60.0, "mu": 40.0}
OMEGA = 25.0
FRICTION = math.tan(math.radians(OMEGA))
BAND = MohrCoulombMonodirectional(**MODULI, cohesion=0.0, friction_angle=OMEGA, unilateral=True)
HOLONOMIC = HolonomicCoulomb.of_layer(**MODULI, friction=FRICTION)
INCREMENTAL = IncrementalCoulomb.of_layer(**MODULI, friction=FRICTION)
ONCE = {0: (0.28, 1.0, 1.5), 1: (0.28, 1.0, 1.5)}
TO_AND_FRO = {0: (0.0, 0.0, 0.0), 1: (0.28, 1.0, 0.0), 2: (0.28, 1.0, 1.5), 3: (0.28, 0.0, -1.0)}
TIMES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
CELLS, FRACTION = 4, 1e-5  # cells through the thickness, and the elastic fraction that their inner nodes need
TITLES = {
    "": "at once",
    "history": "to and fro",
    "cells": "at once, 4 cells, h = 1e-5",
    "sine": "at once, f = sin(Omega)",
}


@dataclass(frozen=True)
class Comparison:
    """A meshed band against a contact law on S.

    Attributes:
        path: loads, see `pressed`.
        times: ends of the steps, or None for one step.
        contact: the law on S.
        band: the band's law.
        cells: cells through its thickness.
    """

    path: dict[int, tuple[float, float, float]]
    times: Sequence[float] | None
    contact: HolonomicCoulomb | IncrementalCoulomb
    band: MohrCoulombMonodirectional = BAND
    cells: int = 1

    def sweep(self, record: Record, h: float, case: str) -> Sweep:
        """Its sweep on squares of size h."""
        joint, setup = pressed(h, self.path)
        layer, more = partial(ThinLayer, self.band, at=1.0), partial(_noted, record, case)
        choices: dict[str, Any] = {"cells_through": self.cells, "times": self.times, "instead": self.contact}
        return Sweep(record, joint, setup | {"element": "Q1"}, layer, more=more, case=case, **choices)


AT_ONCE = Comparison(ONCE, None, HOLONOMIC)
CASES = {"": AT_ONCE, "history": Comparison(TO_AND_FRO, TIMES, INCREMENTAL)}
CONTACT = "contact on S"
FINER = replace(AT_ONCE, band=replace(BAND, elastic_fraction=FRACTION), cells=CELLS)
SINE = replace(AT_ONCE, contact=replace(HOLONOMIC, friction=math.sin(math.radians(OMEGA))))


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64, 1 / 128), quick: bool = False) -> None:
    """Sweep the thickness; the band is Mohr-Coulomb's with slip planes parallel to S, unilateral, without cohesion.

    table.csv: loads at once, holonomic friction on S. table_history.csv: pressed, sheared, and sheared back while a part of
    S closes again; incremental friction on S. Elements are Q1 in both models. Contact acts at the nodes of S, the band at
    its quadrature points: `discretisation` in run.json is what this changes, the difference on S between contact and the
    band's own law on S.

    The band has one cell through the thickness and no elastic fraction. Its nodes are those of the bodies, which hold it
    where it is open or slides. Inner nodes would move freely in an open band: more cells need an elastic fraction h, and
    since contact on S has none, h adds an error of its own that does not vanish with eps, about 6e-4 (jump) for h = 1e-4,
    in proportion to h. table_cells.csv has four cells and h = 1e-5. Their errors differ from those of one cell by up to a
    half: how slip and opening are shared through the thickness is not determined, which changes the next term in eps. The
    order is the same.

    table_sine.csv is a control: friction sin(Omega) on S leaves an error that does not vanish.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh, without the four cells and the control's picture.
    """
    h, times = (1 / 64, TIMES[1::2]) if quick else (1 / 128, TIMES)
    cases = CASES | {"history": replace(CASES["history"], times=times)}
    tables = {}
    for case, comparison in cases.items():
        sweep = comparison.sweep(record, h, case)
        tables[case] = sweep.run(eps, (0.9, 1.1), title=f"frictional layer, {TITLES[case]}")
        _check_discretisation(record, case, comparison, h, tables[case])
        _check_zones(record, case, tables[case], h)
    if not quick:
        sweep = FINER.sweep(record, 2 * h, "cells")
        sweep.run(eps, (0.7, 1.3), title=f"frictional layer, {CELLS} cells through the thickness")
        _check_fraction(record, 2 * h, min(eps))
    control = replace(SINE.sweep(record, 2 * h, "sine"), more=None)
    sine = control.run(eps, None, pictured=None if quick else max, title="friction sin(Omega) on S")
    worst = sine["error_jump"][-1] / tables[""]["error_jump"][-1]
    record.check("friction sin(Omega) on S: last error of the jump over that with tan(Omega)", worst, low=2)


# ---------------------------------------------------------------- what is measured
def _noted(record: Record, case: str, full: Solution, limit: Solution) -> dict[str, Any]:
    """Solver, Newton steps and zones; writes the tractions along S."""
    profile = profile_of(last(full), last(limit), FRICTION)
    record.write(profile_name(case, float(layer_of(full).eps)), profile)
    row: dict[str, Any] = {"method": last(limit).report.method}
    row |= {"steps_band": newton_steps(full), "steps_contact": newton_steps(limit)}
    x = profile["x"]
    weights = np.diff(np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]]))
    for model in ("band", "contact"):
        status = np.array([str(one[f"status_{model}"]) for one in profile.rows])
        row |= {f"{name}_{model}": float(weights[status == name].sum()) for name in ("separated", "sliding")}
    return row


def newton_steps(solution: Solution) -> int:
    """Newton steps of a solve, or of all steps of a march."""
    return int(sum(solution.table["iterations"]) if isinstance(solution, History) else solution.report.iterations)


def _check_discretisation(record: Record, case: str, comparison: Comparison, h: float, table: Table) -> None:
    """Contact at nodes against the same law at quadrature points of S, and the errors on cells twice as large."""
    eps = float(table["eps"][-1])
    found = {name: float(table[f"error_{name}"][-1]) for name in ("traction", "jump")}
    sweep = comparison.sweep(record, h, case)
    contact, points = (
        _solved(Structure(sweep.joint, **sweep.setup).interface(layer), comparison.times)
        for layer in (comparison.contact, ThinLayer(comparison.band, eps, at=1.0))
    )
    surface = Surface(last(contact).model)
    lumping = {}
    for name, field in (("traction", surface.traction), ("jump", surface.jump)):
        wanted = field(last(contact))
        lumping[name] = surface.norm(field(last(points)) - wanted) / surface.norm(wanted)
    coarse = compare(*(_solved(model, comparison.times) for model in comparison.sweep(record, 2 * h, case).models(eps)))
    label = f", {case}" if case else ""
    noted: dict[str, Any] = {"case": case, "eps": eps, "h": h}
    for name, error in found.items():
        change = abs(error / coarse[f"error_{name}"] - 1)
        noted |= {f"nodes_{name}": lumping[name], f"coarse_{name}": coarse[f"error_{name}"]}
        what = f"nodes against quadrature points, {name} over the last error{label}"
        record.check(what, lumping[name] / error, high=0.2)
        record.check(f"last error of the {name}{label}, change from cells twice as large", change, high=0.2)
    record.results.setdefault("discretisation", []).append(noted)


def _solved(model: Model, times: Sequence[float] | None) -> Solution:
    return solve(model) if times is None else march(model, times, keep="last")


def _check_zones(record: Record, case: str, table: Table, h: float) -> None:
    """Stick, sliding and separation at once, and their ends in the thinnest band within two cells of the contact's."""
    label = f", {case}" if case else ""
    sizes = {name: table[f"{name}_contact"][-1] for name in ("separated", "sliding")}
    sizes["stick"] = 2.0 - sum(sizes.values())
    for name, size in sizes.items():
        record.check(f"length of S: {name}{label}", size, low=0.2)
    for name in ("separated", "sliding"):
        away = abs(table[f"{name}_band"][-1] - sizes[name])
        record.check(f"{name} zone{label}: thinnest band and contact differ by", away, high=2 * h + table["eps"][-1])


def _check_fraction(record: Record, h: float, eps: float) -> None:
    """Check how little the error on four cells through the layer changes with half the elastic fraction."""
    rows = []
    for fraction in (FRACTION, FRACTION / 2):
        sweep = replace(FINER, band=replace(BAND, elastic_fraction=fraction)).sweep(record, h, "cells")
        rows.append(compare(*map(solve, sweep.models(eps))))
    for name in ("traction", "jump"):
        one, half = (row[f"error_{name}"] for row in rows)
        what = f"{CELLS} cells: half the elastic fraction changes the error of the {name} by"
        record.check(what, half / one - 1, low=-0.1, high=0.1)


# ---------------------------------------------------------------- along S
NO_PRESSURE = 1e-3  # pressure, relative to the largest one, below which a node counts as separated
AT_LIMIT = 1e-2  # relative distance from the threshold at which a node counts as sliding


def profile_of(band: State, contact: State, friction: float) -> Table:
    """Place x, pressure, tangential traction and status of both models at the nodes of S, in 2D. Collective."""
    surface = Surface(contact.model)
    columns: dict[str, Any] = {}
    for name, state in (("band", band), ("contact", contact)):
        x, t = surface.profile(surface.frame(surface.traction(state)))
        columns |= {"x": x[:, 0], f"p_{name}": -t[:, 1], f"t_T_{name}": t[:, 0]}
        columns |= {f"status_{name}": statuses(t, friction)}
    return Table.of(columns)


def statuses(t: Array, friction: float) -> list[str]:
    """Status of nodes, from their tractions (n, 2) in the frame of S.

    It is found in the same way for both models. In a meshed layer zones end between two cells of different status.
    """
    p, shear = -t[:, 1], np.abs(t[:, 0])
    slides = shear >= (1 - AT_LIMIT) * friction * p
    found = np.where(p <= NO_PRESSURE * p.max(), "separated", np.where(slides, "sliding", "stick"))
    return [str(one) for one in found]


def profile_name(case: str, eps: float) -> str:
    """Name of the table for a case and a thickness."""
    return f"profile_{case}_{eps:g}.csv" if case else f"profile_{eps:g}.csv"


# ---------------------------------------------------------------- pictures
STATUS = ("stick", "sliding", "separated")
ALONG = {"status": "status", "p": "pressure", "t_T": "shear traction", "less": "band less contact"}


def draw(record: Record) -> None:
    """Draw the rates, and status, tractions, and how far apart they are, along S, from the tables."""
    draw_rates(record, "frictional layer", {t: c for c, t in TITLES.items() if record.has(table_of(c))}, apart=True)
    parts: dict[str, dict[str, tuple[Any, Any]]] = {}
    for case in CASES:
        shown = {what: parts.setdefault(f"{label}, {TITLES[case]}", {}) for what, label in ALONG.items()}
        for eps in record.load(table_of(case))["eps"]:
            table, name = record.load(profile_name(case, float(eps))), f"band, eps = {eps:.4g}"
            x, status, less = table["x"], _numbers(table, "band"), table["t_T_band"] - table["t_T_contact"]
            lines = {"status": status, "p": table["p_band"], "t_T": table["t_T_band"], "less": less}
            for what, line in lines.items():
                shown[what][name] = x, line
        for what, line in {"p": table["p_contact"], "t_T": table["t_T_contact"]}.items():
            shown[what][CONTACT] = x, line
        shown["status"][CONTACT] = x, _numbers(table, "contact")
    levels = {title: STATUS for title in parts if title.startswith("status")}
    styles, colours, save = {CONTACT: "--"}, {CONTACT: "black"}, record.path("along_S.png")
    plotting.curves(parts, "x along S", levels=levels, styles=styles, colours=colours, columns=len(ALONG), save=save)


def _numbers(table: Table, model: str) -> list[int]:
    return [STATUS.index(str(row[f"status_{model}"])) for row in table.rows]
