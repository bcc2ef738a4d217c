"""Marching in steps of time that are planned or adapted, and halved where they fail."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.discretisation.state import State
from thinlayer.errors import LimitLoad, ModelError, NoEquilibrium, SolveError, warn
from thinlayer.files.progress import track
from thinlayer.parallel.log import logger
from thinlayer.solving.solvers import Solver
from thinlayer.time.error import ErrorEstimate
from thinlayer.time.history import SAME_TIME, History
from thinlayer.time.journal import Journal
from thinlayer.time.plan import HALVINGS, Plan, distinct
from thinlayer.time.switching import steps

SAME_LOADS = 1e-12  # relative change
SAFETY, LEAST, MOST = 0.9, 0.2, 3.0  # of the change of an adaptive step
NEARER = 8.0  # of times at which equilibria are sought beyond a step that fails
CLOSE = 16  # adaptive steps: these may become too short well before the limit that makes displacements grow
NO_LIMIT = (
    "no equilibrium was found, which need not be a limit of the loads: displacements have not been seen to run away. Try "
    "an elastic fraction h, other times, another mesh or number of sublayers, or more steps of Newton's method"
)


class TimeStepping:
    """A march in time under way.

    Args:
        solver: of the model.
        journal: of the march.
        plan: when steps end.
        start: time of the first state.
        theta: of the balance of forces.
    """

    def __init__(self, solver: Solver, journal: Journal, plan: Plan, start: float, theta: float) -> None:
        self.solver, self.plan, self.start, self.theta = solver, plan, start, theta
        self._journal = journal
        self._failed_at: float | None = None  # earliest end of a step that failed, still ahead
        self._run_away = math.inf  # earliest time at which displacements were seen to run away
        self._shortest = False  # whether the step cannot be shortened further
        self._estimate = ErrorEstimate(solver.equations) if plan.adaptive else None

    @property
    def _history(self) -> History:
        return self._journal.history

    @property
    def _sudden(self) -> bool:
        """Whether the layer answers a sudden load at once."""
        return not any(p.law.traits.rate for p in self.solver.model.terms)

    def run(self, resume: bool) -> History:
        """The march, or the rest of the one that is in its folder. Collective; errors as in `march`."""
        if self._journal.read(resume):
            last, end = self._history.last.t, self.plan.targets[-1]
            if last > end + SAME_TIME * max(abs(end), abs(self.start)):
                raise ModelError(f"the march in {self._journal.out} is at t = {last:g}; times end before")
            if passed := self._passed():
                warn(
                    f"the march in {self._journal.out} is at t = {last:g} and has no step that ended at t = "
                    f"{', '.join(f'{t:g}' for t in passed)}, which times ask for: there is no row for it",
                    self.solver.model.comm,
                )
        else:
            self._begin()
        for target in track(self.plan.after(self._history.last.t), "march", "t = {:g}"):
            self._reach(target)
        return self._history

    def _passed(self) -> list[float]:
        """Times asked for that a march to be resumed has passed without a row."""
        done, end = self._history.t, self.plan.targets[-1]
        near = SAME_TIME * max(abs(end), abs(self.start))
        return [t for t in self.plan.targets if t < done[-1] - near and np.abs(done - t).min() > near]

    def _begin(self) -> None:
        """The first state. One at rest is written together with the first step: until then nothing has been solved."""
        rest = self.solver.rest(self.start)
        if not self._sudden:
            self._journal.note(rest)
            return
        try:
            self._accept([self.solver.step(rest, self.start)])
        except SolveError as error:
            advice = "let the loads grow from less, as functions (x, t) or piecewise" if self.solver.yields else None
            reason = error.reason if advice else str(error)
            raise SolveError(
                f"the sudden load at t = {self.start:g}: {reason}", self._history, advice=advice
            ) from error

    def _reach(self, target: float) -> None:
        """Step to a time, in shorter steps where need be."""
        while self._history.last.t != target:
            old = self._history.last
            left = target - old.t
            planned = self._journal.pace.step or left
            dt = min(planned, left)
            end = target if left - dt < 1e-3 * dt else old.t + dt
            if not distinct(old.t, end):
                raise SolveError(f"a step of {dt:g} from t = {old.t:.16g} is lost in rounding", self._history)
            try:
                states, factor = self._try(old, end)
            except SolveError as error:
                self._fail(old, end, error)
                continue
            if not states:
                self._shorten(
                    (end - old.t) * factor, old, end, SolveError("its estimated error stays above the tolerance")
                )
                continue
            passed = self._failed_at is None or end >= self._failed_at
            if self.plan.adaptive:
                step = (end - old.t) * factor
                if end == target:  # a step cut short for the target says nothing against a longer one
                    step = max(step, planned)
                self._journal.pace.step = min(step, self.plan.adaptive.largest)
            elif self._journal.pace.step is not None:
                self._journal.pace.step = None if end == target else 2 * dt if passed or not self.solver.yields else dt
            if passed:
                self._failed_at = None
            self._shortest = False
            self._accept(states)

    def _accept(self, states: list[State]) -> None:
        """Note states, and how large what errors are measured against has become."""
        if self._estimate:
            pace = self._journal.pace
            for state in states:
                pace.largest = [*map(float, np.maximum(pace.largest, self._estimate.sizes(state)))]
        self._journal.accept(states)

    @property
    def _smallest(self) -> float:
        return self.plan.smallest * (1 - SAME_TIME)

    @property
    def _thorough(self) -> bool:
        """Whether a step is worth every effort: a planned one, the shortest one, one after another that took it."""
        whole = self._failed_at is None and (self._journal.pace.step is None or self.plan.adaptive is not None)
        return whole or self._shortest or self._history.last.report.eased > 0

    def _fail(self, old: State, end: float, error: SolveError) -> None:
        """Shorten a step whose solve failed; the shortest one is tried again with every effort."""
        dt, thorough = (end - old.t) / 2, self._thorough
        self._failed_at = end if self._failed_at is None else min(end, self._failed_at)
        if self.solver.yields and not thorough and dt < self._smallest:
            self._shortest = True
        else:
            self._shorten(dt, old, end, error)

    def _shorten(self, dt: float, old: State, end: float, error: SolveError) -> None:
        if dt >= self._smallest and distinct(old.t, old.t + dt):
            what = "step from t = %g to %g is shortened to %g: %s"
            logger("march", self.solver.model.comm).info(what, old.t, end, dt, error)
            self._journal.pace.step = dt
            return
        if self.solver.yields and self._seek(old, end, error):
            return
        raise SolveError(
            f"step {len(self._history)}, from t = {old.t:g} to {end:g}, failed, and so did longer ones: {error}",
            self._history,
            advice=NO_LIMIT if self.solver.yields else None,
        ) from error

    def _farthest(self, t: float, end: float) -> float:
        """Until when equilibria are sought: to the end of a planned step, or about as near as adaptive steps come."""
        target, adaptive = self.plan.after(t)[0], self.plan.adaptive
        return min(target, t + max(CLOSE * (end - t), adaptive.first / 2**HALVINGS)) if adaptive else target

    def _seek(self, old: State, end: float, error: SolveError) -> bool:
        """Take a step by other means where shorter ones have failed; whether one is found.

        Raises:
            LimitLoad: displacements run away as loads change, at the end of the shortest step or, if adaptive, near it.
        """
        t, sign = self._farthest(old.t, end), None
        if old.t < self._run_away < t:
            t = self._nearer(old.t, self._run_away, end)
        while True:
            try:
                state = self.solver.seek(old, t, self.theta)
            except NoEquilibrium as run_away:
                sign, self._run_away = (t, run_away.growth), t
            except SolveError:
                pass  # what was seen farther on still says that there is a limit before
            else:
                if self.plan.adaptive:
                    break
                self._failed_at, self._shortest, self._journal.pace.step = None, False, t - old.t
                self._accept([state])
                return True
            if t <= end:
                break
            t = self._nearer(old.t, t, end)
        if sign and self._loads_change(old.t, sign[0]):
            raise LimitLoad(error.reason, old.t, sign[0], self._resultant(old.t), sign[1], self._history) from error
        return False

    def _nearer(self, start: float, t: float, end: float) -> float:
        return max(start + (t - start) / NEARER, end)

    def _loads_change(self, before: float, after: float) -> bool:
        a, b = (self.solver.equations.history.loads_at(t) for t in (before, after))
        size = b.norm()
        b.axpy(-1.0, a)
        change = b.norm()
        a.destroy()
        b.destroy()
        return bool(change > SAME_LOADS * size)

    def _resultant(self, t: float) -> list[float]:
        """Tractions and body forces on the bodies at a time, their sum."""
        model, loads = self.solver.model, self.solver.equations.history.loads_at(t)
        translations = [*rigid_motions(model.V, model.joint).values()][: model.joint.dim]
        forces = [float(loads.dot(motion.x.petsc_vec)) for motion in translations]
        loads.destroy()
        return forces

    def _try(self, old: State, end: float) -> tuple[list[State], float]:
        """States of a step, none if its error is too large, and by how much the next step may be longer or shorter."""
        theta = 1.0 if len(self._history) == 1 and not self._sudden else self.theta
        middle = (old.t + end) / 2
        adaptive, estimate = self.plan.adaptive, self._estimate
        if self.solver.equations.traits.switches:
            return [*steps(self.solver, old, end)], 1.0
        if adaptive is None or estimate is None:
            ends = [middle, end] if theta != self.theta else [end]
            return [*self._chain(old, ends, theta)], 1.0
        whole = self.solver.step(old, end, theta, self._thorough)
        halves = [*self._chain(old, [middle, end], theta)]
        order = 2 if theta == 0.5 else 1
        self._look_ahead(estimate, halves[-1])
        error = estimate.error(whole, halves[-1], order, self._journal.pace.largest)
        ratio = (adaptive.tolerance / error) ** (1 / (order + 1)) if error else MOST
        factor = float(np.clip(SAFETY * ratio, LEAST, MOST))
        return (halves if error <= adaptive.tolerance else []), factor

    def _look_ahead(self, estimate: ErrorEstimate, end: State) -> None:
        """Measure errors against what the first step after rest brings, even if it is too long to be taken.

        What grows from nothing as a power of time has, in the first step, an error that is a fixed share of it, however
        short that step is. At rest is what the tolerance does not tell from zero next to what comes.
        """
        assert self.plan.adaptive is not None
        pace, sizes = self._journal.pace, estimate.sizes(end)
        at_rest = np.array(pace.largest) < self.plan.adaptive.tolerance * sizes
        pace.largest = [*map(float, np.where(at_rest, sizes, pace.largest))]

    def _chain(self, state: State, ends: list[float], theta: float) -> Iterator[State]:
        for t in ends:
            state = self.solver.step(state, t, theta, self._thorough)
            yield state
