"""Studies and errors under mpirun; ranks that are told different things."""

from __future__ import annotations

import gc
import re
import sys
import time
import weakref
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

import thinlayer
from forms import LinearElastic, VonMises
from studies.timing import status
from tests.folders_run import raised
from tests.mpirun import mpirun
from tests.on_ranks import on_ranks
from tests.viscous_joints import BODY, JOINT, SLOW
from thinlayer import Structure, ThinLayer, compare, estimate, fields, goals, march, solve, sweep

SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}


def model(eps=0.1, law=SLOW, profile=None, build=Structure.interface, **change):
    data = {"body": BODY, "supports": SUPPORTS, "tractions": {"TOP": (0.0, 1.0)}}
    return build(Structure(JOINT, **data | change), ThinLayer(law, eps, profile=profile, at=1.0))


def cases(rank: int, folder: Path):
    """Name -> what is done on a rank."""
    elastic, good = model(law=LinearElastic(60.0, 40.0)), model()
    state = solve(elastic)
    full = solve(model(build=Structure.full, law=LinearElastic(60.0, 40.0)))
    factor = 1.0 + rank
    return {
        "thickness": lambda: model(0.1 + 0.2 * rank),
        "law": lambda: model(law=LinearElastic(60.0 + rank, 40.0)),
        "tractions": lambda: model(tractions={"TOP": (0.0, 1.0 + 0.5 * rank)}),
        "a function that fails": lambda: model(tractions={"TOP": lambda x, t: (0.0, 1.0 / (1 - rank))}),
        "supports": lambda: model(supports=SUPPORTS | {"RIGHT": {"y": 0.3 * rank}}),
        "what a load refers to": lambda: model(tractions={"TOP": lambda x, t: (0.0, factor * t)}),
        "element": lambda: model(element="P7" if rank else "P2"),
        "options": lambda: solve(elastic, options={"ksp_type": "cg"} if rank else {}),
        "times": lambda: march(good, [0.1, 0.2 + 0.1 * rank]),
        "observed": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 + rank}),
        "run": lambda: sweep(lambda e: {"eps": e / (1 - rank), "error_traction": e, "error_jump": e}, [0.2, 0.1]),
        "where": lambda: compare(full, state, where=lambda x: x[0] > 0.25 + 0.5 * rank),
        "observed by one": lambda: march(good, [0.1], observe={"one": lambda state: 1.0 / (1 - rank)}),
        "ending": lambda: fields.write(state, folder / ("a.txt" if rank else "a.pvd")),
    }


def errors(folder: Path) -> dict[str, str | list[str]]:
    """Case -> the error that all ranks have, or those that they have."""
    messages: dict[str, str | list[str]] = {}
    for name, run in cases(COMM.rank, folder).items():
        texts = COMM.allgather(raised(run))
        messages[name] = texts[0] if len(set(texts)) == 1 else texts
    return messages


COMM = MPI.COMM_WORLD


