"""The time that loads depend on, and load curves: tables of values over time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.algebra import Division, Product, Sum
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.core.terminal import Terminal
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import is_number
from forms.kinematics import Expr
from forms.trace import asked_by_ufl

Array = npt.NDArray[np.float64]
ROUNDING = 1e-12  # relative tolerance for equal times (a sum of steps against the end of a curve) and equal slopes
RATIONAL = (Sum, Product, Division)
SAMPLES = (-2.5, 0.0, 1.0, 7.0)  # times at which a rational argument is tested for being linear in t


def _refuse(done: str) -> NoReturn:
    raise TypeError(f"x and t stand for all places and times, they are no numbers: {done} would be found once, for all")


class Time(ufl.Constant):
    """The time, a UFL symbol without a value: functions of it are called once, when the model is built.

    Expressions get their values at a `Moment`. Python code cannot use the time as a number.
    """

    def __init__(self, mesh: Mesh) -> None:
        super().__init__(mesh.ufl_domain())
        self.mesh = mesh
        self.followers: list[tuple[Expr, LoadCurve, ufl.Constant]] = []

    @property
    def value(self) -> Any:
        """The time has no value; raises TypeError."""
        _refuse("t.value")

    def follow(self, argument: Expr, curve: LoadCurve) -> ufl.Constant:
        """A symbol (columns,) for the values of a curve at an argument that depends on the time alone."""
        symbol = Followed(self, (curve.columns.shape[1],))
        self.followers.append((argument, curve, symbol))
        return symbol

    @property
    def breaks(self) -> set[float]:
        """The break times of all curves whose argument is linear in the time."""
        found: set[float] = set()
        for argument, curve, _ in self.followers:
            rate, start = _linear(argument, self)
            found |= {(t - start) / rate for t in curve.breaks} if rate else set()
        return found

    def __str__(self) -> str:
        return "t"

    def __float__(self) -> float:
        _refuse("float(t)")

    def __complex__(self) -> complex:
        _refuse("complex(t)")

    def __round__(self, n: int | None = None) -> Any:
        _refuse("round(t)")

    def __bool__(self) -> bool:
        _refuse("whether t is true")

    def __eq__(self, other: object) -> bool:
        if isinstance(other, ufl.core.expr.Expr):
            return bool(super().__eq__(other))
        if not asked_by_ufl():
            _refuse(f"t == {other!r}")
        return False

    __hash__ = ufl.Constant.__hash__


class Followed(ufl.Constant):
    """The values of a curve, a UFL symbol.

    Attributes:
        clock: the time that the argument of the curve depends on.
    """

    def __init__(self, clock: Time, shape: tuple[int, ...]) -> None:
        super().__init__(clock.ufl_domain(), shape)
        self.clock = clock


def clock_of(*expressions: Expr) -> Time | None:
    """The time that expressions depend on; None: they do not."""
    for node in (node for one in expressions for node in unique_pre_traversal(one)):
        if isinstance(node, Time):
            return node
        if isinstance(node, Followed):
            return node.clock
    return None


class Moment:
    """A time at which expressions of a `Time` have values, as constants that compiled forms read.

    Forms at several moments are compiled once. To use one compiled form at several times, `set` its moment.
    """

    def __init__(self, clock: Time, t: float) -> None:
        self._clock, self._t = clock, fem.Constant(clock.mesh, 0.0)
        self._curves = [
            (argument, curve, fem.Constant(clock.mesh, np.zeros(symbol.ufl_shape)))
            for argument, curve, symbol in clock.followers
        ]
        symbols = [clock, *(symbol for *_, symbol in clock.followers)]
        self._values = dict(zip(symbols, [self._t, *(constant for *_, constant in self._curves)], strict=True))
        self.set(t)

    def set(self, t: float) -> None:
        """Move on to another time."""
        self._t.value = t
        for argument, curve, constant in self._curves:
            constant.value = curve.at(_value(argument, self._clock, t))

    def of(self, expression: Expr) -> Expr:
        """An expression or a form at this moment."""
        return ufl.replace(expression, self._values)


@contextmanager
def symbols() -> Iterator[None]:
    """Context in which x and t raise TypeError if Python code compares them with numbers or uses them as a condition.

    UFL would compare the expressions themselves: x[0] == 0 is False, everywhere.
    """
    kind = ufl.core.expr.Expr
    same, other_than, true = kind.__eq__, kind.__ne__, kind.__bool__

    def compared(self: Any, other: object) -> bool:
        if not (isinstance(other, kind) or asked_by_ufl()):
            _refuse(f"whether {self} == {other!r}")
        return bool(same(self, other))

    def different(self: Any, other: object) -> bool:
        if not (isinstance(other, kind) or asked_by_ufl()):
            _refuse(f"whether {self} != {other!r}")
        return bool(other_than(self, other))

    def truth(self: Any) -> bool:
        _refuse(f"whether {self} is true")

    kind.__eq__, kind.__ne__, kind.__bool__ = compared, different, truth
    try:
        yield
    finally:
        kind.__eq__, kind.__ne__, kind.__bool__ = same, other_than, true


class LoadCurve:
    """Values at given times, linear in between; NaN before and after.

    Attributes:
        times: (n,) increasing.
        columns: (n, columns) values.
        scalar: whether each value is a number instead of components.
        breaks: the first and the last time, and those between at which the slope changes.
    """

    def __init__(self, times: Array, values: Array) -> None:
        self.times, self.columns, self.scalar = times, values.reshape(len(times), -1), values.ndim == 1
        slopes = np.diff(self.columns, axis=0) / np.diff(times)[:, None]
        changes = np.abs(np.diff(slopes, axis=0)) > ROUNDING * np.abs(slopes).max(axis=0)
        self.breaks = tuple(map(float, times[[True, *changes.any(axis=1), True]]))

    def __call__(self, t: Any) -> Any:
        """The value at t, a number or a UFL expression; a list of components unless the curve is of numbers."""
        if is_number(t):
            found = [*map(float, self.at(float(t)))]
        else:
            t = ufl.as_ufl(t)
            clock = _clock(t)
            found = (
                [*clock.follow(t, self)] if clock is not None else [self._lines(column, t) for column in self.columns.T]
            )
        return found[0] if self.scalar else found

    def at(self, t: float) -> Array:
        """Values (columns,) at a time."""
        first, last = self.times[[0, -1]]
        near = ROUNDING * max(abs(first), abs(last))
        if not first - near <= t <= last + near:
            return np.full(self.columns.shape[1], np.nan)
        return np.array([np.interp(t, self.times, column) for column in self.columns.T])

    def _lines(self, column: Array, t: Expr) -> Expr:
        """One column at an expression that depends on the place too, UFL."""
        times, column = [*map(float, self.times)], [*map(float, column)]  # type: ignore[assignment]

        def between(a: int, b: int) -> Expr:
            if b - a == 1:
                return column[a] + (t - times[a]) * ((column[b] - column[a]) / (times[b] - times[a]))
            middle = (a + b) // 2
            return ufl.conditional(ufl.le(t, times[middle]), between(a, middle), between(middle, b))

        inside = ufl.And(ufl.ge(t, times[0]), ufl.le(t, times[-1]))
        return ufl.conditional(inside, between(0, len(times) - 1), ufl.sqrt(-1 - t * t))


def _clock(expression: Expr) -> Time | None:
    """The time in an expression that depends on nothing else; else None."""
    terminals = [node for node in unique_pre_traversal(expression) if isinstance(node, Terminal)]
    clocks = [node for node in terminals if isinstance(node, Time)]
    others = [node for node in terminals if not isinstance(node, (Time, ConstantValue, MultiIndex))]
    return clocks[0] if len(clocks) == 1 and not others else None


def _value(expression: Expr, clock: Time, t: float) -> float:
    """An expression of the time alone at a time; NaN where it has no value."""
    try:
        return float(t if expression is clock else expression((), {clock: float(t)}))
    except (ArithmeticError, ValueError, TypeError):
        return math.nan


def _linear(expression: Expr, clock: Time) -> tuple[float, float]:
    """Rate and value at 0 of an expression that is linear in the time; a rate of 0 if it is not."""
    if expression is clock:
        return 1.0, 0.0
    if not all(isinstance(node, (Terminal, *RATIONAL)) for node in unique_pre_traversal(expression)):
        return 0.0, 0.0
    y = np.array([_value(expression, clock, t) for t in SAMPLES])
    rate, start = float(y[2] - y[1]), float(y[1])
    straight = np.abs(start + rate * np.array(SAMPLES) - y).max() <= ROUNDING * np.abs(y).max()  # False for NaN
    return (rate, start) if straight else (0.0, 0.0)
