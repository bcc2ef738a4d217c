"""Stiffness of layers, and errors of those interface laws that let no material of a soft layer flow along S."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
from thinlayer.discretisation.state import State
from thinlayer.surface.law_points import law_tractions
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

# length of the pressure, over the thickness, up to which it has no effect along S; the length of nu = 3/8
NEARLY_INCOMPRESSIBLE_LENGTH = 0.5
INCOMPRESSIBLE_BULK_RATIO = 1e8  # bulk modulus that represents incompressibility, relative to the tangent
NEGLIGIBLE_MODULUS_RATIO = 1e-9  # modulus or stiffness, relative to others of the layer, that counts as zero


@dataclass(frozen=True)
class SublayerModuli:
    """Moduli of a layer, or of one sublayer of a `Stack`, before loading or after loads of some duration.

    Attributes:
        fraction: fraction of the layer's thickness that the sublayer has; 1 for a whole layer.
        lmbda, mu: Lame moduli, stresses. They are effective moduli after the duration if the law's response depends on
            it, otherwise those before loading.
        E_plane: modulus, a stress, of the sublayer as a sheet along S with free faces; for isotropic laws E/(1 - nu^2).
    """

    fraction: float
    lmbda: float
    mu: float
    E_plane: float

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
    tangents = [C if C_later is None else C_later for (*_, C), C_later in zip(sublayers, later_tangents, strict=True)]
    rows = zip(sublayers, tangents, strict=True)
    moduli = [None if C is None else SublayerModuli.of(a, law, C, n) for (a, law, _), C in rows]
    return [] if any(C is None for C in tangents) else [*filter(None, moduli)]


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
# jump that order 0 leaves out, over the jump, above which there is a warning. Of 185 layers that were also meshed 136 warn,
# all with errors of jump or traction above 4 %; of 140 with errors above 10 % 10 do not warn, with errors up to 18 %, 6 of
# them with the warning "too stiff". Of 144 incompressible ones between rollers 111 warn, among them all 108 above 10 %
JUMP_ERROR_LIMIT = 0.1
# error of the traction, see `pressure_excess`, above which there is a warning. Of 156 layers that were also meshed, 88
# warn, 87 of them with errors above 5 %; of the others none has an error of the work of loads above 10 %
TRACTION_ERROR_LIMIT = 0.05


@dataclass(frozen=True)
class FaceDisplacements:
    """Displacements of the lower and upper face of a layer in a state of an interface model. Collective.

    They are given at the k corners of each of the n facets of the layer's seam. d is the number of dimensions, q the
    number of quadrature points on each facet.

    Attributes:
        state: the state.
        layer: the layer.
    """

    state: State
    layer: SeamLayer

    @property
    def surface(self) -> SurfaceMesh:
        """The mesh of the whole seam of the layer."""
        return surface_of(self.state.model, self.layer.name)

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
        """Squares of the tangential jumps, (n, k), at the k corners of n facets."""
        slip = self.sides[1] - self.sides[0] - self.normal_jump * self.surface.corner_points.n
        return np.asarray((slip**2).sum(axis=0))

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

    @cached_property
    def jump_norm(self) -> float:
        """L2 norm of the jump of displacements."""
        return self.surface.norm(self.surface.from_corners(self.sides[1] - self.sides[0]))

    def left_out_norm(self, sublayers: list[SublayerModuli]) -> float:
        """Return the L2 norm of what a law of order 0 leaves out of the jump under the same traction.

        With the mean displacement <u> of the faces, the layer's strain has a part along S. The traction of this part
        vanishes with the jump -eps (a div_S <u> n + grad_S <u_N>), where a = lmbda/(lmbda + 2 mu).

        The pressure p of an incompressible layer drives a flow along S, which opens it by
        div_S(eps^3/(12 mu) grad_S p) if its sides are not free. Its law holds [u_N] at zero.

        Args:
            sublayers: moduli of the layer's sublayers.
        """
        surface, layer, applicability = self.surface, self.layer, self.state.model.applicability[self.layer.name]
        eps = surface.at_points(surface.thickness(layer, surface.vertices))
        gradients, n = surface.quadrature.shape_gradients, surface.n
        share = sum(ply.fraction - 2 * ply.mu * ply.compliance for ply in sublayers)
        turns = np.einsum("dfk,fqke,dfq->efq", self.sides.mean(axis=0), gradients, n)
        left_out = eps * (share * self.surface_divergence * n + turns)
        if [ply.decay_length for ply in sublayers] == [math.inf] and not len(applicability.uncorrected_rim.vertices):
            p = surface.nodal((surface.at_points(law_tractions(surface, self.state)) * n).sum(axis=0))
            flow = surface.stiffness(eps**3 / (12 * sublayers[0].mu)) @ p
            left_out += surface.at_points(flow / surface.areas) * n
        return surface.norm(left_out)


def pressure_excess(state: State, layer: SeamLayer, sublayers: list[SublayerModuli]) -> tuple[float, float]:
    """Return by how much too stiff an interface law is that lets no material of a layer flow along S. Collective.

    With the mean <u> of the faces' displacements, the layer's change of volume per area of S is
    wb = [u_N] + eps div_S <u>. The pressure of the law is p_0 = wb/(c eps), with the compliance c of the sublayers. The
    pressure p of the layer with the same displacements of its faces is continuous, of degree 1, and solves

        c eps p - div_S(c eps delta^2 grad_S p) = wb, p = 0 at free ends, no flow through other ends,

    with the length delta of `pressure_decay_length`. Free ends whose loss of stiffness the law contains (edges="free")
    count as other ends. p_0 is made continuous too: slip on straight facets of a curved S opens and closes them.

    Cells of size h may be longer than delta. Functions of degree 1 then have an outflow at free ends that is
    sqrt(1 + h^2/(12 delta^2)) times too large. A resistance at the free ends corrects this.

    Args:
        state: state of an interface model.
        layer: the layer.
        sublayers: moduli of its sublayers.

    Returns:
        int (p_0 - p) wb/int p wb: the relative error of the stiffness against openings; and the L2 norm of p_0 - p over
        that of the law's traction. Openings as small as the rounding error of displacements have no error.
    """
    faces = FaceDisplacements(state, layer)
    surface, joint = faces.surface, faces.surface.joint
    area, eps = float(surface.integral(1.0)), surface.thickness(layer, surface.vertices)
    eps_at_points, compliance = surface.at_points(eps), eps * sum(ply.compliance for ply in sublayers)
    rim = state.model.applicability[layer.name].uncorrected_rim
    rim_lengths, node_of_vertex = surface.ridge_lengths(rim), np.zeros(len(joint.points), int)
    node_of_vertex[surface.vertices] = np.arange(len(surface.vertices))
    rim_nodes = node_of_vertex[joint.masters[rim.vertices]]
    width = area / (layer.eps * rim_lengths.sum()) if len(rim_lengths) else math.inf
    delta = eps * pressure_decay_length(sublayers, width)
    rim_delta, rim_compliance = delta[rim_nodes].mean(axis=1), compliance[rim_nodes].mean(axis=1)
    conductance = rim_compliance * rim_delta / (1 - 1 / np.sqrt(1 + (rim.depth / rim_delta) ** 2 / 12))
    outflow = np.zeros(len(eps))
    np.add.at(outflow, rim_nodes, (rim_lengths * conductance / rim_nodes.shape[1])[:, None])
    volume_matrix = surface.mass(surface.at_points(compliance))
    flow_matrix = surface.stiffness(surface.at_points(compliance * delta**2)) + scipy.sparse.diags_array(outflow)
    b = surface.nodal_sums(
        surface.moments(surface.from_corners(faces.normal_jump) + eps_at_points * faces.surface_divergence)
    )
    p_0, p = (scipy.sparse.linalg.spsolve(A.tocsc(), b) for A in (volume_matrix, volume_matrix + flow_matrix))
    if surface.norm(surface.at_points(compliance * p_0)) <= faces.jump_rounding * math.sqrt(area):
        return 0.0, 0.0
    shear_compliance = eps_at_points * sum(ply.fraction / ply.mu for ply in sublayers)
    t_T = math.sqrt(surface.integral(surface.from_corners(faces.slip_squared) / shear_compliance**2))
    error_norm, t_N = (surface.norm(surface.at_points(field)) for field in (p_0 - p, p_0))
    return float(b @ p_0 / (b @ p)) - 1, error_norm / math.hypot(t_N, t_T)


def order_0_remark(layer: SeamLayer, states: Sequence[State], sublayers: list[SublayerModuli]) -> Iterator[Remark]:
    """Yield a warning (key, text) if jumps that order 0 leaves out are large beside those of a law of order 0.

    The state with the largest jumps is tested: where jumps pass through zero, all of them is left out.

    Args:
        layer: the layer.
        states: states of an interface model.
        sublayers: moduli of the layer's sublayers.
    """
    if layer.as_thin_layer.order or not sublayers or acts_as_springs(sublayers):
        return
    faces = max((FaceDisplacements(state, layer) for state in states), key=lambda faces: faces.jump_norm)
    if faces.jump_norm <= faces.jump_rounding * math.sqrt(faces.surface.integral(1.0)):
        return
    if (ratio := faces.left_out_norm(sublayers) / faces.jump_norm) > JUMP_ERROR_LIMIT:
        text = f"at t = {faces.state.t:.4g} order 0 leaves out jumps of {layer} that are {ratio:.2g} of its own"
        remedy = "use order=1, or see estimate(state)"
        yield "order 0", f"{text}, from strains, turns and flow along S: an error of jump or traction; {remedy}"


def pressure_decay_length(sublayers: list[SublayerModuli], width: float) -> float:
    """Return the length over which the pressure decays at a free end of S, divided by the layer's thickness.

    All sublayers have the same normal traction t, a function of the position along S. With derivatives along S, the
    normal jump is w = c t - B t''. So disturbances of t decay over the length delta = sqrt(B/c).

    c is the sum of the sublayers' compliances. B t'' is the contribution of material that flows along S. A slope t'
    drives nearly incompressible sublayers; these shear and stretch the other sublayers, which resist. B follows from
    the displacements along S that minimise the energy, as polynomials of degree 2 through each sublayer. For a single
    sublayer this is its `decay_length`.

    Args:
        sublayers: moduli of the sublayers, from the lower to the upper face.
        width: distance along S over which the material flows, divided by the layer's thickness.
    """
    if len(sublayers) == 1:
        return sublayers[0].decay_length
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


def stiffness_remark(layer: SeamLayer, states: Sequence[State], start: float | None) -> Iterator[Remark]:
    """Yield a warning if an interface law is much too stiff, as it lets no material of the layer flow along S.

    Three states are tested: the first with an opening, the one with the largest opening, and the last one with at least
    half of it. Laws that creep or relax may be nearly incompressible at some times only.

    Args:
        layer: the layer.
        states: states of an interface model, in the order of their times.
        start: time at which the loads begin to act; None: the layer's moduli before loading are used.

    Yields:
        Key of the warning, and its message; at most one such pair.
    """
    if not (layer.law.traits.linear or any(ply.rubbery for ply in sublayer_moduli(layer))):
        return  # tangents of non-linear laws do not change in time
    openings = [float(np.abs(FaceDisplacements(state, layer).normal_jump).max()) for state in states]
    opened = [k for k, opening in enumerate(openings) if opening >= MIN_OPENING_RATIO * max(openings)]
    first = next((k for k, opening in enumerate(openings) if opening > 0), 0)
    rows = []
    for state in (states[k] for k in sorted({first, openings.index(max(openings)), opened[-1]})):
        sublayers = sublayer_moduli(layer, 0.0 if start is None else state.t - start)
        flowing = [ply for ply in sublayers if ply.rubbery or (layer.law.traits.linear and len(sublayers) == 1)]
        ply = max(flowing, key=lambda ply: ply.decay_length, default=None)
        if ply and 0 < ply.decay_length < math.inf and not acts_as_springs(sublayers):
            rows.append((*pressure_excess(state, layer, sublayers), ply.lmbda / ply.mu, state.t))
    rows = [row for row in rows if min(row[0] - STIFFNESS_ERROR_LIMIT, row[1] - TRACTION_ERROR_LIMIT) > 0]
    for excess, _, ratio, t in sorted(rows, reverse=True)[:1]:
        text = f"at t = {t:.4g} {layer} has lmbda/mu = {ratio:.4g}, and lets no material flow along S"
        effect = f"for these jumps the layer is {1 + excess:.4g} times too stiff, the structure less if bodies are soft"
        yield "too stiff", f"{text}: {effect}; see estimate(state), {_remedy(layer, ratio)}, {SUPPORT_HINT}"


def _remedy(layer: SeamLayer, lame_ratio: float) -> str:
    """Return what to do about a layer that is too stiff, whose largest lmbda/mu is `lame_ratio`."""
    if layer.remembers or len(layer.law.sublayers) > 1:
        return "mesh the layer (structure.full; forms.Rubber has no memory, and is no sublayer)"
    law = "" if lame_ratio <= LOCKING_RATIO else "forms.Rubber with "
    return f"use {law}order=1, or mesh the layer (structure.full)"
