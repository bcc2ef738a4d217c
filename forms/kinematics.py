"""Kinematics: strains (3, 3) of displacements, or of a scalar field, on plane, axisymmetric and 3D meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np
import ufl

from forms.base import Array, InputError
from forms.law import BulkLaw
from forms.tensors import MANDEL_PAIRS, Expr, jump_strain, scalar_strain, strain, three_dimensional

# (k, d, d) matrices W of unit rotations with displacements W x: in 3D the cross products of e_k and x
UNIT_ROTATIONS = {2: np.array([[[0.0, -1.0], [1.0, 0.0]]]), 3: np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)}


class QuantityNames(NamedTuple):
    """Names of quantities, for messages and columns of results.

    Attributes:
        symbol: symbol of the unknown.
        traction: what acts on a surface, per area.
        stress: what a law gives in bodies.
        load: load on a facet set, in names of parameters.
        body_force: what acts in a volume, per volume.
        load_arguments: names of the arguments of `Structure` for loads on facet sets and in volumes.
        more_arguments: names of other arguments of `Structure` that act on this unknown alone.
        motion: change of the unknown without strain, with {} for the name of a component.
        unsupported: message if nothing prevents a motion without strain, with {} for this motion.
        steady_remedy: what refusals of laws with rates add for who wants a state that does not change.
    """

    symbol: str = "u"
    traction: str = "traction"
    stress: str = "stress"
    load: str = "load"
    body_force: str = "body force"
    load_arguments: tuple[str, str] = ("tractions", "body_force")
    more_arguments: tuple[str, ...] = ("loads", "strain", "stress", "eigenstrain")
    motion: str = "translation {}"
    unsupported: str = "no support against rigid motion of the structure ({}); add supports"
    steady_remedy: str = ""


@dataclass(frozen=True)
class Kinematics:
    """Strains (3, 3) that displacements cause in plane strain (2D meshes) or in three dimensions (3D meshes).

    The other kinematics derive from this class. Kinematics also give the form of laws that fits these strains. `factor`
    multiplies all integrals over the mesh, such as 2 pi r in axisymmetry. The mesh has d dimensions, the unknown c
    components: d displacements, or the one value of a scalar field.

    Attributes:
        x: coordinates on the mesh, UFL (d,); None if no mesh is set (`on_mesh` returns a copy with a mesh).
        name: value of `plane` in `Structure(plane=...)` that selects these kinematics.
        unknown: name of the unknown; laws for these kinematics have the same name in `Law.unknown`.
        quantities: names of quantities, for messages and columns of results.
        has_value_in_strain: whether a strain contains the unknown's value, on which laws then may depend.
        has_axis: whether the bodies are bodies of revolution about an axis.
        is_fixed_on_axis: whether the first component of the unknown vanishes on this axis.
        has_rigid_rotations: whether rigid rotations cause no strain.
        factor: factor, UFL, of all integrals over the mesh; with 1, integrals in 2D are per unit depth.
        factor_degree: polynomial degree of `factor` in the coordinates.
    """

    x: Expr | None = None
    name: ClassVar[str] = "strain"
    unknown: ClassVar[str] = "displacement"
    quantities: ClassVar[QuantityNames] = QuantityNames()
    has_value_in_strain: ClassVar[bool] = False
    has_axis: ClassVar[bool] = False
    is_fixed_on_axis: ClassVar[bool] = False
    has_rigid_rotations: ClassVar[bool] = True
    factor: ClassVar[Expr] = 1
    factor_degree: ClassVar[int] = 0

    def on_mesh(self, mesh: ufl.Mesh) -> Self:
        """Return a copy of these kinematics that uses the coordinates of `mesh`."""
        return replace(self, x=ufl.SpatialCoordinate(mesh))

    def require(self, unknown: str, what: str, instead: str = "") -> None:
        """Raise InputError unless the unknown of these kinematics is that which a function or a result needs.

        Args:
            unknown: name of the needed unknown.
            what: what needs it, the first words of the message.
            instead: what to take for other unknowns; "": nothing.
        """
        if self.unknown != unknown:
            remedy = f"; take {instead}" if instead else ""
            raise InputError(f"{what} is for laws of a {unknown}; the bodies have laws of a {self.unknown}{remedy}")

    def at(self, x: Expr) -> Self:
        """Return a copy with other coordinates `x`, UFL (d,), such as those of points on S away from the facets."""
        return replace(self, x=x)

    def components(self, d: int) -> tuple[str, ...]:
        """Return the names of the unknown's components on a mesh of `d` dimensions."""
        return tuple("xyz"[:d])

    def uniform_components(self, d: int) -> tuple[int, ...]:
        """Return the indices of the unknown's components whose uniform values cause no strain."""
        return self.translation_axes(d)

    def motion_count(self, d: int) -> int:
        """Return the number k of unit motions: 3 of a rigid body in `d` = 2 dimensions, 6 in three."""
        return d + len(UNIT_ROTATIONS[d])

    def unit_motions_at(self, x: Array, about: Array) -> Array:
        """Return the values (n, c, k) of the k unit motions at n places (n, d): of rigid bodies, or a uniform value.

        The motions of rigid bodies are d translations, then rotations about the point `about` (d,). Not all of them
        are without strain in axisymmetry, see `uniform_components` and `has_rigid_rotations`.
        """
        n, d = x.shape
        arms = np.einsum("kij,nj->nik", UNIT_ROTATIONS[d], x - about)
        return np.concatenate([np.broadcast_to(np.eye(d), (n, d, d)), arms], axis=2)

    def combined_motion(self, x: Expr, about: Array, factors: Expr) -> Expr:
        """Return the sum (c,), UFL, of the unit motions `unit_motions_at` at `x` (d,), times the `factors` (k,)."""
        d, arm = len(about), x - ufl.as_vector(about.tolist())
        rotations = enumerate(UNIT_ROTATIONS[d].tolist())
        rotation_terms = (factors[d + k] * ufl.dot(ufl.as_matrix(rotation), arm) for k, rotation in rotations)
        return sum(rotation_terms, ufl.as_vector([factors[i] for i in range(d)]))

    def strain_indices(self, d: int) -> tuple[int, ...]:
        """Return the indices, from 0 to 5, of the Mandel components of strain that may be nonzero.

        `d` is the number of dimensions of the mesh.
        """
        return tuple(k for k, (_, j) in enumerate(MANDEL_PAIRS) if j < d)

    def resisted_indices(self, d: int) -> tuple[int, ...]:
        """Return those of the `strain_indices` whose components of strain every stable law resists with a stress."""
        return self.strain_indices(d)

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

    def strain_across(self, jump: Expr, n: Expr) -> Expr:
        """Return the strain (3, 3), UFL, that a jump (c,) of the unknown over a unit of length along `n` (d,) causes."""
        return jump_strain(jump, n)

    def tractions(self, stresses: Array, n: Array) -> Array:
        """Return the tractions (n_points, c), conjugate to jumps, of stresses (n_points, 3, 3) on normals (n_points, d)."""
        d = n.shape[1]
        return np.asarray(np.einsum("pij,pj->pi", stresses[:, :d, :d], n))

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
    has_axis = is_fixed_on_axis = True
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


