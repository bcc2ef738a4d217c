"""Sublayers in series share the traction, add up jumps and energies, and find their shares for steps of any size."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, Norton, Stack
from tests.at_points import DT, E2, jump_strain, material, respond, situation, traction
from tests.laws_at_points import (
    EXACT,
    KELVIN,
    LAWS,
    LMBDA,
    MAXWELL,
    MISES,
    MU,
    NORTON_3,
    NORTON_15,
    STACKS,
    STIFF,
)


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5", "user"])
def test_sublayers_of_one_law_are_that_law(name, theta):
    law = LAWS[name]
    now = situation(law, theta).respond(law, theta)
    alone = situation(Stack((1.0, law)), theta).respond(Stack((1.0, law)), theta)
    assert np.array_equal(alone.stress, now.stress)
    assert np.array_equal(alone.tangent, now.tangent)
    for fractions in ((0.5, 0.5), (0.1, 0.7, 0.2)):
        stack = Stack(*((a, law) for a in fractions))
        response = situation(stack, theta).respond(stack, theta)
        assert response.stress == pytest.approx(now.stress, abs=EXACT * np.abs(now.stress).max())
        assert response.tangent == pytest.approx(now.tangent, abs=1e-11 * np.abs(now.tangent).max())
        assert response.energies == pytest.approx(now.energies, abs=EXACT * np.abs(now.energies).max())
        assert np.abs(response.q[:, : 3 * len(fractions)]).max() < 1e-13


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", STACKS)
def test_sublayers_share_traction_and_add_up_jumps(name, theta):
    """Each law run by itself with its share of the jump: equal tractions; shares cancel; stresses and energies average."""
    law = STACKS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    count, at = len(law.laws), 3 * len(law.laws)
    shares = [q[:, 3 * i : 3 * i + 3] for q in (start.q, now.q) for i in range(count)]
    old, new = shares[:count], shares[count:]
    assert sum(a * g for a, g in zip(law.fractions, new, strict=True)) == pytest.approx(0.0, abs=EXACT)
    mean, energies, tractions = 0.0, 0.0, []
    for (a, sublayer_law), g_old, g in zip(law.sublayers, old, new, strict=True):
        memory = material(sublayer_law).memory_size
        e, e_old = start.e + jump_strain(g, start.n), start.e_old + jump_strain(g_old, start.n)
        part = respond(sublayer_law, e, e_old, start.q[:, at : at + memory], start.n, DT, theta)
        assert now.q[:, at : at + memory] == pytest.approx(part.q, abs=1e-12)
        mean, energies = mean + a * part.stress, energies + a * part.energies
        tractions.append(traction(part.stress, start.n))
        at += memory
    size = np.abs(now.stress).max()
    for t in tractions[1:]:
        assert t == pytest.approx(tractions[0], abs=1e-11 * size)
    assert now.stress == pytest.approx(mean, abs=1e-11 * size)
    assert now.energies == pytest.approx(energies, abs=1e-11 * np.abs(energies).max())


def test_elastic_sublayer_over_a_plastic_one_carries_its_limit():
    """The common traction is bounded by the plastic sublayer, the jump goes on in it."""
    law = STACKS["elastic, plastic"]
    t_T = MISES.strength / 3**0.5
    e, q, tractions = np.zeros((1, 6)), np.zeros((1, material(law).memory_size)), []
    for w in np.linspace(0.0, 1.0, 21)[1:]:
        old, e = e, jump_strain(np.array([[w, 0, 0]]), E2[None])
        answer = respond(law, e, old, q, E2[None])
        q = answer.q
        tractions.append(traction(answer.stress, E2[None])[0, 0])
    K = 1 / (0.4 / STIFF.mu + 0.6 / MISES.mu)
    assert tractions == pytest.approx(np.minimum(K * np.linspace(0.0, 1.0, 21)[1:], t_T), rel=1e-9)
    assert q[0, 0] == pytest.approx(t_T / STIFF.mu - 1.0, rel=1e-9)  # share of the elastic sublayer beyond the jump


def test_elastic_sublayers_return_to_zero():
    """Of a strain that ends at zero shares are rounding, which gets smaller from iteration to iteration."""
    random, law = np.random.default_rng(3), Stack((0.3, LinearElastic(7.0, 3.0)), (0.7, STIFF))
    e, n = random.normal(size=(200, 6)) * 10 ** random.uniform(-6, 0, (200, 1)), random.normal(size=(200, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    there = respond(law, e, 0 * e, np.zeros((200, material(law).memory_size)), n)
    back = respond(law, 0 * e, e, there.q, n)
    assert (there.failed, back.failed) == (0, 0)
    assert np.abs(back.stress).max() < 1e-14


SHARING = [(MAXWELL, NORTON_15), (MAXWELL, Norton(LMBDA, MU, 5.0, 1.2)), (KELVIN, MAXWELL, NORTON_15, NORTON_3, MISES)]


@pytest.mark.parametrize("laws", SHARING)
def test_a_stack_finds_its_shares_for_steps_of_any_size(laws):
    """Jumps and steps over powers of ten: dashpots that are almost rigid, sublayers far beyond yield.

    Where it says that it has found them, the tractions are equal: the work of the step is the sublayers' energies, to
    1e-3 (a dashpot with p = 1.2 that hardly moves magnifies the rounding of its strain by 1e10).
    """
    law = Stack(*((1 / len(laws), sublayer_law) for sublayer_law in laws))
    random, failed, wrong = np.random.default_rng(0), {}, {}
    for size in (1e-6, 1e-4, 1e-2, 1.0):
        for dt in (1e-3, 1e-1, 10.0):
            n = random.normal(size=(20, 3))
            n /= np.linalg.norm(n, axis=1)[:, None]
            e, q, stored = np.zeros((20, 6)), np.zeros((20, material(law).memory_size)), np.zeros(20)
            for _ in range(3):
                old, e = e, e + size * jump_strain(random.normal(size=n.shape), n)
                answer = respond(law, e, old, q, n, dt)
                if answer.failed:
                    failed[size, dt] = answer.failed
                    break
                work = np.sum(answer.stress * (e - old), axis=1)
                left = work - (answer.stored - stored) - answer.dissipated - answer.remainder
                scale = np.max(np.abs([answer.stored, answer.dissipated, answer.remainder, stored]), axis=0)
                if (np.abs(left) > 1e-3 * scale).any():
                    wrong[size, dt] = np.abs(left / scale).max()
                q, stored = answer.q, answer.stored
    assert (failed, wrong) == ({}, {})
