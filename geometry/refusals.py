"""Errors of geometry, and texts for their messages."""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable

import numpy as np

from forms.base import InputError
from forms.base import unknown_name_message as unknown_name_message
from geometry.topology import BoolArray, FloatArray


def place_text(x: FloatArray) -> str:
    """Short text of coordinates, for messages."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def require_known(kind: str, name: object, allowed: Collection[str], what: str = "") -> None:
    """Raise InputError unless a name is among the allowed names; `what` begins the message."""
    if not (isinstance(name, Hashable) and name in allowed):
        raise InputError((f"{what}: " if what else "") + unknown_name_message(kind, name, allowed))


def refuse(bad: BoolArray | np.bool_, x: FloatArray, message: str) -> None:
    """Raise InputError if any of n items is bad.

    Args:
        bad: (n,) whether each item is bad.
        x: (n, d) places of the items, or (n, k, d) places of their nodes.
        message: text of the error. {at} becomes the place of the first bad item, {bad} the number of bad items, {all}
            the number of items.
    """
    if bad.any():
        first = x[bad.argmax()].reshape(-1, x.shape[-1]).mean(axis=0)
        texts = {"{at}": place_text(first), "{bad}": str(bad.sum()), "{all}": str(np.size(bad))}
        raise InputError(re.sub(r"\{(at|bad|all)\}", lambda match: texts[match[0]], message))
