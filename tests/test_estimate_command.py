"""python3 -m thinlayer estimate: what it prints and writes, and its exit status."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from mpi4py import MPI

from tests import lap_files
from tests.on_ranks import alone, on_ranks
from tests.pictures import assert_drawn
from tests.test_cli import rows, thinlayer
from thinlayer import estimate, solve
from thinlayer.estimating import goals
from thinlayer.files.table import hash_of

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
    return {
        (row["instead"], row["quantity"]): [float(row[key] or "nan") for key in ("value", "better", "error")]
        for row in rows(path)
    }


def test_description_and_script_agree(lap, wanted, tmp_path):
    done = thinlayer("estimate", lap, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = numbers(tmp_path / "out" / "estimate.csv")
    assert [*found] == [("law", name) for name in ("traction", "jump", "compliance", "pull")]
    for row, name in zip(wanted.table.rows, ("traction", "jump", "compliance", "pull"), strict=True):
        expected = [row[key] for key in ("value", "better", "error")]
        assert found["law", name] == pytest.approx(expected, rel=1e-8, nan_ok=True)
    for sentence in wanted.sentences:
        assert sentence.replace(PULL, "pull") in done.stdout
    assert done.stdout.startswith("lengths in mm, stresses in MPa\nMay you drop the layer's mesh")
    assert f"written to {tmp_path / 'out'}" in done.stdout
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["parameters"]["files"] == {str(path): hash_of(path) for path in (lap.with_suffix(".msh"), lap)}
    assert run["parameters"]["description"]["layer"] == {"E": 3e3, "nu": 0.35, "eps": 0.4}
    assert (run["study"], run["error"]) == ("estimate", None)
    assert len(run["solves"]) == 2
    for name in ("map_law_compliance.png", "map_law_pull.png"):
        assert_drawn(tmp_path / "out" / name)


def test_words_and_description_agree(lap, wanted, tmp_path):
    """The same structure in words alone; of another glue the numbers differ."""
    words = [
        "--S", "GLUE", "--upper", "UPPER", "--body", "LOWER: E=200e3 nu=0.3", "--body", "UPPER: E=70e3 nu=0.2",
        "--support", "RIGHT/LOWER=0", "--support", "LEFT/UPPER y=0.001", "--load", "LEFT/UPPER=-60,5",
    ]  # fmt: skip
    mesh = lap.with_suffix(".msh")
    done = thinlayer("estimate", mesh, *words, "--layer", "E=3e3 nu=0.35 eps=0.4", "--out", tmp_path / "a")
    assert done.returncode == 0, done.stderr
    expected = wanted.goals["compliance"]
    found = numbers(tmp_path / "a" / "estimate.csv")
    assert found["law", "compliance"][:2] == pytest.approx([expected.value, expected.better], rel=1e-8)
    softer = thinlayer("estimate", lap, "--layer", "E=2e3", "--out", tmp_path / "a")
    assert softer.returncode == 0, softer.stderr
    other = numbers(tmp_path / "a" / "estimate.csv")
    assert abs(other["law", "compliance"][0] / expected.value - 1) > 1e-3
    earlier = numbers(tmp_path / "a" / "previous-1" / "estimate.csv")
    assert earlier["law", "compliance"] == found["law", "compliance"]


def test_bonded(lap, wanted, tmp_path):
    """May the glue be ignored: the better law is the same, what it is compared with is not."""
    done = thinlayer("estimate", lap, "--bonded", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    found, bonded = numbers(tmp_path / "estimate.csv"), solve(lap_files.structure().bonded())
    assert found["bond", "compliance"][0] == pytest.approx(goals.Compliance().value(bonded, bonded.model), rel=1e-8)
    assert found["bond", "compliance"][1] == pytest.approx(found["law", "compliance"][1], rel=1e-8)
    assert found["bond", "compliance"][2] > 3 * found["law", "compliance"][2]
    assert math.isnan(found["bond", "jump"][2])
    assert "May you ignore the layer altogether" in done.stdout


def test_tolerance(lap, tmp_path):
    """The thickness at which the change is as large as allowed, found once more by an estimate there."""
    done = thinlayer("estimate", lap, "--tolerance", "0.05", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    (row,) = rows(tmp_path / "out" / "thin_enough.csv")
    assert row["quantity"] == "traction"
    state = solve(lap_files.structure().interface(lap_files.layer(float(row["eps"]))))
    assert estimate(state).traction == pytest.approx(0.05, rel=0.05)
    assert "the layer's mesh may be dropped: at most 5 % in traction" in done.stdout


def test_times(lap, tmp_path):
    """A layer that creeps under constant loads: marched, not solved."""
    law = "KelvinVoigt E=3e3 nu=0.35 eps=0.4 theta_lmbda=1 theta_mu=2"
    refused = thinlayer("estimate", lap, "--layer", law, "--out", tmp_path / "out")
    assert refused.returncode == 2
    assert "times is missing: KelvinVoigt depends on the rate of strains" in refused.stderr
    (tmp_path / "lap.toml").write_text(f"times = [1, 4]\n{lap.read_text()}")
    done = thinlayer(
        "estimate", lap.with_suffix(".msh"), tmp_path / "lap.toml", "--layer", law, "--out", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    assert len(json.loads((tmp_path / "out" / "run.json").read_text())["solves"]) == 4


def test_loads_that_grow(lap, tmp_path):
    """A layer with a memory that stays elastic: at the end of a history the numbers are those of the elastic layer."""
    grown = lap.read_text().replace("[-60, 5]", "{times = [0, 3], values = [[0, 0], [-60, 5]]}").replace("0.001", "0")
    (tmp_path / "lap.toml").write_text(f"times = [1, 3]\n{grown}")
    law = "VonMises E=9e3 nu=0.35 eps=0.4 strength=1e4"
    mesh = lap.with_suffix(".msh")
    done = thinlayer("estimate", mesh, tmp_path / "lap.toml", "--layer", law, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = numbers(tmp_path / "out" / "estimate.csv")
    at_once = thinlayer("estimate", lap, "--layer", law, "--support", "LEFT/UPPER y=0", "--out", tmp_path / "at once")
    assert at_once.returncode == 0, at_once.stderr
    wanted = numbers(tmp_path / "at once" / "estimate.csv")
    for name in ("compliance", "pull"):
        assert found["law", name] == pytest.approx(wanted["law", name], rel=1e-6)
    assert_drawn(tmp_path / "out" / "map_law_compliance.png")


PYTHON = """
from tests import lap_files
from thinlayer.estimating import goals

