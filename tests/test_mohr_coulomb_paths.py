"""Mohr-Coulomb laws along paths keep yield and the balance of energy, and prefer no direction; tangents are derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from forms import MohrCoulombMonodirectional
from tests.at_points import at_rest, respond, tensor, traction, vector
from tests.mohr_coulomb_points import LAW, LAWS, OMEGA, PLANE, THETAS, C, elastic, excess, normals, principal, strains
from tests.test_hardening import LAWS as HARDENING

TURNED = LAWS | {f"hardening, {name}": law for name, law in HARDENING.items()}


# ---------------------------------------------------------------- paths: yield, dissipation, balance, frames
@pytest.mark.parametrize("plane", [True, False], ids=["2D", "3D"])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_random_paths(name, theta, plane):
    """Yield is never violated, nothing is gained, and stress : de = stored + dissipated + remainder."""
    law, random, points = LAWS[name], np.random.default_rng(4), 100
    n, q, old = normals(points), at_rest(law, points), np.zeros((points, 6))
    stored, largest = np.zeros(points), 0.0
    for _ in range(8):
        e = old + strains(random, points, 0.005, plane)
        answer = respond(law, e, old, q, n, 1.0, theta)
        assert answer.failed == 0
        mid = theta * e + (1 - theta) * old
        plastic = (answer.stress - law.elastic_fraction * elastic(mid)) / (1 - law.elastic_fraction)
        scale = np.abs(elastic(mid)).max() + C
        if isinstance(law, MohrCoulombMonodirectional):
            t = traction(plastic, n)
            bound = np.maximum(C - np.tan(np.radians(OMEGA)) * t[:, 1], 0)
            assert (np.hypot(t[:, 0], t[:, 2]) <= bound + 1e-10 * scale).all()
            assert not law.unilateral or t[:, 1].max() <= 1e-10 * scale
        else:
            assert excess(plastic).max() <= 1e-10 * scale
        work = np.sum(answer.stress * (e - old), axis=1)
        size = np.max(np.abs([work, answer.stored, stored, answer.dissipated, answer.remainder]), axis=0)
        assert (answer.dissipated >= -1e-13 * size).all()
        assert (answer.remainder >= -1e-12 * size).all() or not law_is_quadratic(law)
        assert (np.abs(work - (answer.stored - stored) - answer.dissipated - answer.remainder) < 1e-11 * size).all()
        largest = max(largest, (answer.dissipated / size).max())
        old, q, stored = e, answer.q, answer.stored
    assert largest > 0.3


def law_is_quadratic(law):
    return not getattr(law, "unilateral", False)


@pytest.mark.parametrize("flip", [1, -1], ids=["turned", "mirrored"])
@pytest.mark.parametrize("name", TURNED)
def test_no_direction_is_preferred(name, flip):
    """Strain paths that are turned or mirrored, with the normal, give turned or mirrored stresses."""
    law, random, points = TURNED[name], np.random.default_rng(6), 50
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    turn *= flip * np.sign(np.linalg.det(turn))
    assert np.linalg.det(turn) == pytest.approx(flip)
    turned = lambda a: vector(turn @ tensor(a) @ turn.T)
    n, q, old, q_turned = normals(points), at_rest(law, points), np.zeros((points, 6)), at_rest(law, points)
    for _ in range(4):
        e = old + strains(random, points, 0.01)
        answer = respond(law, e, old, q, n)
        other = respond(law, turned(e), turned(old), q_turned, n @ turn.T)
        assert other.stress == pytest.approx(turned(answer.stress), abs=1e-11 * np.abs(answer.stress).max())
        same = [other.q[:, :6] - turned(answer.q[:, :6]), other.q[:, 6:] - answer.q[:, 6:]]
        assert max(np.abs(one).max(initial=0.0) for one in same) < 1e-12 * np.abs(e).max()
        assert other.energies == pytest.approx(answer.energies, abs=1e-10 * np.abs(answer.energies).max())
        old, q, q_turned = e, answer.q, other.q


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
