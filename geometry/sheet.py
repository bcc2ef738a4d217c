"""A seam, or all of S, as straight segments (2D) or triangles (3D): areas, gradients, ends and heights of bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import basix
import numpy as np

from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import refuse
from geometry.seam import S
from geometry.topology import (
    BoolArray,
    FloatArray,
    IntArray,
    components,
    facet_ridge_keys,
    is_tensor,
    lagrange,
    normal_vectors,
    ridge_keys,
    ridges,
)

QUADRILATERAL_TRIANGLES = ((0, 1, 2), (1, 3, 2))  # corners of the two triangles of a quadrilateral
MIN_MEAN_NORMAL_LENGTH = 0.1  # length of the mean unit normal below which S counts as closed
# cosine of the least angle between straight ends that meet; at smaller angles the end counts as curved
CORNER_ANGLE_COSINE = 0.7


def vectors_from_segments(x: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    """Return (n, m, d) vectors to each of n places from the nearest point of each of m straight segments, lengths.

    Args:
        x: (n, d) coordinates of the places in d dimensions.
        first, last: (m, d) coordinates of the two ends of each segment.
    """
    segments, to = last - first, x[:, None] - first
    fractions = (to * segments).sum(axis=2) / np.maximum((segments**2).sum(axis=1), np.finfo(float).tiny)
    return np.asarray(to - np.clip(fractions, 0.0, 1.0)[..., None] * segments)


@dataclass(frozen=True)
class Rim:
    """The n ridges where a sheet ends: vertices of S in 2D, edges of S in 3D.

    A sheet consists of simplices: segments in 2D, triangles in 3D. Each of these ridges bounds one simplex.

    Attributes:
        vertices: (n, 1) vertex in 2D, or (n, 2) vertices in 3D, of each ridge, as row numbers in `Joint.points`.
        facet: (n,) position in `Joint.surface` of the facet that each ridge bounds.
        outward: (n, d) unit vector that is tangential to S, normal to the ridge, and points away from S, in d
            dimensions.
        depth: (n,) extent of the simplex along `outward`, a length.
        length: (n,) length of each ridge; 1 in 2D.
    """

    vertices: IntArray
    facet: IntArray
    outward: FloatArray
    depth: FloatArray
    length: FloatArray

    def __getitem__(self, which: BoolArray) -> Rim:
        return Rim(*(getattr(self, f.name)[which] for f in fields(self)))

    def lies_on(self, facets: IntArray) -> BoolArray:
        """Return (n,) whether each ridge is a part of any of the given facets.

        Args:
            facets: (m, k) numbers of the k vertices of each of m facets.
        """
        return np.asarray(np.isin(ridge_keys(self.vertices), facet_ridge_keys(facets, self.vertices.shape[1])))

    def distance(self, points: FloatArray, x: FloatArray) -> FloatArray:
        """Return (n,) the distance of each of n places from the nearest ridge, a length; inf if there are no ridges.

        Args:
            points: (n_points, d) coordinates of the joint's points in d dimensions.
            x: (n, d) coordinates of the places.
        """
        distance = np.full(len(x), np.inf)
        for ends in points[self.vertices][:, [0, -1], None]:
            distance = np.minimum(distance, np.linalg.norm(vectors_from_segments(x, *ends)[:, 0], axis=1))
        return distance


def continued_ridge_keys(joint: Joint, facets: IntArray) -> IntArray:
    """Return the ridges where S ends within a facet set of the bodies, which then continues on a meshed layer's side.

    A ridge is a vertex of S in 2D, an edge of S in 3D. The layer's side is its own boundary at the ridge. The set
    continues there if all outer facets at the ridge are in it: those of both bodies, or on a rigid base of the only
    body. A set with facets of only one of two bodies ends at S. Where several layers end at one ridge, the facets of
    all bodies there must be in the set.

    Args:
        joint: the joint, in which S is a surface.
        facets: (n, k) numbers of the k vertices of the outer facets in the set.

    Returns:
        (m,) keys of the ridges, as from `ridge_keys`.
    """
    rows, keys = joint.outer_beside_s
    is_named = np.isin(rows, joint.table.index(facets))
    return np.setdiff1d(keys[is_named], np.append(keys[~is_named], -1))


@dataclass(frozen=True)
class Sheet:
    """A seam, or all of S, as n straight simplices: segments in 2D, triangles in 3D.

    Vertices are those of the facets of S, even if these are curved. A quadrilateral is two triangles.

    Attributes:
        joint: the joint.
        name: name of the seam; "S" for all seams.
    """

    joint: Joint
    name: str = S

    @cached_property
    def facets(self) -> IntArray:
        """(n_facets,) row numbers in `joint.surface` of the seam's facets."""
        return self.joint.facets_of(self.name)

    @cached_property
    def simplices(self) -> tuple[IntArray, IntArray]:
        """For each of the n simplices the facet of S that contains it, and which of the facet's vertices it has.

        These are (n,) row numbers in `joint.surface`, and (n, 2) in 2D, (n, 3) in 3D positions in these rows.
        """
        corners = QUADRILATERAL_TRIANGLES if self.joint.cell_type == "hexahedron" else (tuple(range(self.joint.dim)),)
        return np.tile(self.facets, len(corners)), np.repeat(np.array(corners), len(self.facets), axis=0)

    @cached_property
    def vertices(self) -> IntArray:
        """(n, 2) vertices of each segment in 2D, (n, 3) of each triangle in 3D, as row numbers in `Joint.points`."""
        facet, corner = self.simplices
        return np.asarray(self.joint.surface[facet[:, None], corner])

    @cached_property
    def mean_normal(self) -> FloatArray:
        """Unit vector of the mean normal of the seam's facets; if the seam is closed, the normal of its first facet."""
        normals = self.joint.interface_normals[self.facets]
        mean = normals.mean(axis=0)
        length = np.linalg.norm(mean)
        return np.asarray(mean / length if length > MIN_MEAN_NORMAL_LENGTH else normals[0])

    @property
    def planar(self) -> bool:
        """Whether the seam lies in one plane, or in parallel planes: its normals differ by at most 1e-5."""
        normals = self.joint.node_normals[self.facets].reshape(-1, self.joint.dim)
        return bool(np.ptp(normals, axis=0).max() <= PLANAR_TOLERANCE)

    @cached_property
    def _edges(self) -> FloatArray:
        x = self.joint.points[self.vertices]
        return np.asarray(x[:, 1:] - x[:, :1])

    @cached_property
    def gradients(self) -> FloatArray:
        """(n, d, d) gradients along S of the linear shape functions of each of the n simplices, 1 / length.

        The second axis is the vertex of the simplex to which the shape function belongs. The third axis is the
        component of the gradient, in d dimensions.
        """
        vertex_gradients = np.swapaxes(np.linalg.pinv(self._edges), 1, 2)
        return np.concatenate([-vertex_gradients.sum(axis=1, keepdims=True), vertex_gradients], axis=1)

    @cached_property
    def areas(self) -> FloatArray:
        """(n,) area of each triangle in 3D, length of each segment in 2D."""
        gram_determinant = np.linalg.det(self._edges @ np.swapaxes(self._edges, 1, 2))
        return np.asarray(np.sqrt(gram_determinant) / math.factorial(self.joint.dim - 1))

    def facet_integrals(self, values: FloatArray | float) -> FloatArray:
        """Return the integrals (n_facets,) over the seam's facets of values (n,), one for each of the n simplices."""
        facet = np.searchsorted(self.facets, self.simplices[0])
        return np.bincount(facet, self.areas * values, len(self.facets)).astype(float)

    def facet_means(self, values: FloatArray) -> FloatArray:
        """Return the means (n_facets,) over the seam's facets of values (n,), one for each of the n simplices."""
        return np.asarray(self.facet_integrals(values) / self.facet_integrals(1.0))

    @cached_property
    def rim(self) -> Rim:
        """Ridges where the seam ends on the outer boundary; ridges inside bodies or on periodic sides are left out."""
        joint, n_simplices = self.joint, len(self.vertices)
        ridges = np.concatenate([np.delete(self.vertices, k, axis=1) for k in range(joint.dim)])
        _, free_indices, counts = np.unique(ridge_keys(ridges), return_index=True, return_counts=True)
        free_indices = free_indices[counts == 1]
        opposite, simplex = np.divmod(free_indices, n_simplices)
        outward, vertices, facet = -self.gradients[simplex, opposite], ridges[free_indices], self.simplices[0][simplex]
        gradient_size = np.linalg.norm(outward, axis=1)
        x = joint.points[vertices]
        length = np.linalg.norm(x[:, -1] - x[:, 0], axis=1) if joint.dim == 3 else np.ones(len(free_indices))
        rim = Rim(vertices, facet, outward / gradient_size[:, None], 1 / gradient_size, length)
        outer_rows = joint.outer_rows
        if joint.periods:
            periodic_facets = np.concatenate([joint.facets[name] for name in joint.periods.side_names])
            outer_rows = np.setdiff1d(outer_rows, joint.table.index(periodic_facets))
        return rim[rim.lies_on(joint.table.vertices[outer_rows])]

    @cached_property
    def tip(self) -> FloatArray | None:
        """(d,) coordinates of one place where the seam ends inside the bodies; None if there is none.

        The seam does not end where another seam continues it.
        """
        joint = self.joint
        seam_ridges, _ = ridges(joint.surface[self.facets], joint.cell_type)
        tip_ridges = joint.tips[np.isin(ridge_keys(joint.tips), ridge_keys(seam_ridges))]
        return joint.points[tip_ridges[0]].mean(axis=0) if len(tip_ridges) else None

    @cached_property
    def junction_point(self) -> FloatArray | None:
        """(d,) coordinates of one place where the seam branches or meets another seam; None: no such place."""
        joint = self.joint
        surface = joint.masters[joint.surface]
        s_ridges, s_counts = ridges(surface, joint.cell_type)
        seam_ridges, counts = ridges(surface[self.facets], joint.cell_type)
        total_counts = s_counts[np.searchsorted(ridge_keys(s_ridges), ridge_keys(seam_ridges))]
        junctions = seam_ridges[(counts > 2) | (total_counts > counts)]
        return joint.points[junctions[0]].mean(axis=0) if len(junctions) else None

    @cached_property
    def body_heights(self) -> tuple[float, ...]:
        """Heights of the bodies below and above the seam: volume of each body over area of the seam, lengths.

        On a rigid base there is no lower height. If both sides are one body, there is one height. As bodies may extend
        beyond the ends of the seam, heights are bounded: if the seam is planar, a height is at most the largest
        distance of the body's points from it.
        """
        joint = self.joint
        pieces, cells = joint.split_mesh.pieces, joint.surface_cells[self.facets]
        bodies = [np.unique(pieces[side[side >= 0]]) for side in cells.T]
        bodies = [np.union1d(*bodies)] if len(np.intersect1d(*bodies)) else [side for side in bodies if len(side)]
        distance, heights = np.abs((joint.points - joint.points[self.vertices[0, 0]]) @ self.mean_normal), []
        for side in bodies:
            is_inside = np.isin(pieces, side)
            reach = distance[joint.corners[is_inside]].max()
            heights.append(min(volume_of(joint, is_inside) / self.areas.sum(), reach if self.planar else math.inf))
        return tuple(map(float, heights))


