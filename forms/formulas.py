"""Closed-form solutions in numpy: Mohr-Coulomb layers in shear, rubber bearings, plasticity, the bar of section 6.2.

Models never use these formulas; studies and tests compare with them. Equations and sections are those of the paper.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ive

from forms.base import Array, InputError

BOUND_TOLERANCE = 1e-12  # relative tolerance for parameters that equal a bound exactly


# ---------------------------------------------------------------- friction; moduli per thickness, w is the jump [u]
def mohr_coulomb_fixed_opening(
    lmbda: float, mu: float, cohesion: float, friction_angle: float, w_N: float, w_T: Array
) -> Array:
    """Tractions (..., 2), t_T and t_N, of a Mohr-Coulomb layer as its slip w_T grows at a fixed opening w_N.

    The law is `MohrCoulomb` with psi = 0 in plane strain, and the result is exact in time. Let p = (lmbda + mu) w_N be
    the mean in-plane stress, and s the in-plane deviator. The response is elastic until |s| = R = C cos(Omega) - p
    sin(Omega). Let s_y be the shear stress at first yield, at w_y. After it, with a = mu (w_T - w_y)/R + artanh(s_y/R),
    t_T = R tanh(a) and t_N = p +- R sech(a). The sign equals the sign of s_N = mu w_N. The normal part of the deviator
    fades, and t_T tends to R, not to the C - t_N tan(Omega) of Eqs. (34)-(37) of the paper.

    Args:
        lmbda, mu: Lame moduli over the thickness, stress per length.
        cohesion: C in the formulas, stress.
        friction_angle: Omega in the formulas, degrees.
        w_N: fixed normal jump, a length; the shear starts after elastic compression.
        w_T: tangential jumps (...), lengths since the start, of one sign and monotone.

    Raises:
        InputError: the start is beyond the yield surface.
    """
    angle, p, s_N, x = np.radians(friction_angle), (lmbda + mu) * w_N, mu * w_N, np.asarray(w_T, float)
    R = cohesion * np.cos(angle) - p * np.sin(angle)
    if not (R > 0 and abs(s_N) <= R * (1 + 1e-12)):
        raise InputError(f"|s| = {abs(s_N):g} at the start exceeds R = {R:g}")
    sign = -1.0 if np.any(x < 0) else 1.0
    yield_shear = sign * np.sqrt(max(R**2 - s_N**2, 0.0))
    past_yield = (mu * x - yield_shear) / R  # shear after first yield
    with np.errstate(divide="ignore"):
        angle_y = past_yield + np.arctanh(yield_shear / R)
    yields = sign * past_yield > 0
    t_T = np.where(yields, R * np.tanh(angle_y), mu * x)
    return np.stack([t_T, p + np.where(yields, np.sign(s_N) * R / np.cosh(np.minimum(np.abs(angle_y), 300)), s_N)], -1)


def first_yield_ratio(nu: float, friction_angle: float) -> float:
    """Ratio t_T/|t_N| at which a Mohr-Coulomb layer without cohesion yields in shear, after elastic compression.

    It is sqrt(sin^2(Omega) - (1 - 2 nu)^2)/(2 (1 - nu)). It is 0 for nu <= (1 - sin(Omega))/2, where compression alone
    makes the layer yield.

    Args:
        nu: Poisson's ratio of the layer.
        friction_angle: Omega in the formula, degrees.
    """
    return float(np.sqrt(max(np.sin(np.radians(friction_angle)) ** 2 - (1 - 2 * nu) ** 2, 0.0)) / (2 * (1 - nu)))


def apparent_friction(friction_angle: float, dilatancy_angle: float) -> float:
    """Ratio t_T/|t_N| to which a Mohr-Coulomb layer without cohesion tends under lasting shear.

    It is Davis' friction coefficient sin(Omega) cos(psi)/(1 - sin(Omega) sin(psi)). It equals sin(Omega) for psi = 0.
    Only for psi = Omega it equals the tan(Omega) of Eq. (37) of the paper.

    Args:
        friction_angle: Omega in the formula, degrees.
        dilatancy_angle: psi in the formula, degrees.
    """
    friction_angle, dilatancy_angle = np.radians(friction_angle), np.radians(dilatancy_angle)
    sin_friction, sin_dilatancy = np.sin(friction_angle), np.sin(dilatancy_angle)
    return float(sin_friction * np.cos(dilatancy_angle) / (1 - sin_friction * sin_dilatancy))


# ---------------------------------------------------------------- rubber bearings; moduli are not per thickness
# Two plates that do not stretch move apart by w_N. The pressure p of the layer is zero on the free ends and solves
#     (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = w_N.
# With delta = eps sqrt(lmbda/(12 mu)), p = (1 - v) lmbda w_N/eps, where delta^2 lap_S v = v, and v = 1 on free ends.
# For infinite lmbda this is Stefan's squeeze film, with the leading term of Gent and Lindley (Proc. Inst. Mech. Eng.
# 173, 1959): eps times the stiffness is 4 mu s^2 for a strip and 6 mu s^2 for a disc; s is loaded over free area.
def rubber_strip(lmbda: float, mu: float, eps: float, a: float) -> float:
    """Mean normal traction per opening of a rubber strip between rigid plates in plane strain, stress per length.

    It is [lmbda (1 - tanh(x)/x) + 2 mu]/eps with x = a/delta and delta = eps sqrt(lmbda/(12 mu)). For an infinite lmbda
    it is 4 mu a^2/eps^3 + 2 mu/eps.

    Args:
        lmbda: first Lame modulus of the layer, stress; > 0 or math.inf.
        mu: shear modulus of the layer, stress; > 0.
        eps: thickness of the layer, length; > 0.
        a: half the width of the strip, length; > 0.

    Raises:
        InputError: an argument out of range.
    """
    return (retained_pressure_share(lmbda, mu, a / eps, 0.5) + 2 * mu) / eps


def rubber_disc(lmbda: float, mu: float, eps: float, radius: float) -> float:
    """Mean normal traction per opening of a rubber disc between rigid plates, stress per length.

    It is [lmbda (1 - 2 I_1(x)/(x I_0(x))) + 2 mu]/eps with x = radius/delta and delta = eps sqrt(lmbda/(12 mu)). I_0
    and I_1 are modified Bessel functions. For an infinite lmbda it is 3 mu radius^2/(2 eps^3) + 2 mu/eps.

    Args:
        lmbda: first Lame modulus of the layer, stress; > 0 or math.inf.
        mu: shear modulus of the layer, stress; > 0.
        eps: thickness of the layer, length; > 0.
        radius: radius of the disc, length; > 0.

    Raises:
        InputError: an argument out of range.
    """
    return (retained_pressure_share(lmbda, mu, radius / eps, 1.0) + 2 * mu) / eps


def retained_pressure_share(lmbda: float, mu: float, slenderness: float, k: float) -> float:
    """Modulus, stress, with which the pressure of a rubber layer resists an opening in spite of the flow to free ends.

    It is lmbda times the fraction 1 - 2 k I_k(x)/(x I_(k-1)(x)), with modified Bessel functions I and x =
    slenderness/sqrt(lmbda/(12 mu)). The fraction is computed as I_(k+1)(x)/I_(k-1)(x), which loses no digits for any x.

    Args:
        lmbda: first Lame modulus, stress; > 0 or math.inf.
        mu: shear modulus, stress; > 0.
        slenderness: half the width, or the radius, over the thickness; > 0.
        k: index of the functions: 1/2 for an opened strip, 3/2 for a tilted strip, 1 for a disc.

    Raises:
        InputError: an argument out of range.
    """
    if not (lmbda > 0 and 0 < mu < math.inf and 0 < slenderness < math.inf):
        raise InputError(f"lmbda = {lmbda}, mu = {mu}, width over eps {slenderness}; allowed: > 0, lmbda <= math.inf")
    if lmbda == math.inf:
        return 3 * mu * slenderness**2 / (k * (k + 1))
    x = slenderness / math.sqrt(lmbda / (12 * mu))
    return float(lmbda * ive(k + 1, x) / ive(k - 1, x))


# ---------------------------------------------------------------- von Mises' plasticity
def prandtl_pressure(k: float) -> float:
    """Mean pressure (2 + pi) k under which a strip footing sinks into a half space with the yield stress in shear k."""
    return (2 + math.pi) * k


class PlasticCylinder(NamedTuple):
    """A thick-walled cylinder in plane strain under internal pressure, incompressible and ideally plastic.

    Von Mises' and Tresca's conditions are the same here, with the yield stress in shear k, because s_zz is the mean of
    s_rr and s_tt. The plastic zone is a <= r <= c with the radius r. At first yield c = a, at the limit load c = b.

    Attributes:
        a, b: inner and outer radius, 0 < a < b, lengths.
        mu: shear modulus, stress.
        k: yield stress in shear, > 0; the yield stress in tension over sqrt(3) for von Mises.
    """

    a: float
    b: float
    mu: float
    k: float

    def pressure(self, c: float) -> float:
        """Pressure at which the plastic zone reaches the radius c: k (2 ln(c/a) + 1 - c^2/b^2)."""
        return self.k * (2 * math.log(c / self.a) + 1 - (c / self.b) ** 2)

    def zone(self, pressure: float) -> float:
        """Outer radius c of the plastic zone under an internal pressure; the inner radius a if there is no zone.

        Raises:
            InputError: the pressure is above the limit load.
        """
        if pressure <= self.pressure(self.a):
            return self.a
        if pressure > self.pressure(self.b):
            raise InputError(f"the pressure is {pressure:g}; the cylinder bears {self.pressure(self.b):g}")
        from scipy.optimize import brentq  # takes a while to import

        return float(brentq(lambda c: self.pressure(c) - pressure, self.a, self.b, xtol=1e-14 * self.b))

    def displacement(self, pressure: float, r: Array) -> Array:
        """Radial displacements (...) at radii r (...) under an internal pressure p.

        They are k c^2/(2 mu r) with a plastic zone up to c, and p a^2/(2 mu r (1 - a^2/b^2)) without one.
        """
        return np.asarray(self._size(pressure) / (2 * self.mu * np.asarray(r, float)))

    def radial_stress(self, pressure: float, r: Array) -> Array:
        """Radial stresses (...) at radii r (...) under an internal pressure p.

        They are -p + 2 k ln(r/a) in the plastic zone, and -k c^2 (1/r^2 - 1/b^2) outside it, if it reaches the radius
        c.
        """
        r = np.asarray(r, float)
        plastic = -pressure + 2 * self.k * np.log(r / self.a)
        return np.where(r < self.zone(pressure), plastic, -self._size(pressure) * (1 / r**2 - 1 / self.b**2))

    def _size(self, pressure: float) -> float:
        """Coefficient A, force per depth, of the elastic stress s_rr = -A (1/r^2 - 1/b^2) at an internal pressure."""
        c = self.zone(pressure)
        return self.k * c**2 if c > self.a else pressure * self.a**2 / (1 - (self.a / self.b) ** 2)


# ---------------------------------------------------------------- the bar of section 6.2 of the paper, of Eq. (44)
def fraction(x: Array, cost: float, g: float) -> Array:
    """Signed fraction of a material in phase 1 or -1 that minimises its energy; negative: phase -1.

    Args:
        x: driving force of phase 1, energy per volume, any shape.
        cost: energy per volume of a phase 1 or -1 without strain.
        g: energy gain per volume of mixing; 0: phases do not mix.
    """
    excess = np.abs(x) - cost
    return np.asarray(np.sign(x) * (np.clip(0.5 + excess / g, 0, 1) if g else excess > 0))


def phase_energy(x: Array, cost: float, g: float, phase: Array | float) -> Array:
    """Energy per volume that phases 1 or -1 add to the elastic energy; arguments may have any shape.

    Args:
        x: driving force of phase 1, energy per volume.
        cost: energy per volume of a phase 1 or -1 without strain.
        g: energy gain per volume of mixing.
        phase: fraction in phase 1, or minus the fraction in phase -1.
    """
    share = np.abs(phase)
    return np.asarray(cost * share - x * phase - share * (1 - share) * g / 2)


class BarResponse(NamedTuple):
    """Response of a bar whose layer has prescribed phases; all arrays have one shape.

    Attributes:
        phase: fraction of the layer in phase 1, or minus the fraction in phase -1.
        sigma: stress.
        U: elongation of the layer, a length.
        energy: energy of the whole bar, per area of its section.
        local: whether all strains are admissible for their phases, so that the response is a local minimiser.
    """

    phase: Array
    sigma: Array
    U: Array
    energy: Array
    local: npt.NDArray[np.bool_]

    def least(self) -> BarResponse:
        """Response of least energy along the last axis; of several with the same energy the first.

        In `Bar.layouts` this is the one with the smallest transformed part.
        """
        indices = np.argmin(self.energy, axis=-1)[..., None]
        return BarResponse._make(np.take_along_axis(array, indices, -1)[..., 0] for array in self)


@dataclass(frozen=True)
class Bar:
    """The bar of section 6.2 of the paper: a layer of three phases -1, 0 and 1 in series with an elastic body.

    The layer ]0, eps l[ has the rigidity k = eps kbar, the body ]eps l, l[ the rigidity K. The displacements of the
    ends are u(0) = 0 and u(l) = delta. The layer corresponds to `NonMonotone` with lmbda = 0, chi = n (x) n and the
    thickness eps l. Divided by its thickness the moduli are 2 mu = kbar/l; the transformation energy times the
    thickness is l cbar. All thresholds are linear in eps.

    eps = 0 is the limit, Eq. (48), with these corrections. Phase 0 has sigma = (kbar/l) U in place of kbar [u]; phase 1
    likewise, minus alpha. Between the two branches the law is sigma = sigma_m; the paper prints the body's balance
    there, with l/K in place of K/l. Finally delta_1 - delta_0 = l alpha/kbar.

    Attributes:
        l: length, layer included.
        K: rigidity of the body, stress.
        kbar: rigidity of the layer over eps, stress.
        alpha: transformation stress.
        cbar: c eps with the transformation energy c of Eq. (44), stress; cbar >= alpha^2/(2 kbar), below which phases 1
            and -1 would mix.
        eps: length of the layer over the length of the bar, 0 <= eps < 1.

    Raises:
        InputError: a parameter out of range.
    """

    l: float  # noqa: E741
    K: float
    kbar: float
    alpha: float
    cbar: float
    eps: float

    def __post_init__(self) -> None:
        bound = self.alpha**2 / (2 * self.kbar) * (1 - BOUND_TOLERANCE)
        if not (all(0 < value < math.inf for value in astuple(self)[:5]) and self.cbar >= bound and 0 <= self.eps < 1):
            raise InputError(f"{self}; allowed: all > 0, cbar >= alpha^2/(2 kbar) = {bound:g}, 0 <= eps < 1")

    @property
    def sigma_m(self) -> float:
        """Stress at which phases 0 and 1 are in equilibrium, k c/alpha - alpha/2 = kbar cbar/alpha - alpha/2."""
        return self.sigma_up - self.alpha / 2

    @property
    def sigma_up(self) -> float:
        """Largest stress of phase 0, kbar cbar/alpha; the smallest stress of phase 1 is sigma_up - alpha."""
        return self.kbar * self.cbar / self.alpha

    @property
    def R(self) -> float:
        """Compliance of the bar over its length, (1 - eps)/K + 1/kbar, 1/stress."""
        return (1 - self.eps) / self.K + 1 / self.kbar

    @property
    def free_elongation(self) -> float:
        """Elongation of the layer in phase 1 without stress, l alpha/kbar."""
        return self.l * self.alpha / self.kbar

    @property
    def delta_0(self) -> float:
        """Elongation of the bar at which phase 1 begins in the global minimiser, sigma_m l R."""
        return self.sigma_m * self.l * self.R

    @property
    def delta_1(self) -> float:
        """Elongation of the bar at which phase 0 ends in the global minimiser, delta_0 + l alpha/kbar.

        Equation (47) of the paper prints l alpha alpha/k for the second term, which is eps l alpha/k.
        """
        return self.delta_0 + self.free_elongation

    @property
    def up(self) -> float:
        """Elongation of the bar at which a layer all in phase 0 snaps to phase 1, l R kbar cbar/alpha.

        The paper has no snaps.
        """
        return self.l * self.R * self.sigma_up

    @property
    def down(self) -> float:
        """Elongation of the bar at which a layer all in phase 1 snaps back to phase 0, up - l alpha (1 - eps)/K."""
        return self.up - self.l * self.alpha * (1 - self.eps) / self.K

    @property
    def loop_area(self) -> float:
        """Energy per area of the section that is lost in a cycle over both snaps of a layer whose phases do not mix.

        It is alpha/(kbar R) times l alpha (1 - eps)/K.
        """
        return self.free_elongation * self.alpha * (1 - self.eps) / (self.K * self.R)

    # ------------------------------------------------------------ the global minimiser; delta has any shape
    def phase(self, delta: Array | float) -> Array:
        """Signed fraction of the layer in phase 1 or -1, in the global minimiser at elongations delta of the bar.

        Equation (46) of the paper: (|delta| - delta_0)/(delta_1 - delta_0), cut off at 0 and 1, with the sign of delta.
        The arrays of this and of the next methods have the shape of delta.
        """
        delta = np.asarray(delta, float)
        return np.asarray(np.sign(delta) * np.clip((np.abs(delta) - self.delta_0) / self.free_elongation, 0, 1))

    def sigma(self, delta: Array | float) -> Array:
        """Stress of the global minimiser at elongations delta of the bar.

        For delta > 0 it is delta/(l R) before phase 1 grows, sigma_m while it grows, and (delta - l alpha/kbar)/(l R)
        after that. Equation (47) of the paper prints (k/(eps l)) K/K_eps, without delta, in the first case and likewise
        in the third.
        """
        return self.branch(delta, self.phase(delta)).sigma

    def U(self, delta: Array | float) -> Array:
        """Elongation of the layer in the global minimiser at elongations delta of the bar.

        For delta > 0 it is l sigma/kbar before phase 1 grows. It is delta - sigma_m l (1 - eps)/K while phase 1 grows,
        and l (sigma + alpha)/kbar after that. The first and third cases before Eq. (47) of the paper print K
        delta/(K_eps (1
        - eps)), which exceeds delta.
        """
        return self.branch(delta, self.phase(delta)).U

    def energy(self, delta: Array | float) -> Array:
        """Least energy of the bar per area of its section at elongations delta, right side of Eq. (45) of the paper."""
        return self.branch(delta, self.phase(delta)).energy

    def boundary(self, delta: Array | float) -> Array:
        """Length of the part of the layer in phase 0, in the global minimiser at elongations delta of the bar.

        While phases mix it is eps l - eps (kbar/alpha)(|delta| - delta_0). Equation (47) of the paper prints sigma k
        l/(alpha K) without the factor 1 - eps, with a minus, and inside the brackets.
        """
        return self.eps * self.l * (1 - np.abs(self.phase(delta)))

    # ------------------------------------------------------------ local minimisers
    def branch(self, delta: Array | float, phase: Array | float) -> BarResponse:
        """Response of the bar if the layer has prescribed phases, whether or not its strains are admissible for them.

        Args:
            delta: elongations of the bar.
            phase: fraction of the layer in phase 1, or minus the fraction in phase -1.
        """
        delta, phase = np.broadcast_arrays(np.asarray(delta, float), np.asarray(phase, float))
        share = np.abs(phase)
        sigma = np.asarray((delta - phase * self.free_elongation) / (self.l * self.R), float)
        U = np.asarray(self.l * (sigma + self.alpha * phase) / self.kbar, float)
        energy = self.l * self.R * sigma**2 / 2 + share * self.sigma_m * self.free_elongation
        old_stable = (share == 1) | (np.abs(sigma) <= self.sigma_up)
        new_stable = (share == 0) | (np.sign(phase) * sigma >= self.sigma_up - self.alpha)
        return BarResponse(phase, sigma, U, energy, old_stable & new_stable)

    def layouts(self, delta: Array | float, n: int) -> BarResponse:
        """Responses of a bar whose layer has n equal elements, with m = 0, ..., n of them in phase 1 (delta < 0: -1).

        Each array has the axes of delta, then one axis for m. Which elements are in phase 1 does not matter. No layout
        with both 1 and -1, or with -1 in place of 1, has less energy. `BarResponse.least` is the global minimiser of n
        elements; its energy tends to `energy` from above like n^-2.
        """
        delta = np.asarray(delta, float)[..., None]
        return self.branch(delta, np.where(delta < 0, -1, 1) * (np.arange(n + 1) / n))

    # ------------------------------------------------------------ a uniform layer that softens
    def layer(self, U: Array | float, mixing: float = 1.0) -> tuple[Array, Array, Array]:
        """Stress, energy per area of the section, and signed phase fraction of a layer alone at elongations U.

        The last is the fraction of the layer in phase 1, or minus the fraction in phase -1.

        Args:
            U: elongations of the layer, of any shape.
            mixing: fraction of the energy gain of mixing. 1: the convex envelope of Eq. (45) of the paper and its
                derivative; 0: W_min of Eq. (44), of pure phases.
        """
        x, g = self.alpha * np.asarray(U, float), mixing * self.alpha * self.free_elongation
        C, stiffness = self.l * self.cbar, self.kbar / self.l
        phase = fraction(x, C, g)
        elastic = stiffness * np.square(U)
        return stiffness * np.asarray(U) - self.alpha * phase, elastic / 2 + phase_energy(x, C, g, phase), phase

    def path(self, mixing: float, end: float | None = None) -> Array:
        """Vertices (delta, sigma), (4, 2), of the piecewise linear equilibrium path of a bar with a uniform layer.

        The phases start to mix at the second vertex, and all of the layer is in phase 1 at the third. Between them the
        elongation delta decreases if mixing < (1 - eps)/(K R), and grows otherwise.

        Args:
            mixing: fraction of the energy gain of mixing, from 0 to 1.
            end: elongation of the bar at the last vertex, beyond the others; None: twice the largest of these.
        """
        half_drop = mixing * self.alpha / 2
        sigma = np.array([0, self.sigma_up - half_drop, self.sigma_up - self.alpha + half_drop])
        delta = self.l * self.R * sigma + np.array([0, 0, self.free_elongation])
        end_delta = 2 * delta.max() if end is None else end
        return np.column_stack([[*delta, end_delta], [*sigma, (end_delta - self.free_elongation) / (self.l * self.R)]])
