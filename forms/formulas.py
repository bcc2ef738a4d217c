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
    """Return the tractions t_T and t_N of a Mohr-Coulomb layer that is sheared at a fixed normal jump.

    The law is `MohrCoulomb` with the dilatancy angle 0, in plane strain; time is not discretised. p = (lmbda + mu) w_N
    is the mean in-plane stress, and R = C cos(Omega) - p sin(Omega) bounds the norm of the in-plane deviator. The layer
    first yields at the tangential jump w_y, where t_T is s_y = mu w_y. After that

        t_T = R tanh(a),   t_N = p +- R sech(a),   a = mu (w_T - w_y)/R + artanh(s_y/R),

    with the sign of w_N in place of +-. The normal part of the deviator vanishes as w_T grows, and t_T tends to R. It
    does not tend to the C - t_N tan(Omega) of Eqs. (34)-(37) of the paper.

    Args:
        lmbda, mu: Lame moduli of the layer divided by its thickness, stress per length.
        cohesion: C in the formulas, stress.
        friction_angle: Omega in the formulas, degrees.
        w_N: normal jump, a length; it is applied elastically before the shear, then fixed.
        w_T: tangential jumps of any shape, lengths, all of one sign. The jump has grown from zero to each of them
            without reversal.

    Returns:
        Tractions t_T and t_N, stress, with the shape of `w_T` and 2 components on a last axis.

    Raises:
        InputError: the layer would yield before it is sheared.
    """
    angle, p, s_N, x = np.radians(friction_angle), (lmbda + mu) * w_N, mu * w_N, np.asarray(w_T, float)
    R = cohesion * np.cos(angle) - p * np.sin(angle)
    if not (R > 0 and abs(s_N) <= R * (1 + 1e-12)):
        raise InputError(f"|s| = {abs(s_N):g} at the start exceeds R = {R:g}")
    sign = -1.0 if np.any(x < 0) else 1.0
    yield_shear = sign * np.sqrt(max(R**2 - s_N**2, 0.0))
    past_yield = (mu * x - yield_shear) / R  # shear after first yield
    with np.errstate(divide="ignore"):
        tanh_arg = past_yield + np.arctanh(yield_shear / R)
    yields = sign * past_yield > 0
    t_T = np.where(yields, R * np.tanh(tanh_arg), mu * x)
    return np.stack([t_T, p + np.where(yields, np.sign(s_N) * R / np.cosh(np.minimum(np.abs(tanh_arg), 300)), s_N)], -1)


def first_yield_ratio(nu: float, friction_angle: float) -> float:
    """Return the ratio t_T/|t_N| of tractions at which a Mohr-Coulomb layer without cohesion first yields in shear.

    The layer is first compressed elastically. The ratio is sqrt(sin^2(Omega) - (1 - 2 nu)^2)/(2 (1 - nu)). It is 0 for
    nu <= (1 - sin(Omega))/2, where compression alone makes the layer yield.

    Args:
        nu: Poisson's ratio of the layer.
        friction_angle: Omega in the formula, degrees.
    """
    return float(np.sqrt(max(np.sin(np.radians(friction_angle)) ** 2 - (1 - 2 * nu) ** 2, 0.0)) / (2 * (1 - nu)))


def apparent_friction(friction_angle: float, dilatancy_angle: float) -> float:
    """Return the ratio t_T/|t_N| of tractions to which a Mohr-Coulomb layer without cohesion tends in lasting shear.

    This is Davis' friction coefficient sin(Omega) cos(psi)/(1 - sin(Omega) sin(psi)). For psi = 0 it is sin(Omega). The
    tan(Omega) of Eq. (37) of the paper is right for psi = Omega only.

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
def disc_stiffness(lmbda: float, mu: float, eps: float, radius: float) -> float:
    """Return the mean normal traction per opening of a rubber disc between rigid plates, stress per length.

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
    return (pressure_modulus(lmbda, mu, radius / eps, 1.0) + 2 * mu) / eps


