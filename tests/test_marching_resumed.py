"""Only the same march is resumed; a march that was killed ends with the table of one that was left alone."""

from __future__ import annotations

import signal
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from forms.laws import KelvinVoigt, LinearElastic
from tests import marching_run
from tests.ranks import CLEAN, CLONE, mpirun
from tests.viscous_joints import JOINT, PULL, SETUP, SLOW, SUDDEN, interface
from thinlayer import ModelError, RangeWarning, Structure, ThinLayer, march
from thinlayer.running.cli import main


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of bodies softer than the layer
@pytest.mark.parametrize(
    ("change", "what"),
    [
        (dict(body=LinearElastic.young(1.0, 0.3)), "bodies"),
        (dict(supports=SETUP["supports"] | {"BOTTOM": {"y": 0.01, "x": 0.0}}), "supports"),
        (dict(tractions={"TOP": (0.0, 2.0)}), "loads"),
        (dict(body_force=(0.0, 1.0)), "loads"),
        (dict(layer=ThinLayer(SLOW, 0.2)), "eps"),
        (dict(layer=ThinLayer(SUDDEN, 0.1)), "law"),
    ],
)
def test_another_structure_is_not_resumed_and_not_overwritten(tmp_path, change, what):
    data, layer = SETUP | {"tractions": PULL}, ThinLayer(SLOW, 0.1)
    march(Structure(JOINT, **data).interface(layer), [0.1], out=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    other_layer = change.pop("layer", layer)
    other = Structure(JOINT, **data | change).interface(other_layer)
    for resume in (True, False):
        with pytest.raises(ModelError, match=rf"another march \(.*{what}: .* give another folder"):
            march(other, [0.1, 0.2], out=tmp_path, resume=resume)
    with pytest.raises(ModelError, match=r"start: 0\.0 there, -1\.0 here"):
        march(Structure(JOINT, **data).interface(layer), [0.1, 0.2], out=tmp_path, resume=True, start=-1.0)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    same = KelvinVoigt(np.float64(60.0), 40, theta_lmbda=0.3, theta_mu=0.5)
    again = Structure(JOINT, **data).interface(ThinLayer(same, 0.1))
    assert len(march(again, [0.1, 0.2], out=tmp_path, resume=True)) == 3


def test_times_may_be_negative(tmp_path):
    for resume in (False, True):
        history = march(interface(), [-2.0, -1.0], start=-3.0, out=tmp_path, resume=resume)
        assert history.t == pytest.approx([-3.0, -2.0, -1.0])


def test_times_that_a_resumed_march_has_passed(tmp_path):
    """A row for them there will never be, and who asks for it is told."""
    march(interface(), [0.2, 0.4], out=tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "the step of .* is not well below a time")
        march(interface(), [0.2, 0.4, 0.5], out=tmp_path, resume=True)
    with pytest.warns(
        RangeWarning, match=r"is at t = 0\.5 and has no step that ended at t = 0\.3, which times ask for"
    ):
        history = march(interface(), [0.3, 0.5, 0.6], out=tmp_path, resume=True)
    assert history.t == pytest.approx([0.0, 0.2, 0.4, 0.5, 0.6])


def test_what_is_observed_in_another_order(tmp_path):
    observe = {"one": lambda state: 2 * state.t, "other": lambda state: -state.t}
    march(interface(), [0.2], out=tmp_path, observe=observe)
    resumed = march(interface(), [0.2, 0.3], out=tmp_path, observe=dict(reversed(observe.items())), resume=True)
    assert resumed.table["one"] == pytest.approx([0.0, 0.4, 0.6])
    assert resumed.table["other"] == pytest.approx([0.0, -0.2, -0.3])


def test_files_that_do_not_fit_together(tmp_path):
    march(interface(), [0.1, 0.2], out=tmp_path)
    with pytest.raises(ModelError, match=r"is at t = 0\.2; times end before"):
        march(interface(), [0.1], out=tmp_path, resume=True)
    states = tmp_path / "states"
    (states / "000002.npz").write_bytes((states / "000001.npz").read_bytes())
    with pytest.raises(ModelError, match="another time than row 2"):
        march(interface(), [0.3], out=tmp_path, resume=True)
    (states / "000002.npz").unlink()
    with pytest.raises(ModelError, match=r"000002\.npz cannot be read"):
        march(interface(), [0.3], out=tmp_path, resume=True)


def test_only_the_same_march_is_resumed(tmp_path):
    march(interface(), [0.1, 0.2], out=tmp_path)
    first = (tmp_path / "table.csv").read_text()
    longer = march(interface(), [0.1, 0.2, 0.3], out=tmp_path, resume=True)
    assert (tmp_path / "table.csv").read_text().startswith(first)
    assert len(longer) == 4
    with pytest.raises(
        ModelError, match=r"another march \(law: S: KelvinVoigt.*theta_mu=0.5.* there, Kelvin.*theta_mu=0.6"
    ):
        march(interface(KelvinVoigt(60.0, 40.0, 0.3, 0.6)), [0.1], out=tmp_path, resume=True)
    assert [state.t for state in longer] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    for name in ("states/000002.npz", "march.json"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:700])
        with pytest.raises(ModelError, match=f"{Path(name).name} cannot be read"):
            march(interface(), [0.1], out=tmp_path, resume=True)
    assert len(march(interface(), [0.1], out=tmp_path)) == 2
    assert len(list((tmp_path / "states").iterdir())) == 2


