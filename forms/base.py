"""What all packages here share and no library has: the base class of errors, what counts as a number, the packages."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

PACKAGES = ("forms", "geometry", "thinlayer")


class ThinlayerError(Exception):
    """Base of all errors that these packages raise themselves, for bad input and for solves that fail."""


class InputError(ThinlayerError, ValueError):
    """Something given that cannot be used: the message says what, where and what is allowed."""


def is_number(value: Any) -> bool:
    """Whether a value is a real number, NaN and infinity among them; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_finite(value: Any) -> bool:
    """Whether a value is a finite real number."""
    return is_number(value) and math.isfinite(value)
