"""The paper's interface laws as closed formulas in numpy, which tests hold laws against.

They are independent of the models. Barred parameters (per thickness) throughout; w is the jump [u], n the unit normal from
the lower to the upper body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ive, kve

from forms.formulas import phase_energy, pressure_modulus, signed_phase_fraction
from forms.non_monotone import lamination_gain

Array = npt.NDArray[np.float64]


def elastic_stiffness(lmbda: float, mu: float, n: Array) -> Array:
    """K_L of Eqs. (16)-(17), (d, d): mu tangentially, lmbda + 2 mu along n."""
    n = np.asarray(n, float)
    return mu * np.eye(len(n)) + (lmbda + mu) * np.outer(n, n)


def elastic(lmbda: float, mu: float, w: Array, n: Array) -> Array:
    """Traction of an elastic layer, the elastic part of Eq. (17): t = K_L [u]."""
    return elastic_stiffness(lmbda, mu, n) @ np.asarray(w, float)


def acoustic_tensor(C: Array, n: Array) -> Array:
    """K_ik = C_ijkl n_j n_l of an anisotropic layer, (3, 3), for C (3, 3, 3, 3)."""
    return np.einsum("ijkl,j,l->ik", C, n, n)


def stratified(fractions: Sequence[float], stiffnesses: Sequence[Array]) -> Array:
    """Stiffness of sublayers in series, (sum a_i K_i^-1)^-1.

    Equations (51)-(52) give 1/mu = sum a_i/mu_i and, with lmbda averaged alone, a wrong normal part; the sums that the
    paper calls stiffnesses are compliances. It is 1/(lmbda + 2 mu) that averages.
    """
    return np.asarray(np.linalg.inv(sum(a * np.linalg.inv(K) for a, K in zip(fractions, stiffnesses, strict=True))))


# ---------------------------------------------------------------- laws with time: tractions at a point
def kelvin_voigt(
    lmbda: float, mu: float, theta_lmbda: float, theta_mu: float, w: Array, rate: Array, n: Array
) -> Array:
    """Traction of Eqs. (16)-(17), t = K_L [u] + K_th d[u]/dt; K_th is K_L of the viscosities modulus times theta."""
    return elastic(lmbda, mu, w, n) + elastic(lmbda * theta_lmbda, mu * theta_mu, rate, n)


def norton(lmbda: float, mu: float, eta: float, p: float, w: Array, rate: Array, n: Array) -> Array:
    """Traction of Eqs. (22)-(24), t = K_L [u] + eta |v (x)_s n|^(p - 2) (v_N n + v_T/2), v = d[u]/dt.

    The modulus is that of the symmetrised product, |v (x)_s n|^2 = v_N^2 + |v_T|^2/2. Equations (22)-(24) print the bars
    around v alone. The 1/2 of the tangential part, right in print, is that of the shear strain.
    """
    n, v = np.asarray(n, float), np.asarray(rate, float)
    v_N = v @ n
    v_T = v - v_N * n
    modulus = np.sqrt(v_N**2 + v_T @ v_T / 2)
    return elastic(lmbda, mu, w, n) + (eta * modulus ** (p - 2) * (v_N * n + v_T / 2) if modulus else 0 * n)


def volumetric_rate(lmbda: float, mu: float, t1: float, t2: float) -> float:
    """1/t_v = ((1 + nu)/t1 - 3 nu/t2)/(1 - 2 nu): the trace of Eq. (18), with the rate of strain on its left.

    The trace is the three-dimensional one, s_33 included.
    """
    nu = lmbda / (2 * (lmbda + mu))
    return ((1 + nu) / t1 - 3 * nu / t2) / (1 - 2 * nu)


# ---------------------------------------------------------------- laws with time: one component, K its stiffness
def kelvin_voigt_creep(traction: float, K: float, G: float, t: Array) -> Array:
    """Jump under a traction held from t = 0 on, Eq. (16) with stiffness K and viscosity G of the component."""
    return traction / K * -np.expm1(-K * np.asarray(t) / G)


def kelvin_voigt_displaced(d: float, K: float, G: float, c: float, t: Array) -> Array:
    """Jump when the end of a body of compliance c > 0 is moved by d at t = 0 and held: Eq. (16) and t = (d - [u])/c."""
    return d / (1 + K * c) * -np.expm1(-(K + 1 / c) * np.asarray(t) / G)


def maxwell_creep(traction: float, K: float, t1: float, t: Array) -> Array:
    """Jump under a traction held from t = 0 on, d[u]/dt = (dt/dt + t/t1)/K.

    Equation (19) prints [u] for its rate, and for 1/K the coefficients (1 + nu)/E, -(1 - nu)/(E nu); the right ones are
    1/mu = 2 (1 + nu)/E and 1/(lmbda + 2 mu) = (1 + nu)(1 - 2 nu)/(E (1 - nu)).
    """
    return traction / K * (1 + np.asarray(t) / t1)


def maxwell_relaxation(d: float, K: float, c: float, t1: float, t: Array) -> Array:
    """Traction when the end of a body of compliance c >= 0 is moved by d at t = 0 and held; Eq. (19) corrected."""
    return d / (c + 1 / K) * np.exp(-np.asarray(t) / (t1 * (1 + K * c)))


def maxwell_normal_creep(lmbda: float, mu: float, t1: float, t2: float, traction: float, t: Array) -> Array:
    """Normal jump under a normal traction held from t = 0 on, t1 != t2 in Eq. (18).

    With the parts s + p = t_N, deviatoric and spherical, of stiffnesses k_s + k_p = K and rates r_s, r_p:
    K d[u_N]/dt = r_s s + r_p p, and p tends to k_p r_s t_N/(k_p r_s + k_s r_p) like exp(-t (k_p r_s + k_s r_p)/K).
    """
    t = np.asarray(t, float)
    k_s, k_p = 4 / 3 * mu, lmbda + 2 / 3 * mu
    r_s, r_p, K = 1 / t1, volumetric_rate(lmbda, mu, t1, t2), lmbda + 2 * mu
    rate = (k_p * r_s + k_s * r_p) / K
    last = traction * k_p * r_s / (K * rate)
    lag = (traction * k_p / K - last) * -np.expm1(-rate * t) / rate  # integral of p - last
    return np.asarray((traction + r_s * (traction - last) * t + r_p * last * t + (r_p - r_s) * lag) / K, float)


def norton_creep(traction: float, K: float, eta: float, p: float, t: Array, *, shear: bool) -> Array:
    """Jump under a traction > 0 held from t = 0 on, any p > 1 but 2: t = K w + c (dw/dt)^(p - 1).

    c is eta for a normal jump and eta 2^(-p/2) for a shear one (Eq. (22) with |v (x)_s n|). With r = t - K w and
    q = 1/(p - 1): r^(1 - q) = t^(1 - q) - (1 - q) K c^(-q) t. For p > 2 rest is reached in finite time.
    """
    q = 1 / (p - 1)
    c = eta * 2 ** (-p / 2) if shear else eta
    left = traction ** (1 - q) - (1 - q) * K * c**-q * np.asarray(t)
    return (traction - np.maximum(left, 0.0) ** (1 / (1 - q))) / K


def power_creep(mu: float, A: float, n: float, traction: float, t: Array) -> Array:
    """Tangential jump of `NortonCreep` under a traction > 0 held from t = 0 on: it grows for ever, at a steady rate."""
    return np.asarray(traction / mu + 3 ** ((n + 1) / 2) * A * traction**n * np.asarray(t, float))


def power_relaxation(compliance: float, A: float, n: float, traction: float, t: Array) -> Array:
    """Tangential traction > 0 of `NortonCreep`, n > 1, where layer and bodies of this compliance, 1/mu + C, are held.

    compliance dt_T/dt = -3^((n + 1)/2) A t_T^n.
    """
    rate = (n - 1) * 3 ** ((n + 1) / 2) * A / compliance
    return np.asarray((traction ** (1 - n) + rate * np.asarray(t)) ** (1 / (1 - n)))


def power_creep_normal(lmbda: float, mu: float, A: float, n: float, traction: float, t: Array) -> Array:
    """Normal jump of `NortonCreep`, n > 1, under a traction > 0 held from t = 0 on, which ends as k w_N = t_N.

    With k = lmbda + 2 mu/3 the deviator s = t_N - k w_N has ds/dt (1 + 4 mu/(3 k)) = -3 mu A (3/2)^(n - 1) s^n.
    """
    k, first = lmbda + 2 * mu / 3, 4 / 3 * mu * traction / (lmbda + 2 * mu)
    rate = 3 * mu * A * 1.5 ** (n - 1) / (1 + 4 * mu / (3 * k))
    return np.asarray((traction - (first ** (1 - n) + (n - 1) * rate * np.asarray(t)) ** (1 / (1 - n))) / k)


def stack_creep(fractions: Sequence[float], jumps: Sequence[Array]) -> Array:
    """Jump of sublayers in series under a common traction, sum a_i w_i; w_i: jump if the whole layer were sublayer i.

    Jumps, hence compliances, add; Eqs. (51)-(52) print sums of compliances as stiffnesses.
    """
    return np.asarray(sum(a * np.asarray(w) for a, w in zip(fractions, jumps, strict=True)))


# ---------------------------------------------------------------- Mohr-Coulomb; angles in degrees, (T, N): frame of S
def mohr_coulomb(
    lmbda: float, mu: float, cohesion: float, friction_angle: float, w: Array, w_old: Array, s_old: Array
) -> tuple[Array, Array]:
    """Traction (t_T, t_N) and in-plane deviator s = (s_T, s_N) after a step of backward Euler of the full law, psi = 0.

    With p = (lmbda + mu) w_N: s = s_old + mu (w - w_old), shortened to |s| = R = C cos(Omega) - p sin(Omega) where it is
    longer; t_T = s_T, t_N = p + s_N. It replaces Eqs. (31)-(35), which lack the factor 2 of plastic shear strains and write
    the plastic strain as a jump, which it is not. It holds in plane strain while s_33 lies between the other two principal
    stresses. All arguments may be arrays (..., 2); from rest s_old = w_old = 0.
    """
    w, w_old = np.asarray(w, float), np.asarray(w_old, float)
    angle = np.radians(friction_angle)
    p = (lmbda + mu) * w[..., 1]
    trial = np.asarray(s_old, float) + mu * (w - w_old)
    R, size = cohesion * np.cos(angle) - p * np.sin(angle), np.linalg.norm(trial, axis=-1)
    s = trial * np.where(size > R, R / np.where(size > 0, size, 1.0), 1.0)[..., None]
    return s + np.stack([0 * p, p], axis=-1), s


def penalised_coulomb(
    lmbda, mu, cohesion, friction_angle, w, slip, n, *, unilateral=False, hardening=0.0, accumulated=0.0
):
    """Traction and new slip w^p of the monodirectional law, one step: t = K_L (w - w^p), |t_T| <= C - tan(Omega) t_N.

    Equations (36)-(38) with the elastic strain, the moduli per thickness, t_T = stress n in place of tau_i, and slip along
    t_T whatever its sign. Where t_N > C cot(Omega) no shear is left. Unilateral: t_N <= 0. With linear hardening C is the
    cohesion at first, and `accumulated` the sum of the |dw^p| so far.
    """
    K, C = elastic_stiffness(lmbda, mu, n), cohesion + hardening * accumulated
    return _coulomb(K, C, friction_angle, w, slip, n, unilateral, hardening)


def stratified_coulomb(fractions, stiffnesses, cohesion, friction_angle, w, slip, n) -> tuple[Array, Array]:
    """Traction and new slip of isotropic sublayers, one of them monodirectional, in one step: t = K (w - w^p).

    Equations (54)-(55), with the sign of t_T in the flow and K = `stratified`; the threshold is on the common traction
    and w^p is the jump of the plastic sublayer, its fraction of the thickness times that of `penalised_coulomb`.
    """
    return _coulomb(stratified(fractions, stiffnesses), cohesion, friction_angle, w, slip, n, False)


def _coulomb(
    K: Array, cohesion: float, friction_angle: float, w: Array, slip: Array, n: Array, unilateral: bool, H: float = 0.0
) -> tuple[Array, Array]:
    n, slip = np.asarray(n, float), np.asarray(slip, float)
    trial = K @ (np.asarray(w, float) - slip)
    t_N = min(float(trial @ n), 0.0) if unilateral else float(trial @ n)
    shear = trial - (trial @ n) * n
    bound, size = cohesion - np.tan(np.radians(friction_angle)) * t_N, np.linalg.norm(shear)
    if H and size > bound:
        mu = shear @ K @ shear / size**2
        bound = (bound * mu + size * H) / (mu + H)
    t_T = shear * min(1.0, max(bound, 0.0) / size) if size else shear
    return t_N * n + t_T, slip + np.linalg.solve(K, shear - t_T)


def von_mises_shear(mu: float, strength: float, hardening: float, w: Array) -> Array:
    """Traction of a layer under a shear w that only grows, at w_N = 0; mu and H + K per thickness.

    sqrt(3) t_T = Y + (H + K) p with the accumulated plastic strain p = (w - t_T/mu)/sqrt(3).
    """
    first = strength / (math.sqrt(3) * mu)
    return np.where(w <= first, mu * w, mu * first + mu * hardening / (3 * mu + hardening) * (w - first))


# ---------------------------------------------------------------- non-monotone layers
@dataclass(frozen=True)
class NonMonotoneLimit:
    """Section 6.1: the non-monotone interface law, relaxed and with pure phases, for jumps w (..., d) in global axes.

    Phases z = -1, 0, 1 have the energies e:C:e/2 - z alpha chi:e + c |z| per volume, Eq. (39); C = lim eps c. The limit
    needs alpha ~ eps^0, not the "power eta < 1" of Eq. (41). chi (d, d) is in the layer's axes: the second is n, the first
    in 2D (n_2, -n_1).
    """

    lmbda: float
    mu: float
    alpha: float
    transformation_energy: float
    chi: Array
    n: Array

    def relaxed(self, w: Array, mixing: float = 1.0) -> tuple[Array, Array]:
        """Traction (..., d) and signed phase fraction (...): t = K_L w - phase alpha chi n.

        |phase| = 1/2 + (|x| - C)/g, not outside [0, 1], with the sign of the drive x and g = mixing alpha^2 G; C >= g/2, as
        phases 1 and -1 would mix below. mixing = 1 is the relaxed form of Eqs. (42)-(43), whose stress is that of the least
        energy. Equation (43) prints alpha chi_12 [u_i] for alpha chi_ij [u_i] n_j and leaves out phase -1.
        """
        phase = signed_phase_fraction(self.drive(w), self.transformation_energy, self._gain(mixing))
        return self._traction(w, phase), phase

    def pure(self, w: Array, phase: int) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Traction (..., d) of a layer all in one phase z = -1, 0 or 1, and whether the phase holds at these jumps.

        t = K_L w - z alpha chi n, Eqs. (41)-(42), which print lmbda + mu for the normal stiffness lmbda + 2 mu and [u_1]
        for [u_2]. Phase 0 holds for drives |x| <= C, phases z = -1, 1 for z x >= C.
        """
        x, C = self.drive(w), self.transformation_energy
        return self._traction(w, np.full(x.shape, float(phase))), phase * x >= C if phase else np.abs(x) <= C

    def energy(self, w: Array, phase: Array | float, mixing: float = 1.0) -> Array:
        """Energy per area (...): w.K_L w/2 - phase x + C |phase| - |phase| (1 - |phase|) g/2; of pure phases Eq. (44)."""
        x = self.drive(w)
        elastic = np.sum(w * self._traction(w, 0 * x), axis=-1) / 2
        return elastic + phase_energy(x, self.transformation_energy, self._gain(mixing), phase)

    def drive(self, w: Array) -> Array:
        """Drive x = alpha chi_ij w_i n_j (...): the energy per area that phase 1 gains over phase 0, before its cost C."""
        return self.alpha * np.asarray(w, float) @ self._transformation

    def _gain(self, mixing: float) -> float:
        return mixing * self.alpha**2 * lamination_gain(self.lmbda, self.mu, self.chi)

    def _traction(self, w: Array, phase: Array) -> Array:
        stiffness = elastic_stiffness(self.lmbda, self.mu, self.n)
        return np.asarray(w, float) @ stiffness - self.alpha * phase[..., None] * self._transformation

    @property
    def _transformation(self) -> Array:
        """Chi n in global axes."""
        n, across = self.n, self.chi[:, 1]
        if len(n) == 2:
            return np.array([[n[1], n[0]], [-n[0], n[1]]]) @ across
        if n[1] < -1 + 1e-12:  # no smallest rotation: a half turn about the third axis
            return np.array([-1, -1, 1]) * across
        axis = np.array([0.0, 1.0, 0.0])
        middle = (axis + n) / np.linalg.norm(axis + n)
        about_axis = 2 * axis * across[1] - across  # the smallest rotation from e_2 to n is two half turns
        return 2 * middle * (middle @ about_axis) - about_axis


