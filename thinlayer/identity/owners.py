"""Owner of code: these packages, a library, or the user."""

from __future__ import annotations

import builtins
import functools
import importlib.util
import sys
import sysconfig
import types
from pathlib import Path
from typing import Any

from forms.base import PACKAGES

HEAP = 1 << 9  # Python's flag of classes that were made by running code


def is_ours(module: str | None) -> bool:
    """Whether a module, by its name, is one of these packages'."""
    return (module or "").partition(".")[0] in PACKAGES


def is_readable(value: Any, home: str) -> bool:
    """Whether the code of a function or class counts: it stands in the module `home`, or is the user's own."""
    module = getattr(value, "__module__", None)
    if module in (None, "builtins"):  # Python's own, or code that is executed as a text
        if isinstance(value, types.FunctionType):
            return not is_installed(Path(value.__code__.co_filename))
        made = bool(getattr(value, "__flags__", 0) & HEAP)
        return made and value is not getattr(builtins, value.__name__, None)
    return module in (home, "__main__") or not (is_ours(module) or is_of_a_library(module))


def is_own(module: types.ModuleType) -> bool:
    """Whether a module is the user's own: from no library's folder, or from no file at all."""
    top = module.__name__.partition(".")[0]
    if top in PACKAGES:
        return False
    place = getattr(module, "__file__", None) or next(iter(getattr(module, "__path__", ())), None)
    if place is not None:
        return not is_installed(Path(place))
    package = sys.modules.get(top)
    return is_own(package) if package not in (None, module) else top not in sys.stdlib_module_names


@functools.cache
def is_of_a_library(module: str) -> bool:
    """Whether a module, by its name, is installed or comes with Python."""
    if module in sys.modules:
        file = getattr(sys.modules[module], "__file__", None)
    else:
        found = importlib.util.find_spec(module)
        file = found.origin if found is not None and found.has_location else None
    return file is None or is_installed(Path(file))


def is_installed(path: Path) -> bool:
    """Whether a file is one of Python or of an installed package."""
    installed = {"site-packages", "dist-packages"} & set(path.parts)
    return bool(installed) or path.is_relative_to(sysconfig.get_path("stdlib"))
