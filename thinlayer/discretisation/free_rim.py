"""Free ends of a layer: where its side is held by no support."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geometry.seam import LAYER, S
from geometry.sheet import Rim, Sheet
from geometry.topology import FloatArray
from thinlayer.discretisation.axis import on_axis
from thinlayer.discretisation.layer import real_law
from thinlayer.discretisation.loads import Pressure
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError


def free_rim(model: Model, sheet: Sheet) -> Rim:
    """The part of the rim of a seam where the layer's side is free: no support of the whole side holds it along S.

    Where S meets an axis of revolution it does not end.
    """
    rim, supports = sheet.rim, model.supports
    held = np.zeros(rim.outward.shape)
    held[on_axis(model.kinematics, sheet.joint)[rim.vertices].all(axis=1)] = 1.0
    for place, components in supports.entries:
        name = place.removesuffix(f"/{LAYER}") if isinstance(place, str) else S
        if name in (S, *model.joint.seams) or name not in model.joint.facets:  # a vertex, or the side of one body
            continue
        axes = [supports.axes.index(axis) for axis in components if axis in supports.axes] or [
            *range(len(supports.axes))
        ]
        held[:, axes] = np.maximum(held[:, axes], rim.on(model.joint.facets[name])[:, None])
    return rim[(held * rim.outward**2).sum(axis=1) < 0.5]


def neglected_rim(model: Model, one: SeamLayer) -> Rim:
    """The free ends of which an interface law knows nothing: all, or none (`InterfaceModel.free_ends`)."""
    rim = free_rim(model, one.sheet)
    return rim[np.full(len(rim.vertices), model.free_ends(one.name) is not None)]


def fall_of_pressure(one: SeamLayer, rim: Rim) -> FloatArray:
    """Lengths (n,) over which the pressure of a layer of order 1 falls to zero at free ends.

    They are eps sqrt(lmbda/(12 mu)), infinite where the volume stays the same.
    """
    assert one.thin
    joint, law = one.structure.joint, real_law(one.layer, one.structure.kinematics)
    laws = law.at_places(joint.points[rim.vertices].mean(axis=1).T) if law.fields else [law] * len(rim.vertices)
    squares = np.array([12 * law.parameters()["mu"] * law.volume_compliance for law in laws])
    relative = joint.relative_thickness(one.thin.profile, one.name)[rim.vertices].mean(axis=1)
    with np.errstate(divide="ignore"):
        return np.asarray(one.thin.eps * relative / np.sqrt(squares))


def free_of_pressure(model: Model, one: SeamLayer) -> tuple[Rim, Rim, FloatArray]:
    """The free ends where the pressure of a layer of order 1 is zero, those where it is not, and its fall at the latter.

    Where cells are larger than its fall (`fall_of_pressure`) there is no flow across the end, as if it were held: a
    pressure of zero at the end would be too small over a whole cell.
    """
    rim = free_rim(model, one.sheet)
    fall = fall_of_pressure(one, rim)
    fine = rim.depth <= fall
    return rim[fine], rim[~fine], fall[~fine]


def require_unloaded_sides(one: SeamLayer, tractions: Mapping[str, Any] | None) -> None:
    """Raise ModelError if a traction acts on a layer's own side: its pressure of order 1 is zero at free ends.

    Args:
        one: a layer whose pressure flows along S.
        tractions: as in `Structure`.
    """
    for name, load in (tractions or {}).items():
        value = load.p if isinstance(load, Pressure) else load
        if name.endswith(f"/{LAYER}") and (callable(value) or np.any(np.asarray(value, float))):
            raise ModelError(
                f"the traction on {name!r} acts on the side of the layer, and the pressure of {one} of order 1 is zero at "
                "free ends; the load would change it by as much as the load itself: mesh the layer (structure.full)"
            )
