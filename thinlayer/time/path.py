"""Steps along an equilibrium path: displacements and load parameter t together, by arc length (Riks 1972, Wempner 1971).

With residual R(u, t) a path has the direction (v, 1), where K v = -dR/dt and v follows the supports. A step of length s
goes to the predictor P = (u, t) + s (direction), and from there by Newton's method to the equilibrium in the plane through
P that is normal to the direction. The scalar product is du.dv/U^2 + dt ds/T^2, with units U of displacements and T of t.
Turning points of t need no special treatment: K is nearly singular there and indefinite beyond, and the factorisation
allows both.

Where the tangent of a law jumps (a kink of the law), the path has a corner. It may be sharp: beyond a peak the path may
fall steeply and lead almost all the way back. The plane through P then misses the path, however short the step. A step
that turns takes the plane normal to the direction found at P instead, which is that of the branch beyond the corner.
"""

from __future__ import annotations

import math
import time

from petsc4py import PETSc

from forms.base import InputError
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import SolveError
from thinlayer.parts.part import Interval
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import Factor, direct_solver, mark
from thinlayer.solving.petsc import Options, chosen, options_set, reason_name, require_all_read, solve_linear

ITERATIONS = 12  # largest number of Newton steps
TURN_ITERATIONS = 2  # the same for a step that turns: the branch beyond a corner is nearly straight
# Largest distance of the equilibrium from the predictor, relative to the step; one farther away is on another path.
MOST_MISSED = 0.25
TURN_MISSED = 3.0  # the same for a step that turns
RUN_AWAY = 9.0  # largest distance of Newton's iterates from the predictor, relative to the step
BEYOND_CORNER = 0.5  # distance beyond a corner at which a step that turns ends, relative to the step
# Bound of the distance from the predictor, relative to the step: factor * (change of direction) + offset.
BEND_FACTOR, BEND_OFFSET = 2.0, 0.01
SHORT_STEP = 1e-6  # step of difference quotients along the path, relative to the step
QUOTIENT_STEP = 1e-3  # step of difference quotients in t, relative to the unit of t
SMALL = 1e-7  # change of forces in a step, relative to the forces, that counts as zero


