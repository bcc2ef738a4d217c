"""Round shapes: concentric rings and stacked discs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from math import pi, tau
from typing import Self

from geometry.errors import GeometryError
from geometry.seam import S
from geometry.shapes import gmsh
from geometry.shapes.drawing import Drawing, Shape, walls
from geometry.shapes.polar import Web, curve_grid, is_circle, surface
from geometry.shapes.prism import Prism
from geometry.shapes.sizing import Grading, require_wide, times
from geometry.topology import FloatArray, IntArray

TURN = 0.3  # largest angle of a cell about the axis, in radians
CORE = 0.65  # half the diagonal of the square grid in the middle of a disc, over the radius


@dataclass(frozen=True)
class Rings(Prism):
    """Two concentric rings or sectors of rings about the origin, in 3D tubes, S between them.

    Attributes:
        inner, interface, outer: radii, growing lengths > 0.
        angle: of the sector from the x axis, in radians, up to the full circle.
    """

    inner: float
    interface: float
    outer: float
    angle: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inner < self.interface < self.outer:
            radii = f"inner = {self.inner}, interface = {self.interface}, outer = {self.outer}"
            raise GeometryError(f"the radii {radii} must grow")
        if not (0 < self.angle < tau or is_circle(self.angle)):
            raise GeometryError(f"angle is {self.angle}; it must be > 0 and at most 2 pi, the full circle")

    @property
    def plane_lengths(self) -> dict[str, float]:
        """The radii."""
        return {"inner": self.inner, "interface": self.interface, "outer": self.outer}

    @property
    def thinnest(self) -> float:
        """The smallest of the rings' widths and their depth."""
        return min(self.interface - self.inner, self.outer - self.interface, self.depth or self.outer)

    @property
    def span(self) -> float:
        """Length of S in the plane, or the depth."""
        return max(self.angle * self.interface, self.depth or 0.0)

    @property
    def distance(self) -> str:
        """Distance from S."""
        return f"abs(sqrt(x*x + y*y) - {float(self.interface)!r})"

    @property
    def limits(self) -> list[str]:
        """Cells at every radius small enough to follow a circle."""
        return [f"{TURN!r} * sqrt(x*x + y*y)"]

    def scaled(self, factor: float) -> Self:
        """All lengths times a factor."""
        return replace(
            self,
            cells=self.cells.scaled(factor),
            depth=self.depth and times(self.depth, factor),
            inner=times(self.inner, factor),
            interface=times(self.interface, factor),
            outer=times(self.outer, factor),
        )

    def draw_plane(self) -> Drawing:
        """Rings between spokes; INNER's spokes end at S, where OUTER's begin."""
        web = Web.drawn((self.inner, self.interface, self.outer), self.angle, "xy")
        gmsh.model.geo.synchronize()
        curves = dict(zip(("INSIDE", S, "OUTSIDE"), web.arcs, strict=True))
        if not is_circle(self.angle):
            curves |= {"START": [ring[0] for ring in web.spokes], "END": [ring[-1] for ring in web.spokes]}
        bodies = dict(zip(("INNER", "OUTER"), web.patches, strict=True))
        return Drawing(bodies, curves, list(chain.from_iterable(web.patches)), self._gradings(web))

    def _gradings(self, web: Web) -> dict[int, Grading]:
        """A polar grid: cells from h_S at S to h away from it, from h_ends at the ends of S to h_S between them."""
        h, h_S, h_ends = self.sizes
        inner, outer = web.spokes
        gradings = dict.fromkeys(inner, Grading.of(self.interface - self.inner, h_S, h, backwards=True))
        gradings |= dict.fromkeys(outer, Grading.of(self.outer - self.interface, h_S, h))
        along = min(h_S, TURN * self.interface)
        last = len(web.arcs[0]) - 1
        length = self.angle * self.interface / (last + 1)
        for k, arcs in enumerate(zip(*web.arcs, strict=True)):
            at_end = k in (0, last) and not is_circle(self.angle)
            first = min(h_ends, along) if at_end else along
            gradings |= dict.fromkeys(arcs, Grading.of(length, first, along, backwards=k == last))
        return gradings

    def settle(self, points: FloatArray, cells: IntArray) -> FloatArray:
        """Nodes of a curved polar grid on circles."""
        return curve_grid(points, cells, self.kind, [0, 1]) if self.curved_grid else points


