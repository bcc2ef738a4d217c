"""Layers on their seams: what a model needs to know of a layer before anything is discretised, and S on the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from forms.contact import ContactLaw
from forms.kinematics import Expr
from forms.law import Law
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import S
from geometry.sheet import Sheet
from thinlayer.discretisation.given import Coordinates, Load
from thinlayer.discretisation.given_strains import Matter, given_strain
from thinlayer.discretisation.layer import CONTACT, LAYER, PRESSURE, AtRest, LawOnS, Layer, ThinLayer, real_law
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError
from thinlayer.system.compat import interior_facet_entities
from thinlayer.system.identity import described


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

    @property
    def profile(self) -> Any:
        """Description of the profile, as JSON; None: the thickness is uniform."""
        given = self.thin.profile if self.thin else None
        return described(self.structure.joint.relative_thickness(given, self.name)) if given else None

    @property
    def shape(self) -> tuple[Any, ...]:
        """Thickness, profile and fractions of sublayers, which the mesh of the layer depends on; (): a law on S."""
        return (self.thin.eps, self.profile, self.thin.fractions) if self.thin else ()

    def identity(self) -> dict[str, Any]:
        """Description of the layer without its law, as JSON."""
        thin = self.thin
        return {
            "eps": float(thin.eps) if thin else None,
            "order": thin.order if thin else None,
            "profile": self.profile,
            **({"eigenstrain": described(thin.eigenstrain)} if thin and thin.eigenstrain is not None else {}),
        }


def loads_of_layers(given: Any, joint: Joint, layers: Mapping[str, SeamLayer], bonds: Sequence[str]) -> dict[str, Load]:
    """Name of a seam -> force per volume of its layer, among the body forces as given; a bond leaves it out.

    Raises:
        ModelError: a load of a seam without a layer that has a thickness.
    """
    found: dict[str, Load] = {}
    for name, load in given.items() if isinstance(given, Mapping) else ():
        if name not in (S, *joint.seams):
            continue
        for seam in joint.seams if name == S else (name,):
            if seam in bonds:
                continue
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
