"""The studies that exist and the options each takes, read from their source without importing them."""

from __future__ import annotations

import ast
import importlib.util
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Study:
    """A study script.

    Attributes:
        name: module name in `studies`.
        summary: first line of its docstring.
        options: names of the keyword arguments of its `run`.
    """

    name: str
    summary: str
    options: tuple[str, ...]


def studies() -> dict[str, Study]:
    """All studies by name."""
    spec = importlib.util.find_spec("studies")
    if spec is None or not spec.submodule_search_locations:
        raise FileNotFoundError("the folder 'studies' is not next to the package 'thinlayer'; run from a clone")
    folder = Path(next(iter(spec.submodule_search_locations)))
    found = {}
    for path in sorted(folder.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name == "run":
                options = tuple(argument.arg for argument in node.args.kwonlyargs)
                summary = (ast.get_docstring(tree) or "").partition("\n")[0]
                found[path.stem] = Study(path.stem, summary, options)
    return found
