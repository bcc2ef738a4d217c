"""`thin_enough`: how thin a layer must be for its mesh to be dropped."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from forms.base import is_number
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.structure import Structure
from thinlayer.errors import ModelError
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.goal import Goal
from thinlayer.estimating.goals import Compliance
from thinlayer.estimating.places import NEAR_ENDS
from thinlayer.estimating.result import Estimate
from thinlayer.files.table import Table
from thinlayer.parallel.agreement import on_all
from thinlayer.solving.options import OptionValue
from thinlayer.solving.solvers import solve
from thinlayer.time.history import History
from thinlayer.time.marching import march

FIELDS = ("traction", "jump")
ACCURACY = 0.01  # of the thickness, relative
SURE = 3  # thicknesses in turn, each half of the one before, at which the error is allowed
FEW = 4  # halvings over which an error should fall
STALLED = 0.92  # error over that before so many halvings from which on it hardly falls
HALVINGS = 20  # of the thickness, at most, in search of one that is thin enough
THICKEST = 0.5  # thickness over the height of the thinner body up to which the search goes


@dataclass(frozen=True)
class ThinEnough:
    """The thickness below which a layer's mesh may be dropped.

    Attributes:
        eps: the thickness; where the error stays below the tolerance, the largest that was tried.
        tolerance: the relative error that is allowed.
        quantity: "traction", "jump", or the name of a goal.
        table: a row for each thickness that was tried: eps, error.
        found: whether the error is equal to the tolerance at `eps`, to one percent of the thickness.
    """

    eps: float
    tolerance: float
    quantity: str
    table: Table
    found: bool

    def __str__(self) -> str:
        allowed = f"{100 * self.tolerance:.3g} % in {self.quantity}"
        if self.found:
            return f"thinner than {self.eps:.3g} the layer's mesh may be dropped: at most {allowed}"
        return f"up to {self.eps:.3g} the layer's mesh may be dropped: at most {allowed}; thicker ones were not tried"


def thin_enough(
    structure: Structure,
    layer: ThinLayer,
    tolerance: float,
    goal: str | Goal = "traction",
    *,
    t: float = 0.0,
    times: Sequence[float] | None = None,
    bonded: bool = False,
    bodies: str = "kept",
    options: Mapping[str, OptionValue] | None = None,
) -> ThinEnough:
    """The thickness at which the estimated error of dropping a layer's mesh is equal to a tolerance. Collective.

    The layer's material stays the same: its real moduli are those of the thickness that is given. Each thickness is two
    solves on one mesh; it takes eight to twelve thicknesses.

    Args:
        structure: bodies, supports and loads.
        layer: the layer, with the thickness at which the search begins; its law per thickness, as always.
        tolerance: relative error that is allowed, between 0 and 1.
        goal: "traction" or "jump", on S away from its free ends; or a goal.
        t: time of the loads and supports, as in `solve`.
        times: ends of time steps, as in `march`, for layers with a rate or a memory; t is then not used.
        bonded: whether the layer is ignored altogether, instead of replaced by its law of order 0.
        bodies: "kept" or "extended", as of `Structure.interface`.
        options: PETSc options, as in `solve`.

    Raises:
        ModelError: arguments out of range; a layer of which nothing can be estimated; no thickness is thin enough.
        SolveError: as in `solve`.
    """
    _check(structure, layer, tolerance, goal, bonded, bodies)

    def solved(model: Model) -> State | History:
        return solve(model, t, options=options) if times is None else march(model, times, options=options)

    goals = (goal,) if isinstance(goal, Goal) else (Compliance(),)
    quantity = goal if isinstance(goal, str) else goal.name

    def scaled(eps: float) -> ThinLayer:
        return replace(layer, eps=eps, law=layer.law.per_thickness(eps / float(layer.eps)))

    begun = structure.interface(layer, bodies=bodies)
    alone = solved(structure.bonded()) if bonded else None

    def error(eps: float) -> float:
        if alone is not None:
            return _error(estimate(alone, scaled(eps), goals, options=options), quantity)
        model = begun.with_layer(scaled(eps)) if bodies == "kept" else structure.interface(scaled(eps), bodies=bodies)
        return _error(estimate(solved(model), goals=goals, options=options), quantity)

    rows: dict[float, float] = {}
    eps, found = _search(error, float(layer.eps), _thickest(begun), tolerance, rows)
    table = Table([{"eps": one, "error": rows[one]} for one in sorted(rows, reverse=True)])
    return ThinEnough(eps, tolerance, quantity, table, found)


def _check(
    structure: Structure, layer: ThinLayer, tolerance: float, goal: str | Goal, bonded: bool, bodies: str
) -> None:
    if not isinstance(structure, Structure):
        raise ModelError(f"thin_enough takes a Structure, of which it makes models, not {structure!r:.80}")
    with on_all(structure.comm):
        if bonded and bodies != "kept":
            raise ModelError("thin_enough: bonded bodies meet on S; bodies='extended' is for the interface law alone")
        if not isinstance(layer, ThinLayer):
            raise ModelError(f"thin_enough: the layer is {layer!r:.80}; give a ThinLayer, one for all seams")
        if not (is_number(tolerance) and 0 < tolerance < 1):
            raise ModelError(f"thin_enough: the tolerance is {tolerance!r}; allowed: between 0 and 1")
        if not (isinstance(goal, Goal) or goal in FIELDS):
            raise ModelError(
                f"thin_enough: the goal is {goal!r}; allowed: {', '.join(FIELDS)}, or one of thinlayer.goals"
            )
        if bonded and goal == "jump":
            raise ModelError("thin_enough: bonded bodies have no jump; take the traction, or a goal")


def _thickest(model: InterfaceModel) -> float:
    """The largest thickness for which an interface law is tried."""
    return THICKEST * min(height for one in model.layers.values() for height in one.sheet.heights)


def _error(found: Estimate, quantity: str) -> float:
    """The estimated error of a quantity; infinite where S is nowhere farther from its free ends."""
    if found.unknown:
        raise ModelError(f"thin_enough: {found.unknown}")
    if quantity in FIELDS:
        error = found.traction if quantity == "traction" else found.jump
        return error if math.isfinite(error) else math.inf
    goal = found.goals[quantity]
    if goal.zero:
        raise ModelError(f"thin_enough: {quantity} is zero, and so has no relative error")
    return goal.relative if goal.told else goal.least


def _search(
    error: Callable[[float], float], start: float, thickest: float, tolerance: float, rows: dict[float, float]
) -> tuple[float, bool]:
    """The thickness below which errors are at most `tolerance`, and whether there is one above; fills rows.

    Errors may change their sign, and so be small at a thickness and large at smaller ones: the search goes down until they
    are allowed at a thickness, half of it, and a quarter, and then up to the first one that is not.
    """

    def excess(eps: float) -> float:
        """Logarithm of the error over the tolerance."""
        if eps not in rows:
            rows[eps] = error(eps)
        return math.log(max(rows[eps], 1e-300) / tolerance)

    low = top = min(start, thickest)
    passed = 0
    while passed < SURE:
        passed = passed + 1 if excess(low) <= 0 else 0
        _require_falling(rows, top, low, passed)
        low /= 2
    low *= 2**passed
    high = 2 * low
    while high <= thickest * (1 + ACCURACY) and excess(high) <= 0:
        low, high = high, 2 * high
    if high > thickest * (1 + ACCURACY):
        if low >= thickest or excess(thickest) <= 0:
            return max(low, thickest), False
        high = thickest
    while high > (1 + ACCURACY) * low:
        above, below = excess(high), excess(low)
        share = -below / (above - below) if math.isfinite(above) else 0.5
        middle = low * (high / low) ** min(max(share, 0.1), 0.9)
        low, high = (low, middle) if excess(middle) > 0 else (middle, high)
    return low, True


def _require_falling(rows: Mapping[float, float], top: float, low: float, passed: int) -> None:
    """Raise ModelError if errors do not fall with the thickness any more, and are not allowed."""
    before = low * 2**FEW
    if passed or before > top:
        return
    if math.isinf(rows[low]):
        raise ModelError(
            f"thin_enough: even at {low:.3g} the layer bears nothing farther than {NEAR_ENDS:g} thicknesses from its free "
            "ends; are there loads at this time?"
        )
    largest = max(error for eps, error in rows.items() if low < eps <= before)
    if rows[low] > STALLED * largest or low < top / 2**HALVINGS:
        raise ModelError(
            f"thin_enough: no thickness is thin enough: the error is {rows[low]:.3g} at {low:.3g}, and hardly falls with "
            "the thickness; is the layer much softer than the bodies?"
        )
