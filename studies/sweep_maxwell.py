"""Maxwell layer between two blocks under a sudden load, one or two relaxation times: error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from forms import Maxwell
from studies.sweeping import draw_rates, sweep_in_time
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
    h, titles = 1 / 8 if quick else 1 / 32, dict.fromkeys(LAYERS, "Maxwell layer")
    sweep_in_time(record, LAYERS, dict.fromkeys(LAYERS, TIMES), eps, h, titles)


def draw(record: Record) -> None:
    """Draw the rates from the tables."""
    cases = {"t2 = 1.0": "table.csv", "t2 = t1": "table_t1.csv"}
    draw_rates(record, title="Maxwell layer, t1 = 0.7", cases=cases)
