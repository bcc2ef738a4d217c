"""The displacements that supports prescribe in a space: conditions at nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from dolfinx import fem

from thinlayer.compiling.compat import interpolation_points
from thinlayer.discretisation.normals import node_normals, smooth
from thinlayer.discretisation.supports import NORMAL, Place, Supports, Value
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
ROUNDING = 1e-13  # a difference that counts as rounding, over the size of the structure


@dataclass
class _Source:
    """The values of one component of one entry: a function that is a number, or an expression to interpolate."""

    entry: int
    place: Place
    axis: str
    value: fem.Function
    expression: fem.Expression | None


class Prescribed:
    """Conditions of supports on a space, direction . u = value at a node.

    At nodes between facets of places with a normal component, facets whose normals differ by less than 30 degrees are one
    smooth surface with their mean normal; others are planes that meet in a corner, and the displacements along both normals
    are prescribed: in 2D the corner is held, in 3D it moves along the edge. Straight facets of a curved side in 3D have
    normals of their own: where they should slide freely, use curved cells (degree 2).

    Args:
        supports: the supports.
        V: the space, of nodal displacements if a component is normal.

    Attributes:
        d, size: components of a node, and displacements of this rank.
        extent: largest extent of the structure.
        entry: (k,) for each condition the number of its support in `supports.entries`; -1: an anchor, or the axis.
        blocks: (k,) local number of its node.
        directions: (k, d) its unit direction.
        conditions: (k, size) sparse, the conditions on the displacements of this rank.
    """

    def __init__(self, supports: Supports, V: fem.FunctionSpace) -> None:
        self.supports, self.V, self.comm = supports, V, supports.domain.comm
        self.d = V.dofmap.bs
        self.size = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        self.extent = float(np.ptp(supports.domain.joint.points, axis=0).max())
        self._sources = [
            self._source(number, place, axis, value)
            for number, (place, components) in enumerate(supports.entries)
            for axis, value in components.items()
        ]
        if any(one.axis == NORMAL for one in self._sources) and not self._nodal:
            raise ModelError("supports along normals need nodal displacements, not elements S2; use Q2 or P2")
        self._find_conditions()

    # ---------------------------------------------------------------- conditions
    def _source(self, entry: int, place: Place, axis: str, given: Value) -> _Source:
        value, expression = fem.Function(self.V), self.supports.functions.get((entry, axis))
        if expression is not None:
            points = interpolation_points(self.V)
            return _Source(entry, place, axis, value, fem.Expression(expression, points))
        if given:
            value.interpolate(lambda x: np.full((self.d, x.shape[1]), float(given)))  # type: ignore[arg-type]
        return _Source(entry, place, axis, value, None)

    def _find_conditions(self) -> None:
        """Find the conditions on this rank: source, the degree of freedom that has the value, and direction."""
        d, axes = self.d, self.supports.axes
        clamped = range(len(self.supports.given), len(self.supports.entries))
        whole = np.zeros(self.size, bool)  # what clamped facets hold
        source: list[Numbers] = []
        dof: list[Numbers] = []
        direction: list[Numbers] = []
        for number, one in enumerate(self._sources):
            if one.axis == NORMAL:
                continue
            dofs = np.unique(self.supports.dofs(self.V, one.place, one.axis))
            dofs = dofs[dofs < self.size]
            whole[dofs] |= one.entry in clamped
            source.append(np.full(len(dofs), number))
            dof.append(dofs)
            direction.append(np.tile(np.eye(d)[axes.index(one.axis)], (len(dofs), 1)))
        for others in (self.supports.anchors(self.V), self.supports.axis(self.V)):  # zero by themselves
            owned = others[others < self.size]
            source.append(np.full(len(owned), -1))
            dof.append(owned)
            direction.append(np.eye(d)[owned % d])
        for some, numbers in zip(self._normal_conditions(), (source, dof, direction), strict=True):
            numbers.append(some)
        self._source_of, self._dof, self.directions = (
            np.concatenate(source).astype(np.int64), np.concatenate(dof).astype(np.int64), np.concatenate(direction)
        )  # fmt: skip
        entry = np.array([*(one.entry for one in self._sources), -1])[self._source_of]
        block = self._dof // d
        held_by_base = whole.reshape(-1, d)[block]
        kept = np.isin(entry, clamped) | ~((np.abs(self.directions) > 0) & held_by_base).any(axis=1)
        self.entry, self._source_of, self._dof, self.directions = (
            array[kept] for array in (entry, self._source_of, self._dof, self.directions)
        )
        self.blocks = self._dof // d
        row = np.repeat(np.arange(len(self.entry)), d)
        column = (self.blocks[:, None] * d + np.arange(d)).ravel()
        self.conditions = scipy.sparse.csr_matrix(
            (self.directions.ravel(), (row, column)), (len(self.entry), self.size)
        )
        self.conditions.eliminate_zeros()

    def _normal_conditions(self) -> tuple[Array, Array, Array]:
        """Conditions along normals: source, degree of freedom, direction."""
        d = self.d
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

    # ---------------------------------------------------------------- values
    @property
    def varies(self) -> npt.NDArray[np.bool_]:
        """(k,) whether the value of a condition is a function."""
        return np.array([*(one.expression is not None for one in self._sources), False])[self._source_of]

    def values(self, t: float) -> Array:
        """Values (k,) of the conditions at a time, possibly not finite. Collective."""
        values = np.zeros(len(self.entry))
        with self.supports.at.clock.at(t):
            for number, one in enumerate(self._sources):
                if one.expression is not None:
                    one.value.interpolate(one.expression)
                    one.value.x.scatter_forward()
                rows = self._source_of == number
                values[rows] = one.value.x.array[self._dof[rows]]
        return values

    def said(self, row: int, value: float) -> str:
        """Words for a condition and its value."""
        if self._source_of[row] < 0:
            return "on the axis of revolution x = 0"
        one = self._sources[self._source_of[row]]
        return f"{one.place!r} prescribes {one.axis} = {value:.6g}"

    def place_of(self, row: int) -> Array | None:
        """Place (d,) of the node of a condition; None: displacements are not nodal."""
        if not self._nodal:
            return None
        x = self.V.tabulate_dof_coordinates()[self.blocks[row], : self.d]
        return np.where(np.abs(x) > ROUNDING * self.extent, x, 0.0)

    @property
    def _nodal(self) -> bool:
        try:
            self.V.tabulate_dof_coordinates()
        except RuntimeError:
            return False
        return True
