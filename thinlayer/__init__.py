"""Structures with thin soft layers: the layer is meshed, or replaced by its interface law.

Names are imported when they are first used, so that `python3 -m thinlayer list` does not load DOLFINx.
"""

# ruff: noqa: E402, F401
import sys
from os.path import dirname, join, realpath

_HOME = dirname(dirname(realpath(__file__)))  # the folder of our packages
_is_command = sys.argv[:1] == ["-m"] and "thinlayer" in sys.orig_argv and not sys.flags.safe_path
if _is_command and realpath(sys.path[0]) != _HOME:
    del sys.path[0]  # `python3 -m thinlayer` imports nothing from the working folder, in which Python would look first

import logging
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from thinlayer.system.words import VERSION as __version__

if TYPE_CHECKING:  # for editors and mypy alone
    from thinlayer.discretisation.broken_mesh import BrokenMesh
    from thinlayer.discretisation.given import Pressure
    from thinlayer.discretisation.given_strains import Prestress, ThermalExpansion
    from thinlayer.discretisation.layer import Bond, Gap, ThinLayer
    from thinlayer.discretisation.point_loads import LineLoad, PointLoad
    from thinlayer.discretisation.structure import Structure
    from thinlayer.discretisation.time_functions import piecewise
    from thinlayer.errors import InputError, LimitLoad, RangeWarning, SolveError, ThinlayerError
    from thinlayer.estimating.estimate import estimate
    from thinlayer.estimating.thickness import thin_enough
    from thinlayer.output.comparison import compare
    from thinlayer.output.ensemble import ensemble
    from thinlayer.output.homogenised import homogenised_stiffness
    from thinlayer.output.probe import Probe
    from thinlayer.output.surface import Surface
    from thinlayer.output.sweep import sweep
    from thinlayer.output.zooming import Zoom
    from thinlayer.parts.plates import RigidPlate
    from thinlayer.parts.springs import Springs
    from thinlayer.parts.ufl_part import UflPart
    from thinlayer.pointwise.drive import drive
    from thinlayer.solving.solvers import solve
    from thinlayer.solving.step_problem import StepProblem
    from thinlayer.system.table import Table
    from thinlayer.time.marching import march
    from thinlayer.time.plan import Adaptive, ArcLength

_NAMES = {
    "discretisation.broken_mesh": "BrokenMesh",
    "discretisation.time_functions": "piecewise",
    "discretisation.given": "Pressure",
    "discretisation.given_strains": "Prestress ThermalExpansion",
    "discretisation.layer": "Bond Gap ThinLayer",
    "discretisation.point_loads": "LineLoad PointLoad",
    "discretisation.structure": "Structure",
    "errors": "InputError LimitLoad RangeWarning SolveError ThinlayerError",
    "estimating.estimate": "estimate",
    "estimating.thickness": "thin_enough",
    "output.comparison": "compare",
    "output.ensemble": "ensemble",
    "output.homogenised": "homogenised_stiffness",
    "output.probe": "Probe",
    "output.surface": "Surface",
    "output.sweep": "sweep",
    "output.zooming": "Zoom",
    "parts.plates": "RigidPlate",
    "parts.springs": "Springs",
    "parts.ufl_part": "UflPart",
    "pointwise.drive": "drive",
    "solving.solvers": "solve",
    "solving.step_problem": "StepProblem",
    "system.table": "Table",
    "time.marching": "march",
    "time.plan": "Adaptive ArcLength",
}  # module -> its public names
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names.split()}
_MODULES = {"plotting": "output.plotting", "fields": "output.fields", "goals": "estimating.goals"}
__all__ = sorted(_MODULE_OF)


logging.getLogger("thinlayer").addHandler(logging.NullHandler())  # quiet by default


def _refuse_others() -> None:
    """Raise ImportError where a file or package of a user has the name of one of ours, and Python would import it."""
    for name in ("forms", "geometry"):
        spec, own = find_spec(name), join(_HOME, name)
        if spec and spec.origin and dirname(realpath(spec.origin)) != own:
            raise ImportError(f"{spec.origin} hides thinlayer's own package {name!r}, {own}; rename the former")


_refuse_others()


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        from forms.base import optional

        return optional(f"thinlayer.{_MODULES[name]}")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'thinlayer' has no attribute {name!r}")
    return getattr(import_module(f"thinlayer.{_MODULE_OF[name]}"), name)
