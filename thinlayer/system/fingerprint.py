"""Descriptions of the data and functions that a run depends on, as nested JSON data that two runs can compare.

A run may continue an earlier run only if both have the same description: the same numbers, and unchanged files of the
user's functions. Otherwise an error names the differences.
"""

from __future__ import annotations

import copyreg
import dataclasses
import functools
import hashlib
import itertools
import json
import math
import random
import re
import sys
import sysconfig
import types
import uuid
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal

import numpy as np
import ufl
from ufl.algorithms.signature import compute_expression_signature
from ufl.domain import extract_domains

from forms.base import PACKAGES, require

Resume = bool | Literal["anyway"]
Difference = tuple[tuple[str, ...], object, object]  # path of names, and both values there or `MISSING_VALUE`
CODE_KEY, FILE_KEY, CLASS_KEY, SAME_KEY = "(code)", "(file)", "(class)", "(same as)"
MISSING_VALUE = object()  # placeholder for a value that one of two descriptions lacks
MAX_SHOWN_ENTRIES = 24  # number of entries up to which arrays are shown; larger arrays are hashed
MAX_CHANGES = 4  # number of differences that a message names
LIBRARY_FOLDERS = [Path(sysconfig.get_path("stdlib")), *(Path(__file__).parents[2] / name for name in PACKAGES)]
OPAQUE_PACKAGES = ("basix", "dolfinx", "petsc4py", "ufl")  # packages whose objects differ from one process to the next
PROCESS_LABEL = f", known to process {uuid.uuid4().hex[:8]} alone"
TYPES_WITHOUT_IDENTITY = (dict, types.MappingProxyType, list, tuple, set, frozenset, np.ndarray, types.ModuleType)
GENERATOR_TYPES = (  # types whose objects give other values each time
    np.random.Generator, np.random.BitGenerator, np.random.RandomState, np.random.SeedSequence, random.Random, Iterator,
)  # fmt: skip
_OBJECT_COUNTER = itertools.count(1)
# id of an object that only this process knows -> reference to it, and its number
_OBJECT_NUMBERS: dict[int, tuple[Callable[[], object], int]] = {}
INCLUDED_FILE_REGEX = re.compile(rb'^[ \t]*#[^"<\n]*["<]([^">\n]+)[">]', re.MULTILINE)  # file in a preprocessor line


def describe(value: object) -> object:
    """Return a description of a value as nested JSON data; equal values have the same description in every process.

    - Numbers, texts, arrays and containers are described by their entries, whatever the order of a dict.
    - Dataclasses are described by their fields, other objects by the data that `copy` would make a copy from. Classes
      of this package may define a method `identity`, whose result describes their objects instead.
    - Users' functions are described by their bytecode, the hash of their file, and the values that they read. These are
      closure variables, defaults, attributes and globals.
    - Users' classes are described by their functions and files, users' modules by their files.
    - Functions, classes and modules of libraries are described by their names.
    - Any other object, such as an open file or a function on a mesh, has a description that no object of another
      process has.

    The description does not cover files that a run reads, modules that a function itself imports, `sys.argv` and
    `os.environ`.
    """
    return _Describer().describe(value)


def code_part(description: object, *, is_code: bool = True) -> object:
    """Return the part of a description that stays the same while functions run: their code, and constants in them.

    Numbers and texts in lists or objects are left out, since functions may collect values there.

    Args:
        description: what `describe` returns, or a part of it.
        is_code: whether numbers and texts in this part are kept, as it belongs directly to a function.
    """
    if isinstance(description, dict):
        parts = {key: code_part(value, is_code=CODE_KEY in description) for key, value in description.items()}
        return {key: part for key, part in parts.items() if part not in (None, {}, [])}
    if isinstance(description, list):
        return [item for item in (code_part(item, is_code=False) for item in description) if item not in (None, {}, [])]
    return description if is_code and PROCESS_LABEL not in str(description) else None


def random_states(value: object) -> tuple[list[object], list[object]]:
    """Return the states of random number generators and iterators to which a value refers, and of the global ones.

    The global generators are those of `random` and `numpy.random`. Their states are left out if a function of the value
    uses the name "seed".
    """
    describer = _Describer()
    describer.describe(value)
    functions = () if "seed" in describer.used_names else (random.getstate, np.random.get_state)
    return describer.random, [digest(repr(get_state()).encode()) for get_state in functions]


