"""Tables of an input file in TOML, functions that read and check their values, and errors that say where a value is.

The input file of the command `estimate` is called a description (`running/description.py`). A `Reader` checks the value
at a key of a table, and has the JSON schema by which editors check and complete it.
"""

from __future__ import annotations

import itertools
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from inspect import cleandoc
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

from forms.base import InputError, is_finite, unknown_name_message

KeyPath = tuple[str, ...]  # keys of nested tables, the outermost first
Schema = Mapping[str, Any]  # JSON schema, draft 7, of values or tables


class DescriptionError(InputError):
    """Error in an input file; its message says where it is, what is wrong, and what is allowed."""


@dataclass(frozen=True)
class TimeSeries:
    """A value of an input file that depends on time, linear between given times.

    Attributes:
        values: time -> value, a number or the components of a vector; at least two times, increasing.
        key_path: where the value is in the file: keys of nested tables, the outermost first, and last that of the value.
    """

    values: Mapping[float, float | tuple[float, ...]]
    key_path: KeyPath


def read_input_file(path: Path, settings: Sequence[str] = ()) -> TomlTable:
    """Read an input file in TOML, and replace some of its entries.

    Args:
        path: path of the input file. A relative path of the mesh file in it is relative to the folder of the input
            file.
        settings: texts "KEY=VALUE" in TOML, such as "layer.E=2e3", each of which replaces an entry. In a list, KEY is
            the number of the entry, from 1. A value that is not TOML is taken as text, since shells remove quotes.

    Returns:
        The whole file as a table. The path of its mesh file is now relative to the working folder.

    Raises:
        DescriptionError: the file cannot be read; it is not TOML (the message has the line); or a text of `settings`
            cannot be read.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise DescriptionError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        remedy = "numbers have digits before and after the point, texts stand in quotes, yes and no are true and false"
        if path.suffix != ".toml":
            command = f"thinlayer estimate {path} --new > {path.stem}.toml"
            remedy = f"for a mesh file, print a description to fill in: {command}"
        raise DescriptionError(f"{path} is not TOML: {error}; {remedy}") from None
    mesh = values.get("mesh")
    mesh = {"path": mesh} if isinstance(mesh, str) else mesh
    if isinstance(mesh, dict) and isinstance(mesh.get("path"), str):
        values["mesh"] = {**mesh, "path": str(path.parent / mesh["path"])}
    option_texts = [f"--set {text!r}" for text in settings]
    for text, option_text in zip(settings, option_texts, strict=True):
        values = _with_value(values, *_parse_assignment(text, option_text), option_text)
    return TomlTable(values, (), f"{path} with {', '.join(option_texts)}" if option_texts else str(path), [])


def _parse_assignment(text: str, option_text: str) -> tuple[KeyPath, object]:
    """Return the keys and the value in the text "KEY=VALUE"; KEY joins the keys of nested tables by dots.

    Args:
        text: the text, as the user gave it.
        option_text: the option with this text, for errors.
    """
    key_text, separator, value_text = text.partition("=")
    try:
        keys: KeyPath = ()
        nested: object = tomllib.loads(f"{key_text}{separator}0")
        while isinstance(nested, dict):
            ((key, nested),) = nested.items()
            keys = (*keys, key)
    except ValueError:
        raise DescriptionError(f"{option_text} cannot be read; give KEY=VALUE in TOML, such as layer.E=2e3") from None
    with suppress(ValueError):
        (value,) = tomllib.loads(f"value={value_text}").values()
        return keys, value
    return keys, value_text.strip()


def _with_value(container: object, keys: Sequence[str], value: object, option_text: str) -> Any:
    """Return a copy of a table or list in which one entry, perhaps in a nested table, has a new value.

    Args:
        container: the table or list.
        keys: keys of the nested tables (in a list the number of an entry, from 1), and last that of the entry.
        value: the new value.
        option_text: option of the command line with the new value, for errors.
    """
    if not keys:
        return value
    key, *inner_keys = keys
    if isinstance(container, list) and key in (item_numbers := [str(k) for k in range(1, len(container) + 1)]):
        k = item_numbers.index(key)
        return [*container[:k], _with_value(container[k], inner_keys, value, option_text), *container[k + 1 :]]
    if not isinstance(container, dict):
        raise DescriptionError(f"{option_text}: {_repr(container)} has no {key!r}; set the whole entry")
    return {**container, key: _with_value(container.get(key, {}), inner_keys, value, option_text)}


@dataclass(frozen=True)
class TomlTable:
    """A table of an input file in TOML.

    Attributes:
        values: its entries, key -> value.
        key_path: keys of the nested tables by which this table is reached from the whole file; () for the whole file.
        file_label: name of the file, and options of the command line that replaced entries; errors start with it.
        time_series: values that depend on time, read so far; one list for all tables of the file.
    """

    values: Mapping[str, Any]
    key_path: KeyPath
    file_label: str
    time_series: list[TimeSeries]

    def refuse(self, reason: str, *keys: str) -> NoReturn:
        """Raise a DescriptionError about this table or, with `keys`, about an entry in it or in a table nested in it.

        Args:
            reason: what is wrong.
            *keys: keys of the nested tables, and last that of the entry; none: the error is about this table.
        """
        raise DescriptionError(": ".join(filter(None, [self.file_label, ".".join((*self.key_path, *keys)), reason])))

    @contextmanager
    def locate_errors(self, *keys: str) -> Iterator[None]:
        """Context manager that turns an InputError into a DescriptionError about this table, or about an entry.

        Args:
            *keys: keys of nested tables, and last that of the entry; none: the error is about this table.
        """
        try:
            yield
        except DescriptionError:
            raise
        except InputError as error:
            self.refuse(str(error), *keys)

    def entries(self, keys: Keys, kind: str = "key") -> dict[str, Any]:
        """Read and check all entries of the table; return key -> value.

        Args:
            keys: the allowed and the required keys.
            kind: word for a key in errors, such as "component".

        Raises:
            DescriptionError: a key is not allowed, a required key is missing, or a value is wrong.
        """
        if unknown_keys := [key for key in self.values if key not in keys.readers]:
            self.refuse(unknown_name_message(kind, unknown_keys[0], keys.readers))
        if missing := [f"{key} is missing: {what}" for key, what in keys.hints.items() if key not in self.values]:
            self.refuse(missing[0])
        return {key: reader(self, key) for key, reader in keys.readers.items() if key in self.values}

    def checked(self, key: str, is_allowed: Callable[[Any], bool], error_text: str) -> Any:
        """Return the value at `key`, after a check of it.

        Args:
            key: key of the value.
            is_allowed: function of the value that returns whether it is allowed.
            error_text: text of the error, after the value, such as "is not a finite number".

        Raises:
            DescriptionError: the value is not allowed.
        """
        if not is_allowed(value := self.values[key]):
            self.refuse("it is not filled in" if "?" in str(value) else f"{_repr(value)} {error_text}", key)
        return value

    def number(self, key: str) -> float:
        """Return the finite number at `key`; raise DescriptionError if the value is anything else."""
        text = "is not a finite number"
        if isinstance(self.values[key], str):
            text += "; units are read in lengths, stresses, forces and times"
        return float(self.checked(key, is_finite, text))

    def vector(self, key: str) -> tuple[float, ...]:
        """Return the vector at `key`, 2 or 3 finite numbers; raise DescriptionError if the value is anything else."""
        wrong = "is not a vector; give 2 components, in 3D 3, such as [0, -50]"
        return tuple(map(float, self.checked(key, lambda value: _are_finite(value) and len(value) in (2, 3), wrong)))

    def text(self, key: str, allowed: Collection[str] = (), kind: str = "choice") -> str:
        """Return the text at `key`, which must not be empty.

        Args:
            key: key of the text.
            allowed: texts that are allowed; (): all are.
            kind: what the text is, for errors.

        Raises:
            DescriptionError: the value is no text, is empty, or is not allowed.
        """
        value = self.values[key]
        if not isinstance(value, str) or not value:
            self.refuse(f"{_repr(value)} is not a text" + (f"; allowed: {', '.join(allowed)}" if allowed else ""), key)
        if allowed and value not in allowed:
            self.refuse(unknown_name_message(kind, value, allowed), key)
        return value

    def texts(self, key: str) -> str | list[str]:
        """Return the text at `key`, or the list of texts; raise DescriptionError if the value is anything else."""
        value = self.values[key]
        is_list = isinstance(value, list) and value and all(isinstance(text, str) for text in value)
        return value if is_list else self.text(key)

    def table(self, key: str, content: str) -> TomlTable:
        """Return the table at `key` within this table, or an empty one if the key is missing.

        Args:
            key: key of the table.
            content: what the table contains, for errors.

        Raises:
            DescriptionError: the value is not a table.
        """
        return self.as_table(self.values.get(key, {}), content, key)

    def as_table(self, value: object, content: str, *keys: str) -> TomlTable:
        """Return a value within this table, or within a table nested in it, as a `TomlTable` with its place in the file.

        Args:
            value: the value, which must be a table.
            content: what the table contains, for errors.
            *keys: keys of nested tables, and last that of the value.

        Raises:
            DescriptionError: the value is not a table.
        """
        if not isinstance(value, Mapping):
            self.refuse(f"{_repr(value)} is not a table; it has {content}", *keys)
        return replace(self, values=value, key_path=(*self.key_path, *keys))

    def tables(self, key: str, content: str) -> list[TomlTable]:
        """Return the tables in the list at `key`, each as a `TomlTable`.

        Args:
            key: key of the list.
            content: what each table contains, for errors.

        Raises:
            DescriptionError: the value is not a list of tables.
        """
        wrong = f"is not a list of tables; each has {content}"
        tables = self.checked(key, lambda value: isinstance(value, list), wrong)
        return [self.as_table(table, content, key, str(number)) for number, table in enumerate(tables, 1)]


@dataclass(frozen=True)
class Reader:
    """Function that checks the value at a key of a table and returns it, with the JSON schema of such values.

    Attributes:
        read: function of the table and the key.
        schema: the schema, draft 7. It allows all values that the function accepts, and perhaps others.
    """

    read: Callable[[TomlTable, str], Any]
    schema: Schema

    def __call__(self, section: TomlTable, key: str) -> Any:
        """Return the checked value at `key` in the table `section`."""
        return self.read(section, key)


@dataclass(frozen=True)
class Keys:
    """Keys that a table of an input file may have.

    Attributes:
        readers: key -> reader of its value.
        hints: required key -> explanation, for errors.
    """

    readers: Mapping[str, Reader]
    hints: Mapping[str, str] = field(default_factory=dict)

    def schema(self, texts: Mapping[str, str] | None = None) -> Schema:
        """Return the JSON schema of such a table; editors show `texts`, descriptions of some of its keys."""
        descriptions = {key: {"description": text} for key, text in (texts or {}).items()}
        properties = {key: {**reader.schema, **descriptions.get(key, {})} for key, reader in self.readers.items()}
        return {"type": "object", "properties": properties, "required": [*self.hints], "additionalProperties": False}


def attribute_texts(cls: type) -> dict[str, str]:
    """Return the descriptions of attributes in the docstring of a class, by attribute."""
    section = cleandoc(cls.__doc__ or "").partition("\nAttributes:\n")[2].partition("\n\n")[0]
    texts = re.findall(r"^    (\w[\w, ]*): (.*(?:\n {8}.*)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for names, text in texts for name in names.split(", ")}


NUMBER = Reader(TomlTable.number, {"type": "number"})
VECTOR = Reader(TomlTable.vector, {"type": "array", "items": NUMBER.schema, "minItems": 2, "maxItems": 3})
TEXT = Reader(TomlTable.text, {"type": "string", "minLength": 1})
TEXTS = Reader(TomlTable.texts, {**TEXT.schema, "type": ["string", "array"], "items": TEXT.schema, "minItems": 1})


def types_of(schema: Schema) -> list[str]:
    """Return the types of values that a JSON schema allows; []: it names none."""
    types = schema.get("type", [])
    return [types] if isinstance(types, str) else types


def variants_schema(key: str, variants: Mapping[str, Schema], default: str) -> Schema:
    """Return the JSON schema of a table in which the value at one key says which other keys there are.

    Args:
        key: the key.
        variants: value at the key -> JSON schema of the table with its other keys.
        default: value that stands for a missing one; if it is not in `variants`, the key is required.
    """
    properties = {name: value for variant in variants.values() for name, value in variant["properties"].items()}
    schema: Schema = {}
    for name, variant in variants.items():  # nested, as Taplo completes no keys of a schema with "allOf"
        condition = {"properties": {key: {"const": name}}, "required": [key] if name != default else []}
        allowed = {**variant, "properties": dict.fromkeys([key, *variant["properties"]], True)}
        schema = {"if": condition, "then": allowed, "else": schema}
    required = [] if default in variants else [key]
    return {"type": "object", "properties": {**properties, key: {"enum": [*variants]}}, "required": required, **schema}


def names_reader(item_reader: Reader, content: str) -> Reader:
    """Return a reader of a table from any names to values; `content` says in errors what the table contains."""

    def read(section: TomlTable, key: str) -> dict[str, Any]:
        table = section.table(key, content)
        return {name: item_reader(table, name) for name in table.values}

    return Reader(read, {"type": "object", "additionalProperties": item_reader.schema})


def table_or_other_reader(table_reader: Reader, other_reader: Reader) -> Reader:
    """Return a reader that reads tables as the first reader does, and other values as the second one."""

    def read(section: TomlTable, key: str) -> Any:
        return (table_reader if isinstance(section.values[key], Mapping) else other_reader)(section, key)

    types = ["object", *types_of(other_reader.schema)]
    return Reader(read, {**table_reader.schema, **other_reader.schema, "type": types})


def choice_reader(*allowed: str) -> Reader:
    """Return a reader of a text that must be one of `allowed`."""
    return Reader(lambda section, key: section.text(key, allowed), {"enum": [*allowed]})


def positive_reader(what: str) -> Reader:
    """Return a reader of a number > 0; `what` says in errors what the number is."""

    def read(section: TomlTable, key: str) -> float:
        section.number(key)
        return float(section.checked(key, lambda number: number > 0, f"is not > 0; it is {what}"))

    return Reader(read, {**NUMBER.schema, "exclusiveMinimum": 0, "description": what})


def series_reader(read: Reader) -> Reader:
    """Return a reader of a value that may depend on time, in the form {times = [...], values = [...]}.

    The reader returns this form as a `TimeSeries`. It returns a constant value as `read` does.

    Args:
        read: reader of a constant value, and of each entry of "values".
    """
    what = "a time series is {times = [0, 1], values = [0, 5]}: two or more times that grow"
    items = {"times": NUMBER, "values": read}
    lists = {k: {"type": "array", "items": item.schema} for k, item in items.items()}
    readers = {k: Reader(lambda table, key: table.values[key], schema) for k, schema in lists.items()}
    keys = Keys(readers, dict.fromkeys(items, what))

    def read_value(section: TomlTable, key: str) -> object:
        entry = section.values[key]
        if not isinstance(entry, Mapping) or not readers.keys() & entry.keys():
            return read(section, key)
        times, values = section.table(key, what).entries(keys).values()
        if not (isinstance(values, list) and is_increasing(times) and len(times) == len(values) >= 2):
            section.refuse(what, key)
        table = section.as_table({str(k): value for k, value in enumerate(values, 1)}, what, key, "values")
        series = TimeSeries({float(t): read(table, str(k)) for k, t in enumerate(times, 1)}, (*section.key_path, key))
        section.time_series.append(series)
        return series

    return Reader(read_value, {"anyOf": [read.schema, keys.schema()]})


def is_increasing(times: object) -> TypeGuard[list[float]]:
    """Return whether `times` is a list of finite numbers, each larger than the one before."""
    return _are_finite(times) and all(a < b for a, b in itertools.pairwise(times))


def _are_finite(value: object) -> TypeGuard[list[float]]:
    return isinstance(value, list) and all(map(is_finite, value))


def _repr(value: object) -> str:
    """Return the text of a value for errors, nearly as in TOML, cut after some 60 characters."""
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) < 60 else f"{text[:56]} ..."
