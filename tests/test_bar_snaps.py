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
    n, layouts = 4, LONG.layouts(delta, 4)
    sign = -1 if delta < 0 else 1
    energies, local = [], []
    for z in product((-1, 0, 1), repeat=n):
        e, energy = equilibrium(LONG, delta, z)
        energies.append(energy)
        local.append(bool((lowest_phase_by_drive(LONG, e) == z).all()))
        if set(z) <= {0, sign}:
            m = abs(sum(z))
            assert layouts.energy[m] == pytest.approx(energy, rel=1e-12, abs=1e-14)
            assert layouts.local[m] == local[-1]
            assert layouts.sigma[m] == pytest.approx(body(LONG, delta, LONG.eps * LONG.l * e.mean())[0], abs=1e-12)
            assert layouts.U[m] == pytest.approx(LONG.eps * LONG.l * e.mean(), abs=1e-12)
    least = layouts.least()
    assert least.energy == pytest.approx(min(energies), rel=1e-12, abs=1e-14)
    assert least.local
    assert LONG.energy(delta) <= least.energy * (1 + 1e-12)


def test_every_layout_of_eight_elements_is_a_local_minimiser():
    assert BAR.layouts(1.6, 8).local.all()
    assert BAR.layouts(1.3, 8).local.tolist() == [True] * 9
    assert not BAR.layouts(1.8, 8).local[0]  # beyond the snap
    assert BAR.layouts(1.2, 8).local.tolist() == [True] * 8 + [False]


def test_layouts_tend_to_the_relaxed_energy_from_above():
    delta = np.linspace(LONG.delta_0, LONG.delta_1, 2003)
    above = [np.max(LONG.layouts(delta, n).least().energy - LONG.energy(delta)) for n in (4, 8, 16)]
    assert all(np.min(LONG.layouts(delta, n).least().energy - LONG.energy(delta)) > -1e-13 for n in (4, 8, 16))
    assert np.log2(np.divide(above[:-1], above[1:])) == pytest.approx([2, 2], abs=0.02)


# ---------------------------------------------------------------- snaps
@pytest.mark.parametrize("bar", [BAR, LONG, replace(LONG, kbar=0.9, cbar=1.4)], ids=["paper", "long", "soft"])
def test_snaps(bar):
    """Thresholds where the strain of the uniform layer meets the switch; the loop's area is the energy lost in both."""

    def excess(delta, z):
        return bar.alpha * equilibrium(bar, delta, [z])[0][0] - bar.cbar / bar.eps

    up, down = (brentq(excess, -50, 50, args=(z,), xtol=1e-14) for z in (0, 1))
    assert (bar.up, bar.down) == pytest.approx((up, down), rel=1e-12)
    gain = [equilibrium(bar, delta, [0])[1] - equilibrium(bar, delta, [1])[1] for delta in (up, down)]
    assert gain[0] == pytest.approx(-gain[1], rel=1e-10)
    assert gain[0] - gain[1] == pytest.approx(bar.loop_area, rel=1e-10)
    delta = np.linspace(down, up, 7)
    work = np.trapezoid(bar.branch(delta, 0).sigma - bar.branch(delta, 1).sigma, delta)
    assert work == pytest.approx(bar.loop_area, rel=1e-12)
    assert bar.up + bar.down == pytest.approx(bar.delta_0 + bar.delta_1, rel=1e-12)
    for z, delta in ((0, up), (1, down), (-1, -down)):
        inside = -1e-9 if z == 0 else 1e-9 * z
        assert bar.branch(delta + inside, z).local
        assert not bar.branch(delta - inside, z).local


def test_cycle_loses_the_loop():
    """Steps of a cycle that keeps its phase while it holds: net work within the step of the loop's area."""
    there = np.linspace(0, 1.3 * LONG.up, 3001)
    phase, work, last = 0, 0.0, (0.0, 0.0)
    for delta in [*there, *there[::-1]]:
        e = equilibrium(LONG, delta, [phase])[0]
        phase = int(lowest_phase_by_drive(LONG, e)[0])
        sigma = body(LONG, delta, LONG.eps * LONG.l * equilibrium(LONG, delta, [phase])[0][0])[0]
        work += (sigma + last[1]) / 2 * (delta - last[0])
        last = (delta, sigma)
    assert work == pytest.approx(LONG.loop_area, rel=1e-2)


@pytest.mark.parametrize("mixing", [0.0, 0.2, 0.5, 0.9, 1.0])
def test_equilibrium_path_of_a_uniform_layer(mixing):
    """Every elongation of the layer gives a point on the polygon; the layer's stress is the derivative of its energy."""
    U = np.linspace(0, 1.5 * LONG.U(LONG.delta_1), 401)
    sigma, _, phase = LONG.layer(U, mixing)
    delta = U + sigma * LONG.l * (1 - LONG.eps) / LONG.K
    vertices = LONG.path(mixing, end=10.0)
    assert vertices[-1, 0] == 10.0
    gaps = [distance_to_polygon(np.array(p), vertices) for p in zip(delta, sigma, strict=True)]
    assert max(gaps) < 1e-12
    assert set(phase[[0, -1]]) == {0, 1}
    h = 1e-6
    slope = (LONG.layer(U + h, mixing)[1] - LONG.layer(U - h, mixing)[1]) / (2 * h)
    assert np.median(np.abs(slope - sigma)) < 1e-8
    back = delta[1:] < delta[:-1] - 1e-12
    excess = (1 - LONG.eps) / (LONG.K * LONG.R) - mixing  # of the layer's steepness over the body's
    assert back.any() == (excess > 0)
    if back.any():
        lost = LONG.free_elongation * LONG.alpha * excess
        assert lost_in_both(LONG, vertices) == pytest.approx(lost, rel=1e-12)


def distance_to_polygon(p, vertices):
    starts, sides = vertices[:-1], np.diff(vertices, axis=0)
    along = np.clip(np.sum((p - starts) * sides, 1) / np.sum(sides**2, 1), 0, 1)
    return np.min(np.linalg.norm(p - starts - along[:, None] * sides, axis=1))


def lost_in_both(bar, vertices):
    energy = lambda delta, z: bar.branch(delta, z).energy
    up, down = vertices[1, 0], vertices[2, 0]
    return energy(up, 0) - energy(up, 1) + energy(down, 1) - energy(down, 0)


def test_fraction_of_a_softening_layer_has_the_least_energy():
    z = np.linspace(-1, 1, 20001)
    for U, mixing in product([0.3, 0.55, 0.6, -0.7, 1.1], [0.3, 1.0]):
        _, energy, phase = LONG.layer(U, mixing)
        g = mixing * LONG.alpha**2 * LONG.l / LONG.kbar
        mixed = LONG.l * LONG.cbar * abs(z) - z * LONG.alpha * U - abs(z) * (1 - abs(z)) * g / 2
        assert energy == pytest.approx(LONG.kbar / LONG.l * U**2 / 2 + mixed.min(), abs=1e-8)
        assert phase == pytest.approx(z[np.argmin(mixed)], abs=2e-4)


def test_a_layer_that_mixes_all_has_the_thresholds_of_least_energy():
    vertices = LONG.path(1.0)
    assert vertices[1:3, 0] == pytest.approx([LONG.delta_0, LONG.delta_1], rel=1e-12)
    assert vertices[1:3, 1] == pytest.approx([LONG.sigma_m] * 2, rel=1e-12)
