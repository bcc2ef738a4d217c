"""Layer whose thickness varies along S: a wedge between two blocks, error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from studies.problems import FOURIER_LAYER, fourier
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

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
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(FOURIER_LAYER, e, profile=wedge, at=1.0), bodies="extended")
    sweep.run(eps, (0.9, 1.1), title="wedge between two blocks")


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="wedge between two blocks")
