"""Controllers of steps in time, to given times, of adaptive length, or from snap to snap; and estimates of errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from forms.base import Array
from forms.kinematics import PLANE_STRAIN
from thinlayer.discretisation.rigid_motions import model_motions
from thinlayer.discretisation.state import State
from thinlayer.errors import LimitLoad, LooseBody, NoEquilibrium, SolveError
from thinlayer.parts.part import MeasuresError
from thinlayer.pointwise.columns import EXCESS_TOLERANCE
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import TIME_TOLERANCE
from thinlayer.time.controller import Controller, StepAttempt, is_divisible

if TYPE_CHECKING:  # the settings make their controllers
    from thinlayer.time.plan import Adaptive

# Least size of jumps to which errors are relative, over the displacements; rounding is smaller.
MIN_JUMP_RATIO = 1e-6
COMPARED_QUANTITIES = ("displacements", "jumps", "forces")
LOAD_CHANGE_TOLERANCE = 1e-12  # relative change of loads that counts as zero
MAX_HALVINGS = 10  # largest number of times that a planned step is halved
MAX_SHORTENING_RATIO = 1e6  # default length of the first adaptive step over the shortest
SAFETY_FACTOR = 0.9  # factor on the length of an adaptive step that its error allows
MIN_LENGTH_RATIO, MAX_LENGTH_RATIO = 0.2, 3.0  # bounds of the ratio of the lengths of two adaptive steps
SPRING_SHORTENING_RATIO = 8.0  # length of a failed step by weak springs over that of the next
# longest step by weak springs, in lengths of the adaptive step that failed: it may be far from a limit
MAX_SPRING_RATIO = 16
MIN_LAST_RATIO = 1e-3  # shortest last step to a target, relative to the step before; a shorter one is joined to it
TIME_ROUNDING = 8 * 2.0**-52  # relative tolerance of the time of a snap
N_EXCESS_TESTS = 8  # number of equal parts of a step at whose ends the excess is tested if loads are not linear in time
LIMIT_HINT = "no equilibrium was found, which need not be a limit of the loads: try other times, or an elastic fraction"


@dataclass(eq=False)
class PlannedStepsController(Controller):
    """Controller of steps that end at given times, or earlier if longer steps fail. It also finds limit loads.

    Attributes:
        theta: fraction of each step after which forces balance.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self.theta = self.journal.history.theta
        self.min_length = float(np.diff([self.start, *self.targets]).min()) / 2**MAX_HALVINGS * (1 - TIME_TOLERANCE)
        self._failed_end = math.inf  # earliest end of a failed step that the march has not reached
        self._diverged_time = math.inf  # earliest time at which displacements grew without bound

    def next_length(self) -> float:
        return min(self.journal.pace.step or math.inf, self.target - self.last.t)

    def _step_end(self, length: float) -> float:
        return self.last.t + length if self.target - self.last.t - length >= MIN_LAST_RATIO * length else self.target

    @property
    def attempts(self) -> list[StepAttempt]:
        """Methods for the next step, in the order in which they are tried.

        The first is Newton's method. Where it fails, it may continue with stiffer laws that approach the given ones
        (homotopy). It does so until a step has failed, and later if the last step needed it. If loads may have a limit,
        two more methods follow in the shortest step: Newton's method with such laws in any case, and weak springs at
        all nodes.
        """
        homotopy = self._failed_end == math.inf or self.last.report.homotopy_steps > 0
        newton = StepAttempt("Newton's method", partial(self._make_step, homotopy=homotopy))
        retry = StepAttempt("Newton's method with homotopy", partial(self._make_step, homotopy=True), self.min_length)
        spring_search = StepAttempt("a search by weak springs", self._regularised_step, self.min_length)
        return [newton, *([] if homotopy else [retry]), spring_search] if self.solver.limited else [newton]

    def failure(self, length: float, errors: Sequence[SolveError]) -> SolveError:
        old, history, cause = self.last, self.journal.history, errors[-1]
        error = errors[-2] if self.solver.limited else cause
        end, is_not_unique = self._step_end(length), isinstance(error, LooseBody) and not error.residuals
        # an equilibrium that is not unique is no limit, unless displacements run away in the shortest step
        may_be_limit = self._diverged_time <= end or not is_not_unique
        if isinstance(cause, NoEquilibrium) and may_be_limit and self._loads_change(old.t, self._diverged_time):
            return LimitLoad(error.reason, old.t, self._diverged_time, self._resultant(old.t), cause, history)
        text = f"step {len(history)}, from t = {old.t:g} to {end:g}"
        return self.error(f"{text}, failed, and so did longer ones: {error}", LIMIT_HINT if self.solver.limited else "")

    def _loads_change(self, before: float, after: float) -> bool:
        a, b = (self.solver.equations.prescribed_forces_at(t).array_r for t in (before, after))
        change_norms, norms = map(self.solver.equations.norms, (b - a, b))
        return bool((change_norms > LOAD_CHANGE_TOLERANCE * norms).any())

    def _resultant(self, t: float) -> list[float]:
        """Return the resultant force of the loads at time `t`, on bodies and rigid plates, as its 2 or 3 components."""
        model, loads = self.solver.model, self.solver.equations.loads_at(t)
        kinematics = model.kinematics if model.n_components == 1 else PLANE_STRAIN  # which has all translations
        translations = [*model_motions(model, kinematics).values()][: model.n_components]
        return [float(loads.dot(motion.x.petsc_vec)) for motion in translations]

    # ---------------------------------------------------------------- attempts
    def _make_step(self, length: float, *, homotopy: bool) -> list[State]:
        old, end = self.last, self._step_end(length)
        if not is_divisible(old.t, end):
            raise SolveError(f"a step of {length:g} from t = {old.t:.16g} is lost in rounding")
        try:
            states = self._solve_step(old, end, 1.0 if old.at_rest else self.theta, homotopy)
        except SolveError as error:
            if not isinstance(error, _StepTooLarge):
                self._failed_end = min(self._failed_end, end)
            raise
        self._set_pace(length, end)
        return states

    def _solve_step(self, old: State, end: float, theta: float, homotopy: bool) -> list[State]:
        """Solve a step, and return its states.

        If `theta` differs from the attribute `theta`, the step is made as two halves, with a state at the end of each.

        Args:
            old: the state before the step.
            end: time at the end of the step.
            theta: fraction of the step after which forces balance; 1 in the first step from rest.
            homotopy: whether stiffer laws that approach the given ones (homotopy) are tried if Newton's method fails.
        """
        return self._successive_states(old, [end] if theta == self.theta else [(old.t + end) / 2, end], theta, homotopy)

    def _successive_states(self, old: State, ends: Sequence[float], theta: float, homotopy: bool) -> list[State]:
        states = accumulate(ends, lambda state, t: self.solver.step(state, t, theta, homotopy), initial=old)
        return [*states][1:]

    def _set_pace(self, length: float, end: float) -> None:
        """Set the largest length of the next step after a step that has succeeded.

        Args:
            length: length of this step.
            end: time at its end.
        """
        if end >= self._failed_end:
            self._failed_end = math.inf
        may_grow = self._failed_end == math.inf or not self.solver.limited
        self.journal.pace.step = None if end == self.target else length * (2 if may_grow else 1)

    def _regularised_step(self, length: float) -> list[State]:
        """Find an equilibrium by weak springs at all nodes, as late in time as possible, and return its states.

        Args:
            length: length of a step for which other methods have failed.

        Raises:
            NoEquilibrium: displacements grew without bound as the springs were softened.
            SolveError: no equilibrium was found.
        """
        old, end, t = self.last, self._step_end(length), self._latest_spring_time(length)
        last_error = SolveError("weak springs have not led to an equilibrium")
        if old.t < self._diverged_time < t:
            t = max(old.t + (self._diverged_time - old.t) / SPRING_SHORTENING_RATIO, end)
        while True:
            try:
                return self._accept_regularised(self.solver.solve_regularised(old, t, self.theta))
            except NoEquilibrium as error:
                last_error, self._diverged_time = error, t
            except SolveError as error:  # displacements that grew without bound later still show a limit before
                last_error = last_error if isinstance(last_error, NoEquilibrium) else error
            if t <= end:
                raise last_error
            t = max(old.t + (t - old.t) / SPRING_SHORTENING_RATIO, end)

    def _latest_spring_time(self, length: float) -> float:
        """Return the latest time at which weak springs look for an equilibrium.

        Args:
            length: length of the step for which other methods have failed.
        """
        return self.target

    def _accept_regularised(self, state: State) -> list[State]:
        """Accept a state found by weak springs, and return it in a list.

        This also sets the largest length of the next step.
        """
        self._set_pace(state.t - self.last.t, state.t)
        return [state]


