"""gmsh, imported when it is first used: it takes a third of a second, and only the rank that meshes needs it."""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("gmsh"), name)
