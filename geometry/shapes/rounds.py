"""Round shapes: concentric rings, stacked discs, and a fibre in its matrix, drawn with arcs and radial lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from math import cos, isclose, pi, sin, tau
from typing import ClassVar, NamedTuple

from forms.base import InputError, is_finite
from geometry.seam import S
from geometry.shapes.drawing import Drawing, Prism, Shape, SizeRules, add_plane_surface, swept_surfaces
from geometry.shapes.sizing import Grading, gmsh, require_width

MAX_CELL_ANGLE = 0.3  # largest angle of a cell about the axis, in radians
CORE_RADIUS_RATIO = 0.65  # half the diagonal of the square grid in the middle of a disc, over the radius


class PolarLines(NamedTuple):
    """Arcs about the origin, spokes (radial lines between arcs) and the surfaces between them, as tags in gmsh.

    Each attribute has one list of tags for each arc or ring, the innermost first. Each list begins at the first spoke,
    on the positive x axis.

    Attributes:
        arcs: for each radius the curves from each spoke to the next.
        spokes: for each ring between two radii the radial lines across it.
        patches: for each ring the surfaces between its spokes.
    """

    arcs: list[list[int]]
    spokes: list[list[int]]
    patches: list[list[int]]

    @classmethod
    def draw_polar(cls, radii: Sequence[float], angle: float, plane: str, *, chords: bool = False) -> PolarLines:
        """Draw arcs, spokes and the surfaces between them in the current gmsh model, and return their tags.

        Args:
            radii: radii of the arcs, increasing lengths > 0.
            angle: angle of the sector that starts at the x axis, in radians, > 0 and at most 2 pi.
            plane: coordinate plane of the drawing, "xy" or "xz".
            chords: whether the innermost arcs are replaced by straight lines.
        """
        kernel = gmsh.model.geo
        n = 2 if angle <= pi else 4  # gmsh's arcs are shorter than half a circle

        def add_point(radius: float, turn: float) -> int:
            x, y = radius * cos(turn), radius * sin(turn)
            return kernel.addPoint(*((x, y, 0.0) if plane == "xy" else (x, 0.0, y)))

        def chain_pairs(tags: Sequence[int]) -> list[tuple[int, int]]:
            return list(pairwise([*tags, tags[0]][: n + 1]))

        centre = add_point(0.0, 0.0)
        angles = [angle * k / n for k in range(n if is_circle(angle) else n + 1)]
        points = [[add_point(radius, theta) for theta in angles] for radius in radii]
        arcs = [[kernel.addCircleArc(a, centre, b) for a, b in chain_pairs(row)] for row in points[chords:]]
        if chords:
            arcs.insert(0, [kernel.addLine(a, b) for a, b in chain_pairs(points[0])])
        spokes = [[kernel.addLine(a, b) for a, b in zip(*circles, strict=True)] for circles in pairwise(points)]
        rings = [zip(*both, chain_pairs(ring), strict=True) for ring, both in zip(spokes, pairwise(arcs), strict=True)]
        patches = [[add_plane_surface([start, far, -end, -near]) for near, far, (start, end) in ring] for ring in rings]
        return cls(arcs, spokes, patches)


@dataclass(frozen=True)
class Rings(Prism):
    """Two concentric rings about the origin, or sectors of them; S is where they meet. In 3D they are tubes.

    Attributes:
        inner, interface, outer: radius of the hole, of S and of the outside, increasing lengths > 0.
        angle: angle of the sector that starts at the x axis, in radians, up to the full circle.
    """

    inner: float
    interface: float
    outer: float
    angle: float
    angle_fields: ClassVar[tuple[str, ...]] = ("angle",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inner < self.interface < self.outer:
            raise InputError(f"inner={self.inner}, interface={self.interface}, outer={self.outer}: radii must grow")
        if not (is_finite(self.angle) and (0 < self.angle < tau or is_circle(self.angle))):
            raise InputError(f"angle is {self.angle!r}; it must be > 0 and at most 2 pi, the full circle")

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: the three radii and, in 3D, the depth."""
        return {"inner": self.inner, "interface": self.interface, "outer": self.outer, **super().lengths}

    @property
    def size_rules(self) -> SizeRules:
        """Lengths from which the cell sizes follow.

        `limit` bounds the angle that a cell subtends at the axis, at any radius, so that about 20 cells or more go
        round a circle.
        """
        width = min(self.interface - self.inner, self.outer - self.interface, self.depth or self.outer)
        r = "sqrt(x*x + y*y)"
        to_s = f"abs({r} - {float(self.interface)!r})"
        return SizeRules(width, max(self.angle * self.interface, self.depth or 0.0), to_s, f"{MAX_CELL_ANGLE!r} * {r}")

    def draw_plane(self) -> Drawing:
        """Draw both rings in the current gmsh model and return their entities, with cell sizes for a polar grid.

        Radial lines divide the rings. Cells of a polar grid grow from h_S at S to h away from it. Along S they grow
        from h_ends at its ends to h_S.
        """
        polar = PolarLines.draw_polar((self.inner, self.interface, self.outer), self.angle, "xy")
        gmsh.model.geo.synchronize()
        h, h_S, h_ends = self.sizes
        curves = dict(zip(("INSIDE", S, "OUTSIDE"), polar.arcs, strict=True))
        if not is_circle(self.angle):
            curves |= {"START": [ring[0] for ring in polar.spokes], "END": [ring[-1] for ring in polar.spokes]}
        inner_spokes, outer_spokes = polar.spokes
        gradings = dict.fromkeys(inner_spokes, Grading.of(self.interface - self.inner, h_S, h, backwards=True))
        gradings |= dict.fromkeys(outer_spokes, Grading.of(self.outer - self.interface, h_S, h))
        arc_h = min(h_S, MAX_CELL_ANGLE * self.interface)
        last_arc = len(polar.arcs[0]) - 1
        arc_length = self.angle * self.interface / (last_arc + 1)
        for k, arcs in enumerate(zip(*polar.arcs, strict=True)):
            end_size = min(h_ends, arc_h) if k in (0, last_arc) and not is_circle(self.angle) else arc_h
            gradings |= dict.fromkeys(arcs, Grading.of(arc_length, end_size, arc_h, backwards=k == last_arc))
        bodies = dict(zip(("INNER", "OUTER"), polar.patches, strict=True))
        return Drawing(bodies, curves, list(chain.from_iterable(polar.patches)), gradings, polar_core=([0, 1], 0.0))


