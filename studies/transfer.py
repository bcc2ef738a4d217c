"""Exact elastic layers between blocks under a load with one half-wave, by transfer matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Wave:
    """A load (S sin(k x), T cos(k x)) on the upper of two blocks, clamped below, with a layer between them.

    Displacements are (U(y) sin(k x), V(y) cos(k x)), tractions on planes of constant y (S(y) sin, T(y) cos). Plane strain.

    Attributes:
        k: wave number; a half-wave is pi/k long.
        height: of each block, in addition to the layer.
        body: Lame moduli lmbda, mu of the blocks.
        load: (S, T).
    """

    k: float
    height: float
    body: tuple[float, float]
    load: tuple[float, float]

    def across(self, lmbda: float, mu: float, thickness: float) -> Array:
        """Transfer matrix (4, 4) of (U, V, S, T) through an isotropic layer; lmbda may be infinite."""
        k, M = self.k, lmbda + 2 * mu
        ratio, along = (1.0, 4 * mu) if math.isinf(lmbda) else (lmbda / M, 4 * mu * (lmbda + mu) / M)
        rows = [[0, k, 1 / mu, 0], [-ratio * k, 0, 0, 1 / M], [along * k**2, 0, 0, ratio * k], [0, 0, -k, 0]]
        return np.asarray(expm(np.array(rows) * thickness))

    def solved(self, lmbda: float, mu: float, eps: float) -> tuple[Array, Array, float]:
        """Amplitudes of the layer's mean traction (S, T) and of its jump (U, V); work of the load over a half-wave of 1."""
        body, layer = self.across(*self.body, self.height), self.across(lmbda, mu, eps)
        load = np.array(self.load)
        whole = body @ layer @ body
        below = body @ np.append(np.zeros(2), np.linalg.solve(whole[2:, 2:], load))
        above = layer @ below
        return (above + below)[2:] / 2, (above - below)[:2], float(load @ (body @ above)[:2]) / 2
