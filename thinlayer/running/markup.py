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


def html_of(text: str) -> str:
    """Convert a text to HTML, each of its paragraphs to an element <p>; empty lines separate paragraphs.

    Raises:
        InputError: a formula has an unknown symbol or a group within a group.
    """
    return "".join(f"<p>{line_of(part)}</p>" for part in re.split(r"\n\s*\n", text.strip()))


def line_of(text: str) -> str:
    """Convert a text to HTML without an element <p> around it, for use within a line.

    Raises:
        InputError: a formula has an unknown symbol or a group within a group.
    """

    def marked(match: re.Match[str]) -> str:
        formula, code, stress, label, link = match.groups()
        if formula:
            return f'<span class="formula">{formula_of(html.unescape(formula))}</span>'
        if link:
            return f'<a href="{link}">{line_of(html.unescape(label))}</a>'
        return f"<code>{code}</code>" if code else f"<strong>{stress}</strong>"

    return MARKUP_PATTERN.sub(marked, html.escape(text))


def formula_of(tex: str) -> str:
    """Convert a formula in TeX, without its dollar signs, to HTML.

    Raises:
        InputError: the formula has an unknown symbol or a group within a group.
    """

    def sign(match: re.Match[str]) -> str:
        text = SIGN_ENTITIES.get(match[1][1:], match[1]) if match[1][0] == "\\" else match[1]
        return f"<i>{text}{match[2]}</i>" if len(text) == 1 and text.isalpha() else text

    done = re.sub(r"\\(bar|dot)\s*\{?(\\[a-z]+|\w)\}?", lambda match: match[2] + ACCENTS[match[1]], html.escape(tex))
    done = re.sub(r"(\\[A-Za-z]+|\\.|&\w+;|[A-Za-z-])([\u0304\u0307]?)", sign, done.replace("-", "\\-"))
    for raised, tag in (("_", "sub"), (r"\^", "sup")):
        done = re.sub(rf"{raised}(?:\{{([^{{}}]*)\}}|(<i>.*?</i>|.))", rf"<{tag}>\1\2</{tag}>", done)
    if m := re.search(r"[\\{}]\w*", done):
        raise InputError(f"the formula {tex!r} has {m[0]!r}, neither a name of {SIGNS_FILE} nor a group without groups")
    return done
