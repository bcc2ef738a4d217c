"""LayerModel: the layers of an interface model by themselves, meshed, without bodies."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

from mpi4py import MPI

from geometry.inflating.inflation import without_bodies
from geometry.joint import Joint
from geometry.seam import LAYER, S
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer


class LayerModel(FullModel):
    """The layers of an interface model by themselves: their cells in a full model, what acts on them and holds them there.

    Each rank has all of it. Nothing holds the layers' faces, so that nothing can be solved with it alone.
    """

    name = "layer"

    def __init__(self, model: InterfaceModel, layers: Mapping[str, ThinLayer], cells_through: int) -> None:
        given, joint = copy.copy(model.structure), model.joint
        vars(given).pop("sheet", None)
        given.joint = replace(joint, seams={name: seam for name, seam in joint.seams.items() if name in layers})
        given.comm, given.parts, given.loads, given.body_laws, given.eigenstrains = MPI.COMM_SELF, (), (), {}, {}
        given.tractions = {name: load for name, load in (given.tractions or {}).items() if name.endswith(f"/{LAYER}")}
        force = given.body_force
        given.body_force = {k: v for k, v in force.items() if k in (*layers, S)} if isinstance(force, Mapping) else None
        super().__init__(given, layers, bodies=model._bodies, cells_through=cells_through, junctions=None)

    def _checked(self) -> Joint:
        layers = without_bodies(super()._checked())
        here = {place: held for place, held in self.structure.supports.items() if place in layers.facets}
        self.structure.supports = here
        return layers

    def require_supported(self) -> None:
        """Nothing: the bodies would hold the layers."""
