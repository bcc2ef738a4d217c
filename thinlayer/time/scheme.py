"""What laws ask of steps in time: where they must end, and where in them forces may balance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from thinlayer.discretisation.model import Model
from thinlayer.errors import ModelError
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.kernels import Array
from thinlayer.solving.equations import BETWEEN, Equations

SIZES = tuple(10.0**k for k in range(-15, 7))  # of strains, and of jumps in any unit, that laws are asked about
LENGTHS = (1.0, 1e12, 1e30)  # of steps, in any unit
STRAIGHT = 1e-6  # relative
SAME = 1e-12  # relative, of parameters at several times
ENDS = "theta = 1"


def remembers(model: Model) -> bool:
    """Whether the layer's law depends on what was before, so that a peak of the loads between two times matters."""
    if model.layer is None or model.kind == "bonded":
        return False
    return model.layer.law.traits.rate or model.layer.law.traits.remembers


def require_ends(model: Model, theta: float) -> None:
    """Raise ModelError where theta < 1 and the state within a step says nothing of its ends, by what laws declare."""
    if theta == 1:
        return
    if model.contact:
        raise ModelError(f"theta is {theta}; contact laws hold at the ends of steps: {ENDS}")
    for body, law in model.body_laws.items():
        if not law.traits.linear:
            raise ModelError(f"theta is {theta}; {_swings(law)} (body {body!r})")
    for law in (one for p in model.layer_terms for _, one in p.law.sublayers):
        name = type(law).__name__
        if law.traits.switches:
            raise ModelError(f"theta is {theta}; {name} holds at the ends of steps: {ENDS}")
        if law.traits.bounded:
            raise ModelError(
                f"theta is {theta}; {name} bounds stresses, and a stress that keeps its bound within a step may have "
                f"left it at the end, beyond what the layer bears: {ENDS}"
            )
        if not (law.traits.linear or law.traits.rate or law.traits.compiled):
            raise ModelError(f"theta is {theta}; {_swings(law)}")


def require_time_scale(equations: Equations, theta: float, times: Sequence[float]) -> None:
    """The same by asking laws without rate that are not linear, or not the same at all times: their answer must take time.

    Or be linear, and always the same. In a Stack each law must say so itself. Collective.

    Args:
        equations: of the model.
        theta: of the march.
        times: its start, and those that steps end at.
    """
    if theta == 1:
        return
    for p in equations.laws.points:
        laws = [law for _, law in p.term.law.sublayers]
        for law, changes in zip(laws, _change(p, times), strict=True):
            if law.traits.rate or (law.traits.linear and not changes):
                continue
            one_of_several = len(laws) > 1
            sure = (
                law.traits.linear and law.traits.remembers
                if one_of_several
                else takes_time(p) or (not changes and _straight(p))
            )
            if not sure:
                how = "with parameters that change in time" if changes else "not linearly"
                raise ModelError(f"theta is {theta}; {_swings(law, how)}")


def _swings(law: Any, how: str = "not linearly") -> str:
    return (
        f"{type(law).__name__} answers at once, and {how}: with an equilibrium within a step its ends swing about "
        f"the path, and nothing damps them: {ENDS}"
    )


def _change(points: CompiledTerm, times: Sequence[float]) -> list[bool]:
    """Of each sublayer, whether its parameters change in time. Seen at times and at a few between them. Collective."""
    change = [False] * len(points.term.law.sublayers)
    if not points.material.varies:
        return change
    seen = [a + share * (b - a) for a, b in pairwise(times) for share in (*BETWEEN, 1.0)]
    points.at_time(times[0])
    first = points.material.of_sublayers
    for t in seen:
        points.at_time(t)
        for k, (a, b) in enumerate(zip(first, points.material.of_sublayers, strict=True)):
            change[k] = change[k] or not np.allclose(a, b, rtol=SAME, atol=0.0)
    return [bool(found) for found in points.comm.allreduce(np.array(change, int))]


def _straight(points: CompiledTerm) -> bool:
    """Whether stresses are proportional to sudden strains, small and large. Collective."""
    stiffness = [points.respond(e, 0 * e, points.rest(), 0.0, 1.0).stress / size for size, e in _strains(points)]
    apart = np.abs(np.array(stiffness) - stiffness[0]).max(initial=0.0)
    good = bool(apart <= STRAIGHT * np.abs(stiffness[0]).max(initial=0.0))  # False for NaN
    return not points.comm.allreduce(int(not good))


def takes_time(points: CompiledTerm) -> bool:
    """Whether the answer to some strain depends on how long a step takes: the law creeps or relaxes. Collective."""
    differs = False
    for _, e in _strains(points):
        sudden, *slow = (points.respond(e, 0 * e, points.rest(), dt, 1.0) for dt in (0.0, *LENGTHS))
        for answer in slow:
            pairs = ((sudden.stress, answer.stress), (sudden.memory, answer.memory))
            differs = differs or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return bool(points.comm.allreduce(int(differs)))


def _strains(points: CompiledTerm) -> Iterator[tuple[float, Array]]:
    """Strains of all sizes, and the sizes."""
    e = np.cos(np.arange(points.count * len(points.slots), dtype=float)).reshape(points.count, len(points.slots))
    return ((size, size * e) for size in SIZES)
