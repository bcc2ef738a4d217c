"""Setup: bodies, supports and loads, checked once."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Self

from mpi4py import MPI

from forms.base import Array, InputError, require
from forms.kernel import KernelLaw
from forms.kinematics import KINEMATICS_BY_NAME, Kinematics
from forms.law import BulkLaw, Law, explained_errors
from forms.law_tangents import declared_or_computed_tangent, needs_director, require_stable
from geometry.joint import Joint
from geometry.refusals import require_known
from geometry.sheet import Sheet
from geometry.topology import is_tensor
from thinlayer.discretisation.boundary import require_revolution
from thinlayer.discretisation.coefficient import Load, Pressure, values_by_body
from thinlayer.discretisation.forces import BodyForce
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.discretisation.point_loads import ConcentratedLoad, check_loads
from thinlayer.discretisation.prescribed_strains import EigenstrainInput as Eigenstrain
from thinlayer.discretisation.prescribed_strains import Strain
from thinlayer.discretisation.supports import ByPlace
from thinlayer.system.fingerprint import digest
from thinlayer.system.ranks import errors_on_all, require_same

ELEMENT_NAMES = {False: ("P1", "P2"), True: ("Q1", "Q2", "S2")}
Eigenstrains = Eigenstrain | Mapping[str, Eigenstrain | None]


class Setup:
    """A joint with the laws of its bodies, supports and loads: the arguments of `Structure`, checked. Collective.

    Attributes:
        joint: the joint before inflating.
        plane: "strain", "stress" or "axisymmetric".
        element: the finite element of displacements.
        degree: its polynomial degree.
        body_laws: law of each body.
        supports, tractions, body_force, loads, parts, strain, stress: the arguments of `Structure`.
        eigenstrains: eigenstrain of each body that has one, as the user wrote it.
        comm: MPI communicator; None: the world.
        data_hash: hash of the data, equal on all ranks.

    Raises:
        InputError: the message says what cannot be built, where, and what is allowed.
    """

    def __init__(
        self,
        joint: Joint,
        *,
        body: BulkLaw | Mapping[str, BulkLaw],
        supports: ByPlace,
        tractions: Mapping[str, Load | Pressure] | None = None,
        body_force: BodyForce | None = None,
        loads: Sequence[ConcentratedLoad] = (),
        plane: str = "strain",
        element: str | None = None,
        parts: Sequence[PartDefinition] = (),
        strain: Strain | None = None,
        stress: Strain | None = None,
        eigenstrain: Eigenstrains | None = None,
        comm: MPI.Intracomm | None = None,
    ) -> None:
        require(comm is None or isinstance(comm, MPI.Intracomm), "comm", comm, "give an MPI communicator, or None")
        self.joint, self.plane, self.comm = joint, plane, comm
        self.supports, self.tractions, self.body_force = supports, tractions, body_force
        self.strain, self.stress = strain, stress
        with errors_on_all(comm):
            require(isinstance(joint, Joint), "joint", joint, "it must be a Joint, such as geometry.sandwich gives")
            require(isinstance(parts, Sequence), "parts", parts, "it must be a list of parts")
            self.parts = tuple(parts)
            self.element = element or ("Q2" if is_tensor(joint.cell_type) else "P2")
            self.loads = check_loads(loads)
            self._check_choices()
            self.degree = int(self.element[1])
            self.body_laws = self._laws_of(body)
            strains = values_by_body(eigenstrain, joint, "eigenstrain")
            self.eigenstrains = {name: value for name, value in strains.items() if value is not None}
            for law, C in zip(self.bodies_with_numbers, self.bodies_at_rest, strict=True):
                require_stable(law, C, slots=self.kinematics.slots(joint.dim))
        self.data_hash = require_same(
            comm, joint=joint, body=body, supports=_ordered(supports), tractions=tractions, body_force=body_force,
            loads=self.loads, plane=plane, element=self.element, parts=self.parts, strain=strain, stress=stress,
            eigenstrain=eigenstrain,
        )  # fmt: skip

    def with_loads(self, loads: Mapping[str, Any]) -> Self:
        """Return the same data with other loads, given as argument -> value and not checked. Collective."""
        new = copy.copy(self)
        for name, value in loads.items():
            setattr(new, name, value)
        data = {name: _ordered(value) if name == "supports" else value for name, value in loads.items()}
        new.data_hash = digest([self.data_hash, require_same(self.comm, **data)])
        return new

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.joint!r}, {self.element}, {self.plane}, supports {[*self.supports]})"

    @cached_property
    def kinematics(self) -> Kinematics:
        """Strains of displacements, without a mesh."""
        return KINEMATICS_BY_NAME[self.plane]

    @cached_property
    def sheet(self) -> Sheet:
        """S as a sheet of straight simplices."""
        return Sheet(self.joint)

    @cached_property
    def bodies_at_rest(self) -> list[Array | None]:
        """Tangents at rest of `bodies_with_numbers`; None where not known."""
        n = self.sheet.mean_normal
        return [declared_or_computed_tangent(self.kinematics.law(law), n) for law in self.bodies_with_numbers]

    @cached_property
    def bodies_with_numbers(self) -> list[BulkLaw]:
        """Laws of the bodies; those with functions as parameters are sampled where one is smallest or largest."""
        joint, laws = self.joint, []
        for name, law in self.body_laws.items():
            cells = joint.corners[joint.region == joint.regions.index(name)] if law.fields else joint.corners[:1]
            laws += law.samples(joint.points[cells].mean(axis=1).T)
        return laws

    def _check_choices(self) -> None:
        joint, elements = self.joint, ELEMENT_NAMES[is_tensor(self.joint.cell_type)]
        require_known("plane", self.plane, KINEMATICS_BY_NAME)
        if joint.dim == 3 and self.plane != "strain":
            raise InputError(f"plane={self.plane!r} needs a two-dimensional joint")
        require_revolution(self.kinematics, joint)
        if self.strain is not None and self.stress is not None:
            raise InputError("give a mean strain or a mean stress, not both")
        if not (self.kinematics.rotations or (self.strain is None and self.stress is None)):
            raise InputError(f"plane={self.plane!r}: a mean strain or stress is for periodic cells without an axis")
        if self.element not in elements:
            cells = f"{joint.cell_type} cells; allowed: {', '.join(elements)}"
            raise InputError(f"element {self.element!r} does not exist on {cells}")

    def _laws_of(self, body: BulkLaw | Mapping[str, BulkLaw]) -> dict[str, BulkLaw]:
        """The law of each body, in the same order on all ranks."""
        laws = values_by_body(body, self.joint, "body")
        for name in self.joint.bodies:
            law = laws.get(name)
            if not isinstance(law, Law):
                raise InputError(f"body {name!r} has no law; give body=law or body={{{name!r}: law, ...}}")
            require_body_law(name, law)
        return laws


def require_body_law(name: str, law: Law) -> None:
    """Raise InputError, with the reason, if a law is for layers only."""
    traits, kind = law.traits, type(law).__name__
    reason = ""
    if not isinstance(law, BulkLaw):
        reason = "it gives tractions for jumps, which a body has not"
    elif law.sublayers[0][1] is not law:
        reason = "its sublayers lie across the thickness of a layer; give regions laws of their own"
    elif traits.constrained:
        reason = "its pressure is a field of its own; take LinearElastic with nu = 0.4999, say, in elements of degree 2"
    elif traits.phases:
        reason = "its phases are those of a layer's columns"
    elif traits.compiled:  # others raise errors themselves, as n is None in a body
        with explained_errors(law, law.methods[0]):
            if needs_director(law):
                reason = "its stress depends on the normal of S, which a body has not"
                reason += ", or its class does not say isotropic = True" * isinstance(law, KernelLaw)
    if reason:
        raise InputError(f"body {name!r}: {kind} is for layers: {reason}")
    if traits.softens:
        reason = "all strain would gather in one row of cells; let a layer soften"
        raise InputError(f"body {name!r}: the stress of {kind} falls as strains grow: {reason}")


def _ordered(data: Any) -> Any:
    """Return a mapping as pairs in its order, because supports are numbered in this order."""
    return [list(entry) for entry in data.items()] if isinstance(data, Mapping) else data
