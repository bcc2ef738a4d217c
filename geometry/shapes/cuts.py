"""Rectangles that are cut along straight lines into regions: grains, or blocks between faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial import Voronoi, cKDTree

from forms.base import InputError, is_integer, require
from forms.temperature import finite_values
from geometry.identified_sides import DISTANCE_TOLERANCE
from geometry.refusals import refuse
from geometry.seam import MIN_COSINE, Seam
from geometry.shapes.drawing import Drawing, Shape, SizeRules
from geometry.shapes.sizing import MeshOptions, gmsh
from geometry.sheet import vectors_from_segments
from geometry.topology import BoolArray, FloatArray, IntArray, sum_by_number

SIDE_NAMES = ("BOTTOM", "RIGHT", "TOP", "LEFT")
MIN_LINE_DISTANCE = 0.5  # least distance between lines that do not meet, over the cell size there
MIN_GRAIN_SIDE_RATIO = 0.12  # least side of relaxed grains, over the root of their mean area
LLOYD_STEPS = 3  # number of steps that move points to the centres of their cells
MAX_RELAXATION_STEPS = 100  # largest number of relaxation steps
COORDINATE_DECIMALS = 10  # decimals of coordinates passed to gmsh, the largest between 1 and 1000


Places = Sequence[tuple[float, float]]
SeamNamer = Callable[[int, int], str]  # numbers of two parts that touch -> name of their seam


@dataclass(frozen=True)
class CutRectangle(Shape):
    """The rectangle (0, width) x (0, height), cut along straight lines into parts, which are its cell regions.

    Attributes:
        width, height: lengths > 0.
        feature_size: the default cell size is a tenth of this length.
        cut_lines: (n, 2, 2) coordinates of the two ends of each of n lines. Lines may cross each other and the sides.
        seam_names: (n,) name of the seam that each line belongs to.
        seams: name of a seam -> choice of its upper side.
        body_word: word in the names of the parts, such as "GRAIN" in "GRAIN 1".
        part_points: (n_parts, 2) a point in each part, in the order of the parts' numbers; None: parts are numbered
            from left to right, then upwards.
    """

    width: float
    height: float
    feature_size: float
    cut_lines: FloatArray
    seam_names: Sequence[str]
    seams: Mapping[str, Seam]
    body_word: str
    part_points: FloatArray | None = None

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: width and height."""
        return {"width": self.width, "height": self.height}

    @property
    def size_rules(self) -> SizeRules:
        """Lengths from which the cell sizes follow: `feature_size`, and the longer side of the rectangle."""
        return SizeRules(self.feature_size, max(self.width, self.height))

    @property
    def lines(self) -> FloatArray:
        """(4 + n, 2, 2) coordinates of the two ends of each line: first the four sides, then the n lines `cut_lines`."""
        corners = np.array([[0.0, 0.0], [self.width, 0.0], [self.width, self.height], [0.0, self.height]])
        return np.concatenate([np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), self.cut_lines])

    def is_inside(self, x: FloatArray, margin: float) -> BoolArray:
        """Return (n,) whether each of n places lies in the rectangle and is farther than `margin` from its sides.

        Args:
            x: (n, 2) coordinates of the places, lengths.
            margin: the distance, a length; if negative, places up to this distance outside are included.
        """
        return np.asarray(((x > margin) & (x < np.array([self.width, self.height]) - margin)).all(axis=1))

    def draw(self) -> Drawing:
        """Draw the parts of the rectangle and the lines between them in the current gmsh model.

        A line that ends inside a part is drawn in full.

        Returns:
            The regions, and the facet sets of the sides and seams, by name.

        Raises:
            InputError: a fault lies outside the rectangle.
        """
        kernel, tolerance = gmsh.model.occ, DISTANCE_TOLERANCE * self.size_rules.span
        gmsh.option.setNumber("Geometry.ToleranceBoolean", tolerance)
        ends = [kernel.addPoint(x, y, 0.0) for x, y in np.round(self.lines, COORDINATE_DECIMALS).reshape(-1, 2)]
        curves = [(1, kernel.addLine(*point_pair)) for point_pair in zip(ends[::2], ends[1::2], strict=True)]
        rectangle = kernel.addRectangle(0.0, 0.0, 0.0, self.width, self.height)
        _, (surfaces, *line_pieces) = kernel.fragment([(2, rectangle)], curves)
        kernel.synchronize()
        facets: dict[str, list[int]] = {}
        for name, pieces in zip((*SIDE_NAMES, *self.seam_names), line_pieces, strict=True):
            line_tags = np.array([tag for _, tag in pieces])
            is_kept = self.is_inside(np.array([kernel.getCenterOfMass(1, tag)[:2] for tag in line_tags]), tolerance)
            facets.setdefault(name, []).extend(map(int, line_tags if name in SIDE_NAMES else line_tags[is_kept]))
        for name in (name for name in self.seams if not facets[name]):
            raise InputError(f"the fault {name!r} lies outside the block")
        surface_tags = np.array([tag for _, tag in surfaces])
        middles = np.array([kernel.getCenterOfMass(2, tag)[:2] for tag in surface_tags])
        order = np.lexsort(np.round(middles / self.size_rules.span, COORDINATE_DECIMALS).T[::-1])
        if self.part_points is not None:
            order = np.argsort(cKDTree(self.part_points).query(middles)[1])
        bodies = {f"{self.body_word} {k + 1}": [int(tag)] for k, tag in enumerate(surface_tags[order])}
        return Drawing(bodies, facets, [], {}, self.seams)

    def require_apart(self, noun: str, remedy: str) -> Self:
        """Return this shape; raise InputError if a line ends near another line, or near a side, without touching it.

        A line is near if its distance is less than half the cell size at ends of S.

        Args:
            noun: noun for the lines, for the message.
            remedy: advice for the message.
        """
        end_size, lines, tolerance = self.sizes[2], self.lines, DISTANCE_TOLERANCE * self.size_rules.span
        ends = lines.reshape(-1, 2)
        points = ends[self.is_inside(ends, -tolerance)]
        vectors = vectors_from_segments(points, lines[:, 0], lines[:, 1])
        distance = np.linalg.norm(vectors, axis=2)
        distance[distance <= 2 * tolerance] = np.inf
        point, line = np.unravel_index(distance.argmin(), distance.shape)
        at, gap = points[point] - vectors[point, line] / 2, distance[point, line]
        touch = f"{noun} nearly touch each other or a side at {{at}}: {gap:.3g}, less than {MIN_LINE_DISTANCE:g} cells"
        refuse(gap < MIN_LINE_DISTANCE * end_size, at[None], f"{touch} of size {end_size:g}; {remedy}")
        return self


