"""The bar of section 6.2 of the paper as closed formulas in numpy.

Its phases and their energies are those of `forms.limits_non_monotone`, Eq. (44). The models never use these formulas, tests
and studies compare with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from forms.base import is_number
from forms.declarations import LawError
from forms.limits_non_monotone import ROUNDING, Array, fraction, mixed_share, phase_energy, require_pure


class Response(NamedTuple):
    """A bar whose layer is in given phases; all of one shape.

    Attributes:
        phase: signed fraction of the layer in phase 1 or -1.
        sigma: stress.
        U: elongation of the layer.
        energy: energy of the whole bar, per section.
        local: whether all strains are admissible for their phases, so that the response is a local minimiser.
    """

    phase: Array
    sigma: Array
    U: Array
    energy: Array
    local: npt.NDArray[np.bool_]

    def least(self) -> Response:
        """The response of least energy along the last axis; of several the one with the least transformed part."""
        where = np.argmin(self.energy, axis=-1)[..., None]
        phase, sigma, U, energy = (np.asarray(np.take_along_axis(a, where, -1)[..., 0], float) for a in self[:4])
        return Response(phase, sigma, U, energy, np.asarray(np.take_along_axis(self.local, where, -1)[..., 0], bool))


@dataclass(frozen=True)
class Bar:
    """Section 6.2: a layer ]0, eps l[ of rigidity k = eps kbar and phases -1, 0, 1, and a body ]eps l, l[ of rigidity K.

    u(0) = 0, u(l) = delta. A layer's law of this package with lmbda = 0 and chi = n (x) n has the thickness eps l and, per
    thickness, 2 mu = kbar/l and C = l cbar. All thresholds are linear in eps. eps = 0 is the limit, Eq. (48), corrected:
    sigma = (kbar/l) U for kbar [u], likewise less alpha; in between sigma = sigma_m is the law (printed is the body's
    balance, with l/K for K/l); delta_1 - delta_0 = l alpha/kbar.

    Attributes:
        l: length, layer included.
        K: rigidity of the body, stress.
        kbar: rigidity of the layer over eps, stress.
        alpha: transformation stress.
        cbar: c eps of Eq. (44), stress; cbar >= alpha^2/(2 kbar), below which phases 1 and -1 would mix.
        eps: share of the layer in the length, 0 <= eps < 1.

    Raises:
        LawError: a parameter out of range.
    """

    l: float  # noqa: E741
    K: float
    kbar: float
    alpha: float
    cbar: float
    eps: float

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):
            value, allowed = getattr(self, name), "0 <= eps < 1" if name == "eps" else "> 0"
            number = float(value) if is_number(value) else math.nan
            if not (0 <= number < 1 if name == "eps" else 0 < number < math.inf):
                raise LawError(f"Bar: {name} is {value!r}; allowed: {allowed}")
        bound = self.alpha**2 / (2 * self.kbar)
        if self.cbar < bound * (1 - ROUNDING):
            raise LawError(f"Bar: cbar is {self.cbar!r}; allowed: >= alpha^2/(2 kbar) = {bound:g}")

    @property
    def sigma_m(self) -> float:
        """Stress at which phases 0 and 1 are in equilibrium, k c/alpha - alpha/2."""
        return self.sigma_up - self.alpha / 2

    @property
    def sigma_up(self) -> float:
        """Stress up to which phase 0 holds, k c/alpha; phase 1 holds down to sigma_up - alpha."""
        return self.kbar * self.cbar / self.alpha

    @property
    def R(self) -> float:
        """Compliance over the length, (1 - eps)/K + eps/k."""
        return (1 - self.eps) / self.K + 1 / self.kbar

    @property
    def free_elongation(self) -> float:
        """Elongation of the layer in phase 1 without stress, eps l alpha/k."""
        return self.l * self.alpha / self.kbar

    @property
    def delta_0(self) -> float:
        """delta at which phase 1 begins in the global minimiser, sigma_m l R."""
        return self.sigma_m * self.l * self.R

    @property
    def delta_1(self) -> float:
        """delta at which phase 0 ends, delta_0 + eps l alpha/k; Eq. (47) prints l alpha alpha/k."""
        return self.delta_0 + self.free_elongation

    @property
    def up(self) -> float:
        """delta at which a layer all in phase 0 snaps to phase 1: l R k c/alpha. The paper has no snaps."""
        return self.l * self.R * self.sigma_up

    @property
    def down(self) -> float:
        """delta at which a layer all in phase 1 snaps back: up - l alpha (1 - eps)/K."""
        return self.up - self.l * self.alpha * (1 - self.eps) / self.K

    @property
    def snap_free(self) -> float:
        """(1 - eps)/(K R), the least mixing without a snap: the stress falls no more steeply than the body unloads."""
        return (1 - self.eps) / (self.K * self.R)

    @property
    def loop_area(self) -> float:
        """Energy lost per section in a cycle over both snaps of pure phases, eps alpha/(k R) l alpha (1 - eps)/K."""
        return self.lost()

    def lost(self, mixing: float = 0.0) -> float:
        """Energy lost per section in a cycle of a uniform layer, l alpha^2/kbar (snap_free - mixing); half in each snap."""
        return self.free_elongation * self.alpha * max(self.snap_free - mixed_share(mixing), 0.0)

    # ------------------------------------------------------------ the global minimiser, at any shape of delta
    def phase(self, delta: Array | float) -> Array:
        """Signed fraction of the layer in phase 1 (delta > 0) or -1, Eq. (46): (|delta| - delta_0)/(delta_1 - delta_0)."""
        delta = np.asarray(delta, float)
        return np.asarray(np.sign(delta) * np.clip((np.abs(delta) - self.delta_0) / self.free_elongation, 0, 1))

    def sigma(self, delta: Array | float) -> Array:
        """Stress: delta/(l R), then sigma_m, then (delta - eps l alpha/k)/(l R).

        Equation (47) prints (k/(eps l)) K/K_eps, without delta, in the first case and likewise in the third.
        """
        return self._response(delta, self.phase(delta)).sigma

    def U(self, delta: Array | float) -> Array:
        """Elongation of the layer: eps l sigma/k, then delta - sigma_m l (1 - eps)/K, then eps l (sigma + alpha)/k.

        The first and third cases before Eq. (47) print K delta/(K_eps (1 - eps)), which exceeds delta.
        """
        return self._response(delta, self.phase(delta)).U

    def energy(self, delta: Array | float) -> Array:
        """Least energy of the bar per section, the right-hand side of Eq. (45) (a minimum over U)."""
        return self._response(delta, self.phase(delta)).energy

    def boundary(self, delta: Array | float) -> Array:
        """Length eps S of phase 0, from x = 0 on: eps l - (k/alpha)(delta - delta_0) while phases mix.

        Equation (47) prints sigma k l/(alpha K) without the factor 1 - eps, with a minus, and inside the brackets.
        """
        return self.eps * self.l * (1 - np.abs(self.phase(delta)))

    def displacement(self, x: Array | float, delta: Array | float) -> Array:
        """u at the places x in [0, l], of the shape of x and delta together; Eq. (47) with u_a continuous at eps S.

        eps = 0: the body alone, so that u(0) is the jump.
        """
        x, delta = np.broadcast_arrays(np.asarray(x, float), np.asarray(delta, float))
        if not ((x >= 0) & (x <= self.l)).all():
            raise LawError(f"x is in [{x.min():g}, {x.max():g}]; allowed: [0, {self.l:g}]")
        state, thickness = self._response(delta, self.phase(delta)), self.eps * self.l
        body = delta + state.sigma / self.K * (x - self.l)
        if not self.eps:
            return np.asarray(body)
        beyond = np.sign(delta) * np.maximum(x - self.boundary(delta), 0.0)
        return np.where(x < thickness, (state.sigma * x + self.alpha * beyond) / (self.eps * self.kbar), body)

    # ------------------------------------------------------------ local minimisers
    def branch(self, delta: Array | float, phase: int) -> Response:
        """The layer all in phase -1, 0 or 1, whether it holds there or not."""
        require_pure(phase)
        return self._response(delta, phase)

    def layouts(self, delta: Array | float, n: int) -> Response:
        """The layer as n equal elements, m = 0, ..., n of them in phase 1 (delta < 0: -1); the last axis is m.

        Their places do not matter, and no layout with both 1 and -1, or with -1 instead of 1, has less energy.
        `Response.least` is the global minimiser of n elements; its energy tends to `energy` from above like n^-2.
        """
        if not (isinstance(n, (int, np.integer)) and n >= 1):
            raise LawError(f"n is {n!r}; allowed: an integer >= 1")
        delta = np.asarray(delta, float)[..., None]
        return self._response(delta, np.where(delta < 0, -1, 1) * (np.arange(n + 1) / n))

    def _response(self, delta: Array | float, phase: Array | float) -> Response:
        delta, phase = np.broadcast_arrays(np.asarray(delta, float), np.asarray(phase, float))
        share = np.abs(phase)
        sigma = np.asarray((delta - phase * self.free_elongation) / (self.l * self.R), float)
        U = np.asarray(self.l * (sigma + self.alpha * phase) / self.kbar, float)
        energy = self.l * self.R * sigma**2 / 2 + share * self.sigma_m * self.free_elongation
        kept = (share == 1) | (np.abs(sigma) <= self.sigma_up)
        changed = (share == 0) | (np.sign(phase) * sigma >= self.sigma_up - self.alpha)
        return Response(phase, sigma, U, energy, kept & changed)

    # ------------------------------------------------------------ a uniform layer that softens
    def layer(self, U: Array | float, mixing: float = 1.0) -> tuple[Array, Array, Array]:
        """Stress, energy per section and signed phase fraction of the layer alone at an elongation U.

        mixing = 1: the convex envelope of Eq. (45) and its derivative; 0: W_min of Eq. (44), of pure phases.
        """
        x, g = self.alpha * np.asarray(U, float), mixed_share(mixing) * self.alpha * self.free_elongation
        C, stiffness = self.l * self.cbar, self.kbar / self.l
        phase = fraction(x, C, g)
        elastic = stiffness * np.square(U)
        return stiffness * np.asarray(U) - self.alpha * phase, elastic / 2 + phase_energy(x, C, g, phase), phase

    def turning_points(self, mixing: float) -> tuple[float, float]:
        """delta where a uniform layer starts to mix, d_up, and where it has changed, d_down < d_up: it snaps at both.

        d_up = l R (k c/alpha - r alpha/2), d_down = l R (k c/alpha - alpha + r alpha/2) + eps l alpha/k, r = mixing.

        Raises:
            LawError: mixing not in [0, snap_free[.
        """
        if not mixed_share(mixing) < self.snap_free:
            raise LawError(f"mixing = {mixing:g}: no snap; allowed: < (1 - eps)/(K R) = {self.snap_free:g}")
        vertices = self.path(mixing)
        return float(vertices[1, 0]), float(vertices[2, 0])

    def path(self, mixing: float, end: float | None = None) -> Array:
        """Equilibrium path of a uniform layer from rest on, as vertices (delta, sigma) joined by straight lines, (4, 2).

        The layer starts to mix at the second vertex and has changed at the third; between them delta decreases if
        mixing < snap_free, and grows otherwise. The last is at delta = end (default: twice the largest before).
        """
        change = mixed_share(mixing) * self.alpha / 2
        sigma = np.array([0, self.sigma_up - change, self.sigma_up - self.alpha + change])
        delta = self.l * self.R * sigma + np.array([0, 0, self.free_elongation])
        last = 2 * delta.max() if end is None else end
        if not last >= delta[2]:
            raise LawError(f"end is {end}; allowed: >= {delta[2]:g}, where the layer has changed")
        return np.column_stack([[*delta, last], [*sigma, (last - self.free_elongation) / (self.l * self.R)]])
