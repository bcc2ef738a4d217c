"""Boxes on top of each other; walls of bricks in running bond, and the cell that repeats in them, on grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations, product
from math import ceil

import numpy as np

from forms.base import InputError, is_finite, require
from geometry.joint import Joint
from geometry.seam import S, Seam
from geometry.shapes.drawing import Drawing, Extent, Prism
from geometry.shapes.sizing import DIGITS, Cells, Grading, gmsh
from geometry.topology import FacetTable, FloatArray, IntArray, is_tensor

BED, HEAD = "BED", "HEAD"
SIDES = (("LEFT", "RIGHT"), ("BOTTOM", "TOP"), ("BACK", "FRONT"))  # at the least and the largest place along each axis


@dataclass(frozen=True)
class Boxes(Prism):
    """One or two rectangles on top of each other, in 3D boxes, S at height 0.

    Attributes:
        width: along x, a length > 0.
        bodies: name and height, a length > 0, of each body, the lower one first.
    """

    width: float
    bodies: tuple[tuple[str, float], ...]

    @property
    def lengths(self) -> dict[str, float]:
        """Width, heights and depth."""
        return {"width": self.width, **{f"height of {name}": height for name, height in self.bodies}, **super().lengths}

    @property
    def extent(self) -> Extent:
        """The smallest side, the longest one of S, and the height."""
        return Extent(min(self.lengths.values()), max(self.width, self.depth or 0.0), "abs(y)")

    def draw_plane(self) -> Drawing:
        """Rectangles, the cells of their grid from h_S at S to h away from it, from h_ends at S's ends to h_S between."""
        kernel = gmsh.model.geo
        h, h_S, h_ends = self.sizes
        two = len(self.bodies) == 2
        heights = [-self.bodies[0][1], 0.0, self.bodies[1][1]] if two else [0.0, self.bodies[0][1]]
        corners = [[kernel.addPoint(x, y, 0) for x in (0.0, self.width)] for y in heights]
        across = [kernel.addLine(left, right) for left, right in corners]
        rise = [[kernel.addLine(a[k], b[k]) for k in (0, 1)] for a, b in pairwise(corners)]
        curves = {"LEFT": [r[0] for r in rise], "RIGHT": [r[1] for r in rise], "TOP": [across[-1]], S: [across[-2]]}
        if two:
            curves["BOTTOM"] = [across[0]]
        gradings = dict.fromkeys(across, Grading.of(self.width, h_ends, h_S, symmetric=True))
        surfaces = []
        for k, (_, height) in enumerate(self.bodies):
            loop = kernel.addCurveLoop([across[k], rise[k][1], -across[k + 1], -rise[k][0]])
            surfaces.append(kernel.addPlaneSurface([loop]))
            below = heights[k + 1] == 0.0
            gradings |= dict.fromkeys(rise[k], Grading.of(height, h_S, h, backwards=below))
        kernel.synchronize()
        bodies = {name: [tag] for (name, _), tag in zip(self.bodies, surfaces, strict=True)}
        return Drawing(bodies, curves, surfaces, gradings)


def running_bond(cells: Cells, size: Sequence[float], bricks: int, courses: int) -> Joint:
    """A wall whose bricks are shifted by half in every other course, with half bricks at the ends.

    Args:
        cells: the requested cells.
        size: lengths of a brick along each axis, > 0.
        bricks, courses: number of bricks in a course, and of courses.

    Raises:
        InputError: sizes or numbers are out of range.
    """
    half, height, *others = _counts(cells, size, 1)
    for what, number in (("bricks", bricks), ("courses", courses)):
        require(is_finite(number) and number == int(number) and number >= 1, what, number, "give a whole number >= 1")
    lengths = [size[0] * bricks, size[1] * courses, *size[2:]]
    return _joint(cells, lengths, [2 * half * int(bricks), height * int(courses), *others], (half, height))


