"""Kinematics: three-dimensional strains of displacements on plane, axisymmetric and three-dimensional meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import ufl

from forms.base import Array
from forms.law import BulkLaw
from forms.tensors import MANDEL_PAIRS, Expr, strain, three_dimensional


@dataclass(frozen=True)
class Kinematics:
    """Strains (3, 3) of displacements on a mesh, the factor of its measures, and the laws of these strains.

    This class covers plane strain in 2D, and three dimensions; the other kinematics derive from it. d is the number of
    dimensions of the mesh.

    Attributes:
        x: coordinates on the mesh, (d,) UFL; None as long as there is no mesh (`on` returns a copy with one).
        name: name in `Structure(plane=...)`.
        rotations: whether rotations are rigid motions.
        degree: polynomial degree of the factor of measures.
    """

    x: Expr | None = None
    name: ClassVar[str] = "strain"
    rotations: ClassVar[bool] = True
    degree: ClassVar[int] = 0

    def on(self, mesh: ufl.Mesh) -> Self:
        """The same kinematics with the coordinates of a mesh."""
        return replace(self, x=ufl.SpatialCoordinate(mesh))

    def at(self, x: Expr) -> Self:
        """A copy with other coordinates (d,) UFL, such as those of points on S away from the facets of the mesh."""
        return replace(self, x=x)

    def slots(self, d: int) -> tuple[int, ...]:
        """Indices of the Mandel components of strain that may be nonzero, for displacements with d components."""
        return tuple(k for k, (_, j) in enumerate(MANDEL_PAIRS) if j < d)

    def translations(self, d: int) -> tuple[int, ...]:
        """Indices of the coordinate axes along which translations are rigid motions, on a mesh of dimension d."""
        return tuple(range(d))

    def radius(self, x: Array) -> Array:
        """Distances (n,) of places (n, d) from the axis of revolution; infinite if there is no such axis."""
        return np.full(len(x), np.inf)

    def stress_slots(self, d: int) -> tuple[int, ...]:
        """Indices of the Mandel components of stress that may be nonzero on a mesh of dimension d.

        The others are set to zero, whatever the law returns.
        """
        return tuple(range(len(MANDEL_PAIRS)))

    @property
    def factor(self) -> Expr:
        """Factor of all measures dx, ds and dS of the mesh, UFL: 1, for integrals per unit thickness in 2D."""
        return 1

    def factor_at(self, x: Array) -> Array:
        """Values (...) of the factor of measures at places (..., d)."""
        return np.ones(x.shape[:-1])

    def node_areas(self, corners: Array, lengths: Array) -> Array:
        """Areas (n, k) of S that belong to the k corners of n facets, with the factor of measures.

        They are the integrals of the shape functions of degree 1 times this factor.

        Args:
            corners: coordinates (n, k, d) of the corners.
            lengths: the same areas without the factor, (n, k); lengths in 2D.
        """
        factors = self.factor_at(corners)
        return np.asarray(lengths * ((factors + factors.sum(axis=1, keepdims=True)) / (factors.shape[1] + 1)))

    def strain(self, u: Expr) -> Expr:
        """Strain (3, 3) of displacements u in a body or in a meshed layer."""
        return strain(u)

    def along(self, gradient: Expr, u: Expr) -> Expr:
        """Strain (3, 3) along S of displacements on S.

        Args:
            gradient: gradient (d, d) of the displacements along S.
            u: the displacements (d,).
        """
        return three_dimensional(ufl.sym(gradient))

    def restricted(self, a: Expr) -> Expr:
        """Part (3, 3) of a stress, or of a prescribed strain, that these kinematics allow: here all of it."""
        return a

    def law(self, law: BulkLaw) -> BulkLaw:
        """Law for strains of these kinematics, in the volume, along S and across it, from a three-dimensional law."""
        return law


PLANE_STRAIN = Kinematics()  # plane strain in 2D, all strains in 3D


class PlaneStress(Kinematics):
    """Plane stress: out-of-plane stresses are zero; laws compute the out-of-plane strains (`BulkLaw.plane_stress`)."""

    name = "stress"

    def stress_slots(self, d: int) -> tuple[int, ...]:
        return self.slots(d)

    def restricted(self, a: Expr) -> Expr:
        """In-plane part (3, 3): out-of-plane stresses are zero, and out-of-plane strains are not prescribed."""
        return ufl.as_tensor([[a[0, 0], a[0, 1], 0], [a[1, 0], a[1, 1], 0], [0, 0, 0]])

    def law(self, law: BulkLaw) -> BulkLaw:
        return law.plane_stress()


class Axisymmetric(Kinematics):
    """Bodies of revolution without twist: x is the distance r >= 0 from the axis, y the coordinate along it.

    The third normal strain is the hoop strain u_r/r. Integrals are over the whole revolution, with the factor 2 pi r.
    """

    name = "axisymmetric"
    rotations = False
    degree = 1

    def slots(self, d: int) -> tuple[int, ...]:
        return (0, 1, 2, 3)

    def translations(self, d: int) -> tuple[int, ...]:
        return (1,)

    def radius(self, x: Array) -> Array:
        return x[:, 0]

    @property
    def factor(self) -> Expr:
        """The circumference 2 pi r, UFL."""
        return 2 * ufl.pi * self._r

    def factor_at(self, x: Array) -> Array:
        return np.asarray(2 * np.pi * x[..., 0])

    def strain(self, u: Expr) -> Expr:
        return strain(u) + self._hoops(u)

    def along(self, gradient: Expr, u: Expr) -> Expr:
        return super().along(gradient, u) + self._hoops(u)

    @property
    def _r(self) -> Expr:
        assert self.x is not None, "kinematics of no mesh; see `on`"
        return self.x[0]

    def _hoops(self, u: Expr) -> Expr:
        return ufl.as_tensor([[0, 0, 0], [0, 0, 0], [0, 0, u[0] / self._r]])


KINEMATICS_BY_NAME: dict[str, Kinematics] = {kind.name: kind for kind in (PLANE_STRAIN, PlaneStress(), Axisymmetric())}
