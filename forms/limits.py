"""The paper's interface laws as closed formulas in numpy.

They state the laws a second time, without the route the models take: the models never use them, tests compare with
them. Barred parameters (per thickness) throughout; w is the jump [u], n the unit normal from the lower to the upper body.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

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
    compliance = sum(a * np.linalg.inv(K) for a, K in zip(fractions, stiffnesses, strict=True))
    return np.asarray(np.linalg.inv(compliance))
