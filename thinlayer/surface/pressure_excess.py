"""Stiffness of layers, and errors of those interface laws that let no material of a soft layer flow along S."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.law import BulkLaw
from forms.law_tangents import acoustic_tensor, in_plane_modulus
from forms.stations import LOCKING_RATIO
from forms.tensors import average_lame, isotropic_tensor
from geometry.topology import FloatArray
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

# length of the pressure, over the thickness, up to which it has no effect along S; the length of nu = 3/8
NEARLY_INCOMPRESSIBLE_LENGTH = 0.5
INCOMPRESSIBLE_BULK_RATIO = 1e8  # bulk modulus that represents incompressibility, relative to the tangent
NEGLIGIBLE_MODULUS_RATIO = 1e-9  # modulus or stiffness, relative to others of the layer, that counts as zero
MODULUS_TOLERANCE = 1e-3  # relative change of lmbda/mu in time that counts as zero


@dataclass(frozen=True)
class SublayerModuli:
    """Moduli of a layer, or of one sublayer of a `Stack`, before loading or after loads of some duration.

    Attributes:
        fraction: fraction of the layer's thickness that the sublayer has; 1 for a whole layer.
        lmbda, mu: Lame moduli, stresses. They are effective moduli after the duration if the law's response depends on
            it, otherwise those before loading.
        E_plane: modulus, a stress, of the sublayer as a sheet along S with free faces; for isotropic laws E/(1 - nu^2).
        duration_text: words with the duration, such as " under loads that last 5"; "" if lmbda/mu is as before
            loading.
    """

    fraction: float
    lmbda: float
    mu: float
    E_plane: float
    duration_text: str = ""

    @property
    def rubbery(self) -> bool:
        """Whether the sublayer is nearly incompressible: its `decay_length` is more than half of its `fraction`."""
        return self.decay_length > NEARLY_INCOMPRESSIBLE_LENGTH * self.fraction

    @property
    def decay_length(self) -> float:
        """Length over which the sublayer's pressure decays at a free end, divided by the whole layer's thickness.

        It is infinite if the sublayer is incompressible.
        """
        return self.fraction * math.sqrt(max(self.lmbda, 0.0) / (12 * self.mu))

    @property
    def compliance(self) -> float:
        """Compliance against normal tractions, per thickness of the layer: `fraction` over lmbda + 2 mu.

        It is the sublayer's part of the normal jump for a unit traction and a layer of unit thickness, if strains along
        S are zero.
        """
        return self.fraction / (self.lmbda + 2 * self.mu)

    @classmethod
    def of(cls, fraction: float, law: BulkLaw, C: FloatArray, n: FloatArray) -> SublayerModuli | None:
        """Return the moduli of a sublayer from the tangent of its law; None if the law does not resist shear.

        Args:
            fraction: fraction of the layer's thickness that the sublayer has.
            law: the law.
            C: (6, 6) tangent of the law in Mandel's order.
            n: (d,) unit normal of S; d: number of dimensions.
        """
        lmbda, mu = average_lame(C)
        if law.traits.constrained and not law.parameters().get("lmbda"):
            volumetric = isotropic_tensor(np.abs(C).max() * INCOMPRESSIBLE_BULK_RATIO, 0.0)
            return cls(fraction, math.inf, mu, in_plane_modulus(C + volumetric, n))
        return None if mu <= 0 else cls(fraction, lmbda, mu, in_plane_modulus(C, n))


def sublayer_moduli(layer: SeamLayer, dt: float = 0.0) -> list[SublayerModuli]:
    """Return the moduli of each sublayer of a layer, after loads of some duration; [] if a tangent is unknown.

    Sublayers that do not resist shear are left out.

    Args:
        layer: the layer.
        dt: duration of the loads; 0: the moduli before loading.
    """
    n, sublayers = layer.initial_tangents.n, layer.initial_tangents.sublayers
    later_tangents = layer.initial_tangents.tangents_after(dt) if dt > 0 else [None] * len(sublayers)
    moduli: list[SublayerModuli] = []
    for (a, law, C), C_later in zip(sublayers, later_tangents, strict=True):
        if C is None and C_later is None:
            return []
        old, new = (None if tangent is None else SublayerModuli.of(a, law, tangent, n) for tangent in (C, C_later))
        if new and not (old and math.isclose(new.lmbda * old.mu, old.lmbda * new.mu, rel_tol=MODULUS_TOLERANCE)):
            new = replace(new, duration_text=f" under loads that last {dt:.4g}")
        moduli += [sublayer for sublayer in (new or old,) if sublayer]
    return moduli


def acts_as_springs(sublayers: list[SublayerModuli]) -> bool:
    """Tell whether a layer acts as separate springs between its faces: strains along S cause no stress in it.

    `sublayers` are the moduli of the layer's sublayers; the result is False for an empty list.
    """
    return bool(sublayers) and all(sublayer.E_plane <= NEGLIGIBLE_MODULUS_RATIO * sublayer.mu for sublayer in sublayers)


def jump_stiffness(layer: SeamLayer) -> tuple[float, float]:
    """Return the normal and the least tangential stiffness of a layer before loading, traction per jump.

    Both are 0 if a tangent of the law is unknown. Without shear stiffness the second number is 0, and the first one is
    not the stiffness of the layer.
    """
    n, compliances = layer.initial_tangents.n, np.zeros(2)
    for fraction, _, C in layer.initial_tangents.sublayers:
        if C is None:
            return 0.0, 0.0
        A = acoustic_tensor(C, n)
        tensor_size, normal_stiffness = float(np.abs(A).max()), float(n @ A @ n)
        shear_stiffness = float(np.linalg.eigvalsh((A + A.T) / 2 + 2 * tensor_size * np.outer(n, n))[0])
        if min(shear_stiffness, normal_stiffness) <= NEGLIGIBLE_MODULUS_RATIO * tensor_size:
            return normal_stiffness, 0.0
        compliances += [fraction / normal_stiffness, fraction / shear_stiffness]
    normal, tangential = 1 / (compliances * layer.as_thin_layer.eps)
    return float(normal), float(tangential)


JUMP_ROUNDING = 1e-9  # rounding error of jumps, relative to the displacements
Remark = tuple[str, str]  # key of a RangeWarning, and its message
SHEAR_MATRIX = np.array([[7.0, -8.0, 1.0], [-8.0, 16.0, -8.0], [1.0, -8.0, 7.0]])  # int u' v' times 3 h, degree 2
STRETCH_MATRIX = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]])  # int u v times 30/h, degree 2
MIN_OPENING_RATIO = 0.5  # least opening of the last tested state, relative to the largest opening
SUPPORT_HINT = "or support its sides if they are held"
STIFFNESS_ERROR_LIMIT = 0.1  # relative error of a layer's stiffness above which there is a warning


@dataclass(frozen=True)
class FaceDisplacements:
    """Displacements of the lower and upper face of a layer in a state of an interface model. Collective.

    They are given at the k corners of each of the n facets of the layer's seam. d is the number of dimensions, q the
    number of quadrature points on each facet.

    Attributes:
        surface: the mesh of the seam.
        state: the state.
        layer: the layer.
    """

    surface: SurfaceMesh
    state: State
    layer: SeamLayer

    @classmethod
    def of(cls, state: State, layer: SeamLayer) -> FaceDisplacements:
        """Return the displacements of the faces of `layer` in `state`, on the whole seam of the layer."""
        return cls(surface_of(state.model, layer.name), state, layer)

    @cached_property
    def sides(self) -> FloatArray:
        """Displacements (2, d, n, k) of the lower, then of the upper face at the k corners of n facets."""
        return self.surface.side_values(self.state.u, self.state.model, self.surface.corner_points)

    @property
    def jump_rounding(self) -> float:
        """Rounding error of jumps, a length in proportion to the largest displacement."""
        return JUMP_ROUNDING * float(np.abs(self.sides).max())

    @property
    def normal_jump(self) -> FloatArray:
        """Normal jumps [u_N], (n, k), at the k corners of n facets; positive if the faces move apart."""
        return np.asarray(((self.sides[1] - self.sides[0]) * self.surface.corner_points.n).sum(axis=0))

    @property
    def slip_squared(self) -> FloatArray:
        """Squares of the tangential jumps, (n, k), at the k corners of n facets, plus the square of `jump_rounding`."""
        slip = self.sides[1] - self.sides[0] - self.normal_jump * self.surface.corner_points.n
        return np.asarray((slip**2).sum(axis=0) + self.jump_rounding**2)

    @property
    def closing(self) -> FloatArray:
        """Approach -[u_N] of the faces, divided by the layer's thickness, (n, k), at the k corners of n facets."""
        return -self.normal_jump / self.surface.thickness(self.layer, self.surface.corners)

    @property
    def mean_closing(self) -> float:
        """Mean of `closing` over the seam, where openings count as zero."""
        surface = self.surface
        return float(surface.integral(surface.from_corners(np.maximum(self.closing, 0))) / surface.integral(1.0))

    @property
    def surface_divergence(self) -> FloatArray:
        """Surface divergence, (n, q), of the mean displacement of both faces, at the q quadrature points of n facets.

        The displacements are taken as linear between the corners.
        """
        surface, mean = self.surface, self.sides.mean(axis=0)
        radius = self.state.model.kinematics.axis_distances(surface.x.reshape(len(surface.x), -1).T)
        hoop_strains = surface.from_corners(mean[0]) / radius.reshape(surface.weights.shape)
        return np.asarray(np.einsum("dfk,fqkd->fq", mean, surface.quadrature.shape_gradients) + hoop_strains)


