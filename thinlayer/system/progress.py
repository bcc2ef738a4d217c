"""Reports of the progress of long work on standard error, and messages through Python's `logging`, by one rank.

A report names the work and the part of it now being done, the time spent and the time left. On a terminal it is one
changing line, shown after 5 s and removed at the end. Elsewhere it is a line a minute, and a line for each compilation
of more than 5 s. Work within other work is reported on the same line.
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

MIN_TIMED_SHARE = 1e-3  # completed share from which on the remaining time is shown
# seconds before the first line, and between lines; True: on a terminal
FIRST_REPORT_SECONDS, REPORT_SECONDS = {True: 5.0, False: 60.0}, {True: 0.2, False: 60.0}

_SILENT_LOGGER = logging.Logger("thinlayer on other ranks", logging.CRITICAL + 1)


def logger(part: str, comm: MPI.Intracomm | None = None) -> logging.Logger:
    """Return the logger "thinlayer.PART" on rank 0 of a communicator, and a silent logger on other ranks.

    Args:
        part: PART of this name: "solve" for messages on what a solve tries, "march" on steps in time, "study" on what a
            study has done.
        comm: communicator of the model; None: all ranks, in an `ensemble` those of the group.
    """
    return _SILENT_LOGGER if (comm or default_comm()).rank else logging.getLogger(f"thinlayer.{part}")


@dataclass(eq=False)
class _Task:
    """Work whose progress is reported, in pieces done one after the other.

    Attributes:
        what: name of the work.
        share: finished fraction of the work, 0 to 1.
        piece: fraction of the work, 0 to 1, that is done in the piece that now runs.
        now: text that names this piece.
    """

    what: str
    share: float = 0.0
    piece: float = 0.0
    now: str = ""


class ProgressReporter:
    """Prints the progress of work, and of other work that is done within it.

    Args:
        stream: function that returns the file to write to.
        clock: function that returns the time, s.
    """

    def __init__(self, stream: Callable[[], TextIO], clock: Callable[[], float]) -> None:
        self._stream, self._clock = stream, clock
        self._open: list[_Task] = []
        self._begun = self._due = 0.0
        self._shown = False

    @contextmanager
    def report(self, what: str) -> Iterator[Callable[..., None]]:
        """Context manager of long work, which yields a function that reports its progress; also a decorator.

        The yielded function has four arguments. `share` is the finished fraction of the work (0 to 1). `now` is a text
        that names the piece of work that now runs, and `piece` is the fraction of the work in it. `at_once` says
        whether to print even if the last line was printed a short time ago.

        Args:
            what: name of the work.
        """
        work = _Task(what)
        if not self._open:
            self._begun, self._shown = self._clock(), False
            self._due = self._begun + FIRST_REPORT_SECONDS[self._stream().isatty()]
        self._open.append(work)

        def set_share(share: float, now: str = "", piece: float = 0.0, *, at_once: bool = False) -> None:
            work.share, work.now, work.piece = share, now, piece
            self._print(at_once)

        try:
            self._print()
            yield set_share
        finally:
            if work in self._open:  # not if an abandoned generator is closed after the enclosing work
                del self._open[self._open.index(work) :]
            if not self._open and self._shown and self._stream().isatty():
                self._stream().write("\r\x1b[K")
                self._stream().flush()  # before the results are printed

    @contextmanager
    def report_call(self, what: str) -> Iterator[None]:
        """Context manager of one long call, whose progress is not known, such as a compilation.

        If the call takes more than 5 s, a line names it, also where standard error is not a terminal.

        Args:
            what: name of the work.
        """
        with self.report(what) as set_share:
            timer = threading.Timer(FIRST_REPORT_SECONDS[True], set_share, (0.0,), {"at_once": True})
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
        now, stream = self._clock(), self._stream()
        quiet = MPI.COMM_WORLD.rank or not logging.getLogger("thinlayer").isEnabledFor(logging.WARNING)
        if quiet or (now < self._due and not at_once):
            return
        self._due, self._shown = now + REPORT_SECONDS[stream.isatty()], True
        words = [f"{work.what}: {work.now}" if work.now else work.what for work in self._open]
        # share of the outermost work, nested work included; the time left assumes the same pace
        share, width = 0.0, 1.0
        for work in self._open:
            share += width * work.share
            width *= work.piece
        spent = now - self._begun
        words.append(f"{timedelta(seconds=round(spent))} so far")
        if share > MIN_TIMED_SHARE:
            words.append(f"about {timedelta(seconds=round(spent * (1 - share) / share))} left")
        line = ", ".join(words)
        stream.write(f"\r\x1b[K{line[:120]}" if stream.isatty() else f"{line}\n")
        stream.flush()


_reporter = ProgressReporter(lambda: sys.stderr, time.monotonic)
track, report, report_call = _reporter.track, _reporter.report, _reporter.report_call
