"""A description in Python: a file that defines `structure` and `layer`."""

from __future__ import annotations

import runpy
import sys
import traceback
from pathlib import Path
from typing import Any

from forms.base import ThinlayerError
from thinlayer.describing import entries
from thinlayer.describing.case import Case
from thinlayer.describing.section import DescriptionError, Section
from thinlayer.discretisation.structure import Structure
from thinlayer.estimating.goals import Compliance, Goal
from thinlayer.parallel.agreement import on_all

MODULE = "description"  # __name__ in the file: what stands under `if __name__ == "__main__":` is not run


def case_in(path: Path) -> Case:
    """The case that a file defines by `structure` and `layer`, and perhaps the other attributes of `Case`. Collective.

    Raises:
        DescriptionError: the file cannot be run, with the line; a name is missing, or has a value of another kind.
        ThinlayerError: as the file raises it.
    """
    with on_all(None):
        return _case(path, _names(path))


def _names(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise DescriptionError(f"{path} is no file")
    sys.path.append(str(path.resolve().parent))  # its own modules
    try:
        return runpy.run_path(str(path), run_name=MODULE)
    except ThinlayerError:
        raise
    except SyntaxError as error:
        raise DescriptionError(f"{path}, line {error.lineno}: {error.msg}") from error
    except Exception as error:
        lines = [one.lineno for one in traceback.extract_tb(error.__traceback__) if one.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise DescriptionError(f"{path}{where}: {type(error).__name__}: {error}") from error


def _case(path: Path, names: dict[str, Any]) -> Case:
    for name, what in (("structure", "a Structure"), ("layer", "a ThinLayer, or {name of a seam: ThinLayer}")):
        if name not in names:
            raise DescriptionError(f"{path} does not define {name}: {what}")
    if not isinstance(names["structure"], Structure):
        raise DescriptionError(f"{path}: structure is {names['structure']!r}; it must be a Structure")
    goals = names.get("goals", [Compliance()])
    if not (isinstance(goals, list | tuple) and all(isinstance(one, Goal) for one in goals)):
        raise DescriptionError(f"{path}: goals is {goals!r}; it must be a list of goals, such as goals.Compliance()")
    others = ("bodies", "times", "tolerance", "bonded", "units")
    section = Section(
        {key: names[key] for key in others if key in names}, (), lambda keys: ": ".join([str(path), ".".join(keys)])
    )
    return Case(
        names["structure"],
        names["layer"],
        tuple(goals),
        entries.bodies(section),
        entries.times(section),
        entries.tolerance(section, [*entries.ALWAYS, *(one.name for one in goals)]),
        section.flag("bonded"),
        entries.units(section),
    )
