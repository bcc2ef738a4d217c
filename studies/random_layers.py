"""Benchmark: two hundred random layers on one mesh, time of a run over that of a linear solve, and memory."""

from __future__ import annotations

from functools import partial

import numpy as np

from forms import LinearElastic
from geometry import sandwich
from studies.problems import STEEL
from studies.timing import resident, seconds, solve_once, timed
from thinlayer import Structure, Surface, ThinLayer, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.parts.part import Interval
from thinlayer.running.record import Record
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import direct_solver, mark
from thinlayer.system.progress import track

RUNS, EARLY = 200, 20
LIMIT = 1.3  # time of a run over that of one linear solve
GROWTH = 1.02  # memory after all runs over that after the first ones


def glued(cells: int) -> InterfaceModel:
    """Two plates, 40 x 20 mm, that are sheared over a layer of glue."""
    joint = sandwich(width=40.0, lower=10.0, upper=10.0, h=20.0 / cells, structured=True)
    supports = {"BOTTOM": 0}
    plates = Structure(joint, body=STEEL, supports=supports, tractions={"TOP": (5.0, -3.0)})
    return plates.interface(layer(2e3, 0.2))


def layer(E: float, eps: float) -> ThinLayer:
    """Glue of Young's modulus E, MPa, and of a thickness, mm."""
    return ThinLayer(LinearElastic.young(E=E, nu=0.4), eps)


def run(record: Record, *, quick: bool = False) -> None:
    """Solve random layers, and other loads, on one mesh; alternate with one linear solve of the same matrix.

    The linear solve is what a script would do that has its matrix: ordering, factorisation, one substitution.

    Args:
        record: where to write.
        quick: a small mesh and few runs, without the limit of time.
    """
    cells, runs = (12, 2 * EARLY) if quick else (100, RUNS)
    first = glued(cells)
    surface, random = Surface(first), np.random.default_rng(7)
    table = record.table("table.csv")
    alone = [linear_solve(first) for _ in range(3)]
    for k in track(range(runs), "random_layers", "run {}"):
        E, eps = float(random.lognormal(np.log(2e3), 0.3)), float(random.uniform(0.1, 0.3))
        spent, state = timed(partial(_solved, first, layer(E, eps)))
        jump = surface.norm(surface.jump(state))
        if k % 20 == 10:
            alone.append(linear_solve(first))
        table.append({"run": k, "E": E, "eps": eps, "jump": jump, "seconds": spent, "memory": resident()})
    usual = float(np.median(alone))
    ratio = float(np.median(table["seconds"][1:])) / usual
    record.say({"unknowns": first.unknowns, "linear solve": usual, "run over it": ratio})
    turned = [{"TOP": (5.0 * np.cos(k), -3.0)} for k in range(EARLY)]
    loads = [seconds(partial(_loaded, first, top)) for top in turned]
    record.say({"under other loads, over a linear solve": float(np.median(loads[1:])) / usual})
    memory = table["memory"]
    record.check(f"memory after {runs} runs over that after {EARLY}", memory[-1] / memory[EARLY - 1], high=GROWTH)
    last = layer(float(table["E"][-1]), float(table["eps"][-1]))
    own = glued(cells)
    alone_jump = Surface(own).norm(Surface(own).jump(solve(own.with_layer(last))))
    record.check_near("jump of the last layer in a model of its own", float(table["jump"][-1]), alone_jump, 1e-9)
    if not quick:
        record.check("time of a run over that of a linear solve", ratio, high=LIMIT)


def _solved(model: InterfaceModel, drawn: ThinLayer) -> State:
    return solve(model.with_layer(drawn))


def _loaded(model: InterfaceModel, tractions: dict[str, tuple[float, float]]) -> State:
    return solve(model.with_loads(tractions=tractions))


def linear_solve(model: InterfaceModel) -> float:
    """Time of the processor, s, that MUMPS needs to order, to factor and to solve once."""
    equations = Equations(model)
    rest = equations.rest(0.0)
    equations.begin(Interval(rest, 0.0, 0.0, 1.0))
    x, b = equations.vector(), equations.vector()
    equations.residual(x, b)
    b.scale(-1.0)
    b.array[equations.held] = 0.0
    A = equations.tangent()
    A.zeroRowsColumns(equations.held_rows, 1.0)
    mark(A, model, saddle=False)
    spent = solve_once(A, b, direct_solver(model))
    x.destroy()
    b.destroy()
    equations.destroy()
    return spent