def pressure_modulus(lmbda: float, mu: float, slenderness: float, k: float) -> float:
    """Return the modulus, a stress, with which the pressure in a rubber layer with free ends resists an opening.

    Flow towards the free ends makes it smaller than lmbda, its value in an infinite layer. It is lmbda (1 - 2 k
    I_k(x)/(x I_(k-1)(x))) with modified Bessel functions I and x = slenderness/sqrt(lmbda/(12 mu)). It is computed as
    lmbda I_(k+1)(x)/I_(k-1)(x), which loses no digits for any x.

    Args:
        lmbda: first Lame modulus, stress; > 0 or math.inf.
        mu: shear modulus, stress; > 0.
        slenderness: half the width of a strip, or the radius of a disc, divided by the thickness; > 0.
        k: index of the Bessel functions: 1/2 for an opened strip, 3/2 for a tilted strip, 1 for an opened disc.

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
    """Return the mean pressure (2 + pi) k under which a strip footing sinks into a half space.

    `k` is the yield stress in shear of the half space, which is ideally plastic.
    """
    return (2 + math.pi) * k


class PlasticCylinder(NamedTuple):
    """A thick-walled cylinder under internal pressure in plane strain, elastically incompressible and ideally plastic.

    Here s_zz is the mean of s_rr and s_tt. Von Mises' and Tresca's conditions with the same yield stress in shear k
    therefore agree. The plastic zone is a <= r <= c with the distance r from the axis. At first yield c = a, at the
    limit load c = b.

    Attributes:
        a, b: inner and outer radius, 0 < a < b, lengths.
        mu: shear modulus, stress.
        k: yield stress in shear, > 0; for von Mises it is the yield stress in tension divided by sqrt(3).
    """

    a: float
    b: float
    mu: float
    k: float

    def pressure(self, c: float) -> float:
        """Return the internal pressure at which the plastic zone reaches the radius c: k (2 ln(c/a) + 1 - c^2/b^2)."""
        return self.k * (2 * math.log(c / self.a) + 1 - (c / self.b) ** 2)

    def zone_radius(self, pressure: float) -> float:
        """Return the outer radius c of the plastic zone under an internal pressure; a if there is no plastic zone.

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
        """Return the radial displacements at the radii `r`, an array of any shape, under an internal pressure p.

        They are k c^2/(2 mu r) with a plastic zone up to the radius c, and p a^2/(2 mu r (1 - a^2/b^2)) without one.
        """
        return np.asarray(self._elastic_coefficient(pressure) / (2 * self.mu * np.asarray(r, float)))

    def radial_stress(self, pressure: float, r: Array) -> Array:
        """Return the radial stresses at the radii `r`, an array of any shape, under an internal pressure p.

        In a plastic zone up to the radius c they are -p + 2 k ln(r/a), outside it -k c^2 (1/r^2 - 1/b^2). Without a
        plastic zone p a^2/(1 - a^2/b^2) replaces k c^2.
        """
        r = np.asarray(r, float)
        plastic_stress = -pressure + 2 * self.k * np.log(r / self.a)
        elastic_stress = -self._elastic_coefficient(pressure) * (1 / r**2 - 1 / self.b**2)
        return np.where(r < self.zone_radius(pressure), plastic_stress, elastic_stress)

    def _elastic_coefficient(self, pressure: float) -> float:
        """Return A, stress times length squared, in the elastic stress s_rr = -A (1/r^2 - 1/b^2) at a pressure."""
        c = self.zone_radius(pressure)
        return self.k * c**2 if c > self.a else pressure * self.a**2 / (1 - (self.a / self.b) ** 2)


# ---------------------------------------------------------------- the bar of section 6.2 of the paper, of Eq. (44)
def signed_phase_fraction(x: Array, cost: float, g: float) -> Array:
    """Return the fractions of a material in phase 1, with a minus those in phase -1, that minimise its energy.

    The phases are 0, 1 and -1. Phase 0 has no transformation energy and no driving force.

    Args:
        x: driving forces of phase 1, energy per volume, an array of any shape.
        cost: transformation energy per volume of the phases 1 and -1.
        g: energy that mixing phases gains, per volume; 0: phases do not mix.
    """
    excess_drive = np.abs(x) - cost
    return np.asarray(np.sign(x) * (np.clip(0.5 + excess_drive / g, 0, 1) if g else excess_drive > 0))


def phase_energy(x: Array, cost: float, g: float, phase: Array | float) -> Array:
    """Return the energy per volume that the phases 1 or -1 add to the elastic energy of a material.

    The result has the common shape of `x` and `phase`.

    Args:
        x: driving forces of phase 1, energy per volume.
        cost: transformation energy per volume of the phases 1 and -1.
        g: energy that mixing phases gains, per volume.
        phase: fractions in phase 1, or minus the fractions in phase -1.
    """
    phase_fraction = np.abs(phase)
    return np.asarray(cost * phase_fraction - x * phase - phase_fraction * (1 - phase_fraction) * g / 2)


class BarResponse(NamedTuple):
    """Responses of a bar to elongations of its ends, with prescribed phases in its layer; all arrays have one shape.

    Attributes:
        phase: fraction of the layer in phase 1, or minus the fraction in phase -1.
        sigma: stress.
        U: elongation of the layer, a length.
        energy: energy of the whole bar, divided by the area of its section.
        is_local_minimum: whether the strain in each phase is one at which this phase is stable; the response is then a
            local minimiser of the energy.
    """

    phase: Array
    sigma: Array
    U: Array
    energy: Array
    is_local_minimum: npt.NDArray[np.bool_]

    def of_least_energy(self) -> BarResponse:
        """Return the response of least energy along the last axis of the arrays; of several equal ones, the first.

        Among the responses of `Bar.layout_responses` with equal energy this is the one with the fewest elements in
        phase 1 or -1.
        """
        indices = np.argmin(self.energy, axis=-1)[..., None]
        return BarResponse._make(np.take_along_axis(array, indices, -1)[..., 0] for array in self)


