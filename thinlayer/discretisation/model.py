"""Model: a discretised structure; base of the models with meshed layers, and with interface laws."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import add
from typing import Any, ClassVar, Self

import numpy as np
import ufl
from dolfinx import fem

from forms import work as forms
from forms.base import InputError
from forms.contact import ContactLaw
from forms.law import BulkLaw
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.inflating.layering import value_by_seam
from geometry.joint import Joint
from geometry.sheet import volume_of
from geometry.topology import FloatArray, Indices, Splitting, is_tensor
from thinlayer.discretisation.applicability import Applicability
from thinlayer.discretisation.coefficient import Coordinates, Load, Pressure
from thinlayer.discretisation.constraints import Constraints
from thinlayer.discretisation.forces import BodyForce, Forces, LoadRegion
from thinlayer.discretisation.form_compilation import (
    checked_term,
    compiled,
    compiled_scalars,
    compiled_terms,
    origin_of,
)
from thinlayer.discretisation.layer import (
    BODIES,
    BODY_KIND,
    Bond,
    Gap,
    Layers,
    SeamContent,
    SeamLayer,
    ThinLayer,
    law_with_constants,
    loads_of_layers,
)
from thinlayer.discretisation.mesh_functions import cut_at_faces, vector_space
from thinlayer.discretisation.part_definition import check_part_definitions
from thinlayer.discretisation.point_loads import ConcentratedForms, ConcentratedLoad, check_loads
from thinlayer.discretisation.prescribed_strains import EigenstrainContext, MeanStrain, MeanStress, prescribed_strain
from thinlayer.discretisation.rigid_motions import (
    Resultant,
    free_translations,
    moment_centre,
    require_support,
    resistance_matrices,
    resultants_of_loads,
    scaled_motions,
)
from thinlayer.discretisation.setup import Setup
from thinlayer.discretisation.supports import ByPlace, Place, Prescribed, Supports, is_part
from thinlayer.discretisation.time_functions import TimeLevel
from thinlayer.errors import warn
from thinlayer.pointwise.quadrature import Quadrature, quadrature_degree
from thinlayer.system.compat import interpolate
from thinlayer.system.fingerprint import describe, digest
from thinlayer.system.ranks import collect, errors_on_all, require_same


@dataclass
class ModelFamily:
    """What models have in common, beside mesh and space, that differ in the laws of their layers or in their loads.

    Attributes:
        several: whether there are models that were derived from others: nothing is kept for one.
        kept: matrices for later solves; it goes with the last model. None: nothing, or a solver has it.
    """

    several: bool = False
    kept: Any = None


class Model(ABC):
    """A discretised structure with a thin soft layer, made by `Structure.full`, `interface` or `bonded`.

    Attributes:
        structure: the structure, shared with other models.
        joint: the joint before inflating.
        plane, element, body_laws: the structure's.
        on_seams: name of a seam -> what was given for it: a layer, a `Bond`, a `Gap` or None.
        layers: name of a seam -> its layer, in the joint's order.
        contacts: name of a seam -> its contact law.
        reductions: name of a seam -> which interface law stands for its layer, and why not.
        domain: the distributed mesh.
        comm: the domain's communicator.
        V: displacement space; broken across S in the interface model.
        dx, ds: measures of the mesh with its tags, for your own terms beside the model's: the residual at u is
            `work(model.terms_at(t), u, v) - model.external_work(v, t) + term * model.dx`, without compiled or nodal laws.
            Compile it with `model.form`: by itself DOLFINx 0.9 loses integrals over overlapping tags whose quadratures
            differ, as of a body and of its weight on quadrilaterals.
            Regions and facets: `model.dx(model.domain.cell_values(name))`, `model.ds(model.domain.values(name))`.
            Plain `ufl.dx` beside them is taken by `model.form` alone, not by `dolfinx.fem.form`.
        bodies, layer_terms: terms of the laws of the bodies and of the layer, with given strains that may depend on the
            time; `State.bodies` and `State.layers` are those at the time of a state.
        body_strains, layer_strains: name of a body, and of a seam -> the strain (3, 3) that is added there to that of the
            displacements, minus the eigenstrain; None: there is none.
        supports: prescribed displacements.
        prescribed: the same as conditions at the nodes of V.
        forces: tractions and body forces.
        strain, stress: prescribed mean strain and mean stress of a periodic cell; None: it is not.
        parts: additions to the balance of forces beside bodies, layer and loads.
        origin: numbers, places and columns in the joint, for compiled laws.
        kinematics: strains of displacements on the mesh, and the factor of all measures.
        coordinates: place and time as arguments of what is given, and the clock.
        centre: (d,) mean place of the mesh's points; of bodies of revolution on the axis.
        broken: whether displacements jump across S.
        mark: hash of the data, equal on all ranks.
        said: keys of the warnings that were issued, each with what it is of, such as a seam.
        family: what the model has in common with those that were made from it by `with_layer` and `with_loads`.
        made_from: description, as JSON, of the data at the time the model was built.
    """

    name: ClassVar[str]
    broken: ClassVar[bool] = False
    _bodies = "kept"

    def __init__(self, structure: Setup, layer: Layers, **options: object) -> None:
        self.structure, self.joint, self.plane = structure, structure.joint, structure.plane
        self.element, self.body_laws = structure.element, structure.body_laws
        self._options, self.family, self.issued_warnings = options, ModelFamily(), set[tuple[Hashable, ...]]()
        inflated = self._lay(layer, self._checked)
        self.domain = Domain.of(inflated, structure.comm)
        self.comm = self.domain.comm
        self.centre = moment_centre(structure.kinematics, np.asarray(inflated.points.mean(axis=0), float))
        self.V = self.space(structure.degree, family="S" if self.element[0] == "S" else None)
        collect(self.comm, self.V)
        self.kinematics = structure.kinematics.on(self.domain.mesh)
        self.coordinates = Coordinates.of(self.domain)
        self.origin = origin_of(self.domain)
        mesh = self.domain.mesh
        self.dx = ufl.Measure("dx", domain=mesh, subdomain_data=self.domain.cell_tags)
        self.ds = ufl.Measure("ds", domain=mesh, subdomain_data=self.domain.facet_tags)
        with errors_on_all(self.comm):
            self.supports = self._supports(structure.supports)
            self.body_strains = {name: self._given(name) for name in self.body_laws}
            self.layer_strains = {name: self._layer_strain(seam_layer) for name, seam_layer in self.layers.items()}
            if not (structure.strain is None and structure.stress is None):
                self.require("mean strain")
            strain, stress = structure.strain, structure.stress
            self.strain = None if strain is None else MeanStrain(strain, self.coordinates, self.joint)
        self.bodies = self._strained([term for names in self._body_groups() for term in self._body_terms(names)])
        self.layer_terms = self._terms_of_layers()
        with errors_on_all(self.comm):
            self.forces = self._forces(structure)
        with errors_on_all(self.comm):
            self.stress = None if stress is None else MeanStress(stress, self.coordinates, self.joint, self.solids)
        self.parts = structure.parts
        with errors_on_all(self.comm):
            check_part_definitions(self.parts, self)
        self.constraints = self._constrained()
        self.require_supported()
        self.description = self._data()

    def warn(self, key: str, message: str, *of: Hashable) -> None:
        """Issue a RangeWarning, once for what it is of, such as a seam and a time. Collective."""
        if (key, *of) not in self.issued_warnings:
            warn(key, message, self.comm)
            self.issued_warnings.add((key, *of))

    def require_supported(self) -> None:
        """Raise InputError if the bodies can move as one."""
        if not (self.broken and any(name in self.layers for name in self.joint.base_seams)):
            resistances = [partial(part.resistance, self) for part in self.parts if not part.ties_nodes]
            names = [*scaled_motions(self.domain.joint, self.kinematics)]
            if self.joint.periods:
                self.supports.anchored = free_translations(names, resistance_matrices(self, resistances))
                self.constraints = self._constrained()
            require_support(names, resistance_matrices(self, resistances))

    def _lay(self, layer: Layers, check: Callable[[], Any]) -> Any:
        """Take the layers of the seams and return the result of a check of them. Collective."""
        structure = self.structure
        with errors_on_all(structure.comm):
            self.on_seams: dict[str, SeamContent] = value_by_seam(self.joint, layer, "layer")
            layers = {name: value for name, value in self.on_seams.items() if not isinstance(value, Gap | Bond | None)}
            self.layers = {name: SeamLayer(name, content, structure) for name, content in layers.items()}
            self.contacts = {name: seam_layer.contact for name, seam_layer in self.layers.items() if seam_layer.contact}
            self.applicability = {
                name: Applicability(seam_layer, self._bodies) for name, seam_layer in self.layers.items()
            }
            checked = check()
        self.data_hash = structure.data_hash + require_same(
            structure.comm, model=self.name, layer=layer, options=self._options
        )
        return checked

    def _given(self, name: str) -> Expr | None:
        """The strain that is added to that of the displacements in a body: less its eigenstrain; None: there is none."""
        law, n = self.kinematics.law(self.body_laws[name]), self.structure.sheet.mean_normal
        body = EigenstrainContext(f"the body {name!r}", law, n, self.structure.kinematics, self.coordinates)
        return prescribed_strain(self.structure.eigenstrains.get(name), body)

    def _layer_strain(self, layer: SeamLayer) -> Expr | None:
        """The strain that is added to that of the displacements in a layer."""
        return layer.prescribed_strain(self.coordinates)

    def _body_groups(self) -> list[list[str]]:
        """Names of the bodies, those of one law and one eigenstrain together."""
        groups: dict[tuple[int, int], list[str]] = {}
        for name, law in self.body_laws.items():
            groups.setdefault((id(law), id(self.structure.eigenstrains.get(name))), []).append(name)
        return [*groups.values()]

    def _body_terms(self, names: Sequence[str]) -> list[forms.Term]:
        """Terms of bodies with one law and one eigenstrain: one if they are parts of forms, else one a body, with a key."""
        law, strain = self.kinematics.law(self.body_laws[names[0]]), self.body_strains[names[0]]
        if not law.traits.compiled:
            law, some = law_with_constants(law, self.domain.mesh), {"": names}
        else:
            some = {f"{BODY_KIND} {name}": (name,) for name in names}
        cells = {key: self.dx(self.domain.cell_values(*here), **self._rule(self.dx)) for key, here in some.items()}
        volume = self.volume_degree(law)
        each = {key: forms.body(law, measure, self.kinematics, volume) for key, measure in cells.items()}
        return [
            checked_term(replace(term, key=key, prescribed_strain=strain), self.V, self.origin)
            for key, term in each.items()
        ]

    def _terms_of_layers(self) -> list[forms.Term]:
        terms = [checked_term(term, self.V, self.origin) for term in self._layer_terms()]
        return terms if self.broken else self._strained(terms)

    def _supports(self, supports: ByPlace) -> Supports:
        return Supports(self.domain, supports, self.coordinates.detached, self._clamped, self.kinematics)

    # ---------------------------------------------------------------- differences between kinds of models
    def _forces(self, structure: Setup) -> Forces:
        at = self.coordinates.detached
        points = ConcentratedForms(self.domain, self.joint, structure.degree, at)
        forces = Forces(self.domain, self.kinematics, points, structure)
        for name, load in loads_of_layers(structure.body_force, self.joint, self.layers, self.bonds).items():
            forces.add_layer(name, load, self._place_of(self.layers[name]), self._coordinates_on(at))
        return forces

    def _coordinates_on(self, at: Coordinates) -> Coordinates:
        """Coordinates of the places of layers."""
        return at

    @abstractmethod
    def _place_of(self, layer: SeamLayer) -> LoadRegion:
        """Where a layer's volume is."""

    @property
    def _clamped(self) -> tuple[str, ...]:
        """Names of the facets that a rigid base holds."""
        return ()

    def require(self, question: str, what: str = "") -> None:
        """Raise InputError, after some words, if a layer fails a condition of a question (`Applicability.why_not`)."""
        for reduction in self.applicability.values():
            reduction.require(question, what)

    @property
    def bonds(self) -> tuple[str, ...]:
        """Names of the seams whose bodies are bonded."""
        return tuple(name for name, content in self.on_seams.items() if isinstance(content, Bond))

    @property
    def gaps(self) -> dict[str, Gap]:
        """Name of a seam -> its gap, of those that have some width."""
        return {name: content for name, content in self.on_seams.items() if isinstance(content, Gap)}

    @abstractmethod
    def _checked(self) -> Joint:
        """Check that the layer suits the structure, and return the joint to distribute. Not collective."""

    @abstractmethod
    def _layer_terms(self) -> list[forms.Term]:
        """The terms of the layer's law."""

    # ---------------------------------------------------------------- other models of the family
    def with_layer(self, layer: Layers) -> Self:
        """The same model with other layers; it shares mesh, space, supports, loads and the bodies' matrix. Collective.

        Args:
            layer: as in `Structure.full` or `Structure.interface`, with bonds on the same seams; of a full model layers
                and gaps of the same thickness, profile and fractions, which are those of the mesh.

        Raises:
            InputError: as there; another shape of a meshed layer.
        """
        new = self._shared_copy()
        new.issued_warnings = set()
        return new._copy_with_layers(self, layer)

    def improved(self, layers: Mapping[str, ThinLayer]) -> Self:
        """This model with better laws of some layers, as by `with_layer`: what was said of it is not said again."""
        return self._shared_copy()._copy_with_layers(self, {**self.on_seams, **layers})

    def _copy_with_layers(self, other: Self, layer: Layers) -> Self:
        """This copy of another model, with its layers. Collective."""
        self._lay(layer, partial(self._check_compatible, other))
        with errors_on_all(self.comm):
            self.layer_strains = {name: self._layer_strain(seam_layer) for name, seam_layer in self.layers.items()}
        self.layer_terms = self._terms_of_layers()
        with errors_on_all(self.comm):
            self.forces = self._forces(self.structure)
            if self.strain or self.stress:
                self.require("mean strain")
            if self.stress and not self.broken:
                raise InputError("with_layer: under a mean stress a meshed layer is a part of the cell; build a model")
        if self.constraints.mpcs:  # the thickness is an arm of plates
            self.constraints = self._constrained()
        self.description = self._data()
        return self

    @abstractmethod
    def _check_compatible(self, other: Self) -> None:
        """Raise an error unless the layers suit the mesh of another model."""

    def _require_shapes(self, other: Self) -> None:
        """Raise InputError unless layers and gaps need the room that bodies have made for those of another model."""
        count = 2 if self.broken else 3  # sublayers have cells in meshed layers alone
        needed, made = (
            {name: ("a gap", gap.eps) for name, gap in model.gaps.items()}
            | {name: layer.shape[:count] for name, layer in model.layers.items()}
            for model in (self, other)
        )
        for name in (name for name in needed if needed[name] != made.get(name)):
            room = f"{name!r} of (thickness, profile, fractions) {made.get(name)}, not {needed[name]}"
            raise InputError(f"bodies have made room for a layer {room}; make a model of its own")

    def with_loads(
        self,
        *,
        tractions: Mapping[str, Load | Pressure] | None = None,
        body_force: BodyForce | None = None,
        loads: Sequence[ConcentratedLoad] | None = None,
        supports: ByPlace | None = None,
    ) -> Self:
        """The same model under other loads; it shares mesh, space, matrices and their factor. Collective.

        Args:
            tractions, body_force, loads: as in `Structure`; None: those of this model stay.
            supports: other values at the same places and components; None: those of this model stay.

        Raises:
            InputError: as in `Structure`; supports of other places or components.
        """
        changed: dict[str, Any] = {"tractions": tractions, "body_force": body_force, "supports": supports}
        with errors_on_all(self.comm):
            changed["loads"] = None if loads is None else check_loads(loads)
        updates = {name: value for name, value in changed.items() if value is not None}
        new = self._shared_copy()
        new.issued_warnings = set()
        new.structure = structure = self.structure.with_loads(updates)
        new.data_hash = digest([self.data_hash, structure.data_hash])
        with errors_on_all(self.comm):
            if supports is not None:
                new.supports = self._supports(supports)
                new.supports.anchored = self.supports.anchored
                both = self.supports, new.supports
                expected, other = ([(place, sorted(components)) for place, components in bcs.entries] for bcs in both)
                if expected != other:
                    raise InputError(f"supports hold {other}, those of the model {expected}; build another structure")
            new.forces = new._forces(structure)
        if supports is not None:
            new.constraints = new._constrained()
        new.description = new._data()
        return new

    def _constrained(self) -> Constraints:
        ties = [part.multi_point_constraint(self) for part in self.parts if part.ties_nodes]
        return Constraints(Prescribed(self.supports, self.V), ties)

    def _shared_copy(self) -> Self:
        """A copy that shares all that this model has."""
        new = copy.copy(self)
        for name in ("linear", "symmetric", "quadratures", "surfaces"):
            vars(new).pop(name, None)
        self.family.several = True
        return new

    @property
    def remarks(self) -> list[str]:
        """Sentences for the log: what was chosen that the user left open."""
        return []

    def shifts(self) -> FloatArray | None:
        """(n_cells, d) how far layers that have no cells part the bodies, by cell of the joint; None: not, or not known."""
        return None

    # ---------------------------------------------------------------- spaces
    @cached_property
    def split_mesh(self) -> Splitting:
        """The joint's mesh, cut where displacements jump."""
        return self.domain.joint.split_along(np.empty(0, np.int64))

    @cached_property
    def places(self) -> FloatArray:
        """(n, d) x as a function of `V`: at each node of this rank, those of ghosts last. Collective."""
        f, d = fem.Function(self.V), self.joint.dim
        interpolate(f, lambda x: x[:d])
        f.x.scatter_forward()
        return np.asarray(f.x.array.reshape(-1, d))

    def space(self, degree: int, *, family: str | None = None, broken_at_faces: bool = False) -> fem.FunctionSpace:
        """A vector space on the model's mesh with the jumps of its displacements. Collective.

        Args:
            degree: polynomial degree.
            family: basix family (default: Lagrange).
            broken_at_faces: whether functions also jump between the meshed layer and the bodies, or across S.
        """
        cut = cut_at_faces(self.domain.joint) if broken_at_faces else self.split_mesh
        return vector_space(self.domain, cut, degree, family or "Lagrange")

    # ---------------------------------------------------------------- where laws act
    def _rule(self, measure: ufl.Measure) -> dict[str, Any]:
        """Metadata for the measures of laws: `quadrature_degree` on quadrilaterals and hexahedra, else UFL's choice."""
        if not (is_tensor(self.joint.cell_type) or self.kinematics.degree):
            return {}
        return {"metadata": {"quadrature_degree": quadrature_degree(self.V, measure) + self.kinematics.degree}}

    def volume_degree(self, law: BulkLaw) -> int | None:
        """Degree of the volume strain in each cell of a body that flows without a change of volume (`Term.volume`).

        It is one below that of the displacements, as on straight triangles and tetrahedra in any case. Other elements have
        more volume strains than that, which the flow would have to keep at zero: they lock (Sloan and Randolph 1982).
        """
        straight = not (is_tensor(self.joint.cell_type) or self.kinematics.degree)
        return self.structure.degree - 1 if law.traits.isochoric and not straight else None

    def _strained(self, terms: list[forms.Term]) -> list[forms.Term]:
        """The terms with the mean strain of a periodic cell."""
        return forms.with_added_strain(terms, self.strain.expression) if self.strain else terms

    @property
    def solids(self) -> list[forms.Term]:
        """The terms of bodies and of meshed layers."""
        return self.bodies if self.broken else self.terms

    @cached_property
    def volume(self) -> float:
        """Volume of bodies and meshed layers; of a periodic cell also what layers on S have taken of it. Collective."""
        if self.joint.periods is not None and self.domain.joint.parted is not None:
            return volume_of(self.joint, np.ones(len(self.joint.cells), bool))
        size = sum(fem.Constant(self.domain.mesh, 1.0) * p.weight * p.measure for p in self.solids)
        return float(self.comm.allreduce(sum(map(fem.assemble_scalar, compiled_scalars(size)))))

    @property
    def terms(self) -> list[forms.Term]:
        """All terms of the model."""
        return self.bodies + self.layer_terms

    def terms_at(self, t: float) -> list[forms.Term]:
        """All terms of the model, with the strains that are given at a time, such as minus the eigenstrain."""
        return TimeLevel(t).terms(self.terms)

    @cached_property
    def quadratures(self) -> dict[str, Quadrature]:
        """The quadrature points of compiled laws, by the keys of their memory. Collective."""
        return {key: Quadrature(self.V, p, self.origin) for key, p in compiled_terms(self.terms).items()}

    @property
    def contact(self) -> ContactLaw | None:
        """A contact law, if a layer has one."""
        return next(iter(self.contacts.values()), None)

    def by_seam(self, values: Mapping[str, float]) -> dict[str, float]:
        """Sums of values of layers, given by key (`SeamLayer.key`), for each seam; empty if there is one seam only."""
        several = self.layers if len(self.joint.seams) > 1 else {}
        return {
            name: sum(value for key, value in values.items() if layer.owns_key(key)) for name, layer in several.items()
        }

    def bc_dofs_in(self, V: fem.FunctionSpace) -> Indices:
        """Degrees of freedom of a space (local, unrolled, ghosts included) on which supports and plates act. Collective.

        Without those that a rigid base holds.
        """
        part_dofs = [part.bc_dofs_in(self, V) for part in self.parts]
        return np.unique(np.concatenate([self.supports.bc_dofs_in(V, clamped=False), *part_dofs]))

    def holder_rows(self, place: Place) -> list[int]:
        """Numbers of the rows of `holders` that are a place, or parts of it."""
        return [k for k, name in enumerate(self.holders) if is_part(name, place)]

    @property
    def holders(self) -> list[Place]:
        """What holds it, as rows of `Configuration.reactions`: supports, clamped facets, plates, bases below layers."""
        based = [name for name in self.layers if name in self.joint.base_seams] if self.broken else []
        plates = [part.place for part in self.parts if part.ties_nodes]
        return [*(place for place, _ in self.supports.entries), *plates, *based]

    def by_place(self, values: Mapping[str, float]) -> dict[str, float]:
        """`value_by_seam`, and under "bodies" the sum of the values of bodies, by their keys, if they remember."""
        of_bodies = sum(values.get(p.key, 0.0) for p in self.bodies if p.key)
        remember = any(law.traits.rate or law.traits.remembers for law in self.body_laws.values())
        return self.by_seam(values) | ({BODIES: of_bodies} if remember else {})

    @cached_property
    def linear(self) -> bool:
        """Whether all laws and all additions are linear."""
        of_laws = not self.contact and all(p.law.traits.linear for p in self.terms)
        return of_laws and all(part.is_linear(self) for part in self.parts)

    @cached_property
    def symmetric(self) -> bool:
        """Whether all laws and all additions have symmetric tangents."""
        laws = [p.law for p in self.terms] + list(self.contacts.values())
        return all(law.traits.symmetric for law in laws) and all(part.is_symmetric(self) for part in self.parts)

    @property
    def break_times(self) -> set[float]:
        """The break times of all loads, supports and temperatures of the model."""
        coordinates = (self.coordinates, self.forces.at, self.supports.at)
        return set().union(*(at.breaks for at in coordinates), *(p.law.break_times for p in self.terms))

    def external_work(self, v: Expr, t: float) -> Expr:
        """Virtual work of the loads at a fixed time, a UFL form linear in v."""
        return TimeLevel(t).of(self.forces.work(v))

    def applied(self, t: float) -> Resultant:
        """Resultant of all loads at a time, about `centre`. Collective."""
        forces = self.forces
        loads = resultants_of_loads(self, t, lambda v: {"": forces.work(v), **forces.work_on_bases(v)})
        return reduce(add, loads.values())

    @staticmethod
    def form(form: Expr) -> fem.Form:
        """Compile a form, in which plain dx, ds and dS may stand beside the model's measures, and tags overlap."""
        return compiled(form)

    def added_work(self, u: Expr, v: Expr) -> Expr:
        """Virtual work of the additions to the model at displacements u, a UFL form linear in v."""
        return sum((part.work(self, u, v) for part in self.parts), ufl.Form([]))

    def added_work_in(self, state: Any, v: Expr) -> Expr:
        """Virtual work of the additions to the model in a state, a UFL form linear in v."""
        return sum((part.work_in(self, state, v) for part in self.parts), ufl.Form([]))

    # ---------------------------------------------------------------- identity
    def identity(self) -> dict[str, Any]:
        """Identity of the model, as JSON: equal for the same model in another process, on any number of ranks."""
        return {"model": repr(self), **self.domain.joint.identity(), **self.description}

    def _data(self) -> dict[str, Any]:
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
            **({"eigenstrains": describe(self.structure.eigenstrains)} if self.structure.eigenstrains else {}),
        }

    @property
    def unknowns(self) -> int:
        """The number of displacements, those at supports included."""
        return int(self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.element}, {self.unknowns} unknowns)"
