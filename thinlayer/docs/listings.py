"""What the pages take from the package itself, so that no page says it a second time.

`studies`: cards of the studies with pictures. `errata`: misprints of the paper.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from thinlayer.running.catalogue import Study, duration_text, studies

CLONE = Path(__file__).parents[2]
PICTURES = "../../../studies/pictures/"  # from a page of the reference


class Studies(SphinxDirective):
    """A gallery of the studies: pictures, what each shows, and how long it takes."""

    def run(self) -> list[nodes.Node]:
        gallery: list[nodes.Node] = []
        for group in dict.fromkeys(study.group for study in studies().values()):
            cards = nodes.container(classes=["study-cards"])
            members = [study for study in studies().values() if study.group == group]
            cards += [nodes.container("", *self.card(study)) for study in members]
            gallery += [nodes.rubric(text=group), cards]
        return gallery

    def card(self, study: Study) -> list[nodes.Node]:
        """A study's name, picture, summary, and times."""
        drawn = sorted((CLONE / "studies/pictures").glob(f"{study.name}*.[sp][vn]g"))
        picture = "".join(f"![{study.summary}]({PICTURES}{path.name})\n\n" for path in drawn[:1])
        times = f"{duration_text(study.full)}, with `--quick` {duration_text(study.quick)}"
        return self.parse_text_to_nodes(f"**{study.name}**\n\n{picture}{study.summary}\n\n{times}")


class Errata(SphinxDirective):
    """A list of misprints."""

    def run(self) -> list[nodes.Node]:
        lines = []
        for entry in tomllib.loads((CLONE / "studies/data/paper.toml").read_text())["errata"]:
            shown = f"Shown by {entry['run']}: {entry['label']}." if "check" in entry else entry["evidence"]
            words = f"*Printed*: {entry['printed']}. *Right*: {entry['right']} *{shown}*"
            lines.append(f"- **{entry['where']}**. {words}".replace("\n", " "))
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.add_directive("studies", Studies)
    app.add_directive("errata", Errata)
