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
        corner: (n,) row of `JunctionCorners` of the corner whose block contains each cell.
        values: (n_new, d) values at the n_new added nodes, such as their motion in d dimensions.
        s_nodes: (n_new,) for each added node the node of S at which its polygon opens.
    """

    cells: IntArray
    corner: IntArray
    values: FloatArray
    s_nodes: IntArray


def junction_cells(
    joint: Joint, lines: NodeLines, corners: JunctionCorners, values: FloatArray, s_nodes: IntArray
) -> JunctionCells:
    """Return the cells that fill all junctions.

    The nodes that they add are numbered after the last node inside the lines of nodes.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the layers. Those at junctions have an even number of cells, the same for all.
        corners: corners of the polygons at the vertices of each junction.
        values: (n, d) values at nodes and copies, such as their motion in d dimensions; the added nodes get bilinear
            interpolations of them.
        s_nodes: (n,) for each copy the node of S that it copies; for each other node its own number.
    """
    n_half, k = int(lines.last_level[corners.sides.flat[0]]) // 2, corners.copies.shape[1]
    copies, sides, polygons = corners.copies.ravel(), corners.sides.reshape(-1, 2), corners.polygon.ravel()
    n_corners, polygon_nodes = np.bincount(polygons), np.empty(int(polygons.max()) + 1, np.int64)
    polygon_nodes[polygons] = s_nodes[copies]
    centre_values = sum_by_number(polygons, values[copies], len(n_corners)) / n_corners[:, None]
    key_point_values = np.concatenate([values, values[lines.ends].mean(axis=1), centre_values])
    key_point_nodes = np.concatenate([s_nodes, lines.feet, polygon_nodes])
    key_point_numbers = np.column_stack([copies, len(values) + sides, len(values) + len(lines.feet) + polygons])

    level = np.arange(n_half + 1)
    p, q = np.meshgrid(level, level, indexing="ij")  # from the corner towards the first and the second middle
    weights = np.stack([(n_half - p) * (n_half - q), p * (n_half - q), (n_half - p) * q, p * q], axis=-1)
    radix = n_half**2 + 1
    codes = np.where(weights > 0, key_point_numbers[:, None, None] * radix + weights, -1)
    unique_codes, inverse = np.unique(np.sort(codes.reshape(-1, 4), axis=1), axis=0, return_inverse=True)
    code_no, node_numbers = inverse.reshape(codes.shape[:3]), np.full(len(unique_codes), -1)
    for side, side_codes in zip(sides.T, (code_no[:, :, 0], code_no[:, 0]), strict=True):
        starts_here = (lines.ends[side, 0] == copies)[:, None]
        node_numbers[side_codes] = lines.node_numbers(side[:, None], np.where(starts_here, level, 2 * n_half - level))
    new_codes = np.flatnonzero(node_numbers < 0)
    node_numbers[new_codes] = lines.first_inner_node + lines.n_inner_nodes + np.arange(len(new_codes))
    key, weight = np.divmod(unique_codes[new_codes], radix)
    new_values = np.einsum("nk,nkd->nd", np.where(key < 0, 0, weight) / n_half**2, key_point_values[key])

    grid = node_numbers[code_no]
    quad_nodes = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]], axis=-1)
    quads = quad_nodes.reshape(len(corners.junc), k, n_half * n_half, 4)
    if is_tensor(joint.cell_type):
        cells: IntArray = quads.swapaxes(1, 2).reshape(len(quads), n_half * n_half, 4 * k)
    else:
        cells = _extrude(_split_quads(quads, lines.ends[corners.sides[:, 0], 0] != corners.copies[:, :1]))
    corner_numbers = np.repeat(np.arange(len(quads)), cells.shape[1])
    return JunctionCells(cells.reshape(-1, cells.shape[2]), corner_numbers, new_values, key_point_nodes[key[:, -1]])


def _split_quads(quads: IntArray, is_reversed: BoolArray) -> IntArray:
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
    quads_per_side = round(quads.shape[2] ** 0.5)
    p, q = np.divmod(np.arange(quads_per_side * quads_per_side), quads_per_side)
    triangles = []
    for third, at_side, flip in ((1, q == 0, is_reversed[:, 0]), (2, p == 0, is_reversed[:, 1])):
        vertices = quads[..., [0, third, 3]]
        triangles.append(np.where((flip[:, None] & at_side)[:, None, :, None], vertices[..., [1, 0, 2]], vertices))
    return np.concatenate(triangles, axis=2)


def _extrude(triangles: IntArray) -> IntArray:
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
    tetrahedra = [np.concatenate([low[..., : j + 1], high[..., j:]], axis=2) for j in range(low.shape[2])]
    return np.concatenate(tetrahedra, axis=1)
