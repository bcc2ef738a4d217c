"""Describer: describes data, laws and functions, and the objects they refer to."""

from __future__ import annotations

import argparse
import copyreg
import dataclasses
import functools
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any

import numpy as np

from thinlayer.errors import ModelError
from thinlayer.identity.classes import written
from thinlayer.identity.containers import Containers
from thinlayer.identity.functions import (
    bytecode,
    calls,
    closed_over,
    function_of,
    imported,
    names_read,
    passed_on,
    referred_to,
)
from thinlayer.identity.known import GOES_ON, OPAQUE, known_as
from thinlayer.identity.owners import is_ours, is_own, is_readable
from thinlayer.identity.values import attributes, digest, name_of, place_of, plain, text_of

NAMESPACES = (types.SimpleNamespace, argparse.Namespace)
AGAIN = "(see above)"  # description of an object inside itself
CODE, SAME = "(code)", "(the same as)"  # parts that do not change while a function runs


class Describer(Containers):
    """One description; it may reuse the code of the package's classes from earlier ones."""

    def __init__(self, remembers: bool = True, whole: bool = False) -> None:
        super().__init__(whole)
        self._remembers = remembers
        self.random: list[str] = []  # states of the generators of random numbers and iterators that it has met
        self.seeds = False  # whether code that it has met seeds a generator
        self._known: dict[Any, tuple[Any, Any]] = {}  # by id; the value is kept, so that its id stays its own

    def of(self, value: Any, home: str = "") -> Any:
        """A value that stands in, or is referred to from, the module `home`."""
        kind = type(value)
        if value is None or kind in (str, bool):
            return value
        if kind in (int, float) or not (isinstance(value, (Real, str, bytes)) and is_readable(kind, home)):
            text = plain(value)
            if text is not None:
                return text
        if id(value) not in self._known:
            self._known[id(value)] = value, AGAIN
            self._known[id(value)] = value, self._composed(value, home)
        return self._known[id(value)][1]

    def _composed(self, value: Any, home: str) -> Any:
        if isinstance(value, types.ModuleType):
            return self.module(value)
        if isinstance(value, type):
            if not is_readable(value, home):
                return name_of(value)
            return self._code_of(value)
        content = self.content(value, home)
        if content is None:
            return self._object(value, home)
        kind = type(value)
        if not is_readable(kind, home):
            return content
        return self.brief(
            kind.__qualname__,
            lambda: (
                {"(class)": self.of(kind, home), "(content)": content} | self.named(attributes(value), kind.__module__)
            ),
        )

    def module(self, module: types.ModuleType, names: frozenset[str] | None = None) -> Any:
        """A module; for the user's own modules with the given names, or all public ones."""
        if not is_own(module):
            return f"module {module.__name__}"
        return self._of_names(module, module.__name__, names, lambda name: not name.startswith("_"))

    def _of_names(
        self, value: Any, home: str, names: frozenset[str] | None = None, public: Callable[[str], bool] = lambda _: True
    ) -> Any:
        """A namespace, by the names that are read."""
        key = (id(value), names)
        if key not in self._known:
            self._known[key] = value, AGAIN
            content = {
                name: self.module(one, names) if isinstance(one, types.ModuleType) else self.of(one, home)
                for name, one in sorted(vars(value).items())
                if not name.startswith("__") and (name in names if names is not None else public(name))
            }
            kind = getattr(value, "__name__", name_of(type(value)))
            self._known[key] = value, {"(kind)": kind, **content}
        return self._known[key][1]

    def _object(self, value: Any, home: str) -> Any:
        if isinstance(value, types.MethodType):
            return {"(function)": self.of(value.__func__, home), "self": self.of(value.__self__, home)}
        if isinstance(value, functools.partial):
            parts = {"(function)": value.func, "(arguments)": value.args, **value.keywords}
            return {name: self.of(part, home) for name, part in parts.items()}
        function = function_of(value)
        if function is not None:
            if not is_readable(function, home):
                values, there = dict(closed_over(function)), function.__module__
                name = name_of(function)
                return self.brief(f"{name},", lambda: self.named(values, there)) if values else name
            return self.brief("function, code", lambda: self.parts(function))
        kind = type(value)
        if is_ours(next((one.__module__ for one in kind.__mro__ if "identity" in vars(one)), None)):
            return self.of(value.identity())
        if dataclasses.is_dataclass(value):
            return self._parameters(value)
        if kind in NAMESPACES:
            return self._of_names(value, home)
        held = attributes(value)
        if not is_readable(kind, home):
            if not (callable(value) and held and kind.__module__.partition(".")[0] not in OPAQUE):
                return self._copied(value, home)
            return place_of(value) or self.as_one(kind, lambda: self.named(held, kind.__module__))

        def consists_of() -> dict[str, Any]:
            found = {"(class)": self.of(kind, home), **self.named(held, kind.__module__)}
            if all(base is object or is_readable(base, home) for base in kind.__mro__):
                return found
            return found | {"(copied from)": self._copied(value, home)}

        return self.brief(kind.__qualname__, consists_of)

    def _copied(self, value: Any, home: str) -> Any:
        """An object, by the data that a copy of it is made from."""
        kind, top = type(value), type(value).__module__.partition(".")[0]
        known = known_as(value)
        if known is not None:
            return known
        if name_of(kind).startswith("scipy.spatial.") and kind.__name__ in ("cKDTree", "KDTree"):  # copied with what is
            return [name_of(kind), self.array(value.data), value.leafsize]  # in memory by chance
        if isinstance(value, types.BuiltinFunctionType):
            return [f"{value.__module__}.{value.__qualname__}", self.of(value.__self__, home)]
        if top in OPAQUE or isinstance(value, np.ufunc):
            return self.only_here(value)
        try:
            reduce = copyreg.dispatch_table.get(kind)
            parts = reduce(value) if reduce else value.__reduce_ex__(4)
            if isinstance(parts, str):
                return f"{name_of(kind)} {parts}"
            shown = [list(one) if isinstance(one, Iterator) else one for one in parts]
            found = self.as_one(kind, lambda: [self.of(one, home) for one in shown])
        except Exception:  # the object cannot be copied, or is nested too deeply
            return self.only_here(value)
        if isinstance(value, GOES_ON) or any(one.__name__ == "QMCEngine" for one in kind.__mro__):  # of scipy.stats
            self.random.append(found)
        return found

    def _parameters(self, value: Any) -> str:
        """A dataclass as text."""
        kind = type(value)
        fields = {f.name: self.of(getattr(value, f.name), kind.__module__) for f in dataclasses.fields(value)}
        text = ", ".join(f"{name}={one if isinstance(one, str) else text_of(one)}" for name, one in fields.items())
        code = self._code_of(kind)
        return self.with_parts({"(class)": code, **fields}, f"{kind.__name__}({text}), {code.partition(', ')[2]}")

    # ---------------------------------------------------------------- code
    def parts(self, function: types.FunctionType) -> dict[str, Any]:
        """Code of a function, and name -> object that it refers to."""
        home = function.__module__
        given = {
            "(defaults)": [function.__defaults__ or (), function.__kwdefaults__ or {}],
            "(attributes)": {name: one for name, one in vars(function).items() if name != "__wrapped__"},
        }
        shown = {CODE: digest(bytecode(function))} | {n: self.of(one, home) for n, one in given.items() if any(one)}
        read = frozenset(names_read(function.__code__))
        self.seeds |= calls(function.__code__, "seed")
        for name, value in referred_to(function).items():
            names = None if passed_on(function.__code__, name) else read
            with followed(name):
                if isinstance(value, types.ModuleType):
                    shown[name] = self.module(value, names)
                elif type(value) in NAMESPACES:
                    shown[name] = self._of_names(value, home, names)
                else:
                    shown[name] = self.of(value, home)
        return shown | {f"import {one.__name__}": self.module(one, read) for one in imported(function)}

    def _code_of(self, kind: type) -> str:
        if self._remembers and is_ours(kind.__module__):
            return f"{kind.__qualname__}, code {_code_of_ours(kind)}"
        return self.brief(f"{kind.__qualname__}, code", lambda: written(kind, self.of))


@functools.cache
def _code_of_ours(kind: type) -> str:
    """The code of a class of the package, cached because it does not change."""
    return digest(written(kind, Describer(remembers=False).of))


@contextmanager
def followed(name: str) -> Iterator[None]:
    """Raise ModelError with this name if a chain of references is too long."""
    try:
        yield
    except RecursionError:
        raise ModelError(
            f"{name} refers to things that refer to one another in a chain of hundreds, too long to tell whether another "
            "run has the same; hold them in a list"
        ) from None
