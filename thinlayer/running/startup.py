"""What `python3 -m thinlayer` settles before a study runs: interrupts, and files of the working folder."""

from __future__ import annotations

import os
import signal
from types import FrameType


def end_on_interrupt() -> None:
    """An interrupt ends the process at once, with a line: raised in modules of C++ that load, it would abort them."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def _end(number: int, frame: FrameType | None) -> None:
    if os.environ.get("PMIX_RANK", "0") == "0":
        os.write(2, b"thinlayer: interrupted; nothing was done\n")
    os._exit(130)


def raise_on_interrupt() -> None:
    """An interrupt raises KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def ignore_working_folder() -> None:
    """Options of PETSc, of FFCx and of compilers are not read from files in the working folder. Before PETSc starts."""
    import petsc4py

    petsc4py.init(["thinlayer", "-skip_petscrc"])
    from thinlayer.compiling.compilation import load_options

    load_options()
