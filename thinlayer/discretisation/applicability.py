"""Applicability of an interface law in place of a layer: conditions, reasons against it, and remedies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from forms.base import InputError
from forms.elastic import MAX_FREE_END_NU, MODULUS_RATIO_TOLERANCE, LinearElastic, poisson_ratio
from forms.ends.constants import FreeEnd
from forms.law import BulkLaw
from forms.law_tangents import acoustic_tensor, declared_or_computed_tangent, is_isotropic, tangent_at_rest
from forms.parameter_fields import parameter_numbers
from forms.rubber import Rubber
from forms.tensors import average_lame
from geometry.refusals import place_text
from geometry.sheet import Rim, straight_ends
from geometry.topology import BoolArray, FloatArray
from thinlayer.discretisation.boundary import can_shift_along
from thinlayer.discretisation.layer import FLAT_SQUARED_COSINE, FacetWeights, SeamLayer, ThinLayer, law_with_numbers
from thinlayer.discretisation.prescribed_strains import SINGULARITY_TOLERANCE
from thinlayer.errors import Violation

MIN_STIFFNESS_CONTRAST = 40.0  # least Young's modulus of the bodies over the layer's mu
# least radius of free ends over the thickness in axisymmetry; the error of end constants is of the order of its inverse
MIN_RADIUS_RATIO = 4.0
MAX_SPREADING = 0.1  # length over which a sublayer spreads a scalar field, over the width of S; the error is 3 %
MESH_REMEDY = "use order=0, or mesh the layer (structure.full)"
GOALS_REMEDY = "and compare goals: goal.value(state, model)"
# 48 (1 - nu^2): (eps k)^3 E/mu at which half-spaces are as compliant as the layer under a pressure of wave number k
BODY_COMPLIANCE_FACTOR = 44.0


class Applicability:
    """Range of validity of a layer's interface law, which is checked before a model is built.

    Attributes:
        layer: the layer on its seam.
        bodies: "kept": the bodies keep their shape, and a meshed layer would move them apart. "extended": the outer
            shape is kept, and each body gives up half of the layer's thickness.
    """

    def __init__(self, layer: SeamLayer, bodies: str = "kept") -> None:
        self.layer, self.bodies = layer, bodies

    def why_not(self, use: str) -> Violation | None:
        """Return the first condition that the layer violates for a use; None if it violates none.

        The result is the same on all ranks.

        Args:
            use: the use, a key of `CONDITIONS_OF_USE`, such as "interface law", or "mesh" for a meshed layer.

        Raises:
            InputError: a parameter of the law or the thickness profile is out of range, or the law does not exist in
                the joint's dimension.
        """
        return next((violation for condition in CONDITIONS_OF_USE[use] for violation in condition(self)), None)

    def require(self, use: str, what: str = "") -> None:
        """Raise InputError for the first condition that the layer violates for a use; pass if it violates none.

        Args:
            use: the use, a key of `CONDITIONS_OF_USE`, such as "interface law" or "mesh".
            what: first words of the message.
        """
        if violation := self.why_not(use):
            raise violation.error(what)

    @cached_property
    def law(self) -> BulkLaw:
        """The layer's law for the structure's `plane`; its parameters are numbers, or functions of the place."""
        return law_with_numbers(self.layer.layer, self.layer.structure.kinematics)

    @cached_property
    def bend_text(self) -> str | None:
        """Words in messages that say how the layer is curved or varies in thickness; None for a flat, uniform layer."""
        if self.layer.thin_layer and self.layer.thin_layer.profile is not None:
            return "of a thickness that varies"
        if not self.layer.sheet.planar:
            return "on a curved S"
        can_shift = can_shift_along(self.layer.structure.kinematics, self.layer.sheet.mean_normal[None])
        return None if can_shift else "on an S that is not across the axis of revolution, and so curved,"

    # ---------------------------------------------------------------- sides
    def rim_of_kinds(self, *kinds: str) -> Rim:
        """Return the ridges (vertices in 2D, edges in 3D) where the seam ends and the layer's side is of given kinds.

        The side is the layer's own boundary at the end of S, between its two faces. `kinds` are words that say how
        supports constrain it: "free", "symmetric", "antisymmetric", "held" (clamped) or "oblique". `SeamLayer.side_kinds`
        defines
        them.
        """
        return self.layer.sheet.rim[np.isin(self.layer.side_kinds, kinds)]

    @cached_property
    def free_rim(self) -> Rim:
        """Ridges of free ends, where nothing constrains the layer's side, or only in an oblique direction.

        The side is the layer's own boundary at the end of S. An oblique direction is neither along S nor across it.
        """
        return self.rim_of_kinds("free", "oblique")

    @cached_property
    def loose_rim(self) -> Rim:
        """Ridges of S at which no support prevents the layer's side from moving outward along S.

        The side is the layer's own boundary there. Loads on it act on the layer, and a pressure in the layer falls to
        zero.
        """
        return self.rim_of_kinds("free", "antisymmetric", "oblique")

    @cached_property
    def uncorrected_rim(self) -> Rim:
        """Ridges of all free ends if the interface law does not correct free ends; no ridges if it does."""
        return self.free_rim[np.full(len(self.free_rim.vertices), self.why_not("ends") is not None)]

    @cached_property
    def decay_lengths(self) -> FloatArray:
        """Lengths (n,) over which the pressure of a law of order 1 decays at the n ridges of `loose_rim`.

        They are eps sqrt(lmbda/(12 mu)) with the layer's thickness eps at the ridge, and infinite for an incompressible
        law.
        """
        thin, joint, ridges = self.layer.as_thin_layer, self.layer.sheet.joint, self.loose_rim.vertices
        laws = self.law.at_places(joint.points[ridges].mean(axis=1).T) if self.law.fields else [self.law] * len(ridges)
        inverse_squares = np.array([12 * law.parameters()["mu"] * law.volume_compliance for law in laws])
        thickness_ratio = joint.relative_thickness(thin.profile, self.layer.name)[ridges].mean(axis=1)
        with np.errstate(divide="ignore"):
            return np.asarray(thin.eps * thickness_ratio / np.sqrt(inverse_squares))

    @property
    def coarse_mask(self) -> BoolArray:
        """Mask (n,) of the n ridges of `loose_rim` at which a cell of S is longer than the decay length of the pressure.

        The interface law does not set its pressure to zero at these ridges: the pressure would be too small over a
        whole cell.
        """
        return np.asarray(self.loose_rim.depth > self.decay_lengths)

    # ---------------------------------------------------------------- better laws
    def layer_of_order_1(self) -> ThinLayer:
        """Return the layer with an interface law of order 1, by which the error of its present law is estimated.

        The layer must meet the conditions of the use "estimate", see `why_not`. A `LinearElastic` law with lmbda > 0
        becomes `Rubber` with the same moduli, which has a pressure as additional unknown. It stays `LinearElastic` in
        plane stress, with functions as parameters, or if the correction of free ends is known. This is so if there are
        ridges in `loose_rim` and Poisson's ratio is at most `MAX_FREE_END_NU`. The correction needs no mesh as fine as
        that of the pressure.
        """
        law, has_free_outward = self.layer.as_thin_layer.law, len(self.loose_rim.vertices) > 0
        is_plane_stress = self.layer.structure.plane == "stress"  # no pressure builds up there
        if isinstance(law, LinearElastic) and not (is_plane_stress or law.fields) and law.lmbda > 0:
            corrects_ends = has_free_outward and poisson_ratio(law) <= MAX_FREE_END_NU + MODULUS_RATIO_TOLERANCE
            law = law if corrects_ends else Rubber(law.lmbda, law.mu)
        return replace(self.layer.as_thin_layer, law=law, order=1)

    # ---------------------------------------------------------------- ends
    @property
    def free_end_text(self) -> str:
        """How the interface law treats free ends, as words of messages: "corrected", "not corrected, as ...", "none".

        "none" means that no end is free.
        """
        violation = self.why_not("ends")
        return f"not corrected, as {violation.reason}" if violation else "corrected" if self.weights else "none"

    @cached_property
    def end_constants(self) -> FreeEnd | None:
        """Constants of free ends with which the layer's law is corrected; None if they are not known."""
        return self.law.end_constants()

    @cached_property
    def E_over_mu(self) -> float:
        """Ratio of the least initial Young's modulus of the bodies beside the seam to the layer's shear modulus."""
        return softest_body_modulus(self.layer) / float(parameter_numbers(self.law.parameters()["mu"]))

    @property
    def relative_width(self) -> float:
        """Area of the seam over the total length of its free ends, as a multiple of the layer's thickness."""
        return float(self.layer.sheet.areas.sum() / self.free_rim.length.sum()) / self.layer.eps

    @cached_property
    def unchecked_weights(self) -> FacetWeights:
        """Relative losses of stiffness on the seam's facets near free ends, also if strips of several ends overlap.

        The layer must meet all other conditions of the use "ends", see `why_not`.
        """
        assert self.end_constants is not None
        spreading_length = min(self.relative_width, (self.E_over_mu / BODY_COMPLIANCE_FACTOR) ** (1 / 3))
        constants = self.end_constants.for_spreading_length(spreading_length)
        sheet, eps = self.layer.sheet, self.layer.eps
        return FacetWeights.of_ends(straight_ends(self.free_rim, sheet), sheet, eps, constants)

    @cached_property
    def weights(self) -> FacetWeights | None:
        """Relative losses of stiffness on the seam's facets near free ends; None if no end is free or corrected."""
        return None if self.why_not("ends") or not len(self.free_rim.vertices) else self.unchecked_weights


