"""What layers do on each facet of S in a state: status and phase."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from forms.law import Law
from geometry.topology import IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.contact_fields import CONTACT_STATUSES, at_contact
from thinlayer.output.law_points import LawPoints
from thinlayer.output.surface_mesh import SurfaceMesh
from thinlayer.output.tractions import in_rule, points_on
from thinlayer.parts.phases import phase_slots

Array = npt.NDArray[np.float64]
NO_LAYER, ELASTIC, OPEN, SLIDING, CRUSHED, TORN = "no layer", "elastic", "open", "sliding", "crushed", "torn"
YIELDS = (ELASTIC, SLIDING, CRUSHED, TORN, OPEN)
STATUSES = tuple(dict.fromkeys((*YIELDS, NO_LAYER, *CONTACT_STATUSES)))
ROUNDING = 1e-6  # traction or plastic strain, over the largest traction or strain of a layer, that counts as none


def statuses(model: Model, seam: str) -> tuple[str, ...]:
    """The statuses that facets of a seam may have."""
    if seam in model.contacts:
        return CONTACT_STATUSES
    if seam not in model.layers:
        return (NO_LAYER,)
    return YIELDS if _has_plastic_strain(model.layers[seam].law) else (ELASTIC,)


def _has_plastic_strain(law: Law) -> bool:
    return any(one.internal.get("plastic") == (3, 3) for _, one in law.sublayers)


def status(surface: SurfaceMesh, state: State) -> npt.NDArray[np.str_]:
    """(n, 1) see `Surface.status`. Collective; raises ModelError."""
    model = state.model
    if not isinstance(model, InterfaceModel):
        raise ModelError(f"a status is known of states of interface models, not of {model!r}")
    areas = {name: np.zeros(len(surface.rows)) for name in STATUSES}
    for name in model.joint.seams:
        if len(possible := statuses(model, name)) == 1:
            areas[possible[0]][surface.seams == name] = 1.0
    for points, rows in points_on(surface, state):
        if points.term.n is not None and _has_plastic_strain(points.term.law):
            found, weights = _at_points(surface, points, rows), surface.rule(points.quadrature.degree).weights
            for name in YIELDS:
                np.add.at(areas[name], rows[rows >= 0], (weights[rows[rows >= 0]] * (found == name)).sum(axis=1))
    if of_contact := at_contact(surface, state):
        at_corners = of_contact["status"][surface.nodes]
        for name in CONTACT_STATUSES:
            areas[name] += ((surface.weights @ surface.shapes) * (at_corners == name)).sum(axis=1)
    total = model.comm.allreduce(np.array([*areas.values()]))
    return np.array(STATUSES)[total.argmax(axis=0)][:, None]


def _at_points(surface: SurfaceMesh, points: LawPoints, rows: IntArray) -> npt.NDArray[np.str_]:
    """(facets, q) statuses at the points of a layer's law, on the facets `rows` that are not -1. Collective."""
    model, q, sublayers = points.state.model, points.quadrature, points.term.law.sublayers
    (layer,) = (one for one in model.layers.values() if one.key == points.term.key)
    assert layer.thin
    rule = surface.rule(q.degree)
    lower, upper = surface.sides(points.state.u, model, rule.points)[:, :, surface.seams == layer.name]
    opening = np.zeros(rule.weights.shape)
    opening[surface.seams == layer.name] = ((upper - lower) * rule.n[:, surface.seams == layer.name]).sum(axis=0)
    strain = float(np.abs(upper - lower).max(initial=0.0)) / float(layer.thin.eps)
    plastic = np.zeros((q.count, 3, 3))
    for (fraction, _), values in zip(sublayers, points.internal(), strict=True):
        plastic += fraction * values.get("plastic", 0.0)
    t, flow = (np.einsum("pij,pj->pi", tensor, q.n) for tensor in (points.stress(), plastic))
    t_N, closed = ((vector * q.n).sum(axis=1) for vector in (t, -flow))
    slip = 2 * np.linalg.norm(flow + closed[:, None] * q.n, axis=1)
    largest = model.comm.allreduce(float(np.abs(t).max(initial=0.0)), max)
    order = in_rule(rule, rows, points)
    slip, closed, t_N = slip[order], closed[order], t_N[order]
    free = (opening[rows[rows >= 0]] > 0) & (np.abs(t_N) <= ROUNDING * largest)
    still = np.maximum(slip, np.abs(closed)) <= ROUNDING * strain
    kinds = {OPEN: free, ELASTIC: still, SLIDING: slip >= np.abs(closed), CRUSHED: closed > 0}
    return np.select([*kinds.values()], [*kinds], TORN)


def phase(surface: SurfaceMesh, state: State) -> Array:
    """(n, 1) see `Surface.phase`. Collective."""
    sums = np.zeros((2, len(surface.rows)))
    for points, rows in points_on(surface, state):
        slots = phase_slots(points.term.law)
        memory = points.state.memory[points.key] if slots else np.empty(0)
        cells = points.quadrature.cells[rows >= 0]
        for fraction, k in slots:
            weights = fraction * points.quadrature.weights[cells]
            for total, values in zip(sums, (weights * memory[:, k][cells], weights), strict=True):
                np.add.at(total, rows[rows >= 0], values.sum(axis=1))
    part, whole = state.model.comm.allreduce(sums)
    return np.where(whole > 0, part / np.where(whole > 0, whole, 1.0), np.nan)[:, None]