DIFFERENT = {
    "thickness": "different layer: eps is 0.1 on rank 0, 0.3.* on rank 1; give all ranks the same",
    "law": "different layer: law.lmbda is 60.* on rank 0, 61",
    "tractions": r"different tractions: TOP\.1 is 1.0 on rank 0, 1.5",
    "a function that fails": "different tractions",
    "supports": "different supports: .*0.0.* on rank 0, .*0.3",
    "what a load refers to": r"different tractions: TOP\.factor is 1.0 on rank 0, 2.0 on rank 1",
    "element": "rank 1: element 'P7' does not exist",
    "options": "different options: .*ksp_type",
    "times": "different times",
    "observed": r"observe\['one'\] at t = 0: the ranks find 1, 2; let it return the sum, or the largest, of",
    "run": "rank 1: ZeroDivisionError",
    "where": "different where",
    "observed by one": r"observe\['one'\] at t = 0: rank 1: ZeroDivisionError",
    "ending": "rank 1: path is .*ends in .pvd",
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


ENDINGS = [
    ("if COMM.rank == 1: raise RuntimeError('one alone')", 1, ["one alone"]),
    ("if COMM.rank == 1: sys.exit(3)", 3, []),
    ("time.sleep(COMM.rank / 2); raise RuntimeError(f'on {COMM.rank}')", 1, ["on 0", "on 1"]),
]


@pytest.mark.few(5)
@pytest.mark.parametrize(("ending", "status", "said"), ENDINGS)
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
    observed = "def observed(state):\n if COMM.rank == 1: raise ValueError('one alone')\n return COMM.allreduce(1.0)\n"
    marched = "try: march(interface(), [0.1], observe={'one': observed})\nexcept Exception: pass\n"
    done = mpirun(2, "-c", f"{MARCH}thinlayer.system.ranks.MIN_WAIT_SECONDS = 0.3\n{observed}{marched}")
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


def estimated():
    state = solve(model(law=LinearElastic(60.0, 40.0)))
    return [state.model, state, estimate(state, goals=[goals.Compliance(), STRETCH])]


def marched():
    """In time, with all that varies in it, and a plate; of a load that its strength may not carry: an error."""
    law, supports = VonMises.young(60.0, 0.3, strength=0.2), {"BOTTOM": {"x": lambda x, t: 1e-3 * t * x[0], "y": 0.0}}
    plate = thinlayer.RigidPlate("TOP", force=lambda x, t: (0.1 * t, -0.3 * t), motion={"rotation": 0.0})
    yielding = model(law=law, supports=supports, tractions={}, parts=[plate])
    history = march(yielding, [0.5, 1.0])
    with pytest.raises(thinlayer.SolveError):
        solve(yielding, 40.0)
    return [yielding, history]


def family():
    first = model(law=LinearElastic(60.0, 40.0))
    other = first.with_layer(ThinLayer(LinearElastic(30.0, 20.0), 0.2))
    return [first, other, *(solve(case) for case in (first, other, other.with_loads(tractions={"TOP": (0.3, 1.0)})))]


STRETCH = goals.Functional("stretch", lambda u, model: u[0] * u[1] * model.dx)


def left(runs: int = 3) -> dict[str, list[Any]]:
    """Name -> communicators, memory and seconds after each of some runs, without Python's collector; what is there last."""
    there, usage = Counter[str](), dict[str, list[Any]]()
    key = MPI.Comm.Create_keyval(lambda *_: there.update(comms=1), lambda *_: there.subtract(comms=1))
    for comm in (COMM, MPI.COMM_SELF):
        comm.Set_attr(key, None)
    gc.disable()
    for run in (estimated, marched, family):
        rows, refs = [], list[Any]()
        for _ in range(runs):
            begin = time.perf_counter()
            refs += [weakref.ref(item) for item in run()]
            rows.append((there["comms"], status("VmRSS"), time.perf_counter() - begin))
        usage[run.__name__] = [*rows, sum(ref() is not None for ref in refs)]
    gc.enable()
    for comm in (COMM, MPI.COMM_SELF):
        comm.Delete_attr(key)
    return usage


@on_ranks(left, 2)
@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
def test_what_is_dropped_is_freed_with_its_communicators(there):
    """MPICH ends a process that has some 2,000 of them; MPI tells when one is copied or freed."""
    for name, (_, second, third, kept) in [*left().items(), *there.items()]:
        assert (third[0], kept) == (second[0], 0), name


def test_models_in_cycles_of_users_are_freed_later(monkeypatch):
    monkeypatch.setattr("geometry.domain.MESHES_PER_COLLECTION", 2)
    kept = model()
    kept.itself, gone = kept, weakref.ref(kept)
    del kept
    assert gone()
    model(), model()
    assert not gone()


if __name__ == "__main__":  # python3 -m tests.test_parallel 1000: the first and the last of so many runs
    for name, (*rows, _) in left(int(sys.argv[1])).items():
        print(name, *(f"{n} communicators, {mb:.1f} MB, {s:.3f} s" for n, mb, s in (rows[1], rows[-1])), sep="\n  ")
