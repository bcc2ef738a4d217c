"""Junctions: vertices (2D) or edges (3D) of S where three or more bodies meet, and the space that opens there.

When the bodies move apart, a polygon opens at each vertex of a junction. Its corners are the copies of the vertex, one
on each body. Its sides are lines of nodes through the thickness, at the ends of the layers that meet there. If the
junction is on the outer boundary, one further side there closes the polygon.

In 2D the polygon is the space that opens. In 3D a prism opens, between the polygons at the two ends of an edge. Edges
on one straight line share the polygon at their common vertex. Where other edges meet at a vertex, a polyhedron would
open; joints of this kind are refused.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.inflating.band_cells import FacetLines, NodeLines
from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import refuse
from geometry.topology import FACET_TYPES, BoolArray, FloatArray, IntArray, local_facets, sum_by_number, unique_rows


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
