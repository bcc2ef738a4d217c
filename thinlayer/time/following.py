"""Marching along an equilibrium path: to its end, also where loads turn back, or as long as it leads on in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from forms.base import InputError
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError, TurningPoint
from thinlayer.solving.history import SAME_TIME, History
from thinlayer.solving.petsc import Options
from thinlayer.solving.solvers import Solver
from thinlayer.system.identity import Resume
from thinlayer.system.progress import logger, telling
from thinlayer.time.journal import Journal
from thinlayer.time.path import EquilibriumPath, PathEquations
from thinlayer.time.plan import ArcLength

WANTED_ITERATIONS = 4  # number of Newton steps at which the length of the next step stays the same
LEAST_FACTOR, MOST_FACTOR = 0.5, 2.0  # bounds of the ratio of the lengths of two steps
CLOSENESS = 1e-3  # length of the shortest step before a turning point, relative to the first step
MANY_STEPS = 10**6
CORNER_LENGTH = 0.125  # largest length, relative to the first step, of a failed step that may contain a corner


class PathFollowing:
    """A march along an equilibrium path in progress.

    Args:
        solver: solver of the model, for the first state.
        journal: journal of the march.
        plan: ends of the path and lengths of steps.
        start: time of the first state.
        options: PETSc options of the linear solver; they override our defaults.
    """

    def __init__(
        self, solver: Solver, journal: Journal, plan: ArcLength, start: float, options: Options | None
    ) -> None:
        self.solver, self.plan, self.start = solver, plan, start
        self._journal, self._history = journal, journal.history
        self._log = logger("march", solver.model.comm)
        balance = PathEquations(solver.equations, plan.first, (start + plan.end) / 2, options)
        self._path = EquilibriumPath(balance, plan.first)
        self._unit = math.sqrt(2.0)  # length of the first step: 1 in u and 1 in t
        self._aimed = False  # whether the path knows its direction at the last state

    @property
    def _near(self) -> float:
        return SAME_TIME * max(abs(self.plan.end), abs(self.start))

    def run(self, resume: Resume) -> History:
        """Run the march, or the rest of the march in its folder. Collective; errors as in `march`."""
        try:
            if self._journal.read(resume):
                if self._history.last.t > self.plan.end + self._near:
                    last = self._history.last.t
                    raise InputError(f"the march in {self._journal.out} is at t = {last:g}; the path is to end before")
            elif not len(self._history):
                self._begin()
            self._travel()
        finally:
            self._path.close()
        return self._history

    def _travel(self) -> None:
        """Make steps until the path ends."""
        with telling("path") as tell:
            while self.plan.lowest(self.start) <= self._history.last.t < self.plan.end - self._near:
                self._go_on()
                share = (self._history.last.t - self.start) / (self.plan.end - self.start)  # falls where t turns back
                tell(
                    max(share, 0.0),
                    f"t = {self._history.last.t:.4g} of {self.plan.end:.4g}, {len(self._history)} states",
                )
        if self._history.last.t < self.plan.end - self._near and self.plan.back is None:
            raise SolveError(
                f"the path has come back to t = {self._history.last.t:g} and has not reached end = {self.plan.end:g}",
                self._history,
                advice="give back=, a time < start at which it may end too",
            )

    def _begin(self) -> None:
        try:
            self._journal.accept([self.solver.step(self.solver.rest(self.start), self.start)])
        except SolveError as error:
            raise SolveError(f"the first state, at t = {self.start:g}: {error}", self._history) from error

    def _go_on(self) -> None:
        """Make one step, with shorter lengths until it succeeds."""
        last, before, pace = self._history.last, self._journal.before, self._journal.pace
        if len(self._history) > self.plan.steps:
            raise SolveError(
                f"the path is at t = {last.t:g} after {self.plan.steps} steps, not at end = {self.plan.end:g}",
                self._history,
                advice="give more steps, or a longer first one",
            )
        length = min(1.0 if pace.step is None else pace.step, self.plan.largest)
        try:
            if not self._aimed:
                self._path.weight = pace.weight
                self._path.aim(before, last)
            state = None
            while state is None:
                state, length = self._try(last, length)
        except SolveError as error:
            raise SolveError(
                f"step {len(self._history)} of the path, from t = {last.t:g}, failed, and so did longer ones: {error}",
                self._history,
            ) from error
        self._aimed = pace.weight > 0
        if not pace.weight:
            pace.weight = self._unit_of_displacements(last, state)
        factor = math.sqrt(WANTED_ITERATIONS / max(state.report.iterations, 1))
        pace.step = length * min(max(factor, LEAST_FACTOR), MOST_FACTOR)
        self._journal.accept([state])

    def _unit_of_displacements(self, first: State, last: State) -> float:
        """Weight 1/U^2, with the change U of nodal displacements in a first step of full length."""
        change = last.u.x.petsc_vec.copy()
        change.axpy(-1.0, first.u.x.petsc_vec)
        unit = change.norm() * self.plan.first / (last.t - first.t)
        change.destroy()
        if not unit:
            still = f"nothing moves from t = {first.t:g} to {last.t:g}: the path has no direction"
            raise SolveError(still, self._history)
        return 1 / unit**2

    def _try(self, last: State, length: float) -> tuple[State | None, float]:
        """The state after a step and its length; None and half the length if the step fails.

        Lengths are relative to that of the first step.
        """
        scale = self._unit if self._path.weight else 1.0
        try:
            return self._checked(last, self._reach(last, length * scale)), length
        except SolveError as error:
            failed = error
        if self._path.weight and length <= CORNER_LENGTH:
            try:
                return self._checked(last, self._path.step(last, length * scale, turn=True)), length
            except SolveError:
                pass
        if length / 2 < self.plan.smallest:
            raise failed
        self._log.info("t = %g: the step of length %.3g along the path is halved: %s", last.t, length, failed.reason)
        return None, length / 2

    def _checked(self, last: State, state: State) -> State:
        """The state, with the path's direction found there. SolveError: it may not be the next state of the path."""
        self._path.aim(last, state, check=True)
        return state

    def _reach(self, last: State, length: float) -> State:
        """The state after a step, or at the end of the path if that comes first."""
        end = self.plan.end
        if self._path.ahead(last, length) >= end - self._near:
            try:
                return self._path.land(last, None, end)
            except SolveError:
                pass  # the path may turn back before its end
        state = self._path.step(last, length)
        return self._path.land(last, state, end) if state.t > end - self._near else state


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
        self, solver: Solver, journal: Journal, times: Sequence[float], start: float, options: Options | None
    ) -> None:
        self._times, lengths = times, np.diff([start, *times])
        first = float(lengths[0])
        plan = ArcLength(times[-1], first, smallest=CLOSENESS, largest=float(lengths.max()) / first, steps=MANY_STEPS)
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
