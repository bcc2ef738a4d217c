"""Numbers, texts and names as JSON, and names of objects."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import sys
import types
from numbers import Integral, Real
from pathlib import PurePath
from typing import Any

import numpy as np


def digest(value: Any) -> str:
    """Hash, twelve digits, of a JSON value or of bytes."""
    content = value if isinstance(value, bytes) else text_of(value).encode()
    return hashlib.sha256(content).hexdigest()[:12]


def text_of(value: Any) -> str:
    """A JSON value as text."""
    return json.dumps(value, sort_keys=True)


def plain(value: Any) -> Any:
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


def name_of(value: Any) -> str:
    """Name of a class or function, with its module."""
    return f"{value.__module__}.{value.__qualname__}"


def place_of(value: Any) -> str | None:
    """Where a module of a library has an object, such as the distributions of scipy.stats."""
    module = type(value).__module__
    names = (name for name, one in vars(sys.modules.get(module, types)).items() if one is value)
    return next((f"{module}.{name}" for name in names), None)


def attributes(value: Any) -> dict[str, Any]:
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