class ScalarField(Kinematics):
    """A scalar field, such as a temperature, on plane and three-dimensional meshes: its gradient and value are strains.

    They are entries of a strain (3, 3), as `forms.tensors.scalar_strain` places them. In 2D nothing varies across the
    plane.
    """

    unknown = "scalar field"
    has_value_in_strain = True
    quantities = QuantityNames(
        symbol="T",
        traction="flux",
        stress="flux",
        load="flux",
        body_force="source",
        load_arguments=("fluxes", "sources"),
        more_arguments=("gradient", "initial"),
        motion="a change of {} everywhere",
        unsupported="nothing holds the field ({} costs nothing); add supports, or a Film",
        steady_remedy="; for a steady state take Conduction in place of Heat, also in layers",
    )
    has_rigid_rotations = False

    def components(self, d: int) -> tuple[str, ...]:
        return ("T",)

    def uniform_components(self, d: int) -> tuple[int, ...]:
        return (0,)

    def motion_count(self, d: int) -> int:
        return 1

    def unit_motions_at(self, x: Array, about: Array) -> Array:
        return np.ones((len(x), 1, 1))

    def combined_motion(self, x: Expr, about: Array, factors: Expr) -> Expr:
        return ufl.as_vector([factors[0]])

    def strain_indices(self, d: int) -> tuple[int, ...]:
        return (*range(d), 3)

    def resisted_indices(self, d: int) -> tuple[int, ...]:
        return tuple(range(d))

    def strain(self, u: Expr) -> Expr:
        value = u[0] if u.ufl_shape else u
        return scalar_strain(ufl.grad(value), value)

    def strain_along(self, gradient: Expr, u: Expr) -> Expr:
        return scalar_strain(gradient[0, :], u[0])

    def strain_across(self, jump: Expr, n: Expr) -> Expr:
        return scalar_strain(jump[0] * n)

    def tractions(self, stresses: Array, n: Array) -> Array:
        return np.asarray(np.einsum("pii,pi->p", stresses[:, : n.shape[1], : n.shape[1]], n)[:, None])


class AxisymmetricScalarField(ScalarField):
    """A scalar field in bodies of revolution: integrals have the factor 2 pi r, and there is no hoop strain."""

    name, has_axis, factor_degree = Axisymmetric.name, True, Axisymmetric.factor_degree
    translation_axes, axis_distances = Axisymmetric.translation_axes, Axisymmetric.axis_distances
    factor, factors_at, _r = Axisymmetric.factor, Axisymmetric.factors_at, Axisymmetric._r


KINEMATICS_BY_NAME: dict[str, Kinematics] = {kind.name: kind for kind in (PLANE_STRAIN, PlaneStress(), Axisymmetric())}
SCALAR_KINEMATICS_BY_NAME: dict[str, Kinematics] = {
    **dict.fromkeys(KINEMATICS_BY_NAME, ScalarField()),
    Axisymmetric.name: AxisymmetricScalarField(),
}
