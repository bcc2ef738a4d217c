"""Index pages have a row for each page; code of pages fits the site; small pictures are those of the large ones."""

from __future__ import annotations

import re
import runpy

import numpy as np
import pytest
from PIL import Image

from tests.documents import BLOCK, CLONE, DOCS, PAGES

FOLDERS = ("howto", "laws", "reference", "theory", "tutorials")
COLUMNS = 84  # that a screen of 1280 px shows
SMALL = runpy.run_path(str(CLONE / ".ci/small_pictures.py"))


@pytest.mark.parametrize("page", [f"thinlayer/docs/{folder}/index.md" for folder in FOLDERS])
def test_index_pages_have_a_row_for_each_page_in_the_order_of_the_site(page):
    folder = (CLONE / page).parent
    tree = re.search(r"^```\{toctree\}\n(?::[^\n]*\n)*(.*?)^```", PAGES[page], re.DOTALL | re.MULTILINE)[1].split()
    assert sorted(tree) == sorted(path.stem for path in folder.glob("*.md") if path.stem != "index")
    rows = re.findall(r"^\|.*?\]\((\w+)\.md\)(.*)\|$", PAGES[page], re.MULTILINE)
    assert [name for name, _ in rows] == tree
    for name, rest in rows:
        if minutes := re.search(r"\|\s*(\d+)$", rest):
            words = len((folder / f"{name}.md").read_text().split())
            assert float(minutes[1]) == pytest.approx(words / 150, rel=0.3, abs=1), (name, words)


def test_code_of_pages_fits_the_site():
    for page, text in PAGES.items():
        code = "\n".join(match[3] for match in BLOCK.finditer(text))
        for file in re.findall(r"\{literalinclude\} (\S+)", text):
            code += "\n" + ((CLONE / page).parent / file).read_text()
        assert not [line for line in code.splitlines() if len(line) > COLUMNS], page


@pytest.mark.parametrize("name", SMALL["CUTS"])
def test_small_pictures_are_cut_from_the_large_ones(name):
    """`./fenicsx python3 .ci/small_pictures.py` cuts them anew."""
    with Image.open(DOCS / f"_static/{name}.png") as picture:
        stored = np.asarray(picture.convert("RGB"), dtype=float)
    assert abs(stored - np.asarray(SMALL["cut"](name), dtype=float)).mean() < 3
