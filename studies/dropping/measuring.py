"""What leaving layers out changes: the truth, from meshed layers, and the estimate, from a better law on S."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import ufl

from forms import LinearElastic
from forms.kinematics import Expr
from studies.dropping.case import Case, Goal, Layers
from thinlayer import Model, RangeWarning, State, Surface, ThinLayer, march, solve
from thinlayer.running.record import Record

OUT = 3.0  # thicknesses: nearer to free ends no law on S says what tractions are
INNER = 0.25  # from the middle of S, where another program measured
QUANTITIES = ("traction", "jump")


@dataclass(frozen=True)
class Change:
    """What changes from the state of order 0 to another one.

    Attributes:
        traction, jump: L2 norms of the changes on a part of S, over those of the state of order 0.
        goals: name -> change of a goal, with its sign, over its value in the other state.
    """

    traction: float
    jump: float
    goals: dict[str, float]


@dataclass(frozen=True)
class Solved:
    """A case with a thickness, solved with the law of order 0, with a better law, and with meshed layers."""

    case: Case
    eps: float
    zero: State
    better: State
    full: State

    @classmethod
    def of(cls, case: Case, eps: float, record: Record | None = None) -> Solved:
        """Solve the three models."""
        structure, layers = case.structure(eps), case.layers(eps)
        zero = solved(case, structure.interface(layers, bodies=case.bodies), record)
        law = structure.interface(improved(layers, case), bodies=case.bodies)
        full = structure.full(layers, bodies=case.bodies)
        return cls(case, eps, zero, solved(case, law, record), solved(case, full, record))

    @property
    def unknowns(self) -> int:
        """Displacements of the model on S."""
        dofmap = self.zero.u.function_space.dofmap
        return int(dofmap.index_map.size_global * dofmap.index_map_bs)

    def change(self, other: State, *, inner: bool = False) -> Change:
        """The change from the law of order 0 to another state, on S further than `OUT` eps from free ends or `inner`."""
        surface = Surface(self.zero.model)
        part, sizes = self._part(surface, inner), {}
        for name in QUANTITIES:
            field = getattr(surface, name)
            given = field(self.zero)
            sizes[name] = surface.norm(field(other) - given, part) / surface.norm(given, part)
        return Change(**sizes, goals={goal.name: self._relative(surface, goal, other) for goal in self.case.goals})

    def _part(self, surface: Surface, inner: bool) -> Expr:
        x = ufl.SpatialCoordinate(surface.model.domain.mesh)
        if inner:
            return ufl.conditional(abs(x[0] - 0.5) < INNER, 1.0, 0.0)
        distance = self.case.distance
        return ufl.conditional(distance(x) > OUT * self.eps, 1.0, 0.0) if distance else 1

    def _relative(self, surface: Surface, goal: Goal, other: State) -> float:
        value = goal.value(surface, other)
        return (value - goal.value(surface, self.zero)) / value


def solved(case: Case, model: Model, record: Record | None = None) -> State:
    """The state of a model at the end of the case's step."""
    with warnings.catch_warnings():  # of laws out of their range, which the estimate says
        warnings.simplefilter("ignore", RangeWarning)
        state = march(model, [case.step]).last if case.step else solve(model)
    return record.solved(state) if record else state


def improved(layers: Layers, case: Case) -> Layers:
    """The layers with the better law."""

    def of(layer: ThinLayer) -> ThinLayer:
        edges = "free" if case.distance and type(layer.law) is LinearElastic else None
        return replace(layer, order=1, edges=edges)

    return {name: of(one) for name, one in layers.items()} if isinstance(layers, dict) else of(layers)


def effectivities(found: Solved) -> tuple[dict[str, float], list[dict[str, float | str]]]:
    """True changes, and estimated over true ones: of traction and jump, and a row for each goal."""
    truth, estimate = (found.change(state) for state in (found.full, found.better))
    row: dict[str, float] = {f"true_{name}": getattr(truth, name) for name in QUANTITIES}
    row |= {name: getattr(estimate, name) / getattr(truth, name) for name in QUANTITIES}
    goals: list[dict[str, float | str]] = []
    for goal, true in truth.goals.items():
        change = estimate.goals[goal]
        told = abs(change) > estimate.traction * estimate.jump
        goals.append({"goal": goal, "true": true, "effectivity": change / true, "told": float(told)})
    return row, goals


def distance_from_known(found: Solved) -> float | None:
    """Largest distance of the effectivities from those that another program found; None: it has found none."""
    if not (known := found.case.known.get(found.eps)):
        return None
    truth, estimate = (found.change(state, inner=found.case.inner) for state in (found.full, found.better))
    pairs = [(estimate.traction / truth.traction, known[0]), (estimate.jump / truth.jump, known[1])]
    goal = next(iter(truth.goals))
    pairs.append((estimate.goals[goal] / truth.goals[goal], known[2]))
    return max(abs(ratio - number) for ratio, number in pairs if number is not None)
