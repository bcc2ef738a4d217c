"""Checks that laws written in UFL are as symmetric, linear and elastic as they declare.

Solvers read only the upper triangle of a stress, of an internal tensor, and of a matrix declared symmetric; an error in the
lower one would pass unseen. A check evaluates the law with numbers, in a few milliseconds. If the declaration also holds
with other numbers than those given, the law is not checked again.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives
from ufl.indexed import Indexed

from forms.fields import is_field
from forms.kinematics import Expr
from forms.law import BulkLaw, LawError, Step
from forms.numbers import numbers
from forms.trace import named

Array = npt.NDArray[np.float64]
STRESS_TOLERANCE = 1e-10  # relative difference of stresses that counts as rounding
TANGENT_TOLERANCE = 1e-5  # relative error of divided differences of stress or energy
ENERGY_TOLERANCE = 1e-12  # rounding of an energy, relative
STRAINS = (0.01, 0.3)  # sizes of the strains at which laws are checked
CHANGE = 1e-3  # change of strain in divided differences, over the size of the strain
THETA = 0.7  # theta of the step in which laws are checked
VARIATION = 0.1  # relative change of the parameters for the second check
_FOUND: set[tuple[Any, ...]] = set()  # checked laws whose declarations hold for all numbers
NOT_SYMMETRIC = (
    "{}: the tangent is not symmetric, it differs from its transpose by {:.1e} of its size; "
    "write symmetric = False in the class, or correct it"
)
NOT_LINEAR = (
    "{} declares linear = True, but its stress is not affine in the strain; "
    "write linear = False in the class, or correct the stress"
)


def require_declared_stress(law: BulkLaw, key: int) -> None:
    """Raise LawError unless a law in UFL computes what it declares; does nothing if the law cannot be evaluated.

    Stress and internal tensors must be symmetric. The stress must be affine in the strain if the law declares `linear`, and
    the derivative of the energy, if any, if it declares `symmetric` and has neither rate nor internal variables.

    Args:
        law: the law, with the numbers of this run.
        key: key of its equations, see `forms.trace`.
    """
    _for_all_numbers(law, ("stress", key, law.traits.linear, law.traits.symmetric), _require_declared)


def require_symmetric_tangent(law: BulkLaw, key: int) -> None:
    """Raise LawError if a law in UFL declares `symmetric` but its tangent is not; arguments as above."""
    if law.traits.symmetric:
        _for_all_numbers(law, ("tangent", key), _tangent_is_symmetric)


def _for_all_numbers(law: BulkLaw, key: tuple[Any, ...], require: Callable[[BulkLaw], None]) -> None:
    """Check a law with its numbers, unless the same check has passed with other numbers too."""
    given = law.mapped(lambda value, _: _number(value))
    arrays = [value for value in given.parameters().values() if isinstance(value, np.ndarray)]
    key = (*key, *map(_symmetric, arrays))
    if key in _FOUND:
        return
    require(given.mapped(lambda value, _: _tensor_of(value)))
    random = np.random.default_rng(5)
    try:
        require(given.mapped(lambda value, _: _tensor_of(_another(value, random))))
    except LawError:  # the declaration depends on the numbers
        return
    _FOUND.add(key)


def _require_declared(law: BulkLaw) -> None:
    for size in STRAINS:
        sample = Sample(law, size)
        _stress_is_symmetric(sample)
        if named(law) is None:  # tests check the laws of this package
            require_consistent(sample)


def require_consistent(sample: Sample) -> None:
    """Raise LawError unless internal tensors are symmetric, and the stress is as linear and elastic as declared."""
    law = sample.law
    _memory_is_symmetric(sample)
    if law.traits.linear:
        _stress_is_linear(sample)
    if law.traits.has_energy and law.traits.symmetric and not (law.traits.rate or law.internal):
        _stress_is_of_energy(sample)


def _skew(tensor: Array) -> float:
    """Relative difference between a tensor and its transpose; 0 if it is rounding."""
    skew, largest = np.abs(tensor - tensor.T).max(), np.abs(tensor).max()
    return float(skew / largest) if skew > STRESS_TOLERANCE * largest else 0.0


def _stress_is_symmetric(sample: Sample) -> None:
    stress = sample.stress()
    if stress is not None and (skew := _skew(stress)):
        raise LawError(
            f"{type(sample.law).__name__}.stress is not symmetric: it differs from its transpose by {skew:.1e} of "
            "its size; use ufl.sym"
        )


def _memory_is_symmetric(sample: Sample) -> None:
    method = sample.law.methods[1]
    for name, tensor in sample.tensors().items():
        if skew := _skew(tensor):
            raise LawError(
                f"{type(sample.law).__name__}.{method}[{name!r}] is not symmetric: it differs from its transpose by "
                f"{skew:.1e} of its size; internal tensors (3, 3) are symmetric: use ufl.sym, or vectors (3,)"
            )


def _stress_is_linear(sample: Sample) -> None:
    """Raise LawError unless second differences of the stress vanish, also around zero strain."""
    middle = sample.stress()
    mid = THETA * sample.e + (1 - THETA) * sample.e_old
    across = [2 / THETA * mid, 2 * sample.e] if sample.law.traits.rate or sample.law.internal else [2 / THETA * mid]
    for change in (sample.random_strain(), *across):
        up, down = sample.stress(change), sample.stress(-change)
        if middle is None or up is None or down is None:
            return
        apart, largest = np.abs(up + down - 2 * middle).max(), max(np.abs(a).max() for a in (up, down, middle))
        if apart > STRESS_TOLERANCE * largest:
            raise LawError(NOT_LINEAR.format(type(sample.law).__name__))


def _stress_is_of_energy(sample: Sample) -> None:
    stress, along = sample.stress(), sample.random_strain()
    if stress is None:
        return
    first, closer = (partial(_without_energy, sample, stress, share * CHANGE * along) for share in (1.0, 0.5))
    if (apart := first()) and abs(closer() - apart) < 0.1 * abs(apart):  # else a kink is near
        raise LawError(
            f"{type(sample.law).__name__}: the derivative of the energy by the strain is not the stress, it is "
            f"{abs(apart):.1e} of the stress away; correct one of them, or write symmetric = False in the class if the "
            "stress has no energy"
        )


def _without_energy(sample: Sample, stress: Array, change: Array) -> float:
    """Relative part of the stress's work on a small change that the energy lacks; 0 if rounding or unknown."""
    up, down = sample.energy(change), sample.energy(-change)
    if up is None or down is None:
        return 0.0
    work, size = 2 * np.sum(stress * change), 2 * np.linalg.norm(stress) * np.linalg.norm(change)
    rest = up - down - work
    lost = abs(rest) > TANGENT_TOLERANCE * size + ENERGY_TOLERANCE * max(abs(up), abs(down))
    return float(rest / (size or abs(rest))) if lost else 0.0


