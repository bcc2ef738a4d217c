"""The same numbers on 1, 2 and 3 ranks; studies and errors under mpirun."""

from __future__ import annotations

import json
import re

import pytest

from tests.parallel_norms import norms
from tests.pictures import assert_drawn
from tests.ranks import mpirun
from thinlayer.running.cli import main


@pytest.fixture(scope="module")
def serial():
    return norms()


@pytest.mark.parametrize("ranks", [2, 3])
def test_same_norms(serial, ranks):
    done = mpirun(ranks, "-m", "tests.parallel_norms")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == pytest.approx(serial, rel=1e-10)
    assert len(serial) > 30


def test_study_on_two_ranks(tmp_path):
    words = ["run", "sweep_elastic", "--quick", "--eps", "0.1", "0.05", "--out"]
    done = mpirun(2, "-m", "thinlayer", *words, str(tmp_path / "two"))
    assert done.returncode == 0, done.stderr
    assert main([*words, str(tmp_path / "one")]) == 0
    assert done.stdout.count("error_traction") == 1
    texts = [(tmp_path / name / "table.csv").read_text().splitlines() for name in ("two", "one")]
    assert texts[0][0] == texts[1][0]
    for a, b in zip(texts[0][1:], texts[1][1:], strict=True):
        assert [float(x) for x in a.split(",") if x] == pytest.approx([float(x) for x in b.split(",") if x], rel=1e-9)
    assert json.loads((tmp_path / "two" / "run.json").read_text())["ranks"] == 2
    assert_drawn(tmp_path / "two" / "deformed.png")


def test_bad_input_on_two_ranks(tmp_path):
    done = mpirun(
        2, "-m", "thinlayer", "run", "sweep_elastic", "--eps", "3", "--bodies", "extended", "--out", str(tmp_path / "x")
    )
    assert done.returncode == 2
    assert done.stderr.count("turn inside out") == 1
    assert not (tmp_path / "x").exists()


DIFFERENT = {
    "thickness": "different layer: eps is 0.1 on rank 0, 0.3.* on rank 1; give all ranks the same",
    "law": "different layer: law.lmbda is 60.* on rank 0, 61",
    "body": "different body",
    "tractions": r"different tractions: TOP\.1 is 1.0 on rank 0, 1.5",
    "a load that is no number": "different tractions: .* on rank 0, .*nan.* on rank 1",
    "a function that fails": "different tractions",
    "supports": "different supports: .*0.0.* on rank 0, .*0.3",
    "fewer supports": "different supports",
    "order of supports": "different supports",
    "order of others": None,
    "cached values": None,
    "what a load refers to": r"different tractions: TOP\.factor is 1.0 on rank 0, 2.0 on rank 1",
    "element": "rank 1: element 'P7' does not exist",
    "option": "different options: cells_through is 2.0 on rank 0, 3.0 on rank 1",
    "wrong option": "rank 1: unknown way to make room .*did you mean 'kept'",
    "kind of model": 'different model: "interface" on rank 0, "full" on rank 1',
    "no model": "rank 1: model is None",
    "t": "different t: 0.0 on rank 0, 0.5 on rank 1",
    "models": "different models",
    "method": 'different method: "linear" on rank 0, "newton" on rank 1',
    "options": "different options: .*ksp_type",
    "times": "different times",
    "bad times": "rank 1: times is .*must be finite, increase",
    "theta": "different theta: 1.0 on rank 0, 0.5 on rank 1",
    "observe": "different observe",
    "observed": r"observe\['one'\] at t = 0: the ranks find 1, 2; let the function return the sum, or the largest, of",
    "out": "different out",
    "sweep": "different eps",
    "run": "rank 1: ZeroDivisionError",
    "where": r'different where: "\(x\[0\]\) > \(0.25\)" on rank 0, "\(x\[0\]\) > \(0.75\)" on rank 1',
    "where with a constant": "different where",
    "bad where": "rank 1: where is no function of coordinates .*division by zero",
    "profile": "rank 1: the thickness profile is nan at .*it must be > 0 on S",
    "observed by one": r"observe\['one'\] at t = 0: rank 1: ZeroDivisionError",
    "path": "different path",
    "ending": "rank 1: cannot write .*allowed endings",
}


def test_ranks_that_are_told_different_things(tmp_path):
    """All have the same error, and none waits."""
    done = mpirun(2, "-m", "tests.different_ranks_run", str(tmp_path))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == DIFFERENT.keys()
    for name, message in DIFFERENT.items():
        said = f"ModelError: .*{message}" if message else "nothing"
        assert re.match(said, str(found[name])), (name, found[name])


