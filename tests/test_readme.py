"""Scripts of the README and its guide run as printed and print what is printed; links, pictures and studies exist."""

from __future__ import annotations

import math
import re
import runpy
import shlex
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import pyvista

from forms import LinearElastic
from geometry import sandwich
from studies.tubes import lame
from tests.documents import CLONE, DOCUMENT, GUIDE, OWN, PAGES, anchors
from tests.pictures import assert_drawn
from thinlayer import ArcLength, Structure, Surface, ThinLayer, compare, march, solve
from thinlayer.describing.case import Case
from thinlayer.describing.description import KEYS, Description
from thinlayer.describing.source import OF_MESH, OPTIONS, PLAIN, Source
from thinlayer.running.arguments import command_line
from thinlayer.running.asked import Asked
from thinlayer.running.catalogue import studies
from thinlayer.running.cli import main

SCRIPTS = re.findall(r"```python\n(.*?)```", DOCUMENT.partition(OWN)[0], re.DOTALL)


@pytest.mark.parametrize("number", [0, 1], ids=["lap", "creep"])
def test_script(tmp_path, number):
    tables = re.findall(r"^ +eps +error_traction.*?\n\n", DOCUMENT, re.DOTALL | re.MULTILINE)
    assert len(SCRIPTS) == len(tables) + 7 == 9
    (tmp_path / "script.py").write_text(SCRIPTS[number])
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    wanted = [[float(x) for x in line.split()] for line in tables[number].splitlines()[1:] if line.strip()]
    found = [[float(x) for x in line.split()] for line in done.stdout.splitlines()[1:]]
    assert len(wanted) >= 3
    for a, b in zip(found, wanted, strict=True):
        assert a == pytest.approx(b, rel=2e-2)  # another gmsh may mesh a little differently
    assert {path.name for path in tmp_path.glob("*.png")} == ({"lap.png", "rates.png"} if number == 0 else set())


@pytest.fixture
def printed_by(tmp_path, monkeypatch, capsys):
    """Runs the document's script of a number, in a folder of its own; what it prints."""

    def run(number):
        monkeypatch.chdir(tmp_path)
        Path("script.py").write_text(SCRIPTS[number])
        runpy.run_path("script.py", run_name="__main__")
        return capsys.readouterr().out

    return run


def test_loads_script(printed_by):
    out = printed_by(5)
    assert "".join(f"    {line}\n" for line in out.splitlines()) in DOCUMENT


def test_estimate_script(printed_by):
    out = printed_by(8)
    assert "".join(f"    {line}\n" for line in out.splitlines()) in DOCUMENT


def test_network_script(printed_by):
    out = printed_by(6)
    assert f"    {out.strip()}\n" in DOCUMENT


def test_contact_script(printed_by):
    out = printed_by(2)
    for line in out.splitlines()[:-1]:
        assert line.strip() in DOCUMENT
    assert re.search(r"normal force 1938\.9, equilibrium \S*e-1\d", out)
    assert_drawn(Path("contact.png"))


def test_snap_script(printed_by):
    """All at once; 2 MPa and 0.5 MPa at which the foam falls and comes back, over the largest and the least pressure."""
    printed = re.findall(r"^ {4}(at [\d.]+ MPa: .*)", DOCUMENT, re.MULTILINE)
    found, wanted = (
        [[float(x) for x in re.findall(r"\d+\.\d+", line)] for line in lines]
        for lines in (printed_by(4).splitlines(), printed)
    )
    assert np.array(found) == pytest.approx(np.array(wanted), rel=1e-2)  # another gmsh may mesh a little differently
    up, down = found
    assert 2 / 1.2 < up[0] < 2 < 2 / 0.8
    assert 0.5 / 1.2 < down[0] < 0.5 / 0.8
    assert (up[0] - down[0]) * 200 * 5 * 1.5 / 20 == pytest.approx(up[1] + down[1], rel=5e-3)  # area of the loop


def test_limit_script(printed_by):
    """The joint carries what the formula says: C cos(Omega) - t_N sin(Omega)."""
    found, printed = (
        [float(x) for x in re.findall(r"-?\d+\.\d+", line)]
        for line in (printed_by(3), next(line for line in DOCUMENT.splitlines() if line.startswith("    carries ")))
    )
    assert found == pytest.approx(printed, abs=2e-3)
    t_N, angle = found[3], math.radians(35)
    assert found[0] == pytest.approx(0.2 * math.cos(angle) - t_N * math.sin(angle), rel=2e-3)