structure = lap_files.structure()
layer = lap_files.layer()
goals = [goals.Compliance(), goals.Reaction("LEFT", (0, 1))]
"""


def test_python_description(wanted, tmp_path):
    (tmp_path / "lap.py").write_text(PYTHON)
    done = thinlayer("estimate", tmp_path / "lap.py", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = numbers(tmp_path / "out" / "estimate.csv")
    expected = wanted.goals[PULL]
    assert found["law", PULL][:2] == pytest.approx([expected.value, expected.better], rel=1e-8)
    files = json.loads((tmp_path / "out" / "run.json").read_text())["parameters"]["files"]
    assert files == {str(tmp_path / "lap.py"): hash_of(tmp_path / "lap.py")}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("structure = 3", "lap.py does not define layer: a ThinLayer, or {name of a seam: ThinLayer}"),
        ("structure = layer = 3", "lap.py: structure is 3; it must be a Structure"),
        ("\nstructure = a", "lap.py, line 2: NameError: name 'a' is not defined"),
        ("structure = (", "lap.py, line 1: '(' was never closed"),
        (PYTHON + "goals = 3", "lap.py: goals is 3; it must be a list of goals, such as goals.Compliance()"),
        (PYTHON + "goals = [3]", "lap.py: goals is [3]; it must be a list of goals"),
        (PYTHON + "tolerance = {'jmp': 1}", "lap.py: tolerance: unknown quantity 'jmp', did you mean 'jump'?"),
        (PYTHON + "tolerance = 0", "lap.py: tolerance.traction: 0 is not > 0; it is the largest"),
        (PYTHON + "units = 3", "lap.py: units: 3 is no text"),
        (PYTHON + "layer = 3", "the layer is 3; give ThinLayer(law, eps)"),
    ],
)
def test_python_descriptions_refused(tmp_path, text, message):
    (tmp_path / "lap.py").write_text(text)
    done = thinlayer("estimate", tmp_path / "lap.py", "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--support", "LFT=0"), "--support 'LFT=0': unknown set of facets 'LFT', did you mean 'LEFT'?; known: LEFT"),
        (("--support", "LEFT/LOW=0"), "--support 'LEFT/LOW=0': unknown part of 'LEFT' 'LOW', did you mean 'LOWER'?"),
        (("--support", "S=0"), "--support 'S=0': 'S' is where the layer is; name another set of facets"),
        (("--support", "(1,2,3) y=0"), "--support '(1,2,3) y=0': [1.0, 2.0, 3.0] has 3 components; the mesh has 2 dim"),
        (("--support", "LEFT z=0"), "--support 'LEFT z=0': unknown component 'z'; known: n, x, y"),
        (("--load", "TOP=0,1"), "--load 'TOP=0,1': unknown set of facets 'TOP'; known: LEFT, RIGHT"),
        (("--load", "LEFT=0,1,2"), "--load 'LEFT=0,1,2': [0.0, 1.0, 2.0] has 3 components; the mesh has 2 dimensions"),
        (("--load", "(0,1)=0,1 body=UP"), "--load '(0,1)=0,1 body=UP': body: unknown region 'UP'"),
        (("--load", "(0,0.1)=0,1"), "no mesh vertex at (0.0, 0.1); the nearest is (0, 0)"),
        (("--body-force", "LOW=0,1"), "--body-force 'LOW=0,1': unknown region or seam 'LOW', did you mean 'LOWER'?"),
        (("--body-force", "0,1,2"), "--body-force '0,1,2': [0.0, 1.0, 2.0] has 3 components"),
        (("--body", "LOW: E=1 nu=0"), "unknown region 'LOW', did you mean 'LOWER'?; known: LOWER, UPPER"),
        (("--layer", "BED: E=1 nu=0 eps=1"), "--layer 'BED: E=1 nu=0 eps=1': unknown seam 'BED'; known: S"),
        (("--goal", "reaction place=BACK direction=1,0"), "place: unknown support 'BACK'; known: LEFT, LEFT/UPPER"),
        (("--goal", "mean_traction direction=1,0,0"), "direction: [1.0, 0.0, 0.0] has 3 components"),
        (("--goal", "mean_traction direction=1,0 seam=T"), "seam: unknown seam 'T'; known: S"),
        (("--element", "P2"), "--element: P2 is not for quadrilateral cells; allowed: Q2, S2"),
        (("--S", "GLEU"), "unknown set of facets 'GLEU', did you mean 'GLUE'?"),
        (("--upper", "UPPR"), "unknown region 'UPPR', did you mean 'UPPER'?"),
        (("--units", "mm"), "--units: 'mm' are not two units"),
        (("other.msh",), "other.msh: there is no such file"),
        (("tests",), "tests: this is a folder, not a file"),
        (("--layer", "eps=1e-300"), "1e-300; allowed beside bodies of "),
        (("--fast",), "unrecognized argument '--fast'; PETSc options start with -thinlayer_"),
        (("-thinlayer_ksp_typ", "cg"), "not read by the linear solver: -thinlayer_ksp_typ"),
    ],
)
def test_bad_input_writes_nothing(lap, tmp_path, given, message):
    done = thinlayer("estimate", lap, *given, "--out", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert not (tmp_path / "out").exists()
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_in_a_description_is_no_mesh(lap, tmp_path):
    (tmp_path / "lap.msh").mkdir()
    (tmp_path / "lap.toml").write_text(lap.read_text())
    done = thinlayer("estimate", tmp_path / "lap.toml", "--out", tmp_path / "out")
    assert (done.returncode, (tmp_path / "out").exists()) == (2, False)
    assert "this is a folder, not a file" in done.stderr


def test_a_layer_that_relaxes_without_times_is_told_at_once(lap, tmp_path):
    given = ("--layer", "Maxwell E=3e3 nu=0.35 eps=0.4 t1=2.0")
    at_once = thinlayer("estimate", lap, *given, "--out", tmp_path / "out")
    assert at_once.returncode == 0, at_once.stderr
    assert "at t = 0+" in at_once.stdout


def test_solve_that_fails(lap, tmp_path):
    """Of a linear solver that may take five steps."""
    options = ("-thinlayer_ksp_type", "cg", "-thinlayer_pc_type", "jacobi", "-thinlayer_ksp_max_it", "5")
    done = thinlayer("estimate", lap, "--out", tmp_path, *options)
    assert done.returncode == 3
    assert "DIVERGED_MAX_IT" in done.stderr
    assert "--resume" not in done.stderr
    assert "DIVERGED_MAX_IT" in json.loads((tmp_path / "run.json").read_text())["error"]


def commands(folder: Path) -> list[list[list]]:
    """Status, output and errors of the command on each rank: as it should be, with a load and with a law that are wrong."""
    alone(lambda: lap_files.save(folder))
    lap, found = folder / "lap.toml", []
    for out, words in {"right": (), "load": ("--load", "TOP=1,0"), "law": ("--layer", "nuu=1")}.items():
        done = thinlayer("estimate", lap, *words, "--out", folder / out)
        found.append(COMM.allgather([done.returncode, done.stdout, done.stderr]))
    return found


@pytest.mark.long
@on_ranks(commands, 2)
def test_two_ranks(wanted, there, their_folder):
    for ranks, expected, stream, text in zip(
        there,
        (0, 2, 2),
        (1, 2, 2),
        ("May you drop", "unknown set of facets 'TOP'", "unknown key of LinearElastic 'nuu'"),
        strict=True,
    ):
        assert [one[0] for one in ranks] == [expected] * 2, ranks
        assert "".join(one[stream] for one in ranks).count(text) == 1  # told by one rank
    assert not (their_folder / "load").exists()
    assert not (their_folder / "law").exists()
    found = numbers(their_folder / "right" / "estimate.csv")
    assert found["law", "traction"][2] == pytest.approx(wanted.traction, rel=1e-8)
    for name, one in zip(("compliance", "pull"), wanted.goals.values(), strict=True):
        assert found["law", name][:2] == pytest.approx([one.value, one.better], rel=1e-9)
