"""Batches of studies that run at the same time, each in a process; a batch started again goes on after a kill."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from forms.base import InputError, require
from geometry.parallel import default_comm
from thinlayer.running.catalogue import studies
from thinlayer.running.process import CHECK_FAILED, OK, UNFINISHED
from thinlayer.running.record import Record, RunContent
from thinlayer.system.folder import lock_folder
from thinlayer.system.progress import report
from thinlayer.system.version import print_safely

OUTCOMES = {OK: "all checks hold", CHECK_FAILED: "a check fails", UNFINISHED: "not finished"}
LOG_SUFFIX = ".log"
POLL_SECONDS = 0.1  # s between looks at the processes


@dataclass(frozen=True, eq=False)
class Job:
    """A run of one study in a process of its own.

    Attributes:
        study: name of the study.
        options: name of an option of the study -> its value.
        folder: folder for the files of the run. The printed output goes to the file FOLDER.log, which stands next to
            the folder.
        expected_seconds: approximate duration, s. The jobs with the longest durations start first. The progress of a
            batch is the time of its finished jobs, and the time that the others have run, over the sum of all.
    """

    study: str
    options: Mapping[str, object]
    folder: Path
    expected_seconds: float

    @property
    def command_words(self) -> list[str]:
        """Words of the command line that run this job: those after `thinlayer run`, without --out and the folder."""
        options = ([f"--{name}", *([] if value is True else [str(value)])] for name, value in self.options.items())
        return [self.study, *chain.from_iterable(options)]

    def run_content(self) -> RunContent | None:
        """Return the content of the file run.json in the folder, as nested JSON data, or None if it is not of this job.

        It is of this job if it has the same study, options, PETSc options of the package and source code. A missing or
        damaged file gives None, too.
        """
        with suppress(InputError):
            return Record(self.study, self.folder, self.options).read_same_run()
        return None

    def start(self, stack: ExitStack) -> subprocess.Popen[bytes] | None:
        """Start the run in a new process and return it; return None if the folder has a finished run of this job.

        If the folder has an unfinished run of this job, the new process continues it. If an old process still writes to
        the folder, its end is awaited first.

        Args:
            stack: exit stack that gets a callback; when the stack is closed, the callback ends the process if it still
                runs.

        Raises:
            InputError: the folder cannot be written.
        """
        with lock_folder(self.folder, wait=True):  # a killed batch may have left a process that still runs
            earlier_content = self.run_content()
        if earlier_content and earlier_content["error"] is None:
            return None
        command = [sys.executable, "-m", "thinlayer", "run", *self.command_words, "--out", str(self.folder)]
        command += ["--resume"] if earlier_content else []
        with Path(f"{self.folder}{LOG_SUFFIX}").open("wb") as log:
            # every core has a run of its own
            process = subprocess.Popen(command, stdout=log, stderr=log, env={"OMP_NUM_THREADS": "1", **os.environ})
        stack.enter_context(process)  # which waits for it
        stack.callback(process.terminate)
        return process

    def status(self) -> int:
        """Return the exit status of the job from its file run.json: 0 all checks hold, 1 a check fails, 3 not finished.

        To be called after the process has ended. "Not finished" means that run.json is missing, of another job, or
        names an error.
        """
        content = self.run_content()
        if content is None or content["error"] is not None:
            return UNFINISHED
        return OK if all(check["passed"] for check in content["checks"]) else CHECK_FAILED


def quick_options(study: str, quick: bool) -> dict[str, bool]:
    """Return {"quick": True}, the option for coarse meshes, if it is wanted and the study has it; else {}.

    Args:
        study: name of the study.
        quick: whether coarse meshes are wanted.
    """
    return {"quick": True} if quick and "quick" in studies()[study].options else {}


def run_jobs(jobs: Sequence[Job], out: Path, at_a_time: int | None = None) -> int:
    """Run several studies at the same time, each in a process, and print a line when one of them ends.

    If a job fails or does not finish, the others continue.

    Args:
        jobs: the runs of studies, each with its own folder.
        out: folder that contains the folders of the jobs; only one batch at a time may use it.
        at_a_time: largest number of processes at the same time; None: the number of cores.

    Returns:
        Exit status: `UNFINISHED` (3) if a job is not finished, else `CHECK_FAILED` (1) if a check fails, else `OK` (0).

    Raises:
        InputError: the program runs on several MPI ranks; `at_a_time` < 1; another batch uses `out`; or no files can be
            written there.
    """
    n_ranks = default_comm().size
    require(n_ranks == 1, "the number of MPI ranks", n_ranks, "start several studies without mpirun")
    max_processes = len(os.sched_getaffinity(0)) if at_a_time is None else at_a_time
    require(max_processes >= 1, "studies at a time, -j", max_processes, "allowed: 1 or more")
    waiting, codes = sorted(jobs, key=lambda job: -job.expected_seconds), [OK]
    running: dict[Job, tuple[subprocess.Popen[bytes] | None, float]] = {}
    with lock_folder(out, ".batch"), report("studies") as set_share, ExitStack() as stack:
        stack.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, signal.default_int_handler))
        while waiting or running:
            for job in waiting[: max_processes - len(running)]:
                waiting.remove(job)
                running[job] = job.start(stack), time.monotonic()
            for job, (child, start) in [*running.items()]:
                if child is None or child.poll() is not None:
                    del running[job]
                    codes.append(job.status())
                    note = f"{time.monotonic() - start:.0f} s, see {job.folder}{LOG_SUFFIX}" if child else "done before"
                    print_safely(f"{len(codes) - 1} of {len(jobs)}  {job.folder.name}: {OUTCOMES[codes[-1]]} ({note})")
            state_text = ", ".join([f"{len(codes) - 1} of {len(jobs)} done", *(job.folder.name for job in running)])
            time_left, total = (sum(job.expected_seconds for job in group) for group in ([*waiting, *running], jobs))
            # a run that takes longer than expected stays at nine tenths
            spent = [min(time.monotonic() - start, 0.9 * job.expected_seconds) for job, (_, start) in running.items()]
            set_share(1 - (time_left - sum(spent)) / total, state_text)
            time.sleep(POLL_SECONDS)
    return max(codes)
