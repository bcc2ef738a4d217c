"""Search for the cells of a joint, or facets of S, that contain points."""

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
    """Points, and all cells or facets that contain them; a point on a boundary lies in several.

    Attributes:
        x: (n, d) coordinates of the points.
        point: (m,) number of the point, ascending.
        entity: (m,) number of a cell or facet that contains it.
        X: (m, k) its coordinates in the reference entity.
    """

    x: Array
    point: IntArray
    entity: IntArray
    X: Array

    @classmethod
    def of(cls, kind: str, nodes: Array, x: npt.ArrayLike) -> LocatedPoints:
        """Locate points (n, d), or one point (d,), in entities; a point outside all entities has no row.

        Args:
            kind: type of the entities.
            nodes: (m, a, d) coordinates of their nodes.
            x: the points.

        Raises:
            InputError: x is no array of finite numbers with such a shape.
        """
        d, degree = nodes.shape[2], geometry_degree(kind, nodes.shape[1])
        if (query := finite_values(x, (d,), (-1, d))) is None or not query.size:
            raise InputError(f"places are {x!r:.80}; they must have {d} finite coordinates each, (n, {d})")
        query = np.atleast_2d(query)
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        margin = (high - low).max(axis=1, keepdims=True) * (MAX_BULGE if degree > 1 else REFERENCE_TOLERANCE)
        low, high = low - margin, high + margin
        radius = float(np.linalg.norm(high - low, axis=1).max()) / 2
        near = cKDTree((low + high) / 2).query_ball_point(query, radius * (1 + REFERENCE_TOLERANCE))
        point = np.repeat(np.arange(len(query)), [len(candidates) for candidates in near])
        entity = np.array([k for candidates in near for k in sorted(candidates)], np.int64)
        boxed = ((query[point] >= low[entity]) & (query[point] <= high[entity])).all(axis=1)
        point, entity = point[boxed], entity[boxed]
        X = _reference_points(kind, degree, nodes[entity], query[point])
        last = X.max(axis=1, initial=-np.inf) if is_tensor(kind) else X.sum(axis=1)
        return cls(query, point, entity, X)[(X >= -REFERENCE_TOLERANCE).all(axis=1) & (last <= 1 + REFERENCE_TOLERANCE)]

    @classmethod
    def in_cells(cls, joint: Joint, x: npt.ArrayLike) -> LocatedPoints:
        """Locate points in the cells of a joint, inflated or not.

        Raises:
            InputError: as in `of`; a point is in no cell.
        """
        located = cls.of(joint.cell_type, joint.cell_points, x)
        words = "{bad} of {all} places are in no cell of the mesh, the first at {at}"
        refuse(located.missing, located.x, words if joint.parted is None else f"{words}; {EXTENDED_BODIES_HINT}")
        return located

    def __getitem__(self, rows: IntArray | BoolArray) -> LocatedPoints:
        return LocatedPoints(self.x, self.point[rows], self.entity[rows], self.X[rows])

    @property
    def missing(self) -> BoolArray:
        """(n,) whether each point is in no entity."""
        return ~np.isin(np.arange(len(self.x)), self.point)

    def mean(self, values: Array) -> Array:
        """(n, ...) means of values (m, ...) over the entities that contain each point."""
        counts = np.bincount(self.point, minlength=len(self.x))
        return np.asarray(sum_by_number(self.point, values, len(self.x)) / counts.reshape(-1, *[1] * (values.ndim - 1)))


def _reference_points(kind: str, degree: int, nodes: Array, x: Array) -> Array:
    """Reference coordinates of points x (n, d) in entities with nodes (n, a, d); beyond the entity for outer points."""
    element = lagrange(kind, degree)
    X = np.tile(basix.geometry(basix.CellType[kind]).mean(axis=0), (len(x), 1))
    if not len(x):  # basix takes no empty arrays
        return X
    for _ in range(MAX_NEWTON_STEPS):
        table = element.tabulate(1, X)[..., 0]
        there = np.einsum("pn,pnd->pd", table[0], nodes)
        slopes = np.einsum("tpn,pnd->pdt", table[1:], nodes)
        step = np.einsum("pij,pj->pi", np.linalg.pinv(slopes), x - there)
        X = np.clip(X + step, -1.0, 2.0)
        if np.abs(step).max(initial=0.0) < REFERENCE_TOLERANCE**2:
            break
    there = np.einsum("pn,pnd->pd", element.tabulate(0, X)[0, :, :, 0], nodes)
    X[np.linalg.norm(x - there, axis=1) > REFERENCE_TOLERANCE * np.ptp(nodes, axis=1).max(axis=1)] = 2.0
    return X
