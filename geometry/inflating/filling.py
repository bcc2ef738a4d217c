"""Blocks of cells that fill junctions, each cut into a grid.

A polygon has a block, a quadrilateral, at each corner: between the corner, the middles of its two sides, and the centre. A
polyhedron of hexahedra has one at each corner: between the corner, the middles of its three edges, the centres of its three
faces, and the centre. A node has integer weights on these key points of its block, which are multilinear. Blocks share a
node where they have the same weights on the same key points.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from geometry.inflating.bands import Posts
from geometry.inflating.corners import Corners
from geometry.joint import Joint
from geometry.refusals import refuse
from geometry.topology import BoolArray, FloatArray, IntArray, is_tensor, sums


class Filled(NamedTuple):
    """Cells in junctions and the nodes that they add.

    Attributes:
        cells: (n, k) nodes of the cells.
        corners: (n,) the corner of each, among those of junctions and, after them, of polyhedra.
        values: (n_new, d) at the new nodes.
        nodes: (n_new,) the node of S below each.
    """

    cells: IntArray
    corners: IntArray
    values: FloatArray
    nodes: IntArray


class _Keys(NamedTuple):
    """The key points: copies of nodes of S, then middles of posts, centres of polygons, centres of polyhedra.

    Attributes:
        middles, centres, insides: numbers of the first middle, of the first centre of a polygon, and of a polyhedron.
        values: (n, d) at the key points.
        nodes: (n,) the node of S below each.
    """

    middles: int
    centres: int
    insides: int
    values: FloatArray
    nodes: IntArray

    @classmethod
    def of(cls, posts: Posts, junctions: Corners, around: Corners, values: FloatArray, nodes: IntArray) -> _Keys:
        copies = np.concatenate([junctions.copies.ravel(), around.copies.ravel()])
        polygons = np.concatenate([junctions.polygons.ravel(), around.polygons.ravel()])
        kinds = (
            (values, nodes),
            (values[posts.ends].mean(axis=1), posts.nodes),
            _means(polygons, values[copies], nodes[copies]),
            _means(around.of, values[around.copies[:, 0]], nodes[around.copies[:, 0]]),
        )
        first = np.cumsum([len(of_kind) for _, of_kind in kinds[:-1]])
        middles, centres, insides = map(int, first)
        return cls(middles, centres, insides, *map(np.concatenate, zip(*kinds, strict=True)))


def _means(number: IntArray, values: FloatArray, nodes: IntArray) -> tuple[FloatArray, IntArray]:
    """Means of values (n, d) with equal numbers (n,), and one of their nodes (n,)."""
    count = np.bincount(number)
    of = np.zeros(len(count), np.int64)
    of[number] = nodes
    return sums(number, values, len(count)) / np.maximum(count, 1)[:, None], of


def fill(
    joint: Joint, posts: Posts, junctions: Corners, around: Corners, values: FloatArray, nodes: IntArray
) -> Filled:
    """Cells in junctions. Their new nodes are numbered after those of the posts.

    Args:
        joint: the joint before inflating.
        posts: all posts; those of junctions have one even number of cells.
        junctions: corners of the polygons at the vertices of each junction.
        around: corners of the polygons around polyhedra.
        values: (n, d) at the copies of nodes; multilinear in the blocks.
        nodes: (n,) the node of S below each copy.

    Raises:
        InputError: a polyhedron of hexahedra has a corner where other than three edges meet.
    """
    half, k = int(posts.top[junctions.sides.flat[0]]) // 2, junctions.copies.shape[1]
    keys, solid = _Keys.of(posts, junctions, around, values, nodes), is_tensor(joint.cell_type)
    blocks = [_squares(keys, junctions)]
    corner: IntArray = np.arange(len(around.of))
    if len(around.of) and solid:
        cubes, corner = _cubes(joint, keys, around)
        blocks.append(cubes)
    elif len(around.of):
        blocks += [keys.insides + around.of[:, None], _squares(keys, around)]
    grids, added, below = _numbered(posts, junctions, keys, blocks, joint.dim, half)
    quads = _pieces(grids[0], 2).reshape(len(junctions.of), k, half * half, 4)
    if solid:
        cells = [quads.swapaxes(1, 2).reshape(len(quads), -1, 4 * k), *(_pieces(grid, 3) for grid in grids[1:])]
    else:
        back = posts.ends[junctions.sides[:, 0], 0] != junctions.copies[:, :1]
        cells = [_extruded(_halved(quads, back)), *(_cones(grid, grids[1]) for grid in grids[2:])]
    corner = np.concatenate([np.arange(len(junctions.of)), len(junctions.of) + corner])
    count = np.repeat([one.shape[1] for one in cells], [len(one) for one in cells])
    rows = np.concatenate([one.reshape(-1, one.shape[2]) for one in cells])
    return Filled(rows, np.repeat(corner, count), added, below)


def _squares(keys: _Keys, corners: Corners) -> IntArray:
    """(n * k, 4) key points of the blocks at corners of polygons."""
    middles, centres = keys.middles + corners.sides, keys.centres + corners.polygons
    return np.stack([corners.copies, middles[..., 0], middles[..., 1], centres], axis=-1).reshape(-1, 4)


def _cubes(joint: Joint, keys: _Keys, around: Corners) -> tuple[IntArray, IntArray]:
    """(n, 8) key points of the blocks at corners of polyhedra, where three posts and three polygons meet; one of these."""
    pairs, at = np.unique(np.column_stack([around.of, around.copies]), axis=0, return_inverse=True)
    count = np.bincount(at.ravel())
    need = "where junctions meet: hexahedra need three layers around each corner of a body there"
    remedy = f"not {count[(count != 3).argmax()]}; use tetrahedra, or the interface model"
    refuse(count != 3, joint.points[keys.nodes[pairs[:, 1]]], f"S branches at {{at}}, {need}, {remedy}")
    rows = np.argsort(at.ravel(), kind="stable").reshape(-1, 3)
    sides, polygons = around.sides[rows, 0], around.polygons[rows, 0]
    one, other = sides[:, 0].T
    n = np.arange(len(rows))
    second = np.where((sides[:, 1] == one[:, None]).any(axis=1), 1, 2)  # the other polygon at the first post
    third = sides[n, second].sum(axis=1) - one
    a, b, c = (keys.middles + post for post in (one, other, third))
    ab, ac, bc = (keys.centres + polygons[n, at] for at in (0 * second, second, 3 - second))
    return np.stack([pairs[:, 1], a, b, ab, c, ac, bc, keys.insides + around.of[rows[:, 0]]], axis=1), rows[:, 0]


def _numbered(
    posts: Posts, junctions: Corners, keys: _Keys, blocks: Sequence[IntArray], dim: int, half: int
) -> tuple[list[IntArray], FloatArray, IntArray]:
    """The nodes of blocks with their key points (n, 2**k), each (n, half + 1, ..., half + 1); new ones, and what is below.

    A node is a row of codes, sorted: key point * base + weight, and -1 up to the length of the rows.
    """
    base, width = half**dim + 1, max(one.shape[1] for one in blocks)

    def codes(of_blocks: IntArray) -> IntArray:
        k = of_blocks.shape[1].bit_length() - 1
        weights = _weights(k, half) * half ** (dim - k)
        rows = np.where(weights > 0, of_blocks[:, None] * base + weights, -1).reshape(-1, 2**k)
        return np.pad(np.sort(rows, axis=1), ((0, 0), (width - 2**k, 0)), constant_values=-1)

    known = np.unique(junctions.sides)
    ends, level = posts.ends[known], np.arange(half + 1)
    halves = [np.column_stack([end, keys.middles + known]) for end in ends.T]
    there = [posts.number(known[:, None], way).ravel() for way in (level, 2 * half - level)]
    rows = np.concatenate([codes(one) for one in (*halves, *blocks)])
    found, at = np.unique(rows, axis=0, return_inverse=True)
    number, at = np.full(len(found), -1), at.ravel()
    number[at[: 2 * len(there[0])]] = np.concatenate(there)
    new = np.flatnonzero(number < 0)
    number[new] = posts.first_new + posts.size + np.arange(len(new))

    key, weight = np.divmod(found[new], base)
    weight = np.where(key < 0, 0, weight)
    values = np.einsum("nk,nkd->nd", weight / (base - 1), keys.values[key])
    sizes = [len(one) * (half + 1) ** (one.shape[1].bit_length() - 1) for one in blocks]
    grids = np.split(number[at[2 * len(there[0]) :]], np.cumsum(sizes)[:-1])
    shapes = [(len(one), *(half + 1,) * (one.shape[1].bit_length() - 1)) for one in blocks]
    return [grid.reshape(shape) for grid, shape in zip(grids, shapes, strict=True)], values, keys.nodes[key[:, -1]]


def _weights(k: int, half: int) -> IntArray:
    """((half + 1)**k, 2**k) weights of the nodes of a block on its key points, with sum half**k."""
    t = np.arange(half + 1)
    out = np.ones((1, 1), np.int64)
    for _ in range(k):  # the new axis: the last one of nodes, the slowest one of key points
        out = np.concatenate([out[:, None] * s[:, None] for s in (half - t, t)], axis=2).reshape(len(out) * len(t), -1)
    return out


def _pieces(grid: IntArray, k: int) -> IntArray:
    """(n, half**k, 2**k) the cells of grids of nodes (n, half + 1, ..., half + 1)."""
    half = grid.shape[1] - 1
    parts = (tuple(slice(bit, half + bit) for bit in bits[::-1]) for bits in product((0, 1), repeat=k))
    corners = [grid[(slice(None), *part)] for part in parts]
    return np.stack(corners, axis=-1).reshape(len(grid), half**k, 2**k)


def _halved(quads: IntArray, back: BoolArray) -> IntArray:
    """Triangles (n, k, 2 m, 3) from the quadrilaterals (n, k, m, 4) of blocks, halved from the corner to the centre.

    This suits corners of all angles. Vertices are in an order that is the same wherever triangles share an edge, along
    posts that of their levels.

    Args:
        quads: of the blocks.
        back: (n, 2) whether the posts at the block's two outer sides lead towards its corner.
    """
    half = round(quads.shape[2] ** 0.5)
    p, q = np.divmod(np.arange(half * half), half)
    out = []
    for middle, outer, turned in ((1, q == 0, back[:, 0]), (2, p == 0, back[:, 1])):
        rows = quads[..., [0, middle, 3]]
        swapped = (turned[:, None] & outer)[:, None, :, None]
        out.append(np.where(swapped, rows[..., [1, 0, 2]], rows))
    return np.concatenate(out, axis=2)


def _extruded(triangles: IntArray) -> IntArray:
    """Cells between the triangles (n, k, m, 3) at the k vertices of junctions: in 3D prisms, split as those of bands."""
    if triangles.shape[1] == 1:
        return triangles[:, 0]
    low, high = triangles[:, 0], triangles[:, 1]
    steps = [np.concatenate([low[..., : j + 1], high[..., j:]], axis=2) for j in range(low.shape[2])]
    return np.concatenate(steps, axis=1)


def _cones(grids: IntArray, centres: IntArray) -> IntArray:
    """Tetrahedra (n, m, 4) between the blocks (n, half + 1, half + 1) of a polyhedron's polygons and its centre (n,)."""
    faces = _halved(_pieces(grids, 2)[:, None], np.zeros((len(grids), 2), bool))[:, 0]
    return np.concatenate([faces, np.broadcast_to(centres[:, None, None], (*faces.shape[:2], 1))], axis=2)
