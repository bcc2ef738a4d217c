"""Springs per area on a boundary, as a part of the balance of forces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import is_number
from forms.kinematics import Expr
from geometry.joint import S
from thinlayer.discretisation.addition import Addition, Host
from thinlayer.errors import ModelError
from thinlayer.parts.part import Array, Block, Outcome, Part


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
        if not model.domain.values(self.place):
            raise ModelError(f"springs on {self.place!r}: this facet set is empty")
        if self.place.split("/")[0] == S or not model.domain.is_outer(self.place):
            raise ModelError(f"springs on {self.place!r}: its facets lie inside; springs act on the outer boundary")

    def work(self, model: Host, u: Expr, v: Expr) -> Any:
        """Virtual work of the springs, a UFL form."""
        n = ufl.FacetNormal(model.V.mesh)
        across = (self.normal - self.tangential) * ufl.dot(u, n) * ufl.dot(v, n)
        return (across + self.tangential * ufl.inner(u, v)) * model.ds(model.domain.values(self.place))

    def part(self, model: Host) -> Part:
        """The springs as a part of a model's balance. Collective."""
        return SpringPart(self, model)


class SpringPart(Part):
    """Springs over a time step: forces K u, energy u.K u / 2."""

    def __init__(self, springs: Springs, model: Host) -> None:
        self.key = springs.key
        form = springs.work(model, ufl.TrialFunction(model.V), ufl.TestFunction(model.V))
        self.K = self._K = dolfinx.fem.petsc.assemble_matrix(fem.form(form))
        self._K.assemble()
        self._forces, self._change = self._K.createVecLeft(), self._K.createVecLeft()

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._u, self._mid = u, mid

    def add_forces(self, out: PETSc.Vec) -> float:
        self._K.mult(self._mid.x.petsc_vec, self._forces)
        out.axpy(1.0, self._forces)
        return float(self._forces.norm())

    def tangents(self, relative_residual: float) -> list[Block]:
        return [Block(self._K, self.interval.theta, kept=True)]

    def commit(self) -> Outcome:
        now, old = self._u.x.petsc_vec, self.interval.old.u.x.petsc_vec
        now.copy(self._change)
        self._change.axpy(-1.0, old)
        before, after, of_change = map(self._energy, (old, now, self._change))
        return Outcome(before, after, remainder=(2 * self.interval.theta - 1) * of_change)

    def _energy(self, u: PETSc.Vec) -> float:
        self._K.mult(u, self._forces)
        return float(u.dot(self._forces)) / 2

    def error_measure(self, u: fem.Function, forces: PETSc.Vec) -> Array:
        self._K.mult(u.x.petsc_vec, self._forces)
        forces.axpy(1.0, self._forces)
        return super().error_measure(u, forces)

    def destroy(self) -> None:
        for thing in (self._K, self._forces, self._change):
            thing.destroy()
