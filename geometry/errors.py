"""Errors of geometry, and the words of their messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from forms.base import InputError
from geometry.topology import FloatArray


class GeometryError(InputError):
    """A mesh, a name or a size that cannot be used. Says what is wrong, where, and what is allowed."""


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """Message for a name that does not exist: the nearest known one and the whole list."""
    known = sorted(known)
    lowered = {one.lower(): one for one in known}
    near = [lowered[one] for one in difflib.get_close_matches(str(name).lower(), lowered, n=1)]
    return (
        f"unknown {kind} {name!r}" + (f", did you mean {near[0]!r}?" if near else "") + f"; known: {', '.join(known)}"
    )


def place(x: FloatArray) -> str:
    """Coordinates for a message, short."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"
