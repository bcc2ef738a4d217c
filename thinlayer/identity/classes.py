"""Descriptions of classes: their methods and values, and those of their base classes."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

from thinlayer.identity.functions import function_of
from thinlayer.identity.owners import is_readable
from thinlayer.identity.sources import content
from thinlayer.identity.values import digest, name_of

Of = Callable[[Any, str], Any]  # value, module that it is met in -> description
GENERATED = {
    "init",
    "repr",
    "eq",
    "lt",
    "le",
    "gt",
    "ge",
    "hash",
    "setattr",
    "delattr",
}  # methods that dataclass generates


def written(kind: type, of: Of) -> Any:
    """Description of a class and of its base classes in the same file or in the user's own code."""
    shown: dict[str, Any] = {}
    for one in (*kind.__mro__, type(kind)):
        if not is_readable(one, kind.__module__):
            shown[name_of(one)] = "of a library"
            continue
        members = {name: _member(name, value, one, of) for name, value in sorted(vars(one).items())}
        name = one.__qualname__ + "'" * sum(each.startswith(one.__qualname__) for each in shown)
        shown[name] = {name: value for name, value in members.items() if value is not None}
    return shown


def _member(name: str, value: Any, kind: type, of: Of) -> Any:
    home = kind.__module__
    if isinstance(value, property):
        return [of(f, home) for f in (value.fget, value.fset) if f is not None]
    function = function_of(value)
    if function is not None:
        generated = "__dataclass_fields__" in vars(kind) and name.strip("_") in GENERATED
        return None if generated and function.__code__.co_filename == "<string>" else of(function, home)
    if (
        name.startswith("__")
        or name == "_abc_impl"
        or isinstance(value, (types.MemberDescriptorType, types.GetSetDescriptorType))
    ):
        return None
    if name == "source" and isinstance(value, (str, Path)) and Path(value).is_file():  # the C file of a law
        return digest(content(Path(value)))
    return of(value, home)
