"""Tangents of non-monotone laws are derivatives; signs, axes and thickness change what they must and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic
from tests.at_points import E2, tensor, vector
from tests.non_monotone_points import LAWS, LMBDA, MU, THETAS, at, branch, lifted, random_strains


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """The stress is linear in each branch, so that Taylor's remainder is rounding; a mixture has another tangent."""
    law = LAWS[name]
    e, old = random_strains(law, 200) / theta, random_strains(law, 200, seed=8, spread=0.0)
    mid = lambda strain: at(law, theta * strain + (1 - theta) * old, phase=phase)
    phase = np.resize([0, 1, -1], 200) if law.traits.switches else None
    direction = 0.01 * np.random.default_rng(1).normal(size=e.shape)
    now, kinds, sizes = at(law, e, old, theta, phase=phase), branch(law, mid(e)), (1e-2, 1e-3)
    for h in sizes:
        moved = at(law, e + h * direction, old, theta, phase=phase)
        left = np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max(axis=1)
        same = branch(law, mid(e + h * direction)) == kinds
        assert same.mean() > 0.95
        assert left[same].max() < 1e-13 * np.abs(now.stress).max()
    assert now.tangent == pytest.approx(np.swapaxes(now.tangent, 1, 2), abs=1e-13 * 140)
    change = (at(LinearElastic(LMBDA, MU), e, old, theta).tangent - now.tangent) / theta
    mixed = np.abs(kinds) == 1
    chi = vector(lifted(law.chi))
    if law.traits.switches:
        assert set(kinds) == {-2, 0, 2}
        assert np.abs(change).max() < 1e-12
    else:
        assert set(kinds) == {-2, -1, 0, 1, 2}
        assert np.abs(change[~mixed]).max() < 1e-12
        assert change[mixed] == pytest.approx(np.tile(np.outer(chi, chi) / (law.mixing * law.G), (mixed.sum(), 1, 1)))


def turn_to(n):
    """The rotation to the layer's axes by Rodrigues' formula, in the plane and (smallest) in space."""
    if n[1] < -1 + 1e-12:
        return np.diag([-1.0, -1.0, 1.0])
    cross = np.cross(E2, n)
    K = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.eye(3) + K + K @ K * ((1 - n[1]) / (cross @ cross))


NORMALS = {
    "relaxed 2D": [(0.6, 0.8, 0), (-0.8, -0.6, 0), (0, -1, 0), (1, 0, 0)],
    "relaxed 3D": [(1 / 3, 2 / 3, -2 / 3), (2 / 3, -1 / 3, 2 / 3), (0, -1, 0), (0, 0, 1), (6e-6, -1, 8e-6)],
}


@pytest.mark.parametrize("name", NORMALS)
def test_axes_turn_with_the_normal(name):
    """The law of another normal is the turned law: chi is in the layer's axes."""
    law, tilted = LAWS[name], LAWS[name.replace("relaxed", "pure").replace(" 2D", "")]
    e = random_strains(law, 100)
    for n in NORMALS[name]:
        n = np.array(n) / np.linalg.norm(n)
        R = turn_to(n)
        assert np.abs(R @ E2 - n).max() < 1e-10
        for variant, phase in ((law, None), (tilted, np.resize([0, 1, -1], 100))):
            now, there = at(variant, e, phase=phase), at(variant, vector(R @ tensor(e) @ R.T), n=n, phase=phase)
            assert there.stress == pytest.approx(vector(R @ tensor(now.stress) @ R.T), abs=1e-9)
            assert there.q == pytest.approx(now.q, abs=1e-9)
            assert there.energies == pytest.approx(now.energies, abs=1e-11)
    ignored = at(law, vector(R @ tensor(e) @ R.T))  # as if n were e_2
    assert np.abs(ignored.stress - vector(R @ tensor(at(law, e).stress) @ R.T)).max() > 0.1
