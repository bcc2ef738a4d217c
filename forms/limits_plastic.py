"""Closed forms of von Mises' plasticity: a layer under shear, a strip footing, a cylinder under pressure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from forms.declarations import LawError

Array = npt.NDArray[np.float64]


def von_mises_shear(mu: float, strength: float, hardening: float, w: Array) -> Array:
    """Traction of a layer under a shear w that only grows, at w_N = 0; mu and H + K per thickness.

    sqrt(3) t_T = Y + (H + K) p with the accumulated plastic strain p = (w - t_T/mu)/sqrt(3).
    """
    w = np.asarray(w, float)
    first = strength / (math.sqrt(3) * mu)
    slope = mu * hardening / (3 * mu + hardening)
    return np.where(w <= first, mu * w, mu * first + slope * (w - first))


def prandtl_pressure(k: float) -> float:
    """Mean pressure (2 + pi) k under which a strip footing sinks into a half space with the yield stress in shear k."""
    return (2 + math.pi) * k


@dataclass(frozen=True)
class PlasticCylinder:
    """A thick-walled cylinder in plane strain under pressure from inside, of an incompressible, ideally plastic material.

    Von Mises' and Tresca's conditions are the same here, with the yield stress in shear k: s_zz is the mean of the others.
    The plastic zone is a <= r <= c; for c = a it begins, for c = b the cylinder can bear no more.

    Attributes:
        a, b: inner and outer radius, 0 < a < b, lengths.
        mu: shear modulus, stress.
        k: yield stress in shear, > 0; Y/sqrt(3) for von Mises.
    """

    a: float
    b: float
    mu: float
    k: float

    def pressure(self, c: float) -> float:
        """Pressure with a plastic zone up to c: k (2 ln(c/a) + 1 - c^2/b^2)."""
        return self.k * (2 * math.log(c / self.a) + 1 - (c / self.b) ** 2)

    def zone(self, pressure: float) -> float:
        """Outer radius c of the plastic zone; a if there is none. LawError: no equilibrium, the pressure is too high."""
        if pressure <= self.pressure(self.a):
            return self.a
        if pressure > self.pressure(self.b):
            raise LawError(f"the pressure is {pressure:g}; the cylinder bears {self.pressure(self.b):g}")
        from scipy.optimize import brentq  # takes a while to import

        return float(brentq(lambda c: self.pressure(c) - pressure, self.a, self.b, xtol=1e-14 * self.b))

    def displacement(self, pressure: float, r: Array) -> Array:
        """Radial displacement k c^2/(2 mu r), elastic p a^2/(2 mu r (1 - a^2/b^2)), at radii r."""
        c = self.zone(pressure)
        elastic = pressure * self.a**2 / (1 - (self.a / self.b) ** 2)
        size = self.k * c**2 if c > self.a else elastic
        return np.asarray(size / (2 * self.mu * np.asarray(r, float)))

    def radial_stress(self, pressure: float, r: Array) -> Array:
        """-p + 2 k ln(r/a) in the plastic zone, -k c^2 (1/r^2 - 1/b^2) outside, at radii r."""
        c, r = self.zone(pressure), np.asarray(r, float)
        size = self.k * c**2 if c > self.a else pressure * self.a**2 / (1 - (self.a / self.b) ** 2)
        plastic = -pressure + 2 * self.k * np.log(r / self.a)
        return np.where(r < c, plastic, -size * (1 / r**2 - 1 / self.b**2))
