"""Strength before breaking: criteria on the tractions along S, where they are largest, and by how much loads may grow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.optimize

from forms.base import Array, InputError, import_optional, is_finite, is_number, require
from forms.kinematics import PLANE_STRAIN
from forms.parameter_fields import real_values
from geometry.seam import S
from geometry.topology import BoolArray
from thinlayer.discretisation.contact_nodes import normal_frames
from thinlayer.discretisation.state import State
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.goals import MeanTraction
from thinlayer.output.surface import Surface
from thinlayer.solving.history import History
from thinlayer.system.ranks import errors_on_all
from thinlayer.system.table import Row, Table

SCALING_FACTORS = 2.0 ** np.arange(-40, 41)  # factors of tractions between which the first failure is searched
FLATNESS_TOLERANCE = 1e-6  # 1 - cosine of the angle between normals of S that counts as flat
UNRELIABLE_THICKNESSES = 3.0  # distance from free ends, over the thickness, within which tractions on S are wrong


class StrengthCriterion:
    """Criterion of strength: a function of the tractions t_N (tension > 0) and |t_T| on S that is 1 at failure.

    A new criterion defines `value`. `strength` also takes a plain function of t_N and |t_T| in its place.
    """

    def value(self, t_N: Array, t_T: Array) -> Array:
        """Return the value for each of several tractions: below 1 they are borne, above 1 they are not.

        Args:
            t_N: normal tractions, tension is positive.
            t_T: magnitudes of the tangential tractions, an array of the same shape.
        """
        raise NotImplementedError

    def safety_factor(self, t_N: Array, t_T: Array) -> float:
        """Return the smallest factor of all tractions at which one of them fails; infinite if none fails.

        It is that at which values first reach 1, between factors of 2, and of 2^-40 and 2^40.
        """

        def excess(factor: float) -> float:  # its sign counts, and functions may overflow
            return min(float(np.max(self.value(factor * t_N, factor * t_T))) - 1, 1.0)

        with np.errstate(over="ignore"):
            k = next((k for k, factor in enumerate(SCALING_FACTORS) if excess(factor) >= 0), None)
            if not k:
                return math.inf if k is None else 0.0
            return float(scipy.optimize.brentq(excess, SCALING_FACTORS[k - 1], SCALING_FACTORS[k], rtol=1e-14))

    def interval(self, t_N: tuple[float, float], *t_T: tuple[float, float]) -> tuple[float, float]:
        """Return the smallest and the largest value for tractions between bounds, such as those of goals of `estimate`.

        The value must not decrease as t_N or |t_T| grows.

        Args:
            t_N: lower and upper bound of the normal traction.
            t_T: lower and upper bound of each tangential component, whose signs may differ: one in 2D, two in 3D.
        """
        for low, high in (t_N, *t_T):
            require(low <= high, "interval: bounds", (low, high), "allowed: the lower one first, no nan")
        shear = [(0.0 if low < 0 < high else min(abs(low), abs(high)), max(abs(low), abs(high))) for low, high in t_T]
        lower, upper = self.value(np.array(t_N, float), np.hypot.reduce(np.array(shear)))
        return float(lower), float(upper)


class ScalableCriterion(StrengthCriterion):
    """Base of criteria whose value grows in proportion to the tractions, so that the safety factor is its inverse."""

    def safety_factor(self, t_N: Array, t_T: Array) -> float:
        """Return the smallest factor of all tractions at which one of them fails: 1/value, or infinite."""
        largest = float(np.max(self.value(t_N, t_T)))
        return 1 / largest if largest > 0 else math.inf


@dataclass(frozen=True)
class QuadraticCriterion(ScalableCriterion):
    """Quadratic criterion sqrt((<t_N>+/R_N)^2 + (|t_T|/R_T)^2), at which `Breaking` and `Cohesive` begin to soften.

    R_N and R_T are the strengths. Compression does no damage.

    Attributes:
        t_N, t_T: strengths in opening and in shear, stresses > 0.
    """

    t_N: float
    t_T: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(is_finite(value) and value > 0, f"QuadraticCriterion: {name}", value, "allowed: > 0, a stress")

    def value(self, t_N: Array, t_T: Array) -> Array:
        """Return the value for each of several tractions."""
        return np.asarray(np.hypot(np.maximum(t_N, 0.0) / self.t_N, t_T / self.t_T))


@dataclass(frozen=True)
class MohrCoulombCriterion(ScalableCriterion):
    """Criterion of Mohr and Coulomb on S, max((|t_T| + t_N tan(friction_angle))/cohesion, t_N/tension_cutoff, 0).

    Where it is 0, pressure prevents sliding, whatever the factor of the loads.

    Attributes:
        cohesion: shear strength without pressure, a stress > 0.
        friction_angle: angle of internal friction in degrees, from 0 to less than 90.
        tension_cutoff: tensile strength, a stress > 0; infinite: the cone ends at its apex.
    """

    cohesion: float
    friction_angle: float
    tension_cutoff: float = math.inf

    def __post_init__(self) -> None:
        c, angle, cutoff = self.cohesion, self.friction_angle, self.tension_cutoff
        require(is_finite(c) and c > 0, "MohrCoulombCriterion: cohesion", c, "allowed: > 0, a stress")
        require(
            is_finite(angle) and 0 <= angle < 90, "MohrCoulombCriterion: friction_angle", angle, "allowed: 0 to < 90"
        )
        require(is_number(cutoff) and cutoff > 0, "MohrCoulombCriterion: tension_cutoff", cutoff, "allowed: > 0")

    def value(self, t_N: Array, t_T: Array) -> Array:
        """Return the value for each of several tractions."""
        shear = (t_T + t_N * math.tan(math.radians(self.friction_angle))) / self.cohesion
        return np.asarray(np.maximum(np.maximum(shear, t_N / self.tension_cutoff), 0.0))


@dataclass(frozen=True)
class FunctionCriterion(StrengthCriterion):
    """Criterion of strength by a user's numpy function of t_N and |t_T|, whose values are checked."""

    function: Callable[[Array, Array], npt.ArrayLike]

    def value(self, t_N: Array, t_T: Array) -> Array:
        """Return the value for each of several tractions.

        Raises:
            InputError: the function raises an error, or its result has another shape or is nan.
        """
        try:
            values = np.broadcast_to(real_values(self.function(t_N, t_T)), np.shape(t_N))
            require(not np.isnan(values).any(), "a value", math.nan, "it must be a number")
            return values
        except Exception as error:
            raise InputError(f"strength: the criterion is no numpy function of t_N and |t_T|: {error}") from error


