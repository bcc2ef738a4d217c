"""Hardening at points: von Mises' law, and the cohesion of the Mohr-Coulomb laws that grows with the plastic strain."""

from __future__ import annotations

import numpy as np
import pytest

from forms import MohrCoulomb, MohrCoulombMonodirectional, VonMises
from forms.base import InputError
from tests import closed_forms
from tests.at_points import E2, at_rest, respond, tensor, traction
from tests.mohr_coulomb_points import elastic, excess, normals, strains
from tests.refused import refused
from thinlayer import drive

LMBDA, MU, Y, C, OMEGA = 60.0, 40.0, 0.3, 0.1, 30.0
COHESIVE = {"hardening": 20.0, "saturation": 0.2, "saturation_strain": 0.01}
METALS = {
    "ideal": VonMises(LMBDA, MU, Y),
    "isotropic": VonMises(LMBDA, MU, Y, hardening=25.0),
    "kinematic": VonMises(LMBDA, MU, Y, kinematic=25.0),
    "saturating": VonMises(LMBDA, MU, Y, 5.0, 10.0, saturation=0.4, saturation_strain=0.004),
}
SOILS = {
    "Mohr-Coulomb": MohrCoulomb(LMBDA, MU, C, OMEGA, **COHESIVE),
    "dilatant": MohrCoulomb(LMBDA, MU, C, OMEGA, 0.1, 12.0, **COHESIVE),
    "associated": MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=OMEGA, **COHESIVE),
    "Tresca": MohrCoulomb(LMBDA, MU, C, 0.0, **COHESIVE),
    "monodirectional": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, **COHESIVE),
    "unilateral": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, unilateral=True, **COHESIVE),
}
LAWS = METALS | SOILS
POINTS = 300


def steps(law, theta=1.0, count=3, size=0.006):
    """Steps of a random path: strains at its ends, values before, the answer."""
    random = np.random.default_rng(4)
    n, q, e = normals(POINTS), at_rest(law, POINTS), np.zeros((POINTS, 6))
    stored = np.zeros(POINTS)
    for _ in range(count):
        old, e = e, e + strains(random, POINTS, size)
        answer = respond(law, e, old, q, n, 1.0, theta)
        assert answer.failed == 0
        yield e, old, q, n, stored, answer
        q, stored = answer.q, answer.stored


@pytest.mark.parametrize("theta", [1.0, 0.6])
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """Remainder of Taylor's expansion: second order, but where a point passes a kink."""
    law = LAWS[name]
    *_, (e, old, q, n, _, now) = steps(law, theta)
    direction = 1e-3 * np.random.default_rng(1).normal(size=e.shape)
    left = []
    for h in (1e-2, 1e-3):
        moved = respond(law, e + h * direction, old, q, n, 1.0, theta)
        change = moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)
        left.append(np.abs(change).max(axis=1))
    flows = now.q[:, 6] > q[:, 6]
    assert flows.mean() > 0.1
    curved = flows & (left[1] > 1e-13 * np.abs(now.stress).max())
    assert curved.sum() > 20
    assert np.mean(np.log10(left[0] / left[1])[curved] > 1.9) > 0.9
    assert np.median(np.log10(left[0] / left[1])[curved]) == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize("theta", [1.0, 0.6, 0.5])
@pytest.mark.parametrize("name", LAWS)
def test_energy_of_a_step_is_accounted_for(name, theta):
    law, largest = LAWS[name], 0.0
    for e, old, q, _, stored, now in steps(law, theta):
        work = np.sum(now.stress * (e - old), axis=1)
        size = np.max(np.abs([work, now.stored, stored, now.dissipated, now.remainder]), axis=0)
        assert (np.abs(work - (now.stored - stored) - now.dissipated - now.remainder) < 1e-11 * size).all()
        assert (now.dissipated >= -1e-13 * size).all()
        assert (now.q[:, 6] >= q[:, 6]).all()
        if name != "unilateral":
            assert (now.remainder >= -1e-12 * size).all()
        largest = max(largest, float((now.dissipated / size).max()))
    assert largest > 0.2


def equivalent(law, stress, plastic):
    s = tensor(stress - 2 / 3 * law.kinematic * plastic)
    s = s - np.trace(s, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.einsum("kij,kij->k", s, s))


@pytest.mark.parametrize("name", METALS)
def test_metals_stay_on_their_yield_surface(name):
    law, flowed = METALS[name], False
    for e, _, q, _, _, now in steps(law):
        plastic, p = now.q[:, :6], now.q[:, 6]
        bound = Y + law.hardening * p
        if law.saturation:
            bound = bound + law.saturation * (1 - np.exp(-p / law.saturation_strain))
        size, flows = equivalent(law, now.stress, plastic), p > q[:, 6]
        assert (size <= bound * (1 + 1e-12)).all()
        assert size[flows] == pytest.approx(bound[flows], rel=1e-12)
        assert now.stress == pytest.approx(elastic(e - plastic), abs=1e-13)
        assert np.abs(plastic[:, :3].sum(axis=1)).max() < 1e-15
        growth = np.sqrt(2 / 3) * np.linalg.norm(plastic - q[:, :6], axis=1)
        assert p - q[:, 6] == pytest.approx(growth, abs=1e-15)
        flowed = flowed or flows.any()
    assert flowed


