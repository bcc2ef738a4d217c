"""The balance of forces of a model as a function of displacements and load parameter, R(u, t), and its derivatives."""

from __future__ import annotations

import math
from collections.abc import Mapping

from petsc4py import PETSc

from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError, SolveError
from thinlayer.parts.part import Interval
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import Factor, direct_solver, mark
from thinlayer.solving.petsc import PREFIX, OptionValue, chosen, reason_name, require_all_read, solve_linear

QUOTIENT_STEP = 1e-3  # step of difference quotients in t, relative to the unit of t


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

    def __init__(
        self, equations: Equations, unit: float, middle: float, options: Mapping[str, OptionValue] | None
    ) -> None:
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

    def put(self, state: State, x: PETSc.Vec) -> None:
        """Write the unknowns of a state into x."""
        self.equations.put_state(state, x)

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
        except ModelError as error:
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
                newton = {name.removeprefix(PREFIX) for name in PETSc.Options().getAll() if "snes_" in name}
                require_all_read("arc-length", (self._ours.keys() - self._given.keys()) | newton)
        reason = self._factor.ksp.getConvergedReason()
        if reason < 0 or not math.isfinite(x.norm()):
            raise SolveError(f"linear solver: {reason_name(PETSc.KSP.ConvergedReason, reason)}")
