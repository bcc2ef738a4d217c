"""Functions that raise the errors of this package, and texts for their messages."""

from __future__ import annotations

import re
from collections.abc import Collection, Hashable, Iterable

import numpy as np

from forms.base import InputError
from forms.base import unknown_name_message as unknown_name_message
from geometry.topology import BoolArray, FloatArray


def place_text(x: Iterable[float]) -> str:
    """Return coordinates as a short text for messages, as "(1, 0.5)"."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def require_known(kind: str, name: object, allowed: Collection[str], context: str = "") -> None:
    """Raise InputError unless `name` is among the allowed names.

    Args:
        kind: noun for what is named, such as "region", for the message.
        name: the name.
        allowed: the allowed names; the message suggests similar ones.
        context: beginning of the message, such as the name of an argument; "": none.
    """
    if not (isinstance(name, Hashable) and name in allowed):
        raise InputError((f"{context}: " if context else "") + unknown_name_message(kind, name, allowed))


def refuse(bad: BoolArray | np.bool_, x: FloatArray, message: str) -> None:
    """Raise InputError if any of n items, such as cells, is marked as bad.

    Args:
        bad: (n,) whether each item is bad.
        x: (n, d) coordinates of the items in d dimensions, or (n, k, d) coordinates of the k nodes of each.
        message: text of the error. {at} becomes the place of the first bad item, {bad} the number of bad items, {all}
            the number of items.
    """
    if bad.any():
        first = x[bad.argmax()].reshape(-1, x.shape[-1]).mean(axis=0)
        texts = {"{at}": place_text(first), "{bad}": str(bad.sum()), "{all}": str(np.size(bad))}
        raise InputError(re.sub(r"\{(at|bad|all)\}", lambda match: texts[match[0]], message))
