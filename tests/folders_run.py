"""Errors of files, caught by a script, are the same on all ranks."""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path

from mpi4py import MPI

from tests.viscous_joints import interface
from thinlayer import Table, fields, march, plotting, sweep
from thinlayer.running.record import Record

COMM = MPI.COMM_WORLD
FULL_FROM = [0.15]  # time
ROW = {"eps": 0.2, "error_traction": 0.2, "error_jump": 0.1}


def attempts(folder: Path):
    """What touches files, on a folder that is none."""
    model, bad = interface(), folder / "file" / "x"
    table, state = Table([ROW, ROW | {"eps": 0.1}]), march(model, [0.1], keep="last").last
    yield lambda: march(model, [0.1], out=bad)
    yield lambda: sweep(lambda e: ROW, [0.2], out=bad / "t.csv")
    yield lambda: table.write(bad)
    yield lambda: Table(path=bad).append(ROW)
    yield lambda: Table.load(bad)
    yield lambda: plotting.rates(table, save=bad)
    yield lambda: plotting.rates(bad)
    yield lambda: plotting.deformed(state, save=bad)
    yield lambda: fields.write(state, bad.with_suffix(".pvd"))
    yield lambda: Record("s", bad, {}).__enter__()
    yield lambda: Record("s", bad, {}).close()
    yield lambda: Record("s", bad, {}).load("table.csv")
    yield lambda: sweep(lambda e: ROW, [0.2], out=folder / "t.csv", resume=True)


def full_disk(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def time(state):
    if state.t > FULL_FROM[0]:
        os.fsync = full_disk
    return state.t


OBSERVE = {"time": time}


def fills_up(folder: Path):
    """A disk that is full from some moment on."""
    fsync, model = os.fsync, interface()

    def run(e):
        if e < 0.2:
            os.fsync = full_disk
        return ROW | {"eps": e}

    for attempt in (
        lambda: march(model, [0.1, 0.2], out=folder / "march", observe=OBSERVE),
        lambda: sweep(run, [0.4, 0.2, 0.1], out=folder / "sweep.csv"),
    ):
        yield attempt
        os.fsync = fsync


def raised(attempt) -> str:
    try:
        attempt()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "nothing"


def same_errors(folder: Path) -> None:
    """Raise AssertionError unless all ranks have the same error at each attempt."""
    assert sys.excepthook is sys.__excepthook__
    if COMM.rank == 0:
        (folder / "file").write_text("")
        (folder / "t.csv").write_text("a,b\n1,2\n")
    COMM.barrier()
    for make in (attempts, fills_up):
        for attempt in make(folder):
            found = COMM.allgather(raised(attempt))
            assert len(set(found)) == 1, found
            assert "nothing" not in found
            assert make is attempts or "No space" in found[0], found
    FULL_FROM[0] = 1.0
    assert len(march(interface(), [0.1, 0.2, 0.3], out=folder / "march", observe=OBSERVE, resume=True)) == 4
