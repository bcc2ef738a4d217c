"""Mohr-Coulomb laws at points: closed form, return to faces, edges and apex against enumeration, tangents, paths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms import (
    Incompressible,
    LawError,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    MohrCoulombReturn,
    Norton,
    Stack,
    limits,
)
from tests.at_points import E2, at_rest, jump_strain, material, respond, tensor, traction, vector
from tests.own_laws import Slipping
from thinlayer.errors import ModelError, SolveError
from thinlayer.pointwise.drive import drive

LMBDA, MU, C, OMEGA = 60.0, 40.0, 0.1, 30.0  # nu = 0.3
ONE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
PLANE = [0, 1, 3]
THETAS = [1.0, 0.7, 0.5]
SLOW = settings(deadline=None, max_examples=60)


@dataclass(frozen=True)
class ClosedOnly(MohrCoulomb):
    """The closed in-plane form, without another law where it does not hold."""

    otherwise: ClassVar = None


LAW, CLOSED, RETURN = (kind(LMBDA, MU, C, OMEGA) for kind in (MohrCoulomb, ClosedOnly, MohrCoulombReturn))
MONO = MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA)
LAWS = {
    "closed form and return": LAW,
    "return": RETURN,
    "psi = 12": MohrCoulombReturn(LMBDA, MU, C, OMEGA, dilatancy_angle=12.0),
    "psi = Omega": MohrCoulombReturn(LMBDA, MU, C, OMEGA, dilatancy_angle=OMEGA),
    "elastic fraction": MohrCoulombReturn(LMBDA, MU, C, OMEGA, 0.2, 12.0),
    "monodirectional": MONO,
    "unilateral": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, unilateral=True),
    "unilateral, elastic fraction": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, 0.2, unilateral=True),
}


def elastic(e, lmbda=LMBDA, mu=MU):
    """Stress (..., 6) of Mandel strains."""
    return lmbda * e[..., :3].sum(-1)[..., None] * ONE + 2 * mu * e


def compliance(s, lmbda=LMBDA, mu=MU):
    return s / (2 * mu) - lmbda / (2 * mu * (3 * lmbda + 2 * mu)) * s[..., :3].sum(-1)[..., None] * ONE


def principal(s):
    """Descending principal stresses (..., 3)."""
    return np.linalg.eigvalsh(tensor(s))[..., ::-1]


def excess(s, C=C, Omega=OMEGA):
    """(s_1 - s_3)/2 + (s_1 + s_3)/2 sin(Omega) - C cos(Omega)."""
    p, angle = principal(s), np.radians(Omega)
    return (p[..., 0] - p[..., 2]) / 2 + (p[..., 0] + p[..., 2]) / 2 * np.sin(angle) - C * np.cos(angle)


def strains(random, points, size=0.02, plane=False):
    e = size * random.normal(size=(points, 6))
    e[:, 0:3] -= size / 2
    if plane:
        e[:, [2, 4, 5]] = 0
    return e


def normals(points):
    return np.tile(E2, (points, 1))


# ---------------------------------------------------------------- closed form and return mapping
@pytest.mark.parametrize("h", [0.0, 0.3])
@pytest.mark.parametrize("theta", THETAS)
def test_closed_form_is_the_return_mapping_where_it_holds(theta, h):
    """Over several steps: stress, tangent in the plane, memory, energies; elsewhere MohrCoulomb is the return."""
    random, points = np.random.default_rng(3), 400
    n, q, old, held = normals(points), at_rest(RETURN, points), np.zeros((points, 6)), []
    for _ in range(4):
        e = old + strains(random, points, 0.01, plane=True)
        closed, both, other = (respond(law, e, old, q, n, 1.0, theta) for law in (CLOSED, LAW, RETURN))
        holds = ~np.isnan(closed.stress[:, 0])
        held.append(holds.mean())
        assert (both.failed, other.failed, closed.failed) == (0, 0, np.count_nonzero(~holds))
        for name in ("stress", "q", "energies", "tangent"):
            mine, theirs, formula = (getattr(answer, name) for answer in (both, other, closed))
            if name == "tangent":  # in the plane
                mine, theirs, formula = (C[:, PLANE][:, :, PLANE] for C in (mine, theirs, formula))
            assert (mine[~holds] == theirs[~holds]).all()
            assert mine[holds] == pytest.approx(formula[holds], rel=1e-15)
            assert mine == pytest.approx(theirs, abs=1e-10 * np.abs(theirs).max())
        q, old = both.q, e
    assert 0.2 < np.mean(held) < 0.9


def pressed_and_sheared(law, w_N, w_T):
    w = np.array([[w_T, w_N, 0.0]])
    return respond(law, jump_strain(w, E2[None]), np.zeros((1, 6)), at_rest(law, 1), E2[None])


@pytest.mark.parametrize("w_N", [-0.01, -1.0])
@pytest.mark.parametrize(("nu", "holds"), [(0.2, False), (0.249, False), (0.251, True), (0.3, True)])
def test_the_limit_in_compression(nu, holds, w_N):
    """C = 0: s_33 is the intermediate stress at yield for nu > (1 - sin(Omega))/2 = 1/4, at any pressure."""
    lmbda, mu = 2 * MU * nu / (1 - 2 * nu), MU
    assert limits.mohr_coulomb_holds(lmbda, mu, 0.0, OMEGA, w_N) == holds
    closed, both, other = (
        pressed_and_sheared(kind(lmbda, mu, 0.0, OMEGA), w_N, -3 * w_N)
        for kind in (ClosedOnly, MohrCoulomb, MohrCoulombReturn)
    )
    assert bool(closed.failed) is not holds
    assert both.failed == other.failed == 0
    assert both.dissipated > 0
    assert both.stress == pytest.approx(other.stress, abs=1e-10 * np.abs(other.stress).max())
    w = np.array([-3 * w_N, w_N])
    t, _ = limits.mohr_coulomb(lmbda, mu, 0.0, OMEGA, w, 0 * w, 0 * w)
    found = traction(both.stress, E2[None])[0, :2]
    assert np.abs(found - t).max() < 1e-12 * abs(t[1]) if holds else np.abs(found - t).max() > 1e-4 * abs(t[1])


@pytest.mark.parametrize(("ratio", "holds"), [(0.5, True), (0.999, True), (1.001, False), (1.5, False), (3.0, False)])
def test_the_limit_in_tension(ratio, holds):
    """p up to C cos(Omega)/(1 - 2 nu + sin(Omega)); from 1.8 times that on, C cot(Omega), there is only the cut-off."""
    angle, nu = np.radians(OMEGA), 0.3
    p = ratio * C * np.cos(angle) / (1 - 2 * nu + np.sin(angle))
    w_N = p / (LMBDA + MU)
    assert limits.mohr_coulomb_holds(LMBDA, MU, C, OMEGA, w_N) == holds
    closed, both, other = (pressed_and_sheared(law, w_N, 0.05) for law in (CLOSED, LAW, RETURN))
    assert bool(closed.failed) is not holds
    assert both.failed == 0
    assert both.stress == pytest.approx(other.stress, abs=1e-10 * np.abs(other.stress).max())
    if ratio == 3.0:
        assert both.stress[0] == pytest.approx(C / np.tan(angle) * ONE, rel=1e-12)


@given(st.lists(st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.0)), min_size=1, max_size=6))
@SLOW
def test_the_layer_is_its_closed_formula(path):
    """`limits.mohr_coulomb`, any path in compression; absolute tolerances for jumps next to nothing."""
    history = drive(LAW, [{"w_T": w_T, "w_N": w_N} for w_T, w_N in path])
    w_old = s = np.zeros(2)
    for w, found in zip(np.array(path), history.tractions, strict=True):
        t, s = limits.mohr_coulomb(LMBDA, MU, C, OMEGA, w, w_old, s)
        w_old = w
        assert found == pytest.approx(t, rel=1e-9, abs=1e-13)


# ---------------------------------------------------------------- the return against enumeration
def enumerated(trial, psi, C, Omega, lmbda=LMBDA, mu=MU):
    """All stresses that a principal trial stress (3,) may return to, one for each admissible set of active planes.

    The six planes (1 + sin) s_i - (1 - sin) s_j <= 2 C cos; s = trial - sum g_k D m_k with g >= 0, zero on planes that
    are not reached. Which stress is the highest is not known beforehand. Up to three planes may be needed.
    """
    D = lmbda * np.ones((3, 3)) + 2 * mu * np.eye(3)
    sine, dilatant, strength = np.sin(np.radians(Omega)), np.sin(np.radians(psi)), 2 * C * np.cos(np.radians(Omega))
    N, M = np.zeros((6, 3)), np.zeros((6, 3))
    for k, (i, j) in enumerate(permutations(range(3), 2)):
        N[k, i], N[k, j] = 1 + sine, -(1 - sine)
        M[k, i], M[k, j] = 1 + dilatant, -(1 - dilatant)
    beyond = N @ trial - strength
    size = np.abs(trial).max() + strength
    if (beyond <= 0).all():
        return [trial]
    found = []
    for active in (list(some) for count in (1, 2, 3) for some in combinations(range(6), count)):
        A = N[active] @ D @ M[active].T
        if np.linalg.cond(A) > 1e10:
            continue
        g = np.linalg.solve(A, beyond[active])
        s = trial - D @ M[active].T @ g
        if (g >= -1e-12 * size).all() and (N @ s - strength <= 1e-10 * size).all():
            found.append(s)
    return found


ANGLES = {"psi = 0": (30.0, 0.0), "0 < psi < Omega": (35.0, 10.0), "psi = Omega": (25.0, 25.0), "Tresca": (0.0, 0.0)}


def kinds(s, q):
    """Elastic 0, face 1, edge 2, apex 3, of stresses and plastic strains from rest (points, 6)."""
    p = principal(s)
    equal = np.abs(np.diff(p, axis=1)) < 1e-9 * np.abs(s).max()
    return np.where(np.abs(q).max(axis=1) == 0, 0, 1 + equal.sum(axis=1))


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize("lmbda", [60.0, -10.0, 900.0])
def test_the_return_is_the_solution_of_the_six_planes(name, lmbda):
    """One stress only, whatever set of planes; none for psi = 0 beyond the apex, where the stress is cut off."""
    Omega, psi = ANGLES[name]
    law = MohrCoulombReturn(lmbda, MU, C, Omega, dilatancy_angle=psi)
    e = strains(np.random.default_rng(8), 300, 0.004)
    answer = respond(law, e, 0 * e, at_rest(law, len(e)), normals(len(e)))
    assert answer.failed == 0
    trial, seen = elastic(e, lmbda), kinds(answer.stress, answer.q)
    for k in range(len(e)):
        solutions = enumerated(principal(trial[k]), psi, C, Omega, lmbda)
        apex = C / np.tan(np.radians(Omega)) if Omega else np.inf
        if not solutions or (psi == 0 and trial[k, :3].mean() > apex):
            assert psi == 0
            assert trial[k, :3].mean() > apex * (1 - 1e-9)
            assert answer.stress[k] == pytest.approx(apex * ONE, rel=1e-12)
            continue
        found = principal(answer.stress[k])
        size = np.abs(trial[k]).max()
        for one in solutions:
            assert np.abs(found - np.sort(one)[::-1]).max() < 1e-9 * size
        commute = tensor(answer.stress[k]) @ tensor(trial[k])
        assert np.abs(commute - commute.T).max() < 1e-11 * size**2  # the same axes
    counts = np.bincount(seen, minlength=4)
    assert counts[1:].sum() > 50
    if lmbda == LMBDA:
        assert (counts >= ((50, 50, 20, 3) if Omega else (0, 50, 50, 0))).all()
    assert answer.q == pytest.approx(e - compliance(answer.stress, lmbda), abs=1e-14)


def test_another_dilatancy_is_not_the_solution():
    e = strains(np.random.default_rng(8), 50, 0.004)
    law = MohrCoulombReturn(LMBDA, MU, C, 35.0, dilatancy_angle=12.0)
    found = respond(law, e, 0 * e, at_rest(law, len(e)), normals(len(e)))
    for k in np.flatnonzero(kinds(found.stress, found.q) == 1):
        solutions = enumerated(principal(elastic(e[k])), 10.0, C, 35.0)
        assert np.abs(principal(found.stress[k]) - np.sort(solutions[0])[::-1]).max() > 1e-5


def test_associated_return_is_the_closest_stress():
    """psi = Omega: no admissible stress tensor is closer to the trial one in the norm of the complementary energy."""
    law, random = LAWS["psi = Omega"], np.random.default_rng(5)
    e = strains(random, 100, 0.01)
    returned = respond(law, e, 0 * e, at_rest(law, 100), normals(100)).stress
    trial = elastic(e)
    away = compliance(trial - returned)
    others = elastic(strains(random, 4000, 0.01))
    others = others[excess(others) <= 0]
    assert len(others) > 100
    others = np.concatenate([others, returned])
    assert (np.einsum("ki,kmi->km", away, others[None] - returned[:, None]) <= 1e-12).all()
    other = MohrCoulombReturn(
        LMBDA, MU, C, OMEGA, dilatancy_angle=12.0
    )  # which is not associated: some stress is closer
    returned = respond(other, e, 0 * e, at_rest(other, 100), normals(100)).stress
    away = compliance(trial - returned)
    assert (np.einsum("ki,kmi->km", away, others[None] - returned[:, None]) > 1e-6).any()


@pytest.mark.parametrize("lmbda", [-18.9, 60.0, 2e4])
def test_friction_next_to_ninety_degrees(lmbda):
    """Planes of an edge that are next to parallel: yield is kept, and no admissible stress is closer (psi = Omega)."""
    law = MohrCoulombReturn(lmbda, MU, C, 89.9, dilatancy_angle=89.9)
    e = strains(np.random.default_rng(6), 300, 0.004)
    e[::2, [0, 1]] = e[::2, [1, 0]] = (e[::2, :1] + e[::2, 1:2]) / 2
    e[::2, 3:] = 0
    e[:100, :3] -= 0.01
    answer = respond(law, e, 0 * e, at_rest(law, 300), normals(300))
    trial, returned = elastic(e, lmbda), answer.stress
    size = np.abs(trial).max(axis=1)
    assert (excess(returned, C, 89.9) <= 1e-12 * size).all()
    assert {1, 2, 3} & set(kinds(returned, answer.q)) >= {2, 3}
    away = compliance(trial - returned, lmbda)
    others = returned[excess(returned, C, 89.9) <= 0]
    work = np.einsum("ki,kmi->km", away, others[None] - returned[:, None])
    assert (work <= 1e-11 * np.abs(away).max(axis=1)[:, None] * size.max()).all()


def test_torn_material_closes_only_when_the_volume_is_pressed_out():
    """psi = 0: at the cut-off the volume is plastic; unloading is elastic from there, compression comes late."""
    apex, bulk = C / np.tan(np.radians(OMEGA)), LMBDA + 2 * MU / 3
    e = np.array([0.02 / 3 * ONE, 0.019 / 3 * ONE, (0.02 - 2 * apex / bulk) / 3 * ONE])
    q, old, pressures = at_rest(RETURN, 1), np.zeros((1, 6)), []
    for now in e:
        answer = respond(RETURN, now[None], old, q, E2[None])
        assert answer.stress[0] == pytest.approx(answer.stress[0, 0] * ONE, abs=1e-15)
        pressures.append(answer.stress[0, 0])
        old, q = now[None], answer.q
    assert pressures == pytest.approx([apex, apex - bulk * 0.001, -apex], rel=1e-12)


def test_friction_zero_is_tresca():
    """|s_1 - s_3| <= 2 C whatever the mean stress, which is elastic."""
    law = MohrCoulombReturn(LMBDA, MU, C, 0.0)
    e = strains(np.random.default_rng(2), 200)
    stress = respond(law, e, 0 * e, at_rest(law, 200), normals(200)).stress
    assert stress[:, :3].mean(axis=1) == pytest.approx(elastic(e)[:, :3].mean(axis=1), rel=1e-12, abs=1e-14)
    p = principal(stress)
    assert (p[:, 0] - p[:, 2]).max() == pytest.approx(2 * C, rel=1e-12)
    assert np.mean(p[:, 0] - p[:, 2] > 2 * C * (1 - 1e-9)) > 0.9


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
@pytest.mark.parametrize("name", LAWS)
def test_no_direction_is_preferred(name, flip):
    """Strain paths that are turned or mirrored, with the normal, give turned or mirrored stresses."""
    law, random, points = LAWS[name], np.random.default_rng(6), 50
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
        assert other.q == pytest.approx(turned(answer.q), abs=1e-12 * np.abs(e).max())
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
        left = np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max(axis=1)
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


@pytest.mark.parametrize("name", ["return", "psi = 12", "psi = Omega", "elastic fraction"])
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


# ---------------------------------------------------------------- drive, closed formulas and friction
def closing_and_shearing(law, steps, end=0.03, w_N=-0.01):
    path = [{"w_T": 0.0, "w_N": w_N}, *({"w_T": w, "w_N": w_N} for w in np.linspace(0, end, steps + 1)[1:])]
    return drive(law, path)


def test_opening_held():
    """Order 1 to the closed form, whose number is known; slip on planes parallel to S alone gives another one."""
    expected = np.array([0.573611999372, -1.12276731876])
    exact = limits.mohr_coulomb_fixed_opening(LMBDA, MU, C, OMEGA, -0.01, np.array(0.03))
    assert exact == pytest.approx(expected, rel=1e-11)
    ends = [closing_and_shearing(LAW, steps).tractions[-1] for steps in (100, 200, 400)]
    errors = [np.abs(t - exact) for t in ends]
    assert np.log2(errors[1] / errors[2]) == pytest.approx([1, 1], abs=0.01)
    assert 2 * ends[2] - ends[1] == pytest.approx(exact, abs=5e-6)
    for law in (MONO, MohrCoulombReturn(LMBDA, MU, C, OMEGA, dilatancy_angle=10.0), MohrCoulomb(LMBDA, MU, C, 29.9)):
        assert np.abs(closing_and_shearing(law, 400).tractions[-1] - exact).max() > 5e-4
    mono = closing_and_shearing(MONO, 10).tractions[-1]  # any number of steps: it is penalised Coulomb
    assert mono == pytest.approx([C + np.tan(np.radians(OMEGA)) * 1.4, -1.4], rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_any_start_of_shear_under_a_held_opening(sign):
    """From a state beside the axis: elastic until first yield, then the arc; the midpoint rule is of order 2 there."""
    start = [{"w_T": 0.004, "w_N": -0.004}, {"w_T": 0.0045, "w_N": -0.006}]
    before = drive(LAW, start)
    s = before.tractions[-1] - [0, (LMBDA + MU) * -0.006]
    exact = limits.mohr_coulomb_fixed_opening(LMBDA, MU, C, OMEGA, -0.006, sign * np.array([1e-4, 0.02]), tuple(s))
    errors = []
    for steps in (400, 800):
        path = [{"w_T": 0.0045 + sign * w, "w_N": -0.006} for w in np.linspace(0, 0.02, steps + 1)[1:]]
        errors.append(np.abs(drive(LAW, [*start, *path]).tractions[-1] - exact[1]).max())
    assert errors[1] < 2e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.03)
    one = drive(LAW, [*start, {"w_T": 0.0045 + sign * 1e-4, "w_N": -0.006}]).tractions[-1]
    if sign < 0:
        assert one == pytest.approx(exact[0], rel=1e-12)  # unloading is elastic
    with pytest.raises(ValueError, match="at the start exceeds R"):
        limits.mohr_coulomb_fixed_opening(LMBDA, MU, C, OMEGA, -0.006, 0.1, (1.0, 0.0))


def test_friction_of_the_layer():
    """First yield, lasting friction for several psi, and tan(Omega) while the pressure is taken away."""
    law = MohrCoulomb(LMBDA, MU, 0.0, OMEGA)
    first = limits.first_yield_ratio(0.3, OMEGA)
    assert first == pytest.approx(0.3 / 1.4, rel=1e-12)
    for share, flows in ((1 - 1e-9, False), (1 + 1e-9, True)):
        found = drive(law, [{"w_T": 0.0, "w_N": -0.01}, {"w_T": share * first * 1.4 / MU, "w_N": -0.01}])
        assert found.memory[-1].any() == flows
    assert limits.first_yield_ratio(0.2, OMEGA) == 0.0
    for psi, value in ((0.0, 0.5), (10.0, 0.539221272), (20.0, 0.566769624), (30.0, 0.577350269)):
        assert limits.apparent_friction(OMEGA, psi) == pytest.approx(value, rel=2e-9)
        dilatant = MohrCoulomb(LMBDA, MU, 0.0, OMEGA, dilatancy_angle=psi)
        held = drive(dilatant, [{"w_T": w, "t_N": -1.4} for w in np.linspace(0, 2.0, 60)]).tractions[-1]
        assert held == pytest.approx([1.4 * value, -1.4], rel=1e-7)
    pressed = [{"w_T": w, "w_N": -0.01} for w in np.linspace(0, 0.3, 50)]
    opened = [{"w_T": 0.3, "w_N": w} for w in np.linspace(-0.01, -0.002, 400)]
    t = drive(law, [*pressed, *opened]).tractions
    assert t[49, 0] / -t[49, 1] == pytest.approx(0.5, rel=1e-8)
    assert (t[:, 0] / -t[:, 1]).max() == pytest.approx(np.tan(np.radians(OMEGA)), rel=2e-5)


def test_drive_under_a_constant_normal_stress():
    """The tractions asked for are there, the closed formula gives them at the jumps found, and energies balance."""
    path = [{"w_T": 0.0, "t_N": -1.0}, *({"t_T": t, "t_N": -1.0} for t in (0.2, 0.4, 0.55, -0.5, 0.3))]
    found = drive(LAW, path)
    assert found.tractions[:, 0] == pytest.approx([0.0, 0.2, 0.4, 0.55, -0.5, 0.3], abs=1e-11)
    assert found.tractions[:, 1] == pytest.approx(-np.ones(6), abs=1e-11)
    assert (found.parts == 1).all()
    w_old = s = np.zeros(2)
    for w, t in zip(found.jumps, found.tractions, strict=True):
        expected, s = limits.mohr_coulomb(LMBDA, MU, C, OMEGA, w, w_old, s)
        assert t == pytest.approx(expected, rel=1e-11)
        w_old = w
    work = np.sum(found.tractions * np.diff(found.jumps, axis=0, prepend=0), axis=1)
    stored, dissipated, remainder = found.energies.T
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, rel=1e-10)
    assert found.stress[:, 1, 1] == pytest.approx(found.tractions[:, 1], rel=1e-12)
    assert found.stress[:, 2, 2] == pytest.approx(LMBDA * found.jumps[:, 1], rel=1e-10)
    table = found.table
    assert table.columns == ["t", "w_T", "w_N", "t_T", "t_N", "stored", "dissipated", "remainder"]
    assert table["w_T"] == pytest.approx(found.jumps[:, 0])


def test_drive_in_three_dimensions_and_other_frames():
    """The layer's axes do not matter: the law is isotropic. With theta the traction asked for is that inside the step."""
    steps = [{"w_T1": 0.02, "t_T2": 0.1, "t_N": -1.0}, {"t_T1": 0.3, "w_T2": 0.01, "w_N": -0.02}]
    law = LAWS["psi = 12"]
    first = drive(law, steps, n=(0, 1, 0), theta=0.7)
    assert first.tractions[0, 1:] == pytest.approx([0.1, -1.0], rel=1e-11)
    assert first.tractions[1, 0] == pytest.approx(0.3, rel=1e-11)
    for n in [(1.0, 2.0, -2.0), (0, -3, 0), (0, 0, 1), (1e-9, -1, 0)]:
        other = drive(law, steps, n=n, theta=0.7)
        assert other.jumps == pytest.approx(first.jumps, rel=1e-9)
        assert other.tractions == pytest.approx(first.tractions, rel=1e-9)
        unit = np.array(n) / np.linalg.norm(n)
        assert np.einsum("kij,i,j->k", other.stress, unit, unit) == pytest.approx(first.tractions[:, 2], rel=1e-9)
    flat = drive(law, [{"w_T": 0.02, "t_N": -1.0}], n=(0.6, 0.8))
    assert flat.jumps == pytest.approx(drive(law, [{"w_T": 0.02, "t_N": -1.0}]).jumps, rel=1e-11)
    deep = drive(law, [{"w_T1": 0.02, "w_T2": 0.0, "t_N": -1.0}], n=(0, 1, 0))
    assert deep.jumps[0, [0, 2]] == pytest.approx(flat.jumps[0], rel=1e-9)


