"""Values along lines on S by arc length: the pieces of seams in 2D, and the cuts of seams by a plane in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import basix
import numpy as np

from forms.base import Array, InputError, require
from forms.temperature import finite_values
from geometry.joint import Joint
from geometry.topology import BoolArray, IntArray, components, curve_order, lagrange, place_order
from thinlayer.system.table import Table

Plane = tuple[Sequence[float], Sequence[float]]
LINE_TOLERANCE = 1e-12  # difference of values over the largest, or of coordinates over the size, that counts as zero
ARC_QUADRATURE_DEGREE = 8  # quadrature degree for the length of a curved facet


@dataclass(frozen=True)
class Line:
    """Values at n points along a line on S, the same on all ranks; d: number of dimensions.

    The line has no branches. It ends where its seam ends, branches or crosses itself. Where the values jump, two
    successive points have the same arc length.

    Attributes:
        seam: name of the seam, the part of S on which the line lies.
        s: (n,) arc length from the start of the line.
        x: (n, d) coordinates of the points.
        values: (n,) values, or (n, components) of a vector.
        closed: whether the line returns to its start; the last point is then the first one, at s = `length`.
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
        """Return the coordinates (k, d) of the k points where scalar values cross the number `level`.

        Such a point may be the end of a sliding zone. Values are linear between the points of the line.
        """
        difference = self.values - level
        k = np.flatnonzero(difference[:-1] * difference[1:] < 0)
        fraction = difference[k] / (difference[k] - difference[k + 1])
        return np.asarray(self.x[k] + fraction[:, None] * (self.x[k + 1] - self.x[k]))

    def table(self, name: str = "value") -> Table:
        """Return a table with a row for each point, for `Table.write` to a csv file.

        Its columns are s, x, y, in 3D z, and `name`. The values of a vector have the columns "name x", "name y", ...
        """
        values = self.values.reshape(len(self.s), -1)
        names = [name] if values.shape[1] == 1 else [f"{name} {axis}" for axis in "xyz"[: values.shape[1]]]
        columns = ["s", *"xyz"[: self.x.shape[1]], *names]
        return Table.of(dict(zip(columns, np.column_stack([self.s, self.x, values]).T, strict=True)))


@dataclass(frozen=True)
class Segments:
    """Line segments, m of them, with values at both ends of each; d: number of dimensions.

    Attributes:
        end_numbers: (m, 2) numbers of the ends; segments with the same number at an end are joined there.
        x: (m, 2, d) coordinates of the ends.
        values: (m, 2, components) values at the ends.
        lengths: (m,) lengths of the segments.
    """

    end_numbers: IntArray
    x: Array
    values: Array
    lengths: Array

    def join_to_lines(self, seam: str, size: float) -> list[Line]:
        """Join the segments to lines, ordered by the coordinates of their start points, then of their end points.

        A line starts at its lower end: the one with the smaller first coordinate or, if these are equal, the smaller
        next one. A closed line starts at its lowest point in this sense. It goes on to the lower neighbour of that
        point.

        Args:
            seam: name of the seam.
            size: size of the structure, for rounding errors of coordinates.
        """
        end_numbers = np.unique(self.end_numbers, return_inverse=True)[1].reshape(-1, 2)
        is_end = np.bincount(end_numbers.ravel())[end_numbers] != 2  # lines end where not exactly two segments meet
        end_numbers[is_end] = end_numbers.max(initial=-1) + 1 + np.arange(is_end.sum())
        _, first_rows, ends = np.unique(end_numbers, return_index=True, return_inverse=True)
        ends, x = ends.reshape(-1, 2), self.x.reshape(-1, self.x.shape[2])[first_rows]
        line_of = components(ends[:, 0], ends[:, 1], len(x))
        lines = [self._join(seam, np.flatnonzero(line_of[ends[:, 0]] == k), ends, x, size) for k in np.unique(line_of)]
        end_x = np.array([polyline.x[[0, -1]].ravel() for polyline in lines]).reshape(len(lines), 2 * x.shape[1])
        return [lines[k] for k in place_order(end_x, size)]

    def _join(self, seam: str, rows: IntArray, ends: IntArray, x: Array, size: float) -> Line:
        """Join some segments, which form one line without branches, in their order along it.

        Args:
            seam: name of the seam.
            rows: positions, among all m segments, of the segments of the line.
            ends: (m, 2) rows of `x` with the coordinates of the ends of all m segments.
            x: (n, d) coordinates of the n distinct ends.
            size: size of the structure, for rounding errors of coordinates.
        """
        points, ends = np.unique(ends[rows], return_inverse=True)
        ends, closed = ends.reshape(-1, 2), len(points) == len(rows)
        position = np.argsort(curve_order(x[points], ends, size))[ends]
        closes_line = closed & (np.abs(position[:, 0] - position[:, 1]) > 1)  # leads back to the start
        is_reversed = (position[:, 0] > position[:, 1]) != closes_line
        order = np.argsort(np.where(closes_line, len(points), position.min(axis=1)))
        rows, is_reversed = rows[order], is_reversed[order]
        s = np.cumsum([0.0, *self.lengths[rows]])
        s = np.stack([s[:-1], s[1:]], axis=1).ravel()
        end_order = np.stack([is_reversed, ~is_reversed], axis=1).astype(int)[..., None]
        arrays = self.x[rows], self.values[rows]
        x, values = (np.take_along_axis(array, end_order, axis=1).reshape(len(s), -1) for array in arrays)
        largest_value = np.abs(self.values).max(initial=0.0)
        is_jump = np.abs(np.diff(values, axis=0, prepend=np.nan)).max(axis=1) > LINE_TOLERANCE * largest_value
        is_kept = is_jump | (np.diff(s, prepend=-np.inf) > LINE_TOLERANCE * size)
        return Line(seam, s[is_kept], x[is_kept], values[is_kept], closed)


