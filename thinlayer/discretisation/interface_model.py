"""InterfaceModel, whose layers are replaced by their interface laws on S."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_coefficients

from forms import work as forms
from forms.base import InputError
from forms.ends.constants import FreeEnd
from forms.kinematics import ScalarField
from forms.law import BulkLaw
from forms.series import Stack, upper_share
from forms.tensors import Expr
from forms.work import Interface, InterfaceSide
from geometry.domain import Domain
from geometry.inflating.inflation import offset_to_middle, with_gaps
from geometry.inflating.kept_bodies import body_translations
from geometry.inflating.layering import check_layering
from geometry.joint import Joint
from geometry.refusals import require_known
from geometry.seam import FacetName, S
from geometry.sheet import Rim, StraightEnd, straight_ends
from geometry.topology import FloatArray, Splitting, ridge_keys
from thinlayer.discretisation.boundary import require_revolution
from thinlayer.discretisation.coefficient import Coordinates, HandedField, LoadInput, Pressure
from thinlayer.discretisation.forces import Forces, LoadRegion
from thinlayer.discretisation.form_compilation import law_with_expressions
from thinlayer.discretisation.layer import (
    Layers,
    SeamLayer,
    SurfaceSource,
    law_of_terms,
    law_with_numbers,
    strip_shares,
)
from thinlayer.discretisation.model import Model
from thinlayer.errors import Violation
from thinlayer.pointwise.quadrature import quadrature_degree
from thinlayer.system.compat import ufl_replace
from thinlayer.system.ranks import errors_on_all

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

# 7 zeta(3)/pi^3: mean distance from the end, over the thickness, of the tractions that balance a load along the end
ANTIPLANE_LOAD_DISTANCE = 0.2713773
LoadPiece = tuple[Expr, LoadRegion]  # force, and the region where it acts
END_DEGREE_INCREASE = 2  # increase of the quadrature degree where weights of free ends are linear along S


class InterfaceModel(Model):
    """Model of a structure whose layers are replaced by their interface laws on S, with all methods of a `Model`.

    A seam may also have a `Bond`, which joins the two bodies, or be open.
    """

    name = "interface"
    broken = True

    def __init__(self, structure: Structure, layer: Layers, bodies: str = "kept") -> None:
        self._body_shape = bodies
        super().__init__(structure, layer, **({} if bodies == "kept" else {"bodies": bodies}))

    def _checked_joint(self) -> Joint:
        check_layering(1, self._body_shape)
        self.require("interface law")
        if self._body_shape == "kept":
            return self.joint
        if self.joint.seams_meet:
            raise InputError("bodies='extended': seams meet or branch, where S has no middle; use bodies='kept'")
        thin_layers = {name: layer.thin_layer for name, layer in self.layers.items() if layer.thin_layer}
        for name in (name for name in self.joint.seams if name not in thin_layers):
            raise InputError(f"bodies='extended': seam {name!r} has no ThinLayer, so no thickness; use bodies='kept'")
        eps = {name: layer.eps for name, layer in thin_layers.items()}
        joint = with_gaps(self.joint, eps, profile={name: layer.profile for name, layer in thin_layers.items()})
        require_revolution(self.structure.kinematics, joint)
        return joint

    def _make_forces(self) -> Forces:
        forces = super()._make_forces()  # first, as it raises errors about bad data
        for layer in self.layers.values():
            if layer.thin_layer and layer.thin_layer.order:
                add_side_loads(forces, self, layer, self.sides_of(layer.name))
        return forces

    def with_joint(self, joint: Joint) -> InterfaceModel:
        """Return the same model on another mesh `joint`, as drawn, with the same names. Collective.

        Warnings issued before are not repeated.
        """
        new = InterfaceModel(self.structure.with_joint(joint), self.on_seams, self._body_shape)
        new.issued_warnings = self.issued_warnings
        return new

    @cached_property
    def split_mesh(self) -> Splitting:
        """The joint's mesh after cutting it along all seams that have no `Bond`."""
        joint = self.domain.joint
        cut_rows = [joint.rows_of(name) for name in joint.seams if name not in self.bonds]
        return joint.split_along(np.concatenate([np.empty(0, np.int64), *cut_rows])) if self.bonds else joint.split_mesh

    def _check_compatible(self, other: Self) -> None:
        self.require("interface law")
        if self.bonds != other.bonds:
            text = f"{list(other.bonds)}, not {list(self.bonds)}"
            raise InputError(f"this model has bonds on the seams {text}; make a model of its own")
        if self._body_shape != "kept":
            self._require_shapes(other)

    @cached_property
    def _middle(self) -> MidSurface | None:
        """S midway between the faces of bodies that gave up room for the layers; None if the bodies meet on S."""
        return None if self.domain.joint.parted is None else MidSurface(self.domain)

    def _coordinates_on(self, at: Coordinates) -> Coordinates:
        at = super()._coordinates_on(at)
        return at.with_place(at.x + self._middle.offset) if self._middle else at

    def _layer_strain(self, layer: SeamLayer) -> Expr | tuple[Expr, Expr] | None:
        """Return minus the eigenstrain of a layer, or a pair: at its lower and at its upper face."""
        strain = super()._layer_strain(layer)
        functions = [] if strain is None else extract_coefficients(strain)
        if strain is None or not (self._middle or functions):
            return strain
        sides, handed = self.sides_of(layer.name), [f for f in functions if isinstance(f, HandedField)]
        if layer.name in self.joint.base_seams:
            on_base = ufl_replace(strain, dict.fromkeys(handed, ufl.as_ufl(0.0)))
            return (sides.upper(on_base), sides.upper(strain)) if handed else sides.upper(strain)
        is_two_sided = handed or not self._middle
        return (sides.lower(strain), sides.upper(strain)) if is_two_sided else sides.upper(strain)

    @cached_property
    def dS(self) -> ufl.Measure:
        """Measure of facets between two bodies, of which dS(k) is the seam number k in `joint.seams`, from 1.

        On a seam "+" is the upper side. dS without a number would be all inner facets, with arbitrary sides: for all
        seams use `sides.measure`.
        """
        body_seams = [(k, name) for k, name in enumerate(self.joint.seams, 1) if name not in self.joint.base_seams]
        entities = [(k, self.domain.sides(name)[0].ravel()) for k, name in body_seams]
        return ufl.Measure("dS", domain=self.domain.mesh, subdomain_data=entities)

    def sides_of(self, name: str = S) -> Interface:
        """Return the two sides of a seam, or of all seams for the name "S".

        They give the normal, jumps and values of functions on either side, and the measure of integrals over the seam.

        Raises:
            InputError: an unknown seam; "S" if some seams lie between bodies and others on a rigid base.
        """
        joint, offset_to_s = self.joint, self._middle.offset if self._middle else None
        joint.rows_of(name)
        names = tuple(joint.seams) if name == S else (name,)
        are_on_base = [seam in joint.base_seams for seam in names]
        if all(are_on_base):
            return Interface.on_rigid_base(self.ds(self.domain.values(name)), self.kinematics, offset_to_s)
        if any(are_on_base):
            raise InputError(f"S lies between bodies and on a rigid base; name one of the seams {', '.join(names)}")
        seam_numbers = tuple(list(joint.seams).index(seam) + 1 for seam in names)
        measure = self.dS(seam_numbers if len(seam_numbers) > 1 else seam_numbers[0])
        return Interface.between_bodies(measure, self.kinematics, offset_to_s)

    @cached_property
    def sides(self) -> Interface:
        """The two sides of all seams: normal, jumps and values of functions on each side, and measure of integrals."""
        return self.sides_of(S)

    def _layer_terms(self) -> list[forms.Term]:
        with errors_on_all(self.comm):
            for name, layer in self.layers.items():
                if self.applicability[name].weights is None and layer.thin_layer and layer.thin_layer.edges == "free":
                    self.applicability[name].require("ends", f"edges='free' of {layer}: ")
        return [term for layer in self.layers.values() if not layer.contact for term in self.terms_of(layer)]

    @property
    def remarks(self) -> list[str]:
        """Sentences for the log that say for each layer of order 1 whether its free ends are corrected."""
        order_1 = [r for r in self.applicability.values() if r.layer.thin_layer and r.layer.thin_layer.order]
        return [f"free ends of {r.layer}: {r.free_end_text}" for r in order_1]

    def meshing_translations(self) -> FloatArray | None:
        """Return the translations (n_cells, d) of the joint's cells that meshing the layers of order 1 would cause.

        Only these layers count, because other interface laws ignore the thickness. Return None if all translations are
        zero, if the bodies do not meet on S, or if a thickness varies. Return None too if the bodies cannot move apart
        without strain.
        """
        facet_eps = np.zeros(len(self.joint.surface_rows))
        for layer in self.layers.values():
            if layer.thin_layer and layer.thin_layer.order:
                facet_eps[layer.sheet.facets] = np.nan if layer.thin_layer.profile else layer.eps
        if self._middle or not facet_eps.any() or np.isnan(facet_eps).any():
            return None
        try:
            return body_translations(self.joint, facet_eps)[self.joint.split_mesh.pieces]
        except InputError:  # bodies cannot move apart in one piece
            return None

    def free_ends(self, name: str) -> Violation | None:
        """Return why the interface law of a seam does not correct its free ends; None if it does, or if no end is free.

        Raises:
            InputError: the seam is unknown or has no layer.
        """
        require_known("layer", name, self.applicability)
        return self.applicability[name].why_not("ends")

    def terms_of(self, layer: SeamLayer) -> list[forms.Term]:
        """Return the terms, on S, of a layer's interface law; the layer must not have a contact law."""
        mesh, law, sides = self.domain.mesh, law_with_numbers(layer.layer, self.kinematics), self.sides_of(layer.name)
        # UFL would estimate a high degree for slopes and lengths of the middle
        measure = sides.measure.reconstruct(**self._metadata(sides.measure, always=self._middle))
        on_surface = partial(_law_on_surface, self.domain, self.joint, layer.name, sides.upper)
        sides = replace(sides, measure=measure, law_on_surface=on_surface)
        if layer.thin_layer is None:
            terms = [forms.jump_term(law, sides)]
        else:
            eps = self._thickness(layer, sides)
            slope = self._middle.eps_gradient(sides) if self._middle and layer.thin_layer.profile else None
            weights = self.applicability[layer.name].weights
            ends = weights.expressions(self.domain, sides) if weights else None
            if weights:
                finer_metadata = {"quadrature_degree": quadrature_degree(self.V, measure) + END_DEGREE_INCREASE}
                sides = replace(sides, measure=measure.reconstruct(metadata=finer_metadata))
            terms = forms.s_terms(law, sides, eps, layer.thin_layer.order, self.layer_strains[layer.name], slope, ends)
        is_compiled = any(term.bubble_strain for term in terms)  # states then have the stresses, for all results
        laws = [term.law.compiled_copy() if is_compiled else law_of_terms(term.law, mesh) for term in terms]
        return [replace(term, key=layer.key, law=law) for term, law in zip(terms, laws, strict=True)]

    def _thickness(self, layer: SeamLayer, sides: Interface) -> Expr:
        if self._middle:
            return self._middle.thickness(sides)
        eps: Expr = fem.Constant(self.domain.mesh, layer.eps)
        if (profile := layer.as_thin_layer.profile) is None:
            return eps
        joint = self.domain.joint  # values away from the seam have no meaning
        at_corners = joint.relative_thickness(profile, layer.name)[joint.corners][..., None]
        return eps * sides.upper(self.domain.cellwise_function(("Lagrange", 1), at_corners))

    def _description(self) -> dict[str, Any]:
        names = [name for name, applicability in self.applicability.items() if applicability.weights]
        return super()._description() | ({"free ends": names} if names else {})

    def load_region(self, layer: SeamLayer, source: SurfaceSource | None = None) -> LoadRegion:
        """Return the region on S where the loads and the mass of a layer act.

        Its weight contains the thickness, if the layer has one. Each side of S carries half of a load, of a source its
        share. On a rigid base, the base carries the lower part.
        """
        sides, law = self.sides_of(layer.name), layer.thin_layer.law if layer.thin_layer else None
        height = source.height if source else 0.0
        share: Expr | float = 0.5 + height  # of the upper side
        if not source and isinstance(law, Stack) and law.unknown == ScalarField.unknown and law.traits.linear:
            on_surface = partial(_law_on_surface, self.domain, self.joint, layer.name, sides.upper)
            laws: list[Any] = [on_surface(sublayer) for sublayer in law.laws]
            share = upper_share(law, laws, sides.n)

        def base_displacement(v: Expr) -> Expr:  # the base moves and rotates as the facets of the body above it do
            return sides.upper(v + ufl.dot(ufl.grad(v), 2 * self._middle.offset) if self._middle else v) * (1 - share)

        base_argument = base_displacement if layer.name in self.joint.base_seams else None
        has_thickness = layer.thin_layer is not None and source is None
        weight = (self._thickness(layer, sides) if has_thickness else 1) * sides.factor

        def work_argument(v: Expr) -> Expr:
            return share * sides.upper(v) + (1 - share) * sides.lower(v)

        region = LoadRegion(sides.measure, weight, sides.upper, work_argument, base_argument, jump=sides.jump)
        return replace(region, bubble_factor=6 * (1 / 4 - height**2) if source else 1.0)


