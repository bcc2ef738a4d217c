"""Steps of a layer whose columns switch their phases: each step ends at the time at which the first column switches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.pointwise.columns import TIE
from thinlayer.solving.solvers import Solver

TIME_ROUNDING = 8 * 2.0**-52  # relative tolerance of the time of a snap
PROBES = 8  # number of equal parts of a step at whose ends the excess is tested if loads are not linear in time


def steps(solver: Solver, old: State, end: float) -> Iterator[State]:
    """States of a step: at every snap the state just before it and the state after it, then the state at the end.

    A snap has no duration: both its states have the same t. The energy that layer and bodies lose in it is `dissipated`.
    If loads, supports and parameters are linear in time within the step, the first switch is found (steps end at the breaks
    of piecewise data). Otherwise a column may be missed whose phase is not the one of lowest energy only for a while, see
    `PROBES`. Collective; errors as in `solve`.

    Raises:
        SolveError: the methods `excess` and `switched` of a law disagree.
    """

    def excess(t: float) -> float:
        solver.step(old, t, keep_phases=True)
        return solver.equations.excess - 2 * TIE

    while True:
        span = end - old.t
        # With fixed phases driving forces are linear in time if loads, supports and parameters are (bodies are taken to be
        # linear). The excess is the largest of their sizes, so it is convex: if positive within the step, also at its end.
        convex = not span or solver.equations.linear_in_time(old.t, end)
        probes = () if convex else (old.t + span * k / PROBES for k in range(1, PROBES))
        bound = next((t for t in probes if excess(t) > 0), end)
        kept = solver.step(old, bound, keep_phases=True)
        if solver.equations.excess <= 2 * TIE:
            if old.t < end:
                yield kept
            return
        t = _first(excess, old.t, bound)
        if t > old.t:
            old = solver.step(old, t, keep_phases=True)
            yield old
            if excess(t) <= -TIE:  # Newton's tolerance may make the excess smaller from the new start
                continue
        old = snapped(solver.step(old, t))
        if solver.equations.excess > 2 * TIE:
            raise SolveError(f"at t = {t:g}: excess() > 0 for a column, but switched() keeps its phase; they disagree")
        yield old
        if t == end:
            return


def _first(excess: Callable[[float], float], start: float, end: float) -> float:
    """The first time at which the excess is positive, to rounding; the excess is positive at `end`."""
    from scipy.optimize import brentq  # not needed by most marches

    if excess(start) > 0:
        return start
    width = TIME_ROUNDING * max(abs(start), abs(end))
    t = float(brentq(excess, start, end, xtol=width, rtol=TIME_ROUNDING))
    while t < end and excess(t) <= 0:
        t, width = min(t + width, end), 2 * width
    return t


def snapped(state: State) -> State:
    """The state after a snap, with the remainder of its energy balance counted as dissipated."""
    audit = state.audit
    return replace(state, audit=replace(audit, dissipated=audit.dissipated + audit.remainder, remainder=0.0))
