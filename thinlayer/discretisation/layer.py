"""Layers: laws with a thickness, or on S alone, and the data of a layer on its seam before discretisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from forms.base import Array, InputError, is_finite, is_number, require
from forms.contact import ContactLaw
from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights
from forms.kinematics import Kinematics, ScalarField
from forms.law import BulkLaw, Law
from forms.law_tangents import declared_or_computed_tangent, is_checked_at_rest, require_stable, tangent_after
from forms.tensors import average_lame
from forms.traction import TractionLaw
from forms.work import Interface
from geometry.domain import Domain
from geometry.joint import Joint, Profile
from geometry.seam import FacetName, S
from geometry.sheet import Rim, Sheet, StraightEnd, continued_ridge_keys, fraction_below
from geometry.topology import FloatArray, ridge_keys
from thinlayer.discretisation.boundary import AXIS_NAMES, nodes_on_axis, side_normals
from thinlayer.discretisation.coefficient import LoadInput
from thinlayer.discretisation.form_compilation import law_with_constants
from thinlayer.discretisation.key import CONTACT_KIND, LAYER_KIND, Key
from thinlayer.discretisation.prescribed_strains import EigenstrainInput
from thinlayer.errors import Violation
from thinlayer.system.fingerprint import describe

NO_END = 1e3  # distance of the nearest end, over the size of the joint, where there is no end

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

SQUARED_COSINE_TOLERANCE = 1e-6  # tolerance of squared cosines between directions
FLAT_SQUARED_COSINE = 1e-3  # squared cosine up to which directions count as orthogonal: within 2 degrees
CURVED_SQUARED_COSINE = 0.03  # the same for curved S, from which straight facets deviate by 10 degrees
BODIES = "bodies"  # name of all bodies together, among the names of seams
EDGE_CHOICES = (None, "free", "plain")
SurfaceLaw = TractionLaw | ContactLaw  # laws without a thickness: of jumps, or at nodes


@dataclass(frozen=True)
class ThinLayer:
    """A soft layer between two bodies, or between a body and a rigid base.

    Attributes:
        law: the law of the layer's material. Sublayers in series: `Stack((fraction, law), ...)` from the lower to the
            upper face.
        eps: thickness, a length > 0; if the thickness varies along S, it is eps times the profile.
        at: thickness for which the parameters of `law` are given, a length > 0; None: eps. In a layer of thickness eps
            they are multiplied by (eps/at)**power, see `BulkLaw.powers`. Layers with the same `at` and smaller and
            smaller eps have the same interface law of order 0.
        order: order of the interface law; by default 0, and 1 for laws of a scalar field. Order 0 is the limit for thin
            layers, with error O(eps). Order 1 adds the next power of eps. Its error is O(eps^2) where the sides of the
            layer are on rollers, and away from free ends that are corrected, see `edges`. Order 1 needs
            bodies="extended" where S is curved or the thickness varies, and for laws of strains elements of degree 2
            and a Stack of `LinearElastic` alone. Laws of strains other than `LinearElastic`, `Rubber` and
            `Incompressible` need lmbda/mu <= 12 under small strains from rest. Order 2 exists for laws of a scalar
            field alone, see `Conduction`: the mean value through the layer is a further unknown.
        profile: shape of a thickness that varies along S, a numpy function of coordinates x (d, n) that returns n
            numbers > 0. The thickness at the vertices of S is eps * profile(x), linear in between. The law's parameters
            do not vary with it.
        eigenstrain: strain that the layer would have without stress, uniform through the thickness unless it follows a
            temperature of both sides. It is a number times the identity, a symmetric table, a function (x, t),
            `ThermalExpansion`, `Prestress`, or a list of these that add up. On S it is subtracted from the strain of
            the jump, the symmetric part of [u] (x) n/eps. In the tractions of a soft layer it is therefore a term of
            order eps, unless it is as large as [u]/eps.
        edges: correction of the interface law of order 1 for the lower stiffness near straight free ends of S
            (`forms.ends.weights`). With it the error is O(eps^2) away from these ends too. It exists for
            `LinearElastic` with nu from 0 to 0.45, `Rubber` and `Incompressible`, between much stiffer bodies. None:
            applied where it exists (`InterfaceModel.free_ends` has the reason if not). "free": always applied; an error
            where it does not exist. "plain": never applied.

    Raises:
        InputError: a law of jumps or of nodes, which needs no `ThinLayer`; eps, at, order, profile or edges out of
            range; order 1 of a law that has no interface law of order 1.

    Example:
        >>> from forms import LinearElastic, Stack
        >>> from thinlayer import ThinLayer
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> primer = LinearElastic.young(E=500.0, nu=0.3)
        >>> ThinLayer(Stack((0.9, glue), (0.1, primer)), eps=0.05, order=1).fractions
        (0.9, 0.1)
        >>> wedge = lambda x: 1 + 0.1 * x[0]
        >>> swelling = ThinLayer(glue, eps=0.05, profile=wedge, eigenstrain=1e-3)
    """

    law: BulkLaw
    eps: float
    order: int = None  # type: ignore[assignment]  # the law's `default_order`
    profile: Profile | None = None
    eigenstrain: EigenstrainInput | None = None
    edges: str | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        hint = "it must be a law of strains; a law on S, without a thickness, stands alone: interface(law)"
        require(isinstance(self.law, BulkLaw), "the layer's law", self.law, hint)
        first_law, *other_laws = (law for _, law in self.law.sublayers)
        if first_law.traits.linear and all(law == first_law for law in other_laws):
            object.__setattr__(self, "law", first_law)
        _check_thickness("layer's thickness eps", self.eps)
        if self.at is not None:
            _check_thickness("thickness at which the law's parameters hold, at,", self.at)
        order = self.law.default_order if self.order is None else self.order
        require(is_number(order) and order in (0, 1, 2), "the order of the interface law", order, "allowed: 0, 1, 2")
        object.__setattr__(self, "order", int(order))
        if self.order == 2:
            hint = "order 2 is of laws of a scalar field without sublayers; use order=1, or mesh the layer"
            is_single = self.law.unknown == ScalarField.unknown and not self.fractions
            require(is_single, "order=2 of the law", self.law, hint)
        elif self.order == 1:
            self.law.stations()  # raises errors of laws without order 1
        require(self.profile is None or callable(self.profile), "the profile", self.profile, "give a function of x")
        require(self.edges in EDGE_CHOICES, "edges", self.edges, f"allowed: {', '.join(map(repr, EDGE_CHOICES))}")
        if self.law.unknown == ScalarField.unknown:
            for name in ("eigenstrain", "edges"):
                reason = f"it is of displacements, and {type(self.law).__name__} is a law of a {self.law.unknown}"
                require(getattr(self, name) is None, name, getattr(self, name), reason)

    @property
    def material(self) -> BulkLaw:
        """The law with its parameters for the thickness eps, scaled from those given for the thickness `at`."""
        return self.law.scaled(1.0 if self.at is None else float(self.eps) / float(self.at))

    @property
    def fractions(self) -> tuple[float, ...]:
        """Thicknesses of the sublayers, from the lower to the upper, over that of the layer; () for a single layer."""
        return tuple(a for a, _ in self.law.sublayers if a != 1)


@dataclass(frozen=True)
class Gap:
    """An open seam of some width: no forces act between its sides, and nothing prevents their overlap.

    In a meshed model the width stays empty. An interface model ignores the width, so that `Gap(eps)` and None, which
    also leaves a seam open, have the same effect there.

    Attributes:
        eps: width, a length > 0.

    Raises:
        InputError: eps out of range.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import faults
        >>> from thinlayer import Gap, Structure, ThinLayer, solve
        >>> joint = faults(4, 2, {"A": [(1, 1), (2, 1)], "B": [(2, 1), (3, 1)]}, h=0.5)
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> block = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (0, 10)}
        ... )
        >>> state = solve(block.interface({"A": ThinLayer(glue, eps=0.05), "B": Gap(0.05)}))
        >>> sorted(state.energies())
        ['bodies', 'layer', 'layer A', 'loads']
    """

    eps: float

    def __post_init__(self) -> None:
        _check_thickness("gap's width eps", self.eps)


@dataclass(frozen=True)
class SurfaceSource:
    """A source of a scalar per area of a layer, for `Structure(sources={"S": ...})`: such as the heat of friction.

    At a height z it goes by 1/2 + z into the upper side of S, by 1/2 - z into the lower one. So the share beta of the
    upper side is that of z = beta - 1/2. The seam's law may also be one without a thickness.

    Attributes:
        power: source per area: a number, a function (x, t), or `Surface.function` of another model's results.
        height: place across the layer over its thickness, from -1/2 at the lower to 1/2 at the upper face. A meshed
            layer, through which the source is uniform, needs 0.

    Raises:
        InputError: height out of range, or power that is no number or function.
    """

    power: Any
    height: float = 0.0

    def __post_init__(self) -> None:
        is_value = callable(self.power) or is_finite(self.power)
        require(is_value, "power of a SurfaceSource", self.power, "give a number or a function")
        is_height = is_finite(self.height) and abs(self.height) <= 0.5
        require(is_height, "height of a SurfaceSource", self.height, "allowed: from -1/2 to 1/2")


@dataclass(frozen=True)
class Bond:
    """A perfect bond in place of a layer: both sides of its seam have the same displacements.

    On a rigid base, the side of the body is fixed. Only interface models accept a bond. For a meshed model, make a
    joint in which the bodies are connected, without this seam.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Bond, Structure, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> f"{solve(plates.interface(Bond())).energies()['bodies']:.3g}"
        '0.00381'
    """


Layer = ThinLayer | SurfaceLaw
SeamContent = Layer | Gap | Bond | None
Layers = Layer | Bond | Mapping[str, SeamContent]


def _check_thickness(what: str, eps: float) -> None:
    require(is_finite(eps) and eps > 0, f"the {what}", eps, "allowed: > 0")


def law_with_numbers(layer: Layer, kinematics: Kinematics) -> BulkLaw:
    """Return a layer's law for strains of given kinematics; its parameters are numbers or functions of the place."""
    return kinematics.law(layer.material) if isinstance(layer, ThinLayer) else layer.as_bulk_law()


