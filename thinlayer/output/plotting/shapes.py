"""Shapes of deformed structures to draw: regions, the rigid base, outlines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvista

from thinlayer.output.grid import Grid

SUBDIVISION = 3  # subdivision level of curved cells
SHARP = 30.0  # angle (degree) between faces whose common edge is drawn
ALMOST = 0.999  # factor of displacements that keeps the two sides of S apart, so that VTK does not merge them
OFF_MIDDLE = 1e-3  # distance of a cut from the middle, over the structure's size: not along the faces of a grid


@dataclass(frozen=True)
class Shape:
    """A deformed structure to draw.

    Attributes:
        regions: region number -> its cells, the layer's last, with point data "u", a component of the displacement, and
            "moved", (n, 3) how far the deformed points are from the undeformed ones.
        base: facets of the rigid base; None between two bodies.
        plane: of the cut, as `clip` takes it; None: all of the structure is there.
    """

    regions: dict[int, pyvista.UnstructuredGrid]
    base: pyvista.UnstructuredGrid | None
    plane: dict[str, Any] | None = None

    @classmethod
    def of(cls, grid: Grid, component: str, scale: float, cut: Sequence[float] | None = None) -> Shape:
        """The structure with displacements times a scale; cut: without the half to which this unit vector points."""
        mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points + scale * grid.u)
        mesh.point_data.update({"u": grid.component(component), "moved": scale * grid.u})
        parts = {int(number): mesh.extract_cells(grid.region == number) for number in np.unique(grid.region)[::-1]}
        n, k = grid.base.shape[:2]
        facets = np.insert(np.arange(n * k).reshape(n, k), 0, k, axis=1)
        base = pyvista.UnstructuredGrid(facets, np.full(n, grid.base_type), grid.base.reshape(-1, 3)) if n else None
        if base is not None:
            base.point_data["moved"] = np.zeros(base.points.shape)
        if cut is None:
            return cls(parts, base)
        low, high = grid.points.min(axis=0), grid.points.max(axis=0)
        plane = {"normal": cut, "origin": (low + high) / 2 + OFF_MIDDLE * (high - low).max() * np.asarray(cut)}
        behind = {number: part.clip(**plane) for number, part in parts.items()}
        regions = {number: part for number, part in behind.items() if part.n_cells}
        return cls(regions, base.clip(**plane) if base is not None else None, plane)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """(n, 3) nodes of the regions and then of the base."""
        meshes = [*self.regions.values(), *([] if self.base is None else [self.base])]
        return np.concatenate([mesh.points for mesh in meshes])

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """(n,) "u" at `points`; not a number on the base."""
        values = np.concatenate([part["u"] for part in self.regions.values()])
        return np.pad(values, (0, 0 if self.base is None else self.base.n_points), constant_values=np.nan)


def surface(mesh: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """Outer surface of a mesh (in 2D the mesh itself), curved cells subdivided."""
    return mesh.extract_surface(algorithm=None, nonlinear_subdivision=SUBDIVISION)


def edges(surface: pyvista.PolyData) -> pyvista.PolyData:
    """Outlines of a surface, and where it has sharp edges before it deforms, at their deformed places."""
    still = surface.copy()
    still.points -= ALMOST * surface["moved"]
    if not surface.n_lines:
        still = still.compute_normals(point_normals=False)  # turns faces alike, for their angles
    lines = still.extract_feature_edges(SHARP, manifold_edges=False, non_manifold_edges=False)
    if lines.n_cells:
        lines.points += ALMOST * lines["moved"]
    return lines
