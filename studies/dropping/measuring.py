"""What leaving layers out changes, from meshed layers and estimated: on S, along it, over the thickness; and costs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from scipy.optimize import brentq

from forms import LinearElastic, Rubber
from geometry import sandwich
from studies.dropping.cases import STEEL, Case, unwarned
from studies.dropping.structures import corner, displaced, free, loaded
from studies.problems import of
from studies.sweeping import last
from thinlayer import (
    Estimate,
    History,
    Model,
    Probe,
    State,
    Structure,
    Surface,
    Table,
    ThinLayer,
    estimate,
    goals,
    march,
    solve,
    thin_enough,
)
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.estimating.on_surface import away_from_ends
from thinlayer.running.record import Record

INNER = 0.25  # from the middle of S, where another program measured
FIELDS = ("traction", "jump")


@dataclass(frozen=True)
class Dropped:
    """A case whose layers were dropped, and meshed.

    Attributes:
        case, eps: the case and its thickness.
        found: the estimate.
        full: state with meshed layers.
    """

    case: Case
    eps: float
    found: Estimate
    full: State

    @classmethod
    def of(cls, case: Case, eps: float, record: Record | None = None) -> Dropped:
        """Solve a case with the law of order 0, estimate what that changes, and solve it with meshed layers."""
        structure = case.structure(eps)
        zero = solved(case, structure.interface(case.layers(eps), bodies=case.bodies))
        with unwarned():
            found = estimate(zero, goals=case.asked)
        # a nearly incompressible layer is meshed with a pressure, as its better law has one
        layers = {name: replace(one.law.layer, order=0, edges=None) for name, one in found.layers.items()}
        full = last(solved(case, structure.full(layers, bodies=case.bodies)))
        if record:
            for state in (found.state, found.better, full):
                record.solved(state)
        return cls(case, eps, found, full)

    @property
    def truth(self) -> dict[str, float]:
        """Changes of traction and jump to meshed layers, relative, where the estimate tells them; of goals, absolute."""
        model = self.found.better.model
        assert isinstance(model, InterfaceModel)

        def part(surface: Surface) -> Any:
            one = self.found.layers[surface.seam]
            return away_from_ends(surface, model.layers[surface.seam], one.near) if one.near else 1.0

        goals = {
            goal.name: goal.value(self.full, model) - self.found.goals[goal.name].value for goal in self.case.asked
        }
        return self._on_s(self.full, part) | goals

    @property
    def estimated(self) -> dict[str, float]:
        """The same changes, estimated."""
        on_s = {name: float(getattr(self.found, name)) for name in FIELDS}
        return on_s | {name: goal.change for name, goal in self.found.goals.items()}

    def inner(self, state: State) -> dict[str, float]:
        """Relative changes of traction and jump to a state on the inner half of S, from x = 1/4 to 3/4."""

        def part(on: Surface) -> Any:
            return abs(on.x[0] - 0.5) < INNER if self.case.inner else 1.0

        return self._on_s(state, part, Surface.reaction)  # as the other program has it

    def _on_s(
        self,
        state: State,
        part_of: Callable[[Surface], Any],
        traction: Callable[[Surface, State], Array] = Surface.traction,
    ) -> dict[str, float]:
        squares = np.zeros((2, 2))
        for name in self.found.layers:
            surface = Surface(self.found.better.model, name)
            part = part_of(surface)
            for row, field in zip(squares, (traction, Surface.jump), strict=True):
                before = field(surface, self.found.state)
                row += surface.norm(field(surface, state) - before, part) ** 2, surface.norm(before, part) ** 2
        return {name: math.sqrt(change / size) for name, (change, size) in zip(FIELDS, squares, strict=True)}


def solved(case: Case, model: Model) -> State | History:
    """The state of a model, or the history of the case's step."""
    with unwarned():
        return march(model, [case.step]) if case.step else solve(model)


def unknowns(model: Model) -> int:
    """The number of displacements."""
    return int(model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs)


def effectivities(one: Dropped) -> tuple[dict[str, float], list[dict[str, float | str]]]:
    """True changes and estimated over true ones: of traction and jump, and a row for each goal."""
    truth, estimated = one.truth, one.estimated
    row = {f"true_{name}": truth[name] for name in FIELDS}
    row |= {name: estimated[name] / truth[name] for name in FIELDS}
    goals: list[dict[str, float | str]] = []
    for name, goal in one.found.goals.items():
        true = truth[name] / goal.value
        goals.append(
            {"goal": name, "true": true, "effectivity": estimated[name] / truth[name], "told": float(goal.told)}
        )
    return row, goals


