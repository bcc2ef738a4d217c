"""Closed forms of concentric elastic cylinders, bonded or on springs: a coated fibre, tubes under pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Self

import numpy as np

from forms import LinearElastic
from forms.base import Array

MODES = (0, 2)  # radial fields are proportional to cos(mode theta), circumferential fields to sin(mode theta)
Springs = Sequence[tuple[float, float] | None]  # between neighbours: normal and tangential stiffness; None: bonded


@dataclass(frozen=True)
class Cylinders:
    """Closed form of concentric elastic cylinders in plane strain, with u = (a x, b y) on the outermost radius.

    The innermost cylinder is solid. In polar coordinates u_r = u_0(r) + u_2(r) cos(2 theta) and u_theta = v_2(r)
    sin(2 theta); the stresses s_rr and s_rtheta have the same form. Terms without theta are mode 0, with u_0 = A r + B
    / r. Terms with 2 theta are mode 2. They follow from Muskhelishvili's potentials, combinations of z^3 and 1/z, and
    of z and 1/z^3.

    Attributes:
        laws: law of each cylinder, the innermost first.
        radii: outer radius of each cylinder, increasing.
        coefficients: number of the mode, 0 or 2 -> (cylinders, n) factors of its n independent solutions in each
            cylinder; n is 2 for mode 0, 4 for mode 2.
    """

    laws: tuple[LinearElastic, ...]
    radii: tuple[float, ...]
    coefficients: dict[int, Array]

    @classmethod
    def stretched(
        cls, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, stretch: tuple[float, float]
    ) -> Self:
        """Solve for cylinders whose outermost boundary has the displacement (a x, b y).

        Args:
            laws: law of each cylinder, the innermost first.
            radii: outer radius of each cylinder, increasing.
            springs: for each interface between neighbours (normal, tangential) stiffness, stress per length; None:
                bonded.
            stretch: a and b of this displacement.
        """
        a, b = stretch
        rim = {0: ((a + b) / 2, 0.0), 2: ((a - b) / 2, (b - a) / 2)}
        coefficients = {mode: _coeffs(mode, laws, radii, springs, radii[-1] * np.array(rim[mode])) for mode in MODES}
        return cls(tuple(laws), tuple(radii), coefficients)

    def amplitudes(self, mode: int, k: int, r: float) -> Array:
        """Return the amplitudes (4,) of u_r, u_theta, s_rr and s_rtheta at the radius `r`, for one Fourier mode.

        `mode` is the number of the mode in theta, 0 or 2; `k` is the number of the cylinder, 0 for the innermost one.
        """
        return np.asarray(_solutions(mode, self.laws[k], r) @ self.coefficients[mode][k])

    def displacement(self, k: int, r: float, theta: float) -> Array:
        """Return the displacements (2,) u_r and u_theta at the polar coordinates `r` and `theta` (radians).

        `k` is the number of the cylinder, 0 for the innermost one.
        """
        mode_0, mode_2 = (self.amplitudes(mode, k, r)[:2] for mode in MODES)
        return mode_0 + mode_2 * [np.cos(2 * theta), np.sin(2 * theta)]

    def jumps(self, k: int) -> Array:
        """Return the amplitudes (2, 2) of the jumps from cylinder `k` (0: the innermost) to the next cylinder.

        The first index is for the Fourier modes in theta, 0 and 2. The second one is for the components u_r and
        u_theta.
        """
        r = self.radii[k]
        return np.array([(self.amplitudes(mode, k + 1, r) - self.amplitudes(mode, k, r))[:2] for mode in MODES])

    @property
    def energy(self) -> float:
        """Elastic energy of all cylinders, per unit of their length."""
        last, R = len(self.laws) - 1, self.radii[-1]
        mode_0, mode_2 = (self.amplitudes(mode, last, R) for mode in MODES)
        return float(pi * R * mode_0[:2] @ mode_0[2:] + pi * R / 2 * mode_2[:2] @ mode_2[2:])


def _solutions(mode: int, law: LinearElastic, r: float) -> Array:
    """Return the independent solutions for one Fourier mode at the radius `r` of a cylinder with the law `law`.

    `mode` is the number of the mode in theta, 0 or 2. In the array (4, n) each column has the amplitudes of u_r,
    u_theta, s_rr and s_rtheta of a solution; n is 2 for mode 0, 4 for mode 2. The first half of the columns is regular
    at r = 0.
    """
    mu, kappa = law.mu, (law.lmbda + 3 * law.mu) / (law.lmbda + law.mu)
    if mode == 0:
        return np.array([[r, 1 / r], [0.0, 0.0], [2 * (law.lmbda + mu), -2 * mu / r**2], [0.0, 0.0]])
    u = [[(kappa - 3) * r**3, -r, (kappa + 1) / r, -(r**-3)], [(kappa + 3) * r**3, r, (1 - kappa) / r, -(r**-3)]]
    s = [[0.0, -1.0, -4 / r**2, 3 / r**4], [6 * r**2, 1.0, -2 / r**2, 3 / r**4]]
    return np.concatenate([np.array(u) / (2 * mu), s])


def _coupling(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs) -> Array:
    """Return the matrix of the conditions at interfaces between cylinders, for one Fourier mode.

    The matrix multiplies the coefficients of the cylinders' independent solutions (`_solutions`). The conditions say
    that jumps of u_r and u_theta are the extensions of the springs, and tractions are continuous.

    Args:
        mode: number of the Fourier mode in theta, 0 or 2.
        laws: law of each cylinder, the innermost first.
        radii: radius of each interface, increasing.
        springs: for each interface (normal, tangential) stiffness, stress per length; None: bonded.

    Returns:
        (interfaces, 4, cylinders, n): four conditions at each interface, for n coefficients in each cylinder.
    """
    conditions = np.zeros((len(radii), 4, len(laws), _solutions(mode, laws[0], 1.0).shape[1]))
    for k, (spring, r) in enumerate(zip(springs, radii, strict=True)):
        inner, outer = (_solutions(mode, law, r) for law in laws[k : k + 2])
        conditions[k, :, k], conditions[k, :, k + 1] = -inner, outer
        if spring is not None:
            conditions[k, :2, k + 1] -= outer[2:] / np.array(spring)[:, None]
    return conditions


def _coeffs(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, rim: Array) -> Array:
    """Solve for the coefficients of one Fourier mode in cylinders, the innermost of which is solid.

    Args:
        mode: number of the Fourier mode in theta, 0 or 2.
        laws: law of each cylinder, the innermost first.
        radii: outer radius of each cylinder, increasing.
        springs: for each interface (normal, tangential) stiffness, stress per length; None: bonded.
        rim: (2,) prescribed amplitudes of u_r and u_theta on the outermost radius.

    Returns:
        (cylinders, n) coefficients of the n independent solutions in each cylinder.
    """
    conditions = _coupling(mode, laws, radii[:-1], springs)
    n, n_columns = conditions.shape[3], conditions[0, 0].size
    rim_rows = np.zeros((2, n_columns))
    rim_rows[:, -n:] = _solutions(mode, laws[-1], radii[-1])[:2]
    matrix = np.concatenate([conditions.reshape(-1, n_columns), rim_rows])
    unknowns = np.setdiff1d(np.arange(n_columns), np.arange(n // 2, n))
    coefficients = np.zeros(n_columns)
    coefficients[unknowns] = np.linalg.lstsq(matrix[:, unknowns], np.pad(rim, (len(matrix) - 2, 0)), rcond=None)[0]
    return coefficients.reshape(len(laws), n)


@dataclass(frozen=True)
class Lame:
    """Closed form of concentric tubes under inner pressure, without axial strain (Lamé).

    Attributes:
        laws: law of each tube, the innermost first.
        coefficients: (tubes, 2) A and B of the radial displacement A r + B/r in each tube.
    """

    laws: tuple[LinearElastic, ...]
    coefficients: Array

    def displacement(self, k: int, r: float) -> float:
        """Return the radial displacement at the radius `r` in tube `k`, 0 for the innermost one."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[0])

    def stress(self, k: int, r: float) -> float:
        """Return the radial stress at the radius `r` in tube `k`, 0 for the innermost one."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[2])


def lame(radii: Sequence[float], laws: Sequence[LinearElastic], springs: Sequence[float | None], p: float) -> Lame:
    """Return the closed form of concentric tubes under inner pressure; the outer side is free.

    Args:
        radii: increasing radii of the bore, of the interfaces and of the outer side.
        laws: law of each tube, the innermost first.
        springs: normal stiffness of each interface, stress per length; None: bonded.
        p: pressure in the bore.
    """
    coupling = _coupling(0, laws, radii[1:-1], [None if k is None else (k, k) for k in springs])[:, ::2]  # radial rows
    end_rows = np.zeros((2, 2 * len(laws)))
    end_rows[0, :2], end_rows[1, -2:] = (_solutions(0, laws[k], radii[k])[2] for k in (0, -1))
    A, b = np.concatenate([coupling.reshape(-1, end_rows.shape[1]), end_rows]), np.zeros(end_rows.shape[1])
    b[-2] = -p
    return Lame(tuple(laws), np.asarray(np.linalg.solve(A, b).reshape(-1, 2), float))
