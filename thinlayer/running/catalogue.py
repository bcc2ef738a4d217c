"""Catalogue of the studies: summary, options and duration of each, read from its source without importing it."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from textwrap import fill
from typing import Any

STUDIES_FOLDER = Path(__file__).parents[2] / "studies"
BENCHMARKS_FOLDER = STUDIES_FOLDER.parent / ".ci/benchmarks"  # only in a clone
STUDY_LISTS = [p for p in (STUDIES_FOLDER / "data/studies.toml", BENCHMARKS_FOLDER / "studies.toml") if p.exists()]
_LISTS_TEXT = "\n".join(path.read_text(encoding="utf-8") for path in STUDY_LISTS)
STUDY_GROUPS: dict[str, dict[str, list[float]]] = tomllib.loads(_LISTS_TEXT)  # group -> study -> seconds, see `Study`
OptionArguments = Mapping[str, Any]  # arguments of `ArgumentParser.add_argument`, by name
SECONDS_OF_UNIT = {"h": 3600, "min": 60, "s": 1}


@dataclass(frozen=True)
class Study:
    """A study that the command line can run.

    Attributes:
        name: name of its module in `studies`.
        summary: first line of the module's docstring.
        options: name of an option, a keyword argument of the module's `run` -> arguments of argparse's `add_argument`.
        drawn: whether the study draws pictures; other studies only write tables.
        group: name of its group in the list of studies.
        quick, full: approximate duration with --quick, and without it, s.
    """

    name: str
    summary: str
    options: dict[str, OptionArguments]
    drawn: bool
    group: str
    quick: float
    full: float


@cache
def studies() -> dict[str, Study]:
    """Name -> study, in the order of the groups, with benchmarks if they are present."""
    catalogue = {}
    for group, members in STUDY_GROUPS.items():
        for name, seconds in members.items():
            folder = BENCHMARKS_FOLDER if group == "Benchmarks" else STUDIES_FOLDER
            tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
            functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
            run, summary = functions["run"], (ast.get_docstring(tree) or "").partition("\n")[0]
            options = {option.arg: _option(option, ast.get_docstring(run) or "") for option in run.args.kwonlyargs}
            catalogue[name] = Study(name, summary, options, "draw" in functions, group, *seconds)
    return catalogue


def _option(argument: ast.arg, text: str) -> OptionArguments:
    """Arguments of argparse's `add_argument` for a keyword argument of a study's `run`, by name.

    Args:
        argument: the keyword argument; its annotation is `bool`, `Sequence[float]` (thicknesses) or `Literal[...]`.
        text: docstring of `run`; the first line on the argument in it becomes the help of the option.
    """
    line = re.search(rf"^\s+{argument.arg}: (.*)$", text, re.MULTILINE)
    explained = {"help": line[1].replace("%", "%%") if line else None}
    kind = ast.unparse(argument.annotation) if argument.annotation else ""
    if kind == "bool":
        return {**explained, "action": "store_true"}
    if kind == "Sequence[float]":
        return {**explained, "nargs": "+", "type": float, "metavar": "E"}
    allowed = tuple(ast.literal_eval(kind.removeprefix("Literal")))
    return {**explained, "choices": allowed, "type": type(allowed[0])}


def listed() -> str:
    """Text that lists the groups, with each study's name, durations and summary, in 80 columns; without benchmarks."""
    lines = dict[str, None]()  # each heading once
    for study in (study for study in studies().values() if study.group != "Benchmarks"):
        lines[study.group] = None
        lines[f"  {study.name:<20} {duration(study.full):>6}, quick {duration(study.quick)}"] = None
        lines[fill(study.summary, 80, initial_indent=" " * 4, subsequent_indent=" " * 4)] = None
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """Text for a time in seconds, rounded to one digit, with the unit h, min or s."""
    unit = next(unit for unit, size in SECONDS_OF_UNIT.items() if seconds >= 1.5 * size or size == 1)
    return f"{float(f'{seconds / SECONDS_OF_UNIT[unit]:.1g}'):g} {unit}"
