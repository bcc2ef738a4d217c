"""Straight lines in a plane: parted where they cross and meet, and how near they come to each other elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial import cKDTree

from geometry.topology import BoolArray, FloatArray, IntArray, connected


@dataclass(frozen=True)
class Lines:
    """Segments that have only ends in common.

    Attributes:
        points: (n, 2) ends of segments, coordinates.
        ends: (m, 2) the two points of each segment, in the direction of its line.
        line: (m,) the line that each segment is a part of.
    """

    points: FloatArray
    ends: IntArray
    line: IntArray

    @classmethod
    def of(cls, lines: FloatArray, tolerance: float) -> Self:
        """Lines (k, 2, 2), given by their ends, parted at all points where two of them meet.

        Points as near to each other as the tolerance, a length, are one; so is a point and the place on a line beside it.
        """
        x = np.concatenate([lines.reshape(-1, 2), _crossings(lines)])
        pairs = cKDTree(x).query_pairs(tolerance, output_type="ndarray").reshape(-1, 2)
        _, first = np.unique(connected(pairs[:, 0], pairs[:, 1], len(x)), return_index=True)
        points = x[np.sort(first)]
        share, distance = _feet(points, lines)
        near = distance <= 2 * tolerance
        line, point = np.nonzero(near.T)
        order = np.lexsort((share.T[line, point], line))
        line, point = line[order], point[order]
        same = line[1:] == line[:-1]
        return cls(points, np.column_stack([point[:-1], point[1:]])[same], line[1:][same])

    def where(self, kept: BoolArray) -> Self:
        """A part of the segments, and their ends."""
        used, ends = np.unique(self.ends[kept], return_inverse=True)
        return type(self)(self.points[used], ends.reshape(-1, 2), self.line[kept])

    @property
    def middles(self) -> FloatArray:
        """(m, 2) the middle of each segment."""
        return self.points[self.ends].mean(axis=1)

    def doubles(self) -> IntArray:
        """(n, 2) pairs of segments with the same ends, on different lines that lie on each other."""
        ends = np.sort(self.ends, axis=1)
        order = np.lexsort(ends.T)
        same = (np.diff(ends[order], axis=0) == 0).all(axis=1)
        return np.column_stack([order[:-1], order[1:]])[same]

    def nearest(self) -> tuple[float, FloatArray]:
        """The least distance of a point from a segment that does not end there, or length of a segment; its place (2,)."""
        a, b = self.points[self.ends].swapaxes(0, 1)
        share, distance = _feet(self.points, np.stack([a, b], axis=1))
        every = np.arange(len(a))
        distance[self.ends.T, every] = np.inf
        point, segment = np.unravel_index(distance.argmin(), distance.shape)
        length = np.linalg.norm(b - a, axis=1)
        if length.min() <= distance[point, segment]:
            return float(length.min()), self.middles[length.argmin()]
        foot = a[segment] + share[point, segment] * (b - a)[segment]
        return float(distance[point, segment]), (foot + self.points[point]) / 2

    def sharpest(self) -> tuple[float, FloatArray]:
        """The least angle between two segments that meet, in radians, and where they do (2,)."""
        start = np.concatenate([self.ends, self.ends[:, ::-1]])
        way = self.points[start[:, 1]] - self.points[start[:, 0]]
        angle = np.arctan2(way[:, 1], way[:, 0])
        order = np.lexsort((angle, start[:, 0]))
        at, angle = start[order, 0], angle[order]
        first = np.searchsorted(at, at)
        last = np.searchsorted(at, at, "right") - 1
        every = np.arange(len(at))
        gap = angle[np.where(every == last, first, np.minimum(every + 1, last))] - angle
        gap = np.where(first == last, 2 * np.pi, np.where(every == last, gap + 2 * np.pi, gap))
        k = gap.argmin()
        return float(gap[k]), self.points[at[k]]


def _crossings(lines: FloatArray) -> FloatArray:
    """(n, 2) places inside two lines (k, 2, 2), where they cross."""
    start, way = lines[:, 0], lines[:, 1] - lines[:, 0]
    one, other = np.triu_indices(len(lines), 1)
    apart = start[other] - start[one]
    turn = _cross(way[one], way[other])
    parallel = turn == 0
    turn = np.where(parallel, 1.0, turn)
    s, t = _cross(apart, way[other]) / turn, _cross(apart, way[one]) / turn
    inside = ~parallel & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    return np.asarray(start[one[inside]] + s[inside, None] * way[one[inside]])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _feet(points: FloatArray, lines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, k) where on each line the place next to each point is, as a share of its length, and how far the point is."""
    start, way = lines[:, 0], lines[:, 1] - lines[:, 0]
    to = points[:, None] - start
    share = np.clip((to * way).sum(axis=2) / (way**2).sum(axis=1), 0.0, 1.0)
    return share, np.linalg.norm(to - share[..., None] * way, axis=2)
