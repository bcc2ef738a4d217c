"""Sides of a layer, its own boundary at the ends of its seam: how they are constrained, and weights near free ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights
from forms.work import Interface
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import FacetName, S
from geometry.sheet import Rim, Sheet, StraightEnd, continued_ridge_keys, fraction_below
from geometry.topology import FloatArray, ridge_keys
from thinlayer.discretisation.boundary import AXIS_NAMES, nodes_on_axis, side_normals
from thinlayer.discretisation.layer import SeamLayer
from thinlayer.discretisation.mesh_functions import cellwise_function
from thinlayer.discretisation.part_definition import PartDefinition

SQUARED_COSINE_TOLERANCE = 1e-6  # tolerance of squared cosines between directions
FLAT_SQUARED_COSINE = 1e-3  # squared cosine up to which directions count as orthogonal: within 2 degrees
CURVED_SQUARED_COSINE = 0.03  # the same for curved S, from which straight facets deviate by 10 degrees
NO_END = 1e3  # distance of the nearest end, over the size of the joint, where there is no end


def side_kinds(layer: SeamLayer) -> npt.NDArray[np.str_]:
    """Return a word for each of the n ridges where a layer's seam ends: how the layer's side is constrained there.

    The side is the layer's own boundary, between its two faces. Its displacement has a component along m, outward along
    S, and one along n, across S. Supports, multi-point constraints and an axis of revolution may constrain them. The
    words (n,) are:

        - "free": neither component is constrained
        - "held": both are
        - "symmetric": only that along m is, as in a plane of symmetry
        - "antisymmetric": only that along n is
        - "oblique": a direction between m and n is constrained.

    Constraints along the end itself do not matter.
    """
    sheet, projectors = layer.sheet, held_projectors(layer)
    normals = sheet.joint.interface_normals[sheet.rim.facet]
    sq_cosines = np.stack([np.einsum("ni,nij,nj->n", e, projectors, e) for e in (sheet.rim.outward, normals)], axis=1)
    tolerance = FLAT_SQUARED_COSINE if sheet.planar else CURVED_SQUARED_COSINE
    m_held, n_held = (sq_cosines > tolerance).T
    kinds = np.array([["free", "antisymmetric"], ["symmetric", "held"]])[m_held.astype(int), n_held.astype(int)]
    return np.where(((sq_cosines <= tolerance) | (sq_cosines >= 1 - tolerance)).all(axis=1), kinds, "oblique")


def held_projectors(layer: SeamLayer, of_layer: bool = True) -> FloatArray:
    """Return projections (n, d, d) onto the directions in which a layer's side cannot move, at n ridges where S ends.

    The side is the layer's own boundary at such a ridge.

    Args:
        layer: the layer on its seam, in d dimensions.
        of_layer: whether constraints of facet sets "NAME/LAYER" count too; such a set is the part of the facet set NAME
            on the layer's own side.
    """
    structure, rim, joint = layer.structure, layer.sheet.rim, layer.sheet.joint
    d, rim_keys, axes = joint.dim, ridge_keys(rim.vertices), AXIS_NAMES[: joint.dim]
    dyads = np.zeros((len(rim_keys), d, d))
    dyads[nodes_on_axis(structure.kinematics, joint)[rim.vertices].all(axis=1)] = np.eye(d)
    entries = [(place, [*value] if isinstance(value, Mapping) else axes) for place, value in structure.supports.items()]
    mpc_parts = [part for part in structure.parts if isinstance(part, PartDefinition) and part.has_constraint]
    for place, components in [*entries, *((part.place, part.components or axes) for part in mpc_parts)]:
        name = FacetName.parse(place).continued_set if isinstance(place, str) else S
        if name in (S, *joint.seams) or name not in joint.facets or (name != place and not of_layer):
            continue  # a vertex, the side of one body, or that of the layer
        on_rim = np.isin(rim_keys, continued_ridge_keys(joint, joint.facets[name]))
        for axis in components:
            direction = np.eye(d)[axes.index(axis)] if axis in axes else _rim_normals(joint, rim, name)
            dyads += np.where(on_rim[:, None], direction, 0.0)[:, :, None] * direction[..., None, :]
    return np.asarray(dyads @ np.linalg.pinv(dyads, rcond=SQUARED_COSINE_TOLERANCE, hermitian=True))


def _rim_normals(joint: Joint, rim: Rim, name: str) -> FloatArray:
    """Return mean outer unit normals (n, d) of the facet set `name` at the n ridges of `rim`.

    At ridges without a facet of this set the result is the outward direction along S.
    """
    normals = side_normals(joint, name, rim.vertices)
    return np.where(np.isnan(normals), rim.outward, normals)


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
        fields = sides.upper(cellwise_function(domain, ("DG", 0, (4 + joint.dim,)), values[:, None]))
        m = ufl.as_vector([fields[4 + k] for k in range(joint.dim)])
        distance = fields[3] - ufl.dot(m, sides.upper(ufl.SpatialCoordinate(mesh)))
        mean_distances = self.constants.rho_N, self.constants.c_T  # of the tractions that balance those at the end
        reaches = [fem.Constant(mesh, 2 * rho * eps) if rho else None for rho in mean_distances]
        f_N, f_T = (1.0 if r is None else ufl.max_value(0.0, ufl.min_value(1.0, distance / r)) for r in reaches)
        return EndWeights(m, fields[0], fields[1], f_N, f_T, fields[2])
