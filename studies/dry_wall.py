"""Benchmark: a dry wall, pressed and pushed along: Newton steps and time of each solver, over that of one linear solve."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from forms import HolonomicCoulomb, LinearElastic
from geometry import wall
from studies.timing import timed
from studies.wall import BRICK, CLAY, PRESSURE
from thinlayer import SolveError, Structure, Surface, ThinLayer, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import Contact
from thinlayer.running.record import Record
from thinlayer.system.progress import track

FRICTION = 0.5
STIFFNESS = (60.0, 6e3)  # K_N of the joints, MPa/mm; K_T is 0.4 times as much
WEIGHT = 2e-5  # N/mm^3; without it bricks that slide on both faces would have no place of their own
WALLS = {(3, 4): (0.1, 0.3, 0.4, 0.45), (14, 15): (0.1, 0.2, 0.3)}  # bricks and courses -> push over pressure
SOLVERS = ("condensed", "newton")
AGREE = 1e-7  # largest difference of pressures at nodes, over the largest pressure, of two solvers


def run(record: Record, *, quick: bool = False) -> None:
    """Solve each wall under one sudden load with each solver, and with linear joints of the same stiffness.

    Times are of the processor, from a model to a state; steps include those of attempts that failed.

    Args:
        record: where to write.
        quick: the small wall, with bricks as coarse.
    """
    walls = dict([*WALLS.items()][:1]) if quick else WALLS
    cases = [(size, K, push) for size, pushes in walls.items() for K in STIFFNESS for push in pushes]
    table = record.table("table.csv")
    hardest = None
    for size, K, push in track(cases, "dry_wall", "{}"):
        _, linear = solved(bonded(size, K))
        states = {}
        for method in SOLVERS:
            model = dry(size, K, push)
            row = {"bricks": int(model.splitting.pieces.max()) + 1, "K_N": K, "push": push, "solver": method}
            row |= {"unknowns": model.unknowns, "steps": None, "eased": None, "seconds": None}
            row |= {"ratio": None, "sliding": None}
            try:
                state, seconds = solved(model, method)
            except SolveError as error:
                table.append(row | {"steps": len(error.residuals)})
                record.say(f"{row}: {error}")
                continue
            states[method] = state
            row |= {"steps": state.report.iterations, "eased": state.report.eased, "seconds": seconds}
            row |= {"ratio": seconds / linear, "sliding": _beds(state).counts["sliding"]}
            table.append(row)
        if len(states) == 2:
            apart = difference(*states.values())
            record.check(f"{size}, K_N {K:g}, push {push:g}: pressures differ by", apart, high=AGREE)
        hardest = states.get("condensed", hardest) if size == (3, 4) else hardest
    if hardest:
        save, title = record.path("wall.png"), "14 bricks, pushed to the right"
        plotting.deformed(record.solved(hardest), save=save, component="x", unit="mm", title=title)


def dry(size: tuple[int, int], K_N: float, push: float) -> InterfaceModel:
    """The model of a wall with dry joints under its loads."""
    law = HolonomicCoulomb(K_N, 0.4 * K_N, FRICTION)
    return _structure(size, push).interface({"BED": law, "HEAD": law})


def bonded(size: tuple[int, int], K_N: float) -> InterfaceModel:
    """The model of the same wall with linear joints of the same stiffness."""
    return _structure(size, 0.1).interface(ThinLayer(LinearElastic(0.2 * K_N, 0.4 * K_N), 1.0))


def _structure(size: tuple[int, int], push: float) -> Structure:
    joint, tractions = wall(*size, BRICK, BRICK[1] / 4), {"TOP": (push * PRESSURE, -PRESSURE)}
    own: dict[str, Any] = {"body": CLAY, "body_force": (0.0, -WEIGHT), "element": "Q1"}
    return Structure(joint, supports={"BOTTOM": 0.0}, tractions=tractions, **own)


def solved(model: InterfaceModel, method: str | None = None) -> tuple[State, float]:
    """The state, and the least processor time of three solves: the first one compiles."""
    works = [timed(partial(solve, model, method=method)) for _ in range(3)]
    return works[-1][1], min(seconds for seconds, _ in works)


def difference(one: State, other: State) -> float:
    """Largest difference of the pressures on the beds, over the largest pressure."""
    first, second = (_beds(state).p for state in (one, other))
    return float(np.abs(first - second).max() / first.max())


def _beds(state: State) -> Contact:
    return Surface(state.model, "BED").contact(state)
