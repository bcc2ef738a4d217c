"""Parameters of laws that vary from place to place: numpy functions of coordinates."""

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
Combine = Callable[[float, float], float]  # an operator of two numbers or arrays
FieldOperator = Callable[["ParameterField", object], "ParameterField"]


class ParameterRangeError(InputError):
    """Error for a value of a parameter that is out of range at one of several places.

    Attributes:
        k: index of the place.
    """

    def __init__(self, message: str, k: int) -> None:
        super().__init__(message)
        self.k = k


def _operators(combine: Combine) -> tuple[FieldOperator, FieldOperator]:
    """Two operator methods of `ParameterField` that combine it with a number or another field.

    The first has the other operand on the right of the operator, the second on its left.
    """
    return lambda self, other: self._with(combine, other), lambda self, other: self._with(combine, other, swapped=True)


@dataclass(frozen=True, eq=False)
class ParameterField:
    """A parameter as a function of the place, or a value computed from such parameters and numbers.

    Attributes:
        function: function of coordinates x (d, n) that returns (n,) or one number; with `operands`, function of their
            values.
        operands: parameter fields and numbers whose values are the arguments of the function; (): its argument is x.
    """

    function: Callable[..., npt.ArrayLike]
    operands: tuple[ParameterField | float, ...] = ()
    __array_ufunc__: ClassVar[None] = None  # numpy scalars leave arithmetic to this class

    def __call__(self, x: Array) -> Array:
        """Values (n,) at places x (d, n).

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

    def _with(self, combine: Combine, other: object, *, swapped: bool = False) -> ParameterField:
        value = other[()] if isinstance(other, np.ndarray) and not other.ndim else other
        if not (isinstance(value, ParameterField) or is_number(value)):
            return NotImplemented
        operand = value if isinstance(value, ParameterField) else float(value)
        return ParameterField(combine, (operand, self) if swapped else (self, operand))

    __add__, __radd__ = _operators(operator.add)
    __sub__, __rsub__ = _operators(operator.sub)
    __mul__, __rmul__ = _operators(operator.mul)
    __truediv__, __rtruediv__ = _operators(operator.truediv)


# what a user may give for a scalar parameter: a number, or a numpy function of places (d, n) that gives n values
Parameter = float | Callable[[Array], npt.ArrayLike]
# what a law may have: numbers, a function of the place, or UFL, to which `Constant` and `Function` of DOLFINx belong
ParameterValue: TypeAlias = float | Array | ParameterField | Expr


def as_parameter_field(value: Parameter) -> float | ParameterField:
    """Wrap a function as a `ParameterField`; return other values unchanged."""
    return ParameterField(value) if callable(value) and not isinstance(value, ParameterField) else value


def real_values(values: object) -> Array:
    """Values as an array of float64.

    Raises:
        TypeError: values are complex or boolean, which numpy would convert silently.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"it gives {array.dtype.name} values, not real numbers")
    flat = np.array(values, object).flat if isinstance(values, (list, tuple)) else ()
    if any(isinstance(v, (bool, np.bool_)) for v in flat):
        raise TypeError("it gives True or False among its values, which are not numbers")
    return array.astype(float)


def parameter_numbers(value: ParameterValue) -> Array:
    """A parameter (number, array) as an array; NaN for a `ParameterField`."""
    return np.asarray(np.nan if isinstance(value, ParameterField) else value, float)


def failure_text(what: str, x: Array, error: Exception) -> str:
    """Text for messages: a user's function has failed.

    Args:
        what: name of the function.
        x: array for which it was called.
        error: error that it raised.
    """
    return f"{what} fails for an array of shape {x.shape}: {type(error).__name__}: {error}"


def place_text(x: Array, k: int) -> str:
    """Text of the k-th of the places x (d, n), for messages."""
    return f"x = ({', '.join(f'{c:g}' for c in x[:, k])})"


def extreme_places(values: Sequence[Array], *, differences: bool = False) -> list[int]:
    """Indices of the places where one of several quantities, or the ratio of two, is smallest or largest.

    Args:
        values: values (n,) of each quantity at n places.
        differences: whether the differences of two quantities count, too.
    """
    arrays = list(values)
    with np.errstate(all="ignore"):
        for a, b in combinations(values, 2):
            arrays += [a / b] + ([a - b] if differences else [])
    return sorted({int(pick(f)) for f in arrays for pick in (np.nanargmin, np.nanargmax) if np.isfinite(f).any()})
