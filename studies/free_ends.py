"""Free ends of a layer: constants, solved on a half strip, and errors of the law of order 1 with and without them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from forms import LinearElastic
from forms.ends import FreeEnd, free_end
from forms.ends.constants import COLUMNS, nodes, shipped
from forms.ends.half_strip import DEGREE, LEVELS, half_strip
from geometry import sandwich
from thinlayer import Structure, ThinLayer, compare, observed_orders, plotting, solve
from thinlayer.files.progress import track
from thinlayer.running.record import Record

RATIOS = (0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49, 0.499, 0.4999, 0.5)  # Poisson's
ROWS = 17  # of the package's table
BODY, LAYER = LinearElastic.young(E=100.0, nu=0.3), LinearElastic.shear(40.0, 0.3)
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
NAMES = {"known": "free", "ignored": None}  # whether a law knows its free ends -> `ThinLayer.edges`
DRAWN = ("c_N", "rho_N", "m_N/c_N", "c_T", "m_T/c_T", "kappa")


def run(record: Record, *, nu: Sequence[float] = RATIOS, quick: bool = False) -> None:
    """Solve the half strip for some Poisson's ratios, and for those of the package's table.

    Args:
        record: where to write.
        nu: Poisson's ratios of the layer, from 0 to 0.5.
        quick: every other ratio, without the rows of the package's table, and two thicknesses.
    """
    record.parameters = {"degree": DEGREE, "levels": LEVELS}
    table = record.table("table.csv")
    for ratio in track(nu[::2] if quick else nu, "free_ends", "nu = {:g}"):
        found, second = half_strip(float(ratio))
        table.append(_row(found) | _differences(found, second))
    record.say(table)
    record.check("largest difference from the package's table", np.nanmax(table["from_table"]), high=1e-8)
    record.check("largest difference of c_T from tractions", table["c_T_from_middle"].max(), high=1e-5)
    well = (table["nu"] >= 0.1) & (table["nu"] < 0.5)  # below, c_N itself is lost in the traction
    record.check("largest difference of c_N from tractions", table["c_N_from_middle"][well].max(), high=5e-5)
    if not quick:
        _nodes(record)
    for edges in NAMES:
        _errors(record, edges, EPS[:2] if quick else EPS)


def _row(end: FreeEnd) -> dict[str, float]:
    """Constants that are finite for every ratio; nan where there are none."""
    bounded = 0 < end.nu < 0.5
    finite = {"c_N": end.c_N, "m_N/c_N": end.m_N / end.c_N if bounded else math.nan, "rho_N": end.rho_N}
    finite = {name: value if math.isfinite(value) else math.nan for name, value in finite.items()}
    return {"nu": end.nu, **finite, "c_T": end.c_T, "m_T/c_T": end.m_T / end.c_T, "kappa": end.kappa}


def _differences(found: FreeEnd, second: dict[str, float]) -> dict[str, float]:
    """Relative differences of constants: from the package's table, and from the tractions on the middle line."""
    table = free_end(found.nu)
    pairs = [(getattr(found, name), getattr(table, name)) for name in (*COLUMNS[1:], "kappa")]
    distance = [abs(a / b - 1) for a, b in pairs if 0 < b < math.inf]
    c_N = abs(second["c_N"] / found.c_N - 1) if 0 < found.nu < 0.5 else math.nan
    return {"from_table": max(distance), "c_N_from_middle": c_N, "c_T_from_middle": abs(second["c_T"] / found.c_T - 1)}


def _nodes(record: Record) -> None:
    """Solve for the rows of the package's table, and write them as it has them."""
    table = record.table("nodes.csv")
    for ratio in track(list(nodes(ROWS)), "free_ends", "row of the table, nu = {:g}"):
        found, _ = half_strip(float(ratio))
        table.append({name: getattr(found, name) for name in COLUMNS})
    known = shipped()
    error = max(float(np.abs(table[name] / known[name] - 1).max()) for name in COLUMNS[1:])
    record.check("largest difference of a row from the package's table", error, high=1e-9)


def _errors(record: Record, edges: str, thicknesses: Sequence[float]) -> None:
    """Write the errors of the law of order 1 on the inner half of S between two blocks, and of the work of the loads."""

    def run(eps: float) -> dict[str, float]:
        joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral")
        blocks = Structure(joint, body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
        full = record.solved(solve(blocks.full(ThinLayer(LAYER, eps), cells_through=12)))
        limit = record.solved(solve(blocks.interface(ThinLayer(LAYER, eps, order=1, edges=NAMES[edges]))))
        work = limit.energies()["loads"] / full.energies()["loads"]
        return dict(compare(full, limit, where=lambda x: abs(x[0] - 0.5) < 0.25)) | {"error_work": abs(work - 1)}

    table = record.sweep(run, thicknesses, f"errors_{edges}.csv")
    record.say(table)
    for name in ("traction", "jump", "work"):
        order = observed_orders(table["eps"], table[f"error_{name}"])[-1] or math.nan
        bounds = {"low": 1.9} if NAMES[edges] else {"high": 1.1}
        record.check(f"last order of the {name}, ends {edges}", order, **bounds)


def draw(record: Record) -> None:
    """Draw the constants against nu; lines are the package's table. Then errors against the thickness."""
    plotting.rates(
        {f"ends {edges}": record.load(f"errors_{edges}.csv") for edges in NAMES},
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
