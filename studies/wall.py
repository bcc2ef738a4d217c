"""A brick wall under pressure, sheared to its limit: joints slide and open; with and without mortar in the head joints."""

from __future__ import annotations

import resource
import time
from math import radians, tan

import numpy as np

from forms import LinearElastic, MohrCoulombMonodirectional
from geometry import wall
from thinlayer import History, LimitLoad, State, Structure, ThinLayer, march, plotting
from thinlayer.discretisation.kinds import InterfaceModel
from thinlayer.running.record import Record

BRICK = (250.0, 75.0)  # mm, with the mortar
CLAY = LinearElastic.young(E=12e3, nu=0.2)  # MPa
EPS = 10.0  # mm, thickness of the joints
MORTAR = LinearElastic.young(E=2e3, nu=0.2).per_thickness(EPS)
ANGLE = 30.0  # degrees
COHESION = {"BED": 0.1, "HEAD": 0.03}  # MPa
PRESSURE = 0.5  # MPa, on the top
WALLS = ("heads with mortar", "open heads")
LARGE = (14, 15)  # bricks and courses


def run(record: Record, *, large: bool = False, quick: bool = False) -> None:
    """Push the top along, harder and harder, until no equilibrium is left.

    The limit is at most that of a bed along which all bricks above slide: C + tan(Omega) p, per length of the wall.

    Args:
        record: where to write.
        large: 217 bricks and 1e5 unknowns in 20 steps instead, with its time and memory.
        quick: fewer bricks, longer steps.
    """
    record.parameters = {
        "brick_mm": BRICK,
        "clay": str(CLAY),
        "cohesion_MPa": COHESION,
        "angle_deg": ANGLE,
        "eps_mm": EPS,
    }
    if large:
        push_large(record)
        return
    bricks, courses, step = (3, 4, 0.04) if quick else (4, 6, 0.02)
    strength = COHESION["BED"] + tan(radians(ANGLE)) * PRESSURE
    table, last = record.table("table.csv"), 0.9 * strength
    shifts = []
    for name in WALLS:
        model = panel(bricks, courses, BRICK[1] / 3, heads=name == WALLS[0])
        history, limit = pushed(model, step, 1.5 * strength)
        for state in history:
            row = {"wall": name, "shear_MPa": state.t, "shift_mm": shift(state), "iterations": state.report.iterations}
            table.append(row)
        record.solved(history.last)
        record.check(f"{name}: limit over that of a bed that slides", limit / strength, low=0.995, high=1.0)
        shifts.append(np.interp(last, history.t, [shift(state) for state in history]))
        plotting.deformed(
            history.at(limit), save=record.path(f"{name.replace(' ', '_')}.png"), component="x", unit="mm",
            title=f"{name}, at {limit:.3g} MPa",
        )  # fmt: skip
    record.check("shift at 0.9 of the limit, open heads over heads with mortar", shifts[1] / shifts[0], low=1.1)


def push_large(record: Record) -> None:
    """A wall of 217 bricks in 20 steps to 0.8 of the strength of a bed."""
    begin = time.perf_counter()
    model = panel(*LARGE, BRICK[1] / 4, heads=True)
    built = time.perf_counter() - begin
    strength = COHESION["BED"] + tan(radians(ANGLE)) * PRESSURE
    history = march(model, [0.8 * strength * k / 20 for k in range(1, 21)], keep="last")
    row = {
        "bricks": int(model.splitting.pieces.max()) + 1,
        "unknowns": model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs,
        "built_s": built,
        "marched_s": time.perf_counter() - begin - built,
        "iterations": sum(int(one["iterations"] or 0) for one in history.table.rows),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "shift_mm": shift(history.last),
    }
    record.table("large.csv").append(row)
    record.say(row)


def panel(bricks: int, courses: int, h: float, *, heads: bool) -> InterfaceModel:
    """The interface model of a wall on a rigid foot, pressed at t = 0 and pushed along by a shear stress t, MPa."""
    layers = {
        name: ThinLayer(MohrCoulombMonodirectional(MORTAR.lmbda, MORTAR.mu, cohesion, ANGLE, unilateral=opens), EPS)
        for name, cohesion, opens in (("BED", COHESION["BED"], True), ("HEAD", COHESION["HEAD"], False))
    }
    structure = Structure(
        wall(bricks, courses, BRICK, h),
        body=CLAY,
        supports={"BOTTOM": 0.0},
        tractions={"TOP": lambda x, t: (t, -PRESSURE)},
    )
    return structure.interface(layers if heads else layers | {"HEAD": None})


def pushed(model: InterfaceModel, step: float, end: float) -> tuple[History, float]:
    """The states up to the limit, and the shear stress there, MPa."""
    try:
        march(model, [float(t) for t in np.arange(step, end, step)])
    except LimitLoad as limit:
        return limit.history, limit.t
    raise AssertionError("the wall has no limit")


def shift(state: State) -> float:
    """Mean displacement of the top along the wall, mm."""
    model = state.model
    top = model.ds(model.domain.values("TOP"))
    return state.integral(state.u[0] * top) / state.integral(1.0 * top)


def draw(record: Record) -> None:
    """Draw load against displacement from table.csv, which a large wall has not."""
    if not record.has("table.csv"):
        return
    rows = record.load("table.csv").rows
    lines = {}
    for name in WALLS:
        own = [(float(row["shift_mm"] or 0), float(row["shear_MPa"] or 0)) for row in rows if row["wall"] == name]
        lines[name] = tuple(np.array([(0.0, 0.0), *own]).T)
    plotting.curves(
        lines,
        xlabel="shift of the top (mm)",
        ylabel="shear stress on the top (MPa)",
        title="a wall under a pressure of 0.5 MPa",
        styles=dict.fromkeys(lines, "o-"),
        save=record.path("shear.png"),
    )
