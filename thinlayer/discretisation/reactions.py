"""Reactions: the forces and moments that supports, springs, plates and rigid bases give to a structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.temperature import finite
from geometry.domain import Domain
from geometry.refusals import place as at_place
from geometry.seam import BASE, S
from thinlayer.discretisation.measures import per_unit
from thinlayer.discretisation.rigid import balanced_motions, on_centre, rigid_expression
from thinlayer.discretisation.supports import Place
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
ROUNDING = 1e-12  # coordinates over the size of the structure, components over a force, that are told as zero


@dataclass(frozen=True, eq=False)
class Resultant:
    """A force and its moment about a point. In 2D per unit thickness.

    Attributes:
        force: (d,) force.
        moment: moment about the point: (3,), in 2D a number, > 0 from x to y.
        about: (d,) the point, in the coordinates of the model's mesh.
    """

    force: Array
    moment: Array
    about: Array

    def at(self, about: Sequence[float] | Array) -> Resultant:
        """The same forces, with their moment about another point (d,)."""
        point = require_point(about, len(self.force))
        return Resultant(self.force, self.moment + _moment(self.about - point, self.force), point)

    def __add__(self, other: Resultant) -> Resultant:
        there = other.at(self.about)
        return Resultant(self.force + there.force, self.moment + there.moment, self.about)

    def __neg__(self) -> Resultant:
        return Resultant(-self.force, -self.moment, self.about)

    @classmethod
    def of(cls, values: Array, about: Array) -> Resultant:
        """From the work (k,) in the motions of `rigid`: translations, then rotations about the point."""
        d = len(about)
        moment = values[d:]
        return cls(values[:d].copy(), moment[0] if d == 2 else moment.copy(), about)

    def __repr__(self) -> str:
        size = np.abs(self.force).max()
        force = at_place(np.where(np.abs(self.force) > ROUNDING * size, self.force, 0.0))
        moment = f"{self.moment:.6g}" if np.ndim(self.moment) == 0 else at_place(self.moment)
        return f"force {force}, moment {moment} about {at_place(self.about)}"


def require_point(about: Sequence[float] | Array, dim: int) -> Array:
    """A point (d,) as an array; raises ModelError if it is none."""
    point = finite(about, (dim,))
    if point is None:
        raise ModelError(f"about is {about!r}; it must be a point of {dim} finite coordinates")
    return point


def _moment(arm: Array, force: Array) -> Array:
    if len(arm) == 2:
        return np.asarray(arm[0] * force[1] - arm[1] * force[0])
    return np.asarray(np.cross(arm, force), float)


def centroid(domain: Domain, name: str) -> Array:
    """Centroid (d,) of the facets of a name, the sides of the layer that continue it included. Collective."""
    mesh = domain.mesh
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=domain.facet_tags)(domain.values(name, layer_sides=True))
    chosen = fem.Constant(mesh, np.zeros(domain.joint.dim + 1))
    sums = per_unit(domain.comm, ufl.dot(chosen, ufl.as_vector([*ufl.SpatialCoordinate(mesh), 1.0])) * ds, chosen)
    found = sums[:-1] / sums[-1]
    return np.asarray(np.where(np.abs(found) > ROUNDING * np.ptp(domain.joint.points), found, 0.0))


def applied_to(state: Any, about: Sequence[float] | None) -> Resultant:
    """See `State.applied`."""
    model = state.model
    point = model.centre if about is None else require_point(about, model.joint.dim)
    motion, v = rigid_expression(model.domain.mesh, model.centre)
    values = per_unit(model.comm, model.external_work(v, state.t), motion) + sum(_on_bases(state).values())
    return Resultant.of(values * balanced_motions(model.kinematics, len(point)), model.centre).at(point)


def _on_bases(state: Any) -> dict[str, Array]:
    """Forces and moments (k,), about the centre, of the loads that go to rigid bases by themselves, by seam. Collective."""
    model = state.model
    motion, v = rigid_expression(model.domain.mesh, model.centre)
    return {name: per_unit(model.comm, work, motion) for name, work in model.work_on_bases(v, state.t).items()}


def all_reactions(state: Any, about: Sequence[float] | None = None) -> dict[Place, Resultant]:
    """See `State.reactions_by_place`."""
    model = state.model
    if state.reactions is None:
        raise ModelError("this state has no reactions: it is no equilibrium that was solved for")
    rows = list(zip(model.holders, state.reactions, strict=True))
    rows += [(name, -values) for name, values in _on_bases(state).items()]
    for part in model.parts:
        rows += [(place, found) for place, found in part.reaction(model, state.u)]
    point = model.centre if about is None else require_point(about, model.joint.dim)
    found: dict[Place, Resultant] = {}
    balanced = balanced_motions(model.kinematics, model.joint.dim)
    for place, values in rows:
        one = Resultant.of(np.asarray(values) * balanced, model.centre).at(point)
        found[place] = found[place] + one if place in found else one
    return found


def reaction_of(state: Any, place: Place, about: Sequence[float] | None) -> Resultant:
    """See `State.reaction`."""
    model, every = state.model, all_reactions(state)
    bases = {BASE, *model.joint.base_seams}
    chosen = [name for name in every if name == place or str(name).split("/")[0] == place]
    if place == S or (place in bases and not chosen):
        chosen = [name for name in every if name in bases]
    if not chosen:
        held = ", ".join(map(repr, every)) or "nothing"
        free = f"nothing holds {place!r}: it is free of supports and springs"
        raise ModelError(f"{free}; held are: {held}")
    total = every[chosen[0]]
    for name in chosen[1:]:
        total = total + every[name]
    if about is not None:
        return total.at(about)
    return total.at(on_centre(model.kinematics, _middle(model, place, chosen)))


def _middle(model: Any, place: Place, chosen: Sequence[Place]) -> Array:
    """The default point of moments: the centroid of a facet set, the vertex itself."""
    domain = model.domain
    if isinstance(place, str) and place in domain.facet_values and domain.values(place, layer_sides=True):
        return centroid(domain, place)
    names = [name for name in chosen if isinstance(name, str) and domain.facet_values.get(name)]
    if names:
        return np.asarray(np.mean([centroid(domain, name) for name in names], axis=0))
    if isinstance(place, str):  # the side of a layer that is not meshed
        return centroid(domain, place.split("/")[0])
    joint = domain.joint
    vertex = joint.nearest_point(place)
    copies = np.all(joint.reference == joint.reference[vertex], axis=1)
    return np.asarray(joint.points[copies].mean(axis=0))
