"""Model: a discretised structure, the base of models with meshed layers and of models with interface laws."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import add
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np
import ufl
from dolfinx import fem

from forms import work as forms
from forms.base import InputError
from forms.law import BulkLaw
from forms.tensors import Expr, scalar_gradient, scalar_strain, three_dimensional
from geometry.domain import Domain
from geometry.inflating.layering import value_by_seam
from geometry.joint import Joint
from geometry.seam import BASE
from geometry.sheet import volume_of
from geometry.topology import FloatArray, Indices, Splitting, is_tensor
from thinlayer.discretisation.applicability import Applicability
from thinlayer.discretisation.coefficient import Coordinates, LoadInput, Pressure, Value, takes_place_only
from thinlayer.discretisation.constraints import Constraints
from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.forces import BodyForce, Forces, LoadRegion
from thinlayer.discretisation.form_compilation import (
    checked_term,
    compiled_functionals,
    compiled_terms,
    law_with_constants,
    mesh_origin,
)
from thinlayer.discretisation.key import BODY_KIND, Key
from thinlayer.discretisation.layer import (
    BODIES,
    Bond,
    Gap,
    Layers,
    SeamContent,
    SeamLayer,
    SurfaceSource,
    ThinLayer,
    law_with_numbers,
    loads_of_layers,
)
from thinlayer.discretisation.mesh_functions import mesh_cut_at_faces, vector_space
from thinlayer.discretisation.part_definition import PartDefinition, check_part_definitions
from thinlayer.discretisation.point_loads import ConcentratedLoad, check_loads
from thinlayer.discretisation.prescribed_strains import (
    EigenstrainContext,
    EigenstrainInput,
    MeanGradient,
    MeanStrain,
    MeanStress,
    MeanTensorInput,
)
from thinlayer.discretisation.rigid_motions import Resultant, free_axes, load_resultants, moment_centre, require_support
from thinlayer.discretisation.supports import Place, SupportConditions, Supports, SupportsByPlace, is_same_or_part
from thinlayer.discretisation.time_functions import TimeLevel
from thinlayer.errors import warn
from thinlayer.pointwise.quadrature import Quadrature, quadrature_degree
from thinlayer.system.compat import compiled, interpolate, interpolation_points
from thinlayer.system.fingerprint import describe, digest
from thinlayer.system.ranks import errors_on_all, free_petsc_objects, require_same

if TYPE_CHECKING:
    from thinlayer.discretisation.structure import Structure

T = TypeVar("T")
# cached properties that follow from mesh and bonds alone, which all models on one mesh share
MESH_CACHE_NAMES = ("split_mesh", "node_coordinates", "volume", "_middle", "dS", "sides")


def copy_without_caches(source: T, keep: Collection[str] = ()) -> T:
    """Return a copy of an object without the values of its cached properties, except those named in `keep`.

    Cached values may change with the data of the object, so that the copy computes them anew.
    """
    new = copy.copy(source)
    for name in vars(source).keys() - {*keep}:
        if isinstance(getattr(type(source), name, None), cached_property):
            del vars(new)[name]
    return new


@dataclass
class ModelFamily:
    """Models that share mesh, space and matrices, and differ in the laws of their layers or in their loads.

    Only one solver at a time has the shared matrices. Another solver that begins at the same time makes its own.

    Attributes:
        is_shared: whether a model was made from another one; if not, no matrices are stored for later solvers.
        idle_matrices: the `SharedMatrices` that no solver has at present; None: there are none.
    """

    is_shared: bool = False
    idle_matrices: Any = None


class Model(ABC):
    """A discretised structure with a thin soft layer, made by `Structure.full`, `interface` or `bonded`.

    Attributes:
        structure: the structure, shared with other models.
        joint: the joint as drawn, before S is opened to the layers' thickness.
        plane: "strain", "stress" or "axisymmetric".
        element: name of the finite element of displacements, such as "P2".
        body_laws: name of a body -> its law.
        on_seams: name of a seam -> what is on it: a layer, a `Bond`, a `Gap`, or None for an open seam.
        layers: name of a seam -> its layer, in the joint's order.
        bonds: names of the seams whose bodies are bonded.
        gaps: name of a seam -> its `Gap`; open seams without a width are left out.
        contacts: name of a seam -> its contact law.
        contact: the first of these laws; None if there is none.
        applicability: name of a seam -> range of validity of the interface law of its layer.
        domain: the distributed mesh.
        comm: the domain's communicator.
        n_components: number c of components of the unknown: d displacements, or the one value of a scalar field.
        V: space of the unknown; broken across S in the interface model.
        unknowns: number of dofs of V, those at supports included.
        dx: measure of the cells with their tags, for user-defined terms. Compile forms that contain it with
            `model.form`: DOLFINx 0.9 itself loses integrals over overlapping tags whose quadratures differ, as for a
            body and its weight on quadrilaterals. Regions and facets: `model.dx(model.domain.region_tags(name))`,
            `model.ds(model.domain.values(name))`. Only `model.form` accepts plain `ufl.dx` in the same form,
            `dolfinx.fem.form` does not.
        ds: the same of the outer facets.
        bodies, layer_terms: terms of the laws of the bodies and of the layers, with prescribed strains that may depend
            on the time; `State.bodies` and `State.layers` are these terms at the time of a state.
        body_strains, layer_strains: name of a body, or of a seam -> minus its eigenstrain (3, 3), which is added to the
            strain of the displacements; None: there is no eigenstrain.
        supports: displacements that supports prescribe.
        constraints: the supports as conditions at the nodes of V, and the multi-point constraints.
        forces: tractions, body forces, and loads at points and along lines.
        strain, stress: prescribed mean strain and mean stress of a periodic cell; None: not prescribed.
        parts: definitions of further parts of the balance of forces, such as springs.
        origin: relation of the mesh to the joint, for compiled laws: numbers of cells and facets, coordinates, and
            columns (cells above each other through the thickness).
        kinematics: strains of displacements on the mesh, and the factor of all measures.
        coordinates: place and time as arguments of users' functions, and the clock.
        centre: (d,) mean of the mesh's points in d dimensions; in axisymmetry its projection onto the axis.
        broken: whether displacements jump across S.
        data_hash: hash of the data, equal on all ranks.
        issued_warnings: keys of the warnings issued so far, each with its subject, such as a seam.
        family: matrices and other data shared with the models made from this one by `with_layer` and `with_loads`.
        description: description, as JSON, of the data at the time the model was built.
    """

    name: ClassVar[str]
    broken: ClassVar[bool] = False
    _body_shape = "kept"

    def __init__(self, structure: Structure, layer: Layers, **options: object) -> None:
        self.structure, self.joint, self.plane = structure, structure.joint, structure.plane
        self.element, self.body_laws, self.parts = structure.element, structure.body_laws, structure.parts
        self._options, self.family, self.issued_warnings = options, ModelFamily(), set[tuple[Hashable, ...]]()
        domain_joint = self._set_layers(layer, self._checked_joint)
        self.domain = Domain.of(domain_joint, structure.comm)
        self.comm = self.domain.comm
        self.centre = moment_centre(structure.kinematics, np.asarray(domain_joint.points.mean(axis=0), float))
        self.n_components = len(structure.kinematics.components(self.joint.dim))
        self.V = self.space(structure.degree, family="S" if self.element[0] == "S" else None)
        free_petsc_objects(self.comm, self.V)
        self.unknowns = int(self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs)
        self.kinematics = structure.kinematics.on_mesh(self.domain.mesh)
        self.coordinates = Coordinates.of_domain(self.domain)
        self.origin = mesh_origin(self.domain)
        mesh, strain, stress = self.domain.mesh, structure.strain, structure.stress
        self.dx = ufl.Measure("dx", domain=mesh, subdomain_data=self.domain.cell_tags)
        self.ds = ufl.Measure("ds", domain=mesh, subdomain_data=self.domain.facet_tags)
        with errors_on_all(self.comm):
            self.supports = self._make_supports(structure.supports)
            self.body_strains = {name: self._body_strain(name) for name in self.body_laws}
            self.layer_strains = {name: self._layer_strain(seam_layer) for name, seam_layer in self.layers.items()}
            if not (strain is None and stress is None):
                self.require("mean strain")
            self.strain = None if strain is None else self._mean_strain(strain, self.coordinates)
        self.bodies = self._with_mean_strain(self._terms_of_bodies())
        self.layer_terms = self._terms_of_layers()
        with errors_on_all(self.comm):
            self.forces = self._make_forces()
        with errors_on_all(self.comm):
            self.stress = None if stress is None else MeanStress(stress, self.coordinates, self.joint, self.cell_terms)
        with errors_on_all(self.comm):
            check_part_definitions(self.parts, self)
        self.constraints = self._make_constraints()
        self.require_supported()
        self.description = self._description()

    def warn(self, key: str, message: str, *subject: Hashable) -> None:
        """Issue a RangeWarning with a key and a message, but only once for each subject. Collective.

        Args:
            key: kind of the warning.
            message: text of the warning.
            subject: the subject, such as a seam and a time.
        """
        if (key, *subject) not in self.issued_warnings:
            warn(key, message, self.comm)
            self.issued_warnings.add((key, *subject))

    def require_supported(self) -> None:
        """Raise InputError if the structure can move as a rigid body, or a scalar field without capacity is not fixed.

        In a periodic joint translations that nothing prevents are first fixed at one vertex.
        """
        has_capacity = self.n_components == 1 and all(law.traits.rate for law in self.body_laws.values())
        if not (has_capacity or (self.broken and any(name in self.layers for name in self.joint.base_seams))):
            resistances = [partial(part.rigid_stiffness, self) for part in self.parts if not part.has_constraint]
            if self.joint.periods:
                self.supports.anchor_axes = free_axes(self, resistances)
                self.constraints = self._make_constraints()
            require_support(self, resistances)

    def _set_layers(self, data: Layers, check: Callable[[], T]) -> T:
        """Set the layers of the seams from a user's data, and return the result of a check of them. Collective.

        Args:
            data: one layer for all seams, or name of a seam -> its layer, bond, gap or None.
            check: function that is called when the layers are set; it raises errors if they do not fit.
        """
        structure = self.structure
        with errors_on_all(structure.comm):
            self.on_seams: dict[str, SeamContent] = value_by_seam(self.joint, data, "layer")
            layers = {name: value for name, value in self.on_seams.items() if not isinstance(value, Gap | Bond | None)}
            self.layers = {name: SeamLayer(name, content, structure) for name, content in layers.items()}
            self.bonds = tuple(name for name, content in self.on_seams.items() if isinstance(content, Bond))
            self.gaps = {name: content for name, content in self.on_seams.items() if isinstance(content, Gap)}
            self.contacts = {name: layer.contact for name, layer in self.layers.items() if layer.contact}
            self.contact = next(iter(self.contacts.values()), None)
            self.applicability = {name: Applicability(layer, self._body_shape) for name, layer in self.layers.items()}
            result = check()
        layer_hash = require_same(structure.comm, model=self.name, layer=data, options=self._options)
        self.data_hash = structure.data_hash + layer_hash
        return result

    def _body_strain(self, name: str) -> Expr | None:
        """Return minus the eigenstrain of the body `name`, (3, 3) in UFL, which is added to the displacements' strain.

        Return None if there is no eigenstrain.
        """
        law, n = self.kinematics.law(self.body_laws[name]), self.structure.sheet.mean_normal
        context = EigenstrainContext(f"the body {name!r}", law, n, self.structure.kinematics, self.coordinates)
        return context.prescribed_strain(self.structure.eigenstrains.get(name))

    def _layer_strain(self, layer: SeamLayer) -> Expr | None:
        """Return minus the eigenstrain of a layer, (3, 3) in UFL, which is added to the strain of displacements.

        Return None if there is no eigenstrain.
        """
        if layer.thin_layer is None:
            return None
        law, n = law_with_numbers(layer.layer, self.structure.kinematics), layer.sheet.mean_normal
        context = EigenstrainContext(
            str(layer), law, n, self.structure.kinematics, self._coordinates_on(self.coordinates)
        )
        return context.prescribed_strain(layer.thin_layer.eigenstrain)

    def _terms_of_bodies(self) -> list[forms.Term]:
        """Return the terms of the bodies' laws.

        Each body with a compiled law has its own term. Other bodies share a term if they have the same law and
        eigenstrain.
        """
        groups: dict[tuple[int, int], list[str]] = {}
        for name, law in self.body_laws.items():
            groups.setdefault((id(law), id(self.structure.eigenstrains.get(name))), []).append(name)
        terms = []
        for names in groups.values():
            law = law_with_constants(self.kinematics.law(self.body_laws[names[0]]), self.domain.mesh)
            by_key = {str(Key(BODY_KIND, name)): [name] for name in names} if law.traits.compiled else {"": names}
            for key, bodies in by_key.items():
                measure = self.dx(self.domain.region_tags(*bodies), **self._metadata(self.dx))
                term = forms.body(law, measure, self.kinematics, self.volume_strain_degree(law))
                term = replace(term, key=key, prescribed_strain=self.body_strains[names[0]])
                terms.append(checked_term(term, self.V, self.origin))
        return terms

    def _terms_of_layers(self) -> list[forms.Term]:
        return self._with_mean_strain([checked_term(term, self.V, self.origin) for term in self._layer_terms()])

    def _make_supports(self, supports: SupportsByPlace) -> Supports:
        clamped_sets = [name for name in self.bonds if name in self.joint.base_seams]
        clamped_sets += [BASE] if BASE in self.domain.joint.facets and not self.broken else []
        return Supports(self.domain, supports, self.coordinates.with_own_kinks, clamped_sets, self.kinematics)

    # ---------------------------------------------------------------- differences between kinds of models
    def _make_forces(self) -> Forces:
        at = self.coordinates.with_own_kinks
        forces = Forces(self.domain, self.kinematics, self.joint, at, self.structure)
        for name, load in loads_of_layers(self.structure, self.layers, self.bonds).items():
            source = load if isinstance(load, SurfaceSource) else None
            region = self.load_region(self.layers[name], source)
            forces.add_layer_load(name, source.power if source else load, region, self._coordinates_on(at))
        return forces

    def _coordinates_on(self, at: Coordinates) -> Coordinates:
        """Return the coordinates and time in layers, made from those on the mesh, `at`."""
        return replace(at, in_layers=True)

    @abstractmethod
    def load_region(self, layer: SeamLayer, source: SurfaceSource | None = None) -> LoadRegion:
        """Return the region over which a force per volume of the layer, or its mass, or a `source` per area, acts."""

    def require(self, use: str, what: str = "") -> None:
        """Raise InputError if a layer of the model violates a condition for a use of layers.

        Args:
            use: the use, a key of `applicability.CONDITIONS_OF_USE`, such as "interface law" or "mesh".
            what: first words of the message.
        """
        for applicability in self.applicability.values():
            applicability.require(use, what)

    @property
    def surface_identity(self) -> object:
        """Object that is one and the same for all models whose fields on S fit each other."""
        return self.joint.points  # which joints with other seams or periods take from the first one

    @abstractmethod
    def _checked_joint(self) -> Joint:
        """Check that the layers suit the structure, and return the joint that is to be distributed. Not collective."""

    @abstractmethod
    def _layer_terms(self) -> list[forms.Term]:
        """Return the terms of the layers' laws."""

    # ---------------------------------------------------------------- other models of the family
    def with_layer(self, layer: Layers) -> Self:
        """Return this model with other layers, sharing mesh, space, supports, loads and bodies' matrix. Collective.

        Args:
            layer: one layer for all seams, or name of a seam -> its layer, bond or gap, as for `Structure.full` and
                `Structure.interface`. Bonds must be on the same seams. In a full model layers and gaps must have the
                thickness, profile and sublayers of the mesh.

        Raises:
            InputError: the layer does not suit the model; a meshed layer of another thickness, profile or sublayers.
        """
        return self._family_copy()._replace_layers(self, layer)

    def with_interface_laws(self, layers: Mapping[str, ThinLayer]) -> Self:
        """Return this model with other interface laws for some layers; warnings issued before are not repeated.

        The models share mesh, space, supports, loads and bodies' matrix.

        Args:
            layers: name of a seam -> its new layer; the other seams keep theirs.
        """
        new = self._family_copy()
        new.issued_warnings = self.issued_warnings
        return new._replace_layers(self, {**self.on_seams, **layers})

    def _replace_layers(self, other: Self, layer: Layers) -> Self:
        """Replace the layers of this model, which is a copy of another model, and return it. Collective.

        Args:
            other: the model of which this one is a copy.
            layer: the new layers, as for `with_layer`.
        """
        self._set_layers(layer, partial(self._check_compatible, other))
        with errors_on_all(self.comm):
            self.layer_strains = {name: self._layer_strain(seam_layer) for name, seam_layer in self.layers.items()}
        self.layer_terms = self._terms_of_layers()
        with errors_on_all(self.comm):
            self.forces = self._make_forces()
            if self.strain or self.stress:
                self.require("mean strain")
            if self.stress and not self.broken:
                raise InputError("with_layer: under a mean stress a meshed layer is a part of the cell; build a model")
        if self.constraints.mpcs:  # the thickness is a lever arm of plates
            self.constraints = self._make_constraints()
        self.description = self._description()
        return self

    @abstractmethod
    def _check_compatible(self, other: Self) -> None:
        """Raise InputError unless the layers of this model fit the mesh of the model `other`."""

    def _require_shapes(self, other: Self) -> None:
        """Raise InputError unless layers and gaps have the same thickness and profile as those of the model `other`.

        Meshed layers must also have the same sublayers.
        """
        count = 2 if self.broken else 3  # sublayers have cells in meshed layers only
        shapes = ({name: layer.mesh_data[:count] for name, layer in model.layers.items()} for model in (self, other))
        required, available = (model.gaps | shape for model, shape in zip((self, other), shapes, strict=True))
        for name in (name for name in required if required[name] != available.get(name)):
            text = f"{name!r} of (thickness, profile, fractions) {available.get(name)}, not {required[name]}"
            raise InputError(f"bodies have made room for a layer {text}; make a model of its own")

    def with_loads(
        self,
        *,
        tractions: Mapping[str, LoadInput | Pressure] | None = None,
        body_force: BodyForce | None = None,
        fluxes: Mapping[str, Value] | None = None,
        sources: Value | Mapping[str, Value] | None = None,
        loads: Sequence[ConcentratedLoad] | None = None,
        supports: SupportsByPlace | None = None,
    ) -> Self:
        """Return this model under other loads; it shares mesh, space, matrices and their factorisation. Collective.

        Args:
            tractions: name of a facet set -> traction (d,) in d dimensions, or `Pressure`; None: unchanged.
            body_force: force per volume (d,), or name of a region or seam -> this force; None: unchanged.
            fluxes, sources: the same of a scalar field, numbers instead of vectors.
            loads: list of `PointLoad` and `LineLoad`; None: unchanged.
            supports: other values at the same places and components; None: unchanged.

        Raises:
            InputError: a load or support that `Structure` refuses; supports of other places or components.
        """
        with errors_on_all(self.comm):
            checked_loads = None if loads is None else check_loads(loads)
        data: dict[str, Any] = {"fluxes": fluxes, "sources": sources, "loads": checked_loads, "supports": supports}
        new = self._family_copy(self.structure.with_loads(tractions=tractions, body_force=body_force, **data))
        with errors_on_all(self.comm):
            if supports is not None:
                new.supports = self._make_supports(supports)
                new.supports.anchor_axes = self.supports.anchor_axes
                pair = self.supports, new.supports
                expected, other = ([(place, sorted(components)) for place, components in bcs.entries] for bcs in pair)
                if expected != other:
                    raise InputError(f"supports hold {other}, those of the model {expected}; build another structure")
                new.constraints = new._make_constraints()
            new.forces = new._make_forces()
        new.description = new._description()
        return new

    def with_bodies(
        self, laws: Mapping[str, BulkLaw], eigenstrains: Mapping[str, EigenstrainInput] | None = None
    ) -> Self:
        """Return this model with other laws or eigenstrains of bodies. Collective.

        It shares mesh, space, supports and loads. The laws are not checked.

        Args:
            laws: name of a body -> its new law; other bodies keep theirs.
            eigenstrains: name of a body -> its new eigenstrain; None: unchanged.
        """
        laws, strains = {**self.body_laws, **laws}, {**self.structure.eigenstrains, **(eigenstrains or {})}
        new = self._family_copy(self.structure.replaced(body_laws=laws, eigenstrains=strains))
        new.family, new.body_laws, new.issued_warnings = ModelFamily(), laws, self.issued_warnings
        with errors_on_all(self.comm):
            new.body_strains = {name: new._body_strain(name) for name in new.body_laws}
        new.bodies = new._with_mean_strain(new._terms_of_bodies())
        new.description = new._description()
        return new

    def with_parts(self, parts: Sequence[PartDefinition]) -> Self:
        """Return this model with other data of its parts without constraints, which are not checked. Collective."""
        new = self._family_copy(self.structure.replaced(parts=tuple(parts)))
        new.family, new.parts = ModelFamily(), new.structure.parts
        new.forces = new._make_forces()
        new.description = new._description()
        return new

    def _make_constraints(self) -> Constraints:
        mpcs = [part.multi_point_constraint(self) for part in self.parts if part.has_constraint]
        return Constraints(SupportConditions(self.supports, self.V), mpcs)

    def under_mean_strain(self, strain: MeanTensorInput) -> Self:
        """Return a copy of this model of a periodic cell, whose only load is a mean strain. Collective.

        The copy has no other loads and no eigenstrains. It shares no matrices with other models, as they would contain
        its strain.

        Args:
            strain: (d, d) symmetric numbers in d dimensions, or a function (x, t) of the time t alone that returns
                them; for a scalar field its mean gradient (d,).
        """
        new = copy_without_caches(self, keep=MESH_CACHE_NAMES)
        new.family, new.coordinates = ModelFamily(), Coordinates.of_domain(self.domain)
        new.strain, new.stress = self._mean_strain(strain, new.coordinates), None
        new.bodies = new._with_mean_strain([replace(p, prescribed_strain=None) for p in self.bodies])
        new.layer_terms = new._with_mean_strain([replace(p, prescribed_strain=None) for p in self.layer_terms])
        new.structure = self.structure.with_loads(
            **{name: {} for name in self.kinematics.quantities.load_arguments}, loads=()
        )
        new.forces = new._make_forces()
        return new

    def _family_copy(self, structure: Structure | None = None) -> Self:
        """Return a copy that shares mesh, space and matrices, without warnings and cached values that laws change.

        `structure` is the structure of the copy, if it is another one.
        """
        self.family.is_shared = True
        new = copy_without_caches(self, keep=MESH_CACHE_NAMES)
        new.issued_warnings = set()
        if structure is not None:
            new.structure, new.data_hash = structure, digest([self.data_hash, structure.data_hash])
        return new

    @property
    def remarks(self) -> list[str]:
        """Sentences for the log that name choices made for the user, such as the correction of free ends."""
        return []

    def meshing_translations(self) -> FloatArray | None:
        """Return the translations (n_cells, d) of the joint's cells that meshing the layers would cause.

        Return None if they are zero, as in a model whose layers are meshed, or not known.
        """
        return None

    # ---------------------------------------------------------------- spaces
    @cached_property
    def split_mesh(self) -> Splitting:
        """The joint's mesh with cuts where displacements jump."""
        return self.domain.joint.split_along(np.empty(0, np.int64))

    @cached_property
    def node_coordinates(self) -> FloatArray:
        """Coordinates (n, d) of this rank's nodes of `V`, interpolated in `V`; ghosts are last. Collective."""
        f, d, c = fem.Function(self.V), self.joint.dim, self.n_components
        columns = []
        for k in range(0, d, c):  # as many coordinates at once as V has components
            interpolate(f, lambda x, k=k: x[k : k + c])
            f.x.scatter_forward()
            columns.append(f.x.array.reshape(-1, c).copy())
        return np.concatenate(columns, axis=1)

    def unknown_at_rest(self, t: float) -> fem.Function:
        """Return the unknown before the first step, which begins at the time t: zero, or `initial`. Collective."""
        u = fem.Function(self.V)
        if self.structure.initial is not None:
            value, at = self.structure.initial, self.coordinates
            value = at.coefficient(value, "initial", (), place_only=takes_place_only(value)).expression
            field = ufl.as_vector([value]) + fem.Constant(self.domain.mesh, np.zeros(1))  # as value may be a number
            with self.coordinates.clock.at(t):
                interpolate(u, fem.Expression(field, interpolation_points(self.V)))
        return u

    def space(self, degree: int, *, family: str | None = None, broken_at_faces: bool = False) -> fem.FunctionSpace:
        """Return a space of vector functions on the model's mesh, with the jumps of its displacements. Collective.

        Args:
            degree: polynomial degree.
            family: basix family (default: Lagrange).
            broken_at_faces: whether functions also jump between the meshed layer and the bodies, or across S.
        """
        cut = mesh_cut_at_faces(self.domain.joint) if broken_at_faces else self.split_mesh
        return vector_space(self.domain, cut, degree, family or "Lagrange", self.n_components)

    # ---------------------------------------------------------------- where laws act
    def _metadata(self, measure: ufl.Measure, *, always: object = False) -> dict[str, dict[str, int]]:
        """Return metadata of a law's measure: the quadrature degree, or none if UFL is to choose it.

        The degree is set on quadrilaterals and hexahedra, in axisymmetry, and if `always` is true. The latter is for
        laws for which UFL would estimate a high degree.
        """
        if not (always or is_tensor(self.joint.cell_type) or self.kinematics.factor_degree):
            return {}
        return {"metadata": {"quadrature_degree": quadrature_degree(self.V, measure) + self.kinematics.factor_degree}}

    def volume_strain_degree(self, law: BulkLaw) -> int | None:
        """Return the polynomial degree to which the volume strain is projected in each cell, for isochoric flow laws.

        It is one below the degree of the displacements. Return None if no projection is needed: in straight triangles
        and tetrahedra the volume strain has this degree anyway. Other cells have more modes of volume strain. A flow
        without volume change would have to keep all of them at zero, so that the cells lock (Sloan and Randolph 1982).
        """
        is_straight = not (is_tensor(self.joint.cell_type) or self.kinematics.factor_degree)
        return self.structure.degree - 1 if law.traits.isochoric and not is_straight else None

    def _with_mean_strain(self, terms: list[forms.Term]) -> list[forms.Term]:
        """Return terms with the prescribed mean strain of a periodic cell added to their strains.

        All terms are unchanged if no mean strain is prescribed, and terms on S as far as `uniform_strain_in` says.
        """
        if self.strain is None:
            return terms
        strains = ((p, self.uniform_strain_in(p, self.strain.expression)) for p in terms)
        return [p if e is None else forms.with_added_strain([p], e)[0] for p, e in strains]

    def uniform_strain_in(self, term: forms.Term, strain: Expr) -> Expr | None:
        """Return the part (3, 3) of a uniform strain, UFL, that a term has besides that of jumps; None: it has none.

        On S only laws of a scalar field have a part: along S from order 1 on, and across S where bodies give up the layer's
        thickness.
        """
        if term.measure.integral_type() == "cell":
            return strain
        layer = next(layer for layer in self.layers.values() if layer.owns_key(term.key))
        has_along = self.n_components == 1 and layer.as_thin_layer.order > 0
        has_across = self.n_components == 1 and self.domain.joint.parted is not None
        if not (has_along or has_across):
            return None
        gradient, n = scalar_gradient(strain), three_dimensional(term.n)
        across = ufl.dot(gradient, n) * n
        return scalar_strain((gradient - across) * has_along + across * has_across)

    def _mean_strain(self, strain: MeanTensorInput, at: Coordinates) -> MeanStrain:
        return (MeanGradient if self.n_components == 1 else MeanStrain)(strain, at, self.joint)

    @property
    def cell_terms(self) -> list[forms.Term]:
        """Terms of the laws of bodies and of meshed layers, which are integrals over cells."""
        return self.bodies if self.broken else self.terms

    @cached_property
    def volume(self) -> float:
        """Volume of bodies and meshed layers; in a periodic cell it includes that of layers on S. Collective."""
        if self.joint.periods is not None and self.domain.joint.parted is not None:
            return volume_of(self.joint, np.ones(len(self.joint.cells), bool))
        volume_form = sum(fem.Constant(self.domain.mesh, 1.0) * p.weight * p.measure for p in self.cell_terms)
        return float(self.comm.allreduce(sum(map(fem.assemble_scalar, compiled_functionals(volume_form)))))

    @property
    def terms(self) -> list[forms.Term]:
        """Terms of the laws of all bodies and layers."""
        return self.bodies + self.layer_terms

    def contact_surface(self, name: str) -> ContactSurface:
        """Return the facets of the seam `name` of an interface model, and the cells on their two sides."""
        return ContactSurface(self.V, self.comm, *self.domain.sides(name), self.kinematics)

    @cached_property
    def surface_mesh_cache(self) -> dict[str, object]:
        """Meshes of S (`SurfaceMesh`) made so far, by the name of their seam."""
        return {}

    @cached_property
    def quadratures(self) -> dict[str, Quadrature]:
        """Quadrature points of the model's compiled laws, by the key of the law's memory. Collective."""
        return {key: Quadrature(self.V, p, self.origin) for key, p in compiled_terms(self.terms).items()}

    def seam_sums(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the sum of values for the layer of each seam, by the seam's name; empty if the joint has one seam.

        Args:
            values: key of a law, such as "layer BED/1" -> a value, such as an energy.
        """
        layers = self.layers if len(self.joint.seams) > 1 else {}
        return {name: sum(v for key, v in values.items() if layer.owns_key(key)) for name, layer in layers.items()}

    def bc_dofs_in(self, V: fem.FunctionSpace) -> Indices:
        """Return the local degrees of freedom of V, ghosts included, that supports and multi-point constraints act on.

        Collective. Those of clamped facets, as on a rigid base, and of the vertex at which a periodic joint is fixed
        are left out.
        """
        part_dofs = [part.bc_dofs_in(self, V) for part in self.parts]
        return np.unique(np.concatenate([self.supports.bc_dofs_in(V, clamped=False), *part_dofs]))

    def held_indices(self, place: Place) -> list[int]:
        """Return the indices in `held_places` of a place and of its parts, as "NAME/REGION" is a part of "NAME"."""
        return [k for k, name in enumerate(self.held_places) if is_same_or_part(name, place)]

    @property
    def held_places(self) -> list[Place]:
        """Places that support the structure, one for each row of `Configuration.reactions`.

        Supports come first. Clamped facets, facet sets of multi-point constraints, and rigid bases below layers on S
        follow.
        """
        base_seams = [name for name in self.layers if name in self.joint.base_seams] if self.broken else []
        mpc_places = [part.place for part in self.parts if part.has_constraint]
        return [*(place for place, _ in self.supports.entries), *mpc_places, *base_seams]

    def sums_by_seam_and_bodies(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return sums of values: for the layer of each seam by name, and for all bodies under "bodies".

        In a joint with one seam the layer has no entry. "bodies" has one only if the law of a body has memory or
        depends on rates.

        Args:
            values: key of a law -> a value, such as an energy.
        """
        body_sum = sum(values.get(p.key, 0.0) for p in self.bodies if p.key)
        has_memory = any(law.traits.rate or law.traits.remembers for law in self.body_laws.values())
        return self.seam_sums(values) | ({BODIES: body_sum} if has_memory else {})

    @cached_property
    def linear(self) -> bool:
        """Whether all laws, and the forces of all `parts` such as springs, are linear."""
        has_linear_laws = not self.contact and all(p.law.traits.linear for p in self.terms)
        return has_linear_laws and all(part.is_linear(self) for part in self.parts)

    @cached_property
    def symmetric(self) -> bool:
        """Whether all laws, and the forces of all `parts` such as springs, have symmetric tangents."""
        laws = [p.law for p in self.terms] + list(self.contacts.values())
        return all(law.traits.symmetric for law in laws) and all(part.is_symmetric(self) for part in self.parts)

    @property
    def break_times(self) -> set[float]:
        """Times at which a load, support, eigenstrain or parameter of a law changes its slope.

        Steps of marches end at these times.
        """
        coordinates = (self.coordinates, self.forces.at, self.supports.at)
        return set().union(*(at.kinks for at in coordinates), *(p.law.break_times for p in self.terms))

    def external_work(self, v: Expr, t: float) -> Expr:
        """Return the virtual work of the loads at the time t in displacements v, a UFL form linear in v."""
        return TimeLevel(t).at_level(self.forces.work(v))

    def applied(self, t: float) -> Resultant:
        """Return the resultant force of all loads at the time t, with its moment about `centre`. Collective."""
        loads = load_resultants(
            self, t, lambda v: {"": self.forces.work(v, applied_only=True), **self.forces.work_on_bases(v)}
        )
        return reduce(add, loads.values())

    @staticmethod
    def form(form: Expr) -> fem.Form:
        """Compile a UFL form in which plain dx, ds and dS occur beside the model's measures, and tags may overlap."""
        return compiled(form)

    def work_of_parts(self, u: Expr, v: Expr) -> Expr:
        """Return the virtual work, in v, of the forces of `parts` such as springs at displacements u.

        It is a UFL form, linear in v.
        """
        return sum((part.work(self, u, v) for part in self.parts), ufl.Form([]))

    # ---------------------------------------------------------------- identity
    def identity(self) -> dict[str, object]:
        """Return the data that identify the model, as JSON.

        They are the same in another process and on any number of ranks.
        """
        return {"model": repr(self), **self.domain.joint.identity(), **self.description}

    def _description(self) -> dict[str, Any]:
        return {
            "plane": self.plane,
            "law": {name: describe(layer.law) for name, layer in self.layers.items()},
            "bodies": {name: describe(law) for name, law in self.body_laws.items()},
            "layers": {name: layer.identity() for name, layer in self.layers.items()},
            **({"bonds": list(self.bonds)} if self.bonds else {}),
            "supports": [[str(place), describe(components)] for place, components in self.supports.entries],
            "loads": describe(self.forces.user_loads),
            "parts": describe(list(self.parts)),
            **({"strain": describe(self.structure.strain)} if self.strain else {}),
            **({"stress": describe(self.structure.stress)} if self.stress else {}),
            **({} if self.structure.initial is None else {"initial": describe(self.structure.initial)}),
            **({"eigenstrains": describe(self.structure.eigenstrains)} if self.structure.eigenstrains else {}),
        }

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.element}, {self.unknowns} unknowns)"
