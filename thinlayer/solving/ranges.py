"""Tests of whether a model and its results lie in the range of its interface law; a RangeWarning says where not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.law import BulkLaw
from forms.tangent import across, average_lame, in_plane_modulus
from geometry.joint import LAYER, S
from geometry.sheet import Rim, Sheet
from geometry.topology import FloatArray, IntArray
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import warn
from thinlayer.parallel.exchange import carry

# Length delta over which the pressure of a layer falls to zero at a free end of S, relative to eps:
NEARLY_INCOMPRESSIBLE = 0.5  # (nu = 3/8) a shorter length has no effect along S
LONG_PRESSURE = 1.0  # (nu = 6/13) a shorter length changes jumps only within a thickness of free ends
LEAST_ERROR = 0.1  # relative error of a layer's stiffness from which on there is a warning
LEAST_OVERLAP = 2.0  # least closing, relative to the thickness, that leads to a warning; the bodies overlap from 1 on
VOLUME = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # trace of a strain, as a row over its six components
BULK_MODULUS = 1e8  # bulk modulus that stands for incompressibility, relative to the tangent
CORNER_ANGLE = 0.25  # largest angle, in rad, between a facet and the mean of its neighbours that is not a corner of S
NEGLIGIBLE = 1e-9  # modulus or stiffness, relative to others of the layer, that counts as zero
SHEAR_MATRIX = np.array([[7.0, -8.0, 1.0], [-8.0, 16.0, -8.0], [1.0, -8.0, 7.0]])  # int u' v' times 3 h, degree 2
STRETCH_MATRIX = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]])  # int u v times 30/h, degree 2
SAME_RATIO = 1e-3  # relative change of lmbda/mu in time that counts as none
JUMP_ROUNDING = 1e-9  # rounding of jumps, relative to the displacements
LATE_OPENING = 0.5  # least opening of the last state that is tested, relative to the largest one


def warn_of_model(model: Model, lasting: Sequence[float] = ()) -> None:
    """Warn of an interface model that lies outside the range of its law, before it is solved. Collective.

    Args:
        model: the model.
        lasting: durations > 0 of the loads at the times of interest; () for sudden loads.
    """
    for one in _thin(model):
        sublayers = _sublayers(one)
        _warn_of_facets(model, one)
        if not _of_jumps(sublayers):
            _warn_of_thickness(model, one)
            _warn_of_hard_layer(model, one, sublayers)
        at_once = [] if lasting and one.law.traits.rate else [sublayers]
        _warn_of_free_ends(model, one, [*at_once, *(_sublayers(one, dt) for dt in lasting)])


def warn_of_states(states: Sequence[State], start: float | None = None) -> None:
    """Warn of an interface model's results that lie outside the range of its law, once for all of them. Collective.

    Args:
        states: of one model.
        start: time since which loads last; None if they are sudden at every state.
    """
    if not states:
        return
    model = states[0].model
    for one in _thin(model):
        found = [faces for faces in (_Faces.of(state, one) for state in states) if faces]
        if not found:
            continue
        if not (model.linear or _of_jumps(_sublayers(one))):
            _warn_of_overlap(one, max(found, key=lambda faces: faces.mean_closing))
        if one.law.traits.linear and not one.law.traits.phases:  # the strain of a phase brings about no pressure
            _warn_of_pressure(model, one, found, start)


def _thin(model: Model) -> list[SeamLayer]:
    """The layers of an interface model whose laws are of strains."""
    return [one for one in model.layers.values() if one.thin] if model.broken else []


def free_rim(model: Model, sheet: Sheet) -> Rim:
    """The part of the rim of a seam where the layer's side is free: no support of the whole side holds it along S."""
    rim, supports = sheet.rim, model.supports
    held = np.zeros(rim.outward.shape)
    for place, components in supports.entries:
        name = place.removesuffix(f"/{LAYER}") if isinstance(place, str) else S
        if name in (S, *model.joint.seams) or name not in model.joint.facets:  # a vertex, or the side of one body
            continue
        axes = [supports.axes.index(axis) for axis in components]
        held[:, axes] = np.maximum(held[:, axes], rim.on(model.joint.facets[name])[:, None])
    return rim[(held * rim.outward**2).sum(axis=1) < 0.5]


