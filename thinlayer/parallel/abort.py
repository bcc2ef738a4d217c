"""An error that one rank alone has must not leave the others waiting for ever."""

from __future__ import annotations

import sys
import time
import traceback

from mpi4py import MPI

GRACE = 5.0  # s in which ranks that all end with an error come to their ends, rather than be cut off in what they print
STATUS = 1  # of the processes where one rank alone has an error, as of any Python script; the command line has its own
POLL = 1e-3  # s between two looks


def abort(error: BaseException) -> None:
    """Print an error and end all ranks."""
    traceback.print_exception(error)
    _end(STATUS)


def is_done(request: MPI.Request, within: float) -> bool:
    """Whether what has been asked for is done within so many seconds."""
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

    mpi4py notes the status to abort with, and aborts as the last thing of all. Before that the objects of PETSc that the
    script has made are freed, and PETSc ends, together with the other ranks: this rank would wait for them.
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
