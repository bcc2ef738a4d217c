"""What the pages take from the package itself, so that no page says it a second time.

`studies`: cards of the studies with pictures. `errata`: misprints of the paper.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from thinlayer.running.catalogue import Study, duration_text, studies

CLONE = Path(__file__).parents[2]
IMAGE, KINDS = "![{0}](/../../studies/pictures/{0})", (".png", ".svg", ".gif")  # structures before curves and movies


def pictures(study: Study) -> list[str]:
    """Return the files of a study's pictures, the most telling ones first."""
    names = [path.name for path in (CLONE / "studies/pictures").glob(f"{study.name}*")]
    return sorted(names, key=lambda name: (KINDS.index(name[-4:]), name))


class Studies(SphinxDirective):
    """A gallery of the studies: pictures, what each shows, and how long it takes."""

    def run(self) -> list[nodes.Node]:
        gallery: list[nodes.Node] = []
        for group, members in groupby(studies().values(), lambda study: study.group):
            cards = [nodes.container("", *card) for study in members for card in self.cards(study)]
            gallery += [nodes.rubric(text=group), nodes.container("", *cards, classes=["study-cards"])]
        return gallery

    def cards(self, study: Study) -> Iterator[list[nodes.Node]]:
        """Yield a card for each structure that a study draws, or one with curves; cards link to the study's page."""
        names, to = pictures(study), f"(generated/studies/{study.name}.md)"
        times = f"{duration_text(study.full)}, with `--quick` {duration_text(study.quick)}"
        for name in [name for name in names if name.endswith(".png")] or names[:1] or [study.name]:
            image = f"[{IMAGE.format(name)}]{to}" if names else ""
            lines = f"**[{Path(name).stem}]{to}**", image, study.summary, times
            yield self.parse_text_to_nodes("\n\n".join(lines))


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
    (pages := Path(app.srcdir, "reference/generated/studies")).mkdir(parents=True, exist_ok=True)
    template = Path(app.srcdir, "_templates/study.txt").read_text()
    for study in studies().values():
        folder = ".ci/benchmarks" if study.group == "Benchmarks" else "studies"
        images = "\n\n".join(map(IMAGE.format, pictures(study)))
        (pages / f"{study.name}.md").write_text(template.format(study=study, folder=folder, images=images))
    app.add_directive("studies", Studies)
    app.add_directive("errata", Errata)
