"""Studies and errors under mpirun; ranks that are told different things."""

from __future__ import annotations

import functools
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from forms import KelvinVoigt, LinearElastic
from geometry import sandwich
from tests.folders_run import raised
from tests.on_ranks import on_ranks
from tests.pictures import assert_drawn
from tests.ranks import mpirun
from tests.test_cli import thinlayer
from thinlayer import Structure, ThinLayer, compare, fields, march, solve, sweep
from thinlayer.running.cli import main

JOINT = sandwich(1.0, 0.5, 0.5, 0.5)
SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}
BODY = LinearElastic.young(100.0, 0.3)
SLOW = KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5)


def model(eps=0.1, law=SLOW, profile=None, build=Structure.interface, **change):
    data = {"body": BODY, "supports": SUPPORTS, "tractions": {"TOP": (0.0, 1.0)}}
    return build(Structure(JOINT, **data | change), ThinLayer(law, eps, profile=profile, at=1.0))


def turned(given, rank):
    return dict(reversed(given.items())) if rank else given


def in_another_order(rank: int) -> None:
    """That of tractions, bodies and what is observed: columns have that of rank 0."""
    tractions = turned({"TOP": (0.0, 1.0), "RIGHT": lambda x, t: (0.2 * t, -0.1)}, rank)
    observe = turned({"one": lambda state: 2 * state.t, "other": lambda state: -state.t}, rank)
    body = turned(dict.fromkeys(JOINT.bodies, BODY), rank)
    table = march(model(body=body, tractions=tractions), [0.3], observe=observe).table
    assert table.columns[-2:] == ["one", "other"]
    assert table["one"].tolist() == [0.0, 0.6]
    assert table["other"].tolist() == [0.0, -0.3]


class Load:
    """A load with a value that is computed when it is first asked for."""

    @functools.cached_property
    def size(self):
        return 1.5

    def __call__(self, x, t):
        return (0.0, self.size * t)


def asked(rank: int) -> Load:
    load = Load()
    if rank:
        assert load.size > 0
    return load


def cases(rank: int, folder: Path):
    """Name -> what is done on a rank."""
    elastic, other, good = model(law=LinearElastic(60.0, 40.0)), model(law=LinearElastic(50.0, 40.0)), model()
    state = solve(elastic)
    full = solve(model(build=Structure.full, law=LinearElastic(60.0, 40.0)))
    order = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"y": 0.1}}
    factor = 1.0 + rank
    return {
        "thickness": lambda: model(0.1 + 0.2 * rank),
        "law": lambda: model(law=LinearElastic(60.0 + rank, 40.0)),
        "body": lambda: model(body=LinearElastic.young(100.0 + rank, 0.3)),
        "tractions": lambda: model(tractions={"TOP": (0.0, 1.0 + 0.5 * rank)}),
        "a load that is no number": lambda: model(tractions={"TOP": (0.0, math.nan if rank else 1.0)}),
        "a function that fails": lambda: model(tractions={"TOP": lambda x, t: (0.0, 1.0 / (1 - rank))}),
        "supports": lambda: model(supports=SUPPORTS | {"RIGHT": {"y": 0.3 * rank}}),
        "fewer supports": lambda: model(supports=dict([*SUPPORTS.items()][: 2 - rank])),
        "order of supports": lambda: model(supports=turned(order, rank)),
        "order of others": lambda: in_another_order(rank),
        "cached values": lambda: model(tractions={"TOP": asked(rank)}),
        "what a load refers to": lambda: model(tractions={"TOP": lambda x, t: (0.0, factor * t)}),
        "element": lambda: model(element="P7" if rank else "P2"),
        "option": lambda: model(build=functools.partial(Structure.full, cells_through=2 + rank)),
        "wrong option": lambda: model(build=functools.partial(Structure.full, bodies="keep" if rank else "kept")),
        "kind of model": lambda: model(build=Structure.full if rank else Structure.interface),
        "no model": lambda: solve(None if rank else elastic),
        "t": lambda: solve(elastic, 0.5 * rank),
        "models": lambda: solve(other if rank else elastic),
        "method": lambda: solve(elastic, method="newton" if rank else "linear"),
        "options": lambda: solve(elastic, options={"ksp_type": "cg"} if rank else {}),
        "times": lambda: march(good, [0.1, 0.2 + 0.1 * rank]),
        "bad times": lambda: march(good, [0.2, 0.1] if rank else [0.1, 0.2]),
        "theta": lambda: march(good, [0.1], theta=1 - 0.5 * rank),
        "observe": lambda: march(good, [0.1], observe={} if rank else {"one": lambda state: 1.0}),
        "observed": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 + rank}),
        "out": lambda: march(good, [0.1], out=folder / f"{rank}"),
        "sweep": lambda: sweep(lambda e: {"eps": e, "error_traction": e, "error_jump": e}, [0.2, 0.1][: 2 - rank]),
        "run": lambda: sweep(lambda e: {"eps": e / (1 - rank), "error_traction": e, "error_jump": e}, [0.2, 0.1]),
        "where": lambda: compare(full, state, where=lambda x: x[0] > 0.25 + 0.5 * rank),
        "bad where": lambda: compare(full, state, where=lambda x: x[0] > 0.5 / (1 - rank)),
        "profile": lambda: model(profile=lambda x: np.where((x[0] > 0.5) & (rank == 1), math.nan, 1.0)),
        "observed by one": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 / (1 - rank)}),
        "path": lambda: fields.write(state, folder / f"{rank}.pvd"),
        "ending": lambda: fields.write(state, folder / ("a.txt" if rank else "a.pvd")),
    }


