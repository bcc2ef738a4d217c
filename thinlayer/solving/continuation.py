"""Ways to an equilibrium on which Newton's method fails: a sequence of eased laws, or weak springs at all nodes.

With springs k between all nodes and their old places, R(u) + k (u - u_0) = 0 has a solution even above the limit load, and
Newton's method finds it easily while k is large. As k falls, u tends to the nearest equilibrium if there is one; otherwise
u runs away, in the end as 1/k. For a layer with associated flow this is a theorem: R is monotone, |u - u_0| only grows as
k falls, and no equilibrium is nearer (Brezis 1973, the regularisation of Yosida). For other layers it is an indication.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

from petsc4py import PETSc

from thinlayer.discretisation.state import State
from thinlayer.errors import NoEquilibrium, SolveError
from thinlayer.parts.part import Interval
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import Factor, mark
from thinlayer.solving.petsc import Options, chosen, solve_linear

FIRST_DECREMENT, LEAST_DECREMENT = 0.5, 1 / 64  # decrements of the ease from one law to the next
MOST_SOLVES = 30  # number of solves after which continuation gives up
EASED_RUN_AWAY = 1e5  # displacements, relative to those of an elastic layer, at which no equilibrium is expected
Result = TypeVar("Result")
FIRST_STIFFNESS, LEAST_STIFFNESS = 1.0, 1e-12  # of the springs, relative to the mean diagonal entry of K
SOFTENING_FACTOR = 10.0  # stiffness of springs divided by that of the next ones
SETTLED_GROWTH = 1.3  # growth of the distance per SOFTENING_FACTOR below which an equilibrium is near
RUN_AWAY = 30.0  # distance, relative to that of an elastic layer, that shows that there is no equilibrium
STOP_DISTANCE = 1e6  # distance, relative to that of an elastic layer, at which the search ends
TOLERANCE = 1e-3  # residual of solutions with springs, relative to the forces of the springs
ITERATIONS, HALVINGS = 40, 6  # largest numbers of Newton's steps, and of trial lengths of one step
COMPARED_RESIDUALS = 6  # number of last residuals, the largest of which bounds a new one
LEAST_DECREASE = 0.1  # relative decrease of the residual over the length of the step


def through_eased_laws(solve: Callable[[float, PETSc.Vec | None], PETSc.Vec]) -> tuple[PETSc.Vec, int]:
    """Lower the ease from 1, an elastic layer, to 0, the law itself. Collective.

    The decrement of the ease is doubled after a solve that converges and halved after one that fails.

    Args:
        solve: ease, unknowns to start from (None: those of the old state) -> unknowns. The next solve starts from a copy of
            them.

    Returns:
        The unknowns of the law itself, as the last solve returned them, and the number of solves.

    Raises:
        SolveError: the solve of an eased law fails, or displacements run away.
    """
    x = solve(1.0, None)
    ease, decrement, solves, reached = 1.0, FIRST_DECREMENT, 1, x.copy()
    limit = EASED_RUN_AWAY * float(x.norm(PETSc.NormType.INFINITY))
    try:
        while ease:
            lower, solves = max(ease - decrement, 0.0), solves + 1
            try:
                x = solve(lower, reached)
            except SolveError:
                decrement /= 2
                if decrement < LEAST_DECREMENT or solves >= MOST_SOLVES:
                    raise
                continue
            if x.norm(PETSc.NormType.INFINITY) > limit:
                times = f"{EASED_RUN_AWAY:g} times those of an elastic layer"
                raise SolveError(f"displacements of an eased law are {times}")
            x.copy(reached)
            ease, decrement = lower, 2 * decrement
        return x, solves
    finally:
        reached.destroy()


class Restraint:
    """Steps of a model with springs at all nodes. Collective.

    Args:
        equations: the equations of the model.
        options: PETSc options of the linear solver.
    """

    def __init__(self, equations: Equations, options: Options) -> None:
        self.equations = equations
        self._options = {name: value for name, value in options.items() if not name.startswith("snes_")}
        self._factor = Factor()
        self._vectors = [equations.vector() for _ in range(6)]
        self.x, self._begin, self._r, self._d, self._trial, self._kept = self._vectors
        self._unit = equations.mean_stiffness
        self._stiffness = 0.0

    def close(self) -> None:
        """Free vectors and factor."""
        for thing in (self._factor, *self._vectors):
            thing.destroy()

    def follow(self, rest: State, step: Interval, find: Callable[[PETSc.Vec], Result]) -> Result:
        """Soften the springs until `find` succeeds without them; returns its result.

        Args:
            rest: the state at rest.
            step: from an equilibrium to the time of the wanted one.
            find: unknowns -> the equilibrium near them; raises SolveError.

        Raises:
            NoEquilibrium: displacements run away. SolveError: no equilibrium was found.
        """
        elastic = self._elastic_distance(rest, step)
        failed = SolveError("weak springs have not led to an equilibrium")
        if not elastic:
            raise failed
        self._start(step)
        distance, softer, settled = 0.0, SOFTENING_FACTOR, False
        self._stiffness = FIRST_STIFFNESS * self._unit
        while self._stiffness > LEAST_STIFFNESS * self._unit and distance < STOP_DISTANCE * elastic:
            if not self._solve():
                if softer < SOFTENING_FACTOR or not distance:
                    break
                self._stiffness *= softer
                softer = math.sqrt(SOFTENING_FACTOR)
                self._stiffness /= softer
                self._kept.copy(self.x)
                continue
            before, distance = distance, self._distance(self.x)
            self.x.copy(self._kept)
            settled = distance < before * (1 + (SETTLED_GROWTH - 1) * math.log10(softer))
            if settled:
                try:
                    return find(self.x)
                except SolveError as error:
                    failed = error
            self._stiffness /= softer
            if distance > math.sqrt(softer) * before > 0:
                self._run_on(softer)
        if distance >= RUN_AWAY * elastic and not settled:
            raise NoEquilibrium(distance / elastic, self._shares())
        raise failed

    # ---------------------------------------------------------------- the step
    def _elastic_distance(self, rest: State, step: Interval) -> float:
        """Norm of the displacements that the loads and supports of the step cause from rest, with an elastic layer.

        The step has its own length dt, as laws with rate do not answer at once.
        """
        equations, r, d = self.equations, self._r, self._d
        equations.begin(Interval(rest, step.old.t, step.dt, 1.0))
        loads, prescribed = equations.given_forces(), equations.prescribed
        ease = equations.eased
        equations.ease(1.0)
        try:
            equations.begin(Interval(rest, step.t, step.dt, 1.0))
            self.x.set(0.0)
            equations.residual(self.x, r)
            A = equations.tangent()
        finally:
            equations.ease(ease)
        A.shift(LEAST_STIFFNESS * self._unit)
        after = equations.given_forces()
        after.copy(r)
        r.axpy(-1.0, loads)
        for vector in (loads, after):
            vector.destroy()
        d.set(0.0)
        d.array[equations.held] = equations.prescribed - prescribed
        equations.hold(A, d, r)
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

    def _shares(self) -> dict[str, float]:
        """Shares of the seams in the squares of the jumps since the beginning, of layers that yield and of contact."""
        self.x.copy(self._d)
        self._d.axpy(-1.0, self._begin)
        model = self.equations.model
        limited = {part.key for part in self.equations.parts if part.traits.bounded or part.traits.releases}
        measured = self.equations.squares_of_strains(self._d)
        of_seams = model.by_seam({key: square for key, square in measured.items() if key in limited})
        thin = {name: model.layers[name].thin for name, square in of_seams.items() if square > 0}
        squares = {name: of_seams[name] * (layer.eps if layer else 1.0) for name, layer in thin.items()}  # of jumps
        whole = sum(squares.values())
        order = sorted(squares, key=lambda name: -squares[name])
        return {name: squares[name] / whole for name in order} if whole else {}

    def _run_on(self, softer: float) -> None:
        """Extrapolate x, as if displacements grew in proportion to 1/k, if that reduces the residual."""
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
        """Move x to the equilibrium with springs. True if it was found."""
        sizes = [self._residual(self.x)]
        while len(sizes) <= ITERATIONS and math.isfinite(sizes[-1]):
            A = self.equations.tangent()
            A.shift(self._stiffness)
            self.equations.hold(A)
            self._r.scale(-1.0)
            self._solve_linear(A, self._r, self._d)
            sizes.append(self._search(max(sizes[-COMPARED_RESIDUALS:])))
            allowed = max(TOLERANCE * self._stiffness * self._distance(self.x), self.equations.aim(self.x))
            if sizes[-1] <= allowed:
                return True
        return False

    def _search(self, most: float) -> float:
        """Move x along d to a residual below `most`, or else to the smallest one tried; returns the residual."""
        best, at, length = math.inf, 0.0, 1.0
        for _ in range(HALVINGS):
            size = self._at(length)
            if size < (1 - LEAST_DECREASE * length) * most:
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
        with chosen(self._options):
            self._factor.renew(A, None, self.equations.tell)
            solve_linear(self._factor.ksp, b, x)
