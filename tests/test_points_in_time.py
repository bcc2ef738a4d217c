"""Creep and relaxation of a layer at a point tend to closed forms in time, with the order of the time scheme."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from forms import limits
from tests.at_points import E2, jump_strain, material, respond
from tests.laws_at_points import EXACT, K_N, K_T, KELVIN, LMBDA, MAXWELL, MAXWELL_2, MU, NORTON_3, NORTON_15, SERIES


def follow(law, direction, load, *, end, steps, theta, compliance=None):
    """Jumps along a direction under a traction held from t = 0, or of an end of a body (compliance) moved and held.

    Laws with a rate start at rest, with two steps of backward Euler instead of one of any other; the others at once.
    """
    n, a = E2[None], np.asarray(direction, float)
    q, x = np.zeros((1, material(law).memory)), 0.0
    lengths = [(end / steps, theta)] * steps
    if not law.traits.rate:
        lengths = [(0.0, 1.0), *lengths]
    elif theta < 1:
        lengths = [(end / steps / 2, 1.0)] * 2 + lengths[1:]
    strain = lambda x: jump_strain(x * a[None], n)
    one = strain(1.0)[0]
    for dt, th in lengths:
        new = x
        for _ in range(100):
            answer = respond(law, strain(new), strain(x), q, n, dt, th)
            wanted, softer = load, 0.0
            if compliance:
                wanted, softer = (load - th * new - (1 - th) * x) / compliance, th / compliance
            step = (wanted - answer.stress[0] @ one) / (one @ answer.tangent[0] @ one + softer)
            new += step
            if abs(step) < 1e-13 * abs(new):
                break
        answer = respond(law, strain(new), strain(x), q, n, dt, th)
        assert answer.failed == 0
        q, x = answer.q, new
    return x


NORMAL, SHEAR = (0, 1, 0), (1, 0, 0)
C_N, C_T = 0.2 / 26.923076923076923, 0.026  # of two bodies 0.5 high with E = 100, nu = 0.3, roller sides
G_N, G_T = LMBDA * 0.3 + 2 * MU * 0.5, MU * 0.5


def series_creep(load, K, G):
    def at(t):
        parts = [limits.maxwell_creep(load, K, 0.7, t), limits.kelvin_voigt_creep(load, K, G, t), load / K]
        return limits.stack_creep(SERIES.fractions, parts)

    return at


CLOSED = {  # law, direction, load, end, compliance, jump(t)
    "Kelvin-Voigt creep N": (KELVIN, NORMAL, 1.0, 1.0, None, lambda t: limits.kelvin_voigt_creep(1.0, K_N, G_N, t)),
    "Kelvin-Voigt creep T": (KELVIN, SHEAR, 0.5, 1.0, None, lambda t: limits.kelvin_voigt_creep(0.5, K_T, G_T, t)),
    "Kelvin-Voigt moved N": (
        KELVIN, NORMAL, 0.02, 0.5, C_N, lambda t: limits.kelvin_voigt_displaced(0.02, K_N, G_N, C_N, t)
    ),
    "Kelvin-Voigt moved T": (
        KELVIN, SHEAR, 0.05, 0.5, C_T, lambda t: limits.kelvin_voigt_displaced(0.05, K_T, G_T, C_T, t)
    ),
    "Maxwell creep N": (MAXWELL, NORMAL, 1.0, 1.0, None, lambda t: limits.maxwell_creep(1.0, K_N, 0.7, t)),
    "Maxwell creep T": (MAXWELL, SHEAR, 0.5, 1.0, None, lambda t: limits.maxwell_creep(0.5, K_T, 0.7, t)),
    "Maxwell moved N": (
        MAXWELL, NORMAL, 0.02, 1.0, C_N, lambda t: 0.02 - C_N * limits.maxwell_relaxation(0.02, K_N, C_N, 0.7, t)
    ),
    "Maxwell moved T": (
        MAXWELL, SHEAR, 0.05, 1.0, C_T, lambda t: 0.05 - C_T * limits.maxwell_relaxation(0.05, K_T, C_T, 0.7, t)
    ),
    "Maxwell t1 != t2 creep N": (
        MAXWELL_2, NORMAL, 1.0, 1.0, None, lambda t: limits.maxwell_normal_creep(LMBDA, MU, 0.7, 1.5, 1.0, t)
    ),
    "Maxwell t1 != t2 moved T": (
        MAXWELL_2, SHEAR, 0.05, 1.0, C_T, lambda t: 0.05 - C_T * limits.maxwell_relaxation(0.05, K_T, C_T, 0.7, t)
    ),
    "Norton 1.5 creep N": (
        NORTON_15, NORMAL, 1.0, 0.5, None, lambda t: limits.norton_creep(1.0, K_N, 5.0, 1.5, t, shear=False)
    ),
    "Norton 1.5 creep T": (
        NORTON_15, SHEAR, 0.5, 0.5, None, lambda t: limits.norton_creep(0.5, K_T, 5.0, 1.5, t, shear=True)
    ),
    "Norton 3 creep N": (
        NORTON_3, NORMAL, 1.0, 0.02, None, lambda t: limits.norton_creep(1.0, K_N, 5.0, 3.0, t, shear=False)
    ),
    "Norton 3 creep T": (
        NORTON_3, SHEAR, 0.5, 0.02, None, lambda t: limits.norton_creep(0.5, K_T, 5.0, 3.0, t, shear=True)
    ),
    "stack creep N": (SERIES, NORMAL, 1.0, 1.0, None, series_creep(1.0, K_N, G_N)),
    "stack creep T": (SERIES, SHEAR, 0.5, 1.0, None, series_creep(0.5, K_T, G_T)),
}  # fmt: skip


@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
@pytest.mark.parametrize("name", CLOSED)
def test_order_in_time(name, theta, order):
    """Backward Euler is of order 1, the midpoint rule of order 2; a Maxwell layer under constant traction is exact."""
    law, direction, load, end, compliance, closed = CLOSED[name]
    expected = float(closed(end))
    found = [
        follow(law, direction, load, end=end, steps=steps, theta=theta, compliance=compliance)
        for steps in (20, 40, 80, 160)
    ]
    errors = np.abs(np.array(found) / expected - 1)
    assert errors[-1] < (2e-2 if order == 1 else 2e-4)
    if name in ("Maxwell creep N", "Maxwell creep T"):
        assert errors.max() < 1e-11
    else:
        assert [np.log2(a / b) for a, b in pairwise(errors)][-1] == pytest.approx(order, abs=0.06)


def test_norton_above_two_comes_to_rest_in_finite_time():
    """p = 3: the end of the closed form is the elastic jump, reached and kept."""
    stop = 2 * (0.5 * 5.0 * 2**-1.5) ** 0.5 / K_T
    assert limits.norton_creep(0.5, K_T, 5.0, 3.0, 0.999 * stop, shear=True) < 0.5 / K_T
    assert limits.norton_creep(0.5, K_T, 5.0, 3.0, 1.001 * stop, shear=True) == pytest.approx(0.5 / K_T, rel=EXACT)
    assert follow(NORTON_3, SHEAR, 0.5, end=2 * stop, steps=200, theta=1.0) == pytest.approx(0.5 / K_T, rel=1e-3)


def test_closed_forms_have_the_reference_numbers():
    """Values of the closed forms at t = 1, evaluated with independent code."""
    numbers = {
        "Kelvin-Voigt creep N": 0.00650374813452,
        "Kelvin-Voigt creep T": 0.0108083089595,
        "Maxwell moved N": 0.02 - C_N * 0.681396777691,
        "Maxwell moved T": 0.05 - C_T * 0.486711984065,
        "Norton 1.5 creep T": 0.00866886620207,
    }
    for name, number in numbers.items():
        assert CLOSED[name][-1](1.0) == pytest.approx(number, rel=1e-11), name
