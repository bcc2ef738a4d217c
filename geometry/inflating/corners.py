"""Junctions: vertices (2D) or edges (3D) of S where three or more bodies meet, and the space that opens there.

When the bodies part, a polygon opens at each vertex of a junction. Its corners are the copies of the vertex, one on
each body. Its sides are lines of nodes through the thickness, at the ends of the layers. On the outer boundary one more
side closes it. In 2D the polygon is the junction. In 3D the junction is a prism between the polygons at the two ends of
an edge. Edges on one line have one polygon at their common vertex. Where other edges meet at a vertex a polyhedron
would open, which is not meshed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.inflating.band_cells import FacetLines, NodeLines
from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import refuse
from geometry.topology import FACET_TYPES, BoolArray, FloatArray, IntArray, local_facets, sum_by_number, unique_rows


class JunctionCorners(NamedTuple):
    """Corners of the polygons that open at junctions: n rows, each with the corners of one body at the k vertices.

    A junction has one vertex in 2D, k = 1, and the two vertices of an edge in 3D, k = 2.

    Attributes:
        copies: (n, k) the body's copy of each vertex; the vertices of a junction are in ascending order.
        sides: (n, k, 2) numbers of the node lines from each corner to its two neighbours in the polygon.
        polygons: (n, k) number of the polygon that each corner is in.
        of: (n,) number of the junction.
    """

    copies: IntArray
    sides: IntArray
    polygons: IntArray
    of: IntArray


def junction_corners(joint: Joint, lines: NodeLines, footing: FacetLines) -> tuple[NodeLines, JunctionCorners | None]:
    """Return all node lines, with those that close polygons on the outer boundary, and the corners of junctions.

    Without junctions the corners are None.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness, at the nodes of S; those at junctions have one number of
            levels.
        footing: the lines at the nodes of each facet of S.

    Raises:
        InputError: between layers that meet, bodies touch only at a vertex or along an edge; in 3D, edges where layers
            meet come together at a vertex.
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
    """Return for each layer that ends at a junction the node lines of its end, and its number of facets there.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        footing: the lines at the nodes of each facet of S.

    Returns:
        (n, k) numbers of the lines, in ascending order, at the k vertices of the junction; (n,) number of facets of S
        that touch the junction with the same lines.
    """
    is_shared = np.bincount(lines.nodes)[lines.nodes] > 1
    rows = np.concatenate([footing.lines[:, ridge] for ridge in local_facets(FACET_TYPES[joint.cell_type])])
    links, number = unique_rows(np.sort(rows[is_shared[rows].all(axis=1)], axis=1))
    _, junction = unique_rows(lines.nodes[links])
    is_branch = np.bincount(junction)[junction] > 1
    return links[is_branch], np.bincount(number, minlength=len(links))[is_branch]


def _polygons(sides: IntArray, of: IntArray) -> IntArray:
    """Return (n, k) number of the polygon of each corner; polygons with the same sides have one number.

    Args:
        sides: (n, k, 2) numbers of the node lines from each corner to its neighbours, for n bodies at the k vertices of
            a junction.
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
    """Return (n, d) the unit normal common to all layers at the junction of each of n corners; zero if they differ.

    Args:
        joint: the joint as drawn, before S is opened, in d dimensions.
        footing: numbers of the node lines at the nodes of each facet of S.
        corners: corners of the polygons at junctions.
        gap: (n_lines,) whether each node line belongs to a gap, or closes a polygon on the outer boundary.
    """
    normals = sum_by_number(footing.lines, joint.node_normals, len(gap))
    normals[gap] = 0.0
    normals[~gap] /= np.maximum(np.linalg.norm(normals[~gap], axis=1, keepdims=True), np.finfo(float).tiny)
    total = sum_by_number(corners.of, normals[corners.sides].sum(axis=(1, 2)), int(corners.of.max()) + 1)
    count = np.bincount(corners.of, (~gap[corners.sides]).sum(axis=(1, 2)))
    length = np.linalg.norm(total, axis=1)
    same = length >= (1 - PLANAR_TOLERANCE**2) * np.maximum(count, 1)
    return np.where(same, 1 / np.maximum(length, np.finfo(float).tiny), 0.0)[corners.of, None] * total[corners.of]
