"""Fields of free ends and of their corners: exponents, strengths by two ways, equilibrium, and what the table has."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from forms.base import InputError
from forms.ends import free_end
from forms.ends.end_fields import EVEN, Corner, EndFields, end_fields
from tests.refused import refused

RATIOS = (0.1, 0.3, 0.45, 0.5)
FIELDS = {nu: EndFields(nu, degree=8, levels=8) for nu in (0.2, 0.45)}  # to seven digits


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


@pytest.mark.parametrize("nu", FIELDS)
def test_the_fields_take_away_the_stresses_on_the_end(nu):
    y = np.array([-0.4, -0.1, 0.2, 0.45])
    end, face = FIELDS[nu].stresses(0 * y, y), FIELDS[nu].stresses(0 * y + 20.0, y)
    expected = [
        np.stack([-1 + 0 * y, 0 * y]),
        np.stack([0 * y, -1 + 0 * y]),
        np.stack([-y, 0 * y]),
        np.stack([0 * y, -y]),
    ]
    np.testing.assert_allclose(np.swapaxes(end[:, :, [0, 2]], 1, 2), expected, atol=1e-3)  # of stresses of degree 7
    np.testing.assert_allclose(face, 0, atol=1e-6)


@pytest.mark.parametrize("nu", FIELDS)
def test_the_fields_have_the_constants_of_the_end(nu):
    """The tractions that are missing on the middle line are c_N M w_N and c_T mu w_T."""
    points, weights = np.polynomial.legendre.leggauss(12)
    edges = np.array([0, 0.05, 0.15, 0.4, 1, 2, 3.5, 5.5, 8, 12, 18])
    x = (edges[:-1, None] + np.diff(edges)[:, None] * (points + 1) / 2).ravel()
    w = (np.diff(edges)[:, None] * weights / 2).ravel()
    found, lmbda = FIELDS[nu].stresses(x, 0 * x), 2 * nu / (1 - 2 * nu)
    end = free_end(nu)
    assert -lmbda * (w @ found[0, :, 1]) == pytest.approx(end.c_N * (lmbda + 2), abs=1e-4 * (lmbda + 2))
    assert -(w @ found[1, :, 2]) == pytest.approx(end.c_T, abs=1e-4)


@pytest.mark.parametrize("nu", FIELDS)
def test_strengths_are_those_of_the_traction_near_the_corner(nu):
    """By reciprocity on an arc of 0.3 eps, and by the tractions on the face at 1e-4 eps, where H alone is left."""
    fields, r = FIELDS[nu], np.array([1e-4])
    lmbda, corner = 2 * nu / (1 - 2 * nu), fields.corner
    near = fields.stresses(r, np.array([-0.5]))[:, 0]
    fit_N = (near[0, 1] + (lmbda + 2) / lmbda) * r[0] ** (1 - corner.exponent)  # with the field far away
    fit_T = near[1, 1] * r[0] ** (1 - corner.exponent)
    sheared = (1 + near[1, 2]) * r[0] ** (1 - corner.exponent) / corner.shear
    H_N, H_T, *_ = fields.strengths
    assert fit_N == pytest.approx(H_N, rel=2e-3)
    assert fit_T == pytest.approx(H_T, rel=2e-3)
    assert sheared == pytest.approx(H_T, rel=5e-3)


def test_strengths_do_not_depend_on_the_radius_but_on_the_exponent():
    fields = FIELDS[0.2]

    def strength(corner, r):
        return corner.strength(r, *fields._solutions[1].at(corner.arc(r)), np.array([0.0, 1.0]))

    found = [strength(fields.corner, r) for r in (0.01, 0.1, 0.45)]
    np.testing.assert_allclose(found, fields.strengths[1], rtol=1e-5)
    wrong = [strength(Corner(0.3), r) for r in (0.01, 0.1)]
    assert abs(wrong[0] / wrong[1] - 1) > 0.05


def test_fields_are_mirrored():
    fields, x, y = FIELDS[0.45], np.array([0.1, 0.7]), np.array([0.3, 0.15])
    above, below = fields.stresses(x, y), fields.stresses(x, -y)
    for k, sign in enumerate(EVEN):
        np.testing.assert_allclose(above[k], sign * below[k] * [1, 1, -1], rtol=1e-12)


def test_fields_are_kept_and_ratios_out_of_range_refused():
    assert end_fields(0.31) is end_fields(0.31)
    for make in (Corner, end_fields):
        refused(InputError, r"from 0 to 0\.5", make, 0.51)
    assert np.isnan(EndFields(0.0).strengths).all()
