"""What results were made from, as text and numbers that two runs can compare: data, laws, functions, what they refer to."""

from __future__ import annotations

import argparse
import builtins
import collections.abc
import copyreg
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
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import scipy.special
import ufl
from ufl.algorithms.signature import compute_expression_signature
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from thinlayer.errors import ModelError
from thinlayer.identity.sources import content
from thinlayer_base import PACKAGES

OPAQUE = ("basix", "dolfinx", "petsc4py", "ufl")  # objects of theirs differ from one process to the next
IMPORT = dis.opmap["IMPORT_NAME"]
FROM_DICT = ("LOAD_FROM_DICT_OR_GLOBALS", "LOAD_FROM_DICT_OR_DEREF")  # in the body of a class
VIEWS = (collections.abc.KeysView, collections.abc.ValuesView, collections.abc.ItemsView)
PROCESS = uuid.uuid4().hex[:8]
_ALONE: dict[int, Any] = {}  # what no other process knows, kept so that ids stay their own
FEW = 24  # numbers that are shown themselves; of more a digest is
MANY = 1000  # parts of a container that are told apart
AGAIN = "(see above)"  # of what refers to itself
CODE, SAME = "(code)", "(the same as)"  # of parts that stay as they are while a function runs
MISSING = object()
GENERATED = {"init", "repr", "eq", "lt", "le", "gt", "ge", "hash", "setattr", "delattr"}  # by dataclass itself
NAMESPACES = (types.SimpleNamespace, argparse.Namespace)
CACHED = type(functools.cache(len))
STREAMS = (sys.__stdin__, sys.__stdout__, sys.__stderr__)
HEAP = 1 << 9  # Python's flag of classes that were made by running code


class Brief(str):
    """A short text, and the parts that it stands for."""

    parts: Any


def digest(value: Any) -> str:
    """Twelve digits that stand for a value that JSON knows, or for bytes."""
    content = value if isinstance(value, bytes) else _text(value).encode()
    return hashlib.sha256(content).hexdigest()[:12]


def described(value: Any) -> Any:
    """A value as JSON that is the same in another process, on any number of ranks, if the value is.

    Numbers, texts, arrays and containers of them stand for themselves; the order of a dict or set does not count. Of
    dataclasses (laws) the parameters count and the code of the class; of functions the code, the defaults, the attributes,
    and what the code refers to, again and again where that is the user's own, stands in the same file or in none, and of
    others the values they close over. Of modules of the user's, and of namespaces, the names count that the code reads. Of
    other objects what they are copied from counts (`copyreg`, `__reduce_ex__`), of the user's and of callable ones the
    attributes but cached properties; the package's own say themselves what does (`identity`). Locks, standard streams and
    callable objects that a library's module has count by name. What has nothing of all this, such as an open file or a
    function on a mesh, is the same as itself alone: in another process it is another one.

    Not seen are the content of files, `sys.argv`, `os.environ`, and whatever else code asks of the world around it.

    Raises:
        ModelError: things that refer to one another in a chain too long to follow.
    """
    with _followed(_name(type(value))):
        return _Describer().of(value)


def in_full(value: Any) -> Any:
    """The same with all parts, none of them behind a digest: dicts and lists in one another. Errors as in `described`."""
    with _followed(_name(type(value))):
        return _expanded(_Describer(whole=True).of(value), {})


def referred(function: Any) -> dict[str, Any]:
    """The same of a function: name -> what its code refers to by it; "(code)" is the code itself."""
    found = in_full(function)
    return found if isinstance(found, dict) else {"(function)": found}