def faulted_rectangle(opts: MeshOptions, width: float, height: float, faults: Mapping[str, Places]) -> CutRectangle:
    """Return a block that is cut by faults.

    Args:
        opts: requested cell sizes.
        width, height: size of the block, lengths > 0.
        faults: name of a fault -> points (x, y) from one of its ends to the other.

    Raises:
        InputError: sizes or faults are out of range; a fault turns back, or ends near another fault or a side without
            touching it.
    """
    opts.check({"width": width, "height": height}, 2)
    if not isinstance(faults, Mapping) or not faults:
        raise InputError(f"faults is {faults!r}; it must be {{name: points of the fault}}, one or more")
    paths = {name: _fault_points(name, points) for name, points in faults.items()}
    seams = {name: Seam(direction=(-float(x[-1, 1] - x[0, 1]), float(x[-1, 0] - x[0, 0]))) for name, x in paths.items()}
    seam_names = [name for name, x in paths.items() for _ in x[1:]]
    cut_lines = np.concatenate([np.stack([x[:-1], x[1:]], axis=1) for x in paths.values()])
    shape = CutRectangle(opts, width, height, min(width, height), cut_lines, seam_names, seams, "BLOCK")
    return shape.require_apart("faults", "let them meet, draw them farther apart, or use smaller cells")


