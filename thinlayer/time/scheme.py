"""Requirements of parts on time steps: theta < 1 is not always allowed."""

from __future__ import annotations

from collections.abc import Sequence

from thinlayer.errors import ModelError
from thinlayer.solving.equations import Equations

ALLOWED_THETA = "theta = 1"  # the last words of errors


def require_ends(equations: Equations, theta: float, times: Sequence[float]) -> None:
    """Raise ModelError if theta < 1 and a part does not balance at the ends of steps then. Collective.

    Laws at points that creep or relax may be of any kind; others say `linear`, and their parameters do not change in time.

    Args:
        equations: the equations of the model.
        theta: theta of the march.
        times: start of the march, and the times at which steps end.
    """
    if theta == 1:
        return
    at_ends = f"theta is {theta}; {{}} holds at the ends of steps: {ALLOWED_THETA}"
    bounds = (
        f"theta is {theta}; {{}} bounds stresses: with theta < 1 they are kept within the bound at t + theta dt, "
        f"where forces balance, and may exceed it at the end of the step; allowed: {ALLOWED_THETA}"
    )
    equations.refuse({"releases": at_ends, "switches": at_ends, "bounded": bounds})
    for part in equations.parts:
        at_once = [(name, False) for name, has in part.named().items() if has.nonlinear and not has.rate]
        if hasattr(part, "answers_at_once"):
            at_once = [*filter(None, [part.answers_at_once(times)])]
        for name, changes in at_once:
            how = "with parameters that change in time" if changes else "not linearly (linear = True is not declared)"
            raise ModelError(
                f"theta is {theta}; {name} answers at once, and {how}: if forces balance within a step, states at the ends "
                f"of steps oscillate about the solution, and nothing damps them: {ALLOWED_THETA}"
            )