def differences(one: Any, other: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """Where two descriptions in full differ: names on the way there, and what either has, or `MISSING`."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            yield from differences(one.get(key, MISSING), other.get(key, MISSING), (*path, key))
    elif isinstance(one, list) and isinstance(other, list):
        for k, pair in enumerate(itertools.zip_longest(one, other, fillvalue=MISSING)):
            yield from differences(*pair, (*path, str(k)))
    elif one != other:
        yield path, one, other


def code_of(function: Any) -> str:
    """What stands for the code of a function and of all that it calls, without the values they refer to."""
    found: set[str] = set()
    seen: dict[int, Any] = {}
    waiting = [(function, "")]
    while waiting:
        value, home = waiting.pop()
        if id(value) in seen:
            continue
        seen[id(value)] = value
        inner = _function(value)
        further: list[Any] = []
        if isinstance(value, (dict, list, tuple)):
            further = [one for one in (value.values() if isinstance(value, dict) else value) if callable(one)]
        elif isinstance(value, types.MethodType):
            found.add(f"method {value.__func__.__qualname__}")
            further = [value.__func__, value.__self__]
        elif isinstance(value, functools.partial):
            further = [value.func, *value.args, *value.keywords.values()]
            given: dict[Any, Any] = {**dict(enumerate(value.args)), **value.keywords}
            found.add(_text({str(key): _plain(one) for key, one in given.items()}))  # what stays as it is
        elif inner is not None and _readable(inner, home):
            found.add(digest(_bytecode(inner)))
            home, read = inner.__module__, {*_read(inner.__code__)}
            for one in [*_values(inner).values(), *_imported(inner)]:
                own = isinstance(one, types.ModuleType) and _own(one)
                further += [each for name, each in vars(one).items() if name in read] if own else [one]
        elif inner is not None:
            found.add(_name(inner))
            further = [one for _, one in _closed_over(inner)]
        elif isinstance(value, type):
            found.add(_name(value))
            further = [one for kind in value.__mro__ if _readable(kind, home) for one in vars(kind).values()]
        elif isinstance(value, property):
            further = [value.fget]
        elif _readable(type(value), home) or callable(value):
            found.add(getattr(value, "__name__", ""))
            further = [type(value), *(one for one in _attributes(value).values() if callable(one))]
        waiting += [(one, home) for one in further]
    return digest(sorted(found))


class _Describer:
    """One description under way; it may remember the code of the package's classes from others."""

    def __init__(self, remembers: bool = True, whole: bool = False) -> None:
        self._remembers, self._whole = remembers, whole
        self._known: dict[Any, tuple[Any, Any]] = {}  # by id; the value is kept, so that its id stays its own
        self._alone: list[str] = []  # names of what no other process knows

    def of(self, value: Any, home: str = "") -> Any:
        """A value that stands in, or is referred to from, the module `home`."""
        kind = type(value)
        if value is None or kind in (str, bool):
            return value
        if kind in (int, float) or not (isinstance(value, (Real, str, bytes)) and _readable(kind, home)):
            plain = _plain(value)
            if plain is not None:
                return plain
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
            return self._code_of(value)
        content = self._content(value, home)
        if content is None:
            return self._object(value, home)
        kind = type(value)
        if not _readable(kind, home):
            return content
        return self._brief(
            kind.__qualname__,
            lambda: (
                {"(class)": self.of(kind, home), "(content)": content}
                | self._named(_attributes(value), kind.__module__)
            ),
        )

    def _content(self, value: Any, home: str) -> Any:
        """What is in a container, or in a number or text of a class of its own; None for anything else."""
        if isinstance(value, np.ma.MaskedArray):
            return [self._array(value.data), self._array(np.ma.getmaskarray(value))]
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, memoryview):
            return f"memoryview {value.format} {value.shape}, {digest(value.tobytes())}"
        if isinstance(value, (dict, Mapping)):
            content = self._named(value, home)
            if isinstance(value, collections.OrderedDict):  # whose order counts when it is compared, too
                content["(order)"] = [self._key(key, home) for key in value]
            if isinstance(value, collections.defaultdict):
                content["(default)"] = self.of(value.default_factory, home)
            return content
        if isinstance(value, (list, tuple, *VIEWS)):
            if len(value) > FEW and {*map(type, value)} == {float}:
                return f"{len(value)} numbers, {digest(np.array([*value]).tobytes())}"
            return [self.of(one, home) for one in value]
        if isinstance(value, (set, frozenset)):
            return {self._key(one, home): "in the set" for one in value}
        return _plain(value)

    def _named(self, values: Mapping[Any, Any], home: str) -> dict[str, Any]:
        """Key -> value, in an order that is the same in all processes: of what is met twice the first time counts."""
        entries = sorted(((self._key(key, home), one) for key, one in values.items()), key=lambda entry: entry[0])
        return {key: self.of(one, home) for key, one in entries}

    def _key(self, key: Any, home: str) -> str:
        return key if type(key) is str else f"<{_text(self.of(key, home))}>"

    def _brief(self, what: str, compute: Callable[[], Any]) -> str:
        """What something is called, a digest of its parts, and what in them no other process knows."""
        before = len(self._alone)
        parts = compute()
        alone = ", ".join(dict.fromkeys(self._alone[before:]))
        return self._with(
            parts, f"{what} {digest(parts)}" + f" with {alone}, which no other process knows" * bool(alone)
        )

    def _with(self, parts: Any, text: str) -> str:
        found = Brief(text)
        found.parts = parts if self._whole else None
        return found

    def _as_one(self, kind: type, compute: Callable[[], Any]) -> str:
        """What a library has made, whose parts are not told apart: it may change them all as it is used."""
        return str(self._brief(_name(kind), compute))

    def _only_here(self, value: Any) -> str:
        _ALONE[id(value)] = value
        self._alone.append(_name(type(value)))
        return f"{_name(type(value))}, which no other process knows ({PROCESS} {id(value)})"

    def module(self, module: types.ModuleType, names: frozenset[str] | None = None) -> Any:
        """A module; of the user's own those of its names, or all public ones."""
        if not _own(module):
            return f"module {module.__name__}"
        return self._of_names(module, module.__name__, names, lambda name: not name.startswith("_"))

    def _of_names(
        self, value: Any, home: str, names: frozenset[str] | None = None, public: Callable[[str], bool] = lambda _: True
    ) -> Any:
        """What has names and nothing else, by those of them that are read."""
        key = (id(value), names)
        if key not in self._known:
            self._known[key] = value, AGAIN
            content = {
                name: self.module(one, names) if isinstance(one, types.ModuleType) else self.of(one, home)
                for name, one in sorted(vars(value).items())
                if not name.startswith("__") and (name in names if names is not None else public(name))
            }
            kind = getattr(value, "__name__", _name(type(value)))
            self._known[key] = value, {"(kind)": kind, **content}
        return self._known[key][1]

    def _array(self, array: np.ndarray) -> Any:
        if array.dtype.kind not in "biuf":
            return [list(array.dtype.names or ()), list(array.shape), [self.of(one) for one in array.ravel().tolist()]]
        if array.size <= FEW and np.isfinite(array).all():
            return self.of(array.tolist())
        return f"{array.dtype.name} {array.shape}, {digest(np.ascontiguousarray(array).tobytes())}"

    def _object(self, value: Any, home: str) -> Any:
        if isinstance(value, types.MethodType):
            return {"(function)": self.of(value.__func__, home), "self": self.of(value.__self__, home)}
        if isinstance(value, functools.partial):
            parts = {"(function)": value.func, "(arguments)": value.args, **value.keywords}
            return {name: self.of(part, home) for name, part in parts.items()}
        function = _function(value)
        if function is not None:
            if not _readable(function, home):
                values, there = dict(_closed_over(function)), function.__module__
                name = _name(function)
                return self._brief(f"{name},", lambda: self._named(values, there)) if values else name
            return self._brief("function, code", lambda: self.parts(function))
        kind = type(value)
        if _ours(next((one.__module__ for one in kind.__mro__ if "identity" in vars(one)), None)):
            return self.of(value.identity())
        if dataclasses.is_dataclass(value):
            return self._parameters(value)
        if kind in NAMESPACES:
            return self._of_names(value, home)
        attributes = _attributes(value)
        if not _readable(kind, home):
            if not (callable(value) and attributes and kind.__module__.partition(".")[0] not in OPAQUE):
                return self._copied(value, home)
            return _place(value) or self._as_one(kind, lambda: self._named(attributes, kind.__module__))

        def consists_of() -> dict[str, Any]:
            found = {"(class)": self.of(kind, home), **self._named(attributes, kind.__module__)}
            if all(base is object or _readable(base, home) for base in kind.__mro__):
                return found
            return found | {"(copied from)": self._copied(value, home)}

        return self._brief(kind.__qualname__, consists_of)

    def _copied(self, value: Any, home: str) -> Any:
        """An object by what a copy of it is made from."""
        kind, top = type(value), type(value).__module__.partition(".")[0]
        if isinstance(value, ufl.core.expr.Expr) and all(
            isinstance(one, (ConstantValue, MultiIndex)) for one in traverse_unique_terminals(value)
        ):
            return (
                f"{_name(kind)}, {compute_expression_signature(value, {})[:12]}"  # free indices are numbered by process
            )
        if top == "mpi4py" or _name(kind) in ("_thread.lock", "_thread.RLock"):  # communicators and locks hold no data
            return _name(kind)
        if any(value is one for one in (*STREAMS, sys.stdin, sys.stdout, sys.stderr)):
            return "a standard stream"
        if _name(kind).startswith("scipy.spatial.") and kind.__name__ in ("cKDTree", "KDTree"):  # copied with what is
            return [_name(kind), self._array(value.data), value.leafsize]  # in memory by chance
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
            reduce = copyreg.dispatch_table.get(kind)
            parts = reduce(value) if reduce else value.__reduce_ex__(4)
            if isinstance(parts, str):
                return f"{_name(kind)} {parts}"
            shown = [list(one) if isinstance(one, Iterator) else one for one in parts]
            return self._as_one(kind, lambda: [self.of(one, home) for one in shown])
        except Exception:  # of whatever cannot be copied, or goes too deep
            return self._only_here(value)

    def _parameters(self, value: Any) -> str:
        """A dataclass as text."""
        kind = type(value)
        fields = {f.name: self.of(getattr(value, f.name), kind.__module__) for f in dataclasses.fields(value)}
        text = ", ".join(f"{name}={one if isinstance(one, str) else _text(one)}" for name, one in fields.items())
        code = self._code_of(kind)
        return self._with({"(class)": code, **fields}, f"{kind.__name__}({text}), {code.partition(', ')[2]}")

    # ---------------------------------------------------------------- code
    def parts(self, function: types.FunctionType) -> dict[str, Any]:
        """What a function does, and name -> what its code refers to."""
        home = function.__module__
        given = {
            "(defaults)": [function.__defaults__ or (), function.__kwdefaults__ or {}],
            "(attributes)": {name: one for name, one in vars(function).items() if name != "__wrapped__"},
        }
        shown = {CODE: digest(_bytecode(function))} | {n: self.of(one, home) for n, one in given.items() if any(one)}
        read = frozenset(_read(function.__code__))
        for name, value in _values(function).items():
            names = None if _passed_on(function.__code__, name) else read
            with _followed(name):
                if isinstance(value, types.ModuleType):
                    shown[name] = self.module(value, names)
                elif type(value) in NAMESPACES:
                    shown[name] = self._of_names(value, home, names)
                else:
                    shown[name] = self.of(value, home)
        return shown | {f"import {one.__name__}": self.module(one, read) for one in _imported(function)}

    def _code_of(self, kind: type) -> str:
        if self._remembers and _ours(kind.__module__):
            return f"{kind.__qualname__}, code {_code_of_ours(kind)}"
        return self._brief(f"{kind.__qualname__}, code", lambda: self.written(kind))

    def written(self, kind: type) -> Any:
        """What a class is written like, and those that it builds on in the same file or among the user's own."""
        shown: dict[str, Any] = {}
        for one in (*kind.__mro__, type(kind)):
            if not _readable(one, kind.__module__):
                shown[_name(one)] = "of a library"
                continue
            members = {name: self._member(name, value, one) for name, value in sorted(vars(one).items())}
            name = one.__qualname__ + "'" * sum(each.startswith(one.__qualname__) for each in shown)
            shown[name] = {name: value for name, value in members.items() if value is not None}
        return shown

    def _member(self, name: str, value: Any, kind: type) -> Any:
        home = kind.__module__
        if isinstance(value, property):
            return [self.of(f, home) for f in (value.fget, value.fset) if f is not None]
        function = _function(value)
        if function is not None:
            generated = "__dataclass_fields__" in vars(kind) and name.strip("_") in GENERATED
            return None if generated and function.__code__.co_filename == "<string>" else self.of(function, home)
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


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


