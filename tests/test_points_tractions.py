"""The paper's interface laws are the tractions of laws at points; what it prints otherwise is another law."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Norton
from tests import closed_forms
from tests.at_points import DT, jump_strain, material, respond, traction
from tests.laws_at_points import ELASTIC, EXACT, KELVIN, LAWS, LMBDA, MAXWELL, MU, THETAS


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
    q = np.zeros((len(n), material(law).memory_size))
    return traction(respond(law, jump_strain(w, n), jump_strain(w_old, n), q, n, dt, theta).stress, n)


@pytest.mark.parametrize("p", [None, 1.1, 1.5, 2.0, 3.0, 4.5])
@pytest.mark.parametrize("theta", THETAS)
def test_kelvin_voigt_and_norton_traction(jumps, theta, p):
    """Eq. (17); Eq. (22) with the modulus of the symmetrised product, 1 and 1/2."""
    w_old, w, n = jumps
    mid, rate = theta * w + (1 - theta) * w_old, (w - w_old) / DT
    law = Norton(LMBDA, MU, 5.0, p) if p else KELVIN
    parameters = (5.0, p) if p else (0.3, 0.5)
    closed = closed_forms.norton if p else closed_forms.kelvin_voigt
    expected = [closed(LMBDA, MU, *parameters, *sample) for sample in zip(mid, rate, n, strict=True)]
    assert traction_of(law, jumps, theta) == pytest.approx(np.array(expected), rel=EXACT)


@pytest.mark.parametrize("theta", [1.0, 0.7])
def test_maxwell_rate_form(jumps, theta):
    """t1 = t2: (t - t_old)/dt + t_mid/t1 = K_L d[u]/dt, the end value of t being what is remembered.

    A sudden load has the elastic stiffness, not that of the coefficients of Eq. (19).
    """
    w_old, w, n = jumps
    q = np.zeros((len(n), 6))
    first = respond(MAXWELL, jump_strain(w_old, n), np.zeros((len(n), 6)), q, n, 0.0, 1.0)
    then = respond(MAXWELL, jump_strain(w, n), jump_strain(w_old, n), first.q, n, DT, theta)
    t_old, t_mid, t = (traction(s, n) for s in (first.q, then.stress, then.q))
    assert first.stress == pytest.approx(respond(ELASTIC, jump_strain(w_old, n), 0 * q, q[:, :0], n).stress, rel=EXACT)
    elastic = np.array([closed_forms.elastic(LMBDA, MU, *sample) for sample in zip(w - w_old, n, strict=True)])
    assert (t - t_old) / DT + t_mid / 0.7 == pytest.approx(elastic / DT, rel=1e-11)


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
