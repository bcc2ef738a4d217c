"""Tests of whether a model and its results lie in the range of its interface law; a RangeWarning says where not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from forms.tangent import in_plane_modulus
from thinlayer.discretisation.free_rim import why_alone
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import warn
from thinlayer.ranges.areas import Areas
from thinlayer.ranges.cavitation import warn_of_cavitation
from thinlayer.ranges.excess import LEAST_ERROR
from thinlayer.ranges.faces import Faces
from thinlayer.ranges.pressure import warn_of_coarse_ends, warn_of_free_ends, warn_of_pressure
from thinlayer.ranges.strains import warn_of_strains
from thinlayer.ranges.sublayers import Sublayer, acts_on_jumps, stiffness_of_jumps, sublayers_of

LEAST_OVERLAP = 2.0  # least closing, relative to the thickness, that leads to a warning; the bodies overlap from 1 on
CORNER_ANGLE = 0.25  # largest angle, in rad, between a facet and the mean of its neighbours that is not a corner of S


def warn_of_model(model: Model, lasting: Sequence[float] = ()) -> None:
    """Warn of an interface model that lies outside the range of its law, before it is solved. Collective.

    Args:
        model: the model.
        lasting: durations > 0 of the loads at the times of interest; () for sudden loads.
    """
    for one in _thin(model):
        sublayers = sublayers_of(one)
        _warn_of_facets(model, one)
        if not acts_on_jumps(sublayers):
            _warn_of_thickness(model, one)
            _warn_of_hard_layer(model, one, sublayers)
        if one.flows or _told_by_states(one, sublayers):
            continue
        at_once = [] if lasting and one.law.traits.rate else [sublayers]
        warn_of_free_ends(model, one, [*at_once, *(sublayers_of(one, dt) for dt in lasting)])
    for one in model.layers.values() if model.broken else ():
        if one.flows:
            warn_of_coarse_ends(model, one)
        if reason := why_alone(model, one):
            warn(f"{reason}: what it bears is left out; support the bodies too, or mesh the layer", model.comm)


def warn_of_states(states: Sequence[State], start: float | None = None) -> None:
    """Warn of results that lie outside the range of small strains or of interface laws, once for all. Collective.

    Args:
        states: of one model.
        start: time since which loads last; None if they are sudden at every state.
    """
    if not states:
        return
    model = states[0].model
    warn_of_strains(states)
    for one in model.layers.values() if model.broken else ():
        if one.flows:
            warn_of_cavitation(one, states)
    for one in _thin(model):
        found = [faces for faces in (Faces.of(state, one) for state in states) if faces]
        if not found:
            continue
        if not (model.linear or acts_on_jumps(sublayers_of(one))):
            _warn_of_overlap(one, max(found, key=lambda faces: faces.mean_closing))
        if one.flows or one.law.traits.phases:  # the strain of a phase brings about no pressure
            continue
        told = one.law.traits.linear and warn_of_pressure(model, one, found, start)
        if not told and _told_by_states(one, sublayers := sublayers_of(one)):
            warn_of_free_ends(model, one, [sublayers])


def _told_by_states(one: SeamLayer, sublayers: list[Sublayer]) -> bool:
    """Whether jumps say more of the pressure than free ends do, so that one warning is enough."""
    of_one = one.law.traits.linear and not one.remembers and len(sublayers) == 1
    return of_one and sublayers[0].length < math.inf


def _thin(model: Model) -> list[SeamLayer]:
    """The layers of an interface model whose laws are of strains, several times where parameters are functions."""
    return [sample for one in model.layers.values() if one.thin for sample in one.samples] if model.broken else []


def _warn_of_facets(model: Model, one: SeamLayer) -> None:
    """Warn if slip along straight facets of a curved S is resisted by the angles between the facets.

    A slip w opens the layer by w . (N - n), with the facet's normal n and the mean normal N of its neighbours at each
    vertex. This adds the normal stiffness times the mean of |N - n|^2 to the tangential one. Angles above CORNER_ANGLE
    are corners of S.
    """
    sheet, joint = one.sheet, model.joint
    if joint.degree > 1 or joint.planar:
        return
    used, number = np.unique(sheet.vertices, return_inverse=True)
    number = number.reshape(sheet.vertices.shape)
    sums = np.zeros((len(used), joint.dim))
    np.add.at(sums, number, sheet.normals * sheet.areas[:, None, None])
    tilt = sums[number] / np.linalg.norm(sums[number], axis=2, keepdims=True) - sheet.normals
    tilt[np.linalg.norm(tilt, axis=2) > CORNER_ANGLE] = 0.0
    areas = Areas(sheet, model.kinematics)
    angle = math.sqrt(float(np.einsum("nij,nik,njk->", areas.mass, tilt, tilt)) / areas.total)
    normal, tangential = stiffness_of_jumps(one)
    if normal * angle**2 > LEAST_ERROR * tangential:
        effect = (
            f"is about {1 + normal * angle**2 / tangential:.3g} times too stiff against it,"
            if tangential
            else "resists"
        )
        warn(
            f"S is curved and its facets are straight, {math.degrees(angle):.2g} degrees off its normal on average: a slip "
            f"along S opens the layer there, which {effect} by the mesh alone; use curved cells (degree 2), or a finer "
            "mesh",
            model.comm,
        )


def _warn_of_thickness(model: Model, one: SeamLayer) -> None:
    """Warn if the layer is thicker than a body.

    The law is the start of a series in eps over the length on which the bodies' stresses vary.
    """
    height, layer = min(one.sheet.heights), one.thin
    if layer and layer.eps > height:
        warn(
            f"{one} is {layer.eps:.4g} thick, the thinner body {height:.4g} high: the interface law is for thicknesses "
            "well below that of the bodies; mesh the layer (structure.full), or check eps",
            model.comm,
        )


def _warn_of_hard_layer(model: Model, one: SeamLayer, sublayers: list[Sublayer]) -> None:
    """Warn if the layer is harder than a body.

    Order 0 leaves eps grad_S <u>, about eps t/E_body, out of a jump of about eps t/E_layer.
    """
    layer, n, bodies = one.thin, one.at_rest.n, model.structure.bodies_at_rest
    if layer is None or layer.order == 1 or not sublayers or any(C is None for C in bodies):
        return
    softest = min(in_plane_modulus(C, n) for C in bodies if C is not None)
    hardest = max(one.along for one in sublayers)
    if hardest > softest > 0:
        warn(
            f"{one} is {hardest / softest:.3g} times as hard as the softer body (moduli in the plane of S): its jump is "
            "less than what order 0 leaves out; use order=1, mesh the layer (structure.full), or check its parameters",
            model.comm,
        )


def _warn_of_overlap(one: SeamLayer, faces: Faces) -> None:
    """Warn if the bodies overlap by more than the thickness on average, which laws of small strains do not prevent.

    The mean over S is tested, because at single places, such as ends, jumps are large in any case. The limit is not zero,
    because as the thickness tends to zero under the same load, jumps stay and exceed it in the end. Linear models are not
    tested: their results are proportional to loads of any size.
    """
    closing, state = faces.closing, faces.state
    if faces.mean_closing > LEAST_OVERLAP:
        worst = np.unravel_index(closing.argmax(), closing.shape)
        x = ", ".join(f"{c:.4g}" for c in state.model.joint.points[faces.sheet.vertices[worst]])
        warn(
            f"at t = {state.t:.4g} {one} closes by {faces.mean_closing:.3g} times its thickness, on average over S "
            f"(most near ({x}), by {closing[worst]:.3g} times): the bodies overlap, and the law is for small strains; "
            "check loads, thickness and the law's parameters",
            state.model.comm,
        )
