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
    published_cases,
    random_case,
    unwarned,
)
from studies.sweeping import Field, last
from thinlayer import Probe, Surface, estimate, march, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.estimating.result import ESTIMATED_FIELDS, Estimate
from thinlayer.output.plotting.curves import fraction
from thinlayer.pointwise.quadrature import assemble_values
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution
from thinlayer.surface.surface_mesh import Where
from thinlayer.system.progress import track
from thinlayer.system.table import Table

THICKNESSES = (THICK, THIN)
INNER = 0.25  # distance from the middle of S up to which another program measured
CLOSE = 0.01  # allowed distance of effectivities from 1
ROUNDING = 1e-8  # relative rounding error of goals
DRAWN = "free ends: two stiffnesses"


def run(record: Record, *, quick: bool = False) -> None:
    """Estimate how results of interface laws of order 0 change if layers are meshed, and measure the true change.

    The effectivity of an estimate is the estimated over the true change. effectivities.csv has true changes and
    effectivities of tractions and jumps on S, goals.csv those of other results. random.csv has those of random
    structures, along.csv the changes along S in one structure.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: without structures in 3D, with fewer random structures.
    """
    _effectivities(record, quick=quick)
    _at_random(record, count=12 if quick else 100)


def _effectivities(record: Record, *, quick: bool) -> None:
    """Write true changes and effectivities of all cases to two tables of `record`, and check the effectivities.

    An effectivity is an estimated over a true change. effectivities.csv is about fields on S, goals.csv about goals.
    `quick` leaves out structures in 3D.
    """
    chosen = [case for case in (*published_cases(), *further_cases()) if not (quick and case.solid)]
    cases = [(case, eps) for case in chosen for eps in THICKNESSES]
    table, goals = record.table("effectivities.csv"), record.table("goals.csv")
    for case, eps in track(cases, "may_i_drop", "{0[0].name}, {0[1]:g}"):
        dropped = Dropped.of(case, eps, record)
        row, asked = effectivities(dropped)
        table.append({"case": case.name, "eps": eps, "unknowns": dropped.estimate.better.model.unknowns, **row})
        goals.extend({"case": case.name, "eps": eps, **goal} for goal in asked)
        if (case.name, eps) == (DRAWN, THICK):
            record.write("along.csv", along(dropped))
    for name in ESTIMATED_FIELDS:
        off = np.abs(table[name] - 1).max()
        record.check(f"largest distance of the {name}'s effectivity from 1", off, high=CLOSE)
    deviations = np.abs(goals["effectivity"] - 1)[goals["told"] > 0]
    record.check("median distance of a told goal's effectivity from 1", np.median(deviations), high=1e-6)
    record.check("largest distance of a told goal's effectivity from 1", deviations.max(), high=1e-4)
    record.check("goals that are not between their bounds", np.sum(goals["outside"]), high=0)


def _at_random(record: Record, *, count: int) -> None:
    """Write true changes and effectivities of two goals of random structures to random.csv of `record`, and check them.

    An effectivity is an estimated over a true change; `count` is the number of structures.
    """
    table = record.table("random.csv")
    for seed in track(range(count), "may_i_drop", "random, {}"):
        eps, case = random_case(seed)
        _, asked = effectivities(Dropped.of(case, eps))
        table.extend({"seed": seed, "what": case.name, "eps": eps, **goal} for goal in asked)
    off = np.abs(table["effectivity"] - 1)
    record.check("random: goals that are not between their bounds", np.sum(table["outside"]), high=0)
    record.check("random: largest distance of a goal's effectivity from 1", off.max(), high=CLOSE)


