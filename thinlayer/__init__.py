"""Structures with thin soft layers: the layer is meshed, or replaced by its interface law.

Names are imported when they are first used, so that `python3 -m thinlayer list` does not load DOLFINx. As in SPEC 1 of
Scientific Python, `__init__.pyi` has the module of each name.
"""

# ruff: noqa: E402, F401
import sys
from os.path import dirname, join, realpath

_PACKAGE_PARENT = dirname(dirname(realpath(__file__)))  # the folder in which our packages lie
_is_run_with_m = sys.argv[:1] == ["-m"] and "thinlayer" in sys.orig_argv and not sys.flags.safe_path
if _is_run_with_m and realpath(sys.path[0]) != _PACKAGE_PARENT:
    del sys.path[0]  # `python3 -m thinlayer` imports nothing from the working folder, in which Python would look first

import ast
import logging
from importlib.util import find_spec
from pathlib import Path

from thinlayer.system.version import VERSION as __version__

if find_spec("dolfinx_solver"):  # the wheel of DOLFINx: MPI must be loaded before what is linked to it
    import dolfinx_solver

_STUB_TEXT = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_STUB_IMPORTS = [line for line in ast.parse(_STUB_TEXT).body if isinstance(line, ast.ImportFrom)]
_MODULE_OF_NAME = {alias.name: str(line.module) for line in _STUB_IMPORTS for alias in line.names}
_SUBMODULE_PATHS = {"plotting": "output.plotting", "fields": "output.paraview.writer", "goals": "estimating.goals"}
_SUBMODULE_PATHS["examples"] = "examples"
__all__ = sorted(_MODULE_OF_NAME)

logging.getLogger("thinlayer").addHandler(logging.NullHandler())  # quiet by default


def _refuse_shadowing_packages() -> None:
    """Raise ImportError if Python would import a user's module `forms` or `geometry` instead of thinlayer's own."""
    for name in ("forms", "geometry"):
        spec, folder = find_spec(name), join(_PACKAGE_PARENT, name)
        if spec and spec.origin and dirname(realpath(spec.origin)) != folder:
            raise ImportError(f"{spec.origin} hides thinlayer's own package {name!r}, {folder}; rename the former")


_refuse_shadowing_packages()


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


def __getattr__(name: str) -> object:
    from forms.base import import_optional

    if name in _SUBMODULE_PATHS:
        return import_optional(f"thinlayer.{_SUBMODULE_PATHS[name]}")
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module 'thinlayer' has no attribute {name!r}")
    return getattr(import_optional(_MODULE_OF_NAME[name]), name)
