"""Elastic layer between two blocks: the interface law's error is O(eps)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from studies.problems import FOURIER_LAYER, fourier
from studies.sweeping import Sweep, middle
from thinlayer import ThinLayer, plotting
from thinlayer.running.record import Record


def run(
    record: Record,
    *,
    eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64),
    bodies: Literal["kept", "extended"] = "kept",
    order: Literal[0, 1] = 0,
    quick: bool = False,
) -> None:
    """Sweep the thickness with the moduli over thickness held.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        bodies: "kept" or "extended".
        order: of the interface law, 0 or 1.
        quick: coarser mesh.
    """
    h = (1 / 8, 1 / 16)[order] if quick else 1 / 32
    joint, setup = fourier(h)
    record.parameters = {"h": h, "layer": str(FOURIER_LAYER), "bodies": bodies, "order": order}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(FOURIER_LAYER, e, order=order, at=1.0), bodies=bodies)
    ends = ((0.95, 1.05), (1.9, 2.1))[order]
    sweep.run(eps, ends, pictured=middle)


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    table = record.load("table.csv")
    slope = 2.0 if table["order_traction"][-1] > 1.5 else 1.0
    title = "elastic layer between two blocks"
    plotting.rates(table, save=record.path("rates.png"), title=title, reference=slope)
