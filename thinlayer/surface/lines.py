"""Lines on S by arc length: the pieces of seams in 2D, and where a plane cuts them in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import basix
import numpy as np
import numpy.typing as npt

from forms.temperature import finite
from geometry.joint import Joint
from geometry.order import by_place
from geometry.topology import IntArray, is_tensor, lagrange
from thinlayer.errors import ModelError
from thinlayer.system.table import Table

Array = npt.NDArray[np.float64]
Plane = tuple[Sequence[float], Sequence[float]]
SAME = 1e-12  # difference of values, over the largest, and of places, over the size, that counts as none
ARC_DEGREE = 8  # of the quadrature for the length of a curved facet


@dataclass(frozen=True)
class Line:
    """Values along a line on S, the same on all ranks.

    It has no branches and does not go beyond a tip, an end or a junction of its own seam. Where values jump, there are two
    rows with the same s.

    Attributes:
        seam: name of the seam.
        s: (n,) arc length from the start of the line.
        x: (n, d) places.
        values: (n,), or (n, components) of a vector.
        closed: whether it returns to its start; the last row is then the first one, at s = the length of the line.
    """

    seam: str
    s: Array
    x: Array
    values: Array
    closed: bool

    @property
    def length(self) -> float:
        """Length of the line."""
        return float(self.s[-1])

    def crossings(self, level: float) -> Array:
        """(k, d) places where values (n,) cross a level: the front of a phase, the end of a zone."""
        above = self.values - level
        k = np.flatnonzero(above[:-1] * above[1:] < 0)
        share = (above[k] / (above[k] - above[k + 1]))[:, None]
        return np.asarray(self.x[k] + share * (self.x[k + 1] - self.x[k]))

    def table(self, name: str = "value") -> Table:
        """Columns s, x, y (z) and `name`, or "name x", "name y", ... of a vector; `write` makes a csv file of it."""
        values = self.values.reshape(len(self.s), -1)
        names = [name] if values.shape[1] == 1 else [f"{name} {axis}" for axis in "xyz"[: values.shape[1]]]
        columns = ["s", *"xyz"[: self.x.shape[1]], *names]
        return Table(
            dict(zip(columns, map(float, row), strict=True)) for row in np.column_stack([self.s, self.x, values])
        )


@dataclass(frozen=True)
class Segments:
    """Parts of lines, (m,) of them, with two ends each.

    Attributes:
        keys: (m, 2) number of what segments share that are joined.
        x: (m, 2, d) places of the ends.
        values: (m, 2, components).
        lengths: (m,).
    """

    keys: IntArray
    x: Array
    values: Array
    lengths: Array

    def lines(self, seam: str, size: float) -> list[Line]:
        """The lines that they form, ordered by the places at which they start (`by_place`).

        A line starts at the lower of its ends; a closed one at its lowest place, towards the lower of its neighbours.
        """
        x, ends = self.x.reshape(-1, self.x.shape[2]), self.keys.ravel()
        rank = np.empty(len(ends), np.int64)  # of a place; equal keys are at one place
        _, first, number = np.unique(ends, return_index=True, return_inverse=True)
        rank[:] = np.argsort(by_place(x[first], size))[number.ravel()]
        ranks = rank.reshape(-1, 2)
        at: dict[int, list[int]] = {}
        for segment, pair in enumerate(ranks):
            for end in pair:
                at.setdefault(int(end), []).append(segment)
        left, found = set(range(len(ranks))), []
        for closed in (False, True):
            for start in sorted(at):
                for segment in sorted(at[start], key=lambda k: int(ranks[k].sum())):
                    if segment in left and (closed or len(at[start]) != 2):
                        found.append((start, self._line(start, segment, at, ranks, left, seam, size)))
        return [line for _, line in sorted(found, key=lambda one: one[0])]

    def _line(
        self,
        start: int,
        segment: int,
        at: dict[int, list[int]],
        ranks: IntArray,
        left: set[int],
        seam: str,
        size: float,
    ) -> Line:
        """The line from a place on, which begins with a segment; takes its segments from those that are `left`."""
        here, way = start, list[tuple[int, int]]()
        while True:
            left.remove(segment)
            side = int(ranks[segment, 0] != here)
            way.append((segment, side))
            here = int(ranks[segment, 1 - side])
            onwards = [k for k in at[here] if k in left]
            if len(at[here]) != 2 or not onwards:
                break
            segment = onwards[0]
        segments, sides = np.array(way).T
        order = np.stack([sides, 1 - sides], axis=1)
        s = np.concatenate([[0.0], np.cumsum(self.lengths[segments])])
        along = np.stack([s[:-1], s[1:]], axis=1).ravel()
        x, values = (
            np.take_along_axis(one[segments], order[..., None], axis=1).reshape(2 * len(way), -1)
            for one in (self.x, self.values)
        )
        moved = np.diff(along, prepend=-np.inf) > SAME * size
        jumps = np.abs(np.diff(values, axis=0, prepend=np.nan)).max(axis=1) > SAME * np.abs(self.values).max(
            initial=0.0
        )
        kept = moved | jumps
        return Line(seam, along[kept], x[kept], values[kept], here == start and len(at[start]) == 2)


def lines_on(joint: Joint, seam: str, rows: IntArray, values: Array, plane: Plane | None) -> list[Line]:
    """The lines of a seam.

    Args:
        joint: the joint.
        seam: name of the seam.
        rows: (n,) rows of its facets in the joint's table.
        values: (n, k) or (n, k, components) at the vertices of the table's rows.
        plane: in 3D the plane that cuts S.
    """
    of_corners = values.reshape(*values.shape[:2], -1)
    cut = seam_segments(joint, rows, of_corners) if plane is None else cut_segments(joint, rows, of_corners, plane)
    lines = cut.lines(seam, float(np.ptp(joint.points, axis=0).max()))
    return lines if values.ndim == 3 else [replace(one, values=one.values[:, 0]) for one in lines]


def require_plane(plane: Plane | None, dim: int) -> None:
    """Raise ModelError for a plane in 2D, or none in 3D."""
    if (plane is None) != (dim == 2):
        hint = "in 2D S is a line" if dim == 2 else "in 3D lines on S are cuts by a plane: plane=(point, normal)"
        raise ModelError(f"plane is {plane!r}; {hint}")


def seam_segments(joint: Joint, rows: IntArray, values: Array) -> Segments:
    """The facets of S in 2D.

    Args:
        joint: the joint.
        rows: (m,) rows of the joint's table of facets.
        values: (m, 2, components) at the vertices of the table's rows.
    """
    vertices = joint.table.vertices[rows]
    nodes = joint.table.nodes(rows, joint.cells, joint.cell_type)
    points, weights = basix.make_quadrature(basix.CellType.interval, ARC_DEGREE)
    slopes = lagrange("interval", joint.degree).tabulate(1, points)[1, :, :, 0]
    lengths = np.linalg.norm(np.einsum("qn,fnd->fqd", slopes, joint.points[nodes]), axis=2) @ weights
    return Segments(vertices, joint.points[vertices], values, lengths)


def cut_segments(joint: Joint, rows: IntArray, values: Array, plane: Plane) -> Segments:
    """Where a plane cuts facets of S in 3D, taken as straight between vertices; arguments as in `seam_segments`."""
    point, normal = _plane(plane)
    vertices = joint.table.vertices[rows]
    corners = joint.table.nodes(rows, joint.corners, joint.cell_type)
    ring = corners[:, [0, 1, 3, 2] if is_tensor(joint.cell_type) else [0, 1, 2]]
    column = (vertices[:, None] == ring[:, :, None]).argmax(axis=2)
    values = np.take_along_axis(values, column[..., None], axis=1)
    x = joint.points[ring]
    height = (x - point) @ normal
    height[np.abs(height) <= SAME * np.ptp(joint.points, axis=0).max()] = 0.0
    for above in (height >= 0, height > 0):  # a plane along facets: those on one side of it are cut, at their edges
        found = _crossed(ring, x, values, height, above)
        if len(found.keys):
            return found
    return found


def _crossed(ring: IntArray, x: Array, values: Array, height: Array, above: npt.NDArray[np.bool_]) -> Segments:
    after = np.roll(np.arange(ring.shape[1]), -1)
    crossed = above != above[:, after]
    facets = np.flatnonzero(crossed.sum(axis=1) == 2)
    edge = np.argsort(~crossed[facets], axis=1, kind="stable")[:, :2]
    row, ends = facets[:, None], np.stack([edge, after[edge]])
    share = height[row, ends[0]] / (height[row, ends[0]] - height[row, ends[1]])

    def between(nodal: Array) -> Array:
        return nodal[row, ends[0]] + share[..., None] * (nodal[row, ends[1]] - nodal[row, ends[0]])

    _, keys = np.unique(np.sort(ring[row, ends], axis=0).reshape(2, -1), axis=1, return_inverse=True)
    places = between(x)
    return Segments(keys.reshape(-1, 2), places, between(values), np.linalg.norm(places[:, 1] - places[:, 0], axis=1))


def _plane(plane: object) -> tuple[Array, Array]:
    """Point and unit normal of a plane; raises ModelError."""
    both = finite(plane, (2, 3))
    if both is None or not both[1].any():
        raise ModelError(
            f"plane is {plane!r}; it needs (point, normal), three finite numbers each, and a normal that is not zero"
        )
    return both[0], both[1] / np.linalg.norm(both[1])
