"""An error that one rank alone has must not leave the others waiting for ever."""

from __future__ import annotations

import sys
import traceback
from types import TracebackType

from mpi4py import MPI


def abort(error: BaseException) -> None:
    """Print an error and end all ranks."""
    traceback.print_exception(error)
    sys.stderr.flush()
    MPI.COMM_WORLD.Abort(1)


def end_all_ranks_on_errors() -> None:
    """From now on an error that nobody catches ends all ranks of a parallel run; a serial run is left as it is."""
    previous = sys.excepthook
    if MPI.COMM_WORLD.size == 1 or previous is not sys.__excepthook__:
        return

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        abort(error)

    sys.excepthook = hook
