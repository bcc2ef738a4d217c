"""Which number matters? How a result of three joints changes if each of their parameters is 1 % larger."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from forms import MohrCoulomb, Rubber
from geometry import sandwich
from studies.bearing import plated_disc
from studies.problems import STEEL
from studies.sweeping import end_state
from studies.wall import BRICK_SIZE, CLAY, COHESIONS, EPS, MORTAR, OMEGA, PRESSURE
from thinlayer import Structure, ThinLayer, derivative, goals, march, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.supports import Place, Support
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.parameters import Parameters
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import finish_picture, make_panels
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Description
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution
from thinlayer.system.progress import track

LAP_FILE = Path(__file__).with_name("data") / "lap.toml"
TOP_SHIFT, TIMES = 0.08, (0.25, 0.5, 0.75, 1.0)  # mm, of the upper brick at t = 1
RUBBER, RUBBER_EPS = Rubber.shear(1.2, 0.499), 2.5  # MPa, mm
STRESSES = ("E", "lmbda", "mu", "cohesion")  # parameters of laws that are stresses
STEP = 1e-4  # relative change of a parameter for central differences
TOLERANCE = 1e-5  # relative: steel is 1e5 times stiffer than rubber, whose derivatives lose five digits by rounding
MIN_CHANGE = 5e-3  # smallest change that is drawn, over the largest one


@dataclass(frozen=True)
class Case:
    """A joint, one of its results, and the parameters by which its derivatives are compared.

    Attributes:
        make: function of `quick` that makes the interface model.
        run: function that solves the model.
        goal: the result.
        unused: parameters of laws that are left out, as the others determine them.
        compared: parameters whose derivatives are compared with central differences of whole solves.
    """

    make: Callable[[bool], InterfaceModel]
    run: Callable[[InterfaceModel], Solution]
    goal: Goal
    unused: tuple[str, str]
    compared: tuple[str, str]


def lap_joint(_: bool) -> InterfaceModel:
    """Make the two glued plates of studies/data/lap.toml, mm and MPa; the mesh is that of the file."""
    lap = DescribedCase.from_description(Description.read(LAP_FILE))
    assert isinstance(lap.layer, ThinLayer)
    return lap.structure.interface(replace(lap.layer, order=1))


def pressed_bricks(quick: bool) -> InterfaceModel:
    """Make two bricks with mortar, mm and MPa; the upper one is pressed down and moved along until the mortar yields."""
    width, height = BRICK_SIZE
    joint = sandwich(width, height, height, height / (4 if quick else 12), cell="quadrilateral", structured=True)
    supports: dict[Place, Support] = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: TOP_SHIFT * t}}
    bricks = Structure(joint, body=CLAY, supports=supports, tractions={"TOP": (0.0, -PRESSURE)})
    law = MohrCoulomb(MORTAR.lmbda, MORTAR.mu, COHESIONS["BED"], OMEGA, elastic_fraction=1e-3)
    return bricks.interface(ThinLayer(law, EPS))


def bearing(quick: bool) -> InterfaceModel:
    """Make a disc of rubber between steel plates, mm and MPa, whose upper plate is lifted."""
    disc = plated_disc(STEEL, RUBBER_EPS, 1.0 if quick else 0.4)
    return disc.interface(ThinLayer(RUBBER, RUBBER_EPS, order=1))


LAME, YOUNG, march_bricks = ("lmbda", "mu"), ("E", "nu"), partial(march, times=TIMES)
PUSH, LIFT_FORCE = goals.Reaction("TOP", (1, 0)), goals.Reaction("TOP", (0, 1))
CASES = {
    "lap joint, compliance": Case(lap_joint, solve, goals.Compliance(), LAME, ("S.E", "UPPER PLATE.nu")),
    "bricks, shear force": Case(pressed_bricks, march_bricks, PUSH, LAME, ("S.friction_angle", "load TOP")),
    "rubber bearing, force": Case(bearing, solve, LIFT_FORCE, YOUNG, ("S.eps", "S.lmbda")),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Compute the derivatives of a result of each joint by all parameters, and compare them with differences of solves.

    table.csv has for each joint and parameter p the derivative p dQ/dp of the result Q, and this over Q: the change in
    per cent if p is 1 % larger. Q is the compliance of a lap joint, the shear force on a brick whose mortar yields, and
    the force on a rubber bearing. These results are proportional to a stress. So if all parameters that are stresses are
    1 % larger, at the same strains, Q is 1 % larger: their derivatives add up to Q.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser meshes of bricks and bearing.
    """
    table = record.new_table("table.csv")
    for name, case in track([*CASES.items()], "which_number", "{0[0]}"):
        model = case.make(quick)
        parameters = Parameters(model)
        unused = {key for key in parameters if key.rpartition(".")[2] in case.unused} | parameters.reasons.keys()
        result = derivative(case.run(model), case.goal, [key for key in parameters if key not in unused])
        by = result.by
        rows = ({"parameter": key, "derivative": by[key], "relative": by[key] / result.value} for key in by)
        table.extend({"joint": name, "value": result.value, **row} for row in rows)
        distance = abs(sum(by[key] for key in by if is_stress(key)) / result.value - 1)
        record.check(f"{name}: distance of the sum over stresses from the result", distance, high=TOLERANCE)
        for parameter in case.compared:
            models = [parameters[parameter](model, 1 + step) for step in (STEP, -STEP)]
            upper, lower = (case.goal.value(end_state(case.run(changed)), changed) for changed in models)
            error = abs((upper - lower) / (2 * STEP) / by[parameter] - 1)
            record.check(f"{name}: distance of the derivative by {parameter} from solves", error, high=TOLERANCE)


def is_stress(parameter: str) -> bool:
    """Return whether the parameter of a name is a stress, or a load."""
    return parameter.startswith("load ") or parameter.rpartition(".")[2] in STRESSES


def draw(record: Record) -> None:
    """Draw the change of each joint's result if a parameter is 1 % larger, from table.csv in the folder of `record`."""
    panels = make_panels(None, (1, len(CASES)), len(CASES), (11.0, 3.6))
    for axes, (joint, rows) in zip(panels, record.load("table.csv").split("joint").items(), strict=True):
        changes, names = rows["relative"], [str(row["parameter"]) for row in rows]
        order = [k for k in np.argsort(abs(changes)) if abs(changes[k]) > MIN_CHANGE * abs(changes).max()]
        bars = axes.barh([names[k] for k in order], changes[order], color=COLOURS[0])
        axes.bar_label(bars, fmt="%+.2g", padding=3, fontsize=8)
        axes.axvline(0.0, color="black", lw=0.8)
        axes.margins(x=0.25)
        axes.set(title=joint, xlabel="change (%)")
    finish_picture(panels, record.path("tornado.svg"), "if a parameter is 1 % larger")
