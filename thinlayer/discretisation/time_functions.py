"""Functions of time: tables of values, fields between those of another march, and expressions at other times."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.algebra import Division, Product, Sum
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.core.terminal import Terminal
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import Array, InputError, is_number
from forms.temperature import real_values
from forms.tensors import Expr
from forms.work import Term
from thinlayer.discretisation.coefficient import (
    Clock,
    HandedField,
    TimeConstant,
    TimeDependent,
    set_value,
    time_constants,
)
from thinlayer.system.compat import ufl_replace

# relative tolerance of equal times, such as a sum of steps and the end of a table, and of equal slopes
TIME_TOLERANCE = 1e-12
RATIONAL_OPERATORS = (Sum, Product, Division)
TEST_TIMES = np.array([-2.5, 0.0, 1.0, 7.0])  # times at which a table's rational argument is tested for linearity


class TableConstant(TimeConstant):
    """Values of a table that depend on the time alone, as a constant of a clock in UFL forms.

    Args:
        time: the time of the clock.
        argument: UFL expression of the time, at which the table is evaluated.
        table: the table of m values.
    """

    def __init__(self, time: TimeConstant, argument: Expr, table: PiecewiseLinear) -> None:
        super().__init__(time.mesh, np.full(table.columns.shape[1], np.nan))
        self._time, self._argument, self._table = time, argument, table
        self.time_constants = time.time_constants
        self.time_constants.add(self)

    def at(self, t: float) -> Array:
        """Return the values (m,) of the table at the time t."""
        return self._table.values_at(self._argument_at(t))

    def _argument_at(self, t: float) -> float:
        """Return the argument of the table at the time t; NaN where the expression is not defined."""
        try:
            return float(t if self._argument is self._time else self._argument((), {self._time: float(t)}))
        except (ArithmeticError, ValueError, TypeError):
            return math.nan

    @property
    def kinks(self) -> set[float]:  # type: ignore[override]
        """Times at which the slope of the table's values changes.

        They are known only if the table's argument is linear in the time; otherwise the set is empty.
        """
        if not all(isinstance(node, (Terminal, *RATIONAL_OPERATORS)) for node in unique_pre_traversal(self._argument)):
            return set()
        y = np.array([self._argument_at(t) for t in TEST_TIMES])
        rate, start = float(y[2] - y[1]), float(y[1])
        is_linear = np.abs(start + rate * TEST_TIMES - y).max() <= TIME_TOLERANCE * np.abs(y).max()  # False for NaN
        return {(t - start) / rate for t in self._table.kinks} if is_linear and rate else set()


class FieldInTime(HandedField, TimeDependent):
    """A function on a mesh that is linear in time between fields at some times, and NaN before and after them.

    Like a `TimeConstant` it has values only inside the context of its clock. Steps need not end at the times of the
    fields, which are those of another march.

    Args:
        fields: functions in one space at the times `times`, increasing.
        times: (n,) the times.
        clock: the clock of the model.
    """

    def __init__(self, fields: Sequence[fem.Function], times: Array, clock: Clock) -> None:
        super().__init__(fields[0].function_space)
        self._table = PiecewiseLinear(times, np.array([field.x.array for field in fields]))
        clock.symbol.time_constants.add(self)

    def at(self, t: float) -> Array:
        """Return the degrees of freedom on this rank at the time t, ghosts included."""
        return self._table.values_at(t)

    def copy_at(self, t: float) -> fem.Function:
        """Return a function with the values at the time t."""
        copy = fem.Function(self.function_space)
        copy.x.array[:] = self.at(t)
        return copy


class TimeLevel:
    """A time, besides that of the clock, at which expressions and forms are evaluated.

    Expressions at this level contain constants that are separate from those of the clock. A form may thus contain
    several times, and is compiled once. To evaluate a compiled form at another time, call `set_time`.
    """

    def __init__(self, t: float = 0.0) -> None:
        self._t, self._constants = t, dict[TimeDependent, fem.Constant | fem.Function]()

    def set_time(self, t: float) -> None:
        """Set the time of this level, and so the values of its constants in compiled forms."""
        self._t = t
        for time_constant, constant in self._constants.items():
            set_value(constant, time_constant.at(t))

    def at_level(self, expression: Expr) -> Expr:
        """Return an expression or a form in which constants of this time level replace those of the clock."""
        constants = time_constants(expression)
        for constant in constants:
            if constant not in self._constants:
                self._constants[constant] = constant.copy_at(self._t)
        return ufl_replace(expression, {c: self._constants[c] for c in constants}) if constants else expression


def with_strains(terms: Iterable[Term], new_strain: Callable[[Expr], Expr]) -> list[Term]:
    """Return copies of `terms` in which each prescribed strain e, if there is one, is replaced by `new_strain(e)`."""
    pairs = ((p, p.prescribed_strain) for p in terms)
    return [p if e is None else replace(p, prescribed_strain=new_strain(e)) for p, e in pairs]


class StepStrains:
    """Prescribed strains at both ends of a time step, and at the time between at which forces balance.

    They are constants in compiled forms. Forces balance at a fraction theta of the step. At rest all prescribed strains
    are zero: in the first step they act suddenly, as loads do.

    Args:
        mesh: the mesh.
        terms: the terms with prescribed strains.

    Attributes:
        has_increment: whether a prescribed strain changes over the step.
    """

    def __init__(self, mesh: Mesh, terms: Iterable[Term]) -> None:
        self._varies = any(p.prescribed_strain is not None and time_constants(p.prescribed_strain) for p in terms)
        self._old_factor, self._theta, self._now_factor = (fem.Constant(mesh, 1.0) for _ in range(3))
        self._old, self._new, self._now = TimeLevel(), TimeLevel(), TimeLevel()
        self.has_increment = True

    def begin(self, old: float, new: float, theta: float, *, at_rest: bool) -> None:
        """Begin a step from one time to another.

        Args:
            old: time at the start of the step.
            new: time at the end of the step.
            theta: fraction of the step after which forces balance.
            at_rest: whether prescribed strains are zero at the start, as in the first step.
        """
        self._old_factor.value, self._theta.value = 0.0 if at_rest else 1.0, theta
        self.has_increment = at_rest or self._varies
        self._old.set_time(old)
        self._new.set_time(new)

    def at_balance_time(self, f: Expr) -> Expr:
        """Return an expression f at the time at which forces balance: theta f(new) + (1 - theta) f(old).

        Displacements are averaged in the same way.
        """
        if not time_constants(f):
            return f
        return self._theta * self._new.at_level(f) + (1 - self._theta) * self._old_factor * self._old.at_level(f)

    def growth(self, f: Expr) -> Expr:
        """Return the increment f(new) - f(old) of an expression f over the step."""
        return self._new.at_level(f) - self._old_factor * self._old.at_level(f)

    def now(self, f: Expr) -> Expr:
        """Return an expression f at the time that `set_now` sets."""
        return self._now_factor * self._now.at_level(f)

    def set_now(self, t: float, *, at_rest: bool = False) -> None:
        """Set the time of the expressions from `now`; if `at_rest`, make these expressions zero."""
        self._now_factor.value = 0.0 if at_rest else 1.0
        self._now.set_time(t)


class PiecewiseLinear:
    """Function of time that is linear between given values, and NaN before the first and after the last time.

    Attributes:
        times: (n,) the n times, increasing.
        columns: (n, m) values at these times, with m components.
        is_scalar: whether each value is a number instead of components.
        kinks: the first and the last time, and those between at which the slope changes.
    """

    def __init__(self, times: Array, values: Array) -> None:
        self.times, self.columns, self.is_scalar = times, values.reshape(len(times), -1), values.ndim == 1
        slopes = np.diff(self.columns, axis=0) / np.diff(times)[:, None]
        slope_changes = np.abs(np.diff(slopes, axis=0)) > TIME_TOLERANCE * np.abs(slopes).max(axis=0)
        self.kinks = tuple(map(float, times[[True, *slope_changes.any(axis=1), True]]))

    def __call__(self, t: Expr) -> Expr | list[Expr]:
        """Return the value at t, a number or a UFL expression: one scalar, or a list of components.

        It is in UFL if t is, otherwise it consists of numbers.
        """
        if is_number(t) or isinstance(t, ufl.constantvalue.RealValue | ufl.constantvalue.Zero):
            y = [*map(float, self.values_at(float(t)))]
        else:
            t = ufl.as_ufl(t)
            now = _time_constant(t)
            y = [self._line(c, t) for c in self.columns.T] if now is None else [*TableConstant(now, t, self)]
        return y[0] if self.is_scalar else y

    def values_at(self, t: float) -> Array:
        """Return the values (m,) of the m components at the time t, a number."""
        first, last = self.times[[0, -1]]
        tolerance = TIME_TOLERANCE * max(abs(first), abs(last))
        if not first - tolerance <= t <= last + tolerance:
            return np.full(self.columns.shape[1], np.nan)
        return np.array([np.interp(t, self.times, column) for column in self.columns.T])

    def _line(self, column: Array, t: Expr) -> Expr:
        """Return one component, in UFL, at an argument t that also depends on the place.

        `column` (n,) has the values of the component at the n times.
        """
        times, slopes = [*map(float, self.times)], map(float, np.diff(column) / np.diff(self.times))
        in_range = ufl.And(ufl.ge(t, times[0]), ufl.le(t, times[-1]))
        durations = (ufl.max_value(0, ufl.min_value(t, b) - a) for a, b in pairwise(times))
        value = sum((slope * duration for slope, duration in zip(slopes, durations, strict=True)), float(column[0]))
        return ufl.conditional(in_range, value, ufl.sqrt(-1 - t * t))


def piecewise(values: Mapping[float, float | Sequence[float]]) -> Callable[[Expr, Expr], Expr]:
    """Return a load or prescribed displacement that is linear in time between given values, and undefined outside.

    Tables of thousands of values are fine, `piecewise(dict(zip(times, forces)))`. The table may be used in a function,
    `lambda x, t: (0, x[0] * table(x, t))`, at another time than t, `table(x, t / 3600)`, and as a law's temperature.
    Time steps of models with memory end at the times where its slope changes.

    Args:
        values: time -> value at this time: the components of a load, or one number, such as a displacement. At least
            two times are needed.

    Returns:
        A function (x, t) for the data of a model; it returns numbers if t is a number.

    Raises:
        InputError: fewer than two times, values that are not numbers or of different lengths.

    Example:
        >>> from thinlayer import piecewise
        >>> ramp = piecewise({0: 0, 1: 10, 3: 4})
        >>> [ramp(None, t) for t in (0.5, 1.0, 2.0)]
        [5.0, 10.0, 7.0]
    """
    try:
        times = real_values(sorted(values))
        value_rows = real_values([values[t] for t in sorted(values)])
    except (TypeError, ValueError, LookupError) as error:
        raise InputError(f"piecewise needs {{time: number or components}}: {error}") from error
    if len(times) < 2 or value_rows.ndim > 2 or not (np.isfinite(times).all() and np.isfinite(value_rows).all()):
        raise InputError(f"piecewise needs two times or more, each with a number or components, not {values!r}")
    table = PiecewiseLinear(times, value_rows)

    def at(_: Expr, t: Expr) -> Expr:
        return table(t)

    vars(at)["times"] = table.kinks
    return at


def _time_constant(expression: Expr) -> TimeConstant | None:
    """Return the clock's time constant in an expression that depends on the time alone; None for other expressions."""
    terminals = [node for node in unique_pre_traversal(expression) if isinstance(node, Terminal)]
    non_constants = {node for node in terminals if not isinstance(node, (ConstantValue, MultiIndex))}
    terminal = non_constants.pop() if len(non_constants) == 1 else None
    return terminal if type(terminal) is TimeConstant else None
