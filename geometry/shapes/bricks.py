"""Walls of bricks in running bond, and the cell that repeats in them, on grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import ceil

import numpy as np

from forms.base import is_finite
from geometry.errors import GeometryError
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.shapes.sizing import DIGITS, Cells
from geometry.topology import FacetTable, FloatArray, IntArray, is_tensor

BED, HEAD = "BED", "HEAD"
SIDES = (("LEFT", "RIGHT"), ("BOTTOM", "TOP"), ("BACK", "FRONT"))  # at the least and the largest place along each axis


@dataclass(frozen=True)
class Bricks:
    """A wall of bricks; in every other course they are shifted by half a brick, and the ends are half bricks.

    Attributes:
        cells: the requested cells.
        size: lengths of a brick along each axis, > 0.
        bricks, courses: number of bricks in a course, and of courses.
    """

    cells: Cells
    size: tuple[float, ...]
    bricks: int
    courses: int

    def build(self) -> Joint:
        """The joint; raises GeometryError for sizes and numbers that are out of range."""
        self._check()
        h, kind = self.cells.h or min(self.size) / 4, self._kind
        half, *others = (max(1, ceil(round(length / h, DIGITS))) for length in (self.size[0] / 2, *self.size[1:]))
        counts = [2 * half * self.bricks, others[0] * self.courses, *others[1:]]
        lengths = [self.size[0] * self.bricks, self.size[1] * self.courses, *self.size[2:]]
        points, cells, at = _grid(lengths, counts, kind)
        course = at[:, 1] // others[0]
        brick = (at[:, 0] + half * (course % 2)) // (2 * half)
        return _joined(points, cells, kind, lengths, course, brick, course)

    @property
    def _kind(self) -> str:
        return _kind(self.cells, self.size)

    def _check(self) -> None:
        _check_size(self.cells, self.size)
        for what, number in (("bricks", self.bricks), ("courses", self.courses)):
            if not is_finite(number) or number != int(number) or number < 1:
                raise GeometryError(f"{what} is {number!r}; it must be a whole number >= 1")
        if self.bricks * self.courses == 1:
            raise GeometryError("one brick is no wall: there is no joint in it")


@dataclass(frozen=True)
class BondCell:
    """The cell that repeats in a running bond: one brick wide and two courses high, cut through bricks.

    Attributes:
        cells: the requested cells.
        size: lengths of a brick along each axis, > 0.
        cut: place of the cell's left lower corner in a brick, as shares of its width and height, between 0 and 1.
    """

    cells: Cells
    size: tuple[float, ...]
    cut: tuple[float, float]

    def build(self) -> Joint:
        """The joint, not yet periodic; raises GeometryError for sizes that are out of range and cuts along joints."""
        _check_size(self.cells, self.size)
        h, kind = self.cells.h or min(self.size) / 4, _kind(self.cells, self.size)
        half, height, *others = (ceil(round(length / h, DIGITS)) for length in (self.size[0] / 2, *self.size[1:]))
        half, height, others = max(2, half), max(2, height), [max(1, n) for n in others]
        across, up = self._cut(half, height)
        counts, lengths = [2 * half, 2 * height, *others], [self.size[0], 2 * self.size[1], *self.size[2:]]
        points, cells, at = _grid(lengths, counts, kind)
        course = (at[:, 1] + up) // height
        brick = (at[:, 0] + across + half * (course % 2)) // (2 * half)
        return _joined(points, cells, kind, lengths, course, brick, course % 2)

    def _cut(self, half: int, height: int) -> tuple[int, int]:
        """The cut in cells, from the left lower corner of a brick."""
        if np.shape(self.cut) != (2,) or not all(is_finite(c) and 0 < c < 1 for c in self.cut):
            raise GeometryError(
                f"cut is {self.cut!r}; it must be two shares of a brick's width and height, between 0 and 1"
            )
        across, up = round(2 * half * self.cut[0]), round(height * self.cut[1])
        if across % half == 0 or up % height == 0:
            raise GeometryError(
                f"cut is {tuple(self.cut)}, which is along a joint of a grid with {2 * half} x {height} cells in a brick: "
                "the cells on its two sides would be no neighbours in the mesh; cut through bricks"
            )
        return across, up


def _kind(cells: Cells, size: Sequence[float]) -> str:
    return cells.kind or {2: "quadrilateral", 3: "hexahedron"}[len(size)]


def _check_size(cells: Cells, size: Sequence[float]) -> None:
    names = ("width", "height", "depth")
    cells.check({f"{name} of a brick": a for name, a in zip(names, size, strict=False)}, len(size))


def _joined(
    points: FloatArray,
    cells: IntArray,
    kind: str,
    lengths: Sequence[float],
    course: IntArray,
    brick: IntArray,
    region: IntArray,
) -> Joint:
    """The joint of a grid, with beds between courses, heads between the bricks of a course, and its sides."""
    d = len(lengths)
    table = FacetTable.of(cells, kind)
    first, second = table.cells.T
    cut = (second >= 0) & ((course[first] != course[second]) | (brick[first] != brick[second]))
    beds = cut & (course[first] != course[second])
    facets = {BED: table.vertices[beds], HEAD: table.vertices[cut & ~beds]}
    x = points[table.vertices]
    for k, names in enumerate(SIDES[:d]):
        for name, end in zip(names, (0.0, lengths[k]), strict=True):
            facets[name] = table.vertices[(second < 0) & (x[..., k] == end).all(axis=1)]
    up, along = (tuple(float(k == axis) for k in range(d)) for axis in (1, 0))
    seams = {BED: Seam(direction=up), HEAD: Seam(direction=along)}
    seams = {name: seam for name, seam in seams.items() if len(facets[name])}
    regions = tuple(f"COURSE {k + 1}" for k in range(int(region.max()) + 1))
    return Joint(points, cells, kind, region, regions, {k: v for k, v in facets.items() if len(v)}, seams)


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
