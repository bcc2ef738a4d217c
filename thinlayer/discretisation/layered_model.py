"""LayeredModel: a model with layers, meshed or on S; base of both kinds."""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Self

from thinlayer.discretisation.given import Load
from thinlayer.discretisation.layer import Layers, gaps_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import loads_of_layers
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all


class LayeredModel(Model):
    """A model with layers.

    Attributes:
        layer: as given: a layer for all seams, or {name of a seam: its layer}.
    """

    layer: Layers

    def with_layer(self, layer: Layers) -> Self:
        """The same model with other layers; it shares mesh, space, supports, loads and the bodies' matrix. Collective.

        Args:
            layer: as in `Structure.full` or `Structure.interface`; of a full model layers and gaps of the same thickness,
                profile and fractions, which are those of the mesh.

        Raises:
            ModelError, LawError: as there; another shape of a meshed layer.
        """
        new = self._derived()
        new.layer = layer
        new._lay(layer, partial(new._check_beside, self))
        with on_all(self.comm):
            new.given_on = {name: new._given_on(one) for name, one in new.layers.items()}
        new.layer_terms = new._strained(new._terms_of_layers())
        with on_all(self.comm):
            new.forces = new._forces(new.structure)
            if new.strain or new.stress:
                new.require("mean strain")
            if new.stress and not new.broken:
                raise ModelError(
                    "with_layer: under a mean stress a meshed layer is a part of the cell; build the model anew"
                )
        if new.constraints.ties:  # the thickness is an arm of plates
            new.constraints = new._constrained()
        new.made_from = new._data()
        return new

    def _loads_of_layers(self, structure: Setup) -> dict[str, Load]:
        return loads_of_layers(structure.body_force, self.joint, self.layers)

    def _require_shapes(self, other: Self) -> None:
        """Raise ModelError unless layers and gaps need the room that bodies have made for those of another model."""
        count = 2 if self.broken else 3  # sublayers have cells in meshed layers alone
        needed, made = (
            {name: ("a gap", gap.eps) for name, gap in gaps_of(model.layer).items()}
            | {name: one.shape[:count] for name, one in model.layers.items()}
            for model in (self, other)
        )
        for name in (name for name in needed if needed[name] != made.get(name)):
            raise ModelError(
                f"bodies have made room for a layer {name!r} of (thickness, profile, fractions) {made.get(name)}, not "
                f"{needed[name]}; make a model of its own"
            )

    @abstractmethod
    def _check_beside(self, other: Self) -> None:
        """Raise an error unless the layers suit the mesh of another model."""
