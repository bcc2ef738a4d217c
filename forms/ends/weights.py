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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl

from forms.ends.constants import FreeEnd
from forms.kinematics import Expr, lift
from forms.stations import Faces

LONGEST = 3.0  # length over the thickness of the strip where openings are weaker


@dataclass(frozen=True)
class Strips:
    """Lengths over the thickness of an isotropic layer's free end.

    Attributes:
        c_N, c_T: as of `FreeEnd`.
        l_N, l_T: of the strips where the layer is weaker against openings, and against shear.
        r_N, r_T: over which the stress along S is handed to the faces if the layer opens, and if it is sheared.
    """

    c_N: float
    l_N: float
    r_N: float
    c_T: float
    l_T: float
    r_T: float

    @classmethod
    def of(cls, end: FreeEnd) -> Strips:
        """The strips with the first moments of an end."""
        l_N = min(2 * end.m_N / end.c_N, LONGEST) if end.c_N else LONGEST
        return cls(end.c_N, l_N, 2 * end.rho_N, end.c_T, 2 * end.m_T / end.c_T, 2 * end.c_T)


@dataclass(frozen=True)
class EndWeights:
    """Weights at a place of S, near free ends or not.

    Attributes:
        m: unit normal of the nearest end, in S; (d,).
        a_N, a_T: how much weaker the layer is against openings and shear; 0 <= a < 1.
        f_N, f_T: how much of the stress along S there is; 0 <= f <= 1.
    """

    m: Expr
    a_N: Expr
    a_T: Expr
    f_N: Expr
    f_T: Expr

    def strains(self, faces: Faces, share: Any) -> tuple[Expr, Expr]:
        """The two strains (3, 3) at which the isotropic law with lmbda/M = share has the energy W."""
        m, n = lift(self.m), lift(faces.n)
        across, mean = faces.across(), faces.mean
        e_N, e_S = ufl.dot(n, across * n), faces.in_s(mean)
        g, h = 2 * ufl.dot(n, across * m), 2 * ufl.dot(n, mean * m)
        root_N, root_T = ufl.sqrt(1 - self.a_N), ufl.sqrt(1 - self.a_T)
        trace = share * ufl.tr(e_S) / root_N
        both = (root_T - 1) * g + (self.f_T / root_T - 1) * h
        shear = ufl.sym(ufl.outer(m, n))
        first = across + mean + (1 / root_N - 1) * e_S + both * shear
        first += ((root_N - 1) * e_N - (1 - self.f_N) * trace) * faces.normal
        second = ufl.sqrt(1 - self.f_N**2) * trace * faces.normal + ufl.sqrt(1 - self.f_T**2) / root_T * h * shear
        return first, second
