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

What the constants are worth: with f_N = f_T = 1 errors are up to 9 times as large, with kappa = 1 those of the forces on
rubber bearings 2 to 60 times. Strips of 1.5 and 0.7 thicknesses for all nu make errors in blocks 1.1 to 2.7 times
smaller, but up to 4.5 times larger in discs, where first moments count.
"""

from __future__ import annotations

from typing import NamedTuple

import ufl

from forms.stations import Faces
from forms.tensors import Expr, three_dimensional


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
