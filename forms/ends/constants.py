"""Constants of a free end of a layer as functions of Poisson's ratio.

`estimate(state).better` needs no constants, but short cells: it has the errors of the layer's mesh. These are relative
errors of traction and jump inside S, and of the compliance, of blocks with nu = 0.3 (`tests/test_edges.py` checks the
first row):

    cells at ends   eps/width   law with constants     `better` of order 0
    2 eps           1/64        1e-5, 4e-5, 8e-5       6e-4, 1e-3, 7e-4
    eps/12          1/64        3e-6, 2e-5, 6e-5       4e-5, 5e-5, 6e-5
    eps/12          1/16        6e-5, 4e-4, 1e-3       2e-4, 2e-4, 2e-4
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from forms.base import Array, require

TABLE_COLUMNS = ("nu", "c_N", "m_N", "rho_N", "c_T", "m_T")
TABLE_FILE = Path(__file__).parent / "table.csv"
MAX_OPENING_STRIP = 3.0  # largest length, over the thickness, of the strip that is weaker against openings
# Spreading lengths, over the thickness: up to the first a pressure is not linear near an end, from the second it is.
SPREAD_LENGTHS = (8.0, 10.0)


class FreeEnd(NamedTuple):
    """Constants of an end of an isotropic layer between much stiffer bodies, free and at a right angle to the faces.

    The constants hold in plane strain. For plane stress take them at nu/(1 + nu) of the material in place of nu. All
    quantities are dimensionless: lengths are divided by the thickness of the layer, stresses by mu. M is lmbda + 2 mu,
    w_N the opening of the layer, w_T its slip. "Missing tractions" are the tractions of an infinite layer minus those
    of the layer with the end. At nu = 0.5 c_N, m_N and rho_N are infinite. Source: `studies/free_ends.py`.

    Attributes:
        nu: Poisson's ratio of the layer.
        c_N: shortening of the layer by the end under an opening: a layer of length L carries the force M w_N (L - c_N).
        m_N: first moment, about the end, of the missing normal tractions, divided by M w_N.
        rho_N: mean distance from the end of the tractions along S that balance the stress lmbda w_N.
        c_T: shortening of the layer by the end under a slip: a layer of length L carries the force mu w_T (L - c_T). It
            is also the mean distance from the end of the tractions across S that balance the moment of mu w_T. The mean
            displacement of the end across S is c_T w_T, away from the face that moves outwards.
        m_T: first moment, about the end, of the missing shear tractions, divided by mu w_T.
        kappa: factor on the pressure-driven flow along S within one thickness of the end, in laws with a pressure on S
            (`forms.rubber`). With this factor the shortening of such a layer under an opening is c_N without further
            corrections.
    """

    nu: float
    c_N: float
    m_N: float
    rho_N: float
    c_T: float
    m_T: float
    kappa: float

    @property
    def inward_displacement(self) -> float:
        """Mean displacement of the end into the layer as the layer opens, divided by the opening w_N.

        An infinite layer has the stress lmbda w_N/eps along S, which a free end cannot bear. The end therefore lowers
        the energy by c_N M w_N^2/2, half the work of this stress on the displacement of the end.
        """
        lmbda = lame_over_mu(self.nu)
        return self.c_N * (lmbda + 2) / lmbda if lmbda else 0.0

    @property
    def opening_strip(self) -> float:
        """Length of the strip along the end in which the layer is less stiff against openings.

        A loss of stiffness that is uniform in the strip reduces the layer's force, and its first moment about the end,
        by as much as the end does. The strip is at most `MAX_OPENING_STRIP` long; if this bound is active, the first
        moment is reduced by less.
        """
        return min(2 * self.m_N / self.c_N, MAX_OPENING_STRIP) if self.c_N else MAX_OPENING_STRIP

    @property
    def shear_strip(self) -> float:
        """Length of the strip along the end in which the layer is less stiff against shear, as in `opening_strip`."""
        return 2 * self.m_T / self.c_T

    @property
    def strips(self) -> list[tuple[float, float]]:
        """Pairs (c, length) for the strips along the end in which the law for openings, shear and flow is changed.

        c/length is the relative loss of stiffness in a strip, or the relative gain of resistance to the flow along S.
        c = 0: no change.
        """
        return [(self.c_N, self.opening_strip), (self.c_T, self.shear_strip), (1 / self.kappa - 1, 1.0)]

    @property
    def reach(self) -> float:
        """Length of the longest strip in which the law is changed."""
        return max(length for c, length in self.strips if c)

    def for_spreading_length(self, length: float) -> FreeEnd:
        """Return the constants for a layer in which a pressure evens out over at most `length` thicknesses along S.

        For nu > 0.49 the flow at an end has less resistance than in an infinite layer (kappa > 1). This only holds if
        the pressure grows linearly over many thicknesses, which a narrow S or soft bodies can prevent. The change
        1/kappa - 1 of the resistance is therefore left out up to the first of `SPREAD_LENGTHS`, and whole from the
        second; between them it grows linearly, so that no result jumps. Whole in all layers it would make errors beside
        soft bodies up to 1.4 times as large.
        """
        shortest, longest = SPREAD_LENGTHS
        share = min(max((length - shortest) / (longest - shortest), 0.0), 1.0)
        return self if self.kappa <= 1 else self._replace(kappa=1 / (1 + share * (1 / self.kappa - 1)))


def lame_over_mu(nu: float) -> float:
    """Return the first Lame modulus divided by mu, 2 nu/(1 - 2 nu); math.inf for nu = 0.5.

    Raises:
        InputError: nu is not in [0, 0.5].
    """
    require(0 <= nu <= 0.5, "free end of a layer: Poisson's ratio", nu, "allowed: from 0 to 0.5")
    return 2 * nu / (1 - 2 * nu) if nu < 0.5 else math.inf


def free_end(nu: float) -> FreeEnd:
    """Return the constants of a free end of a layer for Poisson's ratio nu from 0 to 0.5, to nine digits.

    They are interpolated in a table, by polynomials of s = sqrt(1 - 2 nu). Some constants are infinite at s = 0.
    Therefore the functions c_N M mu/(lmbda^2 s), m_N M s^2/lmbda, rho_N s, c_T and m_T are interpolated, which are
    analytic in s. The first of them is sqrt(1/12) at s = 0.

    Raises:
        InputError: nu is not in [0, 0.5].
    """
    lmbda, s = lame_over_mu(nu), math.sqrt(1 - 2 * nu)
    interpolated: Array = np.asarray(chebyshev.chebval(2 * s - 1, _chebyshev_coefficients()), float)
    c_N_term, scaled_m_N, scaled_rho_N, c_T, m_T = map(float, interpolated)
    if s == 0:
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, 1 / (1 - math.sqrt(3) * c_N_term))
    scaled_c_N = math.sqrt(1 / 12 + s * c_N_term)
    delta, excess = math.sqrt(lmbda / 12), (1 - s**2) * ((1 - s**2) * c_N_term - s / 12) / s
    c_N, m_N = scaled_c_N * s * lmbda**2 / (lmbda + 2), scaled_m_N / s**2 * lmbda / (lmbda + 2)
    kappa = flow_factor(delta, excess / (scaled_c_N * s * lmbda + delta)) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N=scaled_rho_N / s, c_T=c_T, m_T=m_T, kappa=kappa)


@cache
def _chebyshev_coefficients() -> Array:
    """Return Chebyshev coefficients (n, 5), from n rows of `TABLE_FILE`, for the functions that `free_end` interpolates.

    In terms of s = sqrt(1 - 2 nu) the rows are Chebyshev points between 0 and 1. The columns of the result belong to the
    five functions in `free_end`; in place of the first, y, the column has (y^2 - 1/12)/s. The variable of the
    polynomials is 2 s - 1.
    """
    table = dict(zip(TABLE_COLUMNS, np.loadtxt(TABLE_FILE, delimiter=",", skiprows=1).T, strict=True))
    nu = table["nu"]
    lmbda, s = 2 * nu / (1 - 2 * nu), np.sqrt(1 - 2 * nu)
    M = lmbda + 2
    c_N_term = ((table["c_N"] * M / (lmbda**2 * s)) ** 2 - 1 / 12) / s
    function_values = [c_N_term, table["m_N"] * M * s**2 / lmbda, table["rho_N"] * s, table["c_T"], table["m_T"]]
    return np.asarray(chebyshev.chebfit(2 * s - 1, np.stack(function_values, axis=1), len(nu) - 1))


def flow_factor(delta: float, excess_loss: float) -> float:
    """Return the factor f on the pressure-driven flow near a free end that gives a prescribed loss of pressure.

    x is the distance from the end, and all lengths are divided by the thickness. p(x) is the pressure divided by that
    far from the end. The factor is f for 0 < x < 1, and 1 beyond. p solves delta^2 (f p')' = p - 1 with p(0) = 0. The
    loss, the integral of 1 - p over x > 0, is r delta (1 + r t)/(t + r) with r = sqrt(f) and t = tanh(1/(r delta)).

    Args:
        delta: length over which the pressure evens out; the loss for f = 1.
        excess_loss: prescribed loss minus delta.
    """

    def residual(r: float) -> float:
        t = math.tanh(1 / (r * delta))
        return delta * t * (r**2 - 1) / (t + r) - excess_loss

    from scipy.optimize import brentq  # takes a while to import

    return float(brentq(residual, 1e-9, 3.0, xtol=1e-15, rtol=1e-14)) ** 2
