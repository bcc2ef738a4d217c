"""The function `thin_enough`: the thickness below which an interface law may replace a layer's mesh."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from forms.base import InputError, is_number, require
from geometry.inflating.layering import value_by_seam
from geometry.refusals import require_known
from geometry.seam import S
from thinlayer.discretisation.layer import Bond, Layers, SeamContent, ThinLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.structure import Structure
from thinlayer.errors import FormerNames, RangeWarning
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.result import ESTIMATED_FIELDS, Estimate
from thinlayer.solving.history import History
from thinlayer.solving.petsc import Options
from thinlayer.solving.solve import solve
from thinlayer.system.progress import report
from thinlayer.system.ranks import errors_on_all
from thinlayer.system.table import Table
from thinlayer.time.marching import march

THICKNESS_TOLERANCE = 0.01  # relative tolerance of the thickness
THICKNESS_RATIO = math.sqrt(2)  # ratio of successive thicknesses, from the largest
N_ALLOWED_IN_TURN = 5  # number of successive thicknesses at which the error must be allowed
N_FALLING_STEPS = 16  # steps over which an error should fall; it stays over seven in nearly incompressible layers
STALLED_ERROR_RATIO = 0.92  # error over the largest error of the last N_FALLING_STEPS above which it hardly falls
MAX_THICKNESSES = 40  # largest number of steps in search of a thickness that is thin enough


@dataclass(frozen=True)
class ThinEnough(FormerNames):
    """The thickness below which a layer's mesh may be dropped, the result of `thin_enough`.

    Attributes:
        eps: the thickness. If the error stays below the tolerance, it is the largest thickness that was tried.
        tolerance: relative error that is allowed.
        quantity: quantity to which the error belongs: "traction", or "flux" of a scalar field, "jump", or the name of a
            goal.
        table: table with a row for each thickness that was tried, with the columns "eps" and "error". The error is its
            upper bound, where there are bounds.
        at_tolerance: whether the error at `eps` is equal to the tolerance, with `eps` correct to one percent.
        lacks: limits of the estimate at `eps`, in words, for example that goals have no bounds; "": none.
        bonded: True: without the layer, bodies are bonded. False: the interface law replaces the layer.
    """

    former_names = {"found": "at_tolerance"}
    eps: float
    tolerance: float
    quantity: str
    table: Table
    at_tolerance: bool
    lacks: str = ""
    bonded: bool = False

    def __str__(self) -> str:
        tried = f"at the {len(self.table)} thicknesses tried{f' ({self.lacks})' if self.lacks else ''}"
        allowed = f"{100 * self.tolerance:.3g} % in {self.quantity} on this mesh, {tried}"
        layer = "the layer may be ignored" if self.bonded else "the layer's mesh may be dropped"
        if self.at_tolerance:
            return f"thinner than {self.eps:.3g} {layer}: at most {allowed}"
        return f"up to {self.eps:.3g} {layer}: at most {allowed}; thicker ones were not tried"


@report("thin_enough")
def thin_enough(
    structure: Structure,
    layer: Layers,
    tolerance: float,
    goal: str | Goal | None = None,
    *,
    seam: str = S,
    t: float = 0.0,
    times: Sequence[float] | None = None,
    bonded: bool = False,
    bodies: str = "kept",
    options: Options | None = None,
) -> ThinEnough:
    """Find the thickness at which the estimated error of dropping a layer's mesh is equal to a tolerance. Collective.

    The layer's material stays the same. If a goal has bounds, its error is the largest one within them. The search
    tries ten to twenty thicknesses on one mesh. It begins with the height of the thinner body, and goes down until the
    error is within the tolerance at five successive thicknesses.

    Args:
        structure: bodies, supports and loads.
        layer: the layer, one for all seams, or {name of a seam: its layer, bond or gap}.
        tolerance: relative error that is allowed, between 0 and 1.
        goal: quantity whose error counts: "traction" (for a scalar field "flux") or "jump", both on S, or a goal such as
            `Reaction`. None: the traction or flux.
        seam: name of the seam whose layer becomes thinner; all other layers stay as they are, and their errors are not
            counted. "S": all seams, if they have the same layer.
        t: time of the loads and supports.
        times: ends of the time steps of a march, for layers with a rate or a memory; t is then not used.
        bonded: True: without the layer, bodies are bonded. False: its interface law of order 0 replaces the layer.
        bodies: "kept": the bodies keep their shape, and a meshed layer moves them apart. "extended": the layer is cut
            out of the bodies.
        options: {name of a PETSc option without its prefix: value}, as in `solve`.

    Returns:
        The thickness, and the errors at all thicknesses that were tried.

    Raises:
        InputError: arguments out of range; a layer that cannot be estimated; no thickness is thin enough.
        SolveError: a solve does not converge or has no unique solution.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, thin_enough
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> limit = thin_enough(plates, ThinLayer(glue, eps=0.05), tolerance=0.05)
        >>> f"{limit.eps:.3g}"
        '0.123'
    """
    require(isinstance(structure, Structure), "thin_enough: the structure", structure, "it takes a Structure")
    goal = structure.kinematics.quantities.traction if goal is None else goal
    seam_layers, thinned_layer = _check_arguments(structure, layer, tolerance, goal, seam, bonded)
    seams = list(seam_layers) if seam == S else [seam]

    def solve_model(model: Model) -> State | History:
        return solve(model, t, options=options) if times is None else march(model, times, options=options)

    quantity, goals = (goal, []) if isinstance(goal, str) else (goal.name, [goal])

    first_model = structure.interface(seam_layers, bodies=bodies)
    make_model = first_model.with_layer if bodies == "kept" else partial(structure.interface, bodies=bodies)
    bonds = {**seam_layers, **dict.fromkeys(seams, Bond())}
    for name in seams if bonded else ():
        first_model.applicability[name].require("bonded", "thin_enough: ")
    bonded_state = solve_model(structure.interface(bonds, bodies=bodies)) if bonded else None
    warnings_at: dict[float, list[warnings.WarningMessage]] = {}
    caveats: dict[float, list[str]] = {}

    def error_at(eps: float) -> float:
        with warnings.catch_warnings(record=True) as warnings_at[eps]:  # warnings at the final thickness are passed on
            warnings.simplefilter("always", RangeWarning)
            layers = dict.fromkeys(seams, replace(thinned_layer, eps=eps, law=thinned_layer.material, at=None))
            state = bonded_state or solve_model(make_model({**seam_layers, **layers}))
            error_estimate = estimate(state, layers if bonded else None, goals, seam=seam, options=options)
        caveats[eps] = error_estimate.caveats
        return _relative_error(error_estimate, quantity)

    thickest = min(min(first_model.layers[name].sheet.body_heights) for name in seams)
    eps, at_tolerance, errors = _search_thickness(error_at, thickest, tolerance)
    for warning in warnings_at[eps]:
        warnings.warn(warning.message, stacklevel=3)
    table = Table([{"eps": thickness, "error": errors[thickness]} for thickness in sorted(errors, reverse=True)])
    return ThinEnough(eps, tolerance, quantity, table, at_tolerance, "; ".join(caveats[eps]), bonded)


def _check_arguments(
    structure: Structure, layer: Layers, tolerance: float, goal: str | Goal, seam: str, bonded: bool
) -> tuple[dict[str, SeamContent], ThinLayer]:
    """Check arguments of `thin_enough`, and return the contents of the seams and the layer that becomes thinner.

    Args:
        structure: bodies, supports and loads.
        layer: the layer of all seams, or {name of a seam: its layer, bond or gap}.
        tolerance: relative error that is allowed.
        goal: quantity whose error counts.
        seam: name of the seam whose layer becomes thinner; "S": all seams.
        bonded: whether bodies are bonded without the layer.

    Returns:
        Name of a seam -> its layer, bond or gap; and the layer that becomes thinner.

    Raises:
        InputError: an argument is out of range.
    """
    with errors_on_all(structure.comm):
        seam_layers: dict[str, SeamContent] = value_by_seam(structure.joint, layer, "layer")
        if not (seam == S and isinstance(layer, ThinLayer)):
            require_known("seam", seam, seam_layers, "thin_enough: seam=... names the layer that becomes thinner")
        fields = (structure.kinematics.quantities.traction, "jump")
        thinned_layer, is_goal = seam_layers.get(seam, layer), isinstance(goal, Goal) or goal in fields
        if not isinstance(thinned_layer, ThinLayer):
            raise InputError(f"thin_enough: the layer is {thinned_layer!r:.200}; give a ThinLayer")
        in_range, names = is_number(tolerance) and 0 < tolerance < 1, ", ".join(fields)
        require(in_range, "thin_enough: the tolerance", tolerance, "allowed: between 0 and 1")
        require(is_goal, "thin_enough: the goal", goal, f"allowed: {names}, or one of thinlayer.goals")
        if bonded and goal == "jump":
            raise InputError(f"thin_enough: bonded bodies have no jump; take the {fields[0]}, or a goal")
    return seam_layers, thinned_layer


def _relative_error(error_estimate: Estimate, quantity: str) -> float:
    """Return the relative error of `quantity` ("traction", "flux", "jump" or the name of a goal) in an estimate.

    For a goal with bounds it is the largest error within them. It is infinite for the traction or the jump of a layer
    that has none.

    Raises:
        InputError: the goal is zero, and has no relative error.
    """
    if quantity in ESTIMATED_FIELDS:
        error = error_estimate.jump if quantity == "jump" else error_estimate.traction
        return error if math.isfinite(error) else math.inf
    goal = error_estimate.goals[quantity]
    if goal.zero:
        raise InputError(f"thin_enough: {quantity} is zero, and so has no relative error")
    return goal.at_most


def _search_thickness(
    error_at: Callable[[float], float], thickest: float, tolerance: float
) -> tuple[float, bool, dict[float, float]]:
    """Find the thickness below which errors are at most `tolerance`.

    Errors may change their sign, and so be small at a thickness and large at smaller thicknesses. Therefore the search
    goes down from the thickest until errors are allowed at `N_ALLOWED_IN_TURN` successive thicknesses.

    Args:
        error_at: function of the thickness that returns the relative error.
        thickest: the largest thickness that is tried.
        tolerance: the relative error that is allowed.

    Returns:
        The thickness; True if errors exceed the tolerance just above it, False if it is `thickest`, above which nothing
        was tried; and thickness -> error for all thicknesses that were tried.
    """

    errors: dict[float, float] = {}

    def log_excess(eps: float) -> float:
        """Return log(error/tolerance) at the thickness `eps`, positive if the error is too large."""
        if eps not in errors:
            errors[eps] = error_at(eps)
        return math.log(max(errors[eps], 1e-300) / tolerance)

    low, n_passed, tried = thickest, 0, []
    while n_passed < N_ALLOWED_IN_TURN:
        n_passed = n_passed + 1 if log_excess(low) <= 0 else 0
        tried.append(low)
        _require_falling([errors[eps] for eps in tried], low, n_passed)
        low /= THICKNESS_RATIO
    low = tried[-N_ALLOWED_IN_TURN]
    if low == thickest:
        return low, False, errors
    high = tried[-N_ALLOWED_IN_TURN - 1]
    while high > (1 + THICKNESS_TOLERANCE) * low:
        log_high, log_low = log_excess(high), log_excess(low)
        fraction = -log_low / (log_high - log_low) if math.isfinite(log_high) else 0.5
        middle = low * (high / low) ** min(max(fraction, 0.1), 0.9)
        low, high = (low, middle) if log_excess(middle) > 0 else (middle, high)
    return low, True, errors


def _require_falling(errors: Sequence[float], low: float, n_passed: int) -> None:
    """Raise InputError if the last error is too large, and errors no longer fall with the thickness.

    Args:
        errors: errors at the thicknesses that were tried, the largest thickness first.
        low: the last and smallest of these thicknesses.
        n_passed: number of successive thicknesses, up to the last one, at which the error is allowed.
    """
    stalled_error = STALLED_ERROR_RATIO * max(errors[-1 - N_FALLING_STEPS : -1], default=math.inf)
    if not n_passed and len(errors) > N_FALLING_STEPS and (errors[-1] > stalled_error or len(errors) > MAX_THICKNESSES):
        text = f"no thickness down to {low:.3g} is thin enough: the error is {errors[-1]:.3g} there, and hardly falls"
        advice = "is the layer much softer than the bodies, and are there loads at this time?"
        raise InputError(f"thin_enough: {text} with it; {advice}")
