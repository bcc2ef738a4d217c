"""Section 6.1 of the paper as closed formulas in numpy: the non-monotone interface law, relaxed and with pure phases.

The layer has three phases z = -1, 0, 1 of one stiffness, with the energies e:C:e/2 - z alpha chi:e + c |z| per volume,
Eq. (39); C = lim eps c and the moduli are per thickness, alpha is not: the limit needs alpha ~ eps^0, not the "power
eta < 1" of Eq. (41). The models never use these formulas, tests and studies compare with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from forms.base import is_number
from forms.declarations import LawError

Array = npt.NDArray[np.float64]
ROUNDING = 1e-12  # relative tolerance for parameters that equal a bound exactly


def lamination(lmbda: float, mu: float, chi: Array) -> float:
    """G = max over unit vectors k of (chi k).A(k)^-1 (chi k), A(k) = mu I + (lmbda + mu) k (x) k: 1/stiffness.

    alpha^2 G is what phases 0 and 1 gain by mixing in sheets across the best k. With s = k.chi k the gain is
    (|chi k|^2 - s^2)/mu + s^2/(lmbda + 2 mu). For given s, |chi k|^2 is largest between the extreme principal values
    c_1 >= c_d of chi, where it is (c_1 + c_d) s - c_1 c_d; the maximum is then at s = (1 - nu)(c_1 + c_d), not outside
    [c_d, c_1], nu = lmbda/(2 (lmbda + mu)). For chi = n (x) n and nu > 0 this is not k = n. Not in the paper.

    Args:
        lmbda, mu: Lame moduli, mu > 0 and lmbda > -2 mu/3.
        chi: symmetric, not zero; (2, 2) in plane strain (k in the plane) or (3, 3).

    Raises:
        LawError: a modulus or chi out of range.
    """
    _require_moduli(lmbda, mu)
    c = np.linalg.eigvalsh(_orientation(chi))
    sum_c, stiffness = c[0] + c[-1], lmbda + 2 * mu
    s = min(max(stiffness / (2 * (lmbda + mu)) * sum_c, c[0]), c[-1])
    return float((sum_c * s - c[0] * c[-1] - s**2) / mu + s**2 / stiffness)


@dataclass(frozen=True)
class NonMonotoneLimit:
    """The non-monotone interface law, for jumps w (..., d) in global axes.

    Attributes:
        lmbda, mu: Lame moduli, stress per thickness, mu > 0 and lmbda > -2 mu/3.
        alpha: transformation stress, > 0.
        transformation_energy: C, energy per area of the transformed layer, > 0.
        chi: symmetric (d, d) in the layer's axes: the second is n, the first in 2D (n_2, -n_1).
        n: unit normal of S, (d,).

    Raises:
        LawError: a parameter out of range; methods raise it, too.
    """

    lmbda: float
    mu: float
    alpha: float
    transformation_energy: float
    chi: Array
    n: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", np.asarray(self.n, float))
        object.__setattr__(self, "chi", _orientation(self.chi))
        _require_moduli(self.lmbda, self.mu)
        if self.n.shape != self.chi.shape[:1] or not abs(self.n @ self.n - 1) < 1e-9:
            raise LawError(f"chi {self.chi.shape}, n = {self.n}; allowed: (d, d), a unit vector (d,)")
        if not (0 < self.alpha < math.inf and 0 < self.transformation_energy < math.inf):
            given = f"alpha = {self.alpha:g}, transformation_energy = {self.transformation_energy:g}"
            raise LawError(f"{given}; allowed: > 0")

    def relaxed(self, w: Array, mixing: float = 1.0) -> tuple[Array, Array]:
        """Traction (..., d) and signed phase fraction (...): t = K_L w - phase alpha chi n.

        |phase| = 1/2 + (|x| - C)/g, not outside [0, 1], with the sign of the drive x and g = mixing alpha^2 G
        (`lamination`); C >= g/2, as phases 1 and -1 would mix below. mixing = 1 is the relaxed form of Eqs. (42)-(43),
        whose stress is that of the least energy; with less the stress falls while the phases mix. Equation (43) prints
        alpha chi_12 [u_i] for alpha chi_ij [u_i] n_j and leaves out phase -1.

        Args:
            w: jumps.
            mixing: share of the gain, 0 < mixing <= 1.
        """
        if not mixed_share(mixing) > 0:
            raise LawError(f"mixing = {mixing:g}; allowed: 0 < mixing <= 1")
        C, g = self.transformation_energy, self._gain(mixing)
        if not g / 2 * (1 - ROUNDING) <= C:
            raise LawError(f"transformation_energy = {C:g}; allowed: >= {g / 2:g}, half the gain of mixing")
        phase = fraction(self.drive(w), C, g)
        return self._traction(w, phase), phase

    def pure(self, w: Array, phase: int) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Traction (..., d) of a layer all in one phase z = -1, 0 or 1, and whether the phase holds at these jumps.

        t = K_L w - z alpha chi n, Eqs. (41)-(42), which print lmbda + mu for the normal stiffness lmbda + 2 mu and [u_1]
        for [u_2]. Phase 0 holds for drives |x| <= C, phases z = -1, 1 for z x >= C.
        """
        require_pure(phase)
        x, C = self.drive(w), self.transformation_energy
        holds = phase * x >= C if phase else np.abs(x) <= C
        return self._traction(w, np.full(x.shape, float(phase))), np.asarray(holds)

    def energy(self, w: Array, phase: Array | float, mixing: float = 1.0) -> Array:
        """Energy per area (...) at a signed phase fraction: w.K_L w/2 - phase x + C |phase| - |phase| (1 - |phase|) g/2.

        x, g as in `relaxed`. Pure phases have the energy of Eq. (44), whatever the mixing, 0 <= mixing <= 1.
        """
        mixed_share(mixing)
        if not (np.abs(phase) <= 1).all():
            raise LawError(f"phase is {phase!r}; allowed: -1 <= phase <= 1")
        x = self.drive(w)
        elastic = np.sum(np.asarray(w, float) * self._traction(w, 0 * x), axis=-1) / 2
        return np.asarray(
            elastic + phase_energy(x, self.transformation_energy, self._gain(mixing), np.asarray(phase, float))
        )

    def drive(self, w: Array) -> Array:
        """Drive x = alpha chi_ij w_i n_j (...): the energy per area that phase 1 gains over phase 0, before its cost C."""
        w = np.asarray(w, float)
        if w.shape[-1:] != self.n.shape:
            raise LawError(f"w {w.shape}, n = {self.n}; allowed: (..., d)")
        return np.asarray(self.alpha * w @ _transformation(self.chi, self.n))

    def _gain(self, mixing: float) -> float:
        """The energy per area that sheets of two phases gain by mixing, g."""
        return mixing * self.alpha**2 * lamination(self.lmbda, self.mu, self.chi)

    def _traction(self, w: Array, phase: Array) -> Array:
        w, n = np.asarray(w, float), self.n
        elastic = self.mu * w + (self.lmbda + self.mu) * (w @ n)[..., None] * n
        return np.asarray(elastic - self.alpha * phase[..., None] * _transformation(self.chi, n))


