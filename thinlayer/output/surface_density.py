"""SurfaceDensity: a scalar on S, such as where the change of a goal comes from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from forms.kinematics import Expr
from geometry.inflating.parting import points_on_middle
from geometry.topology import FloatArray, IntArray
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.joint_fields import cellwise


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

    @cached_property
    def expression(self) -> Expr:
        """It as a UFL expression on S."""
        joint = self.model.joint
        values = np.zeros(len(joint.points))
        values[self.vertices] = self.values
        f = cellwise(self.model.domain, ("Lagrange", 1), values[joint.corners][..., None])
        return f("+") if any(name not in joint.base_seams for name in self.model.layers) else f
