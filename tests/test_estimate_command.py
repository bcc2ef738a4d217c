"""python3 -m thinlayer estimate: what it prints and writes, and its exit status."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests import lap_files
from tests.meshes import NAMES as NAMES_OF_SQUARES
from tests.meshes import squares
from tests.on_ranks import alone, on_ranks
from tests.pictures import assert_drawn
from tests.refused import refused
from tests.test_cli import rows, thinlayer
from thinlayer import Inertia, Surface, estimate, modes, solve
from thinlayer.estimating import goals
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Description
from thinlayer.running.toml_table import DescriptionError
from thinlayer.system.folder import file_hash

LAP = Path(__file__).parent.parent / "studies/data/lap.toml"
COMM = MPI.COMM_WORLD
PULL = "reaction LEFT along (0, 1)"


@pytest.fixture(scope="module")
def lap(tmp_path_factory):
    return lap_files.save(tmp_path_factory.mktemp("lap"))


@pytest.fixture(scope="module")
def wanted():
    """The estimate by a script, with a goal that has a name of its own."""
    state = solve(lap_files.structure().interface(lap_files.layer()))
    return estimate(state, goals=[goals.Compliance(), goals.Reaction("LEFT", (0, 1))])


def numbers(path):
    """(instead, quantity) -> value, better, error of a table."""
    values = lambda row: [float(row[key] or "nan") for key in ("value", "better", "error")]
    return {(row["instead"], row["quantity"]): values(row) for row in rows(path)}


def test_description_and_script_agree_and_another_glue_does_not(lap, wanted, tmp_path):
    done = thinlayer("estimate", lap, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    values = numbers(tmp_path / "out" / "estimate.csv")
    assert [*values] == [("law", name) for name in ("traction", "jump", "compliance", "pull")]
    for row, name in zip(wanted.table.rows, ("traction", "jump", "compliance", "pull"), strict=True):
        expected = [row[key] for key in ("value", "better", "error")]
        assert values["law", name] == pytest.approx(expected, rel=1e-8, nan_ok=True)
    for sentence in wanted.sentences:
        assert sentence.replace(PULL, "pull") in done.stdout
    assert done.stdout.startswith("lengths in mm, stresses in MPa\nMay you drop the layer's mesh")
    surface, density = Surface(wanted.better.model), wanted.density("compliance")
    near = np.minimum(surface.x[0], 20.0 - surface.x[0]) < 1.6
    share = 100 * surface.integral(surface.at_points(density) * near) / wanted.goals["compliance"].change
    (said,) = re.findall(r"\n  compliance: of its change (.*) % within 1.6 of the ends of S and ", done.stdout)
    assert float(said) == pytest.approx(share, rel=0.02)
    assert f"written to {tmp_path / 'out'}" in done.stdout
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["parameters"]["files"] == {str(path): file_hash(path) for path in (lap.with_suffix(".msh"), lap)}
    assert run["parameters"]["description"]["layer"] == {"E": 3e3, "nu": 0.35, "eps": 0.4}
    assert (run["study"], run["error"]) == ("estimate", None)
    assert len(run["solves"]) == 2
    for name in ("map_law_compliance.png", "map_law_pull.png"):
        assert_drawn(tmp_path / "out" / name)
    changes = ["layer.E=2e3", "layer.eigenstrain=-0.002", "bodies='extended'"]
    words = [word for change in changes for word in ("--set", change)]
    softer = thinlayer("estimate", lap, *words, "--out", tmp_path / "out")
    assert softer.returncode == 0, softer.stderr
    assert json.loads((tmp_path / "out" / "run.json").read_text())["options"] == {"set": changes}
    other, glue = numbers(tmp_path / "out" / "estimate.csv"), lap_files.layer(E=2e3, eigenstrain=-0.002)
    state = solve(lap_files.structure().interface(glue, bodies="extended"))
    expected = goals.Reaction("LEFT", (0, 1)).value(state, state.model)
    assert other["law", "pull"][0] == pytest.approx(expected, rel=1e-8)
    assert other["law", "pull"][0] != pytest.approx(values["law", "pull"][0], rel=1e-3)
    assert numbers(tmp_path / "out" / "previous-1" / "estimate.csv")["law", "compliance"] == values["law", "compliance"]


def test_a_goal_of_another_name_is_of_its_kind(lap, wanted):
    """As what is known of it depends on that."""
    compliance, pull = DescribedCase.from_description(Description.read(lap)).goals
    assert (compliance.name, pull.name) == ("compliance", "pull")
    assert isinstance(pull, goals.Reaction)
    work = DescribedCase.from_description(Description.read(lap, ["goals={work = {kind = 'compliance'}}"])).goals[0]
    assert work.name == "work"
    assert isinstance(work, goals.Compliance)
    assert work.value(wanted.state, wanted.state.model) == wanted.goals["compliance"].value


def test_bonded(lap, wanted, tmp_path):
    """May the glue be ignored: the better law is the same, what it is compared with is not.

    Names of goals that differ in their signs have pictures of their own, and a file that was there is moved away.
    """
    (tmp_path / "map_law_compliance.png").write_text("of the user")
    alike = "goals={compliance = true, 'compliance!' = {kind = 'compliance'}}"
    switches = "--set", "bonded=true", "--set", "continuum=true"
    done = thinlayer("estimate", lap, *switches, "--set", alike, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("for any mesh; ") == 4
    values, bonded = numbers(tmp_path / "estimate.csv"), solve(lap_files.structure().bonded())
    assert values["bond", "compliance"][0] == pytest.approx(goals.Compliance().value(bonded, bonded.model), rel=1e-8)
    assert values["bond", "compliance"][1] == pytest.approx(values["law", "compliance"][1], rel=1e-8)
    assert values["bond", "compliance"][2] > 3 * values["law", "compliance"][2]
    assert math.isnan(values["bond", "jump"][2])
    pictures = {f"map_{name}_compliance{end}.png" for name in ("law", "bond") for end in ("", "_")}
    assert {path.name for path in tmp_path.glob("*.png")} == pictures
    assert (tmp_path / "previous-1" / "map_law_compliance.png").read_text() == "of the user"
    assert "May you ignore the layer altogether" in done.stdout


@pytest.mark.filterwarnings("ignore:plates bend")
def test_modes(lap, tmp_path):
    """Frequencies are those of a script, and need no change of the estimate."""
    density = {"LOWER": 7.8e-9, "UPPER": 2.7e-9, "S": 1.2e-9}
    changes = ["modes=2", *(f"density.{name}={rho}" for name, rho in density.items())]
    done = thinlayer("estimate", lap, *(word for change in changes for word in ("--set", change)), "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    structure = lap_files.structure()
    structure.parts = (Inertia(density),)
    written, meshed = rows(tmp_path / "modes.csv"), modes(structure.full(lap_files.layer()), 2)
    for row, omega, law in zip(
        written, meshed.omega, modes(structure.interface(lap_files.layer()), 2).omega, strict=True
    ):
        assert [float(row[key]) for key in ("omega", "better")] == pytest.approx([law, omega], rel=1e-6)
        assert float(row["lower"]) <= omega <= float(row["upper"])
        assert sum(float(row[f"kinetic {name}"]) for name in density) == pytest.approx(1.0)
    assert "With the layer meshed, for these cells of the bodies:" in done.stdout
    for change, text in (("modes=2", "it needs density"), ("density.S=1.2e-9", "it needs modes")):
        refused(DescriptionError, text, lambda change=change: Description.read(lap, [change]))
    case = DescribedCase.from_description(Description.read(lap, changes[:-1]))
    refused(DescriptionError, "density: Inertia: the density of 'S'", lambda: case.modes(case.make_model()))


def test_tolerance(lap, tmp_path):
    """The thickness at which the change is as large as allowed, found once more by an estimate there."""
    done = thinlayer("estimate", lap, "--set", "tolerance=0.05", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (row,) = rows(tmp_path / "out" / "thin_enough.csv")
    assert row["quantity"] == "traction"
    state = solve(lap_files.structure().interface(lap_files.layer(float(row["eps"]))))
    assert estimate(state).traction == pytest.approx(0.05, rel=0.05)
    assert "the layer's mesh may be dropped: at most 5 % in traction" in done.stdout


def test_loads_that_grow(lap, tmp_path):
    """A layer with a memory that stays elastic: at the end of a history the numbers are those of the elastic layer."""
    law = "layer={law = 'VonMises', E = 9e3, nu = 0.35, eps = 0.4, strength = 1e4}"
    alike = ("estimate", lap, "--set", law, "--set", "supports.'LEFT/UPPER'.y=0")
    grown = "tractions.'LEFT/UPPER'={times = [0, 3], values = [[0, 0], [-60, 5]]}"
    done = thinlayer(*alike, "--set", "times=[1, 3]", "--set", grown, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    values = numbers(tmp_path / "out" / "estimate.csv")
    at_once = thinlayer(*alike, "--json", "--out", tmp_path / "at once")
    assert at_once.returncode == 0, at_once.stderr
    wanted = numbers(tmp_path / "at once" / "estimate.csv")
    answer = json.loads(at_once.stdout)
    assert answer == json.loads((tmp_path / "at once" / "run.json").read_text())["results"]
    assert answer["law"]["quantities"][2]["value"] == wanted["law", "compliance"][0]
    for name in ("compliance", "pull"):
        assert values["law", name] == pytest.approx(wanted["law", name], rel=1e-6)
    assert_drawn(tmp_path / "out" / "map_law_compliance.png")


def test_wrong_descriptions_write_nothing(lap, tmp_path):
    for setting, message in [
        ("supports.LFT=0", "unknown facet set 'LFT', did you mean 'LEFT'?; known: LEFT, LEFT/LAYER, "),
        ("loads=[{place = [0, 0], force = [0, 1], body = 'UP'}]", "unknown body 'UP'"),
        ("goals.pull.place=BACK", "nothing holds 'BACK'"),
        ("mesh.S=GLEU", "unknown set of facets 'GLEU', did you mean 'GLUE'?"),
        ("mesh.path=other.msh", "other.msh: the file does not exist in "),
        ("layer.eps=1e-300", "layer.eps: 1e-300; allowed in bodies of size "),
    ]:
        done = thinlayer("estimate", lap, "--set", setting, "--out", tmp_path / "out")
        assert (done.returncode, (tmp_path / "out").exists()) == (2, False), done.stderr
        assert message in done.stderr
        assert not re.search("InputError|DescriptionError|Traceback", done.stderr)


def test_a_layer_that_relaxes_without_times_is_told_at_once(lap, tmp_path):
    at_once = thinlayer("estimate", lap, "--set", "layer.law=Maxwell", "--set", "layer.t1=2", "--out", tmp_path / "out")
    assert at_once.returncode == 0, at_once.stderr
    assert "at t = 0+" in at_once.stdout


# ---------------------------------------------------------------- before anything is solved
def test_a_new_description_is_refused_until_it_is_filled_in(tmp_path, monkeypatch):
    """With the names of the mesh of the lap joint; filled in as that is, all that is read of it is the same."""
    monkeypatch.chdir(tmp_path)
    text, file = thinlayer("estimate", LAP.with_suffix(".msh"), "--new").stdout, Path("a.toml")
    for asked, filled in {
        'units = "?"': "units = 'mm, MPa'",
        'E = "?"': "E = 210e3",
        'nu = "?"': "nu = 0.3",
        'eps = "?"': "eps = 0.3",
        '"LEFT" = "?"': "LEFT = 0",
        '"RIGHT" = "?"': "RIGHT = {y = 0}",
        '"LEFT" = ["?", "?"]\n': "",
        '"RIGHT" = ["?", "?"]': "RIGHT = [60, 0]",
    }.items():
        file.write_text(text)
        refused(DescriptionError, r"not filled in|'\?'", Description.read, file)
        assert asked in text
        text = text.replace(asked, filled)
    file.write_text(text)
    glue = ("--set", "layer.E=2e3", "--set", "layer.nu=0.4")
    checked = thinlayer("estimate", file, "--check", *glue)
    assert checked.returncode == 0, checked.stderr
    assert checked.stdout == thinlayer("estimate", LAP, "--check", "--set", "goals={compliance = true}").stdout
    assert "body UPPER PLATE: law = LinearElastic, E = 210000, nu = 0.3, area = 275\n" in checked.stdout
    assert "eps = 0.3, length = 25, 100 facets, from LOWER PLATE to UPPER PLATE\n" in checked.stdout
    assert "at t = 0: force (300, 0), moment -750 about (0, 0)\n" in checked.stdout
    assert [*Path().iterdir()] == [file]


def test_several_sets_inside_have_a_layer_each(tmp_path):
    cut = squares(tmp_path / "a.msh", more=[("line", [[1, 4]], 3)], names={**NAMES_OF_SQUARES, "CUT": (3, 1)})
    text = thinlayer("estimate", cut, "--new").stdout
    assert f'mesh = {{path = "{cut}", S = {{"S" = ["LOW", "UP"], "CUT" = "?"}}}}\n' in text
    matches = re.findall(r'^(?:"(\w+)" = |\[layer."(\w+)"\])', text, re.MULTILINE)
    assert matches == [("", "S"), ("", "CUT"), ("TOP", ""), ("TOP", "")]


def test_sizes_and_loads_of_revolution(lap):
    """A disc under a traction on its rim: over the whole revolution, at the last of the times."""
    pulled = "tractions={'RIGHT/UPPER' = {times = [0, 3], values = [[0, 0], [7, 5]]}}"
    settings = ("plane=axisymmetric", pulled, "supports={'RIGHT/LOWER' = 0}", "goals={}", "times=[1, 3]")
    done = thinlayer("estimate", lap, "--check", *(word for setting in settings for word in ("--set", setting)))
    assert done.returncode == 0, done.stderr
    rim = 2 * math.pi * 20 * 4
    assert f"volume = {20 * rim / 2:.6g}\nlayer GLUE: " in done.stdout
    assert f"area = {math.pi * 20**2:.6g}, " in done.stdout
    assert f"at t = 3: force (0, {5 * rim:.6g}), moment 0 about (0, 0)\n" in done.stdout


def commands(folder: Path) -> list[list]:
    """Status, output and errors of the command on each rank: as it should be, with a load that is wrong, unsolved."""
    alone(lambda: lap_files.save(folder))
    asked = {"right": ["lap.toml"], "load": ["lap.toml", "--set", "tractions.TOP=[1, 0]"]}
    asked |= {"check": ["lap.toml", "--check"], "new": ["lap.msh", "--new"]}
    run = lambda out, file, *words: thinlayer("estimate", folder / file, *words, "--out", folder / out)
    done = [run(out, *words) for out, words in asked.items()]
    return [COMM.allgather([process.returncode, process.stdout, process.stderr]) for process in done]


@pytest.mark.long
@on_ranks(commands, 2)
def test_two_ranks(wanted, there, their_folder):
    said = ((0, 1, "May you drop"), (2, 2, "unknown facet set 'TOP'"), (0, 1, "force (-240, 20),"), (0, 1, "eps = "))
    for ranks, (expected, stream, text) in zip(there, said, strict=True):
        assert [result[0] for result in ranks] == [expected] * 2, ranks
        assert "".join(result[stream] for result in ranks).count(text) == 1  # told by one rank
    assert not (their_folder / "load").exists()
    values = numbers(their_folder / "right" / "estimate.csv")
    assert values["law", "traction"][2] == pytest.approx(wanted.traction, rel=1e-8)
    for name, goal in zip(("compliance", "pull"), wanted.goals.values(), strict=True):
        assert values["law", name][:2] == pytest.approx([goal.value, goal.better], rel=1e-9)
