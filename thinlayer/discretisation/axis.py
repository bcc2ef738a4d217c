"""The axis of revolution: what a joint must be to have one, and what is held there; other places that are no boundary."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from forms.planes import Kinematics
from geometry.domain import Domain
from geometry.errors import place
from geometry.joint import Joint
from geometry.seam import LAYER, S
from thinlayer.errors import ModelError

AXES = "xyz"  # names of components and of motions
ON_AXIS = 1e-10  # distance from the axis, over the size of the joint, that is rounding
ACROSS = 1e-9  # largest component of a normal along which bodies cannot move


def on_axis(kinematics: Kinematics, joint: Joint) -> npt.NDArray[np.bool_]:
    """(n,) which points of a joint lie on the axis."""
    return np.asarray(np.abs(kinematics.radius(joint.points)) <= ON_AXIS * np.ptp(joint.points, axis=0).max())


def require_revolution(kinematics: Kinematics, joint: Joint) -> None:
    """Raise ModelError unless a joint may be turned about the axis: r >= 0, no seam on the axis, no period across it."""
    r, on = kinematics.radius(joint.points), on_axis(kinematics, joint)
    behind = np.flatnonzero((r < 0) & ~on)
    if len(behind):
        raise ModelError(
            f"plane={kinematics.name!r}: x is the distance from the axis of revolution, and {len(behind)} points have "
            f"x < 0, the first at {place(joint.points[behind[0]])}; allowed: x >= 0"
        )
    for name in joint.seams if joint.band is None else ():
        facets = joint.table.vertices[joint.rows_of(name)]
        if on[facets].all(axis=1).any():
            raise ModelError(f"plane={kinematics.name!r}: the seam {name!r} lies on the axis, where it has no area")
    if joint.periods:
        held = np.delete(joint.periods.vectors(joint.points), kinematics.translations(joint.dim), axis=1)
        if np.abs(held).max(initial=0.0) > ON_AXIS * np.ptp(joint.points, axis=0).max():
            raise ModelError(f"plane={kinematics.name!r}: a structure repeats along the axis (y) alone")


def is_across(kinematics: Kinematics, normals: npt.NDArray[np.float64]) -> bool:
    """Whether S, with these normals (n, d), lies across the axis: translations along them are rigid motions."""
    held = np.delete(normals, kinematics.translations(normals.shape[1]), axis=1)
    return bool(np.abs(held).max(initial=0.0) <= ACROSS)


def require_shifts(kinematics: Kinematics, joint: Joint) -> None:
    """Raise ModelError unless bodies can be moved apart along the normals of S without a strain (bodies="kept")."""
    if not is_across(kinematics, joint.interface_normals.reshape(-1, joint.dim)):
        raise ModelError(
            f"plane={kinematics.name!r}: bodies='kept' moves the bodies apart along the normal of S, and a body of "
            "revolution cannot move away from its axis; use bodies='extended', or an S across the axis (normal along y)"
        )


def boundary(
    domain: Domain, kinematics: Kinematics, name: object, what: str, *, inside: bool = False, side: bool = False
) -> tuple[int, ...]:
    """Facet values of a place of the outer boundary, given by its name.

    Args:
        domain: the mesh.
        kinematics: of the mesh.
        name: as a user gives it.
        what: first words of errors.
        inside: whether the place may lie inside the bodies, or on the axis, but not on S.
        side: whether it may be the side of a layer that is not meshed, without facets.

    Raises:
        ModelError, GeometryError: another place, no place, or an empty one.
    """
    joint = domain.joint
    base = joint.band.base if joint.band else joint
    if not isinstance(name, str):
        known = ", ".join(sorted(base.facets.keys() - {S}))
        raise ModelError(f"{what}: a place is the name of a facet set; known: {known}")
    whole = name.split("/")[0]
    refuse_periodic(joint, name, what)
    if name in base.seams or whole == S or not (inside or domain.is_outer(name)):
        raise ModelError(f"{what}: its facets lie inside, or below a layer; take a facet set on the outer boundary")
    facets = joint.facets.get(name, joint.facets.get(whole))
    if not inside and facets is not None and len(facets) and on_axis(kinematics, joint)[facets].all():
        raise ModelError(f"{what}: these facets are the axis of revolution, which is no boundary")
    if not domain.values(name) and not (side and name.endswith(f"/{LAYER}")):
        why = ", as the layer is a surface here: mesh it (structure.full)" * name.endswith(f"/{LAYER}")
        raise ModelError(f"{what}: this facet set is empty{why}")
    return domain.values(name)


def refuse_periodic(joint: Joint, name: str, what: str) -> None:
    """Raise ModelError if a name is that of a periodic side: inside the periodic structure there is no boundary."""
    if joint.periods and name.split("/")[0] in joint.periods.names:
        raise ModelError(
            f"{what}: this side is identified with another one, the structure goes on there; a periodic cell is loaded by "
            "a mean strain, Structure(..., strain=...)"
        )
