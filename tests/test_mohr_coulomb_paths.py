"""Mohr-Coulomb laws keep yield along paths; their tangents are derivatives in every part of the yield surface."""

from __future__ import annotations

import numpy as np
import pytest

from forms import MohrCoulombMonodirectional
from tests.at_points import at_rest, respond, tensor, traction, vector
from tests.mohr_coulomb_points import (
    LAW,
    LAWS,
    OMEGA,
    PLANE,
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


def test_in_the_plane_no_direction_is_preferred_either():
    """The closed form answers in any axes of the plane."""
    random, a = np.random.default_rng(6), 0.7
    rotation = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    for turn in (rotation, np.diag([-1.0, 1, 1])):
        turned = lambda x, turn=turn: vector(turn @ tensor(x) @ turn.T)
        e = strains(random, 50, 0.01, plane=True)
        one, other = (respond(LAW, x, 0 * x, at_rest(LAW, 50), normals(50)).stress for x in (e, turned(e)))
        assert other == pytest.approx(turned(one), abs=1e-12 * np.abs(one).max())


# ---------------------------------------------------------------- tangents
def remainders(law, e, direction, theta, slots, sizes):
    """Of Taylor's expansion of the stress for each size, (sizes, points); NaN where a point changes its kind."""
    n, q, zero = normals(len(e)), at_rest(law, len(e)), np.zeros((len(e), len(slots)))
    now = respond(law, e, zero, q, n, 1.0, theta, slots)
    kind, out = part_of_the_surface(law, e, now, theta, slots), []
    for h in sizes:
        moved = respond(law, e + h * direction, zero, q, n, 1.0, theta, slots)
        change = (moved.stress - now.stress)[:, slots]
        left = np.abs(change - h * np.einsum("kij,kj->ki", now.tangent, direction)).max(axis=1)
        out.append(np.where(part_of_the_surface(law, e + h * direction, moved, theta, slots) == kind, left, np.nan))
    return kind, np.array(out)


def part_of_the_surface(law, e, answer, theta, slots):
    """Elastic 0, face 1, edge 2 or 3 (the upper or the lower two are equal), apex 4; slipping 1, with tension or not."""
    whole = np.zeros((len(e), 6))
    whole[:, slots] = e
    zero = 0 * whole
    full = respond(law, whole, zero, at_rest(law, len(e)), normals(len(e)), 1.0, theta)
    stress = (full.stress - law.elastic_fraction * theta * elastic(whole)) / (1 - law.elastic_fraction)
    flows = np.abs(full.q).max(axis=1) > 0
    if isinstance(law, MohrCoulombMonodirectional):
        t_N = theta * elastic(whole)[:, 1]
        return flows + 2 * (t_N > 0) + 4 * (t_N > C / np.tan(np.radians(OMEGA)))
    upper, lower = (np.abs(np.diff(principal(stress), axis=1)) < 1e-9 * np.abs(stress).max()).T
    return np.where(flows, 1 + upper + 2 * lower, 0)


@pytest.mark.parametrize("slots", [PLANE, list(range(6))], ids=["2D", "3D"])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta, slots):
    """In every part of the yield surface, points that leave it excepted: remainders of second order, or rounding."""
    law, random = LAWS[name], np.random.default_rng(9)
    e = 0.01 / theta * random.normal(size=(600, len(slots)))
    e[:, :2] -= 0.003 / theta * np.arange(-200, 400)[:, None] / 200
    direction = np.random.default_rng(1).normal(size=e.shape) * np.abs(e).max(axis=1)[:, None]
    kind, left = remainders(law, e, direction, theta, slots, (1e-4, 1e-5))
    rounding = 1e-12 * np.abs(elastic(e[:, [0, 1, 1, 0, 0, 0]])).max()
    here = ~np.isnan(left).any(axis=0)
    for one in np.unique(kind):
        first, second = (part[here & (kind == one)] for part in left)
        assert len(first) >= 3
        bad = (second > rounding) & (second > first / 50)  # 1/100 for second order
        assert not bad.any(), f"kind {one}: {first[bad]} {second[bad]}"
    surface = {"monodirectional": 4, "unilateral": 2, "unilateral, elastic fraction": 2}
    expected = surface.get(name, 4 if slots == PLANE else 5)
    assert len(np.unique(kind)) >= expected
    assert here.mean() > 0.9


@pytest.mark.parametrize("name", ["psi = 0", "psi = 12", "psi = Omega", "elastic fraction"])
def test_tangents_where_principal_stresses_coincide(name):
    """Two equal trial stresses, at edges, and three, at the apex and inside."""
    law = LAWS[name]
    base = np.array([[-1.0, -1, 2], [1.0, 1, -2], [1.0, 1, 1], [-1.0, -1, -1], [-2.0, 1, 1], [2.0, -1, -1]]) * 0.01
    e = np.concatenate([base - shift for shift in (0.0, 0.004, 0.02)])
    e = np.hstack([e, np.zeros_like(e)])
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    for strain in (e, vector(turn @ tensor(e) @ turn.T)):
        direction = 0.01 * np.random.default_rng(3).normal(size=e.shape)
        kind, left = remainders(law, strain, direction, 1.0, list(range(6)), (1e-4, 1e-5))
        here = ~np.isnan(left).any(axis=0)
        assert here.sum() >= 14
        assert set(kind[here]) >= {0, 2, 3, 4}
        first, second = left[:, here]
        assert ((second < 1e-12) | (second < first / 50)).all()
