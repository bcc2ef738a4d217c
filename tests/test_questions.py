"""The page of questions quotes messages that exist, one of each warning; words that people search for are in headings."""

from __future__ import annotations

import re

from tests.documents import CLONE, DOCS, PAGES, anchors

SOURCES = "".join(
    path.read_text() for name in ("forms", "geometry", "thinlayer") for path in (CLONE / name).rglob("*.py")
)
QUOTES = set(re.findall(r'\*"(.+?)"\*', PAGES["thinlayer/docs/howto/questions.md"]))
WARNINGS = {  # key of a RangeWarning -> words of its message
    "bond line": "is that of a bond line of",
    "coarse ends": "falls to zero at free ends over delta",
    "curved": "the meshed layer is curved",
    "density": "the density of the change",
    "elastic share": "springs parallel to what yields",
    "end of a gap": "the load is smaller than",
    "facets": "S is curved and its facets are straight",
    "fit": "not converged after",
    "flux along": "values vary along S with errors of",
    "fracture zone": "the fracture zone of",
    "friction angle": "if it is in radians",
    "incompressible": "is incompressible:",
    "cavitation": "is a tension,",
    "insulated side": "between bodies that are held there",
    "layer time": "values even out inside",
    "lever": "plates bend about",
    "locking": "locks near 0.5",
    "negative conductivity": "fluxes run against gradients",
    "no step error": "the error of the march's steps",
    "no time": "a solve knows no time",
    "other bodies": "the load is smaller than",
    "order 0": "order 0 leaves out jumps",
    "overlap": "closes by",
    "phase": "a shear wave crosses",
    "plates": "joins plates",
    "sinks": "move its mean value",
    "softens": "there may be other",
    "split": "are split into",
    "step error": "leave estimated relative errors",
    "strains": "strains of",
    "thick": "its law is for thin layers",
    "time step": "is not well below a time of",
    "tolerance": "with the largest part near",
    "too stiff": "lets no material flow",
    "zoom": "from those of the bodies",
}
SEARCHED = {
    "howto/contact.md": "contact friction",
    "howto/from_abaqus.md": "abaqus cohesive",
    "howto/questions.md": "adhesive cite convergence damage delamination plot solder",
    "tutorials/glue_line.md": "glue",
}


def test_quoted_messages_exist():
    assert len(QUOTES) > 40
    assert [words for words in QUOTES if words not in SOURCES] == []


def test_each_warning_has_its_words_on_the_page():
    keys = {*re.findall(r'(?:warn|warn_of_range)\(\s*"([^"]+)"', SOURCES), *re.findall(r'yield "([^"]+)", f"', SOURCES)}
    assert keys == WARNINGS.keys()
    assert {*WARNINGS.values()} <= QUOTES


def test_words_that_people_search_for_are_in_headings():
    """Of all places Sphinx's search ranks these first."""
    for page, words in SEARCHED.items():
        headings = "-".join(anchors((DOCS / page).read_text())).split("-")
        assert {*words.split()} <= {*headings}, page
