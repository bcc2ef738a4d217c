"""Hardening at points: von Mises' law, and the cohesion of the Mohr-Coulomb laws that grows with the plastic strain."""

from __future__ import annotations

import numpy as np
import pytest

from forms import MohrCoulombMonodirectional, VonMises
from tests import closed_forms
from tests.at_points import at_rest, respond, tensor
from tests.mohr_coulomb_points import LMBDA, METALS, MU, OMEGA, SOILS, C, Y, elastic, normals, reached, strains
from thinlayer import drive

POINTS = 300


def equivalent(law, stress, plastic):
    s = tensor(stress - 2 / 3 * law.kinematic * plastic)
    s = s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.einsum("kij,kij->k", s, s))


@pytest.mark.parametrize("name", METALS)
def test_metals_stay_on_their_yield_surface(name):
    law, random, flowed = METALS[name], np.random.default_rng(4), False
    q, e = at_rest(law, POINTS), np.zeros((POINTS, 6))
    for _ in range(3):
        old, e = e, e + strains(random, POINTS, 0.006)
        now = respond(law, e, old, q, normals(POINTS))
        plastic, p = now.q[:, :6], now.q[:, 6]
        bound = Y + law.hardening * p
        if law.saturation:
            bound = bound + law.saturation * (1 - np.exp(-p / law.saturation_strain))
        size, flows = equivalent(law, now.stress, plastic), p > q[:, 6]
        assert (size <= bound * (1 + 1e-12)).all()
        assert size[flows] == pytest.approx(bound[flows], rel=1e-12)
        assert now.stress == pytest.approx(elastic(e - plastic), abs=1e-13)
        assert np.abs(plastic[:, :3].sum(axis=1)).max() < 1e-15
        assert p - q[:, 6] == pytest.approx(np.sqrt(2 / 3) * np.linalg.norm(plastic - q[:, :6], axis=1), abs=1e-15)
        flowed, q = flowed or flows.any(), now.q
    assert flowed


@pytest.mark.parametrize("name", METALS)
@pytest.mark.parametrize("theta", [1.0, 0.6])
def test_metals_dissipate_yield_stress_times_plastic_strain(name, theta):
    """The yield stress is that at the time within the step at which the stress is found."""
    law, e = METALS[name], strains(np.random.default_rng(7), POINTS, 0.012)
    now = respond(law, e, 0 * e, at_rest(law, POINTS), normals(POINTS), theta=theta)
    p = now.q[:, 6]
    bound = Y + law.hardening * theta * p
    if law.saturation:
        bound = bound + law.saturation * (1 - np.exp(-theta * p / law.saturation_strain))
    assert (p > 0).any()
    assert now.dissipated == pytest.approx(bound * p, rel=1e-11, abs=1e-14)


# ---------------------------------------------------------------- as layers
def test_a_layer_of_metal_under_shear():
    law = VonMises(LMBDA, MU, Y, hardening=8.0, kinematic=6.0)
    w = np.linspace(0.001, 0.05, 12)
    t_T = drive(law, [{"w_T": jump, "w_N": 0.0} for jump in w]).tractions[:, 0]
    assert t_T == pytest.approx(closed_forms.von_mises_shear(MU, Y, 14.0, w), rel=1e-10)


def test_a_layer_that_slips_hardens():
    """Forth and back, with the closed form of one step after the other."""
    law, H = MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, hardening=12.0), 12.0
    path = [(0.004, -0.001), (0.008, -0.002), (-0.004, -0.002), (0.01, 0.0005)]
    history = drive(law, [{"w_T": a, "w_N": b} for a, b in path])
    slip, gone, n = np.zeros(2), 0.0, np.array([0.0, 1.0])
    for w, traction in zip(np.array(path), history.tractions, strict=True):
        t, new = closed_forms.penalised_coulomb(LMBDA, MU, C, OMEGA, w, slip, n, hardening=H, accumulated=gone)
        assert traction == pytest.approx(t, rel=1e-10)
        gone, slip = gone + float(np.linalg.norm(new - slip)), new


def test_a_torn_point_bears_the_mean_stress_of_the_apex():
    """psi = 0: the deviator is gone, the larger part of it hardens, and the cohesion is that of this flow."""
    law = SOILS["hardening"]
    e = np.array([[0.02, 0.011, 0.012, 0.002, 0.0, 0.0], [0.02, 0.019, 0.008, 0.002, 0.0, 0.0]])
    answer = respond(law, e, 0 * e, at_rest(law, 2), normals(2))
    deviators = np.linalg.eigvalsh(tensor(e)) - e[:, :3].mean(axis=1, keepdims=True)
    assert answer.q[:, 6] == pytest.approx(2 * np.cos(np.radians(OMEGA)) * np.abs(deviators).max(axis=1), rel=1e-12)
    apex = reached(law, answer.q) / np.tan(np.radians(OMEGA))
    assert answer.stress == pytest.approx(np.outer(apex, [1, 1, 1, 0, 0, 0]), abs=1e-12)


def test_a_layer_that_slips_far_is_on_its_yield_surface():
    """Most of the cohesion that can be gained is, in one step."""
    law = SOILS["hardening, monodirectional"]
    history = drive(law, [{"w_T": 2.0, "w_N": -0.001}])
    (t_T, t_N), cohesion = history.tractions[0], reached(law, history.memory)[0]
    assert t_T == pytest.approx(cohesion - np.tan(np.radians(OMEGA)) * t_N, rel=1e-10)
