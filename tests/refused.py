"""What is refused, a line each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import pytest

Raised = TypeVar("Raised", bound=Exception)


def refused(error: type[Raised], words: str, call: Callable[..., object], /, *args: object, **named: object) -> Raised:
    """The call raises this error, and its message has these words (a regular expression); the error."""
    with pytest.raises(error, match=words) as caught:
        call(*args, **named)
    return caught.value
