"""The singular field at corners of free ends: exponents, equilibrium, strengths."""

from __future__ import annotations

import numpy as np
import pytest

from forms.ends.corner import CornerField

RATIOS = (0.1, 0.3, 0.45, 0.5)


def test_exponents_that_are_known():
    """Of Williams; tests of the field hold the others."""
    for nu, exponent in ((0.0, 1.0), (0.3, 0.71117), (0.5, 0.59461)):  # 0.3: stresses ~ r^-0.289
        assert CornerField(nu).exponent == pytest.approx(exponent, abs=1e-5)


@pytest.mark.parametrize("nu", RATIOS)
def test_the_singular_field_is_elastic_and_in_equilibrium(nu):
    corner, r, h = CornerField(nu), 0.7, 1e-5
    angles = np.array([0.2, 0.9, 1.4])
    x = r * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def at(x):
        return corner.unit_field(np.linalg.norm(x, axis=1), np.arctan2(x[:, 1], x[:, 0]))

    slopes = lambda e: [(a - b) / (2 * h) for a, b in zip(at(x + h * e), at(x - h * e), strict=True)]
    (u_x, s_x), (u_y, s_y) = map(slopes, np.eye(2))
    _, stress = at(x)
    np.testing.assert_allclose(s_x[:, 0] + s_y[:, 2], 0, atol=1e-8)
    np.testing.assert_allclose(s_x[:, 2] + s_y[:, 1], 0, atol=1e-8)
    np.testing.assert_allclose(u_x[:, 1] + u_y[:, 0], stress[:, 2], rtol=1e-7)
    np.testing.assert_allclose(2 * (u_x[:, 0] - u_y[:, 1]), stress[:, 0] - stress[:, 1], rtol=1e-6)
    np.testing.assert_allclose(u_x[:, 0] + u_y[:, 1], (1 - 2 * nu) * (stress[:, 0] + stress[:, 1]) / 2, atol=1e-8)
    on_face, on_side = (corner.unit_field(np.array(r), np.array(angle)) for angle in (0.0, np.pi / 2))
    np.testing.assert_allclose(on_face[0], 0, atol=1e-12)
    np.testing.assert_allclose(on_side[1][[0, 2]], 0, atol=1e-12)
    np.testing.assert_allclose(on_face[1][1:], np.array([1, corner.t_ratio]) * r ** (corner.exponent - 1), rtol=1e-12)


def test_strengths_do_not_depend_on_the_radius():
    corner, H = CornerField(0.2), 2.7

    for r in (0.01, 0.1, 0.45):
        u, stress = corner.unit_field(np.array(r), corner._arc_rule[0])
        assert corner.intensity(r, H * u, H * stress) == pytest.approx(H, rel=1e-12)
