"""Blocks of all pages run as they are pasted and print what the pages say; links, pictures and studies exist."""

from __future__ import annotations

import doctest
import html
import io
import re
import runpy
import shlex
import sys
import warnings
from collections import defaultdict
from pathlib import Path

import pytest

import forms
import geometry
import thinlayer
from studies.rates import LAWS
from tests.documents import CLONE, NOTEBOOK, PAGES, Block, anchors, sections
from thinlayer import RangeWarning, compare, estimate, goals, solve
from thinlayer.running.case import DescribedCase
from thinlayer.running.cli import main, studies
from thinlayer.running.description import ENTRY_READERS, Description

SHOWN = ("tests/own_scripts/own_kernel.py", "tests/own_scripts/own_support.py")  # by pages, which do not repeat them
SECTIONS = sections() | {name: [Block("python", 1, (CLONE / name).read_text(), "")] for name in SHOWN}
DOCS = "thinlayer/docs/"
LONG = """
    howto/derivatives.md#changes-by-a-parameter-and-a-fit howto/lap_joint.md#single-lap-joint howto/many_runs.md#an-ensemble
    howto/joints_that_break.md#results howto/networks.md#networks-walls-faults-grains howto/own_law.md#jumps
    howto/own_law.md#strains howto/results.md#read-results-draw-pictures howto/time.md#time-creep-steps-restart
    howto/yielding.md#layers-and-bodies-that-yield theory/continuum.md#2--please
    tutorials/estimate.md tutorials/own_script.md
"""
LONG = {f"{DOCS}{name}" for name in LONG.split()} | {"README.md#a-question-without-a-script"}
assert SECTIONS.keys() >= LONG
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
WRITTEN = re.compile(r'(?:save=|write\(\w+, |out=)"([\w.]+)"')
LAP = CLONE / "studies/data/lap.toml"


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def assert_says(page: str, printed: str) -> None:
    """The words are the same, and numbers but for 2 %, as another gmsh may mesh a little differently."""
    assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", page).split()
    assert numbers(printed) == pytest.approx(numbers(page), rel=2e-2, abs=1e-12)


def run_script(path: Path, blocks: list) -> None:
    """Hold what each line of a section's code prints against the numbers of its comment, or the text below its block."""
    text, printed = "", defaultdict(str)
    for block in blocks:
        text += "\n" * (block.line - text.count("\n")) + block.code  # lines as in the page
    path.write_text(text)

    def capture_print(*args, **options):
        print(*args, file=(out := io.StringIO()), **options)
        printed[sys._getframe(1).f_lineno] += out.getvalue()

    with warnings.catch_warnings(record=True, action="always", category=RangeWarning) as caught:
        runpy.run_path(str(path), {"print": capture_print}, run_name="__main__")
    assert ("# warns" in text) == any(issubclass(warning.category, RangeWarning) for warning in caught)
    below = defaultdict(str)
    for line, words in printed.items():
        comment = numbers(text.splitlines()[line - 1].partition("  # ")[2])
        if comment:
            values = numbers(words)
            assert comment[: len(values)] == pytest.approx(values, rel=2e-2), f"line {line}"
        else:
            below[max((block for block in blocks if block.line < line), key=lambda block: block.line)] += words
    for block in blocks:
        if block.shown is not None:
            assert_says(block.shown, below[block])
    for name in WRITTEN.findall(text):
        assert path.with_name(name).stat().st_size > 300, name


PARAMETERS = [pytest.param(key, marks=[pytest.mark.long][: key in LONG or "/tours/" in key]) for key in SECTIONS]


