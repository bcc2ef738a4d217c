"""Estimate: what an estimate of the error of interface laws says, in numbers, bounds, places and words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from forms.base import InputError
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer_model import LayerModel
from thinlayer.discretisation.state import State
from thinlayer.estimating.better import BetterLaw, creeps
from thinlayer.estimating.global_local import NARROW, Bounds, GlobalLocal, Iterate
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.on_surface import density_by_layers, density_of
from thinlayer.output.surface import Surface
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_alone import HeldLayers, LayerAlone
from thinlayer.solving.petsc import OptionValue
from thinlayer.system.table import Table

SAME = 1e-7  # difference of a change from the integral of its density, over the goal, that counts as none
ROUNDING = 1e-6  # of a goal that is zero but for rounding, over its scale
FIXED = 1e-10  # change of a goal, over its scale, that is only rounding: equilibrium gives the goal
NOISE = 0.1  # what changes of goals, over their scale, were found to be wrong by at most, over the error in traction
OF_JUMPS = 0.15  # the same of errors in jump


@dataclass(frozen=True)
class GoalError:
    """The estimated error of a goal.

    Attributes:
        value: Q(u_0), of the given state.
        better: Q(u_1), of the better law.
        scale: what both are compared with to see whether they are only rounding.
        traction: the error of the traction, or what is not told of it where that is more.
        known: whether what both laws leave out of Q is of a higher order.
        lower, upper: bounds of Q with the layer meshed; nan: there are none.
    """

    value: float
    better: float
    scale: float
    traction: float
    known: bool = True
    lower: float = math.nan
    upper: float = math.nan

    @property
    def bounded(self) -> bool:
        """Whether there are bounds."""
        return math.isfinite(self.lower)

    @property
    def between(self) -> tuple[float, float]:
        """The least and the largest error that bounds allow, |Q - Q(u_0)|/|Q|."""
        errors = [abs(q - self.value) / abs(q) if q else math.inf for q in (self.lower, self.upper)]
        least = 0.0 if self.lower <= self.value <= self.upper else min(errors)
        return least, math.inf if self.lower < 0 < self.upper else max(errors)

    @property
    def least(self) -> float:
        """The noise of `relative`: leading terms cancel in an error below it, and the estimate is none."""
        if self.fixed or self.bounded:
            return 0.0
        noise = NOISE * min(1.0, self.traction) * self.scale  # 1 where that is nan
        return noise / abs(self.better) if self.better else math.inf

    @property
    def change(self) -> float:
        """Q(u_1) - Q(u_0)."""
        return self.better - self.value

    @property
    def relative(self) -> float:
        """|Q(u_1) - Q(u_0)|/|Q(u_1)|; nan: the goal is zero, or its error is not known."""
        if self.zero or not self.known:
            return math.nan
        return 0.0 if self.fixed else abs(self.change / self.better) if self.better else math.inf

    @property
    def zero(self) -> bool:
        """Whether the goal is zero, but for rounding."""
        return max(abs(self.value), abs(self.better)) <= ROUNDING * self.scale

    @property
    def told(self) -> bool:
        """Whether `relative` is an estimate."""
        return self.known and not self.zero and not self.relative < self.least

    @property
    def at_most(self) -> float:
        """What the true error is at most, relative: the bound, or the estimate, with its noise where it is none."""
        return self.between[1] if self.bounded and not self.fixed else at_most(self.relative, self.least)

    @property
    def fixed(self) -> bool:
        """Whether the goal does not change, as equilibrium gives it."""
        return abs(self.change) <= FIXED * self.scale


@dataclass(frozen=True)
class LayerError:
    """The estimated errors of the traction and of the jump of a layer.

    Attributes:
        law: the better law.
        near: distance from free ends within which they are not known; 0: there are no free ends.
        traction: |t(u_1) - t(u_0)|/|t(u_0)| in L2 farther away; nan: not known.
        jump: likewise; nan beside bonded bodies.
        ends: the part of the tractions there that free ends bring about, of which neither law knows; an error below it is
            not told.
        of_jumps: what is not told of jumps, over the error of the traction.
    """

    law: BetterLaw
    near: float
    traction: float
    jump: float
    ends: float
    of_jumps: float = OF_JUMPS

    @property
    def floors(self) -> tuple[float, float]:
        """As of `Estimate`, of this layer."""
        return self.ends, self.of_jumps * min(1.0, self.traction)


@dataclass(frozen=True, eq=False)
class Meshed:
    """The layers by themselves, meshed.

    Attributes:
        inside: a state of them, as they are between bodies.
        layers: they themselves.
        first: the state from which steps led to it.
        weights: of goals.
        energy: bounds of that of the given displacements, with the layers meshed, above the least one; None: not known, or
            of linear laws.
    """

    inside: State
    layers: LayerAlone
    first: State
    weights: Mapping[str, Iterate]
    energy: Bounds | None = None


@dataclass(frozen=True, repr=False)
class Estimate:
    """What dropping the mesh of a layer costs, see `estimate`.

    Attributes:
        state: u_0, as given.
        better: u_1, of the better laws; of linear ones the same model with the layers by themselves.
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
    meshed: Meshed | None = None

    @property
    def inside(self) -> State:
        """The layers by themselves, meshed, as they are between bodies: for `Probe`, pictures, files.

        Raises:
            InputError: the estimate is by a better law.
        """
        if self.meshed is None:
            raise InputError("estimate: the layers inside are not known; they were not meshed by themselves")
        return self.meshed.inside

    @property
    def energy(self) -> Bounds | None:
        """Bounds of the potential energy of the given displacements, with the layers meshed, above the least one.

        Half of what the bodies' part of the error has in the energy norm, squared, is at most that. None: of linear laws
        goals have bounds; or it is not known.
        """
        return self.meshed.energy if self.meshed else None

    @property
    def floors(self) -> tuple[float, float]:
        """Errors of traction and jump below which they are not told: the field of free ends, and where changes cancel."""
        ends, of_jumps = (max(getattr(one, name) for one in self.layers.values()) for name in ("ends", "of_jumps"))
        return ends, of_jumps * min(1.0, self.traction)

    @property
    def cost(self) -> float:
        """Time of the solve of the better laws, or of all of the estimate by layers, over that of the given state."""
        return (self.seconds if self.meshed else self.better.report.seconds) / self.state.report.seconds

    @property
    def laws(self) -> dict[str, str]:
        """Name of a seam -> what its better law is, and what it lacks."""
        return {name: str(one.law) for name, one in self.layers.items()}

    @property
    def dropped(self) -> str:
        """What the given state has in place of the layers, in words."""
        bonds, layers = self.state.model.bonds, self.state.model.layers
        orders = sorted({one.thin.order for one in layers.values() if one.thin})
        found = [f"order {' and '.join(map(str, orders))}"] if layers else []
        of = " of " + ", ".join(bonds) if layers else ""
        return ", ".join([f"perfect bond{of}", *found] if bonds else found)

    # ---------------------------------------------------------------- where
    def density(self, goal: str = "compliance") -> npt.NDArray[np.float64]:
        """Where on S the change of a goal comes from: a density whose integral is Q(u_1) - Q(u_0). Collective.

        It is (m,) at the nodes of `Surface(estimate.better.model)`, a field for its `integral`, `along`, `most_of`.

        For linear models with symmetric laws and linear goals the integral is exact, otherwise it is so to first order in
        the change. It is large where a mesh of the layer is needed.

        Raises:
            InputError: no such goal; one without a dual; loads that act in one of both models alone.
        """
        if goal not in self._goals:
            known = ", ".join(map(repr, self._goals)) or "none"
            raise InputError(f"estimate: there is no goal {goal!r}; there are: {known}")
        if self.meshed:
            of_law = self.meshed.first if self.state.model.bonds else self.state
            with Adjoint(of_law, options=self._options, meshed=True) as adjoint:
                iteration = GlobalLocal(adjoint, self.meshed.layers)
                return density_by_layers(iteration, self.state, self.better, self.meshed.weights[goal])
        before, theirs = self._before
        with Adjoint(self.better, before, self._options) as adjoint:
            z = adjoint.weights(*self._goals[goal].dual(adjoint))
            found = density_of(adjoint, adjoint.summands(z, self.state, theirs))
        if self.better.model.linear and self.better.model.symmetric and self._goals[goal].is_linear(adjoint.model):
            self._require_same_loads(found, self.goals[goal])
        return found

    def _require_same_loads(self, density: npt.NDArray[np.float64], goal: GoalError) -> None:
        """Raise InputError if the identity does not hold, as loads act in one of both models alone."""
        total = Surface(self.better.model).integral(density)
        size = max(abs(goal.value), abs(goal.better), goal.scale)
        if abs(total - goal.change) > SAME * size:
            raise InputError(
                "estimate: loads act in one of both models alone, such as tractions on the layer's side or its weight, so "
                f"that the change {goal.change:.4g} has no density on S (it would add up to {total:.4g})"
            )

    def by_seam(self, goal: str = "compliance") -> dict[str, float]:
        """Name of a seam -> the part of the change of a goal that its layer causes; errors as of `density`. Collective."""
        surface = Surface(self.better.model)
        changes = surface.at_points(self.density(goal)) * surface.weights
        return {name: float(changes[surface.seams == name].sum()) for name in self.layers}

    def with_finer_ends(self, goal: str = "compliance", at_ends: float = 1 / 16) -> float:
        """A goal's better value if the layer's cells are divided towards its free ends and junctions. Collective.

        Its difference from the better value is what the layer's own cells leave there, to second order. The bodies' cells
        stay.

        Args:
            goal: its name.
            at_ends: how far cells there reach at most, over the thickness, > 0, as of `Zoom`.

        Raises:
            InputError: no such goal, or one that has no bounds.
        """
        if self.meshed is None or goal not in self.goals or not self.goals[goal].bounded:
            raise InputError(f"estimate: there is no goal {goal!r} with bounds, whose value with finer ends is known")
        model, alone, z = self.better.model, self.meshed.layers, self.meshed.weights[goal]
        assert isinstance(model, InterfaceModel)
        layers = {name: one.law.layer for name, one in self.layers.items()}
        reach = at_ends * min(float(layer.eps) for layer in layers.values())
        fine = HeldLayers(LayerModel(model, layers, alone.through, reach), self.state.t)
        inside = alone.inside(alone.at_faces(self.better.u.x.array), alone.load, alone.values)
        weights, found = alone.inside(z.v, z.load, z.values), []
        for held, w, w_z in (
            (alone, inside, weights),
            (fine, alone.in_parts(inside, fine), alone.in_parts(weights, fine)),
        ):
            load_z, values_z = self._goals[goal].in_layers(held)
            w, w_z = held.inside(w, held.load, held.values), held.inside(w_z, load_z, values_z)
            found.append(load_z @ w - w_z @ (held.K @ w - held.load))
        return float(self.goals[goal].better + found[1] - found[0])

    # ---------------------------------------------------------------- words
    @property
    def table(self) -> Table:
        """A row for each quantity: values with the given and the better law, relative error, its noise, bounds."""
        nan, rows = math.nan, []
        for name, one in self.layers.items():
            of = f" {name}" if len(self.layers) > 1 else ""
            for which, error, noise in zip(("traction", "jump"), (one.traction, one.jump), one.floors, strict=True):
                row = {"quantity": f"{which}{of}", "value": nan, "better": nan, "error": error, "noise": noise}
                rows.append((row if math.isfinite(error) else row | {"noise": nan}) | {"lower": nan, "upper": nan})
        for name, goal in self.goals.items():
            noise = goal.least if math.isfinite(goal.relative) else nan
            row = {"quantity": name, "value": goal.value, "better": goal.better, "error": goal.relative, "noise": noise}
            rows.append(row | {"lower": goal.lower, "upper": goal.upper})
        if energy := self.energy:
            row = {
                "quantity": "energy above the least",
                "value": energy.told,
                "better": 0.0,
                "error": nan,
                "noise": nan,
            }
            rows.append(row | {"lower": energy.lower, "upper": energy.upper})
        return Table(rows)

    @property
    def caveats(self) -> list[str]:
        """What the estimate leaves out, in words."""
        found = []
        if self.state.sudden and any(creeps(term.law) for term in self.better.model.terms):
            found.append("at t = 0+, just after sudden loads; for later times march, and give the history")
        if self.unknown:
            return found
        if self.meshed:
            found.append(f"for these cells of the bodies, and {self.meshed.layers.through} cells through the layer")
        if self.energy:
            between = f"{self.energy.lower:.3g} to {self.energy.upper:.3g}"
            found.append(f"laws are not linear: goals have no bounds, the energy is {between} above the least")
        found += dict.fromkeys(one.law.lacks for one in self.layers.values() if one.law.lacks)
        if not all(goal.known for goal in self.goals.values()):
            found.append("laws on S leave out a part of what forces on the layer's own side do")
        return found

    @cached_property
    def sentences(self) -> list[str]:
        """What the estimate says."""
        if self.unknown:
            return [f"{self.dropped}: {self.unknown}", *self.caveats]
        errors = _said_of_fields((self.traction, self.jump), self.floors)
        errors += [_said(name, goal) for name, goal in self.goals.items()]
        found = [f"{self.dropped}: {', '.join(errors)}"]
        for name, one in self.layers.items():
            where = f" of {name}" if len(self.layers) > 1 else ""
            if where and math.isfinite(one.traction):
                found.append(f"{name}: {', '.join(_said_of_fields((one.traction, one.jump), one.floors))}")
            if one.near:
                found.append(f"within {one.near:.3g} of free ends{where}: not known")
            if math.isnan(one.traction):
                found.append(f"the layer{where} is nowhere farther from its free ends, or bears no traction there")
        return found + self.caveats

    def __str__(self) -> str:
        return "; ".join(self.sentences)

    def __repr__(self) -> str:
        return f"Estimate({self})"