def volume_of(joint: Joint, is_inside: BoolArray) -> float:
    """Return the volume, in 2D the area, of some cells of a joint; curved cells count as straight-sided.

    Args:
        joint: the joint.
        is_inside: (n_cells,) whether each cell counts.
    """
    kind = joint.cell_type
    points, weights = basix.make_quadrature(basix.CellType[kind], joint.dim if is_tensor(kind) else 0)
    gradients = lagrange(kind, 1).tabulate(1, points)[1:, :, :, 0]
    tangents = np.einsum("tqn,cnd->tcqd", gradients, joint.points[joint.corners[is_inside]], optimize=True)
    determinants = (tangents[0] * normal_vectors(tangents[1:])).sum(axis=-1)  # faster than that of numpy
    return float((np.abs(determinants) @ weights).sum())


class StraightEnd(NamedTuple):
    """A straight free end of a planar S, in one connected piece: a point in 2D, a straight line in 3D.

    S may lie in several parallel planes; the end is in one of them. Vectors have d components in d dimensions.

    Attributes:
        n: unit normal of S.
        levels: least and largest n . x of places x that count as being in the plane of the end, lengths.
        m: unit vector in the plane of S that is normal to the end and points away from S.
        offset: value of m . x at the end, a length.
        along: unit vector along the end; zero in 2D.
        along_range: least and largest value of along . x at points of the end, lengths.
        length: length of the end; 1 in 2D.
    """

    n: FloatArray
    levels: tuple[float, float]
    m: FloatArray
    offset: float
    along: FloatArray
    along_range: tuple[float, float]
    length: float = 1.0

    @property
    def axes(self) -> FloatArray:
        """(2, 3) two unit vectors with three components, in 2D with z = 0: from the end into S, and the normal of S."""
        return np.stack([np.pad(vector, (0, 3 - len(vector))) for vector in (-self.m, self.n)])

    def distance(self, x: FloatArray) -> FloatArray:
        """Return the distances (...) of places of S from the straight line through the end; positive inside S.

        Args:
            x: (..., d) coordinates of the places in d dimensions, lengths.
        """
        return np.asarray(self.offset - x @ self.m)

    def contains(self, x: FloatArray) -> BoolArray:
        """Return (n,) whether each of n places of S lies on the end.

        Args:
            x: (n, d) coordinates of the places in d dimensions, lengths.
        """
        return np.asarray((np.abs(self.distance(x)) <= (self.levels[1] - self.levels[0]) / 2) & self._is_beside(x))

    def is_in_front(self, x: FloatArray) -> BoolArray:
        """Return (n,) whether each of n places of S is in the strip that leads from the end, normal to it, into S.

        The strip is as wide as the end and in its plane. Places on the end itself are not counted.

        Args:
            x: (n, d) coordinates of the places in d dimensions, lengths.
        """
        return np.asarray((self.distance(x) > 0) & self._is_beside(x))

    def _is_beside(self, x: FloatArray) -> BoolArray:
        """Return (n,) whether each of n places is in the plane of the end, with along . x in the range `along_range`.

        Args:
            x: (n, d) coordinates of the places in d dimensions, lengths.
        """
        at, (low, high), (bottom, top), level = x @ self.along, self.along_range, self.levels, x @ self.n
        return np.asarray((at >= low) & (at <= high) & (level >= bottom) & (level <= top))