def lines_on(joint: Joint, seam: str, facet_rows: IntArray, values: Array, plane: Plane | None) -> list[Line]:
    """Return the values along the pieces of a seam in 2D, or along the lines in which a plane cuts it in 3D.

    Args:
        joint: the joint, the undistributed mesh of the bodies.
        seam: name of the seam.
        facet_rows: (n,) positions of the seam's facets in `joint.surface`.
        values: values (n, k), or (n, k, components) of a vector, at the k corners of each facet.
        plane: in 3D the plane that cuts S, as a point and a normal, ((x, y, z), (n_x, n_y, n_z)); None in 2D.

    Raises:
        InputError: a plane is given in 2D. Or in 3D no plane is given, or an invalid one.
    """
    hint = "in 2D S is a line" if joint.dim == 2 else "in 3D lines on S are cuts by a plane: plane=(point, normal)"
    require((plane is None) == (joint.dim == 2), "plane", plane, hint)
    corner_values, nodes = values.reshape(*values.shape[:2], -1), joint.surface[facet_rows]
    if plane is None:
        points, weights = basix.make_quadrature(basix.CellType.interval, ARC_QUADRATURE_DEGREE)
        derivatives = lagrange("interval", joint.degree).tabulate(1, points)[1, :, :, 0]
        lengths = np.linalg.norm(np.einsum("qn,fnd->fqd", derivatives, joint.points[nodes]), axis=2) @ weights
        segments = Segments(nodes[:, :2], joint.points[nodes[:, :2]], corner_values, lengths)
    else:
        segments = cut_segments(joint, nodes, corner_values, plane)
    lines = segments.join_to_lines(seam, joint.size)
    return lines if values.ndim == 3 else [replace(line, values=line.values[:, 0]) for line in lines]


def cut_segments(joint: Joint, nodes: IntArray, values: Array, plane: Plane) -> Segments:
    """Return the line segments in which a plane cuts facets in 3D, with interpolated values at their ends.

    Args:
        joint: the joint, the undistributed mesh of the bodies.
        nodes: (n, a) numbers, in the joint, of the a nodes of each of n facets, corners first. Curved facets are taken
            as straight.
        values: (n, k, components) values at the k corners of each facet.
        plane: a point and a normal of the plane, ((x, y, z), (n_x, n_y, n_z)).

    Raises:
        InputError: the plane is not two vectors of three finite numbers, or the normal is zero.
    """
    if (plane_data := finite_values(plane, (2, 3))) is None or not plane_data[1].any():
        raise InputError(f"plane is {plane!r}; it must be (point, normal), three finite numbers each, not all zero")
    corners = nodes[:, : values.shape[1]]
    heights = (joint.points[corners] - plane_data[0]) @ plane_data[1] / np.linalg.norm(plane_data[1])
    heights[np.abs(heights) <= LINE_TOLERANCE * joint.size] = 0.0
    segments = _cut_facets(joint, corners, values, heights, heights >= 0)
    # if facets lie in the plane, facets on one side are cut at their edges
    return segments if len(segments.end_numbers) else _cut_facets(joint, corners, values, heights, heights > 0)


def level_points(joint: Joint, seam: str, facet_rows: IntArray, heights: Array) -> Array:
    """Return the points (k, d) of a seam where numbers at corners, linear on facets, change sign; in 3D along lines.

    Args:
        joint: the joint, the undistributed mesh of the bodies.
        seam: name of the seam.
        facet_rows: (n,) positions of the seam's facets in `joint.surface`.
        heights: (n, k) numbers at the k corners of each facet.
    """
    corners = joint.surface[facet_rows][:, : heights.shape[1]]
    segments = _cut_facets(joint, corners, np.zeros((*heights.shape, 1)), heights, heights >= 0)
    if joint.dim == 3:
        return np.concatenate([np.empty((0, 3)), *(line.x for line in segments.join_to_lines(seam, joint.size))])
    points = segments.x[:, 0]
    return np.asarray(points[place_order(points, joint.size)])


def _cut_facets(joint: Joint, corners: IntArray, values: Array, heights: Array, is_above: BoolArray) -> Segments:
    """Return the segments of facets along which `heights`, linear on their edges, are zero; in 2D both ends coincide."""
    ring = [0, 1, 3, 2] if corners.shape[1] == 4 else [*range(corners.shape[1])]  # in the order around a facet
    ring_nodes, values, heights, is_above = corners[:, ring], values[:, ring], heights[:, ring], is_above[:, ring]
    x, next_corner = joint.points[ring_nodes], np.roll(np.arange(len(ring)), -1)
    is_cut = is_above != is_above[:, next_corner]
    facets = np.flatnonzero(is_cut.sum(axis=1) == 2)
    cut_edges = np.argsort(~is_cut[facets], axis=1, kind="stable")[:, :2]
    row, edge_ends = facets[:, None], np.stack([cut_edges, next_corner[cut_edges]])
    fraction = heights[row, edge_ends[0]] / (heights[row, edge_ends[0]] - heights[row, edge_ends[1]])
    first, last = (np.concatenate([x, values], axis=2)[row, end] for end in edge_ends)
    end_x, cut_values = np.split(first + fraction[..., None] * (last - first), [x.shape[2]], axis=2)
    _, end_numbers = np.unique(np.sort(ring_nodes[row, edge_ends], axis=0).reshape(2, -1), axis=1, return_inverse=True)
    return Segments(end_numbers.reshape(-1, 2), end_x, cut_values, np.linalg.norm(end_x[:, 1] - end_x[:, 0], axis=1))
