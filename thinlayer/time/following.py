"""Controllers of steps along an equilibrium path by arc length, also where the load parameter t decreases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError, TurningPoint
from thinlayer.solving.petsc import Options
from thinlayer.time.controller import Controller, StepAttempt
from thinlayer.time.path import EquilibriumPath

if TYPE_CHECKING:  # the settings make their controllers
    from thinlayer.time.plan import ArcLength

IDEAL_NEWTON_STEPS = 4  # number of Newton steps at which the length of the next step stays the same
MIN_LENGTH_RATIO, MAX_LENGTH_RATIO = 0.5, 2.0  # bounds of the ratio of the lengths of two steps
MAX_CORNER_LENGTH = 0.125  # largest length, relative to the first step, of a failed step that may contain a corner
MANY_STEPS = 10**6
FAILURE_ADVICE = (
    "support bodies that come loose as all that bears them breaks; else take a smaller first step, a finer mesh, or "
    "more toughness; the states so far are in the error's history"
)


@dataclass(eq=False)
class ArcLengthController(Controller):
    """Controller of steps of given arc length along an equilibrium path.

    In its methods, the length of a step is its arc length over that of the first step.

    Attributes:
        plan: settings of the user: ends of the path, and limits of the lengths of steps.
        options: PETSc options of the linear solver, which override the package's defaults.
    """

    plan: ArcLength
    options: Options

    def __post_init__(self) -> None:
        super().__post_init__()
        self.min_length = self.plan.smallest
        self._path = EquilibriumPath(self.solver.equations, self.plan.first, self.options)
        self._direction_state: State | None = None  # the state at which the path's direction has been computed

    @property
    def done(self) -> bool:
        min_t = self.plan.back
        return super().done or (min_t is not None and self.last.t < min_t)

    def next_length(self) -> float:
        settings, pace, last, previous = self.plan, self.journal.pace, self.last, self.journal.previous
        n_steps = len(self.journal.history) - 1
        if last.t < settings.lowest(self.start):
            text = f"the path has come back to t = {last.t:g} and has not reached end = {settings.end:g}"
            raise self.error(text, "give back=, a time < start at which it may end too")
        if n_steps >= settings.steps:
            text = f"the path is at t = {last.t:g} after {settings.steps} steps, not at end = {settings.end:g}"
            raise self.error(text, "give more steps, or a longer first one")
        if n_steps and previous and not pace.weight:
            pace.weight, self._direction_state = self._length_weight(previous, last), None
        self._path.inner_time = ([self.start, *self.targets][self._n_targets_passed] + self.target) / 2
        try:
            if self._direction_state is not last:
                self._set_direction()
        except SolveError as error:
            raise self.failure(1.0, [error]) from error
        return min(pace.step or 1.0, settings.largest or math.inf)

    def _set_direction(self, *, forward: bool = False) -> None:
        """Compute the direction of the path at the last state.

        It leads away from the state before the last one. If there is no such state, t increases along it.

        Args:
            forward: whether t must increase along the direction even if there is a state before.

        Raises:
            SolveError: the direction cannot be computed.
        """
        self._path.length_weight, self._direction_state = self.journal.pace.weight, self.last
        self._path.set_direction(None if forward else self.journal.previous, self.last)

    def _length_weight(self, before: State, last: State) -> float:
        """Return the factor 1/U^2 of squared displacements in the squared arc length.

        U is the norm of the change of nodal displacements between the first two states, per change of t, times
        `ArcLength.first`.

        Args:
            before, last: the first two states of the path.

        Raises:
            SolveError: U is 0, as nothing moves.
        """
        u_unit = float((last.u.x.petsc_vec - before.u.x.petsc_vec).norm()) * self.plan.first / (last.t - before.t)
        if not u_unit:
            advice = "loads or supports must change with t from the start on; begin where they do, with start="
            raise self.error(f"nothing moves from t = {before.t:g} to {last.t:g}: the path has no direction", advice)
        return 1 / u_unit**2

    @property
    def attempts(self) -> list[StepAttempt]:
        smooth_step = StepAttempt("a step along the path", self._step_ahead)
        corner_step = StepAttempt("a step through a corner", self._step_through_corner, MAX_CORNER_LENGTH / 2)
        return [smooth_step, corner_step] if self._path.length_weight else [smooth_step]

    def _arc_length(self, length: float) -> float:
        """Return the arc length of a step from its length relative to the first step.

        The squared arc length is a sum of two terms, from displacements and from t. In the first step each term is 1,
        so that its arc length is sqrt(2). Until the unit of displacements is known, only the term from t counts.
        """
        return length * math.sqrt(2.0) if self._path.length_weight else length

    def _step_ahead(self, length: float) -> list[State]:
        """Make a step along the path, and return its state in a list.

        If the step would pass the next time of `targets`, the state is the one at this time.

        Args:
            length: arc length of the step over that of the first step.

        Raises:
            SolveError: the step fails.
        """
        last, target, arc_length = self.last, self.target, self._arc_length(length)
        self._path.must_be_straight, state = length > 1 and self.plan.largest is None, None
        predicted_t = last.t + arc_length * self._path.t_slope
        if self._path.must_be_straight and predicted_t < self.plan.lowest(self.start):
            raise SolveError("a step longer than the first would end too far back")
        if predicted_t >= target - self.time_slack:
            with suppress(SolveError):  # the path may turn back before the target
                state = self._path.solve_at_time(last, None, target)
        if state is None:
            state = self._path.step(last, arc_length)
            state = self._path.solve_at_time(last, state, target) if state.t > target - self.time_slack else state
        return self._accept_state(state, length)

    def shorter_length(self, length: float, error: SolveError) -> float:
        return super().shorter_length(length, error) if length <= 1 else max(length / 2, 1.0)

    def _step_through_corner(self, length: float) -> list[State]:
        self._path.must_be_straight = False
        return self._accept_state(self._path.step(self.last, self._arc_length(length), turn=True), length)

    def _accept_state(self, state: State, length: float) -> list[State]:
        """Accept a state as the next one of the path, and return it in a list.

        This also computes the direction of the path at the state, and the largest length of the next step.

        Args:
            state: the state.
            length: length of the step that has led to it, over that of the first step.

        Raises:
            SolveError: the path turns within the step, or the state seems to be on another path.
        """
        self._path.set_direction(self.last, state, check=True)
        length_factor = math.sqrt(IDEAL_NEWTON_STEPS / max(state.report.iterations, 1))
        self.journal.pace.step = length * min(max(length_factor, MIN_LENGTH_RATIO), MAX_LENGTH_RATIO)
        self._direction_state = state
        return [state]

    def failure(self, length: float, errors: Sequence[SolveError]) -> SolveError:
        step_text = f"step {len(self.journal.history)} of the path, from t = {self.last.t:g}"
        return self.error(f"{step_text}, failed, and so did longer ones: {errors[0]}", FAILURE_ADVICE)


class PathToTimesController(ArcLengthController):
    """Controller of steps along an equilibrium path to given times; it stops where time would decrease along the path.

    Loads and displacements of supports are functions of the time t. Steps along the path follow each bend of it,
    whereas a step in time could end beyond a loop of the path. A step ends at each break time of `piecewise` data,
    where slopes of loads change. There the direction of the path is chosen anew, with t increasing.
    """

    _turns_back = False  # whether the path has turned back in the last step tried

    def _is_break_time(self, t: float) -> bool:
        return any(abs(t - break_time) <= self.time_slack for break_time in self.solver.model.break_times)

    def _set_direction(self, *, forward: bool = False) -> None:
        super()._set_direction(forward=self._is_break_time(self.last.t))

    def _accept_state(self, state: State, length: float) -> list[State]:
        """Accept a state as the next one of the path, and return it in a list.

        Args:
            state: the state.
            length: length of the step that has led to it, over that of the first step.

        Raises:
            SolveError: t decreases up to this state or beyond it; the path turns within the step; or the state seems to
                be on another path.
        """
        states = super()._accept_state(state, length)
        self._turns_back = not (self._path.t_slope > 0 and state.t > self.last.t)
        if self._turns_back:
            self._set_direction()
            raise SolveError("the path turns back in time")
        if self._is_break_time(state.t):
            self._direction_state = None
        return states

    def failure(self, length: float, errors: Sequence[SolveError]) -> SolveError:
        return TurningPoint(self.last.t, self.journal.history) if self._turns_back else super().failure(length, errors)