def _checked_points(points: object, noun: str) -> FloatArray:
    """Return points (x, y) as an array (n, 2), n >= 2.

    Args:
        points: the points, as the user gave them.
        noun: noun for the points, for the message.

    Raises:
        InputError: these are not two or more finite points.
    """
    if (x := finite_values(points, (-1, 2))) is None or len(x) < 2:
        raise InputError(f"{noun} is {points!r}; it must be two points (x, y) or more")
    return x


def _fault_points(name: str, points: object) -> FloatArray:
    """Return the points of a fault as an array (n, 2), from its first to its last end.

    Args:
        name: name of the fault, for messages.
        points: its points (x, y), as the user gave them.

    Raises:
        InputError: these are not two or more finite points, or the fault turns back: a piece of it does not lead
            towards the last point.
    """
    x = _checked_points(points, f"the fault {name!r}")
    steps, chord = np.diff(x, axis=0), x[-1] - x[0]
    back = steps @ chord <= MIN_COSINE * np.linalg.norm(steps, axis=1) * np.linalg.norm(chord)
    refuse(back, x[:-1], f"the fault {name!r} turns back at {{at}}; give its parts before and after it different names")
    return x


def grain_rectangle(
    opts: MeshOptions, width: float, height: float, grains: int | Places, seed: int, seams: SeamNamer | None
) -> CutRectangle:
    """Return a rectangle that is filled with Voronoi grains.

    Args:
        opts: requested cell sizes.
        width, height: size of the rectangle, lengths > 0.
        grains: number of grains at random points, or the points (x, y) of the grains.
        seed: whole number >= 0 for random points; the same seed gives the same grains.
        seams: function of the numbers, from 1, of two grains that touch; it returns the name of their seam. None: "S".

    Raises:
        InputError: sizes or numbers are out of range; points lie outside, or two coincide; a side of a grain is too
            short.
    """
    opts.check({"width": width, "height": height}, 2)
    size = max(width, height)
    box = np.array([width, height]) / size
    if (point_count := np.asarray(grains)).ndim == 0:
        require(is_integer(grains, 2), "grains", grains, "it must be a whole number >= 2, or points (x, y)")
        require(is_integer(seed, 0), "seed", seed, "it must be a whole number >= 0")
        points = _relaxed_points(np.random.default_rng(int(seed)).random((int(point_count), 2)) * box, box)
    else:
        points = np.asarray(_grain_points(grains, width, height) / size, float)
    lines, grain_pairs = _grain_boundaries(points, box)
    seam_names = [seams(int(a), int(b)) for a, b in grain_pairs + 1] if seams else ["S"] * len(grain_pairs)
    mean_width = size * float(np.sqrt(box.prod() / len(points)))
    rules = {name: Seam() for name in sorted(set(seam_names))}
    shape = CutRectangle(opts, width, height, mean_width, lines * size, seam_names, rules, "GRAIN", points * size)
    return shape.require_apart("boundaries of grains", "use smaller cells, another seed or other points")


def _grain_points(points: object, width: float, height: float) -> FloatArray:
    """Return the points of grains as an array (n, 2).

    Args:
        points: points (x, y), as the user gave them.
        width, height: size of the rectangle, lengths.

    Raises:
        InputError: a point is not inside the rectangle, or two points coincide.
    """
    x = _checked_points(points, "grains")
    box = f"the rectangle (0, {width:g}) x (0, {height:g})"
    refuse(~((x > 0) & (x < (width, height))).all(axis=1), x, f"the point {{at}} of a grain is not inside {box}")
    coincident = cKDTree(x).query_pairs(DISTANCE_TOLERANCE * max(width, height), output_type="ndarray")
    refuse(np.ones(len(coincident), bool), x[coincident[:, 0]], "two points of grains are the same, {at}")
    return x