def law_of_terms(law: BulkLaw, mesh: Mesh) -> BulkLaw:
    """Return a law in the form that integrals over S need.

    In a law in UFL forms the parameters become DOLFINx Constants. A compiled law is unchanged. A law with functions of
    the place as parameters becomes a compiled law.
    """
    return law.compiled_copy() if law.fields else law_with_constants(law, mesh)


def conductivities_of(tangents: Sequence[Array], n: Array) -> tuple[Array, Array]:
    """Return the conductivities (k,) of k tangents (6, 6) across S, with the normal `n` (d,), and the largest along S."""
    n = np.pad(n, (0, 3 - len(n)))
    K = np.array([(C[:3, :3] + C[:3, :3].T) / 2 for C in tangents])
    projector = np.eye(3) - np.outer(n, n)
    return np.einsum("i,kij,j->k", n, K, n), np.linalg.eigvalsh(projector @ K @ projector)[:, -1]


class InitialTangents:
    """Tangents (derivatives of stress by strain) of the laws of a layer's sublayers at zero strain, before any loading.

    Args:
        law: law of the layer, with numbers as parameters.
        n: mean unit normal of S, (d,) in d dimensions.

    Attributes:
        sublayers: (fraction of the thickness, law, tangent) of each sublayer, or of the layer if it has no sublayers.
            The tangent is a matrix (6, 6) in Mandel's notation, or None if it is not known.
    """

    def __init__(self, law: BulkLaw, n: Array) -> None:
        self.law, self.n, self._by_duration = law, n, dict[float, list[Array | None]]()
        self.sublayers = [(a, material, declared_or_computed_tangent(material, n)) for a, material in law.sublayers]

    def tangents_after(self, dt: float) -> list[Array | None]:
        """Return the stiffness (6, 6) of each sublayer, after creep or relaxation, under loads that last for dt.

        dt is a time > 0. An entry is None if the law is not linear or cannot be evaluated, or if the stiffness is the
        initial tangent for all dt.
        """
        if dt not in self._by_duration:
            laws = [law for _, law, _ in self.sublayers]
            self._by_duration[dt] = [tangent_after(law, self.n, dt) if law.traits.compiled else None for law in laws]
        return self._by_duration[dt]

    def require_stable(self) -> None:
        """Raise InputError if the initial stiffness of a sublayer is negative, because equilibria would be unstable."""
        for _, law, C in self.sublayers:
            if is_checked_at_rest(law):
                require_stable(law, C, self.n)

    @property
    def conductivities(self) -> tuple[Array, Array, Array]:
        """Fractions (k,) of a scalar field's k sublayers, their conductivities across S, and largest ones along S."""
        tangents = [np.eye(6) if C is None else C for _, _, C in self.sublayers]
        return np.array([a for a, *_ in self.sublayers]), *conductivities_of(tangents, self.n)

    def locking_violation(self) -> Violation | None:
        """Return why the interface law of order 1 is much too stiff (it locks); None if it is not.

        It takes displacements as linear through the layer, and so locks if lmbda/mu of a sublayer is large.
        """
        max_ratio = min(station.max_lame_ratio for station in self.law.stations())
        for _, law, C in self.sublayers:
            lmbda, mu = (0.0, 1.0) if C is None else average_lame(C)
            if lmbda > max_ratio * mu:
                ratio_text, most = (f"{x:.4g} (nu = {x / (x + 1) / 2:.4f})" for x in (lmbda / mu, max_ratio))
                reason = f"order=1 of {type(law).__name__} with lmbda/mu = {ratio_text} at rest locks; allowed: {most}"
                is_elastic = not (law.traits.remembers or law.traits.rate)
                alternative = ", or Rubber or LinearElastic if it is isotropic" if is_elastic else ""
                return Violation("locks", reason, f"use order=0, or mesh the layer (structure.full){alternative}")
        return None


