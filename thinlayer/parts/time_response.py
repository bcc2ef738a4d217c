"""The response of a compiled law in time, found by trials: instantaneous or not, linear or not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.kernels import Array

SIZES = tuple(10.0**k for k in range(-15, 7))  # sizes of the trial strains, or jumps in any unit
LENGTHS = (1.0, 1e12, 1e30)  # lengths of the trial steps, in any unit of time
LINEARITY_TOLERANCE = 1e-6  # relative difference of stiffness between strains of several sizes that counts as rounding
SAMPLE_FRACTIONS = (0.21, 0.5, 0.83)  # of a step, at which parameters are tried
SAME = 1e-12  # relative difference of parameters at several times that counts as rounding


def not_linear_at_once(points: CompiledTerm, times: Sequence[float]) -> tuple[str, bool] | None:
    """Name of a law with a non-linear instantaneous response, and whether varying parameters are the reason.

    None: there is no such law. Laws with rate and linear laws with constant parameters need no trial. Other laws are tried,
    unless they are sublayers: each law of a Stack must declare that it is linear and has memory. Collective.

    Args:
        points: the compiled term.
        times: times of the march.
    """
    laws = [law for _, law in points.term.law.sublayers]
    for law, changes in zip(laws, _change(points, times), strict=True):
        if law.traits.rate or (law.traits.linear and not changes):
            continue
        declared = law.traits.linear and law.traits.remembers
        if not (declared if len(laws) > 1 else takes_time(points) or (not changes and _is_linear(points))):
            return type(law).__name__, changes
    return None


def takes_time(points: CompiledTerm) -> bool:
    """Whether the response to a strain depends on the length of the step: the law creeps or relaxes. Collective."""
    differs = False
    for _, e in _strains(points):
        sudden, *slow = (points.respond(e, 0 * e, points.rest(), dt, 1.0) for dt in (0.0, *LENGTHS))
        for answer in slow:
            pairs = ((sudden.stress, answer.stress), (sudden.memory, answer.memory))
            differs = differs or not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return bool(points.comm.allreduce(int(differs)))


def _change(points: CompiledTerm, times: Sequence[float]) -> list[bool]:
    """For each sublayer, whether its parameters change in time; tested at `times` and between them. Collective."""
    change = [False] * len(points.term.law.sublayers)
    if not points.material.varies:
        return change
    sampled = [a + share * (b - a) for a, b in pairwise(times) for share in (*SAMPLE_FRACTIONS, 1.0)]
    points.at_time(times[0])
    first = points.material.of_sublayers
    for t in sampled:
        points.at_time(t)
        for k, (a, b) in enumerate(zip(first, points.material.of_sublayers, strict=True)):
            change[k] = change[k] or not np.allclose(a, b, rtol=SAME, atol=0.0)
    return [bool(found) for found in points.comm.allreduce(np.array(change, int))]


def _is_linear(points: CompiledTerm) -> bool:
    """Whether stresses are proportional to sudden strains, small and large. Collective."""
    stiffness = [points.respond(e, 0 * e, points.rest(), 0.0, 1.0).stress / size for size, e in _strains(points)]
    apart = np.abs(np.array(stiffness) - stiffness[0]).max(initial=0.0)
    good = bool(apart <= LINEARITY_TOLERANCE * np.abs(stiffness[0]).max(initial=0.0))  # False for NaN
    return not points.comm.allreduce(int(not good))


def _strains(points: CompiledTerm) -> Iterator[tuple[float, Array]]:
    """The sizes, each with trial strains of this size."""
    e = np.cos(np.arange(points.count * len(points.slots), dtype=float)).reshape(points.count, len(points.slots))
    return ((size, size * e) for size in SIZES)