def differences(value: object, other: object, path: tuple[str, ...] = ()) -> Iterator[Difference]:
    """Yield the differences between two descriptions: for each, the keys that lead to it, and the two values there.

    Where only one description has a value, the other value is `MISSING_VALUE`.

    Args:
        value, other: the descriptions, or parts of them.
        path: keys that lead from the whole descriptions to these parts.
    """
    if isinstance(value, list) and isinstance(other, list):
        value, other = ({f"{k}": entry for k, entry in enumerate(values)} for values in (value, other))
    if isinstance(value, dict) and isinstance(other, dict):
        for key in sorted(value.keys() | other.keys()):
            yield from differences(value.get(key, MISSING_VALUE), other.get(key, MISSING_VALUE), (*path, key))
    elif value != other:
        yield path, value, other


def differences_text(changes: list[Difference]) -> str:
    """Return a text that names at most four differences between the descriptions of an earlier run and of this one.

    Differences with the same two values are named once.

    Args:
        changes: the differences: keys that lead to each, and both values, that of the earlier run first.
    """
    paths = {(_short_text(value), _short_text(other)): ".".join(path) for path, value, other in reversed(changes)}
    texts = [f"{path}: {value} there, {other} here" for (value, other), path in reversed(paths.items())]
    return "; ".join(texts[:MAX_CHANGES]) + f"; and {len(texts) - MAX_CHANGES} more" * (len(texts) > MAX_CHANGES)


def _short_text(value: object) -> str:
    text = "nothing" if value is MISSING_VALUE else value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 200 else f"{text[:200]} ..."


def require_resume(resume: object) -> None:
    """Check that `resume` is True, False or "anyway"; raise InputError otherwise."""
    is_allowed = isinstance(resume, bool) or (isinstance(resume, str) and resume == "anyway")
    require(is_allowed, "resume", resume, "allowed: True, False, and 'anyway' for a run that may be another one")


def digest(value: object) -> str:
    """Return a hash of a JSON value or of bytes, as a text of twelve hexadecimal digits."""
    content = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:12]


