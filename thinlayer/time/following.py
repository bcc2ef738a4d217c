"""Marching along an equilibrium path, through points where loads or supports turn back."""

from __future__ import annotations

import math
from collections.abc import Mapping

from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError, SolveError
from thinlayer.parallel.log import logger
from thinlayer.solving.options import OptionValue
from thinlayer.solving.solvers import Solver
from thinlayer.time.arc_length import ArcLength
from thinlayer.time.history import SAME_TIME, History
from thinlayer.time.journal import Journal
from thinlayer.time.path import EquilibriumPath
from thinlayer.time.path_equations import PathEquations

WANTED = 4  # Newton steps; of one that needs fewer the next is longer
LEAST, MOST = 0.5, 2.0  # of the change of a step
TURN = 0.125  # part of the first step's length, below which a step that fails is taken to have a corner in it


class PathFollowing:
    """A march along a path under way.

    Args:
        solver: of the model, for the first state.
        journal: of the march.
        plan: where the path ends, and how long steps are.
        start: time of the first state.
        options: PETSc options of the linear solver, over ours.
    """

    def __init__(
        self,
        solver: Solver,
        journal: Journal,
        plan: ArcLength,
        start: float,
        options: Mapping[str, OptionValue] | None,
    ) -> None:
        self.solver, self.plan, self.start = solver, plan, start
        self._journal = journal
        self._log = logger("march", solver.model.comm)
        balance = PathEquations(solver.equations, plan.first, (start + plan.end) / 2, options)
        self._path = EquilibriumPath(balance, plan.first)
        self._unit = math.sqrt(2.0)  # length of the first step, which has a length of 1 in u and in t
        self._aimed = False  # whether the path's direction is that at the last state

    @property
    def _history(self) -> History:
        return self._journal.history

    @property
    def _near(self) -> float:
        return SAME_TIME * max(abs(self.plan.end), abs(self.start))

    def run(self, resume: bool) -> History:
        """The march, or the rest of the one that is in its folder. Collective; errors as in `march`."""
        try:
            if self._journal.read(resume):
                if self._history.last.t > self.plan.end + self._near:
                    raise ModelError(
                        f"the march in {self._journal.out} is at t = {self._history.last.t:g}; the path is to end before"
                    )
            else:
                self._begin()
            while self.plan.lowest(self.start) <= self._history.last.t < self.plan.end - self._near:
                self._go_on()
        finally:
            self._path.close()
        if self._history.last.t < self.plan.end - self._near and self.plan.back is None:
            raise SolveError(
                f"the path has come back to t = {self._history.last.t:g} and has not reached end = {self.plan.end:g}",
                self._history,
                advice="give back=, a time < start at which it may end too",
            )
        return self._history

    def _begin(self) -> None:
        try:
            self._journal.accept([self.solver.step(self.solver.rest(self.start), self.start)])
        except SolveError as error:
            raise SolveError(f"the first state, at t = {self.start:g}: {error}", self._history) from error

    def _go_on(self) -> None:
        """One step, shortened where need be."""
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
        factor = math.sqrt(WANTED / max(state.report.iterations, 1))
        pace.step = length * min(max(factor, LEAST), MOST)
        self._journal.accept([state])

    def _unit_of_displacements(self, first: State, last: State) -> float:
        """1/U^2, with the change U of nodal displacements in a first step of full length."""
        change = last.u.x.petsc_vec.copy()
        change.axpy(-1.0, first.u.x.petsc_vec)
        unit = change.norm() * self.plan.first / (last.t - first.t)
        change.destroy()
        if not unit:
            raise SolveError(
                f"nothing moves from t = {first.t:g} to {last.t:g}: a path has no direction", self._history
            )
        return 1 / unit**2

    def _try(self, last: State, length: float) -> tuple[State | None, float]:
        """The state of a step of a length, relative to the first one's, and that length; None and half of it."""
        scale = self._unit if self._path.weight else 1.0
        try:
            return self._checked(last, self._reach(last, length * scale)), length
        except SolveError as error:
            failed = error
        if self._path.weight and length <= TURN:
            try:
                return self._checked(last, self._path.step(last, length * scale, turn=True)), length
            except SolveError:
                pass
        if length / 2 < self.plan.smallest:
            raise failed
        self._log.info("t = %g: the step of length %.3g along the path is halved: %s", last.t, length, failed.reason)
        return None, length / 2

    def _checked(self, last: State, state: State) -> State:
        """A state from which the path goes on. Errors where it may not be the next one."""
        self._path.aim(last, state, check=True)
        return state

    def _reach(self, last: State, length: float) -> State:
        """The state of a step, or the one at the end of the path where that comes first."""
        end = self.plan.end
        if self._path.ahead(last, length) >= end - self._near:
            try:
                return self._path.land(last, None, end)
            except SolveError:
                pass  # the path may turn back before its end
        state = self._path.step(last, length)
        return self._path.land(last, state, end) if state.t > end - self._near else state
