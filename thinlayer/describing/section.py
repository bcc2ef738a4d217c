"""A table of a description: values by key, and words for the place where each was given."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from forms.base import InputError, is_finite, unknown

Path = tuple[str, ...]


class DescriptionError(InputError):
    """A description that cannot be used. Says where, what is wrong, and what is allowed."""


@dataclass(frozen=True)
class History:
    """Values at times, two or more; linear between them."""

    values: Mapping[float, Any]


@dataclass(frozen=True)
class Section:
    """A table of a description.

    Attributes:
        values: its entries.
        path: the keys that lead to it.
        told: words for where an entry stands, by the keys that lead to it.
    """

    values: Mapping[str, Any]
    path: Path
    told: Callable[[Path], str]

    def where(self, *keys: str) -> str:
        """Words for where this table, or an entry of it, stands."""
        return self.told((*self.path, *keys))

    def refuse(self, what: str, *keys: str) -> NoReturn:
        """Raise DescriptionError about this table, or about an entry of it."""
        raise DescriptionError(f"{self.where(*keys)}: {what}")

    def allow(self, keys: Iterable[str], kind: str = "key") -> None:
        """Raise DescriptionError if there is an entry with another key."""
        known = [*keys]
        for key in self.values:
            if key not in known:
                self.refuse(unknown(kind, key, known))

    def require(self, key: str, what: str) -> Any:
        """The value of a key; raises DescriptionError if there is none, with words for what it is."""
        if key not in self.values:
            self.refuse(f"{key} is missing: {what}")
        return self.values[key]

    def number(self, key: str, default: float | None = None) -> float | None:
        """A finite number."""
        if key not in self.values:
            return default
        if not is_finite(self.values[key]):
            self.refuse(f"{self.values[key]!r} is no finite number", key)
        return float(self.values[key])

    def positive(self, key: str, what: str) -> float:
        """A number > 0 that must be given."""
        self.require(key, what)
        number = self.number(key)
        if number is None or number <= 0:
            self.refuse(f"{self.values[key]!r} is not > 0; it is {what}", key)
        return number

    def vector(self, key: str) -> tuple[float, ...]:
        """Components of a vector, 2 or 3 finite numbers."""
        return self.components(self.values[key], key)

    def components(self, value: Any, *keys: str) -> tuple[float, ...]:
        """The same of a value of this table."""
        if not (isinstance(value, list | tuple) and len(value) in (2, 3) and all(map(is_finite, value))):
            self.refuse(f"{_shown(value)} is no vector; give 2 components, in 3D 3, such as [0, -50]", *keys)
        return tuple(float(one) for one in value)

    def history(self, key: str, read: Callable[[Section, str], Any]) -> Any:
        """A value that `read` takes from a table at a key, or a `History` of such values, {times = ..., values = ...}."""
        given = self.values[key]
        if not isinstance(given, Mapping) or not {"times", "values"} & given.keys():
            return read(self, key)
        one = self.table(key, "times and values")
        one.allow(["times", "values"])
        times, values = (one.require(name, "a history has times and values") for name in ("times", "values"))
        if not (isinstance(values, list) and is_growing(times) and len(times) == len(values) >= 2):
            self.refuse("a history is {times = [0, 1], values = [0, 5]}: two or more, times that grow", key)
        each = Section({str(k): value for k, value in enumerate(values, 1)}, (*one.path, "values"), self.told)
        return History({float(t): read(each, str(k)) for k, t in enumerate(times, 1)})

    def text(self, key: str, allowed: Iterable[str] | None = None) -> str | None:
        """A text, or None if it is not given."""
        if key not in self.values:
            return None
        value = self.values[key]
        if not isinstance(value, str) or not value:
            self.refuse(f"{_shown(value)} is no text" + (f"; allowed: {', '.join(allowed)}" if allowed else ""), key)
        if allowed is not None and value not in (known := [*allowed]):
            self.refuse(unknown("choice", value, known), key)
        return value

    def texts(self, key: str) -> str | tuple[str, ...] | None:
        """A text or several in a list, or None."""
        value = self.values.get(key)
        if isinstance(value, list | tuple) and value and all(isinstance(one, str) for one in value):
            return tuple(value)
        return self.text(key)

    def flag(self, key: str) -> bool:
        """True or false; false if it is not given."""
        value = self.values.get(key, False)
        if not isinstance(value, bool):
            self.refuse(f"{_shown(value)} is neither true nor false", key)
        return value

    def table(self, key: str, what: str) -> Section:
        """The table of a key, empty if it is not given; raises DescriptionError if it is no table, with what it is."""
        return self.inner(self.values.get(key, {}), what, key)

    def inner(self, value: Any, what: str, *keys: str) -> Section:
        """A value of this table as a table."""
        if not isinstance(value, Mapping):
            self.refuse(f"{_shown(value)} is no table; it has {what}", *keys)
        return Section(value, (*self.path, *keys), self.told)

    def tables(self, key: str, what: str) -> list[Section]:
        """The tables in a list."""
        value = self.values.get(key, [])
        if not isinstance(value, list | tuple):
            self.refuse(f"{_shown(value)} is no list of tables; each has {what}", key)
        return [self.inner(one, what, key, str(number)) for number, one in enumerate(value, 1)]

    def named(self, key: str, what: str) -> dict[str | None, Section]:
        """The table of a key as the tables in it, by their names; if it has none, itself with the name None."""
        whole = self.table(key, what)
        inside = [isinstance(value, Mapping) for value in whole.values.values()]
        if not any(inside):
            return {None: whole}
        if not all(inside):
            whole.refuse(f"it has tables with names beside keys without one; give each name a table with {what}")
        return {name: whole.table(name, what) for name in whole.values}


def is_growing(times: Any) -> bool:
    """Whether something is a list of finite numbers, each larger than the one before."""
    good = isinstance(times, list | tuple) and all(map(is_finite, times))
    return good and all(a < b for a, b in itertools.pairwise(times))


def as_array(value: Any) -> Any:
    """Lists as arrays of numbers; other values as they are."""
    return np.array(value, float) if isinstance(value, list | tuple) else value


def _shown(value: Any) -> str:
    """A value as it may be written in TOML, shortened."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    return text if len(text) < 60 else f"{text[:56]} ..."