@contextmanager
def _followed(name: str) -> Iterator[None]:
    """Says what refers to too long a chain of things."""
    try:
        yield
    except RecursionError:
        raise ModelError(
            f"{name} refers to things that refer to one another in a chain of hundreds, too long to tell whether another "
            "run has the same; hold them in a list"
        ) from None


def _plain(value: Any) -> Any:
    """A number or text, of whatever class, as JSON; None for anything else."""
    if isinstance(value, str):
        return str.__str__(value)
    if isinstance(value, Integral) and abs(int(value)) > 1 / sys.float_info.epsilon:
        return str(int(value))
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else str(float(value))  # NaN is not equal to itself
    if isinstance(value, (bytes, bytearray)):
        return f"bytes {digest(bytes(value))}"
    if isinstance(value, (complex, np.generic, PurePath)) and not isinstance(value, np.void):
        return str(value)
    return None


def _expanded(found: Any, seen: dict[int, str], path: str = "") -> Any:
    """A description with its parts; of what it meets again where it was met, of large containers a digest."""
    if isinstance(found, Brief) and found.parts is not None:
        if id(found) in seen:
            return {SAME: seen[id(found)]}
        seen[id(found)] = path
        return _expanded(found.parts, seen, path)
    if isinstance(found, (dict, list)) and len(found) > MANY:
        return f"{len(found)} parts, {digest(found)}"
    if isinstance(found, dict):
        return {key: _expanded(found[key], seen, f"{path}.{key}") for key in sorted(found)}
    if isinstance(found, list):
        return [_expanded(one, seen, f"{path}.{k}") for k, one in enumerate(found)]
    return found


