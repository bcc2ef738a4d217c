"""BondedModel: bodies without a layer between them."""

from __future__ import annotations

from forms import work as forms
from geometry.joint import Joint
from thinlayer.discretisation.forces import Weighted
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.setup import Setup


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

    def _places_of(self, one: SeamLayer) -> list[Weighted]:
        return []
