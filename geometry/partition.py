"""Which rank owns each cell of a joint: recursive bisection by place, and the cells that ranks share across facets."""

from __future__ import annotations

import numpy as np

from geometry.joint import Joint
from geometry.topology import FloatArray, Indices, IntArray


def bisected(x: FloatArray, parts: int) -> Indices:
    """(n,) number below `parts` of the part of each place (n, d): equal parts, halved across their longest direction."""
    part = np.zeros(len(x), np.int32)
    waiting: list[tuple[IntArray, int, int]] = [(np.arange(len(x)), 0, parts)]
    while waiting:
        rows, first, count = waiting.pop()
        part[rows] = first
        if count > 1 and len(rows):
            low = count // 2
            here = x[rows]
            order = np.argsort(here[:, np.ptp(here, axis=0).argmax()], kind="stable")
            at = len(rows) * low // count
            waiting += [(rows[order[:at]], first, low), (rows[order[at:]], first + low, count - low)]
    return part


def destinations(joint: Joint, parts: int) -> tuple[IntArray, Indices]:
    """Where the cells of a joint go: (n + 1,) first entry of each cell; the rank that owns it, then those that see it."""
    owner = bisected(joint.points[joint.corners].mean(axis=1), parts)
    pairs = joint.table.cells[(joint.table.cells >= 0).all(axis=1)]
    apart = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    seen = np.unique(np.concatenate([np.column_stack([a, owner[b]]) for a, b in (apart.T, apart.T[::-1])]), axis=0)
    cells = np.concatenate([np.arange(len(owner)), seen[:, 0]])
    ranks = np.concatenate([owner, seen[:, 1]])[np.argsort(cells, kind="stable")]
    return np.searchsorted(np.sort(cells), np.arange(len(owner) + 1)), ranks.astype(np.int32)
