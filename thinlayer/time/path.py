"""Steps along an equilibrium path: displacements and load parameter t together, by arc length (Riks 1972, Wempner 1971).

With residual R(u, t) a path has the direction (v, 1) where K v = -dR/dt, and v moves as the supports do. A step of
length s goes to the predictor P = (u, t) + s (direction), and from there by Newton's method to the equilibrium in the
plane through P that is normal to the direction. The scalar product is du.dv/U^2 + dt ds/T^2, with units U of displacements
and T of t. Nothing special happens where t turns back: the tangent K is nearly singular there, and beyond it not definite,
which is what the factorisation expects.

Laws with kinks make paths with corners, which may be sharp: beyond a peak a steep fall leads almost all the way back. The
plane through P then misses the path, however short the step. A step that turns takes the direction at P instead, with the
sign that goes on into the branch which P has reached.
"""

from __future__ import annotations

import math
import time

from petsc4py import PETSc

from thinlayer.discretisation.state import Report, State
from thinlayer.errors import SolveError
from thinlayer.time.path_equations import PathEquations

ITERATIONS = 12  # of Newton's method in a step
TURNING = 2  # beyond a corner: of the branch at the predictor, which is nearly straight
FAR = 0.25  # from the predictor, in lengths of the step: farther away the path may be another one
FARTHER = 3.0  # the same beyond a corner, and, in times of it, within Newton's method
BEYOND = 0.5  # a corner, in lengths of the step, is where a step that turns ends
CURVED, STRAIGHT = 2.0, 0.01  # distance from the predictor of a path that bends, over the change of its direction
NEAR = 1e-6  # of a difference quotient along the path, in lengths of the step
SMALL = 1e-7  # change of forces in a step, over the forces, that says nothing


