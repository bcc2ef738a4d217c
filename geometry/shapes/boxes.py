"""Stacked boxes, walls of bricks in running bond, and the periodic cell of such a wall; grids are made without gmsh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil

import numpy as np

from forms.base import InputError, is_finite, is_integer, require
from geometry.joint import Joint
from geometry.seam import S, Seam
from geometry.shapes.drawing import Drawing, Prism, SizeRules, add_plane_surface
from geometry.shapes.sizing import COUNT_DECIMALS, Grading, MeshOptions, gmsh
from geometry.topology import FacetTable, FloatArray, IntArray, is_tensor

BED, HEAD = "BED", "HEAD"
Pair = tuple[int, int]
# name of a side -> the axis that it is normal to, and its place along this axis
SIDE_PLANES = {"LEFT": (0, 0), "RIGHT": (0, -1), "BOTTOM": (1, 0), "TOP": (1, -1), "BACK": (2, 0), "FRONT": (2, -1)}


@dataclass(frozen=True)
class Boxes(Prism):
    """One rectangle, or two stacked along y, or boxes in 3D; S is the bottom side of the upper (or only) one, at y = 0.

    Attributes:
        width: size along x, a length > 0.
        bodies: name and height (a length > 0) of each body, the lower body first.
    """

    width: float
    bodies: tuple[tuple[str, float], ...]

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: the width, the heights and, in 3D, the depth."""
        return {"width": self.width, **{f"height of {name}": height for name, height in self.bodies}, **super().lengths}

    @property
    def size_rules(self) -> SizeRules:
        """Lengths from which the cell sizes follow: the smallest side of the bodies and the longest side of S."""
        return SizeRules(min(self.lengths.values()), max(self.width, self.depth or 0.0), "abs(y)")

    def draw_plane(self) -> Drawing:
        """Draw the rectangles in the current gmsh model and return their entities by name; not used for grids."""
        kernel = gmsh.model.geo
        heights = [*(-height for _, height in self.bodies[:-1]), 0.0, self.bodies[-1][1]]
        corners = [[kernel.addPoint(x, y, 0) for x in (0.0, self.width)] for y in heights]
        levels = [kernel.addLine(left, right) for left, right in corners]
        sides = [[kernel.addLine(a[k], b[k]) for k in (0, 1)] for a, b in pairwise(corners)]
        curves = {"LEFT": [r[0] for r in sides], "RIGHT": [r[1] for r in sides], "TOP": [levels[-1]], S: [levels[-2]]}
        if len(self.bodies) == 2:
            curves["BOTTOM"] = [levels[0]]
        strips = zip(pairwise(levels), sides, strict=True)
        surfaces = [add_plane_surface([low, right, -high, -left]) for (low, high), (left, right) in strips]
        kernel.synchronize()
        bodies = {name: [tag] for (name, _), tag in zip(self.bodies, surfaces, strict=True)}
        return Drawing(bodies, curves, surfaces, {})

    def _build(self, unit: float) -> Joint:
        """Return the joint on a grid if one is requested, else with gmsh's mesh.

        Cells of a grid grow from h_S at S to h away from it. Along S they grow from h_ends at its ends to h_S.

        Args:
            unit: factor by which all coordinates are multiplied.
        """
        if not self.is_grid:
            return super()._build(unit)
        h, h_S, h_ends = self.sizes
        (*below, (_, height)), names = self.bodies, tuple(name for name, _ in self.bodies)
        y_below = [-Grading.of(lower, h_S, h).positions(lower)[:0:-1] for _, lower in below]
        lengths = (self.width, *([self.depth] if self.depth else []))
        in_plane = [Grading.of(length, h_ends, h_S, symmetric=True).positions(length) for length in lengths]
        axes = [in_plane[0], np.concatenate([*y_below, Grading.of(height, h_S, h).positions(height)]), *in_plane[1:]]
        grid, i_S = BoxGrid([axis * unit for axis in axes], self.kind, self.meshing.arrangement), sum(map(len, y_below))
        facets = grid.side_facets() | {S: grid.facets_at(1, i_S)}
        if not below:
            del facets["BOTTOM"]
        region = (grid.box_positions[:, 1] >= i_S).astype(np.int64) * len(below)
        return Joint(grid.points, grid.cells, self.kind, region, names, facets, {S: Seam(names[:-1], names[-1:])})


