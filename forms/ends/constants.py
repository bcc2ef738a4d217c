"""Constants of a free end of a layer as functions of Poisson's ratio."""

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


class FreeEnd(NamedTuple):
    """Constants of a free end, at a right angle to the faces, of an isotropic layer between much stiffer bodies.

    The constants hold in plane strain, and in plane stress with nu/(1 + nu) of the material for nu. Lengths are over
    the thickness, stresses over mu, and M = lmbda + 2 mu. w_N is the opening of the layer, w_T its slip. At nu = 0.5
    c_N, m_N and rho_N are infinite. Source: `studies/half_strip.py`.

    Attributes:
        nu: Poisson's ratio of the layer.
        c_N: with one such end, a layer of length L under an opening w_N carries the force M w_N (L - c_N).
        m_N: first moment, about the end, of the normal tractions that are missing near it, over M w_N.
        rho_N: mean distance from the end of the tractions along S that balance lmbda w_N.
        c_T: with one such end, a layer of length L under a slip w_T carries the force mu w_T (L - c_T). It is also the
            mean distance from the end of the tractions across S that balance the moment of mu w_T. The mean
            displacement of the end across S is c_T w_T, away from the face that moves outwards.
        m_T: first moment, about the end, of the shear tractions that are missing near it, over mu w_T.
        kappa: factor on the pressure-driven flow along S within one thickness of the end, in laws with a pressure on S
            (`forms.rubber`). With this factor the pressure alone gives c_N.
    """

    nu: float
    c_N: float
    m_N: float
    rho_N: float
    c_T: float
    m_T: float
    kappa: float

    @property
    def drawn_in(self) -> float:
        """Mean inward displacement of the end as the layer opens, over w_N.

        The end does not bear the stress lmbda w_N/eps along S that an infinite layer has. The end lowers the energy by
        c_N M w_N^2/2, which is half the work of this stress on the end's displacement.
        """
        lmbda = lame_over_mu(self.nu)
        return self.c_N * (lmbda + 2) / lmbda if lmbda else 0.0


def lame_over_mu(nu: float) -> float:
    """The first Lame modulus over mu, 2 nu/(1 - 2 nu); math.inf for nu = 0.5.

    Raises:
        InputError: nu is not in [0, 0.5].
    """
    require(0 <= nu <= 0.5, "free end of a layer: Poisson's ratio", nu, "allowed: from 0 to 0.5")
    return 2 * nu / (1 - 2 * nu) if nu < 0.5 else math.inf


def free_end(nu: float) -> FreeEnd:
    """Constants of a free end of a layer for Poisson's ratio nu from 0 to 0.5, to nine digits, from a table.

    The table is interpolated by polynomials of s = sqrt(1 - 2 nu), from 0 to 1. The numbers c_N M mu/(lmbda^2 s), m_N M
    s^2/lmbda, rho_N s, c_T and m_T are analytic in s; the first is sqrt(1/12) at s = 0.

    Raises:
        InputError: nu out of range.
    """
    lmbda, s = lame_over_mu(nu), math.sqrt(1 - 2 * nu)
    fitted: Array = np.asarray(chebyshev.chebval(2 * s - 1, _coefficients()), float)
    growth, moment, mean, c_T, m_T = map(float, fitted)
    if s == 0:
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, 1 / (1 - math.sqrt(3) * growth))
    root = math.sqrt(1 / 12 + s * growth)
    delta, excess = math.sqrt(lmbda / 12), (1 - s**2) * ((1 - s**2) * growth - s / 12) / s
    c_N, m_N = root * s * lmbda**2 / (lmbda + 2), moment / s**2 * lmbda / (lmbda + 2)
    kappa = flow_factor(delta, excess / (root * s * lmbda + delta)) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N=mean / s, c_T=c_T, m_T=m_T, kappa=kappa)


def chebyshev_ratios(n: int) -> Array:
    """Poisson's ratios (n,) for a table of n rows, from the largest to the smallest.

    They are Chebyshev points in s = sqrt(1 - 2 nu).
    """
    s = (1 - np.cos(np.pi * (np.arange(n) + 0.5) / n)) / 2
    return np.asarray((1 - s**2) / 2)


@cache
def shipped_table() -> dict[str, Array]:
    """Table of the constants in this package: name of a column -> values, in the order of `chebyshev_ratios`."""
    return dict(zip(TABLE_COLUMNS, np.loadtxt(TABLE_FILE, delimiter=",", skiprows=1).T, strict=True))


@cache
def _coefficients() -> Array:
    """Chebyshev coefficients (n, 5) of the five analytic numbers in `free_end`, from the table's n rows.

    The variable of the polynomials is 2 s - 1 with s = sqrt(1 - 2 nu).
    """
    table = shipped_table()
    nu = table["nu"]
    lmbda, s = 2 * nu / (1 - 2 * nu), np.sqrt(1 - 2 * nu)
    M = lmbda + 2
    growth = ((table["c_N"] * M / (lmbda**2 * s)) ** 2 - 1 / 12) / s
    values = [growth, table["m_N"] * M * s**2 / lmbda, table["rho_N"] * s, table["c_T"], table["m_T"]]
    return np.asarray(chebyshev.chebfit(2 * s - 1, np.stack(values, axis=1), len(nu) - 1))


def flow_factor(delta: float, excess: float) -> float:
    """Factor f on the flow within 0 < x < 1 with which the integral of 1 - p over x > 0 is delta + excess.

    The pressure p over the pressure far from the end solves delta^2 (f p')' = p - 1 with p(0) = 0; f = 1 for x > 1. x
    is the distance from the end over the thickness. With r = sqrt(f) and t = tanh(1/(r delta)) the integral is r delta
    (1 + r t)/(t + r).

    Args:
        delta: length over which the pressure evens out, over the thickness; the integral for f = 1.
        excess: difference of the integral from delta.
    """

    def residual(r: float) -> float:
        t = math.tanh(1 / (r * delta))
        return delta * t * (r**2 - 1) / (t + r) - excess

    from scipy.optimize import brentq  # takes a while to import

    return float(brentq(residual, 1e-9, 3.0, xtol=1e-15, rtol=1e-14)) ** 2
