"""Steps of a layer whose columns switch their phases: cut where the first one does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from scipy.optimize import brentq

from forms.non_monotone import TIE
from thinlayer.solvers import Solver
from thinlayer.state import State

ROUNDING = 8 * 2.0**-52


def steps(solver: Solver, old: State, end: float) -> Iterator[State]:
    """States on the way from a state to a time: at every snap the one just before it, and the one after it, then the end.

    A snap has no duration: both its states have the same t. What the layer and the bodies lose in it is `dissipated`.
    Switches are looked for at the end of a way: there is one more for each turn of piecewise loads, and loads and
    temperatures that are functions of time should change in one direction within a step. Collective; errors as in `solve`.
    """
    turns = sorted(t for t in solver.model.break_times if old.t < t < end)
    for stop in (*turns, end):
        for state in _one_way(solver, old, stop):
            yield state
            old = state


def _one_way(solver: Solver, old: State, end: float) -> Iterator[State]:
    def excess(t: float) -> float:
        solver.step(old, t, held=True)
        return solver.equations.excess - 2 * TIE

    while True:
        held = solver.step(old, end, held=True)
        if solver.equations.excess <= TIE:
            yield held
            return
        t = brentq(excess, old.t, end, xtol=ROUNDING * max(abs(old.t), abs(end)), rtol=ROUNDING)
        if t > old.t:
            old = solver.step(old, t, held=True)
            yield old
        old = snapped(solver.step(old, t))
        yield old
        if t == end:
            return


def snapped(state: State) -> State:
    """The state after a snap; what its time scheme is left with is energy lost."""
    audit = state.audit
    return replace(state, audit=replace(audit, dissipated=audit.dissipated + audit.remainder, remainder=0.0))