@pytest.mark.parametrize("name", [name for name in SOILS if "directional" not in name and name != "unilateral"])
def test_soils_stay_on_their_yield_surface(name):
    """With the cohesion that they have reached."""
    law, flowed = SOILS[name], 0.0
    for e, _, q, _, _, now in steps(law):
        plastic = (now.stress - law.elastic_fraction * elastic(e)) / (1 - law.elastic_fraction)
        p = now.q[:, 6]
        reached = C + 20.0 * p + 0.2 * p / (0.01 + p)
        beyond = excess(plastic, reached, law.friction_angle)
        scale = np.abs(elastic(e)).max()
        assert beyond.max() <= 1e-12 * scale
        flows = p > q[:, 6]
        assert beyond[flows] == pytest.approx(0.0, abs=1e-10 * scale)
        flowed = max(flowed, float(p.max()))
    assert flowed > 0.005


# ---------------------------------------------------------------- as layers
def test_a_layer_of_metal_under_shear():
    law = VonMises(LMBDA, MU, Y, hardening=8.0, kinematic=6.0)
    w = np.linspace(0.001, 0.05, 12)
    found = drive(law, [{"w_T": one, "w_N": 0.0} for one in w]).tractions[:, 0]
    assert found == pytest.approx(closed_forms.von_mises_shear(MU, Y, 14.0, w), rel=1e-10)
    assert np.abs(found - closed_forms.von_mises_shear(MU, Y, 20.0, w)).max() > 0.05 * found.max()


def test_a_layer_of_metal_under_shear_at_a_held_opening():
    """Backward Euler to first order in the step."""
    law, w_N, errors = VonMises(LMBDA, MU, Y), -0.003, []
    for count in (40, 80):
        w = np.linspace(0, 0.03, count + 1)[1:]
        found = drive(law, [{"w_T": 0.0, "w_N": w_N}] + [{"w_T": one, "w_N": w_N} for one in w]).tractions[1:]
        exact = closed_forms.von_mises_fixed_opening(LMBDA, MU, Y, w_N, w)
        errors.append(np.abs(found - exact).max() / Y)
    assert errors[1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    refused(InputError, "not below Y", closed_forms.von_mises_fixed_opening, LMBDA, MU, Y, 0.01, w)


def test_a_layer_that_slips_hardens():
    """Forth and back, with the closed form of one step after the other."""
    law, H = MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, hardening=12.0), 12.0
    path = [(0.004, -0.001), (0.008, -0.002), (-0.004, -0.002), (0.01, 0.0005)]
    history = drive(law, [{"w_T": a, "w_N": b} for a, b in path])
    slip, gone, n, apart = np.zeros(2), 0.0, np.array([0.0, 1.0]), 0.0
    for w, found in zip(np.array(path), history.tractions, strict=True):
        t, new = closed_forms.penalised_coulomb(LMBDA, MU, C, OMEGA, w, slip, n, hardening=H, accumulated=gone)
        wrong, _ = closed_forms.penalised_coulomb(LMBDA, MU, C, OMEGA, w, slip, n, hardening=H)
        assert found == pytest.approx(t, rel=1e-10)
        apart = max(apart, np.abs(found - wrong).max() / np.abs(t).max())
        gone, slip = gone + float(np.linalg.norm(new - slip)), new
    assert apart > 0.05


@pytest.mark.parametrize("eps", [0.5, 0.02])
@pytest.mark.parametrize("name", ["saturating", "Mohr-Coulomb", "monodirectional"])
def test_thickness_does_not_change_the_interface_law(name, eps):
    """Real parameters and strains w/eps give the traction of parameters per thickness and w."""
    law, path = LAWS[name], [(0.004, -0.001), (0.02, -0.002), (-0.01, -0.001)]
    thin = drive(law, [{"w_T": a, "w_N": b} for a, b in path]).tractions
    real = drive(law.scaled(eps), [{"w_T": a / eps, "w_N": b / eps} for a, b in path]).tractions
    assert real == pytest.approx(thin, rel=1e-10)


def test_eased_metal_is_elastic_in_the_end():
    law, e = VonMises(LMBDA, MU, Y), strains(np.random.default_rng(2), 5, 0.05)
    zero = np.zeros_like(e)
    found = [respond(law.eased(ease), e, zero, at_rest(law, 5), normals(5)).stress for ease in (0.0, 0.5, 1.0)]
    assert found[0] == pytest.approx(respond(law, e, zero, at_rest(law, 5), normals(5)).stress)
    assert found[2] == pytest.approx(elastic(e), rel=1e-6)
    assert np.linalg.norm(found[1]) > np.linalg.norm(found[0])


def test_a_torn_point_bears_the_mean_stress_of_the_apex():
    """psi = 0: the deviator is gone, and the cohesion is that of the flow that took it away."""
    law = SOILS["Mohr-Coulomb"]
    e = np.array([[0.02, 0.011, 0.012, 0.002, 0.0, 0.0]])
    found = respond(law, e, 0 * e, at_rest(law, 1), normals(1))
    p = found.q[0, 6]
    reached = C + 20.0 * p + 0.2 * p / (0.01 + p)
    assert p > 0
    assert traction(found.stress, E2[None])[0] == pytest.approx([0, reached / np.tan(np.radians(OMEGA)), 0], abs=1e-12)
