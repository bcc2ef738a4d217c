"""Every law with time at points: tangents, energies of a step and rotations are consistent."""

from __future__ import annotations

import numpy as np
import pytest

from forms import BulkLaw, KernelLaw, Stack
from forms.traits import VARIABLE_SIZES
from tests.at_points import DT, respond, situation, tensor, vector
from tests.laws_at_points import BALANCED, EXACT, LAWS, QUADRATIC, ROUNDING, THETAS
from tests.mohr_coulomb_points import LAWS as MOHR_COULOMB
from tests.mohr_coulomb_points import METALS, SOILS

YIELDING = METALS | SOILS | {f"Mohr-Coulomb, {name}": law for name, law in MOHR_COULOMB.items()}
ALL = LAWS | YIELDING


def begun(name, theta):
    """Points in the middle of a history; where they yield there are many, as some pass a kink."""
    small = {"points": 300, "size": 0.006, "pressed": 0.003} if name in YIELDING else {}
    return ALL[name], situation(ALL[name], theta, **small)


def memory_blocks(law: BulkLaw) -> list[int]:
    """Sizes of what is remembered: 1 a number, 3 a vector, 6 a symmetric tensor."""
    if isinstance(law, Stack) and len(law.laws) > 1:
        return [3] * len(law.laws) + [size for sublayer in law.laws for size in memory_blocks(sublayer)]
    if isinstance(law, KernelLaw):
        return [6] * (law.memory // 6) + [1] * (law.memory % 6)
    return [VARIABLE_SIZES[shape] for shape in law.internal.values()]


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", ALL)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """Remainder of Taylor's expansion at each point: second order, or rounding where the law is linear."""
    law, start = begun(name, theta)
    now = start.respond(law, theta)
    assert now.failed == 0
    direction = np.abs(start.e - start.e_old).mean() * np.random.default_rng(1).normal(size=start.e.shape)
    left = []
    for h in (1e-2, 1e-3):
        moved = start.respond(law, theta, start.e + h * direction)
        left.append(np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max(axis=1))
    size = np.abs(now.stress).max()
    if law.traits.linear:
        assert max(left[0].max(), left[1].max()) < EXACT * size
    elif name not in YIELDING:
        assert left[1].max() > 100 * ROUNDING * size  # it is the law's curvature that is seen
        assert np.log10(left[0].max() / left[1].max()) > 1.95
    else:
        curved = left[1] > 1e-13 * size
        orders = np.log10(left[0] / left[1])[curved]
        assert curved.sum() > 20
        assert np.mean(orders > 1.9) > 0.9  # others pass a kink
        assert np.median(orders) == pytest.approx(2, abs=0.05)
    if law.traits.symmetric:
        assert now.tangent == pytest.approx(np.swapaxes(now.tangent, 1, 2), abs=EXACT * np.abs(now.tangent).max())


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", [*BALANCED, *YIELDING])
def test_energy_of_a_step_is_accounted_for(name, theta):
    """stress : (e - e_old) = stored + dissipated + remainder; remainder > 0, or zero for the midpoint rule."""
    law, start = begun(name, theta)
    now = start.respond(law, theta)
    work = np.sum(now.stress * (start.e - start.e_old), axis=1)
    size = np.max(np.abs([work, now.stored, start.stored, now.dissipated, now.remainder]), axis=0)
    exact = 1e-11 if name in YIELDING else EXACT
    assert (np.abs(work - (now.stored - start.stored) - now.dissipated - now.remainder) < exact * size).all()
    assert (now.stored > 0).all()
    assert (now.dissipated >= -1e-13 * size).all()
    if name in YIELDING:
        assert (now.q[:, 6] >= start.q[:, 6]).all()
        assert (now.dissipated / size).max() > 0.2
        assert (now.remainder >= -1e-12 * size).all() or law.unilateral
    elif name in QUADRATIC:
        assert now.dissipated.max() > 1e-3 * size.max()
        assert (now.remainder > 0).all() if theta > 0.5 else (np.abs(now.remainder) < EXACT * size).all()


@pytest.mark.parametrize("flip", [1, -1], ids=["turned", "mirrored"])
@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", ALL)
def test_no_direction_is_preferred(name, theta, flip):
    """When strains, memory and director are turned or mirrored, so are stress, tangent and memory."""
    law, start = begun(name, theta)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn = turn * flip * np.sign(np.linalg.det(turn))
    assert np.linalg.det(turn) == pytest.approx(flip)

    def turned(a):
        if a.shape[-1] == 6:
            return vector(turn @ tensor(a) @ turn.T)
        return a @ turn.T if a.shape[-1] == 3 else a

    def memory(q):
        parts = np.split(q, np.cumsum(memory_blocks(law))[:-1], axis=1) if q.shape[1] else []
        return np.concatenate([np.empty((len(q), 0)), *map(turned, parts)], axis=1)

    def close(actual, expected):
        return actual == pytest.approx(expected, abs=1e-11 * np.abs(expected).max(initial=1e-300))

    now = start.respond(law, theta)
    answer = respond(law, turned(start.e), turned(start.e_old), memory(start.q), turned(start.n), DT, theta)
    assert close(answer.stress, turned(now.stress))
    assert close(answer.q, memory(now.q))
    assert close(answer.energies, now.energies)
    assert close(answer.tangent, np.swapaxes(turned(np.swapaxes(turned(now.tangent), 1, 2)), 1, 2))
