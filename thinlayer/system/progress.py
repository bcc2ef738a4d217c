"""Reports of the progress of long work on standard error, and messages through Python's `logging`, by one rank.

A report names the work and the part of it now being done, the time spent and the time left. On a terminal it is one
changing line, shown after 5 s and removed at the end; in a notebook too, where it changes every 5 s. Elsewhere it is a
line a minute, and a line for each compilation of more than 5 s. Work within other work is reported on the same line.
`logging.getLogger("thinlayer").setLevel("ERROR")` turns reports off. Messages are shown if the user asks for them:
`logging.basicConfig(level="INFO")`, or `--verbose` on the command line.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TextIO

from mpi4py import MPI

from geometry.parallel import ResultType, default_comm

MIN_FORECAST_SHARE = 1e-3  # completed share from which on the remaining time is shown
LINE_WIDTH = 120  # largest number of characters of a changing line
# by kind of stream: seconds before the first line, and between lines; text that removes a line, "": lines stay
FIRST_REPORT_SECONDS = {"terminal": 5.0, "notebook": 5.0, "file": 60.0}
REPORT_SECONDS = {"terminal": 0.2, "notebook": 5.0, "file": 60.0}
REMOVE_LINE = {"terminal": "\r\x1b[K", "notebook": f"\r{LINE_WIDTH * ' '}\r", "file": ""}

_SILENT_LOGGER = logging.Logger("thinlayer on other ranks", logging.CRITICAL + 1)


def logger(part: str, comm: MPI.Intracomm | None = None) -> logging.Logger:
    """Return the logger "thinlayer.PART" on rank 0 of a communicator, and a silent logger on other ranks.

    Args:
        part: PART of this name: "solve" for messages on what a solve tries, "march" on steps in time, "study" on what a
            study has done.
        comm: communicator of the model; None: all ranks, in an `ensemble` those of the group.
    """
    return _SILENT_LOGGER if (comm or default_comm()).rank else logging.getLogger(f"thinlayer.{part}")


def _kind_of(stream: TextIO) -> str:
    """Return "terminal", "notebook" (a stream of Jupyter's kernel for Python) or "file"."""
    if stream.isatty():
        return "terminal"
    return "notebook" if type(stream).__module__.startswith("ipykernel") else "file"


@dataclass(eq=False)
class _Task:
    """Work whose progress is reported, in pieces done one after the other.

    Attributes:
        title: name of the work.
        done_share: finished fraction of the work, 0 to 1.
        piece_share: fraction of the work, 0 to 1, that is done in the piece that now runs.
        piece_text: text that names this piece.
    """

    title: str
    done_share: float = 0.0
    piece_share: float = 0.0
    piece_text: str = ""


class ProgressReporter:
    """Prints the progress of work, and of other work that is done within it.

    Args:
        stream: function that returns the file to write to.
        clock: function that returns the time, s.
    """

    def __init__(self, stream: Callable[[], TextIO], clock: Callable[[], float]) -> None:
        self._stream, self._clock = stream, clock
        self._open_tasks: list[_Task] = []
        self._start_time = self._next_print_time = 0.0
        self._has_printed = False

    @contextmanager
    def report(self, name: str) -> Iterator[Callable[..., None]]:
        """Context manager of long work, which yields a function that reports its progress; also a decorator.

        The yielded function has four arguments. `share` is the finished fraction of the work (0 to 1). `now` is a text
        that names the piece of work that now runs, and `piece` is the fraction of the work in it. `at_once` says
        whether to print even if the last line was printed a short time ago.

        Args:
            name: name of the work.
        """
        task = _Task(name)
        if not self._open_tasks:
            self._start_time, self._has_printed = self._clock(), False
            self._next_print_time = self._start_time + FIRST_REPORT_SECONDS[_kind_of(self._stream())]
        self._open_tasks.append(task)

        def set_share(share: float, now: str = "", piece: float = 0.0, *, at_once: bool = False) -> None:
            task.done_share, task.piece_text, task.piece_share = share, now, piece
            self._print(at_once)

        try:
            self._print()
            yield set_share
        finally:
            if task in self._open_tasks:  # not if an abandoned generator is closed after the enclosing work
                del self._open_tasks[self._open_tasks.index(task) :]
            if not self._open_tasks and self._has_printed:
                self._stream().write(REMOVE_LINE[_kind_of(self._stream())])
                self._stream().flush()  # before the results are printed

    @contextmanager
    def report_call(self, what: str) -> Iterator[None]:
        """Context manager of one long call, whose progress is not known, such as a compilation.

        If the call takes more than 5 s, a line names it, also where standard error is not a terminal.

        Args:
            what: name of the work.
        """
        with self.report(what) as set_share:
            timer = threading.Timer(FIRST_REPORT_SECONDS["terminal"], set_share, (0.0,), {"at_once": True})
            timer.daemon = True
            timer.start()
            try:
                yield
            finally:
                timer.cancel()

    def track(self, items: Sequence[ResultType], what: str, label: str = "{}") -> Iterator[ResultType]:
        """Yield items one after the other, and report how many of them are done.

        Args:
            items: the items.
            what: name of the work.
            label: format string that makes, of the item that was yielded last, a text for the report.
        """
        with self.report(what) as set_share:
            for k, item in enumerate(items):
                set_share(k / len(items), f"{k + 1} of {len(items)}, {label.format(item)}", 1 / len(items))
                yield item

    def _print(self, at_once: bool = False) -> None:
        now, stream, kind = self._clock(), self._stream(), _kind_of(self._stream())
        is_quiet = MPI.COMM_WORLD.rank or not logging.getLogger("thinlayer").isEnabledFor(logging.WARNING)
        if is_quiet or (now < self._next_print_time and not at_once):
            return
        self._next_print_time, self._has_printed = now + REPORT_SECONDS[kind], True
        texts = [f"{task.title}: {task.piece_text}" if task.piece_text else task.title for task in self._open_tasks]
        # share of the outermost work, nested work included; the time left assumes the same pace
        share, task_share = 0.0, 1.0
        for task in self._open_tasks:
            share += task_share * task.done_share
            task_share *= task.piece_share
        elapsed = now - self._start_time
        texts.append(f"{timedelta(seconds=round(elapsed))} so far")
        if share > MIN_FORECAST_SHARE:
            texts.append(f"about {timedelta(seconds=round(elapsed * (1 - share) / share))} left")
        line = ", ".join(texts)
        stream.write(f"{line}\n" if kind == "file" else f"{REMOVE_LINE[kind]}{line[:LINE_WIDTH]}")
        stream.flush()


_reporter = ProgressReporter(lambda: sys.stderr, time.monotonic)
track, report, report_call = _reporter.track, _reporter.report, _reporter.report_call
