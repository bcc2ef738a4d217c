"""Weights of free ends on S: strips along straight ends, and distances to the nearest one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights, Strips
from forms.work import Interface
from geometry.errors import place
from geometry.joint import FLAT
from geometry.sheet import Rim, Sheet
from geometry.topology import FloatArray
from thinlayer.discretisation.free_rim import free_rim
from thinlayer.discretisation.joint_fields import cellwise
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError

CORNER = 0.7  # cosine of the least angle between straight ends that meet: at smaller ones the end counts as curved
FAR = 1e3  # distance, over the size of the joint, of ends that there are not


@dataclass(frozen=True)
class StraightEnd:
    """A straight free end of a planar S, or several on one line.

    Attributes:
        m: unit normal in S, outward, (d,).
        offset: m . x of its points.
        along: (d,) unit vector along it; zero in 2D.
        reach: least and largest along . x of its points.
    """

    m: FloatArray
    offset: float
    along: FloatArray
    reach: tuple[float, float]

    def distance(self, x: FloatArray) -> FloatArray:
        """Distance (...) of places (..., d) of S from it."""
        return np.asarray(self.offset - x @ self.m)

    def faces(self, x: FloatArray) -> FloatArray:
        """Whether places (n, d) of S lie beside it, inwards."""
        at, (low, high) = x @ self.along, self.reach
        return np.asarray((at >= low) & (at <= high) & (self.distance(x) > 0))


def straight_ends(rim: Rim, sheet: Sheet) -> list[StraightEnd]:
    """The free ends of S, ridges on one line together.

    Raises:
        ModelError: they are curved.
    """
    joint, size = sheet.joint, float(np.ptp(sheet.joint.points, axis=0).max())
    x = joint.points[rim.vertices]  # (n, d - 1, d)
    left, ends = np.arange(len(x)), []
    offsets = np.einsum("nd,nd->n", x[:, 0], rim.outward)
    while len(left):
        m, offset = rim.outward[left[0]], offsets[left[0]]
        cosine = rim.outward @ m
        same = (cosine > 1 - FLAT) & (np.abs(offsets - offset) <= FLAT * size)
        on_it, others = rim[same], rim[(cosine > CORNER) & (cosine <= 1 - FLAT)]
        meeting = np.isin(others.vertices, on_it.vertices).any(axis=1)
        if meeting.any():
            raise ModelError(
                f"edges='free' needs straight free ends of S, and one is curved at "
                f"{place(joint.points[others.vertices[meeting][0, 0]])}: constants of curved ends are not known"
            )
        along = x[left[0], -1] - x[left[0], 0]
        length = np.linalg.norm(along)
        along = along / length if length else along
        at = x[same].reshape(-1, x.shape[2]) @ along
        ends.append(StraightEnd(m, float(offset), along, (float(at.min()), float(at.max()))))
        left = left[~same[left]]
    return ends


def share_within(d: FloatArray, length: float) -> FloatArray:
    """Part (n,) of segments (n, 2) or triangles (n, 3) where a linear function with values d at corners is below a length."""
    low, *middle, high = np.sort(d, axis=1).T
    if not middle:
        return np.asarray(np.clip((length - low) / (high - low), 0.0, 1.0)) if len(d) else low
    (mid,) = middle
    with np.errstate(divide="ignore", invalid="ignore"):
        below = (length - low) ** 2 / ((mid - low) * (high - low))
        above = 1 - (high - length) ** 2 / ((high - low) * (high - mid))
    return np.select([length <= low, length >= high, length <= mid], [0.0, 1.0, below], above)


@dataclass(frozen=True)
class FacetWeights:
    """Weights of the free ends on the facets of a seam.

    Attributes:
        a_N, a_T: mean weight of each facet, (n,).
        m: (n, d) normal of the nearest end; zero where there is none.
        offset: (n,) m . x of its points.
    """

    a_N: FloatArray
    a_T: FloatArray
    m: FloatArray
    offset: FloatArray

    @classmethod
    def of(cls, ends: list[StraightEnd], sheet: Sheet, eps: float, strips: Strips) -> FacetWeights:
        """The weights of these ends, for a layer of this thickness.

        Raises:
            ModelError: strips of too many ends overlap.
        """
        joint, x = sheet.joint, sheet.joint.points[sheet.vertices]
        facet = np.searchsorted(sheet.facets, sheet.parts[0])
        count, d = len(sheet.facets), joint.dim
        size, area = float(np.ptp(joint.points, axis=0).max()), np.bincount(facet, sheet.areas, count)
        weights = np.zeros((2, count))
        nearest, m, offset = np.full(count, np.inf), np.zeros((count, d)), np.full(count, FAR * size)
        centre = np.stack([np.bincount(facet, sheet.areas * c, count) / area for c in x.mean(axis=1).T], axis=1)
        for end in ends:
            here, distance = end.faces(x.mean(axis=1)), end.distance(x)
            for k, (c, length) in enumerate(((strips.c_N, strips.l_N), (strips.c_T, strips.l_T))):
                part = share_within(distance, length * eps) * here * sheet.areas
                weights[k] += c / length * np.bincount(facet, part, count) / area
            closer = end.faces(centre) & (end.distance(centre) < nearest)
            nearest[closer], m[closer], offset[closer] = end.distance(centre)[closer], end.m, end.offset
        if weights.max(initial=0.0) >= 1:
            raise ModelError(
                f"edges='free': strips of {max(strips.l_N, strips.l_T) * eps:.3g} along the free ends of {sheet.name} lie on "
                "one another; such a short S needs a meshed layer"
            )
        return cls(*weights, m, offset)


def end_weights(model: Model, one: SeamLayer, end: FreeEnd, sides: Interface) -> EndWeights | None:
    """The weights of a layer's free ends as UFL expressions on S; None: it has no free end. Collective."""
    assert one.thin
    sheet, joint, strips, eps = one.sheet, model.joint, Strips.of(end), float(one.thin.eps)
    rim = free_rim(model, sheet)
    if not len(rim.vertices):
        return None
    on = FacetWeights.of(straight_ends(rim, sheet), sheet, eps, strips)
    values = np.zeros((len(joint.cells), 3 + joint.dim))
    upper = joint.surface_cells[sheet.facets, 1]
    values[upper] = np.column_stack([on.a_N, on.a_T, on.offset, on.m])
    mesh = model.domain.mesh
    known = sides.upper(cellwise(model.domain, ("DG", 0, (3 + joint.dim,)), values[:, None]))
    m = ufl.as_vector([known[3 + k] for k in range(joint.dim)])
    distance = known[2] - ufl.dot(m, sides.upper(ufl.SpatialCoordinate(mesh)))
    f_N, f_T = (
        ufl.max_value(0.0, ufl.min_value(1.0, distance / fem.Constant(mesh, eps * length)))
        for length in (strips.r_N, strips.r_T)
    )
    return EndWeights(m, known[0], known[1], f_N, f_T)
