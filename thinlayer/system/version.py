"""Version of the package, printing to standard output, and texts of errors that end a run; all without MPI."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

VERSION = "1.0.0"  # version of these packages; pyproject.toml reads it
WHEEL = "dolfinx-solver-real"  # the package that pip installs DOLFINx and petsc4py with


def version_of(package: str) -> str:
    """Return the version of an installed package as a text, or "not installed".

    If DOLFINx was installed as a wheel, with petsc4py in it, the version is that of the wheel.
    """
    for name in (package, WHEEL) if package in ("fenics-dolfinx", "petsc4py") else (package,):
        with suppress(PackageNotFoundError):
            return version(name)
    return "not installed"


def error_reason(error: BaseException) -> str:
    """Return a text that says why `error` ended a run, such as "interrupted".

    For an OSError the text names the file. For an error that shows a bug it starts with the class of the error.
    """
    if isinstance(error, OSError):
        file_text = f" {str(error.filename)!r}" if error.filename else ""
        return f"a file{file_text} could not be written or read: {error.strerror or error}"
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return str(error) if isinstance(error, RuntimeError) else f"{type(error).__name__}: {error}"


def print_safely(text: object) -> None:
    """Print `text` in place of a line of progress.

    It does nothing if no process reads standard output any more, as in `thinlayer list | head -1`.
    """
    if sys.stderr.isatty():
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    try:
        print(text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def two_columns(texts: Mapping[str, str]) -> str:
    """Return the names and texts of `texts` (name -> text) as lines with two aligned columns."""
    width = max(map(len, texts), default=0)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in texts.items())
