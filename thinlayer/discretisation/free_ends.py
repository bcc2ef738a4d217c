"""What an interface law knows of the free ends of its seam, and why it does not know them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from forms.elastic import LARGEST_NU, ROUNDING
from forms.ends.weights import EndWeights, Strips
from forms.interface import Interface
from forms.tangent import average_lame, is_checked_at_rest, tangent_at_rest
from geometry.ends import straight_ends
from geometry.errors import GeometryError, place
from geometry.sheet import Rim
from thinlayer.discretisation.end_weights import FacetWeights
from thinlayer.discretisation.free_rim import fall_of_pressure, free_rim, why_oblique
from thinlayer.discretisation.layer import ThinLayer, real_law
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer

LEAST_CONTRAST = 40.0  # Young's modulus of the bodies over the layer's mu
LEAST_RADIUS = 4.0  # of curved ends, over the thickness; what constants leave out there is of the order of its inverse
BENDING = 44.0  # 48 (1 - nu^2): (eps k)^3 E/mu where half-spaces yield to a pressure of wave number k as the layer does


@dataclass(frozen=True)
class SeamEnds:
    """The free ends of a layer's seam, and what its interface law knows of them.

    Attributes:
        unknown: why the law does not know them, and takes the layer for an infinite one there; None: it does, or there
            are none.
        weights: of the ends on the facets; None: there are none, or the law does not know them.
        strips: that the weights are made from.
    """

    unknown: str | None = None
    weights: FacetWeights | None = None
    strips: Strips | None = None

    @classmethod
    def of(cls, model: Model, one: SeamLayer, bodies: str) -> SeamEnds:
        """The ends of a layer of an interface model; not collective, and the same on all ranks.

        Args:
            model: whose supports are known.
            one: the layer.
            bodies: as of the model.
        """
        if one.thin is None:
            return cls("the law is one on S, without a thickness")
        if one.thin.order == 0:
            return cls("the interface law is of order 0")
        rim = free_rim(model, one.sheet)
        if not len(rim.vertices):
            return cls()
        if reason := why_oblique(model, one.sheet):
            return cls(reason)
        strips = real_law(one.layer, one.structure.kinematics).end_strips()
        if reason := _why_without_constants(one, one.thin, strips) or _why_not_here(one, rim, bodies):
            return cls(reason)
        assert strips is not None
        eps = float(one.thin.eps)
        contrast = softest_body(one) / float(real_law(one.layer, one.structure.kinematics).parameters()["mu"])
        width = float(one.sheet.areas.sum() / rim.length.sum()) / eps
        reason = _why_too_stiff(contrast) or _why_too_coarse(one, rim) or _why_too_short(width, strips)
        if reason:
            return cls(reason)
        strips = strips.of_spread(min(width, (contrast / BENDING) ** (1 / 3)))
        try:
            ends = straight_ends(rim, one.sheet)
        except GeometryError as error:
            return cls(f"{error}; constants of curved ends are not known")
        weights = FacetWeights.of(ends, one.sheet, eps, strips)
        if weights.overlap:
            return cls(f"strips of {strips.longest * eps:.3g} along them lie on one another; mesh the layer")
        return cls(None, weights, strips)

    @property
    def said(self) -> str:
        """What is known of them, in words."""
        if self.unknown:
            return f"not corrected, as {self.unknown}"
        return "none" if self.weights is None else "corrected"

    def expressions(self, model: Model, one: SeamLayer, sides: Interface) -> EndWeights | None:
        """The weights as UFL expressions on S; None: there are none. Collective."""
        if self.weights is None or self.strips is None:
            return None
        return self.weights.expressions(model, one, sides, self.strips)


def _why_without_constants(one: SeamLayer, thin: ThinLayer, strips: Strips | None) -> str | None:
    """Why constants of free ends are not known for a layer, if they are not."""
    if thin.edges == "plain":
        return "edges='plain' was asked for"
    for name, given in (("profile", thin.profile), ("eigenstrain", thin.eigenstrain)):
        if given is not None:
            return f"constants of free ends are not known for a layer with {name}=..."
    if strips is None:
        return (
            f"constants of free ends are not known for this {type(one.law).__name__}: they are for LinearElastic with "
            f"Poisson's ratio from 0 to {LARGEST_NU:g} and for Rubber and Incompressible, with parameters that are numbers"
        )
    return None


def _why_not_here(one: SeamLayer, rim: Rim, bodies: str) -> str | None:
    """Why constants of free ends are not known between these bodies, if they are not."""
    if bodies != "kept":
        return (
            "bodies are not kept, but apart: ends of the layer may be oblique there, and their constants are not known"
        )
    assert one.thin
    if one.structure.plane == "axisymmetric":
        radius = float(one.structure.joint.points[rim.vertices, 0].min()) / float(one.thin.eps)
        if radius < LEAST_RADIUS * (1 - ROUNDING):
            return (
                f"the free ends of a body of revolution are curved, and constants are those of straight ones: the least "
                f"radius is {radius:.3g} thicknesses; allowed: at least {LEAST_RADIUS:g}"
            )
    return None


def _why_too_stiff(contrast: float) -> str | None:
    """Why the constants, which are those between rigid faces, do not hold between these bodies, if they do not."""
    if contrast >= LEAST_CONTRAST * (1 - ROUNDING):
        return None
    return (
        "bodies must be much stiffer than the layer, as constants of free ends are those between rigid faces: Young's "
        f"modulus of a body on S is {contrast:.4g} times mu of the layer; allowed: at least {LEAST_CONTRAST:g} times"
    )


def _why_too_coarse(one: SeamLayer, rim: Rim) -> str | None:
    """Why the pressure of a layer, if it has one, is not zero at all free ends (`free_of_pressure`)."""
    if not one.flows or (coarse := rim[rim.depth > (fall := fall_of_pressure(one, rim))]).vertices.size == 0:
        return None
    at = place(one.structure.joint.points[coarse.vertices[0, 0]])
    return (
        f"cells at free ends must not be longer than the fall of the pressure there, {fall.min():.3g}, and the one at {at} "
        f"is {coarse.depth[0]:.3g} long; make them shorter (h_ends=...), or use LinearElastic if Poisson's ratio is at "
        f"most {LARGEST_NU:g}"
    )


def _why_too_short(width: float, strips: Strips) -> str | None:
    """Why ends are too near to one another, if they are; the width is over the thickness."""
    if width >= strips.longest:
        return None
    return (
        f"S is short: its area over the length of its free ends is {width:.3g} thicknesses; allowed: at least "
        f"{strips.longest:.3g}"
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
