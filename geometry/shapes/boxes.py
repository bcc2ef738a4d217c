"""Rectangles and boxes on top of each other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from geometry.seam import S
from geometry.shapes.drawing import Drawing, Extent, Prism
from geometry.shapes.sizing import Grading, gmsh


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
    def plane_lengths(self) -> dict[str, float]:
        """Width and heights."""
        return {"width": self.width} | {f"height of {name}": height for name, height in self.bodies}

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
