"""Tests whether a model and its results are in the range of its interface law; a RangeWarning says if not."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.base import Array
from forms.breaking import BREAKING, BROKEN
from forms.law_tangents import in_plane_modulus
from forms.parameter_fields import ParameterField, as_parameter_field
from forms.tensors import average_lame
from geometry.parallel import on_root
from geometry.refusals import place_text
from thinlayer.discretisation.applicability import Applicability
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.solving.flux_ranges import warn_of_fluxes, warn_of_insulated_sides, warn_of_negative_conductivities
from thinlayer.surface.law_points import layer_points, share_columns
from thinlayer.surface.pressure_excess import (
    STIFFNESS_ERROR_LIMIT,
    SUPPORT_HINT,
    FaceDisplacements,
    Remark,
    SublayerModuli,
    acts_as_springs,
    jump_stiffness,
    order_0_remark,
    stiffness_remark,
    sublayer_moduli,
)
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

MIN_ZONE = 1 / 3  # length, over that of a facet, below which a fracture zone cannot be measured
FACETS_IN_ZONE = 4  # number of facets in a fracture zone that the warning advises

LOCKING_NU = 0.45  # Poisson's ratio above which a warning says that elements of degree 1 lock
OVERLAP_CLOSING = 2.0  # least closing, relative to the thickness, that leads to a warning; the bodies overlap from 1 on
CORNER_ANGLE = 0.25  # angle, in rad, between a facet and the mean of its neighbours above which S has a corner
MAX_SMALL_STRAIN = 0.1  # largest root mean square strain of a body that counts as small
MAX_STEP_ERROR = 0.05  # largest error of steps over one time constant of a law, relative to the creep or relaxation
MIN_SPRING_LOAD_FRACTION = 0.05  # share of the load in parallel springs above which they change results visibly
PLATE_SLENDERNESS = 10.0  # length of S over the height of both bodies above which these are plates that may bend
THICKNESS_TOLERANCE = 1e-6  # relative difference of two thicknesses that counts as rounding
MIN_STEP_TO_TIME_CONSTANT = 1e-9  # step over a time constant of a law below which its error is lost in rounding
# mean stress over the shear modulus at which small holes in rubber grow (Gent and Lindley 1959)
CAVITATION_STRESS_RATIO = 2.5


def warn_of_model(model: Model) -> None:
    """Warn once, before a solve, if elements lock or an interface law is outside its range. Collective.

    Elements lock if they are far too stiff, as linear ones are for nearly incompressible bodies.

    Args:
        model: the model.
    """
    setup = model.structure
    if model.n_components == 1:
        warn_of_insulated_sides(model)
    for law, C in zip(setup.body_laws_at_extremes, setup.extreme_body_tangents, strict=True):
        lmbda, mu = average_lame(C) if C is not None and model.n_components > 1 else (0.0, 1.0)
        nu = lmbda / (2 * (lmbda + mu))
        if model.n_components > 1 and setup.degree == 1 and nu > LOCKING_NU and model.volume_strain_degree(law) is None:
            needs_hexahedra = model.contact is not None and setup.joint.cell_type == "tetrahedron"
            remedy = "hexahedra with element='Q2'" if needs_hexahedra else f"element='{setup.element[0]}2'"
            text = f"a body of {type(law).__name__} has Poisson's ratio {nu:.4g}, and {setup.element} locks near 0.5"
            why = "a block of 10 by 5 cells is 4 % too stiff at 0.45, 18 % at 0.49, and three times at 0.4995"
            model.warn("locking", f"{text}: {why}; use {remedy}", law)
    for layer in model.layers.values():
        for key, remark in _bond_line_remarks(model, layer):
            model.warn(key, remark, layer.name)
    for layer in _strain_layers(model):
        for key, remark in _model_remarks(model, layer):
            model.warn(key, remark, layer.name)
    for name, applicability in model.applicability.items() if model.broken else ():
        if applicability.layer.has_pressure_flow and (coarse := applicability.coarse_mask).any():
            delta, rim_depth = applicability.decay_lengths[coarse].min(), applicability.loose_rim[coarse].depth.max()
            text = f"the pressure of {applicability.layer} falls to zero at free ends over delta = {delta:.3g}"
            effect = f"cells there are up to {rim_depth:.3g} long, and it is not set to zero; make them shorter"
            model.warn("coarse ends", f"{text}: {effect}", name)
        if violation := applicability.why_not("sides"):
            model.warn(violation.key, f"{violation.reason}: what it bears is left out; {violation.remedy}", name)
        if violation := applicability.why_not("sublayers"):
            model.warn(violation.key, f"{violation.reason}; {violation.remedy}", name)


def _bond_line_remarks(model: Model, layer: SeamLayer) -> Iterator[Remark]:
    """Yield a warning (key, text) if a law has the toughness of a bond line of another thickness than the layer's."""
    if not (thin := layer.thin_layer):
        return
    joint = model.structure.joint
    vertices = np.unique(joint.table.vertices[joint.rows_of(layer.name)])
    thickness = float(thin.at or thin.eps) * joint.relative_thickness(thin.profile, layer.name)[vertices]
    for fraction, law in thin.law.sublayers:
        bond_line = as_parameter_field(getattr(law, "bond_line", 0.0))
        tested = bond_line(joint.points[vertices].T) if isinstance(bond_line, ParameterField) else bond_line
        if not np.any(tested):
            continue
        ratio = fraction * thickness / tested
        k = int(abs(np.log(ratio)).argmax())
        if abs(ratio[k] - 1) > THICKNESS_TOLERANCE:
            eps, bond_line = fraction * thickness[k], float(np.broadcast_to(tested, ratio.shape)[k])
            place = "" if np.ptp(ratio) <= THICKNESS_TOLERANCE else f" at {place_text(joint.points[vertices[k]])}"
            text = f"the toughness of {layer} is that of a bond line of {bond_line:.4g}, and its thickness {eps:.4g}{place}"
            effect = f"per area it is {ratio[k]:.3g} times that of the tests"
            remedy = "bond_line=, the thickness as a function of places"
            if not place:
                remedy = f"bond_line={eps:.4g}, or ThinLayer(..., at={bond_line:.4g})"
            yield "bond line", f"{text}: {effect}; give {remedy}"


