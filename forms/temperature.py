"""Parameters that depend on a temperature, and checks of the numbers that functions of users return."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError, require
from forms.parameter_fields import failure_text, place_text, real_values

TemperatureFunction = Callable[[Array], npt.ArrayLike]  # (n,) temperatures -> (n,) values, numpy
TemperatureField = Callable[[Array, float], npt.ArrayLike]  # places (d, n), time -> (n,) temperatures, numpy


@dataclass(frozen=True)
class Tabulated:
    """Table of a parameter's values at some temperatures, with linear interpolation: a function of temperature.

    Attributes:
        values: two or more pairs of temperature and value, in the order of increasing temperature.

    Raises:
        InputError: pairs out of order or not finite; in a call, a temperature outside the table.

    Example:
        >>> from forms import Tabulated
        >>> alpha = Tabulated([(20, 0.1), (80, 0.4)])
        >>> float(alpha(50))
        0.25
    """

    values: tuple[tuple[float, float], ...]

    def __init__(self, values: Iterable[tuple[float, float]]) -> None:
        rows = finite_values([*values], (-1, 2)) if isinstance(values, Iterable) else None
        if rows is None or len(rows) < 2 or (np.diff(rows[:, 0]) <= 0).any():
            raise InputError(f"Tabulated needs two or more finite pairs (T, value) with T increasing, not {values!r}")
        object.__setattr__(self, "values", tuple((float(T), float(value)) for T, value in rows))

    def __call__(self, T: npt.ArrayLike) -> Array:
        """Return the parameter's values (n,) at the temperatures `T` (n,), or one value at one temperature."""
        require(np.asarray(T).dtype.kind in "iuf", "T", T, "a table is a function of temperatures, numbers")
        T, rows = np.asarray(T, float), np.array(self.values)
        for bad_T in T[~((rows[0, 0] <= T) & (rows[-1, 0] >= T))][:1]:
            raise InputError(f"T is {bad_T:g}; the table knows {rows[0, 0]:g} to {rows[-1, 0]:g}")
        return np.asarray(np.interp(T, rows[:, 0], rows[:, 1]))


def finite_values(values: object, *shapes: tuple[int, ...]) -> Array | None:
    """Return numbers as an array of float64; None if they are not real and finite, or have a wrong shape.

    Args:
        values: the numbers, in any form that numpy converts to an array.
        shapes: allowed shapes; -1 as first entry of a shape stands for any length. If none is given, all shapes are
            allowed.
    """
    try:
        array = real_values(values)
    except (TypeError, ValueError):
        return None
    shape_fits = not shapes or array.shape in shapes or (-1, *array.shape[1:]) in shapes
    return array if shape_fits and np.isfinite(array).all() else None


def place_and_time_text(x: Array, t: float, k: int) -> str:
    """Return the coordinates of one place and the time `t` as text for messages: place number `k` of `x` (d, n)."""
    return f" at {place_text(x, k)}, t = {t:g}"


def checked_values(
    call: str, function: Callable[..., npt.ArrayLike], x: Array, *more: object, wanted: str, where: Callable[[int], str]
) -> Array:
    """Return the values (n,) of a user's function at n places or temperatures, which must be finite real numbers.

    Args:
        call: text of the call, such as "gap(x)", for messages.
        function: the user's function of `x` and `more`.
        x: places (d, n) or temperatures (n,).
        more: further arguments of the function, such as the time.
        wanted: text that says what the function must return, for messages.
        where: function from an index k to a text that tells the k-th place or temperature, for messages.

    Raises:
        InputError: the function fails, or does not return n finite real numbers.
    """
    try:
        values = np.array(np.broadcast_to(real_values(function(x.copy(), *more)), x.shape[-1:]))
    except InputError as error:
        raise InputError(f"{call}: {error}") from None
    except Exception as error:
        raise InputError(f"{failure_text(call, x, error)}; {wanted}") from error
    for k in np.flatnonzero(~np.isfinite(values))[:1]:
        raise InputError(f"{call} is {values[k]}{where(int(k))}; {wanted}")
    return values


def evaluate_parameter(law: object, name: str, parameter: float | TemperatureFunction, T: Array) -> Array:
    """Return the values (n,) of a law's parameter at temperatures T (n,).

    Args:
        law: the law, for messages.
        name: name of the parameter, for messages.
        parameter: a number, or a function of the temperature.
        T: the temperatures.

    Raises:
        InputError: the function fails, or does not return n finite real numbers.
    """
    if not callable(parameter):
        return np.full(len(T), float(parameter))
    call, wanted = f"{type(law).__name__}: {name}(T)", "it must be a numpy function of temperatures, or Tabulated(...)"
    return checked_values(call, parameter, T, wanted=wanted, where=lambda k: f" at T = {T[k]:g}")
