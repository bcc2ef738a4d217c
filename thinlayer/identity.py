"""What results were made from, as text and numbers that two runs can compare: data, laws, functions, what they refer to."""

from __future__ import annotations

import builtins
import collections.abc
import dataclasses
import dis
import functools
import hashlib
import importlib
import importlib.util
import itertools
import json
import math
import sys
import sysconfig
import types
import uuid
from collections.abc import Callable, Iterator, Mapping
from numbers import Real
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import scipy.special
import ufl
from ufl.algorithms.signature import compute_expression_signature
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from thinlayer.sources import content

OURS = ("forms", "geometry", "thinlayer")
OPAQUE = ("basix", "dolfinx", "petsc4py", "ufl")  # objects of theirs differ from one process to the next
IMPORT = dis.opmap["IMPORT_NAME"]
VIEWS = (collections.abc.KeysView, collections.abc.ValuesView, collections.abc.ItemsView)
PROCESS = uuid.uuid4().hex[:8]
_ALONE: dict[int, Any] = {}  # what no other process knows, kept so that ids stay their own
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
    user's own or stands in the same file, and of others the values they close over. Of modules of the user's the names
    count that the code reads. Of other objects what they are copied from counts (`__reduce_ex__`), of the user's and of
    callable ones the attributes; the package's own say themselves what does (`identity`). What has nothing of all this,
    such as an open file or a function on a mesh, is the same as itself alone: in another process it is another one.

    Not seen are the content of files, `sys.argv`, `os.environ`, and whatever else code asks of the world around it.
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
    """One description under way; it may remember the code of the package's classes from others."""

    def __init__(self, remembers: bool = True) -> None:
        self._remembers = remembers
        self._known: dict[Any, tuple[Any, Any]] = {}  # by id; the value is kept, so that its id stays its own
        self._alone: list[str] = []  # names of what no other process knows

    def of(self, value: Any, home: str = "") -> Any:
        """A value that stands in, or is referred to from, the module `home`."""
        if value is None or isinstance(value, (str, bool)):
            return value
        if isinstance(value, int) and abs(value) > 1 / sys.float_info.epsilon:
            return str(value)
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
        if isinstance(value, types.ModuleType):
            return self.module(value)
        if isinstance(value, type):
            if not _readable(value, home):
                return _name(value)
            return f"{value.__qualname__}, code {self._code_of(value)}"
        content = self._content(value, home)
        if content is None:
            return self._object(value, home)
        kind = type(value)
        return [self.of(kind, home), content, self.of(_attributes(value), home)] if _readable(kind, home) else content

    def _content(self, value: Any, home: str) -> Any:
        """What is in a container; None for anything else."""
        if isinstance(value, np.ma.MaskedArray):
            return [self._array(value.data), self._array(np.ma.getmaskarray(value))]
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, memoryview):
            return f"memoryview {value.format} {value.shape}, {digest(value.tobytes())}"
        if isinstance(value, Mapping):
            return {self._key(k, home): self.of(v, home) for k, v in value.items()}
        if isinstance(value, (list, tuple, *VIEWS)):
            return [self.of(one, home) for one in value]
        if isinstance(value, (set, frozenset)):
            return sorted((self.of(one, home) for one in value), key=json.dumps)
        return None

    def _key(self, key: Any, home: str) -> str:
        return str(key) if isinstance(key, (str, Real)) else json.dumps(self.of(key, home))

    def _hashed(self, compute: Callable[[], Any]) -> str:
        """A digest, and what in it no other process knows."""
        before = len(self._alone)
        found = digest(compute())
        alone = ", ".join(dict.fromkeys(self._alone[before:]))
        return f"{found} with {alone}, which no other process knows" if alone else found

    def _only_here(self, value: Any) -> str:
        _ALONE[id(value)] = value
        self._alone.append(_name(type(value)))
        return f"{_name(type(value))}, which no other process knows ({PROCESS} {id(value)})"

    def module(self, module: types.ModuleType, names: frozenset[str] | None = None) -> Any:
        """A module; of the user's own those of its names, or all public ones."""
        if not _own(module):
            return f"module {module.__name__}"
        key = (id(module), names)
        if key not in self._known:
            self._known[key] = module, AGAIN
            content = {
                name: self.module(one, names) if isinstance(one, types.ModuleType) else self.of(one, module.__name__)
                for name, one in sorted(vars(module).items())
                if not name.startswith("__") and (name in names if names is not None else not name.startswith("_"))
            }
            self._known[key] = module, {"module": module.__name__, "content": content}
        return self._known[key][1]

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
                values, there = dict(_closed_over(function)), function.__module__
                return (
                    f"{_name(function)}, {self._hashed(lambda: self.of(values, there))}" if values else _name(function)
                )
            return f"function, code {self._hashed(lambda: [self.code(function), self.references(function)])}"
        kind = type(value)
        if _ours(next((one.__module__ for one in kind.__mro__ if "identity" in vars(one)), None)):
            return self.of(value.identity())
        if dataclasses.is_dataclass(value):
            return self._parameters(value)
        attributes = _attributes(value)
        readable = _readable(kind, home)
        called = callable(value) and attributes and kind.__module__.partition(".")[0] not in OPAQUE
        if not (readable or called):
            return self._copied(value, home)
        shown = [self.of(kind, home), self.of(attributes, kind.__module__)]
        if readable and not all(base is object or _readable(base, home) for base in kind.__mro__):
            shown.append(self._copied(value, home))
        return shown

    def _copied(self, value: Any, home: str) -> Any:
        """An object by what a copy of it is made from."""
        kind, top = type(value), type(value).__module__.partition(".")[0]
        if isinstance(value, ufl.core.expr.Expr) and all(
            isinstance(one, (ConstantValue, MultiIndex)) for one in traverse_unique_terminals(value)
        ):
            return (
                f"{_name(kind)}, {compute_expression_signature(value, {})[:12]}"  # free indices are numbered by process
            )
        if top == "mpi4py":  # communicators hold no data
            return _name(kind)
        if isinstance(value, np.ufunc):
            known = value in (getattr(np, value.__name__, None), getattr(scipy.special, value.__name__, None))
            return f"ufunc {value.__name__}" if known else self._only_here(value)
        if isinstance(value, types.BuiltinFunctionType):
            name = f"{value.__module__}.{value.__qualname__}"
            owner = value.__self__
            return (
                name if owner is None or isinstance(owner, (type, types.ModuleType)) else [name, self.of(owner, home)]
            )
        if top in OPAQUE:
            return self._only_here(value)
        try:
            parts = value.__reduce_ex__(4)
            if isinstance(parts, str):
                return f"{_name(kind)} {parts}"
            shown = [list(one) if isinstance(one, Iterator) else one for one in parts]
            return [_name(kind), *(self.of(one, home) for one in shown)]
        except Exception:  # of whatever cannot be copied, or goes too deep
            return self._only_here(value)

    def _parameters(self, value: Any) -> str:
        """A dataclass as text."""
        kind = type(value)
        fields = {f.name: self.of(getattr(value, f.name), kind.__module__) for f in dataclasses.fields(value)}
        text = ", ".join(f"{name}={one if isinstance(one, str) else json.dumps(one)}" for name, one in fields.items())
        return f"{kind.__name__}({text}), code {self._code_of(kind)}"

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
        read = frozenset(_read(function.__code__))
        shown = {}
        for name, value in found.items():
            if isinstance(value, types.ModuleType):
                shown[name] = self.module(value, None if _passed_on(function.__code__, name) else read)
            else:
                shown[name] = self.of(value, home)
        return shown | {f"import {one.__name__}": self.module(one, read) for one in _imported(function)}

    def _code_of(self, kind: type) -> str:
        if self._remembers and _ours(kind.__module__):
            return _code_of_ours(kind)
        return self._hashed(lambda: self.written(kind))

    def written(self, kind: type) -> Any:
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
        if (
            name.startswith("__")
            or name == "_abc_impl"
            or isinstance(value, (types.MemberDescriptorType, types.GetSetDescriptorType))
        ):
            return None
        if name == "source" and isinstance(value, (str, Path)) and Path(value).is_file():  # the C file of a law
            return digest(content(Path(value)))
        return self.of(value, home)


