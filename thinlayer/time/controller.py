"""The loop of all marches: a controller chooses length and attempts of each step, a journal keeps the states."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from forms.base import InputError
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.history import TIME_TOLERANCE, History
from thinlayer.solving.solve import Solver
from thinlayer.system.fingerprint import Resume
from thinlayer.system.progress import logger, report
from thinlayer.time.journal import Journal


class StepAttempt(NamedTuple):
    """Description of one attempt at a step.

    Attributes:
        name: name for the log.
        make: length -> the states of the step from the last state. It sets the pace of the next step, and raises
            SolveError if the step fails.
        until: after a failed attempt, this attempt is made only if the step would be shortened to this length, or
            below.
    """

    name: str
    make: Callable[[float], list[State]]
    until: float = math.inf


def is_divisible(start: float, end: float) -> bool:
    """Whether a step is so long that its two halves are not lost in rounding."""
    return start < (start + end) / 2 < end


@dataclass(eq=False)
class Controller(ABC):
    """Controller of the steps of a march.

    Attributes:
        solver: solver of the model.
        journal: journal of the march.
        targets: times at which steps must end.
        start: time of the first state.
        near: largest difference of times that count as equal.
        smallest: length below which a step is not shortened further.
    """

    solver: Solver
    journal: Journal
    targets: Sequence[float]
    smallest: float = field(init=False)

    def __post_init__(self) -> None:
        self.start = self.journal.start
        lengths = np.diff([self.start, *self.targets])
        self.near = min(TIME_TOLERANCE * max(abs(self.start), abs(self.targets[-1])), float(lengths.min()) / 2)
        self._log = logger("march", self.solver.model.comm)

    @property
    def last(self) -> State:
        """The last accepted state."""
        return self.journal.history.last

    @property
    def done(self) -> bool:
        """Whether the march has reached its end."""
        return self._passed_times == len(self.targets)

    @property
    def target(self) -> float:
        """The next time at which a step must end."""
        return self.targets[self._passed_times]

    @property
    def _passed_times(self) -> int:
        return bisect_right(self.targets, self.last.t + self.near)

    @abstractmethod
    def length(self) -> float:
        """Length of the next step, in the controller's own unit."""

    @property
    @abstractmethod
    def attempts(self) -> list[StepAttempt]:
        """Attempts at a step, in the order in which they are made."""

    def shorter(self, length: float, error: SolveError) -> float:
        """The length to try after an error."""
        return length / 2

    @abstractmethod
    def failure(self, length: float, errors: Sequence[SolveError]) -> SolveError:
        """The error of the march if the shortest step fails, made from the errors of its attempts."""

    def error(self, what: str, advice: str = "") -> SolveError:
        """A SolveError of the march, with its history."""
        return SolveError(what, self.journal.history, advice=advice)

    # ---------------------------------------------------------------- the loop
    def run(self, resume: Resume = False, begun: Sequence[State] = ()) -> History:
        """March to the end. Collective; errors as in `march`.

        Args:
            resume: whether to continue the march in the journal's folder.
            begun: initial state, with the previous state before it if that is known; (): from rest.
        """
        with report("march") as tell:
            end = self.targets[-1]
            if self.journal.read(resume):
                if self.last.t > end + self.near:
                    where = f"the march in {self.journal.out} is at t = {self.last.t:g}"
                    raise InputError(f"{where}, and is to end before, at t = {end:g}")
            elif begun:
                self.journal.begin(begun)
            else:
                self._begin()
            while not self.done:
                self.journal.accept(self._next())
                share = (self.last.t - self.start) / (end - self.start)  # falls where t turns back
                tell(max(share, 0.0), f"t = {self.last.t:.4g} of {end:.4g}, {len(self.journal.history)} states")
        return self.journal.history

    def _begin(self) -> None:
        """Compute the first state. A state at rest is written later, with the first step."""
        if self.solver.equations.traits.rate:
            self.journal.note(self.solver.rest(self.start))
            return
        try:
            self.journal.accept([self.solver.sudden(self.start)])
        except SolveError as error:
            raise self.error(f"the first state, under the sudden load at t = {self.start:g}: {error}") from error

    def _next(self) -> list[State]:
        """The states of the next step, which is shortened until an attempt succeeds."""
        length, t = self.length(), self.last.t
        while True:
            errors: list[SolveError] = []
            for attempt in self.attempts:
                if errors and self.shorter(length, errors[0]) > attempt.until:
                    continue
                if errors:
                    self._log.info("t = %g: %s is tried: %s", t, attempt.name, errors[-1].reason)
                try:
                    return attempt.make(length)
                except SolveError as error:
                    errors.append(error.with_traceback(None))  # as in `Solver._try_in_turn`
            shorter = self.shorter(length, errors[0])
            if shorter < max(self.smallest, np.finfo(float).tiny):
                raise self.failure(length, errors) from errors[0]
            self._log.info("t = %g: a step of %g is shortened to %g: %s", t, length, shorter, errors[0].reason)
            length = shorter
