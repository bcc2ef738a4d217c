"""Model: one structure, its layer meshed ("full") or replaced by its interface law on S ("interface")."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms import work as forms
from forms.contact import ContactLaw
from forms.kinematics import Expr
from forms.law import Law
from forms.series import Stack, parts
from forms.tangent import (
    Array,
    average_lame,
    held_along,
    require_stable_body,
    require_stable_layer,
    rests_by_itself,
    tangent_at_rest,
    tangent_over,
)
from forms.traction import TractionLaw
from geometry.domain import Domain
from geometry.inflation import check_layering, inflate
from geometry.joint import BASE, BONDED, Joint, S, unknown
from geometry.motion import require_no_branches
from geometry.sheet import Sheet
from geometry.topology import is_tensor
from thinlayer.discretisation.broken import broken_space, interface_measure
from thinlayer.discretisation.forces import BodyForce, Forces
from thinlayer.discretisation.joint_fields import director, relative_thickness
from thinlayer.discretisation.layer import ThinLayer, constants, in_plane
from thinlayer.discretisation.loads import Coordinates, Load, Place, Support, Supports
from thinlayer.discretisation.origin import origin_of
from thinlayer.discretisation.rigid import require_support
from thinlayer.errors import ModelError
from thinlayer.identity.identity import described
from thinlayer.parallel.agreement import on_all, require_same
from thinlayer.pointwise.quadrature import Quadrature

ELEMENTS = {False: ("P1", "P2"), True: ("Q1", "Q2", "S2")}
PLANES = ("strain", "stress")
LARGEST_EPS = 1e6  # thickness over the bodies' size: beyond, their coordinates have fewer than ten digits left
LOCKING = 12.0  # lmbda/mu where displacements linear through the layer add a third to the error of order 1 in the jump


class Model:
    """A structure with a thin layer, discretised.

    Built by `Model.full`, `Model.interface` and `Model.bonded` from the same data, so that all are the same structure.

    Attributes:
        joint: the joint before inflating.
        domain: the distributed mesh.
        layer: the layer; None where the bodies are bonded.
        kind: "full", "interface" or "bonded".
        V: displacement space; broken across S in the interface model.
        body_laws: law of each body.
        sides: the two sides of S (interface model only).
        bodies, layer_terms: where the laws act.
        supports: prescribed displacements.
        conditions: their Dirichlet conditions in V.
        forces: tractions and body forces.
        origin: numbers, places and columns in the joint, for laws that act at points.
        coordinates: the place and the time that loads depend on; `solve` sets the time.
        mark: stands for the data on several ranks, which all have the same.
        made_from: the data that it was built with, described as JSON; what changes later does not count.
    """

    def __init__(
        self,
        joint: Joint,
        kind: str,
        *,
        layer: ThinLayer | TractionLaw | ContactLaw | None = None,
        body: Law | Mapping[str, Law],
        supports: Mapping[Place, Support],
        tractions: Mapping[str, Load] | None = None,
        body_force: BodyForce | None = None,
        plane: str = "strain",
        element: str | None = None,
        bodies: str = "kept",
        sublayers: int = 4,
        comm: MPI.Intracomm | None = None,
    ) -> None:
        if isinstance(layer, (TractionLaw, ContactLaw)):
            layer = ThinLayer(layer, 1.0)  # of jumps, not of strains: there is no thickness in it
        self.joint, self.layer, self.kind, self.plane = joint, layer, kind, plane
        with on_all(comm):
            self.element = element or ("Q2" if is_tensor(joint.cell_type) else "P2")
            self._check_choices(bodies)
            check_layering(sublayers, bodies, "sublayers")
            self.body_laws = self._body_laws(body)
            self._check_stability()
            if kind == "interface" and not joint.rigid_base:
                require_no_branches(joint)
            if kind == "interface" and layer is not None:
                joint.relative_thickness(layer.profile)  # a function: errors it may have on one rank alone
            inflated = self._inflated(bodies, sublayers)
        self.mark = require_same(
            comm, joint=joint, kind=kind, layer=layer, body=body, supports=_ordered(supports), tractions=tractions,
            body_force=body_force, plane=plane, element=self.element, bodies=bodies, sublayers=sublayers,
        )  # fmt: skip
        self.domain = Domain.of(inflated, comm)
        self.comm = self.domain.comm
        mesh = self.domain.mesh
        self.V = self.space(int(self.element[1]), family="S" if self.element[0] == "S" else None)
        self.coordinates = Coordinates.of(self.domain)
        self.origin = origin_of(self.domain)
        with on_all(self.comm):
            self.supports = Supports(self.domain, supports, self.coordinates, clamped=self._clamped())
            self.forces = Forces(self.domain, tractions, body_force, self.coordinates)
        self.conditions = self.supports.conditions(self.V)
        self._dx = ufl.Measure("dx", domain=mesh, subdomain_data=self.domain.cell_tags)
        self._ds = ufl.Measure("ds", domain=mesh, subdomain_data=self.domain.facet_tags)
        self.bodies = [
            forms.body(constants(in_plane(law, plane), mesh), self._dx(self.domain.cell_values(name), **self._rule))
            for name, law in self.body_laws.items()
        ]
        self.sides = self._sides() if kind == "interface" else None
        self.layer_terms = self._layer_terms()
        if not joint.rigid_base:
            require_support(self.comm, self.V, joint, self.supports.held(self.V))
        self.made_from = self._data()
        self._laws_read = self._laws()

    @classmethod
    def full(cls, joint: Joint, **data: Any) -> Model:
        """The model whose layer is meshed.

        Args:
            joint: the joint; S is inflated by the layer's thickness.
            layer: ThinLayer; a law of jumps (contact, `TractionLaw`) may stand alone.
            body: law of the bodies (moduli: stress), or region name -> law.
            supports: place -> prescribed displacements, see `Supports`; they continue over the side of the layer.
            tractions: facet name -> (d,) traction (stress), constant or a function (x, t) of UFL coordinates that
                returns d components. On the bodies, and with bodies="extended" on the part of the layer's side that was
                theirs, so that the loads of all models are the same; name "NAME/LAYER" to load that side by itself.
            body_force: (d,) force per volume in the bodies, likewise, or region name -> force.
            plane: "strain" or "stress" (linear elastic laws only).
            element: "P1", "P2" (default) on triangles and tetrahedra, "Q1", "Q2" (default) or "S2" on others.
            bodies: "kept" or "extended", see `geometry.inflate`; the interface model ignores it.
            sublayers: number of cells through the layer's thickness; the interface model ignores it.
            comm: MPI communicator (default: the world).

        Raises:
            ModelError, GeometryError, LawError: what cannot be built, where, and what is allowed.
        """
        return cls(joint, "full", **_known(data))

    @classmethod
    def interface(cls, joint: Joint, **data: Any) -> Model:
        """The model whose layer is replaced by its interface law on S; arguments and errors as in `full`."""
        return cls(joint, "interface", **_known(data))

    @classmethod
    def bonded(cls, joint: Joint, **data: Any) -> Model:
        """The model without a layer: bodies perfectly bonded on S (on a rigid base S does not move).

        Arguments and errors as in `full`; the layer is ignored.
        """
        return cls(joint, "bonded", **_known(data))

    def _inflated(self, bodies: str, sublayers: int) -> Joint:
        if self.kind != "full" or self.layer is None:
            return self.joint
        layer, size = self.layer, float(np.ptp(self.joint.points, axis=0).max())
        if layer.eps > LARGEST_EPS * size:
            raise ModelError(
                f"the layer's thickness eps is {layer.eps:g}, the bodies measure {size:g}: next to such a layer their "
                "shape is lost in rounding; is eps in the unit of the mesh?"
            )
        return inflate(
            self.joint, layer.eps, profile=layer.profile, layers=sublayers, strata=layer.fractions, bodies=bodies
        )

    def _check_choices(self, bodies: str) -> None:
        joint, layer, element = self.joint, self.layer, self.element
        if self.plane not in PLANES:
            raise ModelError(unknown("plane", self.plane, PLANES))
        if self.plane == "stress" and joint.dim == 3:
            raise ModelError("plane='stress' needs a two-dimensional joint")
        if element not in ELEMENTS[is_tensor(joint.cell_type)]:
            allowed = ", ".join(ELEMENTS[is_tensor(joint.cell_type)])
            raise ModelError(f"element {element!r} does not exist on {joint.cell_type} cells; allowed: {allowed}")
        if self.kind == "bonded":
            return
        if not isinstance(layer, ThinLayer):
            raise ModelError(f"layer is {layer!r}; give layer=ThinLayer(law, eps)")
        layer.law.check_dimension(joint.dim)
        if isinstance(layer.law, ContactLaw):
            self._check_contact()
        if layer.order == 1:
            self._check_order_1(bodies)
        if self.kind == "full" and isinstance(layer.law, (TractionLaw, ContactLaw)):
            raise ModelError(f"{type(layer.law).__name__} is a law of jump and traction: it has no meshed layer")
        if self.kind == "full" and layer.law.softens:
            raise ModelError(
                f"the stress of {layer.law!r} falls as strains grow: in a meshed layer all strain would gather in one row "
                "of cells; take mixing=1, or NonMonotoneUnrelaxed, which has one phase for each column"
            )
        if layer.law.constrained and element not in ("P2", "Q2"):
            raise ModelError(f"an incompressible layer needs elements P2 or Q2 for its displacements, not {element}")

    def _check_contact(self) -> None:
        """Contact laws act at the nodes of S, on displacements of degree 1."""
        linear = "Q1" if is_tensor(self.joint.cell_type) else "P1"
        if self.element != linear:
            raise ModelError(
                f"a contact law acts at the vertices of S and needs element={linear!r}, not {self.element}: nodes in the "
                "middle of edges would carry most of the pressure, or none of it"
            )
        assert self.layer is not None
        assert isinstance(self.layer.law, ContactLaw)
        self.layer.law.check_threshold()
        if self.layer.profile is not None:
            raise ModelError("a contact law has no thickness that could vary along S")

    def _check_order_1(self, bodies: str) -> None:
        if bodies != "kept":
            raise ModelError("order=1 needs bodies='kept': on extended bodies its energy has no lower bound")
        if self.element[1] != "2":
            raise ModelError(f"order=1 needs elements of degree 2 (its law has gradients on S), not {self.element}")
        if not self.joint.planar:
            raise ModelError("order=1 needs a planar S: its law leaves out the curvature's part of the next term")
        if len(self.joint.bonded):
            raise ModelError("order=1 needs an S that does not end inside the bodies: its law has gradients at the tip")
        self._check_locking()

    @cached_property
    def sheet(self) -> Sheet:
        """S as a sheet of straight simplices."""
        return Sheet(self.joint)

    @cached_property
    def layer_at_rest(self) -> list[tuple[float, Law, Array | None]]:
        """Fraction of the thickness, real law and tangent at rest (None: not known) of the layer, or of its sublayers."""
        assert self.layer is not None
        law = self.layer.real_law(self.plane)
        strata = law.sublayers if isinstance(law, Stack) else ((1.0, law),)
        n = self.sheet.mean_normal
        return [(a, one, tangent_at_rest(one, n) if rests_by_itself(one) else one.stiffness(n)) for a, one in strata]

    def layer_over(self, dt: float) -> list[Array | None]:
        """Tangents of the same under loads that have lasted dt > 0; None: not known, or as at rest."""
        if dt not in self._layer_over:
            n = self.sheet.mean_normal
            self._layer_over[dt] = [
                tangent_over(law, n, dt) if law.pointwise else None for _, law, _ in self.layer_at_rest
            ]
        return self._layer_over[dt]

    @cached_property
    def _layer_over(self) -> dict[float, list[Array | None]]:
        return {}

    @cached_property
    def silent(self) -> tuple[npt.NDArray[np.bool_], bool]:
        """Axes along which the interface law has no traction where supports hold that component of both bodies together.

        (d,); and whether it has none where they hold all components. Laws with a stress of their own and order 1 have one,
        an incompressible one has its pressure, and laws with memory or rate remember that the bodies have been apart.
        """
        none = np.zeros(self.joint.dim, bool)
        if self.layer is None or self.layer.order or self.contact:
            return none, False
        laws = [law for _, law, _ in self.layer_at_rest]
        moving = any(callable(value) for _, given in self.supports.entries for value in given.values())
        if moving and any(law.rate or law.internal for law in laws):
            return none, False
        along = ~none & self.joint.planar
        for law in laws:
            found = held_along(law, self.sheet.mean_normal)
            if found is None:
                return none, False
            along &= found
        return along, not any(law.constrained for law in laws)

    @cached_property
    def bodies_at_rest(self) -> list[Array | None]:
        """Tangents of the bodies' laws at rest; None: not known."""
        n = self.sheet.mean_normal
        return [tangent_at_rest(in_plane(law, self.plane), n) for law in self.body_laws.values()]

    def _check_stability(self) -> None:
        """Refuse laws whose stiffness at rest is negative: what is found would be no equilibrium that lasts."""
        for law, C in zip(self.body_laws.values(), self.bodies_at_rest, strict=True):
            require_stable_body(law, C, self.joint.dim)
        if self.kind == "bonded" or self.layer is None or isinstance(self.layer.law, ContactLaw):
            return
        for _, law, C in self.layer_at_rest:
            if rests_by_itself(law):
                require_stable_layer(law, C, self.sheet.mean_normal)

    def _check_locking(self) -> None:
        """Refuse laws whose displacements stay linear through the layer where its volume is held: they would lock."""
        assert self.layer is not None
        _, law, C = self.layer_at_rest[0]
        if law.relaxes or C is None:
            return
        lmbda, mu = average_lame(C)
        if lmbda > LOCKING * mu:
            raise ModelError(
                f"order=1 of {type(law).__name__} with lmbda/mu = {lmbda / mu:.4g} at rest (nu = "
                f"{lmbda / (lmbda + mu) / 2:.4g}); allowed: at most {LOCKING:g} (nu = {LOCKING / (LOCKING + 1) / 2:.4f}), "
                "beyond which the next term locks; use order=0, the meshed layer (Model.full), or LinearElastic"
            )

    # ---------------------------------------------------------------- spaces
    @cached_property
    def sides_of_cells(self) -> npt.NDArray[np.int32]:
        """0 below S, 1 in the layer, 2 above: colours of a space that is broken at both faces."""
        joint = self.domain.joint
        return (joint.side[self.domain.original_cells] + 1).astype(np.int32)

    @cached_property
    def _colours(self) -> npt.NDArray[np.int32]:
        """Colours in which displacements are continuous: each body in the interface model, else everything."""
        return self.sides_of_cells if self.kind == "interface" else np.zeros_like(self.sides_of_cells)

    def space(self, degree: int, *, family: str | None = None, broken_at_faces: bool = False) -> fem.FunctionSpace:
        """A vector space on the model's mesh with the jumps of its displacements. Collective.

        Args:
            degree: polynomial degree.
            family: basix family (default: Lagrange).
            broken_at_faces: whether functions also jump between the meshed layer and the bodies.
        """
        mesh = self.domain.mesh
        element = basix.ufl.element(family or "Lagrange", mesh.basix_cell(), degree, shape=(self.joint.dim,))
        colours = self.sides_of_cells if broken_at_faces else self._colours
        return broken_space(self.comm, mesh, element, colours, self.domain.facets(BONDED))

    # ---------------------------------------------------------------- where laws act
    def _clamped(self) -> tuple[str, ...]:
        """Facets that a rigid base holds."""
        faces = {"full": (BASE,), "bonded": (S,)}
        return faces.get(self.kind, ()) if self.joint.rigid_base else ()

    def _body_laws(self, body: Law | Mapping[str, Law]) -> dict[str, Law]:
        regions = self.joint.bodies
        laws = dict(body) if isinstance(body, Mapping) else dict.fromkeys(regions, body)
        for name in laws:
            if name not in regions:
                raise ModelError(unknown("body", name, regions))
        for name in regions:
            if not isinstance(laws.get(name), Law):
                raise ModelError(f"body {name!r} has no law; give body=law or body={{{name!r}: law, ...}}")
            if laws[name].pointwise or laws[name].constrained or isinstance(laws[name], (TractionLaw, ContactLaw)):
                raise ModelError(f"body {name!r}: {type(laws[name]).__name__} is for layers; bodies take elastic laws")
            if laws[name].softens:
                raise ModelError(
                    f"body {name!r}: the stress of {type(laws[name]).__name__} falls as strains grow: all strain would "
                    "gather in one row of cells; let a layer soften, on S"
                )
        return {name: laws[name] for name in regions}  # in the same order on all ranks

    def _sides(self) -> forms.Interface:
        mesh, facets = self.domain.mesh, self.domain.facets(S)
        if self.joint.rigid_base:
            return forms.Interface.on_rigid_base(mesh, self._ds(self.domain.values(S)))
        measure, _ = interface_measure(self.comm, mesh, facets, self._colours)
        return forms.Interface.between_bodies(mesh, measure)

    @property
    def _rule(self) -> dict[str, Any]:
        """Quadrature of laws on quadrilaterals and hexahedra: exact on straight cells, a point more each way on others.

        UFL would sum the degrees of all directions and of the geometry: many times the points, to no avail.
        """
        if not is_tensor(self.joint.cell_type):
            return {}
        degree = 2 * int(self.element[1]) + 1 + 2 * (self.joint.degree - 1)
        return {"metadata": {"quadrature_degree": degree}}

    def _layer_terms(self) -> list[forms.Term]:
        if self.kind == "bonded" or self.layer is None or self.contact:
            return []
        mesh, law = self.domain.mesh, self.layer.real_law(self.plane)
        if self.sides:
            eps: Expr = fem.Constant(mesh, float(self.layer.eps))
            if self.layer.profile is not None:
                eps = eps * self.sides.upper(relative_thickness(self.domain, self.layer.profile))
            law = law if law.pointwise else constants(law, mesh)
            return forms.surface(
                law, replace(self.sides, measure=self.sides.measure.reconstruct(**self._rule)), eps, self.layer.order
            )
        laws = law.laws if isinstance(law, Stack) else (law,)
        n = director(self.domain)
        values = [self.domain.cell_values(name) for name in self.domain.layer_regions]
        laws = tuple(one if one.pointwise else constants(one, mesh) for one in laws)
        return [forms.band(one, self._dx(tags, **self._rule), n) for one, tags in zip(laws, values, strict=True)]

    @property
    def terms(self) -> list[forms.Term]:
        """All points where a law acts."""
        return self.bodies + self.layer_terms

    @cached_property
    def quadratures(self) -> list[Quadrature]:
        """The points of compiled laws, in the order of `State.memory`. Collective."""
        return [Quadrature(self.V, p, self.origin) for p in self.terms if p.law.pointwise]

    @property
    def contact(self) -> ContactLaw | None:
        """The contact law on S, if there is one."""
        law = self.layer.law if self.layer and self.kind == "interface" else None
        return law if isinstance(law, ContactLaw) else None

    @property
    def linear(self) -> bool:
        """Whether every law is linear."""
        return self.contact is None and all(p.law.linear for p in self.terms)

    @property
    def symmetric(self) -> bool:
        """Whether every law has a symmetric tangent."""
        return all(p.law.symmetric for p in self.terms) and (self.contact is None or self.contact.symmetric)

    @property
    def break_times(self) -> set[float]:
        """Times at which piecewise loads, supports and temperatures break."""
        laws = [law for p in self.layer_terms for law in parts(p.law)]
        given = [getattr(law, name) for law in laws for name in law.functions]
        return self.coordinates.t.breaks.union(*(getattr(function, "times", ()) for function in given))

    def external_work(self, v: Expr) -> Expr:
        """Virtual work of the loads, a UFL form linear in v."""
        return self.forces.work(v)

    def identity(self) -> dict[str, Any]:
        """What the model is made of, as JSON: the same for the same model in another process, on any number of ranks."""
        return {"model": repr(self), **self.domain.joint.identity(), **self.made_from}

    def _data(self) -> dict[str, Any]:
        layer = self.layer
        return {
            "plane": self.plane,
            **self._laws(),
            "eps": float(layer.eps) if layer else None,
            "order": layer.order if layer else None,
            "profile": described(self.joint.relative_thickness(layer.profile)) if layer and layer.profile else None,
            "supports": [[str(place), described(given)] for place, given in self.supports.entries],
            "loads": described(self.forces.given),
        }

    def _laws(self) -> dict[str, Any]:
        return {
            "law": described(self.layer.law) if self.layer else None,
            "bodies": {name: described(law) for name, law in self.body_laws.items()},
        }

    def require_same_laws(self) -> None:
        """Raise ModelError if what the laws' code refers to has changed since it was last read."""
        for name, now in self._laws().items():
            before = self._laws_read[name]
            if now != before:
                raise ModelError(
                    f"what the model's {name} refers to has changed since the model was built, from {before} to {now}; "
                    "build the model anew"
                )

    def laws_were_read(self) -> None:
        """Take note of what the laws' own code has changed as it was read: counters, logs and the like."""
        self._laws_read = self._laws()

    def __repr__(self) -> str:
        dofs = self.V.dofmap.index_map.size_global * self.V.dofmap.index_map_bs
        return f"Model.{self.kind}({self.element}, {dofs} unknowns)"


def _known(data: dict[str, Any]) -> dict[str, Any]:
    """The data of a model, if all names in it are known and none that it needs is missing. Collective."""
    parameters = inspect.signature(Model.__init__).parameters
    options = {name: p for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY}
    with on_all(data.get("comm")):
        for name in data:
            if name not in options:
                raise ModelError(unknown("option of a model", name, options))
        for name, parameter in options.items():
            if parameter.default is parameter.empty and name not in data:
                raise ModelError(f"a model needs {name}=...")
    return data


def _ordered(given: Any) -> Any:
    """Data with the order of its entries: later supports decide where two overlap."""
    return [list(entry) for entry in given.items()] if isinstance(given, Mapping) else given
