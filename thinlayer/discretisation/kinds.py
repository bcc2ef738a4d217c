"""The three kinds of models: the layer meshed, the layer replaced by its interface law on S, and bodies that are bonded."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms import work as forms
from forms.contact import ContactLaw
from forms.kinematics import Expr
from geometry.inflation import check_layering, inflate
from geometry.joint import BASE, Joint, S
from geometry.motion import require_no_branches
from geometry.topology import is_tensor
from thinlayer.discretisation.at_rest import AtRest
from thinlayer.discretisation.broken import interface_measure
from thinlayer.discretisation.joint_fields import director, relative_thickness
from thinlayer.discretisation.layer import LawOnS, Layer, ThinLayer, constants, real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError

LARGEST_EPS = 1e6  # largest thickness over the bodies' size: beyond it coordinates have fewer than ten digits left


class FullModel(Model):
    """The model whose layer is meshed.

    Attributes:
        layer: the layer.
    """

    name = "full"
    _clamped: ClassVar = (BASE,)

    def __init__(self, structure: Setup, layer: ThinLayer, *, bodies: str, cells_through: int) -> None:
        self.layer, self._bodies, self._cells_through = layer, bodies, cells_through
        super().__init__(structure, layer, bodies=bodies, cells_through=cells_through)

    def _checked(self) -> Joint:
        check_layering(self._cells_through, self._bodies)
        if isinstance(self.layer, LawOnS):
            raise ModelError(f"{type(self.layer).__name__} is a law of jump and traction: it has no meshed layer")
        _require_suited(self.layer, self.structure)
        layer, size = self.layer, self.structure.size
        self.thin_layer, self.layer_law = layer, layer.law
        if layer.order == 1 and self._bodies != "kept":
            raise ModelError("order=1 needs bodies='kept': on extended bodies its energy has no lower bound")
        if layer.law.traits.softens:
            raise ModelError(
                f"the stress of {layer.law!r} falls as strains grow: in a meshed layer all strain would gather in one row "
                "of cells; take mixing=1, or NonMonotoneUnrelaxed, which has one phase for each column"
            )
        _at_rest(layer, self.structure)
        if layer.eps > LARGEST_EPS * size:
            raise ModelError(
                f"the layer's thickness eps is {layer.eps:g}, the bodies measure {size:g}: next to such a layer their "
                "shape is lost in rounding; is eps in the unit of the mesh?"
            )
        return inflate(
            self.joint,
            layer.eps,
            profile=layer.profile,
            cells_through=self._cells_through,
            fractions=layer.fractions,
            bodies=self._bodies,
        )

    def _layer_terms(self) -> list[forms.Term]:
        mesh, law = self.domain.mesh, real_law(self.layer, self.plane)
        n = director(self.domain)
        values = [self.domain.cell_values(name) for name in self.domain.layer_regions]
        laws = [one if one.traits.compiled else constants(one, mesh) for _, one in law.sublayers]
        return [forms.band(one, self.dx(tags, **self._rule), n) for one, tags in zip(laws, values, strict=True)]


class InterfaceModel(Model):
    """The model whose layer is replaced by its interface law on S.

    Attributes:
        layer: a thin layer, or a law of jumps or of nodes.
        sides: the two sides of S.
        dS: the measure of S; values from either side are `sides.upper(f)` and `sides.lower(f)`.
    """

    name = "interface"
    broken = True

    def __init__(self, structure: Setup, layer: Layer) -> None:
        self.layer = layer
        super().__init__(structure, layer)

    def _checked(self) -> Joint:
        layer, structure = self.layer, self.structure
        if isinstance(layer, LawOnS):
            self.layer_law = layer
            layer.check_dimension(self.joint.dim)
        else:
            _require_suited(layer, structure)
            self.thin_layer, self.layer_law = layer, layer.law
        if isinstance(layer, ContactLaw):
            self.contact = layer
            _require_vertices(layer, structure)
        else:
            self.at_rest = _at_rest(layer, structure)
        if not self.joint.rigid_base:
            require_no_branches(self.joint)
        if self.thin_layer:
            self.joint.relative_thickness(self.thin_layer.profile)  # a user's function, may fail on one rank alone
        return self.joint

    @cached_property
    def sides(self) -> forms.Interface:
        """The two sides of S."""
        mesh, facets = self.domain.mesh, self.domain.facets(S)
        if self.joint.rigid_base:
            return forms.Interface.on_rigid_base(mesh, self.ds(self.domain.values(S)))
        measure, _ = interface_measure(self.comm, mesh, facets, self._colours)
        return forms.Interface.between_bodies(mesh, measure)

    @property
    def dS(self) -> ufl.Measure:
        """The measure of S."""
        return self.sides.measure

    def _layer_terms(self) -> list[forms.Term]:
        if self.contact:
            return []
        mesh, law, layer = self.domain.mesh, real_law(self.layer, self.plane), self.thin_layer
        law = law if law.traits.compiled else constants(law, mesh)
        sides = replace(self.sides, measure=self.sides.measure.reconstruct(**self._rule))
        if layer is None:
            return [forms.of_jumps(law, sides)]
        eps: Expr = fem.Constant(mesh, float(layer.eps))
        if layer.profile is not None:
            eps = eps * self.sides.upper(relative_thickness(self.domain, layer.profile))
        return forms.surface(law, sides, eps, layer.order)

    @cached_property
    def zero_tractions(self) -> tuple[npt.NDArray[np.bool_], bool]:
        """Which tractions are zero because supports of both bodies hold the jump at zero, see `AtRest.zero_tractions`.

        All are False for contact laws and for order 1, whose tractions also depend on gradients along S.
        """
        if self.contact or (self.thin_layer and self.thin_layer.order):
            return np.zeros(self.joint.dim, bool), False
        moving = any(callable(value) for _, given in self.supports.entries for value in given.values())
        return self.at_rest.zero_tractions(self.joint.planar, moving)


class BondedModel(Model):
    """The model without a layer: bodies perfectly bonded on S; on a rigid base S does not move."""

    name = "bonded"
    _clamped: ClassVar = (S,)

    def __init__(self, structure: Setup) -> None:
        super().__init__(structure, None)

    def _checked(self) -> Joint:
        return self.joint

    def _layer_terms(self) -> list[forms.Term]:
        return []


def _at_rest(layer: Layer, structure: Setup) -> AtRest:
    """The layer's law at rest; raises an error if it is not stable, or of order 1 and would lock."""
    found = AtRest(real_law(layer, structure.plane), structure.sheet.mean_normal)
    if isinstance(layer, ThinLayer) and layer.order == 1:
        found.require_no_locking()
    found.require_stable()
    return found


