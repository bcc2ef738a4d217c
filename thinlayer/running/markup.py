"""Conversion to HTML of text with `code`, **emphasis**, [links](to) and formulas, such as $\\bar\\mu [u_T]$.

A formula is a small part of TeX. It may have letters, numbers, \\bar and \\dot over a letter, and the symbols listed in
studies/data/signs.toml. Indices _ and exponents ^ consist of one symbol, or of a group in braces that contains no other
group.
"""

from __future__ import annotations

import html
import re
import tomllib
from pathlib import Path

from forms.base import InputError

DATA_FOLDER = Path(__file__).parents[2] / "studies" / "data"  # data of the paper's page, and names of signs
SIGNS_FILE = DATA_FOLDER / "signs.toml"
SIGN_ENTITIES: dict[str, str] = tomllib.loads(SIGNS_FILE.read_text(encoding="utf-8"))
ACCENTS = {"bar": "\u0304", "dot": "\u0307"}
MARKUP_PATTERN = re.compile(r"\$([^$]+)\$|`([^`]+)`|\*\*([^*]+)\*\*|\[([^\]]+)\]\(([^)\s]+)\)")


def paragraphs_html(text: str) -> str:
    """Convert a text to HTML, each of its paragraphs to an element <p>; empty lines separate paragraphs.

    Raises:
        InputError: a formula has an unknown symbol or a group within a group.
    """
    return "".join(f"<p>{line_html(paragraph)}</p>" for paragraph in re.split(r"\n\s*\n", text.strip()))


def line_html(text: str) -> str:
    """Convert a text to HTML without an element <p> around it, for use within a line.

    Raises:
        InputError: a formula has an unknown symbol or a group within a group.
    """

    def element_html(match: re.Match[str]) -> str:
        formula, code, strong, label, link = match.groups()
        if formula:
            return f'<span class="formula">{formula_html(html.unescape(formula))}</span>'
        if link:
            return f'<a href="{link}">{line_html(html.unescape(label))}</a>'
        return f"<code>{code}</code>" if code else f"<strong>{strong}</strong>"

    return MARKUP_PATTERN.sub(element_html, html.escape(text))


def formula_html(tex: str) -> str:
    """Convert a formula in TeX, without its dollar signs, to HTML.

    Raises:
        InputError: the formula has an unknown symbol or a group within a group.
    """

    def sign_html(match: re.Match[str]) -> str:
        text = SIGN_ENTITIES.get(match[1][1:], match[1]) if match[1][0] == "\\" else match[1]
        return f"<i>{text}{match[2]}</i>" if len(text) == 1 and text.isalpha() else text

    result = re.sub(r"\\(bar|dot)\s*\{?(\\[a-z]+|\w)\}?", lambda match: match[2] + ACCENTS[match[1]], html.escape(tex))
    result = re.sub(r"(\\[A-Za-z]+|\\.|&\w+;|[A-Za-z-])([\u0304\u0307]?)", sign_html, result.replace("-", "\\-"))
    for marker, tag in (("_", "sub"), (r"\^", "sup")):
        result = re.sub(rf"{marker}(?:\{{([^{{}}]*)\}}|(<i>.*?</i>|.))", rf"<{tag}>\1\2</{tag}>", result)
    if m := re.search(r"[\\{}]\w*", result):
        raise InputError(f"the formula {tex!r} has {m[0]!r}, neither a name of {SIGNS_FILE} nor a group without groups")
    return result