class _Describer:
    """Worker behind `describe`, which describes one value and all values within it.

    Attributes:
        random: states of the random number generators and iterators found so far.
        used_names: names of globals and attributes that occur in the code of functions found so far.
    """

    def __init__(self) -> None:
        self.random: list[object] = []
        self.used_names: set[str] = set()
        # id -> path of first place; value, so that its id stays in use
        self._first_places: dict[int, tuple[str, object]] = {}

    def describe(self, value: object, at: str = "") -> object:
        """Return the description of a value.

        If the same object occurs again, its description is only a reference to the place where it occurred first.

        Args:
            value: the value.
            at: place of the value in the whole: names of attributes and entries that lead to it, joined by dots.
        """
        json_value = None if _is_user_module(type(value).__module__) else _json_value(value)
        if json_value is not None or value is None:
            return json_value
        if id(value) in self._first_places:
            return {SAME_KEY: self._first_places[id(value)][0]}
        self._first_places[id(value)] = at, value
        description = self._describe_any(value, at)
        is_frozen = getattr(getattr(type(value), "__dataclass_params__", None), "frozen", False)
        if is_frozen or type(value) in TYPES_WITHOUT_IDENTITY:  # one object in two places is like two equal objects
            del self._first_places[id(value)]
        return description

    def _describe_any(self, obj: object, at: str) -> object:
        kind = type(obj)
        if (function := _unwrap_function(obj)) is not None:
            return self._describe_function(function, at)
        if isinstance(obj, types.MethodType):
            return self._named({CODE_KEY: "method", "(function)": obj.__func__, "self": obj.__self__}, at)
        if isinstance(obj, functools.partial):
            entries = {CODE_KEY: "partial", "(function)": obj.func, "(arguments)": obj.args}
            return self._named(entries | obj.keywords, at)
        if isinstance(obj, types.ModuleType):
            return {CODE_KEY: f"module {obj.__name__}"} | _file_entry(getattr(obj, "__file__", None))
        if isinstance(obj, type):
            user_bases = [base for base in obj.__mro__ if _is_user_module(base.__module__)]
            members = {f"{base.__qualname__}{k or ''}": _class_members(base) for k, base in enumerate(user_bases)}
            return self._named(members, at) if obj in user_bases else _qualified_name(obj)
        if type(obj) is np.ndarray:
            if obj.dtype.kind in "biuf" and obj.size > MAX_SHOWN_ENTRIES:
                return f"{obj.dtype.name} {obj.shape}, {digest(np.ascontiguousarray(obj).tobytes())}"
            return self.describe(obj.tolist(), at)
        if type(obj) is dict or type(obj) is types.MappingProxyType:
            return self._named(obj, at)
        if type(obj) is list or type(obj) is tuple:
            return [self.describe(item, f"{at}.{k}") for k, item in enumerate(obj)]
        if type(obj) is set or type(obj) is frozenset:
            return sorted((self.describe(item, at) for item in obj), key=digest)
        identity_method = getattr(kind, "identity", None)
        if identity_method and (getattr(identity_method, "__module__", None) or "").partition(".")[0] in PACKAGES:
            return self.describe(identity_method(obj), at)
        if dataclasses.is_dataclass(obj):
            return self._named({CLASS_KEY: kind} | {f.name: getattr(obj, f.name) for f in dataclasses.fields(obj)}, at)
        description = self._describe_by_copy(obj, at)
        # QMCEngine is of scipy.stats
        if isinstance(obj, GENERATOR_TYPES) or any(base.__name__ == "QMCEngine" for base in kind.__mro__):
            self.random.append(description)
        return description

    def _named(self, values: Mapping[Any, object], at: str) -> dict[str, object]:
        keys = (name if type(name) is str else f"<{json.dumps(self.describe(name, at))}>" for name in values)
        named_values = dict(zip(keys, values.values(), strict=True))
        return {name: self.describe(item, f"{at}.{name}") for name, item in sorted(named_values.items())}

    def _describe_by_copy(self, value: object, at: str) -> object:
        """Return the description of an object, from the data that `copy` would make a copy from.

        An object that cannot be copied gets a description that belongs to this process alone.

        Args:
            value: the object.
            at: place of the object in the whole: names that lead to it, joined by dots.
        """
        kind, package = type(value), type(value).__module__.partition(".")[0]
        if isinstance(value, ufl.core.expr.Expr) and not extract_domains(value):
            return f"{_qualified_name(kind)}, {compute_expression_signature(value, {})[:12]}"
        if value is np.random.mtrand._rand or value is random._inst or package == "mpi4py":
            return _qualified_name(kind)  # global objects: their states do not belong to the value
        try:
            reduced = copyreg.dispatch_table.get(kind, lambda instance: instance.__reduce_ex__(4))(value)
        except Exception:  # it cannot be copied
            reduced = None
        if reduced is None or package in OPAQUE_PACKAGES:
            return f"{_qualified_name(kind)}{PROCESS_LABEL} ({_object_number(value)})"
        if isinstance(reduced, str):
            return f"{_qualified_name(kind)} {reduced}"
        make, args, state, *items = (*reduced, None)[: max(len(reduced), 3)]
        data = {CLASS_KEY: kind, "(made of)": [make, *args], "(items)": [[*item] for item in items if item is not None]}
        for attributes in state if isinstance(state, tuple) else (state,):  # of the dict and of slots
            data |= attributes if isinstance(attributes, dict) else {f"(state {len(data)})": attributes}
        return self._named(data, at)

    def _describe_function(self, function: types.FunctionType, at: str) -> object:
        code, closure = function.__code__, zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        read: dict[str, object] = {name: cell.cell_contents for name, cell in closure if cell != types.CellType()}
        if not _is_user_file(code.co_filename):
            return {CODE_KEY: _qualified_name(function), **self._named(read, at)} if read else _qualified_name(function)
        used_names = {name for code_object in _codes(code) for name in code_object.co_names}
        self.used_names |= used_names
        read = {name: function.__globals__[name] for name in used_names & function.__globals__.keys()} | read
        read |= {"(defaults)": function.__defaults__, "(keywords)": function.__kwdefaults__} | vars(function)
        read.pop("__wrapped__", None)
        parts = self._named({name: value for name, value in read.items() if value is not None}, at)
        return parts | _file_entry(code.co_filename) | {CODE_KEY: f"{function.__qualname__} {digest(_bytecode(code))}"}


def _object_number(value: object) -> int:
    """Return a number for an object, which no other object of this process gets.

    If the object allows weak references, this does not keep it alive.
    """
    reference_and_number = _OBJECT_NUMBERS.get(id(value))
    if reference_and_number is None or reference_and_number[0]() is not value:
        reference = weakref.ref(value) if type(value).__weakrefoffset__ else lambda: value
        reference_and_number = _OBJECT_NUMBERS[id(value)] = reference, next(_OBJECT_COUNTER)
    return reference_and_number[1]


