"""Standard output whose reader may have gone, as in `python3 -m thinlayer run STUDY | head -1`."""

from __future__ import annotations

import os
import sys


def say(text: object) -> None:
    """Print, or do nothing once the reader of standard output has gone."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
