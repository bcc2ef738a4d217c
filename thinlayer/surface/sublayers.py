"""Stiffness of a layer and of its sublayers at rest, and after a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from forms.law import BulkLaw
from forms.tangent import across, average_lame, in_plane_modulus
from geometry.topology import FloatArray
from thinlayer.discretisation.layer import SeamLayer

NEARLY_INCOMPRESSIBLE = 0.5  # (nu = 3/8) a shorter length of the pressure, relative to eps, has no effect along S
VOLUME = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # trace of a strain, as a row over its six components
BULK_MODULUS = 1e8  # bulk modulus that stands for incompressibility, relative to the tangent
NEGLIGIBLE = 1e-9  # modulus or stiffness, relative to others of the layer, that counts as zero
SAME_RATIO = 1e-3  # relative change of lmbda/mu in time that counts as none


@dataclass(frozen=True)
class Sublayer:
    """One of the sublayers of a layer whose law is a `Stack`, or the whole layer.

    Attributes:
        fraction: share of the layer's thickness.
        lmbda, mu: Lame moduli at rest or, if lmbda/mu changes in time, under loads that have lasted; a stress.
        along: modulus of the sublayer as a sheet in the plane of S; a stress.
        when: words for a warning that say how long loads last; "" at rest.
    """

    fraction: float
    lmbda: float
    mu: float
    along: float
    when: str = ""

    @property
    def nearly(self) -> bool:
        """Whether the sublayer is nearly incompressible."""
        return self.length > NEARLY_INCOMPRESSIBLE * self.fraction

    @property
    def length(self) -> float:
        """Length over which the pressure falls to zero at a free end, over the layer's thickness; may be infinite."""
        return self.fraction * math.sqrt(max(self.lmbda, 0.0) / (12 * self.mu))

    @property
    def compliance(self) -> float:
        """Compliance under a normal traction without strain along S, over the thickness of the layer."""
        return self.fraction / (self.lmbda + 2 * self.mu)

    @classmethod
    def of(cls, fraction: float, law: BulkLaw, C: FloatArray, n: FloatArray) -> Sublayer | None:
        """A sublayer from the tangent C at rest; None if the law does not resist shear."""
        lmbda, mu = average_lame(C)
        if law.traits.constrained and not law.parameters().get("lmbda"):
            held = np.outer(VOLUME, VOLUME) * np.abs(C).max() * BULK_MODULUS
            return cls(fraction, math.inf, mu, in_plane_modulus(C + held, n))
        return None if mu <= 0 else cls(fraction, lmbda, mu, in_plane_modulus(C, n))


def sublayers_of(one: SeamLayer, dt: float = 0.0) -> list[Sublayer]:
    """The sublayers of a layer under loads that have lasted dt (0: at rest); [] if tangents are not known."""
    n, sublayers = one.at_rest.n, one.at_rest.sublayers
    later = one.at_rest.over(dt) if dt > 0 else [None] * len(sublayers)
    found: list[Sublayer] = []
    for (a, law, C), C_later in zip(sublayers, later, strict=True):
        if C is None and C_later is None:
            return []
        rest, then = (None if one is None else Sublayer.of(a, law, one, n) for one in (C, C_later))
        if then and not (rest and math.isclose(then.lmbda * rest.mu, rest.lmbda * then.mu, rel_tol=SAME_RATIO)):
            then = replace(then, when=f" under loads that last {dt:.4g}")
        found += [one for one in (then or rest,) if one]
    return found


def acts_on_jumps(sublayers: list[Sublayer]) -> bool:
    """Whether strains along S cause no stress, as in springs: the traction then does not depend on the thickness."""
    return bool(sublayers) and all(one.along <= NEGLIGIBLE * one.mu for one in sublayers)


def stiffness_of_jumps(one: SeamLayer) -> tuple[float, float]:
    """Normal and least tangential stiffness of the layer at rest, per area; zeros if they are not known."""
    assert one.thin
    n, compliances = one.at_rest.n, np.zeros(2)
    for fraction, _, C in one.at_rest.sublayers:
        if C is None:
            return 0.0, 0.0
        A = across(C, n)
        size, up = float(np.abs(A).max()), float(n @ A @ n)
        along = float(np.linalg.eigvalsh((A + A.T) / 2 + 2 * size * np.outer(n, n))[0])
        if min(along, up) <= NEGLIGIBLE * size:
            return up, 0.0
        compliances += [fraction / up, fraction / along]
    normal, tangential = 1 / (compliances * one.thin.eps)
    return float(normal), float(tangential)
