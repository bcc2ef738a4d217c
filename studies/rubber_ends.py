"""Free ends of rubbery layers: errors of the law of order 1 with and without them; how stiff bodies must be."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np

from forms import BulkLaw, Incompressible, LinearElastic, Rubber
from studies.problems import free_blocks
from studies.sweeping import errors_of_work, last_order
from thinlayer import ThinLayer, plotting, solve
from thinlayer.discretisation import reduction
from thinlayer.discretisation.reduction import LEAST_CONTRAST
from thinlayer.errors import RangeWarning
from thinlayer.running.record import Record
from thinlayer.system.progress import track

BODY_E = 100.0  # of `free_blocks`
LAYERS = {"rubber": Rubber.shear(40.0, 0.45), "incompressible": Incompressible(40.0)}  # at the thickness 1
EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128)
TITLES = {"rubber": "rubber, nu = 0.45", "incompressible": "nu = 0.5"}
NAMES = {"known": "free", "ignored": "plain"}  # whether a law knows its free ends -> `ThinLayer.edges`
CONTRASTS = (10.0, 20.0, LEAST_CONTRAST, 80.0, 400.0)  # Young's modulus of the bodies over mu of the layer
SOFT_RATIOS, SOFT_EPS = (0.0, 0.3, 0.45), (1 / 16, 1 / 64)  # Poisson's ratios of elastic layers, thicknesses
QUANTITIES = ("traction", "jump", "work")


def run(record: Record, *, quick: bool = False) -> None:
    """Solve blocks with a layer whose sides are free, meshed and by laws.

    Args:
        record: where to write.
        quick: fewer thicknesses and Poisson's ratios.
    """
    for law in LAYERS:
        for edges in NAMES:
            _rates(record, law, edges, EPS[:2] if quick else EPS)
    _contrasts(record, SOFT_RATIOS[::2] if quick else SOFT_RATIOS, SOFT_EPS[:1] if quick else SOFT_EPS)


def _errors(record: Record, law: BulkLaw, eps: float, laws: Sequence[str]) -> list[dict[str, float]]:
    """Relative errors of laws of order 1 between two blocks: on the inner half of S, and of the work of the loads.

    Args:
        record: where solves are noted.
        law: of the layer, at the thickness 1.
        eps: the thickness.
        laws: what each knows of its ends, `ThinLayer.edges`.
    """
    blocks, found = free_blocks(eps / 12), []
    full = record.solved(solve(blocks.full(ThinLayer(law, eps, at=1.0), cells_through=12)))
    for edges in laws:
        with warnings.catch_warnings(action="ignore", category=RangeWarning):  # of ends that a law does not know
            limit = record.solved(solve(blocks.interface(ThinLayer(law, eps, order=1, edges=edges, at=1.0))))
        found.append(errors_of_work(full, limit, lambda x: abs(x[0] - 0.5) < 0.25))
    return found


def _rates(record: Record, name: str, edges: str, thicknesses: Sequence[float]) -> None:
    """Write the errors of a law over the thickness."""

    def run(eps: float) -> dict[str, float]:
        return _errors(record, LAYERS[name], eps, [NAMES[edges]])[0]

    table = record.sweep(run, thicknesses, f"errors_{name}_{edges}.csv")
    # errors of a pressure that ignores its ends change their signs: their orders are those of jumps alone
    for quantity in QUANTITIES if edges == "known" else ("jump",):
        order = last_order(table, f"error_{quantity}")
        bounds = {"low": 1.6} if edges == "known" else {"high": 1.1}
        record.check(f"{TITLES[name]}: last order of the {quantity}, ends {edges}", order, **bounds)


def _contrasts(record: Record, ratios: Sequence[float], thicknesses: Sequence[float]) -> None:
    """Write how many times as large errors are if the law knows its ends, for bodies that are not much stiffer.

    Such bodies are refused below `LEAST_CONTRAST`; here the limit itself is measured.
    """
    table = record.table("contrasts.csv")
    cases = [(nu, eps, contrast) for nu in ratios for eps in thicknesses for contrast in CONTRASTS]
    with patch.object(reduction, "LEAST_CONTRAST", 0.0):
        for nu, eps, contrast in track(cases, "free_ends", "nu, eps, E/mu = {}"):
            law = LinearElastic.shear(BODY_E / contrast, nu).scaled(1 / eps)
            known, ignored = _errors(record, law, eps, ["free", "plain"])
            row = {"nu": nu, "eps": eps, "E_over_mu": contrast}
            for quantity in QUANTITIES:
                row[quantity] = known[f"error_{quantity}"]
                row[f"{quantity}_factor"] = known[f"error_{quantity}"] / ignored[f"error_{quantity}"]
            table.append(row)
    factors = np.max([table[f"{quantity}_factor"] for quantity in QUANTITIES], axis=0)
    allowed = table["E_over_mu"] >= LEAST_CONTRAST
    record.check("largest factor of an error by known ends, where allowed", factors[allowed].max(), high=1.0)
    record.check("largest factor of an error by known ends, elsewhere", factors[~allowed].max(), low=2.0)


def draw(record: Record) -> None:
    """Draw the errors against the thickness."""
    for law in LAYERS:
        plotting.rates(
            {f"ends {edges}": record.load(f"errors_{law}_{edges}.csv") for edges in NAMES},
            reference=2.0,
            title=f"{TITLES[law]}, order 1, inner half of S between blocks with free sides",
            save=record.path(f"rates_{law}.png"),
        )
