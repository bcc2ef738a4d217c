"""S as a sheet: its area, gradients along it, its ends (straight or not), and the heights of the bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np

from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import refuse
from geometry.seam import S
from geometry.topology import (
    BoolArray,
    FloatArray,
    IntArray,
    connected,
    keys_of_ridges,
    ridge_keys,
    ridges,
)

QUADRILATERAL_TRIANGLES = ((0, 1, 2), (1, 3, 2))  # corners of the two triangles of a quadrilateral
CLOSED_NORMAL_LENGTH = 0.1  # length of the mean unit normal below which S counts as closed
# cosine of the least angle between straight ends that meet; at smaller angles the end counts as curved
CORNER_COSINE = 0.7


def vectors_from_segments(x: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """(n, m, d) vectors to places x (n, d) from the nearest points of segments between `first` and `last` (m, d)."""
    along, to = last - first, x[:, None] - first
    share = (to * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    return np.asarray(to - np.clip(share, 0.0, 1.0)[..., None] * along)


@dataclass(frozen=True)
class Rim:
    """Ridges where S ends: vertices in 2D, edges in 3D.

    Attributes:
        vertices: (n, d - 1) vertices of the ridges, as numbers in the joint.
        simplex: (n,) simplex of the sheet at each ridge.
        outward: (n, d) unit vectors along S, normal to the ridge.
        depth: (n,) extent of the simplex along `outward`.
        length: (n,) lengths of the ridges; 1 in 2D.
    """

    vertices: IntArray
    simplex: IntArray
    outward: FloatArray
    depth: FloatArray
    length: FloatArray

    def __getitem__(self, which: BoolArray) -> Rim:
        return Rim(*(getattr(self, f.name)[which] for f in fields(self)))

    def on(self, facets: IntArray) -> BoolArray:
        """(n,) whether each ridge belongs to one of these facets, given by their vertices."""
        return np.asarray(np.isin(ridge_keys(self.vertices), keys_of_ridges(facets, self.vertices.shape[1])))

    def distance(self, points: FloatArray, x: FloatArray) -> FloatArray:
        """(n,) distances of places x (n, d) from the ridges, whose vertices are in `points`; inf without ridges."""
        distance = np.full(len(x), np.inf)
        for ends in points[self.vertices][:, [0, -1], None]:
            distance = np.minimum(distance, np.linalg.norm(vectors_from_segments(x, *ends)[:, 0], axis=1))
        return distance


def continued_ridges(joint: Joint, facets: IntArray) -> IntArray:
    """Keys of the ridges of S where `facets` continue over the layer's side: they include all outer facets there.

    At such a ridge they lie on the bodies at both faces of the layer, or next to layers that meet in the ridge. On a
    rigid base there is one body. Facets on only one of two bodies end where S begins.
    """
    rows, keys = joint.outer_beside_s
    mine = np.isin(rows, joint.table.index(facets))
    return np.setdiff1d(keys[mine], np.append(keys[~mine], -1))


@dataclass(frozen=True)
class Sheet:
    """A seam as n straight simplices between its vertices; a quadrilateral is two triangles.

    Attributes:
        joint: the joint.
        name: name of the seam; "S" for all seams.
    """

    joint: Joint
    name: str = S

    @cached_property
    def facets(self) -> IntArray:
        """Positions of the seam's facets in `joint.surface`, the facets of S."""
        return np.searchsorted(self.joint.surface_rows, self.joint.rows_of(self.name))

    @cached_property
    def parts(self) -> tuple[IntArray, IntArray]:
        """For each simplex its facet of S, (n,), and the corners of this facet, (n, d)."""
        corners = QUADRILATERAL_TRIANGLES if self.joint.cell_type == "hexahedron" else (tuple(range(self.joint.dim)),)
        return np.tile(self.facets, len(corners)), np.repeat(np.array(corners), len(self.facets), axis=0)

    @cached_property
    def vertices(self) -> IntArray:
        """(n, d) vertices of the simplices, as numbers in the joint."""
        facet, corner = self.parts
        return np.asarray(self.joint.surface[facet[:, None], corner])

    @cached_property
    def mean_normal(self) -> FloatArray:
        """(d,) unit vector of the mean normal; if S is closed, the normal of its first facet."""
        normals = self.joint.interface_normals[self.facets]
        mean = normals.mean(axis=0)
        length = np.linalg.norm(mean)
        return np.asarray(mean / length if length > CLOSED_NORMAL_LENGTH else normals[0])

    @property
    def planar(self) -> bool:
        """Whether the seam lies in one plane, or in parallel planes."""
        normals = self.joint.node_normals[self.facets].reshape(-1, self.joint.dim)
        return bool(np.ptp(normals, axis=0).max() <= PLANAR_TOLERANCE)

    @cached_property
    def _edges(self) -> FloatArray:
        x = self.joint.points[self.vertices]
        return np.asarray(x[:, 1:] - x[:, :1])

    @cached_property
    def gradients(self) -> FloatArray:
        """(n, d, d) gradients along S of the linear shape functions of the vertices of each simplex."""
        others = np.swapaxes(np.linalg.pinv(self._edges), 1, 2)
        return np.concatenate([-others.sum(axis=1, keepdims=True), others], axis=1)

    @cached_property
    def areas(self) -> FloatArray:
        """(n,) areas of the simplices."""
        gram = np.linalg.det(self._edges @ np.swapaxes(self._edges, 1, 2))
        return np.asarray(np.sqrt(gram) / math.factorial(self.joint.dim - 1))

    @cached_property
    def rim(self) -> Rim:
        """Ridges where S ends at the outer boundary, without tips inside the bodies and without periodic sides."""
        joint, count = self.joint, len(self.vertices)
        ridges = np.concatenate([np.delete(self.vertices, k, axis=1) for k in range(joint.dim)])
        _, first, times = np.unique(ridge_keys(ridges), return_index=True, return_counts=True)
        first = first[times == 1]
        opposite, simplex = np.divmod(first, count)
        outward = -self.gradients[simplex, opposite]
        steepness = np.linalg.norm(outward, axis=1)
        x = joint.points[ridges[first]]
        length = np.linalg.norm(x[:, -1] - x[:, 0], axis=1) if joint.dim == 3 else np.ones(len(first))
        rim = Rim(ridges[first], simplex, outward / steepness[:, None], 1 / steepness, length)
        outer = joint.outer_rows
        if joint.periods:
            sides = np.concatenate([joint.facets[name] for name in joint.periods.names])
            outer = np.setdiff1d(outer, joint.table.index(sides))
        return rim[rim.on(joint.table.vertices[outer])]

    @cached_property
    def tip(self) -> FloatArray | None:
        """A place where the seam ends inside the bodies and no other seam continues; None if there is no such place."""
        joint = self.joint
        seam_ridges, _ = ridges(joint.surface[self.facets], joint.cell_type)
        here = joint.tips[np.isin(ridge_keys(joint.tips), ridge_keys(seam_ridges))]
        return joint.points[here[0]].mean(axis=0) if len(here) else None

    @cached_property
    def junction(self) -> FloatArray | None:
        """A place where the seam branches or meets another seam; None if there is no such place."""
        joint = self.joint
        surface = joint.masters[joint.surface]
        (s_ridges, counts), (subset, here) = (ridges(rows, joint.cell_type) for rows in (surface, surface[self.facets]))
        all_seams = counts[np.searchsorted(ridge_keys(s_ridges), ridge_keys(subset))]
        meeting = subset[(here > 2) | (all_seams > here)]
        return joint.points[meeting[0]].mean(axis=0) if len(meeting) else None

    @cached_property
    def heights(self) -> tuple[float, ...]:
        """Heights of the lower side (left out on a rigid base) and of the upper side: volume over the area of S.

        If S is planar, a height is at most the largest distance from S, because bodies may extend beyond the ends of S.
        If both sides are one body, there is one value.
        """
        joint = self.joint
        pieces, cells = joint.split_mesh.pieces, joint.surface_cells[self.facets]
        sides = [np.unique(pieces[side[side >= 0]]) for side in cells.T]
        sides = [np.union1d(*sides)] if len(np.intersect1d(*sides)) else [side for side in sides if len(side)]
        distance, heights = np.abs((joint.points - joint.points[self.vertices[0, 0]]) @ self.mean_normal), []
        for side in sides:
            inside = np.isin(pieces, side)
            away = distance[joint.corners[inside]].max()
            heights.append(min(volume_of(joint, inside) / self.areas.sum(), away if self.planar else math.inf))
        return tuple(map(float, heights))


