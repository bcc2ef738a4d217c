"""The closed form of the non-monotone interface law is the least energy of sheets, and its tractions are derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from forms.non_monotone import lamination_gain
from tests.closed_forms import NonMonotoneLimit
from tests.phases_of_bars import LONG, SLOW, positive

LMBDA, MU, ALPHA, C = 6.0, 4.0, 2.1, 0.9
CHI = np.array([[0.3, -0.5], [-0.5, 0.8]])
CHI_3 = np.array([[0.3, -0.5, 0.2], [-0.5, 0.8, 0.4], [0.2, 0.4, -0.6]])
N = np.array([np.sin(0.7), np.cos(0.7)])


def gain(lmbda, mu, chi, k):
    """The lamination gain over alpha^2 for directions k (m, d)."""
    A = mu * np.eye(k.shape[1]) + (lmbda + mu) * k[:, :, None] * k[:, None, :]
    q = k @ chi
    return np.sum(q * np.linalg.solve(A, q[..., None])[..., 0], axis=1)


def directions(d):
    if d == 2:
        angle = np.linspace(0, np.pi, 4001)
        return np.column_stack([np.sin(angle), np.cos(angle)])
    k = np.random.default_rng(0).normal(size=(4000, 3))
    return k / np.linalg.norm(k, axis=1)[:, None]


entries = st.lists(st.floats(-2, 2), min_size=6, max_size=6)


@pytest.mark.parametrize("d", [2, 3])
@settings(max_examples=25)
@given(a=entries, mu=positive, nu=st.floats(-0.9, 0.48))
def test_lamination_is_the_best_direction(d, a, mu, nu):
    chi = np.array([[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]])[:d, :d] + 0.01 * np.eye(d)
    assume(np.abs(chi).max() > 1e-3)
    lmbda = 2 * mu * nu / (1 - 2 * nu)
    found, k = lamination_gain(lmbda, mu, chi), directions(d)
    values = gain(lmbda, mu, chi, k)
    best = minimize(lambda k: -gain(lmbda, mu, chi, (k / np.linalg.norm(k))[None])[0], k[np.argmax(values)], tol=1e-12)
    scale = gain(lmbda, mu, np.abs(chi).max() * np.eye(d), k[:1])[0] + np.abs(chi).max() ** 2 / mu
    assert found == pytest.approx(-best.fun, abs=1e-7 * scale)
    assert values.max() <= found + 1e-12 * scale


def test_lamination_numbers():
    """At chi = n (x) n the sheets stand inclined; across n alone the gain is less."""
    normal = np.diag([0.0, 1.0])
    assert lamination_gain(60, 40, normal) == pytest.approx(0.00875, rel=1e-14)
    assert lamination_gain(60, 40, np.diag([0.0, 1.0, 0.0])) == pytest.approx(0.00875, rel=1e-14)
    assert gain(60, 40, normal, np.array([[0.0, 1.0]]))[0] == pytest.approx(1 / 140, rel=1e-14)
    assert lamination_gain(60, 40, [[0, 0.5], [0.5, 0]]) == pytest.approx(0.25 / 40, rel=1e-14)  # across n
    assert lamination_gain(0, 40, normal) == pytest.approx(1 / 80, rel=1e-14)  # across n


def law(n=N, chi=CHI, alpha=ALPHA):
    return NonMonotoneLimit(LMBDA, MU, alpha, C, chi, n)


def relaxed(w, mixing=1.0):
    t, phase = law().relaxed(w, mixing)
    return t, phase, law().energy(w, phase, mixing)


W = np.random.default_rng(3).uniform(-1.2, 1.2, (40, 2))


def test_relaxed_energy_is_that_of_sheets():
    """Least energy of two phases that differ by a strain sym(a (x) k), over a, k and the fraction."""
    n, frame = N, np.array([[N[1], N[0]], [-N[0], N[1]]])
    chi = frame @ CHI @ frame.T

    def energy(e, z):
        return LMBDA / 2 * np.trace(e) ** 2 + MU * np.sum(e * e) - z * ALPHA * np.sum(chi * e) + C * abs(z)

    mixed = 0
    for w in W[:12]:
        e, sign = (np.outer(w, n) + np.outer(n, w)) / 2, np.sign(law().drive(w))

        def sheets(p, e=e, sign=sign):
            share, k = (1 + np.sin(p[0])) / 2, np.array([np.sin(p[1]), np.cos(p[1])])
            b = (np.outer(p[2:], k) + np.outer(k, p[2:])) / 2
            return (1 - share) * energy(e - share * b, 0) + share * energy(e + (1 - share) * b, sign)

        starts = [(s, angle, 0.1, -0.1) for s in (-0.8, 0.6) for angle in (0.1, 1.2, 2.3)]
        _, phase, found = relaxed(w)
        assert min(minimize(sheets, start).fun for start in starts) == pytest.approx(found, abs=1e-6)
        mixed += 0 < abs(phase) < 1
    assert mixed >= 2


@pytest.mark.parametrize("mixing", [0.15, 1.0])
def test_traction_is_the_derivative_of_the_energy(mixing):
    t, phase, energy = relaxed(W, mixing)
    h = 1e-6
    slope = [(relaxed(W + h * d, mixing)[2] - relaxed(W - h * d, mixing)[2]) / (2 * h) for d in np.eye(2)]
    assert t == pytest.approx(np.transpose(slope), abs=1e-4)
    z = np.linspace(-1, 1, 2001)[:, None]
    all_mixtures = law().energy(W, z, mixing)
    assert energy == pytest.approx(all_mixtures.min(axis=0), abs=1e-6)
    assert {-1, 0, 1} <= set(phase)
    for z in (-1, 0, 1):
        pure, holds = law().pure(W, z)
        assert t[phase == z] == pytest.approx(pure[phase == z], abs=1e-13)
        assert holds[phase == z].all()
        least = np.argmin([law().energy(W, y) for y in (-1, 0, 1)], axis=0)
        assert (holds == (least == z + 1)).all()
    assert relaxed(-W, mixing)[0] == pytest.approx(-t, abs=1e-13)


def test_traction_of_a_pure_phase():
    """Components along and across S by hand; the printed lmbda + mu, [u_1] and chi_12 [u_i] are other laws."""
    w, n = np.array([-0.3, 0.7]), np.array([0.0, 1.0])
    t, holds = law(n).pure(w, 1)
    assert t == pytest.approx([MU * -0.3 + ALPHA * 0.5, (LMBDA + 2 * MU) * 0.7 - ALPHA * 0.8], rel=1e-14)
    assert holds
    assert law(n).drive(w) == pytest.approx(ALPHA * (0.5 * 0.3 + 0.8 * 0.7), rel=1e-14)
    assert ALPHA * -0.5 * (-0.3 + 0.7) < C  # printed: would not hold
    assert abs(t[1] - ((LMBDA + MU) * 0.7 - ALPHA * 0.8)) > 0.1 * abs(t[1])
    assert abs(t[1] - ((LMBDA + 2 * MU) * -0.3 - ALPHA * 0.8)) > 0.1 * abs(t[1])
    assert law(n).pure(0 * w, 0)[0] == pytest.approx([0, 0])


@SLOW
@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
def test_orientation_turns_with_the_normal(a, b):
    """chi n against the rotation vector from e_2 to n; in 2D its first axis is (n_2, -n_1)."""
    n = np.array([np.sin(a) * np.cos(b), np.cos(a), np.sin(a) * np.sin(b)])
    axis = np.cross([0, 1, 0], n)
    turned = np.arctan2(np.linalg.norm(axis), n[1])
    assume(np.linalg.norm(axis) > 1e-5)
    turn = Rotation.from_rotvec(turned * axis / np.linalg.norm(axis)).as_matrix()
    basis = law(n, CHI_3).drive(np.eye(3))
    assert basis == pytest.approx(ALPHA * turn @ CHI_3 @ turn.T @ n, abs=1e-9)
    plane = np.array([np.sin(a), np.cos(a)])
    frame = np.column_stack([[plane[1], -plane[0]], plane])
    basis = law(plane).drive(np.eye(2))
    assert basis == pytest.approx(ALPHA * frame @ CHI @ frame.T @ plane, abs=1e-13)


@pytest.mark.parametrize("mixing", [0.3, 1.0])
def test_layer_of_the_bar_is_the_interface_law(mixing):
    """lmbda = 0, chi = n (x) n, per thickness eps l: lmbda + 2 mu = kbar/l, C = l cbar; any eps."""
    U, n = np.linspace(-1.4, 1.4, 57), np.array([0.6, 0.8])
    mu, C_layer, chi = LONG.kbar / LONG.l / 2, LONG.l * LONG.cbar, np.diag([0.0, 1.0])
    layer = NonMonotoneLimit(0, mu, LONG.alpha, C_layer, chi, n)
    t, phase = layer.relaxed(U[:, None] * n, mixing)
    energy = layer.energy(U[:, None] * n, phase, mixing)
    expected = LONG.layer(U, mixing)
    assert t == pytest.approx(expected[0][:, None] * n, abs=1e-12)
    assert energy == pytest.approx(expected[1], abs=1e-12)
    assert phase == pytest.approx(expected[2], abs=1e-12)
