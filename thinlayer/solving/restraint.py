"""Weak springs that hold every node where it was: they lead to an equilibrium that is hard to find, or show that none is.

With springs k at all nodes, R(u) + k (u - u_0) = 0 has a solution even beyond a limit of the loads, and Newton's method
finds it easily while k is large. As k falls, u tends to the nearest equilibrium if there is one; if there is none it runs
away, in the end as 1/k. For a layer whose flow is associated this is a theorem: R is monotone, |u - u_0| only grows as k
falls, and no equilibrium is nearer (Brezis 1973, the regularisation of Yosida). For other layers it is a sign.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TypeVar

from petsc4py import PETSc

from thinlayer.discretisation.state import State
from thinlayer.errors import NoEquilibrium, SolveError
from thinlayer.parts.part import Interval
from thinlayer.solving.balance import aim
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import mark, solve_linear, tell_multigrid
from thinlayer.solving.options import PREFIX, OptionValue, defaults

Found = TypeVar("Found")
FIRST, LEAST = 1.0, 1e-12  # stiffness of the springs, over the mean one of the bodies' nodes; below, rounding
SOFTER = 10.0  # stiffness over that of the next springs
NEAR = 1.3  # growth of the distance with SOFTER springs near an equilibrium
FAR = 30.0  # distance over that of an elastic layer: laws that flow at a limit go farther, others do not come so far
FAR_ENOUGH = 1e6  # distance over that of an elastic layer, from which on it is known that they run away
TOLERANCE = 1e-3  # residual over the forces of the springs: their solution is only on the way
ITERATIONS, CUTS = 40, 6  # of Newton's method, and of a step of it
MEMORY = 6  # steps over the largest of whose residuals a new one may not grow
DECREASE = 0.1  # of the residual, over the length of the step


class Restraint:
    """Steps of a model whose nodes are held by springs. Collective.

    Args:
        equations: of the model.
        options: PETSc options of the linear solver.
    """

    def __init__(self, equations: Equations, options: Mapping[str, OptionValue]) -> None:
        self.equations = equations
        self._options = {name: value for name, value in options.items() if not name.startswith("snes_")}
        self._ksp: PETSc.KSP | None = None
        self._vectors = [equations.vector() for _ in range(6)]
        self.x, self._begin, self._r, self._d, self._trial, self._kept = self._vectors
        self._unit = equations.mean_stiffness
        self._stiffness = 0.0

    def close(self) -> None:
        """Free vectors and factor."""
        for thing in (self._ksp, *self._vectors):
            if thing is not None:
                thing.destroy()

    def follow(self, rest: State, step: Interval, find: Callable[[PETSc.Vec], Found]) -> Found:
        """What `find` finds, without springs, from where softer and softer ones lead.

        Args:
            rest: the state before anything happened.
            step: from an equilibrium to the time at which one is looked for.
            find: unknowns -> the equilibrium near them; raises SolveError.

        Raises:
            NoEquilibrium: displacements run away. SolveError: nothing is found.
        """
        elastic = self._elastic_distance(rest, step)
        failed = SolveError("weak springs have not led to an equilibrium")
        if not elastic:
            raise failed
        self._start(step)
        distance, softer, settled = 0.0, SOFTER, False
        self._stiffness = FIRST * self._unit
        while self._stiffness > LEAST * self._unit and distance < FAR_ENOUGH * elastic:
            if not self._solve():
                if softer < SOFTER or not distance:
                    break
                self._stiffness *= softer
                softer = math.sqrt(SOFTER)
                self._stiffness /= softer
                self._kept.copy(self.x)
                continue
            before, distance = distance, self._distance(self.x)
            self.x.copy(self._kept)
            settled = distance < before * (1 + (NEAR - 1) * math.log10(softer))
            if settled:
                try:
                    return find(self.x)
                except SolveError as error:
                    failed = error
            self._stiffness /= softer
            if distance > math.sqrt(softer) * before > 0:
                self._run_on(softer)
        if distance >= FAR * elastic and not settled:
            raise NoEquilibrium(distance / elastic)
        raise failed

    # ---------------------------------------------------------------- the step
    def _elastic_distance(self, rest: State, step: Interval) -> float:
        """Displacements that the loads and supports of the step would bring about at rest, in an elastic layer.

        In the time of the step: what takes time does not answer at once.
        """
        equations, r, d = self.equations, self._r, self._d
        equations.begin(Interval(rest, step.old.t, step.dt, 1.0))
        loads, prescribed = equations.loads.copy(), equations.prescribed
        ease = equations.eased
        equations.ease(1.0)
        try:
            equations.begin(Interval(rest, step.t, step.dt, 1.0))
            self.x.set(0.0)
            equations.residual(self.x, r)
            A = equations.tangent()
        finally:
            equations.ease(ease)
        A.shift(LEAST * self._unit)
        n = equations.n_displacements
        r.set(0.0)
        r.array[:n] = equations.loads.array_r - loads.array_r
        loads.destroy()
        d.set(0.0)
        d.array[equations.held] = equations.prescribed - prescribed
        A.zeroRowsColumns(equations.held_rows, 1.0, d, r)
        self._solve_linear(A, r, self._trial)
        return float(self._trial.norm())

    def _start(self, step: Interval) -> None:
        equations, x = self.equations, self._begin
        equations.begin(step)
        equations.put_state(step.old, x)
        x.array[equations.held] = equations.prescribed
        x.copy(self.x)

    def _distance(self, x: PETSc.Vec) -> float:
        x.copy(self._d)
        self._d.axpy(-1.0, self._begin)
        return float(self._d.norm())

    def _run_on(self, softer: float) -> None:
        """Start from where displacements come that grow as the springs soften, if that is nearer."""
        here = self._residual(self.x)
        self.x.copy(self._trial)
        self._trial.scale(softer)
        self._trial.axpy(1 - softer, self._begin)
        if self._residual(self._trial) < here:
            self._trial.copy(self.x)

    # ---------------------------------------------------------------- Newton's method
    def _residual(self, x: PETSc.Vec) -> float:
        r = self._r
        self.equations.residual(x, r)
        r.axpy(self._stiffness, x)
        r.axpy(-self._stiffness, self._begin)
        r.array[self.equations.held] = 0.0
        return float(r.norm())

    def _solve(self) -> bool:
        """Move x to the equilibrium with springs; whether it was found."""
        sizes = [self._residual(self.x)]
        while len(sizes) <= ITERATIONS and math.isfinite(sizes[-1]):
            A = self.equations.tangent()
            A.shift(self._stiffness)
            A.zeroRowsColumns(self.equations.held_rows, 1.0)
            self._r.scale(-1.0)
            self._solve_linear(A, self._r, self._d)
            sizes.append(self._search(max(sizes[-MEMORY:])))
            allowed = max(TOLERANCE * self._stiffness * self._distance(self.x), aim(self.equations, self.x))
            if sizes[-1] <= allowed:
                return True
        return False

    def _search(self, most: float) -> float:
        """Go along d, as far as the residual does not grow over `most`; the residual there."""
        best, at, length = math.inf, 0.0, 1.0
        for _ in range(CUTS):
            size = self._at(length)
            if size < (1 - DECREASE * length) * most:
                best, at = size, length
                break
            if size < best:
                best, at = size, length
            length /= 2
        if at != length:
            best = self._at(at)
        self._trial.copy(self.x)
        return best

    def _at(self, length: float) -> float:
        self._trial.waxpy(length, self._d, self.x)
        return self._residual(self._trial)

    def _solve_linear(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        mark(A, self.equations.model, saddle=True)
        with defaults(self._options):
            if self._ksp is None:
                self._ksp = PETSc.KSP().create(self.equations.comm)
                self._ksp.setOptionsPrefix(PREFIX)
                self._ksp.setOperators(A)
                self._ksp.setFromOptions()
                tell_multigrid(self._ksp, A, self.equations.model)
            self._ksp.setOperators(A)
            solve_linear(self._ksp, b, x, self._options.keys())
