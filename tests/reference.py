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
    of_u, of_v = [0, K, 1 / mu, 0], [-lmbda * K / M, 0, 0, 1 / M]
    return np.array([of_u, of_v, [4 * K**2 * mu * (lmbda + mu) / M, 0, 0, lmbda * K / M], [0, 0, -K, 0]])


def spring(lmbda: float, mu: float) -> np.ndarray:
    """Transfer across the interface law: the jump is traction over stiffness."""
    J = np.eye(4, dtype=np.result_type(lmbda, mu, float))
    J[0, 2], J[1, 3] = 1 / mu, 1 / (lmbda + 2 * mu)
    return J


def next_order(lmbda: float, mu: float, eps: float) -> np.ndarray:
    """Transfer across the interface law of order 1 of a layer with real moduli, from its energy over half a wave.

    Strains of a mode with jumps (U, V) and means <U>, <V>: e0 = (k <U>, V/eps, U/eps - k <V>) in 11, 22, 2 12, and
    e1 = (k U, e, g) with what leaves no stress on the faces, (e, g) = (-lmbda k U/M, 0).
    """
    M = lmbda + 2 * mu
    C = np.array([[M, lmbda, 0], [lmbda, M, 0], [0, 0, mu]])
    e0 = np.array([[0, 0, K, 0], [0, 1 / eps, 0, 0], [1 / eps, 0, 0, -K]])
    e1 = np.array([[K, 0, 0, 0], [-lmbda * K / M, 0, 0, 0], [0] * 4])
    return across(eps * e0.T @ C @ e0 + eps / 12 * e1.T @ C @ e1)


def across(energy: np.ndarray) -> np.ndarray:
    """Transfer across an interface law from twice its energy (4, 4) in jumps and means (U, V), over half a wave."""
    faces = np.block([[-np.eye(2), np.eye(2)], [np.eye(2) / 2, np.eye(2) / 2]])  # jumps and means of (lower, upper)
    stiffness = faces.T @ energy @ faces
    below, across, above = stiffness[:2, :2], stiffness[:2, 2:], stiffness[2:, 2:]
    moved = np.linalg.solve(across, np.hstack([-below, -np.eye(2)]))  # upper displacements of the lower (U, V, S, T)
    return np.vstack([moved, np.hstack([across.T, np.zeros((2, 2))]) + above @ moved])


def next_order_errors(lmbda: float, mu: float, eps: float) -> tuple[float, float]:
    """Errors as in `sweep_errors` of the law of order 1, for moduli per thickness, in kept geometry."""
    return errors(expm(strip(lmbda * eps, mu * eps) * eps), next_order(lmbda * eps, mu * eps, eps))[:2]


def errors(layer: np.ndarray, limit: np.ndarray) -> tuple[float, float, float]:
    """Relative errors of traction, jump and compliance that a law's transfer leaves in kept geometry."""
    body, values = expm(strip(*BODY) * HEIGHT), []
    for between in (layer, limit):
        _, below, above, top = clamped(body, between, body)
        values.append(((below[2:] + above[2:]) / 2, (above - below)[:2], TOP @ top[:2]))
    return tuple(float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in zip(*values, strict=True))


def stacked(sublayers: list, eps: float) -> np.ndarray:
    """Transfer through sublayers (fraction, lmbda, mu), from the lower to the upper one, with moduli per thickness."""
    return through(sublayers, eps)[0]


def in_series(sublayers: list, eps: float) -> np.ndarray:
    """Transfer across the interface law of order 1 of such sublayers, at two Gauss points in each.

    Displacements are <u> + Phi [u], Phi from -1/2 to 1/2 in proportion to the compliances. Strains are such that tractions
    are equal in all sublayers.
    """
    M = 1 / sum(a / (lmbda + 2 * shear) for a, lmbda, shear in sublayers)
    mu = 1 / sum(a / shear for a, _, shear in sublayers)
    phi_n = phi_t = -0.5
    points, A, B, r = [], 0.0, 0.0, 0.0
    for a, lmbda, shear in sublayers:
        stiff, lateral = lmbda + 2 * shear, lmbda / (lmbda + 2 * shear)
        across_n, across_t = a * M / stiff, a * mu / shear
        A, B = A + a * lateral * (phi_t + across_t / 2), B + a * (phi_n + across_n / 2)
        r += a * lateral
        for y in (0.5 - 12**-0.5, 0.5 + 12**-0.5):
            points.append((a, lmbda, shear, M / stiff, mu / shear, phi_t + y * across_t))
        phi_n, phi_t = phi_n + across_n, phi_t + across_t
    opening, turned = np.array([K * A, 1 / eps, K * r, 0]), np.array([1 / eps, -K * B, 0, -K])
    energy = np.zeros((4, 4))
    for a, lmbda, shear, s_n, s_t, p_t in points:
        e_11 = np.array([K * p_t, 0, K, 0])
        e_22 = s_n * opening - lmbda / (lmbda + 2 * shear) * e_11
        gamma = s_t * turned
        C = eps * np.array([[lmbda + 2 * shear, lmbda, 0], [lmbda, lmbda + 2 * shear, 0], [0, 0, shear]])
        e = np.array([e_11, e_22, gamma])
        energy += a * eps / 2 * e.T @ C @ e
    return across(energy)


