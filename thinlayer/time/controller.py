"""The loop of all marches: a controller chooses the length and the solution method of each step."""

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
from thinlayer.solving.initial_state import balanced_start
from thinlayer.solving.solve import Solver
from thinlayer.system.fingerprint import Resume
from thinlayer.system.progress import logger, report
from thinlayer.time.journal import Journal


class StepAttempt(NamedTuple):
    """A method that a controller may use for a step, such as Newton's method or a search by weak springs.

    Attributes:
        name: name of the method in messages.
        make_states: function that takes the length of a step, makes the step from the last state, and returns the new
            states. It also sets the largest length of the next step, and raises SolveError if the step fails.
        max_shorter_length: bound for use after a failure. If another method has failed, this one is tried only if
            the shorter step to be tried next has at most this length.
    """

    name: str
    make_states: Callable[[float], list[State]]
    max_shorter_length: float = math.inf


def is_divisible(start: float, end: float) -> bool:
    """Return whether a step from `start` to `end` can be halved, as its middle differs from both in floating point."""
    return start < (start + end) / 2 < end


@dataclass(eq=False)
class Controller(ABC):
    """Base class of controllers, which choose length and method of each step of a march, and shorten steps that fail.

    Attributes:
        solver: solver of the model.
        journal: record of the accepted states.
        targets: times at which steps must end, increasing.
        start: time of the first state.
        time_slack: largest difference of times that count as equal.
        min_length: length below which a step is not shortened further, in the unit of `next_length`.
    """

    solver: Solver
    journal: Journal
    targets: Sequence[float]
    min_length: float = field(init=False)

    def __post_init__(self) -> None:
        self.start = self.journal.start
        durations = np.diff([self.start, *self.targets])
        self.time_slack = min(TIME_TOLERANCE * max(abs(self.start), abs(self.targets[-1])), float(durations.min()) / 2)
        self._log = logger("march", self.solver.model.comm)

    @property
    def last(self) -> State:
        """The accepted state from which the next step starts."""
        return self.journal.history.last

    @property
    def done(self) -> bool:
        """Whether the march has ended, as its last state is at the last time of `targets`, or after it."""
        return self._n_targets_passed == len(self.targets)

    @property
    def target(self) -> float:
        """The first time of `targets` that is after the last state; the next step must not go beyond it."""
        return self.targets[self._n_targets_passed]

    @property
    def _n_targets_passed(self) -> int:
        return bisect_right(self.targets, self.last.t + self.time_slack)

    @abstractmethod
    def next_length(self) -> float:
        """Return the length of the next step: a duration, or for a path the arc length over that of the first step."""

    @property
    @abstractmethod
    def attempts(self) -> list[StepAttempt]:
        """Methods for the next step, in the order in which they are tried."""

    def shorter_length(self, length: float, error: SolveError) -> float:
        """Return the length to be tried after a step has failed; by default half of its length.

        Args:
            length: length of the step that has failed.
            error: error of the first method that was tried for it.
        """
        return length / 2

    @abstractmethod
    def failure(self, length: float, errors: Sequence[SolveError]) -> SolveError:
        """Return the error with which the march ends when even the shortest step has failed.

        Args:
            length: length of this step.
            errors: errors of the methods that were tried for it, in order.
        """

    def error(self, reason: str, advice: str = "") -> SolveError:
        """Return a SolveError that carries the history of the accepted states.

        Args:
            reason: message that says what has failed.
            advice: what the user may do; "": no advice.
        """
        return SolveError(reason, self.journal.history, advice=advice)

    # ---------------------------------------------------------------- the loop
    def run(self, resume: Resume = False, initial: Sequence[State] = ()) -> History:
        """Make all steps of the march, and return its history. Collective.

        Args:
            resume: whether to continue the march that is in the journal's folder; "anyway": also if it is another
                march.
            initial: states of an earlier march from which this one continues: its last state, perhaps with the state
                before it in front. (): the march starts from rest.

        Raises:
            InputError: the folder has another march, damaged files, or a march that is already beyond the last of
                `targets`.
            SolveError: the first state cannot be computed, or even the shortest step fails.
        """
        with report("march") as progress:
            end = self.targets[-1]
            if self.journal.read(resume):
                if self.last.t > end + self.time_slack:
                    march_text = f"the march in {self.journal.out} is at t = {self.last.t:g}"
                    raise InputError(f"{march_text}, and is to end before, at t = {end:g}")
            elif self.solver.equations.traits.inert:
                rest, dt = self.solver.rest_state(self.start), self.targets[0] - self.start
                dt = min(dt, self.journal.pace.step or dt)
                self.journal.begin([balanced_start(self.solver.equations, initial[-1] if initial else rest, dt)])
            elif initial:
                self.journal.begin(initial)
            else:
                self._add_first_state()
            while not self.done:
                self.journal.accept(self._make_next_states())
                share = (self.last.t - self.start) / (end - self.start)  # falls where t turns back
                progress(max(share, 0.0), f"t = {self.last.t:.4g} of {end:.4g}, {len(self.journal.history)} states")
        return self.journal.history

    def _add_first_state(self) -> None:
        """Add the first state to the journal, for a march that starts from rest.

        If a part depends on rates, this is the state at rest, which is written to files only together with the first
        step. Otherwise it is the response to the loads that act suddenly at the start.

        Raises:
            SolveError: this response cannot be computed.
        """
        if self.solver.equations.traits.rate:
            model = self.solver.model
            if model.n_components == 1 and model.structure.initial is None:
                raise InputError("a march with a capacity needs the field at its start: Structure(initial=...)")
            self.journal.add_state(self.solver.rest_state(self.start))
            return
        try:
            self.journal.accept([self.solver.solve_sudden(self.start)])
        except SolveError as error:
            raise self.error(f"the first state, under the sudden load at t = {self.start:g}: {error}") from error

    def _make_next_states(self) -> list[State]:
        """Make the next step, shortened until one of the methods succeeds, and return its states.

        Raises:
            SolveError: even the shortest step fails.
        """
        length, t = self.next_length(), self.last.t
        while True:
            errors: list[SolveError] = []
            for attempt in self.attempts:
                if errors and self.shorter_length(length, errors[0]) > attempt.max_shorter_length:
                    continue
                if errors:
                    self._log.info("t = %g: %s is tried: %s", t, attempt.name, errors[-1].reason)
                try:
                    return attempt.make_states(length)
                except SolveError as error:
                    errors.append(error.with_traceback(None))  # as in `Solver._try_in_turn`
            new_length = self.shorter_length(length, errors[0])
            if new_length < max(self.min_length, np.finfo(float).tiny):
                raise self.failure(length, errors) from errors[0]
            self._log.info("t = %g: a step of %g is shortened to %g: %s", t, length, new_length, errors[0].reason)
            length = new_length
