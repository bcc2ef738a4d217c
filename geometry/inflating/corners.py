"""Junctions: where three or more bodies meet on S, vertices of S in 2D and edges of S in 3D, and what is left open there.

When the bodies part, a polygon opens at each vertex of a junction: its corners are the copies of the vertex, one on each
body, its sides the posts at the ends of the layers. On the outer boundary one more side closes it. In 2D the polygon is the
junction. In 3D the junction is a prism between the polygons at the two ends of an edge. Edges in line have one polygon at
their common vertex. Other polygons at a vertex are the faces of a polyhedron, whose edges are the posts there; on the outer
boundary one more polygon closes it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geometry.inflating.bands import Footing, Posts
from geometry.joint import FLAT, Joint
from geometry.refusals import refuse
from geometry.topology import FACET_TYPES, BoolArray, FloatArray, IntArray, connected, lagrange, sums


class Corners(NamedTuple):
    """Corners of polygons; k of them, one at each vertex of a junction, belong together.

    Attributes:
        copies: (n, k) copy of a vertex of S at each corner; k vertices of a junction in ascending order of their numbers.
        sides: (n, k, 2) posts from there to the next two corners.
        polygons: (n, k) number of the polygon.
        of: (n,) number of the junction, or of the polyhedron.
    """

    copies: IntArray
    sides: IntArray
    polygons: IntArray
    of: IntArray

    @classmethod
    def none(cls, k: int) -> Corners:
        """No corners."""
        return cls(*(np.empty(shape, np.int64) for shape in ((0, k), (0, k, 2), (0, k), 0)))


def junction_posts(posts: Posts) -> IntArray:
    """Posts at nodes that have several of them, in the order of the nodes."""
    count = np.bincount(posts.nodes)
    found = np.flatnonzero(count[posts.nodes] > 1)
    return found[np.argsort(posts.nodes[found], kind="stable")]


def junctions_of(joint: Joint, posts: Posts, footing: Footing) -> tuple[Posts, Corners]:
    """The corners of junctions, and all posts, with those that close the polygons on the outer boundary.

    Args:
        joint: the joint before inflating.
        posts: all posts at the nodes of S; those at junctions have one number of levels.
        footing: where the facets have them.

    Raises:
        InputError: bodies that touch at a vertex, or along an edge, only lie between the layers that end there.
    """
    links, facets = _links(joint, posts, footing)
    k = links.shape[1]
    if not len(links):
        return posts, Corners.none(k)
    vertices, of_link = _numbered(posts.nodes[links])
    ends = posts.ends[links]
    copies, at = _numbered(np.concatenate([ends[..., 0], ends[..., 1]]))
    of = np.empty(len(copies), np.int64)
    of[at] = np.tile(of_link, 2)
    degree = np.bincount(at)
    loose = (np.bincount(of) - np.bincount(of_link) > 1) | (np.bincount(of, degree > 2) > 0)
    loose |= np.bincount(of_link, facets > 1) > 0  # two layers between the same bodies
    for column in copies.T:  # a body has one corner at each end
        loose |= np.bincount(_numbered(np.column_stack([of, column]))[0][:, 0]) < np.bincount(of)
    touching = "bodies only touch at a vertex or an edge, between layers that meet there: the layers' ends enclose no"
    refuse(loose, joint.points[vertices], f"at {{at}} {touching} polygon")

    alone = np.flatnonzero(degree == 1)
    alone = alone[np.argsort(of[alone], kind="stable")].reshape(-1, 2)
    posts, closing = _closed(posts, links, copies[alone], vertices[of[alone[:, 0]]])
    links = np.concatenate([links, closing])
    at = np.concatenate([at[: len(of_link)], alone[:, 0], at[len(of_link) :], alone[:, 1]])
    sides = links[np.argsort(at, kind="stable") % len(links)].reshape(-1, 2, k).swapaxes(1, 2)
    return posts, Corners(copies, sides, _polygons(sides, of), of)


def _links(joint: Joint, posts: Posts, footing: Footing) -> tuple[IntArray, IntArray]:
    """(n, k) the posts at the k vertices of each junction, for each layer that ends there, in ascending order.

    And (n,) the number of facets of S that each joins to the junction.
    """
    several = np.bincount(posts.nodes)[posts.nodes] > 1
    ridges = lagrange(FACET_TYPES[joint.cell_type], 1).entity_closure_dofs[-2]
    rows = np.concatenate([footing.posts[:, ridge] for ridge in ridges])
    links, number = _numbered(np.sort(rows[several[rows].all(axis=1)], axis=1))
    _, place = _numbered(posts.nodes[links])
    branches = np.bincount(place)[place] > 1
    return links[branches], np.bincount(number, minlength=len(links))[branches]


def _numbered(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Different rows in lexicographic order, and the number of each given one among them."""
    found, number = np.unique(rows, axis=0, return_inverse=True)
    return found, number.ravel()