# ---------------------------------------------------------------- before a solve
@dataclass(frozen=True)
class Sublayer:
    """One of the sublayers of a layer whose law is a `Stack`, or the whole layer.

    Attributes:
        fraction: share of the layer's thickness.
        lmbda, mu: Lame moduli at rest or, if lmbda/mu changes in time, under loads that have lasted; a stress.
        along: modulus of the sublayer as a sheet in the plane of S; a stress.
        when: words for a warning that say how long loads last; "" at rest.
    """

    fraction: float
    lmbda: float
    mu: float
    along: float
    when: str = ""

    @property
    def nearly(self) -> bool:
        """Whether the sublayer is nearly incompressible."""
        return self.length > NEARLY_INCOMPRESSIBLE * self.fraction

    @property
    def length(self) -> float:
        """Length over which the pressure falls to zero at a free end, over the layer's thickness; may be infinite."""
        return self.fraction * math.sqrt(max(self.lmbda, 0.0) / (12 * self.mu))

    @property
    def compliance(self) -> float:
        """Compliance under a normal traction without strain along S, over the thickness of the layer."""
        return self.fraction / (self.lmbda + 2 * self.mu)

    @classmethod
    def of(cls, fraction: float, law: BulkLaw, C: FloatArray, n: FloatArray) -> Sublayer | None:
        """A sublayer from the tangent C at rest; None if the law does not resist shear."""
        lmbda, mu = average_lame(C)
        if law.traits.constrained:
            held = np.outer(VOLUME, VOLUME) * np.abs(C).max() * BULK_MODULUS
            return cls(fraction, math.inf, mu, in_plane_modulus(C + held, n))
        return None if mu <= 0 else cls(fraction, lmbda, mu, in_plane_modulus(C, n))


def _sublayers(one: SeamLayer, dt: float = 0.0) -> list[Sublayer]:
    """The sublayers of a layer under loads that have lasted dt (0: at rest); [] if tangents are not known."""
    n, sublayers = one.at_rest.n, one.at_rest.sublayers
    later = one.at_rest.over(dt) if dt > 0 else [None] * len(sublayers)
    found: list[Sublayer] = []
    for (a, law, C), C_later in zip(sublayers, later, strict=True):
        if C is None and C_later is None:
            return []
        rest, then = (None if one is None else Sublayer.of(a, law, one, n) for one in (C, C_later))
        if then and not (rest and math.isclose(then.lmbda * rest.mu, rest.lmbda * then.mu, rel_tol=SAME_RATIO)):
            then = replace(then, when=f" under loads that last {dt:.4g}")
        found += [one for one in (then or rest,) if one]
    return found


def _of_jumps(sublayers: list[Sublayer]) -> bool:
    """Whether strains along S cause no stress, as in springs: the traction then does not depend on the thickness."""
    return bool(sublayers) and all(one.along <= NEGLIGIBLE * one.mu for one in sublayers)


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
    k = joint.dim
    squares = ((tilt.sum(axis=1) ** 2).sum(axis=1) + (tilt**2).sum(axis=(1, 2))) / (k * (k + 1))
    angle = math.sqrt(float(sheet.areas @ squares / sheet.areas.sum()))
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


def stiffness_of_jumps(one: SeamLayer) -> tuple[float, float]:
    """Normal and least tangential stiffness of the layer at rest, per area; zeros if they are not known."""
    assert one.thin
    n, compliances = one.at_rest.n, np.zeros(2)
    for fraction, _, C in one.at_rest.sublayers:
        if C is None:
            return 0.0, 0.0
        A = across(C, n)
        size, up = float(np.abs(A).max()), float(n @ A @ n)
        along = float(np.linalg.eigvalsh((A + A.T) / 2 + 2 * size * np.outer(n, n))[0])
        if min(along, up) <= NEGLIGIBLE * size:
            return up, 0.0
        compliances += [fraction / up, fraction / along]
    normal, tangential = 1 / (compliances * one.thin.eps)
    return float(normal), float(tangential)


def _warn_of_thickness(model: Model, one: SeamLayer) -> None:
    """Warn if the layer is thicker than a body.

    The law is the start of a series in eps over the length on which the bodies' stresses vary.
    """
    height, layer = min(one.sheet.heights), one.thin
    if layer and layer.eps > height:
        warn(
            f"{one} is {layer.eps:.4g} thick, the thinner body {height:.4g} (its volume over the area of S): the "
            "interface law is for thicknesses well below that of the bodies; mesh the layer (structure.full), or check eps",
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
            f"{one} is {hardest / softest:.3g} times as hard as the softer body (moduli in the plane of S; the layer's "
            f"are its law's times eps = {layer.eps:.4g}): its jump is less than what order 0 leaves out; use order=1, mesh "
            "the layer (structure.full), or check whether the law's parameters are per thickness",
            model.comm,
        )


