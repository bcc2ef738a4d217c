"""Free ends of a layer: constants, solved on a half strip, and errors of the law of order 1 with and without them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np

from forms.ends import FreeEnd, free_end
from forms.ends.constants import COLUMNS, nodes, shipped
from forms.ends.half_strip import DEGREE, LEVELS, half_strip
from studies.end_structures import CASES, EDGE, EndCase, OfLength
from thinlayer import State, ThinLayer, compare, observed_orders, plotting, solve
from thinlayer.errors import RangeWarning
from thinlayer.files.progress import track
from thinlayer.files.table import Table
from thinlayer.running.record import Record

RATIOS = (0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49, 0.499, 0.4999, 0.5)  # Poisson's
ROWS = 17  # of the package's table
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
CELLS = (
    24  # across the thickness, and so near the ends: with 12 the mesh is an error of order 1.5 in the jump at nu = 0.45
)
CELLS_3D = 8
KNOWN, IGNORED = "known", "ignored"  # ends, by their first moments; laws that take the layer for an infinite one
LENGTHS = ("1", "2")  # known ends with strips of these lengths over the thickness
# strips of one thickness have no right moments: small terms of several orders, and the mesh's own error, mix at 1/128
LOWEST = {"1": 1.6}
WHAT = ("traction", "jump", "work")
DRAWN = ("c_N", "rho_N", "m_N/c_N", "c_T", "m_T/c_T", "kappa")


def run(record: Record, *, nu: Sequence[float] = RATIOS, quick: bool = False) -> None:
    """Solve the half strip for some Poisson's ratios, and for those of the package's table.

    Args:
        record: where to write.
        nu: Poisson's ratios of the layer, from 0 to 0.5.
        quick: every other ratio, without the rows of the package's table, one structure of two thicknesses.
    """
    record.parameters = {"degree": DEGREE, "levels": LEVELS}
    table = record.table("table.csv")
    for ratio in track(nu[::2] if quick else nu, "free_ends", "nu = {:g}"):
        found = half_strip(float(ratio))
        table.append(_row(found) | {"from_table": _difference(found)})
    record.say(Table({name: f"{value:.9g}" for name, value in row.items()} for row in table.rows))
    record.check("largest difference from the package's table", np.nanmax(table["from_table"]), high=1e-8)
    if not quick:
        _nodes(record)
        _rates(record, CASES, (KNOWN, *LENGTHS, IGNORED), EPS, CELLS)
        _rates(record, [EDGE], (KNOWN, IGNORED), EPS[:2], CELLS_3D)
    else:
        _rates(record, CASES[:1], (KNOWN, IGNORED), EPS[:2], CELLS // 2)


def _row(end: FreeEnd) -> dict[str, float]:
    """Constants that are finite for every ratio; nan where there are none."""
    bounded = 0 < end.nu < 0.5
    finite = {"c_N": end.c_N, "m_N/c_N": end.m_N / end.c_N if bounded else math.nan, "rho_N": end.rho_N}
    finite = {name: value if math.isfinite(value) else math.nan for name, value in finite.items()}
    return {"nu": end.nu, **finite, "c_T": end.c_T, "m_T/c_T": end.m_T / end.c_T, "kappa": end.kappa}


def _difference(found: FreeEnd) -> float:
    """Largest relative difference of the constants from those of the package's table."""
    table = free_end(found.nu)
    pairs = [(getattr(found, name), getattr(table, name)) for name in (*COLUMNS[1:], "kappa")]
    return max(abs(a / b - 1) for a, b in pairs if 0 < b < math.inf)


def _nodes(record: Record) -> None:
    """Solve for the rows of the package's table, and write them as it has them."""
    table = record.table("nodes.csv")
    for ratio in track(list(nodes(ROWS)), "free_ends", "row of the table, nu = {:g}"):
        found = half_strip(float(ratio))
        table.append({name: getattr(found, name) for name in COLUMNS})
    known = shipped()
    error = max(float(np.abs(table[name] / known[name] - 1).max()) for name in COLUMNS[1:])
    record.check("largest difference of a row from the package's table", error, high=1e-9)


