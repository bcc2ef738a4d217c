"""Differences of two descriptions."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

MISSING = object()


def differences(one: Any, other: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """Differences of two descriptions in full: path of names, and both values there, or `MISSING`."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted(one.keys() | other.keys()):
            yield from differences(one.get(key, MISSING), other.get(key, MISSING), (*path, key))
    elif isinstance(one, list) and isinstance(other, list):
        for k, pair in enumerate(itertools.zip_longest(one, other, fillvalue=MISSING)):
            yield from differences(*pair, (*path, str(k)))
    elif one != other:
        yield path, one, other
