"""Straight ends of a planar S, and the strips along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.joint import FLAT
from geometry.refusals import refuse
from geometry.sheet import Rim, Sheet
from geometry.topology import BoolArray, FloatArray, IntArray, connected

CORNER = 0.7  # cosine of the least angle between straight ends that meet: at smaller ones the end counts as curved


@dataclass(frozen=True)
class StraightEnd:
    """A straight free end of a planar S, in one piece.

    Attributes:
        n: unit normal of S, (d,).
        level: least and largest n . x of places in its plane, which may be one of several parallel ones.
        m: unit normal in S, outward, (d,).
        offset: m . x of its points.
        along: (d,) unit vector along it; zero in 2D.
        reach: least and largest along . x of its points.
        length: of it; 1 in 2D.
    """

    n: FloatArray
    level: tuple[float, float]
    m: FloatArray
    offset: float
    along: FloatArray
    reach: tuple[float, float]
    length: float = 1.0

    @property
    def axes(self) -> FloatArray:
        """(2, 3) unit vectors: inward along S, and the normal of S."""
        return np.stack([np.pad(one, (0, 3 - len(one))) for one in (-self.m, self.n)])

    def distance(self, x: FloatArray) -> FloatArray:
        """Distance (...) of places (..., d) of S from it."""
        return np.asarray(self.offset - x @ self.m)

    def has(self, x: FloatArray) -> BoolArray:
        """Whether places (n, d) of S lie on it."""
        allowed = (self.level[1] - self.level[0]) / 2
        return np.asarray((np.abs(self.distance(x)) <= allowed) & self._reaches(x))

    def beside(self, x: FloatArray) -> BoolArray:
        """Whether places (n, d) of S lie on it, or beside it, inwards."""
        return self.has(x) | self.faces(x)

    def faces(self, x: FloatArray) -> BoolArray:
        """Whether places (n, d) of S lie beside it, inwards."""
        return np.asarray((self.distance(x) > 0) & self._reaches(x))

    def _reaches(self, x: FloatArray) -> BoolArray:
        """Whether places (n, d) lie in its plane, between its first and its last point."""
        at, (low, high), (bottom, top), level = x @ self.along, self.reach, self.level, x @ self.n
        return np.asarray((at >= low) & (at <= high) & (level >= bottom) & (level <= top))


def straight_ends(rim: Rim, sheet: Sheet) -> list[StraightEnd]:
    """The free ends of S, ridges on one line together that are connected.

    Raises:
        InputError: they are curved.
    """
    joint, n, size = sheet.joint, sheet.mean_normal, sheet.joint.size
    x = joint.points[rim.vertices]  # (n, d - 1, d)
    left, ends = np.arange(len(x)), []
    offsets = np.einsum("nd,nd->n", x[:, 0], rim.outward)
    while len(left):
        m, offset = rim.outward[left[0]], offsets[left[0]]
        cosine = rim.outward @ m
        on_line = (cosine > 1 - FLAT) & (np.abs(offsets - offset) <= FLAT * size)
        same = on_line & _connected(rim.vertices, on_line, left[0])
        on_it, others = rim[same], rim[(cosine > CORNER) & (cosine <= 1 - FLAT)]
        refuse(
            np.isin(others.vertices, on_it.vertices).any(axis=1),
            joint.points[others.vertices[:, 0]],
            "ends of S must be straight, or meet at angles of 45 degrees or more: one is curved at {at}",
        )
        along = x[left[0], -1] - x[left[0], 0]
        length = np.linalg.norm(along)
        along = along / length if length else along
        at = x[same].reshape(-1, x.shape[2]) @ along
        height, allowed = float(x[left[0], 0] @ n), FLAT * size
        level = height - allowed, height + allowed
        reach, whole = (float(at.min()), float(at.max())), float(rim.length[same].sum())
        ends.append(StraightEnd(n, level, m, float(offset), along, reach, whole))
        left = left[~same[left]]
    return ends


def _connected(vertices: IntArray, chosen: BoolArray, first: int) -> BoolArray:
    """(n,) ridges that chosen ones connect with the first one, which is chosen, by their vertices (n, d - 1)."""
    n, at = len(vertices), np.flatnonzero(chosen)
    ends = vertices[at].ravel()
    label = connected(at.repeat(vertices.shape[1]), n + ends, n + int(ends.max()) + 1)[:n]
    return chosen & (label == label[first])


def share_within(d: FloatArray, length: float) -> FloatArray:
    """Part (n,) of segments (n, 2) or triangles (n, 3) where a linear function of values d at corners is below a length."""
    low, *middle, high = np.sort(d, axis=1).T
    if not middle:
        return np.asarray(np.clip((length - low) / (high - low), 0.0, 1.0)) if len(d) else low
    (mid,) = middle
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (length - low) ** 2 / ((mid - low) * (high - low))
        above = 1 - (high - length) ** 2 / ((high - low) * (high - mid))
    return np.select([length <= low, length >= high, length <= mid], [0.0, 1.0, below], above)
