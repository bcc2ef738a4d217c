"""gmsh builders of the paper's shapes: a block on a rigid base (Figs. 2, 5, 7) and two stacked bodies (Fig. 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import gmsh
import numpy as np
from mpi4py import MPI

from geometry.joint import GeometryError, Joint, S, unknown
from geometry.parallel import on_root
from geometry.topology import IntArray

ARRANGEMENTS = ("Left", "Right", "AlternateLeft", "AlternateRight")
CELLS = ("triangle", "quadrilateral")
GROWTH = 0.3  # cell size gained per unit of distance from a refined place
RANGE = 1e-5  # smallest cell size allowed, in units of the shape's own size


def block(
    width: float,
    height: float,
    h: float | None = None,
    *,
    h_S: float | None = None,
    h_ends: float | None = None,
    cell: str = "triangle",
    structured: bool = False,
    arrangement: str = "Right",
    comm: MPI.Intracomm | None = None,
) -> Joint:
    """A rectangular body (0, width) x (0, height) standing on a rigid base; S is its bottom side. Collective.

    Args:
        width, height: size, lengths > 0.
        h: largest cell size, a length (default: a tenth of the smaller side).
        h_S: cell size at S (default: h).
        h_ends: cell size at the ends of S (default: h_S).
        cell: "triangle" or "quadrilateral"; quadrilaterals are always structured.
        structured: whether triangles halve the cells of a grid; grids are graded in one direction each.
        arrangement: which diagonals halve the grid's cells, "Left", "Right", "AlternateLeft" or "AlternateRight".
        comm: communicator whose rank 0 runs gmsh (default: the world).

    Returns:
        Region "BODY"; facets "S", "TOP", "LEFT", "RIGHT".

    Raises:
        GeometryError: a size is not positive, a name is unknown.
    """
    shape = _Rectangles(width, (("BODY", height),), h, h_S, h_ends, cell, structured, arrangement)
    return on_root(comm, shape.build)


def sandwich(
    width: float,
    lower: float,
    upper: float,
    h: float | None = None,
    *,
    h_S: float | None = None,
    h_ends: float | None = None,
    cell: str = "triangle",
    structured: bool = False,
    arrangement: str = "Right",
    comm: MPI.Intracomm | None = None,
) -> Joint:
    """Two rectangular bodies, stacked: (0, width) x (-lower, 0) and (0, width) x (0, upper); S at height 0. Collective.

    Args:
        width, lower, upper: width and heights of the two bodies, lengths > 0.
        h, h_S, h_ends, cell, structured, arrangement, comm: as in `block`.

    Returns:
        Regions "LOWER", "UPPER"; facets "S", "BOTTOM", "TOP", "LEFT", "RIGHT".

    Raises:
        GeometryError: a size is not positive, a name is unknown.
    """
    shape = _Rectangles(width, (("LOWER", lower), ("UPPER", upper)), h, h_S, h_ends, cell, structured, arrangement)
    return on_root(comm, shape.build)


@dataclass(frozen=True)
class _Rectangles:
    """One or two rectangles on top of each other, S at height 0."""

    width: float
    bodies: tuple[tuple[str, float], ...]
    h: float | None
    h_S: float | None
    h_ends: float | None
    cell: str
    structured: bool
    arrangement: str

    def __post_init__(self) -> None:
        sizes = {"width": self.width, **{f"height of {name}": height for name, height in self.bodies}}
        for what, value in sizes.items():
            if not np.isfinite(value) or value <= 0:
                raise GeometryError(f"{what} is {value}; it must be > 0")
        smallest = RANGE * max(sizes.values())
        for what, size in {"h": self.h, "h_S": self.h_S, "h_ends": self.h_ends}.items():
            if size is not None and not (np.isfinite(size) and smallest <= size <= max(sizes.values())):
                raise GeometryError(f"cell size {what} is {size}; allowed: {smallest:g} to {max(sizes.values()):g}")
        if self.cell not in CELLS:
            raise GeometryError(unknown("cell", self.cell, CELLS))
        if self.arrangement not in ARRANGEMENTS:
            raise GeometryError(unknown("arrangement", self.arrangement, ARRANGEMENTS))

    @property
    def sizes(self) -> tuple[float, float, float]:
        """(h, h_S, h_ends) with their defaults."""
        h = self.h or min(self.width, *(height for _, height in self.bodies)) / 10
        h_S = self.h_S or h
        return h, h_S, self.h_ends or h_S

    def build(self) -> Joint:
        """Mesh with gmsh and take the arrays over."""
        gmsh.initialize(interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.model.add("joint")
            surfaces, curves = self._draw()
            if self.structured or self.cell == "quadrilateral":
                self._set_grid(surfaces, curves)
            else:
                self._set_sizes(curves[S])
            gmsh.model.mesh.generate(2)
            return self._read(surfaces, curves)
        finally:
            gmsh.finalize()

    def _draw(self) -> tuple[dict[str, int], dict[str, list[int]]]:
        """Rectangles; surfaces by body, curves by name (S's ends are its curve's)."""
        kernel = gmsh.model.geo
        two = len(self.bodies) == 2
        heights = [-self.bodies[0][1], 0.0, self.bodies[1][1]] if two else [0.0, self.bodies[0][1]]
        corners = [[kernel.addPoint(x, y, 0) for x in (0.0, self.width)] for y in heights]
        across = [kernel.addLine(left, right) for left, right in corners]
        rise = [[kernel.addLine(a[k], b[k]) for k in (0, 1)] for a, b in pairwise(corners)]
        curves = {"LEFT": [r[0] for r in rise], "RIGHT": [r[1] for r in rise], "TOP": [across[-1]], S: [across[-2]]}
        if two:
            curves["BOTTOM"] = [across[0]]
        surfaces = {}
        for k, (name, _) in enumerate(self.bodies):
            loop = kernel.addCurveLoop([across[k], rise[k][1], -across[k + 1], -rise[k][0]])
            surfaces[name] = kernel.addPlaneSurface([loop])
        kernel.synchronize()
        return surfaces, curves

    def _set_sizes(self, s: Sequence[int]) -> None:
        """Size fields: h_ends at the ends of S, h_S on it, growing to h."""
        h, h_S, h_ends = self.sizes
        field = gmsh.model.mesh.field
        places = [
            ("CurvesList", s, h_S),
            ("PointsList", [p for _, p in gmsh.model.getBoundary([(1, c) for c in s], oriented=False)], h_ends),
        ]
        thresholds = []
        for kind, where, size in places:
            distance = field.add("Distance")
            field.setNumbers(distance, kind, where)
            field.setNumber(distance, "Sampling", min(20000, int(4 * self.width / h_S)))
            threshold = field.add("MathEval")
            field.setString(threshold, "F", f"{size!r} + {GROWTH!r} * F{distance}")
            thresholds.append(threshold)
        smallest = field.add("Min")
        field.setNumbers(smallest, "FieldsList", thresholds)
        field.setAsBackgroundMesh(smallest)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        for source in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{source}", 0)

    def _set_grid(self, surfaces: dict[str, int], curves: dict[str, list[int]]) -> None:
        """A grid: cells from h_S at S to h away from it, from h_ends at the ends of S to h_S in its middle."""
        h, h_S, h_ends = self.sizes
        mesh = gmsh.model.mesh
        n, ratio = _geometric(self.width / 2, h_ends, h_S)
        n = max(1, round(self.width / h_S)) if ratio == 1 else 2 * n
        for curve in curves["TOP"] + curves[S] + curves.get("BOTTOM", []):
            mesh.setTransfiniteCurve(curve, n + 1, *(("Bump", h_ends / h_S) if ratio != 1 else ()))
        for side in ("LEFT", "RIGHT"):
            for k, (_, height) in enumerate(self.bodies):
                m, growth = _geometric(height, h_S, h)
                upwards = growth if len(self.bodies) == 1 or k == 1 else 1 / growth
                mesh.setTransfiniteCurve(curves[side][k], m + 1, "Progression", upwards)
        for surface in surfaces.values():
            mesh.setTransfiniteSurface(surface, self.arrangement)
            if self.cell == "quadrilateral":
                mesh.setRecombine(2, surface)

    def _read(self, surfaces: dict[str, int], curves: dict[str, list[int]]) -> Joint:
        mesh = gmsh.model.mesh
        nodes, x, _ = mesh.getNodes()
        kind, corners = (2, [0, 1, 2]) if self.cell == "triangle" else (3, [0, 1, 3, 2])
        cells = [
            mesh.getElementsByType(kind, tag)[1].reshape(-1, len(corners))[:, corners] for tag in surfaces.values()
        ]
        facets = {
            name: np.concatenate([mesh.getElementsByType(1, c)[1] for c in tags]).reshape(-1, 2)
            for name, tags in curves.items()
        }
        used = np.unique(np.concatenate(cells))
        points = x.reshape(-1, 3)[np.argsort(nodes), :2][np.searchsorted(np.sort(nodes), used)]

        def number(rows: Any) -> IntArray:
            return np.searchsorted(used, rows).astype(np.int64)

        names = tuple(surfaces)
        region = np.repeat(np.arange(len(cells)), [len(c) for c in cells])
        return Joint(
            points,
            number(np.concatenate(cells)),
            self.cell,
            region,
            names,
            {name: number(rows) for name, rows in facets.items()},
            upper=names[-1:],
            lower=names[:-1],
        )


def _geometric(length: float, first: float, last: float) -> tuple[int, float]:
    """Number of cells and growth factor of a geometric grading from size `first` to size `last` over a length."""
    if first == last:
        return max(1, round(length / first)), 1.0
    n = max(2, round(1 + np.log(last / first) / np.log((length - first) / (length - last))))
    return n, float((last / first) ** (1 / (n - 1)))