def from_known(one: Dropped) -> float | None:
    """Largest distance of the effectivities from those that another program found; None: it has found none."""
    if not (known := one.case.known.get(one.eps)):
        return None
    full, better = one.inner(one.full), one.inner(one.found.better)
    first = one.case.asked[0].name
    found = [*(better[name] / full[name] for name in FIELDS), one.estimated[first] / one.truth[first]]
    return max(abs(a - b) for a, b in zip(found, known, strict=True) if b is not None)


# ---------------------------------------------------------------- along S
Array = npt.NDArray[np.float64]
ROUND = 9  # digits of places


def along(one: Dropped) -> Table:
    """Changes of the normal components of t and [u] along S, and densities of the change of the compliance.

    Bodies, loads and supports are linear and fixed. With L the loads, t_0, u_0 of the law of order 0 and u with meshed
    layers, L(u) - L(u_0) = int_S t_0 . [u] - int_layer stress(u) : strain(v) for any v that is u_0 on the faces; v is
    linear between them. Of the estimate the density is its own.

    Args:
        one: two bodies in 2D, S between them on y = 0, elastic laws without a pressure, loads alone.
    """
    found, surface = one.found, Surface(one.found.better.model)
    columns = {}
    for name, field in zip(FIELDS, (surface.traction, surface.jump), strict=True):
        before = field(found.state)
        for which, state in (("true", one.full), ("estimated", found.better)):
            x, values = surface.profile(field(state) - before)
            columns[f"{which}_{name}"] = values[:, 1]
    _, on_s = surface.profile((surface.traction(found.state) * surface.jump(one.full)).sum(axis=0))
    columns["density"] = found.density()
    columns["true_density"] = on_s - _of_layer(one, x[:, 0]) / surface.areas
    return Table(
        {"x": float(x[k, 0]), **{name: float(c[k]) for name, c in columns.items()}} for k in np.argsort(x[:, 0])
    )


def _of_layer(one: Dropped, at: Array) -> Array:
    """Work of the meshed layer's stress in displacements u_0 of its faces, spread over the places x of columns."""
    model, state = one.full.model, one.full
    V, Q = model.V, fem.functionspace(model.domain.mesh, ("Lagrange", 1))
    v, q = fem.Function(V), ufl.TestFunction(Q)
    x = V.tabulate_dof_coordinates()[:, :2]
    layer = np.flatnonzero(np.abs(x[:, 1]) <= one.eps / 2 * (1 + 1e-9))
    v.x.array.reshape(-1, 2)[layer] = _between(one, x[layer])
    (term,) = state.layers
    work = ufl.inner(state.stress(term), term.strain(v)) * term.weight * q * term.measure
    found = fem.assemble_vector(fem.form(work))
    found.scatter_reverse(la.InsertMode.add)
    mine = Q.dofmap.index_map.size_local
    near = np.abs(Q.tabulate_dof_coordinates()[:mine, 0] - at[:, None]) < 10.0**-ROUND
    return np.asarray(model.comm.allreduce(near @ found.array[:mine]))


def _between(one: Dropped, x: Array) -> Array:
    """Displacements u_0 (n, 2) at places (n, 2) of the meshed layer, linear from face to face. Collective."""
    comm, count = one.full.model.comm, len(x)
    everywhere = comm.allgather(x)  # a probe has the same places on all ranks
    probe, places = Probe(one.found.state), np.concatenate(everywhere) * (1.0, 0.0)
    begin = sum(len(there) for there in everywhere[: comm.rank])
    upper, lower = (probe.displacement(places, side=side)[begin : begin + count] for side in ("upper", "lower"))
    share = x[:, 1:] / one.eps + 0.5
    return np.asarray(share * upper + (1 - share) * lower)


# ---------------------------------------------------------------- how thin
FINEST = 1 / 64  # for which the mesh is fine enough
ACROSS = 2.0  # by which the thickness found by meshing may differ from what is told
SAME = 2e-3  # of thicknesses found by meshing