def straight_ends(rim: Rim, sheet: Sheet) -> list[StraightEnd]:
    """Return the straight ends of S that the ridges of a rim form.

    Connected ridges on one straight line form one end.

    Args:
        rim: the ridges.
        sheet: the planar sheet that ends there.

    Raises:
        InputError: an end is curved.
    """
    joint, n, size = sheet.joint, sheet.mean_normal, sheet.joint.size
    x = joint.points[rim.vertices]  # (n, d - 1, d)
    remaining, ends = np.arange(len(x)), []
    offsets = np.einsum("nd,nd->n", x[:, 0], rim.outward)
    while len(remaining):
        m, offset = rim.outward[remaining[0]], offsets[remaining[0]]
        cosine = rim.outward @ m
        on_line = (cosine > 1 - PLANAR_TOLERANCE) & (np.abs(offsets - offset) <= PLANAR_TOLERANCE * size)
        line_ridges, n_rim = np.flatnonzero(on_line), len(x)  # they are connected by their vertices
        links = line_ridges.repeat(rim.vertices.shape[1]), n_rim + rim.vertices[line_ridges].ravel()
        component = components(*links, n_rim + int(rim.vertices.max()) + 1)[:n_rim]
        in_end = on_line & (component == component[remaining[0]])
        end_rim, others = rim[in_end], rim[(cosine > CORNER_ANGLE_COSINE) & (cosine <= 1 - PLANAR_TOLERANCE)]
        complaint = "ends of S must be straight, or meet at angles of 45 degrees or more: one is curved at {at}"
        refuse(np.isin(others.vertices, end_rim.vertices).any(axis=1), joint.points[others.vertices[:, 0]], complaint)
        along = x[remaining[0], -1] - x[remaining[0], 0]
        length = np.linalg.norm(along)
        along = along / length if length else along
        at = x[in_end].reshape(-1, x.shape[2]) @ along
        height, tolerance = float(x[remaining[0], 0] @ n), PLANAR_TOLERANCE * size
        reach, total = (float(at.min()), float(at.max())), float(rim.length[in_end].sum())
        ends.append(StraightEnd(n, (height - tolerance, height + tolerance), m, float(offset), along, reach, total))
        remaining = remaining[~in_end[remaining]]
    return ends


def fraction_below(values: FloatArray, bound: float) -> FloatArray:
    """Return (n,) the fraction of each segment's length, or triangle's area, in which a linear function is < `bound`.

    Args:
        values: (n, 2) or (n, 3) values of the function, such as a distance, at the vertices of each segment or
            triangle.
        bound: bound of the function, in its unit.
    """
    low, *middle, high = np.sort(values, axis=1).T
    if not middle:
        return np.asarray(np.clip((bound - low) / (high - low), 0.0, 1.0)) if len(values) else low
    (mid,) = middle
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (bound - low) ** 2 / ((mid - low) * (high - low))
        above = 1 - (high - bound) ** 2 / ((high - low) * (high - mid))
    return np.select([bound <= low, bound >= high, bound <= mid], [0.0, 1.0, below], above)
