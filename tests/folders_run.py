"""Errors of files, caught by a script, are the same on all ranks."""

from __future__ import annotations

import sys
from pathlib import Path

from mpi4py import MPI

from tests.viscous_joints import interface
from thinlayer import Table, fields, march, plotting, sweep
from thinlayer.running.record import Record

COMM = MPI.COMM_WORLD
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
    for attempt in attempts(folder):
        errors = COMM.allgather(raised(attempt))
        assert len(set(errors)) == 1, errors
        assert "nothing" not in errors