@dataclass(frozen=True)
class BoxGrid:
    """A grid of rectangles or boxes, or of the triangles or tetrahedra that divide them.

    Attributes:
        axes: for each axis the increasing coordinates of the grid's points, lengths.
        kind: type of the cells, such as "triangle".
        arrangement: which diagonals halve the rectangles in the x-y plane: "Right", "Left", "AlternateRight" or
            "AlternateLeft", as in `block`.
    """

    axes: Sequence[FloatArray]
    kind: str
    arrangement: str = "Right"

    @property
    def points(self) -> FloatArray:
        """(n, d) coordinates of all points of the grid in d dimensions, sorted by x, then by y, then by z."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, len(self.axes))

    @cached_property
    def _point_numbers(self) -> IntArray:
        """Number in `points` of each point of the grid, as an array with one index for each axis."""
        return np.arange(len(self.points)).reshape([len(axis) for axis in self.axes])

    @cached_property
    def cells(self) -> IntArray:
        """(m, k) numbers of the k points of each of the m cells."""
        plane_cells = self._plane_cells(self._point_numbers.reshape(*self._point_numbers.shape[:2], -1)[..., 0])
        return plane_cells if len(self.axes) == 2 else self._sweep_up(plane_cells)

    @cached_property
    def box_positions(self) -> IntArray:
        """(m, d) position along each of the grid's d axes, from 0, of the box that contains each of the m cells."""
        boxes = np.indices([len(axis) - 1 for axis in self.axes]).reshape(len(self.axes), -1).T
        return np.tile(boxes, (len(self.cells) // len(boxes), 1))

    def facets_at(self, axis: int, index: int) -> IntArray:
        """Return (n, k) numbers of the k points of each facet in one plane of the grid, normal to an axis.

        Args:
            axis: number of the axis, from 0.
            index: position of the plane among the coordinates of this axis, -1 for the last.
        """
        if axis == 2:
            return self._plane_cells(self._point_numbers[:, :, index])
        line = np.moveaxis(self._point_numbers, axis, 0)[index].reshape(self._point_numbers.shape[1 - axis], -1)[:, 0]
        rows = np.column_stack([line[:-1], line[1:]])
        return rows if len(self.axes) == 2 else self._sweep_up(rows)

    def side_facets(self) -> dict[str, IntArray]:
        """Return name of an outer side -> (n, k) numbers of the k points of each of its n facets.

        The names are "LEFT", "RIGHT", "BOTTOM", "TOP", and in 3D "BACK" and "FRONT".
        """
        return {name: self.facets_at(axis, end) for name, (axis, end) in SIDE_PLANES.items() if axis < len(self.axes)}

    def _plane_cells(self, numbers: IntArray) -> IntArray:
        """Return the numbers of the corners of all rectangles in a plane of the grid, or of the triangles in it.

        Args:
            numbers: (n_x, n_y) numbers of the points in the plane, by their positions along its two axes.

        Returns:
            (n, 4) corners of the n rectangles, or (n, 3) corners of the n triangles: two in each rectangle.
        """
        shifts = slice(None, -1), slice(1, None)
        o, x, y, xy = (numbers[shifts[i], shifts[j]].ravel() for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)))
        if is_tensor(self.kind):
            return np.column_stack([o, x, y, xy])
        is_odd = np.indices([n - 1 for n in numbers.shape]).sum(axis=0).ravel() % 2 == 1
        is_left = {"Left": True, "Right": False, "AlternateLeft": is_odd, "AlternateRight": ~is_odd}[self.arrangement]
        halves = ((o, x, xy), (o, y, x)), ((o, y, xy), (y, x, xy))
        return np.concatenate([np.where(is_left, flipped, plain).T for plain, flipped in halves])

    def _sweep_up(self, rows: IntArray) -> IntArray:
        """Return the cells, or facets, that lie above each other over the given ones at z = 0, up to the largest z.

        Args:
            rows: (n, k) numbers of the k points of each facet, or edge, at z = 0. Points above each other have
                consecutive numbers.
        """
        below = (rows[:, None] + np.arange(len(self.axes[2]) - 1)[:, None]).reshape(-1, rows.shape[1])
        if is_tensor(self.kind):
            return np.column_stack([below, below + 1])
        return np.concatenate([np.column_stack([below[:, : k + 1], below[:, k:] + 1]) for k in range(rows.shape[1])])


