"""Weights of free ends on S: strips along straight ends, and distances to the nearest one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from forms.ends.weights import EndWeights, Strips
from forms.interface import Interface
from geometry.domain import Domain
from geometry.ends import StraightEnd, share_within
from geometry.sheet import Sheet
from geometry.topology import FloatArray
from thinlayer.discretisation.joint_fields import cellwise

FAR = 1e3  # distance, over the size of the joint, of ends that there are not


@dataclass(frozen=True)
class FacetWeights:
    """Weights of the free ends on the facets of a seam.

    Attributes:
        a_N, a_T: mean weight of each facet, (n,).
        resistance: mean further resistance to the flow of a pressure, over that of an infinite layer, (n,).
        m: (n, d) normal of the nearest end; zero where there is none.
        offset: (n,) m . x of its points.
        sheet, eps, strips: that they are made from.
    """

    a_N: FloatArray
    a_T: FloatArray
    resistance: FloatArray
    m: FloatArray
    offset: FloatArray
    sheet: Sheet
    eps: float
    strips: Strips

    @classmethod
    def of(cls, ends: list[StraightEnd], sheet: Sheet, eps: float, strips: Strips) -> FacetWeights:
        """The weights of these ends, for a layer of this thickness."""
        joint, x = sheet.joint, sheet.joint.points[sheet.vertices]
        facet = np.searchsorted(sheet.facets, sheet.parts[0])
        count, d = len(sheet.facets), joint.dim
        size, area = float(np.ptp(joint.points, axis=0).max()), np.bincount(facet, sheet.areas, count)
        weights = np.zeros((3, count))
        nearest, m, offset = np.full(count, np.inf), np.zeros((count, d)), np.full(count, FAR * size)
        centre = np.stack([np.bincount(facet, sheet.areas * c, count) / area for c in x.mean(axis=1).T], axis=1)
        for end in ends:
            here, distance = end.faces(x.mean(axis=1)), end.distance(x)
            for k, strip in enumerate((strips.opening, strips.shear, strips.resistance)):
                part = share_within(distance, strip.length * eps) * here * sheet.areas
                weights[k] += strip.c / strip.length * np.bincount(facet, part, count) / area
            closer = end.faces(centre) & (end.distance(centre) < nearest)
            nearest[closer], m[closer], offset[closer] = end.distance(centre)[closer], end.m, end.offset
        return cls(weights[0], weights[1], weights[2], m, offset, sheet, eps, strips)

    @property
    def overlap(self) -> bool:
        """Whether strips of several ends lie on one another, and leave the layer no stiffness."""
        return bool(max(self.a_N.max(initial=0.0), self.a_T.max(initial=0.0)) >= 1)

    def expressions(self, domain: Domain, sides: Interface) -> EndWeights:
        """The weights as UFL expressions on S. Collective."""
        joint, mesh, eps, strips = self.sheet.joint, domain.mesh, self.eps, self.strips
        values = np.zeros((len(joint.cells), 4 + joint.dim))
        upper = joint.surface_cells[self.sheet.facets, 1]
        values[upper] = np.column_stack([self.a_N, self.a_T, 1 / (1 + self.resistance), self.offset, self.m])
        known = sides.upper(cellwise(domain, ("DG", 0, (4 + joint.dim,)), values[:, None]))
        m = ufl.as_vector([known[4 + k] for k in range(joint.dim)])
        distance = known[3] - ufl.dot(m, sides.upper(ufl.SpatialCoordinate(mesh)))
        f_N, f_T = (
            ufl.max_value(0.0, ufl.min_value(1.0, distance / fem.Constant(mesh, eps * length))) if length else 1.0
            for length in (strips.r_N, strips.r_T)
        )
        return EndWeights(m, known[0], known[1], f_N, f_T, known[2])