def test_drive_any_law():
    """Static, viscous, of tractions, in series: the formulas of `limits`."""
    elastic_layer = drive(LinearElastic(LMBDA, MU), [{"t_T": 0.5, "t_N": 1.0}])
    assert elastic_layer.jumps[0] == pytest.approx([0.5 / MU, 1.0 / (LMBDA + 2 * MU)], rel=1e-11)
    norton = drive(Norton(LMBDA, MU, 5.0, 1.5), [{"t_T": 0.5, "t_N": 0.0}] * 100, dt=0.01, theta=0.5)
    assert norton.jumps[-1, 0] == pytest.approx(limits.norton_creep(0.5, MU, 5.0, 1.5, 1.0, shear=True), rel=1e-3)
    assert norton.t[-1] == pytest.approx(1.0)
    maxwell = drive(Maxwell(LMBDA, MU, 0.7), [{"t_T": 0.5, "t_N": 1.0}] * 11, dt=[0.0] + 10 * [0.1], theta=0.5)
    assert maxwell.jumps[-1, 1] == pytest.approx(limits.maxwell_creep(1.0, LMBDA + 2 * MU, 0.7, 1.0), rel=1e-9)
    assert drive(Slipping(70.0, 30.0, 12.0, 90.0), [{"w_T": 0.01, "w_N": -0.01}], dt=1.0).energies == pytest.approx(
        np.full((1, 3), np.nan), nan_ok=True
    )


