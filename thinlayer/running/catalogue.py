"""The studies and their options, read from the source of the studies without importing it."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Study:
    """A study script.

    Attributes:
        name: module name in `studies`.
        summary: first line of its docstring.
        options: name of a keyword argument of its `run` -> arguments of `ArgumentParser.add_argument` for it.
        drawn: whether it has pictures, which its `draw` makes of its tables; benchmarks have tables alone.
    """

    name: str
    summary: str
    options: dict[str, dict[str, Any]]
    drawn: bool


@cache
def studies() -> dict[str, Study]:
    """All studies by name."""
    found = {}
    for path in sorted((Path(__file__).parents[2] / "studies").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        if run := functions.get("run"):
            text, summary = ast.get_docstring(run) or "", (ast.get_docstring(tree) or "").partition("\n")[0]
            options = {one.arg: _option(one, text) for one in run.args.kwonlyargs}
            found[path.stem] = Study(path.stem, summary, options, "draw" in functions)
    return found


def _option(argument: ast.arg, text: str) -> dict[str, Any]:
    """Arguments of `add_argument` for a keyword argument of `run`.

    Args:
        argument: the keyword argument; its annotation is `bool`, `Sequence[float]` (thicknesses) or `Literal[...]`.
        text: docstring of `run`, in which its description becomes the help of the option.
    """
    line = re.search(rf"^\s+{argument.arg}: (.*)$", text, re.MULTILINE)
    found: dict[str, Any] = {"help": line[1].replace("%", "%%") if line else None}
    match ast.unparse(argument.annotation) if argument.annotation else "":
        case "bool":
            return found | {"action": "store_true"}
        case "Sequence[float]":
            return found | {"nargs": "+", "type": float, "metavar": "E"}
        case kind:
            allowed = tuple(ast.literal_eval(kind.removeprefix("Literal")))
            return found | {"choices": allowed, "type": type(allowed[0])}