def softest_body_modulus(seam_layer: SeamLayer) -> float:
    """Return the least initial Young's modulus of the bodies beside a seam; infinite if no stiffness is known.

    Moduli of anisotropic laws are averaged over all directions.
    """
    joint, n, moduli = seam_layer.structure.joint, seam_layer.sheet.mean_normal, [np.inf]
    cells = np.unique(joint.surface_cells[seam_layer.sheet.facets])
    cells = cells[cells >= 0]
    for region_number in np.unique(joint.region[cells]):
        law = seam_layer.structure.body_laws[joint.regions[region_number]]
        centres = joint.points[joint.corners[cells[joint.region[cells] == region_number]]].mean(axis=1)
        tangents = [declared_or_computed_tangent(local_law, n) for local_law in law.laws_at_extremes(centres.T)]
        lame_pairs = [average_lame(C) for C in tangents if C is not None]
        moduli += [mu * (3 * lmbda + 2 * mu) / (lmbda + mu) for lmbda, mu in lame_pairs]
    return float(min(moduli))


# ---------------------------------------------------------------- conditions, in the order in which they are checked
def _law_conditions(r: Applicability) -> Iterator[Violation]:
    """Check that the law of the layer `r.layer` can be used, on S or meshed; yield each violated condition."""
    seam_layer, structure, element = r.layer, r.layer.structure, r.layer.structure.element
    seam_layer.law.check_dimension(structure.joint.dim)
    if (unknown := seam_layer.law.unknown) != structure.kinematics.unknown:
        reason = (
            f"{seam_layer.law_name} is a law of a {unknown}, those of the bodies of a {structure.kinematics.unknown}"
        )
        yield Violation("unknown", reason, "make a structure for each unknown")
        return
    if seam_layer.contact:
        reason = f"a contact law acts at nodes, and in {element}"
        if element == "S2":
            yield Violation("element", f"{reason} unknowns have no places", "use element='Q2'")
        if element == "P2" and structure.joint.dim == 3:
            yield Violation("element", f"{reason} vertices bear no uniform pressure", "use P1, or Q2 on hexahedra")
        seam_layer.contact.check_threshold()
        return
    if seam_layer.law.traits.constrained and element not in ("P2", "Q2"):
        yield Violation("element", f"an incompressible layer needs elements P2 or Q2, not {element}", "give them")
    if seam_layer.thin_layer:  # a user's function may fail on one rank only
        structure.joint.relative_thickness(seam_layer.thin_layer.profile, seam_layer.name)
    for sample_layer in seam_layer.samples:
        sample_layer.initial_tangents.require_stable()