def test_traction_beyond_the_limit():
    """The steps before are kept, up to them all is as without the step too many."""
    path = [{"w_T": 0.0, "t_N": -1.0}, *({"t_T": t, "t_N": -1.0} for t in (0.3, 0.58, 0.59))]
    bound = C * np.cos(np.radians(OMEGA)) + np.sin(np.radians(OMEGA))
    assert 0.58 < bound < 0.59
    with pytest.raises(SolveError, match=r"step 4 of 4 \(t_T = 0.59, t_N = -1\): no jump was found") as caught:
        drive(LAW, path)
    kept = caught.value.history
    assert len(kept) == 3
    assert kept.jumps == pytest.approx(drive(LAW, path[:3]).jumps)
    with pytest.raises(SolveError, match="Beyond the law's limit") as caught:
        drive(MONO, [{"t_T": 0.0, "t_N": -1.0}, {"t_T": C + np.tan(np.radians(OMEGA)) + 1e-3, "t_N": -1.0}])
    assert len(caught.value.history) == 1
    with pytest.raises(SolveError, match="step 1 of 1"):  # it does not pull
        drive(LAWS["unilateral"], [{"w_T": 0.0, "t_N": 0.01}])


def test_an_open_layer_closes_under_pressure():
    """Where the tangent vanishes there is a way back."""
    for law, pressed in ((LAWS["unilateral"], -1 / (LMBDA + 2 * MU)), (LAW, None)):
        found = drive(law, [{"w_T": 0.1, "w_N": 1.0}, {"w_T": 0.1, "t_N": -1.0}])
        assert found.tractions[-1, 1] == pytest.approx(-1.0, rel=1e-11)
        if pressed:
            assert found.jumps[-1, 1] == pytest.approx(pressed, rel=1e-9)
        else:
            assert found.jumps[-1, 1] > 0.9  # the volume gained is still there


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"steps": []}, "at least one step"),
        ({"steps": None}, "steps is None; it must be a sequence of dictionaries"),
        ({"steps": {"w_T": 0.0, "w_N": 0.0}}, "steps is {'w_T': 0.0, 'w_N': 0.0}; it must be a sequence"),
        ({"law": [{"w_T": 0.0}], "steps": LAW}, "the law of a point is "),
        ({"steps": [(0.0, 1.0)]}, r"step 1 is \(0.0, 1.0\); it must be a dictionary with w_T or t_T, w_N or t_N"),
        ({"steps": [{"w_T": 0.0}]}, r"step 1 has neither of w_N \(jump\) and t_N \(traction\)"),
        ({"steps": [{"w_T": 0.0, "w_N": 0.0, "t_N": 1.0}]}, "step 1 has both of w_N"),
        ({"steps": [{"w_T": 0.0, "w_n": 0.0}]}, "step 1 has 'w_n'; allowed in 2D: w_T or t_T, w_N or t_N"),
        ({"steps": [{"w_T": 0.0, "w_N": float("nan")}]}, "step 1: w_N is nan; it must be a finite number"),
        ({"steps": [{"w_T": 0.0, "w_N": "1"}]}, "w_N is '1'"),
        ({"n": (0, 1, 0)}, "allowed in 3D: w_T1 or t_T1, w_T2 or t_T2, w_N or t_N"),
        ({"n": (0, 0)}, r"the normal n is \(0, 0\)"),
        ({"n": 1.0}, "the normal n is 1.0"),
        ({"n": (0, "up")}, "the normal n is"),
        ({"dt": -1.0}, "dt is -1.0"),
        ({"dt": [1.0, 2.0]}, "one for each of the 1 steps"),
        ({"dt": None}, "dt is None"),
        ({"theta": 0.4}, "theta is 0.4; allowed: 0.5 to 1"),
        ({"theta": "half"}, "theta is 'half'"),
        ({"law": "glue"}, "the law of a point is 'glue'"),
        ({"law": Incompressible(1.0)}, r"the law of a point is Incompressible\(mu=1.0\)"),
        ({"law": Norton(LMBDA, MU, 5.0, 1.5), "dt": 0}, "dt is 0 in step 1; Norton lets no jump change at once"),
    ],
)
def test_what_drive_refuses(change, message):
    with pytest.raises(ModelError, match=message):
        drive(**({"law": LAW, "steps": [{"w_T": 0.0, "w_N": 0.0}]} | change))


