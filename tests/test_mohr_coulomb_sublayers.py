"""Slip on planes parallel to S is penalised Coulomb; sublayers that yield share one traction."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional, Stack
from tests import closed_forms
from tests.at_points import E2, at_rest, jump_strain, material, respond, tensor, traction
from tests.mohr_coulomb_points import LAW, LAWS, LMBDA, MONO, MU, OMEGA, C, normals
from thinlayer.pointwise.drive import drive


@pytest.mark.parametrize("unilateral", [False, True])
def test_monodirectional_is_penalised_coulomb(unilateral):
    """Any path in 3D, in tension and compression."""
    law, random = MohrCoulombMonodirectional(LMBDA, MU, 1.0, OMEGA, unilateral=unilateral), np.random.default_rng(3)
    n, slip = np.array([1.0, 2.0, -2.0]) / 3, np.zeros(3)
    old, q = np.zeros((1, 3)), at_rest(law, 1)
    seen = set()
    for _ in range(40):
        w = old + 0.01 * random.normal(size=3)
        answer = respond(law, jump_strain(w, n[None]), jump_strain(old, n[None]), q, n[None])
        before = slip
        t, slip = closed_forms.penalised_coulomb(LMBDA, MU, 1.0, OMEGA, w[0], slip, n, unilateral=unilateral)
        assert traction(answer.stress, n[None])[0] == pytest.approx(t, abs=1e-12)
        assert tensor(answer.q[0, :6]) @ n == pytest.approx(slip / 2, abs=1e-15)
        seen.add((bool(np.abs(slip - before).max() > 1e-9), bool(w[0] @ n > 0)))
        old, q = w, answer.q
    assert len(seen) == (4 if unilateral else 3)  # bilateral, nothing sticks in tension


def test_elastic_and_monodirectional_sublayers():
    """t = K (w - w^p), the threshold on the common traction."""
    above = LinearElastic(100.0, 15.0)
    law, random, n = Stack((0.3, above), (0.7, MONO)), np.random.default_rng(3), np.array([0.6, 0.8])
    stiffnesses = [closed_forms.elastic_stiffness(part.lmbda, part.mu, n) for part in (above, MONO)]
    w, slip, path, expected, slips = np.zeros(2), np.zeros(2), [], [], 0
    tangent = np.array([n[1], -n[0]])
    for _ in range(20):
        w = w + 0.01 * random.normal(size=2) - (w @ n) * n - 0.002 * n
        before = slip
        t, slip = closed_forms.stratified_coulomb(law.fractions, stiffnesses, C, OMEGA, w, slip, n)
        slips += bool(np.abs(slip - before).max() > 1e-9)
        path.append({"w_T": w @ tangent, "w_N": w @ n})
        expected.append([t @ tangent, t @ n])
    history = drive(law, path, n=n)
    assert 3 < slips < 20
    assert history.tractions == pytest.approx(np.array(expected), rel=1e-8, abs=1e-10)


PAIRS = {
    "full, unilateral": (LAW, LAWS["unilateral"]),
    "full, full": (LAW, MohrCoulomb(120.0, 80.0, 0.1, 45.0)),
    "equal": (LAWS["psi = 12"], LAWS["psi = 12"]),
}


@pytest.mark.parametrize("name", PAIRS)
def test_shares_of_sublayers_that_yield(name):
    """Whatever happens, tractions are equal and the shares add up to nothing; they do not run away."""
    laws, fractions, points, random = PAIRS[name], np.array([0.3, 0.7]), 200, np.random.default_rng(1)
    law, n = Stack(*zip(fractions, laws, strict=True)), normals(points)
    q, e, failed = at_rest(law, points), np.zeros((points, 6)), 0
    for _ in range(8):
        new = e + jump_strain(0.003 * random.normal(size=(points, 3)) - 0.002 * E2, n)
        answer = respond(law, new, e, q, n)
        done = ~np.isnan(answer.stress[:, 0])
        failed += answer.failed
        shares, old = (memory[:, :6].reshape(points, 2, 3) for memory in (answer.q, q))
        assert np.abs(shares[done]).max() < 1.0
        assert np.einsum("i,kij->kj", fractions, shares[done]) == pytest.approx(0, abs=1e-14)
        first, tractions = 6, []
        for i, sublayer in enumerate(laws):
            memory = q[:, first : first + material(sublayer).memory_size]
            first += memory.shape[1]
            ends = new + jump_strain(shares[:, i], n), e + jump_strain(old[:, i], n)
            tractions.append(traction(respond(sublayer, *ends, memory, n).stress, n)[done])
        tractions = np.array(tractions)
        assert np.abs(tractions - tractions[0]).max() < 1e-7 * np.abs(tractions).max()
        if name == "equal":  # the law itself
            alone = respond(laws[0], new, e, q[:, 6:13], n).stress[done]
            assert answer.stress[done] == pytest.approx(alone, abs=1e-9 * np.abs(alone).max())
        q, e = np.where(done[:, None], answer.q, q), np.where(done[:, None], new, e)
    assert failed < 0.1 * 8 * points
