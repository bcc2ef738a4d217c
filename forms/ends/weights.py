"""How a layer's interface law of order 1 is changed near its free ends, so that its error is of order 2 there, too.

Near a free end a layer is weaker than an infinite one. Between faces that move by w_N across and w_T along S, what it
lacks is the force c_N M w_N and c_T mu w_T per unit of edge (`FreeEnd`); besides, stresses lmbda w_N along S and mu w_T
across it, which a layer of no thickness would bring to its last point, are handed to the faces over lengths of the
thickness. With d the distance to the end, m its normal in S, e_N, g the strains of the jump across S and along it, e_S and
h those of the mean displacements, in S and of <u_N> along m, the energy per volume of the mean strain is

    2 W = M (1 - a_N) e_N^2 + 2 lmbda f_N e_N tr e_S + [lmbda (tr e_S)^2 + 2 mu e_S : e_S]/(1 - a_N)
          + mu [(1 - a_T) g_m^2 + 2 f_T g_m h_m + h_m^2/(1 - a_T)] + mu (g_tau + h_tau)^2,

a_N = c_N eps/l_N within l_N of an end, a_T = c_T eps/l_T within l_T, else zero; f_N = min(1, d/(2 rho_N eps)), f_T =
min(1, d/(2 c_T eps)). The strips have the first moments of what is missing, l = 2 m eps/c, but l_N <= 3 eps. On facets that
a strip ends in, a has its mean: the integral of a across an end is c eps on any mesh. W is convex as a < 1 and f <= 1.

It is the energy of the isotropic law itself at two strains: with q = 1 - a, and without the tau components,

    e_N' = sqrt(q_N) e_N - (1 - f_N) lmbda/M tr e_S/sqrt(q_N),    e_N'' = lmbda/M sqrt((1 - f_N^2)/q_N) tr e_S,
    e_S' = e_S/sqrt(q_N),                                         e_S'' = 0,
    g' = sqrt(q_T) g_m + f_T h_m/sqrt(q_T),                       g'' = sqrt((1 - f_T^2)/q_T) h_m.

A law with a pressure on S that is zero at free ends (`forms.rubber`) has the part of shear alone. Against openings its
pressure makes it weaker by itself, with c_N if within one thickness of an end the flow along S is kappa times that of an
infinite layer (`FreeEnd.kappa`). What adds up across an end is the resistance to the flow: on facets that the strip ends in
the flow has the harmonic mean, 1 + (1/kappa - 1) times the part of the facet in the strip.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import ufl

from forms.ends.constants import FreeEnd
from forms.stations import Faces, Station, pressure_stations
from forms.tensors import Expr, three_dimensional

OPENING_STRIP_LENGTH = 3.0  # length over the thickness of the strip where openings are weaker
LINEAR_PRESSURE_LENGTH = 10.0  # length over the thickness from which on a pressure grows as a straight line near an end


@dataclass(frozen=True)
class EndStrip:
    """A strip along a free end, where a weight is c/length; lengths are over the thickness.

    Attributes:
        c: integral of the weight across the end; 0: there is none.
        length: of the strip, > 0.
    """

    c: float = 0.0
    length: float = 1.0


@dataclass(frozen=True)
class EndStrips:
    """The strips of an isotropic layer's free end, and lengths over the thickness.

    Attributes:
        opening, shear: where the layer is weaker against openings, and against shear.
        resistance: where a pressure meets more resistance to its flow along S.
        r_N, r_T: over which the stress along S is handed to the faces if the layer opens, and if it is sheared; 0: at once.
    """

    opening: EndStrip
    shear: EndStrip
    resistance: EndStrip
    r_N: float
    r_T: float

    @property
    def longest(self) -> float:
        """Length of the longest strip where the layer is weaker."""
        return max(strip.length for strip in (self.opening, self.shear, self.resistance) if strip.c)

    @classmethod
    def of(cls, end: FreeEnd) -> EndStrips:
        """The strips with the first moments of an end."""
        l_N = min(2 * end.m_N / end.c_N, OPENING_STRIP_LENGTH) if end.c_N else OPENING_STRIP_LENGTH
        return cls(EndStrip(end.c_N, l_N), _of_shear(end), EndStrip(), 2 * end.rho_N, 2 * end.c_T)

    @classmethod
    def with_pressure(cls, end: FreeEnd) -> EndStrips:
        """Those of a law whose pressure falls to zero at the end: it is weaker against openings by itself."""
        return cls(EndStrip(), _of_shear(end), EndStrip(1 / end.kappa - 1), 0.0, 2 * end.c_T)

    def of_spread(self, length: float) -> EndStrips:
        """Those of a pressure that spreads over a length (over the thickness) at most, whatever the layer's ratio.

        For nu > 0.49 an end has less resistance than the flow of an infinite layer (kappa > 1), if the pressure grows as a
        straight line over many thicknesses. Where narrow S or soft bodies prevent that it has not: within 5 thicknesses
        the flow is nearer to that of an infinite layer.
        """
        return (
            self if self.resistance.c >= 0 or length >= LINEAR_PRESSURE_LENGTH else replace(self, resistance=EndStrip())
        )


def _of_shear(end: FreeEnd) -> EndStrip:
    return EndStrip(end.c_T, 2 * end.m_T / end.c_T)


@dataclass(frozen=True)
class EndWeights:
    """Weights at a place of S, near free ends or not.

    Attributes:
        m: unit normal of the nearest end, in S; (d,).
        a_N, a_T: how much weaker the layer is against openings and shear; 0 <= a < 1.
        f_N, f_T: how much of the stress along S there is; 0 <= f <= 1.
        flow: factor of the flow along S of a pressure; > 0.
    """

    m: Expr
    a_N: Expr
    a_T: Expr
    f_N: Expr
    f_T: Expr
    flow: Expr

    def sheared(self, faces: Faces) -> tuple[Expr, Expr]:
        """What weights of shear add to the strain (3, 3) of an infinite layer, and g'' as a strain of its own."""
        m, n = three_dimensional(self.m), three_dimensional(faces.n)
        g, h = 2 * ufl.dot(n, faces.across() * m), 2 * ufl.dot(n, faces.mean * m)
        root, shear = ufl.sqrt(1 - self.a_T), ufl.sym(ufl.outer(m, n))
        return ((root - 1) * g + (self.f_T / root - 1) * h) * shear, ufl.sqrt(1 - self.f_T**2) / root * h * shear

    def strains(self, faces: Faces, share: Any) -> tuple[Expr, Expr]:
        """The two strains (3, 3) at which the isotropic law with lmbda/M = share has the energy W."""
        n, across, mean, (first, second) = three_dimensional(faces.n), faces.across(), faces.mean, self.sheared(faces)
        e_N, e_S, root = ufl.dot(n, across * n), faces.in_s(mean), ufl.sqrt(1 - self.a_N)
        trace = share * ufl.tr(e_S) / root
        first += across + mean + (1 / root - 1) * e_S
        first += ((root - 1) * e_N - (1 - self.f_N) * trace) * faces.normal
        return first, second + ufl.sqrt(1 - self.f_N**2) * trace * faces.normal


def pressure_stations_at_ends(law: Any, weights: EndWeights) -> list[Station[Any]]:
    """`forms.stations.pressure_stations` near free ends."""
    mean, stiff = pressure_stations(law)
    sheared = replace(
        mean,
        strain=lambda law, faces: mean.strain(law, faces) + weights.sheared(faces)[0],
        flow=lambda law: weights.flow * mean.flow(law),
    )
    return [sheared, Station(stiff.law, 1, lambda law, faces: weights.sheared(faces)[1]), stiff]
