"""Free ends of a layer: constants, solved on a half strip, and errors of the law of order 1 with and without them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np

from forms import BulkLaw, Incompressible, LinearElastic, Rubber
from forms.ends import FreeEnd, free_end
from forms.ends.constants import COLUMNS, nodes, shipped
from forms.ends.half_strip import DEGREE, LEVELS, half_strip
from geometry import sandwich
from thinlayer import Structure, ThinLayer, compare, observed_orders, plotting, solve
from thinlayer.discretisation import free_ends
from thinlayer.discretisation.free_ends import LEAST_CONTRAST
from thinlayer.errors import RangeWarning
from thinlayer.files.progress import track
from thinlayer.running.record import Record

RATIOS = (0.0, 0.1, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.475, 0.49, 0.499, 0.4999, 0.5)  # Poisson's
ROWS = 17  # of the package's table
BODY_E = 100.0
BODY = LinearElastic.young(BODY_E, nu=0.3)
LAYERS = {  # per thickness
    "elastic": LinearElastic.shear(40.0, 0.3),
    "rubber": Rubber.shear(40.0, 0.45),
    "incompressible": Incompressible(40.0),
}
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
TITLES = {"elastic": "nu = 0.3", "rubber": "rubber, nu = 0.45", "incompressible": "nu = 0.5"}
NAMES = {"known": "free", "ignored": "plain"}  # whether a law knows its free ends -> `ThinLayer.edges`
CONTRASTS = (10.0, 20.0, LEAST_CONTRAST, 80.0, 400.0)  # Young's modulus of the bodies over mu of the layer
SOFT_RATIOS, SOFT_EPS = (0.0, 0.3, 0.45), (1 / 16, 1 / 64)
QUANTITIES = ("traction", "jump", "work")
DRAWN = ("c_N", "rho_N", "m_N/c_N", "c_T", "m_T/c_T", "kappa")


def run(record: Record, *, nu: Sequence[float] = RATIOS, quick: bool = False) -> None:
    """Solve the half strip for some Poisson's ratios and those of the package's table, and measure the laws' errors.

    Args:
        record: where to write.
        nu: Poisson's ratios of the layer, from 0 to 0.5.
        quick: every other ratio, without the rows of the package's table, and fewer thicknesses.
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
    for law in LAYERS:
        for edges in NAMES:
            _rates(record, law, edges, EPS[:2] if quick else EPS)
    _contrasts(record, SOFT_RATIOS[::2] if quick else SOFT_RATIOS, SOFT_EPS[:1] if quick else SOFT_EPS)


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


def _errors(record: Record, law: BulkLaw, eps: float, laws: Sequence[str]) -> list[dict[str, float]]:
    """Relative errors of laws of order 1 between two blocks: on the inner half of S, and of the work of the loads.

    Args:
        record: where solves are noted.
        law: of the layer, per thickness.
        eps: the thickness.
        laws: what each knows of its ends, `ThinLayer.edges`.
    """
    joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral")
    blocks = Structure(joint, body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    full = record.solved(solve(blocks.full(ThinLayer(law, eps), cells_through=12)))
    found = []
    for edges in laws:
        with warnings.catch_warnings():  # of ends that a law does not know
            warnings.simplefilter("ignore", RangeWarning)
            limit = record.solved(solve(blocks.interface(ThinLayer(law, eps, order=1, edges=edges))))
        work = limit.energies()["loads"] / full.energies()["loads"]
        row = dict(compare(full, limit, where=lambda x: abs(x[0] - 0.5) < 0.25))
        found.append(row | {"error_work": abs(work - 1)})
    return found


def _rates(record: Record, name: str, edges: str, thicknesses: Sequence[float]) -> None:
    """Write the errors of a law over the thickness."""

    def run(eps: float) -> dict[str, float]:
        return _errors(record, LAYERS[name], eps, [NAMES[edges]])[0]

    table = record.sweep(run, thicknesses, f"errors_{name}_{edges}.csv")
    record.say(f"{TITLES[name]}, ends {edges}\n{table}")
    # errors of a pressure that ignores its ends change their signs: their orders are those of jumps alone
    for quantity in QUANTITIES if edges == "known" or name == "elastic" else ("jump",):
        order = observed_orders(table["eps"], table[f"error_{quantity}"])[-1] or math.nan
        bounds = {"low": 1.9 if name == "elastic" else 1.6} if edges == "known" else {"high": 1.1}
        record.check(f"{TITLES[name]}: last order of the {quantity}, ends {edges}", order, **bounds)


def _contrasts(record: Record, ratios: Sequence[float], thicknesses: Sequence[float]) -> None:
    """Write how many times as large errors are if the law knows its ends, for bodies that are not much stiffer.

    Such bodies are refused below `LEAST_CONTRAST`; here the limit itself is measured.
    """
    table = record.table("contrasts.csv")
    cases = [(nu, eps, contrast) for nu in ratios for eps in thicknesses for contrast in CONTRASTS]
    with patch.object(free_ends, "LEAST_CONTRAST", 0.0):
        for nu, eps, contrast in track(cases, "free_ends", "nu, eps, E/mu = {}"):
            law = LinearElastic.shear(BODY_E / contrast, nu).per_thickness(eps)
            known, ignored = _errors(record, law, eps, ["free", "plain"])
            row = {"nu": nu, "eps": eps, "E_over_mu": contrast}
            for quantity in QUANTITIES:
                row[quantity] = known[f"error_{quantity}"]
                row[f"{quantity}_factor"] = known[f"error_{quantity}"] / ignored[f"error_{quantity}"]
            table.append(row)
    record.say(table)
    factors = np.max([table[f"{quantity}_factor"] for quantity in QUANTITIES], axis=0)
    allowed = table["E_over_mu"] >= LEAST_CONTRAST
    record.check("largest factor of an error by known ends, where allowed", factors[allowed].max(), high=1.0)
    record.check("largest factor of an error by known ends, elsewhere", factors[~allowed].max(), low=2.0)


def draw(record: Record) -> None:
    """Draw the constants against nu; lines are the package's table. Then errors against the thickness."""
    for law in LAYERS:
        plotting.rates(
            {f"ends {edges}": record.load(f"errors_{law}_{edges}.csv") for edges in NAMES},
            reference=2.0,
            title=f"{TITLES[law]}, order 1, inner half of S between blocks with free sides",
            save=record.path(f"rates_{law}.png"),
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
