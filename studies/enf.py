"""End-notched flexure: a bent beam with a crack that slides and closes, against Euler's beams on glue that softens.

The lower and the upper half of a beam on two supports slide on each other, and the crack grows in shear. Its sides press
on each other near the support. Beyond a peak the path turns back in force and displacement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from forms import Cohesive, LinearElastic
from geometry import sandwich
from studies.delamination import BEAMS, LOOK, ON_S, ROWS, SHARP, Beams, check_sharp, compare, path_table, precrack
from thinlayer import ArcLength, PointLoad, Structure, march, plotting
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.supports import Place, Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History

HALF_SPAN, ARM, CRACK = 50.0, 1.5, 25.0  # mm: of the beam, whose width is 1; height of a half; length of the precrack
E = 120e3  # MPa, of the beam, whose Poisson's ratio is 0
K, STRENGTH, TOUGHNESS = 1e5, 60.0, 1.5  # of the glue: MPa/mm, MPa, N/mm
GLUE = Cohesive(K, K, STRENGTH, STRENGTH, TOUGHNESS, TOUGHNESS, cracked=precrack(CRACK))
HALVES = Beams(GLUE, E, ARM, HALF_SPAN, CRACK, bending=1.0)
END = 3.6  # mm, deflection at which the path ends after its turn
LONGEST = 38.0  # mm, longest crack of beams
RTOL = 0.03  # largest distance from beams, relative


def flexure(
    glue: Cohesive, h: float, h_S: float, loaded: Mapping[Place, Support], loads: Sequence[PointLoad] = ()
) -> InterfaceModel:
    """Make the beam on two supports, with the law on S.

    Args:
        glue: the law.
        h, h_S: cell sizes inside the beam and along S.
        loaded: prescribed displacements of places that are loaded.
        loads: forces.
    """
    joint = sandwich(2 * HALF_SPAN, ARM, ARM, h, h_S=h_S, cell="quadrilateral", structured=True)
    supports: dict[Place, Support] = {(0, -ARM): {"y": 0.0}, (2 * HALF_SPAN, -ARM): {"x": 0.0, "y": 0.0}, **loaded}
    return Structure(joint, body=LinearElastic.young(E, 0.0), supports=supports, loads=loads).interface(glue)


def bend(h_S: float) -> History:
    """Bend the beam with the law on S until its deflection is `END` behind the turn of the path.

    The table of the history has the columns "displacement" and "force", too. Cells along S are `h_S` long.
    """
    top = (HALF_SPAN, ARM)
    model = flexure(GLUE, ARM / 2, h_S, {top: {"y": lambda x, t: -t}})
    observe = {"displacement": lambda state: state.t, "force": lambda state: -state.reaction(top).force[1]}
    return march(model, ArcLength(end=END, first=0.2, largest=4), observe=observe, keep="last")


def run(record: Record, *, quick: bool = False) -> None:
    """Bend the beam until the path has turned back and forth, and compare it with beams on glue that softens.

    table.csv has rows for the law on S and for beams: deflection, force per width, length of the crack, and dissipated
    energy per width.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: cells of 1 mm along S, not of 0.5 mm.
    """
    path = path_table(record.add_report(bend(1.0 if quick else 0.5)), 2 * HALF_SPAN)
    beams, table = HALVES.envelope(LONGEST), record.new_table("table.csv")
    for name, curve in ((BEAMS, beams), (ON_S, path)):
        table.extend({"curve": name, **row} for row in curve.rows)
    compare(record, path, beams, RTOL)
    turns = [-np.minimum(np.diff(curve["displacement"]), 0).sum() for curve in (path, beams)]
    record.check_near("deflection by which the path turns back, over that of beams", turns[0] / turns[1], 1.0, 0.2)
    energy = np.interp(-path["force"][-1], -beams["force"][ROWS:], beams["dissipated"][ROWS:])
    record.check_near("dissipated energy over that of beams", path["dissipated"][-1] / energy, 1.0, RTOL)
    check_sharp(record, HALVES, beams, 0.1)


def draw(record: Record) -> None:
    """Draw force over deflection, from table.csv in the folder of `record`."""
    curves = record.load("table.csv").split("curve")
    curves[SHARP] = HALVES.sharp(np.linspace(CRACK, LONGEST, 40))
    panels = {"a crack of 25 mm": "force", "its growth": "force"}
    limits = {"xlim": dict(zip(panels, ((0.0, 4.1), (3.4, 3.65)), strict=True))}
    limits["ylim"] = dict(zip(panels, ((0.0, 40.0), (24.0, 37.0)), strict=True))
    axes, look = ("deflection under the load (mm)", "force per width (N/mm)"), LOOK | limits
    look["title"], look["save"] = "end-notched flexure", record.path("enf.svg")
    plotting.load_displacement(curves, "displacement", panels, *axes, **look)
