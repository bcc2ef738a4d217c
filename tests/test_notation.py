"""A symbol has one meaning: those of each page are in the table of the notation, or in its row of that page alone."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from tests.documents import PAGES

DOCS = "thinlayer/docs/"
NOTATION = DOCS + "reference/notation.md"
OPERATORS = re.compile(
    r"bar|cdot|circ|cos|cot|dot|exp|frac|ge|in|int|infty|langle|le|left|log|lvert|max|min|nabla|otimes|parallel|partial|pi|pm|"
    r"propto|q?quad|rangle|right|rvert|sin|sqrt|sum|sym|tan|tfrac|times|to"
)


def symbols(text: str) -> set[str]:
    """Letters of the formulas of a text, without their indices' words."""
    text = re.sub(r"```.*?```|`[^`]*`|^    .*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    formulas = " ".join(re.findall(r"\$\$?(.*?)\$\$?", text, re.DOTALL))
    formulas = re.sub(r"\\mathrm\{[^}]*\}", "", formulas)
    words = re.findall(r"\\mathbb C|\\bar\s*\{?e|\\[A-Za-z]+|[A-Za-z]", formulas)
    return {re.sub(r"\\bar.*", "\\\\bar e", word) for word in words if not OPERATORS.fullmatch(word.lstrip("\\"))}


def test_symbols_have_one_meaning():
    everywhere, _, there = PAGES[NOTATION].partition("Further symbols of single pages:")
    common_symbols = symbols(everywhere)
    page_symbols: dict[str, set[str]] = {}
    for pages, meanings in re.findall(r"^\| (\[.*?) \| (.*) \|$", there, re.MULTILINE):
        for path in re.findall(r"\]\(\.\./(.*?)\)", pages):
            page_symbols[DOCS + path] = symbols(meanings)
            defined = symbols(" ".join(re.findall(r"((?:\$[^$]+\$(?:, )?)+):", meanings)))
            assert not defined & common_symbols, path
    for page, text in PAGES.items():
        if PurePosixPath(page).suffix == ".md" and page != NOTATION:
            assert not (more := symbols(text) - common_symbols - page_symbols.get(page, set())), (page, more)
