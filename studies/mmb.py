"""Mixed-mode bending: a lever opens and bends a beam with a crack, against Euler's beams on glue that softens.

A lever on the middle of the beam pulls up the end of the upper half, as it is loaded beyond the middle at the distance c.
By its statics the end has the force P c/L and the middle -P (c + L)/L, with half of the span L. So each half is opened by
P (3 c - L)/(4 L) and both are bent by P (c + L)/L: a longer lever has more opening. Where the load P falls, the path by
arc length follows it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from forms import Cohesive, LinearElastic
from geometry import sandwich
from studies.delamination import BEAMS, LOOK, ON_S, ROWS, SHARP, Beams, compare, path_table
from studies.enf import ARM, CRACK, HALF_SPAN, RTOL, E, K
from thinlayer import ArcLength, PointLoad, Probe, Structure, march, plotting
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support
from thinlayer.errors import SolveError
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track

GLUE = Cohesive(
    K, K, 30.0, 60.0, 0.3, 1.5, 2.0,
    cracked=lambda x: 1.0 * (x[0] < CRACK),  # type: ignore[arg-type]
)  # fmt: skip
LEVERS = (30.0, 45.0, 80.0)  # mm
LONGEST = 31.0  # mm, longest crack of beams
STEPS, FIRST = (40, 100), 0.06  # with --quick and without; first step of the load over the largest load of beams


def halves(c: float) -> Beams:
    """Return the beams for a lever of the length `c`."""
    opening, bending = (3 * c / HALF_SPAN - 1) / 4, c / HALF_SPAN + 1
    return Beams(GLUE, E, ARM, HALF_SPAN, CRACK, opening, bending)


def bend(c: float, h_S: float, first: float, steps: int) -> History:
    """Load the lever of length `c`, and follow the path until it has a number of steps, behind the largest load.

    The table of the history has the columns "displacement" of the load, and "force", too. Cells along S are `h_S` long.
    """
    joint = sandwich(2 * HALF_SPAN, ARM, ARM, ARM, h_S=h_S, cell="quadrilateral", structured=True)
    supports: dict[Place, Support] = {(0, -ARM): {"y": 0.0}, (2 * HALF_SPAN, -ARM): {"x": 0.0, "y": 0.0}}
    forces = {(0.0, ARM): c / HALF_SPAN, (HALF_SPAN, ARM): -c / HALF_SPAN - 1}
    loads = [
        PointLoad(place, partial(lambda factor, x, t: (0.0, t * factor), factor)) for place, factor in forces.items()
    ]
    model = Structure(joint, body=LinearElastic.young(E, 0.0), supports=supports, loads=loads).interface(GLUE)

    def displacement(state: State) -> float:
        return float(Probe(state).displacement([*forces])[:, 1] @ [*forces.values()])

    observe = {"displacement": displacement, "force": lambda state: state.t}
    try:
        return march(model, ArcLength(1e3 * first, first, largest=4, steps=steps, back=-first), observe=observe)
    except SolveError as error:  # after all steps
        return error.history


def run(record: Record, *, quick: bool = False) -> None:
    """Load levers of several lengths, and compare the paths with beams on glue that softens.

    table.csv has for each lever rows for the law on S and for beams: displacement of the load, load per width, length of
    the crack, and dissipated energy per width.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: cells of 1 mm along S, not of 0.5 mm, and fewer steps.
    """
    table = record.new_table("table.csv")
    for c in track(LEVERS, "mmb", "lever of {0:g} mm"):
        beams = halves(c).envelope(LONGEST)
        first = FIRST * beams["force"].max()
        history = bend(c, 1.0 if quick else 0.5, first, STEPS[0 if quick else 1])
        path = path_table(record.add_report(history), 2 * HALF_SPAN)
        for name, curve in ((BEAMS, beams), (ON_S, path)):
            table.extend({"lever": c, "curve": name, **row} for row in curve.rows)
        compare(record, path, beams, RTOL, f"lever of {c:g} mm: ")
        excess = halves(c).sharp(beams["crack"][ROWS:])[1] / beams["force"][ROWS:] - 1
        record.check(f"lever of {c:g} mm: force of sharp cracks over that of beams, less 1", excess.min(), low=0.04)


def draw(record: Record) -> None:
    """Draw loads over displacements, from table.csv in the folder of `record`."""
    panels = {}
    for c, rows in record.load("table.csv").split("lever").items():
        lines = {name: (curve["displacement"], curve["force"]) for name, curve in rows.split("curve").items()}
        panels[f"lever of {c:g} mm"] = lines | {SHARP: halves(c).sharp(np.linspace(CRACK, LONGEST, 20))}
    axes = "displacement of the load (mm)", "load per width (N/mm)"
    plotting.curves(panels, *axes, title="mixed-mode bending", save=record.path("mmb.svg"), **LOOK)
