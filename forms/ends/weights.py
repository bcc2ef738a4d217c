"""Reductions of a layer's stiffness near its free ends, for interface laws of order 1.

With them the errors far from the ends are O(eps^2) instead of O(eps).

Near a free end a layer is less stiff than an infinite layer. Let its faces move apart by w_N across S and by w_T along
S. Then the forces c_N M w_N and c_T mu w_T per unit of edge are missing (`FreeEnd`), with M = lmbda + 2 mu. In
addition, the stresses lmbda w_N along S and mu w_T across S cannot reach the end, as they would in a layer without
thickness. They are transferred to the faces over lengths of about the thickness.

Let d be the distance to the end, m the end's normal in S, and tau the direction along the end in S. Let e_N and g be
the strains of the jump across S and along it. Let e_S be the strain of the mean displacements <u> of the faces in S,
and h the gradient of <u_N> along S. Indices m and tau are components. The mean strain has the energy per volume

    2 W = M (1 - a_N) e_N^2 + 2 lmbda f_N e_N tr e_S + [lmbda (tr e_S)^2 + 2 mu e_S : e_S]/(1 - a_N)
          + mu [(1 - a_T) g_m^2 + 2 f_T g_m h_m + h_m^2/(1 - a_T)] + mu (g_tau + h_tau)^2.

Here a_N = c_N eps/l_N within l_N of an end, and a_T = c_T eps/l_T within l_T; elsewhere both are zero. The others are
f_N = min(1, d/(2 rho_N eps)) and f_T = min(1, d/(2 c_T eps)). The lengths l_N = 2 m_N eps/c_N and l_T = 2 m_T eps/c_T
of the strips reproduce the first moments of the missing tractions; but l_N <= 3 eps. On facets in which a strip ends,
a_N and a_T have their mean over the facet. The integral of a_N across an end is therefore c_N eps on any mesh, that of
a_T is c_T eps. W is convex because a_N, a_T < 1 and f_N, f_T <= 1.

W is the sum of the energies of the isotropic law at two strains. With q = 1 - a, and without the tau components, they
are

    e_N' = sqrt(q_N) e_N - (1 - f_N) lmbda/M tr e_S/sqrt(q_N);    e_N'' = lmbda/M sqrt((1 - f_N^2)/q_N) tr e_S;
    e_S' = e_S/sqrt(q_N);                                         e_S'' = 0;
    g' = sqrt(q_T) g_m + f_T h_m/sqrt(q_T);                       g'' = sqrt((1 - f_T^2)/q_T) h_m.

A law with a pressure on S (`forms.rubber`) needs the shear part only. Its pressure is zero at free ends, which makes it
less stiff against openings. This gives c_N if the flow along S within one thickness of an end is kappa times the flow
in an infinite layer (`FreeEnd.kappa`). Resistances to the flow add up across an end. On facets in which the strip ends,
the flow factor is therefore the harmonic mean. With the fraction s of the facet in the strip it is 1/(1 + (1/kappa - 1)
s).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import ufl

from forms.ends.constants import FreeEnd
from forms.stations import AnyStation, Faces, Station, pressure_stations
from forms.tensors import Expr, three_dimensional

if TYPE_CHECKING:
    from forms.rubber import PressureLaw

OPENING_STRIP_LENGTH = 3.0  # largest length, over the thickness, of the strip that is weaker against openings
MIN_SPREAD = 10.0  # spreading length, over the thickness, from which a pressure grows linearly near an end


class EndStrip(NamedTuple):
    """A strip of S along a free end with the uniform weight c/length; lengths are over the thickness.

    The weight is a relative loss of stiffness, or a relative increase of the resistance to a flow along S.

    Attributes:
        c: integral of the weight across the end; 0: no strip.
        length: length of the strip from the end, > 0.
    """

    c: float = 0.0
    length: float = 1.0


class EndStrips(NamedTuple):
    """Strips of S along a free end of an isotropic layer in which its law changes; all lengths are over the thickness.

    Attributes:
        opening, shear: strips in which the layer is less stiff against openings, and against shear.
        resistance: strip in which the pressure-driven flow along S meets more resistance; less if its c < 0.
        r_N, r_T: lengths over which the stress is transferred to the faces if the layer opens, and if it is sheared; 0:
            at once.
    """

    opening: EndStrip
    shear: EndStrip
    resistance: EndStrip
    r_N: float
    r_T: float

    @property
    def longest(self) -> float:
        """Length over the thickness of the longest strip that is not empty."""
        return max(strip.length for strip in (self.opening, self.shear, self.resistance) if strip.c)

    @classmethod
    def of(cls, end: FreeEnd) -> EndStrips:
        """Strips that reproduce the missing forces of a free end, and as far as possible their first moments."""
        l_N = min(2 * end.m_N / end.c_N, OPENING_STRIP_LENGTH) if end.c_N else OPENING_STRIP_LENGTH
        return cls(EndStrip(end.c_N, l_N), _of_shear(end), EndStrip(), 2 * end.rho_N, 2 * end.c_T)

    @classmethod
    def with_pressure(cls, end: FreeEnd) -> EndStrips:
        """Strips of a law whose pressure on S is zero at the free end.

        The pressure makes this law less stiff against openings, without a strip for openings.
        """
        return cls(EndStrip(), _of_shear(end), EndStrip(1 / end.kappa - 1), 0.0, 2 * end.c_T)

    def of_spread(self, length: float) -> EndStrips:
        """Strips for a layer whose pressure spreads over at most `length`, a length over the thickness.

        For nu > 0.49 the flow at an end has less resistance than in an infinite layer (kappa > 1). This holds if the
        pressure grows linearly over many thicknesses. Narrow S or soft bodies can prevent this. If `length` is below
        `MIN_SPREAD`, the flow near the end is closer to that in an infinite layer. The strip `resistance` is then left
        out.
        """
        return self if self.resistance.c >= 0 or length >= MIN_SPREAD else self._replace(resistance=EndStrip())


def _of_shear(end: FreeEnd) -> EndStrip:
    return EndStrip(end.c_T, 2 * end.m_T / end.c_T)


class EndWeights(NamedTuple):
    """Changes of a layer's law of order 1 near its free ends, at a place of S, UFL; the module has their formulas.

    Attributes:
        m: unit normal of the nearest end, in S; (d,) in d dimensions.
        a_N, a_T: relative loss of stiffness against openings and shear; 0 <= a < 1.
        f_N, f_T: fraction of the stress that has not been transferred to the faces; 0 <= f <= 1.
        flow: factor on the pressure-driven flow along S; > 0.
    """

    m: Expr
    a_N: Expr
    a_T: Expr
    f_N: Expr
    f_T: Expr
    flow: Expr

    def sheared(self, faces: Faces) -> tuple[Expr, Expr]:
        """Two strains (3, 3) by which a free end changes the layer's energy in shear.

        The first is added to the mean strain of an infinite layer; the second has an energy of its own (g'' in the
        module).

        Args:
            faces: displacements of the faces of the layer.
        """
        m, n = three_dimensional(self.m), three_dimensional(faces.n)
        g, h = 2 * ufl.dot(n, faces.across() * m), 2 * ufl.dot(n, faces.mean * m)
        root, shear = ufl.sqrt(1 - self.a_T), ufl.sym(ufl.outer(m, n))
        return ((root - 1) * g + (self.f_T / root - 1) * h) * shear, ufl.sqrt(1 - self.f_T**2) / root * h * shear

    def strains(self, faces: Faces, share: Expr) -> tuple[Expr, Expr]:
        """Two strains (3, 3) whose energies in the isotropic law add up to the layer's energy near a free end.

        This energy is W in the module.

        Args:
            faces: displacements of the faces of the layer.
            share: lmbda/(lmbda + 2 mu) of the law.
        """
        n, across, mean, (e_1, e_2) = three_dimensional(faces.n), faces.across(), faces.mean, self.sheared(faces)
        e_N, e_S, root = ufl.dot(n, across * n), faces.in_s(mean), ufl.sqrt(1 - self.a_N)
        trace = share * ufl.tr(e_S) / root
        e_1 += across + mean + (1 / root - 1) * e_S
        e_1 += ((root - 1) * e_N - (1 - self.f_N) * trace) * faces.normal
        return e_1, e_2 + ufl.sqrt(1 - self.f_N**2) * trace * faces.normal


def pressure_stations_at_ends(law: PressureLaw, weights: EndWeights) -> list[AnyStation]:
    """Three stations of a law with a pressure field on S, near free ends of the layer.

    They are the stations of `forms.stations.pressure_stations`, changed by the weights, and one for the second shear
    strain.

    Args:
        law: the law.
        weights: changes of the law near free ends, UFL on S.
    """
    mean_station, in_plane = pressure_stations(law)
    sheared = replace(
        mean_station,
        strain=lambda law, faces: mean_station.strain(law, faces) + weights.sheared(faces)[0],
        flow=lambda law: weights.flow * mean_station.flow(law),
    )
    return [sheared, Station(in_plane.law, 1, lambda law, faces: weights.sheared(faces)[1]), in_plane]