def _errors(record: Record, case: EndCase, kinds: Sequence[str], thicknesses: Sequence[float], cells: int) -> Table:
    """Write errors of laws of order 1 on the inner part of S, and of the work of loads on top, by kind of ends."""

    def run(eps: float) -> dict[str, float]:
        structure, found = case.structure(eps, cells), {"eps": eps}
        full = record.solved(solve(structure.full(ThinLayer(case.law, eps, at=1.0), cells_through=cells)))
        for kind in kinds:
            edges = "plain" if kind == IGNORED else "free"
            law = OfLength(case.law.lmbda, case.law.mu, float(kind)) if kind in LENGTHS else case.law
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RangeWarning)  # that ends are ignored
                limit = record.solved(solve(structure.interface(ThinLayer(law, eps, order=1, edges=edges, at=1.0))))
            row = compare(full, limit, where=case.inner)
            work = _work_on_top(limit) / _work_on_top(full)
            errors = {"traction": row["error_traction"], "jump": row["error_jump"], "work": abs(work - 1)}
            found |= {_column(what, kind): error for what, error in errors.items()}
        return found

    return record.sweep(run, thicknesses, case.file)


def _work_on_top(state: State) -> float:
    """Work of the loads on top; that of a load on the layer's side has a part that no law on S knows, its own pull."""
    model = state.model
    given = model.structure.tractions or {}
    top = model.with_loads(tractions={"TOP": given["TOP"]})
    return state.integral(top.external_work(state.u, state.t))


def _column(what: str, kind: str) -> str:
    return f"error_{what}" + ("" if kind == KNOWN else f", {kind}")


def _rates(
    record: Record, cases: Sequence[EndCase], kinds: Sequence[str], thicknesses: Sequence[float], cells: int
) -> None:
    """Write the last errors and orders of structures with free ends, and check the orders."""
    rows = Table()
    for case in cases:
        table = _errors(record, case, kinds, thicknesses, cells)
        for kind in kinds:
            row: dict[str, float | str] = {"structure": case.name, "ends": kind, "eps": thicknesses[-1]}
            row |= {what: float(table[_column(what, kind)][-1]) for what in WHAT}
            for what in WHAT:
                order = observed_orders(table["eps"], table[_column(what, kind)])[-1] or math.nan
                row[f"order of {what}"] = order
                bounds = {"high": 1.3} if kind == IGNORED else {"low": LOWEST.get(kind, case.lowest)}
                record.check(f"{case.name}, ends {kind}: last order of the {what}", order, **bounds)
            rows.append(row)
    record.say(rows)


def draw(record: Record) -> None:
    """Draw the constants against nu; lines are the package's table. Then errors against the thickness."""
    table = record.load(CASES[0].file)
    shown = {}
    for kind in (KNOWN, IGNORED):
        columns = zip(table["eps"], *(table[_column(what, kind)] for what in WHAT[:2]), strict=True)
        shown[f"ends {kind}"] = Table(
            {"eps": eps, "error_traction": traction, "error_jump": jump} for eps, traction, jump in columns
        )
    plotting.rates(
        shown,
        reference=2.0,
        title="order 1, inner half of S between blocks with free sides, nu = 0.3",
        save=record.path("rates.png"),
    )
    table = record.load("table.csv")
    ratios = np.linspace(0.02, 0.4995, 200)
    lines = [_row(free_end(float(ratio))) for ratio in ratios]
    parts = {
        name: {"half strip": (table["nu"], table[name]), "table": (ratios, np.array([row[name] for row in lines]))}
        for name in DRAWN
    }
    plotting.panels(
        parts,
        xlabel="Poisson's ratio",
        ylabels={name: "" if name == "kappa" else "over the thickness" for name in DRAWN},
        styles={"half strip": "o", "table": "-"},
        colours={"half strip": "black", "table": "tab:blue"},
        ylims={"c_N": (0.0, 3.0), "rho_N": (0.0, 3.0), "m_N/c_N": (0.0, 4.0)},
        save=record.path("constants.png"),
    )
