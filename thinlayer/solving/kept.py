"""What solves of one family of models keep: the parts of the bodies, and the tangent with its factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from forms.work import Term
from thinlayer.discretisation.model import Model
from thinlayer.parts.part import Part
from thinlayer.solving.factor import Factor
from thinlayer.solving.tangent_matrix import TangentMatrix

NAME = "equations"  # under which a family keeps this


class Kept:
    """Matrices of the equations of a model, which may serve other models of its family.

    Attributes:
        bodies: parts that depend on mesh and bodies alone; empty: they are yet to be made.
        matrix: the tangent; None: it is yet to be made.
        factor: of the tangent.
    """

    def __init__(self) -> None:
        self.bodies: Sequence[Part] = ()
        self.matrix: TangentMatrix | None = None
        self.factor = Factor()
        self._terms: Sequence[Term] = ()
        self._pattern: Any = None

    @classmethod
    def of(cls, model: Model) -> Kept:
        """What the model's family has, made fit for this model; new if it has nothing."""
        found = model.family.take(NAME)
        kept = found if isinstance(found, cls) else cls()
        pattern = (
            [(p.key, type(p.law), p.law.traits, len(p.law.sublayers)) for p in model.layer_terms],
            [(name, type(one.law), one.thin and one.thin.order) for name, one in model.layers.items()],
        )
        if pattern != kept._pattern:
            kept._free_matrix()
        if model.layer_terms is not kept._terms:
            kept.factor.of = None
        kept._terms, kept._pattern = model.layer_terms, pattern
        return kept

    def give_back(self, model: Model) -> None:
        """Leave all to the family if it has other models, else free it."""
        if model.family.several:
            model.family.keep(NAME, self)
        else:
            self.destroy()

    def _free_matrix(self) -> None:
        self.factor.destroy()
        if self.matrix is not None:
            self.matrix.destroy()
        self.matrix = None

    def destroy(self) -> None:
        """Free all matrices."""
        self._free_matrix()
        for part in self.bodies:
            part.destroy()
        self.bodies = ()