def _law_on_surface(domain: Domain, joint: Joint, name: str, upper: InterfaceSide, law: BulkLaw) -> BulkLaw:
    """Return a law with UFL expressions as parameters, for integrals over a seam.

    A parameter that is a function of the place becomes its interpolant on S, linear between vertices. Numbers become
    Constants.

    Args:
        domain: the distributed mesh.
        joint: the joint, in whose coordinates parameters are functions.
        name: name of the seam.
        upper: the upper side of the seam, on which the interpolants are evaluated.
        law: the law.
    """
    expressions, vertices = {}, np.unique(joint.table.vertices[joint.rows_of(name)])
    for parameter, vertex_values in law.fields_at(joint.points[vertices].T).items():
        values = np.full(len(joint.points), vertex_values[0])  # values elsewhere have no meaning
        values[vertices] = vertex_values
        expressions[parameter] = upper(domain.cellwise_function(("Lagrange", 1), values[joint.corners][..., None]))
    return law_with_expressions(law, domain.mesh, expressions)


class MidSurface:
    """S midway between the faces of bodies that gave up room for the layer, which has no cells.

    Args:
        domain: the distributed mesh.

    Attributes:
        offset: (d,) UFL vector from places on the face of either body to S, in d dimensions.
    """

    def __init__(self, domain: Domain) -> None:
        joint = domain.joint
        self.offset = domain.cellwise_function(("DG", joint.degree, (joint.dim,)), offset_to_middle(joint))

    def thickness(self, sides: Interface) -> Expr:
        """Return the thickness of the layer in UFL: the distance between the bodies' faces along the normal n of S."""
        return -2 * ufl.dot(sides.upper(self.offset), sides.n)

    def eps_gradient(self, sides: Interface) -> Expr:
        """Return the gradient (d,) of the thickness along S, in UFL."""
        gradient = -2 * ufl.dot(sides.n, sides.upper.gradient(self.offset))
        return gradient - ufl.dot(gradient, sides.director) * sides.n


