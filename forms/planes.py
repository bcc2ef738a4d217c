"""Kinematics: what the displacements of a plane, an axisymmetric or a three-dimensional mesh mean in three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import ufl

from forms.kinematics import MANDEL, Expr, lift, strain
from forms.law import BulkLaw


@dataclass(frozen=True)
class Kinematics:
    """Strains (3, 3) of displacements, the factor of measures, and the laws of these strains.

    These are the kinematics of plane strain in 2D, and of three dimensions; others derive from them.

    Attributes:
        x: place on the mesh, (d,) UFL; None: there is no mesh yet, see `on`.
        name: as in `Structure(plane=...)`.
    """

    x: Expr | None = None
    name: ClassVar[str] = "strain"

    def on(self, mesh: Any) -> Self:
        """The same kinematics at the places of a mesh."""
        return replace(self, x=ufl.SpatialCoordinate(mesh))

    def slots(self, d: int) -> tuple[int, ...]:
        """Mandel components that the strains of displacements (d,) have; the others are zero."""
        return tuple(k for k, (_, j) in enumerate(MANDEL) if j < d)

    @property
    def factor(self) -> Any:
        """Factor of all measures dx, ds and dS of the mesh: 1, for integrals per unit thickness in 2D."""
        return 1

    def strain(self, u: Expr) -> Expr:
        """Strain (3, 3) of a displacement in a body or in a meshed layer."""
        return strain(u)

    def along(self, u: Expr, side: Callable[[Expr], Expr], n: Expr) -> Expr:
        """Strain (3, 3) along S, of normal n (d,), of the displacements on one side."""
        tangential = ufl.Identity(len(n)) - ufl.outer(n, n)
        return lift(ufl.sym(ufl.dot(side(ufl.grad(u)), tangential)))

    def seen(self, e: Expr) -> Expr:
        """The part of a given strain (3, 3), such as a free expansion, that the laws of `law` take."""
        return e

    def law(self, law: BulkLaw) -> BulkLaw:
        """The law of the strains of `strain`, `along` and of jumps, for a law of strains in three dimensions."""
        return law


class PlaneStress(Kinematics):
    """Plane stress: no stress out of the plane; laws find the strain there themselves (`BulkLaw.plane_stress`)."""

    name = "stress"

    def seen(self, e: Expr) -> Expr:
        """The strain in the plane: nothing holds a strain out of it."""
        return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])

    def law(self, law: BulkLaw) -> BulkLaw:
        return law.plane_stress()


PLANES: dict[str, Kinematics] = {one.name: one for one in (Kinematics(), PlaneStress())}
