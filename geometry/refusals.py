"""Errors of geometry, and the words of their messages."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from forms.base import InputError
from forms.base import unknown as unknown


def place(x: npt.NDArray[np.float64]) -> str:
    """Coordinates for a message, short."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def refuse(bad: npt.NDArray[np.bool_] | np.bool_, x: npt.NDArray[np.float64], message: str) -> None:
    """Raise InputError if any of n things is bad.

    Args:
        bad: (n,) whether each is.
        x: (n, d) their places, or (n, k, d) those of their nodes.
        message: its {at} becomes the place of the first bad one, its {bad} and {all} the numbers of bad ones and of all.
    """
    if bad.any():
        first = x[bad.argmax()].reshape(-1, x.shape[-1]).mean(axis=0)
        for name, value in {"at": place(first), "bad": bad.sum(), "all": np.size(bad)}.items():
            message = message.replace(f"{{{name}}}", str(value))
        raise InputError(message)
