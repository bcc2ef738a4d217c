"""May you drop the layer? Estimated and true changes if the layer is not meshed, in 41 structures."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array
from studies.dropped import (
    THICK,
    THIN,
    DroppedCase,
    further_cases,
    ignore_range_warnings,
    published_cases,
    random_case,
)
from studies.sweeping import Field, end_state
from thinlayer import Probe, Surface, estimate, march, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.estimating.result import ESTIMATED_FIELDS, Estimate
from thinlayer.output.plotting.curves import as_fraction
from thinlayer.pointwise.quadrature import assemble_values
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution
from thinlayer.surface.surface_mesh import Where
from thinlayer.system.progress import track
from thinlayer.system.table import Table

THICKNESSES = (THICK, THIN)
INNER_HALF_WIDTH = 0.25  # distance from the middle of S up to which another program measured
EFFECTIVITY_TOLERANCE = 0.01  # allowed distance of effectivities from 1
GOAL_ROUNDING = 1e-8  # relative rounding error of goals
DRAWN_CASE = "free ends: two stiffnesses"


def run(record: Record, *, quick: bool = False) -> None:
    """Estimate how results of interface laws of order 0 change if layers are meshed, and measure the true change.

    The effectivity of an estimate is the estimated over the true change. effectivities.csv has true changes and
    effectivities of tractions and jumps on S, goals.csv those of other results. random.csv has those of random
    structures, along.csv the changes along S in one structure.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: without structures in 3D, with fewer random structures.
    """
    _check_all_cases(record, quick=quick)
    _check_random_cases(record, count=12 if quick else 100)


def _check_all_cases(record: Record, *, quick: bool) -> None:
    """Write true changes and effectivities of all cases to two tables of `record`, and check the effectivities.

    An effectivity is an estimated over a true change. effectivities.csv is about fields on S, goals.csv about goals.
    `quick` leaves out structures in 3D.
    """
    chosen_cases = [case for case in (*published_cases(), *further_cases()) if not (quick and case.is_3d)]
    cases = [(case, eps) for case in chosen_cases for eps in THICKNESSES]
    table, goals = record.new_table("effectivities.csv"), record.new_table("goals.csv")
    for case, eps in track(cases, "may_i_drop", "{0[0].name}, {0[1]:g}"):
        solved = SolvedCase.from_case(case, eps, record)
        row, goal_rows = effectivities(solved)
        table.append({"case": case.name, "eps": eps, "unknowns": solved.estimate.better.model.unknowns, **row})
        goals.extend({"case": case.name, "eps": eps, **goal} for goal in goal_rows)
        if (case.name, eps) == (DRAWN_CASE, THICK):
            record.write("along.csv", changes_along_s(solved))
    for name in ESTIMATED_FIELDS:
        deviation = np.abs(table[name] - 1).max()
        record.check(f"largest distance of the {name}'s effectivity from 1", deviation, high=EFFECTIVITY_TOLERANCE)
    deviations = np.abs(goals["effectivity"] - 1)[goals["told"] > 0]
    record.check("median distance of a told goal's effectivity from 1", np.median(deviations), high=1e-6)
    record.check("largest distance of a told goal's effectivity from 1", deviations.max(), high=1e-4)
    record.check("goals that are not between their bounds", np.sum(goals["outside"]), high=0)


def _check_random_cases(record: Record, *, count: int) -> None:
    """Write true changes and effectivities of two goals of random structures to random.csv of `record`, and check them.

    An effectivity is an estimated over a true change; `count` is the number of structures.
    """
    table = record.new_table("random.csv")
    for seed in track(range(count), "may_i_drop", "random, {}"):
        eps, case = random_case(seed)
        _, goal_rows = effectivities(SolvedCase.from_case(case, eps))
        table.extend({"seed": seed, "what": case.name, "eps": eps, **goal} for goal in goal_rows)
    off = np.abs(table["effectivity"] - 1)
    record.check("random: goals that are not between their bounds", np.sum(table["outside"]), high=0)
    record.check("random: largest distance of a goal's effectivity from 1", off.max(), high=EFFECTIVITY_TOLERANCE)


# ---------------------------------------------------------------- measurements
@dataclass(frozen=True)
class SolvedCase:
    """A case solved with interface laws, whose errors are estimated, and with meshed layers.

    Attributes:
        case: the case.
        eps: thickness of its layers.
        estimate: the estimated changes from the interface laws of order 0 to meshed layers.
        full: state with meshed layers.
    """

    case: DroppedCase
    eps: float
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
        return cls(case, eps, result, full)

    @property
    def true_changes(self) -> dict[str, float]:
        """True changes if the layers are meshed, by the names "traction" and "jump" and the names of the goals.

        Changes of traction and jump are relative, in L2 norms on S. The change of a goal is absolute: its value with
        meshed layers minus that with interface laws.
        """
        interface_model = self.estimate.better.model
        assert isinstance(interface_model, InterfaceModel)
        old_goals, qois = self.estimate.goals, self.case.qois
        changes = {goal.name: goal.value(self.full, interface_model) - old_goals[goal.name].value for goal in qois}
        return self._deltas(self.full) | changes

    @property
    def estimated_changes(self) -> dict[str, float]:
        """Estimated changes if the layers are meshed, by the names "traction" and "jump" and the names of the goals.

        Changes of traction and jump are relative, in L2 norms on S. The change of a goal is absolute: its value with
        meshed layers minus that with interface laws.
        """
        surface_changes = {name: float(getattr(self.estimate, name)) for name in ESTIMATED_FIELDS}
        return surface_changes | {name: goal.change for name, goal in self.estimate.goals.items()}

    def inner_changes(self, state: State) -> dict[str, float]:
        """Return the relative changes of "traction" and "jump" on S, in L2 norms, from interface laws to `state`.

        Tractions are those of the bodies' nodal forces. If the case's `inner_only` is set, only the part of S from x =
        1/4 to 3/4 counts.
        """
        region = (lambda x: abs(x[0] - 0.5) < INNER_HALF_WIDTH) if self.case.inner_only else 1.0
        return self._deltas(state, region, Surface.reaction)  # as in the other program

    def _deltas(self, state: State, part: Where | float = 1.0, traction: Field = Surface.traction) -> dict[str, float]:
        squares = np.zeros((2, 2))
        for name in self.estimate.layers:
            surface = Surface(self.estimate.better.model, name)
            for row, field in zip(squares, (traction, Surface.jump), strict=True):
                old_field = field(surface, self.estimate.state)
                row += surface.norm(field(surface, state) - old_field, part) ** 2, surface.norm(old_field, part) ** 2
        return {name: math.sqrt(change / size) for name, (change, size) in zip(ESTIMATED_FIELDS, squares, strict=True)}


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
    truth, goal_rows = solved.true_changes, list[dict[str, float | str]]()
    ratios = {name: estimated / truth[name] for name, estimated in solved.estimated_changes.items()}
    for name, goal in solved.estimate.goals.items():
        true_value, rounding = goal.value + truth[name], GOAL_ROUNDING * abs(goal.value)
        is_outside = goal.bounded and not goal.lower - rounding <= true_value <= goal.upper + rounding
        flags = {"told": float(not (goal.zero or goal.fixed)), "outside": float(is_outside)}
        changes = {"true": truth[name] / goal.value, "effectivity": ratios[name]}
        goal_rows.append({"goal": name, **changes, "width": (goal.upper - goal.lower) / abs(truth[name]), **flags})
    row = {f"true_{name}": truth[name] for name in ESTIMATED_FIELDS}
    return row | {name: ratios[name] for name in ESTIMATED_FIELDS}, goal_rows


# ---------------------------------------------------------------- along S
COORDINATE_DIGITS = 9  # decimal digits to which coordinates are compared


def changes_along_s(solved: SolvedCase) -> Table:
    """Compute the true and the estimated change of normal traction, normal jump and compliance along S.

    The compliance's density is its change per area of S. Bodies are linear, supports are fixed. Let L(u) be the work of
    the loads in u, t_0 and u_0 the solution of order 0, and u the solution with meshed layers. Then L(u) - L(u_0) =
    int_S t_0 . [u] - int_layer stress(u) : strain(v) for any v that is u_0 on the faces. Here v is the layer's
    equilibrium with its faces at u_0. The estimated density is `Estimate.density`.

    Args:
        solved: a case of two bodies in 2D, with S between them on y = 0, elastic laws without a pressure, and loads
            only.

    Returns:
        A table with a row for each node of S: "x"; "true_traction", "estimated_traction", "true_jump",
        "estimated_jump"; "true_density" and the estimated "density".
    """
    estimate, surface, columns = solved.estimate, Surface(solved.estimate.better.model), {}
    for name, field in zip(ESTIMATED_FIELDS, (surface.traction, surface.jump), strict=True):
        old_field = field(estimate.state)
        better = estimate.inside if name == "traction" else estimate.better
        for kind, state in (("true", solved.full), ("estimated", better)):
            x, values = surface.profile(field(state) - old_field)
            columns[f"{kind}_{name}"] = values[:, 1]
    _, surface_work = surface.profile((surface.traction(estimate.state) * surface.jump(solved.full)).sum(axis=0))
    columns["density"] = estimate.density()
    columns["true_density"] = surface_work - _layer_work(solved, x[:, 0]) / surface.areas
    sorted_rows = np.argsort(x[:, 0])
    return Table.of({"x": x[sorted_rows, 0], **{name: column[sorted_rows] for name, column in columns.items()}})


def _layer_work(solved: SolvedCase, at: Array) -> Array:
    """Compute the work of the meshed layer's stress in a virtual strain, and distribute it along S.

    The strain is that of the layer in equilibrium with its faces at the displacements of the solution of order 0.

    Args:
        solved: the case.
        at: (m,) coordinates x of the nodes of S.

    Returns:
        (m,) work that belongs to each node.
    """
    model, state, problem = solved.full.model, solved.full, solved.estimate._subproblem
    Q, comm = fem.functionspace(model.domain.mesh, ("Lagrange", 1)), model.comm
    v, q, x = fem.Function(model.V), ufl.TestFunction(Q), model.V.tabulate_dof_coordinates()[:, :2]
    nodes = np.flatnonzero(np.abs(x[:, 1]) <= solved.eps / 2 * (1 + 1e-9))
    face_displacements = problem.to_layers(solved.estimate.state.u.x.array)
    probe = Probe(problem.state(problem.dirichlet_displacements(face_displacements, problem.load, problem.side_u)))
    all_points = comm.allgather(x[nodes])  # a probe needs the same points on all ranks
    offset = sum(len(points) for points in all_points[: comm.rank])
    v.x.array.reshape(-1, 2)[nodes] = probe.displacement(np.concatenate(all_points))[offset : offset + len(nodes)]
    (term,) = state.layers
    work_form = ufl.inner(state.stress(term), term.strain(v)) * term.weight * q * term.measure
    n_owned = Q.dofmap.index_map.size_local
    is_near = np.abs(Q.tabulate_dof_coordinates()[:n_owned, 0] - at[:, None]) < 10.0**-COORDINATE_DIGITS
    return np.asarray(comm.allreduce(is_near @ assemble_values(fem.form(work_form), n_owned)))


# ---------------------------------------------------------------- pictures
PANEL_COLUMNS = {"change of t_N": ("traction", "estimated_traction"), "change of [u_N]": ("jump", "estimated_jump")}
PANEL_COLUMNS["where the compliance changes"] = "density", "density"


def draw(record: Record) -> None:
    """Draw the effectivities of all cases, and the changes along S of one case.

    The values are read from effectivities.csv and along.csv in the folder of `record`.
    """
    panels, names = dict[str, dict[str, tuple[list[float], list[int]]]](), dict[str, list[str]]()
    for case, rows in record.load("effectivities.csv").split("case").items():
        group, _, name = case.partition(": ")
        names.setdefault(group, []).append(name)
        for field in ESTIMATED_FIELDS:
            for eps, value in zip(rows["eps"], rows[field], strict=True):
                x, y = panels.setdefault(group, {}).setdefault(f"{field}, eps = {as_fraction(eps)}", ([], []))
                x.append(value)
                y.append(len(names[group]) - 1)
    look = {"styles": ("o", "s", "x", "+"), "columns": 2, "levels": names, "save": record.path("effectivities.svg")}
    plotting.curves(panels, "1: the estimate is right", title="estimated over true changes", xlim=(0.98, 1.02), **look)
    table = record.load("along.csv")
    lines = {
        title: {"meshed layer": (table["x"], table[f"true_{column}"]), "estimate": (table["x"], table[estimated])}
        for title, (column, estimated) in PANEL_COLUMNS.items()
    }
    plotting.curves(lines, f"x along S over its length; eps = {as_fraction(THICK)}", save=record.path("along.svg"))