# ---------------------------------------------------------------- slip planes parallel to S; sublayers
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
        t, slip = limits.penalised_coulomb(LMBDA, MU, 1.0, OMEGA, w[0], slip, n, unilateral=unilateral)
        assert traction(answer.stress, n[None])[0] == pytest.approx(t, abs=1e-12)
        assert tensor(answer.q[0]) @ n == pytest.approx(slip / 2, abs=1e-15)
        seen.add((bool(np.abs(slip - before).max() > 1e-9), bool(w[0] @ n > 0)))
        old, q = w, answer.q
    assert len(seen) == (4 if unilateral else 3)  # bilateral, nothing sticks in tension


def test_elastic_and_monodirectional_sublayers():
    """t = K (w - w^p), the threshold on the common traction."""
    above = LinearElastic(100.0, 15.0)
    law, random, n = Stack((0.3, above), (0.7, MONO)), np.random.default_rng(3), np.array([0.6, 0.8])
    stiffnesses = [limits.elastic_stiffness(part.lmbda, part.mu, n) for part in (above, MONO)]
    w, slip, path, expected, slips = np.zeros(2), np.zeros(2), [], [], 0
    tangent = np.array([n[1], -n[0]])
    for _ in range(20):
        w = w + 0.01 * random.normal(size=2) - (w @ n) * n - 0.002 * n
        before = slip
        t, slip = limits.stratified_coulomb(law.fractions, stiffnesses, C, OMEGA, w, slip, n)
        slips += bool(np.abs(slip - before).max() > 1e-9)
        path.append({"w_T": w @ tangent, "w_N": w @ n})
        expected.append([t @ tangent, t @ n])
    found = drive(law, path, n=n)
    assert 3 < slips < 20
    assert found.tractions == pytest.approx(np.array(expected), rel=1e-8, abs=1e-10)
    mean = [np.sum(law.fractions * np.array([k[0, 0] for k in stiffnesses]))]  # the arithmetic mean is another law
    assert abs(mean[0] - limits.stratified(law.fractions, stiffnesses)[0, 0]) > 0.05 * mean[0]


