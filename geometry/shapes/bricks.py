"""Walls of bricks in running bond, on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product
from math import ceil

import numpy as np

from forms.base import is_finite
from geometry.joint import GeometryError, Joint, Seam
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
        d, h, kind = len(self.size), self.cells.h or min(self.size) / 4, self._kind
        half, *others = (max(1, ceil(round(length / h, DIGITS))) for length in (self.size[0] / 2, *self.size[1:]))
        counts = [2 * half * self.bricks, others[0] * self.courses, *others[1:]]
        lengths = [self.size[0] * self.bricks, self.size[1] * self.courses, *self.size[2:]]
        points, cells, at = _grid(lengths, counts, kind)
        course = at[:, 1] // others[0]
        brick = (at[:, 0] + half * (course % 2)) // (2 * half)
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
        regions = tuple(f"COURSE {k + 1}" for k in range(self.courses))
        return Joint(points, cells, kind, course, regions, {k: v for k, v in facets.items() if len(v)}, seams)

    @property
    def _kind(self) -> str:
        return self.cells.kind or {2: "quadrilateral", 3: "hexahedron"}[len(self.size)]

    def _check(self) -> None:
        names = ("width", "height", "depth")
        self.cells.check({f"{name} of a brick": a for name, a in zip(names, self.size, strict=False)}, len(self.size))
        for what, number in (("bricks", self.bricks), ("courses", self.courses)):
            if not is_finite(number) or number != int(number) or number < 1:
                raise GeometryError(f"{what} is {number!r}; it must be a whole number >= 1")
        if self.bricks * self.courses == 1:
            raise GeometryError("one brick is no wall: there is no joint in it")


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
