"""Kelvin-Voigt layer between two blocks under a sudden load: the interface law's error is O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from forms import KelvinVoigt
from studies.sweeping import draw_rates, sweep_in_time
from thinlayer.running.record import Record

LAYER = KelvinVoigt(lmbda=60.0, mu=40.0, theta_lmbda=0.3, theta_mu=0.5)
TIMES = (0.1, 0.2, 0.3, 0.4, 0.5)  # the jump is still a fifth short of the elastic one


def run(record: Record, *, eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64), quick: bool = False) -> None:
    """Sweep the thickness with the moduli over thickness and the times held; both models take the same steps.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 32
    sweep_in_time(record, {"": LAYER}, {"": TIMES}, eps, h, {"": "Kelvin-Voigt layer"})


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="Kelvin-Voigt layer")
