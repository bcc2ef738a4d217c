"""The return has the closed form of plane strain where this holds, and solves the six yield planes, enumerated."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms import MohrCoulomb
from tests import closed_forms
from tests.at_points import E2, at_rest, respond, tensor
from tests.mohr_coulomb_points import (
    LAW,
    LMBDA,
    MU,
    OMEGA,
    ONE,
    C,
    compliance,
    elastic,
    normals,
    principal,
    strains,
)
from thinlayer.pointwise.drive import drive

pytestmark = pytest.mark.few(5)

SLOW = settings(max_examples=60)


# ---------------------------------------------------------------- the closed form


@given(st.lists(st.tuples(st.floats(-0.03, 0.03), st.floats(-0.03, 0.0)), min_size=1, max_size=6))
@SLOW
def test_the_layer_is_its_closed_formula(path):
    """`closed_forms.mohr_coulomb`, any path in compression; absolute tolerances for jumps next to nothing."""
    history = drive(LAW, [{"w_T": w_T, "w_N": w_N} for w_T, w_N in path])
    w_old = s = np.zeros(2)
    for w, traction in zip(np.array(path), history.tractions, strict=True):
        t, s = closed_forms.mohr_coulomb(LMBDA, MU, C, OMEGA, w, w_old, s)
        w_old = w
        assert traction == pytest.approx(t, rel=1e-9, abs=1e-13)


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
    stresses = []
    for active in (list(some) for count in (1, 2, 3) for some in combinations(range(6), count)):
        A = N[active] @ D @ M[active].T
        if np.linalg.cond(A) > 1e10:
            continue
        g = np.linalg.solve(A, beyond[active])
        s = trial - D @ M[active].T @ g
        if (g >= -1e-12 * size).all() and (N @ s - strength <= 1e-10 * size).all():
            stresses.append(s)
    return stresses


ANGLES = {"psi = 0": (30.0, 0.0), "0 < psi < Omega": (35.0, 10.0), "psi = Omega": (25.0, 25.0), "Tresca": (0.0, 0.0)}


def kinds(s, q):
    """Elastic 0, face 1, edge 2, apex 3, of stresses and plastic strains from rest (points, 6)."""
    equal = np.abs(np.diff(principal(s), axis=1)) < 1e-9 * np.abs(s).max()
    return np.where(np.abs(q).max(axis=1) == 0, 0, 1 + equal.sum(axis=1))


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize("lmbda", [60.0, -10.0, 900.0])
def test_the_return_is_the_solution_of_the_six_planes(name, lmbda):
    """One stress only, whatever set of planes; none for psi = 0 beyond the apex, where the stress is cut off."""
    Omega, psi = ANGLES[name]
    law = MohrCoulomb(lmbda, MU, C, Omega, dilatancy_angle=psi)
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
        stress = principal(answer.stress[k])
        size = np.abs(trial[k]).max()
        for solution in solutions:
            assert np.abs(stress - np.sort(solution)[::-1]).max() < 1e-9 * size
        commute = tensor(answer.stress[k]) @ tensor(trial[k])
        assert np.abs(commute - commute.T).max() < 1e-11 * size**2  # the same axes
    counts = np.bincount(seen, minlength=4)
    assert counts[1:].sum() > 50
    if lmbda == LMBDA:
        assert (counts >= ((50, 50, 20, 3) if Omega else (0, 50, 50, 0))).all()
    assert answer.q[:, :6] == pytest.approx(e - compliance(answer.stress, lmbda), abs=1e-14)


def test_torn_material_closes_only_when_the_volume_is_pressed_out():
    """psi = 0: at the cut-off the volume is plastic; unloading is elastic from there, compression comes late."""
    apex, bulk = C / np.tan(np.radians(OMEGA)), LMBDA + 2 * MU / 3
    e = np.array([0.02 / 3 * ONE, 0.019 / 3 * ONE, (0.02 - 2 * apex / bulk) / 3 * ONE])
    q, old, pressures = at_rest(LAW, 1), np.zeros((1, 6)), []
    for now in e:
        answer = respond(LAW, now[None], old, q, E2[None])
        assert answer.stress[0] == pytest.approx(answer.stress[0, 0] * ONE, abs=1e-15)
        pressures.append(answer.stress[0, 0])
        old, q = now[None], answer.q
    assert pressures == pytest.approx([apex, apex - bulk * 0.001, -apex], rel=1e-12)
