"""Layers on their seams: what a model needs to know of a layer before anything is discretised, and S on the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from forms.contact import ContactLaw
from forms.kinematics import Expr
from forms.law import Law
from geometry.domain import Domain
from geometry.errors import place
from geometry.joint import Joint
from geometry.seam import S
from geometry.sheet import Sheet
from geometry.topology import is_tensor
from thinlayer.compiling.compat import interior_facet_entities
from thinlayer.discretisation.at_rest import AtRest
from thinlayer.discretisation.axis import is_across
from thinlayer.discretisation.eigenstrains import Matter, given_strain
from thinlayer.discretisation.given import Coordinates, Load
from thinlayer.discretisation.layer import CONTACT, LAYER, PRESSURE, LawOnS, Layer, ThinLayer, real_law
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError
from thinlayer.identity import described


class SeamLayer:
    """A layer, or a law of jumps or of nodes, on a seam.

    Attributes:
        name: of the seam.
        layer: as given.
        structure: the data of the bodies.
    """

    def __init__(self, name: str, layer: Layer, structure: Setup) -> None:
        self.name, self.layer, self.structure = name, layer, structure

    def __str__(self) -> str:
        return f"the layer {self.name!r}" if len(self.structure.joint.seams) > 1 else "the layer"

    @property
    def key(self) -> str:
        """Key of what the law remembers and stores; it has the seam's name if the joint has several seams.

        Several terms of one layer have the keys "layer NAME/1", "layer NAME/2", ...; names of seams have no slash.
        """
        kind = CONTACT if self.contact else LAYER
        return f"{kind} {self.name}" if len(self.structure.joint.seams) > 1 else kind

    @property
    def pressure_key(self) -> str:
        """Key of the layer's pressure, if its law has one."""
        return PRESSURE + self.key.removeprefix(LAYER)

    @property
    def flows(self) -> bool:
        """Whether the interface law is that of order 1 of a law with a pressure, which flows along S."""
        return self.thin is not None and self.thin.order == 1 and self.thin.law.traits.constrained

    @property
    def thin(self) -> ThinLayer | None:
        """The layer, if it has a law of strains."""
        return None if isinstance(self.layer, LawOnS) else self.layer

    @property
    def contact(self) -> ContactLaw | None:
        """The law, if it is one of contact."""
        return self.layer if isinstance(self.layer, ContactLaw) else None

    @property
    def law(self) -> Law:
        """The law, as given."""
        return self.layer if isinstance(self.layer, LawOnS) else self.layer.law

    @property
    def remembers(self) -> bool:
        """Whether the law depends on its history, and may dissipate energy."""
        return self.law.traits.rate or self.law.traits.remembers

    @cached_property
    def sheet(self) -> Sheet:
        """The seam as a sheet of straight simplices."""
        return Sheet(self.structure.joint, self.name)

    @cached_property
    def samples(self) -> list[SeamLayer]:
        """The layer itself; where parameters are functions, with numbers where one is smallest or largest along S."""
        if not (self.thin and self.thin.law.fields):
            return [self]
        joint = self.structure.joint
        facets = joint.points[joint.table.vertices[joint.rows_of(self.name)]].mean(axis=1)
        laws = self.thin.law.samples(facets.T)
        return [SeamLayer(self.name, replace(self.thin, law=law), self.structure) for law in laws]

    @cached_property
    def at_rest(self) -> AtRest:
        """The law at rest, of a layer without contact; its parameters are numbers (`samples`)."""
        return AtRest(real_law(self.layer, self.structure.kinematics), self.sheet.mean_normal)

    def given(self, at: Coordinates) -> Expr | None:
        """The strain (3, 3) that is added to that of the displacements: less the eigenstrain; None: there is none."""
        if self.thin is None:
            return None
        kinematics = self.structure.kinematics
        matter = Matter(str(self), real_law(self.layer, kinematics), self.sheet.mean_normal, kinematics, at)
        return given_strain(self.thin.eigenstrain, matter)

    def check(self, bodies: str) -> None:
        """Raise ModelError or LawError if the layer does not suit the joint or the elements, or is not stable.

        Args:
            bodies: "kept", or "extended": at their true places.
        """
        joint, element = self.structure.joint, self.structure.element
        if not isinstance(self.layer, ThinLayer | LawOnS):
            raise ModelError(
                f"the layer is {self.layer!r}; give ThinLayer(law, eps), or a law of jumps or of contact on S"
            )
        self.law.check_dimension(joint.dim)
        if self.contact:
            self._check_contact(self.contact)
            return
        if self.thin:
            if self.thin.order == 1:
                self._check_order_1(bodies)
            if self.thin.law.traits.constrained and element not in ("P2", "Q2"):
                raise ModelError(
                    f"an incompressible layer needs elements P2 or Q2 for its displacements, not {element}"
                )
            joint.relative_thickness(self.thin.profile, self.name)  # a user's function, may fail on one rank alone
        for one in self.samples:
            one.at_rest.require_stable()

    def check_next_term(self, bodies: str) -> None:
        """Raise ModelError or LawError unless the next term of the law holds away from tips and junctions; as `check`."""
        if self.thin and self.thin.law.traits.constrained and self.structure.plane == "stress":
            raise ModelError(
                f"order=1 of {type(self.thin.law).__name__} in plane stress: no pressure builds up in a sheet; use "
                "LinearElastic or order=0"
            )
        if self.structure.degree != 2:
            element = self.structure.element
            raise ModelError(f"order=1 needs elements of degree 2 (its law has gradients on S), not {element}")
        self._check_flat(bodies)
        for one in self.samples:
            one.at_rest.require_no_locking()

    def _check_order_1(self, bodies: str) -> None:
        self.check_next_term(bodies)
        if self.sheet.tip is not None:
            raise ModelError(
                f"order=1 needs an S that does not end inside the bodies, and {self} ends at {place(self.sheet.tip)}: its "
                "law has gradients at the tip"
            )
        if self.sheet.junction is not None:
            raise ModelError(
                f"order=1 needs an S without junctions, and {self} meets another one, or branches, at "
                f"{place(self.sheet.junction)}: the next term leaves out what a junction adds, which is of the same order"
            )

    def _check_flat(self, bodies: str) -> None:
        """Raise ModelError for a bent layer whose next term would be wrong."""
        assert self.thin
        if (bent := self._bent) and bodies == "kept":
            raise ModelError(
                f"order=1 {bent} needs bodies at their true places: where they meet on S the next term is wrong; use "
                "bodies='extended', for the interface and the full model alike"
            )
        if bent and len(self.thin.law.sublayers) > 1:
            raise ModelError(
                f"order=1 of a Stack {bent}: the next term leaves out that the sublayers' shares of the jump turn along S; "
                "use order=0, or mesh the layer (structure.full)"
            )

    @property
    def _bent(self) -> str | None:
        """In what way the layer is not flat and of one thickness, if it is not."""
        if self.thin and self.thin.profile is not None:
            return "of a thickness that varies"
        if not self.sheet.planar:
            return "on a curved S"
        if not is_across(self.structure.kinematics, self.sheet.mean_normal[None]):
            return "on an S that is not across the axis of revolution, its normal along y, and so curved,"
        return None

    def _check_contact(self, law: ContactLaw) -> None:
        """Raise ModelError unless displacements are of degree 1: contact laws act at the vertices of S."""
        linear = "Q1" if is_tensor(self.structure.joint.cell_type) else "P1"
        if self.structure.element != linear:
            raise ModelError(
                f"a contact law acts at the vertices of S and needs element={linear!r}, not {self.structure.element}: "
                "nodes in the middle of edges would carry most of the pressure, or none of it"
            )
        law.check_threshold()

    @property
    def profile(self) -> Any:
        """Description of the profile, as JSON; None: the thickness is uniform."""
        given = self.thin.profile if self.thin else None
        return described(self.structure.joint.relative_thickness(given, self.name)) if given else None

    def identity(self) -> dict[str, Any]:
        """Description of the layer without its law, as JSON."""
        thin = self.thin
        return {
            "eps": float(thin.eps) if thin else None,
            "order": thin.order if thin else None,
            "profile": self.profile,
            **({"eigenstrain": described(thin.eigenstrain)} if thin and thin.eigenstrain is not None else {}),
        }


