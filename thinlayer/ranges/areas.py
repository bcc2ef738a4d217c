"""Areas of a seam as integrals of a model have them: in axisymmetry those of the whole revolution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from forms.planes import Kinematics
from geometry.sheet import Rim, Sheet
from geometry.topology import FloatArray


@dataclass(frozen=True)
class Areas:
    """Integrals over the n simplices of a sheet, each with d vertices, with the factor of the measures (1, or 2 pi r)."""

    sheet: Sheet
    kinematics: Kinematics

    @cached_property
    def at_vertices(self) -> FloatArray:
        """(n, d) integrals of the functions of degree 1 that are 1 at a vertex."""
        d = self.sheet.joint.dim
        shares = np.repeat(self.sheet.areas[:, None] / d, d, axis=1)
        return self.kinematics.node_areas(self.sheet.joint.points[self.sheet.vertices], shares)

    @property
    def of_simplices(self) -> FloatArray:
        """(n,) areas."""
        return np.asarray(self.at_vertices.sum(axis=1))

    @property
    def total(self) -> float:
        """Area of the sheet."""
        return float(self.at_vertices.sum())

    @cached_property
    def mass(self) -> FloatArray:
        """(n, d, d) integrals of the products of the functions of degree 1."""
        d = self.sheet.joint.dim
        products = np.repeat(self.of_simplices / (d * (d + 1)), d * d).reshape(-1, d, d)  # of two functions
        i = np.arange(d)
        products[:, i, i] = self.at_vertices - (d - 1) * products[:, i, i]
        return products

    def length(self, rim: Rim) -> float:
        """Length of a part of the rim; in a plane the number of its points, in axisymmetry that of their circles."""
        middles = self.sheet.joint.points[rim.vertices].mean(axis=1)
        return float(rim.length @ self.kinematics.factor_at(middles))

    def divergence(self, u: FloatArray) -> FloatArray:
        """(n,) means of div_S u over the simplices, for displacements (n, d, d) at their vertices."""
        middles = self.sheet.joint.points[self.sheet.vertices].mean(axis=1)
        along = (u * self.sheet.gradients).sum(axis=(1, 2))
        return np.asarray(along + u[:, :, 0].mean(axis=1) / self.kinematics.radius(middles))