@pytest.mark.parametrize("name", ["closed form and return", "monodirectional", "unilateral"])
def test_sublayers_that_all_yield(name):
    """Equal ones are the law itself, whatever the split; of others, under pressure, the order does not matter."""
    law, random = LAWS[name], np.random.default_rng(9)
    w = np.cumsum(0.01 * random.normal(size=(40, 3)), axis=0) * [1.0, 0.3, 0.0] - [0.0, 0.005, 0.0]
    path = [{"w_T": x, "w_N": y} for x, y, _ in w]
    alone, stack = drive(law, path), drive(Stack((0.2, law), (0.5, law), (0.3, law)), path)
    size = np.abs(alone.tractions).max()
    assert (alone.energies[:, 1] > 0).any()
    assert stack.tractions == pytest.approx(alone.tractions, abs=1e-9 * size)
    assert stack.energies == pytest.approx(alone.energies, abs=1e-8 * np.abs(alone.energies).max())
    mixed = Stack((0.2, law), (0.5, LinearElastic(30.0, 50.0)), (0.3, law.with_parameters({"cohesion": 0.3})))
    reverse = Stack(*mixed.sublayers[::-1])
    pressed = [step | {"w_N": -0.002 - abs(step["w_N"])} for step in path]
    one, other = drive(mixed, pressed), drive(reverse, pressed)
    assert other.tractions == pytest.approx(one.tractions, abs=1e-7 * size)
    assert one.energies[:, 1].min() > -1e-12


