"""Benchmark: cost and memory of bounds against the continuum, over the cost of a solve of the same structure."""

from __future__ import annotations

from functools import partial
from operator import itemgetter

from studies.dropped import ignore_range_warnings
from studies.performance import blocks, layer
from studies.timing import check_ratios, compared, peak, timed
from thinlayer import estimate, solve
from thinlayer.running.record import Record
from thinlayer.system.table import Row

CELLS, QUICK_CELLS = {2: 110, 3: 12}, 2  # along a side: about 100,000 and 50,000 unknowns of P2
LIMITS = {2: 4.0, 3: 12.0}  # dimension -> time of the bounds over that of a solve
COLUMNS = ("work", "dim", "unknowns", "seconds", "reference_seconds", "ratio", "limit", "peak_mb")


def run(record: Record, *, quick: bool = False) -> None:
    """Solve two blocks with a layer, and bound the compliance whatever the mesh; the least of two times counts.

    table.csv has the processor times, and the memory that the bounds take in addition.

    Args:
        record: where to write.
        quick: a small mesh, and times once.
    """
    table = record.new_table("table.csv")
    with ignore_range_warnings():
        for dim, cells in CELLS.items():
            cost(QUICK_CELLS, dim)  # forms are compiled
            table.append(min((cost(QUICK_CELLS if quick else cells, dim) for _ in range(2)), key=itemgetter("ratio")))
    check_ratios(record, () if quick else table)


def cost(cells: int, dim: int) -> Row:
    """Row of the bounds of the compliance, against the solve whose result they take."""
    model = blocks(cells, dim, "P2").interface(layer())
    reference, state = timed(partial(solve, model))
    result, seconds = estimate(state), list[float]()
    memory = peak(lambda: seconds.append(timed(result.continuum)[0]))
    row = {"dim": dim, "unknowns": model.unknowns, "seconds": seconds[0], "peak_mb": memory}
    row = compared("bounds for any mesh", row, "solve", {"seconds": reference}, LIMITS[dim])
    return {name: row[name] for name in COLUMNS}
