"""Search for an equilibrium, where Newton's method fails, by weak springs at all nodes.

Springs of stiffness k join each node to its place before the step. Let R be the residual and u_0 the displacements
before the step. The equation R(u) + k (u - u_0) = 0 has a solution even above the limit load. While k is large
Newton's method converges easily.

As k falls, u tends to the nearest equilibrium if there is one. Otherwise u grows without bound, in the end as 1/k.
This is a theorem for a layer with associated flow: then R is monotone, |u - u_0| only grows as k falls, and no
equilibrium is nearer (Brezis 1973, the regularisation of Yosida). For other layers it is an indication.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from petsc4py import PETSc

from forms.base import Array
from thinlayer.discretisation.state import State
from thinlayer.errors import NoEquilibrium, SolveError
from thinlayer.parts.part import MeasuresError, TimeStep
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import Factor, mark_symmetry
from thinlayer.solving.part_sum import MIN_DIVISOR
from thinlayer.solving.petsc import Options, set_options, solve_linear

SpringResult = TypeVar("SpringResult")
FIRST_STIFFNESS, MIN_STIFFNESS = 1.0, 1e-12  # stiffness of the springs, over the mean diagonal entry of K
SOFTENING_FACTOR = 10.0  # stiffness of springs over the stiffness of the next springs
CONVERGED_GROWTH = 1.3  # growth of the distance per SOFTENING_FACTOR below which an equilibrium is near
DIVERGED_DISTANCE = 30.0  # distance, relative to an elastic layer's, above which there is no equilibrium
MAX_DISTANCE = 1e6  # distance, relative to an elastic layer's, at which the search ends
RESIDUAL_TOLERANCE = 1e-3  # residual of solutions with springs, relative to the forces of the springs
MAX_NEWTON_STEPS, MAX_STEP_TRIALS = 40, 6  # largest numbers of Newton steps, and of trial lengths of one step
N_COMPARED_RESIDUALS = 6  # number of last residuals, the largest of which a new residual must not exceed
MIN_RESIDUAL_DECREASE = 0.1  # least relative decrease of the residual, over the length of the step


class WeakSprings:
    """Search for the equilibrium at the end of a time step, with springs at all nodes that soften. Collective.

    In all methods, arrays (n,) have the n unknowns of this rank.

    Args:
        equations: the balance of forces of the model.
        options: PETSc options of the linear solver, {name without prefix: value}.
    """

    def __init__(self, equations: Equations, options: Options) -> None:
        self.equations = equations
        self._options = {name: value for name, value in options.items() if not name.startswith("snes_")}
        self._factor = Factor()
        self._x, self._r, self._d = (equations.create_vector() for _ in range(3))
        self._mean_stiffness, self._stiffness = equations.mean_stiffness, 0.0

    def soften(self, rest: State, step: TimeStep, solve_free: Callable[[PETSc.Vec], SpringResult]) -> SpringResult:
        """Soften the springs until `solve_free` succeeds without them; return the result of `solve_free`.

        Args:
            rest: the model's state at rest.
            step: the time step at whose end an equilibrium is sought.
            solve_free: function that seeks an equilibrium without springs from the unknowns that it is given. It raises
                SolveError if it fails.

        Raises:
            NoEquilibrium: displacements grow without bound as the springs soften.
            SolveError: no equilibrium was found.
        """
        elastic_distance = self._elastic_distance(rest, step)
        errors = [SolveError("weak springs have not led to an equilibrium")]
        if not elastic_distance:
            raise errors.pop()
        self.equations.begin(step)
        self.equations.put_state(step.old, self._x)
        self._x.array[self.equations.bc_dofs] = self.equations.prescribed
        x = last_x = self._initial_x = self._x.array_r.copy()
        distance, factor, is_near = 0.0, SOFTENING_FACTOR, False
        self._stiffness = FIRST_STIFFNESS * self._mean_stiffness
        self.equations.residual(self._x, self._r)
        self._reference_forces = np.maximum(self.equations.scale.forces, self.equations.residual_norms(self._r))
        while self._stiffness > MIN_STIFFNESS * self._mean_stiffness and distance < MAX_DISTANCE * elastic_distance:
            solution = self._solve(x)
            if solution is None:
                if factor < SOFTENING_FACTOR or not distance:
                    break
                self._stiffness *= factor
                factor = math.sqrt(SOFTENING_FACTOR)
                self._stiffness /= factor
                x = last_x
                continue
            x = last_x = solution
            old_distance, distance = distance, self._distance(x)
            is_near = distance < old_distance * (1 + (CONVERGED_GROWTH - 1) * math.log10(factor))
            if is_near:
                self._x.array[:] = x
                try:
                    return solve_free(self._x)
                except SolveError as error:
                    errors = [error.with_traceback(None)]  # as in `Solver._try_in_turn`
            self._stiffness /= factor
            if distance > math.sqrt(factor) * old_distance > 0:  # extrapolate growth in proportion to 1/k
                x = min(x, factor * x + (1 - factor) * self._initial_x, key=self._residual_norm)
        if distance >= DIVERGED_DISTANCE * elastic_distance and not is_near:
            raise NoEquilibrium(distance / elastic_distance, self._jump_fractions(x))
        raise errors.pop()

    # ---------------------------------------------------------------- the step
    def _elastic_distance(self, rest_state: State, step: TimeStep) -> float:
        """Return the norm of the displacements that the step would cause in the model at rest with elastic layers.

        They are due to its loads and to the motion of its supports. The length dt of the step is kept, because laws
        with rate have no instantaneous response.

        Args:
            rest_state: the model's state at rest.
            step: the time step.
        """
        equations, r, d = self.equations, self._r, self._d
        equations.begin(TimeStep(rest_state, step.old.t, step.dt, 1.0))
        loads, prescribed = equations.prescribed_forces(), equations.prescribed
        homotopy_parameter = equations.homotopy_parameter
        equations.set_homotopy(1.0)
        try:
            equations.begin(TimeStep(rest_state, step.t, step.dt, 1.0))
            self._x.set(0.0)
            equations.residual(self._x, r)
            A = equations.tangent()
        finally:
            equations.set_homotopy(homotopy_parameter)
        A.shift(MIN_STIFFNESS * self._mean_stiffness)
        r.waxpy(-1.0, loads, equations.prescribed_forces())
        d.set(0.0)
        d.array[equations.bc_dofs] = equations.prescribed - prescribed
        equations.apply_bcs(A, d, r)
        self._solve_linear(A, r, d)
        return float(d.norm())

    def _distance(self, x: Array) -> float:
        displacement = x - self._initial_x
        return math.sqrt(self.equations.comm.allreduce(float(displacement @ displacement)))

    def _jump_fractions(self, x: Array) -> dict[str, float]:
        """Return which seams have the largest changes of jumps: name of a seam -> its fraction of their squares.

        The largest fraction comes first. Only seams with laws that yield or release bodies count. In layers that yield,
        jumps along S count half.

        Args:
            x: (n,) unknowns. Changes are counted from the start of the search.
        """
        self._d.array[:] = x - self._initial_x
        equations, model, u = self.equations, self.equations.model, self.equations.configuration(self._d).u
        limited_parts = [part for part in equations.parts if part.traits.bounded or part.traits.releases]
        jumps = {part.key: part.error_measure(u) for part in limited_parts if isinstance(part, MeasuresError)}
        seam_squares = model.seam_sums({key: equations.comm.allreduce(float((w**2).sum())) for key, w in jumps.items()})
        thin_layers = {name: model.layers[name].thin_layer for name, square in seam_squares.items() if square > 0}
        # squared jumps
        squares = {name: seam_squares[name] * (layer.eps if layer else 1.0) for name, layer in thin_layers.items()}
        total = sum(squares.values())
        return {name: squares[name] / total for name in sorted(squares, key=lambda name: -squares[name])}

    # ---------------------------------------------------------------- Newton's method
    def _residual_norm(self, x: Array) -> float:
        """Compute the residual at unknowns `x` (n,), with the forces of the springs, and return its relative norm.

        In each block of unknowns of `ForceScale` except the whole model, the norm of the residual is divided by a
        reference force. The result is the root of the sum of squares over the blocks. The reference force is that of
        `ForceScale` or, if it is larger, the norm of the residual at the beginning of `soften`.
        """
        equations = self.equations
        self._x.array[:] = x
        equations.residual(self._x, self._r)
        self._r.array[:] += self._stiffness * (x - self._initial_x)
        self._r.array[equations.bc_dofs] = 0.0
        self._norms = equations.norms(self._r.array_r)
        return float(np.linalg.norm(self._norms[1:] / np.maximum(self._reference_forces[1:], MIN_DIVISOR)))

    def _is_converged(self, x: Array) -> bool:
        """Return whether the last residual is small compared with the forces of the springs at unknowns `x` (n,).

        It must be so in each block of unknowns of `ForceScale`.
        """
        f_norms = self._stiffness * self.equations.norms(x - self._initial_x)
        return bool((self._norms <= np.maximum(RESIDUAL_TOLERANCE * f_norms, self.equations.max_norms(self._x))).all())

    def _solve(self, x: Array) -> Array | None:
        """Solve for the equilibrium with springs, starting from unknowns `x` (n,).

        Returns:
            The unknowns (n,) at this equilibrium; None: no convergence.
        """
        residuals = [self._residual_norm(x)]
        while len(residuals) <= MAX_NEWTON_STEPS and math.isfinite(residuals[-1]):
            A = self.equations.tangent()
            A.shift(self._stiffness)
            self.equations.apply_bcs(A)
            self._solve_linear(A, self._r, self._d)
            x, residual = self._line_search(x, -self._d.array_r, max(residuals[-N_COMPARED_RESIDUALS:]))
            residuals.append(residual)
            if self._is_converged(x):
                return x
        return None

    def _line_search(self, x: Array, d: Array, bound: float) -> tuple[Array, float]:
        """Shorten a Newton step until the residual is small enough.

        Args:
            x: (n,) unknowns before the step.
            d: (n,) increment of the unknowns by the full step.
            bound: norm below which the residual should fall. If no length of the step achieves that, the length with
                the least residual is taken.

        Returns:
            Unknowns (n,) after the step, and the norm of their residual.
        """
        best_residual, best_length, length = math.inf, 0.0, 1.0
        for length in 0.5 ** np.arange(MAX_STEP_TRIALS):
            residual = self._residual_norm(x + length * d)
            is_enough = residual < (1 - MIN_RESIDUAL_DECREASE * length) * bound
            if is_enough or residual < best_residual:
                best_residual, best_length = residual, length
            if is_enough:
                break
        if best_length != length:
            best_residual = self._residual_norm(x + best_length * d)
        return x + best_length * d, best_residual

    def _solve_linear(self, A: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        mark_symmetry(A, self.equations.model, is_saddle=True)
        with set_options(self._options):
            self._factor.renew(A, None, self.equations.set_preconditioner_data)
            solve_linear(self._factor.ksp, b, x)