@dataclass(frozen=True)
class PressureExcess:
    """Relative errors of an interface law whose pressure is too large, as the law lets no material flow along S.

    p_0 is the pressure of the law, p that of the layer, and w_T the tangential jump. The layer's change of volume per
    area of S is wb = [u_N] + eps div_S <u>, with the mean displacement <u> of the faces.

    Attributes:
        opening_error: int (p_0 - p) wb/int p wb: the law is 1 + opening_error times too stiff against openings.
        work_error: int (p_0 - p) wb over the work of the layer including shear, int p wb + int mu/eps |w_T|^2.
        traction_error: L2 norm of p_0 - p over S, divided by that of the law's traction.
    """

    opening_error: float = 0.0
    work_error: float = 0.0
    traction_error: float = 0.0

    @property
    def reported(self) -> float:
        """Error that warnings report: `opening_error` if `traction_error` exceeds 0.1, otherwise `work_error`."""
        return self.opening_error if self.traction_error > STIFFNESS_ERROR_LIMIT else self.work_error


def times_too_stiff(state: State, layer: SeamLayer) -> float | None:
    """Return the factor by which an interface law overestimates the layer's stiffness against openings. Collective.

    It is 1 if the law lets material flow along S.

    Args:
        state: state of an interface model; its openings are those for which the stiffness is compared.
        layer: the layer.

    Returns:
        The factor. None: it cannot be computed; `Applicability.why_not("excess of pressure")` says why.
    """
    if state.model.applicability[layer.name].why_not("excess of pressure"):
        return None
    if layer.has_pressure_flow:
        return 1.0
    return 1 + pressure_excess(FaceDisplacements.of(state, layer), sublayer_moduli(layer)[0]).opening_error


