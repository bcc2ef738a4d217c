"""Whether stresses and tangents of laws written in UFL are as symmetric as the solvers take them to be.

An upper triangle is all that is read of a stress, and of a matrix that is said to be symmetric: what is missing below
would be lost without a word. Laws are evaluated with numbers, a few milliseconds for each; once for all numbers, where
other ones than those given do not break the symmetry either.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives

from forms.law import Law, LawError, Step

Array = npt.NDArray[np.float64]
STRESS, TANGENT = 1e-10, 1e-5  # relative differences: rounding, and divided differences
SIZES = (0.01, 0.3)  # of the strains
CHANGE = 1e-3  # of the strains, for divided differences
APART = 0.1  # of the numbers given: how far from them others are tried
_FOUND: set[tuple[Any, ...]] = (
    set()
)  # laws whose stress, or tangent, is as symmetric as they say, whatever their numbers
NOT_SYMMETRIC = (
    "{}: the tangent is not symmetric, it differs from its transpose by {:.1e} of its size; "
    "write symmetric = False in the class, or correct it"
)


def require_symmetric_stress(law: Law, key: int) -> None:
    """Raise LawError if a law in UFL gives a stress that is not symmetric; silent if it cannot be evaluated.

    Args:
        law: with the numbers of this run.
        key: of what it computes from any numbers, see `forms.trace`.
    """
    _for_all_numbers(law, ("stress", key), _stress_is_symmetric)


def require_symmetric_tangent(law: Law, key: int) -> None:
    """Raise LawError if a law in UFL says `symmetric`, and its tangent is not; arguments as above."""
    if law.symmetric:
        _for_all_numbers(law, ("tangent", key), _tangent_is_symmetric)


def _for_all_numbers(law: Law, key: tuple[Any, ...], require: Callable[[Law], None]) -> None:
    """Require something of a law with its numbers, unless it has been seen to hold with other ones too."""
    given = law.mapped(lambda value, _: _number(value))
    arrays = [value for value in given.parameters().values() if isinstance(value, np.ndarray)]
    key = (*key, *map(_symmetric, arrays))
    if key in _FOUND:
        return
    require(given.mapped(lambda value, _: _tensor_of(value)))
    random = np.random.default_rng(5)
    try:
        require(given.mapped(lambda value, _: _tensor_of(_another(value, random))))
    except LawError:  # it depends on the numbers
        return
    _FOUND.add(key)


def _stress_is_symmetric(law: Law) -> None:
    for size in SIZES:
        stress = _Sample(law, size).stress()
        if stress is None:
            return
        skew, largest = np.abs(stress - stress.T).max(), np.abs(stress).max()
        if skew > STRESS * largest:
            raise LawError(
                f"{type(law).__name__}.stress is not symmetric: it differs from its transpose by {skew / largest:.1e} of "
                "its size; use ufl.sym"
            )


def _tangent_is_symmetric(law: Law) -> None:
    for size in SIZES:
        sample = _Sample(law, size)
        one, other = (sample.random_strain() for _ in range(2))
        skew = sample.skew(one, other, CHANGE)
        if not abs(skew) > TANGENT:
            continue
        closer = sample.skew(one, other, CHANGE / 2)
        if abs(skew - closer) < 0.1 * abs(skew):  # else a kink is near
            raise LawError(NOT_SYMMETRIC.format(type(law).__name__, abs(closer)))


class _Sample:
    """A law at one point, with numbers that no axis or plane prefers."""

    def __init__(self, law: Law, size: float) -> None:
        self.law, self.random, self.size = law, np.random.default_rng(3), size
        self.e, self.e_old = self.random_strain(), self.random_strain()
        self.n = self.random.normal(size=3)
        self.n /= np.linalg.norm(self.n)
        shapes: Any = {
            (): lambda: ufl.as_ufl(size * self.random.random()),
            (3,): lambda: ufl.as_vector(self.n.tolist()),
        }
        self.q = {
            name: shapes.get(shape, lambda: _tensor(self.random_strain()))() for name, shape in law.internal.items()
        }

    def random_strain(self) -> Array:
        a = self.random.normal(size=(3, 3))
        return np.asarray(self.size * (a + a.T) / 2)

    def stress(self, change: Array | float = 0.0) -> Array | None:
        n = ufl.as_vector(self.n.tolist())
        step = Step(_tensor(self.e + change), n, _tensor(self.e_old), self.q, ufl.as_ufl(0.1), ufl.as_ufl(0.7))
        try:
            stress: Any = expand_derivatives(ufl.as_ufl(self.law.stress(step)))  # once, not for each component
            return np.array([[float(stress((0.0,), component=(i, j))) for j in range(3)] for i in range(3)])
        except Exception:  # whatever a law contains that has no number: the compiler will say what is wrong with it
            return None

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


def _tensor(a: Array) -> Any:
    return ufl.as_matrix(a.tolist())


def _number(value: Any) -> Any:
    """A parameter, a number or a Constant, as numbers; what is neither stays."""
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
    """Another number near a parameter, also near 0; of a symmetric array a symmetric one."""
    if not isinstance(value, (float, np.ndarray)):
        return value
    size = APART * (float(np.abs(value).max(initial=0.0)) or 1.0)
    change = size * random.uniform(0.5, 1.0, np.shape(value))
    if isinstance(value, np.ndarray):
        return value + ((change + change.T) / 2 if _symmetric(value) else change)
    return value + float(change)
