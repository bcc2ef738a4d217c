"""Bodies of an interface model that stand apart, at their true places beside a layer, and S midway between them."""

from __future__ import annotations

from collections.abc import Mapping

import ufl

from forms.interface import Interface
from forms.kinematics import Expr
from geometry.domain import Domain
from geometry.inflating.parting import parted, to_middle
from geometry.joint import Joint
from thinlayer.discretisation.given import Coordinates
from thinlayer.discretisation.joint_fields import cellwise
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError


def apart(joint: Joint, layers: Mapping[str, SeamLayer]) -> Joint:
    """The joint whose bodies have made room for layers, which have no cells.

    Args:
        joint: the joint.
        layers: name of a seam -> its layer.

    Raises:
        ModelError: seams that meet, or one without a thickness. GeometryError: as of `geometry.inflate`.
    """
    if joint.seams_meet:
        raise ModelError(
            "bodies='extended' of an interface model needs seams that do not meet or branch: S has no middle there"
        )
    thin = {name: one.thin for name, one in layers.items() if one.thin}
    for name in joint.seams:
        if name not in thin:
            raise ModelError(
                f"bodies='extended' of an interface model: {name!r} has no ThinLayer, so that no thickness tells where "
                "bodies are; use bodies='kept'"
            )
    eps, profiles = ({name: getattr(one, of) for name, one in thin.items()} for of in ("eps", "profile"))
    return parted(joint, eps, profile=profiles)


class Middle:
    """S midway between bodies that stand apart.

    Args:
        domain: the mesh.

    Attributes:
        to_s: (d,) how far S is from the places of its facets, on either side.
    """

    def __init__(self, domain: Domain) -> None:
        joint = domain.joint
        self.to_s = cellwise(domain, ("DG", joint.degree, (joint.dim,)), to_middle(joint))

    def coordinates(self, at: Coordinates) -> Coordinates:
        """Coordinates of the places of S, for functions that are then restricted to a side."""
        return at.moved(at.x + self.to_s)

    def thickness(self, sides: Interface) -> Expr:
        """Distance of the bodies along n; S is half of it away from either."""
        return -2 * ufl.dot(sides.upper(self.to_s), sides.n)

    def slope(self, sides: Interface) -> Expr:
        """(d,) gradient of the thickness along S."""
        slope = -2 * ufl.dot(sides.n, sides.upper.gradient(self.to_s))
        return slope - ufl.dot(slope, sides.fibre) * sides.n
