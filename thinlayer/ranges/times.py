"""Hints where the times of a law that creeps or relaxes are not those of a march, or a solve knows no time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from thinlayer.discretisation.model import Model
from thinlayer.errors import warn

ALLOWED = 0.05  # error of the steps over one own time, in shares of what creeps or relaxes


def warn_of_steps(model: Model, start: float, times: Sequence[float], theta: float) -> None:
    """Warn if planned steps are not well below the times of a law, before they are made. Collective.

    Steps count that begin within this time of the start or of a break of the data: later ones follow what is slow.
    """
    begun = [start, *(t for t in model.break_times if t > start)]
    worst = max(
        (
            (_error((b - a) / own, theta), b - a, a, own, name)
            for name, own in _own_times(model)
            for a, b in pairwise([start, *times])
            if any(0 <= a - t < own for t in begun)
        ),
        default=None,
    )
    if worst and worst[0] > ALLOWED:
        error, step, t, own, name = worst
        warn(
            "time step",
            f"the step of {step:.3g} at t = {t:.3g} is not well below a time of {name}, {own:.3g}: such steps leave an "
            f"error of about {error:.0%} of what creeps or relaxes; take steps below {own / 4:.2g} while this lasts, or "
            "times=Adaptive(end=..., first=..., tolerance=...)",
            model.comm,
        )


def warn_of_no_time(model: Model) -> None:
    """Warn that a solve gives what a law that relaxes answers at once. Collective."""
    for name, own in _own_times(model)[:1]:
        warn(
            "no time",
            f"{name} relaxes with the time {own:.3g}, and a solve knows no time: this is the answer to sudden loads "
            "just after they have come; for a later one march(model, times), or give times",
            model.comm,
        )


def _own_times(model: Model) -> list[tuple[str, float]]:
    """Names of laws with a time each, where parameters are numbers."""
    laws = [*model.body_laws.values(), *(law for one in model.layers.values() for _, law in one.law.sublayers)]
    return [(type(law).__name__, float(own)) for law in laws if not law.fields for own in law.own_times]


def _error(x: float, theta: float) -> float:
    """Error of exp(-t/tau) after about tau in steps x tau of the scheme."""
    n = max(1, round(1 / x))
    return abs(((1 - (1 - theta) * x) / (1 + theta * x)) ** n - math.exp(-n * x))
