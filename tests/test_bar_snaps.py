"""Layouts of phases of the bar are its local minimisers; it snaps where they end, and loses the area of the loop."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.phases_of_bars import BAR, DELTAS, LONG, body, equilibrium, lowest_phase_by_drive


# ---------------------------------------------------------------- layouts of phases
@pytest.mark.parametrize("delta", DELTAS)
def test_layouts_are_all_there_is(delta):
    """All 3^4 layouts: energies, which are local minimisers, and the least of all."""
    n, layouts = 4, LONG.layout_responses(delta, 4)
    sign = -1 if delta < 0 else 1
    energies, local = [], []
    for z in product((-1, 0, 1), repeat=n):
        e, energy = equilibrium(LONG, delta, z)
        energies.append(energy)
        local.append(bool((lowest_phase_by_drive(LONG, e) == z).all()))
        if set(z) <= {0, sign}:
            m = abs(sum(z))
            assert layouts.energy[m] == pytest.approx(energy, rel=1e-12, abs=1e-14)
            assert layouts.is_local_minimum[m] == local[-1]
            assert layouts.sigma[m] == pytest.approx(body(LONG, delta, LONG.eps * LONG.l * e.mean())[0], abs=1e-12)
            assert layouts.U[m] == pytest.approx(LONG.eps * LONG.l * e.mean(), abs=1e-12)
    least = layouts.of_least_energy()
    assert least.energy == pytest.approx(min(energies), rel=1e-12, abs=1e-14)
    assert least.is_local_minimum
    assert LONG.energy(delta) <= least.energy * (1 + 1e-12)


# ---------------------------------------------------------------- snaps
@pytest.mark.parametrize("bar", [BAR, LONG, replace(LONG, kbar=0.9, cbar=1.4)], ids=["paper", "long", "soft"])
def test_snaps(bar):
    """Thresholds where the strain of the uniform layer meets the switch; the loop's area is the energy lost in both."""

    def excess(delta, z):
        return bar.alpha * equilibrium(bar, delta, [z])[0][0] - bar.cbar / bar.eps

    up, down = (brentq(excess, -50, 50, args=(z,), xtol=1e-14) for z in (0, 1))
    assert (bar.snap_elongation, bar.snap_back_elongation) == pytest.approx((up, down), rel=1e-12)
    gain = [equilibrium(bar, delta, [0])[1] - equilibrium(bar, delta, [1])[1] for delta in (up, down)]
    assert (gain[0], gain[0] - gain[1]) == pytest.approx((-gain[1], bar.loop_area), rel=1e-10)
    delta = np.linspace(down, up, 7)
    work = np.trapezoid(bar.responses_at(delta, 0).sigma - bar.responses_at(delta, 1).sigma, delta)
    assert (work, bar.snap_elongation + bar.snap_back_elongation) == pytest.approx(
        (bar.loop_area, bar.delta_0 + bar.delta_1), rel=1e-12
    )
    for z, delta in ((0, up), (1, down), (-1, -down)):
        inside = -1e-9 if z == 0 else 1e-9 * z
        assert bar.responses_at(delta + inside, z).is_local_minimum
        assert not bar.responses_at(delta - inside, z).is_local_minimum


def path_vertices(bar, mixing, end_elongation):
    """The four vertices (elongation, stress) of the equilibrium path of a bar with a uniform layer.

    Without load, where phases start to mix, where all of the layer is in phase 1, and at the given elongation.
    """
    mixing_offset = mixing * bar.alpha / 2
    sigma = np.array([0, bar.sigma_up - mixing_offset, bar.sigma_up - bar.alpha + mixing_offset])
    delta = bar.l * bar.R * sigma + np.array([0, 0, bar.free_elongation])
    return np.column_stack(
        [[*delta, end_elongation], [*sigma, (end_elongation - bar.free_elongation) / (bar.l * bar.R)]]
    )


@pytest.mark.parametrize("mixing", [0.2, 0.9, 1.0])
def test_equilibrium_path_of_a_uniform_layer(mixing):
    """Every elongation of the layer gives a point on the polygon; the layer's stress is the derivative of its energy."""
    U = np.linspace(0, 1.5 * LONG.U(LONG.delta_1), 401)
    sigma, _, phase = LONG.layer_response(U, mixing)
    delta = U + sigma * LONG.l * (1 - LONG.eps) / LONG.K
    vertices = path_vertices(LONG, mixing, end_elongation=10.0)
    assert vertices[-1, 0] == 10.0
    assert max(distance_to_polygon(np.array(p), vertices) for p in zip(delta, sigma, strict=True)) < 1e-12
    assert set(phase[[0, -1]]) == {0, 1}
    h = 1e-6
    slope = (LONG.layer_response(U + h, mixing)[1] - LONG.layer_response(U - h, mixing)[1]) / (2 * h)
    assert np.median(np.abs(slope - sigma)) < 1e-8
    back = delta[1:] < delta[:-1] - 1e-12
    excess = (1 - LONG.eps) / (LONG.K * LONG.R) - mixing  # of the layer's steepness over the body's
    assert back.any() == (excess > 0)
    if mixing == 1:
        assert vertices[1:3] == pytest.approx(np.array([[at, LONG.sigma_m] for at in (LONG.delta_0, LONG.delta_1)]))
    if back.any():
        assert lost_in_both(LONG, vertices) == pytest.approx(LONG.free_elongation * LONG.alpha * excess, rel=1e-12)


def distance_to_polygon(p, vertices):
    starts, sides = vertices[:-1], np.diff(vertices, axis=0)
    along = np.clip(np.sum((p - starts) * sides, 1) / np.sum(sides**2, 1), 0, 1)
    return np.min(np.linalg.norm(p - starts - along[:, None] * sides, axis=1))


def lost_in_both(bar, vertices):
    energy = lambda delta, z: bar.responses_at(delta, z).energy
    up, down = vertices[1, 0], vertices[2, 0]
    return energy(up, 0) - energy(up, 1) + energy(down, 1) - energy(down, 0)
