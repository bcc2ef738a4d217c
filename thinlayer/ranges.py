"""Whether a model and its result lie in the range of its interface law; RangeWarnings where they do not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.contact import ContactLaw
from forms.law import Law
from forms.tangent import average_lame, in_plane_modulus
from forms.traction import TractionLaw
from geometry.joint import LAYER, S
from geometry.sheet import Rim
from geometry.topology import FloatArray, IntArray
from thinlayer.exchange import carry
from thinlayer.failure import warn
from thinlayer.model import Model
from thinlayer.state import State

NEARLY = 0.5  # delta/eps, nu = 3/8: below it what free ends relax is no pressure along S
LONG = (
    1.0  # delta/eps, nu = 6/13: below it what jumps found at free ends relax is within a thickness of them, and local
)
SHARE = 0.1  # of a layer's stiffness: errors of this size are told
OVERLAP = 2.0  # closing over thickness: from 1 on bodies overlap, here by another thickness
VOLUME, HELD = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), 1e8  # trace of a strain; bulk modulus that holds it, over mu
JUMPS = 1e-9  # modulus along S over mu, rounding: a law with less sees jumps alone


def warn_of_model(model: Model) -> None:
    """Warn of an interface model that lies outside the range of its law, before it is solved. Collective."""
    law = _law_of_strains(model)
    if law is None:
        return
    strata = _strata(model)
    if not _of_jumps(strata):
        _warn_of_thickness(model)
        _warn_of_hard_layer(model, strata)
    _warn_of_free_ends(model, strata)


def warn_of_states(states: Sequence[State]) -> None:
    """Warn of an interface model's results that lie outside the range of its law, once for all of them. Collective."""
    law = _law_of_strains(states[0].model) if states else None
    if law is None:
        return
    strata = _strata(states[0].model)
    found = [faces for faces in map(_Faces.of, states) if faces]
    if not found:
        return
    if not (states[0].model.linear or _of_jumps(strata)):
        _warn_of_overlap(max(found, key=lambda faces: faces.mean_closing))
    if strata and law.linear and not law.pointwise and LONG < strata[0].length < math.inf:
        _warn_of_pressure(max(found, key=lambda faces: np.abs(faces.opening).max()), strata[0])


def _law_of_strains(model: Model) -> Law | None:
    """The law, its parameters real, of an interface model whose law is one of strains; else None."""
    if model.kind != "interface" or model.layer is None or isinstance(model.layer.law, (TractionLaw, ContactLaw)):
        return None
    return model.layer.real_law(model.plane)


def free_rim(model: Model) -> Rim:
    """Where the layer's side is free: no support of its whole side holds it along S."""
    rim, supports = model.sheet.rim, model.supports
    held = np.zeros(rim.outward.shape)
    for place, components in supports.entries:
        name = place.removesuffix(f"/{LAYER}") if isinstance(place, str) else S
        if name == S or name not in model.joint.facets:  # a vertex, or the side of one body
            continue
        axes = [supports.axes.index(axis) for axis in components]
        held[:, axes] = np.maximum(held[:, axes], rim.on(model.joint.facets[name])[:, None])
    return rim[(held * rim.outward**2).sum(axis=1) < 0.5]


# ---------------------------------------------------------------- before a solve
@dataclass(frozen=True)
class Stratum:
    """A sublayer, or the layer: its share of the thickness, moduli lmbda and mu at rest, and the modulus of its sheet."""

    fraction: float
    lmbda: float
    mu: float
    along: float

    @property
    def length(self) -> float:
        """Length of the pressure along S, over the thickness of the layer; infinite if the layer is incompressible."""
        return self.fraction * math.sqrt(max(self.lmbda, 0.0) / (12 * self.mu))

    @property
    def compliance(self) -> float:
        """Under a normal traction, sides held."""
        return self.fraction / (self.lmbda + 2 * self.mu)

    @classmethod
    def of(cls, fraction: float, law: Law, C: FloatArray, n: FloatArray) -> Stratum | None:
        """From the tangent at rest; None if the law has no resistance to shear, and so no such length."""
        lmbda, mu = average_lame(C)
        if law.constrained:
            held = np.outer(VOLUME, VOLUME) * np.abs(C).max() * HELD
            return cls(fraction, math.inf, mu, in_plane_modulus(C + held, n))
        return None if mu <= 0 else cls(fraction, lmbda, mu, in_plane_modulus(C, n))


def _strata(model: Model) -> list[Stratum]:
    """Those of a layer whose tangents at rest are known; [] of another."""
    n = model.sheet.mean_normal
    found = [None if C is None else Stratum.of(a, law, C, n) for a, law, C in model.layer_at_rest]
    return [] if None in found else [stratum for stratum in found if stratum]


