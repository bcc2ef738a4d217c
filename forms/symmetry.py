"""Whether stresses and tangents of laws written in UFL are as symmetric as the solvers take them to be.

An upper triangle is all that is read of a stress, and of a matrix that is said to be symmetric: what is missing below
would be lost without a word. Laws are evaluated with numbers, a few milliseconds for each.
"""

from __future__ import annotations

import math
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
_FOUND: set[tuple[type[Law], str, str]] = set()  # laws whose stress, or tangent, is as symmetric as they say
NOT_SYMMETRIC = (
    "{}: the tangent is not symmetric, it differs from its transpose by {:.1e} of its size; "
    "write symmetric = False in the class, or correct it"
)


def require_symmetric_stress(law: Law) -> None:
    """Raise LawError if a law in UFL gives a stress that is not symmetric; silent if it cannot be evaluated."""
    key = (type(law), repr(_Sample(law, 1.0).law), "stress")
    if key in _FOUND:
        return
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
    _FOUND.add(key)


def require_symmetric_tangent(law: Law) -> None:
    """Raise LawError if a law in UFL says `symmetric`, and its tangent is not; silent if it cannot be evaluated."""
    key = (type(law), repr(_Sample(law, 1.0).law), "tangent")
    if not law.symmetric or key in _FOUND:
        return
    for size in SIZES:
        sample = _Sample(law, size)
        one, other = (sample.random_strain() for _ in range(2))
        skew = sample.skew(one, other, CHANGE)
        if not abs(skew) > TANGENT:
            continue
        closer = sample.skew(one, other, CHANGE / 2)
        if abs(skew - closer) < 0.1 * abs(skew):  # else a kink is near
            raise LawError(NOT_SYMMETRIC.format(type(law).__name__, abs(closer)))
    _FOUND.add(key)


class _Sample:
    """A law at one point, with numbers that no axis or plane prefers."""

    def __init__(self, law: Law, size: float) -> None:
        self.random, self.size = np.random.default_rng(3), size
        self.law = law.mapped(lambda value, _: _number(value))
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
    """A parameter, a number or a Constant, as UFL reads it; what is neither stays."""
    try:
        array = np.asarray(getattr(value, "value", value), float)
    except (TypeError, ValueError):
        return value
    return ufl.as_tensor(array.tolist()) if array.ndim else float(array)
