"""Ends of a layer: what holds its side there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from geometry.errors import place as place_of
from geometry.joint import Joint
from geometry.seam import LAYER, S
from geometry.sheet import Rim, Sheet, continued
from geometry.topology import FloatArray, ridge_keys
from thinlayer.discretisation.addition import Addition
from thinlayer.discretisation.axis import on_axis
from thinlayer.discretisation.given import vanishes
from thinlayer.discretisation.layer import real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError

ROUNDING = 1e-6  # of squares of cosines between directions
SLIGHT = 1e-3  # share of a direction, cos^2, that counts as none: 2 degrees
BENT = 0.03  # the same where S is curved: straight facets are 10 degrees off it


def side_kinds(model: Model, sheet: Sheet) -> npt.NDArray[np.str_]:
    """(n,) what the layer's side is at each ridge of the rim of a seam.

    Its displacements have a component m, outward along S, and one n, across S. Supports, plates and an axis of revolution
    hold both ("held"), m alone ("symmetric": as in a plane of symmetry), n alone ("antisymmetric"), neither ("free"), or
    a direction between them ("oblique"). What is held along the end does not matter.
    """
    rim, held = sheet.rim, _held(model, sheet)
    normals = model.joint.interface_normals[sheet.parts[0][rim.simplex]]
    shares = np.stack([np.einsum("ni,nij,nj->n", way, held, way) for way in (rim.outward, normals)], axis=1)
    slight = SLIGHT if sheet.planar else BENT
    along, across = (shares > slight).T
    found = np.array([["free", "antisymmetric"], ["symmetric", "held"]])[along.astype(int), across.astype(int)]
    clear = ((shares <= slight) | (shares >= 1 - slight)).all(axis=1)
    return np.where(clear, found, "oblique")


def _held(model: Model, sheet: Sheet, of_layer: bool = True) -> FloatArray:
    """(n, d, d) projections onto what holds the layer's side at the rim; `of_layer`: places NAME/LAYER as well."""
    rim, joint, supports = sheet.rim, model.joint, model.supports
    d, keys = joint.dim, ridge_keys(rim.vertices)
    held = np.zeros((len(keys), d, d))
    held[on_axis(model.kinematics, joint)[rim.vertices].all(axis=1)] = np.eye(d)
    entries = [(place, tuple(components)) for place, components in supports.entries]
    for part in model.structure.parts:
        if isinstance(part, Addition) and part.ties_nodes:
            entries.append((part.place, tuple(part.components or supports.axes)))
    for place, components in entries:
        name = place.removesuffix(f"/{LAYER}") if isinstance(place, str) else S
        if name in (S, *joint.seams) or name not in joint.facets:  # a vertex, or the side of one body
            continue
        if name != place and not of_layer:
            continue
        on = np.isin(keys, continued(joint, joint.facets[name]))
        for axis in components:
            way = np.eye(d)[supports.axes.index(axis)] if axis in supports.axes else _normals(joint, rim, name)
            held += np.where(on[:, None], way, 0.0)[:, :, None] * way[..., None, :]
    return np.asarray(held @ np.linalg.pinv(held, rcond=ROUNDING, hermitian=True))  # onto all directions that are held


def _normals(joint: Joint, rim: Rim, name: str) -> FloatArray:
    """(n, d) mean unit normal of the facets of a name at each ridge: that of a layer's side if S ends at right angles."""
    rows, out = joint.facets[name], rim.outward.copy()
    edges = np.diff(joint.points[rows[:, : joint.dim]], axis=1)
    normals = edges[:, 0, ::-1] * [1.0, -1.0] if joint.dim == 2 else np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for k, ridge in enumerate(rim.vertices):
        at = normals[np.isin(rows, ridge).sum(axis=1) == joint.dim - 1]
        mean = (at * np.sign(at @ rim.outward[k])[:, None]).sum(axis=0)
        if length := np.linalg.norm(mean):
            out[k] = mean / length
    return out


def rim_of_kinds(model: Model, sheet: Sheet, *kinds: str) -> Rim:
    """The part of the rim of a seam where the layer's side is of some kinds (`side_kinds`)."""
    return sheet.rim[np.isin(side_kinds(model, sheet), kinds)]


def free_rim(model: Model, sheet: Sheet) -> Rim:
    """Where an end of the layer has a field of its own: nothing holds its side along m or n, or something oblique does.

    Where S meets an axis of revolution it does not end.
    """
    return rim_of_kinds(model, sheet, "free", "oblique")


def loose_rim(model: Model, sheet: Sheet) -> Rim:
    """Where the layer's side is not held along m: loads on it reach the layer, and a pressure falls to zero."""
    return rim_of_kinds(model, sheet, "free", "antisymmetric", "oblique")


def why_oblique(model: Model, sheet: Sheet) -> str | None:
    """Why fields and constants of free ends are not those of this seam, where its side is held obliquely; None: nowhere."""
    oblique = rim_of_kinds(model, sheet, "oblique").vertices
    if not len(oblique):
        return None
    at = place_of(model.joint.points[oblique[0, 0]])
    return f"something holds the layer's side at {at} in a direction neither along S nor across it"


def why_alone(model: Model, one: SeamLayer, meshed: npt.NDArray[np.bool_] | None = None) -> str | None:
    """Where supports hold the layer's own side, NAME/LAYER, and not the bodies beside it, in words; None: nowhere.

    `meshed` (n_S,) are facets of S with cells, which do know of it.
    """
    apart = np.abs(_held(model, one.sheet) - _held(model, one.sheet, of_layer=False)).max(axis=(1, 2)) > SLIGHT
    if meshed is not None:
        apart &= ~meshed[one.sheet.parts[0][one.sheet.rim.simplex]]
    if not apart.any():
        return None
    at = place_of(model.joint.points[one.sheet.rim.vertices[apart][0, 0]])
    return f"a support holds the side of {one} alone, at {at}, of which no law on S knows"


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
    rim = loose_rim(model, one.sheet)
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
        if name.endswith(f"/{LAYER}") and not vanishes(load):
            raise ModelError(
                f"the traction on {name!r} acts on the side of the layer, and the pressure of {one} of order 1 is zero at "
                "free ends; the load would change it by as much as the load itself: mesh the layer (structure.full)"
            )
