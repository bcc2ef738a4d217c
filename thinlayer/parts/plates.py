"""Rigid plates on the boundary: their motions are unknowns, the resultants of the forces on them are given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from thinlayer.discretisation.addition import Addition, Host
from thinlayer.discretisation.constraints import Tied
from thinlayer.discretisation.reactions import Array, count
from thinlayer.discretisation.state import Configuration, State
from thinlayer.parts.plate_data import PlateData, motion_names
from thinlayer.parts.plate_nodes import tie


@dataclass(frozen=True, eq=False)
class PlateMotion:
    """The motion of a rigid plate.

    Attributes:
        translation: (d,) displacement of the point.
        rotation: small rotation: (3,), in 2D a number, > 0 from x to y.
        about: (d,) the point.
    """

    translation: Array
    rotation: Array
    about: Array


@dataclass(frozen=True)
class RigidPlate(PlateData, Addition):
    """A rigid plate, bonded to a facet set of the outer boundary and to the side of the layer that continues it.

    Its nodes move as a rigid body, with small rotations. For each of its 3 motions (in 3D 6) either the force or moment is
    given, by default zero, or the motion is prescribed. All values may be functions (x, t) of the time alone, or
    `piecewise`. A support at one of its nodes holds the whole plate there.

    Attributes:
        place: name of a facet set on the outer boundary.
        force: (d,) resultant force on the plate; in 2D per unit thickness.
        moment: its moment about the point: a number in 2D (> 0 from x to y), (3,) in 3D.
        motion: prescribed motions of the point: "x", "y", "z" a length, "rotation" (in 3D "rotation x", ...) an angle.
        about: the point (d,), in the coordinates of the model's mesh; by default the centroid of the place.
        key: name of its unknowns, "plate NAME".

    Raises:
        ModelError: when a model is made: an unknown or empty place, inner facets, values that are no numbers, a force along
            a prescribed motion, nodes that another plate holds too.
    """

    ties_nodes: ClassVar[bool] = True

    @property
    def prescribed(self) -> Sequence[Any]:
        """As in `Addition`: its prescribed motions."""
        return list(self.motion.values())

    def held(self, model: Host, V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """As in `Addition`: all displacements of the plate's nodes."""
        facets, d = model.domain.facets(self.place, layer_sides=True), model.joint.dim
        blocks = fem.locate_dofs_topological(V, d - 1, facets)
        return np.unique(blocks[:, None] * d + np.arange(d)).astype(np.int32)

    def tied(self, model: Host) -> Tied:
        """Its nodes, which follow its motions. Collective."""
        d, size = model.joint.dim, self.size(model)
        scale = np.where(np.arange(count(d)) < d, 1.0, size)
        held = {k: partial(self._prescribed_at, model, k, scale[k]) for k in self.motions_held(model)}
        R = tie(self, model, self.point(model), size)
        return Tied(self.key, motion_names(d), R, held, lambda t: self.resultants(model, t) / scale)

    def _prescribed_at(self, model: Host, k: int, scale: float, t: float) -> float:
        return self.motions(model, t)[k] * scale

    def load_work(self, model: Host, state: Configuration) -> float:
        """Work of the given force and moment in the plate's motion at a state. Collective."""
        return float(self.resultants(model, state.t) @ self._in_units(model, state.u))

    def motion_in(self, state: State) -> PlateMotion:
        """The plate's motion in a state. Collective."""
        values, d = self._in_units(state.model, state.u), state.model.joint.dim
        rotation = values[d] if d == 2 else values[d:]
        return PlateMotion(values[:d], np.asarray(rotation), self.point(state.model))

    def _in_units(self, model: Any, u: fem.Function) -> Array:
        (tie,) = (one for one in model.constraints.ties if one.key == self.key)
        q, d = model.constraints.motion(tie, u.x.array[: model.constraints.n]), model.joint.dim
        return np.append(q[:d], q[d:] / self.size(model))

    def part(self, model: Host) -> None:
        """None: a plate has no forces of its own; its nodes are `tied`."""