def _bytecode(function: types.FunctionType) -> Any:
    """What a function's code does; comments, texts on what it does, names of files and lines do not count."""
    return _of_code(function.__code__, function.__doc__)


def _of_code(code: types.CodeType, doc: str | None = None) -> Any:
    constants = [c for k, c in enumerate(code.co_consts) if k or doc is None or c != doc]
    shown = [_of_code(c) if isinstance(c, types.CodeType) else _constant(c) for c in constants]
    return [code.co_code.hex(), shown, list(code.co_names), list(code.co_varnames), list(code.co_freevars)]


def _values(function: types.FunctionType) -> dict[str, Any]:
    """Name -> what a function's code refers to: values it closes over, and global ones."""
    found = dict(_closed_over(function))
    for name in sorted(set(_names(function.__code__)) - found.keys()):
        if name in function.__globals__:
            found[name] = function.__globals__[name]
    if _ours(function.__module__):  # what the package itself collects as it goes is no data
        return {name: value for name, value in found.items() if not isinstance(value, (dict, list, set))}
    return found


def _place(value: Any) -> str | None:
    """Where a module of a library has an object, such as the distributions of scipy.stats."""
    module = type(value).__module__
    names = (name for name, one in vars(sys.modules.get(module, types)).items() if one is value)
    return next((f"{module}.{name}" for name in names), None)


