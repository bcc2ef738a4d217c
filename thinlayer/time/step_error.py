"""What planned steps leave undetermined: a march again with half or twice as many, and how far its end is away."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from thinlayer.errors import SolveError, warn
from thinlayer.solving.equations import Equations
from thinlayer.solving.solvers import Solver
from thinlayer.system.progress import telling
from thinlayer.time.checkpoint import Pace
from thinlayer.time.error import QUANTITIES, ErrorEstimate
from thinlayer.time.history import History
from thinlayer.time.journal import Journal
from thinlayer.time.plan import HALVINGS, Plan
from thinlayer.time.stepping import TimeStepping

TOLD = 0.02  # least error of the steps that leads to a warning
FEWEST = 8  # planned steps whose number can be halved; fewer are made again as this many or more
IDLE = 1e-12  # dissipation over the work of the loads, that is none


def tell_steps(solver: Solver, history: History, plan: Plan, start: float, theta: float) -> None:
    """Estimate the errors of planned steps at the end of a march, and warn of large ones. Collective.

    Laws that are not linear and have a history, as of yield, friction or damage, are marched again with half as many steps:
    half as many solves again. Less than eight steps are made again as 8 to 14. Breaks of the data remain ends of steps. The
    difference gives the error of the whole march to leading order; one halved step would tell what it adds alone. A march
    that has dissipated nothing is not made again.
    """
    if plan.adaptive or not depends_on_steps(solver.equations):
        return
    if _idle(history):
        history.step_errors = dict.fromkeys(QUANTITIES, 0.0)
        return
    again = _other(plan.targets, start, solver.model.break_times)
    length = float(np.diff([start, *again]).min()) / 2**HALVINGS
    journal = Journal(solver.equations, Pace(None), {}, "last", None, {"theta": theta})
    remedy = "take more steps, or times=Adaptive(end=..., first=..., tolerance=...)"
    try:
        with telling("error of the steps"):
            other = TimeStepping(solver, journal, Plan(again, None, length), start, theta).run(False).last
    except SolveError as error:
        history.step_errors = dict.fromkeys(QUANTITIES, np.nan)
        warn(
            "no step error",
            f"the error of the march's steps is not known: with {len(again)} steps {error.reason}; {remedy}",
            history.model.comm,
        )
        return
    order = 2 if theta == 0.5 else 1
    gain = abs((len(plan.targets) / len(again)) ** order - 1)
    shares = ErrorEstimate(solver.equations).shares(other, history.last) / gain
    history.step_errors = dict(zip(QUANTITIES, map(float, shares), strict=True))
    if shares.max() > TOLD:
        told = ", ".join(f"{share:.2g} in {name}" for name, share in history.step_errors.items())
        warn(
            "step error",
            f"the {len(plan.targets)} steps of this march leave estimated relative errors of {told} at its end (march with "
            f"{len(again)} steps): the law depends on its history; {remedy}",
            history.model.comm,
        )


def depends_on_steps(equations: Equations) -> bool:
    """Whether a part is not linear and has a history; phases that switch have steps of their own."""
    each = [part.traits for part in equations.parts]
    return any((has.remembers or has.rate) and has.nonlinear and not has.switches for has in each)


def _idle(history: History) -> bool:
    """Whether the march has dissipated nothing; False if a law does not declare its energy."""
    dissipated, supplied = (np.array(history.table[name], float) for name in ("dissipated", "supplied"))
    return bool(np.abs(dissipated).sum() <= IDLE * np.abs(supplied).sum())


def _other(targets: Sequence[float], start: float, breaks: set[float]) -> list[float]:
    """Every second target, counted from the end, and breaks; where few would be left, all steps in parts."""
    last = len(targets) - 1
    coarse = [t for k, t in enumerate(targets) if (last - k) % 2 == 0 or t in breaks]
    if len(targets) >= FEWEST and 4 * len(coarse) <= 3 * len(targets):
        return coarse
    parts = max(2, math.ceil(FEWEST / len(targets)))
    return [b - (b - a) * k / parts for a, b in pairwise([start, *targets]) for k in reversed(range(parts))]