def _transformation(chi: Array, n: Array) -> Array:
    """Chi n in global axes, chi in the layer's."""
    if len(n) == 2:
        return np.array([[n[1], n[0]], [-n[0], n[1]]]) @ chi[:, 1]
    if n[1] < -1 + 1e-12:  # no smallest rotation: a half turn about the third axis
        return np.array([-1, -1, 1]) * chi[:, 1]
    axis = np.array([0.0, 1.0, 0.0])
    middle = (axis + n) / np.linalg.norm(axis + n)
    about_axis = 2 * axis * chi[1, 1] - chi[:, 1]  # the smallest rotation from e_2 to n is two half turns
    return np.asarray(2 * middle * (middle @ about_axis) - about_axis)


def _require_moduli(lmbda: float, mu: float) -> None:
    if not (0 < mu < math.inf and -2 / 3 * mu < lmbda < math.inf):
        raise LawError(f"lmbda = {lmbda:g}, mu = {mu:g}; allowed: mu > 0, lmbda > -2 mu/3")


def _orientation(chi: Array) -> Array:
    chi = np.asarray(chi, float)
    if chi.shape not in ((2, 2), (3, 3)) or not np.isfinite(chi).all() or not chi.any():
        raise LawError(f"chi is {chi.tolist()}; allowed: (2, 2) or (3, 3), finite, not zero")
    if not np.allclose(chi, chi.T, rtol=1e-10, atol=0):
        raise LawError(f"chi is {chi.tolist()}; allowed: symmetric")
    return chi


def require_pure(phase: int) -> None:
    """Raise LawError unless a phase is one of the three."""
    if phase not in (-1, 0, 1):
        raise LawError(f"phase is {phase!r}; allowed: -1, 0, 1")


def fraction(x: Array, transformation_energy: float, g: float) -> Array:
    """Signed phase fraction of least energy; without gain, g = 0, phases do not mix."""
    excess = np.abs(x) - transformation_energy
    return np.asarray(np.sign(x) * (np.clip(0.5 + excess / g, 0, 1) if g else excess > 0))


def phase_energy(x: Array, transformation_energy: float, g: float, phase: Array) -> Array:
    """Energy that a signed phase fraction adds to the elastic energy at a drive x."""
    share = np.abs(phase)
    return np.asarray(transformation_energy * share - x * phase - share * (1 - share) * g / 2)


def mixed_share(mixing: float) -> float:
    """`mixing` itself; raises LawError unless it is in [0, 1]."""
    if not (is_number(mixing) and 0 <= mixing <= 1):
        raise LawError(f"mixing = {mixing!r}; allowed: 0 <= mixing <= 1")
    return mixing
