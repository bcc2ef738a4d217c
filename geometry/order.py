"""The order of places on S: along a curve, else by coordinates; the same for any numbering of the mesh."""

from __future__ import annotations

import numpy as np

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
