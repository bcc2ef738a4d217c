"""Parameters of laws that vary from place to place: numpy functions of the coordinates."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError, is_number
from forms.tensors import Expr

MAX_CHECKED_PLACES = 1000  # number of places at which parameters are checked in addition to their extremes
BinaryOperation = Callable[[float, float], float]  # an operator of two numbers or arrays
FieldOperator = Callable[["ParameterField", object], "ParameterField"]


class ParameterRangeError(InputError):
    """Error for a parameter whose value is out of range at one of several places.

    Attributes:
        k: index of this place.
    """

    def __init__(self, message: str, k: int) -> None:
        super().__init__(message)
        self.k = k


def _operator_methods(combine: BinaryOperation) -> tuple[FieldOperator, FieldOperator]:
    """Return the methods for an operator and for its reflection, such as `__sub__` and `__rsub__` of `ParameterField`.

    Args:
        combine: function of the left and the right operand, such as `operator.sub`.
    """
    return lambda self, other: self._with(combine, other), lambda self, other: self._with(combine, other, swapped=True)


@dataclass(frozen=True, eq=False)
class ParameterField:
    """A parameter that is a function of the place, or that is computed from such parameters and numbers.

    Attributes:
        function: without `operands`, a numpy function of the coordinates (d, n) of n places that returns n values, or
            one number. With `operands`, a function of their values.
        operands: parameter fields and numbers, whose values are the arguments of the function; (): there are none.
    """

    function: Callable[..., npt.ArrayLike]
    operands: tuple[ParameterField | float, ...] = ()
    __array_ufunc__: ClassVar[None] = None  # numpy scalars leave arithmetic to this class

    def __call__(self, x: Array) -> Array:
        """Return the values (n,) of the parameter at n places with the coordinates `x` (d, n).

        Raises:
            ParameterRangeError: a value is not finite, or out of the range of the function.
            TypeError: the function does not return n real numbers.
        """
        operand_values = [operand(x) if isinstance(operand, ParameterField) else operand for operand in self.operands]
        array = real_values(self.function(*operand_values or [x.copy()]))
        if array.shape not in ((), x.shape[1:]):
            raise TypeError(f"it gives the shape {array.shape} for x of shape {x.shape}; allowed: {x.shape[1:]}")
        values = np.array(np.broadcast_to(array, x.shape[1:]))
        if len(bad := np.flatnonzero(~np.isfinite(values))):
            raise ParameterRangeError(f"{values[bad[0]]}; allowed: finite numbers", int(bad[0]))
        return values

    def __repr__(self) -> str:
        name = getattr(self.function, "__qualname__", type(self.function).__name__)
        return f"{name}({', '.join(map(repr, self.operands)) or 'x'})"

    def _with(self, combine: BinaryOperation, other: object, *, swapped: bool = False) -> ParameterField:
        value = other[()] if isinstance(other, np.ndarray) and not other.ndim else other
        if not (isinstance(value, ParameterField) or is_number(value)):
            return NotImplemented
        operand = value if isinstance(value, ParameterField) else float(value)
        return ParameterField(combine, (operand, self) if swapped else (self, operand))

    __add__, __radd__ = _operator_methods(operator.add)
    __sub__, __rsub__ = _operator_methods(operator.sub)
    __mul__, __rmul__ = _operator_methods(operator.mul)
    __truediv__, __rtruediv__ = _operator_methods(operator.truediv)


# what a user may give for a scalar parameter: a number, or a numpy function of places (d, n) that gives n values
Parameter = float | Callable[[Array], npt.ArrayLike]
# what a law may have: numbers, a function of the place, or UFL, to which `Constant` and `Function` of DOLFINx belong
ParameterValue: TypeAlias = float | Array | ParameterField | Expr


def as_parameter_field(value: Parameter) -> float | ParameterField:
    """Return a function as a `ParameterField`; a number, or a `ParameterField`, is returned unchanged.

    Numbers of numpy become Python's, as they do not multiply vectors of UFL.
    """
    value = float(value) if isinstance(value, np.floating) else value
    return ParameterField(value) if callable(value) and not isinstance(value, ParameterField) else value


def real_values(values: object) -> Array:
    """Return numbers as an array of float64.

    Raises:
        TypeError: a value is complex or boolean, which numpy would convert silently.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"it gives {array.dtype.name} values, not real numbers")
    flat = np.array(values, object).flat if isinstance(values, (list, tuple)) else ()
    if any(isinstance(v, (bool, np.bool_)) for v in flat):
        raise TypeError("it gives True or False among its values, which are not numbers")
    return array.astype(float)


def parameter_numbers(value: ParameterValue) -> Array:
    """Return a parameter, a number or an array, as an array; NaN for a `ParameterField`."""
    return np.asarray(np.nan if isinstance(value, ParameterField) else value, float)


def failure_text(call: str, x: Array, error: Exception) -> str:
    """Return the text of a message that a user's function has failed.

    Args:
        call: text of the failed call, such as "gap(x)".
        x: array with which it was called.
        error: error that it raised.
    """
    return f"{call} fails for an array of shape {x.shape}: {type(error).__name__}: {error}"


def place_text(x: Array, k: int) -> str:
    """Return the coordinates of one place as text for messages: place number `k` of the places `x` (d, n)."""
    return f"x = ({', '.join(f'{c:g}' for c in x[:, k])})"


def extreme_indices(values: Sequence[Array], *, with_differences: bool = False) -> list[int]:
    """Return the indices of the places where a quantity, or the ratio of two, is smallest or largest.

    Args:
        values: values (n,) of each quantity at n places.
        with_differences: whether to add the places where the difference of two quantities is smallest or largest.
    """
    quantities = list(values)
    with np.errstate(all="ignore"):
        for a, b in combinations(values, 2):
            quantities += [a / b] + ([a - b] if with_differences else [])
    return sorted({int(pick(f)) for f in quantities for pick in (np.nanargmin, np.nanargmax) if np.isfinite(f).any()})