def _tangent_is_symmetric(law: BulkLaw) -> None:
    for size in STRAINS:
        sample = Sample(law, size)
        one, other = (sample.random_strain() for _ in range(2))
        skew = sample.skew(one, other, CHANGE)
        if not abs(skew) > TANGENT_TOLERANCE:
            continue
        closer = sample.skew(one, other, CHANGE / 2)
        if abs(skew - closer) < 0.1 * abs(skew):  # else a kink is near
            raise LawError(NOT_SYMMETRIC.format(type(law).__name__, abs(closer)))


class Sample:
    """A law at one point, with random strain, director and internal variables."""

    def __init__(self, law: BulkLaw, size: float) -> None:
        self.law, self.random, self.size = law, np.random.default_rng(3), size
        self.n = self.random.normal(size=3)
        self.n /= np.linalg.norm(self.n)
        self.e, self.e_old = self.random_strain(), self.random_strain()
        shapes: Any = {
            (): lambda: ufl.as_ufl(size * self.random.random()),
            (3,): lambda: ufl.as_vector(self.n.tolist()),
        }
        self.q = {
            name: shapes.get(shape, lambda: _tensor(self.random_strain()))() for name, shape in law.internal.items()
        }

    def random_strain(self) -> Array:
        return self.size * self.law.trial_strain(self.random.normal(size=(3, 3)), self.n)

    def _step(self, change: Array | float) -> Step:
        n = ufl.as_vector(self.n.tolist())
        return Step(_tensor(self.e + change), n, _tensor(self.e_old), self.q, ufl.as_ufl(0.1), ufl.as_ufl(THETA))

    def stress(self, change: Array | float = 0.0) -> Array | None:
        """Stress (3, 3) with a change of the strain; None if it cannot be evaluated."""
        return _evaluated(lambda: self.law.stress(self.law.own_step(self._step(change))))

    def tensors(self) -> dict[str, Array]:
        """New internal variables of shape (3, 3) that can be evaluated."""
        found = {}
        for name, shape in self.law.internal.items():
            tensor = _evaluated(partial(self._advanced, name)) if shape == (3, 3) else None
            if tensor is not None:
                found[name] = tensor
        return found

    def _advanced(self, name: str) -> Expr:
        return self.law.advance(self._step(0.0))[name]

    def energy(self, change: Array | float) -> float | None:
        """Energy at the time of the stress, with a change of the strain; None if it cannot be evaluated."""
        energy = _evaluated(lambda: self.law.energy(self.law.own_step(self._step(np.asarray(change / THETA)))))
        return None if energy is None else float(energy)

    def skew(self, one: Array, other: Array, change: float) -> float:
        """one : C : other - other : C : one, over their size, by central differences; NaN if they cannot be evaluated."""
        by_one, by_other = self._along(one, change), self._along(other, change)
        if by_one is None or by_other is None:
            return math.nan
        size = max(np.linalg.norm(one) * np.linalg.norm(by_other), np.linalg.norm(other) * np.linalg.norm(by_one))
        return float(np.sum(one * by_other - other * by_one) / size) if size else 0.0

    def _along(self, direction: Array, change: float) -> Array | None:
        up, down = self.stress(change * direction), self.stress(-change * direction)
        return None if up is None or down is None else up - down


