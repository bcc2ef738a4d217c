"""Laws at a point, against the closed formulas, for random moduli and directions; and their range checks."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem, mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from forms import Anisotropic, LinearElastic, Stack
from forms.base import InputError
from forms.kinematics import layer_frame
from tests import closed_forms
from tests.at_points import at_rest, jump_strain, respond, traction
from tests.refused import refused
from thinlayer import ThinLayer

CELL = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)


def traction_and_energy(law, w, n):
    """Traction (3,) and energy of a law at one point of S with jump w and normal n, (2,) or (3,)."""
    w, n = (np.pad(a, (0, 3 - len(a)))[None] for a in (w, n))
    strain = jump_strain(w, n)
    answer = respond(law, strain, 0 * strain, at_rest(law, 1), n, dt=0.0)
    assert not answer.failed
    return traction(answer.stress, n)[0], answer.stored[0]


moduli = st.floats(0.1, 50.0)
jumps = st.lists(st.floats(-2.0, 2.0).map(lambda x: round(x, 9)), min_size=3, max_size=3).map(np.array)
angles = st.floats(-np.pi, np.pi)


def direction(a, b, dim):
    if dim == 2:
        return np.array([np.sin(a), np.cos(a)])
    return np.array([np.sin(a) * np.cos(b), np.cos(a), np.sin(a) * np.sin(b)])


@pytest.mark.parametrize("dim", [2, 3])
@settings(max_examples=25)
@given(lmbda=moduli, mu=moduli, w=jumps, a=angles, b=angles)
def test_elastic(dim, lmbda, mu, w, a, b):
    """Eq. (17) and its energy, w.K w/2."""
    n, law = direction(a, b, dim), LinearElastic(lmbda, mu)
    t, energy = traction_and_energy(law, w[:dim], n)
    expected = closed_forms.elastic(lmbda, mu, w[:dim], n)
    size = (lmbda + 2 * mu) * max(np.linalg.norm(w), 1e-300)
    assert t[:dim] == pytest.approx(expected, abs=1e-13 * size)
    assert energy == pytest.approx(expected @ w[:dim] / 2, rel=1e-10, abs=1e-13 * size)


@pytest.mark.parametrize("dim", [2, 3])
@settings(max_examples=25)
@given(m=st.lists(moduli, min_size=6, max_size=6), w=jumps, a=angles, b=angles)
def test_stratified(dim, m, w, a, b):
    """Compliances add up, whatever the order of the sublayers."""
    n = direction(a, b, dim)
    laws = [LinearElastic(m[2 * k], m[2 * k + 1]) for k in range(3)]
    fractions = (0.3, 0.5, 0.2)
    K = closed_forms.stratified(fractions, [closed_forms.elastic_stiffness(law.lmbda, law.mu, n) for law in laws])
    t, energy = traction_and_energy(Stack(*zip(fractions, laws, strict=True)), w[:dim], n)
    size = np.linalg.norm(K) * max(np.linalg.norm(w), 1e-300)
    assert t[:dim] == pytest.approx(K @ w[:dim], abs=1e-11 * size)
    assert energy == pytest.approx(w[:dim] @ K @ w[:dim] / 2, rel=1e-8, abs=1e-12 * size)


@pytest.mark.parametrize("dim", [2, 3])
@settings(max_examples=25)
@given(k_n=moduli, k_t=moduli, w=jumps, a=angles, b=angles)
def test_springs(dim, k_n, k_t, w, a, b):
    n = direction(a, b, dim)
    t, _ = traction_and_energy(Anisotropic.springs(k_n, k_t), w[:dim], n)
    w = w[:dim]
    expected = k_t * w + (k_n - k_t) * (w @ n) * n
    assert t[:dim] == pytest.approx(expected, abs=1e-9 * (k_n + k_t) * max(np.linalg.norm(w), 1e-300))


@pytest.mark.parametrize("n", [(0, 1, 0), (0, -1, 0), (1, 0, 0), (0.6, -0.48, 0.64), (0, 1), (0, -1), (0.8, -0.6)])
def test_layer_frame_is_a_rotation_with_second_axis_n(n):
    constant = fem.Constant(CELL, np.array(n, float))
    turn = fem.Expression(layer_frame(constant), np.zeros((1, 2))).eval(CELL, np.array([0], np.int32)).reshape(3, 3)
    assert turn.T @ turn == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert turn[:, 1] == pytest.approx([*n, 0][:3])


@given(lmbda=moduli, mu=moduli, eps=st.floats(1e-6, 10.0))
def test_a_layer_has_the_parameters_of_its_material(lmbda, mu, eps):
    real = ThinLayer(LinearElastic(lmbda, mu).scaled(1 / eps), eps, at=1.0).material
    assert (float(real.lmbda), float(real.mu)) == pytest.approx((lmbda, mu), rel=1e-12)


@given(E=moduli, nu=st.floats(-0.9, 0.49))
def test_moduli(E, nu):
    law = LinearElastic.young(E, nu)
    assert law.lmbda + 2 * law.mu == pytest.approx(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), rel=1e-9)
    assert law.plane_stress().lmbda + 2 * law.mu == pytest.approx(E / (1 - nu**2), rel=1e-9)
    assert LinearElastic.shear(law.mu, nu).lmbda == pytest.approx(law.lmbda, rel=1e-9, abs=1e-12 * E)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ThinLayer(LinearElastic(1.0, 1.0), 0.0, at=1.0), "eps is 0.0; allowed: > 0"),
        (lambda: ThinLayer(LinearElastic(1.0, 1.0), np.ones(3)), "eps is .*must be > 0|allowed"),
        (lambda: ThinLayer("glue", 1.0), "must be a law"),
        (lambda: ThinLayer(LinearElastic(1.0, 1.0), 1.0, at=0.0), "at, is 0.0"),
    ],
)
def test_layers_out_of_range(build, message):
    refused(InputError, message, build)