def run(ranks: int, *words: str) -> subprocess.CompletedProcess:
    if ranks > 1:
        return mpirun(ranks, "-m", "tests.marching_run", *words)
    command = [sys.executable, "-m", "tests.marching_run", *words]
    return subprocess.run(command, env=CLEAN | {"PYTHONPATH": str(CLONE)}, cwd=CLONE, capture_output=True, timeout=240)


def test_a_killed_study_is_resumed(tmp_path, capsys):
    """In the middle of the second thickness, on one rank; resumed on two."""
    words = ["run", "sweep_maxwell", "--quick", "--eps", "0.04", "0.02", "--out"]
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, signal, sys\n"
        "from itertools import count\n"
        "from thinlayer.solving.solvers import Solver\n"
        "from thinlayer.running.cli import main\n"
        "step, calls = Solver.step, count()\n"
        "Solver.step = lambda *a: step(*a) if next(calls) < 15 else os.kill(os.getpid(), signal.SIGKILL)\n"
        "main(sys.argv[1:])\n"
    )
    environment = CLEAN | {"PYTHONPATH": str(CLONE)}
    done = subprocess.run([sys.executable, str(script), *words, str(tmp_path / "a")], env=environment, cwd=CLONE)
    assert done.returncode == -signal.SIGKILL
    assert len((tmp_path / "a" / "table.csv").read_text().splitlines()) == 2
    assert main([w.replace("maxwell", "stack") for w in words] + [str(tmp_path / "a"), "--resume"]) == 2
    assert "is of the study sweep_maxwell, not sweep_stack" in capsys.readouterr().err
    assert main([*words[:-2], "0.01", "--out", str(tmp_path / "a"), "--resume"]) == 2
    assert "had the options" in capsys.readouterr().err
    resumed = mpirun(2, "-m", "thinlayer", *words, str(tmp_path / "a"), "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert main([*words, str(tmp_path / "b")]) == 0
    for name in ("table.csv", "table_t1.csv"):
        a, b = (np.genfromtxt(tmp_path / out / name, delimiter=",", skip_header=1) for out in "ab")
        assert a == pytest.approx(b, rel=1e-9, nan_ok=True)
    assert not (tmp_path / "a" / "unfinished").exists()


def tables(out: Path) -> dict[str, np.ndarray]:
    found = {path.parent.name: np.genfromtxt(path, delimiter=",", names=True) for path in out.glob("*/table.csv")}
    columns = ("t", "dt", "supplied", "stored", "dissipated", "energy")
    return {name: np.array([table[column] for column in columns]) for name, table in found.items()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    marching_run.main([str(out)])
    return tables(out)


@pytest.mark.parametrize(
    ("killed_on", "resumed_on", "row", "writing", "first"),
    [(1, 1, 4, False, 2), (1, 2, 10, True, 3), (2, 1, 16, False, 4), (2, 2, 22, True, 6)],
)
def test_killed_and_resumed(undisturbed, tmp_path, killed_on, resumed_on, row, writing, first):
    """A run killed with -9 in a step, or as it writes its files, ends with the table of a run that was left alone.

    The first, second, third and fourth march are killed. Later ones than the next are not disturbed by that: they run only
    with the last, on two ranks.
    """
    words = [str(tmp_path), "--first", str(first)]
    done = run(killed_on, *words, "--kill", str(row), *(["--writing"] if writing else []))
    assert done.returncode != 0
    if killed_on == 1:
        assert done.returncode == -signal.SIGKILL
    if resumed_on == 1:
        marching_run.main([*words, "--resume"])
    else:
        done = run(resumed_on, *words, "--resume")
        assert done.returncode == 0, done.stderr
    found = tables(tmp_path)
    assert len(found) == first
    assert len(undisturbed) == 6
    for name, table in found.items():
        assert table == pytest.approx(undisturbed[name], rel=1e-9, abs=1e-13), name