class EquilibriumPath:
    """Equilibria (u, t) of a model along a path, one after the other. Collective.

    Args:
        balance: the equations of the model in (u, t).
        unit: T of the arc length, a change of t > 0.

    Attributes:
        weight: 1/U^2 of the arc length; 0 until displacements have a unit: the first step is one of t.
    """

    def __init__(self, balance: PathEquations, unit: float) -> None:
        self.balance, self.unit, self.weight = balance, unit, 0.0
        self._vectors = [balance.equations.vector() for _ in range(5)]
        self._direction, self._target, self._row, self._work, self._more = self._vectors
        self._slope = 0.0  # of t along the path: (direction, slope) has the length 1
        self._missed = 0.0  # distance of the last equilibrium from its predictor, in lengths of the step

    def close(self) -> None:
        """Free vectors and factor."""
        for vector in self._vectors:
            vector.destroy()
        self.balance.close()

    def ahead(self, last: State, length: float) -> float:
        """Time at the predictor of a step of this length."""
        return last.t + length * self._slope

    def _product(self, x: PETSc.Vec, t: float, y: PETSc.Vec, s: float) -> float:
        return self.weight * float(x.dot(y)) + t * s / self.unit**2

    def _size(self, x: PETSc.Vec, t: float) -> float:
        return math.sqrt(self._product(x, t, x, t))

    # ---------------------------------------------------------------- direction
    def aim(self, before: State | None, last: State, *, check: bool = False) -> None:
        """Find the direction in which the path goes on: along its tangent, on the side that it does not come from.

        The tangent is that of the step which led to the last state. Without a state before it t increases. Where the
        tangent is singular the last increment is taken. With `check` the direction found before was that of the state
        before, and both must fit.

        Raises:
            SolveError: the path turns between the states, or the last one is on another path; the direction is kept.
        """
        balance, increment, dt = self.balance, self._target, 0.0
        balance.put(last, balance.x)
        if before is not None:
            balance.put(before, increment)
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
        """Raise SolveError unless the direction found at an equilibrium is that of the path from the last one."""
        if self._crossing(last, direction, slope, length) < 0:
            raise SolveError("the path turns within the step")
        direction.copy(self._work)
        self._work.axpy(-1.0, self._direction)
        if self._missed > CURVED * self._size(self._work, slope - self._slope) + STRAIGHT:
            raise SolveError("the equilibrium found is beside the path: its direction is that of the predictor")

    def _crossing(self, last: State, direction: PETSc.Vec, slope: float, length: float) -> float:
        """> 0 if a direction, tangent where the equations were linearised last, goes on with the one at a state.

        Where a law has a kink, derivatives A = [K, dR/dt] of its two branches differ by c n', if n is the normal of their
        boundary. Directions d_1 and d_2 cross it the same way if the changes (A_2 - A_1) d = c (n.d) have one sign.
        0 where they are as small as their errors.
        """
        balance, beyond, across = self.balance, self._work, self._more
        balance.derivative(self._direction, self._slope, beyond)  # A_2 d_1, as A_2 d_2 = 0
        balance.put(last, balance.x)
        balance.residual(last, last.t)
        balance.r.copy(across)
        short = NEAR * length
        balance.x.axpy(short, direction)
        balance.residual(last, last.t + short * slope)
        across.axpy(-1.0, balance.r)
        across.scale(1 / short)  # -A_1 d_2
        scale = balance.equations.scale
        small = SMALL * scale.forces / length
        rounded = [scale.rounding(float(x.norm(PETSc.NormType.INFINITY))) for x in (self._direction, balance.x)]
        if beyond.norm() < max(small, rounded[0]):
            return 0.0
        if across.norm() < max(small, rounded[1] / short):  # of residuals; forces may have vanished
            return 0.0
        return float(beyond.dot(across))

    # ---------------------------------------------------------------- steps
    def step(self, last: State, length: float, *, turn: bool = False) -> State:
        """The equilibrium a length farther on, or, with `turn`, about that far beyond a corner nearer than that.

        Raises:
            SolveError: there is none, or it is too far from where it was looked for.
        """
        self._predict(last, length)
        self._direction.copy(self._row)
        return self._solve(last, self.ahead(last, length), self._slope, length, turn)

    def land(self, last: State, beyond: State | None, t: float) -> State:
        """The equilibrium at a time that the predictor passes, or that lies between two states. Errors as in `step`."""
        if beyond is None:
            length = (t - last.t) / self._slope
            self._predict(last, length)
        else:
            share, increment = (t - last.t) / (beyond.t - last.t), self._work
            self.balance.put(last, self._target)
            self.balance.put(beyond, increment)
            increment.axpy(-1.0, self._target)
            increment.scale(share)
            self._target.axpy(1.0, increment)
            length = self._size(increment, t - last.t)
        self._row.set(0.0)
        return self._solve(last, t, 1.0, length, False)

    def _predict(self, last: State, length: float) -> None:
        self.balance.put(last, self._target)
        self._target.axpy(length, self._direction)

    def _solve(self, last: State, target: float, slope: float, length: float, turn: bool) -> State:
        """The equilibrium in the plane normal to (row, slope) through the target."""
        begin, balance, x = time.perf_counter(), self.balance, self.balance.x
        most, far = (TURNING, FARTHER * length) if turn else (ITERATIONS, FAR * length)
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
            if not self._size(self._from_target(), t - target) <= FARTHER * FARTHER * length:
                raise SolveError("Newton's method for the arc length runs away")
        missed = self._size(self._from_target(), t - target)
        if missed > far:
            raise SolveError("the equilibrium at this arc length is far from where the path was going")
        self._missed = 0.0 if turn else missed / length
        report = Report("newton", iterations, residual, time.perf_counter() - begin)
        return balance.equations.accept(x, report)

    def _from_target(self) -> PETSc.Vec:
        self.balance.x.copy(self._work)
        self._work.axpy(-1.0, self._target)
        return self._work

    def _turn(self, last: State, length: float) -> tuple[float, float]:
        """Let the plane be normal to the direction at the predictor: its slope, and how far beyond the predictor it is."""
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
        return slope, length * (max(-cosine, 0.0) + BEYOND)
