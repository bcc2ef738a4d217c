"""A gap whose conductance follows its opening: heat and mechanics solved in turn, in two bars that expand.

Two bars are held at their outer ends, with T = 0 below and 1 above. Gas conducts through the gap by k_g/(opening +
g_0); bars that touch conduct better with the overlap. Warm bars expand and close the gap.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.optimize import brentq

from forms import Conductance, Conduction, LinearElastic
from forms.base import Array
from geometry import sandwich
from thinlayer import Structure, Surface, Table, ThermalExpansion, ThinLayer, coupled, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.errors import SolveError
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

K_GAS, G_0, CONTACT = 0.002, 0.0002, 2000.0  # of the gap; growth of the conductance by the overlap
CASES = {  # expansions of the lower and the upper bar, cold opening: s at the solution
    (0.0, 0.02, 0.0112): -0.246,
    (0.0, 0.1, 0.0458): -1.488,
    (0.0, 0.3, 0.1335): -4.504,
}
UNSTABLE = (0.1, 0.0, 0.0083)  # three equilibria: closed, unstable, open
EMPTY = ThinLayer(LinearElastic(0.0, 1e-10), eps=0.1)  # nearly without stiffness
JOINT = sandwich(0.1, 0.5, 0.5, h=0.05, cell="quadrilateral")
HEATED = Structure(JOINT, body=Conduction(1.0), supports={"BOTTOM": 0, "TOP": 1})
SURFACE = Surface(HEATED.bonded())


def conductance(opening: Array) -> Array:
    """Return the conductance of the gap for openings, or overlaps < 0."""
    return np.where(opening < 0, K_GAS / G_0 - CONTACT * opening, K_GAS / (np.maximum(opening, 0) + G_0))


def heat(opening: Array) -> State:
    """Solve for the temperature of the bars, with a gap of given openings on S."""
    h = SURFACE.function(conductance(opening))
    return solve(HEATED.interface(Conductance(h)))  # type: ignore[arg-type]


def bars(lower: float, upper: float, temperature: Solution) -> InterfaceModel:
    """Make the model of bars with these coefficients of expansion, open to each other."""
    rollers: dict[str, Support] = {"BOTTOM": 0, "TOP": {"y": 0}, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    expansions = {"LOWER": lower, "UPPER": upper}
    strains = {body: ThermalExpansion(alpha, temperature, reference=0) for body, alpha in expansions.items()}
    return Structure(JOINT, body=LinearElastic(0, 0.5), supports=rollers, eigenstrain=strains).interface(EMPTY)


def expand(lower: float, upper: float, temperature: State) -> State:
    """Solve for the displacements of bars with these coefficients of expansion."""
    return solve(bars(lower, upper, temperature))


def closed_opening(opening: float, lower: float, upper: float, cold: float) -> float:
    """Return the opening that follows from a given one, by rods: each has its mean temperature."""
    flux = 1 / (1 + 1 / float(conductance(np.array(opening))))
    return cold - lower * flux / 8 - upper * (2 - flux / 2) / 4


def run(record: Record) -> None:
    """Solve heat and mechanics in turn, with the measured slope, from s = -0.25 to -4.5, and from an unstable state.

    Args:
        record: record of the run, with its folder, tables and checks.
    """
    table = record.new_table("table.csv")
    for (lower, upper, cold), s in CASES.items():
        trail: list[float] = []

        def exchange(state: State, cold: float = cold, trail: list[float] = trail) -> Array:
            trail.append(float((cold + SURFACE.jump(state)[1]).mean()))
            return cold + SURFACE.jump(state)[1]

        pair = coupled(heat, partial(expand, lower, upper), exchange, begin=0.003)
        rods = brentq(lambda g, case=(lower, upper, cold): closed_opening(g, *case) - g, -0.01, 0.1, xtol=1e-15)
        table.extend({"s": s, "step": k, "distance": abs(g / rods - 1)} for k, g in enumerate(trail, 1))
        record.check_near(f"s = {s:g}: opening over that of rods", pair.value.mean() / rods, 1.0, 1e-6)
        record.check_near(f"s = {s:g}: measured s", pair.s, s, 2e-3)
        record.check(f"s = {s:g}: steps", pair.steps, high=7)
    message = ""
    try:
        coupled(heat, partial(expand, *UNSTABLE[:2]), lambda u: UNSTABLE[2] + SURFACE.jump(u)[1], begin=0.00145)
    except SolveError as error:
        message = str(error)
    record.check("the unstable equilibrium is refused with s > 1", "> 1" in message, low=1)


def draw(record: Record) -> None:
    """Draw how the openings approach the solution, from table.csv in the folder of `record`."""
    tables: dict[str, Table] = record.load("table.csv").split("s")
    lines = {f"s = {s}": (rows["step"], np.maximum(rows["distance"], 1e-9)) for s, rows in tables.items()}
    axes = "step: one solution of heat and one of mechanics", "relative distance of the opening from rods"
    title = "a gap that conducts by its width"
    plotting.curves(lines, *axes, title=title, styles="o-", log="y", save=record.path("gap.svg"))
