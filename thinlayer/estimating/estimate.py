"""`estimate`: by how much the answer changes as a layer is dropped, without meshing it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.kinematics import Expr
from geometry.seam import LAYER
from thinlayer.discretisation.bonded_model import BondedModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.estimating.better import BetterLaw, better_model
from thinlayer.estimating.goals import Compliance, Goal
from thinlayer.estimating.places import NEAR_ENDS, away_from_ends, density_of
from thinlayer.estimating.yielding import why_not
from thinlayer.files.table import Table
from thinlayer.output.surface import Surface
from thinlayer.output.surface_density import SurfaceDensity
from thinlayer.parallel.agreement import on_all
from thinlayer.ranges.sublayers import stiffness_of_jumps
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.options import OptionValue
from thinlayer.solving.solvers import solve
from thinlayer.time.history import History
from thinlayer.time.marching import march

Array = npt.NDArray[np.float64]
NOTHING = 1e-11  # traction over the layer's stiffness times displacements, and jump over these, that count as rounding
SAME = 1e-7  # difference of a change from the integral of its density, over the goal, that counts as none
ROUNDING = 1e-6  # of a goal that is zero but for rounding and the mesh, over its scale


@dataclass(frozen=True)
class GoalError:
    """The estimated error of a goal.

    Attributes:
        value: Q(u_0), of the given state.
        better: Q(u_1), of the better law.
        scale: what both are compared with to see whether they are only rounding.
        known: whether what both laws leave out of Q is of a higher order.
        least: product of the errors of traction and jump, each at most 1. Leading terms cancel in an error below it, and
            the estimate is none.
    """

    value: float
    better: float
    scale: float
    least: float
    known: bool = True

    @property
    def change(self) -> float:
        """Q(u_1) - Q(u_0)."""
        return self.better - self.value

    @property
    def relative(self) -> float:
        """|Q(u_1) - Q(u_0)|/|Q(u_1)|; nan: the goal is zero, or its error is not known."""
        return math.nan if self.zero or not self.known else abs(self.change / self.better) if self.better else math.inf

    @property
    def zero(self) -> bool:
        """Whether the goal is zero, but for rounding."""
        return max(abs(self.value), abs(self.better)) <= ROUNDING * self.scale

    @property
    def told(self) -> bool:
        """Whether `relative` is an estimate."""
        return self.known and not self.zero and not self.relative < self.least


@dataclass(frozen=True)
class LayerError:
    """The estimated errors of the traction and of the jump of a layer.

    Attributes:
        law: the better law.
        near: distance from free ends within which they are not known; 0: there are no free ends.
        traction: |t(u_1) - t(u_0)|/|t(u_0)| in L2 farther away; nan: not known.
        jump: likewise; nan beside bonded bodies.
    """

    law: BetterLaw
    near: float
    traction: float
    jump: float


@dataclass(frozen=True, repr=False)
class Estimate:
    """What dropping the mesh of a layer costs, see `estimate`.

    Attributes:
        state: u_0, as given.
        better: u_1, of the better laws.
        layers: name of a seam -> its errors.
        goals: name of a goal -> its error.
        traction, jump: as of `LayerError`, over all layers.
        unknown: why no number can be told; "": it can.
        seconds: wall time of the estimate.
    """

    state: State
    better: State
    layers: Mapping[str, LayerError]
    goals: Mapping[str, GoalError]
    traction: float
    jump: float
    unknown: str
    seconds: float
    _goals: Mapping[str, Goal] = field(default_factory=dict)
    _before: tuple[State | None, State | None] = (None, None)
    _options: Mapping[str, OptionValue] | None = None

    @property
    def cost(self) -> float:
        """Time of the solve of the better laws over that of the given state."""
        return self.better.report.seconds / self.state.report.seconds

    @property
    def laws(self) -> dict[str, str]:
        """Name of a seam -> what its better law is, and what it lacks."""
        return {name: str(one.law) for name, one in self.layers.items()}

    @property
    def dropped(self) -> str:
        """What the given state has in place of the layers, in words."""
        return "perfect bond" if isinstance(self.state.model, BondedModel) else "order 0"

    # ---------------------------------------------------------------- where
    def density(self, goal: str = "compliance") -> SurfaceDensity:
        """Where on S the change of a goal comes from: a density whose integral is Q(u_1) - Q(u_0). Collective.

        For linear models with symmetric laws the integral is exact, otherwise it is so to first order in the change. It is
        large where a mesh of the layer is needed.

        Raises:
            ModelError: no such goal; one without a dual; loads that act in one of both models alone.
        """
        if goal not in self._goals:
            known = ", ".join(map(repr, self._goals)) or "none"
            raise ModelError(f"estimate: there is no goal {goal!r}; there are: {known}")
        before, theirs = self._before
        with Adjoint(self.better, before, self._options) as adjoint:
            z = adjoint.weights(*self._goals[goal].dual(adjoint))
            found = density_of(adjoint, adjoint.summands(z, self.state, theirs))
        self._require_same_loads(found, self.goals[goal])
        return found

    def _require_same_loads(self, density: SurfaceDensity, goal: GoalError) -> None:
        """Raise ModelError if the identity does not hold, as loads act in one of both models alone."""
        model, size = self.better.model, max(abs(goal.value), abs(goal.better))
        if model.linear and model.symmetric and abs(density.total - goal.change) > SAME * max(size, goal.scale):
            raise ModelError(
                "estimate: loads act in one of both models alone, such as tractions on the layer's side or its weight, so "
                f"that the change {goal.change:.4g} has no density on S (it would add up to {density.total:.4g})"
            )

    def map(self, goal: str = "compliance") -> Expr:
        """`density` as a scalar UFL expression on S of the model of `better`. Collective."""
        return self.density(goal).expression

    # ---------------------------------------------------------------- words
    @property
    def table(self) -> Table:
        """A row for each quantity: its value with the given law, with the better one, and the relative error."""
        nan, rows = math.nan, []
        for name, one in self.layers.items():
            of = f" {name}" if len(self.layers) > 1 else ""
            rows.append({"quantity": f"traction{of}", "value": nan, "better": nan, "error": one.traction})
            rows.append({"quantity": f"jump{of}", "value": nan, "better": nan, "error": one.jump})
        for name, goal in self.goals.items():
            error = goal.relative if not self.unknown else nan
            rows.append({"quantity": name, "value": goal.value, "better": goal.better, "error": error})
        return Table(rows)

    @cached_property
    def sentences(self) -> list[str]:
        """What the estimate says."""
        if self.unknown:
            return [f"{self.dropped}: {self.unknown}"]
        found = []
        errors = [f"{_percent(self.traction)} in traction"] if math.isfinite(self.traction) else []
        errors += [f"{_percent(self.jump)} in jump"] if math.isfinite(self.jump) else []
        for name, goal in self.goals.items():
            error = _percent(goal.relative) if goal.told else f"below {_percent(goal.least)}"
            error = error if goal.known else "not known"
            errors.append(f"{name} is zero" if goal.zero else f"{error} in {name}")
        found.append(f"{self.dropped}: {', '.join(errors)}")
        for name, one in self.layers.items():
            where = f" of {name}" if len(self.layers) > 1 else ""
            if one.near:
                found.append(f"within {one.near:.3g} of free ends{where}: not known")
            if math.isnan(one.traction):
                found.append(f"the layer{where} is nowhere farther from its free ends, or bears no traction there")
            if one.law.lacks:
                found.append(one.law.lacks)
        if not all(goal.known for goal in self.goals.values()):
            found.append("what tractions on the layer's own side do inside it is left out: their work is not known")
        return found

    def __str__(self) -> str:
        return "; ".join(self.sentences)

    def __repr__(self) -> str:
        return f"Estimate({self})"


def _percent(x: float) -> str:
    return f"{100 * x:.2g} %" if x < 0.995 else f"{100 * x:.0f} %"


def estimate(
    state: State | History,
    layer: Layers | None = None,
    goals: Sequence[Goal] = (Compliance(),),
    *,
    options: Mapping[str, OptionValue] | None = None,
) -> Estimate:
    """By how much the answer changes if a layer's mesh is dropped, estimated without meshing it. Collective.

    The structure is solved once more on the same mesh with a better law of the layer: of order 1, with its free ends, and
    with a pressure that flows along S where the layer is nearly incompressible. The difference of the two answers is, as
    the thickness tends to zero, the error of the first one. Near free ends, within three thicknesses, tractions and jumps
    of neither law are those of the layer.

    Args:
        state: a state of an interface model of order 0, or its history (marched with theta = 1, all states kept), which is
            then marched again; or a state of bonded bodies ("may the layer be ignored altogether?").
        layer: for bonded bodies, what was left out: as in `Structure.interface`, with the thickness.
        goals: numbers whose change is wanted.
        options: PETSc options, as in `solve`.

    Raises:
        ModelError: a state or law of which nothing can be estimated, with the reason.
        SolveError: as in `solve`.
    """
    start = time.perf_counter()
    given = state.last if isinstance(state, History) else state
    if not isinstance(given, State):
        raise ModelError(f"estimate takes a state or a history, as solve and march return them, not {given!r:.80}")
    with on_all(given.model.comm):
        checked = _checked_goals(goals)
        if isinstance(state, State) and not state.sudden:
            _require_no_memory(state)
    model, laws = _with_better_laws(given, layer)
    with on_all(model.comm):
        for goal in checked.values():
            goal.check(model)
    if isinstance(state, History):
        theirs, times = _one_before(state), state.t
        history = march(model, times[times > times[0]].tolist(), start=float(times[0]), options=options)
        better, before = history.last, (_one_before(history), theirs)
    else:
        like = given if isinstance(given.model, InterfaceModel) and not model.linear else None
        better, before = solve(model, given.t, options=options, like=like), (None, None)
    unknown = why_not(better)
    total, layers = _Norms(np.zeros(4)), {}
    for name, law in laws.items():
        norms = _Norms(np.zeros(4)) if unknown else _Norms.on(given, better, model.layers[name])
        near = NEAR_ENDS * float(law.layer.eps) if law.ends else 0.0
        total, layers[name] = total + norms, LayerError(law, near, *norms.errors)
    traction, jump = total.errors
    least = min(traction, 1.0) * min(jump if math.isfinite(jump) else traction, 1.0)
    found = {}
    for name, goal in checked.items():
        scale = max(goal.scale(given, model), goal.scale(better, model))
        known = not (isinstance(goal, Compliance) and _has_side_loads(model))
        found[name] = GoalError(goal.value(given, model), goal.value(better, model), scale, least, known)
    return Estimate(
        given, better, layers, found, traction, jump, unknown, time.perf_counter() - start, checked, before, options
    )


def _require_no_memory(state: State) -> None:
    """Raise ModelError if a state that steps in time led to cannot be found again by one solve."""
    for law in (term.law for term in state.model.terms):
        if law.traits.remembers or law.traits.rate:
            raise ModelError(
                f"estimate: {type(law).__name__} remembers, and steps in time have led to this state; give the history, "
                "which is marched again"
            )


def _has_side_loads(model: InterfaceModel) -> bool:
    """Whether tractions act on a layer's own side: they do work in the layer itself, which no law on S knows."""
    return any(name.endswith(f"/{LAYER}") for name in model.structure.tractions or {})


