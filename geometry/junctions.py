"""Junctions in 2D: the polygon between the ends of three or more layers, filled with cells.

Its corners are the copies of a vertex of S, one on each body, its sides the ends of the layers. On the outer boundary one
more side closes it. Each corner has a block of quadrilaterals: between the corner, the middles of its two sides, and the
centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.bands import Posts
from geometry.errors import GeometryError, place
from geometry.joint import Joint
from geometry.topology import BoolArray, FloatArray, IntArray, is_tensor


@dataclass(frozen=True)
class Ring:
    """Junctions with the same number of corners.

    Attributes:
        nodes: (n,) the vertex of S of each junction.
        corners: (n, m) its copies, in order around the polygon.
        sides: (n, m) the post from each corner to the next one.
        turned: (n, m) whether this post leads from the next corner to this one.
    """

    nodes: IntArray
    corners: IntArray
    sides: IntArray
    turned: BoolArray


def junction_posts(posts: Posts) -> IntArray:
    """Posts at nodes that have several of them, in the order of the nodes."""
    count = np.bincount(posts.nodes)
    found = np.flatnonzero(count[posts.nodes] > 1)
    return found[np.argsort(posts.nodes[found], kind="stable")]


def rings_of(joint: Joint, posts: Posts, found: IntArray) -> tuple[Posts, list[Ring]]:
    """The junctions, and all posts, with those that close the polygons on the outer boundary.

    Args:
        joint: the joint before inflating.
        posts: all posts at the nodes of S.
        found: those of junctions, see `junction_posts`.

    Raises:
        GeometryError: bodies that touch at a vertex only lie between the layers that end there.
    """
    if not len(found):
        return posts, []
    first, second = posts.ends[found].T
    copy = np.concatenate([first, second])
    order = np.argsort(copy, kind="stable")
    copies, start, degree = np.unique(copy[order], return_index=True, return_counts=True)
    to, by = np.concatenate([second, first])[order], np.concatenate([found, found])[order]
    # (copies, 2) the neighbours of each copy, and the posts that lead there; -1: there is one only
    last = start + degree - 1
    neighbour = np.column_stack([to[start], np.where(degree > 1, to[last], -1)])
    link = np.column_stack([by[start], np.where(degree > 1, by[last], -1)])

    node_of = np.empty(len(copies), np.int64)
    node_of[np.searchsorted(copies, first)] = posts.nodes[found]
    node_of[np.searchsorted(copies, second)] = posts.nodes[found]
    nodes, at = np.unique(node_of, return_inverse=True)
    corners, sides = np.bincount(at), np.bincount(np.searchsorted(nodes, posts.nodes[found]))
    loose = (corners - sides > 1) | (np.bincount(at, degree > 2) > 0)
    if loose.any():
        raise GeometryError(
            f"at {place(joint.points[nodes[loose][0]])} bodies touch at a vertex only, between layers that meet there: the "
            "layers' ends enclose no polygon"
        )
    begin = np.lexsort((copies, degree, at))[
        np.searchsorted(np.sort(at), np.arange(len(nodes)))
    ]  # an end, if there is one
    rings = []
    for m, closed in np.unique(np.column_stack([corners, corners == sides]), axis=0):
        here = np.flatnonzero((corners == m) & ((corners == sides) == closed))
        ring, by_side = np.empty((len(here), m), np.int64), np.full((len(here), m), -1)
        now, came = begin[here], np.full(len(here), -1)
        for k in range(m):
            ring[:, k] = copies[now]
            way = (link[now, 0] == came).astype(np.int64)
            came = link[now, way]
            if k < m - 1 or closed:
                by_side[:, k] = came
                now = np.searchsorted(copies, neighbour[now, way])
        if not closed:
            by_side[:, -1] = len(posts.nodes) + np.arange(len(here))
            posts = posts.joined(ring[:, [-1, 0]], nodes[here], int(posts.kind[found[0]]))
        rings.append(Ring(nodes[here], ring, by_side, posts.ends[by_side, 0] != ring))
    return posts, rings


def fill(
    ring: Ring, posts: Posts, cell_type: str, values: FloatArray, first: int
) -> tuple[IntArray, FloatArray, IntArray]:
    """Cells of junctions, (n, cells, corners), and values at their new nodes, which are numbered from `first` on.

    Args:
        ring: junctions with the same number of corners.
        posts: all posts; those of the sides have one even number of cells.
        cell_type: "triangle" or "quadrilateral".
        values: (n_nodes, d) at the copies; linear from the centre to the sides, bilinear in the blocks.
        first: number of the first new node.

    Returns:
        The cells, the values, and the node of S below each new node.
    """
    n, m = ring.corners.shape
    N = int(posts.top[ring.sides[0, 0]])
    half, d = N // 2, values.shape[1]
    at = values[ring.corners]  # (n, m, d)
    centre = at.mean(axis=1)
    middle = (at + np.roll(at, -1, axis=1)) / 2
    inner, t = half - 1, np.arange(1, half) / half
    per_junction = 1 + m * inner + m * inner**2
    start = first + per_junction * np.arange(n)
    rays = start[:, None, None] + 1 + np.arange(m * inner).reshape(m, inner)
    insides = start[:, None, None, None] + 1 + m * inner + np.arange(m * inner**2).reshape(m, inner, inner)

    grid = np.empty((n, m, half + 1, half + 1), np.int64)  # [p, q]: p along the next side, q along the one before
    k = np.arange(half + 1)
    level = np.where(ring.turned[..., None], N - k, k)
    grid[:, :, :, 0] = posts.number(ring.sides[..., None], level)
    grid[:, :, 0, :] = np.roll(posts.number(ring.sides[..., None], N - level), 1, axis=1)
    grid[:, :, half, 1:half] = rays
    grid[:, :, 1:half, half] = np.roll(rays, 1, axis=1)
    grid[:, :, half, half] = start[:, None]
    grid[:, :, 1:half, 1:half] = insides

    found = np.empty((n, per_junction, d))
    found[:, 0] = centre
    s = t[:, None]
    found[:, 1 : 1 + m * inner] = ((1 - s) * middle[:, :, None] + s * centre[:, None, None]).reshape(n, -1, d)
    p, q = t[:, None, None], t[None, :, None]
    before = np.roll(middle, 1, axis=1)[:, :, None, None]
    blocks = (
        (1 - p) * (1 - q) * at[:, :, None, None]
        + p * (1 - q) * middle[:, :, None, None]
        + (1 - p) * q * before
        + p * q * centre[:, None, None, None]
    )
    found[:, 1 + m * inner :] = blocks.reshape(n, -1, d)

    quads = np.stack([grid[..., :-1, :-1], grid[..., 1:, :-1], grid[..., :-1, 1:], grid[..., 1:, 1:]], axis=-1)
    cells: IntArray = quads.reshape(n, -1, 4)
    if not is_tensor(cell_type):  # halved from the corner to the centre, which suits corners of all angles
        cells = np.concatenate([cells[..., [0, 1, 3]], cells[..., [0, 3, 2]]], axis=1)
    return cells, found.reshape(-1, d), np.repeat(ring.nodes, per_junction)