def _model_remarks(model: Model, layer: SeamLayer) -> Iterator[Remark]:
    """Yield warnings about a layer that follow from the model alone, as pairs (key that identifies the warning, text).

    Args:
        model: the model, which need not be solved yet.
        layer: the layer.
    """
    sublayers = sublayer_moduli(layer)
    yield from _facet_remarks(model, layer)
    if not acts_as_springs(sublayers):
        yield from _thickness_remarks(model, layer, sublayers)
    is_incompressible = any(ply.decay_length == math.inf for ply in sublayers) and not layer.has_pressure_flow
    if is_incompressible and len(model.applicability[layer.name].uncorrected_rim.vertices):
        text = f"{layer} is incompressible: its law holds [u_N] at zero, but at free ends it is squeezed out"
        yield "incompressible", f"{text}; use order=1, mesh the layer (structure.full), {SUPPORT_HINT}"


def warn_of_states(states: Sequence[State], start: float | None = None) -> None:
    """Warn, once for all states, if results are outside the range of small strains or of an interface law. Collective.

    A warning that was already issued for the same time is not repeated.

    Args:
        states: states of one model, at least one.
        start: time at which the loads began; None: they are sudden in every state.
    """
    model = states[0].model
    if model.n_components == 1:
        warn_of_negative_conductivities(states)
        return warn_of_fluxes(states)
    warn_of_strains(states)
    warn_of_fracture_zones(states)
    for applicability in model.applicability.values() if model.broken else ():
        layer, tensions = applicability.layer, [_tension_ratio(applicability, state) for state in states]
        if (ratio := max(tensions)) > CAVITATION_STRESS_RATIO:
            t, why = states[int(np.argmax(tensions))].t, f"rubber cavitates from {CAVITATION_STRESS_RATIO:g} times on"
            text = f"at t = {t:.4g} the pressure of {layer} is a tension, {ratio:.3g} times its shear modulus: {why}"
            model.warn("cavitation", f"{text}, unlike its law; do not use such results", layer.name, states[-1].t)
    worst = max(states, key=lambda state: state.elastic_share)
    if worst.elastic_share > MIN_SPRING_LOAD_FRACTION:
        text = f"at t = {worst.t:.4g} springs parallel to what yields carry {worst.elastic_share:.2g} of its load"
        remedy = "take a smaller elastic_fraction, 0 if Newton's method then converges"
        model.warn("elastic share", f"{text}, and hide its limit load; {remedy}", "", states[-1].t)
    for layer in _strain_layers(model):
        for key, remark in _state_remarks(states, layer, start):
            model.warn(key, remark, layer.name, states[-1].t)