def _order_1_conditions(r: Applicability) -> Iterator[Violation]:
    """Check that the layer `r.layer` can have an interface law of order 1; yield each violated condition.

    A layer of order 0 violates none. Conditions at tips and junctions of the seam come last.
    """
    thin, structure, sheet = r.layer.thin_layer, r.layer.structure, r.layer.sheet
    if thin is None or thin.order == 0:
        return
    if thin.law.traits.constrained and structure.plane == "stress":
        yield Violation("pressure in a sheet", "no pressure builds up in plane stress", "use LinearElastic or order=0")
    if r.bend_text and r.bodies == "kept":
        remedy = "use bodies='extended', for the interface and the full model alike"
        yield Violation("bent", f"order=1 {r.bend_text} needs bodies at their true places", remedy)
    if structure.kinematics.has_value_in_strain:
        if len(thin.law.sublayers) > 1 and (not sheet.planar or (r.bend_text and thin.profile is None)):
            reason = (
                f"order=1 of a Stack {r.bend_text}: its sublayers have other areas than S, by thickness over radius"
            )
            yield Violation("bent stack", reason, f"{MESH_REMEDY}, or use order=0, whose errors are of this size")
        return  # a scalar field does not lock, and its energy of order 1 is positive at tips and junctions, too
    if structure.degree != 2:
        yield Violation("element", f"order=1 has gradients on S, elements are {structure.element}", "use degree 2")
    if r.bend_text and len(thin.law.sublayers) > 1:
        yield Violation("bent stack", f"order=1 of a Stack {r.bend_text}: shares of the jump turn along S", MESH_REMEDY)
    yield from filter(None, (sample_layer.initial_tangents.locking_violation() for sample_layer in r.layer.samples))
    if sheet.tip is not None:
        reason = f"order=1 has gradients at the tip, and {r.layer} ends at {place_text(sheet.tip)}, inside the bodies"
        yield Violation("tip", reason, "use order=0")
    if sheet.junction_point is not None:
        reason = f"order=1 leaves out what junctions add, and {r.layer} meets another one, or branches, at "
        yield Violation("junction", reason + place_text(sheet.junction_point), MESH_REMEDY)


