"""The displacements that supports prescribe in a space: conditions at nodes, and the forces that they cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from dolfinx import fem

from geometry.errors import place as at_place
from thinlayer.compiling.compat import interpolation_points
from thinlayer.discretisation.conditions import INDEPENDENT, Resolution
from thinlayer.discretisation.normals import node_normals, smooth
from thinlayer.discretisation.supports import NORMAL, Place, Supports, Value
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
AGREE = 1e-9  # difference of two values of one displacement, at most, over the largest prescribed displacement
ROUNDING = 1e-13  # a difference that counts as rounding, over the size of the structure


@dataclass
class _Source:
    """The values of one component of one entry: a function that is a number, or an expression to interpolate."""

    entry: int
    place: Place
    axis: str
    value: fem.Function
    expression: fem.Expression | None


@dataclass(frozen=True)
class Released:
    """Conditions that are left out.

    Attributes:
        source, dof: the component and the degree of freedom that has its value.
        entry: number of the support.
    """

    prescribed: Prescribed
    source: npt.NDArray[np.int64]
    dof: npt.NDArray[np.int64]
    entry: npt.NDArray[np.int64]

    def values(self) -> Array:
        """Their values (n,) at the time of the last `Prescribed.at`."""
        return self.prescribed.values_of(self.source, self.dof)


class Prescribed:
    """Conditions of supports on a space, direction . u = value at a node; the library solves for other unknowns y, u = Q y.

    Where supports prescribe components along the axes, Q is the identity. Where they prescribe one along an inclined
    normal, y has the components along the prescribed directions first, then those across. At nodes between facets of places
    with a normal component, facets whose normals differ by less than 30 degrees are one smooth surface with their mean
    normal; others are planes that meet in a corner, and the displacements along both normals are prescribed: in 2D the
    corner is held, in 3D it moves along the edge. Straight facets of a curved side in 3D have normals of their own: where
    they should slide freely, use curved cells (degree 2).

    A displacement that several places prescribe must have the same value by all. Its force is shared equally among them.

    Args:
        supports: the supports.
        V: the space, of nodal displacements if a component is normal.

    Attributes:
        held: (n,) local numbers of the prescribed entries of y on this rank, increasing.
        frames: Q of this rank, (m, m) sparse and orthogonal; None: the identity.
        entry: (k,) for each condition the number of its support in `supports.entries`; -1: an anchor, or the axis.
        blocks: (k,) local number of its node.
        released: key of a part -> conditions at its nodes that are left out, and its motions' displacements along them.
        conditions: (k, m) sparse, the conditions on the displacements of this rank.

    Raises:
        ModelError: two supports prescribe different numbers at a node; later, in `at`, different values of functions.
    """

    def __init__(self, supports: Supports, V: fem.FunctionSpace) -> None:
        self.supports, self.V, self.comm = supports, V, supports.domain.comm
        self._moment = supports.at.moment(0.0)
        self._bs = V.dofmap.bs
        self._size = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        self.released: dict[str, tuple[Released, Array]] = {}
        self._extent = float(np.ptp(supports.domain.joint.points, axis=0).max())
        self._sources = [
            self._source(number, place, axis, value)
            for number, (place, components) in enumerate(supports.entries)
            for axis, value in components.items()
        ]
        if any(one.axis == NORMAL for one in self._sources) and not self._nodal:
            raise ModelError("supports along normals need nodal displacements, not elements S2; use Q2 or P2")
        self._find_conditions()
        self._resolve()
        self._require_agreement(self._numbers(), self._constant)

    # ---------------------------------------------------------------- conditions
    def _source(self, entry: int, place: Place, axis: str, given: Value) -> _Source:
        value, expression = fem.Function(self.V), self.supports.functions.get((entry, axis))
        if expression is not None:
            points = interpolation_points(self.V)
            return _Source(entry, place, axis, value, fem.Expression(self._moment.of(expression), points))
        if given:
            value.interpolate(lambda x: np.full((self._bs, x.shape[1]), float(given)))  # type: ignore[arg-type]
        return _Source(entry, place, axis, value, None)

    def _find_conditions(self) -> None:
        """Find the conditions on this rank: source, the degree of freedom that has the value, and direction."""
        d, axes = self._bs, self.supports.axes
        clamped = range(len(self.supports.given), len(self.supports.entries))
        whole = np.zeros(self._size, bool)  # what clamped facets hold
        source: list[Numbers] = []
        dof: list[Numbers] = []
        direction: list[Numbers] = []
        for number, one in enumerate(self._sources):
            if one.axis == NORMAL:
                continue
            dofs = np.unique(self.supports.dofs(self.V, one.place, one.axis))
            dofs = dofs[dofs < self._size]
            whole[dofs] |= one.entry in clamped
            source.append(np.full(len(dofs), number))
            dof.append(dofs)
            direction.append(np.tile(np.eye(d)[axes.index(one.axis)], (len(dofs), 1)))
        for others in (self.supports.anchors(self.V), self.supports.axis(self.V)):  # zero by themselves
            owned = others[others < self._size]
            source.append(np.full(len(owned), -1))
            dof.append(owned)
            direction.append(np.eye(d)[owned % d])
        for some, numbers in zip(self._normal_conditions(), (source, dof, direction), strict=True):
            numbers.append(some)
        self._source_of, self._dof, self._direction = (
            np.concatenate(source).astype(np.int64), np.concatenate(dof).astype(np.int64), np.concatenate(direction)
        )  # fmt: skip
        entry = np.array([*(one.entry for one in self._sources), -1])[self._source_of]
        block = self._dof // d
        held_by_base = whole.reshape(-1, d)[block]
        kept = np.isin(entry, clamped) | ~((np.abs(self._direction) > 0) & held_by_base).any(axis=1)
        self.entry, self._source_of, self._dof, self._direction = (
            array[kept] for array in (entry, self._source_of, self._dof, self._direction)
        )
        self.blocks = self._dof // d
        row = np.repeat(np.arange(len(self.entry)), d)
        column = (self.blocks[:, None] * d + np.arange(d)).ravel()
        self.conditions = scipy.sparse.csr_matrix(
            (self._direction.ravel(), (row, column)), (len(self.entry), self._size)
        )
        self.conditions.eliminate_zeros()

    def _normal_conditions(self) -> tuple[Array, Array, Array]:
        """Conditions along normals: source, degree of freedom, direction."""
        d = self._bs
        source: list[Numbers] = [np.empty(0, np.int64)]
        block: list[Numbers] = [np.empty(0, np.int64)]
        normals: list[Numbers] = [np.empty((0, d))]
        for number, one in enumerate(self._sources):
            if one.axis != NORMAL:
                continue
            assert isinstance(one.place, str)
            facets = self.supports.domain.facets(one.place, layer_sides=True)
            found, n = node_normals(self.supports.domain, self.V, facets)
            source.append(np.full(len(found), number))
            block.append(found)
            normals.append(n)
        sources, blocks, vectors = np.concatenate(source), np.concatenate(block), np.concatenate(normals)
        order = np.argsort(blocks, kind="stable")
        rows: list[tuple[int, int, Array]] = []
        for here in np.split(order, np.flatnonzero(np.diff(blocks[order])) + 1) if len(order) else []:
            surface, unit = smooth(vectors[here])
            pairs = np.unique(np.column_stack([sources[here], surface]), axis=0)
            rows += [(int(s), int(blocks[here[0]]), unit[k]) for s, k in pairs]
        if not rows:
            return np.empty(0), np.empty(0), np.empty((0, d))
        return np.array([s for s, _, _ in rows]), np.array([b * d for _, b, _ in rows]), np.array([n for *_, n in rows])

    @property
    def directions(self) -> Array:
        """(k, d) unit direction of each condition."""
        return self._direction

    def release(self, rows: npt.NDArray[np.int64]) -> Released:
        """Leave out conditions of this rank, given by their rows, that something else meets. Collective."""
        found = Released(self, self._source_of[rows], self._dof[rows], self.entry[rows])
        kept = np.setdiff1d(np.arange(len(self.entry)), rows)
        self.entry, self._source_of, self._dof, self._direction, self.blocks = (
            array[kept] for array in (self.entry, self._source_of, self._dof, self._direction, self.blocks)
        )
        self.conditions = self.conditions[kept]
        self._resolve()
        self.__dict__.pop("_constant", None)
        return found

    # ---------------------------------------------------------------- unknowns
    def _resolve(self) -> None:
        """Find the held unknowns y, as sums of the values, and how their forces are shared among the conditions."""
        found = Resolution(self._direction, self.blocks, self._bs, self._size)
        self.held, self._solve, self._same, self._share = found.held, found.solve, found.same, found.share
        self.frames = found.frames if self.comm.allreduce(int(found.turned)) else None

    # ---------------------------------------------------------------- values
    def _numbers(self) -> Array:
        """Values of the conditions, of the last interpolation."""
        return self.values_of(self._source_of, self._dof)

    def values_of(self, source: npt.NDArray[np.int64], dof: npt.NDArray[np.int64]) -> Array:
        """Values of components at degrees of freedom, of the last interpolation."""
        values = np.zeros(len(source))
        for number, one in enumerate(self._sources):
            here = source == number
            values[here] = one.value.x.array[dof[here]]
        return values

    @cached_property
    def _constant(self) -> npt.NDArray[np.bool_]:
        """Conditions at nodes where all values are numbers."""
        varies = np.array([*(one.expression is not None for one in self._sources), False])[self._source_of]
        return ~np.isin(self.blocks, self.blocks[varies])

    def at(self, t: float) -> Array:
        """Prescribed values (n,) of y at a time, possibly not finite. Collective.

        Raises:
            ModelError: two supports prescribe different values at a node.
        """
        self._moment.set(t)
        for one in self._sources:
            if one.expression is not None:
                one.value.interpolate(one.expression)
                one.value.x.scatter_forward()
        values = self._numbers()
        if not self.comm.allreduce(int(not np.isfinite(values).all())):
            self._require_agreement(values, ~self._constant, f" at t = {t:g}")
        return np.asarray(self._solve @ values)

    def _require_agreement(self, values: Array, asked: npt.NDArray[np.bool_], when: str = "") -> None:
        apart = np.where(asked, np.abs(values - self._same @ values), 0.0)
        largest = self.comm.allreduce(float(np.abs(values).max(initial=0.0)), max)
        message = ""
        if apart.max(initial=0.0) > max(AGREE * largest, ROUNDING * self._extent):
            message = self._contradiction(int(apart.argmax()), values) + when
        if messages := [one for one in self.comm.allgather(message) if one]:
            raise ModelError(f"{messages[0]}; where supports overlap, their values must agree")

    def _contradiction(self, row: int, values: Array) -> str:
        """Words for a condition that does not agree with the others at its node."""
        there = np.flatnonzero((self.blocks == self.blocks[row]) & (self.entry != self.entry[row]))
        across = np.abs(self._direction[there] @ self._direction[row])
        there = np.append(there[across > INDEPENDENT], row)
        said = [self._said(int(k), values) for k in there[np.argsort(self.entry[there], kind="stable")]]
        x = self.V.tabulate_dof_coordinates()[self.blocks[row], : self._bs] if self._nodal else None
        if x is not None:
            x = np.where(np.abs(x) > ROUNDING * self._extent, x, 0.0)
        return f"contradictory supports{f' at {at_place(x)}' if x is not None else ''}: " + " and ".join(said)

    def _said(self, row: int, values: Array) -> str:
        if self._source_of[row] < 0:
            return "on the axis of revolution x = 0"
        one = self._sources[self._source_of[row]]
        return f"{one.place!r} prescribes {one.axis} = {values[row]:.6g}"

    @property
    def _nodal(self) -> bool:
        try:
            self.V.tabulate_dof_coordinates()
        except RuntimeError:
            return False
        return True

    # ---------------------------------------------------------------- forces
    def resultants(self, r: Array, motions: Array) -> Array:
        """Resultants (entries, k) of nodal forces of this rank: their work in k motions, by the supports that cause them.

        Args:
            r: (m,) residual, internal forces less loads, at the displacements of this rank.
            motions: (m, k) displacements.
        """
        out = np.zeros((len(self.supports.entries) + 1, motions.shape[1]))
        np.add.at(out, self.entry, (self._share @ r)[:, None] * (self.conditions @ motions))
        return out[:-1]

    def dual_to_resultant(self, entries: Sequence[int], direction: Array) -> Array:
        """(m,) weights of nodal forces whose sum is the force of some supports along a direction (d,), see `resultants`."""
        along = np.isin(self.entry, entries) * (self._direction @ direction)
        return np.asarray(self._share.T @ along)
