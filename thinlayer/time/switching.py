"""Steps of a layer whose columns switch their phases: cut where the first one does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from scipy.optimize import brentq

from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.pointwise.columns import TIE
from thinlayer.solving.solvers import Solver

ROUNDING = 8 * 2.0**-52
PROBES = 8  # times at which a step is looked at whose columns may be beaten for a while, and at its end are not


def steps(solver: Solver, old: State, end: float) -> Iterator[State]:
    """States on the way from a state to a time: at every snap the one just before it, and the one after it, then the end.

    A snap has no duration: both its states have the same t. What the layer and the bodies lose in it is `dissipated`.
    Where loads, supports and parameters are linear in time on the way, the first switch is found (the march stops where
    piecewise ones break); where they are not, a column that is beaten for a while only may be missed, see `PROBES`.
    Collective; errors as in `solve`.

    Raises:
        SolveError: a law whose `excess` asks for what its `switched` does not do.
    """

    def excess(t: float) -> float:
        solver.step(old, t, held=True)
        return solver.equations.excess - 2 * TIE

    while True:
        bound = (
            end if _bends_up(solver, old.t, end) else next(filter(lambda t: excess(t) > 0, _probes(old.t, end)), end)
        )
        held = solver.step(old, bound, held=True)
        if solver.equations.excess <= 2 * TIE:
            if old.t < end:
                yield held
            return
        t = _first(excess, old.t, bound)
        if t > old.t:
            old = solver.step(old, t, held=True)
            yield old
            if excess(t) <= -TIE:  # from there Newton's method may find it smaller by what its tolerance allows
                continue
        old = snapped(solver.step(old, t))
        if solver.equations.excess > 2 * TIE:
            raise SolveError(
                f"at t = {t:g} a column is beaten and switches to no other phase: see the law's `switched`"
            )
        yield old
        if t == end:
            return


def _bends_up(solver: Solver, start: float, end: float) -> bool:
    """Whether an excess with phases held is a convex function of time: it is positive at the end if it ever is. Collective.

    Where all is linear in time drives are, and an excess is the largest of their sizes; bodies that are not linear are
    taken to be near enough.
    """
    return start == end or solver.equations.linear_in_time(start, end)


def _probes(start: float, end: float) -> Iterator[float]:
    return (start + (end - start) * k / PROBES for k in range(1, PROBES))


def _first(excess: Callable[[float], float], start: float, end: float) -> float:
    """The time at which an excess, positive at the end, becomes so; it is positive there, however coarse times are."""
    if excess(start) > 0:
        return start
    width = ROUNDING * max(abs(start), abs(end))
    t = float(brentq(excess, start, end, xtol=width, rtol=ROUNDING))
    while t < end and excess(t) <= 0:
        t, width = min(t + width, end), 2 * width
    return t


def snapped(state: State) -> State:
    """The state after a snap; what its time scheme is left with is energy lost."""
    audit = state.audit
    return replace(state, audit=replace(audit, dissipated=audit.dissipated + audit.remainder, remainder=0.0))
