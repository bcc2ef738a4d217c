"""The order of places on S: along a curve, else by coordinates; the same for any numbering of the mesh."""

from __future__ import annotations

import numpy as np

from geometry.joint import Joint
from geometry.seam import S
from geometry.topology import FloatArray, IntArray

CLOSE = 1e-9  # distance, over the size of the whole, below which two places are the same


def by_place(x: FloatArray, size: float) -> IntArray:
    """Order of places (n, d) by the first coordinate, then by the next ones; `size`: length of the whole."""
    return np.lexsort(np.rint(x[:, ::-1] / (CLOSE * size)).T)


def along(x: FloatArray, pairs: IntArray, size: float) -> IntArray:
    """Order of places (n, 2) along the curves that pairs (m, 2) of neighbours form.

    Curve after curve, each from its lower end, a closed one from its lowest place towards the lower of its neighbours
    (`by_place`). Where a curve ends and another one begins, that follows: the parts of a bed joint, brick by brick.
    """
    order = by_place(x, size)
    rank = np.argsort(order)
    neighbours: list[list[int]] = [[] for _ in x]
    for a, b in zip(*pairs.T, strict=True):
        neighbours[int(a)].append(int(b))
        neighbours[int(b)].append(int(a))
    left, way = set(range(len(x))), list[int]()
    places = [*map(tuple, np.rint(x / (CLOSE * size)).astype(np.int64).tolist())]
    ends: dict[tuple[int, ...], list[int]] = {}
    for k, place in enumerate(places):
        if len(neighbours[k]) < 2:
            ends.setdefault(place, []).append(k)
    for first in sorted(map(int, order), key=lambda k: len(neighbours[k]) > 1):
        going = [first] if first in left else []
        while going:
            at = min(going, key=lambda k: int(rank[k]))
            left.remove(at)
            way.append(at)
            going = [k for k in neighbours[at] if k in left] or [k for k in ends.get(places[at], ()) if k in left]
    return np.array(way, np.int64)


def edges_of_s(joint: Joint, numbers: IntArray, seam: str = S) -> tuple[IntArray, IntArray]:
    """Pairs of positions in `numbers`, vertices of a joint, of those that share a facet of S, or of one seam."""
    return edges_of(joint.table.vertices[joint.rows_of(seam)], numbers)


def edges_of(facets: IntArray, numbers: IntArray) -> tuple[IntArray, IntArray]:
    """Pairs of positions in `numbers` of those that share one of the facets (m, k), given by such numbers."""
    k = facets.shape[1]
    pairs = np.concatenate([facets[:, [i, j]] for i in range(k) for j in range(i + 1, k)])
    order = np.argsort(numbers)
    at = np.minimum(np.searchsorted(numbers[order], pairs), len(numbers) - 1)
    there = (numbers[order][at] == pairs).all(axis=1)
    return order[at[there, 0]], order[at[there, 1]]


def order_on_s(
    joint: Joint, numbers: IntArray, x: FloatArray, seam: str = S, facets: IntArray | None = None
) -> IntArray:
    """Order of vertices of a joint on S, or on a seam, at x (n, d), each once or more: along S in 2D, else by place.

    Args:
        joint: the joint.
        numbers: (n,) numbers of the vertices.
        x: (n, d) their places.
        seam: name of the seam, or "S".
        facets: (m, k) vertices of its facets, if they have other numbers than the joint's.
    """
    size = float(np.ptp(joint.points, axis=0).max())
    vertices, first, number = np.unique(numbers, return_index=True, return_inverse=True)
    if joint.dim == 2:
        edges = edges_of_s(joint, vertices, seam) if facets is None else edges_of(facets, vertices)
        order = along(x[first], np.column_stack(edges), size)
    else:
        order = by_place(x[first], size)
    return np.argsort(np.argsort(order)[number], kind="stable")