def warn_of_strains(states: Sequence[State]) -> None:
    """Warn, once for all states, if strains of non-linear bodies exceed `MAX_SMALL_STRAIN`. Collective.

    The root mean square over a body is tested. At single points, such as corners, strains are large in any case. Linear
    bodies are not tested, as their results are proportional to loads of any size.

    Args:
        states: states of one model.
    """
    if not states or states[0].model.n_components == 1:
        return
    model = states[0].model
    for term in (term for term in model.bodies if not term.law.traits.linear):
        u = fem.Function(model.V)
        e, unity = term.strain(u), fem.Constant(model.domain.mesh, 1.0)
        squared_strain = compiled(ufl.inner(e, e) * term.weight * term.measure)
        volume = model.comm.allreduce(fem.assemble_scalar(compiled(unity * term.weight * term.measure)))
        strains = {}
        for state in states:
            u.x.array[:] = state.u.x.array
            strains[state.t] = math.sqrt(model.comm.allreduce(fem.assemble_scalar(squared_strain)) / volume)
        if not (times := [t for t, strain in strains.items() if strain > MAX_SMALL_STRAIN]):
            continue
        worst_t, name = max(times, key=strains.__getitem__), Key.parse(term.key).name
        body = f"the body {name!r}" if name else "the bodies"
        text = f"at t = {worst_t:.4g} strains of {body} are {strains[worst_t]:.3g} (root mean square over its volume)"
        since = f"beyond {MAX_SMALL_STRAIN:g} from t = {times[0]:.4g} on: the theory is for small strains"
        model.warn("strains", f"{text}, {since}; take smaller loads, or check the moduli's units", name, states[-1].t)


def warn_of_fracture_zones(states: Sequence[State]) -> None:
    """Warn, once for each layer, if cracks advance in zones of fewer than two facets. Collective.

    Args:
        states: states of one model, in the order of a march.
    """
    for layer in states[0].model.layers.values() if len(states) > 1 else ():
        if {BROKEN, BREAKING} <= {*share_columns(layer.law)}:
            _warn_of_short_zone(states, layer)


def _state_remarks(states: Sequence[State], layer: SeamLayer, start: float | None) -> Iterator[Remark]:
    """Yield warnings about a layer that follow from states, as pairs (key that identifies the warning, text).

    Args:
        states: states of one model.
        layer: the layer.
        start: time at which the loads began; None: they are sudden in every state.
    """
    sublayers = sublayer_moduli(layer)
    if not (states[0].model.linear or acts_as_springs(sublayers)):
        # The mean over S is tested, as jumps are large at single places in any case. The limit is above 1, because
        # under the same load jumps do not vanish with the thickness. Linear models are not tested: their results are
        # proportional to loads of any size.
        mean_closings = [FaceDisplacements(state, layer).mean_closing for state in states]
        if (max_mean := max(mean_closings)) > OVERLAP_CLOSING:
            faces = FaceDisplacements(states[int(np.argmax(mean_closings))], layer)
            facet, corner = np.unravel_index(faces.closing.argmax(), faces.closing.shape)
            x = place_text(faces.surface.corner_points.x[:, facet, corner])
            text = f"at t = {faces.state.t:.4g} {layer} closes by {max_mean:.3g} times its thickness, on average over S"
            most_text = f"most near {x}, by {faces.closing.max():.3g} times"
            yield "overlap", f"{text} ({most_text}): bodies overlap; check loads, thickness and parameters"
    if not layer.has_pressure_flow:
        yield from stiffness_remark(layer, states, start)
    yield from order_0_remark(layer, states, sublayers)


def _strain_layers(model: Model) -> list[SeamLayer]:
    """Return the layers of an interface model whose laws depend on strains; an empty list for others.

    A layer whose parameters vary in space occurs several times, with samples of their values.
    """
    has_strains = model.broken and model.n_components > 1
    return [s for layer in model.layers.values() if layer.thin_layer for s in layer.samples] if has_strains else []


