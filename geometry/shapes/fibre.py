"""A fibre of circular section in its matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi, tau
from typing import Self

from geometry.errors import GeometryError
from geometry.seam import S
from geometry.shapes import gmsh
from geometry.shapes.drawing import Drawing, Shape
from geometry.shapes.polar import Web, curve_grid, surface
from geometry.shapes.rounds import CORE, TURN
from geometry.shapes.sizing import Grading, times
from geometry.topology import FloatArray, IntArray


@dataclass(frozen=True)
class Fibre(Shape):
    """A disc about the origin in a larger disc or a rectangle, S the circle between.

    Attributes:
        radius: of the fibre, a length > 0.
        around: radius of the matrix's outer circle, or width and height of its rectangle.
    """

    radius: float
    around: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.around) not in (1, 2):
            raise GeometryError(f"around is {self.around}; it must be a radius, or a width and a height")
        super().__post_init__()
        if self.gap <= 0:
            what = "radius" if self.round else "smaller half side"
            raise GeometryError(f"radius is {self.radius}; it must be less than the {what} of the matrix, {self.reach}")
        if self.gridded and not self.round:
            raise GeometryError(
                f"cell {self.kind!r} needs a matrix with an outer circle; in a rectangle use 'triangle'"
            )

    @property
    def dim(self) -> int:
        """Space dimension."""
        return 2

    @property
    def round(self) -> bool:
        """Whether the matrix is a disc."""
        return len(self.around) == 1

    @property
    def reach(self) -> float:
        """Distance of the matrix's outer side from the origin."""
        return self.around[0] if self.round else min(self.around) / 2

    @property
    def gap(self) -> float:
        """The least width of the matrix."""
        return self.reach - self.radius

    @property
    def lengths(self) -> dict[str, float]:
        """Radius, and radius or sides of the matrix."""
        names = ("radius of the matrix",) if self.round else ("width", "height")
        return {"radius": self.radius} | dict(zip(names, self.around, strict=True))

    @property
    def thinnest(self) -> float:
        """The smaller one of the radius and the matrix's least width."""
        return min(self.radius, self.gap)

    @property
    def span(self) -> float:
        """The circumference."""
        return tau * self.radius

    @property
    def limits(self) -> list[str]:
        """Cells small enough to follow a circle at every radius from that of S on."""
        return [f"{TURN!r} * ({float(self.radius)!r} + abs(sqrt(x*x + y*y) - {float(self.radius)!r}))"]

    def scaled(self, factor: float) -> Self:
        """All lengths times a factor."""
        return replace(
            self,
            cells=self.cells.scaled(factor),
            radius=times(self.radius, factor),
            around=tuple(times(length, factor) for length in self.around),
        )

    def draw(self) -> Drawing:
        """A disc in a ring or in a rectangle with a hole; for a grid around a square one."""
        core = [CORE * self.radius] if self.gridded else []
        radii = (*core, self.radius, *(self.around if self.round else ()))
        web = Web.drawn(radii, tau, "xy", chords=self.gridded)
        fibre = [*(web.patches[0] if core else ()), surface(web.arcs[0])]
        circle = web.arcs[len(core)]
        if self.round:
            sides, matrix = {"OUTSIDE": web.arcs[-1]}, web.patches[-1]
        else:
            sides, matrix = self._rectangle(circle)
        gmsh.model.geo.synchronize()
        gradings = self._gradings(web) if self.gridded else {}
        return Drawing({"FIBRE": fibre, "MATRIX": matrix}, {S: circle} | sides, fibre + matrix, gradings)

    def _rectangle(self, hole: Sequence[int]) -> tuple[dict[str, list[int]], list[int]]:
        """The sides of the matrix, and its surface around a hole."""
        kernel = gmsh.model.geo
        x, y = (length / 2 for length in self.around)
        corners = [kernel.addPoint(*at, 0.0) for at in ((-x, -y), (x, -y), (x, y), (-x, y))]
        lines = [kernel.addLine(corners[k - 1], corners[k]) for k in range(4)]
        loops = [kernel.addCurveLoop(lines), kernel.addCurveLoop(list(hole))]
        sides = {name: [line] for name, line in zip(("LEFT", "BOTTOM", "RIGHT", "TOP"), lines, strict=True)}
        return sides, [kernel.addPlaneSurface(loops)]

    def _gradings(self, web: Web) -> dict[int, Grading]:
        """A polar grid around a square one: cells from h_S at S to h away from it."""
        h, h_S, _ = self.sizes
        along = Grading.of(self.radius * pi / 2, min(h_S, TURN * self.radius), min(h_S, TURN * self.radius))
        gradings = dict.fromkeys([arc for arcs in web.arcs for arc in arcs], along)
        inner, outer = web.spokes
        gradings |= dict.fromkeys(inner, Grading.of(self.radius * (1 - CORE), h_S, h_S))
        return gradings | dict.fromkeys(outer, Grading.of(self.gap, h_S, h))

    def settle(self, points: FloatArray, cells: IntArray) -> FloatArray:
        """Nodes of a curved polar grid on circles, those of the square grid on its straight lines."""
        return curve_grid(points, cells, self.kind, [0, 1], CORE * self.radius) if self.curved_grid else points
