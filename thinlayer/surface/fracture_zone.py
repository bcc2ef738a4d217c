"""Check that a layer which breaks has facets small enough for the zone in which it softens ahead of a crack."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.sparse

from forms.base import Array
from forms.breaking import BREAKING, BROKEN
from geometry.refusals import place_text
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.surface.law_points import layer_points, share_columns
from thinlayer.surface.pressure_excess import Remark
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

MIN_ZONE = 1 / 3  # length, over that of a facet, below which a fracture zone cannot be measured
FACETS_IN_ZONE = 4  # number of facets in a fracture zone that the warning advises


def short_zone_remark(states: Sequence[State], layer: SeamLayer) -> Iterator[Remark]:
    """Yield a warning (key, text) if a crack has advanced over facets with less than two of them in its fracture zone.

    Then a facet that has broken since the first state has sound points, or has a neighbour with sound points. The path
    has kinks and turns of single facets, and the toughness is not resolved. Collective.

    Args:
        states: states of one model, in the order of a march.
        layer: a layer of the model.
    """
    if len(states) < 2 or not {BROKEN, BREAKING} <= {*share_columns(layer.law)}:
        return
    surface = surface_of(states[0].model, layer.name)
    dim = surface.joint.dim
    corner_of = np.ones(surface.nodes.size), (np.repeat(np.arange(len(surface.nodes)), surface.nodes.shape[1]),
        surface.nodes.ravel())  # fmt: skip
    of_nodes = scipy.sparse.csr_matrix(corner_of)
    neighbours = ((of_nodes @ of_nodes.T) >= dim - 1).astype(float)
    was_broken = _facet_shares(surface, states[0])[0] > 0
    for state in states[1:]:
        broken, breaking, sound = _facet_shares(surface, state)
        is_bad = (broken > 0) & ~was_broken & (neighbours @ sound > 0)
        if not is_bad.any():
            continue
        facet = int(is_bad.argmax())
        corners = surface.joint.points[surface.corners[facet]]
        h = float(np.linalg.norm(corners[1:] - corners[0], axis=1).min())
        others = np.setdiff1d(neighbours[[facet]].indices, [facet])
        zone = h * max(MIN_ZONE, float(breaking[facet] + breaking[others].max(initial=0.0)))
        x = place_text(corners.mean(axis=0))
        text = (
            f"at t = {state.t:.4g} the fracture zone of {layer} is about {zone:.2g} long, near {x}, and facets {h:.3g}"
        )
        remedy = f"take facets of {zone / FACETS_IN_ZONE:.2g}, or less strength, with which the zone is longer"
        yield "fracture zone", f"{text}: fewer than two in the zone do not resolve the toughness; {remedy}"
        return


def _facet_shares(surface: SurfaceMesh, state: State) -> Array:
    """Return the shares (3, n) of each facet that are broken, are breaking and are sound. Collective."""
    sums = np.zeros((3, len(surface.rows)))
    for points, facets in layer_points(surface, state):
        cells, facets_here = points.quadrature.cells[facets >= 0], facets[facets >= 0]
        for (_, law), internal in zip(points.term.law.sublayers, points.internal(), strict=True):
            if BROKEN in law.share_columns:
                shares = law.shares(internal)
                for row, values in zip(sums, (shares[BROKEN], shares[BREAKING], 1.0 - shares[BROKEN] - shares[BREAKING]),
                                       strict=True):  # fmt: skip
                    np.add.at(row, facets_here, values[cells].mean(axis=1))
    shares = np.asarray(state.model.comm.allreduce(sums))
    return shares / np.maximum(shares.sum(axis=0), 1.0)
