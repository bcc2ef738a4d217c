"""What laws ask of steps in time: where they must end, and where in them forces may balance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from forms.series import parts
from thinlayer.equations import Equations
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.pointwise.kernels import Array
from thinlayer.pointwise.points import LawPoints

SIZES = tuple(10.0**k for k in range(-15, 7))  # of strains, and of jumps in any unit, that laws are asked about
LENGTHS = (1.0, 1e12, 1e30)  # of steps, in any unit
STRAIGHT = 1e-6  # relative
ENDS = "theta = 1"


def remembers(model: Model) -> bool:
    """Whether the layer's law depends on what was before, so that a peak of the loads between two times matters."""
    if model.layer is None or model.kind == "bonded":
        return False
    laws: tuple[Any, ...] = parts(model.layer.law)  # the memory of a `PointLaw` and of a contact law is their own
    return any(law.rate or law.internal or getattr(law, "memory", False) for law in laws)


def require_ends(model: Model, theta: float) -> None:
    """Raise ModelError where theta < 1 and the state within a step says nothing of its ends, by what laws declare."""
    if theta == 1:
        return
    if model.contact:
        raise ModelError(f"theta is {theta}; contact laws hold at the ends of steps: {ENDS}")
    for body, law in model.body_laws.items():
        if not law.linear:
            raise ModelError(f"theta is {theta}; {_swings(law)} (body {body!r})")
    for law in (one for p in model.layer_points for one in parts(p.law)):
        name = type(law).__name__
        if law.switches:
            raise ModelError(f"theta is {theta}; {name} holds at the ends of steps: {ENDS}")
        if law.yields:
            raise ModelError(
                f"theta is {theta}; {name} bounds stresses, and a stress that keeps its bound within a step may have "
                f"left it at the end, beyond what the layer bears: {ENDS}"
            )
        if not (law.linear or law.rate or law.pointwise):
            raise ModelError(f"theta is {theta}; {_swings(law)}")


def require_time_scale(equations: Equations, theta: float) -> None:
    """The same by asking laws that are not linear and have no rate: their answer must take time, or be linear. Collective.

    In a Stack each law must say so itself.
    """
    if theta == 1:
        return
    for p in equations.laws.points:
        laws = parts(p.points.law)
        unsure = [law for law in laws if not (law.linear or law.rate)]
        if unsure and (len(laws) > 1 or not (_straight(p) or takes_time(p))):
            raise ModelError(f"theta is {theta}; {_swings(unsure[0])}")


def _swings(law: Any) -> str:
    return (
        f"{type(law).__name__} answers at once, and not linearly: with an equilibrium within a step its ends swing about "
        f"the path, and nothing damps them: {ENDS}"
    )


def _straight(points: LawPoints) -> bool:
    """Whether stresses are proportional to sudden strains, small and large. Collective."""
    stiffness = [points.respond(e, 0 * e, points.rest(), 0.0, 1.0).stress / size for size, e in _strains(points)]
    apart = np.abs(np.array(stiffness) - stiffness[0]).max(initial=0.0)
    good = bool(apart <= STRAIGHT * np.abs(stiffness[0]).max(initial=0.0))  # False for NaN
    return not points.domain.comm.allreduce(int(not good))


def takes_time(points: LawPoints) -> bool:
    """Whether the answer to some strain depends on how long a step takes: the law creeps or relaxes. Collective."""
    differs = False
    for _, e in _strains(points):
        sudden, *slow = (points.respond(e, 0 * e, points.rest(), dt, 1.0) for dt in (0.0, *LENGTHS))
        for answer in slow:
            pairs = ((sudden.stress, answer.stress), (sudden.memory, answer.memory))
            differs = differs or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return bool(points.domain.comm.allreduce(int(differs)))


def _strains(points: LawPoints) -> Iterator[tuple[float, Array]]:
    """Strains of all sizes, and the sizes."""
    e = np.cos(np.arange(points.count * len(points.slots), dtype=float)).reshape(points.count, len(points.slots))
    return ((size, size * e) for size in SIZES)
