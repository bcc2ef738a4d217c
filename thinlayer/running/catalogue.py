"""Catalogue of the studies: the summary, options and duration of each, read from its source without importing it."""

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
STUDY_LIST_FILES = [p for p in (STUDIES_FOLDER / "data/studies.toml", BENCHMARKS_FOLDER / "studies.toml") if p.exists()]
_LISTS_TEXT = "\n".join(path.read_text(encoding="utf-8") for path in STUDY_LIST_FILES)
STUDY_GROUPS: dict[str, dict[str, list[float]]] = tomllib.loads(_LISTS_TEXT)  # group -> study -> seconds, see `Study`
OptionArguments = Mapping[str, Any]  # arguments of `ArgumentParser.add_argument`, by name
SECONDS_OF_UNIT = {"h": 3600, "min": 60, "s": 1}


@dataclass(frozen=True)
class Study:
    """A study that the command line can run: a Python module that computes tables and checks numbers in them.

    Attributes:
        name: name of the module, which is in the folder `studies`, or `.ci/benchmarks` for benchmarks.
        summary: first line of the module's docstring.
        options: name of an option -> arguments for argparse's `add_argument`, by name. Each option is a keyword
            argument of the module's function `run`.
        drawn: whether the study draws pictures; other studies only write tables.
        group: heading under which the list of studies shows this one.
        quick, full: approximate duration in seconds, with the option --quick and without it.
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
    """Return name -> `Study` for all studies, sorted by group.

    The group "Benchmarks" is included only in a clone of the repository, which has the folder `.ci/benchmarks`.
    """
    catalogue = {}
    for group, group_studies in STUDY_GROUPS.items():
        for name, durations in group_studies.items():
            folder = BENCHMARKS_FOLDER if group == "Benchmarks" else STUDIES_FOLDER
            syntax_tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
            functions = {node.name: node for node in syntax_tree.body if isinstance(node, ast.FunctionDef)}
            run, summary = functions["run"], (ast.get_docstring(syntax_tree) or "").partition("\n")[0]
            options = {option.arg: _option_args(option, ast.get_docstring(run) or "") for option in run.args.kwonlyargs}
            catalogue[name] = Study(name, summary, options, "draw" in functions, group, *durations)
    return catalogue


def _option_args(argument: ast.arg, text: str) -> OptionArguments:
    """Return the arguments of argparse's `add_argument`, name -> value, for one option of a study.

    Args:
        argument: syntax tree of the keyword argument of the study's function `run` that the option sets. Its annotation
            is `bool`, `Sequence[float]` (thicknesses) or `Literal[...]` (allowed values).
        text: docstring of `run`. In its section "Args", the first line about the keyword argument becomes the help of
            the option.
    """
    help_match = re.search(rf"^\s+{argument.arg}: (.*)$", text, re.MULTILINE)
    help_argument = {"help": help_match[1].replace("%", "%%") if help_match else None}
    annotation = ast.unparse(argument.annotation) if argument.annotation else ""
    if annotation == "bool":
        return {**help_argument, "action": "store_true"}
    if annotation == "Sequence[float]":
        return {**help_argument, "nargs": "+", "type": float, "metavar": "E"}
    choices = tuple(ast.literal_eval(annotation.removeprefix("Literal")))
    help_text = f"{help_argument['help'] or ''} Allowed: {', '.join(map(str, choices))}."
    return {"help": help_text, "choices": choices, "type": type(choices[0]), "metavar": argument.arg.upper()}


def list_text() -> str:
    """Return the list of studies as a text: headings, and below them the name, durations and summary of each study.

    Lines have at most 80 columns. Benchmarks are left out.
    """
    lines = dict[str, None]()  # each heading once
    for study in (study for study in studies().values() if study.group != "Benchmarks"):
        lines[study.group] = None
        lines[f"  {study.name:<20} {duration_text(study.full):>6}, quick {duration_text(study.quick)}"] = None
        lines[fill(study.summary, 80, initial_indent=" " * 4, subsequent_indent=" " * 4)] = None
    return "\n".join(lines)


def duration_text(seconds: float) -> str:
    """Return a text for a time in `seconds`, as "3 min": one significant digit, and the unit h, min or s."""
    unit = next(unit for unit, size in SECONDS_OF_UNIT.items() if seconds >= 1.5 * size or size == 1)
    return f"{float(f'{seconds / SECONDS_OF_UNIT[unit]:.1g}'):g} {unit}"