@dataclass(frozen=True)
class SideLoad:
    """A traction on the side of a layer whose interface law is of order 1.

    The side is the layer's own boundary at an end of S. It joins the two faces of the layer.

    Attributes:
        what: name of the load in error messages.
        load: the load as the user wrote it.
        rim: the ridges (vertices in 2D, edges in 3D) at which S ends on this side.
    """

    what: str
    load: LoadInput | Pressure
    rim: Rim

    @classmethod
    def loads_on_sides(cls, model: Model, layer: SeamLayer) -> Iterator[SideLoad]:
        """Yield the tractions, except zero ones, on a layer's lateral sides (at ends of S) in an interface model."""
        rim = layer.sheet.rim
        for name, load in sorted((model.structure.tractions or {}).items()):
            facet_set, value = FacetName.parse(name).continued_set, load.p if isinstance(load, Pressure) else load
            is_zero = not callable(value) and not np.any(np.asarray(value, float))
            if facet_set != name and not is_zero and (on_rim := rim.lies_on(model.joint.facets[facet_set])).any():
                yield cls(f"{model.kinematics.quantities.traction} on {name!r}", load, rim[on_rim])


def add_side_loads(forces: Forces, model: Model, layer: SeamLayer, sides: Interface) -> None:
    """Add the tractions on the sides of a layer of order 1 to the forces of an interface model.

    The side is the layer's own boundary at an end of S; its height is the thickness eps. Per length of this end, a
    traction t on the side does the work eps t . v, with the mean displacement v of the side. If the faces have the
    displacements <u> -+ [u]/2, order 1 approximates v by <u>: each face gets half of the force.

    At a free end the side has further displacements of the same size. They are -(c_N M/lmbda) [u_N] along the outward
    normal m in S, and -c_T [u_m] along n. Here M is lmbda + 2 mu, and c_N, c_T and rho_N are constants of the end
    (`forms.ends.constants.FreeEnd`). By reciprocity the displacements follow from the energy that the end takes away.
    The force reaches the faces over lengths of the order of the thickness. Its mean distances from the end are rho_N
    eps (along m), c_T eps (along n) and 7 zeta(3)/pi^3 eps (along the end, index tau). With the relative losses of
    stiffness a_N and a_T near the end (`forms.ends.weights`) it does the work

        int_S { eps [t_m v_m f_N' + t_n v_n f_T' + t_tau v_tau f'] - a_N M/lmbda t_m [v_N] - a_T t_n [v_m] }

    with v = <u>. For each component f' is 1/r within r of the end, where r is twice the mean distance, and else zero.
    Without these terms the errors would be as large as the effects of loads on sides. `estimate(state).better` has the
    loads on sides, too; on cells of S of two thicknesses its errors of traction and jump are 4 to 20 times as large.

    Args:
        forces: the forces.
        model: the interface model.
        layer: the layer.
        sides: the two sides of S, for the layer's seam.

    Raises:
        InputError: it is not known how the layer transfers such a traction to its faces.
    """
    r = model.applicability[layer.name]
    loose_keys = ridge_keys(r.loose_rim.vertices)
    for load in SideLoad.loads_on_sides(model, layer):
        if layer.has_pressure_flow or r.weights is None or not np.isin(ridge_keys(load.rim.vertices), loose_keys).all():
            violation = None if layer.has_pressure_flow else r.why_not("ends")
            why = "a support holds the side" if not violation else violation.reason
            why = "its pressure of order 1 is zero at free ends" if layer.has_pressure_flow else why
            why = "no law is known of the ends of a scalar field's layer" if model.n_components == 1 else why
            reason = f"the {load.what} acts on the side of {layer}, and how it reaches the faces is not known: {why}"
            raise Violation("loaded side", reason, "use order=0, which leaves it out, or mesh the layer").error()
        for force, region in _end_load(load, forces.at, model, layer, sides):
            forces.add_weighted_load(layer.name, load.what, force, region)


