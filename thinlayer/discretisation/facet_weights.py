"""Weights near straight free ends of a layer, on the facets of its seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights
from forms.work import Interface
from geometry.domain import Domain
from geometry.sheet import Sheet, StraightEnd, fraction_below
from geometry.topology import FloatArray

NO_END = 1e3  # distance of the nearest end, over the size of the joint, where there is no end


def strip_shares(end: StraightEnd, sheet: Sheet, reach: float) -> FloatArray:
    """Return the fraction (n,) of each facet of S that lies in the strip of width `reach` along a straight end."""
    x = sheet.joint.points[sheet.vertices]
    return sheet.facet_means(fraction_below(end.distance(x), reach) * end.is_in_front(x.mean(axis=1)))


@dataclass(frozen=True)
class FacetWeights:
    """Weights with which free ends change the interface law on the n facets of a seam.

    Attributes:
        a_N, a_T: (n,) relative loss of stiffness against openings and against shear, the mean over each facet.
        flow_resistance: (n,) relative increase of the resistance to a flow along S under pressure, mean over each
            facet.
        m: (n, d) unit normal in S of the nearest end, outward, in d dimensions; zero where there is none.
        offset: (n,) value of m . x at points x of the nearest end, a length.
        sheet, eps, constants: the seam, its thickness and the constants of free ends, of which the weights are made.
    """

    a_N: FloatArray
    a_T: FloatArray
    flow_resistance: FloatArray
    m: FloatArray
    offset: FloatArray
    sheet: Sheet
    eps: float
    constants: FreeEnd

    @classmethod
    def of_ends(cls, ends: list[StraightEnd], sheet: Sheet, eps: float, constants: FreeEnd) -> FacetWeights:
        """Return the weights of straight free ends on a seam.

        Args:
            ends: the free ends.
            sheet: the seam.
            eps: thickness of the layer, a length.
            constants: constants of a free end with which the law is corrected.
        """
        joint, count = sheet.joint, len(sheet.facets)
        weights = np.zeros((3, count))
        nearest, m, offset = np.full(count, np.inf), np.zeros((count, joint.dim)), np.full(count, NO_END * joint.size)
        centroids = np.stack([sheet.facet_means(c) for c in joint.points[sheet.vertices].mean(axis=1).T], axis=1)
        for end in ends:
            for k, (c, length) in enumerate(constants.strips):
                weights[k] += c / length * strip_shares(end, sheet, length * eps)
            is_closer = end.is_in_front(centroids) & (end.distance(centroids) < nearest)
            nearest[is_closer], m[is_closer], offset[is_closer] = end.distance(centroids)[is_closer], end.m, end.offset
        return cls(weights[0], weights[1], weights[2], m, offset, sheet, eps, constants)

    @property
    def strips_overlap(self) -> bool:
        """Whether strips of several ends overlap so far that no stiffness is left: a relative loss is 1 or more."""
        return bool(max(self.a_N.max(initial=0.0), self.a_T.max(initial=0.0)) >= 1)

    def expressions(self, domain: Domain, sides: Interface) -> EndWeights:
        """Return the weights as UFL expressions, which multiply terms of an interface law of order 1. Collective.

        Args:
            domain: the mesh; the cells above S store the weights of the facets.
            sides: the two sides of S.
        """
        joint, mesh, eps = self.sheet.joint, domain.mesh, self.eps
        values = np.zeros((len(joint.cells), 4 + joint.dim))
        upper_cells = joint.surface_cells[self.sheet.facets, 1]
        values[upper_cells] = np.column_stack([self.a_N, self.a_T, 1 / (1 + self.flow_resistance), self.offset, self.m])
        fields = sides.upper(domain.cellwise_function(("DG", 0, (4 + joint.dim,)), values[:, None]))
        m = ufl.as_vector([fields[4 + k] for k in range(joint.dim)])
        distance = fields[3] - ufl.dot(m, sides.upper(ufl.SpatialCoordinate(mesh)))
        mean_distances = self.constants.rho_N, self.constants.c_T  # of the tractions that balance those at the end
        reaches = [fem.Constant(mesh, 2 * rho * eps) if rho else None for rho in mean_distances]
        f_N, f_T = (1.0 if r is None else ufl.max_value(0.0, ufl.min_value(1.0, distance / r)) for r in reaches)
        return EndWeights(m, fields[0], fields[1], f_N, f_T, fields[2])