def _meshed_layer_conditions(r: Applicability) -> Iterator[Violation]:
    if r.layer.law.traits.softens and r.layer.law.traits.phases:
        reason = f"the stress of {r.layer.law!r} falls as strains grow: all strain would gather in one row of cells"
        yield Violation("softens", reason, "take mixing=1, or NonMonotoneUnrelaxed with one phase for each column")
    n, sample_tangents = r.layer.sheet.mean_normal, [sample_layer.initial_tangents for sample_layer in r.layer.samples]
    for law in (law for tangents in sample_tangents for _, law, _ in tangents.sublayers if law.traits.softens):
        C = tangent_at_rest(law, n)
        if C is None or np.linalg.eigvals(acoustic_tensor(C, n)).real.min() <= 0:  # it supports inner nodes
            reason = f"{type(law).__name__} softens, and its stiffness at rest is not known, or not positive"
            yield Violation("sound", reason, "write a method stiffness(n) in its class, that of the sound material")


def _mean_strain_conditions(r: Applicability) -> Iterator[Violation]:
    is_scalar = r.layer.structure.kinematics.has_value_in_strain
    if r.layer.thin_layer and r.layer.thin_layer.order and not is_scalar:
        yield Violation("order 1", f"{r.layer} has order=1, whose strains along S have a mean part", "use order=0")
    if is_scalar and r.bodies == "extended" and len(r.layer.law.sublayers) > 1:
        yield Violation(
            "mean gradient", f"{r.layer} has sublayers, whose shares of a mean gradient differ", MESH_REMEDY
        )


def _support_conditions(r: Applicability) -> Iterator[Violation]:
    """Yield a violation if a support constrains only the side of the layer `r.layer`, not the bodies beside it.

    The side is the layer's own boundary at an end of S. Such a support has a name of the kind "NAME/LAYER": the part of
    the facet set NAME on this side.
    """
    sheet, layer_projectors = r.layer.sheet, r.layer.held_projectors() - r.layer.held_projectors(of_layer=False)
    if len(ridges := sheet.rim.vertices[np.abs(layer_projectors).max(axis=(1, 2)) > FLAT_SQUARED_COSINE]):
        reason = f"a support holds the side of {r.layer} alone, at {place_text(sheet.joint.points[ridges[0, 0]])}"
        yield Violation("held alone", reason, "support the bodies too, or mesh the layer")


def _sublayer_conditions(r: Applicability) -> Iterator[Violation]:
    """Yield a violation if an inner sublayer conducts so well that its value is not that of a field of equal flux.

    In a foil between two insulating sublayers the field spreads along S over `spreading` times the thickness, before it
    reaches the nearer face.
    """
    if not r.layer.structure.kinematics.has_value_in_strain or len(r.layer.law.sublayers) < 3:
        return
    x = r.layer.sheet.joint.points[r.layer.sheet.vertices]
    width = float(np.ptp(x.reshape(-1, x.shape[-1]), axis=0).max())
    for layer in r.layer.samples:
        fractions, across, along = layer.initial_tangents.conductivities
        to_lower = np.cumsum(fractions / across)
        resistances = np.minimum(to_lower[:-2], to_lower[-1] - to_lower[1:-1])
        spreading = layer.eps * float(np.sqrt(fractions[1:-1] * along[1:-1] * resistances).max())
        if spreading > MAX_SPREADING * width:
            text = f"a sublayer of {r.layer} spreads the field over {spreading:.3g} along S, which is {width:.3g} wide"
            effect = f"from {MAX_SPREADING:g} of its width on it has a value of its own, unknown on S"
            yield Violation("foil", f"{text}; {effect}", "mesh the layer (structure.full)")
            return