def loads_of_layers(given: Any, joint: Joint, layers: Mapping[str, SeamLayer]) -> dict[str, Load]:
    """Name of a seam -> force per volume of its layer, among the body forces as given.

    Raises:
        ModelError: a load of a seam without a layer that has a thickness.
    """
    found: dict[str, Load] = {}
    for name, load in given.items() if isinstance(given, Mapping) else ():
        if name not in (S, *joint.seams):
            continue
        for seam in joint.seams if name == S else (name,):
            layer = layers.get(seam)
            if layer is None or not layer.thin:
                raise ModelError(
                    f"body force in the layer {seam!r}: it is no layer with a thickness; its weight is not known"
                )
            found[seam] = load
    return found


def seam_entities(domain: Domain, name: str) -> npt.NDArray[np.int32]:
    """(upper cell, local facet, lower cell, local facet) of this rank's facets of a seam between bodies, (n, 4).

    They are in the order of the local facets. Collective.
    """
    joint, mesh = domain.joint, domain.mesh
    mesh.topology.create_connectivity(joint.dim - 1, joint.dim)
    mesh.topology.create_connectivity(joint.dim, joint.dim - 1)
    facets = domain.facets(name)
    facets = np.sort(facets[facets < mesh.topology.index_map(joint.dim - 1).size_local])
    entities = interior_facet_entities(mesh, facets)
    lost = domain.comm.allreduce(len(facets) - len(entities))
    if lost:
        raise ModelError(f"{lost} facets of {name!r} have one cell on their rank: the mesh lacks ghost cells")
    rows = np.searchsorted(joint.surface_rows, domain.numbers(joint.dim - 1, facets))
    swap = domain.original_cells[entities[:, 0]] != joint.surface_cells[rows, 1]
    entities[swap] = entities[swap][:, [2, 3, 0, 1]]
    return entities
