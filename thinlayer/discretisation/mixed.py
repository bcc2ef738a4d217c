"""Mixed models: the layer meshed on a part of S, replaced by its interface law on the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import ufl
from scipy.spatial import cKDTree

from forms import work as forms
from geometry.errors import place
from geometry.seam import LAYER, S
from thinlayer.discretisation.followers import Followers
from thinlayer.discretisation.free_rim import free_rim
from thinlayer.discretisation.kinds import FullModel, InterfaceModel
from thinlayer.discretisation.layer import Layers, ThinLayer
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import seam_entities
from thinlayer.discretisation.setup import Setup
from thinlayer.errors import ModelError
from thinlayer.identity.described import described
from thinlayer.parallel.agreement import on_all

BoolArray = npt.NDArray[np.bool_]
Where = BoolArray | Callable[[npt.NDArray[np.float64]], Any]
REACH = 3.0  # largest width, over the thickness, of the strips on which the law has the constants of a free end


class MixedModel(FullModel):
    """The model whose layer is meshed on a part of S, and replaced by its interface law on the rest.

    The bodies stand where those of the full model do. Where there are no cells the law acts between the sides of a gap:
    its nodal forces are those of an interface model with the same bodies. Where cells end their nodes between both faces
    move as the law has it, linearly from face to face.

    Attributes:
        by_law: the interface model of the same layer.
    """

    name = "mixed"

    def __init__(self, structure: Setup, layer: Layers, where: Where, *, bodies: str, cells_through: int) -> None:
        with on_all(structure.comm):
            self.meshed = _facets(structure, where)
            _require(structure, layer, self.meshed)
        self.layer, self._bodies, self._cells_through, self._junctions = layer, bodies, cells_through, None
        self.by_law = InterfaceModel(structure, _between_cells(structure, layer, self.meshed), bodies=bodies)
        with on_all(structure.comm):
            _require_reach(self.by_law, self.meshed)
        options = {"bodies": bodies, "cells_through": cells_through, "meshed": described(self.meshed)}
        super(FullModel, self).__init__(structure, layer, **options)
        self.followers = Followers.at_cuts(self.domain, self.V, structure.sheet.mean_normal)

    def _data(self) -> dict[str, Any]:
        return super()._data() | {"meshed": described(self.meshed)}

    def with_layer(self, layer: Layers) -> Self:
        """As in other models; its interface model is made anew. Collective."""
        with on_all(self.comm):
            assert self.meshed is not None
            _require(self.structure, layer, self.meshed)
        new = super().with_layer(layer)
        new.by_law = self.by_law.with_layer(_between_cells(self.structure, layer, self.meshed))
        return new

    def law_elsewhere(self) -> tuple[Model, list[forms.Term]] | None:
        """The terms of the interface law on the facets without cells, and the interface model. Collective."""
        model = self.by_law
        assert self.meshed is not None
        if self.meshed.all():
            return None
        (name,) = model.joint.seams
        entities, joint = seam_entities(model.domain, name), model.joint
        lower, upper = joint.surface_cells[~self.meshed].T
        count = len(joint.cells)
        own = model.domain.original_cells[entities[:, 0]] * count + model.domain.original_cells[entities[:, 2]]
        chosen = np.ascontiguousarray(entities[np.isin(own, upper * count + lower)], np.int32)
        measure = ufl.Measure("dS", domain=model.domain.mesh, subdomain_data=[(1, chosen.ravel())])
        return model, [replace(p, measure=measure(1, metadata=p.measure.metadata())) for p in model.layer_terms]


def _facets(structure: Setup, where: Where) -> BoolArray:
    """(n_S,) the facets that get cells.

    Raises:
        ModelError: `where` gives no truth values, or chooses none of the facets.
    """
    joint = structure.joint
    centres = joint.points[joint.table.vertices[joint.surface_rows]].mean(axis=1)
    n = len(centres)
    try:
        found = np.asarray(where(centres.T) if callable(where) else where)
    except Exception as error:
        raise ModelError(f"where is no numpy function of places x (d, n): {error}") from error
    if found.dtype != bool or found.shape != (n,):
        raise ModelError(
            f"where gives shape {found.shape} and type {found.dtype}; it must say for each of the {n} facets of S whether "
            "the layer is meshed there, as lambda x: abs(x[0] - 20) > 16 does, or an array of truth values"
        )
    if not found.any():
        raise ModelError("where holds on no facet of S: no part of the layer is meshed; use structure.interface")
    return found


def _require(structure: Setup, layer: Layers, meshed: BoolArray) -> None:
    """Raise ModelError for what a mixed model cannot have, with the reason."""
    joint = structure.joint
    if len(joint.seams) > 1 or joint.seams_meet:
        raise ModelError("a mixed model needs one seam that does not branch; mesh whole seams of networks instead")
    if joint.base_seams:
        raise ModelError("a mixed model needs bodies on both sides of S, not a rigid base")
    if joint.periods or structure.strain is not None or structure.stress is not None:
        raise ModelError("a mixed model is not for periodic cells")
    if not structure.sheet.planar:
        raise ModelError("a mixed model needs a planar S: elsewhere nodes at a cut are not above one another")
    if structure.element[0] == "S":
        raise ModelError("a mixed model needs nodal displacements, not elements S2")
    if not isinstance(layer, ThinLayer):
        raise ModelError("a mixed model needs one ThinLayer: its law is meshed on a part of S")
    traits, kind = layer.law.traits, type(layer.law).__name__
    if traits.constrained or traits.phases or layer.law.fields:
        what = "a pressure" if traits.constrained else "phases" if traits.phases else "parameters that are functions"
        raise ModelError(
            f"a mixed model is not for {kind}, which has {what}: these are not carried between cells and S"
        )
    if layer.profile is not None or layer.eigenstrain is not None:
        raise ModelError("a mixed model needs a layer of uniform thickness without eigenstrain")
    rim = structure.sheet.rim
    by_law = rim[~meshed[structure.sheet.parts[0][rim.simplex]]]
    for name in structure.tractions or {}:
        outer = joint.facets.get(name.removesuffix(f"/{LAYER}")) if name.endswith(f"/{LAYER}") else None
        if outer is not None and by_law.on(outer).any():
            raise ModelError(
                f"the traction on {name!r} acts on the side of the layer; mesh all of the layer there, as its law does not "
                "know the load"
            )
    if isinstance(structure.body_force, Mapping) and {S, *joint.seams} & set(structure.body_force):
        raise ModelError("a mixed model has no weight of the layer itself; give the bodies theirs")


def _between_cells(structure: Setup, layer: Layers, meshed: BoolArray) -> Layers:
    """The layer of the interface model: if cells are at all ends of S, its law knows of no free ends."""
    assert isinstance(layer, ThinLayer)
    sheet = structure.sheet
    ends = sheet.rim.simplex
    return replace(layer, edges="plain") if meshed[sheet.parts[0][ends]].all() else layer


def _require_reach(model: InterfaceModel, meshed: BoolArray) -> None:
    """Raise ModelError where a law with constants of free ends acts within their reach of an end that is meshed."""
    (one,) = model.layers.values()
    assert one.thin
    if not one.thin.order or model.free_ends(one.name) is not None:
        return
    joint, sheet = model.joint, one.sheet
    rim = free_rim(model, sheet)
    at_cells = rim[meshed[sheet.parts[0][rim.simplex]]]
    by_law = np.unique(joint.table.vertices[joint.surface_rows[~meshed]])
    if not len(at_cells.vertices):
        return
    x = joint.points[at_cells.vertices].mean(axis=1)
    near, at = cKDTree(x).query(joint.points[by_law])
    if near.min() < REACH * one.thin.eps:
        raise ModelError(
            f"the layer is meshed at its free end at {place(x[at[near.argmin()]])} over {near.min():.3g} only; the law "
            f"beside it, which has the constants of other free ends, needs {REACH:g} thicknesses there"
        )