def pressure_excess(faces: FaceDisplacements, layer: SublayerModuli) -> PressureExcess:
    """Return the relative errors of an interface law, from its pressure and that of the layer itself. Collective.

    The displacements of the faces are the same in both, with the mean <u>. The layer's change of volume per area of S
    is wb = [u_N] + eps div_S <u>. The pressure of the law is p_0 = lmbda wb/eps. The pressure p of the layer is
    continuous, of degree 1, and solves

        (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = wb, p = 0 at free ends, no flow through other ends.

    Free ends whose loss of stiffness the law contains (edges="free") count as other ends.

    Cells of size h may be longer than the length delta over which p falls to zero. Functions of degree 1 then have an
    outflow at free ends that is sqrt(1 + h^2/(12 delta^2)) times too large. A resistance at the free ends corrects
    this, so that the errors do not depend on h.

    On straight facets of a curved S, slip opens the layer at one end of a facet and closes it at the other. The law
    resists this too. `work_error` includes this resistance. For the other two errors, p_0 is made continuous like p, which
    excludes it. Openings as small as the rounding error of displacements count as zero.

    Args:
        faces: displacements of the layer's faces in a state of an interface model.
        layer: moduli of the layer.
    """
    if not layer.lmbda:
        return PressureExcess()
    surface, joint = faces.surface, faces.surface.joint
    eps = surface.from_corners(surface.thickness(faces.layer, surface.corners))
    normal_jump = surface.from_corners(faces.normal_jump)
    k_N, wb = layer.lmbda / eps, normal_jump + eps * faces.surface_divergence
    # the pressure is continuous where bodies branch
    vertices, number = np.unique(surface.vertices, return_inverse=True)
    expand = scipy.sparse.csc_matrix((np.ones(len(number)), (np.arange(len(number)), number)))
    b = expand.T @ surface.nodal_sums(surface.moments(wb))
    volume_matrix = expand.T @ surface.mass(1 / k_N) @ expand
    system = volume_matrix + expand.T @ surface.stiffness(eps**3 / (12 * layer.mu)) @ expand
    if not b @ b:  # also if the squares underflow
        return PressureExcess()
    rim = faces.state.model.applicability[faces.layer.name].uncorrected_rim
    rim_eps = surface.thickness(faces.layer, rim.vertices).mean(axis=1)
    resistance = layer.decay_length * (1 - 1 / np.sqrt(1 + (rim.depth / (layer.decay_length * rim_eps)) ** 2 / 12))
    conductance = surface.ridge_lengths(rim) * rim_eps**2 / (12 * layer.mu * resistance)
    rim_rows, k = np.searchsorted(vertices, joint.masters[rim.vertices]), rim.vertices.shape[1]
    outflow = np.bincount(rim_rows.ravel(), np.repeat(conductance / k, k), len(vertices))
    p = scipy.sparse.linalg.spsolve(system + scipy.sparse.diags_array(outflow.astype(float), format="csc"), b)
    p_0 = scipy.sparse.linalg.spsolve(volume_matrix, b)
    law_work, layer_work = float(surface.integral(k_N * wb**2)), float(b @ p)
    slip_squared_over_eps = surface.from_corners(faces.slip_squared) / eps
    work_error = (law_work - layer_work) / (layer_work + layer.mu * float(surface.integral(slip_squared_over_eps)))
    if surface.norm(surface.at_points(expand @ p_0) / k_N) <= faces.jump_rounding * math.sqrt(surface.integral(1.0)):
        return PressureExcess(work_error=work_error)
    t_N = surface.norm(k_N * wb + 2 * layer.mu * normal_jump / eps)
    t_T = layer.mu * math.sqrt(surface.integral(slip_squared_over_eps / eps))
    error_norm = surface.norm(surface.at_points(expand @ (p_0 - p)))
    return PressureExcess(float(b @ p_0) / layer_work - 1, work_error, error_norm / math.hypot(t_N, t_T))


