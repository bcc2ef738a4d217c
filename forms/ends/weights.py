"""Reductions of a layer's stiffness near its free ends, for interface laws of order 1.

With them the errors far from the ends are O(eps^2) instead of O(eps).

Near a free end a layer is less stiff than an infinite layer. Let the faces move apart by w_N across S and by w_T along
S. Then the forces c_N M w_N and c_T mu w_T per unit of edge are missing (`FreeEnd`). Here M is lmbda + 2 mu. Moreover,
the stresses lmbda w_N along S and mu w_T across S vanish at the end. They are transferred to the faces over lengths of
about the thickness.

Let d be the distance to the end, m the end's normal in S, and tau the direction along the end in S. Let e_N and g be
the strains of the jump across S and along S. Let e_S be the strain, in S, of the mean displacement <u> of the faces,
and h the gradient of <u_N> along S. The indices m and tau denote components. The mean strain has the energy W per
volume:

    2 W = M (1 - a_N) e_N^2 + 2 lmbda f_N e_N tr e_S + [lmbda (tr e_S)^2 + 2 mu e_S : e_S]/(1 - a_N)
          + mu [(1 - a_T) g_m^2 + 2 f_T g_m h_m + h_m^2/(1 - a_T)] + mu (g_tau + h_tau)^2.

The losses of stiffness in strips along the ends are a_N and a_T. a_N = c_N eps/l_N within the length l_N of an end, and
a_T = c_T eps/l_T within l_T; elsewhere both are zero. f_N = min(1, d/(2 rho_N eps)) and f_T = min(1, d/(2 c_T eps)) are
the fractions of the stresses that have not yet been transferred to the faces.

The strips have the lengths l_N = 2 m_N eps/c_N, but at most 3 eps, and l_T = 2 m_T eps/c_T. With these lengths the
missing tractions have the right first moments. On a facet in which a strip ends, a_N and a_T are their means over the
facet. The integral of a_N across an end is therefore c_N eps on any mesh, that of a_T is c_T eps. W is convex because
a_N, a_T < 1 and f_N, f_T <= 1.

W is the sum of the energies of the isotropic law at two strains, marked by ' and ''. With q = 1 - a, and without the
tau components, these strains are

    e_N' = sqrt(q_N) e_N - (1 - f_N) lmbda/M tr e_S/sqrt(q_N);    e_N'' = lmbda/M sqrt((1 - f_N^2)/q_N) tr e_S;
    e_S' = e_S/sqrt(q_N);                                         e_S'' = 0;
    g' = sqrt(q_T) g_m + f_T h_m/sqrt(q_T);                       g'' = sqrt((1 - f_T^2)/q_T) h_m.

A law with a pressure on S (`forms.rubber`) needs only the terms of shear. Its pressure is zero at free ends, which
makes it less stiff against openings. The loss of force is that of c_N if the flow along S within one thickness of an
end is multiplied by kappa (`FreeEnd.kappa`). On a facet of which only the fraction s is in this strip, the resistances
to the flow add up. The factor on the flow is then 1/(1 + (1/kappa - 1) s).
"""

from __future__ import annotations

from typing import NamedTuple

import ufl

from forms.ends.constants import FreeEnd
from forms.stations import Faces
from forms.tensors import Expr, three_dimensional

MAX_OPENING_STRIP = 3.0  # largest length, over the thickness, of the strip that is weaker against openings
# Spreading lengths, over the thickness: up to the first a pressure is not linear near an end, from the second it is.
SPREAD_LENGTHS = (8.0, 10.0)


class EndStrip(NamedTuple):
    """A strip of S along a free end with a constant loss of stiffness, or a constant gain of resistance to flow.

    Lengths are divided by the thickness. The relative loss or gain is c/length in the strip.

    Attributes:
        c: integral of the relative loss or gain across the strip; 0: no strip.
        length: length of the strip from the end, > 0.
    """

    c: float = 0.0
    length: float = 1.0