def _end_load(load: SideLoad, at: Coordinates, model: Model, layer: SeamLayer, sides: Interface) -> Iterator[LoadPiece]:
    """Yield a load on the layer's side at straight free ends as forces per area of S, each with its region.

    The regions transfer the forces to the layer's faces, over strips along the ends.

    Args:
        load: the load.
        at: place and time as arguments of the load.
        model: the interface model.
        layer: the layer.
        sides: the two sides of S, for the layer's seam.
    """
    mesh, on_base = model.domain.mesh, layer.name in model.joint.base_seams
    constants = model.applicability[layer.name].end_constants
    assert constants is not None  # weights were made of them
    for end in straight_ends(load.rim, layer.sheet):
        cell_factors = np.zeros((len(model.joint.cells), 1, 5))
        upper_cells = model.joint.surface_cells[layer.sheet.facets, 1]
        cell_factors[upper_cells, 0] = _transfer_factors(end, load.rim, layer, constants)
        facet_factors = sides.upper(model.domain.cellwise_function(("DG", 0, (5,)), cell_factors))
        m, offset = fem.Constant(mesh, end.m), fem.Constant(mesh, end.offset)
        end_coordinates = at.with_place(at.x + (offset - ufl.dot(m, at.x)) * m)
        yield end_coordinates.load(load.load, load.what, len(m), m), _transfer_region(facet_factors, m, sides, on_base)