# ---------------------------------------------------------------- rubber, beside what `forms.formulas` has
def rubber_strip_tilted(lmbda: float, mu: float, eps: float, a: float) -> float:
    """Moment about the middle per rotation of a strip |x| < a in plane strain, per length out of the plane; a force.

    w_N = theta x gives p = (lmbda theta/eps) (x - a sinh(x/delta)/sinh(a/delta)), and with 2 mu w_N/eps the moment.
    """
    return (pressure_modulus(lmbda, mu, a / eps, 1.5) + 2 * mu) / eps * 2 * a**3 / 3


def rubber_disc_pressure(lmbda: float, mu: float, eps: float, radius: float, r: Array) -> Array:
    """Pressure p per opening of a disc at the radii r <= radius, tension > 0, stress per length, of the shape of r.

    (lmbda/eps) (1 - I_0(r/delta)/I_0(radius/delta)); 3 mu (radius^2 - r^2)/eps^3 where delta is a thousand times the
    radius, or infinite. The normal traction is p + 2 mu/eps.
    """
    delta = eps * math.sqrt(lmbda / (12 * mu))
    if not radius > 1e-3 * delta:
        return np.asarray(3 * mu * (radius**2 - r**2) / eps**3)
    share = ive(0, r / delta) / ive(0, radius / delta) * np.exp((r - radius) / delta)
    return np.asarray(lmbda / eps * (1 - share))


