"""One law at one point of S: tractions for given jumps, and jumps for given tractions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from forms.base import Array
from forms.law import BulkLaw
from forms.tensors import MANDEL_BASIS
from thinlayer.errors import SolveError
from thinlayer.pointwise.columns import Switching
from thinlayer.pointwise.compiled_law import CompiledLaw

COMPONENT_NAMES = {2: ("T", "N"), 3: ("T1", "T2", "N")}
MAX_NEWTON_STEPS, MAX_HALVINGS = 60, 25  # limits of Newton iterations, and of trial lengths in each line search
MIN_STEP_FRACTION = 2.0**-10  # smallest fraction of a step that is tried
MAX_NULL_STEP = 2.0**25  # longest step along a null vector of a singular tangent, relative to the elastic step
# relative error of tractions: target; largest accepted error if Newton's method stagnates
TRACTION_TOLERANCE, STAGNATION_TOLERANCE = (1e-12, 1e-9)


class MaterialPointState(NamedTuple):
    """Response of a law at a point of S, at the end of a step or before the first one; d: number of dimensions.

    Jump, traction and tangent have components in the frame of S: tangents first, then the normal.

    Attributes:
        t: time at the end of the step.
        w: (d,) jump at the end of the step; for laws of strains, divided by the layer's thickness.
        traction: (d,) traction after the fraction theta of the step, when forces balance.
        tangent: (d, d) derivative of `traction` by `w`.
        stress: (6,) stress at the time of `traction`, as Mandel components in the axes x, y, z.
        memory: (values,) internal variables at the end of the step.
        energies: (3,) energy stored at the end of the step, energy dissipated in it, and remainder of the energy
            balance.
    """

    t: float
    w: Array
    traction: Array
    tangent: Array
    stress: Array
    memory: Array
    energies: Array


class MaterialPoint:
    """Solver for the jumps and tractions of a law at one point of S; d: number of dimensions.

    Args:
        law: the law, with numbers for parameters.
        n: (d,) unit normal of S.
        axes: (3, d) frame of S: its columns are the tangents, then the normal.
        theta: fraction of a step after which forces balance.
    """

    def __init__(self, law: BulkLaw, n: Array, axes: Array, theta: float) -> None:
        self.law, self.n, self.theta = law, n, theta
        self.material = CompiledLaw(MPI.COMM_SELF, law)
        self.switching = Switching(law) if law.traits.switches else None
        self.n3 = np.append(n, np.zeros(3 - len(n)))
        # (6, d) strain of a unit jump in each component: e = E w, t = E^T stress
        self.E = np.einsum("kij,ia,j->ka", MANDEL_BASIS, axes, self.n3)
        self.max_tangent = 0.0  # largest entry of a tangent so far

    def rest(self) -> MaterialPointState:
        """Return the state before the first step, at time 0, with all values zero."""
        d = len(self.n)
        return MaterialPointState(0.0, *(np.zeros(shape) for shape in (d, d, (d, d), 6, self.material.memory_size, 3)))

    def _respond(self, old: MaterialPointState, w: Array, dt: float) -> MaterialPointState | None:
        """Return the state after a step of length `dt` from `old` to the jump `w` (d,); None if the law fails."""
        e, e_old = (self.E @ w)[None], (self.E @ old.w)[None]
        arguments = (e, e_old, old.memory[None], self.n3[None], dt, self.theta if dt > 0 else 1.0)
        stress, C, memory, energies, failed = self.material.update(range(6), *arguments)
        if failed:
            return None
        tangent = self.E.T @ C[0] @ self.E
        self.max_tangent = max(self.max_tangent, np.abs(tangent).max())
        return MaterialPointState(old.t + dt, w, self.E.T @ stress[0], tangent, stress[0], memory[0], energies[0])

    def advance(self, old: MaterialPointState, is_w: Array, values: Array, dt: float) -> tuple[MaterialPointState, int]:
        """Make a step, and return the state at its end and the number of smaller steps into which it was divided.

        The dissipated energy and the remainder are sums over the smaller steps.

        Args:
            old: the state before the step.
            is_w: (d,) True for a component whose jump is prescribed, False if its traction is.
            values: (d,) values of these prescribed jumps and tractions at the end of the step.
            dt: length of the step.

        Raises:
            SolveError: even a small fraction of the step has no solution.
        """
        start = np.where(is_w, old.w, old.traction)
        done, fraction, n_parts = 0.0, 1.0, 0
        state, energy_sums = old, np.zeros(3)
        while done < 1:
            target = values if done + fraction >= 1 else start + (done + fraction) * (values - start)
            trial = self._phase_step(state, is_w, target, fraction * dt)
            if trial is None:
                fraction /= 2
                if fraction < MIN_STEP_FRACTION:
                    raise SolveError(self._failure_text(state, is_w, done))
                continue
            state, done, n_parts = trial, done + fraction, n_parts + 1
            energy_sums += state.energies
            fraction = min(2 * fraction, 1 - done)
        energy_sums[0] = state.energies[0]
        return state._replace(energies=energy_sums), n_parts

    def _phase_step(self, old: MaterialPointState, is_w: Array, values: Array, dt: float) -> MaterialPointState | None:
        """Return the state after a step with phases that do not change any more; None if no solution is found.

        The step is solved with fixed phases. If a phase then changes, the step is solved again.

        Args:
            old: the state before the step.
            is_w: (d,) True for a component whose jump is prescribed, False if its traction is.
            values: (d,) values of these prescribed jumps and tractions.
            dt: length of the step.
        """
        state = self._solve(old, is_w, values, dt)
        if state is None or self.switching is None:
            return state
        memory = self.switching.switched(state.memory[None], old.memory[None])
        return state if memory is None else self._phase_step(old._replace(memory=memory[0]), is_w, values, dt)

    def _failure_text(self, state: MaterialPointState, is_w: Array, done: float) -> str:
        names = [f"{kind}_{c}" for kind in "wt" for c in COMPONENT_NAMES[len(self.n)]]
        values = zip(names, (*state.w, *state.traction), strict=True)
        values_text = ", ".join(f"{name} = {value:.6g}" for name, value in values)
        place_text = f"it stopped after {done:.4g} of the step, at {values_text}"
        if is_w.all():
            return f"the law failed; {place_text}"
        return f"no jump has the prescribed traction; {place_text}. Beyond the law's limit? Prescribe the jump there"

    def _solve(self, old: MaterialPointState, is_w: Array, values: Array, dt: float) -> MaterialPointState | None:
        """Return the state after a step with fixed phases, by Newton's method; None if it diverges.

        The unknowns are those jumps whose traction is prescribed. The tangent is singular at a limit load, or where an
        open layer must close. There the jump moves in the direction of the missing traction, by a distance that doubles
        in each iteration.

        Args:
            old: the state before the step.
            is_w: (d,) True for a component whose jump is prescribed, False if its traction is.
            values: (d,) values of these prescribed jumps and tractions.
            dt: length of the step.
        """
        is_unknown, null_step = np.logical_not(is_w), 1.0

        def traction_error(state: MaterialPointState) -> float:
            return float(np.abs(values - state.traction)[is_unknown].max(initial=0.0))

        def line_search(step: Array, max_error: float) -> MaterialPointState | None:
            """Try the increments `step`, step/2, step/4, ... of the unknown jumps, and return the first good state.

            In a good state no prescribed traction has an error larger than `max_error`. None: there is no such state.
            """
            full_step = np.zeros(len(is_unknown))
            full_step[is_unknown] = step
            trials = (self._respond(old, now.w + 0.5**n_halvings * full_step, dt) for n_halvings in range(MAX_HALVINGS))
            return next((state for state in trials if state is not None and traction_error(state) <= max_error), None)

        self._respond(old, old.w, dt)  # sets self.max_tangent
        reached = self._respond(old, np.where(is_w, values, old.w), dt)
        for _ in range(MAX_NEWTON_STEPS):
            if reached is None or null_step > MAX_NULL_STEP:
                return None
            now = reached
            residual, error = (values - now.traction)[is_unknown], traction_error(now)
            scale = max(np.abs(traction).max() for traction in (now.traction, old.traction, values * is_unknown))
            if error <= TRACTION_TOLERANCE * scale:
                return now
            tangent, candidate = now.tangent[np.ix_(is_unknown, is_unknown)], None
            if np.linalg.cond(tangent) < 1e13:
                null_step = 1.0
                step = np.linalg.solve(tangent, residual)
                candidate = line_search(step, error * (1 - 1e-4))
            if candidate is None and error <= STAGNATION_TOLERANCE * scale:
                return now
            if candidate is None:
                candidate = line_search(null_step * residual / self.max_tangent, error)
                null_step *= 2
            reached = candidate
        return None
