"""Mohr-Coulomb laws keep yield along paths; their tangents are derivatives in every part of the yield surface."""

from __future__ import annotations

import numpy as np
import pytest

from forms import MohrCoulombMonodirectional
from tests.at_points import at_rest, respond, tensor, traction, vector
from tests.mohr_coulomb_points import (
    LAWS,
    SOILS,
    THETAS,
    C,
    elastic,
    excess,
    normals,
    principal,
    reached,
    strains,
)


# ---------------------------------------------------------------- paths: yield, axes
@pytest.mark.parametrize("plane", [True, False], ids=["2D", "3D"])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS | SOILS)
def test_yield_is_never_violated(name, theta, plane):
    """With the cohesion that has been reached; where the full law flows it is just met."""
    law, random, points = (LAWS | SOILS)[name], np.random.default_rng(4), 100
    n, q, old, flowed = normals(points), at_rest(law, points), np.zeros((points, 6)), 0
    angle = np.radians(law.friction_angle)
    for _ in range(8):
        e = old + strains(random, points, 0.005, plane)
        answer = respond(law, e, old, q, n, 1.0, theta)
        assert answer.failed == 0
        mid = theta * e + (1 - theta) * old
        plastic = (answer.stress - law.elastic_fraction * elastic(mid)) / (1 - law.elastic_fraction)
        scale, flows = np.abs(elastic(mid)).max() + C, answer.q[:, 6] > q[:, 6]
        cohesion = reached(law, theta * answer.q + (1 - theta) * q)
        if isinstance(law, MohrCoulombMonodirectional):
            t = traction(plastic, n)
            beyond = np.hypot(t[:, 0], t[:, 2]) - np.maximum(cohesion - np.tan(angle) * t[:, 1], 0)
            assert not law.unilateral or t[:, 1].max() <= 1e-10 * scale
        else:
            beyond = excess(plastic, cohesion, law.friction_angle)
            assert beyond[flows] == pytest.approx(0.0, abs=1e-10 * scale)
        assert beyond.max() <= 1e-10 * scale
        flowed += flows.sum()
        old, q = e, answer.q
    assert flowed > 50


# ---------------------------------------------------------------- tangents
def stretched(law, e):
    """Answers from rest, and the part of the surface: elastic 0, face 1, edge 2 or 3, apex 4."""
    now = respond(law, e, 0 * e, at_rest(law, len(e)), normals(len(e)), 1.0)
    stress = (now.stress - law.elastic_fraction * elastic(e)) / (1 - law.elastic_fraction)
    upper, lower = (np.abs(np.diff(principal(stress), axis=1)) < 1e-9 * np.abs(stress).max()).T
    return now, np.where(np.abs(now.q).max(axis=1) > 0, 1 + upper + 2 * lower, 0)


@pytest.mark.parametrize("name", ["psi = 0", "psi = 12", "psi = Omega", "elastic fraction"])
def test_tangents_where_principal_stresses_coincide(name):
    """Two equal trial stresses, at edges, and three, at the apex and inside; points that leave their part excepted."""
    law = LAWS[name]
    base = np.array([[-1.0, -1, 2], [1.0, 1, -2], [1.0, 1, 1], [-1.0, -1, -1], [-2.0, 1, 1], [2.0, -1, -1]]) * 0.01
    e = np.concatenate([base - shift for shift in (0.0, 0.004, 0.02)])
    e = np.hstack([e, np.zeros_like(e)])
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    for strain in (e, vector(turn @ tensor(e) @ turn.T)):
        direction = 0.01 * np.random.default_rng(3).normal(size=e.shape)
        (now, kind), here, left = stretched(law, strain), np.ones(len(e), bool), []
        for h in (1e-4, 1e-5):
            moved, other = stretched(law, strain + h * direction)
            change = moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)
            left.append(np.abs(change).max(axis=1))
            here &= other == kind
        assert here.sum() >= 14
        assert set(kind[here]) >= {0, 2, 3, 4}
        assert ((left[1] < 1e-12) | (left[1] < left[0] / 50))[here].all()