def _checked_goals(goals: Any) -> dict[str, Goal]:
    given = list(goals) if isinstance(goals, Sequence) else [goals]
    for goal in given:
        if not isinstance(goal, Goal):
            raise ModelError(f"estimate: {goal!r:.80} is no goal; give those of thinlayer.goals")
    names = [goal.name for goal in given]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ModelError(f"estimate: two goals have the name {twice[0]!r}")
    return dict(zip(names, given, strict=True))


def _with_better_laws(state: State, layer: Layers | None) -> tuple[InterfaceModel, dict[str, BetterLaw]]:
    """The interface model with better laws of the layers, and what they are. Collective."""
    model = state.model
    if isinstance(model, InterfaceModel):
        if layer is not None:
            raise ModelError("estimate: layer= is for a state of bonded bodies; an interface model has its layers")
        return better_model(model)
    if not isinstance(model, BondedModel):
        raise ModelError(f"estimate: a {model.name} model has nothing dropped; give a state of an interface model")
    if layer is None:
        raise ModelError("estimate: bodies are bonded in this state; give layer=, what was left out")
    return better_model(model.structure.interface(layer))  # type: ignore[attr-defined]


@dataclass(frozen=True)
class _Norms:
    """Squares of norms on S: of the changes of t and of [u], of t(u_0) and of [u_0]; zero where they are not known."""

    squares: Array

    @classmethod
    def on(cls, before: State, better: State, one: SeamLayer) -> _Norms:
        """Those on a seam, away from its free ends. Collective."""
        model = better.model
        surface = Surface(model, one.name)
        assert one.thin
        part = away_from_ends(surface.model, one, NEAR_ENDS * float(one.thin.eps))
        t, w = surface.traction(before), surface.jump(before)
        fields = [surface.traction(better) - t, t]
        if isinstance(before.model, InterfaceModel):
            fields += [surface.jump(better) - w, w]
        found = np.array([surface.norm(f, part) ** 2 for f in fields])
        moved = float(better.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)) ** 2 * surface.integral(part)
        for k, size in ((1, max(stiffness_of_jumps(one.samples[0])) ** 2), (3, 1.0)):
            if k < len(found) and found[k] <= NOTHING**2 * size * moved:
                found[k] = 0.0  # rounding of bodies that bear nothing there
        return cls(np.append(found, np.zeros(4 - len(found))))

    def __add__(self, other: _Norms) -> _Norms:
        return _Norms(self.squares + other.squares)

    @property
    def errors(self) -> tuple[float, float]:
        """Relative errors of traction and jump; nan: not known."""
        of_t, t, of_w, w = (float(root) for root in np.sqrt(self.squares))
        return of_t / t if t else math.nan, of_w / w if w else math.nan


def _one_before(history: History) -> State | None:
    """The state from which the last step of a history was made; None: rest."""
    if history.theta != 1:
        raise ModelError(f"estimate: the history was marched with theta = {history.theta:g}; it must be 1")
    if len(history) > 1 and len(history) - 2 not in history.states:
        raise ModelError("estimate: the history lacks the state before its last step; march with keep='all'")
    return history.states[len(history) - 2] if len(history) > 1 else None
