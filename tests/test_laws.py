"""Laws at a point, against the closed formulas, for random moduli and directions; and their range checks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms import LinearElastic, Stack
from forms.base import InputError
from tests import closed_forms
from tests.at_points import at_rest, jump_strain, respond, traction
from tests.refused import refused
from thinlayer import ThinLayer


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


@given(E=moduli, nu=st.floats(-0.9, 0.49))
def test_moduli(E, nu):
    law = LinearElastic.young(E, nu)
    assert law.lmbda + 2 * law.mu == pytest.approx(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), rel=1e-9)
    assert law.plane_stress().lmbda + 2 * law.mu == pytest.approx(E / (1 - nu**2), rel=1e-9)
    assert LinearElastic.shear(law.mu, nu).lmbda == pytest.approx(law.lmbda, rel=1e-9, abs=1e-12 * E)


def test_layers_out_of_range():
    glue = LinearElastic(1.0, 1.0)
    refused(InputError, "eps is 0.0; allowed: > 0", ThinLayer, glue, 0.0, at=1.0)
    refused(InputError, "must be a law", ThinLayer, "glue", 1.0)
    refused(InputError, "at, is 0.0", ThinLayer, glue, 1.0, at=0.0)