class _StepTooLarge(SolveError):
    """Error of an adaptive step whose estimated error is above the tolerance.

    A step of `factor` times its length is expected to meet the tolerance.
    """

    def __init__(self, factor: float) -> None:
        super().__init__("its estimated error stays above the tolerance")
        self.factor = factor


@dataclass(eq=False)
class AdaptiveController(PlannedStepsController):
    """Controller of steps that are as long as their estimated error allows.

    Each step is made once as a whole and once as two halves. The states of the halves are kept.

    Attributes:
        settings: tolerance of the error, and limits of the lengths of steps.
    """

    settings: Adaptive

    def __post_init__(self) -> None:
        super().__post_init__()
        self._error_estimate = ErrorEstimate(self.solver.equations)
        self.min_length = (self.settings.smallest or self.settings.first / MAX_SHORTENING_RATIO) * (1 - TIME_TOLERANCE)
        self.journal.pace.step, self._length_factor = self.settings.first, 1.0

    def shorter_length(self, length: float, error: SolveError) -> float:
        return length * error.factor if isinstance(error, _StepTooLarge) else super().shorter_length(length, error)

    def _solve_step(self, old: State, end: float, theta: float, homotopy: bool) -> list[State]:
        """Make a step once as a whole and once as two halves, and return the states of the halves.

        Errors are relative to the largest norms of displacements, jumps and forces so far. A quantity counts as being
        at rest if its norm is less than the tolerance times its norm at the end of the step. Its errors are relative to
        its norm at the end of the first step that was tried, whether accepted or not. Such a quantity may grow from
        zero as a power of time. Relative to its own norm, its error would then be the same in any first step, however
        short.

        Args:
            old: the state before the step.
            end: time at the end of the step.
            theta: fraction of each step after which forces balance.
            homotopy: whether stiffer laws that approach the given ones (homotopy) are tried if Newton's method fails.

        Raises:
            _StepTooLarge: the estimated error is above the tolerance.
            SolveError: a step fails.
        """
        one_step_state = self.solver.step(old, end, theta, homotopy)
        half_states = self._successive_states(old, [(old.t + end) / 2, end], theta, homotopy)
        pace, estimate, tolerance = self.journal.pace, self._error_estimate, self.settings.tolerance
        old_norms, middle_norms, end_norms = map(estimate.state_norms, [old, *half_states])
        max_norms = np.maximum(pace.largest, old_norms)
        max_norms = np.where(max_norms < tolerance * end_norms, end_norms, max_norms)
        order = 2 if theta == 0.5 else 1
        error = float(estimate.differences(one_step_state, half_states[-1], max_norms).max()) / (2**order - 1)
        length_ratio = (tolerance / error) ** (1 / (order + 1)) if error else MAX_LENGTH_RATIO
        self._length_factor = float(np.clip(SAFETY_FACTOR * length_ratio, MIN_LENGTH_RATIO, MAX_LENGTH_RATIO))
        pace.largest = [*map(float, np.maximum(max_norms, middle_norms) if error <= tolerance else max_norms)]
        if not error <= tolerance:
            raise _StepTooLarge(self._length_factor)
        return half_states

    def _set_pace(self, length: float, end: float) -> None:
        """Set the largest length of the next step to what the error of the last one allows.

        A step that was shortened to end at one of `targets` does not shorten the next one.

        Args:
            length: length of the last step.
            end: time at its end.
        """
        limit, old_limit = length * self._length_factor, self.journal.pace.step or 0.0
        super()._set_pace(length, end)
        self.journal.pace.step = min(max(limit, old_limit) if end == self.target else limit, self.settings.largest)

    def _latest_spring_time(self, length: float) -> float:
        return min(self.target, self.last.t + max(MAX_SPRING_RATIO * length, self.settings.first / 2.0**MAX_HALVINGS))

    def _accept_regularised(self, state: State) -> list[State]:
        raise SolveError("the error of a step by weak springs is not known")


