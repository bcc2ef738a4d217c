"""Drawing about an axis: arcs, spokes and the patches between them, nodes of curved cells on circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, isclose, pi, sin, tau

import numpy as np

from geometry.shapes import gmsh
from geometry.topology import FloatArray, IntArray, corner_count, lagrange


@dataclass(frozen=True)
class Web:
    """Arcs about the origin and the spokes between them, from the innermost arc and the first spoke on.

    Attributes:
        arcs: for each radius the curves from one spoke to the next.
        spokes: for each ring between two radii its straight lines.
        patches: for each ring the surfaces between its spokes.
    """

    arcs: list[list[int]]
    spokes: list[list[int]]
    patches: list[list[int]]

    @classmethod
    def drawn(cls, radii: Sequence[float], angle: float, plane: str, *, chords: bool = False) -> Web:
        """Draw a web with gmsh.

        Args:
            radii: radii of the arcs, growing lengths > 0.
            angle: angle of the web from the x axis, in radians, > 0 and at most 2 pi.
            plane: "xy" or "xz".
            chords: whether the innermost arcs are straight lines instead.
        """
        kernel = gmsh.model.geo
        n = 2 if angle <= pi else 4  # gmsh's arcs are shorter than half a circle

        def place(radius: float, turn: float) -> int:
            x, y = radius * cos(turn), radius * sin(turn)
            return kernel.addPoint(*((x, y, 0.0) if plane == "xy" else (x, 0.0, y)))

        def neighbours(row: Sequence[int]) -> list[tuple[int, int]]:
            return list(pairwise([*row, row[0]][: n + 1]))

        centre = place(0.0, 0.0)
        turns = [angle * k / n for k in range(n if is_circle(angle) else n + 1)]
        points = [[place(radius, turn) for turn in turns] for radius in radii]
        arcs = [[kernel.addCircleArc(a, centre, b) for a, b in neighbours(row)] for row in points[chords:]]
        if chords:
            arcs.insert(0, [kernel.addLine(a, b) for a, b in neighbours(points[0])])
        spokes = [[kernel.addLine(a, b) for a, b in zip(*rows, strict=True)] for rows in pairwise(points)]
        patches = []
        for ring, (low, high) in zip(spokes, pairwise(arcs), strict=True):
            sides = zip(low, high, neighbours(ring), strict=True)
            patches.append([surface([start, far, -end, -near]) for near, far, (start, end) in sides])
        return cls(arcs, spokes, patches)


def is_circle(angle: float) -> bool:
    """Whether an angle, in radians, is the full circle."""
    return isclose(angle, tau, rel_tol=1e-8)


def surface(sides: Sequence[int]) -> int:
    """A plane surface bounded by curves, negative where they run backwards, in gmsh's built-in kernel."""
    kernel = gmsh.model.geo
    return int(kernel.addPlaneSurface([kernel.addCurveLoop(sides)]))


def curve_grid(points: FloatArray, cells: IntArray, kind: str, axes: list[int], core: float = 0.0) -> FloatArray:
    """Points of a polar grid of degree 2 whose circles are all curved, less and less towards a straight core.

    gmsh itself curves only cells that touch a circle of the drawing, and would fold thin ones.

    Args:
        points: (n_points, d) coordinates, lengths.
        cells: (n_cells, n_nodes) nodes of degree 2, vertices first.
        kind: "quadrilateral" or "hexahedron".
        axes: the two coordinates in the circles' plane.
        core: radius up to which nodes stay, a length; 0: all circles are curved in full.
    """
    corners = corner_count(kind)
    weights = lagrange(kind, 1).tabulate(0, lagrange(kind, 2).points[corners:])[0, :, :, 0]
    radius = np.hypot(*points[:, axes].T)
    goal = radius.copy()
    goal[cells[:, corners:]] = radius[cells[:, :corners]] @ weights.T
    share = np.clip((radius - core) / (radius.max() - core), 0.0, 1.0) if core else 1.0
    scale = 1 + share * (goal / np.where(radius > 0, radius, 1.0) - 1)
    points = points.copy()
    points[:, axes] *= scale[:, None]
    return points
