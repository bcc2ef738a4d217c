"""Rigid motions, which supports must prevent, and resultants of forces from their work in rigid motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, InputError
from forms.kinematics import UNIT_ROTATIONS, Kinematics
from forms.temperature import finite_values
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.refusals import place_text as at_place
from geometry.seam import FacetName
from geometry.topology import IntArray
from thinlayer.discretisation.boundary import AXIS_NAMES
from thinlayer.discretisation.form_compilation import unit_values
from thinlayer.discretisation.supports import Place
from thinlayer.discretisation.time_functions import TimeLevel

if TYPE_CHECKING:
    from thinlayer.discretisation.model import Model

ResistanceFunction = Callable[[Sequence[fem.Function]], Array]
# plane (i, j) and sense of each rotation
ROTATION_PLANES = {2: ((0, 1, 1.0),), 3: ((1, 2, 1.0), (0, 2, -1.0), (0, 1, 1.0))}
MIN_RELATIVE_EIGENVALUE = 1e-10  # least eigenvalue of the supports' Gram matrix of rigid motions, over its largest one
# coordinates over the size of the structure, or force components over the largest one, that are shown as zero
ZERO_TOLERANCE = 1e-12


def resultant_mask(kinematics: Kinematics, dim: int) -> Array:
    """Return a factor for each of the k unit rigid motions: 0 if its resultant vanishes by axisymmetry, else 1.

    Translations come first in the result (k,), then rotations. `dim` is the number of dimensions.
    """
    n_components, n_motions = len(kinematics.components(dim)), kinematics.motion_count(dim)
    has_resultant = np.isin(np.arange(n_components), kinematics.uniform_components(dim))
    return np.append(has_resultant, np.full(n_motions - n_components, kinematics.has_rigid_rotations)).astype(float)


def moment_centre(kinematics: Kinematics, x: Array) -> Array:
    """Return the place `x` (d,) as the point of moments; in axisymmetry return its projection onto the axis."""
    return np.where(np.isin(np.arange(len(x)), kinematics.translation_axes(len(x))), x, 0.0)


def motion_expression(model: Model) -> tuple[fem.Constant, Expr]:
    """Return a combination of the k unit rigid motions about the model's centre, with a Constant (k,) as its factors.

    Returns:
        The Constant, which is zero, and the displacement (c,) of the combination, in UFL.
    """
    mesh, kinematics, about = model.domain.mesh, model.kinematics, model.centre
    factors = fem.Constant(mesh, np.zeros(kinematics.motion_count(len(about))))
    return factors, kinematics.combined_motion(ufl.SpatialCoordinate(mesh), about, factors)


def motion_values(model: Model, about: Array, dofs: IntArray) -> Array:
    """Return the values (m, k) of the k unit rigid motions at m displacement components.

    The motions are translations, then rotations.

    Args:
        model: the model.
        about: (d,) the point about which motions rotate.
        dofs: (m,) local numbers of the displacement components: c for each node.
    """
    c = model.n_components
    motions = model.kinematics.unit_motions_at(model.node_coordinates[dofs // c], about)
    return motions[np.arange(len(dofs)), dofs % c]


def motion_factors(joint: Joint, kinematics: Kinematics) -> dict[str, Array]:
    """Return the rigid motions that the kinematics and periods of a joint admit, each by name with k factors.

    The factors (k,) multiply the k unit motions: d translations, then rotations about the centre. Factors of rotations
    are divided by the size of the structure, so that rotations are as large as translations.

    Translations come first in the result. In axisymmetry only that along the axis is left. Periodic joints have no
    rotations, which would move one periodic side against the other. The only exception is a rotation about the
    direction of a single period in 3D.
    """
    d, size, basis = joint.dim, joint.size, np.eye(kinematics.motion_count(joint.dim))
    names, motion = kinematics.components(d), kinematics.quantities.motion
    factors = {motion.format(names[i]): basis[i] for i in kinematics.uniform_components(d)}
    if not kinematics.has_rigid_rotations:
        return factors
    if joint.periods:
        vectors = joint.periods.vectors(joint.points)
        if d == 3 and np.linalg.matrix_rank(vectors) == 1:
            direction = vectors[0] / np.linalg.norm(vectors[0])
            factors[f"rotation about ({', '.join(f'{c:.3g}' for c in direction)})"] = direction @ basis[d:] / size
    else:
        for k, (i, j, sign) in reversed([*enumerate(ROTATION_PLANES[d])]):
            factors[f"rotation {AXIS_NAMES[i]}{AXIS_NAMES[j]}"] = basis[d + k] * sign / size
    return factors


def model_motion_values(model: Model, dofs: IntArray, kinematics: Kinematics | None = None) -> Array:
    """Return the values (m, k) of the structure's k rigid motions, `motion_factors`, at m displacement components.

    Args:
        model: the model.
        dofs: (m,) local numbers of the displacement components.
        kinematics: kinematics that decide which motions there are; None: those of the model.
    """
    joint = model.domain.joint
    factors = [*motion_factors(joint, kinematics or model.kinematics).values()]
    return motion_values(model, joint.points.mean(axis=0), dofs) @ np.transpose(factors)


def model_motions(model: Model, kinematics: Kinematics | None = None) -> dict[str, fem.Function]:
    """Return the rigid motions of a model's structure as displacements in its space, by name. Collective.

    The motions are those of `motion_factors`.

    Args:
        model: the model.
        kinematics: kinematics that decide which motions there are; None: those of the model.
    """
    n_dofs = len(model.node_coordinates) * model.n_components
    values = model_motion_values(model, np.arange(n_dofs), kinematics)
    names = motion_factors(model.domain.joint, kinematics or model.kinematics)
    motions = {name: fem.Function(model.V) for name in names}
    for f, column in zip(motions.values(), values.T, strict=True):
        f.x.array[:] = column
    return motions


def resistance_matrix(model: Model, resistances: Sequence[ResistanceFunction]) -> Array:
    """Return a matrix (m, m) whose null space is the rigid motions that nothing prevents. Collective.

    Rows and columns belong to the m motions of `motion_factors`. Entry (i, j) is the sum of two contributions. The
    first is the scalar product of the displacements in motions i and j along the directions of all support conditions.
    Multi-point constraints, such as rigid plates, adapt so that these displacements are least. The second is the
    stiffness of other parts, such as springs. The stiffness of each part is made symmetric and divided by its largest
    absolute entry, as only its null space counts.

    Args:
        model: the model.
        resistances: for each part that resists motions, a function from the displacements of the m motions to its
            stiffness (m, m) against them.
    """
    matrix = model.constraints.violation_gram(partial(model_motion_values, model))
    motions = [*model_motions(model).values()] if resistances else []
    for resistance in resistances:
        stiffness = resistance(motions)
        largest = np.abs(stiffness).max()
        if np.isfinite(largest) and largest > 0:
            matrix = matrix + (stiffness + stiffness.T) / (2 * largest)
    return np.asarray(matrix, float)


def free_axes(model: Model, resistances: Sequence[ResistanceFunction]) -> tuple[str, ...]:
    """Return the names of the axes along which nothing prevents a translation. Collective.

    Neither supports nor other parts resist a translation whose diagonal entry in `resistance_matrix` is about 0.

    Args:
        model, resistances: arguments of `resistance_matrix`.
    """
    # translations are the first motions of `motion_factors`
    d = model.joint.dim
    names = [model.kinematics.components(d)[k] for k in model.kinematics.uniform_components(d)]
    diagonal = np.diag(resistance_matrix(model, resistances))[: len(names)]
    limit = MIN_RELATIVE_EIGENVALUE * max(*diagonal, 1.0)
    return tuple(name for name, r in zip(names, diagonal, strict=True) if r <= limit)


def require_support(model: Model, resistances: Sequence[ResistanceFunction]) -> None:
    """Raise InputError if nothing prevents one of the rigid motions, or a combination of them. Collective.

    Args:
        model, resistances: arguments of `resistance_matrix`.
    """
    names = [*motion_factors(model.domain.joint, model.kinematics)]
    eigenvalues, eigenvectors = np.linalg.eigh(resistance_matrix(model, resistances))
    if eigenvalues[0] <= MIN_RELATIVE_EIGENVALUE * max(eigenvalues[-1], 1.0):
        motion = names[int(np.argmax(np.abs(eigenvectors[:, 0])))]
        raise InputError(model.kinematics.quantities.unsupported.format(motion))


@dataclass(frozen=True, eq=False)
class Resultant:
    """A resultant force with its moment about a point; in 2D per unit thickness.

    Attributes:
        force: (d,) force in d dimensions.
        moment: (3,) moment about the point; in 2D a number, > 0 from x to y.
        about: (d,) the point, in the coordinates of the model's mesh.
    """

    force: Array
    moment: Array
    about: Array

    @property
    def components(self) -> Array:
        """Components (d,) of the force."""
        return self.force

    def at(self, about: Sequence[float] | Array) -> Resultant:
        """Return the same resultant with the moment about another point (d,)."""
        point = require_point(about, len(self.force))
        moment = self.force @ UNIT_ROTATIONS[len(point)] @ (self.about - point)
        return Resultant(self.force, self.moment + (moment if len(moment) > 1 else moment[0]), point)

    def __add__(self, other: Resultant) -> Resultant:
        shifted = other.at(self.about)
        return Resultant(self.force + shifted.force, self.moment + shifted.moment, self.about)

    def __neg__(self) -> Resultant:
        return Resultant(-self.force, -self.moment, self.about)

    def __repr__(self) -> str:
        force = at_place(np.where(np.abs(self.force) > ZERO_TOLERANCE * np.abs(self.force).max(), self.force, 0.0))
        moment = f"{self.moment:.6g}" if np.ndim(self.moment) == 0 else at_place(self.moment)
        return f"force {force}, moment {moment} about {at_place(self.about)}"


@dataclass(frozen=True)
class Flow:
    """Resultant of a scalar field's fluxes: for heat the power that enters the structure; in 2D per unit thickness.

    Attributes:
        flow: integral of the flux over the area.
    """

    flow: float

    @property
    def components(self) -> Array:
        """The flow as an array (1,)."""
        return np.array([self.flow])

    def at(self, about: Sequence[float] | Array) -> Flow:
        """Return the same flow; unlike a force it has no moment about a point."""
        return self

    def __add__(self, other: Flow) -> Flow:
        return Flow(self.flow + other.flow)

    def __neg__(self) -> Flow:
        return Flow(-self.flow)

    def __repr__(self) -> str:
        return f"flow {self.flow:.6g}"


def require_point(about: Sequence[float] | Array, dim: int) -> Array:
    """Return the point `about` as an array (dim,).

    Raises:
        InputError: it does not have `dim` finite coordinates.
    """
    if (point := finite_values(about, (dim,))) is None:
        raise InputError(f"about is {about!r}; it must be a point of {dim} finite coordinates")
    return point


def centroid(domain: Domain, name: str) -> Array:
    """Return the centroid (d,) of a named facet set, with the facets of a layer's side that continue it. Collective."""
    if name in domain.centroids:
        return domain.centroids[name]
    mesh = domain.mesh
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=domain.facet_tags)(domain.values(name, layer_sides=True))
    factors = fem.Constant(mesh, np.zeros(domain.joint.dim + 1))
    sums = unit_values(domain.comm, ufl.dot(factors, ufl.as_vector([*ufl.SpatialCoordinate(mesh), 1.0])) * ds, factors)
    centre = sums[:-1] / sums[-1]
    domain.centroids[name] = np.where(np.abs(centre) > ZERO_TOLERANCE * domain.joint.size, centre, 0.0)
    return domain.centroids[name]


