"""Whether bodies that are kept have room to move apart."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from geometry.errors import GeometryError, place
from geometry.inflating.motion import SAME_GAP
from geometry.joint import Joint
from geometry.topology import FloatArray, IntArray, is_tensor

MANY = 3  # number of different motions of bodies in 2D up to which their ways are checked, pair by pair
# weights of a facet's vertices: their mean lies above no edge of an aligned grid
ASKEW = np.array([1.0, 1.3, 1.7, 2.3])


def is_swept(joint: Joint, translation: FloatArray) -> bool:
    """Whether the bodies' ways are checked; in 2D, of many different ones, it is the result instead."""
    return joint.dim == 3 or len(ways_of(translation)[0]) <= MANY


def require_room(joint: Joint, translation: FloatArray) -> None:
    """Raise GeometryError if bodies that are kept, or a layer on a rigid base, hit one another on their way.

    Args:
        joint: the joint before inflating.
        translation: of its pieces, and of the rigid base if there is one, see `kept_motion`.
    """
    table, cells = joint.table, joint.surface_cells
    first, alike = ways_of(translation)
    outer = np.union1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    piece = joint.splitting.pieces[table.cells[outer, 0]]
    below = np.where(cells[:, 0] >= 0, joint.splitting.pieces[cells[:, 0]], len(translation) - 1)
    piece[np.searchsorted(outer, joint.surface_rows)] = below
    group, translation = alike[piece], translation[first]
    for one, other in _near(joint.points[table.vertices[outer]], group, translation):
        way = translation[one] - translation[other]
        eps = float(np.linalg.norm(way))
        for moving, fixed, sign in ((one, other, 1.0), (other, one, -1.0)):
            corners = table.vertices[outer[group == moving]]
            weights = ASKEW[: corners.shape[1]] / ASKEW[: corners.shape[1]].sum()
            probes = np.concatenate([joint.points[np.unique(corners)], weights @ joint.points[corners]])
            x = _first_hit(joint, probes, outer[group == fixed], sign * way / eps, eps)
            if x is not None:
                raise GeometryError(
                    f"no room for a layer of thickness {eps:g} at {place(x)}: moved apart, the bodies would overlap"
                )


def _near(x: FloatArray, group: IntArray, translation: FloatArray) -> Iterator[tuple[int, int]]:
    """Pairs of groups of facets x (n, k, d) whose boxes meet on their ways."""
    low, high = np.full_like(translation, np.inf), np.full_like(translation, -np.inf)
    np.minimum.at(low, group, x.min(axis=1))
    np.maximum.at(high, group, x.max(axis=1))
    for one in range(len(translation) - 1):
        way = translation[one] - translation[one + 1 :]
        apart = np.maximum(low[one + 1 :] - high[one], low[one] - high[one + 1 :]).max(axis=1)
        for other in np.flatnonzero(apart <= np.linalg.norm(way, axis=1)):
            yield one, one + 1 + int(other)


def ways_of(translation: FloatArray) -> tuple[IntArray, IntArray]:
    """The first pieces with each translation, but for rounding errors; and (n_pieces,) which of these each piece has."""
    scale = SAME_GAP * max(float(np.abs(translation).max()), np.finfo(float).tiny)
    _, first, alike = np.unique(np.round(translation / scale), axis=0, return_index=True, return_inverse=True)
    return first, alike.ravel()


def _first_hit(joint: Joint, x: FloatArray, rows: IntArray, way: FloatArray, eps: float) -> FloatArray | None:
    """The first of the points (n, d) that meets one of the facets on its way, a length eps along a unit vector."""
    nodes = joint.table.nodes(rows, joint.corners, joint.cell_type)
    if is_tensor(joint.cell_type) and joint.dim == 3:
        nodes = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [3, 1, 2]]])
    facets = joint.points[nodes]
    tolerance = 1e-9 * float(np.ptp(joint.points, axis=0).max())
    start, heights = x @ way, facets @ way
    near = (heights.max(axis=1) > start.min(initial=np.inf) + tolerance) & (
        heights.min(axis=1) < start.max(initial=-np.inf) + eps
    )
    plane = np.linalg.svd(way[None])[2][1:]
    for facet, height in zip(facets[near] @ plane.T, heights[near], strict=True):
        edges = (facet[1:] - facet[0]).T
        if abs(np.linalg.det(edges)) < tolerance ** (joint.dim - 1):
            continue  # the facet is parallel to the way
        weights = np.linalg.solve(edges, (x @ plane.T - facet[0]).T).T
        gap = height[0] + weights @ (height[1:] - height[0]) - start
        inside = (weights > 1e-9).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-9)
        hit = np.flatnonzero(inside & (gap > tolerance) & (gap < eps))
        if len(hit):
            return np.asarray(x[hit[0]], float)
    return None


def require_apart(opened: Joint) -> None:
    """Raise GeometryError if parts of the outer boundary of a joint in 2D cross each other: bodies overlap."""
    outer = opened.table.vertices[opened.table.cells[:, 1] < 0]
    x = opened.points[outer]
    length = float(np.linalg.norm(x[:, 1] - x[:, 0], axis=1).max())
    pairs = cKDTree(x.mean(axis=1)).query_pairs(length, output_type="ndarray")
    one, other = outer[pairs].swapaxes(0, 1) if len(pairs) else (outer[:0], outer[:0])
    apart = ~(one[:, :, None] == other[:, None, :]).any(axis=(1, 2))
    a, b = opened.points[one[apart]], opened.points[other[apart]]

    def beside(of: FloatArray, points: FloatArray) -> FloatArray:
        """Twice the areas of the triangles over a segment, with signs."""
        edge, to = (of[:, 1] - of[:, 0])[:, None], points - of[:, :1]
        return np.asarray(edge[..., 0] * to[..., 1] - edge[..., 1] * to[..., 0])

    tolerance = 1e-12 * length**2
    crossed = np.ones(len(a), bool)
    for of, points in ((a, b), (b, a)):
        left = beside(of, points) > -tolerance  # a vertex on the line counts as left: a chain is crossed there once
        crossed &= left[:, 0] != left[:, 1]
    if crossed.any():
        raise GeometryError(
            f"no room for the layers at {place(a[crossed][0].mean(axis=0))}: moved apart, the bodies would overlap"
        )
