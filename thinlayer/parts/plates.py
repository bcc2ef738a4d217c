"""Rigid plates on the boundary: their motions are unknowns, the resultants of the forces on them are given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import scipy.sparse
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import is_number
from forms.kinematics import Expr
from geometry.errors import place as at_place
from geometry.errors import unknown
from thinlayer.discretisation.addition import Addition, Host
from thinlayer.discretisation.loads import AXES, Coordinates, called, refuse_periodic, refuse_seam
from thinlayer.discretisation.prescribed import AGREE, ROUNDING
from thinlayer.discretisation.reactions import (
    Array,
    balanced_motions,
    centroid,
    count,
    on_centre,
    require_point,
    rigid,
)
from thinlayer.discretisation.state import Configuration, State
from thinlayer.errors import ModelError
from thinlayer.parts.plate_part import PlatePart

Number = float | Callable[[Expr, Any], Any]
Vector = Sequence[float] | Callable[[Expr, Any], Sequence[Any]]
FOLLOWS = 1e-9  # share of a free motion in a displacement that counts as rounding
ROTATIONS = {2: ("rotation",), 3: ("rotation x", "rotation y", "rotation z")}


def _names(d: int) -> list[str]:
    """Names of the motions of a plate."""
    return [*AXES[:d], *ROTATIONS[d]]


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
class RigidPlate(Addition):
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

    place: str
    force: Vector | None = None
    moment: Number | Vector | None = None
    motion: Mapping[str, Number] = field(default_factory=dict)
    about: Sequence[float] | None = None
    key: str = field(init=False)
    ties_nodes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", f"plate {self.place}")

    @property
    def _what(self) -> str:
        return f"plate on {self.place!r}"

    # ---------------------------------------------------------------- data
    def check(self, model: Host) -> None:
        """As in `Addition`."""
        if not isinstance(self.place, str):
            raise ModelError(f"{self._what}: a place is the name of a facet set")
        inside = f"{self._what}: its facets lie inside, or below a layer; plates lie on the outer boundary"
        refuse_seam(model.joint, self.place, inside)
        refuse_periodic(model.joint, self.place, "rigid plate")
        if not model.domain.values(self.place):
            raise ModelError(f"{self._what}: this facet set is empty")
        if not model.domain.is_outer(self.place):
            raise ModelError(inside)
        d = model.joint.dim
        names = _names(d)
        if not isinstance(self.motion, Mapping):
            raise ModelError(f"{self._what}: motion is {self.motion!r}; it must be {{{names[0]!r}: value, ...}}")
        for name in self.motion:
            if name not in names:
                raise ModelError(f"{self._what}: {unknown('motion', name, names)}")
            if names.index(name) in self._prevented(model):
                raise ModelError(
                    f"{self._what}: a rigid plate of revolution has no motion {name!r}; it moves along the axis"
                )
        if self.about is not None:
            require_point(self.about, d)
        for given, _ in self._given(d):
            if callable(given):
                self._once(given, model.coordinates)
        if not any(callable(given) for given, _ in self._given(d)):
            self.resultants(model, 0.0)
            self.motions(model, 0.0)

    def _given(self, d: int) -> list[tuple[Any, tuple[int, ...]]]:
        """All data with the shapes of their values."""
        found: list[tuple[Any, tuple[int, ...]]] = [(self.force, (d,)), (self.moment, () if d == 2 else (3,))]
        return [one for one in found if one[0] is not None] + [(value, ()) for value in self.motion.values()]

    def _once(self, given: Callable[..., Any], at: Coordinates) -> None:
        """Call a function with the symbol of the time, whose breaks it tells; it may not depend on the place."""
        found = called(given, at, self._what)
        for one in found if isinstance(found, Sequence | np.ndarray) else [found]:
            for node in unique_pre_traversal(ufl.as_ufl(one)):
                if isinstance(node, ufl.SpatialCoordinate):
                    raise ModelError(f"{self._what}: a value depends on the place x; it is one for the whole plate")

    def _value(self, given: Any, shape: tuple[int, ...], at: Coordinates, t: float) -> Array:
        """A value (shape) at a time."""
        if not callable(given) and shape == () and not is_number(given):
            raise ModelError(f"{self._what}: a value is {given!r}; it must be a number or a function (x, t)")
        found = called(given, at, self._what, t) if callable(given) else given
        try:
            value = np.array(found, float)
        except (TypeError, ValueError):
            value = np.array([np.nan])
        if value.shape != shape or not np.isfinite(value).all():
            need = f"{shape[0]} finite components" if shape else "a finite number"
            raise ModelError(f"{self._what}: a value at t = {t:g} is {found!r}; it must be {need}")
        return value

    def motions(self, model: Host, t: float) -> dict[int, float]:
        """Number of a prescribed motion -> its value at a time; a plate of revolution moves along its axis alone."""
        names, found = _names(model.joint.dim), dict.fromkeys(self._prevented(model), 0.0)
        return found | {
            names.index(name): float(self._value(value, (), model.coordinates, t))
            for name, value in self.motion.items()
        }

    @staticmethod
    def _prevented(model: Host) -> list[int]:
        """Numbers of the motions that kinematics do not have."""
        return [int(k) for k in np.flatnonzero(balanced_motions(model.kinematics, model.joint.dim) == 0)]

    def resultants(self, model: Host, t: float) -> Array:
        """Force and moment (k,) at a time; raises ModelError if one of them is along a prescribed motion."""
        d, at = model.joint.dim, model.coordinates
        out = np.zeros(count(d))
        if self.force is not None:
            out[:d] = self._value(self.force, (d,), at, t)
        if self.moment is not None:
            out[d:] = self._value(self.moment, () if d == 2 else (3,), at, t)
        for k in self.motions_held(model):
            if out[k]:
                raise ModelError(
                    f"{self._what}: the motion {_names(d)[k]!r} is prescribed, and {out[k]:g} is given for its force or "
                    "moment; one of them follows from the other"
                )
        return out

    def point(self, model: Host) -> Array:
        """The point (d,) to which motions and moments refer. Collective."""
        if self.about is not None:
            return require_point(self.about, model.joint.dim)
        return on_centre(model.kinematics, centroid(model.domain, self.place))

    # ---------------------------------------------------------------- in a model
    def work(self, model: Host, u: Expr, v: Expr) -> Any:
        """Zero: a plate has no forces of its own."""
        return ufl.inner(fem.Constant(model.domain.mesh, np.zeros(model.joint.dim)), v) * model.dx

    def tie(self, model: Host, about: Array, size: float) -> Any:
        """(n, k) sparse: displacements of this rank by the plate's motions, rotations times a length. Collective."""
        V, d = model.V, model.joint.dim
        facets = model.domain.facets(self.place, layer_sides=True)
        owned = V.dofmap.index_map.size_local
        found = fem.locate_dofs_topological(V, d - 1, facets)
        blocks = np.unique(found[found < owned])
        try:
            x = V.tabulate_dof_coordinates()[blocks, :d]
        except RuntimeError as error:
            raise ModelError(f"{self._what} needs nodal displacements, not elements S2") from error
        values = rigid(x, about)
        values[:, :, d:] /= size
        k = values.shape[2]
        rows = np.repeat(blocks[:, None] * d + np.arange(d), k)
        columns = np.tile(np.arange(k), len(blocks) * d)
        return scipy.sparse.csr_matrix((values.ravel(), (rows, columns)), (owned * d, k))

    def release(self, model: Host) -> int:
        """Take out conditions of supports at nodes of the plate that follow from its prescribed motions; their number.

        Raises:
            ModelError: a support at a node of the plate prescribes what does not.
        """
        about, size, d = self.point(model), self.size(model), model.joint.dim
        tied = np.flatnonzero(np.diff(self.tie(model, about, size).indptr)) // d
        prescribed = model.prescribed
        rows = np.flatnonzero(np.isin(prescribed.blocks, tied) & (prescribed.entry >= 0))
        x = model.V.tabulate_dof_coordinates()[prescribed.blocks[rows], :d]
        directions = prescribed.directions[rows]
        ways = np.einsum("nd,ndk->nk", directions, rigid(x, about))
        free = np.setdiff1d(np.arange(ways.shape[1]), self.motions_held(model))
        scaled = np.where(np.arange(ways.shape[1]) < d, ways, ways / size)
        wrong = np.abs(scaled[:, free]).max(axis=1, initial=0.0) > FOLLOWS
        message = ""
        if wrong.any():
            place, _ = model.supports.entries[prescribed.entry[rows[wrong][0]]]
            where = np.where(np.abs(x[wrong][0]) > ROUNDING * size, x[wrong][0], 0.0)
            message = (
                f"the support on {place!r} acts on a node of the rigid plate on {self.place!r}, at {at_place(where)}, and "
                f"does not follow from its prescribed motions; prescribe them, RigidPlate({self.place!r}, motion={{...}})"
            )
        if messages := [one for one in model.comm.allgather(message) if one]:
            raise ModelError(messages[0])
        prescribed.released[self.key] = prescribed.release(rows), ways
        return len(rows)

    def require_agreement(self, model: Host, motions: Mapping[int, float], t: float) -> None:
        """Raise ModelError if supports at nodes of the plate prescribe other values than its motions. Collective."""
        released, ways = model.prescribed.released[self.key]
        q = np.array([motions.get(k, 0.0) for k in range(ways.shape[1])])
        values, by_plate = released.values(), ways @ q
        apart = np.abs(values - by_plate)
        largest = max(np.abs(values).max(initial=0.0), np.abs(by_plate).max(initial=0.0))
        message = ""
        if apart.max(initial=0.0) > max(AGREE * largest, ROUNDING * self.size(model)):
            k = int(apart.argmax())
            place, _ = model.supports.entries[released.entry[k]]
            message = (
                f"contradictory at t = {t:g}: the support on {place!r} prescribes {values[k]:.6g} where the motion of the "
                f"rigid plate on {self.place!r} is {by_plate[k]:.6g}"
            )
        if messages := [one for one in model.comm.allgather(message) if one]:
            raise ModelError(messages[0])

    def held(self, model: Host, V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """As in `Addition`: all displacements of the plate's nodes."""
        facets, d = model.domain.facets(self.place, layer_sides=True), model.joint.dim
        blocks = fem.locate_dofs_topological(V, d - 1, facets)
        return np.unique(blocks[:, None] * d + np.arange(d)).astype(np.int32)

    def size(self, model: Host) -> float:
        """Largest extent of the structure, by which rotations are multiplied to be lengths."""
        return float(np.ptp(model.domain.joint.points, axis=0).max())

    def resistance(self, model: Host, motions: Sequence[fem.Function]) -> npt.NDArray[np.float64]:
        """As in `Addition`: prescribed motions of the plate resist those of the structure."""
        R = self.tie(model, self.point(model), self.size(model))
        matrix = model.comm.allreduce(np.asarray((R.T @ R).todense()), MPI.SUM)
        held = self.motions_held(model)
        rows = [R.T @ f.x.array[: R.shape[0]] for f in motions]
        own = np.linalg.lstsq(matrix, np.array([model.comm.allreduce(row) for row in rows]).T, rcond=None)[0][held]
        return np.asarray(own.T @ own)

    def motions_held(self, model: Host) -> list[int]:
        """Numbers of the prescribed motions."""
        return sorted({*self._prevented(model), *(_names(model.joint.dim).index(name) for name in self.motion)})

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
