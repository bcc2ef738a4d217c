"""Double cantilever beam that is peeled apart: a layer that breaks, on S and meshed, against Timoshenko's beams.

Both arms are lifted at their ends, and a crack runs along the glue. The glue first resists like springs. Beyond its
strength the traction falls linearly to zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from forms import Breaking, Cohesive, LinearElastic
from geometry import sandwich
from studies.delamination import BEAMS, LOOK, MESHED, ON_S, SHARP, Beams, compare, path_table, precrack
from thinlayer import ArcLength, Structure, Table, ThinLayer, march, plotting
from thinlayer.discretisation.supports import Place, Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History

LENGTH, ARM, CRACK = 48.0, 3.0, 30.0  # mm: of the specimen, whose width is 1; height of an arm; length of the precrack
E, NU = 70e3, 0.3  # of the arms, MPa
EPS, STRENGTHS, TOUGHNESSES = 0.1, (20.0, 30.0), (0.3, 0.9)  # of the glue in opening and shear: mm, MPa, N/mm
MODULUS = 1e3  # MPa, of the glue in opening: its stiffness is MODULUS/EPS
GLUE = Breaking(0.0, MODULUS / 2, *STRENGTHS, TOUGHNESSES[0] / EPS, TOUGHNESSES[1] / EPS, cracked=precrack(CRACK))
END = 1.5  # mm, largest opening of the ends of the arms
ARMS = Beams(
    Cohesive(MODULUS / EPS, MODULUS / EPS / 2, *STRENGTHS, *TOUGHNESSES), E / (1 - NU**2), ARM, LENGTH, CRACK,
    opening=1.0, shear=E / (2 * (1 + NU)) * ARM * 5 / 6,
)  # fmt: skip
BEAM_RTOL = 0.01  # largest distance from beams, relative
MESHED_RTOL = 2e-3  # largest distance of the meshed layer from the law on S, relative


# ---------------------------------------------------------------- the study
def arms(h: float, h_S: float) -> Structure:
    """Make the arms, whose ends are 2 t apart at time t; `h` and `h_S` are cell sizes inside them and along S."""
    supports: dict[Place, Support] = {(0, ARM): {"y": lambda x, t: t}, (0, -ARM): {"y": lambda x, t: -t}}
    supports |= {(LENGTH, y): {"x": 0.0} for y in (ARM, -ARM)}
    joint = sandwich(LENGTH, ARM, ARM, h, h_S=h_S, cell="quadrilateral", structured=True)
    return Structure(joint, body=LinearElastic.young(E, NU), supports=supports)


def peel(kind: str, h_S: float) -> History:
    """Peel the arms until they are `END` apart, by arc length; the table has columns "displacement" and "force"."""
    structure, layer, arc = arms(ARM / 2, h_S), ThinLayer(GLUE, EPS), ArcLength(end=END / 2, first=0.05)
    model = structure.full(layer, cells_through=1) if kind == MESHED else structure.interface(layer)
    observe = {"displacement": lambda state: 2 * state.t, "force": lambda state: state.reaction((0, ARM)).force[1]}
    return march(model, arc, observe=observe, keep="last")


def run(record: Record, *, quick: bool = False) -> None:
    """Peel the arms of a double cantilever beam, with the law on S and with a meshed layer.

    table.csv has rows for both and for beams: the opening of the ends, the force per width, the length of the crack and
    the dissipated energy per width up to then.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: four cells along the fracture zone, not eight.
    """
    table, curves = record.new_table("table.csv"), {BEAMS: ARMS.envelope(1.25 * CRACK)}
    for kind in (ON_S, MESHED):
        curves[kind] = path_table(record.add_report(peel(kind, 1.0 if quick else 0.5)), LENGTH)
    for name, curve in curves.items():
        table.extend({"curve": name, **row} for row in curve.rows)
    check_curves(record, curves)


def check_curves(record: Record, curves: Mapping[str, Table]) -> None:
    """Check the models against beams and against each other, and evaluate the test.

    Tests are evaluated by clamped beams, which have the toughness (P a)^2/B for a force P, a crack a and arms of the
    stiffness B. Beams on glue are softer. So the crack must be that of clamped beams with the measured opening and force,
    not the real one.
    """
    beams, on_s, meshed = (curves[name] for name in (BEAMS, ON_S, MESHED))
    compare(record, on_s, beams, BEAM_RTOL)
    openings = np.linspace(1.1, END, 5)
    forces = [np.interp(openings, curve["displacement"], curve["force"]) for curve in (on_s, meshed)]
    distance = abs(forces[1] / forces[0] - 1).max()
    record.check("meshed layer: largest relative distance of the force from the law on S", distance, high=MESHED_RTOL)
    dissipated = np.interp(END, beams["displacement"], beams["dissipated"])
    record.check_near("dissipated energy over that of beams", on_s["dissipated"][-1] / dissipated, 1.0, BEAM_RTOL)
    ratio = meshed["dissipated"][-1] / on_s["dissipated"][-1]
    record.check_near("dissipated energy of the meshed layer over that of the law on S", ratio, 1.0, MESHED_RTOL)
    opening, force, crack = (on_s[name][-1] for name in ("displacement", "force", "crack"))
    stiffness = ARMS.E * ARM**3 / 12
    effective_crack = (1.5 * stiffness * opening / force) ** (1 / 3)
    by_crack, by_opening = ((force * a) ** 2 / stiffness / TOUGHNESSES[0] for a in (crack, effective_crack))
    record.check("toughness by clamped beams from force and crack length, over the true one", by_crack, high=0.8)
    record.check_near("toughness by clamped beams from force and opening, over the true one", by_opening, 1.0, 0.02)


def draw(record: Record) -> None:
    """Draw force and dissipated energy over the opening, from table.csv in the folder of `record`."""
    curves = record.load("table.csv").split("curve")
    curves[SHARP] = ARMS.sharp(np.linspace(0.9 * CRACK, 1.25 * CRACK, 30))
    panels, xlabel = {"force (N/mm)": "force", "dissipated energy (N mm/mm)": "dissipated"}, "opening of the ends (mm)"
    look = LOOK | {"title": "a double cantilever beam with a crack of 30 mm is peeled", "xlim": (0.0, END)}
    plotting.load_displacement(curves, "displacement", panels, xlabel, save=record.path("dcb.svg"), **look)
