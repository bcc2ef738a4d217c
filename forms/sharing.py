"""Sharing: isotropic elastic sublayers in series, in the interface law of order 1."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import ufl

from forms.elastic import LinearElastic
from forms.kinematics import Expr, jump_strain, lift
from forms.law import BulkLaw
from forms.stations import Faces, Station


class Moments(LinearElastic):
    """Averages of elastic laws, whose moduli may be negative."""

    def check(self) -> None:
        """Nothing: the laws of the sublayers have been checked."""


@dataclass(frozen=True)
class Across(Moments):
    """All sublayers under tractions on planes parallel to S, which are equal in all of them.

    Averages are over the thickness; Phi_N and Phi_T as in `in_series`.

    Attributes:
        lmbda, mu: lmbda + 2 mu is the harmonic mean of lmbda + 2 mu, and mu that of mu.
        lateral: mean of r = lmbda/(lmbda + 2 mu), by which a layer gets thinner as it is stretched along S.
        lateral_normal, lateral_tangential: means of r Phi_N and r Phi_T.
        normal, tangential: means of Phi_N and Phi_T.
    """

    lateral: float
    lateral_normal: float
    lateral_tangential: float
    normal: float
    tangential: float

    def strain(self, faces: Faces) -> Expr:
        """The mean strain across the layer, and what strains along S add to it where no traction acts."""
        n, across = lift(faces.n), faces.across() + faces.mean
        thinned = faces.split(self.lateral_normal, self.lateral_tangential).difference
        turned = faces.split(self.normal, self.tangential).difference
        stretch = self.lateral * ufl.tr(faces.in_s(across)) + ufl.tr(faces.in_s(thinned))
        shear = 2 * ufl.dot(across + turned, n)
        shear -= ufl.dot(shear, n) * n
        return (ufl.dot(n, ufl.dot(across, n)) + stretch) * faces.normal + jump_strain(shear, n)


def in_series(sublayers: tuple[tuple[float, BulkLaw], ...]) -> list[Station[Any]]:
    """Stations of isotropic elastic sublayers, from the lower to the upper face.

    Displacements through the layer are <u> + Phi [u]: the sublayers share the jump as at order 0, so that Phi_N along n and
    Phi_T along S grow from -1/2 to 1/2 in proportion to 1/(lmbda + 2 mu) and to 1/mu. The stress is the traction on planes
    parallel to S, equal in all sublayers as each is strained across S a little further, and what strains along S add to it;
    the energies of both add up. (With the strains of <u> + Phi [u] alone a nearly incompressible sublayer would lock.)

    The first station is `Across`. The others have the strains along S. Their energy is quadratic in Phi_T, so that three
    places, Phi_T = -1/2, 0 and 1/2, with the right moments of the moduli give its integral over any number of sublayers.

    Raises:
        LawError: a sublayer of another kind.
    """
    fractions, moduli = [a for a, _ in sublayers], [law.elastic_moduli() for _, law in sublayers]

    def mean(values: Iterable[Any]) -> Any:
        return sum(a * value for a, value in zip(fractions, values, strict=True))

    stiffness, mu = [lmbda + 2 * mu for lmbda, mu in moduli], [mu for _, mu in moduli]
    whole, sheared = 1 / mean(1 / one for one in stiffness), 1 / mean(1 / one for one in mu)
    r = [lmbda / one for (lmbda, _), one in zip(moduli, stiffness, strict=True)]
    normal, tangential, squared = [], [], []  # means of Phi_N, Phi_T and Phi_T^2 over each sublayer
    at_n = at_t = -0.5
    for a, one, shear in zip(fractions, stiffness, mu, strict=True):
        step_n, step_t = a * whole / one, a * sheared / shear
        normal.append(at_n + step_n / 2)
        tangential.append(at_t + step_t / 2)
        squared.append(at_t * at_t + at_t * step_t + step_t * step_t / 3)
        at_n, at_t = at_n + step_n, at_t + step_t

    def times(first: list[Any], second: list[Any]) -> list[Any]:
        return [a * b for a, b in zip(first, second, strict=True)]

    def along(phi: float, shares: list[Any]) -> Station:
        law = Moments(2 * mean(times(times(shares, r), mu)), mean(times(shares, mu)))
        return Station(law, 1, lambda law, faces: faces.in_s(faces.mean + phi * faces.difference))

    across = Across(
        whole - 2 * sheared,
        sheared,
        lateral=mean(r),
        lateral_normal=mean(times(r, normal)),
        lateral_tangential=mean(times(r, tangential)),
        normal=mean(normal),
        tangential=mean(tangential),
    )
    return [
        Station(across, 1, lambda law, faces: law.strain(faces)),
        along(-0.5, [2 * p - q for p, q in zip(squared, tangential, strict=True)]),
        along(0.0, [1 - 4 * p for p in squared]),
        along(0.5, [2 * p + q for p, q in zip(squared, tangential, strict=True)]),
    ]
