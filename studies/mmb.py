"""Mixed-mode bending: a lever opens and bends a beam with a crack, against Euler's beams on glue that softens.

A lever on the middle of the beam pulls up the end of the upper half, as it is loaded beyond the middle at the distance c.
By its statics the end has the force P c/L and the middle -P (c + L)/L, with half of the span L. So each half is opened by
P (3 c - L)/(4 L) and both are bent by P (c + L)/L: a longer lever has more opening. Where the load P falls, the path by
arc length follows it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from forms import Cohesive
from studies.delamination import BEAMS, LOOK, ON_S, SHARP, Beams, check_sharp, compare, path_table, precrack
from studies.enf import ARM, CRACK, HALF_SPAN, RTOL, E, K, flexure
from thinlayer import ArcLength, PointLoad, Probe, march, plotting
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track

GLUE = Cohesive(K, K, 30.0, 60.0, 0.3, 1.5, 2.0, cracked=precrack(CRACK))
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
    forces = {(0.0, ARM): c / HALF_SPAN, (HALF_SPAN, ARM): -c / HALF_SPAN - 1}
    loads = [
        PointLoad(place, partial(lambda factor, x, t: (0.0, t * factor), factor)) for place, factor in forces.items()
    ]

    def displacement(state: State) -> float:
        return float(Probe(state).displacement([*forces])[:, 1] @ [*forces.values()])

    observe = {"displacement": displacement, "force": lambda state: state.t}
    model = flexure(GLUE, ARM, h_S, {}, loads)
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
        check_sharp(record, halves(c), beams, 0.04, f"lever of {c:g} mm: ")


def draw(record: Record) -> None:
    """Draw loads over displacements, from table.csv in the folder of `record`."""
    panels = {}
    for c, rows in record.load("table.csv").split("lever").items():
        curves = rows.split("curve") | {SHARP: halves(c).sharp(np.linspace(CRACK, LONGEST, 20))}
        panels[f"lever of {c:g} mm"] = {name: (curve["displacement"], curve["force"]) for name, curve in curves.items()}
    axes = "displacement of the load (mm)", "load per width (N/mm)"
    plotting.curves(panels, *axes, title="mixed-mode bending", save=record.path("mmb.svg"), **LOOK)
