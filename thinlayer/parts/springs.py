"""Springs per area on a boundary, as a part of the balance of forces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from forms.base import is_number
from forms.kinematics import Expr
from thinlayer.discretisation.addition import Addition, Host
from thinlayer.discretisation.axis import refuse_axis
from thinlayer.discretisation.loads import refuse_seam
from thinlayer.discretisation.reactions import Array, count, rigid_expression, work_in_motions
from thinlayer.discretisation.supports import Place
from thinlayer.errors import ModelError
from thinlayer.parts.forms import FormPart, matrix


@dataclass(frozen=True)
class Springs(Addition):
    """Springs between a facet set of the outer boundary and a base that does not move: t = -k_N u_N - k_T u_T.

    A structure on springs needs no supports. The side of a meshed layer has another name, "NAME/LAYER", and gets springs
    only under that name.

    Attributes:
        place: name of a facet set on the outer boundary.
        normal, tangential: stiffness k_N across and k_T along the boundary, stress per length; >= 0, not both 0.
        key: name of their energy, "springs NAME".

    Raises:
        ModelError: a stiffness out of range. When a model is made: an unknown or empty facet set, or inner facets.
    """

    place: str
    normal: float = 0.0
    tangential: float = 0.0
    key: str = field(init=False)

    def __post_init__(self) -> None:
        for name in ("normal", "tangential"):
            value = getattr(self, name)
            if not is_number(value) or not (math.isfinite(value) and value >= 0):
                raise ModelError(f"springs on {self.place!r}: {name} is {value!r}; allowed: a finite number >= 0")
        if self.normal == self.tangential == 0:
            raise ModelError(f"springs on {self.place!r} have no stiffness; give normal=... or tangential=...")
        object.__setattr__(self, "key", f"springs {self.place}")

    def check(self, model: Host) -> None:
        """Raise ModelError or GeometryError unless the facet set exists and lies on the outer boundary."""
        if not isinstance(self.place, str):
            raise ModelError(f"springs on {self.place!r}: a place is the name of a facet set")
        inside = (
            f"springs on {self.place!r}: its facets lie inside, or below a layer; springs act on the outer boundary"
        )
        refuse_seam(model.joint, self.place, inside)
        if not model.domain.values(self.place):
            raise ModelError(f"springs on {self.place!r}: this facet set is empty")
        if not model.domain.is_outer(self.place):
            raise ModelError(inside)
        refuse_axis(model.kinematics, model.joint, self.place, "springs")

    def work(self, model: Host, u: Expr, v: Expr) -> Any:
        """Virtual work of the springs, a UFL form."""
        n = ufl.FacetNormal(model.V.mesh)
        across = (self.normal - self.tangential) * ufl.dot(u, n) * ufl.dot(v, n)
        work = across + self.tangential * ufl.inner(u, v)
        return work * model.kinematics.factor * model.ds(model.domain.values(self.place))

    def reaction(self, model: Host, u: fem.Function) -> list[tuple[Place, Array]]:
        """As in `Addition`: the force and moment of the springs."""
        motion = fem.Constant(model.domain.mesh, np.zeros(count(model.joint.dim)))
        v = rigid_expression(model.domain.mesh, motion, model.centre)
        return [(self.place, -work_in_motions(model.comm, self.work(model, u, v), motion))]

    def part(self, model: Host) -> FormPart:
        """The springs as a part of a model's balance. Collective."""
        u, v = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
        return FormPart(self.key, fem.Function(model.V), matrix(self.work(model, u, v)), kept=True)
