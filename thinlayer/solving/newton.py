"""Newton's method for a step of a model: PETSc's SNES, told when to stop by the forces of the step."""

from __future__ import annotations

import math
from typing import Any

from petsc4py import PETSc

from thinlayer.errors import SolveError
from thinlayer.solving.balance import aim
from thinlayer.solving.equations import Equations
from thinlayer.solving.force_scale import ALLOWED
from thinlayer.solving.linear_solvers import tell_multigrid
from thinlayer.solving.options import PREFIX, OptionError, OptionValue

NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_rtol": 0,  # the first residual says nothing: a dashpot at rest lets the first step go anywhere
    "snes_stol": 0,
    "snes_max_it": 100,
}
YIELDING: dict[str, OptionValue] = {"snes_max_it": 50}
FLAT: dict[str, OptionValue] = {  # a search for the least energy: residuals may have to grow on the way
    "snes_linesearch_type": "cp",
    "snes_linesearch_max_it": 40,
    "snes_linesearch_atol": 0,  # of the work along the step, in units of energy: it knows nothing of the forces
    "snes_max_it": 300,
}
STALLED = 16  # steps without a residual that is a tenth smaller: a law that yields has no equilibrium, or hides it
RUN_AWAY = 1e6  # displacements over those of the first step: likewise
Reason = PETSc.SNES.ConvergedReason


def newton(
    equations: Equations, x: PETSc.Vec, r: PETSc.Vec, *, own_test: bool, hopeless: bool, advice: str
) -> tuple[int, float]:
    """Solve for x, from displacements that satisfy the supports; steps taken and relative residual. Collective.

    Args:
        equations: the step; their last residual is that of x.
        x: unknowns, overwritten.
        r: a vector to work with.
        own_test: whether we say when to stop, or PETSc's options do.
        hopeless: whether to give up where the residual stays or the displacements run away: laws that yield.
        advice: what else to try, for the error.

    Raises:
        SolveError: no convergence. OptionError: a method that does not ask when to stop.
    """
    largest = RUN_AWAY * _largest(x)
    residuals: list[float] = []
    given_up = ""

    def function(_: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        equations.residual(x, b)
        b.array[equations.held] = 0.0

    def jacobian(_: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        equations.tangent()
        P.zeroRowsColumns(equations.held_rows, 1.0)

    def converged(_: PETSc.SNES, steps: int, norms: tuple[float, float, float]) -> Any:
        nonlocal given_up
        residuals.append(equations.scale.relative(norms[2]))
        if math.isnan(norms[2]):
            return Reason.DIVERGED_FNORM_NAN
        x = snes.getSolution()
        if hopeless and _stays(residuals):
            given_up = f"the residual has stayed where it is for {STALLED} steps"
        elif hopeless and not _largest(x) <= largest:
            given_up = "displacements grow without bound"
        if given_up:
            return Reason.DIVERGED_DTOL
        return Reason.CONVERGED_FNORM_ABS if norms[2] <= aim(equations, x) else False

    A = equations.tangent()
    A.zeroRowsColumns(equations.held_rows, 1.0)
    snes = PETSc.SNES().create(equations.comm)
    snes.setOptionsPrefix(PREFIX)
    snes.setFunction(function, r)
    snes.setJacobian(jacobian, A)
    if own_test:
        snes.setConvergenceTest(converged)
    snes.setFromOptions()
    tell_multigrid(snes.getKSP(), A, equations.model)
    snes.solve(None, x)
    reason, steps = snes.getConvergedReason(), snes.getIterationNumber()
    if own_test and not residuals and reason >= 0:  # PETSc itself refuses a first residual that is NaN
        raise OptionError(f"-{PREFIX}snes_type {snes.getType()} does not look at the residual; use another one")
    last = equations.scale.relative(float(snes.getFunctionNorm()))
    ksp_reason = snes.getKSP().getConvergedReason()
    snes.destroy()
    stalled = reason == Reason.DIVERGED_LINE_SEARCH and last < ALLOWED  # by rounding
    stopped = own_test and reason >= 0 and not last < ALLOWED  # by a test other than ours
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


def _stays(residuals: list[float]) -> bool:
    """Whether the last steps have not made the residual smaller."""
    return len(residuals) > STALLED and min(residuals[-STALLED:]) > 0.9 * min(residuals[:-STALLED])


def reason_name(kind: Any, value: int) -> str:
    """PETSc's name of a reason why it stopped."""
    names = {v: k for k, v in vars(kind).items() if isinstance(v, int) and not k.startswith("_")}
    return names.get(value, str(value))
