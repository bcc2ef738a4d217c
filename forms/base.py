"""Errors, checks of numbers and names, and the array type, which the packages forms, geometry and thinlayer share."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable
from importlib import import_module
from numbers import Real
from types import ModuleType
from typing import TypeGuard

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
PACKAGES = ("forms", "geometry", "thinlayer")
# optional module -> the extra of pyproject.toml that installs it
OPTIONAL_PACKAGES = {
    "dolfinx": "fenicsx", "matplotlib": "pictures", "pyvista": "vtk", "gmsh": "meshes", "meshio": "meshes",
    "h5py": "meshes", "pint": "units", "pandas": "pandas",
}  # fmt: skip


class ThinlayerError(Exception):
    """Base of all errors that these packages raise, for bad input and for failed solves.

    `except ThinlayerError` catches both kinds of them.
    """


class InputError(ThinlayerError, ValueError):
    """Input that cannot be used. The message says what is wrong, where, and which values are allowed.

    Attributes:
        key: identifier of the violated condition; "" if the condition has none.
    """

    key = ""


def require(condition: object, quantity: str, value: object, wanted: str) -> None:
    """Raise InputError unless `condition` is true.

    The message is "{quantity} is {value}; {wanted}".

    Args:
        condition: result of a check; anything with a truth value.
        quantity: name of the checked quantity.
        value: the quantity's value, of which the message shows at most 200 characters.
        wanted: text that says which values are allowed.
    """
    if not condition:
        raise InputError(f"{quantity} is {value!r:.200}; {wanted}")


def import_optional(name: str) -> ModuleType:
    """Import a module that is, or itself imports, an optional dependency; if this is missing, say how to install it.

    Args:
        name: full name of the module: an optional dependency (a key of `OPTIONAL_PACKAGES`), or a module of these
            packages that imports one.

    Raises:
        InputError: the optional dependency is not installed. The message has the command of pip that installs it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in OPTIONAL_PACKAGES:
            raise
        raise InputError(f"{module} is not installed: pip install 'thinlayer[{OPTIONAL_PACKAGES[module]}]'") from error


def unknown_name_message(kind: str, name: object, allowed: Iterable[str]) -> str:
    """Return an error message for an unknown name, with all known names and a suggestion.

    The suggestion is the known name most similar to the unknown one, or the only one that starts with it.

    Args:
        kind: noun for what the name stands for, such as "seam".
        name: the unknown name.
        allowed: the known names.
    """
    allowed, prefix = sorted(allowed), str(name).lower()
    lowered = {candidate.lower(): candidate for candidate in allowed}
    starting = [key for key in lowered if key.startswith(prefix)]
    matches = difflib.get_close_matches(prefix, lowered, n=1) or (starting if len(starting) == 1 and prefix else [])
    suggestion = f", did you mean {lowered[matches[0]]!r}?" if matches else ""
    return f"unknown {kind} {name!r}{suggestion}; known: {', '.join(allowed) or 'none'}"


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number; NaN and infinity count as numbers, True and False do not."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether a value is a real number in the range of 64-bit floats, which excludes NaN and infinity."""
    number = value.item() if isinstance(value, np.generic) else value  # numpy would round the bound to 32 bits
    return is_number(number) and bool(abs(number) <= sys.float_info.max)


def is_integer(value: object, least: int) -> bool:
    """Return whether a value is a whole number >= `least`; 3.0 counts as whole."""
    return is_finite(value) and value == int(value) and value >= least
