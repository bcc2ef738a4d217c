"""Structure: bodies, supports and loads, checked once, from which the models of a thin layer are made."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from mpi4py import MPI

from forms.base import Array, InputError, is_number, require
from forms.kernel import KernelLaw
from forms.kinematics import KINEMATICS_BY_NAME, SCALAR_KINEMATICS_BY_NAME, ScalarField
from forms.law import BulkLaw, Law, explained_errors
from forms.law_tangents import declared_or_computed_tangent, depends_on_normal, require_stable
from geometry.inflating.layering import CellsThrough
from geometry.joint import Joint
from geometry.refusals import require_known
from geometry.seam import LAYER, FacetName, S
from geometry.sheet import Sheet
from geometry.topology import is_tensor
from thinlayer.discretisation.boundary import require_revolution
from thinlayer.discretisation.coefficient import LoadInput, Pressure, Value, values_by_body
from thinlayer.discretisation.forces import BodyForce
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Bond, Layers
from thinlayer.discretisation.model import copy_without_caches
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.discretisation.point_loads import ConcentratedLoad, check_loads
from thinlayer.discretisation.prescribed_strains import EigenstrainInput as Eigenstrain
from thinlayer.discretisation.prescribed_strains import MeanTensorInput
from thinlayer.discretisation.supports import SupportsByPlace
from thinlayer.system.fingerprint import digest
from thinlayer.system.ranks import errors_on_all, require_same

ELEMENT_NAMES = {False: ("P1", "P2"), True: ("Q1", "Q2", "S2")}
Eigenstrains = Eigenstrain | Mapping[str, Eigenstrain | None]


class Structure:
    """A structure with a thin soft layer: bodies, supports and loads, shared by all of its models. Collective.

    Args:
        joint: the joint; the layer is on S.
        body: law of the bodies (moduli: stress), or region name -> law. Allowed are laws of strains that do not soften.
            Laws only for layers are not allowed: `Stack`, `Incompressible`, laws with phases, and laws that depend on
            the normal of S. Parameters may be numpy functions of places (d, n) in the joint that return n values.
        supports: place -> prescribed displacements. A place is the name of a facet set, which includes the side of the
            layer that continues it, or the coordinates of a vertex. Displacements are {"x": value, ...}, {"n": value}
            along the outer normal, or one number for all components. Where places overlap, values must agree.
        tractions: name of a facet set -> traction (d,) in d dimensions (stress), constant or a function (x, t) of UFL
            coordinates that returns d components. It acts on the bodies. With bodies="extended" it also acts where the
            layer's side takes the place of loaded faces of the bodies. All models then have the same loads. The name
            "NAME/LAYER" loads the layer's own side next to the facet set NAME. This force of order eps is in interface
            laws of order 1, but not in those of order 0. `Pressure(p)` acts along the inner normal.
        body_force: (d,) force per volume in the bodies, constant or a function (x, t). Or name -> force, for regions
            and seams; a single seam is called "S". On a seam it is the weight of the layer, of order eps. It acts on
            the layer's cells. In the interface model it is multiplied by the thickness, and half of it acts on each
            side of S. On a rigid base one half acts directly on the base.
        fluxes: for bodies with laws of a scalar field, in place of tractions: name of a facet set -> flux into the
            body, a number or a function (x, t). Elsewhere on the boundary the flux is zero, if no support holds the
            field. A rigid base has the value 0 of the field: measure the field from that of the base.
        sources: for a scalar field, in place of body forces: what is released per volume and time. A number, a function
            (x, t), or name of a region or seam -> one of these.
        loads: list of `PointLoad` and `LineLoad`: forces at vertices and along edges.
        plane: "strain", "stress" or "axisymmetric", for a joint in 2D. In plane stress, laws compute the strains out of
            the plane themselves (`BulkLaw.plane_stress`). Axisymmetric: x is the distance r >= 0 from the axis of
            revolution, y the place along it, and there is no twist. On the axis u_x = 0 is prescribed automatically.
            All integrals (energies, loads, forces, over S) are over the whole revolution.
        element: "P1", "P2" (default) on triangles and tetrahedra, "Q1", "Q2" (default) or "S2" on others.
        parts: further parts of the balance of forces: `Springs`, `UflPart`, or a user-defined `PartDefinition`.
        strain: mean strain E of a periodic joint, (d, d) symmetric numbers, or a function (x, t) of the time alone that
            returns them. Displacements u then exclude the mean motion: bodies have the strain E + strain(u), S has the
            jump [u]. Translations that nothing prevents are fixed at one vertex, so `supports={}` is allowed.
        stress: mean stress instead of a mean strain, (d, d) or such a function. The mean strain is then unknown, see
            `State.mean_strain`. The joint must be periodic in all directions, and the bodies linear.
        gradient: for a scalar field, its mean gradient in a periodic joint, (d,) numbers or such a function. The field
            then excludes the linear field with this gradient.
        eigenstrain: strain that the bodies would have without stress, or region name -> strain. Allowed are a number, a
            symmetric table (d, d) or (3, 3), and a function (x, t) of UFL coordinates that returns one of these;
            `ThermalExpansion`, `Prestress`, or a list of several that add up. A number multiplies the identity in three
            dimensions, so that in plane strain it also causes stress across the plane. Layers have their own
            eigenstrain, `ThinLayer(..., eigenstrain=...)`.
        initial: for a scalar field, its value before a march, a number, a function of the place x in UFL or numpy, or
            of (x, t), taken at the start. A march with a capacity needs it. Non-linear steady problems are solved from
            it.
        comm: MPI communicator (default: the world).

    Attributes:
        joint: the joint as drawn, before S is opened to the layers' thickness.
        plane: "strain", "stress" or "axisymmetric".
        element: name of the finite element of displacements.
        degree: its polynomial degree.
        kinematics: strains of displacements for `plane`, not yet on a mesh.
        body_laws: name of a body -> its law.
        supports, tractions, body_force, loads, parts, stress: the arguments; of a scalar field fluxes, sources.
        strain: the mean strain, or the mean gradient of a scalar field.
        eigenstrains: name of a body -> its eigenstrain as the user wrote it; bodies without one are left out.
        comm: MPI communicator; None: the world.
        data_hash: hash of the data, equal on all ranks.

    Raises:
        InputError: the message says what cannot be built, where, and what is allowed. Names of facets and loads are
            checked when a model is made.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> print(state.reaction("BOTTOM").force.round(6))
        [-12.  40.]
    """

    def __init__(
        self,
        joint: Joint,
        *,
        body: BulkLaw | Mapping[str, BulkLaw],
        supports: SupportsByPlace,
        tractions: Mapping[str, LoadInput | Pressure] | None = None,
        body_force: BodyForce | None = None,
        fluxes: Mapping[str, Value] | None = None,
        sources: Value | Mapping[str, Value] | None = None,
        loads: Sequence[ConcentratedLoad] = (),
        plane: str = "strain",
        element: str | None = None,
        parts: Sequence[PartDefinition] = (),
        strain: MeanTensorInput | None = None,
        stress: MeanTensorInput | None = None,
        gradient: MeanTensorInput | None = None,
        eigenstrain: Eigenstrains | None = None,
        initial: Value | None = None,
        comm: MPI.Intracomm | None = None,
    ) -> None:
        require(comm is None or isinstance(comm, MPI.Intracomm), "comm", comm, "give an MPI communicator, or None")
        self.joint, self.plane, self.comm = joint, plane, comm
        self.supports, self.stress, self.initial = supports, stress, initial
        self.strain = strain if gradient is None else gradient
        with errors_on_all(comm):
            require(isinstance(joint, Joint), "joint", joint, "it must be a Joint, such as geometry.sandwich gives")
            require(isinstance(parts, Sequence), "parts", parts, "it must be a list of parts")
            self.parts = tuple(parts)
            self.element = element or ("Q2" if is_tensor(joint.cell_type) else "P2")
            self.loads = check_loads(loads)
            self.body_laws = self._laws_by_body(body)
            self._check_choices()
            self.degree = int(self.element[1])
            self.tractions, self.body_force = self._loads_of_unknown(
                tractions=tractions, body_force=body_force, fluxes=fluxes, sources=sources, loads=self.loads or None,
                strain=strain, stress=stress, eigenstrain=eigenstrain, gradient=gradient, initial=initial,
            )  # fmt: skip
            self._check_parts()
            eigenstrains = values_by_body(eigenstrain, joint, "eigenstrain")
            self.eigenstrains = {name: value for name, value in eigenstrains.items() if value is not None}
            for law, C in zip(self.body_laws_at_extremes, self.extreme_body_tangents, strict=True):
                require_stable(law, C, slots=self.kinematics.strain_indices(joint.dim))
        self.data_hash = require_same(
            comm, joint=joint, body=body, supports=_ordered_pairs(supports), tractions=self.tractions,
            body_force=self.body_force, loads=self.loads, plane=plane, element=self.element, parts=self.parts,
            strain=self.strain, stress=stress, eigenstrain=eigenstrain, **({} if initial is None else {"initial": initial}),
        )  # fmt: skip

    # ---------------------------------------------------------------- models
    def full(
        self, layer: Layers, *, bodies: str = "kept", cells_through: CellsThrough = 4, junctions: str | None = None
    ) -> FullModel:
        """Make the model whose layer is meshed. Collective.

        Args:
            layer: law and thickness of the layer; S is opened to the thickness. For a joint with several seams {name of
                a seam: its layer, or a `Gap` for an open joint}, or one layer for all. A layer continues past the end
                of a gap. With extended bodies, tractions do not act on faces that bodies gave up to gaps.
            bodies: "kept": bodies keep their shape and move apart by the thickness. "extended": the outer shape is
                kept, and each body gives up half of the thickness (on a rigid base all of it).
            cells_through: number of cells through the layer's thickness, an even one where layers meet. For a law that
                softens it has little effect, and a single cell is sufficient and fastest. The mean of the strains
                through the thickness drives such a law, as on S, and deviations from the mean are elastic. Or {name of
                a seam: heights between which cells lie, as fractions of the thickness from 0 to 1}.
            junctions: name of a seam whose law also fills the cells where it meets other seams. At other junctions, and
                by default, this is the law of the first of the joint's seams that end there. These cells need the law
                of a layer, with moduli that decrease with the thickness. Other laws would tie the corners of the bodies
                together, and the model would not converge to the interface model.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.

        Example:
            >>> from forms import LinearElastic
            >>> from geometry import sandwich
            >>> from thinlayer import Structure, ThinLayer, solve
            >>> steel = LinearElastic.young(E=210e3, nu=0.3)
            >>> glue = LinearElastic.young(E=2e3, nu=0.4)
            >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
            >>> plates = Structure(
            ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
            ... )
            >>> model = plates.full(ThinLayer(glue, eps=0.05), cells_through=2)
            >>> f"{solve(model).energies()['layer']:.3g}"
            '0.00426'
        """
        return FullModel(self, layer, bodies=bodies, cells_through=cells_through, junctions=junctions)

    def interface(self, layer: Layers, *, bodies: str = "kept") -> InterfaceModel:
        """Make the model whose layer is replaced by its interface law on S. Collective.

        Args:
            layer: a thin layer, or a law on S without a thickness (a `TractionLaw` or a contact law). Or a `Bond`,
                which makes displacements equal on both sides. With several seams, give a dictionary from the name of a
                seam to its layer; None or a `Gap` leaves the seam open. A layer without a dictionary is that of all
                seams.
            bodies: "kept": bodies meet on S. "extended": bodies are where `full(layer, bodies="extended")` has them,
                each half of the thickness away from S (on a rigid base all of it). Order 1 needs this on a curved S, or
                with a thickness that varies. All layers must then have a thickness, and seams must not meet.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.

        Example:
            >>> from forms import LinearElastic
            >>> from geometry import sandwich
            >>> from thinlayer import Structure, ThinLayer, solve
            >>> steel = LinearElastic.young(E=210e3, nu=0.3)
            >>> glue = LinearElastic.young(E=2e3, nu=0.4)
            >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
            >>> plates = Structure(
            ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
            ... )
            >>> model = plates.interface(ThinLayer(glue, eps=0.05, order=1))
            >>> f"{solve(model).energies()['layer']:.3g}"
            '0.00428'
        """
        return InterfaceModel(self, layer, bodies=bodies)

    def bonded(self) -> InterfaceModel:
        """Make the model without layers: bodies are bonded on all of S (on a rigid base S is fixed). Collective.

        Raises:
            InputError: the message says what cannot be built, where, and what is allowed.

        Example:
            >>> from forms import LinearElastic
            >>> from geometry import sandwich
            >>> from thinlayer import Structure, ThinLayer, solve
            >>> steel = LinearElastic.young(E=210e3, nu=0.3)
            >>> glue = LinearElastic.young(E=2e3, nu=0.4)
            >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
            >>> plates = Structure(
            ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
            ... )
            >>> f"{solve(plates.bonded()).energies()['bodies']:.3g}"
            '0.00381'
        """
        return self.interface(Bond())

    # ---------------------------------------------------------------- structures with other data
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
        """Return the same structure with other loads or supports, which are not checked. Collective.

        Args:
            tractions: name of a facet set -> traction (d,) in d dimensions, or `Pressure`; None: unchanged.
            body_force: force per volume (d,), or name of a region or seam -> this force; None: unchanged.
            fluxes, sources: the same of a scalar field, numbers instead of vectors.
            loads: list of `PointLoad` and `LineLoad`; None: unchanged.
            supports: place -> prescribed displacements; None: unchanged.
        """
        tractions, body_force = self._loads_of_unknown(
            loads=loads or None, tractions=tractions, body_force=body_force, fluxes=fluxes, sources=sources
        )
        data = {"tractions": tractions, "body_force": body_force, "loads": loads and tuple(loads), "supports": supports}
        return self.replaced(**{name: value for name, value in data.items() if value is not None})

    def replaced(self, **data: Any) -> Self:
        """Return the same structure with other data, attributes by name, which are not checked. Collective."""
        new = copy_without_caches(self)
        vars(new).update(data)
        hashed = {name: _ordered_pairs(value) if name == "supports" else value for name, value in data.items()}
        new.data_hash = digest([self.data_hash, require_same(self.comm, **hashed)])
        return new

    def with_joint(self, joint: Joint) -> Self:
        """Return the same structure on another mesh `joint` with the same names. Collective."""
        new = copy_without_caches(self)
        new.joint, new.data_hash = joint, digest([self.data_hash, require_same(self.comm, joint=joint)])
        return new

    def with_layers_only(self, names: Collection[str]) -> Self:
        """Return the structure that has only the layers on the seams `names`, with their own loads, on one process.

        It has no bodies' laws, and no other parts such as springs.
        """
        new, force = copy_without_caches(self), self.body_force
        new.joint = replace(self.joint, seams={name: s for name, s in self.joint.seams.items() if name in names})
        new.comm, new.parts, new.loads, new.body_laws, new.eigenstrains = MPI.COMM_SELF, (), (), {}, {}
        if self.initial is None and self.kinematics.unknown == ScalarField.unknown:
            new.initial = self.mean_support  # as the layers by themselves have no such supports
        new.tractions = {k: v for k, v in (self.tractions or {}).items() if FacetName.parse(k).part_name == LAYER}
        new.body_force = {k: v for k, v in force.items() if k in (*names, S)} if isinstance(force, Mapping) else None
        return new

    # ---------------------------------------------------------------- data
    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.joint!r}, {self.element}, {self.plane}, supports {[*self.supports]})"

    @property
    def mean_support(self) -> float:
        """Mean of the numbers that supports prescribe; 0 if there are none."""
        supports = [u.values() if isinstance(u, Mapping) else [u] for u in self.supports.values()]
        return float(np.mean([v for values in supports for v in values if is_number(v)] or [0.0]))

    @cached_property
    def sheet(self) -> Sheet:
        """All seams together, divided into straight segments in 2D or triangles in 3D."""
        return Sheet(self.joint)

    @cached_property
    def extreme_body_tangents(self) -> list[Array | None]:
        """Tangents (6, 6) at zero strain, in Mandel's notation, of `body_laws_at_extremes`; None where not known."""
        n = self.sheet.mean_normal
        return [declared_or_computed_tangent(self.kinematics.law(law), n) for law in self.body_laws_at_extremes]

    @cached_property
    def body_laws_at_extremes(self) -> list[BulkLaw]:
        """Laws of all bodies with numbers as parameters, for checks.

        A law with functions of the place as parameters occurs several times. It has the values at those places where
        one of the parameters is least or largest.
        """
        joint, laws = self.joint, []
        for name, law in self.body_laws.items():
            cell_corners = joint.corners[joint.region == joint.regions.index(name)] if law.fields else joint.corners[:1]
            laws += law.laws_at_extremes(joint.points[cell_corners].mean(axis=1).T)
        return laws

    def _check_choices(self) -> None:
        joint, element_names = self.joint, ELEMENT_NAMES[is_tensor(self.joint.cell_type)]
        require_known("plane", self.plane, KINEMATICS_BY_NAME)
        unknown = next(iter(self.body_laws.values())).unknown
        self.kinematics = (KINEMATICS_BY_NAME, SCALAR_KINEMATICS_BY_NAME)[unknown == ScalarField.unknown][self.plane]
        if joint.dim == 3 and self.plane != "strain":
            raise InputError(f"plane={self.plane!r} needs a two-dimensional joint")
        require_revolution(self.kinematics, joint)
        if self.strain is not None and self.stress is not None:
            raise InputError("give a mean strain or a mean stress, not both")
        if self.kinematics.has_axis and not (self.strain is None and self.stress is None):
            what = "mean gradient" if unknown == ScalarField.unknown else "mean strain or stress"
            raise InputError(f"plane={self.plane!r}: a {what} is for periodic cells without an axis")
        if self.element not in element_names:
            cells_text = f"{joint.cell_type} cells; allowed: {', '.join(element_names)}"
            raise InputError(f"element {self.element!r} does not exist on {cells_text}")

    def _laws_by_body(self, body: BulkLaw | Mapping[str, BulkLaw]) -> dict[str, BulkLaw]:
        """Return the law of each body by name, from one law for all bodies or a mapping.

        Raises:
            InputError: a body has no law, or a law that is only for layers.
        """
        laws = values_by_body(body, self.joint, "body")
        for name in self.joint.bodies:
            law = laws.get(name)
            if not isinstance(law, Law):
                raise InputError(f"body {name!r} has no law; give body=law or body={{{name!r}: law, ...}}")
            require_body_law(name, law)
        first, *others = self.joint.bodies
        for name in (name for name in others if laws[name].unknown != laws[first].unknown):
            kinds = (f"{body!r} of a {laws[body].unknown} ({type(laws[body]).__name__})" for body in (first, name))
            text = f"bodies have laws of different unknowns: {' and '.join(kinds)}"
            raise InputError(f"{text}; make a structure for each unknown, and see thinlayer.coupled")
        return laws

    def _loads_of_unknown(self, **data: Any) -> list[Any]:
        """Return the loads on facets and in volumes: tractions and body forces, or a scalar field's fluxes and sources.

        `data` has the arguments with these names, and others.

        Raises:
            InputError: an argument is given that does not act on the unknown of the bodies' laws.
        """
        names = self.kinematics.quantities
        allowed = (*names.load_arguments, *names.more_arguments)
        for name in (name for name, value in data.items() if name not in allowed and value is not None):
            raise InputError(f"{name}= does not act on a {self.kinematics.unknown}; allowed: {', '.join(allowed)}")
        return [data[name] for name in names.load_arguments]

    def _check_parts(self) -> None:
        unknown = self.kinematics.unknown
        for part in self.parts:
            require(isinstance(part, PartDefinition), "parts", part, "each must be a part, such as Springs or Film")
            if unknown not in part.unknowns:
                raise InputError(f"{part!r:.80} acts on a {part.unknowns[0]}; the bodies have laws of a {unknown}")