def test_results_script(printed_by):
    """What is printed, and files that can be read."""
    out = printed_by(7)
    wanted = PAGES["thinlayer/guide/results.md"].partition("![")[0].splitlines()
    numbers = re.compile(r"-?\d+\.\d+")
    for line in out.splitlines():
        (printed,) = (one for one in wanted if numbers.sub("", one).split() == numbers.sub("", line).split())
        found, there = ([float(x) for x in numbers.findall(one)] for one in (line, printed))
        assert found == pytest.approx(there, rel=1e-2)  # another gmsh may mesh a little differently
    for name in ("wall.pvd", "wall.gif", "along.png"):
        assert Path(name).stat().st_size > 300, name
    state = pyvista.get_reader("wall.pvd")
    assert (state.time_values[0], state.time_values[-1]) == (0, 1)  # of adaptive steps
    assert state.read()[0].keys() == ["bodies", "S"]


def test_estimate_command(tmp_path, capsys):
    """The description is the file, the command prints what is printed, and a mesh of the layer gives what is said."""
    text = (CLONE / "studies/data/lap.toml").read_text()
    assert f"```toml\n{text}```" in PAGES["README.md"]
    (command,) = re.findall(
        r"^    \./fenicsx python3 -m thinlayer (estimate .*--tolerance.*)$", PAGES["README.md"], re.MULTILINE
    )
    _, path, *options = command.split()
    assert main(["estimate", str(CLONE / path), *options, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out.partition("\nwritten to")[0].rstrip()
    assert "\n".join(f"    {line}".rstrip() for line in printed.splitlines()) in PAGES["README.md"]
    given = Case.of(Description.of(Source.read(CLONE / path).section()))
    full, limit = (solve(make(given.layer)) for make in (given.structure.full, given.structure.interface))
    row = compare(full, limit, where=lambda x: abs(x[0] - 12.5) < 12.5 - 0.9)
    work = [state.energies()["loads"] for state in (full, limit)]
    said = re.search(r"errors are\s(\S+) % in traction, (\S+) % in jump and\s(\S+) % in compliance", PAGES["README.md"])
    true = (row["error_traction"], row["error_jump"], 1 - work[1] / work[0])
    assert tuple(f"{100 * one:.2g}" for one in true) == said.groups()


def test_commands_of_the_guide(tmp_path):
    """Each is accepted; those for the shipped lap joint say the same as its description; the one in Python runs."""
    page = PAGES["thinlayer/guide/estimate.md"]
    lines = page.replace("\\\n", " ")
    commands = re.findall(r"^    \./fenicsx python3 -m thinlayer (estimate studies/.*)$", lines, re.MULTILINE)
    asked = [
        Asked.of(
            command_line().parse_args([str(CLONE / word) if word.startswith("studies/") else word for word in words])
        )
        for words in map(shlex.split, commands)
    ]
    file = Description.of(Source.read(CLONE / "studies/data/lap.toml").section())
    assert len(asked) == 2
    assert asked[1].description.layer[None].law == file.layer[None].law
    assert asked[1].description.supports == file.supports
    assert asked[1].description.tractions == file.tractions
    assert asked[1].description.mesh == file.mesh
    script = page[page.index("    from forms import") :].partition("\n\n`")[0]
    (tmp_path / "pressed.py").write_text(textwrap.dedent(script).replace("tolerance = 0.05", ""))
    assert main(["estimate", str(tmp_path / "pressed.py"), "--out", str(tmp_path / "out")]) == 0
    assert set(re.findall(r"--([A-Za-z][\w-]*)", page)) - {"out"} == {*OPTIONS, *PLAIN, *OF_MESH, "bonded"}
    table = page.partition("| Key |")[2].partition("\n\n")[0]
    first = [line.split("|")[1] for line in table.splitlines()[2:]]
    assert [key for cell in first for key in re.findall(r"`(\w+)`", cell)] == [
        *("mesh", "units", "body", "layer", "supports", "tractions", "loads", "body_force", "plane", "element"),
        *("bodies", "times", "goals", "tolerance", "bonded"),
    ]
    assert len(KEYS) == sum(cell.count("`") // 2 for cell in first)


def test_scripts_are_short():
    first, second, *_ = SCRIPTS
    assert len([line for line in first.splitlines() if line.strip()]) <= 20
    law = second[second.index("@dataclass") : second.index("steel =")]
    assert len([line for line in law.splitlines() if line.strip()]) <= 17


def test_laws_of_the_documentation_work():
    """Each in a joint that is loaded step by step, with the values their text says."""
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", (CLONE / "forms" / "README.md").read_text(), re.DOTALL):
        exec(block, own := {})
        names = own | names  # the first of a name
    state, steel, glue = (names[name] for name in ("state", "steel", "glue"))
    closed = lame((6.0, 11.9, 12.1, 18.0), (steel, glue, steel), (None, None), 50.0).displacement(0, 6.0)
    assert state.energies()["loads"] / (2 * math.pi * 6 * 8 * 50) == pytest.approx(closed, rel=1e-3)
    assert closed == pytest.approx(2.33e-3, abs=5e-6)
    assert names["history"].tractions[-1] == pytest.approx([0.3 * math.cos(math.pi / 6) + 0.5, -1.0], rel=1e-3)
    body, pull = LinearElastic.young(100.0, 0.3), {"TOP": lambda x, t: (t, 0.0)}
    supports = {"BOTTOM": 0.0, "LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
    joint = sandwich(1.0, 0.5, 0.5, 0.5)
    slips = {}
    for name, law in {
        "Hardening": names["Hardening"](k=20.0, c=5.0),
        "Mises": names["Mises"](kappa=80.0, mu=20.0, limit=0.6),
        "Cohesive": names["Cohesive"](k=20.0, w_0=1.0),
    }.items():
        layer = law if law.traits.of_jumps else ThinLayer(law, 0.05)
        model = Structure(joint, body=body, supports=supports, tractions=pull).interface(layer)
        surface = Surface(model)
        slip = {"slip": lambda state, s=surface: s.integral(s.jump(state)[0])}
        times = ArcLength(end=0.4, first=0.2) if law.traits.softens else [0.2, 0.4]
        slips[name] = march(model, times, observe=slip).table["slip"]
    w = slips["Hardening"][-1]
    assert 20.0 * w + 5.0 * w**3 / 4 == pytest.approx(0.4, rel=1e-8)
    assert slips["Mises"] == pytest.approx([0.0, 0.01, 0.02], rel=1e-8, abs=1e-12)  # elastic up to 0.6/sqrt 2
    w = slips["Cohesive"][-1]
    assert 20.0 * w * math.exp(-(w**2)) == pytest.approx(0.4, rel=1e-8)
    without_lmbda = (
        solve(names["panel"].interface(ThinLayer(law, 0.05, order=1))).energies()["loads"]
        for law in (names["Stiffened"](0.0, 30.0), LinearElastic(0.0, 30.0))
    )
    assert next(without_lmbda) == pytest.approx(next(without_lmbda), rel=1e-10)
    full, graded = names["full"], names["graded"]
    limits = (solve(names["panel"].interface(ThinLayer(graded, 0.05, order))) for order in (0, 1))
    assert [compare(full, one)["error_jump"] for one in limits] == pytest.approx([4.05e-3, 1.72e-4], rel=3e-3)


def test_links_lead_somewhere():
    """Pages, pictures, files and headings; the README has all pages of the guide."""
    others = (
        "forms/README.md",
        "forms/which_law.md",
        "geometry/README.md",
        "geometry/networks.md",
        "studies/ensembles.md",
    )
    texts = PAGES | {name: (CLONE / name).read_text() for name in (*others, "CONTRIBUTING.md")}
    for name, text in texts.items():
        for path, anchor in re.findall(r"\]\(([\w/.]*)(?:#([\w-]+))?\)", text):
            target = (CLONE / name).parent / path if path else CLONE / name
            assert target.is_file(), (name, path)
            assert not anchor or anchor in anchors(target.read_text()), (name, path, anchor)
    assert sorted(path.stem for path in (CLONE / "thinlayer/guide").iterdir()) == sorted(GUIDE)
    assert all(f"](thinlayer/guide/{page}.md)" in PAGES["README.md"] for page in GUIDE)


def test_every_study_has_its_row():
    rows = re.findall(r"^\|.*\| `(\w+)` \| `\./fenicsx python3 -m thinlayer run (\w+)", DOCUMENT, re.MULTILINE)
    assert sorted(a for a, _ in rows) == sorted(studies())
    assert all(a == b for a, b in rows)
