"""InterfaceModel, whose layers are replaced by their interface laws on S."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_coefficients

from forms import work as forms
from forms.base import InputError
from forms.kinematics import ScalarField
from forms.law import BulkLaw
from forms.series import Stack, upper_share
from forms.tensors import Expr
from forms.work import Interface, InterfaceSide
from geometry.domain import Domain
from geometry.inflating.inflation import with_gaps
from geometry.inflating.kept_bodies import body_translations
from geometry.inflating.layering import check_layering
from geometry.joint import Joint
from geometry.refusals import require_known
from geometry.seam import S
from geometry.topology import FloatArray, Splitting
from thinlayer.discretisation.boundary import require_revolution
from thinlayer.discretisation.coefficient import Coordinates
from thinlayer.discretisation.forces import Forces, LoadRegion
from thinlayer.discretisation.form_compilation import law_with_expressions
from thinlayer.discretisation.layer import Layers, SeamLayer, SurfaceSource, law_of_terms, law_with_numbers
from thinlayer.discretisation.mesh_functions import MidSurface, cellwise_function, relative_thickness
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.side_loads import add_side_loads
from thinlayer.discretisation.time_functions import HandedField
from thinlayer.errors import Violation
from thinlayer.pointwise.quadrature import quadrature_degree
from thinlayer.system.compat import ufl_replace
from thinlayer.system.ranks import errors_on_all

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

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
            if layer.thin_layer and layer.thin_layer.order == 1:
                add_side_loads(forces, self, layer, self.sides_of(layer.name))
        return forces

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
        strain = layer.prescribed_strain(self._coordinates_on(self.coordinates))
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
        return [replace(term, key=layer.key, law=law_of_terms(term.law, mesh)) for term in terms]

    def _thickness(self, layer: SeamLayer, sides: Interface) -> Expr:
        if self._middle:
            return self._middle.thickness(sides)
        eps: Expr = fem.Constant(self.domain.mesh, layer.eps)
        profile = layer.as_thin_layer.profile
        return eps if profile is None else eps * sides.upper(relative_thickness(self.domain, profile, layer.name))

    def _description(self) -> dict[str, Any]:
        names = [name for name, applicability in self.applicability.items() if applicability.weights]
        return super()._description() | ({"free ends": names} if names else {})

    def load_region(self, layer: SeamLayer, source: SurfaceSource | None = None) -> LoadRegion:
        """Return the region on S where the loads and the mass of a layer act.

        Its weight contains the thickness, if the layer has one. Each side of S carries half of a load, of a source its
        share. On a rigid base, the base carries the lower part.
        """
        sides, law = self.sides_of(layer.name), layer.thin_layer.law if layer.thin_layer else None
        share: Expr | float = 0.5 + (source.height if source else 0.0)  # of the upper side
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

        return LoadRegion(sides.measure, weight, sides.upper, work_argument, base_argument, jump=sides.jump)


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
        expressions[parameter] = upper(cellwise_function(domain, ("Lagrange", 1), values[joint.corners][..., None]))
    return law_with_expressions(law, domain.mesh, expressions)