def _thickness_conditions(r: Applicability) -> Iterator[Violation]:
    if r.layer.thin_layer is None:
        yield Violation("no thickness", f"{r.layer.law_name} is a law on S, without a thickness", "give a ThinLayer")


def _free_end_law_conditions(r: Applicability) -> Iterator[Violation]:
    """Check that an interface law of order 1 can correct the free ends of the layer `r.layer`; yield each violation.

    If no end is free, the only condition is that the interface law is of order 1.
    """
    thin, joint = r.layer.as_thin_layer, r.layer.structure.joint
    if thin.order == 0:
        yield Violation("order 0", "the interface law is of order 0", "use order=1")
    if not len(r.free_rim.vertices):
        return
    if thin.edges == "plain":
        yield Violation("plain", "edges='plain' was asked for", "leave edges=None")
    if thin.eigenstrain is not None:
        yield Violation("eigenstrain", "constants of free ends are not known for a layer with eigenstrain=...")
    if r.bodies != "kept":
        yield Violation("apart", "bodies are extended: ends of the layer may be oblique", "use bodies='kept'")
    if r.layer.structure.plane == "axisymmetric":
        R = float(joint.points[r.free_rim.vertices, 0].min()) / r.layer.eps
        if R < MIN_RADIUS_RATIO * (1 - MODULUS_RATIO_TOLERANCE):
            yield Violation("radius", f"free ends have a radius of {R:.3g} thicknesses; allowed: {MIN_RADIUS_RATIO:g}")
    if r.end_constants is None:
        known_text = f"LinearElastic with nu from 0 to {MAX_FREE_END_NU:g}, Rubber and Incompressible, by numbers"
        yield Violation("no constants", f"free ends are not known of this {r.layer.law_name}: they are of {known_text}")
        return
    yield from _straight_end_conditions(r, r.E_over_mu)
    if r.layer.has_pressure_flow and r.coarse_mask.any():
        at, decay = place_text(joint.points[r.loose_rim[r.coarse_mask].vertices[0, 0]]), r.decay_lengths.min()
        reason = f"cells at free ends must not be longer than the fall of the pressure there, {decay:.3g}, as at {at}"
        yield Violation("coarse", reason, "make them shorter (h_ends=...)")
    if r.relative_width < (reach := r.end_constants.reach):
        reason = f"its area over the length of free ends is {r.relative_width:.3g} thicknesses"
        yield Violation("short", f"S is short: {reason}; allowed: {reach:.3g}")
    if r.unchecked_weights.strips_overlap:
        yield Violation("overlap", f"strips of {reach * thin.eps:.3g} along free ends lie on one another")


def _straight_end_conditions(r: Applicability, E_over_mu: float) -> Iterator[Violation]:
    """Check that the layer `r.layer` is flat, with straight free ends, and much softer than the bodies.

    Yield each violated condition. `E_over_mu` is Young's modulus of the softest body over the shear modulus of the
    layer.
    """
    sheet = r.layer.sheet
    if r.bend_text:
        yield Violation("bent", f"free ends are not known of a layer {r.bend_text}")
    for ridge in r.rim_of_kinds("oblique").vertices[:1]:
        at = place_text(sheet.joint.points[ridge[0]])
        yield Violation("oblique", f"something holds the layer's side at {at} neither along S nor across it")
    if E_over_mu < MIN_STIFFNESS_CONTRAST * (1 - MODULUS_RATIO_TOLERANCE):
        reason = f"E of a body is {E_over_mu:.4g} times mu of the layer; allowed: at least {MIN_STIFFNESS_CONTRAST:g}"
        yield Violation("contrast", f"faces must be rigid beside free ends: {reason}")
    try:
        straight_ends(r.free_rim, sheet)
    except InputError as error:
        yield Violation("curved end", str(error))