# ---------------------------------------------------------------- warnings
def free_end_remark(model: Model, seam_layer: SeamLayer, moduli: Sequence[list[SublayerModuli]]) -> Iterator[Remark]:
    """Yield a warning if a nearly incompressible layer loses much stiffness at its free ends.

    Its pressure falls to zero there over the decay length delta of `pressure_decay_length`. Interface laws do not contain
    this effect. Between rigid faces a strip of half-width l carries only the fraction 1 - tanh(l/delta) delta/l of the
    load that the law predicts. The warning states the inverse of the smallest such fraction.

    Args:
        model: the interface model.
        seam_layer: the layer.
        moduli: for each of several durations of the loads, the moduli of the layer's sublayers.

    Yields:
        Key of the warning, and its message; at most one such pair.
    """
    moduli, rim = [s for s in moduli if any(k.rubbery for k in s)], model.applicability[seam_layer.name].uncorrected_rim
    if not moduli or not len(rim.vertices):
        return
    if any(k.decay_length == math.inf for sublayers in moduli for k in sublayers):
        text = f"{seam_layer} is incompressible: its law holds [u_N] at zero, but at free ends it is squeezed out"
        yield "incompressible", f"{text}; use order=1, mesh the layer (structure.full), {SUPPORT_HINT}"
        return
    surface, eps = surface_of(model, seam_layer.name), seam_layer.as_thin_layer.eps
    width = surface.integral(1.0) / surface.ridge_lengths(rim).sum()
    lengths = [pressure_decay_length(sublayers, width / eps) for sublayers in moduli]
    duration = max(moduli[lengths.index(max(lengths))], key=lambda k: k.decay_length).duration_text
    delta = eps * max(lengths)
    y = delta / width
    excess = 1 / (1 - math.tanh(1 / y) * y) - 1
    if excess > 1 / (1 - STIFFNESS_ERROR_LIMIT) - 1:
        text = f"{seam_layer} is nearly incompressible{duration}: its pressure falls to 0 at free ends over {delta:.3g}"
        area_text = f"{y:.2g} of the area of S over the length of these ends ({width:.3g})"
        ratio = max(k.lmbda / k.mu for sublayers in moduli for k in sublayers)
        effect = f"between rigid bodies its law is about {1 + excess:.3g} times too stiff against normal jumps"
        yield "free ends", f"{text}, {area_text}; {effect}; {_remedy(seam_layer, ratio)}, {SUPPORT_HINT}"


