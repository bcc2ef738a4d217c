"""How docstrings become pages of the reference: types of arguments, links, fields."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from sphinx.domains.python import PyObject
from sphinx.ext.napoleon import GoogleDocstring

from forms import LinearElastic

WORDS = tomllib.loads(Path(__file__).with_name("types.toml").read_text())
LINES_OF_CODE, CLASS_NAME, OTHER_NAMES = r"^ *(?:>>>|\.\.\.).*", r"`([A-Z]\w+(?:\.\w+)*)`", r"``?[^`]*``?"
MARKUP = re.compile("|".join([LINES_OF_CODE, CLASS_NAME, OTHER_NAMES, r"[|*]"]))


def in_words(annotation: Any) -> str:
    """Return a type as the source writes it, with words for what has a name only in the source."""
    text = re.sub(r"ClassVar\[(.*)\]", r"\1", str(getattr(annotation, "__forward_arg__", annotation)))
    text = re.sub(r"Callable\[\[.*?\], [\w.]+\]", "function", text)
    return re.sub(r"[\w.]+", lambda name: WORDS.get(name[0], name[0]), text)


def prepare(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Add types, link names of classes, and keep `|t_T|` and `a * b`, which are markup, as they are written."""
    types = getattr(obj, "__annotations__", {}) | getattr(obj.__init__, "__annotations__", {})
    for k, line in enumerate(lines):
        label = re.match(r" +\w+(, \w+)*(?=: )", line)
        hints = {types.get(argument) for argument in re.findall(r"\w+", label[0])} if label else {None}
        if label and len(hints) == 1 and hints != {None}:
            line = f"{label[0]} ({in_words(*hints)}){line[label.end() :]}"
        lines[k] = MARKUP.sub(lambda m: f":py:obj:`.{m[1]}`" if m[1] else "\\" * (m[0] in "|*") + m[0], line)
    if what in ("function", "method") and types.get("return", "None") != "None":
        end = lines.index("Example:") if "Example:" in lines else len(lines)
        lines[end:end] = ["", f":rtype: {in_words(types['return'])}", ""]


def hide_constructor(app: Any, what: str, name: str, obj: Any, options: Any, arguments: str | None, *_: Any) -> Any:
    """Leave out the arguments with which the package itself makes errors and results."""
    made = what == "exception" or (what == "class" and re.match(r"thinlayer\.(?!parts\.)\w+\.\w+\.", name))
    return ("", None) if made and arguments else None


def setup(app: Any) -> None:
    """Called by Sphinx."""
    del LinearElastic.__new__  # which only refuses wrong names; Sphinx would show its arguments
    app.connect("autodoc-process-docstring", prepare, priority=100)
    app.connect("autodoc-process-signature", hide_constructor)
    attributes = next(field for field in PyObject.doc_field_types if field.name == "variable")
    attributes.label, attributes.rolename = "Attributes", ""
    GoogleDocstring._consume_fields.__defaults__ = (True, False, True)  # "K_N, K_T: ..." are two attributes
