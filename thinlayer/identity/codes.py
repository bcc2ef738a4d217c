"""Hashes of the code of functions, without data."""

from __future__ import annotations

import functools
import types
from typing import Any

from thinlayer.identity.functions import bytecode, closed_over, function_of, imported, names_read, referred_to
from thinlayer.identity.owners import is_own, is_readable
from thinlayer.identity.values import attributes, digest, name_of, plain, text_of


def code_of(function: Any) -> str:
    """Hash of the code of a function and of all functions that it calls, without the values they refer to."""
    found: set[str] = set()
    seen: dict[int, Any] = {}
    waiting = [(function, "")]
    while waiting:
        value, home = waiting.pop()
        if id(value) in seen:
            continue
        seen[id(value)] = value
        inner = function_of(value)
        further: list[Any] = []
        if isinstance(value, (dict, list, tuple)):
            further = [one for one in (value.values() if isinstance(value, dict) else value) if callable(one)]
        elif isinstance(value, types.MethodType):
            found.add(f"method {value.__func__.__qualname__}")
            further = [value.__func__, value.__self__]
        elif isinstance(value, functools.partial):
            further = [value.func, *value.args, *value.keywords.values()]
            given: dict[Any, Any] = {**dict(enumerate(value.args)), **value.keywords}
            found.add(text_of({str(key): plain(one) for key, one in given.items()}))  # what stays as it is
        elif inner is not None and is_readable(inner, home):
            found.add(digest(bytecode(inner)))
            home, read = inner.__module__, {*names_read(inner.__code__)}
            for one in [*referred_to(inner).values(), *imported(inner)]:
                own = isinstance(one, types.ModuleType) and is_own(one)
                further += [each for name, each in vars(one).items() if name in read] if own else [one]
        elif inner is not None:
            found.add(name_of(inner))
            further = [one for _, one in closed_over(inner)]
        elif isinstance(value, type):
            found.add(name_of(value))
            further = [one for kind in value.__mro__ if is_readable(kind, home) for one in vars(kind).values()]
        elif isinstance(value, property):
            further = [value.fget]
        elif is_readable(type(value), home) or callable(value):
            found.add(getattr(value, "__name__", ""))
            further = [type(value), *(one for one in attributes(value).values() if callable(one))]
        waiting += [(one, home) for one in further]
    return digest(sorted(found))