def _closed(posts: Posts, links: IntArray, ends: IntArray, vertices: IntArray) -> tuple[Posts, IntArray]:
    """All posts, with further ones between pairs of copies; (n, k) numbers of the latter.

    Args:
        posts: all posts so far.
        links: (m, k) posts of junctions.
        ends: (n, 2, k) pairs of copies.
        vertices: (n, k) vertices of S.
    """
    pairs, number = _numbered(np.sort(ends.swapaxes(1, 2).reshape(-1, 2), axis=1))
    nodes = np.empty(len(pairs), np.int64)
    nodes[number] = vertices.ravel()
    return (
        posts.joined(pairs, nodes, int(posts.kind[links[0, 0]])),
        (len(posts.nodes) + number).reshape(-1, links.shape[1]),
    )


def _polygons(sides: IntArray, of: IntArray) -> IntArray:
    """(n, k) numbers of polygons: two with the same sides are one.

    Args:
        sides: (n, k, 2) posts at their corners.
        of: (n,) junction of each corner.
    """
    k, count = sides.shape[1], np.bincount(of)
    out, first = np.empty(sides.shape[:2], np.int64), 0
    for m in np.unique(count):
        here = np.flatnonzero(count[of] == m)
        here = here[np.argsort(of[here], kind="stable")].reshape(-1, m)
        around = np.sort(sides[here].swapaxes(1, 2).reshape(-1, 2 * m), axis=1)[:, ::2]
        found, number = _numbered(around)
        out[here] = first + number.reshape(-1, 1, k)
        first += len(found)
    return out


def polyhedra_of(joint: Joint, posts: Posts, corners: Corners) -> Corners:
    """The corners of the polygons around polyhedra in 3D, each polygon once; in 2D there are none.

    A polygon between two junctions in line is part of none, and neither is the end of a junction on the outer boundary.

    Args:
        joint: the joint before inflating.
        posts: all posts, with those that close polygons.
        corners: of junctions.

    Raises:
        InputError: the polygons at a vertex do not enclose polyhedra.
    """
    if joint.dim == 2:
        return Corners.none(1)
    ends = np.bincount(corners.polygons[np.unique(corners.of, return_index=True)[1]].ravel())
    faces = _faces(corners, ends == 1, len(posts.nodes))
    uses = np.bincount(faces.sides.ravel(), minlength=len(posts.nodes))  # two for each polygon
    outer = _outer_polygons(faces, posts, np.flatnonzero(uses == 2), len(ends))
    around = Corners(*map(np.concatenate, zip(faces, outer, strict=True)))

    uses = np.bincount(around.sides.ravel(), minlength=len(posts.nodes))
    columns = (around.copies, around.sides[:, 0], around.polygons)
    vertices, edges, polygons = (np.bincount(_pairs(around.of, of)[0][:, 0]) for of in columns)
    euler = vertices - edges + polygons == 2
    whole = euler[around.of] & (uses[around.sides] == 4).all(axis=(1, 2))
    wrong = np.concatenate([around.sides[~whole, 0, 0], corners.sides[ends[corners.polygons] > 2][:, 0]])
    open_ends = "junctions are not meshed: the layers' ends enclose no polyhedron; use the interface model"
    refuse(wrong >= 0, joint.points[posts.nodes[wrong]], f"S branches at {{at}}, where {open_ends}")
    return around


