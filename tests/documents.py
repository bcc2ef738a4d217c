"""Pages of the documents, their blocks of code by section, and what they say that these print."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

CLONE = Path(__file__).parent.parent
DOCS = CLONE / "thinlayer/docs"
FILES = [CLONE / "README.md", CLONE / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
PAGES = {path.relative_to(CLONE).as_posix(): path.read_text() for path in FILES if "generated" not in path.parts}
BLOCK = re.compile(r"^```(\{code-cell\} )?(\w+)\n(.*?)^```\n(.*?)(?=^```|^#|\Z)", re.DOTALL | re.MULTILINE)
NOTEBOOK = "---\nfile_format: mystnb\n"  # head of a page whose cells the site runs
INDENTED = re.compile(r"^ {4} *\S.*\n(?:(?: {4}.*)?\n)*", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """Code between fences, and the indented text below, which shows what it prints; None: the site shows it."""

    language: str
    line: int  # of the fence
    code: str
    shown: str | None


def anchors(text: str) -> list[str]:
    """Names by which links refer to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]


def sections() -> dict[str, list[Block]]:
    """Blocks by page and heading; a notebook is one script."""
    blocks = defaultdict(list)
    for page, text in PAGES.items():
        for block in BLOCK.finditer(text):
            cell, language, code, rest = block.groups()
            shown = INDENTED.search(rest)
            line = text.count("\n", 0, block.start()) + 1
            below = dedent(shown[0]) if shown else None if cell else ""
            name = page if text.startswith(NOTEBOOK) else f"{page}#{anchors(text[: block.start()])[-1]}"
            code = re.sub(r"^:", "#", code, flags=re.MULTILINE)  # options of a cell
            blocks[name].append(Block(language, line, code, below))
    return blocks


def names_of_checks() -> list[re.Pattern[str]]:
    """The longer texts in the code of studies, among them the names of their checks; values in them are any text."""
    texts = []
    for node in (node for path in (CLONE / "studies").glob("*.py") for node in ast.walk(ast.parse(path.read_text()))):
        parts = node.values if isinstance(node, ast.JoinedStr) else [node] if isinstance(node, ast.Constant) else []
        words = [str(part.value) if isinstance(part, ast.Constant) else "" for part in parts]
        if sum(map(len, words)) > 8:
            texts.append(re.compile("".join(re.escape(word) or ".+" for word in words)))
    return texts
