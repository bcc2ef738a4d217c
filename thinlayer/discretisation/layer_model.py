"""LayerModel: the layers of an interface model by themselves, meshed, without bodies."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from geometry.inflating.dividing import Divided, divided
from geometry.inflating.inflation import without_bodies
from geometry.joint import Joint
from geometry.seam import LAYER, S
from thinlayer.discretisation.full_model import FullModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer


class LayerModel(FullModel):
    """The layers of an interface model by themselves: their cells in a full model, what acts on them and holds them there.

    Each rank has all of it. Nothing holds the layers' faces, so that nothing can be solved with it alone.

    Attributes:
        divided: their cells, divided towards free ends and junctions; None: they are those of `inflated`.

    Args:
        model: the interface model.
        layers: name of a seam -> its layer.
        cells_through: number of cells through the thickness.
        at_ends: how far cells at ends reach at most, a length; None: as far as the facets of S there.
    """

    name = "layer"
    divided: Divided | None = None

    def __init__(
        self, model: InterfaceModel, layers: Mapping[str, ThinLayer], cells_through: int, at_ends: float | None = None
    ) -> None:
        given, joint = copy.copy(model.structure), model.joint
        vars(given).pop("sheet", None)
        seams = {name: seam for name, seam in joint.seams.items() if name in layers}
        # fields on S of divided cells are not those of the model's facets: with other points they are refused
        points = joint.points if at_ends is None else joint.points.copy()
        given.joint = replace(joint, points=points, seams=seams)
        given.comm, given.parts, given.loads, given.body_laws, given.eigenstrains = MPI.COMM_SELF, (), (), {}, {}
        given.tractions = {name: load for name, load in (given.tractions or {}).items() if name.endswith(f"/{LAYER}")}
        force = given.body_force
        given.body_force = {k: v for k, v in force.items() if k in (*layers, S)} if isinstance(force, Mapping) else None
        free = [model.reductions[name].free.vertices.ravel() for name in layers]
        self._ends, self._at_ends = joint.points[np.unique(np.concatenate([*free, joint.meetings]))], at_ends
        super().__init__(given, layers, bodies=model._bodies, cells_through=cells_through, junctions=None)

    def _checked(self) -> Joint:
        layers = without_bodies(super()._checked())
        if self._at_ends is not None and len(self._ends):
            distance, _ = cKDTree(self._ends).query(layers.reference)
            self.divided = divided(layers, distance, self._at_ends)
            layers = self.divided.joint
        here = {place: held for place, held in self.structure.supports.items() if place in layers.facets}
        self.structure.supports = here
        return layers

    def require_supported(self) -> None:
        """Nothing: the bodies would hold the layers."""