@functools.cache
def _code_of_ours(kind: type) -> str:
    """The code of a class of the package, which stays as it is."""
    return digest(_Describer(remembers=False).written(kind))


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


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """A code and those of functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _names(code: types.CodeType) -> Iterator[str]:
    """Names that a code may look up, those in functions within it too."""
    for one in _codes(code):
        yield from one.co_names


def _read(code: types.CodeType) -> Iterator[str]:
    """Names that a code may read of a module, by a dot or as a text."""
    yield from _names(code)
    for one in _codes(code):
        for constant in one.co_consts:
            yield from (
                text for text in (constant if isinstance(constant, tuple) else (constant,)) if isinstance(text, str)
            )


def _steps(code: types.CodeType) -> list[dis.Instruction]:
    return [step for one in _codes(code) for step in dis.get_instructions(one) if step.opname != "EXTENDED_ARG"]


def _passed_on(code: types.CodeType, name: str) -> bool:
    """Whether a code does anything else with what a name stands for than to read what is behind a dot."""
    steps = _steps(code)
    return any(
        step.argval == name
        and step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF")
        and after.opname not in ("LOAD_ATTR", "LOAD_METHOD")
        for step, after in itertools.pairwise(steps)
    )


def _imported(function: types.FunctionType) -> list[types.ModuleType]:
    """The user's own modules that a function imports itself."""
    if not any(IMPORT in code.co_code[::2] for code in _codes(function.__code__)):
        return []
    steps, found = _steps(function.__code__), {}
    for k, step in enumerate(steps):
        if step.opname == "IMPORT_NAME":
            level, names = steps[k - 2].argval or 0, steps[k - 1].argval or ()
            try:
                name = "." * level + step.argval
                name = (
                    importlib.util.resolve_name(name, function.__globals__.get("__package__") or "") if level else name
                )
                if name not in sys.modules and _of_a_library(name.partition(".")[0]):
                    continue
                module = importlib.import_module(name)
                for one in names:
                    if one != "*" and not hasattr(module, one):
                        importlib.import_module(f"{name}.{one}")
            except Exception:  # the function itself will say so
                continue
            if _own(module):
                found[module.__name__] = module
    return list(found.values())


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
    if module in (home, "__main__"):  # code that is executed as a text may have Python's own module for a home
        return value is not getattr(builtins, getattr(value, "__name__", ""), None)
    return module is not None and not _ours(module) and not _of_a_library(module)


def _own(module: types.ModuleType) -> bool:
    """Whether a module is the user's own: from no library's folder, or from no file at all."""
    top = module.__name__.partition(".")[0]
    if top in OURS:
        return False
    place = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
    if place is not None:
        return not _installed(Path(place))
    package = sys.modules.get(top)
    return _own(package) if package not in (None, module) else top not in sys.stdlib_module_names


@functools.cache
def _of_a_library(module: str) -> bool:
    if module in sys.modules:
        file = getattr(sys.modules[module], "__file__", None)
    else:
        found = importlib.util.find_spec(module)
        file = found.origin if found is not None and found.has_location else None
    return file is None or _installed(Path(file))


def _installed(path: Path) -> bool:
    installed = {"site-packages", "dist-packages"} & set(path.parts)
    return bool(installed) or path.is_relative_to(sysconfig.get_path("stdlib"))
