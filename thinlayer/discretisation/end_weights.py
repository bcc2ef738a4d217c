"""Weights of free ends on S: strips along straight ends, and distances to the nearest one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights, Strips
from forms.interface import Interface
from forms.tangent import average_lame, is_checked_at_rest, tangent_at_rest
from geometry.ends import StraightEnd, share_within, straight_ends
from geometry.errors import GeometryError
from geometry.sheet import Sheet
from geometry.topology import FloatArray
from thinlayer.discretisation.free_rim import free_rim
from thinlayer.discretisation.joint_fields import cellwise
from thinlayer.discretisation.layer import real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError

LARGEST_NU = 0.45
ROUNDING = 1e-9  # of Poisson's ratio, from moduli
LARGEST_STIFFNESS = 0.25  # of the layer, lmbda + 2 mu, over Young's modulus of the bodies
FAR = 1e3  # distance, over the size of the joint, of ends that there are not


def require_free_ends(one: SeamLayer, bodies: str) -> None:
    """Raise an error unless the constants of free ends hold for a layer whose edges are "free".

    Args:
        one: the layer.
        bodies: as of the model.

    Raises:
        LawError: of the law. ModelError: of the joint, or of the bodies' stiffness.
    """
    structure = one.structure
    law = real_law(one.layer, structure.kinematics)
    nu, moduli = law.free_end().nu, law.parameters()
    if nu > LARGEST_NU + ROUNDING:
        raise ModelError(
            f"edges='free' of {law!r}: Poisson's ratio is {nu:.4g}; allowed: at most {LARGEST_NU}, beyond which the "
            "pressure falls over more than the strip along an end; use forms.Rubber"
        )
    if bodies != "kept":
        raise ModelError(
            "edges='free' needs bodies='kept': where bodies are apart ends of the layer may be oblique, and their "
            "constants are not known"
        )
    if structure.plane == "axisymmetric":
        raise ModelError(
            "edges='free' of a body of revolution: its free ends are curved, whose constants are not known"
        )
    M, E = float(moduli["lmbda"] + 2 * moduli["mu"]), softest_body(one)
    if M > LARGEST_STIFFNESS * E:
        raise ModelError(
            f"edges='free' needs bodies much stiffer than the layer, as its constants are those between rigid faces: "
            f"lmbda + 2 mu of the layer is {M:.4g}, Young's modulus of a body on S {E:.4g}; allowed: at most "
            f"{LARGEST_STIFFNESS:g} of it; use edges=None"
        )


def softest_body(one: SeamLayer) -> float:
    """The least Young's modulus at rest of the bodies on a seam, at the mean over all directions."""
    joint, n, found = one.structure.joint, one.sheet.mean_normal, [np.inf]
    sides = joint.surface_cells[one.sheet.facets]
    cells = np.unique(sides[sides >= 0])
    for number in np.unique(joint.region[cells]):
        law = one.structure.body_laws[joint.regions[number]]
        centres = joint.points[joint.corners[cells[joint.region[cells] == number]]].mean(axis=1)
        for known in law.samples(centres.T) if law.fields else [law]:
            C = tangent_at_rest(known, n) if is_checked_at_rest(known) else known.stiffness(n)
            if C is not None:
                lmbda, mu = average_lame(C)
                found.append(mu * (3 * lmbda + 2 * mu) / (lmbda + mu))
    return float(min(found))


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
                f"edges='free': strips of {max(strips.l_N, strips.l_T) * eps:.3g} along the free ends of {sheet.name} lie "
                "on one another; such a short S needs a meshed layer"
            )
        return cls(weights[0], weights[1], m, offset)


def end_weights(model: Model, one: SeamLayer, end: FreeEnd, sides: Interface) -> EndWeights | None:
    """The weights of a layer's free ends as UFL expressions on S; None: it has no free end. Collective."""
    assert one.thin
    sheet, joint, strips, eps = one.sheet, model.joint, Strips.of(end), float(one.thin.eps)
    rim = free_rim(model, sheet)
    if not len(rim.vertices):
        return None
    try:
        ends = straight_ends(rim, sheet)
    except GeometryError as error:
        raise ModelError(f"edges='free': {error}; constants of curved ends are not known") from error
    on = FacetWeights.of(ends, sheet, eps, strips)
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
