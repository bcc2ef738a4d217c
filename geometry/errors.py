"""Errors of geometry, and the words of their messages."""

from __future__ import annotations

from forms.base import InputError
from forms.base import unknown as unknown
from geometry.topology import FloatArray


class GeometryError(InputError):
    """A mesh, a name or a size that cannot be used. Says what is wrong, where, and what is allowed."""


def place(x: FloatArray) -> str:
    """Coordinates for a message, short."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"
