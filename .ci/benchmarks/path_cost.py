"""Benchmark: cost of a step along the path of a joint that breaks, over that of a linear solve of the same mesh."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from forms import LinearElastic
from studies import dcb
from studies.dropped import ignore_range_warnings
from studies.timing import check_ratios, compared, timed_in_turn
from thinlayer import ArcLength, ThinLayer, march, solve
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.solving.history import History

PATH = ArcLength(end=0.7, first=0.1)  # mm
CELLS, QUICK_CELLS = 20, 2  # over the height of an arm: about 100,000 and 1,000 unknowns
STIFF = LinearElastic.young(dcb.E, dcb.NU)  # MPa
LIMIT, COLUMNS = 4.0, ("work", "unknowns", "newton", "seconds", "reference_seconds", "ratio", "limit")


def run(record: Record, *, quick: bool = False) -> None:
    """Peel a double cantilever beam, and solve it with an elastic layer in turn; the least of two times counts.

    table.csv has the processor time per step of the path, and its Newton steps.

    Args:
        record: where to write.
        quick: a small mesh, and times once.
    """
    table = record.new_table("table.csv")
    with ignore_range_warnings():
        step_cost(QUICK_CELLS, 1)  # forms are compiled
        table.append(step_cost(QUICK_CELLS if quick else CELLS, 1 if quick else 2))
    check_ratios(record, () if quick else table)


def step_cost(cells: int, repeats: int) -> dict[str, str | float]:
    """Row of a step of the path: its time is that of the whole path over its number of steps."""
    h = dcb.ARM / cells
    breaking, elastic = (dcb.arms(h, h).interface(ThinLayer(law, dcb.EPS)) for law in (dcb.GLUE, STIFF))
    path, linear = partial(march, breaking, PATH, keep="last"), partial(solve, elastic, 0.7)
    works: dict[str, Callable[[], History | State]] = {"path": path, "linear": linear}
    (took, history), (reference, _) = timed_in_turn(works, repeats).values()
    assert isinstance(history, History)
    steps, newton = len(history) - 1, sum(history.table["iterations"][1:])
    row = {"unknowns": breaking.unknowns, "seconds": took / steps}
    row = compared("step of a path that breaks", row, "linear solve", {"seconds": reference}, LIMIT)
    return {name: row[name] for name in COLUMNS if name in row} | {"newton": newton / steps}