def pressure_decay_length(sublayers: list[SublayerModuli], width: float) -> float:
    """Return the length over which the pressure decays at a free end of S, divided by the layer's thickness.

    All sublayers have the same normal traction t, a function of the position along S. With derivatives along S, the
    normal jump is w = c t - B t''. So disturbances of t decay over the length delta = sqrt(B/c).

    c is the sum of the sublayers' compliances. B t'' is the contribution of material that flows along S. A slope t'
    drives nearly incompressible sublayers; these shear and stretch the other sublayers, which resist. B follows from
    the displacements along S that minimise the energy, as polynomials of degree 2 through each sublayer. For a single
    sublayer delta is its `decay_length`.

    Args:
        sublayers: moduli of the sublayers, from the lower to the upper face.
        width: distance along S over which the material flows, divided by the layer's thickness.
    """
    n_nodes = 2 * len(sublayers) + 1
    A, b = np.zeros((n_nodes, n_nodes)), np.zeros(n_nodes)
    for k, ply in enumerate(sublayers):
        at = slice(2 * k, 2 * k + 3)
        A[at, at] += ply.mu / (3 * ply.fraction) * SHEAR_MATRIX
        if ply.rubbery:
            b[at] += math.sqrt(ply.lmbda / (ply.lmbda + 2 * ply.mu)) * ply.fraction / 6 * np.array([1.0, 4.0, 1.0])
        else:
            A[at, at] += 3 / width**2 * max(ply.E_plane, 0.0) * ply.fraction / 30 * STRETCH_MATRIX
    inside = slice(1, -1)  # the displacements of the faces are zero
    flow = float(b[inside] @ np.linalg.solve(A[inside, inside], b[inside]))
    return math.sqrt(flow / sum(ply.compliance for ply in sublayers))


def stiffness_remark(seam_layer: SeamLayer, states: Sequence[State], start: float | None) -> Iterator[Remark]:
    """Yield a warning if an interface law is much too stiff for the openings in states.

    Interface laws of nearly incompressible layers are too stiff if they let no material flow along S. Two states are
    tested: the one with the largest opening, and the last one with at least half that opening. The second is tested
    because laws that creep or relax become nearly incompressible with time.

    Args:
        seam_layer: the layer.
        states: states of an interface model, in the order of their times.
        start: time at which the loads begin to act; None: the layer's moduli before loading are used.

    Yields:
        Key of the warning, and its message; at most one such pair.
    """
    has_excess = not states[0].model.applicability[seam_layer.name].why_not("excess of pressure")
    if not (has_excess or seam_layer.law.traits.compiled or any(k.rubbery for k in sublayer_moduli(seam_layer))):
        return  # tangents of other laws do not change in time
    openings = [float(np.abs(FaceDisplacements.of(state, seam_layer).normal_jump).max()) for state in states]
    last_tested = max(k for k, opening in enumerate(openings) if opening >= MIN_OPENING_RATIO * max(openings))
    rows = []
    for state in (states[k] for k in sorted({openings.index(max(openings)), last_tested})):
        sublayers = sublayer_moduli(seam_layer, 0.0 if start is None else state.t - start)
        if len(sublayers) == 1 and (has_excess or sublayers[0].rubbery) and sublayers[0].decay_length < math.inf:
            rows.append((pressure_excess(FaceDisplacements.of(state, seam_layer), sublayers[0]).reported, sublayers[0]))
    worst, layer = max(rows, key=lambda pair: pair[0], default=(0.0, None))
    if layer and worst > STIFFNESS_ERROR_LIMIT:
        ratio = layer.lmbda / layer.mu
        subject = f"has lmbda/mu = {ratio:.4g}, and lets no material flow along S: for these jumps"
        effect = f"the layer alone is {1 + worst:.4g} times too stiff, the structure less if bodies are soft"
        yield "too stiff", f"{seam_layer}{layer.duration_text} {subject} {effect}; {_remedy(seam_layer, ratio)}"


def _remedy(layer: SeamLayer, lame_ratio: float) -> str:
    """Return what to do about a layer that is too stiff, whose largest lmbda/mu is `lame_ratio`."""
    if layer.remembers or len(layer.law.sublayers) > 1:
        return "mesh the layer (structure.full; forms.Rubber has no memory, and is no sublayer)"
    law = "" if lame_ratio <= LOCKING_RATIO else "forms.Rubber with "
    return f"use {law}order=1, or mesh the layer (structure.full)"
