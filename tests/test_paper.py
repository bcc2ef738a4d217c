"""Figures 5 and 6 of the paper, and an elastic law without stiffness."""

from __future__ import annotations

import numpy as np
import pytest

from studies.fig6_stratified import EPS, GLUE, K_T, POINT_X, StratifiedBar
from tests.orders import observed_orders
from thinlayer import ThinLayer
from thinlayer.running.record import Record

# t_T/u_T (N/mm^3) of the meshed layer at some x (mm), P1 on a graded mesh, from an independent code
RATIOS = {10.0: 85752.2418, 20.0: 85733.8001, 30.0: 85730.6296}
DISPLACEMENTS = {10.0: 2.67658075e-4, 20.0: 1.49923258e-4, 30.0: 6.87843475e-5}  # u_T (mm) of its interface law


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    return StratifiedBar(Record("test", tmp_path_factory.mktemp("bar"), {}), 4.0, 0.4, 0.04)


def test_tangential_stiffness_of_the_meshed_layer(bar):
    x, ratio = bar.stiffness_profile(bar.solve_full(ThinLayer(GLUE, EPS)))
    inner = (x >= 6) & (x <= 30)
    assert pytest.approx(85714.2857, abs=5e-5) == K_T
    assert np.abs(ratio[inner] / K_T - 1).max() < 1e-3
    assert np.abs(ratio[inner] / 87500 - 1).min() > 1e-2  # the arithmetic mean is not it
    for place, value in RATIOS.items():  # its deviations from K_T are 2 to 4 in 10^4; meshes differ by a tenth of them
        assert np.interp(place, x, ratio) - K_T == pytest.approx(value - K_T, rel=0.2)


def test_displacement_of_the_interface_law(bar):
    x, u = bar.surface.profile(bar.surface.frame(bar.surface.jump(bar.limit)))
    for place, value in DISPLACEMENTS.items():
        assert np.interp(place, x[:, 0], u[:, 0]) == pytest.approx(value, rel=2e-3)


def test_deviation_with_the_glues_own_moduli(bar):
    """Order 1 from 0.4 to 0.05 mm: the glue stays what it is and its layer gets thinner."""
    eps = (0.4, 0.2, 0.1, 0.05)
    deviations = [bar.stiffness_deviation(ThinLayer(GLUE, e), K_T * EPS / e) for e in eps]
    assert observed_orders(eps, deviations)[1:] == pytest.approx([1.0] * 3, abs=0.1)


def test_deviation_with_moduli_over_thickness_held(bar):
    """Order 1 as eps -> 0, with the slope that equilibrium inside the layer gives.

    The stress lmbda t_N/(lmbda + 2 mu) along the layer changes along S and bends the shear stress; with nu = 0.3 that is
    t_T = K_T ([u_T] - I dt_N/7), I the integral of (eps - y)/mu over the thickness. At 0.4 mm the layer's moduli are a
    third of the bar's, and the term in eps^2 is still large.
    """
    eps = (0.05, 0.025, 0.0125)
    deviations = [bar.stiffness_deviation(ThinLayer(GLUE, e, at=EPS), K_T) for e in eps]
    orders = observed_orders(eps, deviations)[1:]
    assert orders == pytest.approx([1.0] * 2, abs=0.1)
    assert orders[1] > orders[0]
    x, w = bar.surface.profile(bar.surface.frame(bar.surface.jump(bar.limit)))
    near = np.abs(x[:, 0] - POINT_X) < 1.5
    opening = np.polynomial.Polynomial.fit(x[near, 0], w[near, 1], 3).deriv()(POINT_X)
    soft, hard = 1 / GLUE.laws[0].mu, 1 / GLUE.laws[1].mu
    weight = (0.375 * soft + 0.125 * hard) / (0.5 * soft + 0.5 * hard)
    slope = -3.5 / 7 * weight * opening / np.interp(POINT_X, x[:, 0], w[:, 0])
    assert 2 * deviations[2] / eps[2] - deviations[1] / eps[1] == pytest.approx(slope, rel=5e-3)