def _of_jumps(strata: list[Stratum]) -> bool:
    """Whether strains along S leave the law without stress, as springs: its traction then does not know the thickness."""
    return bool(strata) and all(stratum.along <= JUMPS * stratum.mu for stratum in strata)


def _warn_of_thickness(model: Model) -> None:
    """The law is the first terms of a series in the thickness over the length on which bodies' stresses vary."""
    layer = model.layer
    assert layer is not None
    height = min(model.sheet.heights)
    if layer.eps > height:
        warn(
            f"the layer is {layer.eps:.4g} thick, the thinner body {height:.4g} (its volume over the area of S): the "
            "interface law is for thicknesses well below that of the bodies; mesh the layer (Model.full), or check eps",
            model.comm,
        )


def _warn_of_hard_layer(model: Model, strata: list[Stratum]) -> None:
    """Order 0 leaves eps grad_S <u> out of the jump, eps t/E_body beside eps t/E_layer: more than all of it then."""
    layer, n = model.layer, model.sheet.mean_normal
    assert layer is not None
    bodies = model.bodies_at_rest
    if layer.order == 1 or not strata or any(C is None for C in bodies):
        return
    softest = min(in_plane_modulus(C, n) for C in bodies if C is not None)
    hardest = max(stratum.along for stratum in strata)
    if hardest > softest > 0:
        warn(
            f"the layer is {hardest / softest:.3g} times as hard as the softer body (moduli in the plane of S; the layer's "
            f"are its law's times eps = {layer.eps:.4g}): its jump is less than what order 0 leaves out; use order=1, mesh "
            "the layer (Model.full), or check whether the law's parameters are per thickness",
            model.comm,
        )


def _warn_of_free_ends(model: Model, strata: list[Stratum]) -> None:
    """At free ends the pressure of a nearly incompressible layer falls to zero over a length delta, which laws leave out.

    Between rigid faces a strip of half-width l carries 1 - tanh(l/delta) delta/l of what the laws say.
    """
    layer = model.layer
    assert layer is not None
    nearly = [stratum for stratum in strata if stratum.length > NEARLY * stratum.fraction]
    if not nearly:
        return
    rim = free_rim(model)
    if not len(rim.vertices):
        return
    if any(stratum.length == math.inf for stratum in nearly):
        warn(
            "the layer is incompressible and S has free ends: its law holds the normal jump [u_N] at zero, as of a layer "
            "that is held there; one that is free is squeezed out, and its jump is not zero; mesh the layer (Model.full), "
            "or support its sides if they are held",
            model.comm,
        )
        return
    width = float(model.sheet.areas.sum() / rim.length.sum())
    whole, lost, longest = sum(stratum.compliance for stratum in strata), 0.0, 0.0
    for stratum in nearly:
        delta = stratum.length * layer.eps
        y = delta / width
        lost += stratum.compliance / whole * (1 / (1 - math.tanh(1 / y) * y) - 1)
        longest = max(longest, delta)
    if lost > 1 / (1 - SHARE) - 1:
        warn(
            "the layer is nearly incompressible: its pressure falls to zero at the free ends of S over delta = "
            f"{longest:.3g}, {longest / width:.2g} of the area of S over the length of its free ends ({width:.3g}); "
            f"between rigid bodies its law would be about {1 + lost:.3g} times too stiff against normal jumps; mesh the "
            "layer (Model.full), or support its sides if they are held",
            model.comm,
        )


# ---------------------------------------------------------------- after a solve
@dataclass(frozen=True)
class _Faces:
    """Displacements (n, d, d) of the lower and the upper face at the vertices of the simplices of S."""

    state: State
    lower: FloatArray
    upper: FloatArray

    @classmethod
    def of(cls, state: State) -> _Faces | None:
        """Those of a state on rank 0, None on others. Collective."""
        model, joint = state.model, state.model.joint
        cells = joint.table.cells[joint.surface_rows]
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
        at_corners, sheet = values.reshape(len(needed), -1, joint.dim), model.sheet
        above = (joint.side[cells[:, 0]] > 0) | joint.rigid_base
        upper, lower = (np.where(above == first, cells[:, 0], cells[:, 1]) for first in (True, False))

        def at_vertices(cell: IntArray) -> FloatArray:
            cell = cell[sheet.parts[0]]
            corner = (joint.corners[cell][:, None, :] == sheet.vertices[:, :, None]).argmax(axis=2)
            return np.asarray(at_corners[place[cell][:, None], corner])

        u = at_vertices(upper)
        return cls(state, 0 * u if joint.rigid_base else at_vertices(lower), u)

    @cached_property
    def opening(self) -> FloatArray:
        """(n, d) [u_N]."""
        return np.asarray(((self.upper - self.lower) * self.state.model.sheet.normals).sum(axis=2))

    @cached_property
    def thickness(self) -> FloatArray:
        """(n, d)."""
        model, layer = self.state.model, self.state.model.layer
        assert layer is not None
        return np.asarray(layer.eps * model.joint.relative_thickness(layer.profile)[model.sheet.vertices])

    @property
    def closing(self) -> FloatArray:
        """(n, d) how far the faces have approached each other, over the thickness."""
        return -self.opening / self.thickness

    @property
    def mean_closing(self) -> float:
        """Its mean over S; where the layer opens it counts as none."""
        areas = self.state.model.sheet.areas
        return float(areas @ np.maximum(self.closing, 0).mean(axis=1) / areas.sum())


