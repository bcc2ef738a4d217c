"""SurfaceDensity: a scalar on S, such as where the change of a goal comes from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geometry.inflating.parting import points_on_middle
from geometry.topology import FloatArray, IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.output.surface import Surface


@dataclass(frozen=True)
class SurfaceDensity:
    """A density on S, linear between its vertices, the same on all ranks.

    Attributes:
        model: the interface model.
        vertices: (n,) vertices of S, numbers in the joint.
        sums: (n,) what the density adds up to around each vertex.
    """

    model: InterfaceModel
    vertices: IntArray
    sums: FloatArray

    @property
    def x(self) -> FloatArray:
        """(n, d) places of the vertices."""
        return np.asarray(points_on_middle(self.model.domain.joint)[self.vertices])

    @cached_property
    def areas(self) -> FloatArray:
        """(n,) areas of S around the vertices, of straight facets between them."""
        joint, found = self.model.joint, np.zeros(len(self.model.joint.points))
        corners = joint.table.vertices[joint.surface_rows]
        x = joint.points[corners]
        sides = x[:, 1 : joint.dim] - x[:, :1]
        area = np.sqrt(np.linalg.det(sides @ sides.swapaxes(1, 2))) * (0.5 if joint.cell_type == "tetrahedron" else 1.0)
        shares = np.repeat(area[:, None] / x.shape[1], x.shape[1], axis=1)
        np.add.at(found, corners, self.model.kinematics.node_areas(x, shares))
        return np.asarray(found[self.vertices])

    @property
    def values(self) -> FloatArray:
        """(n,) the density."""
        return np.asarray(self.sums / self.areas)

    @property
    def total(self) -> float:
        """Its integral over S."""
        return float(self.sums.sum())

    def on(self, surface: Surface) -> FloatArray:
        """(n, q) the density as a field on S, or on a seam."""
        values = np.zeros(len(self.model.joint.points))
        values[self.vertices] = self.values
        return np.asarray(values[surface.corners] @ surface.shapes.T)
