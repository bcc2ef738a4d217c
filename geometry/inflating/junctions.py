"""Junctions: vertices (2D) or edges (3D) of S where three or more bodies meet, and the space that opens there.

When the bodies move apart, a polygon opens at each vertex of a junction. Its corners are the copies of the vertex, one
on each body. Its sides are lines of nodes through the thickness, at the ends of the layers that meet there. If the
junction is on the outer boundary, one further side there closes the polygon.

In 2D the polygon is the space that opens. In 3D a prism opens, between the polygons at the two ends of an edge. Edges
on one straight line share the polygon at their common vertex. Where other edges meet at a vertex, a polyhedron would
open; joints of this kind are refused.

Cells that fill junctions: the polygon that opens there is divided into blocks, and each block into a grid.

A polygon has a quadrilateral block at each corner. The four key points of a block are the corner, the middles of the
two sides that meet there, and the polygon's centre. Each node of the block's grid is a bilinear interpolation of the
key points. In a uniform grid it would have integer weights; nodes of two blocks are the same node if these are equal on
equal key points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.inflating.band_cells import FacetLines, NodeLines
from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import refuse
from geometry.topology import (
    FACET_TYPES,
    BoolArray,
    FloatArray,
    IntArray,
    is_tensor,
    local_facets,
    sum_by_number,
    unique_rows,
)


class JunctionCorners(NamedTuple):
    """The n corners of all junctions: each row belongs to one body at one junction.

    In 2D a junction has one vertex, k = 1. In 3D it is an edge with two vertices, k = 2, and one polygon opens at each.
    A row then has the body's corners in both polygons.

    Attributes:
        copies: (n, k) number of the body's copy of each vertex; the vertices of a junction are in ascending order.
        sides: (n, k, 2) numbers of the two lines of nodes that lead from each corner to its neighbours in the polygon.
        polygon: (n, k) number of the polygon to which each corner belongs.
        junc: (n,) number of the junction of each row.
    """

    copies: IntArray
    sides: IntArray
    polygon: IntArray
    junc: IntArray


def junction_corners(joint: Joint, lines: NodeLines, s_lines: FacetLines) -> tuple[NodeLines, JunctionCorners | None]:
    """Return the corners of all junctions, and add the lines of nodes that close their polygons.

    Lines are added only where a junction is on the outer boundary.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness, at the nodes of S. All lines at junctions have the same number
            of levels.
        s_lines: the lines at the nodes of each facet of S.

    Returns:
        The given lines of nodes, followed by those that are added; and the corners, None if there are no junctions.

    Raises:
        InputError: layers meet at a vertex or edge, but the bodies between them touch only there; in 3D, edges where
            layers meet come together at a vertex and are not in line.
    """
    end_lines, n_facets = _layer_end_lines(joint, lines, s_lines)
    k = end_lines.shape[1]
    if not len(end_lines):
        return lines, None
    vertices, end_junc = unique_rows(lines.feet[end_lines])
    end_copies = lines.ends[end_lines]
    copies, corner = unique_rows(np.concatenate([end_copies[..., 0], end_copies[..., 1]]))
    junction = np.empty(len(copies), np.int64)
    junction[corner] = np.tile(end_junc, 2)
    n_ends = np.bincount(corner)
    is_open = (np.bincount(junction) - np.bincount(end_junc) > 1) | (np.bincount(junction, n_ends > 2) > 0)
    is_open |= np.bincount(end_junc, n_facets > 1) > 0  # two layers between the same bodies
    for copy in copies.T:  # a body has one corner at each end
        is_open |= np.bincount(unique_rows(np.column_stack([junction, copy]))[0][:, 0]) < np.bincount(junction)
    complaint = "bodies only touch at a vertex or an edge, between layers that meet there: the layers' ends enclose no"
    refuse(is_open, joint.points[vertices], f"at {{at}} {complaint} polygon")

    end_corners = np.flatnonzero(n_ends == 1)
    end_corners = end_corners[np.argsort(junction[end_corners], kind="stable")].reshape(-1, 2)
    closing_ends, closing_no = unique_rows(np.sort(copies[end_corners].swapaxes(1, 2).reshape(-1, 2), axis=1))
    closing_nodes = np.empty(len(closing_ends), np.int64)
    closing_nodes[closing_no] = vertices[junction[end_corners[:, 0]]].ravel()
    closing_lines = (len(lines.feet) + closing_no).reshape(-1, k)
    lines = lines.with_lines(closing_ends, closing_nodes, int(lines.seam_no[end_lines[0, 0]]))
    end_lines = np.concatenate([end_lines, closing_lines])
    corner = np.concatenate([corner[: len(end_junc)], end_corners[:, 0], corner[len(end_junc) :], end_corners[:, 1]])
    side_lines = end_lines[np.argsort(corner, kind="stable") % len(end_lines)].reshape(-1, 2, k).swapaxes(1, 2)
    polygons = _number_polygons(side_lines, junction)
    polygons_at, _ = unique_rows(np.column_stack([lines.feet[side_lines[..., 0]].ravel(), polygons.ravel()]))
    crossing_text = "where lines along which layers meet come together: these are not meshed; use the interface model"
    refuse(np.diff(polygons_at[:, 0]) == 0, joint.points[polygons_at[1:, 0]], f"S branches at {{at}}, {crossing_text}")
    return lines, JunctionCorners(copies, side_lines, polygons, junction)


def _layer_end_lines(joint: Joint, lines: NodeLines, s_lines: FacetLines) -> tuple[IntArray, IntArray]:
    """Return for each layer that ends at a junction the lines of nodes at its end.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        s_lines: the lines at the nodes of each facet of S.

    Returns:
        (n, k) ascending numbers of each layer's lines at the k vertices of the junction, one row for each of n ends of
        layers; and (n,) number of facets of S that have these lines.
    """
    is_shared = np.bincount(lines.feet)[lines.feet] > 1
    ridges = np.concatenate([s_lines.line_numbers[:, ridge] for ridge in local_facets(FACET_TYPES[joint.cell_type])])
    end_lines, end_no = unique_rows(np.sort(ridges[is_shared[ridges].all(axis=1)], axis=1))
    _, junction = unique_rows(lines.feet[end_lines])
    is_branch = np.bincount(junction)[junction] > 1
    return end_lines[is_branch], np.bincount(end_no, minlength=len(end_lines))[is_branch]


def _number_polygons(sides: IntArray, junction: IntArray) -> IntArray:
    """Return (n, k) the number of the polygon to which each corner belongs; polygons with the same sides are one.

    Args:
        sides: (n, k, 2) numbers of the two lines of nodes from each corner to its neighbours. There are n rows of
            corners, at the k vertices of their junctions.
        junction: (n,) number of the junction of each row.
    """
    k, n_corners = sides.shape[1], np.bincount(junction)
    out, first_number = np.empty(sides.shape[:2], np.int64), 0
    for m in np.unique(n_corners):
        members = np.flatnonzero(n_corners[junction] == m)
        members = members[np.argsort(junction[members], kind="stable")].reshape(-1, m)
        polygons, number = unique_rows(np.sort(sides[members].swapaxes(1, 2).reshape(-1, 2 * m), axis=1)[:, ::2])
        out[members] = first_number + number.reshape(-1, 1, k)
        first_number += len(polygons)
    return out


def common_normals(joint: Joint, s_lines: FacetLines, corners: JunctionCorners, is_gap: BoolArray) -> FloatArray:
    """Return for each corner the unit normal that all layers at its junction have in common, or zero if there is none.

    Args:
        joint: the joint as drawn, before S is opened, in d dimensions.
        s_lines: the lines of nodes at the nodes of each facet of S.
        corners: the n corners of the junctions.
        is_gap: (n_lines,) whether each line of nodes belongs to a gap, or closes a polygon on the outer boundary. Such
            lines are disregarded.

    Returns:
        (n, d) the normals.
    """
    normals = sum_by_number(s_lines.line_numbers, joint.node_normals, len(is_gap))
    normals[is_gap] = 0.0
    normals[~is_gap] /= np.maximum(np.linalg.norm(normals[~is_gap], axis=1, keepdims=True), np.finfo(float).tiny)
    total = sum_by_number(corners.junc, normals[corners.sides].sum(axis=(1, 2)), int(corners.junc.max()) + 1)
    n_terms = np.bincount(corners.junc, (~is_gap[corners.sides]).sum(axis=(1, 2)))
    length = np.linalg.norm(total, axis=1)
    same = length >= (1 - PLANAR_TOLERANCE**2) * np.maximum(n_terms, 1)
    return np.where(same, 1 / np.maximum(length, np.finfo(float).tiny), 0.0)[corners.junc, None] * total[corners.junc]


# ---------------------------------------------------------------- cells that fill junctions
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
        lines: all lines of nodes through the layers. Those at junctions have an even number of cells and symmetric
            heights, the same for all.
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
    unique_codes, first, inverse = np.unique(
        np.sort(codes.reshape(-1, 4), axis=1), axis=0, return_index=True, return_inverse=True
    )
    code_no, node_numbers = inverse.reshape(codes.shape[:3]), np.full(len(unique_codes), -1)
    for side, side_codes in zip(sides.T, (code_no[:, :, 0], code_no[:, 0]), strict=True):
        starts_here = (lines.ends[side, 0] == copies)[:, None]
        node_numbers[side_codes] = lines.node_numbers(side[:, None], np.where(starts_here, level, 2 * n_half - level))
    new_codes = np.flatnonzero(node_numbers < 0)
    node_numbers[new_codes] = lines.first_inner_node + lines.n_inner_nodes + np.arange(len(new_codes))
    corner, at_p, at_q = np.unravel_index(first[new_codes], codes.shape[:3])
    to_middle = 2 * lines.heights[lines.seam_no[corners.sides.flat[0]]]  # 0 at the corner, 1 at the middles
    a, b = to_middle[at_p], to_middle[at_q]
    shares = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b], axis=-1)
    new_values = np.einsum("nk,nkd->nd", shares, key_point_values[key_point_numbers[corner]])
    new_nodes = key_point_nodes[unique_codes[new_codes, -1] // radix]

    grid = node_numbers[code_no]
    quad_nodes = np.stack([grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, :-1, 1:], grid[:, 1:, 1:]], axis=-1)
    quads = quad_nodes.reshape(len(corners.junc), k, n_half * n_half, 4)
    if is_tensor(joint.cell_type):
        cells: IntArray = quads.swapaxes(1, 2).reshape(len(quads), n_half * n_half, 4 * k)
    else:
        cells = _extrude(_split_quads(quads, lines.ends[corners.sides[:, 0], 0] != corners.copies[:, :1]))
    corner_numbers = np.repeat(np.arange(len(quads)), cells.shape[1])
    return JunctionCells(cells.reshape(-1, cells.shape[2]), corner_numbers, new_values, new_nodes)


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
