"""What leaving layers out changes: the truth, from meshed layers, and the estimate."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
import ufl

from forms.kinematics import Expr
from studies.dropping.case import Case
from thinlayer import Estimate, History, Model, RangeWarning, State, Surface, estimate, march, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.estimating.places import away_from_ends
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
        with _unwarned():
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
        parts = {
            name: away_from_ends(model, model.layers[name], one.near) if one.near else 1
            for name, one in self.found.layers.items()
        }
        goals = {
            goal.name: goal.value(self.full, model) - self.found.goals[goal.name].value for goal in self.case.asked
        }
        return self._on_s(self.full, parts) | goals

    @property
    def estimated(self) -> dict[str, float]:
        """The same changes, estimated."""
        on_s = {name: float(getattr(self.found, name)) for name in FIELDS}
        return on_s | {name: goal.change for name, goal in self.found.goals.items()}

    def inner(self, state: State) -> dict[str, float]:
        """Relative changes of traction and jump to a state on the inner half of S, from x = 1/4 to 3/4."""
        x = ufl.SpatialCoordinate(self.found.better.model.domain.mesh)
        part = ufl.conditional(abs(x[0] - 0.5) < INNER, 1.0, 0.0) if self.case.inner else 1
        return self._on_s(state, dict.fromkeys(self.found.layers, part))

    def _on_s(self, state: State, parts: dict[str, Expr]) -> dict[str, float]:
        squares = np.zeros((2, 2))
        for name, part in parts.items():
            surface = Surface(self.found.better.model, name)
            for row, field in zip(squares, (surface.traction, surface.jump), strict=True):
                before = field(self.found.state)
                row += surface.norm(field(state) - before, part) ** 2, surface.norm(before, part) ** 2
        return {name: math.sqrt(change / size) for name, (change, size) in zip(FIELDS, squares, strict=True)}


def solved(case: Case, model: Model) -> State | History:
    """The state of a model, or the history of the case's step."""
    with _unwarned():
        return march(model, [case.step]) if case.step else solve(model)


def unknowns(model: Model) -> int:
    """The number of displacements."""
    return int(model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs)


def last(found: State | History) -> State:
    """The last state."""
    return found.last if isinstance(found, History) else found


def _unwarned() -> warnings.catch_warnings[None]:
    """Without warnings of laws out of their range, which the estimate says."""
    return warnings.catch_warnings(action="ignore", category=RangeWarning)


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
