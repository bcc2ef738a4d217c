"""Blocks of cells that fill junctions, each divided into a grid.

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
        cells: (n, k) nodes of the cells.
        corners: (n,) row of each cell's corner in `JunctionCorners`.
        values: (n_new, d) values at the new nodes.
        nodes: (n_new,) the node of S below each new node.
    """

    cells: IntArray
    corners: IntArray
    values: FloatArray
    nodes: IntArray


def junction_cells(
    joint: Joint, lines: NodeLines, corners: JunctionCorners, values: FloatArray, nodes: IntArray
) -> JunctionCells:
    """Cells in junctions. Their new nodes are numbered after the nodes of the node lines.

    Args:
        joint: the joint before inflating.
        lines: all node lines; at junctions they have one even number of cells.
        corners: corners of the polygons at the vertices of each junction.
        values: (n, d) values at the copies of nodes, interpolated bilinearly in the blocks.
        nodes: (n,) the node of S below each copy.
    """
    half, k = int(lines.top[corners.sides.flat[0]]) // 2, corners.copies.shape[1]
    copies, sides, polygons = corners.copies.ravel(), corners.sides.reshape(-1, 2), corners.polygons.ravel()
    count, of_centres = np.bincount(polygons), np.empty(int(polygons.max()) + 1, np.int64)
    of_centres[polygons] = nodes[copies]
    centres = sum_by_number(polygons, values[copies], len(count)) / count[:, None]
    key_values = np.concatenate([values, values[lines.ends].mean(axis=1), centres])
    key_nodes = np.concatenate([nodes, lines.nodes, of_centres])
    keys = np.column_stack([copies, len(values) + sides, len(values) + len(lines.nodes) + polygons])

    level = np.arange(half + 1)
    p, q = np.meshgrid(level, level, indexing="ij")  # from the corner towards the first and the second middle
    weights = np.stack([(half - p) * (half - q), p * (half - q), (half - p) * q, p * q], axis=-1)
    base = half**2 + 1
    codes = np.where(weights > 0, keys[:, None, None] * base + weights, -1)
    unique_codes, inverse = np.unique(np.sort(codes.reshape(-1, 4), axis=1), axis=0, return_inverse=True)
    at, number = inverse.reshape(codes.shape[:3]), np.full(len(unique_codes), -1)
    for side, on_side in zip(sides.T, (at[:, :, 0], at[:, 0]), strict=True):
        first = (lines.ends[side, 0] == copies)[:, None]
        number[on_side] = lines.number(side[:, None], np.where(first, level, 2 * half - level))
    new = np.flatnonzero(number < 0)
    number[new] = lines.first_new + lines.size + np.arange(len(new))
    key, weight = np.divmod(unique_codes[new], base)
    added = np.einsum("nk,nkd->nd", np.where(key < 0, 0, weight) / half**2, key_values[key])

    grid = number[at]
    pieces = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]], axis=-1)
    quads = pieces.reshape(len(corners.of), k, half * half, 4)
    if is_tensor(joint.cell_type):
        cells: IntArray = quads.swapaxes(1, 2).reshape(len(quads), half * half, 4 * k)
    else:
        cells = _extruded(_halved(quads, lines.ends[corners.sides[:, 0], 0] != corners.copies[:, :1]))
    rows = np.repeat(np.arange(len(quads)), cells.shape[1])
    return JunctionCells(cells.reshape(-1, cells.shape[2]), rows, added, key_nodes[key[:, -1]])


def _halved(quads: IntArray, back: BoolArray) -> IntArray:
    """Triangles (n, k, 2 m, 3) from the quadrilaterals (n, k, m, 4) of blocks, halved from the corner to the centre.

    This suits corners of all angles. Vertices are in the same order wherever triangles share an edge; along node lines
    this is the order of the levels.

    Args:
        quads: quadrilaterals of the blocks.
        back: (n, 2) whether the node lines at the block's two outer sides lead towards its corner.
    """
    half = round(quads.shape[2] ** 0.5)
    p, q = np.divmod(np.arange(half * half), half)
    out = []
    for middle, outer, turned in ((1, q == 0, back[:, 0]), (2, p == 0, back[:, 1])):
        rows = quads[..., [0, middle, 3]]
        out.append(np.where((turned[:, None] & outer)[:, None, :, None], rows[..., [1, 0, 2]], rows))
    return np.concatenate(out, axis=2)


def _extruded(triangles: IntArray) -> IntArray:
    """Cells between the triangles (n, k, m, 3) at the k vertices of junctions; in 3D prisms, split as in bands."""
    if triangles.shape[1] == 1:
        return triangles[:, 0]
    low, high = triangles[:, 0], triangles[:, 1]
    steps = [np.concatenate([low[..., : j + 1], high[..., j:]], axis=2) for j in range(low.shape[2])]
    return np.concatenate(steps, axis=1)
