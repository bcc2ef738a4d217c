"""Layer whose thickness varies along S: a wedge between two blocks, error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Model, ThinLayer, compare, plotting, solve, sweep
from thinlayer.record import Record

EPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64)


def wedge(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Thickness over the mean thickness: three times as thick at the right end as at the left one."""
    return 0.5 + x[0]


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the mean thickness with the moduli over it held.

    The interface law's stiffness is that of the glue over the thickness at each place.

    Args:
        record: where to write.
        eps: mean thicknesses; the blocks are 1 wide and 0.5 high, layer included.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 32
    joint, setup = fourier(h)
    record.parameters = {"h": h, "layer": str(FOURIER_LAYER), "thickness": "eps (0.5 + x)"}
    pictured = max(eps)

    def compare_at(e: float) -> dict[str, float]:
        layer = ThinLayer(FOURIER_LAYER, e, profile=wedge)
        full = record.solved(solve(Model.full(joint, layer=layer, bodies="extended", **setup)))
        limit = record.solved(solve(Model.interface(joint, layer=layer, **setup)))
        if e == pictured:
            states = {f"meshed wedge, mean thickness {e:g}": full, "interface law": limit}
            plotting.deformed(states, save=record.path("deformed.png"))
        return compare(full, limit)

    table = sweep(compare_at, eps, record.path("table.csv"))
    draw(record)
    record.say(table)
    if len(eps) > 1:
        for name in ("traction", "jump"):
            record.check(f"last observed order of the {name}", table[f"order_{name}"][-1], low=0.9, high=1.1)


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    if record.root:
        plotting.rates(record.path("table.csv"), save=record.path("rates.png"), title="wedge between two blocks")
