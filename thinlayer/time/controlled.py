"""Marching in time with a law whose stress falls: along its path, as long as the path leads on in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError, TurningPoint
from thinlayer.solving.options import OptionValue
from thinlayer.solving.solvers import Solver
from thinlayer.time.arc_length import ArcLength
from thinlayer.time.following import PathFollowing
from thinlayer.time.history import History
from thinlayer.time.journal import Journal

CLOSENESS = 1e-3  # length of the shortest step before a turning point, relative to the first step
MANY = 10**6  # largest number of steps


class PathInTime(PathFollowing):
    """A march to given times along an equilibrium path, which ends where the path turns back in time.

    Displacements of supports or loads control it. Steps along the path pass over no part of it: were they steps in time, a
    step could end beyond a loop of the path. At break times of the data the path begins anew, with t increasing.

    Args:
        solver: solver of the model, for the first state.
        journal: journal of the march.
        times: times at which steps must end, the break times of the data among them.
        start: time of the first state.
        options: PETSc options of the linear solver; they override our defaults.
    """

    def __init__(
        self,
        solver: Solver,
        journal: Journal,
        times: Sequence[float],
        start: float,
        options: Mapping[str, OptionValue] | None,
    ) -> None:
        self._times, lengths = times, np.diff([start, *times])
        first = float(lengths[0])
        plan = ArcLength(times[-1], first, smallest=CLOSENESS, largest=float(lengths.max()) / first, steps=MANY)
        super().__init__(solver, journal, plan, start, options)
        self._turned: SolveError | None = None

    def _travel(self) -> None:
        breaks = np.array([*self.solver.model.break_times])
        for end in self._times:
            self.plan = replace(self.plan, end=end)
            if len(breaks) and np.abs(breaks - self._history.last.t).min() <= self._near:
                self._aimed, self._journal.before = False, None
            self._path.balance.middle = (self._history.last.t + end) / 2
            while self._history.last.t < end - self._near:
                try:
                    self._go_on()
                except SolveError as error:
                    if self._turned is None:
                        raise
                    raise TurningPoint(self._history.last.t, self._history) from error

    def _checked(self, last: State, state: State) -> State:
        """As in `PathFollowing`. SolveError: beyond this state, or between the two, the path leads back in time."""
        super()._checked(last, state)
        if not (self._path.leads_on and state.t > last.t):
            self._turned = SolveError("the path turns back in time")
            self._path.aim(self._journal.before, last)
            raise self._turned
        self._turned = None
        return state


def last_of(given: History | State) -> tuple[State | None, State]:
    """The state before the last one, if there is one, and the last state of a history; or a state by itself."""
    if isinstance(given, State):
        return None, given
    states = [*given]
    return (states[-2] if len(states) > 1 else None), states[-1]
