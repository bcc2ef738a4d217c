"""Ends all ranks if one rank alone has an error, so that the others do not wait for ever."""

from __future__ import annotations

import sys
import time
import traceback

from mpi4py import MPI

GRACE = 5.0  # s for all ranks with an error to finish printing it, before they are ended
STATUS = 1  # exit status if one rank alone has an error, as for any Python script; the command line has its own
POLL = 1e-3  # s between two tests of a request


def abort(error: BaseException) -> None:
    """Print an error and end all ranks."""
    traceback.print_exception(error)
    _end(STATUS)


def is_done(request: MPI.Request, within: float) -> bool:
    """Whether a request completes within this number of seconds."""
    end = time.monotonic() + within
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(POLL)
    return True


def _end(status: int) -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    MPI.COMM_WORLD.Abort(status)


def _end_before_petsc() -> None:
    """Let `python3 -m mpi4py` end all ranks before PETSc ends on the rank that has an error.

    mpi4py stores the status and aborts last of all. Before this, Python frees the script's PETSc objects and PETSc ends;
    both are collective, so this rank would wait for the others.
    """
    note = MPI._set_abort_status

    def note_and_end(status: int) -> None:
        note(status)
        if status and not is_done(MPI.COMM_WORLD.Ibarrier(), GRACE):
            error = sys.exception()
            if not isinstance(error, SystemExit):
                traceback.print_exception(error)
            _end(status)

    MPI._set_abort_status = note_and_end


if MPI.COMM_WORLD.size > 1:
    _end_before_petsc()