@dataclass(frozen=True)
class Bar:
    """The bar of section 6.2 of the paper: a layer of three phases -1, 0 and 1 in series with an elastic body.

    The layer ]0, eps l[ has the rigidity k = eps kbar, the body ]eps l, l[ the rigidity K. The displacements of the
    ends are u(0) = 0 and u(l) = delta. The layer is one of thickness eps l with the law `NonMonotone`, lmbda = 0 and
    chi = n (x) n. Divided by this thickness the modulus 2 mu is kbar/l; the transformation energy times the thickness
    is l cbar. All elongations at which phases change are linear in eps.

    The limit eps = 0 is Eq. (48) of the paper, which needs three corrections. In phase 0 sigma is (kbar/l) U, not kbar
    [u], and in phase 1 alpha less than that. While the phases mix sigma is sigma_m; the paper prints the equilibrium of
    the body there, with l/K in place of K/l. Finally delta_1 - delta_0 is l alpha/kbar.

    Attributes:
        l: length of the bar with its layer.
        K: rigidity of the body, stress.
        kbar: rigidity of the layer divided by eps, stress.
        alpha: transformation stress.
        cbar: eps times the transformation energy c of Eq. (44), stress; cbar >= alpha^2/(2 kbar), as otherwise phases 1
            and -1 would mix.
        eps: length of the layer divided by the length of the bar, 0 <= eps < 1.

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
        c_min = self.alpha**2 / (2 * self.kbar) * (1 - BOUND_TOLERANCE)
        if not (all(0 < value < math.inf for value in astuple(self)[:5]) and self.cbar >= c_min and 0 <= self.eps < 1):
            raise InputError(f"{self}; allowed: all > 0, cbar >= alpha^2/(2 kbar) = {c_min:g}, 0 <= eps < 1")

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
        """Compliance of the bar divided by its length, 1/stress: (1 - eps)/K + 1/kbar."""
        return (1 - self.eps) / self.K + 1 / self.kbar

    @property
    def free_elongation(self) -> float:
        """Elongation l alpha/kbar that the layer has in phase 1 without stress."""
        return self.l * self.alpha / self.kbar

    @property
    def delta_0(self) -> float:
        """Elongation of the bar at which phase 1 begins to grow in the global minimiser of the energy: sigma_m l R."""
        return self.sigma_m * self.l * self.R

    @property
    def delta_1(self) -> float:
        """Elongation of the bar above which phase 1 fills the layer in the global minimiser, delta_0 + l alpha/kbar.

        For the second term Eq. (47) of the paper prints l alpha alpha/k; correct is eps l alpha/k.
        """
        return self.delta_0 + self.free_elongation

    @property
    def snap_elongation(self) -> float:
        """Elongation of the bar at which a layer all in phase 0 snaps to phase 1: l R kbar cbar/alpha.

        The paper has no snaps.
        """
        return self.l * self.R * self.sigma_up

    @property
    def snap_back_elongation(self) -> float:
        """Elongation of the bar at which a layer all in phase 1 snaps back to phase 0.

        It is `snap_elongation` minus l alpha (1 - eps)/K.
        """
        return self.snap_elongation - self.l * self.alpha * (1 - self.eps) / self.K

    @property
    def loop_area(self) -> float:
        """Energy, divided by the area of the section, that a cycle over both snaps dissipates if phases do not mix.

        It is alpha/(kbar R) times l alpha (1 - eps)/K.
        """
        return self.free_elongation * self.alpha * (1 - self.eps) / (self.K * self.R)

    # ------------------------------------------------------------ the global minimiser; delta has any shape
    def phase(self, delta: Array | float) -> Array:
        """Return the fractions of the layer in phase 1, with a minus those in phase -1, in the global minimiser.

        They are (|delta| - delta_0)/(delta_1 - delta_0), cut off at 0 and 1, with the sign of delta: Eq. (46) of the
        paper. `delta` are elongations of the bar; the result has their shape.
        """
        delta = np.asarray(delta, float)
        return np.asarray(np.sign(delta) * np.clip((np.abs(delta) - self.delta_0) / self.free_elongation, 0, 1))

    def sigma(self, delta: Array | float) -> Array:
        """Return the stresses in the global minimiser at the elongations `delta` of the bar, in the shape of `delta`.

        For delta > 0 the stress is delta/(l R) before phase 1 grows. It is sigma_m while phase 1 grows, and (delta - l
        alpha/kbar)/(l R) after that. In the first and third case Eq. (47) of the paper prints the factor (k/(eps l))
        K/K_eps without delta; K_eps is K kbar R.
        """
        return self.responses_at(delta, self.phase(delta)).sigma

    def U(self, delta: Array | float) -> Array:
        """Return the elongations of the layer in the global minimiser at the elongations `delta` of the bar.

        The result has the shape of `delta`. For delta > 0 it is l sigma/kbar before phase 1 grows. It is delta -
        sigma_m l (1 - eps)/K while phase 1 grows, and l (sigma + alpha)/kbar after that. For the first and third case
        the paper prints, before Eq. (47), K delta/(K_eps (1 - eps)), which exceeds delta.
        """
        return self.responses_at(delta, self.phase(delta)).U

    def energy(self, delta: Array | float) -> Array:
        """Return the least energies of the bar, divided by the area of its section, at the elongations `delta`.

        They are the right side of Eq. (45) of the paper, in the shape of `delta`.
        """
        return self.responses_at(delta, self.phase(delta)).energy

    def boundary(self, delta: Array | float) -> Array:
        """Return the lengths of the layer's part in phase 0, in the global minimiser at elongations `delta` of the bar.

        The result has the shape of `delta`. While phases mix it is eps l - eps (kbar/alpha)(|delta| - delta_0). If
        delta_0 is inserted, this contains the term sigma_m k l (1 - eps)/(alpha K). Equation (47) of the paper prints
        this term without the factor 1 - eps, with a minus, and inside the brackets.
        """
        return self.eps * self.l * (1 - np.abs(self.phase(delta)))

    # ------------------------------------------------------------ local minimisers
    def responses_at(self, delta: Array | float, phase: Array | float) -> BarResponse:
        """Return the responses of the bar with prescribed phases in its layer, whether these are stable or not.

        Args:
            delta: elongations of the bar, of any shape.
            phase: fractions of the layer in phase 1, or minus the fractions in phase -1; shape that fits `delta`.
        """
        delta, phase = np.broadcast_arrays(np.asarray(delta, float), np.asarray(phase, float))
        phase_fraction = np.abs(phase)
        sigma = np.asarray((delta - phase * self.free_elongation) / (self.l * self.R), float)
        U = np.asarray(self.l * (sigma + self.alpha * phase) / self.kbar, float)
        energy = self.l * self.R * sigma**2 / 2 + phase_fraction * self.sigma_m * self.free_elongation
        is_phase_0_stable = (phase_fraction == 1) | (np.abs(sigma) <= self.sigma_up)
        is_phase_1_stable = (phase_fraction == 0) | (np.sign(phase) * sigma >= self.sigma_up - self.alpha)
        return BarResponse(phase, sigma, U, energy, is_phase_0_stable & is_phase_1_stable)

    def layout_responses(self, delta: Array | float, n: int) -> BarResponse:
        """Return the responses of a bar whose layer has n equal elements, with 0, 1, ..., n of them in phase 1.

        If delta < 0, they are in phase -1 instead. Each array of the result has the axes of `delta`, then an axis of
        length n + 1 for the number of these elements. Their places in the layer do not matter. Layouts with elements in
        both phases 1 and -1 have no less energy. The global minimiser is `BarResponse.of_least_energy`; its energy
        tends to `Bar.energy` from above like n^-2.

        Args:
            delta: elongations of the bar, of any shape.
            n: number of elements.
        """
        delta = np.asarray(delta, float)[..., None]
        return self.responses_at(delta, np.where(delta < 0, -1, 1) * (np.arange(n + 1) / n))

    # ------------------------------------------------------------ a uniform layer that softens
    def layer_response(self, U: Array | float, mixing: float = 1.0) -> tuple[Array, Array, Array]:
        """Return stress, energy per area of the section, and fraction in phase 1 of a uniform layer without the body.

        A fraction in phase -1 has a minus. The three arrays have the shape of `U`.

        Args:
            U: elongations of the layer, of any shape.
            mixing: share, from 0 to 1, of the energy that mixing phases gains. With 1 the energy is the convex envelope
                in Eq. (45) of the paper. With 0 it is W_min in Eq. (44), and phases do not mix.
        """
        x, g = self.alpha * np.asarray(U, float), mixing * self.alpha * self.free_elongation
        C, stiffness = self.l * self.cbar, self.kbar / self.l
        phase = signed_phase_fraction(x, C, g)
        elastic_work = stiffness * np.square(U)
        return stiffness * np.asarray(U) - self.alpha * phase, elastic_work / 2 + phase_energy(x, C, g, phase), phase