class SeamLayer:
    """A layer on its seam, or a law of jumps or of nodes there.

    Attributes:
        name: name of the seam.
        layer: the layer as the user wrote it.
        structure: the structure, with the joint and the laws of the bodies.
        law: the law as the user wrote it.
        law_name: name of the law's class.
        thin_layer: the layer if it is a `ThinLayer`, with a law of strains; else None.
        contact: the law if it is a contact law, which acts at nodes; else None.
        remembers: whether the law depends on its history, and may dissipate energy.
        has_pressure_flow: whether the interface law is of order 1 and has a pressure, which causes a flow along S.
        key: key of the law's memory and stored energy; it contains the seam's name if the joint has several seams.
            Several terms of one layer have the keys "layer NAME/1", "layer NAME/2", ...; names of seams have no slash.

    Raises:
        InputError: `layer` is not a layer.
    """

    def __init__(self, name: str, layer: Layer, structure: Structure) -> None:
        if not isinstance(layer, ThinLayer | SurfaceLaw):
            remedy = "give ThinLayer(law, eps), or a law of jumps or contact"
            raise Violation("no layer", f"the layer is {layer!r}", remedy).error()
        self.name, self.layer, self.structure = name, layer, structure
        self.law: Law = layer.law if isinstance(layer, ThinLayer) else layer
        self.thin_layer = layer if isinstance(layer, ThinLayer) else None
        self.contact = layer if isinstance(layer, ContactLaw) else None
        self.law_name, traits = type(self.law).__name__, self.law.traits
        self.remembers = traits.rate or traits.remembers
        self.has_pressure_flow = isinstance(layer, ThinLayer) and layer.order == 1 and traits.constrained
        seam_name = name if len(structure.joint.seams) > 1 else ""
        self.key = str(Key(CONTACT_KIND if self.contact else LAYER_KIND, seam_name))

    def __str__(self) -> str:
        return f"the layer {self.name!r}" if len(self.structure.joint.seams) > 1 else "the layer"

    def owns_key(self, key: str) -> bool:
        """Return whether the key of a memory or an energy belongs to a law of this layer, or to its pressure."""
        return Key.parse(key).belongs_to(Key.parse(self.key))

    @property
    def bubble_key(self) -> str:
        """Key of the bubble amplitude in states, if the interface law is of order 2."""
        return str(Key.parse(self.key).bubble_key)

    @property
    def as_thin_layer(self) -> ThinLayer:
        """The layer as a `ThinLayer`; not for a law of jumps or of nodes."""
        assert self.thin_layer is not None
        return self.thin_layer

    @property
    def eps(self) -> float:
        """Thickness of a `ThinLayer`; if it varies along S, the length that the profile multiplies."""
        return float(self.as_thin_layer.eps)

    @cached_property
    def sheet(self) -> Sheet:
        """The seam, divided into straight segments in 2D or triangles in 3D."""
        return Sheet(self.structure.joint, self.name)

    @cached_property
    def side_kinds(self) -> npt.NDArray[np.str_]:
        """Words for each of the n ridges where the seam ends: how the layer's side is constrained there.

        The side is the layer's own boundary, between its two faces. Its displacement has a component along m, outward
        along S, and one along n, across S. Supports, multi-point constraints and an axis of revolution may constrain
        them. The words (n,) are:

            - "free": neither component is constrained
            - "held": both are
            - "symmetric": only that along m is, as in a plane of symmetry
            - "antisymmetric": only that along n is
            - "oblique": a direction between m and n is constrained.

        Constraints along the end itself do not matter.
        """
        sheet, projectors = self.sheet, self.held_projectors()
        normals = sheet.joint.interface_normals[sheet.rim.facet]
        sq_cosines = np.stack(
            [np.einsum("ni,nij,nj->n", e, projectors, e) for e in (sheet.rim.outward, normals)], axis=1
        )
        tolerance = FLAT_SQUARED_COSINE if sheet.planar else CURVED_SQUARED_COSINE
        m_held, n_held = (sq_cosines > tolerance).T
        kinds = np.array([["free", "antisymmetric"], ["symmetric", "held"]])[m_held.astype(int), n_held.astype(int)]
        return np.where(((sq_cosines <= tolerance) | (sq_cosines >= 1 - tolerance)).all(axis=1), kinds, "oblique")

    def held_projectors(self, of_layer: bool = True) -> FloatArray:
        """Return projections (n, d, d) onto the directions in which the layer's side cannot move, at the n ridges.

        The side is the layer's own boundary at a ridge where S ends.

        Args:
            of_layer: whether constraints of facet sets "NAME/LAYER" count too; such a set is the part of the facet set
                NAME on the layer's own side.
        """
        structure, rim, joint = self.structure, self.sheet.rim, self.sheet.joint
        d, rim_keys, axes = joint.dim, ridge_keys(rim.vertices), AXIS_NAMES[: joint.dim]
        dyads = np.zeros((len(rim_keys), d, d))
        dyads[nodes_on_axis(structure.kinematics, joint)[rim.vertices].all(axis=1)] = np.eye(d)
        entries = [
            (place, [*value] if isinstance(value, Mapping) else axes) for place, value in structure.supports.items()
        ]
        mpc_parts = [part for part in structure.parts if part.has_constraint]
        for place, components in [*entries, *((part.place, part.components or axes) for part in mpc_parts)]:
            name = FacetName.parse(place).continued_set if isinstance(place, str) else S
            if name in (S, *joint.seams) or name not in joint.facets or (name != place and not of_layer):
                continue  # a vertex, the side of one body, or that of the layer
            on_rim = np.isin(rim_keys, continued_ridge_keys(joint, joint.facets[name]))
            for axis in components:
                direction = np.eye(d)[axes.index(axis)] if axis in axes else _rim_normals(joint, rim, name)
                dyads += np.where(on_rim[:, None], direction, 0.0)[:, :, None] * direction[..., None, :]
        return np.asarray(dyads @ np.linalg.pinv(dyads, rcond=SQUARED_COSINE_TOLERANCE, hermitian=True))

    @property
    def samples(self) -> list[SeamLayer]:
        """Layers with numbers as parameters, for checks of a layer whose parameters are functions of the place.

        They have the values at those places on S where one of the parameters is least or largest. If no parameter is a
        function, the only sample is the layer itself.
        """
        return self._samples if self.thin_layer and self.thin_layer.law.fields else [self]

    @cached_property
    def _samples(self) -> list[SeamLayer]:
        joint, thin = self.structure.joint, self.as_thin_layer
        laws = thin.law.laws_at_extremes(joint.points[joint.table.vertices[joint.rows_of(self.name)]].mean(axis=1).T)
        return [SeamLayer(self.name, replace(thin, law=law), self.structure) for law in laws]

    @cached_property
    def initial_tangents(self) -> InitialTangents:
        """Tangents of the layer's law before any loading.

        The parameters must be numbers, and the law must not be a contact law.
        """
        return InitialTangents(law_with_numbers(self.layer, self.structure.kinematics), self.sheet.mean_normal)

    @property
    def described_profile(self) -> object:
        """Description of the thickness profile, as JSON; None for a uniform thickness."""
        profile = self.thin_layer.profile if self.thin_layer else None
        return describe(self.structure.joint.relative_thickness(profile, self.name)) if profile else None

    @property
    def mesh_data(self) -> tuple[object, ...]:
        """Thickness, profile and fractions of sublayers, on which the layer's mesh depends; () without a thickness."""
        return (self.thin_layer.eps, self.described_profile, self.thin_layer.fractions) if self.thin_layer else ()

    def identity(self) -> dict[str, object]:
        """Return a description of the layer without its law, as JSON, for the data that identify a model."""
        thin = self.thin_layer
        eps, order, eigenstrain = (float(thin.eps), thin.order, thin.eigenstrain) if thin else (None, None, None)
        optional = {} if eigenstrain is None else {"eigenstrain": describe(eigenstrain)}
        return {"eps": eps, "order": order, "profile": self.described_profile, **optional}


