"""Cells that fill junctions: the polygon that opens there is divided into blocks, and each block into a grid.

A polygon has a quadrilateral block at each corner: between the corner, the middles of its two sides, and the centre.
Each node of the grid is identified by bilinear integer weights on these four key points. Blocks share a node if it has
the same weights on the same key points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.inflating.band_cells import NodeLines
from geometry.inflating.corners import JunctionCorners
from geometry.joint import Joint
from geometry.topology import BoolArray, FloatArray, IntArray, is_tensor, sum_by_number


class JunctionCells(NamedTuple):
    """Cells in junctions and the nodes that they add.

    Attributes:
        cells: (n, k) numbers of the k nodes of each cell.
        corners: (n,) number of the row of `JunctionCorners`, a polygon's corner, in whose block each cell lies.
        values: (n_new, d) values at the new nodes, such as their motion in d dimensions.
        nodes: (n_new,) the node of S at which the polygon of each new node opens.
    """

    cells: IntArray
    corners: IntArray
    values: FloatArray
    nodes: IntArray


def junction_cells(
    joint: Joint, lines: NodeLines, corners: JunctionCorners, values: FloatArray, nodes: IntArray
) -> JunctionCells:
    """Return the cells in junctions; numbers of their new nodes follow those of the nodes inside node lines.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the layers; those at junctions have one even number of cells.
        corners: corners of the polygons at the vertices of each junction.
        values: (n, d) values at nodes and copies, such as their motion in d dimensions; new nodes get bilinear
            interpolations.
        nodes: (n,) the node of S of each copy, and of other nodes their own number.
    """
    half, k = int(lines.top[corners.sides.flat[0]]) // 2, corners.copies.shape[1]
    copies, sides, polygons = corners.copies.ravel(), corners.sides.reshape(-1, 2), corners.polygons.ravel()
    count, centre_nodes = np.bincount(polygons), np.empty(int(polygons.max()) + 1, np.int64)
    centre_nodes[polygons] = nodes[copies]
    centres = sum_by_number(polygons, values[copies], len(count)) / count[:, None]
    key_values = np.concatenate([values, values[lines.ends].mean(axis=1), centres])
    key_nodes = np.concatenate([nodes, lines.nodes, centre_nodes])
    keys = np.column_stack([copies, len(values) + sides, len(values) + len(lines.nodes) + polygons])

    level = np.arange(half + 1)
    p, q = np.meshgrid(level, level, indexing="ij")  # from the corner towards the first and the second middle
    weights = np.stack([(half - p) * (half - q), p * (half - q), (half - p) * q, p * q], axis=-1)
    base = half**2 + 1
    codes = np.where(weights > 0, keys[:, None, None] * base + weights, -1)
    unique_codes, inverse = np.unique(np.sort(codes.reshape(-1, 4), axis=1), axis=0, return_inverse=True)
    at, number = inverse.reshape(codes.shape[:3]), np.full(len(unique_codes), -1)
    for side, side_codes in zip(sides.T, (at[:, :, 0], at[:, 0]), strict=True):
        starts_here = (lines.ends[side, 0] == copies)[:, None]
        number[side_codes] = lines.number(side[:, None], np.where(starts_here, level, 2 * half - level))
    new = np.flatnonzero(number < 0)
    number[new] = lines.first_new + lines.size + np.arange(len(new))
    key, weight = np.divmod(unique_codes[new], base)
    new_values = np.einsum("nk,nkd->nd", np.where(key < 0, 0, weight) / half**2, key_values[key])

    grid = number[at]
    pieces = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]], axis=-1)
    quads = pieces.reshape(len(corners.of), k, half * half, 4)
    if is_tensor(joint.cell_type):
        cells: IntArray = quads.swapaxes(1, 2).reshape(len(quads), half * half, 4 * k)
    else:
        cells = _extruded(_halved(quads, lines.ends[corners.sides[:, 0], 0] != corners.copies[:, :1]))
    rows = np.repeat(np.arange(len(quads)), cells.shape[1])
    return JunctionCells(cells.reshape(-1, cells.shape[2]), rows, new_values, key_nodes[key[:, -1]])


def _halved(quads: IntArray, is_reversed: BoolArray) -> IntArray:
    """Return triangles (n, k, 2 m, 3) from the quadrilaterals (n, k, m, 4) of blocks, halved from corner to centre.

    This suits corners of all angles. Vertices are in the same order wherever triangles share an edge; along node lines
    this is the order of the levels.

    Args:
        quads: numbers of the vertices of m quadrilaterals in each of n blocks, at each of k vertices of a junction.
        is_reversed: (n, 2) whether the node lines at the block's two outer sides lead towards its corner.
    """
    n_side = round(quads.shape[2] ** 0.5)
    p, q = np.divmod(np.arange(n_side * n_side), n_side)
    triangles = []
    for middle, outer, flip in ((1, q == 0, is_reversed[:, 0]), (2, p == 0, is_reversed[:, 1])):
        rows = quads[..., [0, middle, 3]]
        triangles.append(np.where((flip[:, None] & outer)[:, None, :, None], rows[..., [1, 0, 2]], rows))
    return np.concatenate(triangles, axis=2)


def _extruded(triangles: IntArray) -> IntArray:
    """Return cells over the triangles (n, k, m, 3) of n blocks at the k vertices of junctions, 1 in 2D, 2 in 3D.

    In 2D these are the triangles. In 3D they are tetrahedra of prisms between triangles at two vertices, split as in
    bands.
    """
    if triangles.shape[1] == 1:
        return triangles[:, 0]
    low, high = triangles[:, 0], triangles[:, 1]
    prisms = [np.concatenate([low[..., : j + 1], high[..., j:]], axis=2) for j in range(low.shape[2])]
    return np.concatenate(prisms, axis=1)