def _warn_of_overlap(faces: _Faces) -> None:
    """A layer that closes by its thickness is gone; laws of small strains do not know it, and the bodies overlap.

    Told is an overlap as large as the thickness, on average: at single places, such as ends, jumps are large in any case,
    and where the thickness tends to zero under the same load, jumps stay, and pass it in the end. Results of linear models
    are proportional to their loads: there a unit load is as good as any, and nothing is told.
    """
    closing, state = faces.closing, faces.state
    if faces.mean_closing > OVERLAP:
        worst = np.unravel_index(closing.argmax(), closing.shape)
        x = ", ".join(f"{c:.4g}" for c in state.model.joint.points[state.model.sheet.vertices[worst]])
        warn(
            f"at t = {state.t:.4g} the layer closes by {faces.mean_closing:.3g} times its thickness, on average over S "
            f"(most near ({x}), by {closing[worst]:.3g} times): the bodies overlap, and the law is for small strains; "
            "check loads, thickness and the law's parameters (per thickness?)",
            state.model.comm,
        )


def _warn_of_pressure(faces: _Faces, layer: Stratum) -> None:
    """How much stiffer the law is than a layer whose pressure evens out along S, with the opening that was found."""
    excess = pressure_excess(faces, layer)
    if excess > SHARE:
        warn(
            f"the layer is nearly incompressible (lmbda/mu = {layer.lmbda / layer.mu:.4g}): with the jumps found, the "
            f"layer alone is {1 + excess:.3g} times too stiff, as its interface law lets no material flow along S; the "
            "structure is off by less where the bodies are soft; mesh the layer (Model.full) to see by how much",
            faces.state.model.comm,
        )


def pressure_excess(faces: _Faces, layer: Stratum) -> float:
    """int (p_0 - p) wb/int p wb, with wb = [u_N] + eps div_S <u>, the pressure p_0 of the law and p of the layer.

    (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = wb, with p = 0 at free ends, no flow through the others; p_0 without the
    second term. Continuous functions of degree 1. Where cells at a free end are larger than the length of the pressure,
    p is left free there: it could not fall within them.
    """
    sheet, eps = faces.state.model.sheet, faces.thickness.mean(axis=1)
    d = sheet.joint.dim
    stretch = ((faces.lower + faces.upper) / 2 * sheet.gradients).sum(axis=(1, 2))
    wb = faces.opening + (eps * stretch)[:, None]
    used, number = np.unique(sheet.vertices, return_inverse=True)
    number = number.reshape(sheet.vertices.shape)
    mass = sheet.areas[:, None, None] / (d * (d + 1)) * (1 + np.eye(d))
    stiff = sheet.areas[:, None, None] * sheet.gradients @ np.swapaxes(sheet.gradients, 1, 2)
    volume = _assemble(mass * (eps / layer.lmbda)[:, None, None], number)
    flow = _assemble(stiff * (eps**3 / (12 * layer.mu))[:, None, None], number)
    b = np.bincount(number.ravel(), (mass @ wb[..., None]).ravel(), len(used))
    rim = free_rim(faces.state.model)
    fine = rim[rim.depth <= layer.length * eps[rim.simplex]]
    inside = np.setdiff1d(np.arange(len(used)), np.searchsorted(used, fine.vertices))
    if not b[inside].any():
        return 0.0
    p_0 = scipy.sparse.linalg.spsolve(volume, b)
    p = scipy.sparse.linalg.spsolve((volume + flow)[inside][:, inside], b[inside])
    work_0, work = float(b @ p_0), float(b[inside] @ p)
    return (work_0 - work) / work


def _assemble(blocks: FloatArray, number: IntArray) -> scipy.sparse.csc_matrix:
    """The matrix of blocks (n, d, d) of simplices whose vertices have these numbers (n, d)."""
    rows = np.broadcast_to(number[:, :, None], blocks.shape).ravel()
    columns = np.broadcast_to(number[:, None, :], blocks.shape).ravel()
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows, columns))).tocsc()