def load_resultants(model: Model, t: float, work: Callable[[Expr], Mapping[str, Expr]]) -> dict[str, Resultant]:
    """Return the resultants of loads at the time t, by name, with moments about the model's centre. Collective.

    Args:
        model: the model.
        t: the time.
        work: function from a motion v, in UFL, to the virtual work of the loads in v: name of a load -> UFL form.
    """
    factors, v = motion_expression(model)
    works = {name: TimeLevel(t).at_level(form) for name, form in work(v).items()}
    return {name: resultant(model, unit_values(model.comm, form, factors)) for name, form in works.items()}


def resultant(model: Model, motion_works: Array) -> Any:
    """Return the `Resultant` of forces from their work in the k unit rigid motions about the model's centre.

    For a scalar field it is a `Flow`. Components that vanish by axisymmetry are set to zero.

    Args:
        model: the model.
        motion_works: (k,) work in the translations, then in the rotations.
    """
    d = model.joint.dim
    works = np.asarray(motion_works) * resultant_mask(model.kinematics, d)
    if len(works) == 1:
        return Flow(float(works[0]))
    return Resultant(works[:d], works[d] if d == 2 else works[d:], model.centre)


def default_moment_point(model: Model, place: Place, places: Sequence[Place]) -> Array:
    """Return the default point (d,) of moments: the centroid of a facet set, or the vertex itself.

    In axisymmetry it is the projection of this place onto the axis.

    Args:
        model: the model.
        place: name of the facet set, or coordinates of the vertex.
        places: places whose reactions are summed for `place`. If `place` has no facets of its own, the result is the
            mean of their centroids.
    """
    domain, joint = model.domain, model.domain.joint
    if isinstance(place, str) and place in domain.set_tags and domain.values(place, layer_sides=True):
        point = centroid(domain, place)
    elif names := [name for name in places if isinstance(name, str) and domain.set_tags.get(name)]:
        point = np.mean([centroid(domain, name) for name in names], axis=0)
    elif isinstance(place, str):  # the side of a layer that is not meshed
        point = centroid(domain, FacetName.parse(place).set_name)
    else:
        is_copy = np.all(joint.reference == joint.reference[joint.nearest_point(place)], axis=1)
        point = joint.points[is_copy].mean(axis=0)
    return moment_centre(model.kinematics, point)
