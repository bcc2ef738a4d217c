"""Marching in time steps that are planned or adaptive, and shortened if they fail."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from petsc4py import PETSc

from forms.base import Array, InputError
from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.discretisation.state import State
from thinlayer.errors import LimitLoad, NoEquilibrium, SolveError, warn
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import SAME_TIME, History
from thinlayer.solving.solvers import Solver
from thinlayer.system.identity import Resume
from thinlayer.system.progress import logger, telling
from thinlayer.time.journal import Journal
from thinlayer.time.plan import HALVINGS, Plan, distinct
from thinlayer.time.switching import steps

# Least size of jumps to which errors are relative, as a share of the displacements; rounding is smaller.
LEAST_JUMP = 1e-6
QUANTITIES = ("displacements", "jumps", "forces")
SAME_LOADS = 1e-12  # relative change of loads that counts as none
SAFETY = 0.9  # factor on the length of an adaptive step that its error allows
LEAST_FACTOR, MOST_FACTOR = 0.2, 3.0  # bounds of the ratio of the lengths of two adaptive steps
NEARER = 8.0  # ratio of the lengths of two steps by weak springs
SEEK_STEPS = 16  # longest step by weak springs, in lengths of the adaptive step that failed: it may be far from a limit
NO_LIMIT = (
    "no equilibrium was found, which need not be a limit of the loads: displacements did not run away. Try other times, "
    "another mesh, more steps of Newton's method, or in a layer that yields an elastic fraction or other cells through it"
)


class TimeStepping:
    """A march in time in progress.

    Args:
        solver: solver of the model.
        journal: journal of the march.
        plan: ends and lengths of steps.
        start: time of the first state.
        theta: forces balance at t + theta dt.
    """

    def __init__(self, solver: Solver, journal: Journal, plan: Plan, start: float, theta: float) -> None:
        self.solver, self.plan, self.start, self.theta = solver, plan, start, theta
        self._journal, self._history = journal, journal.history
        self._late = solver.equations.traits.rate  # whether a part does not answer to a sudden load at once
        self._failed_at: float | None = None  # earliest end of a failed step that the march has not reached
        self._run_away = math.inf  # earliest time at which displacements ran away
        self._shortest = False  # whether the step cannot be shortened further
        self._estimate = ErrorEstimate(solver.equations) if plan.adaptive else None

    def run(self, resume: Resume) -> History:
        """Run the march, or the rest of the march in its folder. Collective; errors as in `march`."""
        with telling("march") as self._tell:
            if self._journal.read(resume):
                last, end = self._history.last.t, self.plan.targets[-1]
                if last > end + SAME_TIME * max(abs(end), abs(self.start)):
                    raise InputError(f"the march in {self._journal.out} is at t = {last:g}; times end before")
                if passed := self._passed():
                    warn(
                        "passed time",
                        f"the march in {self._journal.out} is at t = {last:g} and has no step that ended at t = "
                        f"{', '.join(f'{t:g}' for t in passed)}, which times ask for: there is no row for it",
                        self.solver.model.comm,
                    )
            else:
                self._begin()
            for target in self.plan.after(self._history.last.t):
                self._reach(target)
        return self._history

    def _passed(self) -> list[float]:
        """Targets that a resumed march has passed without a row for them."""
        done, end = self._history.t, self.plan.targets[-1]
        near = SAME_TIME * max(abs(end), abs(self.start))
        return [t for t in self.plan.targets if t < done[-1] - near and np.abs(done - t).min() > near]

    def _begin(self) -> None:
        """Find the first state. A state at rest is written later, with the first step."""
        rest = self.solver.rest(self.start)
        if self._late:
            self._journal.note(rest)
            return
        try:
            self._accept([self.solver.step(rest, self.start)])
        except SolveError as error:
            advice = "let the loads grow from less, as functions (x, t) or piecewise" if self.solver.yields else ""
            what = f"the sudden load at t = {self.start:g}: {error.reason if advice else error}"
            raise SolveError(what, self._history, advice=advice) from error

    def _reach(self, target: float) -> None:
        """Step to a target, in shorter steps if necessary."""
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
                large = SolveError("its estimated error stays above the tolerance")
                self._shorten((end - old.t) * factor, old, end, large)
                continue
            passed = self._failed_at is None or end >= self._failed_at
            if self.plan.adaptive:
                step = (end - old.t) * factor
                if end == target:  # a step that the target cuts short does not limit the next one
                    step = max(step, planned)
                self._journal.pace.step = min(step, self.plan.adaptive.largest)
            elif self._journal.pace.step is not None:
                self._journal.pace.step = None if end == target else 2 * dt if passed or not self.solver.bounded else dt
            if passed:
                self._failed_at = None
            self._shortest = False
            self._accept(states)

    def _accept(self, states: list[State]) -> None:
        """Add states to the journal, and update the norms to which errors are relative."""
        if self._estimate:
            pace = self._journal.pace
            for state in states:
                pace.largest = [*map(float, np.maximum(pace.largest, self._estimate.sizes(state)))]
        self._journal.accept(states)
        t, end = self._history.last.t, self.plan.targets[-1]
        self._tell((t - self.start) / (end - self.start), f"t = {t:.4g} of {end:.4g}")

    @property
    def _smallest(self) -> float:
        return self.plan.smallest * (1 - SAME_TIME)

    @property
    def _thorough(self) -> bool:
        """Whether to try eased laws, too: for planned and shortest steps, and after a step that has used them."""
        whole = self._failed_at is None and (self._journal.pace.step is None or self.plan.adaptive is not None)
        return whole or self._shortest or self._history.last.report.eased > 0

    def _fail(self, old: State, end: float, error: SolveError) -> None:
        """Shorten a step whose solve failed; the shortest step is tried again with eased laws."""
        dt, thorough = (end - old.t) / 2, self._thorough
        self._failed_at = end if self._failed_at is None else min(end, self._failed_at)
        if self.solver.bounded and not thorough and dt < self._smallest:
            self._shortest = True
        else:
            self._shorten(dt, old, end, error)

    def _shorten(self, dt: float, old: State, end: float, error: SolveError) -> None:
        if dt >= self._smallest and distinct(old.t, old.t + dt):
            message = "step from t = %g to %g is shortened to %g: %s"
            logger("march", self.solver.model.comm).info(message, old.t, end, dt, error)
            self._journal.pace.step = dt
            return
        if self.solver.bounded and self._seek(old, end, error):
            return
        raise SolveError(
            f"step {len(self._history)}, from t = {old.t:g} to {end:g}, failed, and so did longer ones: {error}",
            self._history,
            advice=NO_LIMIT if self.solver.bounded else "",
        ) from error

    def _farthest(self, t: float, end: float) -> float:
        """The latest time at which an equilibrium is sought by weak springs."""
        target, adaptive = self.plan.after(t)[0], self.plan.adaptive
        return min(target, t + max(SEEK_STEPS * (end - t), adaptive.first / 2**HALVINGS)) if adaptive else target

    def _seek(self, old: State, end: float, error: SolveError) -> bool:
        """Make a step by weak springs after the shortest step has failed. True if it succeeds.

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
                sign, self._run_away = (t, run_away), t
            except SolveError:
                pass  # displacements that ran away at a later time still show a limit before it
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
        a, b = (self.solver.equations.given_forces_at(t) for t in (before, after))
        size = b.norm()
        b.axpy(-1.0, a)
        change = b.norm()
        a.destroy()
        b.destroy()
        return bool(change > SAME_LOADS * size)

    def _resultant(self, t: float) -> list[float]:
        """Sum of the loads on the bodies at time t, those of rigid plates included, (d,)."""
        model, loads = self.solver.model, self.solver.equations.loads_at(t)
        translations = [*rigid_motions(model.V, model.joint).values()][: model.joint.dim]
        forces = [float(loads.dot(motion.x.petsc_vec)) for motion in translations]
        loads.destroy()
        return forces

    def _try(self, old: State, end: float) -> tuple[list[State], float]:
        """States of a step ([] if its error is too large), and the ratio of the next step's length to this one's."""
        theta = 1.0 if len(self._history) == 1 and self._late else self.theta
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
        ratio = (adaptive.tolerance / error) ** (1 / (order + 1)) if error else MOST_FACTOR
        factor = float(np.clip(SAFETY * ratio, LEAST_FACTOR, MOST_FACTOR))
        return (halves if error <= adaptive.tolerance else []), factor

    def _look_ahead(self, estimate: ErrorEstimate, end: State) -> None:
        """After rest, make errors relative to the values at the end of the first step tried, even if it is not accepted.

        A quantity that grows from zero as a power of time has a constant relative error in its first step, however short
        the step. A quantity is at rest if its norm is less than the tolerance times that at the end of the step.
        """
        assert self.plan.adaptive is not None
        pace, sizes = self._journal.pace, estimate.sizes(end)
        at_rest = np.array(pace.largest) < self.plan.adaptive.tolerance * sizes
        pace.largest = [*map(float, np.where(at_rest, sizes, pace.largest))]

    def _chain(self, state: State, ends: list[float], theta: float) -> Iterator[State]:
        for t in ends:
            state = self.solver.step(state, t, theta, self._thorough)
            yield state