def errors(folder: Path) -> dict[str, str | list[str]]:
    """Case -> the error that all ranks have, or those that they have."""
    found: dict[str, str | list[str]] = {}
    for name, run in cases(COMM.rank, folder).items():
        texts = COMM.allgather(raised(run))
        found[name] = texts[0] if len(set(texts)) == 1 else texts
    return found


COMM = MPI.COMM_WORLD


@pytest.mark.long
def test_study_on_two_ranks(tmp_path):
    words = ["run", "rates", "--law", "elastic", "--quick", "--eps", "0.1", "0.05", "--out"]
    done = mpirun(2, "-m", "thinlayer", *words, str(tmp_path / "two"))
    assert done.returncode == 0, done.stderr
    assert main([*words, str(tmp_path / "one")]) == 0
    assert done.stdout.count("error_traction") == 1
    texts = [(tmp_path / name / "table_elastic.csv").read_text().splitlines() for name in ("two", "one")]
    assert texts[0][0] == texts[1][0]
    for a, b in zip(texts[0][1:], texts[1][1:], strict=True):
        assert [float(x) for x in a.split(",") if x] == pytest.approx([float(x) for x in b.split(",") if x], rel=1e-9)
    assert json.loads((tmp_path / "two" / "run.json").read_text())["ranks"] == 2
    assert_drawn(tmp_path / "two" / "deformed_elastic.png")


def bad_input(folder: Path) -> list[list]:
    """Status and errors of each rank."""
    done = thinlayer("run", "rates", "--law", "extended", "--eps", "3", "--out", folder / "x")
    return COMM.allgather([done.returncode, done.stderr])


@pytest.mark.long
@on_ranks(bad_input, 2)
def test_bad_input_on_two_ranks(there, their_folder):
    status, said = zip(*there, strict=True)
    assert status == (2, 2)
    assert "".join(said).count("turn inside out") == 1
    assert not (their_folder / "x").exists()


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
    "where": "different where",
    "bad where": "rank 1: where is no numpy function of coordinates.*division by zero",
    "profile": "rank 1: the thickness profile is nan at .*it must be > 0 on S",
    "observed by one": r"observe\['one'\] at t = 0: rank 1: ZeroDivisionError",
    "path": "different path",
    "ending": "rank 1: cannot write .*allowed endings",
}


@on_ranks(errors, 2)
def test_ranks_that_are_told_different_things(there):
    """All have the same error, and none waits."""
    assert there.keys() == DIFFERENT.keys()
    for name, message in DIFFERENT.items():
        said = f"InputError: .*{message}" if message else "nothing"
        assert re.match(said, str(there[name])), (name, there[name])


# ---------------------------------------------------------------- programs that end
MARCH = """
import sys, time, thinlayer.system.ranks
from tests.viscous_joints import interface
from thinlayer import march, sweep
from mpi4py import MPI
COMM = MPI.COMM_WORLD
"""


@pytest.mark.long
def test_an_error_of_one_rank_ends_all(tmp_path):
    """A file that only rank 0 writes, and cannot: the other rank must not wait for it."""
    (tmp_path / "file").write_text("")
    row, out = "{'eps': e, 'error_traction': e, 'error_jump': e}", str(tmp_path / "file" / "table.csv")
    done = mpirun(2, "-c", f"{MARCH}sweep(lambda e: {row}, [0.2, 0.1], out={out!r})\nCOMM.Barrier()")
    assert done.returncode != 0
    assert "FileExistsError" in done.stderr or "NotADirectoryError" in done.stderr


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("ending", "status", "said"),
    [
        ("if COMM.rank == 1: raise RuntimeError('one alone')", 1, ["one alone"]),
        ("if COMM.rank == 1: sys.exit(3)", 3, []),
        ("time.sleep(COMM.rank / 2); raise RuntimeError(f'on {COMM.rank}')", 1, ["on 0", "on 1"]),
    ],
    ids=["an error of one", "a status of one", "an error of all"],
)
def test_what_ends_a_rank_after_a_solve_ends_all(ending, status, said):
    """PETSc, which has started by then, ends before mpi4py and waits for the other rank; the first does not cut it off."""
    done = mpirun(2, "-c", f"{MARCH}march(interface(), [0.1])\nprint('solved')\n{ending}\nCOMM.Barrier()")
    assert done.returncode == status
    assert "solved" in done.stdout
    assert ("RuntimeError" in done.stderr) == bool(said)
    for text in said:
        assert f"RuntimeError: {text}" in done.stderr


@pytest.mark.long
def test_an_error_of_one_rank_where_others_wait_for_it():
    """A user's function fails on one rank; the other one waits in a collective call that it would come to."""
    done = mpirun(
        2,
        "-c",
        f"{MARCH}thinlayer.system.ranks.PATIENCE = 0.3\n"
        "def observed(state):\n"
        "    if COMM.rank == 1: raise ValueError('one alone')\n"
        "    return COMM.allreduce(1.0)\n"
        "try: march(interface(), [0.1], observe={'one': observed})\n"
        "except Exception: pass\n",
    )
    assert done.returncode == 1
    assert "ValueError: one alone" in done.stderr
    assert "Rank 1 has had this error for " in done.stderr
    assert "they may wait for this rank in a collective call. All ranks are ended." in done.stderr


def fails_beside_a_model() -> list[str]:
    """A run that fails on one rank, where the other one builds a model."""

    def run(e):
        if COMM.rank == 1:
            raise ValueError("one alone")
        march(model(), [0.1])

    return COMM.allgather(raised(lambda: sweep(run, [0.2, 0.1])))


@pytest.mark.long
@on_ranks(fails_beside_a_model, 2)
def test_an_error_of_one_rank_where_others_build_a_model(there):
    """They learn of it there, and all ranks go on together."""
    assert there == ["InputError: rank 1: one alone", "ValueError: one alone"]