@dataclass(frozen=True)
class Question:
    """How thin must a layer be to be dropped?

    Attributes:
        name: of the question.
        structure: makes the structure; its mesh does for all thicknesses.
        law: with real moduli, which stay.
        tolerance: of the relative change.
        goal: "traction", "jump" or a goal.
    """

    name: str
    structure: Callable[[], Structure]
    law: LinearElastic | Rubber
    tolerance: float
    goal: Any

    def told(self) -> float:
        """The thickness without meshing the layer."""
        with unwarned():
            layer = ThinLayer(self.law, FINEST)
            return float(thin_enough(self.structure(), layer, self.tolerance, goal=self.goal).eps)

    def by_meshing(self, near: float, record: Record | None = None) -> float:
        """The thickness at which the true change is the tolerance; `near` is close to it."""
        asked = () if isinstance(self.goal, str) else (self.goal,)

        def excess(log: float) -> float:
            case = Case(self.name, lambda _: self.structure(), of(self.law, None), asked=asked)
            one = Dropped.of(case, math.exp(log), record)
            truth = one.truth
            size = truth[self.goal] if isinstance(self.goal, str) else truth[self.goal.name]
            if not isinstance(self.goal, str):
                size = abs(size / self.goal.value(one.full, one.found.better.model))
            return math.log(size / self.tolerance)

        return math.exp(brentq(excess, math.log(near / ACROSS), math.log(near * ACROSS), xtol=SAME))


def questions() -> list[Question]:
    """The questions."""
    polymer = LinearElastic.young(E=3.0, nu=0.35)
    return [
        Question("traction, free ends", lambda: free(FINEST), polymer, 0.02, "traction"),
        Question("jump, free ends", lambda: free(FINEST), polymer, 0.08, "jump"),
        Question("compliance, free ends", lambda: free(FINEST, load=(1.0, 0.0)), polymer, 0.03, goals.Compliance()),
        Question(
            "reaction, rubber bearing",
            lambda: displaced(FINEST, body=STEEL),
            Rubber.shear(1.0, 0.49),
            0.1,
            goals.Reaction("TOP", (0.0, 1.0)),
        ),
    ]


# ---------------------------------------------------------------- costs
EPS = 1 / 32
REPEATS = 5
ELASTIC = ThinLayer(LinearElastic.shear(30.0, 0.3), EPS, at=1.0)
RUBBER = ThinLayer(Rubber.shear(30.0, 0.49), EPS, at=1.0)


def _fine() -> Structure:
    """Two blocks with free sides, on a fine mesh."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 60, h_ends=EPS / 8, cell="quadrilateral")
    return loaded(joint, (0.3, -1.0))


PLACES: dict[str, tuple[Callable[[], Structure], ThinLayer]] = {
    "small": (lambda: free(EPS), ELASTIC),
    "fine": (_fine, ELASTIC),
    "fine, rubber": (_fine, RUBBER),
    "3D": (lambda: corner(EPS), ELASTIC),
}


def cost(name: str) -> dict[str, float | str]:
    """Times of one of `PLACES`: medians of several runs after a first one, processor time.

    Returns:
        seconds: of building the interface model and solving it.
        further_solves: what the package says, solves alone.
        over_solve: all of the estimate, over the solve of the interface model.
        over_model: over building this model and solving it.
        over_meshing: over meshing the layer, building that model and solving it.
    """
    make, layer = PLACES[name]
    structure = make()
    rows = [_once(structure, layer) for _ in range(REPEATS + 1)][1:]
    model, alone, told, meshed, further = (median(row[k] for row in rows) for k in range(5))
    size = unknowns(structure.interface(layer))
    ratios = {"solve": alone, "model": model + alone, "meshing": meshed}
    row: dict[str, float | str] = {"case": name, "unknowns": size, "seconds": model + alone, "further_solves": further}
    return row | {f"over_{key}": told / value for key, value in ratios.items()}


def _once(structure: Structure, layer: ThinLayer) -> tuple[float, ...]:
    """Times of building the interface model, of its solve, of the estimate, of meshing; and the estimate's own ratio."""
    with unwarned():
        model, building = _timed(lambda: structure.interface(layer))
        state, solving = _timed(lambda: solve(model))
        found, telling = _timed(lambda: estimate(state))
        _, meshing = _timed(lambda: solve(structure.full(layer)))
    return building, solving, telling, meshing, found.cost


def _timed(do: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    found = do()
    return found, time.process_time() - start