def _transfer_factors(end: StraightEnd, rim: Rim, layer: SeamLayer, constants: FreeEnd) -> FloatArray:
    """Return five factors (n, 5) on the n facets of S that distribute a traction on the side of a free end over S.

    The first three multiply the traction's components along m (outward in S), along n and along the end. The products
    are forces per area of S, which add up to the total force on the side on any mesh. The last two, times a jump, are
    displacements of the side: along -m for an opening, along -n for a shear.

    Args:
        end: the straight free end.
        rim: the loaded ridges.
        layer: the layer.
        constants: constants of the layer's free ends.
    """
    sheet, eps, kinematics = layer.sheet, layer.eps, layer.structure.kinematics
    points, share_of_strip = sheet.joint.points, partial(strip_shares, end, sheet)
    weighted_areas = sheet.facet_integrals(kinematics.factors_at(points[sheet.vertices].mean(axis=1)))
    midpoints = points[rim.vertices].mean(axis=1)
    end_factor = kinematics.factors_at(midpoints[end.contains(midpoints)]).mean()
    l_N, l_T = constants.opening_strip, constants.shear_strip
    mean_distances = constants.rho_N, constants.c_T, ANTIPLANE_LOAD_DISTANCE
    facet_fractions = [share_of_strip(2 * eps * distance) for distance in mean_distances]
    force_factors = [eps * end.length * end_factor * share / (share @ weighted_areas) for share in facet_fractions]
    opening_factor = constants.inward_displacement / l_N * share_of_strip(eps * l_N)
    shear_factor = constants.c_T / l_T * share_of_strip(eps * l_T)
    return np.stack([*force_factors, opening_factor, shear_factor], axis=1)


