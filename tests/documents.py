"""Pages of the documents, their blocks of code by section, and what they say that these print."""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent

CLONE = Path(__file__).parent.parent
GUIDE = ("time", "contact", "yield", "snaps", "loads", "joints", "results", "estimate", "scripts", "environments")
GUIDES = {name: f"thinlayer/guide/{name}.md" for name in GUIDE}
OTHERS = (
    "forms/README.md", "forms/which_law.md", "geometry/README.md", "geometry/networks.md", "studies/ensembles.md",
    "CONTRIBUTING.md",
)  # fmt: skip
PAGES = {name: (CLONE / name).read_text() for name in ("README.md", *GUIDES.values(), *OTHERS)}
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```\n(.*?)(?=^```|^#|\Z)", re.DOTALL | re.MULTILINE)
INDENTED = re.compile(r"^ {4} *\S.*\n(?:(?: {4}.*)?\n)*", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """Code between fences, and the indented text below, which shows what it prints."""

    language: str
    line: int  # of the fence
    code: str
    shown: str


def anchors(text: str) -> list[str]:
    """Names by which links refer to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]


def sections() -> dict[str, list[Block]]:
    """Blocks by page and heading."""
    found = defaultdict(list)
    for page, text in PAGES.items():
        for block in BLOCK.finditer(text):
            language, code, rest = block.groups()
            shown = INDENTED.search(rest)
            line = text.count("\n", 0, block.start()) + 1
            below = dedent(shown[0]) if shown else ""
            found[f"{page}#{anchors(text[: block.start()])[-1]}"].append(Block(language, line, code, below))
    return found
