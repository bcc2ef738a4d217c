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
        polygons: (n, k) number of the polygon to which each corner belongs.
        of: (n,) number of the junction of each row.
    """

    copies: IntArray
    sides: IntArray
    polygons: IntArray
    of: IntArray


def junction_corners(joint: Joint, lines: NodeLines, footing: FacetLines) -> tuple[NodeLines, JunctionCorners | None]:
    """Return the corners of all junctions, and add the lines of nodes that close their polygons.

    Lines are added only where a junction is on the outer boundary.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness, at the nodes of S. All lines at junctions have the same number
            of levels.
        footing: the lines at the nodes of each facet of S.

    Returns:
        The given lines of nodes, followed by those that are added; and the corners, None if there are no junctions.

    Raises:
        InputError: layers meet at a vertex or edge, but the bodies between them touch only there; in 3D, edges where
            layers meet come together at a vertex and are not in line.
    """
    links, facets = _junction_lines(joint, lines, footing)
    k = links.shape[1]
    if not len(links):
        return lines, None
    vertices, of_link = unique_rows(lines.nodes[links])
    ends = lines.ends[links]
    copies, at = unique_rows(np.concatenate([ends[..., 0], ends[..., 1]]))
    of = np.empty(len(copies), np.int64)
    of[at] = np.tile(of_link, 2)
    degree = np.bincount(at)
    is_open = (np.bincount(of) - np.bincount(of_link) > 1) | (np.bincount(of, degree > 2) > 0)
    is_open |= np.bincount(of_link, facets > 1) > 0  # two layers between the same bodies
    for column in copies.T:  # a body has one corner at each end
        is_open |= np.bincount(unique_rows(np.column_stack([of, column]))[0][:, 0]) < np.bincount(of)
    complaint = "bodies only touch at a vertex or an edge, between layers that meet there: the layers' ends enclose no"
    refuse(is_open, joint.points[vertices], f"at {{at}} {complaint} polygon")

    end_corners = np.flatnonzero(degree == 1)
    end_corners = end_corners[np.argsort(of[end_corners], kind="stable")].reshape(-1, 2)
    pairs, number = unique_rows(np.sort(copies[end_corners].swapaxes(1, 2).reshape(-1, 2), axis=1))
    nodes = np.empty(len(pairs), np.int64)
    nodes[number] = vertices[of[end_corners[:, 0]]].ravel()
    closing_lines = (len(lines.nodes) + number).reshape(-1, k)
    lines = lines.joined(pairs, nodes, int(lines.seam_no[links[0, 0]]))
    links = np.concatenate([links, closing_lines])
    at = np.concatenate([at[: len(of_link)], end_corners[:, 0], at[len(of_link) :], end_corners[:, 1]])
    sides = links[np.argsort(at, kind="stable") % len(links)].reshape(-1, 2, k).swapaxes(1, 2)
    polygons = _polygons(sides, of)
    pairs, _ = unique_rows(np.column_stack([lines.nodes[sides[..., 0]].ravel(), polygons.ravel()]))
    crossing = "where lines along which layers meet come together: these are not meshed; use the interface model"
    refuse(np.diff(pairs[:, 0]) == 0, joint.points[pairs[1:, 0]], f"S branches at {{at}}, {crossing}")
    return lines, JunctionCorners(copies, sides, polygons, of)


def _junction_lines(joint: Joint, lines: NodeLines, footing: FacetLines) -> tuple[IntArray, IntArray]:
    """Return for each layer that ends at a junction the lines of nodes at its end.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        footing: the lines at the nodes of each facet of S.

    Returns:
        (n, k) ascending numbers of each layer's lines at the k vertices of the junction, one row for each of n ends of
        layers; and (n,) number of facets of S that have these lines.
    """
    is_shared = np.bincount(lines.nodes)[lines.nodes] > 1
    rows = np.concatenate([footing.lines[:, ridge] for ridge in local_facets(FACET_TYPES[joint.cell_type])])
    links, number = unique_rows(np.sort(rows[is_shared[rows].all(axis=1)], axis=1))
    _, junction = unique_rows(lines.nodes[links])
    is_branch = np.bincount(junction)[junction] > 1
    return links[is_branch], np.bincount(number, minlength=len(links))[is_branch]


def _polygons(sides: IntArray, of: IntArray) -> IntArray:
    """Return (n, k) the number of the polygon to which each corner belongs; polygons with the same sides are one.

    Args:
        sides: (n, k, 2) numbers of the two lines of nodes from each corner to its neighbours. There are n rows of
            corners, at the k vertices of their junctions.
        of: (n,) number of the junction of each row.
    """
    k, count = sides.shape[1], np.bincount(of)
    out, first = np.empty(sides.shape[:2], np.int64), 0
    for m in np.unique(count):
        members = np.flatnonzero(count[of] == m)
        members = members[np.argsort(of[members], kind="stable")].reshape(-1, m)
        polygons, number = unique_rows(np.sort(sides[members].swapaxes(1, 2).reshape(-1, 2 * m), axis=1)[:, ::2])
        out[members] = first + number.reshape(-1, 1, k)
        first += len(polygons)
    return out


def common_normals(joint: Joint, footing: FacetLines, corners: JunctionCorners, gap: BoolArray) -> FloatArray:
    """Return for each corner the unit normal that all layers at its junction have in common, or zero if there is none.

    Args:
        joint: the joint as drawn, before S is opened, in d dimensions.
        footing: the lines of nodes at the nodes of each facet of S.
        corners: the n corners of the junctions.
        gap: (n_lines,) whether each line of nodes belongs to a gap, or closes a polygon on the outer boundary. Such
            lines are disregarded.

    Returns:
        (n, d) the normals.
    """
    normals = sum_by_number(footing.lines, joint.node_normals, len(gap))
    normals[gap] = 0.0
    normals[~gap] /= np.maximum(np.linalg.norm(normals[~gap], axis=1, keepdims=True), np.finfo(float).tiny)
    total = sum_by_number(corners.of, normals[corners.sides].sum(axis=(1, 2)), int(corners.of.max()) + 1)
    count = np.bincount(corners.of, (~gap[corners.sides]).sum(axis=(1, 2)))
    length = np.linalg.norm(total, axis=1)
    same = length >= (1 - PLANAR_TOLERANCE**2) * np.maximum(count, 1)
    return np.where(same, 1 / np.maximum(length, np.finfo(float).tiny), 0.0)[corners.of, None] * total[corners.of]
