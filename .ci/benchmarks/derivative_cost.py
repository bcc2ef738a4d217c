"""Benchmark: cost of derivatives by one more parameter, as fields and along marches, over that of a solve or march."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from forms import LinearElastic, VonMises
from forms.law import BulkLaw
from studies.dropped import ignore_range_warnings
from studies.performance import SIZES, blocks
from studies.timing import check_ratios, compared, in_turn, timed
from thinlayer import ThinLayer, derivative, goals, march, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.estimating.derivative import Derivative
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.table import Row

ELASTIC, PLASTIC = LinearElastic(3.0, 2.0), VonMises(3.0, 2.0, strength=0.43, hardening=1.0)
CELLS, ELEMENT = {2: 60, 3: SIZES[3][-1]}, {2: "P2", 3: "P1"}  # about 30,000 and 300,000 unknowns
SMALL = 4
FIRST, MORE = "S.eps", {"layer": "S.E", "body": "UPPER.E", "load": "load TOP"}
OF_MARCH, TIMES = ("S.mu", "S.strength", "S.hardening", "S.eps"), [k / 8 for k in range(1, 9)]
# over the seconds of the solve or march; bodies' stiffness is assembled anew for both ends of a difference
LIMITS = {"by one parameter": 3.0, "a field": 1.0}
MORE_LIMITS, FOUR, MARCH_LIMIT = {"layer": 0.5, "body": 0.5, "load": 0.5}, "by four parameters", 1.5
COLUMNS = ("work", "dim", "unknowns", "reference", "seconds", "reference_seconds", "ratio", "limit")


def run(record: Record, *, quick: bool = False) -> None:
    """Measure derivatives of a displacement in two blocks under a traction; the least of several times counts.

    Works run in turn, so that a busy machine slows all of them. Forms are compiled before, on a small mesh. The time by
    one more parameter is the difference between derivatives by two parameters and by one.

    Args:
        record: where to write.
        quick: small meshes, one repeat.
    """
    table = record.new_table("table.csv")
    with ignore_range_warnings():
        for dim, cells in CELLS.items():
            of_solve(dim, SMALL, 1)
            table.extend(of_solve(dim, 2 * SMALL if quick else cells, 1 if quick else 2))
        of_march(SMALL, 1)
        table.extend(of_march(2 * SMALL if quick else CELLS[2], 1 if quick else 2))
    check_ratios(record, () if quick else table)


class Works:
    """Works on one model that are to be run in turn: a solve or march, then derivatives of its result.

    Args:
        dim: number of dimensions.
        cells: number of cells along each side.
        law: law of the layer.

    Attributes:
        unknowns: number of unknowns of the model.
    """

    _solution: State | History
    _result: Derivative

    def __init__(self, dim: int, cells: int, law: BulkLaw) -> None:
        load = (0.5, 1.0, 0.0)[:dim]
        structure = blocks(cells, dim, ELEMENT[dim], lambda x, t: tuple(c * t for c in load))
        self._dim, self._new_model = dim, partial(structure.interface, ThinLayer(law, 0.01))
        self._corner = goals.Displacement((1.0, 0.5, 1.0)[:dim], (0.0, 1.0, 0.0)[:dim])
        self.unknowns = self._new_model().unknowns

    def solution(self, compute: Callable[[InterfaceModel], State | History]) -> float:
        """Return the seconds that it takes to compute the solution of a new model."""
        model = self._new_model()
        seconds, self._solution = timed(lambda: compute(model))
        return seconds

    def derivative(self, *names: str) -> float:
        """Return the seconds that derivatives by parameters take."""
        seconds, self._result = timed(lambda: derivative(self._solution, self._corner, names))
        return seconds

    def field(self) -> float:
        """Return the seconds that the first field of the last derivatives takes."""
        return timed(lambda: self._result.field(FIRST))[0]

    def rows(self, reference: str, seconds: float, works: Mapping[str, tuple[float, float]]) -> list[Row]:
        """Return rows of the table, for the seconds and the limit of each work, and for the seconds of a reference."""
        of = {"dim": self._dim, "unknowns": self.unknowns}
        rows = list[Row]()
        for work, (spent, limit) in works.items():
            row = compared(work, of | {"seconds": spent}, reference, {"seconds": seconds}, limit)
            rows.append({name: row[name] for name in COLUMNS})
        return rows


def of_solve(dim: int, cells: int, repeats: int) -> list[Row]:
    """Compare derivatives of a state with its solve."""
    works = Works(dim, cells, ELASTIC)
    calls = {"solve": partial(works.solution, solve), "by one parameter": partial(works.derivative, FIRST)}
    calls |= {"a field": works.field, "again": partial(works.derivative, FIRST)}
    calls |= {kind: partial(works.derivative, FIRST, name) for kind, name in MORE.items()}
    seconds = in_turn(calls, repeats)
    rows = {work: (seconds[work], limit) for work, limit in LIMITS.items() if work in seconds}
    rows |= {f"one more, of a {kind}": (seconds[kind] - seconds["again"], MORE_LIMITS[kind]) for kind in MORE}
    return works.rows("solve", seconds["solve"], rows)


def of_march(cells: int, repeats: int) -> list[Row]:
    """Compare the derivatives of the end of a march with the march."""
    works = Works(2, cells, PLASTIC)
    calls = {"march": partial(works.solution, partial(march, times=TIMES)), FOUR: partial(works.derivative, *OF_MARCH)}
    seconds = in_turn(calls, repeats)
    return works.rows("march", seconds["march"], {FOUR: (seconds[FOUR], MARCH_LIMIT)})
