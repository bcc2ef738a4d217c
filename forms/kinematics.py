"""Kinematics: strains (3, 3) of displacements on plane, axisymmetric and three-dimensional meshes."""

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
    """Strains (3, 3) that displacements cause in plane strain (2D meshes) or in three dimensions (3D meshes).

    The other kinematics derive from this class. Kinematics also give the form of laws that fits these strains. `factor`
    multiplies all integrals over the mesh, such as 2 pi r in axisymmetry. The number of dimensions of the mesh is d.

    Attributes:
        x: coordinates on the mesh, UFL (d,); None if no mesh is set (`on_mesh` returns a copy with a mesh).
        name: value of `plane` in `Structure(plane=...)` that selects these kinematics.
        has_rigid_rotations: whether rigid rotations cause no strain.
        factor: factor, UFL, of all integrals over the mesh; with 1, integrals in 2D are per unit depth.
        factor_degree: polynomial degree of `factor` in the coordinates.
    """

    x: Expr | None = None
    name: ClassVar[str] = "strain"
    has_rigid_rotations: ClassVar[bool] = True
    factor: ClassVar[Expr] = 1
    factor_degree: ClassVar[int] = 0

    def on_mesh(self, mesh: ufl.Mesh) -> Self:
        """Return a copy of these kinematics that uses the coordinates of `mesh`."""
        return replace(self, x=ufl.SpatialCoordinate(mesh))

    def at(self, x: Expr) -> Self:
        """Return a copy with other coordinates `x`, UFL (d,), such as those of points on S off the mesh's facets."""
        return replace(self, x=x)

    def strain_indices(self, d: int) -> tuple[int, ...]:
        """Return the indices, from 0 to 5, of the Mandel components of strain that may be nonzero.

        `d` is the number of dimensions of the mesh.
        """
        return tuple(k for k, (_, j) in enumerate(MANDEL_PAIRS) if j < d)

    def translation_axes(self, d: int) -> tuple[int, ...]:
        """Return the indices of the coordinate axes along which rigid translations cause no strain.

        `d` is the number of dimensions of the mesh.
        """
        return tuple(range(d))

    def axis_distances(self, x: Array) -> Array:
        """Return the distances (n,) of places (n, d) from the axis of revolution; infinite if there is no such axis."""
        return np.full(len(x), np.inf)

    def stress_indices(self, d: int) -> tuple[int, ...]:
        """Return the indices, from 0 to 5, of the Mandel components of stress that may be nonzero.

        The other components are set to zero, whatever the law returns. `d` is the number of dimensions of the mesh.
        """
        return tuple(range(len(MANDEL_PAIRS)))

    def factors_at(self, x: Array) -> Array:
        """Return the factor (...) of integrals at places `x` (..., d): 2 pi r in axisymmetry, otherwise 1."""
        return np.ones(x.shape[:-1])

    def corner_areas(self, corners: Array, shape_integrals: Array) -> Array:
        """Return the areas (n, k) of S that belong to each of the k corners of n facets.

        They are the integrals of the corners' shape functions of degree 1, times `factor`.

        Args:
            corners: coordinates (n, k, d) of the corners.
            shape_integrals: integrals (n, k) of these shape functions without the factor: areas in 3D, lengths in 2D.
        """
        factors = self.factors_at(corners)
        return np.asarray(shape_integrals * ((factors + factors.sum(axis=1, keepdims=True)) / (factors.shape[1] + 1)))

    def strain(self, u: Expr) -> Expr:
        """Return the strain (3, 3), UFL, of the displacements `u` in a body or in a meshed layer."""
        return strain(u)

    def strain_along(self, gradient: Expr, u: Expr) -> Expr:
        """Return the strain (3, 3), UFL, that displacements of points on S cause along S.

        Args:
            gradient: gradient (d, d) of the displacements along S.
            u: the displacements (d,).
        """
        return three_dimensional(ufl.sym(gradient))

    def admissible_part(self, a: Expr) -> Expr:
        """Return a stress or a prescribed strain (3, 3) without the components that the kinematics exclude.

        These kinematics exclude none.
        """
        return a

    def law(self, law: BulkLaw) -> BulkLaw:
        """Return the form of a three-dimensional law that fits these kinematics' strains, in bodies and layers."""
        return law


PLANE_STRAIN = Kinematics()  # plane strain in 2D, all strains in 3D


class PlaneStress(Kinematics):
    """Plane stress: out-of-plane stresses are zero; laws compute the out-of-plane strains (`BulkLaw.plane_stress`)."""

    name = "stress"

    def stress_indices(self, d: int) -> tuple[int, ...]:
        return self.strain_indices(d)

    def admissible_part(self, a: Expr) -> Expr:
        """Return a stress or a prescribed strain (3, 3) with zeros in place of its out-of-plane components."""
        return ufl.as_tensor([[a[0, 0], a[0, 1], 0], [a[1, 0], a[1, 1], 0], [0, 0, 0]])

    def law(self, law: BulkLaw) -> BulkLaw:
        return law.plane_stress()


class Axisymmetric(Kinematics):
    """Bodies of revolution without twist: x is the distance r >= 0 from the axis, y the coordinate along the axis.

    The third normal strain is the hoop strain u_r/r. Integrals are over the whole revolution, with the factor 2 pi r.
    """

    name = "axisymmetric"
    has_rigid_rotations = False
    factor_degree = 1

    def strain_indices(self, d: int) -> tuple[int, ...]:
        return (0, 1, 2, 3)

    def translation_axes(self, d: int) -> tuple[int, ...]:
        return (1,)

    def axis_distances(self, x: Array) -> Array:
        return x[:, 0]

    @property
    def factor(self) -> Expr:
        """Circumference 2 pi r, UFL, by which all integrals over the mesh are multiplied."""
        return 2 * ufl.pi * self._r

    def factors_at(self, x: Array) -> Array:
        return np.asarray(2 * np.pi * x[..., 0])

    def strain(self, u: Expr) -> Expr:
        return strain(u) + self._hoop_strain(u)

    def strain_along(self, gradient: Expr, u: Expr) -> Expr:
        return super().strain_along(gradient, u) + self._hoop_strain(u)

    @property
    def _r(self) -> Expr:
        assert self.x is not None, "kinematics of no mesh; see `on_mesh`"
        return self.x[0]

    def _hoop_strain(self, u: Expr) -> Expr:
        return ufl.as_tensor([[0, 0, 0], [0, 0, 0], [0, 0, u[0] / self._r]])


KINEMATICS_BY_NAME: dict[str, Kinematics] = {kind.name: kind for kind in (PLANE_STRAIN, PlaneStress(), Axisymmetric())}
