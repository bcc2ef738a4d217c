"""Parameters of laws that vary from place to place: numpy functions of coordinates."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, ClassVar, Self

import numpy as np

from forms.base import Array, InputError, is_number

MANY = 1000  # number of places at which parameters are checked beside those where they are extreme
Parameter = float | Callable[[Array], Any]  # a number, or a numpy function of places (d, n) that gives n values


class OutOfRange(InputError):
    """A value of a parameter out of range at the k-th place."""

    def __init__(self, message: str, k: int) -> None:
        super().__init__(message)
        self.k = k


def _operators(combine: Callable[[Any, Any], Any]) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """The methods of `Field` that combine it with another value, on its right and on its left."""
    return lambda one, other: one._with(combine, other), lambda one, other: one._with(combine, other, turned=True)


@dataclass(frozen=True, eq=False)
class Field:
    """A parameter as a function of the place, or a value computed from such parameters and numbers.

    Attributes:
        function: of coordinates x (d, n), or of the values (n,) of the operands; returns (n,) or one number.
        operands: Fields and numbers from whose values the function computes; (): it is a function of coordinates.
    """

    function: Callable[..., Any]
    operands: tuple[Any, ...] = ()
    __array_ufunc__: ClassVar[None] = None  # numbers of numpy leave arithmetic to this class

    def __call__(self, x: Array) -> Array:
        """Values (n,) at places x (d, n).

        Raises:
            OutOfRange: a value is not finite, or out of the range of the function. TypeError: not n real numbers.
        """
        if self.operands:
            given = [one(x) if isinstance(one, Field) else one for one in self.operands]
            found = np.asarray(self.function(*given), float)
        else:
            found = np.asarray(self.function(x.copy()))
            if found.dtype.kind not in "iuf":
                raise TypeError(f"it gives {found.dtype.name} values, not real numbers")
        if found.shape not in ((), x.shape[1:]):
            raise TypeError(f"it gives the shape {found.shape} for x of shape {x.shape}; allowed: {x.shape[1:]}")
        values = np.broadcast_to(found, x.shape[1:]).astype(float)
        if len(bad := np.flatnonzero(~np.isfinite(values))):
            raise OutOfRange(f"{values[bad[0]]}; allowed: finite numbers", int(bad[0]))
        return values

    def __repr__(self) -> str:
        name = getattr(self.function, "__qualname__", type(self.function).__name__)
        return f"{name}({', '.join(map(repr, self.operands)) or 'x'})"

    def _with(self, combine: Callable[[Any, Any], Any], other: Any, *, turned: bool = False) -> Any:
        if not (isinstance(other, Field) or is_number(other) or (isinstance(other, np.ndarray) and not other.ndim)):
            return NotImplemented
        other = other if isinstance(other, Field) else float(other)
        return Field(combine, (other, self) if turned else (self, other))

    __add__, __radd__ = _operators(operator.add)
    __sub__, __rsub__ = _operators(operator.sub)
    __mul__, __rmul__ = _operators(operator.mul)
    __truediv__, __rtruediv__ = _operators(operator.truediv)


class OfPlaces:
    """What a law knows of its parameters that are functions of the place."""

    def with_parameters(self, values: Mapping[str, Any]) -> Self:
        """The same law with other values."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise InputError if a parameter is out of its range."""

    @property
    def fields(self) -> dict[str, Field]:
        """The parameters that are functions of the place, by name."""
        return {name: value for name, value in vars(self).items() if is_field(value)}

    def fields_at(self, x: Array) -> dict[str, Array]:
        """The values (n,) of these parameters at places x (d, n) in the joint before inflating, by name.

        Raises:
            InputError: a function fails, does not give n finite real numbers, or is out of its range; with the place.
        """
        return {name: self._field_at(name, one, x) for name, one in self.fields.items()}

    def _field_at(self, name: str, one: Field, x: Array) -> Array:
        try:
            return one(x)
        except OutOfRange as error:
            said = str(error) if str(error)[:1].isalpha() and " is " in str(error) else f"{name} is {error}"
            raise InputError(f"{type(self).__name__}: {said}, at {place_of(x, error.k)}") from None
        except Exception as error:
            raise InputError(
                f"{type(self).__name__}: {name}(x) fails for x of shape {x.shape}: {type(error).__name__}: {error}; "
                "it must be a numpy function of places (d, n) in the joint that gives n numbers"
            ) from error

    def at_places(self, x: Array) -> Iterator[Self]:
        """The law with numbers, unchecked, at each of the places x (d, n)."""
        values = self.fields_at(x)
        for k in range(x.shape[1]):
            yield self.with_parameters({name: float(value[k]) for name, value in values.items()})

    def check_at(self, x: Array) -> None:
        """Raise InputError if a parameter is out of its range at one of the places x (d, n).

        Of many places those are checked at which a parameter, or a difference or a ratio of two, is smallest or largest,
        and some thousand others.
        """
        if not self.fields:
            return
        values, n = list(self.fields_at(x).values()), x.shape[1]
        at = sorted({*extremes(values, differences=True), *range(0, n, max(n // MANY, 1))})
        for k, one in zip(at, self.at_places(x[:, at]), strict=True):
            try:
                one.check()
            except InputError as error:
                raise InputError(f"{error}, at {place_of(x, k)}") from None

    def samples(self, x: Array) -> list[Self]:
        """The law with numbers, at those of the places x (d, n) where a parameter or a ratio of two is extreme."""
        if not self.fields:
            return [self]
        extreme = x[:, extremes(list(self.fields_at(x).values()))]
        self.check_at(extreme)
        return list(self.at_places(extreme))


def is_field(value: Any) -> bool:
    """Whether a parameter is a function of the place."""
    return isinstance(value, Field)


def field_of(value: Any) -> Any:
    """A function as a Field; other values unchanged."""
    return Field(value) if callable(value) and not isinstance(value, Field) else value


def number_of(value: Any) -> Array:
    """A parameter as numbers, NaN for a Field."""
    return np.asarray(np.nan if isinstance(value, Field) else value, float)


def place_of(x: Array, k: int) -> str:
    """Text of the k-th of the places x (d, n), for messages."""
    return f"x = ({', '.join(f'{c:g}' for c in x[:, k])})"


def extremes(values: Sequence[Array], *, differences: bool = False) -> list[int]:
    """Numbers of the places at which one of some values (n,), or a ratio, or a difference of two is smallest or largest."""
    fields = list(values)
    with np.errstate(all="ignore"):
        for a, b in combinations(values, 2):
            fields += [a / b] + ([a - b] if differences else [])
    return sorted({int(pick(one)) for one in fields for pick in (np.nanargmin, np.nanargmax) if np.isfinite(one).any()})