def _said_of_fields(errors: tuple[float, float], floors: tuple[float, float]) -> list[str]:
    pairs = zip(("traction", "jump"), errors, floors, strict=True)
    return [f"{_or_below(error, least)} in {name}" for name, error, least in pairs if math.isfinite(error)]


def _said(name: str, goal: GoalError) -> str:
    if goal.zero or not goal.known:
        return f"{name} is zero" if goal.zero else f"not known in {name}"
    if not goal.told and goal.least >= 1:
        return f"{name} is nearly zero: its error is noise"
    if goal.bounded and not goal.fixed and goal.upper - goal.lower > NARROW * abs(goal.change):
        return f"between {' and '.join(map(_percent, goal.between))} in {name}"
    return f"{_or_below(goal.relative, goal.least)} in {name}"


def at_most(error: float, noise: float) -> float:
    """What a true error is at most: its estimate, or with its noise where that is larger."""
    return error + noise if error < noise else error


def _or_below(error: float, noise: float) -> str:
    """An error, or what it is below."""
    if error == 0 and not noise:
        return "no change"
    return f"{'below ' if error < noise else ''}{_percent(at_most(error, noise))}"


def _percent(x: float) -> str:
    return f"{100 * x:.2g} %" if x < 0.995 else f"{100 * x:.0f} %"