def require_body_law(name: str, law: Law) -> None:
    """Raise InputError, with the reason, if a body cannot have a law.

    This is so if the law is only for layers, or if its stress falls as strains grow (it softens).

    Args:
        name: name of the body.
        law: the law.
    """
    traits, law_name = law.traits, type(law).__name__
    reason = ""
    if not isinstance(law, BulkLaw):
        reason = "it gives tractions for jumps, which a body has not"
    elif law.sublayers[0][1] is not law:
        reason = "its sublayers lie across the thickness of a layer; give regions laws of their own"
    elif traits.constrained:
        reason = "its pressure is a field of its own; take LinearElastic with nu = 0.4999, say, in elements of degree 2"
    elif traits.phases:
        reason = "its phases are those of a layer's columns"
    else:
        with explained_errors(law, law.methods[0]):
            if depends_on_normal(law):
                reason = "its stress depends on the normal of S, which a body has not"
                reason += ", or its class does not say isotropic = True" * isinstance(law, KernelLaw)
                reason += "; take frame='global'" * (getattr(law, "frame", "") == "layer")
    if reason:
        raise InputError(f"body {name!r}: {law_name} is for layers: {reason}")
    if traits.softens:
        reason = "all strain would gather in one row of cells; let a layer soften"
        raise InputError(f"body {name!r}: the stress of {law_name} falls as strains grow: {reason}")


def _ordered_pairs(data: SupportsByPlace | None) -> object:
    """Return a mapping as a list of pairs in its order, because supports are numbered in this order."""
    return [list(entry) for entry in data.items()] if isinstance(data, Mapping) else data
