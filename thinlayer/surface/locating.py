"""Search for the cells of a joint, or the facets of S, in which given points lie."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from forms.base import Array, InputError
from forms.temperature import finite_values
from geometry.joint import Joint
from geometry.refusals import refuse
from geometry.topology import BoolArray, IntArray, geometry_degree, is_tensor, lagrange, sum_by_number

REFERENCE_TOLERANCE = 1e-9  # distance from the reference entity at which a point still counts as inside
EXTENDED_BODIES_HINT = "as bodies='extended' has the faces of bodies half a thickness away from S"
MAX_BULGE = 0.5  # largest distance, over its size, by which a curved entity may exceed the box around its nodes
MAX_NEWTON_STEPS = 30  # limit of Newton iterations for reference coordinates in non-affine entities


@dataclass(frozen=True)
class LocatedPoints:
    """Points, and the cells or facets that contain them, as m pairs of a point and a cell or facet ("entity").

    A point on the boundary between entities is in several pairs, a point outside all entities in none.

    Attributes:
        x: (n, d) coordinates of the n points; d: number of dimensions.
        point: (m,) number of the point in each pair, ascending.
        entity: (m,) number of the cell or facet in each pair.
        X: (m, k) coordinates of the point in the reference cell or facet, which has k dimensions.
    """

    x: Array
    point: IntArray
    entity: IntArray
    X: Array

    @classmethod
    def locate(cls, cell_type: str, nodes: Array, x: npt.ArrayLike) -> LocatedPoints:
        """Find all cells or facets that contain points; a point outside all of them is in no pair.

        Args:
            cell_type: type of the cells or facets, such as "triangle".
            nodes: (entities, a, d) coordinates of the a nodes of each cell or facet, in d dimensions.
            x: coordinates (n, d) of points, or (d,) of one point.

        Raises:
            InputError: x is no array of finite numbers with such a shape.
        """
        d, degree = nodes.shape[2], geometry_degree(cell_type, nodes.shape[1])
        if (query := finite_values(x, (d,), (-1, d))) is None or not query.size:
            raise InputError(f"places are {x!r:.80}; they must have {d} finite coordinates each, (n, {d})")
        query = np.atleast_2d(query)
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        margin = (high - low).max(axis=1, keepdims=True) * (MAX_BULGE if degree > 1 else REFERENCE_TOLERANCE)
        low, high = low - margin, high + margin
        radius = float(np.linalg.norm(high - low, axis=1).max()) / 2
        candidate_lists = cKDTree((low + high) / 2).query_ball_point(query, radius * (1 + REFERENCE_TOLERANCE))
        point = np.repeat(np.arange(len(query)), [len(candidates) for candidates in candidate_lists])
        entity = np.array([k for candidates in candidate_lists for k in sorted(candidates)], np.int64)
        in_box = ((query[point] >= low[entity]) & (query[point] <= high[entity])).all(axis=1)
        point, entity = point[in_box], entity[in_box]
        X = _reference_coordinates(cell_type, degree, nodes[entity], query[point])
        peak = X.max(axis=1, initial=-np.inf) if is_tensor(cell_type) else X.sum(axis=1)
        return cls(query, point, entity, X)[(X >= -REFERENCE_TOLERANCE).all(axis=1) & (peak <= 1 + REFERENCE_TOLERANCE)]

    @classmethod
    def in_cells(cls, joint: Joint, x: npt.ArrayLike) -> LocatedPoints:
        """Find all cells of a joint that contain points.

        Args:
            joint: the joint, in which S may already be opened to the layer's thickness.
            x: coordinates (n, d) of points in d dimensions, or (d,) of one point.

        Raises:
            InputError: x is no array of finite numbers with such a shape, or a point is in no cell.
        """
        located = cls.locate(joint.cell_type, joint.cell_points, x)
        text = "{bad} of {all} places are in no cell of the mesh, the first at {at}"
        refuse(located.is_missing, located.x, text if joint.parted is None else f"{text}; {EXTENDED_BODIES_HINT}")
        return located

    def __getitem__(self, rows: IntArray | BoolArray) -> LocatedPoints:
        return LocatedPoints(self.x, self.point[rows], self.entity[rows], self.X[rows])

    @property
    def is_missing(self) -> BoolArray:
        """Mask (n,), True for the points that are in no cell or facet."""
        return ~np.isin(np.arange(len(self.x)), self.point)

    def point_means(self, values: Array) -> Array:
        """Return, for each point, the mean (n, ...) of `values` (m, ...) over the m pairs in which the point is.

        The values belong to the cells or facets of the pairs.
        """
        counts = np.bincount(self.point, minlength=len(self.x))
        return np.asarray(sum_by_number(self.point, values, len(self.x)) / counts.reshape(-1, *[1] * (values.ndim - 1)))


def _reference_coordinates(cell_type: str, degree: int, nodes: Array, x: Array) -> Array:
    """Return the reference coordinates (n, k) of n points, each in its cell or facet of dimension k.

    A point outside its cell or facet gets coordinates outside the reference cell or facet.

    Args:
        cell_type: type of the cells or facets, such as "triangle".
        degree: polynomial degree of their geometry.
        nodes: (n, a, d) coordinates of the a nodes of the cell or facet of each point, in d dimensions.
        x: (n, d) coordinates of the points.
    """
    element = lagrange(cell_type, degree)
    X = np.tile(basix.geometry(basix.CellType[cell_type]).mean(axis=0), (len(x), 1))
    if not len(x):  # basix takes no empty arrays
        return X
    for _ in range(MAX_NEWTON_STEPS):
        basis_values = element.tabulate(1, X)[..., 0]
        x_now = np.einsum("pn,pnd->pd", basis_values[0], nodes)
        jacobians = np.einsum("tpn,pnd->pdt", basis_values[1:], nodes)
        step = np.einsum("pij,pj->pi", np.linalg.pinv(jacobians), x - x_now)
        X = np.clip(X + step, -1.0, 2.0)
        if np.abs(step).max(initial=0.0) < REFERENCE_TOLERANCE**2:
            break
    x_now = np.einsum("pn,pnd->pd", element.tabulate(0, X)[0, :, :, 0], nodes)
    X[np.linalg.norm(x - x_now, axis=1) > REFERENCE_TOLERANCE * np.ptp(nodes, axis=1).max(axis=1)] = 2.0
    return X
