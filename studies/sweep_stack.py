"""Sublayers in series, Maxwell with Kelvin-Voigt and elastic with Norton, under a sudden load: error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from forms import KelvinVoigt, LinearElastic, Maxwell, Norton, Stack
from studies.sweeping import draw_rates, sweep_in_time
from thinlayer.running.record import Record

MODULI = {"lmbda": 60.0, "mu": 40.0}
LAYERS = {
    "": Stack((0.5, Maxwell(**MODULI, t1=0.7, t2=1.0)), (0.5, KelvinVoigt(**MODULI, theta_lmbda=0.3, theta_mu=0.5))),
    "norton": Stack((0.5, LinearElastic(**MODULI)), (0.5, Norton(**MODULI, eta=5.0, p=1.5))),
}
TIMES = {"": (0.2, 0.4, 0.6, 0.8, 1.0), "norton": (0.05, 0.1, 0.15, 0.2, 0.25)}


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64, 1 / 128), quick: bool = False) -> None:
    """Sweep the thickness; the meshed layer has a sublayer for each law, on S each point solves for their shares of [u].

    table.csv has the Maxwell and Kelvin-Voigt sublayers, table_norton.csv the elastic and Norton ones.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 32
    sweep_in_time(record, LAYERS, TIMES, eps, h, dict.fromkeys(LAYERS, "two sublayers"))


def draw(record: Record) -> None:
    """Draw the rates from the tables."""
    cases = {"Maxwell, Kelvin-Voigt": "table.csv", "elastic, Norton": "table_norton.csv"}
    draw_rates(record, title="two sublayers in series", cases=cases)
