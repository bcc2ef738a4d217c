"""What results were made from, as text and numbers that two runs can compare: data, laws, functions, what they refer to."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import sys
import sysconfig
import types
from collections.abc import Iterator, Mapping
from numbers import Real
from pathlib import Path, PurePath
from typing import Any

import numpy as np

OURS = ("forms", "geometry", "thinlayer")
OPAQUE = ("basix", "dolfinx", "petsc4py", "ufl")  # objects of theirs differ from one process to the next
FEW = 24  # numbers of an array that are shown themselves
AGAIN = "(see above)"  # of what refers to itself


def digest(value: Any) -> str:
    """Twelve digits that stand for a value that JSON knows, or for bytes."""
    content = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:12]


def described(value: Any) -> Any:
    """A value as JSON that is the same in another process, on any number of ranks, if the value is.

    Numbers, texts, arrays and containers of them stand for themselves. Of dataclasses (laws) the parameters count and the
    code of the class; of functions the code, the defaults, and what the code refers to, again and again where that is the
    user's own or stands in the same file, and of others the values they close over. Of callable objects their attributes
    count; objects with a method `identity` say themselves what does. Of anything else only the name counts.
    """
    return _Describer().of(value)


def referred(function: Any) -> dict[str, Any]:
    """The same of a function, by what it consists of: its "code", and the names that the code refers to."""
    describer = _Describer()
    if not isinstance(function, types.FunctionType):
        return {"function": describer.of(function)}
    return {"code": digest(describer.code(function)), **describer.references(function)}


def code_of(function: Any) -> Any:
    """Of a function its code alone, without the values it refers to."""
    return (
        digest(_Describer().code(function)) if isinstance(function, types.FunctionType) else described(type(function))
    )


class _Describer:
    """One description under way."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Any, Any]] = {}  # by id; the value is kept, so that its id stays its own

    def of(self, value: Any, home: str = "") -> Any:
        """A value that stands in, or is referred to from, the module `home`."""
        if value is None or isinstance(value, (str, bool)):
            return value
        if isinstance(value, Real):
            return float(value) if math.isfinite(value) else str(float(value))  # NaN is not equal to itself
        if isinstance(value, (bytes, bytearray)):
            return f"bytes {digest(bytes(value))}"
        if isinstance(value, (complex, np.generic, PurePath)):
            return str(value)
        if id(value) not in self._known:
            self._known[id(value)] = value, AGAIN
            self._known[id(value)] = value, self._composed(value, home)
        return self._known[id(value)][1]

    def _composed(self, value: Any, home: str) -> Any:
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, Mapping):
            return {str(k): self.of(v, home) for k, v in value.items()}
        if isinstance(value, (list, tuple)):
            return [self.of(one, home) for one in value]
        if isinstance(value, (set, frozenset)):
            return sorted((self.of(one, home) for one in value), key=json.dumps)
        if isinstance(value, types.ModuleType):
            return f"module {value.__name__}"
        if isinstance(value, type):
            return (
                f"{value.__qualname__}, code {digest(self._class(value))}" if _readable(value, home) else _name(value)
            )
        return self._object(value, home)

    def _array(self, array: np.ndarray) -> Any:
        if array.dtype.kind not in "biuf":
            return [self.of(one) for one in array.ravel().tolist()]
        if array.size <= FEW and np.isfinite(array).all():
            return array.astype(float).tolist()
        return f"{array.dtype.name} {array.shape}, {digest(np.ascontiguousarray(array).tobytes())}"

    def _object(self, value: Any, home: str) -> Any:
        if isinstance(value, types.MethodType):
            return [self.of(value.__func__, home), self.of(value.__self__, home)]
        if isinstance(value, functools.partial):
            return [self.of(part, home) for part in (value.func, value.args, value.keywords)]
        function = _function(value)
        if function is not None:
            if not _readable(function, home):
                values = {name: self.of(one, function.__module__) for name, one in _closed_over(function)}
                return f"{_name(function)}, {digest(values)}" if values else _name(function)
            return f"function, code {digest([self.code(function), self.references(function)])}"
        kind = type(value)
        if callable(getattr(kind, "identity", None)):
            return self.of(value.identity())
        if dataclasses.is_dataclass(value):
            return self._parameters(value)
        if _readable(kind, home) or (callable(value) and kind.__module__.partition(".")[0] not in OPAQUE):
            return [self.of(kind, home), self.of(_attributes(value), kind.__module__)]
        return _name(kind)

    def _parameters(self, value: Any) -> str:
        """A dataclass as text."""
        kind = type(value)
        fields = {f.name: self.of(getattr(value, f.name), kind.__module__) for f in dataclasses.fields(value)}
        text = ", ".join(f"{name}={one if isinstance(one, str) else json.dumps(one)}" for name, one in fields.items())
        return f"{kind.__name__}({text}), code {digest(self._class(kind))}"

    # ---------------------------------------------------------------- code
    def code(self, function: types.FunctionType) -> Any:
        """What a function does, whatever it refers to; comments, names of files and lines do not count."""
        code, home = function.__code__, function.__module__
        defaults = [self.of(one, home) for one in function.__defaults__ or ()]
        return [self._bytecode(code, function.__doc__), defaults, self.of(function.__kwdefaults__ or {}, home)]

    def _bytecode(self, code: types.CodeType, doc: str | None = None) -> Any:
        constants = [c for k, c in enumerate(code.co_consts) if k or doc is None or c != doc]
        shown = [self._bytecode(c) if isinstance(c, types.CodeType) else _constant(c) for c in constants]
        return [code.co_code.hex(), shown, list(code.co_names), list(code.co_varnames), list(code.co_freevars)]

    def references(self, function: types.FunctionType) -> dict[str, Any]:
        """Name -> what a function's code refers to: values it closes over, and global ones."""
        found = dict(_closed_over(function))
        for name in sorted(set(_names(function.__code__)) - found.keys()):
            if name in function.__globals__:
                found[name] = function.__globals__[name]
        home = function.__module__
        if _ours(home):  # what the package itself collects as it goes is no data
            found = {name: value for name, value in found.items() if not isinstance(value, (dict, list, set))}
        return {name: self.of(value, home) for name, value in found.items()}

    def _class(self, kind: type) -> Any:
        """What a class is written like, and those that it builds on in the same file or among the user's own."""
        shown: list[Any] = []
        for one in kind.__mro__:
            if not _readable(one, kind.__module__):
                shown.append([_name(one)])
                continue
            members = {name: self._member(name, value, one.__module__) for name, value in sorted(vars(one).items())}
            shown.append([one.__name__, {name: value for name, value in members.items() if value is not None}])
        return shown

    def _member(self, name: str, value: Any, home: str) -> Any:
        if isinstance(value, property):
            return [self.of(f, home) for f in (value.fget, value.fset) if f is not None]
        function = _function(value)
        if function is not None:
            generated = function.__code__.co_filename == "<string>"  # by dataclass, from what the fields say
            return None if generated else self.of(function, home)
        if name.startswith("__") or isinstance(value, (types.MemberDescriptorType, types.GetSetDescriptorType)):
            return None
        if name == "source" and isinstance(value, (str, Path)) and Path(value).is_file():  # the C file of a law
            return digest(Path(value).read_bytes())
        return self.of(value, home)


