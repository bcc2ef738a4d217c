"""Maxwell layer between two blocks under a sudden load, one or two relaxation times: error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from forms import Maxwell
from studies.problems import fourier
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

LAYERS = {
    "": Maxwell(lmbda=60.0, mu=40.0, t1=0.7, t2=1.0),  # the mean stress relaxes with the time 1.04
    "t1": Maxwell(lmbda=60.0, mu=40.0, t1=0.7),
}
TIMES = (0.2, 0.4, 0.6, 0.8, 1.0)


def run(record: Record, *, eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64), quick: bool = False) -> None:
    """Sweep the thickness with the moduli over thickness and the times held; both models take the same steps.

    table.csv has t2 != t1, where the normal traction on S has two parts that relax differently; table_t1.csv t2 = t1.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    record.parameters = {"h": h, "layers": [str(law) for law in LAYERS.values()], "times": TIMES}
    for case, law in LAYERS.items():
        sweep = Sweep(record, joint, setup, partial(ThinLayer, law), times=TIMES, case=case)
        sweep.run(eps, (0.93, 1.07), title=f"Maxwell layer, t = {TIMES[-1]:g}")


def draw(record: Record) -> None:
    """Draw the rates from the tables."""
    cases = {"t2 = 1.0": "table.csv", "t2 = t1": "table_t1.csv"}
    draw_rates(record, title="Maxwell layer, t1 = 0.7", cases=cases)
