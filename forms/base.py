"""Shared by all packages here: base classes of errors, tests for numbers, names of the packages."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

PACKAGES = ("forms", "geometry", "thinlayer")


class ThinlayerError(Exception):
    """Base of all errors that these packages raise themselves, for bad input and for solves that fail."""


class InputError(ThinlayerError, ValueError):
    """Input that cannot be used. The message says what is wrong, where, and which values are allowed."""


def is_number(value: Any) -> bool:
    """Whether a value is a real number, including NaN and infinity, excluding True and False."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_finite(value: Any) -> bool:
    """Whether a value is a finite real number."""
    return is_number(value) and math.isfinite(value)