def _facet_remarks(model: Model, layer: SeamLayer) -> Iterator[Remark]:
    """Yield a warning (key, text) if the straight facets of a curved S make its layer too stiff against slip.

    Let n be the normal of a facet, and N the mean normal of the facets at each of its vertices. A slip w along S then
    opens the layer by w . (N - n). This adds the normal stiffness, times the mean of |N - n|^2, to the tangential
    stiffness. Angles above CORNER_ANGLE are corners of S, and do not count.

    Args:
        model: the model.
        layer: the layer.
    """
    if model.joint.degree > 1 or model.joint.planar:
        return
    surface = surface_of(model, layer.name)
    normal_sums = surface.nodal_sums(surface.moments(surface.n))
    nodal_normals = normal_sums / np.linalg.norm(normal_sums, axis=1, keepdims=True)
    tilt = nodal_normals[surface.nodes] - surface.n[:, :, 0].T[:, None]
    tilt[np.linalg.norm(tilt, axis=2) > CORNER_ANGLE] = 0.0
    angle = surface.norm(surface.from_corners(np.moveaxis(tilt, -1, 0))) / math.sqrt(surface.integral(1.0))
    normal_stiffness, shear_stiffness = jump_stiffness(layer)
    if normal_stiffness * angle**2 > STIFFNESS_ERROR_LIMIT * shear_stiffness:
        ratio = 1 + normal_stiffness * angle**2 / shear_stiffness if shear_stiffness else math.inf
        effect = f"is about {ratio:.3g} times too stiff against it," if shear_stiffness else "resists"
        text = f"S is curved and its facets are straight, {math.degrees(angle):.2g} degrees off its normal on average"
        remedy = "use curved cells (degree 2) or a finer mesh"
        yield "facets", f"{text}: a slip along S opens the layer there, which {effect} by the mesh alone; {remedy}"


def _thickness_remarks(model: Model, layer: SeamLayer, sublayers: list[SublayerModuli]) -> Iterator[Remark]:
    """Yield warnings (key, text) if a layer is thicker than a body, or joins plates that bend.

    Args:
        model: the interface model.
        layer: the layer.
        sublayers: the moduli of its sublayers.
    """
    # on one rank, as heights need memory for all cells
    height, thin_layer = on_root(model.comm, lambda: min(layer.sheet.body_heights)), layer.thin_layer
    assert thin_layer
    if thin_layer.eps > height:
        text = f"{layer} is {thin_layer.eps:.4g} thick, the thinner body {height:.4g} high: its law is for thin layers"
        yield "thick", f"{text}; mesh the layer (structure.full), or check eps"
    body_tangents = model.structure.extreme_body_tangents
    if thin_layer.order == 1 or not sublayers or any(C is None for C in body_tangents):
        return
    softer = min(in_plane_modulus(C, layer.initial_tangents.n) for C in body_tangents if C is not None)
    sheet = layer.sheet
    length, mean_h = float(np.ptp(sheet.joint.points[sheet.vertices], axis=(0, 1)).max()), np.mean(sheet.body_heights)
    if len(sheet.body_heights) == 2 and sheet.planar and length > PLATE_SLENDERNESS * 2 * mean_h and softer > 0:
        # two beams of equal height under a half-wave of load; without the thickness the lever of their forces is mean,
        # not mean + eps
        slip_ratio = 2 * jump_stiffness(layer)[1] * (length / math.pi) ** 2 / (softer * mean_h)
        error = 6 * slip_ratio / (1 + 4 * slip_ratio) * thin_layer.eps / mean_h
        if error > STIFFNESS_ERROR_LIMIT / 2:
            text = f"{layer} joins plates {mean_h:.4g} high, which meet on S in order 0, without its thickness between"
            yield "plates", f"{text}: if they bend, they do so about {error:.2g} too much; use order=1"


def _tension_ratio(applicability: Applicability, state: State) -> float:
    """Return the largest ratio of a layer's pressure, positive in tension, to its shear modulus. Collective.

    The pressure is taken at the vertices of S. The ratio is 0 without tension, and for a layer whose pressure is not an
    unknown.

    Args:
        applicability: ranges of the layer's law.
        state: the state.
    """
    layer = applicability.layer
    p = state.fields.get(str(Key.parse(layer.key).pressure_key)) if layer.has_pressure_flow else None
    if p is None:
        return 0.0
    n_owned = p.function_space.dofmap.index_map.size_local
    x = p.function_space.tabulate_dof_coordinates()[:n_owned, : layer.structure.joint.dim]
    mu = applicability.law.fields_at(x.T).get("mu", applicability.law.parameters()["mu"])
    return float(state.model.comm.allreduce((p.x.array[:n_owned] / mu).max(initial=0.0), MPI.MAX))


