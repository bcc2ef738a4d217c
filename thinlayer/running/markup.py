"""HTML without scripts from text with `code`, **stress**, [links](to) and formulas in dollars, as $\\bar\\mu [u_T]$.

A formula has letters, numbers, \\bar and \\dot of a letter, and the names of studies/data/signs.toml. It also has _ and
^ of one sign or of a group {without groups}. This is a part of TeX, so that other programs can typeset the same text.
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
    """Paragraphs of text as HTML; InputError: a formula has other content than described above."""
    return "".join(f"<p>{line_of(part)}</p>" for part in re.split(r"\n\s*\n", text.strip()))


def line_of(text: str) -> str:
    """Text within a line as HTML; raises as `html_of`."""

    def marked(match: re.Match[str]) -> str:
        formula, code, stress, label, link = match.groups()
        if formula:
            return f'<span class="formula">{formula_of(html.unescape(formula))}</span>'
        if link:
            return f'<a href="{link}">{line_of(html.unescape(label))}</a>'
        return f"<code>{code}</code>" if code else f"<strong>{stress}</strong>"

    return MARKUP_PATTERN.sub(marked, html.escape(text))


def formula_of(tex: str) -> str:
    """A formula as HTML; raises as `html_of`."""

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