def _function(value: Any) -> types.FunctionType | None:
    """The Python function that something is or wraps, as static methods, decorators and compilers do."""
    while not isinstance(value, types.FunctionType):
        if isinstance(value, (staticmethod, classmethod)):
            value = value.__func__
        elif isinstance(value, functools.cached_property):
            value = value.func
        elif not isinstance(value, type) and callable(value):
            value = getattr(value, "__wrapped__", None) or getattr(value, "py_func", None)
        else:
            return None
    return value


def _closed_over(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:  # not assigned yet
            continue


def _names(code: types.CodeType) -> Iterator[str]:
    """Names that a code may look up, those in functions within it too."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def _constant(value: Any) -> str:
    return repr(sorted(value, key=repr)) if isinstance(value, frozenset) else repr(value)


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _attributes(value: Any) -> dict[str, Any]:
    slots = [name for kind in type(value).__mro__ for name in vars(kind).get("__slots__", ())]
    return {name: getattr(value, name) for name in slots if hasattr(value, name)} | getattr(value, "__dict__", {})


def _ours(module: str | None) -> bool:
    return (module or "").partition(".")[0] in OURS


def _readable(value: Any, home: str) -> bool:
    """Whether the code of a function or class counts: it stands in the module `home`, or is the user's own."""
    module = getattr(value, "__module__", None)
    if module == home or module == "__main__":
        return True
    return module is not None and not _ours(module) and not _of_a_library(module)


@functools.cache
def _of_a_library(module: str) -> bool:
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        return True
    path = Path(file)
    installed = {"site-packages", "dist-packages"} & set(path.parts)
    return bool(installed) or path.is_relative_to(sysconfig.get_path("stdlib"))