@dataclass(frozen=True)
class Discs(Shape):
    """Two cylinders, stacked along the y axis, which is the axis of both; S is where they meet, at y = 0.

    Attributes:
        radius: radius of both cylinders, a length > 0.
        lower, upper: heights of the two cylinders, lengths > 0.
        hole: radius of a hole along the axis, a length less than the radius; 0: no hole.
    """

    radius: float
    lower: float
    upper: float
    hole: float
    dim: ClassVar[int] = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_finite(self.hole) and 0 <= self.hole < self.radius):
            raise InputError(f"hole is {self.hole!r}; it must be 0 (no hole) or a radius less than {self.radius}")
        if self.hole:
            require_width("hole", self.hole, self.radius)

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: the radius and the two heights."""
        return {"radius": self.radius, "height of LOWER": self.lower, "height of UPPER": self.upper}

    @property
    def size_rules(self) -> SizeRules:
        """Lengths from which the cell sizes follow.

        `limit` bounds the angle that a cell at the outer circle subtends at the axis, so that about 20 cells or more go
        round it. If there is a hole, this holds at any radius.
        """
        radius_text = "sqrt(x*x + z*z)" if self.hole else repr(float(self.radius))
        min_width = min(self.radius - self.hole, self.lower, self.upper)
        return SizeRules(min_width, tau * self.radius, "abs(y)", f"{MAX_CELL_ANGLE!r} * {radius_text}")

    def draw(self) -> Drawing:
        """Draw both cylinders in the current gmsh model and return their entities, with cell sizes for a grid.

        The disc S in the plane y = 0 is swept to both sides. A grid is polar, and has a square grid in the middle if
        there is no hole. Along S its cells grow from h_ends at the circles that bound S to h_S.
        """
        h, h_S, h_ends = self.sizes
        r_core = CORE_RADIUS_RATIO * self.radius if self.is_grid and not self.hole else 0.0
        r_in = self.hole or r_core
        polar = PolarLines.draw_polar((r_in, self.radius) if r_in else (self.radius,), tau, "xz", chords=r_core > 0)
        disc = list(chain.from_iterable(polar.patches)) + ([] if self.hole else [add_plane_surface(polar.arcs[0])])
        gmsh.model.geo.synchronize()
        low = self.sweep(disc, (0.0, -self.lower, 0.0), Grading.of(self.lower, h_S, h))
        high = self.sweep(disc, (0.0, self.upper, 0.0), Grading.of(self.upper, h_S, h))
        hole_facets = {"HOLE": swept_surfaces(polar.arcs[0], disc)} if self.hole else {}
        facets = {S: disc, "SIDE": swept_surfaces(polar.arcs[-1], disc)} | hole_facets
        facets |= {name: [end for _, end in swept.values()] for name, swept in (("BOTTOM", low), ("TOP", high))}
        bodies = {name: [volume for volume, _ in swept.values()] for name, swept in (("LOWER", low), ("UPPER", high))}
        arc_h = min(h_S, MAX_CELL_ANGLE * self.radius)
        gradings = dict.fromkeys(chain.from_iterable(polar.arcs), Grading.of(self.radius * pi / 2, arc_h, arc_h))
        # with a hole there are circles at both ends of the spokes
        radial = Grading.of(self.radius - r_in, h_ends, h_S, symmetric=bool(self.hole), backwards=not self.hole)
        gradings |= dict.fromkeys(chain.from_iterable(polar.spokes), radial)
        return Drawing(bodies, facets, disc, gradings, polar_core=([0, 2], r_core))


@dataclass(frozen=True)
class Fibre(Shape):
    """A fibre, which is a disc about the origin, in a matrix; S is the circle between them.

    Attributes:
        radius: radius of the fibre, a length > 0.
        around: (radius of the matrix's outer circle,), or (width, height) of its rectangle, lengths.
    """

    radius: float
    around: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.around) not in (1, 2):
            raise InputError(f"around is {self.around}; it must be a radius, or a width and a height")
        super().__post_init__()
        if self.matrix_width <= 0:
            argument = "radius" if self.is_round else "smaller half side"
            raise InputError(f"radius is {self.radius}; it must be less than the {argument} of the matrix")
        if self.is_grid and not self.is_round:
            raise InputError(f"{self.kind!r} needs a matrix with an outer circle; in a rectangle use 'triangle'")

    @property
    def is_round(self) -> bool:
        """Whether the outer boundary of the matrix is a circle, not a rectangle."""
        return len(self.around) == 1

    @property
    def matrix_width(self) -> float:
        """Least width of the matrix between the fibre and the outer boundary, a length."""
        return (self.around[0] if self.is_round else min(self.around) / 2) - self.radius

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: radius of the fibre, and radius or width and height of the matrix."""
        names = ("radius of the matrix",) if self.is_round else ("width", "height")
        return {"radius": self.radius} | dict(zip(names, self.around, strict=True))

    @property
    def size_rules(self) -> SizeRules:
        """Lengths from which the cell sizes follow.

        `limit` bounds the angle that a cell outside the fibre subtends at the origin, so that about 20 cells or more go
        round a circle.
        """
        radius_text = repr(float(self.radius))
        limit = f"{MAX_CELL_ANGLE!r} * ({radius_text} + abs(sqrt(x*x + y*y) - {radius_text}))"
        return SizeRules(min(self.radius, self.matrix_width), tau * self.radius, limit=limit)

    def draw(self) -> Drawing:
        """Draw fibre and matrix in the current gmsh model and return their entities, with cell sizes for a grid.

        A grid is polar, around a square grid in the middle of the fibre. Its cells grow from h_S at S to h at the outer
        circle.
        """
        h, h_S, _ = self.sizes
        r_core = CORE_RADIUS_RATIO * self.radius
        radii = (*([r_core] if self.is_grid else []), self.radius, *(self.around if self.is_round else ()))
        polar = PolarLines.draw_polar(radii, tau, "xy", chords=self.is_grid)
        fibre = [*(polar.patches[0] if self.is_grid else ()), add_plane_surface(polar.arcs[0])]
        circle = polar.arcs[int(self.is_grid)]
        sides, matrix = ({"OUTSIDE": polar.arcs[-1]}, polar.patches[-1]) if self.is_round else self._draw_matrix(circle)
        gmsh.model.geo.synchronize()
        gradings: dict[int, Grading] = {}
        if self.is_grid:
            arc_h = min(h_S, MAX_CELL_ANGLE * self.radius)
            gradings = dict.fromkeys(chain.from_iterable(polar.arcs), Grading.of(self.radius * pi / 2, arc_h, arc_h))
            gradings |= dict.fromkeys(polar.spokes[0], Grading.of(self.radius - r_core, h_S, h_S))
            gradings |= dict.fromkeys(polar.spokes[1], Grading.of(self.matrix_width, h_S, h))
        bodies, polar_core = {"FIBRE": fibre, "MATRIX": matrix}, ([0, 1], r_core)
        return Drawing(bodies, {S: circle} | sides, fibre + matrix, gradings, polar_core=polar_core)

    def _draw_matrix(self, hole: Sequence[int]) -> tuple[dict[str, list[int]], list[int]]:
        """Draw the matrix as a rectangle about the origin with a hole, in the current gmsh model.

        Args:
            hole: tags of the curves around the hole, one after the other.

        Returns:
            Name of each side -> [tag of its line], and [tag of the surface].
        """
        kernel = gmsh.model.geo
        x, y = (length / 2 for length in self.around)
        corners = [kernel.addPoint(*at, 0.0) for at in ((-x, -y), (x, -y), (x, y), (-x, y))]
        lines = [kernel.addLine(corners[k - 1], corners[k]) for k in range(4)]
        sides = {name: [line] for name, line in zip(("LEFT", "BOTTOM", "RIGHT", "TOP"), lines, strict=True)}
        return sides, [kernel.addPlaneSurface([kernel.addCurveLoop(lines), kernel.addCurveLoop(list(hole))])]


def is_circle(angle: float) -> bool:
    """Return whether an angle, in radians, is the full circle."""
    return isclose(angle, tau, rel_tol=1e-8)
