"""Every law with time at points: tangents, energies of a step, rotations and plane strain are consistent."""

from __future__ import annotations

import numpy as np
import pytest

from forms import BulkLaw, KernelLaw, Stack
from tests.at_points import DT, material, respond, situation, tensor, vector
from tests.laws_at_points import (
    BALANCED,
    ELASTIC,
    EXACT,
    KELVIN,
    LAWS,
    LMBDA,
    MAXWELL,
    MAXWELL_2,
    MISES,
    MU,
    NORTON_3,
    NORTON_15,
    QUADRATIC,
    ROUNDING,
    THETAS,
)
from thinlayer.pointwise.kernels import SIZES


def memory_blocks(law: BulkLaw) -> list[int]:
    """Sizes of what is remembered: 1 a number, 3 a vector, 6 a symmetric tensor."""
    if isinstance(law, Stack) and len(law.laws) > 1:
        return [3] * len(law.laws) + [size for one in law.laws for size in memory_blocks(one)]
    return [6] * (law.memory // 6) if isinstance(law, KernelLaw) else [SIZES[shape] for shape in law.internal.values()]


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """Remainder of Taylor's expansion: second order, or rounding where the law is linear."""
    law = LAWS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    assert now.failed == 0
    direction = 0.1 * np.random.default_rng(1).normal(size=start.e.shape)
    left = []
    for h in (1e-2, 1e-3):
        moved = start.respond(law, theta, start.e + h * direction)
        left.append(np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max())
    size = np.abs(now.stress).max()
    if law.traits.linear:
        assert max(left) < EXACT * size
    else:
        assert left[1] > 100 * ROUNDING * size  # it is the law's curvature that is seen
        assert np.log10(left[0] / left[1]) > 1.95
    if law.traits.symmetric:
        assert now.tangent == pytest.approx(np.swapaxes(now.tangent, 1, 2), abs=EXACT * np.abs(now.tangent).max())


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", BALANCED)
def test_energy_of_a_step_is_accounted_for(name, theta):
    """stress : (e - e_old) = stored + dissipated + remainder; remainder > 0, or zero for the midpoint rule."""
    law = LAWS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    work = np.sum(now.stress * (start.e - start.e_old), axis=1)
    size = np.max(np.abs([work, now.stored, start.stored, now.dissipated, now.remainder]), axis=0)
    assert (np.abs(work - (now.stored - start.stored) - now.dissipated - now.remainder) < EXACT * size).all()
    assert (now.stored > 0).all()
    assert (now.dissipated >= -ROUNDING * size).all()
    if name in QUADRATIC:
        assert now.dissipated.max() > 1e-3 * size.max()
        assert (now.remainder > 0).all() if theta > 0.5 else (np.abs(now.remainder) < EXACT * size).all()


@pytest.mark.parametrize(("theta", "share"), [(1.0, 1.0), (0.7, 0.4), (0.5, 0.0)])
def test_remainder_is_the_energy_of_the_increments(theta, share):
    """(2 theta - 1) times the elastic energy of what the springs have been strained by in the step."""
    for law, springs in ((KELVIN, ELASTIC), (NORTON_15, ELASTIC), (NORTON_3, ELASTIC)):
        start = situation(law, theta)
        increment = start.e - start.e_old
        zero = np.zeros_like(increment)
        energy = respond(springs, increment, zero, np.zeros((len(zero), 0)), start.n).stored
        assert start.respond(law, theta).remainder == pytest.approx(share * energy, rel=EXACT)
    for law in (MAXWELL, MAXWELL_2):  # the spring carries the stress: complementary energy of its increment
        start = situation(law, theta)
        now = start.respond(law, theta)
        change = tensor(now.q - start.q)
        mean = np.trace(change, axis1=1, axis2=2) / 3
        dev = change - mean[:, None, None] * np.eye(3)
        energy = np.einsum("kij,kij->k", dev, dev) / (4 * MU) + mean**2 / (2 * (LMBDA + 2 * MU / 3))
        assert now.remainder == pytest.approx(share * energy, rel=1e-10, abs=ROUNDING)


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", LAWS)
def test_no_direction_is_preferred(name, theta):
    """When strains, memory and director turn, so do stress, tangent and memory."""
    law = LAWS[name]
    start = situation(law, theta)
    turn, triangle = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    turn = turn * np.sign(np.diag(triangle))
    turn = turn * np.sign(np.linalg.det(turn))

    def turned(a):
        if a.shape[-1] == 6:
            return vector(turn @ tensor(a) @ turn.T)
        return a @ turn.T if a.shape[-1] == 3 else a

    def memory(q):
        parts = np.split(q, np.cumsum(memory_blocks(law))[:-1], axis=1) if q.shape[1] else []
        return np.concatenate([np.empty((len(q), 0)), *map(turned, parts)], axis=1)

    def close(found, expected):
        return found == pytest.approx(expected, abs=1e-11 * np.abs(expected).max(initial=1e-300))

    now = start.respond(law, theta)
    found = respond(law, turned(start.e), turned(start.e_old), memory(start.q), turned(start.n), DT, theta)
    assert close(found.stress, turned(now.stress))
    assert close(found.q, memory(now.q))
    assert close(found.energies, now.energies)
    assert close(found.tangent, np.swapaxes(turned(np.swapaxes(turned(now.tangent), 1, 2)), 1, 2))


@pytest.mark.parametrize("name", ["Maxwell t1 != t2", "Norton 1.5", "user", "point", "three"])
def test_two_dimensions_are_the_same_law(name):
    """Plane strain: three components of strain, the others zero; the stress has all of them."""
    law, plane = LAWS[name], [0, 1, 3]
    random = np.random.default_rng(2)
    e, n = np.zeros((8, 6)), np.zeros((8, 3))
    e[:, plane], n[:, :2] = 0.1 * random.normal(size=(8, 3)), random.normal(size=(8, 2))
    n /= np.linalg.norm(n, axis=1)[:, None]
    q = np.zeros((8, material(law).memory))
    whole = respond(law, e, 0 * e, q, n)
    part = respond(law, e[:, plane], 0 * e[:, plane], q, n, slots=plane)
    assert part.stress == pytest.approx(whole.stress, rel=ROUNDING)
    assert part.tangent == pytest.approx(whole.tangent[:, plane][:, :, plane], rel=ROUNDING)
    assert part.q == pytest.approx(whole.q, rel=ROUNDING)
    assert part.energies == pytest.approx(whole.energies, rel=ROUNDING)


def test_a_point_law_yields_somewhere_and_not_everywhere():
    """The points of these tests see both branches."""
    for theta in THETAS:
        start = situation(MISES, theta)
        flow = np.abs(start.respond(MISES, theta).q - start.q).max(axis=1)
        assert 0 < np.count_nonzero(flow > 1e-3) < len(flow)