def _require_suited(layer: ThinLayer, structure: Setup) -> None:
    """Raise ModelError if a layer does not suit the joint or the elements."""
    joint, element = structure.joint, structure.element
    if not isinstance(layer, ThinLayer):
        raise ModelError(f"the layer is {layer!r}; give ThinLayer(law, eps), or a law of jumps or of contact on S")
    layer.law.check_dimension(joint.dim)
    if layer.order == 1:
        if structure.degree != 2:
            raise ModelError(f"order=1 needs elements of degree 2 (its law has gradients on S), not {element}")
        if not joint.planar:
            raise ModelError("order=1 needs a planar S: its law leaves out the curvature's part of the next term")
        if len(joint.bonded):
            raise ModelError("order=1 needs an S that does not end inside the bodies: its law has gradients at the tip")
    if layer.law.traits.constrained and element not in ("P2", "Q2"):
        raise ModelError(f"an incompressible layer needs elements P2 or Q2 for its displacements, not {element}")


def _require_vertices(law: ContactLaw, structure: Setup) -> None:
    """Raise ModelError unless displacements are of degree 1: contact laws act at the vertices of S."""
    linear = "Q1" if is_tensor(structure.joint.cell_type) else "P1"
    if structure.element != linear:
        raise ModelError(
            f"a contact law acts at the vertices of S and needs element={linear!r}, not {structure.element}: nodes in the "
            "middle of edges would carry most of the pressure, or none of it"
        )
    law.check_threshold()
