"""FullModel: its layers are meshed."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

from forms import work as forms
from forms.base import InputError
from forms.trace import needs_director
from geometry.inflating.inflation import inflate
from geometry.inflating.layering import check_layering
from geometry.joint import Joint
from geometry.refusals import unknown
from geometry.seam import BASE
from thinlayer.discretisation.boundary import require_revolution, require_shifts
from thinlayer.discretisation.forces import Weighted
from thinlayer.discretisation.layer import Layers, SeamLayer, constants, real_law
from thinlayer.discretisation.mesh_functions import director
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.setup import Setup

LARGEST_EPS = 1e6  # largest thickness over the bodies' size: beyond it coordinates have fewer than ten digits left


class FullModel(Model):
    """The model whose layers are meshed.

    Attributes:
        inflated: the joint with the layers' cells.
    """

    name = "full"
    inflated: Joint

    def __init__(self, structure: Setup, layer: Layers, bodies: str, cells_through: int, junctions: str | None) -> None:
        self._bodies, self._cells_through, self._junctions = bodies, cells_through, junctions
        chosen = {} if junctions is None else {"junctions": junctions}
        super().__init__(structure, layer, bodies=bodies, cells_through=cells_through, **chosen)

    @property
    def _clamped(self) -> tuple[str, ...]:
        return (BASE,) if BASE in self.domain.joint.facets else ()

    def _checked(self) -> Joint:
        check_layering(self._cells_through, self._bodies)
        if self._bodies == "kept":
            require_shifts(self.structure.kinematics, self.joint)
        self._check_layers()
        gaps = self.gaps
        if self._junctions is not None and self._junctions not in [*self.joint.seams]:
            raise InputError(f"junctions: {unknown('seam', self._junctions, self.joint.seams)}")
        if self._junctions in gaps:
            raise InputError(f"junctions: the seam {self._junctions!r} is a gap and has no law")
        first = () if self._junctions is None else (self._junctions,)
        thin = {name: one.thin for name, one in self.layers.items() if one.thin}
        eps = {name: layer.eps for given in (thin, gaps) for name, layer in given.items()}
        if (thickest := max(eps.values(), default=0.0)) > LARGEST_EPS * self.joint.size:
            raise InputError(
                f"the layer's thickness eps is {thickest:g}, the bodies measure {self.joint.size:g}: next to such a "
                "layer their shape is lost in rounding; is eps in the unit of the mesh?"
            )
        inflated = inflate(
            self.joint,
            eps,
            profile={name: layer.profile for name, layer in thin.items()},
            cells_through=self._cells_through,
            fractions={name: layer.fractions for name, layer in thin.items()},
            bodies=self._bodies,
            junctions=(*first, *thin),
            gaps=tuple(gaps),
        )
        self._check_junctions(inflated)
        require_revolution(self.structure.kinematics, inflated)
        self.inflated = inflated
        return inflated

    def _check_layers(self) -> None:
        """Check each layer by itself."""
        if self.bonds:
            raise InputError(f"the seam {self.bonds[0]!r} has a Bond, for interface models: make a joint without it")
        for name, given in self.on_seams.items():
            if given is None:
                remedy = "give it a Gap(eps), or use structure.interface"
                raise InputError(f"the seam {name!r} is open, and its width is not known: {remedy}")
        self.require("mesh")

    def _check_beside(self, other: Self) -> None:
        self._check_layers()
        self._require_shapes(other)
        self._check_junctions(self.domain.joint)

    def _check_junctions(self, inflated: Joint) -> None:
        """Raise InputError if a law cannot be that of cells where layers meet, which are in no column of a layer."""
        assert inflated.band is not None
        for region, name in inflated.band.junctions.items():
            law = self.reductions[name].law
            if law.traits.switches:
                why = "has one phase for each column of a layer, and cells where layers meet are in none"
            elif region not in inflated.band.aligned and needs_director(law):
                why = "depends on the normal of S, which is not defined where layers meet"
            else:
                continue
            law_of = f"{type(law).__name__} of the seam {name!r}"
            raise InputError(f"{law_of} {why}; give junctions=... the name of a seam with another law")

    def _layer_terms(self) -> list[forms.Term]:
        mesh, band, n = self.domain.mesh, self.domain.joint.band, director(self.domain)
        assert band is not None
        terms = []
        for name, one in self.layers.items():
            shared = [region for region, seam in band.junctions.items() if seam == name]
            sublayers = real_law(one.layer, self.kinematics).sublayers
            for (_, law), region in zip(sublayers, band.of_seam[name], strict=True):
                law = law if law.traits.compiled else constants(law, mesh)
                cells = self.dx(self.domain.cell_values(region, *shared), **self._rule(self.dx))
                term = forms.band(law, cells, n, self.kinematics)
                terms.append(replace(term, key=one.key, given=self.given_on[name]))
        return terms

    def _places_of(self, one: SeamLayer) -> list[Weighted]:
        band = self.domain.joint.band
        assert band is not None
        shared = [region for region, seam in band.junctions.items() if seam == one.name]
        cells = self.dx(self.domain.cell_values(*band.of_seam[one.name], *shared))
        return [Weighted(cells, self.kinematics.factor)]