def _warn_of_free_ends(model: Model, one: SeamLayer, layers: Sequence[list[Sublayer]]) -> None:
    """Warn if the pressure of a nearly incompressible layer falls to zero at free ends over a long length delta.

    Interface laws do not contain this effect. Between rigid faces a strip of half-width l carries only the share
    1 - tanh(l/delta) delta/l of the load that the law gives. The warning names the largest factor.

    Args:
        model: the interface model.
        one: the layer.
        layers: the sublayers at several times.
    """
    layers = [sublayers for sublayers in layers if any(one.nearly for one in sublayers)]
    if not layers:
        return
    assert one.thin
    rim, eps = free_rim(model, one.sheet), one.thin.eps
    if not len(rim.vertices):
        return
    if any(one.length == math.inf for sublayers in layers for one in sublayers):
        warn(
            f"{one} is incompressible and S has free ends: its law holds the normal jump [u_N] at zero, as if these "
            "ends were held; a layer with free ends is squeezed out, and its normal jump is not zero; mesh the layer "
            "(structure.full), or support its sides if they are held",
            model.comm,
        )
        return
    width = float(one.sheet.areas.sum() / rim.length.sum())
    lengths = [pressure_length(sublayers, width / eps) for sublayers in layers]
    worst = max(layers[lengths.index(max(lengths))], key=lambda one: one.length)
    delta = eps * max(lengths)
    y = delta / width
    lost = 1 / (1 - math.tanh(1 / y) * y) - 1
    if lost > 1 / (1 - LEAST_ERROR) - 1:
        warn(
            f"{one} is nearly incompressible{worst.when}: its pressure falls to zero at the free ends of S over delta "
            f"= {delta:.3g}, {y:.2g} of the area of S over the length of its free ends ({width:.3g}); between "
            f"rigid bodies its law would be about {1 + lost:.3g} times too stiff against normal jumps; mesh the "
            "layer (structure.full), or support its sides if they are held",
            model.comm,
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


# ---------------------------------------------------------------- after a solve
@dataclass(frozen=True)
class _Faces:
    """Thickness (n, d) and displacements of the lower and upper face (n, d, d) at the vertices of the simplices of S."""

    state: State
    sheet: Sheet
    thickness: FloatArray
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, state: State, one: SeamLayer) -> _Faces | None:
        """The faces of a state on rank 0, None on other ranks. Collective."""
        model, joint = state.model, state.model.joint
        cells = joint.surface_cells[one.sheet.facets]
        needed = np.unique(cells[cells >= 0])
        place = np.full(len(joint.cells), -1)
        place[needed] = np.arange(len(needed))
        domain = model.domain
        owned = domain.original_cells[: domain.mesh.topology.index_map(joint.dim).size_local]
        local = np.flatnonzero(place[owned] >= 0)
        dofs = np.asarray(model.V.dofmap.list)[local][:, : joint.corners.shape[1]]
        values = state.u.x.array.reshape(-1, joint.dim)[dofs].reshape(len(local), dofs.shape[1] * joint.dim)
        wanted = needed if model.comm.rank == 0 else needed[:0]
        values = carry(model.comm, owned[local], values, wanted)
        if model.comm.rank:
            return None
        at_corners, sheet = values.reshape(len(needed), -1, joint.dim), one.sheet
        below, above = cells[np.searchsorted(sheet.facets, sheet.parts[0])].T

        def at_vertices(cell: IntArray) -> FloatArray:
            corner = (joint.corners[cell][:, None, :] == sheet.vertices[:, :, None]).argmax(axis=2)
            return np.asarray(at_corners[place[cell][:, None], corner])

        assert one.thin
        relative = joint.relative_thickness(one.thin.profile, one.name)
        u, thickness = at_vertices(above), one.thin.eps * relative[sheet.vertices]
        return cls(state, sheet, thickness, 0 * u if (below < 0).any() else at_vertices(below), u)

    @cached_property
    def opening(self) -> FloatArray:
        """(n, d) [u_N]."""
        return np.asarray(((self.upper - self.lower) * self.sheet.normals).sum(axis=2))

    @property
    def slip_squared(self) -> FloatArray:
        """(n, d) |w_T|^2 plus the square of the rounding of displacements."""
        jump = self.upper - self.lower
        slip = jump - self.opening[..., None] * self.sheet.normals
        rounding = JUMP_ROUNDING * max(np.abs(self.lower).max(), np.abs(self.upper).max())
        return np.asarray((slip**2).sum(axis=2) + rounding**2)

    @property
    def closing(self) -> FloatArray:
        """(n, d) approach of the faces, relative to the thickness."""
        return -self.opening / self.thickness

    @property
    def mean_closing(self) -> float:
        """Mean closing over S; an opening counts as zero."""
        areas = self.sheet.areas
        return float(areas @ np.maximum(self.closing, 0).mean(axis=1) / areas.sum())


