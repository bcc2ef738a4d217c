"""Code of Python functions, and the values and modules that it refers to."""

from __future__ import annotations

import dis
import functools
import importlib
import importlib.util
import itertools
import sys
import types
from collections.abc import Iterator
from typing import Any

from thinlayer.identity.owners import is_of_a_library, is_ours, is_own

IMPORT = dis.opmap["IMPORT_NAME"]
FROM_DICT = ("LOAD_FROM_DICT_OR_GLOBALS", "LOAD_FROM_DICT_OR_DEREF")  # in the body of a class
CACHED = type(functools.cache(len))


def bytecode(function: types.FunctionType) -> Any:
    """Bytecode of a function without docstrings, file names and line numbers."""
    return _of_code(function.__code__, function.__doc__)


def _of_code(code: types.CodeType, doc: str | None = None) -> Any:
    constants = [c for k, c in enumerate(code.co_consts) if k or doc is None or c != doc]
    shown = [_of_code(c) if isinstance(c, types.CodeType) else _constant(c) for c in constants]
    return [code.co_code.hex(), shown, list(code.co_names), list(code.co_varnames), list(code.co_freevars)]


def referred_to(function: types.FunctionType) -> dict[str, Any]:
    """Name -> object that a function's code refers to: values it closes over, and globals."""
    found = dict(closed_over(function))
    for name in sorted(set(_names(function.__code__)) - found.keys()):
        if name in function.__globals__:
            found[name] = function.__globals__[name]
    if is_ours(function.__module__):  # caches of the package are not data
        return {name: value for name, value in found.items() if not isinstance(value, (dict, list, set))}
    return found


def function_of(value: Any) -> types.FunctionType | None:
    """The Python function behind a function, static method, wrapper or compiled function; else None."""
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


def closed_over(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """Name -> value that a function closes over."""
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


def calls(code: types.CodeType, name: str) -> bool:
    """Whether a code, or a function within it, may call something of this name."""
    return name in _names(code)


def names_read(code: types.CodeType) -> Iterator[str]:
    """Names that a code may read of a module, by a dot or as a text."""
    yield from _names(code)
    for one in _codes(code):
        for constant in one.co_consts:
            yield from (
                text for text in (constant if isinstance(constant, tuple) else (constant,)) if isinstance(text, str)
            )


def _steps(code: types.CodeType) -> list[dis.Instruction]:
    return [step for one in _codes(code) for step in dis.get_instructions(one) if step.opname != "EXTENDED_ARG"]


def passed_on(code: types.CodeType, name: str) -> bool:
    """Whether a code uses a named object in any other way than by reading its attributes."""
    steps = _steps(code)
    return any(
        step.argval == name
        and step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF", *FROM_DICT)
        and (after.opname not in ("LOAD_ATTR", "LOAD_METHOD") or after.argval == "__dict__")
        for step, after in itertools.pairwise(steps)
    )


def imported(function: types.FunctionType) -> list[types.ModuleType]:
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
                if name not in sys.modules and is_of_a_library(name.partition(".")[0]):
                    continue
                module = importlib.import_module(name)
                for one in names:
                    if one != "*" and not hasattr(module, one):
                        importlib.import_module(f"{name}.{one}")
            except Exception:  # the function itself will raise the error
                continue
            if is_own(module):
                found[module.__name__] = module
    return list(found.values())


def _constant(value: Any) -> str:
    return repr(sorted(value, key=repr)) if isinstance(value, frozenset) else repr(value)