def loads_of_layers(
    structure: Structure, layers: Mapping[str, SeamLayer], bonds: Sequence[str]
) -> dict[str, LoadInput]:
    """Return the forces per volume of a model's loaded layers, by the name of the seam.

    Args:
        structure: the structure.
        layers: name of a seam -> its layer.
        bonds: names of seams with bonds, which are left out.

    Raises:
        InputError: a load on a seam without a layer, or whose layer has no thickness; a `SurfaceSource` on a bond.
    """
    force, joint, kinematics = structure.body_force, structure.joint, structure.kinematics
    loads_by_name = force if isinstance(force, Mapping) else {}
    for name in (name for name, load in loads_by_name.items() if isinstance(load, SurfaceSource)):
        bonded = [seam for seam in bonds if name in (S, seam)]
        require(not bonded, "SurfaceSource on the seam", name, "it is bonded; a source needs a layer, or Conductance")
    seams = [seam for seam in joint.seams if seam not in bonds]
    loads = {seam: loads_by_name[name] for name in loads_by_name for seam in seams if name in (S, seam)}
    if kinematics.unknown != ScalarField.unknown and any(isinstance(load, SurfaceSource) for load in loads.values()):
        raise InputError("a SurfaceSource is a source of a scalar field; the bodies have laws of displacements")
    is_per_volume = {seam: not isinstance(load, SurfaceSource) for seam, load in loads.items()}
    for seam in (seam for seam in loads if seam not in layers or (is_per_volume[seam] and not layers[seam].thin_layer)):
        load = kinematics.quantities.body_force
        raise InputError(f"{load} in the layer {seam!r}: it has no layer with a thickness, so no weight is known")
    return loads


