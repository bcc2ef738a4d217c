"""Solutions that DOLFINx has no part in: transfer matrices of the Fourier problem.

u_1 = U(y) sin(kx), u_2 = V cos, sigma_12 = S sin, sigma_22 = T cos with k = pi; z = (U, V, S, T) obeys z' = A z in each
elastic strip. S is at y = 0, the blocks are HEIGHT high in kept geometry.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

K = np.pi
HEIGHT = 0.5
BODY = (57.69230769230769, 38.46153846153846)  # lmbda, mu of E = 100, nu = 0.3
LAYER = (60.0, 40.0)  # per thickness
TOP = np.array([0.5, 1.0])


def strip(lmbda: float, mu: float) -> np.ndarray:
    """The matrix A of an isotropic strip in plane strain."""
    M = lmbda + 2 * mu
    return np.array(
        [
            [0, K, 1 / mu, 0],
            [-lmbda * K / M, 0, 0, 1 / M],
            [4 * K**2 * mu * (lmbda + mu) / M, 0, 0, lmbda * K / M],
            [0, 0, -K, 0],
        ]
    )


def spring(lmbda: float, mu: float) -> np.ndarray:
    """Transfer across the interface law: the jump is traction over stiffness."""
    J = np.eye(4)
    J[0, 2], J[1, 3] = 1 / mu, 1 / (lmbda + 2 * mu)
    return J


def clamped(*factors: np.ndarray) -> list[np.ndarray]:
    """States z at the bottom and above each factor (bottom to top) for a clamped bottom and the given top traction."""
    whole = np.linalg.multi_dot(factors[::-1]) if len(factors) > 1 else factors[0]
    bottom = np.concatenate([np.zeros(2), np.linalg.solve(whole[2:, 2:], TOP)])
    states = [bottom]
    for factor in factors:
        states.append(factor @ states[-1])
    return states


def interface_states() -> list[np.ndarray]:
    """z at the bottom, 0-, 0+ and the top of the interface model."""
    body = expm(strip(*BODY) * HEIGHT)
    return clamped(body, spring(*LAYER), body)


def interface_displacement(y: np.ndarray, side: int) -> np.ndarray:
    """(2, n) amplitudes U, V of the interface model at heights y of the lower (-1) or upper (+1) block."""
    bottom, _, above, _ = interface_states()
    start, z0 = (-HEIGHT, bottom) if side < 0 else (0.0, above)
    levels, inverse = np.unique(np.round(y, 12), return_inverse=True)
    values = np.array([(expm(strip(*BODY) * (level - start)) @ z0)[:2] for level in levels])
    return values[inverse.ravel()].T


def sweep_errors(eps: float, bodies: str) -> tuple[float, float]:
    """Relative L2 errors (traction, jump) of the interface law against the layer, mean traction of both faces."""
    h = HEIGHT if bodies == "kept" else HEIGHT - eps / 2
    body = expm(strip(*BODY) * h)
    layer = expm(strip(LAYER[0] * eps, LAYER[1] * eps) * eps)
    _, below, above, _ = clamped(body, layer, body)
    _, b0, a0, _ = interface_states()
    traction, limit = (below[2:] + above[2:]) / 2, b0[2:]
    jump, jump0 = above[:2] - below[:2], a0[:2] - b0[:2]
    relative = lambda a, b: float(np.linalg.norm(a - b) / np.linalg.norm(b))
    return relative(traction, limit), relative(jump, jump0)