class SnapController(PlannedStepsController):
    """Controller of steps to given times, and to the times between them at which columns switch their phases.

    In a full model a column is the cells above each other through the layer's thickness, in an interface model a facet
    of S.
    """

    def _solve_step(self, old: State, end: float, theta: float, homotopy: bool) -> list[State]:
        """Solve a step, with all snaps (sudden changes of phase) within it, and return its states. Collective.

        The states are two for each snap, before and after it, and the state at the end. A snap has no duration: both
        its states have the same t. The energy that layer and bodies lose in it counts as dissipated.

        If loads, supports and parameters are linear in time within the step, the first switch is found. Otherwise
        columns are tested at a few times within the step. A column that leaves its phase of lowest energy only between
        two of these times is missed.

        Args:
            old: the state before the step.
            end: time at the end of the step.
            theta, homotopy: not used; forces balance at the end of the step.

        Raises:
            SolveError: an equilibrium is not found, or the methods `max_phase_gain` and `switched` of a law disagree.
        """
        solver, states = self.solver, [old]
        while True:
            old = states[-1]
            # With fixed phases driving forces are linear in time if loads, supports and parameters are (bodies are
            # assumed linear). The excess is the largest of their sizes, so it is convex in time. Therefore, if it is
            # positive within the step, it is positive at the end.
            is_linear = old.t == end or solver.equations.is_linear_in_time(old.t, end)
            times = () if is_linear else (old.t + (end - old.t) * k / N_EXCESS_TESTS for k in range(1, N_EXCESS_TESTS))
            test_time = next((t for t in times if self._solve_at_fixed_phases(old, t)[1] > 0), end)
            state, excess = self._solve_at_fixed_phases(old, test_time)
            if excess <= 0:
                return [*states[1:], state] if old.t < end else states[1:]
            t = self._switch_time(old, test_time)
            if t > old.t:
                old, _ = self._solve_at_fixed_phases(old, t)
                states.append(old)
                # from the new start Newton's tolerance may make the excess smaller
                if self._solve_at_fixed_phases(old, t)[1] <= -EXCESS_TOLERANCE:
                    continue
            snapped = solver.step(old, t)
            if solver.equations.max_phase_gain > 2 * EXCESS_TOLERANCE:
                raise SolveError(f"at t = {t:g} excess() > 0 for a column, but switched() keeps its phase")
            # in a snap the remainder of the balance is dissipated
            dissipated = snapped.audit.dissipated + snapped.audit.remainder
            states.append(replace(snapped, audit=replace(snapped.audit, dissipated=dissipated, remainder=0.0)))
            if t == end:
                return states[1:]

    def _solve_at_fixed_phases(self, old: State, t: float) -> tuple[State, float]:
        """Solve for the state at a time with the phases of an earlier state; tell whether a column must switch there.

        Args:
            old: the earlier state.
            t: the time.

        Returns:
            The state; and a number, > 0 if a column must switch. It is the largest energy that a column would lose by a
            change of phase, over the energy of the transformation, minus a tolerance.
        """
        state = self.solver.step(old, t, keep_phases=True)
        return state, self.solver.equations.max_phase_gain - 2 * EXCESS_TOLERANCE

    def _switch_time(self, old: State, end: float) -> float:
        """Return the first time at which a column must switch its phase, exact up to rounding.

        Args:
            old: the state at which the search starts.
            end: time at which the search ends, and at which a column must switch.
        """
        from scipy.optimize import brentq  # not needed by most marches

        def excess(t: float) -> float:
            return self._solve_at_fixed_phases(old, t)[1]

        if excess(old.t) > 0:
            return old.t
        time_tolerance = TIME_ROUNDING * max(abs(old.t), abs(end))
        t = float(brentq(excess, old.t, end, xtol=time_tolerance, rtol=TIME_ROUNDING))
        while t < end and excess(t) <= 0:
            t, time_tolerance = min(t + time_tolerance, end), 2 * time_tolerance
        return t


