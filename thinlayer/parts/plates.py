"""Rigid plates on the boundary: their motions are unknowns, the resultants of the forces on them are given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.kinematics import Expr
from thinlayer.discretisation.addition import Addition, Host
from thinlayer.discretisation.reactions import Array
from thinlayer.discretisation.state import Configuration, State
from thinlayer.parts.plate_data import PlateData
from thinlayer.parts.plate_nodes import release, tie
from thinlayer.parts.plate_part import PlatePart


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
    `piecewise`. The plate holds its nodes whole: a support at one of them must follow from the plate's prescribed motions,
    as that of a plane of symmetry does.

    Attributes:
        place: name of a facet set on the outer boundary.
        force: (d,) resultant force on the plate; in 2D per unit thickness.
        moment: its moment about the point: a number in 2D (> 0 from x to y), (3,) in 3D.
        motion: prescribed motions of the point: "x", "y", "z" a length, "rotation" (in 3D "rotation x", ...) an angle.
        about: the point (d,), in the coordinates of the model's mesh; by default the centroid of the place.
        key: name of its unknowns, "plate NAME".

    Raises:
        ModelError: when a model is made: an unknown or empty place, inner facets, values that are no numbers, a force along
            a prescribed motion, nodes that supports or another plate hold too.
    """

    ties_nodes: ClassVar[bool] = True

    @property
    def prescribed(self) -> Sequence[Any]:
        """As in `Addition`: its prescribed motions."""
        return list(self.motion.values())

    def work(self, model: Host, u: Expr, v: Expr) -> Any:
        """Zero: a plate has no forces of its own."""
        return ufl.inner(fem.Constant(model.domain.mesh, np.zeros(model.joint.dim)), v) * model.dx

    def release(self, model: Host) -> int:
        """Take out conditions of supports at nodes of the plate that follow from its prescribed motions; their number.

        Raises:
            ModelError: a support at a node of the plate prescribes what does not.
        """
        return release(self, model)

    def held(self, model: Host, V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """As in `Addition`: all displacements of the plate's nodes."""
        facets, d = model.domain.facets(self.place, layer_sides=True), model.joint.dim
        blocks = fem.locate_dofs_topological(V, d - 1, facets)
        return np.unique(blocks[:, None] * d + np.arange(d)).astype(np.int32)

    def resistance(self, model: Host, motions: Sequence[fem.Function]) -> npt.NDArray[np.float64]:
        """As in `Addition`: prescribed motions of the plate resist those of the structure."""
        R = tie(self, model, self.point(model), self.size(model))
        matrix = model.comm.allreduce(np.asarray((R.T @ R).todense()), MPI.SUM)
        held = self.motions_held(model)
        rows = [R.T @ f.x.array[: R.shape[0]] for f in motions]
        own = np.linalg.lstsq(matrix, np.array([model.comm.allreduce(row) for row in rows]).T, rcond=None)[0][held]
        return np.asarray(own.T @ own)

    def force_at(self, model: Host, t: float) -> npt.NDArray[np.float64]:
        """As in `Addition`: the given force."""
        return self.resultants(model, t)[: model.joint.dim]

    def load_work(self, model: Host, state: Configuration) -> float:
        """Work of the given force and moment in the plate's motion at a state. Collective."""
        return float(self.resultants(model, state.t) @ _everywhere(state.fields[self.key], model.comm))

    def motion_in(self, state: State) -> PlateMotion:
        """The plate's motion in a state. Collective."""
        values, d = _everywhere(state.fields[self.key], state.model.comm), state.model.joint.dim
        rotation = values[d] if d == 2 else values[d:]
        return PlateMotion(values[:d], np.asarray(rotation), self.point(state.model))

    def part(self, model: Host) -> PlatePart:
        """The plate as a part of a model's balance. Collective."""
        return PlatePart(self, model)


def _everywhere(f: fem.Function, comm: MPI.Intracomm) -> Array:
    """All values of a function with unknowns of the whole structure, on every rank."""
    dofmap = f.function_space.dofmap
    return np.concatenate(comm.allgather(f.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]))