class ErrorEstimate:
    """Compares a step with its two halves. All methods are collective.

    Three quantities are compared in L2 norms:

    - the displacements of nodes;
    - the strains of the layer at its points; on S these are jumps over the thickness, under a contact law jumps at nodes;
    - the nodal forces of the bodies' stresses, which change with reactions of supports and tractions on the layer.

    Displacements are not enough: a layer may relax under bodies that hardly move, and a jump may be small compared with
    the motion of a whole body.

    Args:
        equations: the equations of the model.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, self.comm = equations, equations.comm
        self._unit = float(np.sqrt(sum(equations.ask("unit_jump_measure"))))  # norm of strains for a unit jump, about

    def error(self, whole: State, halves: State, order: int, largest: list[float]) -> float:
        """Estimated error at the end of the two halves: the largest of the three quantities' relative errors.

        Args:
            whole: state at the end of the step.
            halves: state at the end of the two halves.
            order: order of the time scheme.
            largest: norms of the three quantities to which errors are relative, at least.
        """
        return float(self.shares(whole, halves, largest).max()) / (2**order - 1)

    def shares(self, other: State, state: State, largest: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
        """Differences of two states in the three quantities, over their norms in the second one, or over `largest`."""
        ends = [self._quantities(one) for one in (other, state)]
        apart = self._norms([b - a for a, b in zip(*ends, strict=True)])
        sizes = np.maximum(self._norms(ends[1]), largest)
        moved = float(state.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))
        least = np.array([0.0, LEAST_JUMP * self._unit * moved, self._equations.scale.forces])
        sizes = np.maximum(sizes, least)
        return np.divide(apart, sizes, out=np.zeros(3), where=sizes > 0)

    def sizes(self, state: State) -> Array:
        """Norms of the three quantities in a state."""
        return self._norms(self._quantities(state))

    def _quantities(self, state: State) -> list[Array]:
        """The three quantities in a state, on this rank."""
        u = state.u
        forces = u.x.petsc_vec.duplicate()
        forces.set(0.0)
        jumps = self._equations.ask("error_measure", u)
        self._equations.ask("add_forces_in", state, forces)
        of_forces = forces.array_r.copy()
        forces.destroy()
        return [u.x.petsc_vec.array_r.copy(), np.concatenate([np.empty(0), *jumps]), of_forces]

    def _norms(self, parts: list[Array]) -> Array:
        return np.sqrt(self.comm.allreduce(np.array([part @ part for part in parts])))
