"""What the pages take from the package itself, so that no page says it a second time, and formulas without a network.

`studies`: cards of the studies with pictures. `errata`: misprints of the paper. Formulas become MathML: browsers draw it.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util.docutils import SphinxDirective

from thinlayer.running.cli import studies

CLONE = Path(__file__).parents[2]


class Studies(SphinxDirective):
    """A table of the studies."""

    def run(self) -> list[nodes.Node]:
        rows = ["| Study | What it shows |", "|---|---|"]
        rows += [f"| `{one.name}` | {one.summary} |" for one in studies().values() if one.drawn]
        return self.parse_text_to_nodes("\n".join(rows))


class Errata(SphinxDirective):
    """A table of misprints."""

    def run(self) -> list[nodes.Node]:
        file = CLONE / "studies/data/paper.toml"
        if not file.exists():
            return []
        errata = tomllib.loads(file.read_text())["errata"]
        rows = ["| Equation | Printed | Right | Shown by |", "|---|---|---|---|"]
        rows += ["| {equation} | {printed} | {right} | {evidence} |".format(**one) for one in errata]
        return self.parse_text_to_nodes("\n".join(rows))


def write_formula(writer: Any, node: nodes.Element) -> None:
    """Write a formula, inline or displayed, as MathML."""
    text, block = node.astext(), isinstance(node, nodes.math_block)
    formula = tex2mathml(text, as_block=block)
    writer.body.append(f'<div class="formula">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.add_directive("studies", Studies)
    app.add_directive("errata", Errata)
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