@dataclass(frozen=True)
class Discs(Shape):
    """Two discs (annuli with a hole) of some height on top of each other about the y axis, S between them at height 0.

    Attributes:
        radius: a length > 0.
        lower, upper: heights, lengths > 0.
        hole: radius of the hole, a length less than the radius; 0 for none.
    """

    radius: float
    lower: float
    upper: float
    hole: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.hole < self.radius:
            raise GeometryError(f"hole is {self.hole}; it must be 0 (no hole) or a radius less than {self.radius}")
        if self.hole:
            require_wide("hole", self.hole, self.radius)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return 3

    @property
    def lengths(self) -> dict[str, float]:
        """Radius and heights."""
        return {"radius": self.radius, "height of LOWER": self.lower, "height of UPPER": self.upper}

    @property
    def thinnest(self) -> float:
        """The smallest of the heights and the width."""
        return min(self.radius - self.hole, self.lower, self.upper)

    @property
    def span(self) -> float:
        """The circumference."""
        return tau * self.radius

    @property
    def distance(self) -> str:
        """Distance from S."""
        return "abs(y)"

    @property
    def limits(self) -> list[str]:
        """Cells small enough to follow a circle, at every radius if there is a hole."""
        return [f"{TURN!r} * {'sqrt(x*x + z*z)' if self.hole else repr(float(self.radius))}"]

    def scaled(self, factor: float) -> Self:
        """All lengths times a factor."""
        return replace(
            self,
            cells=self.cells.scaled(factor),
            radius=times(self.radius, factor),
            lower=times(self.lower, factor),
            upper=times(self.upper, factor),
            hole=times(self.hole, factor),
        )

    def draw(self) -> Drawing:
        """A disc in the plane of S, swept to both sides."""
        h, h_S, _ = self.sizes
        core = self.gridded and not self.hole
        radii = (self.hole or CORE * self.radius, self.radius) if self.hole or core else (self.radius,)
        web = Web.drawn(radii, tau, "xz", chords=core)
        disc = list(chain.from_iterable(web.patches)) + ([] if self.hole else [surface(web.arcs[0])])
        gmsh.model.geo.synchronize()
        low = self.sweep(disc, (0.0, -self.lower, 0.0), Grading.of(self.lower, h_S, h))
        high = self.sweep(disc, (0.0, self.upper, 0.0), Grading.of(self.upper, h_S, h))
        facets = {S: disc, "SIDE": walls(web.arcs[-1], disc)} | (
            {"HOLE": walls(web.arcs[0], disc)} if self.hole else {}
        )
        for name, swept in (("BOTTOM", low), ("TOP", high)):
            facets[name] = [far for _, far in swept.values()]
        bodies = {name: [volume for volume, _ in swept.values()] for name, swept in (("LOWER", low), ("UPPER", high))}
        return Drawing(bodies, facets, disc, self._gradings(web))

    def _gradings(self, web: Web) -> dict[int, Grading]:
        """A polar grid, around a square one if there is no hole: cells from h_ends at circles to h_S between them."""
        _, h_S, h_ends = self.sizes
        along = min(h_S, TURN * self.radius)
        gradings = dict.fromkeys(chain.from_iterable(web.arcs), Grading.of(self.radius * pi / 2, along, along))
        if self.hole:
            radial = Grading.of(self.radius - self.hole, h_ends, h_S, symmetric=True)
        else:
            radial = Grading.of(self.radius * (1 - CORE), h_ends, h_S, backwards=True)
        return gradings | dict.fromkeys(chain.from_iterable(web.spokes), radial)

    def settle(self, points: FloatArray, cells: IntArray) -> FloatArray:
        """Nodes of a curved polar grid on circles, those of the square grid on its straight lines."""
        core = 0.0 if self.hole else CORE * self.radius
        return curve_grid(points, cells, self.kind, [0, 2], core) if self.curved_grid else points