@dataclass(frozen=True, repr=False)
class Strength:
    """Values of a strength criterion on S for one or several load cases, the result of `strength`.

    Arrays (n, q) are fields on S, at the q quadrature points of n facets of `surface`.

    Attributes:
        surface: S, or a seam.
        states: (c) states of the c load cases.
        criterion: the criterion.
        cases: names of the c load cases: of the user, "state 1" and so on, or "" for a single state.
        t_N, t_T: (c, n, q) normal tractions, and magnitudes of the tangential ones.
        values: (c, n, q) values of the criterion, also near the ends.
        counts: (n, q) mask of the points that numbers take into account, as far from the ends as the user wants.
        has_linear_models: whether safety factors are those of the loads: all models are linear. If not, they only are
            factors of the tractions.
    """

    surface: Surface
    states: Sequence[State]
    criterion: StrengthCriterion
    cases: tuple[str, ...]
    t_N: Array
    t_T: Array
    values: Array
    counts: BoolArray
    has_linear_models: bool

    @property
    def envelope(self) -> Array:
        """Largest value (n, q) over all load cases."""
        return np.asarray(self.values.max(axis=0))

    @property
    def governing(self) -> npt.NDArray[np.str_]:
        """Name (n, q) of the load case that has the largest value."""
        return np.asarray(np.array(self.cases)[self.values.argmax(axis=0)])

    @cached_property
    def table(self) -> Table:
        """Table with a row for each load case, and a row "envelope" if there are several.

        Its columns are "case"; "largest", the largest value at the points that count; "x", "y" and "z", its place;
        "to_ends", the distance of this place from the ends of S; "share", the fraction of the area with values above 1;
        and "safety_factor", by which all tractions may be multiplied.
        """
        tractions = zip(self.t_N[:, self.counts], self.t_T[:, self.counts], strict=True)
        factors = [self.criterion.safety_factor(t_N, t_T) for t_N, t_T in tractions]
        rows = [self._row(*entries) for entries in zip(self.cases, self.values, factors, strict=True)]
        return Table([*rows, self._row("envelope", self.envelope, min(factors))] if len(rows) > 1 else rows)

    def _row(self, case: str, values: Array, factor: float) -> Row:
        """Return the table's row of a load case, from its values (n, q) and its safety factor."""
        surface, areas = self.surface, self.surface.weights * self.counts
        at = self._argmax(values)
        place = dict(zip("xyz", surface.x.reshape(len(surface.x), -1)[:, at].tolist(), strict=False))
        distance = float(surface.distance_to_ends.ravel()[at])
        entries = {"case": case, "largest": float(values.ravel()[at]), **place, "to_ends": distance}
        return entries | {"share": float((areas * (values > 1)).sum() / areas.sum()), "safety_factor": factor}

    @property
    def largest(self) -> float:
        """Largest value over all load cases, at the points that count."""
        return float(self.envelope[self.counts].max())

    @property
    def place(self) -> tuple[float, ...]:
        """Coordinates (d,) of the point with the largest value, in d dimensions."""
        return tuple(float(self.table[name][-1]) for name in "xyz"[: self.surface.joint.dim])

    @property
    def share(self) -> float:
        """Fraction of the area that counts with values above 1, in any load case."""
        return float(self.table["share"][-1])

    @property
    def safety_factor(self) -> float:
        """Smallest factor of the tractions of a load case at which a point that counts fails."""
        return float(self.table["safety_factor"][-1])

    def interval(self, length: float, **options: Any) -> tuple[float, float]:
        """Bound the criterion with the layer meshed, for the mean traction near the point of the largest value. Collective.

        The bounds are those of `estimate` for components of the mean traction: they hold for the given cells, and for
        laws that are linear. The criterion must not decrease as t_N or |t_T| grows.

        Args:
            length: length of the stretch of S whose mean counts, > 0: in 3D the diameter of a disc. The point of the
                largest value is in its middle; at nodes beyond it the weight of tractions falls to 0 over a facet.
            options: other arguments of `estimate`.

        Returns:
            Lower and upper bound.

        Raises:
            InputError: a stretch that is too short or not flat, or models that `estimate` gives no bounds for.
        """
        surface, at = self.surface, self._argmax(self.envelope)
        require(is_finite(length) and length > 0, "interval: length", length, "allowed: > 0, a length along S")
        middle, n = (field.reshape(len(field), -1)[:, at] for field in (surface.x, surface.n))
        within = np.linalg.norm(surface.x - middle[:, None, None], axis=0) <= length / 2
        flatness = float((np.einsum("d,dfq->fq", n, surface.n)[within]).min())
        advice = "S must be flat there, so that its directions are those along and across S: take less"
        require(flatness > 1 - FLATNESS_TOLERANCE, "interval: length", length, advice)

        def near_largest_value(x: Array) -> BoolArray:
            return np.asarray(np.linalg.norm(x - middle[:, None], axis=0) <= length / 2)

        *tangents, normal = normal_frames(n[None])[0]
        goals = [MeanTraction(e, surface.seam, near_largest_value) for e in (normal, *tangents)]
        errors = estimate(
            self.states[int(self.values.reshape(len(self.states), -1)[:, at].argmax())], goals=goals, **options
        ).goals
        wanted = "all laws must be linear, as estimate has no bounds for others"
        require(all(error.bounded for error in errors.values()), "interval: the tractions", "without bounds", wanted)
        return self.criterion.interval(*((error.lower, error.upper) for error in errors.values()))

    def _argmax(self, values: Array) -> int:
        """Return the number of the point with the largest of `values` (n, q) among those that count."""
        return int(np.where(self.counts, values, -math.inf).argmax())

    def __str__(self) -> str:
        place, distance = ", ".join(f"{x:.4g}" for x in self.place), float(self.table["to_ends"][-1])
        case = self.cases[int(np.argmax(self.table["largest"][: len(self.cases)]))]
        text = f"at most {self.largest:.3g} at ({place}){f' in {case}' if case else ''}"
        text += f", {distance:.3g} from the ends of S" if math.isfinite(distance) else ""
        text += f"; {100 * self.share:.3g} % of the area above 1; safety factor {self.safety_factor:.4g}"
        text += "" if self.has_linear_models else " of the tractions, but not of loads, as a model is not linear"
        facet_size = float(np.ptp(self.surface.joint.points[self.surface.corners], axis=1).max())
        thicknesses = [layer.eps for layer in self.surface.model.layers.values() if layer.thin_layer]
        if distance < (UNRELIABLE_THICKNESSES * max(thicknesses) if thicknesses else facet_size):
            text += "; so near to an end tractions on S depend on model and mesh: give a distance ends="
        return text

    def __repr__(self) -> str:
        return f"Strength({self})"

    def plot(self, **options: Any) -> Any:
        """Draw the values of all load cases along S, and a line at 1; `options` as of `plotting.along`. Collective."""
        curves = {name or "value": values for name, values in zip(self.cases, self.values, strict=True)}
        curves["failure"] = np.ones_like(self.values[0])
        return import_optional("thinlayer.output.plotting").along(self.surface, {"criterion": curves}, **options)


