"""FullModel, whose layers are meshed, and LayerModel, which has the meshed layers without bodies."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Self

import numpy as np
import ufl
from dolfinx import fem
from scipy.spatial import cKDTree

from forms import work as forms
from forms.base import InputError, is_finite, require
from forms.law_tangents import depends_on_normal
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.inflating.dividing import RefinedLayers, refined_towards_ends
from geometry.inflating.inflation import inflate, without_bodies
from geometry.inflating.layering import CellsThrough, check_layering
from geometry.joint import InflatedBand, Joint
from geometry.parallel import on_root
from geometry.refusals import require_known
from thinlayer.discretisation.boundary import require_normal_shifts, require_revolution
from thinlayer.discretisation.forces import LoadRegion
from thinlayer.discretisation.form_compilation import law_with_constants
from thinlayer.discretisation.layer import Layers, SeamLayer, SurfaceSource, ThinLayer, law_with_numbers
from thinlayer.discretisation.mesh_functions import band_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import Place
from thinlayer.errors import Violation

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

MAX_EPS_RATIO = 1e6  # largest thickness over the bodies' size: beyond it coordinates have fewer than ten digits left


class FullModel(Model):
    """Model of a structure whose layers are meshed, with all methods of a `Model`.

    Attributes:
        inflated_joint: the joint with the cells of the layers, after S was opened to the layers' thickness.
    """

    name = "full"
    inflated_joint: Joint

    def __init__(
        self, structure: Structure, layer: Layers, bodies: str, cells_through: CellsThrough, junctions: str | None
    ) -> None:
        self._body_shape, self._cells_through = bodies, cells_through
        self._junctions = () if junctions is None else (junctions,)
        options = {} if junctions is None else {"junctions": junctions}
        super().__init__(structure, layer, bodies=bodies, cells_through=cells_through, **options)

    def _checked_joint(self) -> Joint:
        check_layering(self._cells_through, self._body_shape)
        if self._body_shape == "kept":
            require_normal_shifts(self.structure.kinematics, self.joint)
        self._check_layers()
        for name in self._junctions:
            require_known("seam", name, self.layers, "junctions")
        thin_layers = {name: seam_layer.as_thin_layer for name, seam_layer in self.layers.items()}
        eps = {name: layer.eps for name, layer in (thin_layers | self.gaps).items()}
        if (thickest := max(eps.values(), default=0.0)) > MAX_EPS_RATIO * self.joint.size:
            text = f"the layer's thickness eps is {thickest:g}, the bodies measure {self.joint.size:g}"
            raise InputError(f"{text}: their shape is lost in rounding; is eps in the unit of the mesh?")
        profiles = {name: layer.profile for name, layer in thin_layers.items()}
        fractions = {name: layer.fractions for name, layer in thin_layers.items()}
        priority, n_cells, gaps = (*self._junctions, *thin_layers), self._cells_through, [*self.gaps]
        inflater = partial(inflate, self.joint, eps, cells_through=n_cells, bodies=self._body_shape, junctions=priority)
        inflated = on_root(self.structure.comm, partial(inflater, profile=profiles, fractions=fractions, gaps=gaps))
        self._check_junctions(band_of(inflated))
        require_revolution(self.structure.kinematics, inflated)
        self.inflated_joint = inflated
        return inflated

    def _check_layers(self) -> None:
        """Raise InputError if a seam has a `Bond`, is open with unknown width, or has a layer that cannot be meshed."""
        for name in self.bonds:
            raise InputError(f"the seam {name!r} has a Bond, for interface models: make a joint without it")
        for name in (name for name, layer in self.on_seams.items() if layer is None):
            remedy = "give it a Gap(eps), or use structure.interface"
            raise InputError(f"the seam {name!r} is open, and its width is not known: {remedy}")
        self.require("mesh")

    def _check_compatible(self, other: Self) -> None:
        self._check_layers()
        self._require_shapes(other)
        self._check_junctions(band_of(self.domain.joint))

    def _check_junctions(self, band: InflatedBand) -> None:
        """Raise InputError if a law does not suit cells where several layers meet (junctions).

        Such cells have no normal of S, and they are not in columns, which are cells above each other through the
        thickness.

        Args:
            band: the meshed layers, which say where seams meet and which law each junction has.
        """
        for region, name in band.junctions.items():
            law = self.applicability[name].law
            why = "depends on the normal of S, which is not defined where layers meet"
            if law.traits.switches:
                why = "has one phase for each column of a layer, and cells where layers meet are in none"
            elif region in band.aligned_junctions or not depends_on_normal(law):
                continue
            subject = f"{type(law).__name__} of the seam {name!r}"
            raise InputError(f"{subject} {why}; give junctions=... the name of a seam with another law")

    def _layer_terms(self) -> list[forms.Term]:
        mesh, band, n = self.domain.mesh, band_of(self.domain.joint), director(self.domain)
        terms = []
        for name, seam_layer in self.layers.items():
            sublayers = law_with_numbers(seam_layer.layer, self.kinematics).sublayers
            for (_, law), region in zip(sublayers, band.regions_of_seam[name], strict=True):
                if law.traits.softens:  # at points as dense along S as on S in an interface model
                    rule = self._metadata(ufl.dS, always=True)
                else:  # UFL would take degree 100 for the square root of the director
                    rule = self._metadata(self.dx, always=depends_on_normal(law))
                measure = self.dx(self.domain.region_tags(region, *self._junction_regions(name)), **rule)
                term = forms.layer_term(law_with_constants(law, mesh), measure, n, self.kinematics)
                terms.append(replace(term, key=seam_layer.key, prescribed_strain=self.layer_strains[name]))
        return terms

    def load_region(self, layer: SeamLayer, source: SurfaceSource | None = None) -> LoadRegion:
        """Return the cells of a layer, also those with its law where meshed layers meet."""
        if source and (source.height or layer.described_profile):
            raise InputError(
                f"a SurfaceSource at {source.height:g} of a meshed layer: allowed: 0, in a uniform thickness"
            )
        regions = [*band_of(self.domain.joint).regions_of_seam[layer.name], *self._junction_regions(layer.name)]
        factor = self.kinematics.factor / fem.Constant(self.domain.mesh, layer.eps if source else 1.0)
        return LoadRegion(self.dx(self.domain.region_tags(*regions)), factor)

    def _junction_regions(self, name: str) -> list[str]:
        """Return the names of those regions of cells, where layers meet, that have the law of the seam `name`."""
        return [region for region, seam in band_of(self.domain.joint).junctions.items() if seam == name]


class LayerModel(FullModel):
    """The layers of an interface model, meshed as in a full model, with their loads and supports but without bodies.

    Each rank has the whole mesh. The faces of the layers are not constrained, so that the model alone cannot be solved.

    Attributes:
        refined_layers: the layers with cells that become smaller towards free ends and junctions; None if `at_ends` is
            None, or if there are no such ends.

    Args:
        model: the interface model.
        layers: name of a seam -> its layer.
        cells_through: number of cells through the thickness, or {name of a seam: heights between which cells lie}.
        at_ends: largest length of cells along S at free ends and junctions, divided by the least thickness of the
            layers. None: the cells are as long as the facets of S.

    Raises:
        InputError: `at_ends` is not a number > 0, or so small that nodes would coincide; the layers' seams meet others.
    """

    name = "layer"
    refined_layers: RefinedLayers | None = None

    def __init__(
        self, model: Model, layers: Mapping[str, ThinLayer], cells_through: CellsThrough, at_ends: float | None = None
    ) -> None:
        structure, joint = model.structure.with_layers_only(layers), model.joint
        if at_ends is not None:
            require(is_finite(at_ends) and at_ends > 0, "at_ends", at_ends, "allowed: > 0, over the thickness")
            at_ends *= min(float(layer.eps) for layer in layers.values())
        if structure.joint.tip is not None and (violation := why_not_alone(joint, structure.joint.seams)):
            raise violation.error()
        free = [model.applicability[name].free_rim.vertices.ravel() for name in layers]
        self._ends, self._at_ends = joint.points[np.unique(np.concatenate([*free, joint.branch_vertices]))], at_ends
        super().__init__(structure, layers, bodies=model._body_shape, cells_through=cells_through, junctions=None)

    def _checked_joint(self) -> Joint:
        layer_joint = without_bodies(super()._checked_joint())
        if self._at_ends is not None and len(self._ends):
            end_distances, _ = cKDTree(self._ends).query(layer_joint.reference)
            try:
                self.refined_layers = refined_towards_ends(layer_joint, end_distances, self._at_ends)
            except InputError:
                raise InputError("cells at ends are so short that nodes coincide; make at_ends larger") from None
            layer_joint = self.refined_layers.joint

        def has(place: Place) -> bool:
            if isinstance(place, str):
                return place in layer_joint.facets
            return bool((layer_joint.reference == self.joint.points[self.joint.nearest_point(place)]).all(axis=1).any())

        self.structure.supports = {place: support for place, support in self.structure.supports.items() if has(place)}
        return layer_joint

    @property
    def surface_identity(self) -> object:
        """Object that is one and the same for all models whose fields on S fit each other.

        A model with cells refined at ends has fields that fit no other model: the object is the model itself.
        """
        return super().surface_identity if self._at_ends is None else self

    def require_supported(self) -> None:
        """Accept the model without supports, as it has no bodies that would support its layers."""


def why_not_alone(joint: Joint, seams: Iterable[str]) -> Violation | None:
    """Return why the layers on `seams` cannot be solved without other layers; None if no other seam meets theirs."""
    vertices = {name: joint.masters[joint.table.vertices[joint.rows_of(name)]] for name in joint.seams}
    own_vertices = np.concatenate([vertices[name].ravel() for name in seams])
    other_seams = [name for name in joint.seams if name not in seams and np.isin(vertices[name], own_vertices).any()]
    if not other_seams:
        return None
    reason = f"{', '.join(seams)} meets {', '.join(other_seams)}, where bodies part without a layer among these"
    remedy = "take all seams that meet, or mesh the layers: structure.full, with a Gap in an open seam"
    return Violation("beside", f"layers by themselves: {reason}", remedy)


def director(domain: Domain) -> Expr:
    """Return the unit normal (d,) of S, in UFL, from the lower to the upper body in the meshed layer's cells.

    It is not defined in the bodies.
    """
    joint, directors = domain.joint, band_of(domain.joint).director
    cell_directors = np.zeros((*joint.corners.shape, joint.dim))
    cell_directors[-len(directors) :] = directors
    n = domain.cellwise_function(("DG", 1, (joint.dim,)), cell_directors)
    return n / ufl.sqrt(ufl.dot(n, n))
