"""Settings of `python3 -m thinlayer` before a study runs: interrupts, and options in files of the working folder."""

from __future__ import annotations

import os
import signal
from types import FrameType


def end_on_interrupt() -> None:
    """Let an interrupt end the process with a message. An exception raised while C++ modules load would abort them."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: FrameType | None) -> None:
    if is_first():
        os.write(2, b"thinlayer: interrupted; nothing was done\n")
    os._exit(130)


def is_first() -> bool:
    """Whether this is rank 0, before MPI has started."""
    return all(os.environ.get(name, "0") == "0" for name in ("PMIX_RANK", "PMI_RANK", "OMPI_COMM_WORLD_RANK"))


def raise_on_interrupt() -> None:
    """Let an interrupt raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def ignore_working_folder() -> None:
    """Start PETSc, and let neither it nor FFCx and compilers read options from files in the working folder."""
    import petsc4py

    petsc4py.init(["thinlayer", "-skip_petscrc"])
    from thinlayer.compiling.compilation import load_options

    load_options()
