"""A table of a description in TOML: values by key, readers that check them, and errors that name the place."""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

from forms.base import InputError, is_finite, unknown_name_message

Keys = tuple[str, ...]


class DescriptionError(InputError):
    """Error in a description; says where it is, what is wrong, and what is allowed."""


@dataclass(frozen=True)
class TimeSeries:
    """Values at two or more times, linear in between, and the keys that lead to the series in the description."""

    values: Mapping[float, float | tuple[float, ...]]
    keys: Keys


def read_description(path: Path, settings: Sequence[str] = ()) -> Section:
    """Read a description in TOML, with some keys replaced.

    Args:
        path: the file; the name of its mesh file is relative to its folder.
        settings: texts "KEY=VALUE" in TOML, as "layer.E=2e3"; entries of lists are numbered from 1. A value that is not
            TOML is a text, as shells remove quotes.

    Raises:
        DescriptionError: the file cannot be read, or is not TOML, with the line; a setting cannot be read.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise DescriptionError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        remedy = "numbers have digits before and after the point, texts stand in quotes, yes and no are true and false"
        raise DescriptionError(f"{path} is not TOML: {error}; {remedy}") from None
    mesh = values.get("mesh")
    mesh = {"path": mesh} if isinstance(mesh, str) else mesh
    if isinstance(mesh, dict) and isinstance(mesh.get("path"), str):
        values["mesh"] = {**mesh, "path": str(path.parent / mesh["path"])}
    options = [f"--set {text!r}" for text in settings]
    for text, option in zip(settings, options, strict=True):
        values = _with_value(values, *_assignment(text, option), option)
    return Section(values, (), f"{path} with {', '.join(options)}" if options else str(path), [])


def _assignment(text: str, option: str) -> tuple[Keys, object]:
    """Return keys and value of a text "KEY=VALUE"; `option` names it in errors."""
    name, equals, value_text = text.partition("=")
    try:
        keys: Keys = ()
        inner: object = tomllib.loads(f"{name}{equals}0")
        while isinstance(inner, dict):
            ((key, inner),) = inner.items()
            keys = (*keys, key)
    except ValueError:
        raise DescriptionError(f"{option} cannot be read; give KEY=VALUE in TOML, such as layer.E=2e3") from None
    with suppress(ValueError):
        (value,) = tomllib.loads(f"value={value_text}").values()
        return keys, value
    return keys, value_text.strip()


def _with_value(old: object, keys: Sequence[str], value: object, option: str) -> Any:
    """Return a copy of a table or list with another value at the keys that lead to it."""
    if not keys:
        return value
    key, *rest = keys
    if isinstance(old, list) and key in (numbers := [str(k) for k in range(1, len(old) + 1)]):
        k = numbers.index(key)
        return [*old[:k], _with_value(old[k], rest, value, option), *old[k + 1 :]]
    if not isinstance(old, dict):
        raise DescriptionError(f"{option}: {_shown(old)} has no {key!r}; set the whole entry")
    return {**old, key: _with_value(old.get(key, {}), rest, value, option)}


@dataclass(frozen=True)
class Section:
    """A table of a description.

    Attributes:
        values: its entries.
        path: the keys that lead to it.
        name: the file, and the options that replaced keys.
        histories: all histories that have been read so far, in any table of the description.
    """

    values: Mapping[str, Any]
    path: Keys
    name: str
    histories: list[TimeSeries]

    def refuse(self, what: str, *keys: str) -> NoReturn:
        """Raise DescriptionError about this table, or about an entry of it."""
        raise DescriptionError(": ".join(filter(None, [self.name, ".".join((*self.path, *keys)), what])))

    @contextmanager
    def described(self, *keys: str) -> Iterator[None]:
        """Context that turns an InputError into a DescriptionError about this table or an entry of it."""
        try:
            yield
        except DescriptionError:
            raise
        except InputError as error:
            self.refuse(str(error), *keys)

    def entries(self, keys: Readers, needs: Mapping[str, str] | None = None, kind: str = "key") -> dict[str, Any]:
        """Return key -> value, read from all entries of the table.

        Args:
            keys: allowed key -> its reader.
            needs: required key -> words for what it is.
            kind: the word for a key in errors.
        """
        if unknown := [key for key in self.values if key not in keys]:
            self.refuse(unknown_name_message(kind, unknown[0], keys))
        if missing := [f"{key} is missing: {what}" for key, what in (needs or {}).items() if key not in self.values]:
            self.refuse(missing[0])
        return {key: read(self, key) for key, read in keys.items() if key in self.values}

    def checked(self, key: str, good: Callable[[Any], bool], wrong: str) -> Any:
        """Return the value of a key; raise DescriptionError with the words `wrong` unless `good(value)`."""
        if not good(value := self.values[key]):
            self.refuse("it is not filled in" if "?" in str(value) else f"{_shown(value)} {wrong}", key)
        return value

    def number(self, key: str) -> float:
        """A finite number."""
        return float(self.checked(key, is_finite, "is not a finite number"))

    def vector(self, key: str) -> tuple[float, ...]:
        """Components of a vector, 2 or 3 finite numbers."""
        wrong = "is not a vector; give 2 components, in 3D 3, such as [0, -50]"
        return tuple(map(float, self.checked(key, lambda value: _are_finite(value) and len(value) in (2, 3), wrong)))

    def text(self, key: str, allowed: Collection[str] = (), kind: str = "choice") -> str:
        """A text; if `allowed` is not empty, one of these texts."""
        value = self.values[key]
        if not isinstance(value, str) or not value:
            self.refuse(f"{_shown(value)} is not a text" + (f"; allowed: {', '.join(allowed)}" if allowed else ""), key)
        if allowed and value not in allowed:
            self.refuse(unknown_name_message(kind, value, allowed), key)
        return value

    def texts(self, key: str) -> str | list[str]:
        """A text, or a list of texts."""
        value = self.values[key]
        several = isinstance(value, list) and value and all(isinstance(text, str) for text in value)
        return value if several else self.text(key)

    def table(self, key: str, what: str) -> Section:
        """Return the table of a key, empty without it; raise DescriptionError with the text `what` for other values."""
        return self.inner(self.values.get(key, {}), what, key)

    def inner(self, value: object, what: str, *keys: str) -> Section:
        """Return a value of this table as a `Section`; raise DescriptionError if it is not a table."""
        if not isinstance(value, Mapping):
            self.refuse(f"{_shown(value)} is not a table; it has {what}", *keys)
        return replace(self, values=value, path=(*self.path, *keys))

    def tables(self, key: str, what: str) -> list[Section]:
        """Return the tables in the list of a key."""
        tables = self.checked(key, lambda value: isinstance(value, list), f"is not a list of tables; each has {what}")
        return [self.inner(table, what, key, str(number)) for number, table in enumerate(tables, 1)]


Reader = Callable[[Section, str], Any]
Readers = Mapping[str, Reader]


def choice_reader(*allowed: str) -> Reader:
    """Return a reader of a text that must be one of `allowed`."""
    return lambda section, key: section.text(key, allowed)


def positive_reader(what: str) -> Reader:
    """Return a reader of a number > 0; errors say `what` it is."""

    def read(section: Section, key: str) -> float:
        section.number(key)
        return float(section.checked(key, lambda number: number > 0, f"is not > 0; it is {what}"))

    return read


def time_series(read: Reader) -> Reader:
    """Return a reader of values that `read` accepts, or of a `TimeSeries` of them, {times = ..., values = ...}."""

    def read_each(section: Section, key: str) -> object:
        entry, what = section.values[key], "a history is {times = [0, 1], values = [0, 5]}: two or more times that grow"
        if not isinstance(entry, Mapping) or not {"times", "values"} & entry.keys():
            return read(section, key)
        parts = dict.fromkeys(("times", "values"), lambda table, name: table.values[name])
        times, values = section.table(key, what).entries(parts, dict.fromkeys(parts, what)).values()
        if not (isinstance(values, list) and is_growing(times) and len(times) == len(values) >= 2):
            section.refuse(what, key)
        inner = section.inner({str(k): value for k, value in enumerate(values, 1)}, what, key, "values")
        series = TimeSeries({float(t): read(inner, str(k)) for k, t in enumerate(times, 1)}, (*section.path, key))
        section.histories.append(series)
        return series

    return read_each


def is_growing(times: object) -> TypeGuard[list[float]]:
    """Whether something is a list of finite numbers, each larger than the one before."""
    return _are_finite(times) and all(a < b for a, b in itertools.pairwise(times))


def _are_finite(value: object) -> TypeGuard[list[float]]:
    return isinstance(value, list) and all(map(is_finite, value))


def _shown(value: object) -> str:
    """A value as it may be written in TOML, shortened."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) < 60 else f"{text[:56]} ..."