def _warn_of_overlap(one: SeamLayer, faces: _Faces) -> None:
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
            "check loads, thickness and the law's parameters (per thickness?)",
            state.model.comm,
        )


def _warn_of_pressure(model: Model, one: SeamLayer, found: Sequence[_Faces], start: float | None) -> None:
    """Warn if the law is too stiff for the openings found, compared with a layer whose pressure evens out along S.

    Two states are tested: the one with the largest opening and the last one with at least half of it, as laws that creep
    or relax become nearly incompressible with time.
    """
    openings = [float(np.abs(faces.opening).max()) for faces in found]
    most = openings.index(max(openings))
    last = max(k for k, opening in enumerate(openings) if opening >= LATE_OPENING * max(openings))
    worst, sublayer = LEAST_ERROR, None
    for faces in (found[k] for k in sorted({most, last})):
        state = faces.state
        sublayers = _sublayers(one, 0.0 if start is None else state.t - start)
        if len(sublayers) != 1 or not LONG_PRESSURE < sublayers[0].length < math.inf:
            continue
        excess = pressure_excess(faces, sublayers[0])
        if excess > worst:
            worst, sublayer = excess, sublayers[0]
    if sublayer:
        warn(
            f"{one} is nearly incompressible{sublayer.when} (lmbda/mu = {sublayer.lmbda / sublayer.mu:.4g}): with the "
            f"jumps found, the layer alone is {1 + worst:.3g} times too stiff, as its interface law lets no material "
            "flow along S; the structure is off by less where the bodies are soft; mesh the layer (structure.full) to see "
            "by how much",
            model.comm,
        )


def pressure_excess(faces: _Faces, layer: Sublayer) -> float:
    """Excess of the law's work over the work of the layer, int (p_0 - p) wb/(int p wb + int mu/eps |w_T|^2).

    The law is 1 + excess times too stiff for the jumps found; the excess is zero if they only shear the layer. With
    wb = [u_N] + eps div_S <u> the pressure of the law is p_0 = lmbda wb/eps, and the pressure p of the layer solves

        (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = wb, p = 0 at free ends, no flow through the others,

    continuous and of degree 1. If cells at a free end are larger than the length of the pressure, p is not set to zero
    there, as it cannot fall within a cell. On straight facets of a curved S slip opens the layer at one end of a facet and
    closes it at the other, and the law resists that, too. Jumps as small as the rounding of displacements count as shear.
    """
    sheet, eps = faces.sheet, faces.thickness.mean(axis=1)
    d = sheet.joint.dim
    stretch = ((faces.lower + faces.upper) / 2 * sheet.gradients).sum(axis=(1, 2))
    wb = faces.opening + (eps * stretch)[:, None]
    used, number = np.unique(sheet.vertices, return_inverse=True)
    number = number.reshape(sheet.vertices.shape)
    mass = sheet.areas[:, None, None] / (d * (d + 1)) * (1 + np.eye(d))
    stiff = sheet.areas[:, None, None] * sheet.gradients @ np.swapaxes(sheet.gradients, 1, 2)
    volume = _assemble(mass * (eps / layer.lmbda)[:, None, None], number)
    flow = _assemble(stiff * (eps**3 / (12 * layer.mu))[:, None, None], number)
    moments = (mass @ wb[..., None])[..., 0]
    b = np.bincount(number.ravel(), moments.ravel(), len(used))
    rim = free_rim(faces.state.model, sheet)
    fine = rim[rim.depth <= layer.length * eps[rim.simplex]]
    inside = np.setdiff1d(np.arange(len(used)), np.searchsorted(used, fine.vertices))
    if not b[inside].any():
        return 0.0
    p = scipy.sparse.linalg.spsolve((volume + flow)[inside][:, inside], b[inside])
    work_0 = float(layer.lmbda / eps @ (wb * moments).sum(axis=1))
    work = float(b[inside] @ p)
    shear = layer.mu * float((sheet.areas / eps) @ faces.slip_squared.mean(axis=1))
    return (work_0 - work) / (work + shear)


def _assemble(blocks: FloatArray, number: IntArray) -> scipy.sparse.csc_matrix:
    """Assemble the blocks (n, d, d) of simplices whose vertices have these numbers (n, d)."""
    rows = np.broadcast_to(number[:, :, None], blocks.shape).ravel()
    columns = np.broadcast_to(number[:, None, :], blocks.shape).ravel()
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows, columns))).tocsc()
