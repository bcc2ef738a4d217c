"""Only the same march is resumed; a march that was killed ends with the table of one that was left alone."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from forms import KelvinVoigt, LinearElastic
from forms.base import InputError
from tests import marching_run
from tests.mpirun import CLONE, Ended, Ending, clean, mpirun
from tests.on_ranks import alone, on_ranks
from tests.refused import refused
from tests.viscous_joints import JOINT, PULL, SETUP, SLOW, SUDDEN, interface
from thinlayer import Structure, ThinLayer, march

pytestmark = pytest.mark.few(5)
TIMES = [0.1, 0.2]


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of bodies softer than the layer
def test_another_structure_is_not_resumed_and_not_overwritten(tmp_path):
    data, layer = SETUP | {"tractions": PULL}, ThinLayer(SLOW, 0.1, at=1.0)
    march(Structure(JOINT, **data).interface(layer), [0.1], out=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for change, what in [
        (dict(body=LinearElastic.young(1.0, 0.3)), "bodies"),
        (dict(body_force=(0.0, 1.0)), "loads"),
        (dict(supports=SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.01 * t * (x[1] + 0.5)}}), "supports"),
        (dict(joint=replace(JOINT, facets=JOINT.facets | {"LEFT": JOINT.facets["RIGHT"]})), "facets.LEFT"),
        (dict(joint=JOINT.swapped()), "seams.S"),
        (dict(layer=ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.2 * x[0], at=1.0)), "layers.S.profile"),
        (dict(layer=ThinLayer(SUDDEN, 0.1, at=1.0)), "law.S.*KelvinVoigt there, .*Maxwell here"),
    ]:
        other_layer, joint = change.pop("layer", layer), change.pop("joint", JOINT)
        other, words = Structure(joint, **data | change).interface(other_layer), "there, .* here.* give another folder"
        for resume in (True, False):
            refused(InputError, rf"another march \({what}.* {words}", march, other, TIMES, out=tmp_path, resume=resume)
    original, words = Structure(JOINT, **data).interface(layer), r"start: 0\.0 there, -1\.0 here"
    refused(InputError, words, march, original, TIMES, out=tmp_path, resume=True, start=-1.0)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    same = KelvinVoigt(np.float64(60.0), 40, theta_lmbda=0.3, theta_mu=0.5)
    again = Structure(JOINT, **data).interface(ThinLayer(same, 0.1, at=1.0))
    assert len(march(again, TIMES, out=tmp_path, resume=True)) == 3


def test_times_that_a_resumed_march_has_passed(tmp_path):
    """A row for them there will never be; times may be negative."""
    march(interface(), [-2.8, -2.6], start=-3.0, out=tmp_path)
    history = march(interface(), [-2.7, -2.6, -2.5], start=-3.0, out=tmp_path, resume=True)
    assert history.t == pytest.approx([-3.0, -2.8, -2.6, -2.5])
    with pytest.raises(InputError, match=r"is at t = -2\.5, and is to end before, at t = -2\.8"):
        march(interface(), [-2.8], start=-3.0, out=tmp_path, resume=True)


def test_only_the_same_march_is_resumed(tmp_path):
    march(interface(), [0.1, 0.2], out=tmp_path)
    first = (tmp_path / "table.csv").read_text()
    longer = march(interface(), [0.1, 0.2, 0.3], out=tmp_path, resume=True)
    assert (tmp_path / "table.csv").read_text().startswith(first)
    assert len(longer) == 4
    assert [state.t for state in longer] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert len(march(interface(), [0.1], out=tmp_path)) == 2
    assert len(list((tmp_path / "states").iterdir())) == 2


# ---------------------------------------------------------------- killed
THREE = ["meshed", "series", "space"]


def tables(out: Path) -> dict[str, np.ndarray]:
    records = {path.parent.name: np.genfromtxt(path, delimiter=",", names=True) for path in out.glob("*/table.csv")}
    columns = ("t", "dt", "supplied", "stored", "dissipated", "of_bodies")
    return {name: np.array([table[column] for column in columns]) for name, table in records.items()}


@cache
def undisturbed(name: str) -> np.ndarray:
    """The table of a march that was left alone."""
    with TemporaryDirectory() as out:
        marching_run.run(Path(out), [name])
        return tables(Path(out))[name]


def require_undisturbed(out: Path, names) -> None:
    """The tables are those of marches that were left alone."""
    runs = tables(out)
    assert sorted(runs) == sorted(names)
    for name, table in runs.items():  # where a path is nearly singular residuals of 1e-10 of the forces count for more
        near = {"rel": 1e-7, "abs": 1e-9} if name in ("kinked", "damaged") else {"rel": 1e-9, "abs": 1e-13}
        assert table == pytest.approx(undisturbed(name), **near), name


@pytest.mark.parametrize("name", marching_run.MARCHES)
def test_ended_and_resumed(tmp_path, name):
    """Amid its steps, or as it writes the files of one: every march goes on as if it had been left alone."""
    refused(Ended, "", marching_run.run, tmp_path, [name], ending=Ending(4, writing=len(name) % 2 == 0, raises=True))
    marching_run.run(tmp_path, [name], resume=True)
    require_undisturbed(tmp_path, [name])


def resumed_march(folder: Path) -> None:
    """The second of three marches is killed on one rank in a step; all ranks go on."""

    def killed() -> None:
        words = [sys.executable, "-m", "tests.marching_run", str(folder), "10", "stepping", *THREE]
        assert subprocess.run(words, env=clean(), cwd=CLONE, timeout=240).returncode == -signal.SIGKILL

    alone(killed)
    marching_run.run(folder, THREE, resume=True)


@on_ranks(resumed_march, 2)
def test_killed_on_one_rank_and_resumed_on_two(there, their_folder):
    require_undisturbed(their_folder, THREE)


@pytest.mark.long
def test_killed_on_two_ranks_and_resumed_on_one(tmp_path):
    """As it writes the files of the fourth march."""
    done = mpirun(2, "-m", "tests.marching_run", str(tmp_path), "22", "writing", *marching_run.MARCHES)
    assert done.returncode != 0
    assert len(tables(tmp_path)) == 4, done.stderr
    marching_run.run(tmp_path, resume=True)
    require_undisturbed(tmp_path, marching_run.MARCHES)