# ---------------------------------------------------------------- measurements
@dataclass(frozen=True)
class Dropped:
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
    def of(cls, case: DroppedCase, eps: float, record: Record | None = None) -> Dropped:
        """Solve a case with interface laws of order 0, estimate their errors, and solve it with meshed layers.

        Args:
            case: the case.
            eps: thickness of its layers.
            record: record of the run that keeps the solver's reports; None: they are not kept.
        """
        structure = case.structure(eps)
        zero = solved(case, structure.interface(case.layers(eps), bodies=case.bodies))
        with unwarned():
            result = estimate(zero, goals=case.asked)
        # a nearly incompressible layer is meshed with a pressure, as its better law has one
        layers = {name: replace(error.layer, order=0, edges=None) for name, error in result.layers.items()}
        full = last(solved(case, structure.full(layers, bodies=case.bodies)))
        if record:
            for state in (result.state, result.better, full):
                record.solved(state)
        return cls(case, eps, result, full)

    @property
    def truth(self) -> dict[str, float]:
        """True changes if the layers are meshed, by the names "traction" and "jump" and the names of the goals.

        Changes of traction and jump are relative, in L2 norms on S. The change of a goal is absolute: its value with
        meshed layers minus that with interface laws.
        """
        model = self.estimate.better.model
        assert isinstance(model, InterfaceModel)
        before = self.estimate.goals
        changes = {goal.name: goal.value(self.full, model) - before[goal.name].value for goal in self.case.asked}
        return self._on_s(self.full) | changes

    @property
    def estimated(self) -> dict[str, float]:
        """Estimated changes if the layers are meshed, by the names "traction" and "jump" and the names of the goals.

        Changes of traction and jump are relative, in L2 norms on S. The change of a goal is absolute: its value with
        meshed layers minus that with interface laws.
        """
        on_s = {name: float(getattr(self.estimate, name)) for name in ESTIMATED_FIELDS}
        return on_s | {name: goal.change for name, goal in self.estimate.goals.items()}

    def inner(self, state: State) -> dict[str, float]:
        """Return the relative changes of "traction" and "jump" on S, in L2 norms, from interface laws to `state`.

        Tractions are those of the bodies' nodal forces. If the case's `inner` is set, only the part of S from x = 1/4
        to 3/4 counts.
        """
        part = (lambda x: abs(x[0] - 0.5) < INNER) if self.case.inner else 1.0
        return self._on_s(state, part, Surface.reaction)  # as in the other program

    def _on_s(self, state: State, part: Where | float = 1.0, traction: Field = Surface.traction) -> dict[str, float]:
        squares = np.zeros((2, 2))
        for name in self.estimate.layers:
            surface = Surface(self.estimate.better.model, name)
            for row, field in zip(squares, (traction, Surface.jump), strict=True):
                before = field(surface, self.estimate.state)
                row += surface.norm(field(surface, state) - before, part) ** 2, surface.norm(before, part) ** 2
        return {name: math.sqrt(change / size) for name, (change, size) in zip(ESTIMATED_FIELDS, squares, strict=True)}


def solved(case: DroppedCase, model: Model) -> Solution:
    """Solve `model`, a model of `case`: return a state, or a history if the case has a time step."""
    with unwarned():
        return march(model, [case.step]) if case.step else solve(model)


def effectivities(dropped: Dropped) -> tuple[dict[str, float], list[dict[str, float | str]]]:
    """Return the true changes and effectivities (estimated over true changes) of a case, solved as `dropped`.

    Returns:
        A table row with "true_traction", "true_jump" (relative changes), "traction" and "jump" (effectivities); and a
        table row for each goal. This has "goal" (its name), "true" (change over value), "effectivity", and "width" (of
        the bounds over the true change). It also has the flags "told" (the estimate predicts a change) and "outside"
        (the true value is not within the bounds).
    """
    truth, asked = dropped.truth, list[dict[str, float | str]]()
    ratios = {name: estimated / truth[name] for name, estimated in dropped.estimated.items()}
    for name, goal in dropped.estimate.goals.items():
        true, least = goal.value + truth[name], ROUNDING * abs(goal.value)
        outside = goal.bounded and not goal.lower - least <= true <= goal.upper + least
        flags = {"told": float(not (goal.zero or goal.fixed)), "outside": float(outside)}
        changes = {"true": truth[name] / goal.value, "effectivity": ratios[name]}
        asked.append({"goal": name, **changes, "width": (goal.upper - goal.lower) / abs(truth[name]), **flags})
    row = {f"true_{name}": truth[name] for name in ESTIMATED_FIELDS}
    return row | {name: ratios[name] for name in ESTIMATED_FIELDS}, asked


# ---------------------------------------------------------------- along S
ROUND = 9  # decimal digits to which coordinates are compared