def _class_members(user_class: type) -> dict[str, object]:
    """Return what identifies the user's class `user_class`: name -> method.

    Further entries are the file of the class and, if it has one, the content of its C source.
    """
    functions = {name: _unwrap_function(value) for name, value in vars(user_class).items()}
    added = {name for name, f in functions.items() if f and name[:2] == "__" and f.__code__.co_filename == "<string>"}
    # without those that `dataclass` makes
    members: dict[str, object] = {name: f for name, f in functions.items() if f and name not in added}
    source = vars(user_class).get("source")
    if isinstance(source, (str, Path)) and Path(source).is_file():
        members["source"] = source_content(Path(source))
    return members | _file_entry(getattr(sys.modules.get(user_class.__module__), "__file__", None))


def _file_entry(path: str | None) -> dict[str, str]:
    """Return {FILE_KEY: text} with the name and hash of a user's Python file, whose path is `path`.

    For a file of a library, a missing file or None it is {}.
    """
    if path is None or not Path(path).is_file() or not _is_user_file(path):
        return {}
    return {FILE_KEY: f"{Path(path).name} {digest(Path(path).read_bytes())}"}


def _unwrap_function(value: object) -> types.FunctionType | None:
    """Return the Python function that `value` is, or that it wraps as a property or cached function; else None."""
    while not isinstance(value, types.FunctionType):
        is_builtin = type(value).__module__.partition(".")[0] in ("builtins", "functools")
        if not is_builtin or value is None or isinstance(value, (type, types.MethodType, functools.partial)):
            return None
        candidates = (getattr(value, name, None) for name in ("__wrapped__", "func", "fget"))
        value = next((candidate for candidate in candidates if candidate is not None), None)
    return value


def _codes(code: types.CodeType) -> list[types.CodeType]:
    """Return a list of the code object `code` and of the code objects of all functions defined within it."""
    return [code, *(inner for part in code.co_consts if isinstance(part, types.CodeType) for inner in _codes(part))]


def _bytecode(code: object) -> object:
    """Return the bytecode, names and constants of a code object as JSON data, without file names and line numbers.

    A constant (no code object) gives its `repr`.
    """
    if isinstance(code, types.CodeType):
        return [code.co_code.hex(), [*code.co_names], [_bytecode(constant) for constant in code.co_consts]]
    return repr(sorted(code, key=repr) if isinstance(code, frozenset) else code)


def _is_user_module(module: str) -> bool:
    """Return whether a module is the user's own: not of Python, not an installed package, not of this package.

    Args:
        module: name of the module.
    """
    package = module.partition(".")[0]
    files = (getattr(sys.modules.get(name), "__file__", None) for name in (module, package))
    is_installed = package in sys.stdlib_module_names or not all(_is_user_file(file) for file in files if file)
    return module == "__main__" or not is_installed


@functools.cache
def _is_user_file(file: str) -> bool:
    path = Path(file)
    is_installed = file.startswith("<frozen") or {"site-packages", "dist-packages"} & {*path.parts}
    return not (is_installed or any(path.is_relative_to(folder) for folder in LIBRARY_FOLDERS))


def _json_value(value: object) -> bool | float | str | None:
    """Return the JSON value of a number or a text; for bytes a text with their hash; for any other type None."""
    if isinstance(value, (str, bool)):
        return value if isinstance(value, bool) else str(value)
    if isinstance(value, Integral) and abs(int(value)) > 1 / sys.float_info.epsilon:
        return str(int(value))
    if isinstance(value, Real):
        return float(value) if math.isfinite(value) else str(float(value))  # NaN is not equal to itself
    return f"bytes {digest(bytes(value))}" if isinstance(value, (bytes, bytearray)) else None


def _qualified_name(kind: type | types.FunctionType) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


# ---------------------------------------------------------------- C sources
def source_content(source: Path) -> bytes:
    """Return the content of a C source, followed by that of all files that it includes directly or indirectly.

    Only files with paths relative to the source are found. Nothing is preprocessed: a file counts even if a condition
    excludes it. An included file that cannot be read is skipped; the compiler will report it.

    Args:
        source: path of the C file.

    Raises:
        OSError: the source itself cannot be read.
    """
    contents, todo = {source: source.read_bytes()}, [source]
    while todo:
        file = todo.pop()
        for name in INCLUDED_FILE_REGEX.findall(contents[file]):
            with suppress(OSError, ValueError):
                included = (file.parent / name.decode()).resolve()
                if included not in contents:
                    contents[included] = included.read_bytes()
                    todo.append(included)
    return b"\0".join(contents.values())