def _transfer_region(factors: Expr, m: Expr, sides: Interface, based: bool) -> LoadRegion:
    """Return the region on S in which a traction on the layer's side does its work on the layer's faces.

    Args:
        factors: (5,) factors from `_transfer_factors`, in UFL.
        m: (d,) outward normal of the end in S, in d dimensions.
        sides: the two sides of S, for the layer's seam.
        based: whether S stands on a rigid base.
    """
    n = sides.n
    along_m, along_n, along_end, opening, shear = (factors[k] for k in range(5))

    def mean_part(v: Expr) -> Expr:
        normal_part = (along_m - along_end) * ufl.dot(m, v) * m + (along_n - along_end) * ufl.dot(n, v) * n
        return along_end * v + normal_part

    def jump_part(w: Expr) -> Expr:
        return opening * ufl.dot(n, w) * m + shear * ufl.dot(m, w) * n

    def side_displacement(v: Expr) -> Expr:
        return mean_part((sides.upper(v) + sides.lower(v)) / 2) - jump_part(sides.jump(v))

    def base_displacement(v: Expr) -> Expr:
        return mean_part(sides.upper(v) / 2) + jump_part(sides.upper(v))

    return LoadRegion(sides.measure, sides.factor, sides.upper, side_displacement, base_displacement if based else None)
