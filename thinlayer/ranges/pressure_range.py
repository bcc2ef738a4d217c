"""The pressure of nearly incompressible layers, which falls to zero at free ends: interface laws leave this out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.ranges.excess import LEAST_ERROR, Faces, pressure_excess
from thinlayer.ranges.sublayers import Sublayer, sublayers_of
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

Remark = tuple[str, str]  # key of a RangeWarning, and its message
SHEAR_MATRIX = np.array([[7.0, -8.0, 1.0], [-8.0, 16.0, -8.0], [1.0, -8.0, 7.0]])  # int u' v' times 3 h, degree 2
STRETCH_MATRIX = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]])  # int u v times 30/h, degree 2
LONG_PRESSURE = 1.0  # (nu = 6/13) of a shorter length, relative to eps, sheared layers feel no more than near peaks
LATE_OPENING = 0.5  # least opening of the last state that is tested, relative to the largest one


def beyond_free_ends(model: Model, one: SeamLayer, layers: Sequence[list[Sublayer]]) -> Iterator[Remark]:
    """Where the pressure of a nearly incompressible layer falls to zero at free ends over a long length delta, in words.

    Interface laws do not contain this effect. Between rigid faces a strip of half-width l carries only the share
    1 - tanh(l/delta) delta/l of the load that the law gives; the largest factor is named.

    Args:
        model: the interface model.
        one: the layer.
        layers: the sublayers at several times.
    """
    layers, rim = [s for s in layers if any(k.nearly for k in s)], model.reductions[one.name].neglected
    if not layers or not len(rim.vertices):
        return
    if any(k.length == math.inf for sublayers in layers for k in sublayers):
        yield (
            "incompressible",
            f"{one} is incompressible and S has free ends: its law holds the normal jump [u_N] at zero, as if these ends "
            "were held; a layer with free ends is squeezed out; use order=1, mesh the layer (structure.full), or support "
            "its sides if they are held",
        )
        return
    assert one.thin
    surface, eps = surface_of(model, one.name), one.thin.eps
    width = surface.integral(1.0) / surface.length(rim)
    lengths = [pressure_length(sublayers, width / eps) for sublayers in layers]
    worst = max(layers[lengths.index(max(lengths))], key=lambda k: k.length)
    delta = eps * max(lengths)
    y = delta / width
    lost = 1 / (1 - math.tanh(1 / y) * y) - 1
    if lost > 1 / (1 - LEAST_ERROR) - 1:
        yield (
            "free ends",
            f"{one} is nearly incompressible{worst.when}: its pressure falls to zero at the free ends of S over delta "
            f"= {delta:.3g}, {y:.2g} of the area of S over the length of its free ends ({width:.3g}); between rigid bodies "
            f"its law would be about {1 + lost:.3g} times too stiff against normal jumps; {_remedy(one)}, or support its "
            "sides if they are held",
        )


def pressure_length(sublayers: list[Sublayer], width: float) -> float:
    """Length delta over which the pressure falls to zero at a free end of S, relative to the thickness of the layer.

    All sublayers have one normal traction t. The layer opens by w = c t - B t'': c is the sum of their compliances, and
    B t'' is the flow along S that a slope of t drives in nearly incompressible sublayers. The flow shears the other
    sublayers. It also stretches them, as strains along S grow in proportion to the distance. delta^2 = B/c; for one
    sublayer delta is its `length`. B is the minimum of a quadratic form of displacements along S, of degree 2 through
    each sublayer.

    Args:
        sublayers: from below.
        width: length of the flow along S, relative to the thickness of the layer.
    """
    count = 2 * len(sublayers) + 1
    A, b = np.zeros((count, count)), np.zeros(count)
    for k, one in enumerate(sublayers):
        at = slice(2 * k, 2 * k + 3)
        A[at, at] += one.mu / (3 * one.fraction) * SHEAR_MATRIX
        if one.nearly:
            b[at] += math.sqrt(one.lmbda / (one.lmbda + 2 * one.mu)) * one.fraction / 6 * np.array([1.0, 4.0, 1.0])
        else:
            A[at, at] += 3 / width**2 * max(one.along, 0.0) * one.fraction / 30 * STRETCH_MATRIX
    inside = slice(1, -1)  # the bodies do not move
    flow = float(b[inside] @ np.linalg.solve(A[inside, inside], b[inside]))
    return math.sqrt(flow / sum(one.compliance for one in sublayers))


def too_stiff(one: SeamLayer, surface: SurfaceMesh, states: Sequence[State], start: float | None) -> Iterator[Remark]:
    """How many times a law is too stiff for the openings found, against a layer whose pressure evens out along S, in words.

    Two states are tested: the one with the largest opening and the last one with at least half of it, as laws that creep
    or relax become nearly incompressible with time.
    """
    openings = [float(np.abs(Faces(surface, state, one).opening).max()) for state in states]
    last = max(k for k, opening in enumerate(openings) if opening >= LATE_OPENING * max(openings))
    told = []
    for state in (states[k] for k in sorted({openings.index(max(openings)), last})):
        sublayers = sublayers_of(one, 0.0 if start is None else state.t - start)
        if len(sublayers) == 1 and sublayers[0].nearly and sublayers[0].length < math.inf:
            excess = pressure_excess(Faces(surface, state, one), sublayers[0])
            hidden = excess.hidden and sublayers[0].length > LONG_PRESSURE
            told.append((excess.opening if hidden else excess.work, sublayers[0]))
    worst, layer = max(told, key=lambda pair: pair[0], default=(0.0, None))
    if layer and worst > LEAST_ERROR:
        yield (
            "too stiff",
            f"{one} is nearly incompressible{layer.when} (lmbda/mu = {layer.lmbda / layer.mu:.4g}): with the jumps found, "
            f"the layer alone is {1 + worst:.3g} times too stiff, as its interface law lets no material flow along S; the "
            f"structure is off by less where the bodies are soft; {_remedy(one)}",
        )


def _remedy(one: SeamLayer) -> str:
    if one.remembers or len(one.law.sublayers) > 1:
        return "mesh the layer (structure.full; forms.Rubber has no memory, and is no sublayer)"
    return "use forms.Rubber with order=1, or mesh the layer (structure.full)"
