"""Tangents of non-monotone laws are derivatives; signs, axes and thickness change what they must and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic
from forms.planes import LIFTED
from tests.at_points import E2, jump_strain, tensor, vector
from tests.non_monotone_points import (
    ALPHA,
    LAWS,
    LMBDA,
    MU,
    THETAS,
    C,
    at,
    branch,
    jumps_and_normals,
    lifted,
    random_strains,
)
from thinlayer import ThinLayer
from thinlayer.discretisation.layer import real_law


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
    elastic = at(LinearElastic(LMBDA, MU), e, old, theta).tangent
    change = (elastic - now.tangent) / theta
    mixed = np.abs(kinds) == 1
    chi = vector(lifted(law.chi))
    if law.traits.switches:
        assert set(kinds) == {-2, 0, 2}
        assert np.abs(change).max() < 1e-12
    else:
        assert set(kinds) == {-2, -1, 0, 1, 2}
        assert np.abs(change[~mixed]).max() < 1e-12
        assert change[mixed] == pytest.approx(np.tile(np.outer(chi, chi) / (law.mixing * law.G), (mixed.sum(), 1, 1)))


@pytest.mark.parametrize("name", LAWS)
def test_both_signs(name):
    """e -> -e turns stress and phase round; chi -> -chi calls phase 1 phase -1, and changes nothing else."""
    law = LAWS[name]
    e = random_strains(law, 100)
    other = type(law)(**{**{k: v for k, v in law.parameters().items() if k not in ("T", "G")}, "chi": -law.chi})
    phase = np.resize([0, 1, -1], 100) if law.traits.switches else None
    back = -phase if law.traits.switches else None
    now, mirrored, renamed = at(law, e, phase=phase), at(law, -e, phase=back), at(other, e, phase=back)
    assert set(np.sign(now.q[:, 0])) == {-1, 0, 1}
    for answer, sign in ((mirrored, -1), (renamed, 1)):
        assert answer.stress == pytest.approx(sign * now.stress, rel=1e-14)
        assert answer.q[:, 0] == pytest.approx(-now.q[:, 0], rel=1e-14)
        assert answer.energies == pytest.approx(now.energies, rel=1e-13)


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
        for one, phase in ((law, None), (tilted, np.resize([0, 1, -1], 100))):
            now, there = at(one, e, phase=phase), at(one, vector(R @ tensor(e) @ R.T), n=n, phase=phase)
            assert there.stress == pytest.approx(vector(R @ tensor(now.stress) @ R.T), abs=1e-9)
            assert there.q == pytest.approx(now.q, abs=1e-9)
            assert there.energies == pytest.approx(now.energies, abs=1e-11)
    ignored = at(law, vector(R @ tensor(e) @ R.T))  # as if n were e_2
    assert np.abs(ignored.stress - vector(R @ tensor(at(law, e).stress) @ R.T)).max() > 0.1


@pytest.mark.parametrize("name", LAWS)
def test_scaling(name):
    """Moduli ~ eps, alpha ~ eps^0, C ~ 1/eps: traction and eps times the energy of sym([u] (x) n)/eps do not know eps."""
    law = LAWS[name]
    phase = np.resize([0, 1, -1], 50) if law.traits.switches else None
    w, n = jumps_and_normals(law, 50)
    E = jump_strain(w, n)
    there = at(law, E, n=n, phase=phase)
    for eps in (1e-3, 0.5):
        real = real_law(ThinLayer(law, eps, at=1.0), LIFTED)
        numbers = real.parameters()
        assert (numbers["lmbda"], numbers["mu"], numbers["alpha"], numbers["transformation_energy"]) == pytest.approx(
            (LMBDA * eps, MU * eps, ALPHA, C / eps), rel=1e-15
        )
        built = type(law)(LMBDA * eps, MU * eps, ALPHA, C / eps, law.chi, **extra(law))
        for one in (real, built):
            answer = at(one, E / eps, n=n, phase=phase)
            assert answer.stress == pytest.approx(there.stress, rel=1e-11, abs=1e-12)
            assert eps * answer.energies == pytest.approx(there.energies, rel=1e-10, abs=1e-14)
            assert answer.q[:, 0] == pytest.approx(there.q[:, 0], abs=1e-11)
        limit = built.scaled(1 / eps).parameters()
        for key, value in law.parameters().items():
            assert limit[key] == pytest.approx(value, rel=1e-14)
    wrong = law.with_parameters(
        {"lmbda": LMBDA * eps, "mu": MU * eps, "transformation_energy": C}
    )  # "the same power" for alpha and C
    if not law.traits.switches:
        assert np.abs(at(wrong, E / eps, n=n).stress - there.stress).max() > 0.1


def extra(law):
    return {} if law.traits.switches else {"mixing": law.mixing}
