"""Plane shapes, which may be swept along z."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

from geometry.shapes.drawing import Drawing, Shape, walls
from geometry.shapes.sizing import Grading


@dataclass(frozen=True)
class Prism(Shape):
    """A plane shape, in 3D swept from z = 0 ("BACK") to its depth ("FRONT").

    Attributes:
        depth: a length > 0; None in 2D.
    """

    depth: float | None

    @property
    def dim(self) -> int:
        """Space dimension."""
        return 2 if self.depth is None else 3

    @property
    @abstractmethod
    def plane_lengths(self) -> dict[str, float]:
        """Name in messages -> length in the plane; each must be > 0."""

    @property
    def lengths(self) -> dict[str, float]:
        """The lengths in the plane and the depth."""
        return self.plane_lengths | ({} if self.depth is None else {"depth": self.depth})

    @abstractmethod
    def draw_plane(self) -> Drawing:
        """Draw at z = 0 with gmsh's built-in kernel."""

    def draw(self) -> Drawing:
        """The plane drawing, swept if there is a depth."""
        plane = self.draw_plane()
        if self.depth is None:
            return plane
        _, h_S, h_ends = self.sizes
        swept = self.sweep(plane.floor, (0.0, 0.0, self.depth), Grading.of(self.depth, h_ends, h_S, symmetric=True))
        facets = {name: walls(curves, plane.floor) for name, curves in plane.facets.items()}
        return Drawing(
            {name: [swept[tag][0] for tag in tags] for name, tags in plane.bodies.items()},
            {**facets, "BACK": plane.floor, "FRONT": [front for _, front in swept.values()]},
            plane.floor,
            plane.gradings,
        )
