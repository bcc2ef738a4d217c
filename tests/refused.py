"""What is refused, a line each."""

from __future__ import annotations

from collections.abc import Callable

import pytest


def refused(
    error: type[Exception], words: str, call: Callable[..., object], /, *given: object, **named: object
) -> None:
    """The call raises this error, and its message has these words (a regular expression)."""
    with pytest.raises(error, match=words):
        call(*given, **named)
