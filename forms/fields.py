"""Parameters of laws that vary from place to place: numpy functions of coordinates."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from forms.base import InputError, is_number
from forms.declarations import LawError

Array = npt.NDArray[np.float64]
Parameter = float | Callable[[Array], Any]  # a number, or a numpy function of places (d, n) that gives n values


class OutOfRange(InputError):
    """A value of a parameter out of range at the k-th place."""

    def __init__(self, message: str, k: int) -> None:
        super().__init__(message)
        self.k = k


@dataclass(frozen=True, eq=False)
class Field:
    """A parameter as a function of the place, or a value computed from such parameters and numbers.

    Attributes:
        function: of coordinates x (d, n), or of the values (n,) of the operands; returns (n,) or one number.
        operands: Fields and numbers from whose values the function computes; (): it is a function of coordinates.
    """

    function: Callable[..., Any]
    operands: tuple[Any, ...] = ()

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

    def __add__(self, other: Any) -> Any:
        return self._with(operator.add, other)

    def __radd__(self, other: Any) -> Any:
        return self._with(operator.add, other, turned=True)

    def __sub__(self, other: Any) -> Any:
        return self._with(operator.sub, other)

    def __rsub__(self, other: Any) -> Any:
        return self._with(operator.sub, other, turned=True)

    def __mul__(self, other: Any) -> Any:
        return self._with(operator.mul, other)

    def __rmul__(self, other: Any) -> Any:
        return self._with(operator.mul, other, turned=True)

    def __truediv__(self, other: Any) -> Any:
        return self._with(operator.truediv, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._with(operator.truediv, other, turned=True)


class OfPlaces:
    """What a law knows of its parameters that are functions of the place."""

    def with_parameters(self, values: Mapping[str, Any]) -> Self:
        """The same law with other values."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise LawError if a parameter is out of its range."""

    @property
    def fields(self) -> dict[str, Field]:
        """The parameters that are functions of the place, by name."""
        return {name: value for name, value in vars(self).items() if is_field(value)}

    def fields_at(self, x: Array) -> dict[str, Array]:
        """The values (n,) of these parameters at places x (d, n) in the joint before inflating, by name.

        Raises:
            LawError: a function fails, does not give n finite real numbers, or is out of its range; with the place.
        """
        return {name: self._field_at(name, one, x) for name, one in self.fields.items()}

    def _field_at(self, name: str, one: Field, x: Array) -> Array:
        try:
            return one(x)
        except OutOfRange as error:
            said = str(error) if str(error)[:1].isalpha() and " is " in str(error) else f"{name} is {error}"
            raise LawError(f"{type(self).__name__}: {said}, at {place_of(x, error.k)}") from None
        except Exception as error:
            raise LawError(
                f"{type(self).__name__}: {name}(x) fails for x of shape {x.shape}: {type(error).__name__}: {error}; "
                "it must be a numpy function of places (d, n) in the joint that gives n numbers"
            ) from error

    def at_places(self, x: Array) -> Iterator[Self]:
        """The law with numbers, unchecked, at each of the places x (d, n)."""
        values = self.fields_at(x)
        for k in range(x.shape[1]):
            yield self.with_parameters({name: float(value[k]) for name, value in values.items()})

    def check_at(self, x: Array) -> None:
        """Raise LawError if a parameter is out of its range at one of the places x (d, n)."""
        for k, one in enumerate(self.at_places(x) if self.fields else ()):
            try:
                one.check()
            except LawError as error:
                raise LawError(f"{error}, at {place_of(x, k)}") from None

    def samples(self, x: Array) -> list[Self]:
        """The law with numbers, at those of the places x (d, n) where a parameter is smallest or largest."""
        if not self.fields:
            return [self]
        self.fields_at(x)  # raises errors with names and places
        extreme = extremes(list(self.fields.values()), x)
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


def extremes(fields: list[Field], x: Array) -> Array:
    """Those of the places x (d, n) at which one of the fields is smallest or largest, (d, m)."""
    at = {int(pick(values)) for one in fields for values in [one(x)] for pick in (np.argmin, np.argmax)}
    return x[:, sorted(at)]
