"""The three kinds of models: the layer meshed, the layer replaced by its interface law on S, and bodies that are bonded."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import ufl
from dolfinx import fem

from forms import work as forms
from forms.kinematics import Expr
from geometry.inflation import check_layering, inflate
from geometry.joint import BASE, Joint, S
from thinlayer.discretisation.joint_fields import director, relative_thickness
from thinlayer.discretisation.layer import LawOnS, Layers, ThinLayer, constants, real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.pairs import Pairs
from thinlayer.discretisation.seams import SeamLayer, seam_entities
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError

LARGEST_EPS = 1e6  # largest thickness over the bodies' size: beyond it coordinates have fewer than ten digits left


class FullModel(Model):
    """The model whose layer is meshed.

    Attributes:
        layer: the layer.
    """

    name = "full"

    def __init__(self, structure: Setup, layer: ThinLayer, *, bodies: str, cells_through: int) -> None:
        self.layer, self._bodies, self._cells_through = layer, bodies, cells_through
        super().__init__(structure, layer, bodies=bodies, cells_through=cells_through)

    @property
    def _clamped(self) -> tuple[str, ...]:
        return (BASE,) if self.joint.base_seams else ()

    def _checked(self) -> Joint:
        check_layering(self._cells_through, self._bodies)
        if len(self.layers) > 1:
            raise ModelError(
                f"a joint with several seams ({', '.join(self.layers)}) has no meshed layers; use structure.interface"
            )
        (one,) = self.layers.values()
        if isinstance(one.layer, LawOnS):
            raise ModelError(f"{type(one.layer).__name__} is a law of jump and traction: it has no meshed layer")
        one.check()
        layer, size = self.layer, self.structure.size
        if layer.order == 1 and self._bodies != "kept":
            raise ModelError("order=1 needs bodies='kept': on extended bodies its energy has no lower bound")
        if layer.law.traits.softens:
            raise ModelError(
                f"the stress of {layer.law!r} falls as strains grow: in a meshed layer all strain would gather in one row "
                "of cells; take mixing=1, or NonMonotoneUnrelaxed, which has one phase for each column"
            )
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
        layer: as given: a thin layer, or a law of jumps or of nodes, for all seams, or {name of a seam: its layer}.
    """

    name = "interface"
    broken = True

    def __init__(self, structure: Setup, layer: Layers) -> None:
        self.layer = layer
        super().__init__(structure, layer)

    def _checked(self) -> Joint:
        for one in self.layers.values():
            one.check()
        return self.joint

    @cached_property
    def dS(self) -> ufl.Measure:
        """The measure of the seams between bodies; dS(k + 1) is the k-th of `joint.seams`, "+" its upper side."""
        joint = self.joint
        entities = [
            (k + 1, seam_entities(self.domain, name).ravel())
            for k, name in enumerate(joint.seams)
            if name not in joint.base_seams
        ]
        return ufl.Measure("dS", domain=self.domain.mesh, subdomain_data=entities)

    def sides_of(self, name: str = S) -> forms.Interface:
        """The two sides of a seam, or of all ("S"): n, jumps, values from either side, and the measure.

        Raises:
            GeometryError: no such seam. ModelError: S lies between bodies and on a rigid base.
        """
        joint, mesh = self.joint, self.domain.mesh
        joint.rows_of(name)
        names = tuple(joint.seams) if name == S else (name,)
        based = [one in joint.base_seams for one in names]
        if all(based):
            return forms.Interface.on_rigid_base(mesh, self.ds(self.domain.values(name)))
        if any(based):
            raise ModelError(f"S lies between bodies and on a rigid base; name one of the seams {', '.join(names)}")
        numbers = tuple(list(joint.seams).index(one) + 1 for one in names)
        return forms.Interface.between_bodies(mesh, self.dS(numbers if len(numbers) > 1 else numbers[0]))

    @cached_property
    def sides(self) -> forms.Interface:
        """The two sides of S."""
        return self.sides_of(S)

    @cached_property
    def pairs(self) -> Pairs | None:
        """Functions with a value for each pair of bodies around a vertex of S; None where seams do not meet. Collective."""
        return Pairs(self.domain) if self.joint.seams_meet else None

    def _layer_terms(self) -> list[forms.Term]:
        return [term for one in self.layers.values() if not one.contact for term in self.terms_of(one)]

    def terms_of(self, one: SeamLayer) -> list[forms.Term]:
        """The terms of a layer without contact on its seam."""
        mesh, law, layer = self.domain.mesh, real_law(one.layer, self.plane), one.thin
        law = law if law.traits.compiled else constants(law, mesh)
        sides = self.sides_of(one.name)
        sides = replace(sides, measure=sides.measure.reconstruct(**self._rule))
        if layer is None:
            return [forms.of_jumps(law, sides)]
        eps: Expr = fem.Constant(mesh, float(layer.eps))
        if layer.profile is not None:
            eps = eps * sides.upper(relative_thickness(self.domain, layer.profile))
        return forms.surface(law, sides, eps, layer.order)


class BondedModel(Model):
    """The model without a layer: bodies perfectly bonded on S; on a rigid base S does not move."""

    name = "bonded"

    @property
    def _clamped(self) -> tuple[str, ...]:
        return self.joint.base_seams

    def __init__(self, structure: Setup) -> None:
        super().__init__(structure, None)

    def _checked(self) -> Joint:
        return self.joint

    def _layer_terms(self) -> list[forms.Term]:
        return []