def along(dropped: Dropped) -> Table:
    """Compute the true and the estimated change of normal traction, normal jump and compliance along S.

    The compliance's density is its change per area of S. Bodies are linear, supports are fixed. Let L(u) be the work of
    the loads in u, t_0 and u_0 the solution of order 0, and u the solution with meshed layers. Then L(u) - L(u_0) =
    int_S t_0 . [u] - int_layer stress(u) : strain(v) for any v that is u_0 on the faces. Here v is the layer's
    equilibrium with its faces at u_0. The estimated density is `Estimate.density`.

    Args:
        dropped: a case of two bodies in 2D, with S between them on y = 0, elastic laws without a pressure, and loads
            only.

    Returns:
        A table with a row for each node of S: "x"; "true_traction", "estimated_traction", "true_jump",
        "estimated_jump"; "true_density" and the estimated "density".
    """
    estimate, surface = dropped.estimate, Surface(dropped.estimate.better.model)
    columns = {}
    for name, field in zip(ESTIMATED_FIELDS, (surface.traction, surface.jump), strict=True):
        before = field(estimate.state)
        better = estimate.inside if name == "traction" else estimate.better
        for which, state in (("true", dropped.full), ("estimated", better)):
            x, values = surface.profile(field(state) - before)
            columns[f"{which}_{name}"] = values[:, 1]
    _, on_s = surface.profile((surface.traction(estimate.state) * surface.jump(dropped.full)).sum(axis=0))
    columns["density"] = estimate.density()
    columns["true_density"] = on_s - _of_layer(dropped, x[:, 0]) / surface.areas
    in_order = np.argsort(x[:, 0])
    return Table.of({"x": x[in_order, 0], **{name: column[in_order] for name, column in columns.items()}})


def _of_layer(dropped: Dropped, at: Array) -> Array:
    """Compute the work of the meshed layer's stress in a virtual strain, and distribute it along S.

    The strain is that of the layer in equilibrium with its faces at the displacements of the solution of order 0.

    Args:
        dropped: the case.
        at: (m,) coordinates x of the nodes of S.

    Returns:
        (m,) work that belongs to each node.
    """
    model, state, layers = dropped.full.model, dropped.full, dropped.estimate._layers
    Q, comm = fem.functionspace(model.domain.mesh, ("Lagrange", 1)), model.comm
    v, q, x = fem.Function(model.V), ufl.TestFunction(Q), model.V.tabulate_dof_coordinates()[:, :2]
    inner = np.flatnonzero(np.abs(x[:, 1]) <= dropped.eps / 2 * (1 + 1e-9))
    faces = layers.at_faces(dropped.estimate.state.u.x.array)
    bent = Probe(layers.state(layers.dirichlet_displacements(faces, layers.load, layers.values)))
    everywhere = comm.allgather(x[inner])  # a probe needs the same points on all ranks
    begin = sum(len(there) for there in everywhere[: comm.rank])
    v.x.array.reshape(-1, 2)[inner] = bent.displacement(np.concatenate(everywhere))[begin : begin + len(inner)]
    (term,) = state.layers
    work = ufl.inner(state.stress(term), term.strain(v)) * term.weight * q * term.measure
    mine = Q.dofmap.index_map.size_local
    near = np.abs(Q.tabulate_dof_coordinates()[:mine, 0] - at[:, None]) < 10.0**-ROUND
    return np.asarray(comm.allreduce(near @ assemble_values(fem.form(work), mine)))


# ---------------------------------------------------------------- pictures
PANELS = {"change of t_N": ("traction", "estimated_traction"), "change of [u_N]": ("jump", "estimated_jump")}
PANELS["where the compliance changes"] = "density", "density"


def draw(record: Record) -> None:
    """Draw the effectivities of all cases, and the changes along S of one case.

    The values are read from effectivities.csv and along.csv in the folder of `record`.
    """
    parts, names = dict[str, dict[str, tuple[list[float], list[int]]]](), dict[str, list[str]]()
    for case, rows in record.load("effectivities.csv").split("case").items():
        group, _, name = case.partition(": ")
        names.setdefault(group, []).append(name)
        for field in ESTIMATED_FIELDS:
            for eps, value in zip(rows["eps"], rows[field], strict=True):
                x, y = parts.setdefault(group, {}).setdefault(f"{field}, eps = {fraction(eps)}", ([], []))
                x.append(value)
                y.append(len(names[group]) - 1)
    look = {"styles": ("o", "s", "x", "+"), "columns": 2, "levels": names, "save": record.path("effectivities.svg")}
    plotting.curves(parts, "1: the estimate is right", title="estimated over true changes", xlim=(0.98, 1.02), **look)
    table = record.load("along.csv")
    lines = {
        title: {"meshed layer": (table["x"], table[f"true_{column}"]), "estimate": (table["x"], table[estimated])}
        for title, (column, estimated) in PANELS.items()
    }
    plotting.curves(lines, f"x along S over its length; eps = {fraction(THICK)}", save=record.path("along.svg"))