def _evaluated(expression: Callable[[], Expr]) -> Array | None:
    """The numbers of an expression; None if it has none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # UFL warns where it finds no number
            found = numbers(expand_derivatives(ufl.as_ufl(expression())))
    except Exception:  # the law has parts without a value; the compiler will report errors
        return None
    return found if np.isfinite(found).all() else None


def _tensor(a: Array) -> Any:
    return ufl.as_matrix(a.tolist())


def _number(value: Any) -> Any:
    """A parameter as numbers, if it is a number or a Constant, 1 for a function; others unchanged."""
    if is_field(value) or isinstance(value, Indexed):  # values at places, or at quadrature points
        return 1.0
    try:
        array = np.asarray(getattr(value, "value", value), float)
    except (TypeError, ValueError):
        return value
    return array if array.ndim else float(array)


def _tensor_of(value: Any) -> Any:
    return ufl.as_tensor(value.tolist()) if isinstance(value, np.ndarray) else value


def _symmetric(array: Array) -> bool:
    return array.ndim == 2 and np.array_equal(array, array.T)


def _another(value: Any, random: np.random.Generator) -> Any:
    """A different value near a parameter, also near 0; symmetric for a symmetric array."""
    if not isinstance(value, (float, np.ndarray)):
        return value
    size = VARIATION * (float(np.abs(value).max(initial=0.0)) or 1.0)
    change = size * random.uniform(0.5, 1.0, np.shape(value))
    if isinstance(value, np.ndarray):
        return value + ((change + change.T) / 2 if _symmetric(value) else change)
    return value + float(change)
