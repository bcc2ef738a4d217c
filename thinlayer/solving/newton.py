"""Newton's method for a step of a model: PETSc's SNES with a convergence test by the force scale of the step."""

from __future__ import annotations

import math
from typing import Any

from petsc4py import PETSc

from thinlayer.errors import SolveError
from thinlayer.solving.balance import ALLOWED
from thinlayer.solving.equations import Equations
from thinlayer.solving.petsc import PREFIX, OptionError, OptionValue, reason_name, solve_nonlinear

NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_rtol": 0,  # the first residual is no scale: it may be arbitrarily large where a dashpot was at rest
    "snes_stol": 0,
    "snes_max_it": 100,
}
YIELDING: dict[str, OptionValue] = {"snes_max_it": 50}
SINGULAR: dict[str, OptionValue] = {  # for singular tangents: the search is for the least energy, residuals may grow
    "snes_linesearch_type": "cp",
    "snes_linesearch_max_it": 40,
    "snes_linesearch_atol": 0,  # a work along the step: an absolute tolerance would depend on the units
    "snes_max_it": 300,
}
CONTACT: dict[str, OptionValue] = {  # residuals grow on good steps, as springs of S are stiff
    "snes_linesearch_type": "basic",
    "snes_max_it": 40,
}
LONGEST = "snes_linesearch_maxlambda" if PETSc.Sys.getVersion() >= (3, 24) else "snes_linesearch_maxstep"  # one option
EASED_CONTACT: dict[str, OptionValue] = {  # full steps at most, shortened where the forces do no work along them
    **CONTACT,
    "snes_linesearch_type": "cp",
    "snes_linesearch_max_it": 20,
    "snes_linesearch_rtol": 0.01,
    "snes_linesearch_atol": 0,  # a work along the step: an absolute tolerance would depend on the units
    LONGEST: 1,
}
STAGNATION_STEPS = 16  # number of steps in which the residual must fall by a tenth, for laws that yield
RUN_AWAY = 1e6  # largest displacements, relative to those of the first step, for laws that yield
Reason = PETSc.SNES.ConvergedReason


def newton(equations: Equations, x: PETSc.Vec, *, own_test: bool, stop_early: bool, advice: str) -> tuple[int, float]:
    """Solve for x, from displacements that satisfy the supports; returns steps and relative residual. Collective.

    Args:
        equations: the equations of the step; their last residual was computed at x.
        x: unknowns, overwritten; unchanged if PETSc or one of the equations raises an error.
        own_test: True: the force scale says when to stop; False: PETSc options do.
        stop_early: stop if the residual stagnates or displacements run away, as for loads beyond the limit load.
        advice: further things to try, for the error.

    Raises:
        SolveError: no convergence. OptionError: a method of PETSc's that does not use our convergence test.
        PETSc.Error: PETSc itself has failed. Errors of the equations, such as a LawError, as they were raised.
    """
    largest = RUN_AWAY * _largest(x)
    residuals: list[float] = []
    given_up = ""

    def function(_: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        equations.residual(x, b)
        b.array[equations.held] = 0.0

    def jacobian(_: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        equations.tangent()
        equations.hold(P)

    def converged(_: PETSc.SNES, steps: int, norms: tuple[float, float, float]) -> Any:
        nonlocal given_up
        residuals.append(equations.scale.relative(norms[2]))
        if math.isnan(norms[2]):
            return Reason.DIVERGED_FNORM_NAN
        x = snes.getSolution()
        if stop_early and _stagnates(residuals):
            given_up = f"the residual has not fallen for {STAGNATION_STEPS} steps"
        elif stop_early and not _largest(x) <= largest:
            given_up = "displacements grow without bound"
        if given_up:
            return Reason.DIVERGED_DTOL
        return Reason.CONVERGED_FNORM_ABS if norms[2] <= equations.aim(x) else False

    A = equations.tangent()
    equations.hold(A)
    snes = PETSc.SNES().create(equations.comm)
    snes.setOptionsPrefix(PREFIX)
    r = x.duplicate()
    snes.setFunction(function, r)
    snes.setJacobian(jacobian, A)
    if own_test:
        snes.setConvergenceTest(converged)
    snes.setFromOptions()
    equations.tell(snes.getKSP(), A)
    solve_nonlinear(snes, x, r)
    reason, steps = snes.getConvergedReason(), snes.getIterationNumber()
    if own_test and not residuals and reason >= 0:  # PETSc itself refuses a first residual that is NaN
        raise OptionError(f"-{PREFIX}snes_type {snes.getType()} does not look at the residual; use another one")
    last = equations.scale.relative(float(snes.getFunctionNorm()))
    ksp_reason = snes.getKSP().getConvergedReason()
    snes.destroy()
    r.destroy()
    stalled = reason == Reason.DIVERGED_LINE_SEARCH and last < ALLOWED  # rounding stops the line search
    stopped = own_test and reason >= 0 and not last < ALLOWED  # another test than ours ended the solve
    if stopped or (reason < 0 and not stalled):
        failed = f"; {equations.failure()}" if equations.failed else ""
        raise SolveError(
            f"Newton's method failed after {steps} steps: {given_up or reason_name(Reason, reason)}"
            + (f" (linear solver: {reason_name(PETSc.KSP.ConvergedReason, ksp_reason)})" if ksp_reason < 0 else "")
            + f", residual {last:.1e} of the forces{failed}",
            residuals=tuple(residuals),
            advice=f"try {advice}, or -{PREFIX}snes_monitor to watch it",
        )
    return steps, last


def _largest(x: PETSc.Vec) -> float:
    return float(x.norm(PETSc.NormType.INFINITY))


def _stagnates(residuals: list[float]) -> bool:
    """Whether the last steps have not reduced the residual."""
    before, last = residuals[:-STAGNATION_STEPS], residuals[-STAGNATION_STEPS:]
    return bool(before) and min(last) > 0.9 * min(before)