def rubber_annulus(lmbda: float, mu: float, eps: float, inner: float, outer: float) -> float:
    """Mean normal traction per opening of an annulus inner < r < outer, free at both ends, as `formulas.disc_stiffness`.

    For an infinite lmbda (3 mu/(2 eps^3)) (outer^2 + inner^2 - (outer^2 - inner^2)/ln(outer/inner)) + 2 mu/eps.
    """
    if math.isinf(lmbda):
        flow = outer**2 + inner**2 - (outer**2 - inner**2) / math.log(outer / inner)
        return (1.5 * mu / eps**2 * flow + 2 * mu) / eps
    ends = np.array([inner, outer]) / (eps * math.sqrt(lmbda / (12 * mu)))
    # both solutions are scaled to be of order one at the end where they are largest
    rising, falling = np.exp(ends - ends[1]), np.exp(ends[0] - ends)
    at_ends = np.transpose([ive(0, ends) * rising, kve(0, ends) * falling])
    integrals = [np.diff(ends * ive(1, ends) * rising)[0], -np.diff(ends * kve(1, ends) * falling)[0]]
    lost = 2 * float(np.linalg.solve(at_ends, np.ones(2)) @ integrals) / (ends[1] ** 2 - ends[0] ** 2)
    return (lmbda * (1 - lost) + 2 * mu) / eps


def strip_stiffness(lmbda: float, mu: float, eps: float, a: float) -> float:
    """Return the mean normal traction per opening of a rubber strip between rigid plates, stress per length.

    In plane strain it is [lmbda (1 - tanh(x)/x) + 2 mu]/eps with x = a/delta and delta = eps sqrt(lmbda/(12 mu)). For
    an infinite lmbda it is 4 mu a^2/eps^3 + 2 mu/eps.

    Args:
        lmbda: first Lame modulus of the layer, stress; > 0 or math.inf.
        mu: shear modulus of the layer, stress; > 0.
        eps: thickness of the layer, length; > 0.
        a: half the width of the strip, length; > 0.

    Raises:
        InputError: an argument out of range.
    """
    return (pressure_modulus(lmbda, mu, a / eps, 0.5) + 2 * mu) / eps