def strength(
    states: State | History | Mapping[str, State] | Iterable[State],
    criterion: StrengthCriterion | Callable[[Array, Array], npt.ArrayLike],
    *,
    seam: str = S,
    ends: float = 0.0,
) -> Strength:
    """Evaluate a strength criterion at the quadrature points of S, for one or several load cases. Collective.

    The tractions are those of `Surface.traction`. At free ends they depend on model and mesh: within three thicknesses
    of the layer those of laws are wrong, and those of bonded bodies may grow without bound as facets get smaller.

    Args:
        states: a state; load cases, {name: state} or several states of the same joint; or a history, whose states are
            the load cases.
        criterion: `QuadraticCriterion`, `MohrCoulombCriterion` or another criterion; or a numpy function of arrays t_N
            (tension > 0) and |t_T|, whose value is 1 at failure.
        seam: name of a seam; "S": all seams.
        ends: distance from the ends of S, or of the seam, within which no point counts, a length >= 0. A plane of
            symmetry that cuts S is an end, too.

    Returns:
        The values along S, the largest one and its place, the share of S above 1, and the safety factor.

    Raises:
        InputError: no state, or states of several joints; a criterion without numbers; no point is so far from the ends.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import QuadraticCriterion, Structure, ThinLayer, solve, strength
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> result = strength(state, QuadraticCriterion(t_N=40, t_T=30), ends=0.15)
        >>> f"{result.largest:.2f} at x = {result.place[0]:.2f}"
        '0.11 at x = 2.44'
    """
    if isinstance(states, State) or not isinstance(states, Iterable):
        states = {"": states}
    elif not isinstance(states, Mapping):
        in_time = isinstance(states, History)
        states = {f"state {k}" + (f", t = {state.t:g}" if in_time else ""): state for k, state in enumerate(states, 1)}
    names, several = tuple(map(str, states)), [*states.values()]
    require(several, "strength: states", states, "give at least one state")
    for state in several:
        require(isinstance(state, State), "strength: a state", state, "give what solve or march returns")
    wanted = "give a criterion, such as QuadraticCriterion(t_N=40, t_T=30), or a function of t_N and |t_T|"
    is_criterion = isinstance(criterion, StrengthCriterion) or (callable(criterion) and not isinstance(criterion, type))
    require(is_criterion, "strength: the criterion", criterion, wanted)
    several[0].model.kinematics.require(PLANE_STRAIN.unknown, "strength")
    surface = Surface(several[0].model, seam)
    tractions = np.array([surface.frame(surface.traction(state)) for state in several])
    t_N, t_T = tractions[:, -1], np.linalg.norm(tractions[:, :-1], axis=1)
    with errors_on_all(surface.model.comm):
        require(is_finite(ends) and ends >= 0, "strength: ends", ends, "allowed: >= 0, a distance from the ends of S")
        farthest, counts = float(surface.distance_to_ends.max()), surface.distance_to_ends >= ends
        require(counts.any(), "strength: ends", ends, f"allowed: at most {farthest:.4g}, as no point is farther away")
        criterion = criterion if isinstance(criterion, StrengthCriterion) else FunctionCriterion(criterion)
        checked = criterion if isinstance(criterion, FunctionCriterion) else FunctionCriterion(criterion.value)
        values = checked.value(t_N, t_T)
    are_linear = all(state.model.linear for state in several)
    return Strength(surface, several, criterion, names, t_N, t_T, values, counts, are_linear)