def _rim_normals(joint: Joint, rim: Rim, name: str) -> FloatArray:
    """Return mean outer unit normals (n, d) of the facet set `name` at the n ridges of `rim`.

    At ridges without a facet of this set the result is the outward direction along S.
    """
    normals = side_normals(joint, name, rim.vertices)
    return np.where(np.isnan(normals), rim.outward, normals)


@dataclass(frozen=True)
class FacetWeights:
    """Weights with which free ends change the interface law on the n facets of a seam.

    Attributes:
        a_N, a_T: (n,) relative loss of stiffness against openings and against shear, the mean over each facet.
        flow_resistance: (n,) relative increase of the resistance to a flow along S under pressure, mean over each
            facet.
        m: (n, d) unit normal in S of the nearest end, outward, in d dimensions; zero where there is none.
        offset: (n,) value of m . x at points x of the nearest end, a length.
        sheet, eps, constants: the seam, its thickness and the constants of free ends, of which the weights are made.
    """

    a_N: FloatArray
    a_T: FloatArray
    flow_resistance: FloatArray
    m: FloatArray
    offset: FloatArray
    sheet: Sheet
    eps: float
    constants: FreeEnd

    @classmethod
    def of_ends(cls, ends: list[StraightEnd], sheet: Sheet, eps: float, constants: FreeEnd) -> FacetWeights:
        """Return the weights of straight free ends on a seam.

        Args:
            ends: the free ends.
            sheet: the seam.
            eps: thickness of the layer, a length.
            constants: constants of a free end with which the law is corrected.
        """
        joint, count = sheet.joint, len(sheet.facets)
        weights = np.zeros((3, count))
        nearest, m, offset = np.full(count, np.inf), np.zeros((count, joint.dim)), np.full(count, NO_END * joint.size)
        centroids = np.stack([sheet.facet_means(c) for c in joint.points[sheet.vertices].mean(axis=1).T], axis=1)
        for end in ends:
            for k, (c, length) in enumerate(constants.strips):
                weights[k] += c / length * strip_shares(end, sheet, length * eps)
            is_closer = end.is_in_front(centroids) & (end.distance(centroids) < nearest)
            nearest[is_closer], m[is_closer], offset[is_closer] = end.distance(centroids)[is_closer], end.m, end.offset
        return cls(weights[0], weights[1], weights[2], m, offset, sheet, eps, constants)

    @property
    def strips_overlap(self) -> bool:
        """Whether strips of several ends overlap so far that no stiffness is left: a relative loss is 1 or more."""
        return bool(max(self.a_N.max(initial=0.0), self.a_T.max(initial=0.0)) >= 1)

    def expressions(self, domain: Domain, sides: Interface) -> EndWeights:
        """Return the weights as UFL expressions, which multiply terms of an interface law of order 1. Collective.

        Args:
            domain: the mesh; the cells above S store the weights of the facets.
            sides: the two sides of S.
        """
        joint, mesh, eps = self.sheet.joint, domain.mesh, self.eps
        values = np.zeros((len(joint.cells), 4 + joint.dim))
        upper_cells = joint.surface_cells[self.sheet.facets, 1]
        values[upper_cells] = np.column_stack([self.a_N, self.a_T, 1 / (1 + self.flow_resistance), self.offset, self.m])
        fields = sides.upper(domain.cellwise_function(("DG", 0, (4 + joint.dim,)), values[:, None]))
        m = ufl.as_vector([fields[4 + k] for k in range(joint.dim)])
        distance = fields[3] - ufl.dot(m, sides.upper(ufl.SpatialCoordinate(mesh)))
        mean_distances = self.constants.rho_N, self.constants.c_T  # of the tractions that balance those at the end
        reaches = [fem.Constant(mesh, 2 * rho * eps) if rho else None for rho in mean_distances]
        f_N, f_T = (1.0 if r is None else ufl.max_value(0.0, ufl.min_value(1.0, distance / r)) for r in reaches)
        return EndWeights(m, fields[0], fields[1], f_N, f_T, fields[2])


def strip_shares(end: StraightEnd, sheet: Sheet, reach: float) -> FloatArray:
    """Return the fraction (n,) of each facet of S that lies in the strip of width `reach` along a straight end."""
    x = sheet.joint.points[sheet.vertices]
    return sheet.facet_means(fraction_below(end.distance(x), reach) * end.is_in_front(x.mean(axis=1)))