def _subproblem_conditions(r: Applicability) -> Iterator[Violation]:
    """Check that the layer `r.layer`, meshed without bodies, can be solved for given displacements of its faces.

    Yield each violated condition.
    """
    traits, law_name = r.layer.law.traits, r.layer.law_name
    if traits.phases or traits.softens:
        law_remedy = "take mixing=1, or NonMonotoneUnrelaxed, and " * (traits.phases and traits.softens)
        reason = f"{law_name} has phases, or a stress that falls as strains grow"
        yield Violation("phases", reason, f"{law_remedy}mesh the layer (structure.full)")
    elif traits.constrained and not r.law.volume_compliance and not len(r.loose_rim.vertices):
        reason = f"{law_name} between faces, with no side that is free, bears a pressure that these do not tell"
        yield Violation("closed", reason, "take Rubber with Poisson's ratio 0.4999")


def _neumann_conditions(r: Applicability) -> Iterator[Violation]:
    """Yield a violation if some strain of the layer `r.layer` causes no stress.

    Forces on the layer's faces then do not determine its displacements, if it is meshed without bodies.
    """
    components = r.layer.structure.kinematics.resisted_indices(r.layer.structure.joint.dim)
    tangents = [C for layer in r.layer.samples for _, _, C in layer.initial_tangents.sublayers if C is not None]
    for C in (C[np.ix_(components, components)] for C in tangents):
        singular_values = np.linalg.svd(C, compute_uv=False)
        if singular_values[-1] <= SINGULARITY_TOLERANCE * singular_values[0]:
            reason = f"{r.layer.law_name} has strains without stresses, as springs have along S, and moves in itself"
            yield Violation("no stress", reason, f"solve structure.full(layer), {GOALS_REMEDY}")


def _bonded_conditions(r: Applicability) -> Iterator[Violation]:
    """Yield a violation if the layer `r.layer` is curved or varies in thickness, so that a bond cannot replace it.

    A flat, uniform layer shifts the bodies without changing their shape, so that bodies bonded on S have the same
    shape.
    """
    if r.bend_text:
        reason = f"bonded bodies meet on S, where {r.layer} {r.bend_text} leaves them in no place"
        yield Violation("moved", reason, f"solve structure.full(layer, bodies='extended'), {GOALS_REMEDY}")


def _rate_conditions(r: Applicability) -> Iterator[Violation]:
    """Yield a violation if the stress in the layer `r.layer` depends on strain rates, which no state contains."""
    if r.layer.law.traits.rate:
        yield Violation("rate", f"{r.layer.law_name} has a rate, of which a state does not know", "mesh the layer")


def _corner_conditions(r: Applicability) -> Iterator[Violation]:
    """Check that the exponents of the singular stresses at the free ends of `r.layer` are known; yield each violation.

    The exponents are those at the corner of a wedge of 90 degrees on a rigid face in plane strain.
    """
    if not r.layer.law.traits.linear:
        yield Violation("not linear", f"exponents are known of linear laws, not of {r.layer.law_name}")
    sublayers, n = r.law.sublayers, r.layer.sheet.mean_normal
    outer_C = [] if r.law.fields else [declared_or_computed_tangent(law, n) for _, law in (sublayers[0], sublayers[-1])]
    shear_moduli = [average_lame(C)[1] for C in outer_C if C is not None and is_isotropic(C)]
    if len(shear_moduli) < 2:
        yield Violation("not isotropic", "exponents are known of isotropic layers, by numbers")
        return
    if r.layer.structure.plane == "axisymmetric":
        yield Violation("radius", "free ends of a body of revolution are curved")
    yield from _straight_end_conditions(r, softest_body_modulus(r.layer) / max(shear_moduli))


Condition = Callable[[Applicability], Iterator[Violation]]
CONDITIONS_OF_USE: dict[str, tuple[Condition, ...]] = {
    "law": (_law_conditions,),
    "mesh": (_thickness_conditions, _law_conditions, _meshed_layer_conditions),
    "sides": (_support_conditions,),
    "sublayers": (_sublayer_conditions,),
    "mean strain": (_mean_strain_conditions,),
    "interface law": (_law_conditions, _order_1_conditions),
    "ends": (_thickness_conditions, _free_end_law_conditions),
    "estimate": (_thickness_conditions, _support_conditions, _subproblem_conditions, _neumann_conditions),
    "bonded": (_bonded_conditions,),
    "alone": (_thickness_conditions, _rate_conditions, _subproblem_conditions),
    "corners": (_thickness_conditions, _rate_conditions, _subproblem_conditions, _corner_conditions),
}