class EndStrips(NamedTuple):
    """Strips of S along a free end of an isotropic layer in which the interface law of order 1 is modified.

    All lengths are divided by the thickness of the layer.

    Attributes:
        opening: strip in which the layer is less stiff against openings.
        shear: strip in which the layer is less stiff against shear.
        resistance: strip in which the pressure-driven flow along S meets more resistance, or less if its `c` is
            negative.
        transfer_length_axial: length from the end over which stresses along S are transferred to the faces. 0: at the
            end itself.
        transfer_length_shear: length from the end over which shear stresses across S are transferred to the faces.
    """

    opening: EndStrip
    shear: EndStrip
    resistance: EndStrip
    transfer_length_axial: float
    transfer_length_shear: float

    @property
    def max_length(self) -> float:
        """Length of the longest strip in which the law is changed (`c` is not zero), divided by the thickness."""
        return max(strip.length for strip in (self.opening, self.shear, self.resistance) if strip.c)

    @classmethod
    def of_end(cls, end: FreeEnd) -> EndStrips:
        """Return the strips of a law without a pressure field: one for openings, and one for shear.

        A free end reduces the forces that the layer bears. The losses of stiffness in the strips reduce the forces, and
        their first moments about the end, by as much. The strip for openings is at most `MAX_OPENING_STRIP` long. If
        this bound is active, the first moment is reduced by less.
        """
        l_N = min(2 * end.m_N / end.c_N, MAX_OPENING_STRIP) if end.c_N else MAX_OPENING_STRIP
        return cls(EndStrip(end.c_N, l_N), _shear_strip(end), EndStrip(), 2 * end.rho_N, 2 * end.c_T)

    @classmethod
    def with_pressure(cls, end: FreeEnd) -> EndStrips:
        """Return the strips of a law with a pressure field on S: one for shear, and one for the resistance to flow.

        There is no strip for openings. The pressure is zero at the free end, which already makes the law less stiff
        against openings there.
        """
        return cls(EndStrip(), _shear_strip(end), EndStrip(1 / end.kappa - 1), 0.0, 2 * end.c_T)

    def for_spreading_length(self, length: float) -> EndStrips:
        """Return the strips for a layer in which a pressure evens out over at most `length` thicknesses along S.

        For nu > 0.49 the flow at an end has less resistance than in an infinite layer (kappa > 1). This only holds if
        the pressure grows linearly over many thicknesses, which a narrow S or soft bodies can prevent. The strip
        `resistance` of such a layer is therefore left out up to the first of `SPREAD_LENGTHS`, and whole from the
        second; between them it grows linearly, so that no result jumps.
        """
        shortest, longest = SPREAD_LENGTHS
        share = min(max((length - shortest) / (longest - shortest), 0.0), 1.0)
        c = self.resistance.c
        return self if c >= 0 else self._replace(resistance=self.resistance._replace(c=share * c))


def _shear_strip(end: FreeEnd) -> EndStrip:
    return EndStrip(end.c_T, 2 * end.m_T / end.c_T)


class EndWeights(NamedTuple):
    """Changes of a layer's interface law of order 1 near its free ends, UFL expressions at a place of S.

    Their formulas are in the docstring of this module.

    Attributes:
        m: unit normal of the nearest end, tangential to S; (d,) in d dimensions.
        a_N, a_T: relative loss of stiffness against openings (a_N) and against shear (a_T); >= 0 and < 1.
        f_N, f_T: fraction, from 0 to 1, of the stress along S (f_N) and across S (f_T) that is not yet transferred to
            the faces.
        flow_factor: factor on the pressure-driven flow along S; > 0.
    """

    m: Expr
    a_N: Expr
    a_T: Expr
    f_N: Expr
    f_T: Expr
    flow_factor: Expr

    def shear_strains(self, faces: Faces) -> tuple[Expr, Expr]:
        """Return two strains (3, 3), UFL, by which a free end changes the layer's energy in shear.

        The first has to be added to the mean strain of an infinite layer. The second is the strain g'' in the docstring
        of this module; its energy has to be added to the layer's.

        Args:
            faces: displacements of the faces of the layer.
        """
        m, n = three_dimensional(self.m), three_dimensional(faces.n)
        g, h = 2 * ufl.dot(n, faces.strain_across() * m), 2 * ufl.dot(n, faces.mean_strain_s * m)
        root, sym_mn = ufl.sqrt(1 - self.a_T), ufl.sym(ufl.outer(m, n))
        return ((root - 1) * g + (self.f_T / root - 1) * h) * sym_mn, ufl.sqrt(1 - self.f_T**2) / root * h * sym_mn

    def strains(self, faces: Faces, lmbda_ratio: Expr) -> tuple[Expr, Expr]:
        """Return two strains (3, 3), UFL, whose energies sum to that of the layer's mean strain near a free end.

        The energies are those of the isotropic law. Their sum is W in the docstring of this module.

        Args:
            faces: displacements of the faces of the layer.
            lmbda_ratio: the ratio lmbda/(lmbda + 2 mu) of the law.
        """
        n, across, mean = three_dimensional(faces.n), faces.strain_across(), faces.mean_strain_s
        e_1, e_2 = self.shear_strains(faces)
        e_N, e_S, root = ufl.dot(n, across * n), faces.in_plane(mean), ufl.sqrt(1 - self.a_N)
        thinning = lmbda_ratio * ufl.tr(e_S) / root
        e_1 += across + mean + (1 / root - 1) * e_S
        e_1 += ((root - 1) * e_N - (1 - self.f_N) * thinning) * faces.n_dyad
        return e_1, e_2 + ufl.sqrt(1 - self.f_N**2) * thinning * faces.n_dyad
