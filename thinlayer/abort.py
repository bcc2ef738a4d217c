"""An error that one rank alone has must not leave the others waiting for ever."""

from __future__ import annotations

import sys
import traceback

from mpi4py import MPI


def abort(error: BaseException, status: int = 1) -> None:
    """Print an error and end all ranks."""
    traceback.print_exception(error)
    sys.stderr.flush()
    MPI.COMM_WORLD.Abort(status)
