"""Thresholds, energy and stress of the bar of section 6 are those of its least energy; what is printed otherwise is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from forms import formulas
from forms.base import InputError
from tests.phases_of_bars import BAR, DELTAS, LONG, SLOW, body, positive
from tests.refused import refused


def dual(bar, delta):
    """Least energy of the bar with a layer of infinitely many elements, and its stress: a maximum over the stress."""
    k, c = bar.eps * bar.kbar, bar.cbar / bar.eps

    def complementary(s):
        layer = max((s + z * bar.alpha) ** 2 / (2 * k) - c * abs(z) for z in (-1, 0, 1))
        return bar.eps * bar.l * layer + bar.l * (1 - bar.eps) * s**2 / (2 * bar.K) - s * delta

    most = bar.K * (abs(delta) + 2 * bar.l * bar.alpha / bar.kbar) / bar.l + 2 * bar.alpha
    minimum = minimize_scalar(complementary, bounds=(-most, most), method="bounded", options={"xatol": 1e-10})
    return -minimum.fun, minimum.x


NUMBERS = {0.1: (1.2925, 1.6925, 1.7625, 1.2225, 0.275744680851), 0.0: (1.375, 1.775, 1.875, 1.275, 0.288)}


@pytest.mark.parametrize("eps", NUMBERS)
def test_thresholds(eps):
    bar = replace(BAR, eps=eps)
    assert (bar.delta_0, bar.delta_1, bar.snap_elongation, bar.snap_back_elongation, bar.loop_area) == pytest.approx(
        NUMBERS[eps], rel=1e-11
    )


@pytest.mark.parametrize("delta", DELTAS)
def test_global_minimiser(delta):
    """Energy and stress of the relaxed response against the dual problem."""
    energy, sigma = dual(LONG, delta)
    assert LONG.energy(delta) == pytest.approx(energy, rel=1e-9, abs=1e-12)
    assert LONG.sigma(delta) == pytest.approx(sigma, abs=1e-6)


def test_printed_formulas_are_other_formulas():
    """(47a) U, (47b) delta_1, (47d) the boundary, (47e) the stress, and (48) in the limit."""
    bar, K_eps, k, thickness = LONG, 1 / LONG.R, LONG.eps * LONG.kbar, LONG.eps * LONG.l
    low, mid, sigma = 0.7 * bar.delta_0, (bar.delta_0 + bar.delta_1) / 2, bar.sigma_m
    assert body(bar, low, bar.U(low))[0] == pytest.approx(dual(bar, low)[1], abs=1e-6)
    assert body(bar, low, bar.K * low / (K_eps * (1 - bar.eps)))[0] < 0.5 * bar.sigma(low)
    printed_delta_1 = bar.delta_0 + bar.l * bar.alpha**2 / k
    assert dual(bar, (bar.delta_1 + printed_delta_1) / 2)[1] > 1.05 * sigma  # printed: still on the plateau
    strained = lambda S: sigma / k * S + (sigma + bar.alpha) / k * (thickness - S)
    printed = thickness * (1 + sigma / bar.alpha - sigma * k / (bar.alpha * bar.K) * bar.l - k / bar.alpha * mid)
    assert strained(bar.boundary(mid)) == pytest.approx(bar.U(mid), rel=1e-12)
    assert abs(strained(printed) - bar.U(mid)) > 0.1 * bar.U(mid)
    assert abs(k * bar.K / (thickness * K_eps) - bar.sigma(low)) > 0.1 * bar.sigma(low)
    thin = replace(bar, eps=0.0)
    for delta, right, wrong in (
        (0.7 * thin.delta_0, thin.kbar / thin.l, thin.kbar),
        ((thin.delta_0 + thin.delta_1) / 2, thin.K / thin.l, thin.l / thin.K),
    ):
        strain = thin.U(delta) if delta < thin.delta_0 else delta - thin.U(delta)
        assert thin.sigma(delta) == pytest.approx(right * strain, rel=1e-12)
        assert abs(thin.sigma(delta) - wrong * strain) > 0.1 * thin.sigma(delta)


def least_bar(length, K, kbar, alpha, more, eps):
    return formulas.Bar(length, K, kbar, alpha, alpha**2 / (2 * kbar) * (1 + more), eps)


bars = st.builds(least_bar, *[positive] * 4, st.floats(0.01, 3.0), st.sampled_from([0.0, 0.03, 0.35, 0.8]))


@SLOW
@given(bar=bars, share=st.floats(-2.5, 2.5))
def test_any_bar(bar, share):
    """Force = derivative of the energy = layer's stress; odd, even; continuous from above to the limit eps = 0."""
    delta = share * bar.delta_1
    scale = bar.sigma_m + bar.alpha + bar.K
    h = 1e-5 * bar.delta_1
    slope = (bar.energy(delta + h) - bar.energy(delta - h)) / (2 * h)
    assert bar.sigma(delta) == pytest.approx(slope, abs=1e-4 * scale)
    stress, energy, phase = bar.layer_response(bar.U(delta))
    assert stress == pytest.approx(bar.sigma(delta), abs=1e-9 * scale)
    assert phase == pytest.approx(bar.phase(delta), abs=1e-9)
    below, there = body(bar, delta, bar.U(delta))
    assert below == pytest.approx(bar.sigma(delta), abs=1e-9 * scale)
    assert energy + there == pytest.approx(bar.energy(delta), abs=1e-9 * scale * bar.delta_1)
    for odd in (bar.sigma, bar.U, bar.phase):
        assert odd(-delta) == -odd(delta)
    assert bar.energy(-delta) == bar.energy(delta)
    assert bar.energy(delta) <= min(bar.responses_at(delta, z).energy for z in (-1, 0, 1)) + 1e-12 * scale * bar.delta_1


@pytest.mark.parametrize("change", [{"l": 0.0}, {"kbar": np.inf}, {"cbar": np.nan}, {"eps": 1.0}, {"cbar": 0.27}])
def test_bar_out_of_range(change):
    refused(InputError, "allowed: all > 0, cbar >= ", replace, LONG, **change)