def volume_of(joint: Joint, inside: BoolArray) -> float:
    """Volume of whole pieces of bodies, the cells `inside` (n_cells,), from their faces by the divergence theorem."""
    rows = np.concatenate([joint.outer_rows, joint.surface_rows, joint.surface_rows])
    cells = np.concatenate([joint.table.cells[joint.outer_rows, 0], *joint.surface_cells.T])
    kept = (cells >= 0) & inside[cells]
    nodes = joint.table.nodes(rows[kept], joint.corners, joint.cell_type)
    middle = joint.points[joint.corners[cells[kept]]].mean(axis=1)[:, None]
    volume = 0.0
    for corners in QUADRILATERAL_TRIANGLES if joint.cell_type == "hexahedron" else (tuple(range(joint.dim)),):
        x = joint.points[nodes[:, corners]]
        cones, side = (np.linalg.det(x - tip) for tip in (x[0, 0], middle))  # from one place, and the cell's middle
        volume += float((cones * np.sign(side)).sum()) / math.factorial(joint.dim)
    return volume


class StraightEnd(NamedTuple):
    """A straight free end of a planar S, in one piece.

    Attributes:
        n: unit normal of S, (d,).
        level: least and largest n . x of places in its plane, which may be one of several parallel planes.
        m: unit normal in S, outward, (d,).
        offset: m . x of its points.
        along: (d,) unit vector along it; zero in 2D.
        reach: least and largest along . x of its points.
        length: length of the end; 1 in 2D.
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
        return np.stack([np.pad(vector, (0, 3 - len(vector))) for vector in (-self.m, self.n)])

    def distance(self, x: FloatArray) -> FloatArray:
        """Distances (...) of places (..., d) of S from the line of the end, positive inwards."""
        return np.asarray(self.offset - x @ self.m)

    def has(self, x: FloatArray) -> BoolArray:
        """(n,) whether places (n, d) of S lie on the end."""
        return np.asarray((np.abs(self.distance(x)) <= (self.level[1] - self.level[0]) / 2) & self._reaches(x))

    def adjoins(self, x: FloatArray) -> BoolArray:
        """(n,) whether places (n, d) of S lie on the end, or inwards of it as in `faces`."""
        return self.has(x) | self.faces(x)

    def faces(self, x: FloatArray) -> BoolArray:
        """(n,) whether places (n, d) of S lie inwards of the end, between its first and its last point."""
        return np.asarray((self.distance(x) > 0) & self._reaches(x))

    def _reaches(self, x: FloatArray) -> BoolArray:
        """(n,) whether places (n, d) lie in the plane of the end, between its first and its last point."""
        at, (low, high), (bottom, top), level = x @ self.along, self.reach, self.level, x @ self.n
        return np.asarray((at >= low) & (at <= high) & (level >= bottom) & (level <= top))


def straight_ends(rim: Rim, sheet: Sheet) -> list[StraightEnd]:
    """Straight free ends of S; each consists of the connected ridges on one line.

    Raises:
        InputError: an end is curved.
    """
    joint, n, size = sheet.joint, sheet.mean_normal, sheet.joint.size
    x = joint.points[rim.vertices]  # (n, d - 1, d)
    left, ends = np.arange(len(x)), []
    offsets = np.einsum("nd,nd->n", x[:, 0], rim.outward)
    while len(left):
        m, offset = rim.outward[left[0]], offsets[left[0]]
        cosine = rim.outward @ m
        on_line = (cosine > 1 - PLANAR_TOLERANCE) & (np.abs(offsets - offset) <= PLANAR_TOLERANCE * size)
        at, n_rim = np.flatnonzero(on_line), len(x)  # ridges are connected by their vertices
        links = at.repeat(rim.vertices.shape[1]), n_rim + rim.vertices[at].ravel()
        label = connected(*links, n_rim + int(rim.vertices.max()) + 1)[:n_rim]
        same = on_line & (label == label[left[0]])
        on_it, others = rim[same], rim[(cosine > CORNER_COSINE) & (cosine <= 1 - PLANAR_TOLERANCE)]
        curved = "ends of S must be straight, or meet at angles of 45 degrees or more: one is curved at {at}"
        refuse(np.isin(others.vertices, on_it.vertices).any(axis=1), joint.points[others.vertices[:, 0]], curved)
        along = x[left[0], -1] - x[left[0], 0]
        length = np.linalg.norm(along)
        along = along / length if length else along
        at = x[same].reshape(-1, x.shape[2]) @ along
        height, allowed = float(x[left[0], 0] @ n), PLANAR_TOLERANCE * size
        reach, whole = (float(at.min()), float(at.max())), float(rim.length[same].sum())
        ends.append(StraightEnd(n, (height - allowed, height + allowed), m, float(offset), along, reach, whole))
        left = left[~same[left]]
    return ends


def share_within(d: FloatArray, length: float) -> FloatArray:
    """Fraction (n,) of segments or triangles where the linear function with corner values d (n, 2 or 3) is < length."""
    low, *middle, high = np.sort(d, axis=1).T
    if not middle:
        return np.asarray(np.clip((length - low) / (high - low), 0.0, 1.0)) if len(d) else low
    (mid,) = middle
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (length - low) ** 2 / ((mid - low) * (high - low))
        above = 1 - (high - length) ** 2 / ((high - low) * (high - mid))
    return np.select([length <= low, length >= high, length <= mid], [0.0, 1.0, below], above)
