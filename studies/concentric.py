"""Concentric cylinders in plane strain, whose rim is stretched: closed forms, with bonds or springs between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Self

import numpy as np
import numpy.typing as npt

from forms import LinearElastic

Array = npt.NDArray[np.float64]
MODES = (0, 2)  # fields are proportional to cos(mode theta), those along the circles to sin(mode theta)


@dataclass(frozen=True)
class Cylinders:
    """Elastic cylinders in one another, the innermost one solid, with u = (a x, b y) on the outermost radius R.

    u_r = u_0 + u_2 cos(2 theta), u_theta = v_2 sin(2 theta), and so are the stresses on circles. In each cylinder mode 0 is
    u_0 = A r + B / r, and mode 2 follows from the complex potentials a z^3 + b / z and c z + d / z^3.

    Attributes:
        laws: from the innermost one.
        radii: their outer radii, growing lengths.
        coefficients: mode -> (cylinders, 2 or 4) of its solutions.
    """

    laws: tuple[LinearElastic, ...]
    radii: tuple[float, ...]
    coefficients: dict[int, Array]

    @classmethod
    def stretched(
        cls,
        laws: Sequence[LinearElastic],
        radii: Sequence[float],
        springs: Sequence[tuple[float, float] | None],
        stretch: tuple[float, float],
    ) -> Self:
        """Solve.

        Args:
            laws, radii: see above.
            springs: normal and tangential stiffness between neighbours, stress per length; None: bonded.
            stretch: a and b.
        """
        a, b = stretch
        rim = {0: ((a + b) / 2, 0.0), 2: ((a - b) / 2, (b - a) / 2)}
        solved = {mode: _solved(mode, laws, radii, springs, radii[-1] * np.array(rim[mode])) for mode in MODES}
        return cls(tuple(laws), tuple(radii), solved)

    def fields(self, mode: int, k: int, r: float) -> Array:
        """Amplitudes of u_r, u_theta, s_rr and s_rtheta of a mode in cylinder k, at a radius."""
        return np.asarray(_solutions(mode, self.laws[k], r) @ self.coefficients[mode][k])

    def displacement(self, k: int, r: float, theta: float) -> Array:
        """u_r and u_theta in cylinder k."""
        zero, two = (self.fields(mode, k, r)[:2] for mode in MODES)
        return zero + two * [np.cos(2 * theta), np.sin(2 * theta)]

    def jumps(self, k: int) -> Array:
        """(2, 2) amplitudes of [u_r] and [u_theta] of both modes, from cylinder k to the next one."""
        r = self.radii[k]
        return np.array([(self.fields(mode, k + 1, r) - self.fields(mode, k, r))[:2] for mode in MODES])

    @property
    def energy(self) -> float:
        """Half the work of the rim, per length of the cylinders."""
        last, R = len(self.laws) - 1, self.radii[-1]
        zero, two = (self.fields(mode, last, R) for mode in MODES)
        return float(pi * R * zero[:2] @ zero[2:] + pi * R / 2 * two[:2] @ two[2:])


def _solutions(mode: int, law: LinearElastic, r: float) -> Array:
    """(4, n) amplitudes of u_r, u_theta, s_rr and s_rtheta of the solutions of a mode at a radius, regular ones first."""
    mu, kappa = law.mu, (law.lmbda + 3 * law.mu) / (law.lmbda + law.mu)
    if mode == 0:
        return np.array([[r, 1 / r], [0.0, 0.0], [2 * (law.lmbda + mu), -2 * mu / r**2], [0.0, 0.0]])
    u = [[(kappa - 3) * r**3, -r, (kappa + 1) / r, -(r**-3)], [(kappa + 3) * r**3, r, (1 - kappa) / r, -(r**-3)]]
    s = [[0.0, -1.0, -4 / r**2, 3 / r**4], [6 * r**2, 1.0, -2 / r**2, 3 / r**4]]
    return np.concatenate([np.array(u) / (2 * mu), s])


def _solved(
    mode: int,
    laws: Sequence[LinearElastic],
    radii: Sequence[float],
    springs: Sequence[tuple[float, float] | None],
    rim: Array,
) -> Array:
    """Coefficients of a mode: regular in the innermost cylinder, continuous stresses, jumps as of springs."""
    n = _solutions(mode, laws[0], 1.0).shape[1]
    rows, right = [], []
    for k, (spring, r) in enumerate(zip(springs, radii[:-1], strict=True)):
        inside, outside = (_solutions(mode, law, r) for law in laws[k : k + 2])
        compliance = np.zeros(2) if spring is None else 1 / np.array(spring)
        block = np.zeros((4, n * len(laws)))
        block[:2, n * k : n * (k + 1)] = -inside[:2]
        block[:2, n * (k + 1) : n * (k + 2)] = outside[:2] - compliance[:, None] * outside[2:]
        block[2:, n * k : n * (k + 1)] = -inside[2:]
        block[2:, n * (k + 1) : n * (k + 2)] = outside[2:]
        rows.append(block)
        right.append(np.zeros(4))
    at_rim = np.zeros((2, n * len(laws)))
    at_rim[:, -n:] = _solutions(mode, laws[-1], radii[-1])[:2]
    matrix = np.concatenate([*rows, at_rim])
    unknown = np.setdiff1d(np.arange(n * len(laws)), np.arange(n // 2, n))
    found = np.zeros(n * len(laws))
    found[unknown] = np.linalg.lstsq(matrix[:, unknown], np.concatenate([*right, rim]), rcond=None)[0]
    return found.reshape(len(laws), n)