def running_bond(opts: MeshOptions, size: Sequence[float], bricks: int, courses: int) -> Joint:
    """Return the joint of a wall of bricks in running bond: courses are shifted in turn by half a brick.

    Shifted courses begin and end with half a brick.

    Args:
        opts: requested cell size and type.
        size: sizes of a brick along each axis, lengths > 0.
        bricks, courses: number of bricks in a course, and number of courses.

    Raises:
        InputError: sizes or numbers are out of range.
    """
    n_half, n_high, *n_deep = _cell_counts(opts, size, 1)
    for argument, number in (("bricks", bricks), ("courses", courses)):
        require(is_integer(number, 1), argument, number, "give a whole number >= 1")
    lengths = [size[0] * bricks, size[1] * courses, *size[2:]]
    return _joint(opts, lengths, [2 * n_half * int(bricks), n_high * int(courses), *n_deep], (n_half, n_high))


def repeated_bond(opts: MeshOptions, size: Sequence[float], cut: tuple[float, float]) -> Joint:
    """Return the joint of one period of a running bond: one brick wide, two courses high, cut through bricks.

    Its opposite sides are not yet identified with each other.

    Args:
        opts: requested cell size and type.
        size: sizes of a brick along each axis, lengths > 0.
        cut: place of the lower left corner in a brick, as fractions of the brick's width and height, between 0 and 1.

    Raises:
        InputError: sizes are out of range, or the cut is along a layer of mortar.
    """
    n_half, n_high, *n_deep = _cell_counts(opts, size, 2)
    if np.shape(cut) != (2,) or not all(is_finite(c) and 0 < c < 1 for c in cut):
        raise InputError(f"cut is {cut!r}; it must be two shares of a brick's width and height, between 0 and 1")
    start = round(2 * n_half * cut[0]), round(n_high * cut[1])
    if start[0] % n_half == 0 or start[1] % n_high == 0:
        raise InputError(f"cut is {tuple(cut)}, along a joint of a grid {2 * n_half} x {n_high}; cut through bricks")
    return _joint(opts, [size[0], 2 * size[1], *size[2:]], [2 * n_half, 2 * n_high, *n_deep], (n_half, n_high), start)


def _cell_counts(opts: MeshOptions, size: Sequence[float], min_count: int) -> list[int]:
    """Return the numbers of cells in half the width of a brick, in its height and, in 3D, in its depth.

    Args:
        opts: requested cell size and type.
        size: sizes of a brick along each axis, lengths.
        min_count: least number of cells in half the width of a brick and in its height.
    """
    names = ("width", "height", "depth")
    opts.check({f"{name} of a brick": a for name, a in zip(names, size, strict=False)}, len(size))
    h = opts.h or min(size) / 4
    n_half, n_high, *n_deep = (max(1, ceil(round(length / h, COUNT_DECIMALS))) for length in (size[0] / 2, *size[1:]))
    return [max(min_count, n_half), max(min_count, n_high), *n_deep]


def _joint(opts: MeshOptions, lengths: Sequence[float], counts: list[int], brick: Pair, start: Pair = (0, 0)) -> Joint:
    """Return the joint of a grid of bricks, with the seams "BED" between courses and "HEAD" between bricks of a course.

    Args:
        opts: requested cell type.
        lengths: size of the grid along each axis, lengths.
        counts: number of the grid's cells along each axis.
        brick: number of cells in half the width of a brick, and in its height.
        start: number of cells along x and y from the lower left corner of a brick to that of the grid.
    """
    d, (n_half, n_high) = len(lengths), brick
    cell_type = opts.cell or {2: "quadrilateral", 3: "hexahedron"}[d]
    axes = [np.linspace(0.0, length, n + 1).astype(float) for length, n in zip(lengths, counts, strict=True)]
    grid = BoxGrid(axes, cell_type)
    grid_cells, positions = grid.cells, grid.box_positions
    course = (positions[:, 1] + start[1]) // n_high
    brick_no = (positions[:, 0] + start[0] + n_half * (course % 2)) // (2 * n_half)
    region = course % (counts[1] // n_high)
    table = FacetTable.of(grid_cells, cell_type)
    first, second = table.cells.T
    is_bed = (second >= 0) & (course[first] != course[second])
    is_head = (second >= 0) & ~is_bed & (brick_no[first] != brick_no[second])
    facets = {BED: table.vertices[is_bed], HEAD: table.vertices[is_head], **grid.side_facets()}
    facets = {name: of_name for name, of_name in facets.items() if len(of_name)}
    directions = (BED, np.eye(d)[1]), (HEAD, np.eye(d)[0])
    seams = {name: Seam(direction=tuple(map(float, direction))) for name, direction in directions if name in facets}
    regions = tuple(f"COURSE {k + 1}" for k in range(int(region.max()) + 1))
    return Joint(grid.points, grid_cells, cell_type, region, regions, facets, seams)