# ---------------------------------------------------------------- times of laws
def warn_of_steps(model: Model, start: float, times: Sequence[float], theta: float) -> None:
    """Warn, before a march, if planned time steps are not much shorter than a time constant of a law. Collective.

    Only steps that begin less than this time constant after the start, or after a break of the data in time, are
    tested. Later, changes are slow.

    Args:
        model: the model.
        start: time at which the march begins.
        times: times at which the planned steps end.
        theta: fraction of each time step after which forces balance.
    """
    change_times = [start, *(t for t in model.break_times if t > start)]
    step_errors = (
        (_step_error((end - t) / tau, theta), end - t, t, tau, name)
        for name, tau in _law_time_constants(model)
        for t, end in pairwise([start, *times])
        if any(0 <= t - change < tau for change in change_times)
    )
    if (worst := max(step_errors, default=None)) and worst[0] > MAX_STEP_ERROR:
        error, step, t, tau, name = worst
        text = f"the step of {step:.3g} at t = {t:.3g} is not well below a time of {name}, {tau:.3g}: an error of about"
        remedy = f"take steps below {tau / 4:.2g} while this lasts, or Adaptive(end=..., first=..., tolerance=...)"
        model.warn("time step", f"{text} {error:.0%} of what creeps or relaxes; {remedy}", start, *times)


def warn_of_no_time(model: Model) -> None:
    """Warn that `solve` computes the response just after sudden loads, if a law of the model relaxes. Collective."""
    for name, tau in _law_time_constants(model)[:1]:
        text = f"{name} relaxes with the time {tau:.3g}, and a solve knows no time: this is the response just after"
        model.warn("no time", f"{text} sudden loads; for a later one march(model, times), or give times")


def _law_time_constants(model: Model) -> list[tuple[str, float]]:
    """Return pairs of a law's name and one of its time constants, for all laws whose parameters are numbers."""
    laws = [*model.body_laws.values(), *(law for layer in model.layers.values() for _, law in layer.law.sublayers)]
    times = ((getattr(law, "law_3d", law), tau) for law in laws if not law.fields for tau in law.relaxation_times)
    return [(type(law).__name__, float(tau)) for law, tau in times]


def _step_error(x: float, theta: float) -> float:
    """Return the error with which a time scheme computes the relaxation exp(-t/tau), at about t = tau.

    Args:
        x: length of the time steps over the time constant tau.
        theta: fraction of each time step after which forces balance.
    """
    if x < MIN_STEP_TO_TIME_CONSTANT:
        return 0.0
    n = max(1, round(1 / x))
    return abs(((1 - (1 - theta) * x) / (1 + theta * x)) ** n - math.exp(-n * x))


def _warn_of_short_zone(states: Sequence[State], layer: SeamLayer) -> None:
    """Warn if a crack has advanced over facets with less than two of them in its fracture zone.

    Then a facet that has broken since the first state has sound points, or has a neighbour with sound points. The path
    has kinks and turns of single facets, and the toughness is not resolved. Collective.

    Args:
        states: states of one model, in the order of a march.
        layer: a layer of the model.
    """
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
        of_zone = f"is about {zone:.2g} long, near {place_text(corners.mean(axis=0))}, and facets {h:.3g}"
        text = f"at t = {state.t:.4g} the fracture zone of {layer} {of_zone}"
        remedy = f"take facets of {zone / FACETS_IN_ZONE:.2g}, or less strength, with which the zone is longer"
        message = f"{text}: fewer than two in the zone do not resolve the toughness; {remedy}"
        states[0].model.warn("fracture zone", message, layer.name)
        return


def _facet_shares(surface: SurfaceMesh, state: State) -> Array:
    """Return the shares (3, n) of each facet that are broken, are breaking and are sound. Collective."""
    sums = np.zeros((3, len(surface.rows)))
    for points, facets in layer_points(surface, state):
        cells, facets_here = points.quadrature.cells[facets >= 0], facets[facets >= 0]
        for (_, law), internal in zip(points.term.law.sublayers, points.internal(), strict=True):
            if BROKEN in law.share_columns:
                broken, breaking = (law.shares(internal)[name][cells] for name in (BROKEN, BREAKING))
                values = np.stack([broken, breaking, 1.0 - broken - breaking]).mean(axis=2)
                np.add.at(sums.T, facets_here, values.T)
    shares = state.model.comm.allreduce(sums)
    return np.asarray(shares / np.maximum(shares.sum(axis=0), 1.0))
