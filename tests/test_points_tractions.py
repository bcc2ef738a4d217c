"""The paper's interface laws are the tractions of laws at points; what it prints otherwise is another law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from forms import Norton
from tests import closed_forms
from tests.at_points import DT, E2, jump_strain, material, respond, tensor, traction, vector
from tests.laws_at_points import ELASTIC, EXACT, K_N, K_T, KELVIN, LAWS, LMBDA, MAXWELL, MAXWELL_2, MU, THETAS


@pytest.fixture(scope="module")
def jumps():
    """Jumps before and after a step, and normals."""
    random = np.random.default_rng(11)
    n = random.normal(size=(10, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    w_old = 0.1 * random.normal(size=n.shape)
    return w_old, w_old + 0.1 * random.normal(size=n.shape), n


def traction_of(law, jumps, theta=1.0, dt=DT):
    w_old, w, n = jumps
    q = np.zeros((len(n), material(law).memory))
    return traction(respond(law, jump_strain(w, n), jump_strain(w_old, n), q, n, dt, theta).stress, n)


@pytest.mark.parametrize("theta", THETAS)
def test_kelvin_voigt_traction(jumps, theta):
    """Eq. (17)."""
    w_old, w, n = jumps
    mid, rate = theta * w + (1 - theta) * w_old, (w - w_old) / DT
    expected = [closed_forms.kelvin_voigt(LMBDA, MU, 0.3, 0.5, *one) for one in zip(mid, rate, n, strict=True)]
    assert traction_of(KELVIN, jumps, theta) == pytest.approx(np.array(expected), rel=EXACT)


@pytest.mark.parametrize("p", [1.1, 1.5, 2.0, 3.0, 4.5])
@pytest.mark.parametrize("theta", THETAS)
def test_norton_traction(jumps, theta, p):
    """Eq. (22) with the modulus of the symmetrised product, 1 and 1/2."""
    w_old, w, n = jumps
    mid, rate = theta * w + (1 - theta) * w_old, (w - w_old) / DT
    expected = [closed_forms.norton(LMBDA, MU, 5.0, p, *one) for one in zip(mid, rate, n, strict=True)]
    assert traction_of(Norton(LMBDA, MU, 5.0, p), jumps, theta) == pytest.approx(np.array(expected), rel=EXACT)


@pytest.mark.parametrize("p", [1.5, 3.0])
def test_norton_as_printed_is_another_law(jumps, p):
    """Without the 1/2, or with the bars around the rate alone; both show only where the layer is sheared."""
    w_old, w, n = jumps
    v = (w - w_old) / DT
    v_N = np.einsum("ki,ki->k", v, n)[:, None] * n
    v_T = v - v_N
    modulus = np.sqrt(np.sum(v_N**2, axis=1) + np.sum(v_T**2, axis=1) / 2)[:, None]
    viscous = traction_of(Norton(LMBDA, MU, 5.0, p), jumps) - traction_of(ELASTIC, jumps)
    without_half = 5.0 * modulus ** (p - 2) * (v_N + v_T)
    bars_around_rate = 5.0 * np.linalg.norm(v, axis=1)[:, None] ** (p - 2) * (v_N + v_T / 2)
    right = 5.0 * modulus ** (p - 2) * (v_N + v_T / 2)
    size = np.linalg.norm(right)
    assert np.linalg.norm(viscous - right) < EXACT * size
    assert np.linalg.norm(viscous - without_half) > 0.2 * size
    assert np.linalg.norm(viscous - bars_around_rate) > 0.1 * size


def test_maxwell_answers_at_once_with_the_elastic_stiffness(jumps):
    """Sudden load: the coefficients of Eq. (19) corrected. The printed ones are 2 mu and a negative normal stiffness."""
    _, w, n = jumps
    sudden = (0 * w, w, n)
    for law in (MAXWELL, MAXWELL_2):
        assert traction_of(law, sudden, dt=0.0) == pytest.approx(traction_of(ELASTIC, sudden), rel=EXACT)
    nu = LMBDA / (2 * (LMBDA + MU))
    E = 2 * MU * (1 + nu)
    printed_T, printed_N = E / (1 + nu), -E * nu / (1 - nu)
    t = traction_of(MAXWELL, (0 * w, w, n), dt=0.0)
    t_N, w_N = np.einsum("ki,ki->k", t, n), np.einsum("ki,ki->k", w, n)
    stiffness_N = t_N / w_N
    stiffness_T = np.linalg.norm(t - t_N[:, None] * n, axis=1) / np.linalg.norm(w - w_N[:, None] * n, axis=1)
    assert stiffness_N == pytest.approx(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), rel=EXACT)
    assert stiffness_T == pytest.approx(E / (2 * (1 + nu)), rel=EXACT)
    assert (np.abs(stiffness_N - printed_N) > K_N).all()
    assert (np.abs(stiffness_T - printed_T) > 0.9 * K_T).all()


@pytest.mark.parametrize("theta", [1.0, 0.7, 0.5])
def test_maxwell_rate_form(jumps, theta):
    """t1 = t2: (t - t_old)/dt + t_mid/t1 = K_L d[u]/dt, the end value of t being what is remembered."""
    w_old, w, n = jumps
    q = np.zeros((len(n), 6))
    first = respond(MAXWELL, jump_strain(w_old, n), np.zeros((len(n), 6)), q, n, 0.0, 1.0)
    then = respond(MAXWELL, jump_strain(w, n), jump_strain(w_old, n), first.q, n, DT, theta)
    t_old, t_mid, t = (traction(s, n) for s in (first.q, then.stress, then.q))
    elastic = np.array([closed_forms.elastic(LMBDA, MU, *one) for one in zip(w - w_old, n, strict=True)])
    assert (t - t_old) / DT + t_mid / 0.7 == pytest.approx(elastic / DT, rel=1e-11)


def test_maxwell_with_two_times_is_no_equation_of_first_order():
    """The best single exponential misses the relaxation of the normal traction; two relaxing parts do not."""
    t = np.linspace(0.0, 3.0, 301)
    w = np.zeros((1, 3)) + 0.02 * E2
    n, e = E2[None], jump_strain(w, E2[None])
    answer = respond(MAXWELL_2, e, 0 * e, np.zeros((1, 6)), n, 0.0, 1.0)
    found = [answer.q[0, 1]]
    for dt in np.diff(t):
        answer = respond(MAXWELL_2, e, e, answer.q, n, dt, 0.5)
        found.append(answer.q[0, 1])
    expected = closed_forms.maxwell_normal_relaxation(LMBDA, MU, 0.7, 1.5, 0.02, t)
    assert found == pytest.approx(expected, rel=1e-3)

    def worst(rate):
        return np.abs(K_N * 0.02 * np.exp(-rate * t) / expected - 1).max()

    assert minimize_scalar(worst, bounds=(0.5, 5.0), method="bounded").fun > 0.1
    shear = jump_strain(np.array([[0.02, 0.0, 0.0]]), n)
    held = respond(MAXWELL_2, shear, shear, vector(2 * MU * tensor(shear)), n, DT, 1.0)
    assert held.stress == pytest.approx(2 * MU * shear / (1 + DT / 0.7), rel=EXACT)  # shear: t1 alone


def test_traction_law_is_the_traction(jumps):
    """Its stress has the traction on n, and does its work in the strain of every jump."""
    w_old, w, n = jumps
    law = LAWS["traction"]
    e, old = jump_strain(w, n), jump_strain(w_old, n)
    q = 0.01 * np.random.default_rng(8).normal(size=(len(n), 4))
    slip = q[:, :3] = q[:, :3] - np.einsum("ki,ki->k", q[:, :3], n)[:, None] * n
    answer = respond(law, e, old, q, n, DT, 1.0)
    t, w_N = traction(answer.stress, n), np.einsum("ki,ki->k", w, n)[:, None]
    x = DT * law.k_T / law.viscosity
    new_slip = (slip + x * (w - w_N * n)) / (1 + x)
    assert t == pytest.approx((law.k_N * w_N - law.closed * w_N**2) * n + law.k_T * (w - w_N * n - new_slip), rel=EXACT)
    assert answer.q[:, :3] == pytest.approx(new_slip, rel=EXACT)
    assert answer.q[:, 3] - q[:, 3] == pytest.approx(np.sum((w - w_old) ** 2, axis=1), rel=EXACT)
    v = np.random.default_rng(9).normal(size=w.shape)
    assert np.sum(answer.stress * jump_strain(v, n), axis=1) == pytest.approx(np.sum(t * v, axis=1), rel=1e-11)
