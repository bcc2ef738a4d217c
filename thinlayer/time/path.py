"""Steps by arc length along an equilibrium path of displacements u and load parameter t (Riks 1972, Wempner 1971).

With residual R(u, t) and stiffness K = dR/du, a path has the direction (v, 1). Here K v = -dR/dt, and at supports v is
the rate of the prescribed displacements. A step of length s starts at the predictor P = (u, t) + s d, with the
direction d scaled to length 1. From there Newton's method leads to the equilibrium in the plane through P that is
normal to d. The scalar product of (u_1, t_1) and (u_2, t_2) is u_1.u_2/U^2 + t_1 t_2/T^2, with units U of u and T of t.
Turning points of t need no special treatment. There K is nearly singular, and beyond them it is indefinite, but it can
be factorised.

Where the tangent of a law jumps (a kink of the law), the path has a corner. It may be sharp: beyond a peak the path may
fall steeply and lead almost all the way back. The plane through P then misses the path, however short the step. A step
through a corner therefore uses another plane. It is normal to the solution of K v = -dR/dt at P, which is the direction
of the branch beyond the corner.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress

import numpy as np
from petsc4py import PETSc

from forms.base import Array, InputError
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.part import TimeStep
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import Factor, direct_solver_options, mark_symmetry
from thinlayer.solving.petsc import Options, reason_name, set_options, solve_linear

MAX_NEWTON_STEPS = 100  # largest number of Newton steps; cracks that close do so facet by facet
MAX_FUTILE_STEPS = 8  # largest number of successive Newton steps without a smaller residual than all before
FULL_STEPS = 2  # number of Newton steps without a search along the increment
OVERSHOOT = 0.1  # work of forces at the end of an increment, over minus that at its start, from which it is too long
MAX_TURN_STEPS = 2  # the same for a step that turns: the branch beyond a corner is nearly straight
# Largest distance of the equilibrium from the predictor, relative to the step; farther away it is on another path.
MAX_PREDICTION_ERROR = 0.25
# The same for steps up to `SHORT_STEP` in which the memory of laws changes. Where a crack grows through points of a mesh,
# the path has a corner at each; another path, on which all unloads, leaves the memory as it is.
MAX_CORNER_ERROR = 1.0
SHORT_STEP = 0.18  # arc length; that of the first step is sqrt(2)
MAX_TURN_ERROR = 3.0  # the same for a step that turns
MAX_ITERATE_DISTANCE = 9.0  # largest distance of Newton's iterates from the predictor, relative to the step
MEMORY_TOLERANCE = 1e-9  # change of memory in a step, over the memory, that counts as none
STRAIGHT_RESIDUAL = 1e-4  # largest relative residual at the predictor of a step that counts as straight
CORNER_DISTANCE = 0.5  # distance beyond a corner at which a step that turns ends, relative to the step
# Bound of the distance from the predictor, relative to the step: factor * (change of direction) + offset.
BEND_FACTOR, BEND_OFFSET = 2.0, 0.01
PATH_QUOTIENT_STEP = 1e-6  # step of difference quotients along the path, relative to the step
TIME_QUOTIENT_STEP = 1e-3  # step of difference quotients in t, relative to the unit of t
BRANCH_STEP = 1e-3  # distance from a state at which its branches are compared, relative to the last step
STRAIGHT_COSINE = 1 - 1e-6  # least cosine of the angle between directions that count as equal
RETRACED_MESSAGE = "the path would lead back to rest: all that has softened unloads"
BEND_MESSAGE = "the path is not straight, and longer steps than the first are for straight stretches"
FORCE_CHANGE_TOLERANCE = 1e-7  # change of forces in a step, relative to the forces, that counts as zero


class EquilibriumPath:
    """Equilibrium path of a model, which is followed in steps of given arc length. Its methods are collective.

    A point of the path, and a direction, is an array (n + 1,): the n unknowns of this rank, then the load parameter t.
    The path has a direction of length 1 at its last state, which `set_direction` computes and `step` follows. Laws with
    memory start from the memory of the last state, whether t increases or decreases.

    Args:
        equations: the equations of the model.
        t_unit: unit T of t in the arc length sqrt(|du|^2/U^2 + dt^2/T^2), > 0.
        options: PETSc options of the linear solver, which override the package's defaults; options of SNES are ignored.

    Attributes:
        length_weight: factor 1/U^2 in the arc length. It is 0 until the unit U of displacements is known, so that the
            arc length of the first step depends on t only.
        inner_time: a time between those at which loads and supports are evaluated. Difference quotients by t take
            their second value on its side, so that they stay between these times.
        must_be_straight: whether a step fails unless path, loads and supports are straight along it, as where all is
            elastic.
    """

    def __init__(self, equations: Equations, t_unit: float, options: Options) -> None:
        self.equations, self.t_unit, self.length_weight, self.inner_time = equations, t_unit, 0.0, 0.0
        self.must_be_straight = False
        linear_options = {name: value for name, value in options.items() if not name.startswith("snes_")}
        self._options = {**direct_solver_options(equations.model), **linear_options}
        self._factorisation = Factor()
        self._x, self._r, self._dR, self._newton_step, self._du_dt = (equations.create_vector() for _ in range(5))
        self._direction = np.zeros(self._x.getLocalSize() + 1)  # of length 1, at the last state
        self._prediction_error = 0.0  # distance of the last equilibrium from its predictor, relative to the step

    @property
    def t_slope(self) -> float:
        """Change of t per arc length at the last state, in the direction of the path."""
        return float(self._direction[-1])

    def _point(self, state: State) -> Array:
        self.equations.put_state(state, self._x)
        return np.append(self._x.array_r, state.t)

    def _scalar_product(self, a: Array, b: Array) -> float:
        u_product = float(self.equations.comm.allreduce(float(a[:-1] @ b[:-1])))
        return self.length_weight * u_product + float(a[-1] * b[-1]) / self.t_unit**2

    def _norm(self, a: Array) -> float:
        return math.sqrt(self._scalar_product(a, a))

    def _unit_vector(self, a: Array) -> Array:
        return np.asarray(a / self._norm(a), float)

    # ---------------------------------------------------------------- the balance of forces
    def _residual_size(self, last: State, point: Array) -> float | None:
        """Compute the residual at a point; return its size over a reference force if forces balance there, else None.

        Unknowns of `point` that supports prescribe are set to their prescribed values first. The residual is kept in
        `_r`, with zeros at these unknowns.

        Args:
            last: the last state, with the memory of laws.
            point: (n + 1,) the n unknowns of this rank, then t; changed in place.

        Raises:
            SolveError: a law fails, or loads or supports are not finite at t.
        """
        equations, bc_dofs = self.equations, self.equations.bc_dofs
        self._begin_step(last, float(point[-1]))
        point[bc_dofs] = equations.prescribed
        self._x.array[:] = point[:-1]
        self._evaluate_residual(self._r)
        self._r.array[bc_dofs] = 0.0
        return equations.relative_norm(self._r) if equations.is_balanced(self._x, self._r) else None

    def _begin_step(self, last: State, t: float) -> None:
        try:
            self.equations.begin(TimeStep(last, t, t - last.t, 1.0))
        except InputError as error:
            raise SolveError(str(error)) from error

    def _evaluate_residual(self, out: PETSc.Vec) -> None:
        self.equations.residual(self._x, out)
        if self.equations.failed:
            raise SolveError(self.equations.failure_text())

    def _linearise(self, last: State, t: float) -> Array:
        """Linearise the equations at the point of the last residual, and return the derivative of the path by t.

        Derivatives by t are difference quotients.

        Args:
            last: the last state, with the memory of laws.
            t: value of t at the point.

        Returns:
            (n + 1,) derivative of the path's point by t: the n unknowns of this rank, then t.

        Raises:
            SolveError: a law fails, loads or supports are not finite, or the matrix cannot be factorised.
        """
        equations, bc_dofs, dR, du_dt = self.equations, self.equations.bc_dofs, self._dR, self._du_dt
        old_prescribed, dt = equations.prescribed, math.copysign(TIME_QUOTIENT_STEP * self.t_unit, self.inner_time - t)
        self._begin_step(last, t + dt)
        self._evaluate_residual(dR)
        dR.axpy(-1.0, self._r)
        dR.scale(-1 / dt)
        du_dt.set(0.0)
        du_dt.array[bc_dofs] = (equations.prescribed - old_prescribed) / dt
        self._matrix = equations.tangent()
        self._matrix.zeroRowsColumns(equations.bc_rows, 1.0, du_dt, dR)
        mark_symmetry(self._matrix, equations.model, is_saddle=True)
        self._solve(dR, du_dt)
        return np.append(du_dt.array_r, 1.0)

    def _newton_increment(self) -> Array:
        """Return Newton's increment (n + 1,) at fixed t, from the last residual, with the matrix of `_linearise`."""
        self._solve(self._r, self._newton_step)
        return np.append(-self._newton_step.array_r, 0.0)

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        with set_options(self._options):
            try:
                self._factorisation.renew(self._matrix, None, self.equations.set_preconditioner_data)
                solve_linear(self._factorisation.ksp, b, x)
            except PETSc.Error:
                self._factorisation.destroy()
                raise
        reason = self._factorisation.ksp.getConvergedReason()
        if reason < 0 or not math.isfinite(x.norm()):
            raise SolveError(f"linear solver: {reason_name(PETSc.KSP.ConvergedReason, reason)}")

    # ---------------------------------------------------------------- direction
    def set_direction(self, previous: State | None, last: State, *, check: bool = False) -> None:
        """Compute the direction of the path at a state.

        The direction is tangent to the path, and leads away from the state before, or where the memory of laws goes on
        changing, see `_must_turn`. Without a state before, t increases along it. If the stiffness is singular, the
        direction is that from the state before to `last`.

        Args:
            previous: the state before `last`; None: `last` is the first state.
            last: the state at which the direction is computed.
            check: whether to compare the new direction with the present one, that at `previous`.

        Raises:
            SolveError: with `check`, the path turns between the two states, `last` is on another path, or all unloads up
                to it; the present direction is kept. Or the direction at the first state cannot be computed.
        """
        point = self._point(last)
        increment = None if previous is None else point - self._point(previous)
        try:
            self._residual_size(previous or last, point)
            direction = self._linearise(previous or last, last.t)
        except SolveError:
            if increment is None:
                raise
            direction, check = increment, False
        else:
            if increment is not None and self._scalar_product(direction, increment) < 0:
                direction = -direction
        direction = self._unit_vector(direction)
        changes = previous is not None and self._memory_changes(previous, last)
        if changes and increment is not None and self._must_turn(last, direction, self._norm(increment)):
            direction = -direction
        if check and previous is not None and increment is not None:
            if not changes and self._leads_back(direction, point) and not self._leads_back(self._direction, point):
                raise SolveError(RETRACED_MESSAGE)
            # from rest, cracks that open or close are no corner of the path: it is straight
            is_straight = previous.at_rest and not changes
            if not is_straight and self._crossing_sign(previous, direction, self._norm(increment)) < 0:
                raise SolveError("the path turns within the step")
            if self._prediction_error > BEND_FACTOR * self._norm(direction - self._direction) + BEND_OFFSET:
                raise SolveError("the equilibrium is not on the path: its direction is that of the predictor")
        self._direction = direction

    def _leads_back(self, direction: Array, point: Array) -> bool:
        """Return whether a direction leads straight back from a point to rest, with t decreasing. Collective."""
        return bool(self._scalar_product(direction, point) < -STRAIGHT_COSINE * self._norm(point) and direction[-1] < 0)

    def _must_turn(self, last: State, direction: Array, arc_length: float) -> bool:
        """Return whether the path leaves a state, up to which the memory of laws has changed, in the opposite direction.

        The direction is that of the branch where memory goes on changing. On it forces balance to second order of the
        distance, and in the opposite direction, where laws unload, to first order. Where nothing changes any more, as
        all that softened has broken, the path does not lead back to rest.

        Args:
            last: the state.
            direction: (n + 1,) direction of the path but for its sign: the n unknowns of this rank, then t.
            arc_length: arc length of the last step.
        """
        point, step = self._point(last), BRANCH_STEP * arc_length * direction
        with suppress(SolveError):  # loads may not be defined beyond their last time
            if self._residual_size(last, point + step) is None:
                ahead = self._r.norm()
                self._residual_size(last, point - step)
                if self._r.norm() < ahead / 10:
                    return True
        return self._leads_back(direction, point)

    def _crossing_sign(self, last: State, new_direction: Array, arc_length: float) -> float:
        """Return a number whose sign says whether a new direction of the path must be reversed beyond a kink of a law.

        It is negative if the direction must be reversed, positive if not, and 0 if there is no kink. It serves for
        corners of the path sharper than 90 degrees. There the angle with the last increment, by which `set_direction`
        and Crisfield (1981) choose a sign, does not decide.

        The residual R is continuous at a kink. Let 1 be the branch before the kink, and 2 the branch beyond it. Then
        the derivatives A = [K, dR/dt] of R on them differ by a matrix c n^T. Here n is the normal of the boundary
        between the branches, and c is a vector of forces. The present direction d_1, with A_1 d_1 = 0, crosses this
        boundary. The new direction d_2 satisfies A_2 d_2 = 0. The path continues along d_2 if d_2 crosses the boundary
        in the same sense: (n.d_1)(n.d_2) > 0. As n is not known, the forces (A_2 - A_1) d = c (n.d) are computed for
        both directions. The result is their scalar product, |c|^2 (n.d_1)(n.d_2). Forces as small as their errors count
        as zero.

        The matrix A_2 is that of the last call of `_linearise`.

        Args:
            last: the state before the kink, at which the path has its present direction.
            new_direction: (n + 1,) the new direction d_2: the n unknowns of this rank, then t.
            arc_length: arc length of the step.

        Raises:
            SolveError: a law fails, or loads or supports are not finite.
        """
        equations, step = self.equations, PATH_QUOTIENT_STEP * arc_length
        du_difference = self._dR  # (A_2 - A_1) d_1 = A_2 d_1, as A_1 d_1 = 0; and with A_2 (du_dt, 1) = 0
        du_difference.array[:] = self._direction[:-1] - self._direction[-1] * self._du_dt.array_r
        du_difference.array[equations.bc_dofs] = 0.0
        self._matrix.mult(du_difference, self._r)
        dA_d1 = self._r.array_r.copy()
        point = self._point(last)
        self._residual_size(last, point)
        residual = self._r.array_r.copy()
        self._residual_size(last, point + step * new_direction)
        dA_d2 = (residual - self._r.array_r) / step  # (A_2 - A_1) d_2 = -A_1 d_2, as A_2 d_2 = 0
        max_u = [float(np.abs(vector[:-1]).max(initial=0.0)) for vector in (self._direction, point)]
        rounding = np.array([equations.scale.force_rounding(equations.comm.allreduce(size, max))[0] for size in max_u])
        tolerance = FORCE_CHANGE_TOLERANCE * equations.scale.forces[0] / arc_length
        *squared_norms, product = equations.comm.allreduce(np.array([dA_d1 @ dA_d1, dA_d2 @ dA_d2, dA_d1 @ dA_d2]))
        # rounding of residuals; forces may be zero
        return 0.0 if (np.sqrt(squared_norms) < np.maximum(tolerance, rounding / [1.0, step])).any() else float(product)

    # ---------------------------------------------------------------- steps
    def step(self, last: State, length: float, *, turn: bool = False) -> State:
        """Make a step along the path, and return the equilibrium at its end.

        Args:
            last: the last state.
            length: arc length of the step.
            turn: whether to look for the equilibrium on the branch beyond a corner of the path, which must be within
                this length.

        Raises:
            SolveError: no equilibrium is found, or it is too far from the predictor; or, with `turn`, there is no
                corner.
        """
        return self._solve_in_plane(last, self._point(last) + length * self._direction, self._direction, length, turn)

    def solve_at_time(self, last: State, beyond: State | None, t: float) -> State:
        """Return the equilibrium of the path at a given value of t.

        Args:
            last: the last state.
            beyond: state after a step from `last` that has passed t; Newton's method starts from a point between the
                two. None: it starts from a point in the direction of the path.
            t: value of t.

        Raises:
            SolveError: no equilibrium is found, or it is too far from this point.
        """
        point, t_normal = self._point(last), np.zeros_like(self._direction)
        t_normal[-1] = 1.0
        direction = self._direction if beyond is None else self._point(beyond) - point
        increment = (t - last.t) / direction[-1] * direction
        predictor = point + increment
        predictor[-1] = t
        return self._solve_in_plane(last, predictor, t_normal, self._norm(increment), turn=False)

    def _solve_in_plane(self, last: State, predictor: Array, normal: Array, step: float, turn: bool) -> State:
        """Find the equilibrium of the path in a plane by Newton's method, and return it.

        The plane goes through the predictor. With `turn` it lies beyond a corner of the path instead, where the
        direction of the path jumps. It is then normal to the new direction (`_corner_direction`).

        Args:
            last: the last state.
            predictor: (n + 1,) estimate of the equilibrium, from which Newton's method starts: the n unknowns of this
                rank, then t.
            normal: (n + 1,) normal of the plane: the direction of the path, or that of t; not used with `turn`.
            step: arc length of the step.
            turn: whether to look for the equilibrium beyond a corner.

        Raises:
            SolveError: no equilibrium is found, or it is too far from the predictor; or, with `turn`, there is no
                corner.
        """
        start_time, offset, iterations, point = time.perf_counter(), 0.0, 0, predictor.copy()
        most, smallest, n_futile = MAX_TURN_STEPS if turn else MAX_NEWTON_STEPS, math.inf, 0
        residual = self._residual_size(last, point)
        while residual is None:
            size = self.equations.relative_norm(self._r)
            if self.must_be_straight and iterations == 0 and size > STRAIGHT_RESIDUAL:
                raise SolveError(BEND_MESSAGE)
            smallest, n_futile = (size, 0) if size < smallest else (smallest, n_futile + 1)
            if iterations == most or n_futile > MAX_FUTILE_STEPS:
                raise SolveError(f"Newton's method for the arc length has not converged in {iterations} steps")
            tangent, newton = self._linearise(last, float(point[-1])), self._newton_increment()
            if turn and iterations == 0:
                normal, offset = self._corner_direction(last, tangent, step)
            deficit = offset - self._scalar_product(normal, point - predictor) - self._scalar_product(normal, newton)
            tangent_normal = self._scalar_product(normal, tangent)
            if not tangent_normal or not math.isfinite(deficit / tangent_normal):
                raise SolveError("the tangent is singular along the path")
            increment = newton + deficit / tangent_normal * tangent
            point, residual = self._advance(last, point, increment, search=iterations >= FULL_STEPS)
            iterations += 1
            if not self._norm(point - predictor) <= MAX_ITERATE_DISTANCE * step:
                raise SolveError("Newton's method for the arc length runs away")
        distance = self._norm(point - predictor)
        report = Report("newton", iterations, residual, time.perf_counter() - start_time)
        state = self.equations.accept(self._x, report)
        is_corner = not turn and step < SHORT_STEP and self._memory_changes(last, state)
        if distance > step * (MAX_TURN_ERROR if turn else MAX_CORNER_ERROR if is_corner else MAX_PREDICTION_ERROR):
            raise SolveError("the equilibrium at this arc length is far from the predictor")
        if self.must_be_straight and not self.equations.is_linear_in_time(last.t, state.t):
            raise SolveError(BEND_MESSAGE)
        self._prediction_error = 0.0 if turn else distance / step
        return state

    def _advance(self, last: State, point: Array, increment: Array, *, search: bool) -> tuple[Array, float | None]:
        """Add an increment of Newton's method to a point, and compute the residual there, see `_residual_size`.

        With `search`, an increment that overshoots is shortened, as where it cycles between branches of laws. The
        residual forces do work in the increment. Where this work is positive before and negative after it, the increment
        ends where linear interpolation gives zero.

        Args:
            last: the last state, with the memory of laws.
            point: (n + 1,) the point of the last residual: the n unknowns of this rank, then t.
            increment: (n + 1,) the increment.
            search: whether the increment may be shortened.

        Raises:
            SolveError: a law fails, or loads or supports are not finite.
        """
        before, end = self._work(increment), point + increment
        residual = self._residual_size(last, end)
        after = self._work(increment)
        if search and before * after < 0 and abs(after) > OVERSHOOT * abs(before):
            end = point + increment * (before / (before - after))
            residual = self._residual_size(last, end)
        return end, residual

    def _work(self, increment: Array) -> float:
        """Return the work of the last residual in an increment, times -1. Collective."""
        return float(self.equations.comm.allreduce(float(self._r.array_r @ increment[:-1])))

    def _memory_changes(self, last: State, state: State) -> bool:
        """Return whether the memory of a law differs between two states. Collective."""
        changes = []
        for part in self.equations.parts:
            if part.traits.remembers:
                new, old = np.asarray(state.memory[part.key]), np.asarray(last.memory[part.key])
                changes.append(np.abs(new - old).max(initial=0.0) > MEMORY_TOLERANCE * np.abs(new).max(initial=0.0))
        return bool(self.equations.comm.allreduce(int(any(changes)), max))

    def _corner_direction(self, last: State, tangent: Array, arc_length: float) -> tuple[Array, float]:
        """Return the direction of the path beyond a corner, and how far from the predictor to look for an equilibrium.

        The equilibrium is sought in a plane that is normal to this direction.

        Args:
            last: the state before the corner.
            tangent: (n + 1,) derivative by t of the path's point, from the linearisation at the predictor.
            arc_length: arc length of the step.

        Returns:
            (n + 1,) direction of length 1: the n unknowns of this rank, then t. Distance, in arc length, from the
            predictor to the plane, measured along this direction.

        Raises:
            SolveError: the path has no corner here.
        """
        direction = self._unit_vector(tangent)
        sign = self._crossing_sign(last, direction, arc_length)
        if sign == 0:
            raise SolveError("the path has no corner here")
        direction *= math.copysign(1.0, sign)
        return direction, arc_length * (max(-self._scalar_product(direction, self._direction), 0.0) + CORNER_DISTANCE)
