"""Programs run on several ranks, or in a process of their own, from the root of the project."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

CLONE, REPLACE = Path(__file__).parent.parent, Path.replace
LAUNCHES = 5  # of mpirun: two that begin at one time may make the same folder, and one of them ends before its program
BROKEN = "prte_session_dir failed"  # what it says then


def ends_too(by: str) -> list[str]:
    """Words before a command that a signal ends when its parent ends."""
    return ["setpriv", "--pdeathsig", by] if shutil.which("setpriv") else []


def clean() -> dict[str, str]:
    """The environment without what makes an outer MPI process our parent."""
    outer = ("PMIX_RANK", "PMIX_NAMESPACE", "PMIX_SERVER", "OMPI_COMM", "PRTE_")
    return {k: v for k, v in os.environ.items() if not k.startswith(outer) or k.startswith("PRTE_MCA")}


@contextmanager
def launched(ranks: int, *command: str, cwd: Path = CLONE, output: Any = subprocess.PIPE) -> Iterator[subprocess.Popen]:
    """A program on several ranks, ended with the block; in the directory `cwd`, what it prints goes to `output`."""
    # ranks that wait leave the cores to those that compute: there may be fewer cores than ranks
    environment = clean() | {"PYTHONPATH": str(CLONE), "OMP_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    # mpi4py ends all ranks where one has an error; mpirun ends with pytest, even if that is killed, and ranks with mpirun
    words = [*ends_too("TERM"), "mpirun", "-n", str(ranks), *ends_too("KILL"), sys.executable, "-m", "mpi4py", *command]
    streams = {"stdout": output, "stderr": output, "text": True}
    with subprocess.Popen(words, env=environment, cwd=cwd, start_new_session=True, **streams) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)


def mpirun(ranks: int, *command: str, cwd: Path = CLONE, timeout: float = 240) -> subprocess.CompletedProcess:
    """Run a program, and end it after a time."""
    for _ in range(LAUNCHES):
        with launched(ranks, *command, cwd=cwd) as process:
            out, err = process.communicate(timeout=timeout)
        if BROKEN not in err:
            break
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


class Ended(BaseException):
    """As a signal, nobody catches it."""


@dataclass
class Ending:
    """What ends a march before a row is written, or as its files are: a signal to one rank, or an exception on all.

    It is no function, as a march is resumed with the same functions alone.
    """

    row: int = 0
    writing: bool = False
    raises: bool = False
    rows: int = 0

    def at_row(self) -> None:
        self.rows += 1
        if self.rows == self.row and (
            self.raises or MPI.COMM_WORLD.rank == (0 if self.writing else MPI.COMM_WORLD.size - 1)
        ):
            if not self.writing:
                self.end()
            Path.replace = self.end

    def end(self, *_: object) -> None:
        if not self.raises:
            os.kill(os.getpid(), signal.SIGKILL)
        Path.replace = REPLACE
        raise Ended
