"""Benchmark: cost of a step along the path of a joint that breaks, over that of a linear solve of the same mesh."""

from __future__ import annotations

from functools import partial

from forms import Breaking, LinearElastic
from geometry import sandwich
from studies.dropped import ignore_range_warnings
from studies.sweeping import timed
from studies.timing import compared, in_turn
from thinlayer import ArcLength, Structure, ThinLayer, march, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History

LENGTH, ARM, CRACK = 48.0, 3.0, 30.0  # mm: of the beam, height of each arm, crack
STEEL = LinearElastic.young(E=70e3, nu=0.3)  # MPa
GLUE = Breaking(0.0, 500.0, 20.0, 30.0, 3.0, 9.0, eta=2.0, cracked=lambda x: 1.0 * (x[0] < CRACK))
PATH = ArcLength(end=0.7, first=0.1)  # mm
CELLS, QUICK_CELLS = 20, 2  # over the height of an arm: about 100,000 and 1,000 unknowns
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
        table.append(row := step_cost(QUICK_CELLS if quick else CELLS, 1 if quick else 2))
    if not quick:
        record.check(f"linear solves per step of the path, {row['unknowns']} unknowns", float(row["ratio"]), high=LIMIT)


def peeled(cells: int, layer: ThinLayer) -> InterfaceModel:
    """A double cantilever beam whose arms are lifted and lowered by t."""
    joint = sandwich(LENGTH, ARM, ARM, ARM / cells, cell="quadrilateral", structured=True)
    ends: dict[Place, Support] = {(0, s * ARM): {"y": lambda x, t, s=s: s * t} for s in (1, -1)}
    ends |= {(LENGTH, s * ARM): {"x": 0.0} for s in (1, -1)}
    return Structure(joint, body=STEEL, supports=ends).interface(layer)


def step_cost(cells: int, repeats: int) -> dict[str, str | float]:
    """Row of a step of the path: its time is that of the whole path over its number of steps."""
    breaking, elastic = peeled(cells, ThinLayer(GLUE, 0.1)), peeled(cells, ThinLayer(STEEL, 0.1))
    path, linear = partial(march, breaking, PATH, keep="last"), partial(solve, elastic, 0.7)
    works: dict[str, partial[tuple[float, History | State]]]
    works = {"path": partial(timed, path), "linear": partial(timed, linear)}
    (took, history), (reference, _) = in_turn(works, repeats, lambda result: result[0]).values()
    assert isinstance(history, History)
    steps, newton = len(history) - 1, sum(history.table["iterations"][1:])
    row = {"unknowns": breaking.unknowns, "seconds": took / steps}
    row = compared("step of a path that breaks", row, "linear solve", {"seconds": reference}, LIMIT)
    return {name: row[name] for name in COLUMNS if name in row} | {"newton": newton / steps}
