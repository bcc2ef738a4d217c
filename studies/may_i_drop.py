"""May you drop the layer? Estimated and true changes if the layer is not meshed, in 41 structures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from studies.dropped import (
    THICK,
    THIN,
    DroppedCase,
    further_cases,
    ignore_range_warnings,
    published_cases,
)
from studies.sweeping import Curves, Field, end_state
from thinlayer import Surface, estimate, march, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.estimating.result import Estimate
from thinlayer.output.plotting.curves import as_fraction
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution
from thinlayer.surface.surface_mesh import Where
from thinlayer.system.progress import track

THICKNESSES, FIELDS = (THICK, THIN), ("traction", "jump")
EFFECTIVITY_TOLERANCE = 0.01  # allowed distance of effectivities from 1
GOAL_ROUNDING = 1e-8  # relative rounding error of goals


def run(record: Record, *, quick: bool = False) -> None:
    """Estimate how results of interface laws of order 0 change if layers are meshed, and measure the true change.

    The effectivity of an estimate is the estimated over the true change. effectivities.csv has true changes and
    effectivities of tractions and jumps on S, goals.csv those of other results.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: without structures in 3D.
    """
    chosen_cases = [case for case in (*published_cases(), *further_cases()) if not (quick and case.is_3d)]
    cases = [(case, eps) for case in chosen_cases for eps in THICKNESSES]
    table, goals = record.new_table("effectivities.csv"), record.new_table("goals.csv")
    for case, eps in track(cases, "may_i_drop", "{0[0].name}, {0[1]:g}"):
        solved = SolvedCase.from_case(case, eps, record)
        row, goal_rows = effectivities(solved)
        table.append({"case": case.name, "eps": eps, "unknowns": solved.estimate.better.model.unknowns, **row})
        goals.extend({"case": case.name, "eps": eps, **goal} for goal in goal_rows)
    for name in FIELDS:
        deviation = np.abs(table[name] - 1).max()
        record.check(f"largest distance of the {name}'s effectivity from 1", deviation, high=EFFECTIVITY_TOLERANCE)
    deviations = np.abs(goals["effectivity"] - 1)[goals["told"] > 0]
    record.check("median distance of a told goal's effectivity from 1", np.median(deviations), high=1e-6)
    record.check("largest distance of a told goal's effectivity from 1", deviations.max(), high=1e-4)
    record.check("goals that are not between their bounds", np.sum(goals["outside"]), high=0)


# ---------------------------------------------------------------- measurements
@dataclass(frozen=True)
class SolvedCase:
    """A case solved with interface laws, whose errors are estimated, and with meshed layers.

    Attributes:
        case: the case.
        estimate: the estimated changes from the interface laws of order 0 to meshed layers.
        full: state with meshed layers.
    """

    case: DroppedCase
    estimate: Estimate
    full: State

    @classmethod
    def from_case(cls, case: DroppedCase, eps: float, record: Record | None = None) -> SolvedCase:
        """Solve a case with interface laws of order 0, estimate their errors, and solve it with meshed layers.

        Args:
            case: the case.
            eps: thickness of its layers.
            record: record of the run that keeps the solver's reports; None: they are not kept.
        """
        structure = case.make_structure(eps)
        order_0 = solve_case(case, structure.interface(case.make_layers(eps), bodies=case.bodies))
        with ignore_range_warnings():
            result = estimate(order_0, goals=case.qois)
        # a nearly incompressible layer is meshed with a pressure, as its better law has one
        layers = {name: replace(error.layer, order=0, edges=None) for name, error in result.layers.items()}
        full = end_state(solve_case(case, structure.full(layers, bodies=case.bodies)))
        if record:
            for state in (result.state, result.better, full):
                record.add_report(state)
        return cls(case, result, full)

    def changes(self, state: State, part: Where | float = 1.0, traction: Field = Surface.traction) -> dict[str, float]:
        """Return the relative changes of "traction" and "jump" on S, in L2 norms, from interface laws to `state`.

        Args:
            state: state of a model of the case.
            part: part of S on which changes are measured; 1: all of S.
            traction: method of `Surface` that gives the traction.
        """
        squares = np.zeros((2, 2))
        for name in self.estimate.layers:
            surface = Surface(self.estimate.better.model, name)
            for row, field in zip(squares, (traction, Surface.jump), strict=True):
                old_field = field(surface, self.estimate.state)
                row += surface.norm(field(surface, state) - old_field, part) ** 2, surface.norm(old_field, part) ** 2
        return {name: math.sqrt(change / size) for name, (change, size) in zip(FIELDS, squares, strict=True)}


def solve_case(case: DroppedCase, model: Model) -> Solution:
    """Solve `model`, a model of `case`: return a state, or a history if the case has a time step."""
    with ignore_range_warnings():
        return march(model, [case.dt]) if case.dt else solve(model)


def effectivities(solved: SolvedCase) -> tuple[dict[str, float], list[dict[str, float | str]]]:
    """Return the true changes and effectivities (estimated over true changes) of a case, solved as `solved`.

    Returns:
        A table row with "true_traction", "true_jump" (relative changes), "traction" and "jump" (effectivities); and a
        table row for each goal. This has "goal" (its name), "true" (change over value), "effectivity", and "width" (of
        the bounds over the true change). It also has the flags "told" (the estimate predicts a change) and "outside"
        (the true value is not within the bounds).
    """
    result, full, goal_rows = solved.estimate, solved.full, list[dict[str, float | str]]()
    model = result.better.model
    assert isinstance(model, InterfaceModel)
    for qoi in solved.case.qois:
        goal = result.goals[qoi.name]
        true_value, rounding = qoi.value(full, model), GOAL_ROUNDING * abs(goal.value)
        true_change = true_value - goal.value
        is_outside = goal.bounded and not goal.lower - rounding <= true_value <= goal.upper + rounding
        flags = {"told": float(not (goal.zero or goal.fixed)), "outside": float(is_outside)}
        changes = {"true": true_change / goal.value, "effectivity": goal.change / true_change}
        goal_rows.append({"goal": qoi.name, **changes, "width": (goal.upper - goal.lower) / abs(true_change), **flags})
    truth = solved.changes(full)
    row = {f"true_{name}": value for name, value in truth.items()}
    return row | {name: float(getattr(result, name)) / value for name, value in truth.items()}, goal_rows


# ---------------------------------------------------------------- picture
def draw(record: Record) -> None:
    """Draw how ratios of estimated to true changes are distributed, from effectivities.csv in the folder of `record`."""
    lines = Curves()
    for eps, rows in record.load("effectivities.csv").split("eps").items():
        for field in FIELDS:
            label = f"{field}, eps = {as_fraction(eps)}"
            lines[label] = np.sort(rows[field]), np.arange(1, len(rows) + 1) / len(rows)
    title, save = "changes if the layers are meshed", record.path("effectivities.svg")
    labels = ("estimated over true change", "share of the structures with at most this ratio")
    plotting.curves(lines, *labels, title=title, xlim=(0.99, 1.01), save=save)