PAIRS = {
    "full, unilateral": (
        MohrCoulomb(113.0, 75.0, 0.1, 10.0),
        MohrCoulombMonodirectional(52.0, 34.0, 0.1, 30.0, unilateral=True),
    ),
    "full, full": (MohrCoulomb(86.0, 58.0, 0.0, 30.0), MohrCoulomb(120.0, 80.0, 0.1, 45.0)),
    "bilateral, bilateral": (
        MohrCoulombMonodirectional(90.0, 60.0, 0.2, 45.0),
        MohrCoulombMonodirectional(60.0, 40.0, 0.1, 30.0),
    ),
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
        for i, one in enumerate(laws):
            memory = q[:, first : first + material(one).memory]
            first += memory.shape[1]
            ends = new + jump_strain(shares[:, i], n), e + jump_strain(old[:, i], n)
            tractions.append(traction(respond(one, *ends, memory, n).stress, n)[done])
        tractions = np.array(tractions)
        assert np.abs(tractions - tractions[0]).max() < 1e-7 * np.abs(tractions).max()
        q, e = np.where(done[:, None], answer.q, q), np.where(done[:, None], new, e)
    assert failed < 0.1 * 8 * points


def test_elastic_and_full_sublayers():
    """Against a Newton method of its own: the sublayers' jumps, with the closed formula for the plastic one."""
    a, above = 0.6, LinearElastic(100.0, 15.0)
    law = Stack((1 - a, above), (a, LAW))
    K = np.diag([above.mu, above.lmbda + 2 * above.mu])
    share_old, s, path, expected, yielded = np.zeros(2), np.zeros(2), [], [], 0
    for w_T, w_N in [(0, -0.01), (0.01, -0.01), (0.03, -0.012), (0.02, -0.02), (-0.03, -0.02), (-0.03, -0.005)]:
        w, share = np.array([w_T, w_N], float), share_old

        def lack(share, w=w, share_old=share_old, s=s):
            t, _ = limits.mohr_coulomb(LMBDA, MU, C, OMEGA, share, share_old, s)
            return t - K @ (w - a * share) / (1 - a)

        for _ in range(50):
            J = np.column_stack([(lack(share + d) - lack(share - d)) / 2e-7 for d in 1e-7 * np.eye(2)])
            share = share - np.linalg.solve(J, lack(share))
        assert np.abs(lack(share)).max() < 1e-10
        t, s = limits.mohr_coulomb(LMBDA, MU, C, OMEGA, share, share_old, s)
        yielded += np.linalg.norm(s) > C * np.cos(np.pi / 6) - (LMBDA + MU) * share[1] / 2 - 1e-12
        share_old = share
        path.append({"w_T": w_T, "w_N": w_N})
        expected.append(t)
    assert 2 <= yielded < 6
    assert drive(law, path).tractions == pytest.approx(np.array(expected), rel=1e-8, abs=1e-10)


# ---------------------------------------------------------------- bad parameters
@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: MohrCoulomb(LMBDA, MU, -0.1, 30.0), "MohrCoulomb: cohesion is -0.1; allowed: >= 0"),
        (lambda: MohrCoulomb(LMBDA, MU, float("inf"), 30.0), "cohesion is inf"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 90.0), "friction_angle is 90.0; allowed: 0 <= friction_angle < 90 degrees"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, -1.0), "friction_angle is -1.0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, float("nan")), "friction_angle is nan"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.0, 0.0), "cohesion is 0.0; allowed: > 0 where friction_angle = 0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, dilatancy_angle=31.0),
            "dilatancy_angle is 31.0; allowed: 0 <= dilatancy_angle <= friction_angle = 30 degrees",
        ),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, dilatancy_angle=-1.0), "dilatancy_angle is -1.0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, elastic_fraction=1.0),
            "elastic_fraction is 1.0; allowed: 0 <= elastic_fraction < 1",
        ),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, elastic_fraction=-0.1), "elastic_fraction is -0.1"),
        (lambda: MohrCoulomb(LMBDA, 0.0, 0.1, 30.0), "mu is 0.0; allowed: > 0"),
        (lambda: MohrCoulomb(-30.0, MU, 0.1, 30.0), "lmbda is -30.0"),
        (lambda: MohrCoulombReturn(LMBDA, MU, 0.1, 30.0, dilatancy_angle=31.0),
            "MohrCoulombReturn: dilatancy_angle is 31.0",
        ),
        (lambda: MohrCoulombReturn(LMBDA, MU, -0.1, 30.0), "MohrCoulombReturn: cohesion is -0.1"),
        (lambda: MohrCoulomb(LMBDA, MU, "0.1", 30.0), "cohesion is '0.1'; allowed: a number"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, -0.1, 30.0), "MohrCoulombMonodirectional: cohesion is -0.1"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 95.0), "friction_angle is 95.0"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, unilateral=1), "unilateral is 1; allowed: True or False"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, unilateral="no"), "unilateral is 'no'"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, dilatancy_angle=1.0), "no parameter 'dilatancy_angle'"),
        (lambda: LAW.eased(1.5), "ease is 1.5; allowed: 0 to 1"),
        (lambda: LAW.eased("a bit"), "ease is 'a bit'; allowed: 0 to 1"),
        (lambda: LAW.plane_stress(), "plane stress is not defined for MohrCoulomb"),
    ],
)  # fmt: skip
def test_what_the_laws_refuse(build, message):
    with pytest.raises(LawError, match=message):
        build()