def _function(value: Any) -> types.FunctionType | None:
    """The Python function that something is or wraps: static methods and the like, and compiled ones."""
    while not isinstance(value, types.FunctionType):
        if isinstance(value, (staticmethod, classmethod)):
            value = value.__func__
        elif isinstance(value, functools.cached_property):
            value = value.func
        elif isinstance(value, CACHED):
            value = value.__wrapped__
        elif type(value).__module__.partition(".")[0] == "numba" and callable(value):
            value = getattr(value, "py_func", None) or getattr(value, "__wrapped__", None)
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
        and step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF", *FROM_DICT)
        and (after.opname not in ("LOAD_ATTR", "LOAD_METHOD") or after.argval == "__dict__")
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
    """Attributes of an object, but what it or a library computes from others when first asked."""
    kind = type(value)
    slots = [name for one in kind.__mro__ for name in vars(one).get("__slots__", ())]
    found = {name: getattr(value, name) for name in slots if hasattr(value, name)} | getattr(value, "__dict__", {})
    return {
        name: one
        for name, one in found.items()
        if not isinstance(getattr(kind, name, None), functools.cached_property)
        and not (name == "_ufunc" and kind is np.vectorize)
        and one is not np.random.mtrand._rand  # of scipy's distributions, where none is given
    }


def _ours(module: str | None) -> bool:
    return (module or "").partition(".")[0] in PACKAGES


def _readable(value: Any, home: str) -> bool:
    """Whether the code of a function or class counts: it stands in the module `home`, or is the user's own."""
    module = getattr(value, "__module__", None)
    if module in (None, "builtins"):  # Python's own, or code that is executed as a text
        if isinstance(value, types.FunctionType):
            return not _installed(Path(value.__code__.co_filename))
        made = bool(getattr(value, "__flags__", 0) & HEAP)
        return made and value is not getattr(builtins, value.__name__, None)
    return module in (home, "__main__") or not (_ours(module) or _of_a_library(module))


def _own(module: types.ModuleType) -> bool:
    """Whether a module is the user's own: from no library's folder, or from no file at all."""
    top = module.__name__.partition(".")[0]
    if top in PACKAGES:
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
