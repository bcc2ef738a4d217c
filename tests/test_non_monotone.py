"""The energy of a mixture of phases is the least of all laminates; gain, stress and convexity follow from it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from forms import NonMonotone
from forms.non_monotone import lamination_gain
from tests.at_points import E2, jump_strain, tensor, traction, vector
from tests.non_monotone_points import (
    ACROSS,
    ALONG,
    ALPHA,
    CHIS,
    LMBDA,
    MU,
    RELAXED,
    C,
    at,
    density,
    drives,
    jumps_and_normals,
    lifted,
    random_strains,
)

pytestmark = pytest.mark.few(5)


# ---------------------------------------------------------------- the gain of laminates
def gains(lmbda, mu, chi, angles):
    """(chi k).A(k)^-1 (chi k) for directions k of given angles (n,) or (n, 2)."""
    if len(chi) == 2:
        k = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    else:
        a, b = angles[..., 0], angles[..., 1]
        k = np.stack([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)], axis=-1)
    v = k @ chi
    inverse = (np.eye(len(chi)) - (lmbda + mu) / (lmbda + 2 * mu) * k[..., :, None] * k[..., None, :]) / mu
    return np.einsum("...i,...ij,...j", v, inverse, v)


@pytest.mark.parametrize("d", [2, 3])
def test_gain_where_it_is_known(d):
    """n (x) n: the best direction is oblique for lmbda > 0, and n for lmbda <= 0; with a tangent it is n, always."""
    across, along = (lifted(a)[:d, :d] for a in (ACROSS, ALONG))
    assert lamination_gain(60.0, 40.0, across) == pytest.approx(0.00875, rel=1e-14)
    at_n = np.array([np.pi / 2] if d == 2 else [[np.pi / 2, np.pi / 2]])
    assert gains(60.0, 40.0, across, at_n)[0] == pytest.approx(1 / 140, rel=1e-14)
    for lmbda in (-20.0, 0.0):
        assert lamination_gain(lmbda, 40.0, across) == pytest.approx(1 / (lmbda + 80), rel=1e-14)
    for lmbda in (-20.0, 0.0, 60.0, 3e3):
        assert lamination_gain(lmbda, 40.0, along) == pytest.approx(1 / (4 * 40), rel=1e-14)
        assert lamination_gain(lmbda, 40.0, np.eye(d)) == pytest.approx(1 / (lmbda + 80), rel=1e-14)


# ---------------------------------------------------------------- energy
def least_of_laminates(e, chi, pair, random, starts=4):
    """Least mean energy of sheets of two phases across k, with strains e - th sym(a (x) k), e + (1 - th) sym(a (x) k).

    The mean is quadratic in a, whose best value is found from differences; th and k are searched for.
    """
    d = len(chi)
    unit = 0.02 * np.eye(d)
    pairs = (unit[:, None] + unit[None]).reshape(-1, d)

    def mean(th, a, k):
        S = np.einsum("ni,j->nij", lifted(a), k)
        S = (S + np.swapaxes(S, 1, 2)) / 2
        return (1 - th) * density(e - th * S, pair[0], chi) + th * density(e + (1 - th) * S, pair[1], chi)

    def least(x):
        th, angles = x[0], [x[1], np.pi / 2 if d == 2 else x[-1]]
        k = np.array([np.cos(angles[0]) * np.sin(angles[1]), np.sin(angles[0]) * np.sin(angles[1]), np.cos(angles[1])])
        values = mean(th, np.concatenate([0 * unit[:1], unit, pairs]), k)
        f0, f1 = values[0], values[1 : 1 + d]
        second = values[1 + d :].reshape(d, d) - f1[:, None] - f1[None] + f0
        best = -np.linalg.solve(second, f1 - f0 - np.diag(second) / 2) @ unit
        return 1e2 * mean(th, best[None], k)[0]

    bounds = [(1e-4, 1 - 1e-4)] + [(None, None)] * (d - 1)
    minima = [
        minimize(least, [0.5, *random.uniform(0, np.pi, d - 1)], method="L-BFGS-B", bounds=bounds, tol=1e-14).fun
        for _ in range(starts)
    ]
    return min(min(minima) / 1e2, *(density(e, z, chi) for z in pair))


@pytest.mark.few(5)
@pytest.mark.parametrize("name", ["2D", "3D", "n (x) n"])
def test_energy_is_the_least_of_all_laminates(name):
    """Of phases 0 and 1, 0 and -1; those of -1 and 1 have none that is lower. Another gain is not the least."""
    law, random = RELAXED[name], np.random.default_rng(3)
    e = random_strains(law, 6)
    chi, g = lifted(law.chi), ALPHA**2 * law.G
    wanted = np.array([1, -1, 1, -1, 1, -1]) * (C + g * np.array([-0.4, -0.1, 0.3, 0.45, -0.52, 0.6]))
    e += vector(((wanted - drives(law, e)) / (ALPHA * np.sum(chi**2)))[:, None, None] * chi)
    answer = at(law, e)
    assert answer.q[:, 0] == pytest.approx([0.1, -0.4, 0.8, -0.95, 0, -1], abs=1e-12)
    for strain, energy, m in zip(tensor(e), answer.stored, wanted, strict=True):
        assert energy == pytest.approx(least_of_laminates(strain, law.chi, (0, np.sign(m)), random), rel=1e-9)
        assert least_of_laminates(strain, law.chi, (-1, 1), random, 1) > energy * (1 - 1e-9)
    assert (at(law.with_parameters({"mixing": 0.8}), e).stored[:3] > answer.stored[:3] * (1 + 1e-4)).all()


@pytest.mark.few(1)
@pytest.mark.parametrize("least", [False, True], ids=["C", "C = g/2"])
@pytest.mark.parametrize("name", CHIS)
def test_energy_is_convex_along_every_jump(name, least):
    """Strains that differ by sym(a (x) k), for any k: rank-one convex, which is what laminates leave."""
    law = RELAXED[name]
    if least:
        law = NonMonotone(LMBDA, MU, ALPHA, ALPHA**2 * law.G / 2, law.chi)
    e, (a, k) = random_strains(law, 3000), jumps_and_normals(law, 3000)
    change = jump_strain(a, k)
    ends, middle = at(law, e - change).stored + at(law, e + change).stored, at(law, e).stored
    assert (ends - 2 * middle).min() > -1e-13 * ends.max()
    pull = np.sum((at(law, e + change).stress - at(law, e).stress) * change, axis=1)
    assert pull.min() > -1e-13 * np.abs(pull).max()


def test_what_is_not_convex():
    """Smaller gains along the best direction; and along strains that are no jumps, the relaxed energy itself."""
    along = jump_strain(np.array([[1.0, 0.0, 0.0]]), E2[None]) * np.linspace(0, 0.05, 41)[:, None]
    for mixing, monotone in ((1.0, True), (0.98, False)):
        law = NonMonotone(LMBDA, MU, ALPHA, C, ALONG, mixing=mixing)
        t = traction(at(law, along).stress, np.broadcast_to(E2, (41, 3)))[:, 0]
        assert (np.diff(t).min() > -1e-12) == monotone
        assert law.traits.softens == (not monotone)
    swelling = NonMonotone(LMBDA, MU, ALPHA, C, np.eye(2))
    e = np.linspace(0, 2 * C / ALPHA, 101)[:, None] * np.array([0.5, 0.5, 0, 0, 0, 0])
    assert np.diff(at(swelling, e).stored, 2).min() < -1e-6