def clamped(*factors: np.ndarray) -> list[np.ndarray]:
    """States z at the bottom and above each factor (bottom to top) for a clamped bottom and the given top traction."""
    whole = np.linalg.multi_dot(factors[::-1]) if len(factors) > 1 else factors[0]
    states = [np.concatenate([np.zeros(2), np.linalg.solve(whole[2:, 2:], TOP)])]
    for factor in factors:
        states.append(factor @ states[-1])
    return states


def interface_states() -> list[np.ndarray]:
    """z at the bottom, 0-, 0+ and the top of the interface model."""
    body = expm(strip(*BODY) * HEIGHT)
    return clamped(body, spring(*LAYER), body)


def through(layer: list, eps: float) -> tuple[np.ndarray, np.ndarray]:
    """Transfer through sublayers (fraction, lmbda, mu) with moduli per thickness, and its mean over the thickness."""
    whole, mean = np.eye(4), np.zeros((4, 4))
    for a, lmbda, mu in layer:
        both = expm(np.block([[strip(lmbda * eps, mu * eps), np.eye(4)], [np.zeros((4, 8))]]) * a * eps)
        whole, mean = both[:4, :4] @ whole, mean + both[:4, 4:] @ whole / eps
    return whole, mean


def sweep_errors(eps: float, bodies: str) -> tuple[float, float]:
    """Relative L2 errors (traction, jump) of the interface law against the layer, mean traction through it."""
    body = expm(strip(*BODY) * (HEIGHT if bodies == "kept" else HEIGHT - eps / 2))
    layer, mean = through([(1, *LAYER)], eps)
    _, below, above, _ = clamped(body, layer, body)
    _, b0, a0, _ = interface_states()
    relative = lambda a, b: float(np.linalg.norm(a - b) / np.linalg.norm(b))
    return relative((mean @ below)[2:], b0[2:]), relative((above - below)[:2], (a0 - b0)[:2])


# ---------------------------------------------------------------- in time
# A time scheme is linear and starts from nothing, so that it obeys a correspondence principle of its own: with
# x(z) = sum_n x_n z^n the rate is d(z) x(z), d = (1 - z)/(dt (theta + (1 - theta) z)), and every series is an elastic
# solution with the moduli of d. Coefficients are Fourier sums over a circle; nothing is approximated but rounding.
POINTS, RADIUS = 64, 0.5


def kelvin_voigt(lmbda: float, mu: float, theta_lmbda: float, theta_mu: float):
    """Moduli as functions of the rate's symbol d."""
    return lambda d: (lmbda * (1 + theta_lmbda * d), mu * (1 + theta_mu * d))


def maxwell(lmbda: float, mu: float, t1: float, t2: float):
    """Moduli of Eq. (18): shear and bulk modulus relax with t1 and t_v."""
    nu, bulk = lmbda / (2 * (lmbda + mu)), lmbda + 2 * mu / 3
    volumetric = ((1 + nu) / t1 - 3 * nu / t2) / (1 - 2 * nu)

    def moduli(d: complex) -> tuple[complex, complex]:
        shear = mu * d / (d + 1 / t1)
        return bulk * d / (d + volumetric) - 2 * shear / 3, shear

    return moduli


def marched(layer: list, loads: np.ndarray, dt: float, theta: float = 1.0, eps: float | None = None) -> np.ndarray:
    """(steps + 1, 4) amplitudes at each step: jump (U, V), traction (S, T), of a layer its mean through it.

    Args:
        layer: (fraction, moduli of d) of each sublayer, from the lower to the upper face; moduli per thickness.
        loads: factor of the top traction at each step, the first one zero.
        dt, theta: the time scheme.
        eps: thickness of the layer (bodies kept); None: the interface law.
    """
    body = expm(strip(*BODY) * HEIGHT)
    sums = np.zeros((POINTS, 4), complex)
    circle = RADIUS * np.exp(2j * np.pi * np.arange(POINTS) / POINTS)
    for k, z in enumerate(circle):
        d = (1 - z) / (dt * (theta + (1 - theta) * z))
        moduli = [(a, *moduli_at(d)) for a, moduli_at in layer]
        if eps is None:
            layers = [np.linalg.multi_dot([np.eye(4), *(spring(lmbda / a, mu / a) for a, lmbda, mu in moduli)])] * 2
        else:
            layers = through(moduli, eps)
        _, below, above, _ = clamped(body, layers[0], body)
        scale = np.polyval(np.asarray(loads)[::-1], z)
        sums[k] = scale * np.concatenate([(above - below)[:2], (layers[1] @ below)[2:]])
    n = np.arange(len(loads))
    series = np.exp(-2j * np.pi * np.outer(n, np.arange(POINTS)) / POINTS) @ sums / POINTS
    return (series / RADIUS ** n[:, None]).real


def marched_errors(layer: list, loads: np.ndarray, dt: float, theta: float, eps: float) -> tuple[float, float]:
    """Relative L2 errors (traction, jump) of the interface law against the layer at the last step."""
    limit, full = (marched(layer, loads, dt, theta, thickness)[-1] for thickness in (None, eps))
    error = lambda part: float(np.linalg.norm(full[part] - limit[part]) / np.linalg.norm(limit[part]))
    return error(slice(2, 4)), error(slice(0, 2))