class ErrorEstimate:
    """Estimate of the error of steps from the difference of two states, reached by longer and by shorter steps.

    All methods are collective. Three quantities are compared, in Euclidean norms of nodal values or L2 norms of
    strains:

    - displacements: those of nodes;
    - jumps or strains: the strains of compiled laws at their quadrature points. On S these are jumps divided by the
      thickness, and under a contact law jumps at nodes;
    - forces: the nodal forces of the bodies' stresses, which change with reactions of supports and tractions on the
      layer.

    Displacements alone would not be enough. A layer may relax under bodies that hardly move, and a jump may be small
    compared with the motion of a whole body.

    Args:
        equations: the equations of the model.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, self.comm = equations, equations.comm
        # approximate norm of strains for a unit jump
        self._measuring_parts = [part for part in equations.parts if isinstance(part, MeasuresError)]
        self._jump_norm = float(np.sqrt(sum(part.unit_jump_measure() for part in self._measuring_parts)))

    def differences(self, other: State, state: State, max_norms: Sequence[float] | Array = (0.0, 0.0, 0.0)) -> Array:
        """Return the relative differences (3,) of two states in displacements, in jumps or strains, and in forces.

        Each is the norm of the difference over the norm in `state` or, if this is larger, over the norm in `max_norms`.

        Args:
            other: the state from longer steps.
            state: the state from shorter steps.
            max_norms: (3,) norms of the three quantities, in the same order.
        """
        quantities = [self._quantities(end_state) for end_state in (other, state)]
        difference_norms = self._norms([b - a for a, b in zip(*quantities, strict=True)])
        max_u = float(state.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))
        min_norms = np.array([0.0, MIN_JUMP_RATIO * self._jump_norm * max_u, self._equations.scale.forces[0]])
        norms = np.maximum(np.maximum(self._norms(quantities[1]), max_norms), min_norms)
        return np.asarray(np.divide(difference_norms, norms, out=np.zeros(3), where=norms > 0))

    def state_norms(self, state: State) -> Array:
        """Return the norms (3,) of displacements, of jumps or strains, and of forces in `state`."""
        return self._norms(self._quantities(state))

    def _quantities(self, state: State) -> list[Array]:
        """Return the three compared quantities in `state`, as arrays of this rank's values.

        They are displacements, jumps or strains, and forces.
        """
        u = state.u
        forces = u.x.petsc_vec.duplicate()
        forces.set(0.0)
        jumps = [part.error_measure(u) for part in self._measuring_parts]
        for part in self._equations.parts:
            part.add_forces_in(state, forces)
        return [u.x.petsc_vec.array_r.copy(), np.concatenate([np.empty(0), *jumps]), forces.array_r.copy()]

    def _norms(self, quantities: list[Array]) -> Array:
        return np.asarray(np.sqrt(self.comm.allreduce(np.array([array @ array for array in quantities]))))