def _grain_boundaries(points: FloatArray, box: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the straight lines between the Voronoi cells of points in a rectangle.

    Args:
        points: (n, 2) coordinates of the points.
        box: width and height of the rectangle, whose lower left corner is the origin.

    Returns:
        (m, 2, 2) coordinates of the two ends of each line, and (m, 2) numbers, from 0, of the cells on both sides of
        it.
    """
    diagram = _voronoi_diagram(points, box)
    pairs = np.sort(diagram.ridge_points, axis=1)
    is_inner = pairs[:, 1] < len(points)
    x = diagram.vertices[np.array([diagram.ridge_vertices[k] for k in np.flatnonzero(is_inner)])]
    is_long = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) > DISTANCE_TOLERANCE
    order = np.lexsort(pairs[is_inner][is_long].T[::-1])
    return x[is_long][order], pairs[is_inner][is_long][order]


def _voronoi_diagram(points: FloatArray, box: FloatArray) -> Voronoi:
    """Return a Voronoi diagram in which the sides of a rectangle bound the cells of the points in it.

    It has also the cells of the points' mirror images at the four sides, which come after those of the points.

    Args:
        points: (n, 2) coordinates of points in the rectangle.
        box: width and height of the rectangle, whose lower left corner is the origin.
    """
    mirrors = [(axis, side) for axis in (0, 1) for side in (0.0, box[axis])]
    images = [np.where(np.arange(2) == axis, 2 * side - points, points) for axis, side in mirrors]
    return Voronoi(np.concatenate([points, *images]))


def _relaxed_points(points: FloatArray, box: FloatArray) -> FloatArray:
    """Return (n, 2) points that are moved until their Voronoi cells in a rectangle have no short sides.

    Points move to the centroids of their cells a few times. Then, if the side between two cells is short, their points
    move towards each other, which makes the side longer. This ends after a largest number of steps.

    Args:
        points: (n, 2) coordinates of the points.
        box: width and height of the rectangle, whose lower left corner is the origin.
    """
    n, size = len(points), float(np.sqrt(box.prod() / len(points)))
    for _ in range(LLOYD_STEPS):
        points = _cell_centroids(points, box)
    for _ in range(MAX_RELAXATION_STEPS):
        diagram = _voronoi_diagram(points, box)
        pairs, x = diagram.ridge_points, diagram.vertices[np.array(diagram.ridge_vertices)]
        is_short = (pairs.min(axis=1) < n) & (np.linalg.norm(x[:, 1] - x[:, 0], axis=1) < MIN_GRAIN_SIDE_RATIO * size)
        if not is_short.any():
            break
        first, other = pairs[is_short].T
        offsets = diagram.points[other] - diagram.points[first]
        offsets *= MIN_GRAIN_SIDE_RATIO * size / 2 / np.linalg.norm(offsets, axis=1)[:, None]
        count = len(diagram.points)
        points = points + (sum_by_number(first, offsets, count) - sum_by_number(other, offsets, count))[:n]
    return points


def _cell_centroids(points: FloatArray, box: FloatArray) -> FloatArray:
    """Return (n, 2) centroids of the Voronoi cells of n points in a rectangle.

    Args:
        points: (n, 2) coordinates of the points.
        box: width and height of the rectangle, whose lower left corner is the origin.
    """
    diagram, n = _voronoi_diagram(points, box), len(points)
    first, other = diagram.ridge_points.T
    cell, ends = np.concatenate([first, other]), np.tile(diagram.ridge_vertices, (2, 1))
    is_finite = (cell < n) & (ends >= 0).all(axis=1)
    cell, x = cell[is_finite], diagram.vertices[ends[is_finite]]
    to = x - points[cell][:, None]
    area = np.abs(to[:, 0, 0] * to[:, 1, 1] - to[:, 0, 1] * to[:, 1, 0])  # twice the area of a triangle with the point
    moment = area[:, None] * to.sum(axis=1) / 3
    return np.asarray(points + sum_by_number(cell, moment, n) / np.bincount(cell, area, n)[:, None])
