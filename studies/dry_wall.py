"""Benchmark: a dry wall, pressed and pushed along: Newton steps and time of each solver, over that of one linear solve."""

from __future__ import annotations

import time

import numpy as np

from forms import HolonomicCoulomb, LinearElastic
from geometry import wall
from thinlayer import SolveError, State, Structure, Surface, ThinLayer, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.files.progress import track
from thinlayer.output.contact_fields import Contact
from thinlayer.running.record import Record

BRICK = (250.0, 75.0)  # mm
CLAY = LinearElastic.young(E=12e3, nu=0.2)  # MPa
FRICTION = 0.5
STIFFNESS = (60.0, 6e3)  # K_N of the joints, MPa/mm; K_T is 0.4 times as much
PRESSURE = 0.5  # MPa, on the top
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
    record.parameters = {"brick_mm": BRICK, "clay": str(CLAY), "friction": FRICTION, "pressure_MPa": PRESSURE}
    record.parameters["weight_N_per_mm3"] = WEIGHT
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
            row["unknowns"] = model.V.dofmap.index_map.size_global * 2
            try:
                state, seconds = solved(model, method)
            except SolveError as error:
                table.append(
                    row
                    | {"steps": len(error.residuals), "eased": None, "seconds": None, "ratio": None, "sliding": None}
                )
                record.say(f"{row}: {error}")
                continue
            states[method] = state
            report = state.report
            row |= {"steps": report.iterations, "eased": report.eased, "seconds": seconds, "ratio": seconds / linear}
            row |= {"sliding": _beds(state).counts["sliding"]}
            table.append(row)
            record.say(row)
        if len(states) == 2:
            record.check(
                f"{size}, K_N {K:g}, push {push:g}: pressures differ by", difference(*states.values()), high=AGREE
            )
        hardest = states.get("condensed", hardest) if size == (3, 4) else hardest
    if hardest:
        record.solved(hardest)
        plotting.deformed(
            hardest, save=record.path("wall.png"), component="x", unit="mm", title="14 bricks, pushed to the right"
        )


def dry(size: tuple[int, int], K_N: float, push: float) -> InterfaceModel:
    """The model of a wall with dry joints under its loads."""
    law = HolonomicCoulomb(K_N, 0.4 * K_N, FRICTION)
    return _structure(size, push).interface({"BED": law, "HEAD": law})


def bonded(size: tuple[int, int], K_N: float) -> InterfaceModel:
    """The model of the same wall with linear joints of the same stiffness."""
    return _structure(size, 0.1).interface(ThinLayer(LinearElastic(0.2 * K_N, 0.4 * K_N), 1.0))


def _structure(size: tuple[int, int], push: float) -> Structure:
    return Structure(
        wall(*size, BRICK, BRICK[1] / 4),
        body=CLAY,
        supports={"BOTTOM": 0.0},
        tractions={"TOP": (push * PRESSURE, -PRESSURE)},
        body_force=(0.0, -WEIGHT),
        element="Q1",
    )


def solved(model: InterfaceModel, method: str | None = None) -> tuple[State, float]:
    """The state, and the least processor time of three solves: the first one compiles."""
    times = []
    for _ in range(3):
        begin = time.process_time()
        state = solve(model, method=method)
        times.append(time.process_time() - begin)
    return state, min(times)


def difference(one: State, other: State) -> float:
    """Largest difference of the pressures on the beds, over the largest pressure."""
    first, second = (_beds(state).p for state in (one, other))
    return float(np.abs(first - second).max() / first.max())


def _beds(state: State) -> Contact:
    return Surface(state.model, "BED").contact(state)


def draw(record: Record) -> None:
    """Draw Newton steps over the push from table.csv."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for row in record.load("table.csv").rows:
        if int(row["bricks"] or 0) == 14 and row["ratio"]:
            name = f"{float(row['K_N'] or 0):g} MPa/mm, {row['solver']}"
            lines.setdefault(name, []).append((float(row["push"] or 0), float(row["steps"] or 0)))
    plotting.curves(
        {name: tuple(np.array(points).T) for name, points in lines.items()},
        xlabel="push over pressure",
        ylabel="Newton steps",
        title="a sudden push on a dry wall of 14 bricks",
        styles=dict.fromkeys(lines, "o-"),
        save=record.path("steps.png"),
    )
