"""The singular field at corners of free ends: exponents, equilibrium, strengths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from forms.base import InputError
from forms.ends.corner import Corner
from tests.refused import refused

RATIOS = (0.1, 0.3, 0.45, 0.5)


def determinant(power: float, nu: float) -> float:
    """Of the wedge held at 0 and free at pi/2, with Airy's function r^(power + 1) F(theta), as Williams has it."""
    p, m = power + 1, power - 1

    def F(theta, k):
        c, s = np.cos, np.sin
        return [
            np.array([s(p * theta), c(p * theta), s(m * theta), c(m * theta)]),
            np.array([p * c(p * theta), -p * s(p * theta), m * c(m * theta), -m * s(m * theta)]),
        ][k]

    # harmonic conjugates: 4 (1 - nu) times them is what displacements have beside the derivatives of F
    other = 4 * (1 - nu) * np.array([[0, 0, np.sin(0), np.cos(0)], [0, 0, -np.cos(0), np.sin(0)]])
    u_r = -p * F(0.0, 0) + other[0]
    u_t = -F(0.0, 1) + other[1]
    return float(np.linalg.det(np.stack([u_r, u_t, F(np.pi / 2, 0), F(np.pi / 2, 1)])))


@pytest.mark.parametrize("nu", RATIOS)
def test_the_exponent_is_that_of_williams(nu):
    found = brentq(determinant, 0.3, 0.99, args=(nu,), xtol=1e-15)
    assert Corner(nu).exponent == pytest.approx(found, abs=1e-12)


def test_exponents_that_are_known():
    assert Corner(0.3).exponent == pytest.approx(0.71117, abs=1e-5)  # stresses ~ r^-0.289
    assert Corner(0.5).exponent == pytest.approx(0.59461, abs=1e-5)
    assert Corner(0.0).exponent == 1.0


@pytest.mark.parametrize("nu", RATIOS)
def test_the_singular_field_is_elastic_and_in_equilibrium(nu):
    corner, r, h = Corner(nu), 0.7, 1e-5
    angles = np.array([0.2, 0.9, 1.4])
    x = r * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def at(x):
        return corner.field(np.linalg.norm(x, axis=1), np.arctan2(x[:, 1], x[:, 0]))

    (u_x, s_x), (u_y, s_y) = (
        [(a - b) / (2 * h) for a, b in zip(at(x + h * e), at(x - h * e), strict=True)] for e in np.eye(2)
    )
    _, stress = at(x)
    np.testing.assert_allclose(s_x[:, 0] + s_y[:, 2], 0, atol=1e-8)
    np.testing.assert_allclose(s_x[:, 2] + s_y[:, 1], 0, atol=1e-8)
    np.testing.assert_allclose(u_x[:, 1] + u_y[:, 0], stress[:, 2], rtol=1e-7)
    np.testing.assert_allclose(2 * (u_x[:, 0] - u_y[:, 1]), stress[:, 0] - stress[:, 1], rtol=1e-6)
    volume = (1 - 2 * nu) * (stress[:, 0] + stress[:, 1]) / 2
    np.testing.assert_allclose(u_x[:, 0] + u_y[:, 1], volume, atol=1e-8)
    on_face, on_side = (corner.field(np.array(r), np.array(angle)) for angle in (0.0, np.pi / 2))
    np.testing.assert_allclose(on_face[0], 0, atol=1e-12)
    np.testing.assert_allclose(on_side[1][[0, 2]], 0, atol=1e-12)
    np.testing.assert_allclose(on_face[1][1:], np.array([1, corner.shear]) * r ** (corner.exponent - 1), rtol=1e-12)


def test_strengths_do_not_depend_on_the_radius_but_on_the_exponent():
    corner, H = Corner(0.2), 2.7

    def strength(of, r):
        u, stress = corner.field(np.array(r), of._arc[0])
        return of.strength(r, H * u, H * stress)

    found = [strength(corner, r) for r in (0.01, 0.1, 0.45)]
    assert found == pytest.approx([H] * 3, rel=1e-12)
    wrong = [strength(Corner(0.3), r) for r in (0.01, 0.1)]
    assert abs(wrong[0] / wrong[1] - 1) > 0.05


def test_ratios_out_of_range_are_refused():
    refused(InputError, r"from 0 to 0\.5", Corner, 0.51)