@pytest.mark.parametrize("name", PARAMETERS)
def test_blocks_print_what_the_page_says(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("studies").symlink_to(CLONE / "studies")
    code = {kind: [block for block in SECTIONS[name] if block.language == kind] for kind in ("python", "sh", "toml")}
    assert sum(map(len, code.values())) == len(SECTIONS[name])
    lines = [(block, line) for block in code["sh"] for line in block.code.replace("\\\n", "").splitlines()]
    commands = [(block, shlex.split(line, comments=True)) for block, line in lines]
    if code["python"]:
        run_script(tmp_path / "script.py", code["python"])
    for block, words in commands:
        capsys.readouterr()
        assert words[:4] == ["./fenicsx", "python3", "-m", "thinlayer"]
        assert main(words[4:]) == 0
        if block.shown:
            assert_says(block.shown, capsys.readouterr().out)
    assert all(block.code == LAP.read_text() for block in code["toml"])


def test_notebooks_have_a_head_a_picture_and_exercises():
    notebooks = {name: text for name, text in PAGES.items() if "{code-cell}" in text}
    assert len(notebooks) >= 3
    for name, text in notebooks.items():
        assert text.startswith(NOTEBOOK), name
        words = ["- **Goal**: ", "- **Time**: ", "- **Difficulty**: ★", f"`{Path(name).stem}.ipynb`", "## Try this"]
        assert [word for word in [*words, "plotting."] if word not in text] == [], name


def test_the_first_scripts_are_short():
    creep = SECTIONS[f"{DOCS}howto/time.md#time-creep-steps-restart"][0].code
    law = creep[creep.index("@dataclass") : creep.index("steel =")]
    first, second = (SECTIONS[f"README.md#{name}"][0].code for name in ("thinlayer", "a-script"))
    for code, most in ((first, 10), (second, 20), (law, 17)):
        assert len([line for line in code.splitlines() if line.strip()]) <= most


def test_errors_of_the_first_example_are_those_of_a_meshed_layer():
    case = DescribedCase.from_description(Description.read(LAP))
    full, limit = (solve(make(case.layer)) for make in (case.structure.full, case.structure.interface))
    row = compare(full, limit)
    work = [state.energies()["loads"] for state in (full, limit)]
    said = re.search(r"errors are\s(\S+) % in traction, (\S+) % in jump and\s(\S+) % in compliance", PAGES["README.md"])
    true = (row["error_traction"], row["error_jump"], 1 - work[1] / work[0])
    assert tuple(f"{100 * value:.2g}" for value in true) == said.groups()
    better = estimate(limit, goals=[goals.Compliance()]).better.energies()["loads"]
    gain = re.search(r"a lap joint\s(\S+) % too small.*? within\s(\S+) %", PAGES["README.md"], re.DOTALL)
    assert gain[1] == said[3]
    assert better == pytest.approx(work[0], rel=float(gain[2]) / 100)


def test_keys_of_descriptions_are_those_of_the_guide():
    table = PAGES[f"{DOCS}reference/description.md"].partition("| Key |")[2].partition("\n\n")[0]
    keys = re.findall(r"`(\w+)`", " ".join(line.split("|")[1] for line in table.splitlines()[2:]))
    assert sorted(keys) == sorted(ENTRY_READERS)


def test_links_lead_somewhere():
    """Pages, pictures, files and headings; each law of `rates` has its row."""
    for name, text in PAGES.items():
        for path, anchor in re.findall(r"\]\(([\w/.]*)(?:#([\w-]+))?\)", text):
            target = (CLONE / name).parent / path if path else CLONE / name
            assert target.is_file(), (name, path)
            assert not anchor or anchor in anchors(target.read_text()), (name, path, anchor)
    table = PAGES[f"{DOCS}reference/studies.md"].partition("| `--law` |")[2]
    named = [law for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE) for law in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted(LAWS)
    assert studies()["rates"].options["law"]["choices"] == ("all", *LAWS)


def test_built_pages_have_the_formulas_of_their_sources():
    """As TeX, for a MathJax that lies beside them, without a script from a network."""
    built = CLONE / "out/docs"
    newer = [
        (name, page)
        for name in PAGES
        if (page := built / name.removeprefix(DOCS).replace(".md", ".html")).exists()
        and page.stat().st_mtime > (CLONE / name).stat().st_mtime
    ]
    if not newer:
        pytest.skip("./fenicsx docs builds the pages")
    for name, page in newer:
        code = re.sub(r"^```.*?^```$|`[^`]+`|^ {4}.*?$", "", PAGES[name], flags=re.DOTALL | re.MULTILINE)
        text = "".join(html.unescape(page.read_text()).split())
        formulas = ["".join(tex.strip("$").split()) for tex in re.findall(r"\$\$.+?\$\$|\$[^$]+\$", code, re.DOTALL)]
        assert [tex for tex in formulas if not re.search(rf"\\[(\[](\\begin{{split}})?{re.escape(tex)}", text)] == []
        scripts = re.findall(r'<script[^>]* src="([^"?]+)', page.read_text())
        assert not [src for src in scripts if "//" in src]
        drawn = [page.parent / src for src in scripts if "tex-svg" in src]
        assert drawn or not formulas, name
        assert all(path.stat().st_size > 1e6 for path in drawn), name


PUBLIC = {name: getattr(package, name) for package in (forms, geometry, thinlayer) for name in dir(package)}
PUBLIC |= {"fields.write": thinlayer.fields.write}
DOCTESTS = [doctest.DocTestFinder().find(value, name, globs={}) for name, value in PUBLIC.items() if callable(value)]
EXAMPLES = {test.name: test for tests in DOCTESTS for test in tests if test.examples}
assert len(EXAMPLES) >= 40  # of the names that users call most


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_docstrings_print_what_they_say(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert doctest.DocTestRunner().run(EXAMPLES[name]).failed == 0, capsys.readouterr().out