class PathEquations:
    """R(u, t), with loads, supports and laws at t, and linear solves with its derivatives. All methods are collective.

    Laws with memory start from a state `last`, whether t increases or decreases.

    Args:
        equations: the equations of the model.
        unit: unit of t, > 0.
        middle: middle of the times at which loads and supports are known; difference quotients step towards it.
        options: PETSc options of the linear solver, which override our defaults; options of SNES are ignored.

    Attributes:
        middle: the argument; it may be changed.
        x: unknowns; set them before `residual`, which sets the held ones.
        r: residual R, zero at held displacements.
        step: after `linearise` the Newton step at fixed t, -K^-1 R.
        change: after `linearise` the derivative of the unknowns by t in equilibrium, -K^-1 dR/dt, supports included.
    """

    def __init__(self, equations: Equations, unit: float, middle: float, options: Options | None) -> None:
        self.equations, self.middle, self._short = equations, middle, QUOTIENT_STEP * unit
        self._ours = direct_solver(equations.model)
        self._given = {name: value for name, value in (options or {}).items() if not name.startswith("snes_")}
        self._factor = Factor()
        self._vectors = [equations.vector() for _ in range(5)]
        self.x, self.r, self.step, self.change, self._dR = self._vectors

    def close(self) -> None:
        """Free vectors and factor."""
        for thing in (self._factor, *self._vectors):
            thing.destroy()

    def residual(self, last: State, t: float) -> float | None:
        """Compute the residual at time t; returns its size relative to the forces if x is an equilibrium, else None.

        Raises:
            SolveError: a law fails, or loads or supports are not finite at t.
        """
        self._begin(last, t)
        equations, held = self.equations, self.equations.held
        self.x.array[held] = equations.prescribed
        equations.residual(self.x, self.r)
        self._require_law()
        self.r.array[held] = 0.0
        size = float(self.r.norm())
        return equations.scale.relative(size) if size <= equations.aim(self.x) else None

    def _begin(self, last: State, t: float) -> None:
        try:
            self.equations.begin(Interval(last, t, t - last.t, 1.0))
        except InputError as error:
            raise SolveError(str(error)) from error

    def _require_law(self) -> None:
        if self.equations.failed:
            raise SolveError(self.equations.failure())

    def linearise(self, last: State, t: float) -> None:
        """Compute `step` and `change` at the unknowns of the last residual. Derivatives by t are difference quotients.

        Raises:
            SolveError: as in `residual`; or the matrix cannot be factorised.
        """
        equations, held = self.equations, self.equations.held
        prescribed, short = equations.prescribed, math.copysign(self._short, self.middle - t)
        self._begin(last, t + short)
        equations.residual(self.x, self._dR)
        self._require_law()
        self._dR.axpy(-1.0, self.r)
        self._dR.scale(-1 / short)
        self.change.set(0.0)
        self.change.array[held] = (equations.prescribed - prescribed) / short
        self._matrix = equations.tangent()
        self._matrix.zeroRowsColumns(equations.held_rows, 1.0, self.change, self._dR)
        mark(self._matrix, equations.model, saddle=True)
        self._solve(self._dR, self.change)
        self.r.scale(-1.0)
        self._solve(self.r, self.step)
        self.r.scale(-1.0)

    def derivative(self, x: PETSc.Vec, slope: float, out: PETSc.Vec) -> None:
        """Derivative of R along (x, slope) at the last linearisation; supports move with t."""
        x.copy(self._dR)
        self._dR.axpy(-slope, self.change)  # K change + dR/dt = 0
        self._dR.array[self.equations.held] = 0.0
        self._matrix.mult(self._dR, out)

    def _solve(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        with chosen(self._ours, self._given):
            try:
                kept = self._factor.renew(self._matrix, None, self.equations.tell)
                solve_linear(self._factor.ksp, b, x)
            except PETSc.Error:
                self._factor.destroy()
                raise
            if not kept:
                newton = {name for name in options_set() if "snes_" in name}
                require_all_read("arc-length", (self._ours.keys() - self._given.keys()) | newton)
        reason = self._factor.ksp.getConvergedReason()
        if reason < 0 or not math.isfinite(x.norm()):
            raise SolveError(f"linear solver: {reason_name(PETSc.KSP.ConvergedReason, reason)}")


class EquilibriumPath:
    """Equilibria (u, t) of a model along a path, one after the other. Collective.

    Args:
        balance: the equations of the model in (u, t).
        unit: unit T of t in the arc length, > 0.

    Attributes:
        weight: 1/U^2 of the arc length; 0 until U is known, so that the first step has a length in t only.
    """

    def __init__(self, balance: PathEquations, unit: float) -> None:
        self.balance, self.unit, self.weight = balance, unit, 0.0
        self._vectors = [balance.equations.vector() for _ in range(5)]
        self._direction, self._target, self._row, self._work, self._more = self._vectors
        self._put = balance.equations.put_state
        self._slope = 0.0  # component of the direction in t: (direction, slope) has the length 1
        self._missed = 0.0  # distance of the last equilibrium from its predictor, relative to the step

    def close(self) -> None:
        """Free vectors and factor."""
        for vector in self._vectors:
            vector.destroy()
        self.balance.close()

    @property
    def leads_on(self) -> bool:
        """Whether t increases along the direction of the path."""
        return self._slope > 0

    def ahead(self, last: State, length: float) -> float:
        """Time at the predictor of a step of this length."""
        return last.t + length * self._slope

    def _product(self, x: PETSc.Vec, t: float, y: PETSc.Vec, s: float) -> float:
        return self.weight * float(x.dot(y)) + t * s / self.unit**2

    def _size(self, x: PETSc.Vec, t: float) -> float:
        return math.sqrt(self._product(x, t, x, t))

    # ---------------------------------------------------------------- direction
    def aim(self, before: State | None, last: State, *, check: bool = False) -> None:
        """Find the direction of the path at the state `last`.

        It is tangent to the path and leads away from the state `before`. Without `before` t increases. If the tangent is
        singular, the last increment is the direction.

        Args:
            before: the state before `last`; None: there is none.
            last: the last state.
            check: compare the direction with the one found at `before`.

        Raises:
            SolveError: the path turns between the states, or `last` is on another path; the old direction stays.
        """
        balance, increment, dt = self.balance, self._target, 0.0
        self._put(last, balance.x)
        if before is not None:
            self._put(before, increment)
            increment.aypx(-1.0, balance.x)
            dt = last.t - before.t
        direction, slope = self._row, 1.0
        try:
            balance.residual(before or last, last.t)
            balance.linearise(before or last, last.t)
        except SolveError:
            if before is None:
                raise
            increment.copy(direction)
            slope, check = dt, False
        else:
            balance.change.copy(direction)
            if before is not None and self._product(direction, 1.0, increment, dt) < 0:
                direction.scale(-1.0)
                slope = -1.0
        size = self._size(direction, slope)
        direction.scale(1 / size)
        slope /= size
        if check and before is not None:
            self._check(before, direction, slope, self._size(increment, dt))
        direction.copy(self._direction)
        self._slope = slope

    def _check(self, last: State, direction: PETSc.Vec, slope: float, length: float) -> None:
        """Raise SolveError unless the direction at a new equilibrium fits the direction at the state `last` before it."""
        if self._crossing(last, direction, slope, length) < 0:
            raise SolveError("the path turns within the step")
        direction.copy(self._work)
        self._work.axpy(-1.0, self._direction)
        if self._missed > BEND_FACTOR * self._size(self._work, slope - self._slope) + BEND_OFFSET:
            raise SolveError("the equilibrium found is beside the path: its direction is that of the predictor")

    def _crossing(self, last: State, direction: PETSc.Vec, slope: float, length: float) -> float:
        """Whether a direction is to be reversed beyond a kink of a law: > 0 no, < 0 yes, 0 if there is no kink.

        The angle with the last increment, by which Crisfield (1981) chooses between two solutions and `aim` the sign of the
        direction, does not tell at corners sharper than 90 degrees. R is continuous at a kink, so its derivatives
        A = [K, dR/dt] on the two branches differ by c n', where n is the normal of the boundary between the branches.
        The direction d_1 at the state `last` (A_1 d_1 = 0) crosses this boundary, and the path goes on along the direction
        d_2 of the last linearisation (A_2 d_2 = 0) if d_2 crosses it in the same sense: (n.d_1)(n.d_2) > 0. As n is not
        known, the forces (A_2 - A_1) d = c (n.d) are computed, and the result is their scalar product,
        |c|^2 (n.d_1)(n.d_2). Forces as small as their errors count as zero.

        Args:
            last: the state before the kink.
            direction, slope: d_2, found at the last linearisation.
            length: length of the step.
        """
        balance, beyond, across = self.balance, self._work, self._more
        balance.derivative(self._direction, self._slope, beyond)  # (A_2 - A_1) d_1 = A_2 d_1, as A_1 d_1 = 0
        self._put(last, balance.x)
        balance.residual(last, last.t)
        balance.r.copy(across)
        short = SHORT_STEP * length
        balance.x.axpy(short, direction)
        balance.residual(last, last.t + short * slope)
        across.axpy(-1.0, balance.r)
        across.scale(1 / short)  # (A_2 - A_1) d_2 = -A_1 d_2, as A_2 d_2 = 0
        scale = balance.equations.scale
        small = SMALL * scale.forces / length
        rounded = [scale.rounding(float(x.norm(PETSc.NormType.INFINITY))) for x in (self._direction, balance.x)]
        if beyond.norm() < max(small, rounded[0]):
            return 0.0
        if across.norm() < max(small, rounded[1] / short):  # rounding of residuals; forces may be zero
            return 0.0
        return float(beyond.dot(across))

    # ---------------------------------------------------------------- steps
    def step(self, last: State, length: float, *, turn: bool = False) -> State:
        """The equilibrium one step of this length farther on; with `turn`, a step through a corner within this length.

        Raises:
            SolveError: there is no equilibrium, or it is too far from the predictor.
        """
        self._predict(last, length)
        self._direction.copy(self._row)
        return self._solve(last, self.ahead(last, length), self._slope, length, turn)

    def land(self, last: State, beyond: State | None, t: float) -> State:
        """The equilibrium at time t, between the states `last` and `beyond` (None: the predictor). Errors as in `step`."""
        if beyond is None:
            length = (t - last.t) / self._slope
            self._predict(last, length)
        else:
            share, increment = (t - last.t) / (beyond.t - last.t), self._work
            self._put(last, self._target)
            self._put(beyond, increment)
            increment.axpy(-1.0, self._target)
            increment.scale(share)
            self._target.axpy(1.0, increment)
            length = self._size(increment, t - last.t)
        self._row.set(0.0)
        return self._solve(last, t, 1.0, length, False)

    def _predict(self, last: State, length: float) -> None:
        self._put(last, self._target)
        self._target.axpy(length, self._direction)

    def _solve(self, last: State, target: float, slope: float, length: float, turn: bool) -> State:
        """The equilibrium in the plane normal to (row, slope) through the target."""
        begin, balance, x = time.perf_counter(), self.balance, self.balance.x
        most, far = (TURN_ITERATIONS, TURN_MISSED * length) if turn else (ITERATIONS, MOST_MISSED * length)
        t, beyond, iterations = target, 0.0, 0
        self._target.copy(x)
        while (residual := balance.residual(last, t)) is None:
            if iterations == most:
                raise SolveError(f"Newton's method for the arc length has not converged in {most} steps")
            balance.linearise(last, t)
            if turn and iterations == 0:
                slope, beyond = self._turn(last, length)
            missing = beyond - self._product(self._row, slope, self._from_target(), t - target)
            across = self._product(self._row, slope, balance.change, 1.0)
            dt = (missing - self.weight * float(self._row.dot(balance.step))) / across if across else math.inf
            if not math.isfinite(dt):
                raise SolveError("the tangent is singular along the path")
            x.axpy(1.0, balance.step)
            x.axpy(dt, balance.change)
            t += dt
            iterations += 1
            if not self._size(self._from_target(), t - target) <= RUN_AWAY * length:
                raise SolveError("Newton's method for the arc length runs away")
        missed = self._size(self._from_target(), t - target)
        if missed > far:
            raise SolveError("the equilibrium at this arc length is far from the predictor")
        self._missed = 0.0 if turn else missed / length
        report = Report("newton", iterations, residual, time.perf_counter() - begin)
        return balance.equations.accept(x, report)

    def _from_target(self) -> PETSc.Vec:
        self.balance.x.copy(self._work)
        self._work.axpy(-1.0, self._target)
        return self._work

    def _turn(self, last: State, length: float) -> tuple[float, float]:
        """Make the plane normal to the direction found at the predictor; returns its slope, and its distance from there."""
        size = self._size(self.balance.change, 1.0)
        self.balance.change.copy(self._row)
        self._row.scale(1 / size)
        slope = 1 / size
        crossing = self._crossing(last, self._row, slope, length)
        self._target.copy(self.balance.x)
        if crossing == 0:
            raise SolveError("the path has no corner here")
        if crossing < 0:
            self._row.scale(-1.0)
            slope = -slope
        cosine = self._product(self._row, slope, self._direction, self._slope)
        return slope, length * (max(-cosine, 0.0) + BEYOND_CORNER)