def repeated_bond(cells: Cells, size: Sequence[float], cut: tuple[float, float]) -> Joint:
    """The cell that repeats in a running bond, not yet periodic: one brick wide and two courses high, cut through bricks.

    Args:
        cells: the requested cells.
        size: lengths of a brick along each axis, > 0.
        cut: place of the cell's left lower corner in a brick, as shares of its width and height, between 0 and 1.

    Raises:
        InputError: sizes are out of range, or the cut is along a joint.
    """
    half, height, *others = _counts(cells, size, 2)
    if np.shape(cut) != (2,) or not all(is_finite(c) and 0 < c < 1 for c in cut):
        raise InputError(f"cut is {cut!r}; it must be two shares of a brick's width and height, between 0 and 1")
    start = round(2 * half * cut[0]), round(height * cut[1])
    if start[0] % half == 0 or start[1] % height == 0:
        raise InputError(
            f"cut is {tuple(cut)}, which is along a joint of a grid with {2 * half} x {height} cells in a brick: the cells "
            "on its two sides would be no neighbours in the mesh; cut through bricks"
        )
    return _joint(cells, [size[0], 2 * size[1], *size[2:]], [2 * half, 2 * height, *others], (half, height), start)


def _counts(cells: Cells, size: Sequence[float], least: int) -> list[int]:
    """Cells in half a brick along x, in its height, at least so many in each of the two, and in its depth."""
    names = ("width", "height", "depth")
    cells.check({f"{name} of a brick": a for name, a in zip(names, size, strict=False)}, len(size))
    h = cells.h or min(size) / 4
    half, height, *depth = (max(1, ceil(round(length / h, DIGITS))) for length in (size[0] / 2, *size[1:]))
    return [max(least, half), max(least, height), *depth]


def _joint(
    cells: Cells, lengths: Sequence[float], counts: list[int], brick: tuple[int, int], start: tuple[int, int] = (0, 0)
) -> Joint:
    """The joint of a grid, with beds between courses, heads between the bricks of a course, and its sides.

    Args:
        cells: the requested cells.
        lengths, counts: size of the grid along each axis, and its numbers of cells.
        brick: numbers of cells in half a brick along x, and in its height.
        start: the place in a brick where the grid begins, in cells.
    """
    d, (half, height) = len(lengths), brick
    kind = cells.cell or {2: "quadrilateral", 3: "hexahedron"}[d]
    points, rows, at = _grid(lengths, counts, kind)
    course = (at[:, 1] + start[1]) // height
    number = (at[:, 0] + start[0] + half * (course % 2)) // (2 * half)
    region = course % (counts[1] // height)
    table = FacetTable.of(rows, kind)
    first, second = table.cells.T
    beds = (second >= 0) & (course[first] != course[second])
    heads = (second >= 0) & ~beds & (number[first] != number[second])
    facets = {BED: table.vertices[beds], HEAD: table.vertices[heads]}
    x = points[table.vertices]
    for k, names in enumerate(SIDES[:d]):
        for name, end in zip(names, (0.0, lengths[k]), strict=True):
            facets[name] = table.vertices[(second < 0) & (x[..., k] == end).all(axis=1)]
    facets = {name: of_name for name, of_name in facets.items() if len(of_name)}
    ways = {BED: 1, HEAD: 0}
    seams = {name: Seam(direction=tuple(map(float, np.eye(d)[k]))) for name, k in ways.items() if name in facets}
    regions = tuple(f"COURSE {k + 1}" for k in range(int(region.max()) + 1))
    return Joint(points, rows, kind, region, regions, facets, seams)


def _grid(lengths: Sequence[float], counts: Sequence[int], kind: str) -> tuple[FloatArray, IntArray, IntArray]:
    """Points (n, d) of a grid, its cells (m, k), simplices along one diagonal, and their places in the grid (m, d)."""
    axes = [np.linspace(0.0, length, n + 1) for length, n in zip(lengths, counts, strict=True)]
    d, shape = len(axes), [len(axis) for axis in axes]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    number = np.arange(len(points)).reshape(shape)
    inner = [n - 1 for n in shape]
    corners = [
        number[tuple(slice(o, o + n) for o, n in zip(reversed(offset), inner, strict=True))].ravel()
        for offset in product((0, 1), repeat=d)
    ]
    cells = np.column_stack(corners)
    at = np.stack(np.meshgrid(*map(np.arange, inner), indexing="ij"), axis=-1).reshape(-1, d)
    if is_tensor(kind):
        return points, cells, at
    paths = [[sum(1 << axis for axis in way[:k]) for k in range(d + 1)] for way in permutations(range(d))]
    return points, np.concatenate([cells[:, path] for path in paths]), np.tile(at, (len(paths), 1))
