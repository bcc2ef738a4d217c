"""Cells that fill junctions: the polygon that opens there is divided into blocks, and each block into a grid.

A polygon has a quadrilateral block at each corner. The four key points of a block are the corner, the middles of the
two sides that meet there, and the polygon's centre. Each node of the block's grid is a bilinear interpolation of the
key points with integer weights. Nodes of two blocks are the same node if they have equal weights on equal key points.
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
        corners: (n,) row of `JunctionCorners` of the corner whose block contains each cell.
        values: (n_new, d) values at the n_new added nodes, such as their motion in d dimensions.
        nodes: (n_new,) for each added node the node of S at which its polygon opens.
    """

    cells: IntArray
    corners: IntArray
    values: FloatArray
    nodes: IntArray


def junction_cells(
    joint: Joint, lines: NodeLines, corners: JunctionCorners, values: FloatArray, nodes: IntArray
) -> JunctionCells:
    """Return the cells that fill all junctions.

    The nodes that they add are numbered after the last node inside the lines of nodes.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the layers. Those at junctions have an even number of cells, the same for all.
        corners: corners of the polygons at the vertices of each junction.
        values: (n, d) values at nodes and copies, such as their motion in d dimensions; the added nodes get bilinear
            interpolations of them.
        nodes: (n,) for each copy the node of S that it copies; for each other node its own number.
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
    """Return triangles that halve the quadrilaterals of blocks, each along its diagonal from the corner to the centre.

    If two triangles share an edge, its two ends have the same order in both. Along lines of nodes this is the order of
    levels.

    Args:
        quads: (n, k, m, 4) vertices of the m quadrilaterals of each of n blocks at each of the k vertices of its
            junction.
        is_reversed: (n, 2) whether the lines of nodes at the two sides of each block that meet in its corner lead
            towards the corner.

    Returns:
        (n, k, 2 m, 3) numbers of the vertices of the triangles.
    """
    n_side = round(quads.shape[2] ** 0.5)
    p, q = np.divmod(np.arange(n_side * n_side), n_side)
    triangles = []
    for middle, outer, flip in ((1, q == 0, is_reversed[:, 0]), (2, p == 0, is_reversed[:, 1])):
        rows = quads[..., [0, middle, 3]]
        triangles.append(np.where((flip[:, None] & outer)[:, None, :, None], rows[..., [1, 0, 2]], rows))
    return np.concatenate(triangles, axis=2)


def _extruded(triangles: IntArray) -> IntArray:
    """Return the cells of blocks from the triangles of their cross sections.

    In 2D, k = 1, the cells are the triangles. In 3D, k = 2, a junction is an edge, and a block has the same triangles
    at its two ends. Each prism between them is split into three tetrahedra.

    Args:
        triangles: (n, k, m, 3) numbers of the vertices of m triangles for each of n blocks at each of k vertices of its
            junction.

    Returns:
        (n, m, 3) in 2D, (n, 3 m, 4) in 3D: numbers of the vertices of the cells of each block.
    """
    if triangles.shape[1] == 1:
        return triangles[:, 0]
    low, high = triangles[:, 0], triangles[:, 1]
    prisms = [np.concatenate([low[..., : j + 1], high[..., j:]], axis=2) for j in range(low.shape[2])]
    return np.concatenate(prisms, axis=1)
