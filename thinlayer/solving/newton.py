"""Solver of one time step: a linear solve from the state before the step, then refinement or Newton's method."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from petsc4py import PETSc

from forms.base import InputError
from thinlayer.errors import SolveError
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import mark_symmetry, needs_factor_only, pivot_ratio
from thinlayer.solving.part_sum import ACCEPTED_RESIDUAL, SOLVER_RESIDUAL
from thinlayer.solving.petsc import PREFIX, OptionDict, reason_name, solve_linear, solve_nonlinear

# Relative residuals; keys: True for direct solvers, False for Krylov methods.
REFINEMENT_TARGET = {True: 1e-15, False: 1e-10}  # refinement ends at this residual
MAX_REFINABLE_RESIDUAL = {True: 1e-3, False: 0.5}  # refinement starts below this; Krylov methods test another norm
REFINEMENT_REDUCTION = {True: 0.1, False: 0.5}  # another follows if one reduces the residual below this ratio
KRYLOV_REDUCTION = 0.3  # target of a Krylov method that refines, relative to REFINEMENT_TARGET
MIN_PIVOT_RATIO = 1e-6  # smallest over largest pivot above which rounding of the forces is harmless
# The next two are changes of displacements by a refinement, relative to `_reference_displacement`.
SINGULAR_CHANGE = 1e-3  # change by the first refinement above which the matrix is singular
MAX_LAST_CHANGE = 1e-5  # change by the last refinement above which rounding has spoilt the solution
OVERSHOOT_RESIDUAL = 10.0  # residual after the linear step, relative to the forces, above which it is shortened
# snes_rtol: the first residual is no reference, as it may be arbitrarily large where a dashpot was at rest
NEWTON_OPTIONS = OptionDict(snes_type="newtonls", snes_linesearch_type="bt", snes_rtol=0, snes_stol=0, snes_max_it=100)
YIELDING_OPTIONS = OptionDict(snes_max_it=50)
# PETSc 3.24 has renamed this option
MAX_STEP_OPTION = "snes_linesearch_maxlambda" if PETSc.Sys.getVersion() >= (3, 24) else "snes_linesearch_maxstep"
# steps end where the forces do no work along them, though residuals may grow; an absolute tolerance (atol) of this work
# would depend on the units
CP_LINESEARCH_OPTIONS = OptionDict(snes_linesearch_type="cp", snes_linesearch_max_it=40, snes_linesearch_atol=0)
# for singular tangents: the line search looks for the least energy
SINGULAR_TANGENT_OPTIONS = OptionDict(CP_LINESEARCH_OPTIONS, snes_max_it=300)
# no line search, as residuals grow on good steps
CONTACT_OPTIONS = OptionDict(snes_linesearch_type="basic", snes_max_it=300)
CONTACT_HOMOTOPY_OPTIONS = CP_LINESEARCH_OPTIONS | {"snes_max_it": 40, "snes_linesearch_rtol": 0.01, MAX_STEP_OPTION: 1}
STAGNATION_STEPS = 16  # number of steps in which the residual must fall by a tenth, for laws that yield
DIVERGED_DISPLACEMENT_RATIO = 1e6  # largest displacements, relative to the first step's, for laws that yield
Reason = PETSc.SNES.ConvergedReason
RESISTANCE_QUESTION = "does something resist every motion of the bodies, and every strain of the layer?"
YIELDING_STEP_RATIO = 1e4  # linear step over old displacements above which a layer yields everywhere


@dataclass(frozen=True)
class StepSolution:
    """Unknowns at the end of a time step, with the effort and accuracy of their computation.

    Attributes:
        x: vector of the unknowns. It belongs to the solver, and is valid until the next `solve_step` or `close`.
        iterations: number of Newton steps. For a linear solve, that of Krylov iterations; for a relaxation, that of
            sweeps.
        residual: norm of the residual relative to the reference forces.
    """

    x: PETSc.Vec
    iterations: int
    residual: float


class EquilibriumSolver(ABC):
    """Base of the solvers for the unknowns at the end of a time step. They keep matrices and factors between steps.

    The time step is the one that was last begun by the `Equations` of the solver.

    Attributes:
        has_homotopy: whether the solver can be used in a homotopy continuation, which starts with an elastic law.
        reused_solver: whether the last step used a PETSc solver of an earlier step, and so read no PETSc options.
    """

    has_homotopy = True
    reused_solver = False

    @abstractmethod
    def solve_step(self, start: PETSc.Vec | None = None) -> StepSolution:
        """Solve for the unknowns at the end of the time step. Collective.

        Args:
            start: initial unknowns; None: those of the state before the step.

        Raises:
            SolveError: no convergence.
        """

    def reset(self) -> bool:
        """Drop the data of earlier steps, so that a step that failed with them can be tried again.

        Returns:
            Whether the last step used such data.
        """
        return False

    def close(self) -> None:  # noqa: B027  some solvers have nothing to free
        """Free matrices and factors."""


class NewtonSolver(EquilibriumSolver):
    """Solver of time steps by a linear solve, then Newton's method or, for linear models, iterative refinement.

    It uses a factor again as long as the matrix is the same.

    Args:
        equations: the balance of forces.
        nonlinear: whether Newton's method follows the linear solve; otherwise iterative refinement does.
        force_test: whether the reference forces of `ForceScale` decide on convergence; otherwise tolerances that the user
            has set in PETSc options do.
        yields: whether a law bounds stresses. Newton's method then stops early if it does not converge.
        advice: what the error message of Newton's method advises after a failure.

    Attributes:
        equations, nonlinear: the arguments.
    """

    def __init__(self, equations: Equations, *, nonlinear: bool, force_test: bool, yields: bool, advice: str) -> None:
        self.equations, self.nonlinear = equations, nonlinear
        self._force_test, self._yields, self._advice = force_test, yields, advice
        self._factor = equations.factor
        self._work_vectors = [equations.create_vector() for _ in range(4)]

    def reset(self) -> bool:
        """Drop the linear solver and its factor; return whether the last step used the factor of an earlier step."""
        self._factor.destroy()
        was_reused, self.reused_solver = self.reused_solver, False
        return was_reused

    def solve_step(self, start: PETSc.Vec | None = None) -> StepSolution:
        """Solve for the unknowns at the end of the time step. Collective.

        Args:
            start: unknowns from which Newton's method starts at once. None: a linear solve from the state before the
                step comes first.

        Raises:
            SolveError: no convergence, or no unique solution.
        """
        equations = self.equations
        x, r, d, bc_step = self._work_vectors
        if start is not None:
            start.copy(x)
            equations.residual(x, r)
            return self._run_newton(x)
        for vector in self._work_vectors:
            vector.set(0.0)
        equations.put_state(equations.interval.old, x)
        bc_step.array[equations.bc_dofs] = equations.prescribed - x.array_r[equations.bc_dofs]
        if self.nonlinear:
            equations.initial_residual(x, r)
        else:
            x.axpy(1.0, bc_step)
            equations.residual(x, r)
        if equations.failed:
            raise SolveError(f"at the start of the step {equations.failure_text()}")
        return self._solve_from_linear_step(x, r, d, bc_step) if self.nonlinear else self._solve_linear_model(x, r, d)

    def _solve_linear_model(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec) -> StepSolution:
        r.scale(-1.0)
        r.array[self.equations.bc_dofs] = 0.0
        self._prepare_ksp()
        solve_linear(self._factor.ksp, r, d)
        iterations = int(self._factor.ksp.getIterationNumber())
        x.axpy(1.0, d)
        self.equations.scale.include_displacement(_max_norm(x))
        self.equations.residual(x, r)
        residual, more_iterations = self._refine(x, r, d)
        return StepSolution(x, iterations + more_iterations, residual)

    def _solve_from_linear_step(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec, bc_step: PETSc.Vec) -> StepSolution:
        """Solve a step by Newton's method that starts after a linear solve, in which the supports move.

        Args:
            x: unknowns of the state before the step; overwritten.
            r: residual at `x`; overwritten.
            d: work vector.
            bc_step: increments of the prescribed displacements, zero at all other unknowns.
        """
        equations, scale = self.equations, self.equations.scale
        reference = 0.0 if scale.is_only_rounding else float(scale.forces[0])
        self._require_finite("stress", self._unconstrained_norm(r))
        r.scale(-1.0)
        self._prepare_ksp(bc_step, r)
        solve_linear(self._factor.ksp, r, d)
        if self._yields and x.norm() > 0 and not d.norm() <= YIELDING_STEP_RATIO * x.norm():
            self._elastic_step(x, r, d, bc_step)
        if not math.isfinite(d.norm()):
            advice = f"{RESISTANCE_QUESTION[:-1]} at rest? A stress without a linear part, as e^3, needs a small one"
            raise SolveError("the tangent at the start of the step is singular", advice=advice)
        d.array[equations.bc_dofs] = bc_step.array_r[equations.bc_dofs]
        x.axpy(1.0, d)
        if not self._yields and equations.interval.old.at_rest:
            equations.scale.include_displacement(_max_norm(x))
        equations.residual(x, r)
        self._shorten_step(x, r, d, bc_step, reference)
        return self._run_newton(x)

    def _elastic_step(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec, bc_step: PETSc.Vec) -> None:
        """Compute the increment of the unknowns by a linear solve in which the layer is elastic.

        Args:
            x: unknowns of the state before the step.
            r: work vector for the right-hand side.
            d: the increment; overwritten.
            bc_step: increments of the prescribed displacements, zero at all other unknowns.
        """
        equations, homotopy_parameter = self.equations, self.equations.homotopy_parameter
        equations.residual(x, r)
        r.scale(-1.0)
        equations.set_homotopy(1.0)
        try:
            equations.residual(x, d)
        finally:
            equations.set_homotopy(homotopy_parameter)
        self._prepare_ksp(bc_step, r)
        solve_linear(self._factor.ksp, r, d)

    def _shorten_step(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec, bc_step: PETSc.Vec, reference: float) -> None:
        """Shorten the increment of the linear solve while the residual after it is too large.

        Laws that stiffen with the rate lead to such increments. Prescribed displacements keep their full increments.

        Args:
            x: unknowns after the increment; overwritten.
            r: residual at `x`; overwritten.
            d: the increment; overwritten.
            bc_step: increments of the prescribed displacements, zero at all other unknowns.
            reference: reference force. The residual must be at most `OVERSHOOT_RESIDUAL` times as large; 0: any residual
                is allowed.
        """
        d.axpy(-1.0, bc_step)
        for _ in range(40):
            if not reference or self._unconstrained_norm(r) <= OVERSHOOT_RESIDUAL * reference:
                return
            x.axpy(-0.75, d)
            d.scale(0.25)
            self.equations.residual(x, r)

    def _prepare_ksp(self, bc_step: PETSc.Vec | None = None, b: PETSc.Vec | None = None) -> None:
        """Give the linear solver the tangent with Dirichlet conditions, for the next solve.

        Args:
            bc_step: increments of the prescribed displacements. None: they are zero, so that a factor of the same matrix
                can be used again.
            b: right-hand side, to which the forces due to `bc_step` are added; None if `bc_step` is None.
        """
        equations = self.equations
        dt = equations.interval.dt if equations.depends_on_dt else 0.0
        key = float(f"{dt:.12g}"), equations.interval.theta  # lengths of equal steps differ by rounding
        if bc_step is None and self._factor.matrix_key == key:
            self.reused_solver = True
            return
        in_place = not self.nonlinear and needs_factor_only()
        with equations.constrained_tangent(bc_step, b, in_place=in_place) as A:
            if self.nonlinear:
                self._require_finite("tangent (the slope of the stress)", A.norm())
            else:
                equations.require_unique()
            mark_symmetry(A, equations.model, is_saddle=equations.traits.saddle)
            self.reused_solver = self._factor.renew(A, key, equations.set_preconditioner_data) and not self.nonlinear
            if in_place:
                self._factor.set_up()

    def _require_finite(self, quantity: str, norm: float) -> None:
        """Raise SolveError if `norm`, the norm of a quantity at the start of the step, is NaN or infinite.

        Args:
            quantity: name of the quantity, for the message.
            norm: its norm.
        """
        if not math.isfinite(norm):
            names = " or ".join(sorted({*self.equations.names_with_trait("nonlinear")}))
            advice = "at rest the strain e is zero: write ufl.sqrt(ufl.inner(e, e) + small), or a ufl.conditional"
            raise SolveError(f"the {quantity} of {names} is not finite at the start of the step", advice=advice)

    def _refine(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec) -> tuple[float, int]:
        """Improve the solution of a linear model by iterative refinement.

        Args:
            x: unknowns after the linear solve; changed in place.
            r: residual at `x`; overwritten.
            d: work vector.

        Returns:
            Norm of the residual relative to the reference forces, and number of Krylov iterations (0 for a direct
                solver).

        Raises:
            SolveError: the solution is not unique, or its residual is too large.
        """
        equations, ksp = self.equations, self._factor.ksp
        reason, is_direct = ksp.getConvergedReason(), ksp.getType() == "preonly"
        residual, is_first, ratio, iterations, rtol = self._relative_norm(r), True, 0.0, 0, ksp.getTolerances()[0]
        if residual < SOLVER_RESIDUAL and not equations.traits.saddle and pivot_ratio(ksp.getPC()) > MIN_PIVOT_RATIO:
            return residual, 0
        while REFINEMENT_TARGET[is_direct] < residual < MAX_REFINABLE_RESIDUAL[is_direct]:
            r.scale(-1.0)
            if not is_direct:  # no further than needed
                ksp.setTolerances(rtol=max(rtol, KRYLOV_REDUCTION * REFINEMENT_TARGET[is_direct] / residual))
            try:
                solve_linear(ksp, r, d)
            finally:
                ksp.setTolerances(rtol=rtol)
            iterations += ksp.getIterationNumber()
            reference, change = self._reference_displacement(x), _max_norm(d)
            if is_first and is_direct and change > SINGULAR_CHANGE * reference:
                text = f"rounding of the forces changes the displacements {reference:.1e} by {change:.1e}"
                raise SolveError(f"no unique solution: {text}", advice=RESISTANCE_QUESTION)
            is_first, ratio = False, change / reference if reference else 0.0
            x.axpy(1.0, d)
            equations.residual(x, r)
            new_residual = self._relative_norm(r)
            if new_residual > residual:
                x.axpy(-1.0, d)
            if new_residual >= REFINEMENT_REDUCTION[is_direct] * residual:
                break
            residual = new_residual
        if is_direct and ratio > MAX_LAST_CHANGE:
            details = f"by {ratio:.1e} of them, allowed: {MAX_LAST_CHANGE:g}; bodies are too stiff for what holds them"
            advice = f"take their moduli {10 * ratio / MAX_LAST_CHANGE:.0e} times smaller, or larger cells"
            raise SolveError(f"linear solve failed: rounding changes the displacements {details}", advice=advice)
        if not residual < ACCEPTED_RESIDUAL:
            equations.put_state(equations.interval.old, d)
            equations.initial_residual(d, r)
            equations.residual(x, r)
            residual = self._relative_norm(r)
        if not residual < ACCEPTED_RESIDUAL:
            text = f"{reason_name(PETSc.KSP.ConvergedReason, reason)}, relative residual {residual:.1e}"
            hints = "".join(f", or {part.hint}" for part in equations.field_parts if part.hint)
            advice = f"with an iterative solver try -{PREFIX}ksp_max_it or -{PREFIX}pc_type cholesky"
            raise SolveError(f"linear solve failed: {text}; a body is free, or a law not linear{hints}", advice=advice)
        return residual, 0 if is_direct else iterations

    def _reference_displacement(self, x: PETSc.Vec) -> float:
        """Return the displacement to which rounding errors of the unknowns `x` are compared.

        It is the largest of three: the largest entry of `x`, the largest displacement known before the step, and the
        forces of the step divided by the mean stiffness. `x` alone may be only rounding errors: if loads end at zero,
        in a uniform cell under a mean strain, or if supports prevent every expansion.
        """
        scale, stiffness = self.equations.scale, self.equations.mean_stiffness
        elastic = float(scale.forces[0]) / (stiffness * math.sqrt(x.getSize())) if stiffness else 0.0
        return max(_max_norm(x), scale.max_displacement, elastic)

    def _relative_norm(self, r: PETSc.Vec) -> float:
        """Return the largest ratio of the norm of the residual `r` to the reference force, over all blocks of unknowns.

        The blocks are those of `ForceScale`. Entries of `r` at constrained unknowns become zero.
        """
        r.array[self.equations.bc_dofs] = 0.0
        return self.equations.relative_norm(r)

    def _unconstrained_norm(self, r: PETSc.Vec) -> float:
        r.array[self.equations.bc_dofs] = 0.0
        return float(r.norm())

    # ---------------------------------------------------------------- Newton's method
    def _run_newton(self, x: PETSc.Vec) -> StepSolution:
        """Solve by Newton's method (PETSc SNES) from unknowns `x`, which become the solution.

        The last residual that was evaluated must be that at `x`. The reference forces decide on convergence, unless the
        user's PETSc options do.

        If a law bounds stresses, the method stops early where the residual stagnates or displacements grow without
        bound. Both happen under loads beyond the limit load.

        Raises:
            SolveError: no convergence.
            InputError: the user has chosen an SNES type that does not call the convergence test.
            PETSc.Error: PETSc itself has failed. Errors of the equations, such as an InputError, pass unchanged.
        """
        equations, max_displacement = self.equations, DIVERGED_DISPLACEMENT_RATIO * _max_norm(x)
        residuals, why_diverged = list[float](), ""

        def converged(snes: PETSc.SNES, steps: int, norms: tuple[float, float, float]) -> PETSc.SNES.ConvergedReason:
            nonlocal why_diverged
            x, r = snes.getSolution(), snes.getFunction()[0]
            residuals.append(equations.relative_norm(r))
            if math.isnan(norms[2]):
                return Reason.DIVERGED_FNORM_NAN
            if self._yields and _stagnates(residuals):
                why_diverged = f"the residual has not fallen for {STAGNATION_STEPS} steps"
            elif self._yields and not _max_norm(x) <= max_displacement:
                why_diverged = "displacements grow without bound"
            if why_diverged:
                return Reason.DIVERGED_DTOL
            return Reason.CONVERGED_FNORM_ABS if equations.is_balanced(x, r) else False

        snes = self._create_snes(x, converged)
        solve_nonlinear(snes, x)
        reason, steps = snes.getConvergedReason(), snes.getIterationNumber()
        if self._force_test and not residuals and reason >= 0:  # PETSc itself refuses a first residual that is NaN
            raise InputError(f"-{PREFIX}snes_type {snes.getType()} does not look at the residual; use another one")
        residual, ksp_reason = equations.relative_norm(snes.getFunction()[0]), snes.getKSP().getConvergedReason()
        is_stalled = reason == Reason.DIVERGED_LINE_SEARCH and residual < ACCEPTED_RESIDUAL
        if is_stalled:  # by rounding, unless no equilibrium is near: then another step would be long
            solve_linear(snes.getKSP(), snes.getFunction()[0], d := self._work_vectors[2])
            is_stalled = _max_norm(d) <= MAX_LAST_CHANGE * self._reference_displacement(x)
            why_diverged = "" if is_stalled else "no step reduces the residual"
        snes.destroy()
        # for reasons >= 0 a test other than ours may have ended the solve
        has_failed = not is_stalled if reason < 0 else self._force_test and not residual < ACCEPTED_RESIDUAL
        if has_failed:
            text = f"{why_diverged or reason_name(Reason, reason)}, residual {residual:.1e} of the forces"
            text += f", linear solver: {reason_name(PETSc.KSP.ConvergedReason, ksp_reason)}" if ksp_reason < 0 else ""
            text += f"; {equations.failure_text()}" if equations.failed else ""
            advice = f"try {self._advice}, or -{PREFIX}snes_monitor to watch it"
            raise SolveError(f"Newton's method failed after {steps} steps: {text}", None, tuple(residuals), advice)
        if not equations.traits.releases:
            equations.require_unique()
        return StepSolution(x, steps + 1, residual)

    def _create_snes(self, x: PETSc.Vec, converged: Callable[..., PETSc.SNES.ConvergedReason]) -> PETSc.SNES:
        """Create the SNES that solves the balance of forces, with the convergence test `converged`.

        Args:
            x: vector of unknowns, whose layout the SNES takes.
            converged: convergence test in PETSc's form. It is not used if the user has set tolerances.
        """
        equations = self.equations

        def residual(_: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
            equations.residual(x, b)
            b.array[equations.bc_dofs] = 0.0

        def jacobian(_: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
            equations.tangent()
            equations.apply_bcs(P)

        A = equations.tangent()
        equations.apply_bcs(A)
        snes = PETSc.SNES().create(equations.comm)
        snes.setOptionsPrefix(PREFIX)
        snes.setFunction(residual, x.duplicate())
        snes.setJacobian(jacobian, A)
        if self._force_test:
            snes.setConvergenceTest(converged)
        snes.setFromOptions()
        equations.set_preconditioner_data(snes.getKSP(), A)
        return snes


def _max_norm(x: PETSc.Vec) -> float:
    return float(x.norm(PETSc.NormType.INFINITY))


def _stagnates(residuals: list[float]) -> bool:
    """Whether the last STAGNATION_STEPS Newton steps have reduced the residual by less than a tenth.

    Args:
        residuals: relative residuals before each step and after the last one.
    """
    before, last = residuals[:-STAGNATION_STEPS], residuals[-STAGNATION_STEPS:]
    return bool(before) and min(last) > 0.9 * min(before)