def _pairs(of: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """Different pairs of a number (n,) and one of its entries (n, k), and the pair of each entry."""
    return _numbered(np.column_stack([of.repeat(rows.shape[1]), rows.ravel()]))


def _faces(corners: Corners, free: BoolArray, n_posts: int) -> Corners:
    """The corners of free polygons that share posts with others; `of` is the number of their polyhedron."""
    polygons, sides = corners.polygons.ravel(), corners.sides.reshape(-1, 1, 2)
    once = np.flatnonzero(free[polygons])
    label = connected(polygons[once].repeat(2), len(free) + sides[once].ravel(), len(free) + n_posts)
    count = np.bincount(label[np.flatnonzero(free)], minlength=len(label))
    once = once[count[label[polygons[once]]] > 1]
    _, of = np.unique(label[polygons[once]], return_inverse=True)
    return Corners(corners.copies.reshape(-1, 1)[once], sides[once], polygons[once, None], of.ravel())


def _outer_polygons(faces: Corners, posts: Posts, rim: IntArray, first: int) -> Corners:
    """The corners of polygons on the outer boundary, one for each polyhedron, numbered from `first` on.

    Args:
        faces: corners of polyhedra that may be open.
        posts: all posts.
        rim: those at the edge of open polyhedra.
        first: number of the first polygon.
    """
    of_posts = np.zeros(len(posts.nodes), np.int64)
    of_posts[faces.sides] = faces.of[:, None, None]
    pairs, at = _pairs(of_posts[rim], posts.ends[rim])
    count = np.bincount(at, minlength=len(pairs))
    sides = (np.argsort(at, kind="stable") // 2)[np.repeat(count == 2, count)]
    of, copies = pairs[count == 2].T
    _, number = np.unique(of, return_inverse=True)
    return Corners(copies[:, None], rim[sides].reshape(-1, 1, 2), first + number.reshape(-1, 1), of)


def are_filled(junctions: Corners, around: Corners, gap: BoolArray) -> BoolArray:
    """(n,) whether the junction, or polyhedron, of each corner gets cells, for the corners of junctions and of polyhedra.

    It gets none if a body has a corner between two gaps there, or in a polyhedron between junctions without cells: the body
    would touch the cells at a vertex or along an edge only.

    Args:
        junctions: corners of junctions.
        around: corners of the polygons around polyhedra.
        gap: (n_posts,) whether each post is that of a gap, or closes a polygon on the outer boundary.
    """
    apart = gap[junctions.sides[:, 0]].all(axis=1)
    filled = ~(np.bincount(junctions.of, apart) > 0)[junctions.of]
    full = np.zeros(int(max(junctions.polygons.max(), around.polygons.max(initial=0))) + 1, bool)
    full[junctions.polygons[filled]] = True
    _, copy = _pairs(around.of, around.copies)
    held = np.bincount(copy, full[around.polygons[:, 0]])[copy] > 0
    empty = np.bincount(around.of, ~held, 1) > 0
    return np.concatenate([filled, ~empty[around.of]])


def common_normals(joint: Joint, footing: Footing, corners: Corners, gap: BoolArray) -> FloatArray:
    """(n, d) unit normal of S of all layers that end at the junction or polyhedron of each corner; zero if they differ.

    Args:
        joint: the joint before inflating.
        footing: where the facets of S have their posts.
        corners: of junctions or of polyhedra.
        gap: (n_posts,) whether each post is that of a gap, or closes a polygon on the outer boundary.
    """
    normals = sums(footing.posts, joint.node_normals, len(gap))
    normals[gap] = 0.0
    normals[~gap] /= np.maximum(np.linalg.norm(normals[~gap], axis=1, keepdims=True), np.finfo(float).tiny)
    total = sums(corners.of, normals[corners.sides].sum(axis=(1, 2)), int(corners.of.max(initial=-1)) + 1)
    count = np.bincount(corners.of, (~gap[corners.sides]).sum(axis=(1, 2)))
    length = np.linalg.norm(total, axis=1)
    same = length >= (1 - FLAT**2) * np.maximum(count, 1)
    return np.where(same, 1 / np.maximum(length, np.finfo(float).tiny), 0.0)[corners.of, None] * total[corners.of]