def test_an_error_of_one_rank_ends_all(tmp_path):
    """A file that only rank 0 writes, and cannot: the other rank must not wait for it."""
    script = tmp_path / "script.py"
    (tmp_path / "file").write_text("")
    script.write_text(
        "import sys\n"
        "from thinlayer import Structure, sweep\n"
        "sweep(lambda e: {'eps': e, 'error_traction': e, 'error_jump': e}, [0.2, 0.1], out=sys.argv[1])\n"
        "from mpi4py import MPI\n"
        "MPI.COMM_WORLD.Barrier()\n"
    )
    done = mpirun(2, str(script), str(tmp_path / "file" / "table.csv"))
    assert done.returncode != 0
    assert "FileExistsError" in done.stderr or "NotADirectoryError" in done.stderr


MODEL = """
import sys
from mpi4py import MPI
import thinlayer.parallel.agreement
from forms import KelvinVoigt, LinearElastic
from geometry import sandwich
from thinlayer import Structure, ThinLayer, march, sweep

COMM, joint = MPI.COMM_WORLD, sandwich(1.0, 0.5, 0.5, 0.5)

def model():
    layer = ThinLayer(KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5), 0.1)
    body, supports = LinearElastic.young(100.0, 0.3), {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}
    return Structure(joint, body=body, supports=supports, tractions={"TOP": (0.0, 1.0)}).interface(layer)
"""


def test_an_error_of_all_ranks_is_told_by_all(tmp_path):
    """A rank that comes to its end first does not cut off the others."""
    script = tmp_path / "script.py"
    ending = "if COMM.rank == 1: time.sleep(0.5)\nraise RuntimeError(f'on {COMM.rank}')\n"
    script.write_text(f"{MODEL}\nimport time\nmarch(model(), [0.1])\n{ending}")
    done = mpirun(2, str(script))
    assert done.returncode == 1
    assert "RuntimeError: on 0" in done.stderr
    assert "RuntimeError: on 1" in done.stderr


@pytest.mark.parametrize(("ending", "status"), [("raise RuntimeError('one alone')", 1), ("sys.exit(3)", 3)])
def test_an_error_of_one_rank_after_a_solve_ends_all(tmp_path, ending, status):
    """PETSc, which has started by then, ends before mpi4py and waits for the other rank."""
    script = tmp_path / "script.py"
    script.write_text(f"{MODEL}\nmarch(model(), [0.1])\nprint('solved')\nif COMM.rank == 1: {ending}\nCOMM.Barrier()\n")
    done = mpirun(2, str(script))
    assert done.returncode == status
    assert ("RuntimeError: one alone" in done.stderr) == (status == 1)
    assert "solved" in done.stdout


def test_an_error_of_one_rank_where_others_wait_for_it(tmp_path):
    """A user's function fails on one rank; the other one waits in a collective call that it would come to."""
    script = tmp_path / "script.py"
    script.write_text(
        f"{MODEL}\n"
        "thinlayer.parallel.agreement.PATIENCE = 0.3\n"
        "def observed(state):\n"
        "    if COMM.rank == 1: raise ValueError('one alone')\n"
        "    return COMM.allreduce(1.0)\n"
        "try: march(model(), [0.1], observe={'one': observed})\n"
        "except Exception: pass\n"
    )
    done = mpirun(2, str(script))
    assert done.returncode == 1
    assert "ValueError: one alone" in done.stderr
    assert "Rank 1 has had this error for " in done.stderr
    assert "they may wait for this rank in a collective call. All ranks are ended." in done.stderr


def test_an_error_of_one_rank_where_others_build_a_model(tmp_path):
    """They learn of it there, and all ranks go on together."""
    script = tmp_path / "script.py"
    script.write_text(
        f"{MODEL}\n"
        "def run(e):\n"
        "    if COMM.rank == 1: raise ValueError('one alone')\n"
        "    march(model(), [0.1])\n"
        "found = ''\n"
        "try: sweep(run, [0.2, 0.1])\n"
        "except Exception as error: found = f'{type(error).__name__}: {error}'\n"
        "found = COMM.allgather(found)\n"
        "if COMM.rank == 0: print(found)\n"
    )
    done = mpirun(2, str(script))
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(["ModelError: rank 1: one alone", "ValueError: one alone"])
