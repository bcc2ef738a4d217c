"""A rectangle that is cut along straight lines: into grains, or by faults that may cross and end inside."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import degrees
from typing import Any, Self

import numpy as np
from scipy.spatial import Voronoi, cKDTree

from forms.base import InputError, is_finite
from forms.temperature import finite
from geometry.periods import SAME_PLACE
from geometry.refusals import place, refuse
from geometry.seam import LEAST_COSINE, Seam
from geometry.shapes.drawing import Drawing, Extent, Shape
from geometry.shapes.sizing import Cells, gmsh
from geometry.topology import BoolArray, FloatArray, IntArray, connected, sums

SIDES = ("BOTTOM", "RIGHT", "TOP", "LEFT")
NEAR = 0.5  # least distance between lines that do not meet, over the cell size there
SHARP = 0.1  # least angle between lines that meet, in radians
SHORT = 0.12  # least side of relaxed grains, over the root of their mean area
EVEN = 3  # steps of points to the centres of their cells
STEPS = 100  # of the relaxation, at most
DECIMALS = 10  # of coordinates that gmsh gets, which are between 1 and 1000


@dataclass(frozen=True)
class CutRectangle(Shape):
    """The rectangle (0, width) x (0, height), cut along lines.

    Attributes:
        width, height: lengths > 0.
        grain: the length that the default cell size divides.
        names: of the lines, those of the four sides first.
        lines: the sides and the lines, which meet in their ends only.
        seams: name of a line that is no side -> which side is up.
        part: name of the parts of the rectangle, which are numbered.
        centres: (n, 2) points of the parts, in the order of their numbers; None: from left to right, then upwards.
    """

    width: float
    height: float
    grain: float
    names: tuple[str, ...]
    lines: Lines
    seams: Mapping[str, Seam]
    part: str
    centres: FloatArray | None = None

    @property
    def lengths(self) -> dict[str, float]:
        """The sides."""
        return {"width": self.width, "height": self.height}

    @property
    def extent(self) -> Extent:
        """The size of grains, or the smaller side, and the longer side."""
        return Extent(self.grain, max(self.width, self.height))

    def scaled(self, factor: float) -> Self:
        """All lengths times a factor; coordinates are rounded."""
        lines = replace(self.lines, points=np.round(self.lines.points * factor, DECIMALS))
        centres = None if self.centres is None else self.centres * factor
        return replace(super().scaled(factor), lines=lines, centres=centres)

    def draw(self) -> Drawing:
        """The rectangle in fragments, with the lines that end in one of them."""
        kernel = gmsh.model.occ
        points = [kernel.addPoint(x, y, 0.0) for x, y in self.lines.points]
        curves = [(1, kernel.addLine(points[a], points[b])) for a, b in self.lines.ends]
        whole = kernel.addRectangle(0.0, 0.0, 0.0, self.width, self.height)
        _, (parts, *drawn) = kernel.fragment([(2, whole)], curves)
        kernel.synchronize()
        facets: dict[str, list[int]] = {}
        for line, found in zip(self.lines.line, drawn, strict=True):
            facets.setdefault(self.names[line], []).extend(tag for _, tag in found)
        tags = np.array([tag for _, tag in parts])
        order = self._order(np.array([kernel.getCenterOfMass(2, tag)[:2] for tag in tags]))
        bodies = {f"{self.part} {k + 1}": [int(tag)] for k, tag in enumerate(tags[order])}
        return Drawing(bodies, facets, [], {}, self.seams)

    def _order(self, middles: FloatArray) -> IntArray:
        """The order of the parts with these centres of mass."""
        if self.centres is None:
            return np.lexsort(np.round(middles / self.extent.span, DECIMALS).T[::-1])
        return np.argsort(cKDTree(self.centres).query(middles)[1])


def faulted(cells: Cells, width: float, height: float, faults: Mapping[str, Any]) -> CutRectangle:
    """A block with faults: name -> points, from one end to the other. Raises InputError, see `builders.faults`."""
    cells.check({"width": width, "height": height}, 2)
    if not isinstance(faults, Mapping) or not faults:
        raise InputError(f"faults is {faults!r}; it must be {{name: points of the fault}}, one or more")
    _check_names(faults, "fault")
    given = {name: _path(name, points) for name, points in faults.items()}
    ways = {name: x[-1] - x[0] for name, x in given.items()}
    seams = {name: Seam(direction=(-float(way[1]), float(way[0]))) for name, way in ways.items()}
    pieces = [np.stack([x[:-1], x[1:]], axis=1) for x in given.values()]
    of_piece = np.repeat(np.arange(len(given)), [len(piece) for piece in pieces])
    names = (*SIDES, *(list(given)[k] for k in of_piece))
    lines = _inside(width, height, np.concatenate(pieces), names)
    for name in given:
        if not any(names[k] == name for k in lines.line):
            raise InputError(f"the fault {name!r} lies outside the block (0, {width:g}) x (0, {height:g})")
    shape = CutRectangle(cells, width, height, min(width, height), names, lines, seams, "BLOCK")
    return _apart(shape, "faults", "let them meet, draw them farther apart, or use smaller cells")


def _check_names(names: Iterable[Any], what: str) -> None:
    """Raise InputError for names that lines inside cannot have."""
    for name in names:
        if name in SIDES or not isinstance(name, str):
            raise InputError(f"{name!r} cannot be the name of a {what}; not allowed: {', '.join(SIDES)}")


def _points(given: Any, what: str) -> FloatArray:
    """(n, 2) points; raises InputError."""
    if (x := finite(given, (-1, 2))) is None or len(x) < 2:
        raise InputError(f"{what} is {given!r}; it must be two points (x, y) or more")
    return x


def _path(name: str, points: Any) -> FloatArray:
    """(n, 2) points of a fault that does not turn back; raises InputError."""
    x = _points(points, f"the fault {name!r}")
    way, whole = np.diff(x, axis=0), x[-1] - x[0]
    if not way.any(axis=1).all():
        raise InputError(f"two points of the fault {name!r} that follow each other are the same")
    back = way @ whole <= LEAST_COSINE * np.linalg.norm(way, axis=1) * np.linalg.norm(whole)
    reason = "so that its left side cannot be told by one vector; give its parts names of their own"
    refuse(back, x[:-1], f"the fault {name!r} turns back at {{at}}, {reason}")
    return x


def _inside(width: float, height: float, cuts: FloatArray, names: Sequence[str]) -> Lines:
    """The sides and the parts of lines (n, 2, 2) inside; raises InputError for lines that lie on each other."""
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    tolerance = SAME_PLACE * max(width, height)
    lines = Lines.of(np.concatenate([sides, cuts]), tolerance)
    x = lines.middles
    outside = (x < -tolerance) | (x > np.array([width, height]) + tolerance)
    lines = lines.where(np.asarray(~outside.any(axis=1)))
    double = lines.doubles()
    if len(double):
        one, other = (names[lines.line[k]] for k in double[0])
        raise InputError(f"{one!r} and {other!r} lie on each other at {place(lines.middles[double[0, 0]])}")
    return lines


def _apart(shape: CutRectangle, what: str, remedy: str) -> CutRectangle:
    """The shape; raises InputError for lines that nearly touch, or meet at a sharp angle."""
    size = shape.sizes[2]
    distance, at = shape.lines.nearest()
    if distance < NEAR * size:
        touch = f"{what} nearly touch each other or a side, or are as short, at {place(at)}"
        raise InputError(f"{touch}: {distance:.3g}, less than {NEAR:g} cells of size {size:g}; {remedy}")
    angle, at = shape.lines.sharpest()
    if angle < SHARP:
        meet = f"{what} meet each other or a side at {degrees(angle):.3g} degrees at {place(at)}"
        raise InputError(f"{meet}; allowed: at least {degrees(SHARP):.3g}")
    return shape


def grained(
    cells: Cells, width: float, height: float, grains: Any, seed: int, seams: Callable[[int, int], str] | None
) -> CutRectangle:
    """Voronoi grains of given points, or of random ones. Raises InputError, see `builders.grains`."""
    cells.check({"width": width, "height": height}, 2)
    size = max(width, height)
    box = np.array([width, height]) / size
    if np.ndim(grains) == 0:
        if not is_finite(grains) or grains != int(grains) or grains < 2:
            raise InputError(f"grains is {grains!r}; it must be a whole number >= 2, or points (x, y)")
        if not is_finite(seed) or seed != int(seed) or seed < 0:
            raise InputError(f"seed is {seed!r}; it must be a whole number >= 0")
        points = _relaxed(np.random.default_rng(int(seed)).random((int(grains), 2)) * box, box)
    else:
        points = np.asarray(_seeds(grains, width, height) / size, float)
    ridges, pairs = _ridges(points, box)
    named = [seams(int(a), int(b)) for a, b in pairs + 1] if seams else ["S"] * len(pairs)
    _check_names(named, "seam")
    names = (*SIDES, *named)
    lines = _inside(width, height, ridges * size, names)
    grain = size * float(np.sqrt(box.prod() / len(points)))
    sides = {name: Seam() for name in sorted(set(named))}
    shape = CutRectangle(cells, width, height, grain, names, lines, sides, "GRAIN", points * size)
    return _apart(shape, "boundaries of grains", "use smaller cells, another seed or other points")


def _seeds(given: Any, width: float, height: float) -> FloatArray:
    """(n, 2) points of grains; raises InputError."""
    x = _points(given, "grains")
    box = f"the rectangle (0, {width:g}) x (0, {height:g})"
    refuse(~((x > 0) & (x < (width, height))).all(axis=1), x, f"the point {{at}} of a grain is not inside {box}")
    same = cKDTree(x).query_pairs(SAME_PLACE * max(width, height), output_type="ndarray")
    if len(same):
        raise InputError(f"two points of grains are the same, {place(x[same[0, 0]])}")
    return x


def _ridges(points: FloatArray, box: FloatArray) -> tuple[FloatArray, IntArray]:
    """(m, 2, 2) sides between the Voronoi cells of points in the box (0, box), and (m, 2) the cells they are between."""
    cells = _voronoi(points, box)
    pairs = np.sort(cells.ridge_points, axis=1)
    inner = pairs[:, 1] < len(points)
    ends = np.array([cells.ridge_vertices[k] for k in np.flatnonzero(inner)])
    x = cells.vertices[ends]
    long = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) > SAME_PLACE
    order = np.lexsort(pairs[inner][long].T[::-1])
    return x[long][order], pairs[inner][long][order]


def _voronoi(points: FloatArray, box: FloatArray) -> Voronoi:
    """Voronoi cells of points and of their mirror images beyond the four sides, which the sides are between."""
    images = [points]
    for axis in (0, 1):
        for side in (0.0, box[axis]):
            image = points.copy()
            image[:, axis] = 2 * side - image[:, axis]
            images.append(image)
    return Voronoi(np.concatenate(images))


def _relaxed(points: FloatArray, box: FloatArray) -> FloatArray:
    """Points moved to the centres of their cells a few times, then towards each other across short sides of their cells.

    This makes such a side longer.
    """
    n, size = len(points), float(np.sqrt(box.prod() / len(points)))
    for _ in range(EVEN):
        points = _centres(points, box)
    for _ in range(STEPS):
        cells = _voronoi(points, box)
        pairs, x = cells.ridge_points, cells.vertices[np.array(cells.ridge_vertices)]
        short = (pairs.min(axis=1) < n) & (np.linalg.norm(x[:, 1] - x[:, 0], axis=1) < SHORT * size)
        if not short.any():
            break
        one, other = pairs[short].T
        way = cells.points[other] - cells.points[one]
        way *= SHORT * size / 2 / np.linalg.norm(way, axis=1)[:, None]
        count = len(cells.points)
        points = points + (sums(one, way, count) - sums(other, way, count))[:n]
    return points


def _centres(points: FloatArray, box: FloatArray) -> FloatArray:
    """(n, 2) centres of the areas of the Voronoi cells of points."""
    cells, n = _voronoi(points, box), len(points)
    one, other = cells.ridge_points.T
    ends = np.array(cells.ridge_vertices)
    own, ends = np.concatenate([one, other]), np.concatenate([ends, ends])
    kept = (own < n) & (ends >= 0).all(axis=1)
    own, x = own[kept], cells.vertices[ends[kept]]
    to = x - points[own][:, None]
    area = np.abs(to[:, 0, 0] * to[:, 1, 1] - to[:, 0, 1] * to[:, 1, 0])  # twice that of a triangle over the point
    moment = area[:, None] * to.sum(axis=1) / 3
    return np.asarray(points + sums(own, moment, n) / np.bincount(own, area, n)[:, None])


@dataclass(frozen=True)
class Lines:
    """Segments that have only ends in common.

    Attributes:
        points: (n, 2) ends of segments, coordinates.
        ends: (m, 2) the two points of each segment, in the direction of its line.
        line: (m,) the line that each segment is a part of.
    """

    points: FloatArray
    ends: IntArray
    line: IntArray

    @classmethod
    def of(cls, lines: FloatArray, tolerance: float) -> Self:
        """Lines (k, 2, 2), given by their ends, parted at all points where two of them meet.

        Points as near to each other as the tolerance, a length, are one; so is a point and the place on a line beside it.
        """
        x = np.concatenate([lines.reshape(-1, 2), _crossings(lines)])
        pairs = cKDTree(x).query_pairs(tolerance, output_type="ndarray").reshape(-1, 2)
        _, first = np.unique(connected(pairs[:, 0], pairs[:, 1], len(x)), return_index=True)
        points = x[np.sort(first)]
        share, distance = _feet(points, lines)
        near = distance <= 2 * tolerance
        line, point = np.nonzero(near.T)
        order = np.lexsort((share.T[line, point], line))
        line, point = line[order], point[order]
        same = line[1:] == line[:-1]
        return cls(points, np.column_stack([point[:-1], point[1:]])[same], line[1:][same])

    def where(self, kept: BoolArray) -> Self:
        """A part of the segments, and their ends."""
        used, ends = np.unique(self.ends[kept], return_inverse=True)
        return type(self)(self.points[used], ends.reshape(-1, 2), self.line[kept])

    @property
    def middles(self) -> FloatArray:
        """(m, 2) the middle of each segment."""
        return self.points[self.ends].mean(axis=1)

    def doubles(self) -> IntArray:
        """(n, 2) pairs of segments with the same ends, on different lines that lie on each other."""
        ends = np.sort(self.ends, axis=1)
        order = np.lexsort(ends.T)
        same = (np.diff(ends[order], axis=0) == 0).all(axis=1)
        return np.column_stack([order[:-1], order[1:]])[same]

    def nearest(self) -> tuple[float, FloatArray]:
        """The least distance of a point from a segment that does not end there, or length of a segment; its place (2,)."""
        a, b = self.points[self.ends].swapaxes(0, 1)
        share, distance = _feet(self.points, np.stack([a, b], axis=1))
        every = np.arange(len(a))
        distance[self.ends.T, every] = np.inf
        point, segment = np.unravel_index(distance.argmin(), distance.shape)
        length = np.linalg.norm(b - a, axis=1)
        if length.min() <= distance[point, segment]:
            return float(length.min()), self.middles[length.argmin()]
        foot = a[segment] + share[point, segment] * (b - a)[segment]
        return float(distance[point, segment]), (foot + self.points[point]) / 2

    def sharpest(self) -> tuple[float, FloatArray]:
        """The least angle between two segments that meet, in radians, and where they do (2,)."""
        start = np.concatenate([self.ends, self.ends[:, ::-1]])
        way = self.points[start[:, 1]] - self.points[start[:, 0]]
        angle = np.arctan2(way[:, 1], way[:, 0])
        order = np.lexsort((angle, start[:, 0]))
        at, angle = start[order, 0], angle[order]
        first, last, every = np.searchsorted(at, at), np.searchsorted(at, at, "right") - 1, np.arange(len(at))
        after = np.where(every == last, first, every + 1)
        gap = np.where(first == last, 2 * np.pi, (angle[after] - angle) % (2 * np.pi))
        k = gap.argmin()
        return float(gap[k]), self.points[at[k]]


def _crossings(lines: FloatArray) -> FloatArray:
    """(n, 2) places inside two lines (k, 2, 2), where they cross."""
    start, way = lines[:, 0], lines[:, 1] - lines[:, 0]
    one, other = np.triu_indices(len(lines), 1)
    apart = start[other] - start[one]
    turn = _cross(way[one], way[other])
    parallel = turn == 0
    turn = np.where(parallel, 1.0, turn)
    s, t = _cross(apart, way[other]) / turn, _cross(apart, way[one]) / turn
    inside = ~parallel & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    return np.asarray(start[one[inside]] + s[inside, None] * way[one[inside]])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _feet(points: FloatArray, lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, k) where on each line the place next to each point is, as a share of its length, and how far the point is."""
    start, way = lines[:, 0], lines[:, 1] - lines[:, 0]
    to = points[:, None] - start
    share = np.clip((to * way).sum(axis=2) / (way**2).sum(axis=1), 0.0, 1.0)
    return share, np.linalg.norm(to - share[..., None] * way, axis=2)
