"""Errors of geometry, and the words of their messages."""

from __future__ import annotations

from collections.abc import Collection, Hashable

import numpy as np

from forms.base import InputError
from forms.base import unknown_name_message as unknown_name_message
from geometry.topology import BoolArray, FloatArray


def place_text(x: FloatArray) -> str:
    """Coordinates for a message, short."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def require_known(kind: str, name: object, allowed: Collection[str], what: str = "") -> None:
    """Raise InputError for a name that does not exist; `what` begins the message."""
    if not (isinstance(name, Hashable) and name in allowed):
        raise InputError((f"{what}: " if what else "") + unknown_name_message(kind, name, allowed))


def refuse(bad: BoolArray | np.bool_, x: FloatArray, message: str) -> None:
    """Raise InputError if any of n things is bad.

    Args:
        bad: (n,) whether each is.
        x: (n, d) their places, or (n, k, d) those of their nodes.
        message: its {at} becomes the place of the first bad one, its {bad} and {all} the numbers of bad ones and of all.
    """
    if bad.any():
        first = x[bad.argmax()].reshape(-1, x.shape[-1]).mean(axis=0)
        for name, value in {"at": place_text(first), "bad": bad.sum(), "all": np.size(bad)}.items():
            message = message.replace(f"{{{name}}}", str(value))
        raise InputError(message)
