"""Closed forms of section 6, the non-monotone law and the bar, against minimisation by brute force."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize, minimize_scalar
from scipy.spatial.transform import Rotation

from forms import limits

BAR = limits.Bar(l=1, K=2, kbar=3, alpha=1.2, cbar=0.9, eps=0.1)
LONG = limits.Bar(l=1.7, K=2.3, kbar=3.1, alpha=1.3, cbar=0.8, eps=0.3)  # no parameter is 1, none equals another
SLOW = settings(deadline=None, max_examples=60)
DELTAS = np.array([-4.1, -3.0, -0.2, 0.0, 0.4, 2.6, 2.9, 3.4, 4.8])  # of LONG: all phases, and mixtures


# ---------------------------------------------------------------- the bar by brute force, Eq. (44) alone
def body(bar, delta, elongation):
    """Stress and energy of the body ]eps l, l[."""
    length = bar.l * (1 - bar.eps)
    strain = (delta - elongation) / length
    return bar.K * strain, length * bar.K / 2 * strain**2


def density(bar, e, z):
    """Energy density of phase z of the layer."""
    return bar.eps * bar.kbar / 2 * e**2 - bar.alpha * z * e + bar.cbar / bar.eps * np.abs(z)


def lowest_phase(bar, e):
    return np.array([-1, 0, 1])[np.argmin([density(bar, e, z) for z in (-1, 0, 1)], axis=0)]


def total(bar, delta, e):
    """Energy of elements of equal length with strains e, each in its phase of least energy."""
    h = bar.eps * bar.l / len(e)
    return h * np.sum(density(bar, e, lowest_phase(bar, e))) + body(bar, delta, h * np.sum(e))[1]


def equilibrium(bar, delta, z):
    """Strains of equal elements with phases z held, and the energy with these phases."""
    z = np.asarray(z, float)
    h, length = bar.eps * bar.l / len(z), bar.l * (1 - bar.eps)
    matrix = bar.eps * bar.kbar * np.eye(len(z)) + bar.K * h / length * np.ones((len(z), len(z)))
    e = np.linalg.solve(matrix, bar.alpha * z + bar.K * delta / length)
    return e, h * np.sum(density(bar, e, z)) + body(bar, delta, h * np.sum(e))[1]


def dual(bar, delta):
    """Least energy of the bar with a layer of infinitely many elements, and its stress: a maximum over the stress."""
    k, c = bar.eps * bar.kbar, bar.cbar / bar.eps

    def complementary(s):
        layer = max((s + z * bar.alpha) ** 2 / (2 * k) - c * abs(z) for z in (-1, 0, 1))
        return bar.eps * bar.l * layer + bar.l * (1 - bar.eps) * s**2 / (2 * bar.K) - s * delta

    most = bar.K * (abs(delta) + 2 * bar.l * bar.alpha / bar.kbar) / bar.l + 2 * bar.alpha
    found = minimize_scalar(complementary, bounds=(-most, most), method="bounded", options={"xatol": 1e-10})
    return -found.fun, found.x


NUMBERS = {0.1: (1.2925, 1.6925, 1.7625, 1.2225, 0.275744680851), 0.0: (1.375, 1.775, 1.875, 1.275, 0.288)}


@pytest.mark.parametrize("eps", NUMBERS)
def test_thresholds(eps):
    bar = replace(BAR, eps=eps)
    found = (bar.delta_0, bar.delta_1, bar.up, bar.down, bar.loop_area)
    assert found == pytest.approx(NUMBERS[eps], rel=1e-11)


def test_at_one_displacement():
    assert BAR.sigma(1.6) == pytest.approx(1.65, rel=1e-14)
    assert BAR.U(1.6) == pytest.approx(0.8575, rel=1e-14)
    assert BAR.boundary(1.6) == pytest.approx(0.23125 * BAR.eps * BAR.l, rel=1e-13)
    assert BAR.energy(1.6) == pytest.approx(1.5736875, rel=1e-14)


def test_thresholds_are_linear_in_the_thickness():
    """And the loop area is not: it has 1/R."""
    for name in ("R", "delta_0", "delta_1", "up", "down"):
        value = {eps: getattr(replace(LONG, eps=eps), name) for eps in (0.0, 0.1, 0.3, 0.7)}
        slopes = [(value[eps] - value[0.0]) / eps for eps in (0.1, 0.3, 0.7)]
        assert slopes == pytest.approx([slopes[0]] * 3, rel=1e-12)
        assert abs(slopes[0]) > 0.1
    area = [replace(LONG, eps=eps).loop_area for eps in (0.0, 0.2, 0.4)]
    assert abs(area[0] - 2 * area[1] + area[2]) > 1e-3 * area[0]


@pytest.mark.parametrize("delta", DELTAS)
def test_global_minimiser(delta):
    """Energy and stress of the relaxed response against the dual problem."""
    energy, sigma = dual(LONG, delta)
    assert LONG.energy(delta) == pytest.approx(energy, rel=1e-9, abs=1e-12)
    assert LONG.sigma(delta) == pytest.approx(sigma, abs=1e-6)


def test_printed_formulas_are_other_formulas():
    """(47a) U, (47b) delta_1, (47c) a displacement that jumps, (47d) the boundary, (47e) the stress, (48) in the limit."""
    bar, K_eps, k = LONG, 1 / LONG.R, LONG.eps * LONG.kbar
    low, mid, high = 0.7 * bar.delta_0, (bar.delta_0 + bar.delta_1) / 2, 1.2 * bar.delta_1
    for delta, right, printed in [
        (low, bar.U(low), bar.K * low / (K_eps * (1 - bar.eps))),
        (high, bar.U(high), bar.alpha * bar.l / K_eps + bar.K * high / (K_eps * (1 - bar.eps))),
    ]:
        sigma = dual(bar, delta)[1]
        assert body(bar, delta, right)[0] == pytest.approx(sigma, abs=1e-6)
        assert abs(body(bar, delta, printed)[0] - sigma) > 0.5 * sigma
        assert printed > delta
    printed_delta_1 = bar.delta_0 + bar.l * bar.alpha**2 / k
    assert dual(bar, (bar.delta_1 + printed_delta_1) / 2)[1] > 1.05 * bar.sigma_m  # printed: still on the plateau
    sigma = bar.sigma_m
    boundary, U = bar.boundary(mid), bar.U(mid)
    thickness = bar.eps * bar.l
    printed = thickness * (1 + sigma / bar.alpha - sigma * k / (bar.alpha * bar.K) * bar.l - k / bar.alpha * mid)
    strained = lambda S: sigma / k * S + (sigma + bar.alpha) / k * (thickness - S)
    assert strained(boundary) == pytest.approx(U, rel=1e-12)
    assert abs(strained(printed) - U) > 0.1 * U
    assert abs((sigma + bar.alpha) / k * (thickness - boundary) - U) > 0.1 * U  # (47c), printed at x = eps l
    assert abs(k * bar.K / (thickness * K_eps) - bar.sigma(low)) > 0.1 * bar.sigma(low)
    thin = replace(bar, eps=0.0)
    low, mid = 0.7 * thin.delta_0, (thin.delta_0 + thin.delta_1) / 2
    assert thin.sigma(low) == pytest.approx(thin.kbar / thin.l * thin.U(low), rel=1e-12)
    assert abs(thin.sigma(low) - thin.kbar * thin.U(low)) > 0.1 * thin.sigma(low)
    assert thin.sigma(mid) == pytest.approx(thin.K / thin.l * (mid - thin.U(mid)), rel=1e-12)
    assert abs(thin.sigma(mid) - thin.l / thin.K * (mid - thin.U(mid))) > 0.1 * thin.sigma(mid)


positive = st.floats(0.2, 5.0)
bars = st.builds(
    lambda length, K, kbar, alpha, more, eps: limits.Bar(
        length, K, kbar, alpha, alpha**2 / (2 * kbar) * (1 + more), eps
    ),
    positive,
    positive,
    positive,
    positive,
    st.floats(0.01, 3.0),
    st.sampled_from([0.0, 0.03, 0.35, 0.8]),
)


@SLOW
@given(bar=bars, share=st.floats(-2.5, 2.5))
def test_any_bar(bar, share):
    """Force = derivative of the energy = layer's stress; odd, even; continuous from above to the limit eps = 0."""
    delta = share * bar.delta_1
    scale = bar.sigma_m + bar.alpha + bar.K
    h = 1e-5 * bar.delta_1
    slope = (bar.energy(delta + h) - bar.energy(delta - h)) / (2 * h)
    assert bar.sigma(delta) == pytest.approx(slope, abs=1e-4 * scale)
    stress, energy, phase = bar.layer(bar.U(delta))
    assert stress == pytest.approx(bar.sigma(delta), abs=1e-9 * scale)
    assert phase == pytest.approx(bar.phase(delta), abs=1e-9)
    below, there = body(bar, delta, bar.U(delta))
    assert below == pytest.approx(bar.sigma(delta), abs=1e-9 * scale)
    assert energy + there == pytest.approx(bar.energy(delta), abs=1e-9 * scale * bar.delta_1)
    for odd in (bar.sigma, bar.U, bar.phase):
        assert odd(-delta) == -odd(delta)
    assert bar.energy(-delta) == bar.energy(delta)
    assert bar.energy(delta) <= min(bar.branch(delta, z).energy for z in (-1, 0, 1)) + 1e-12 * scale * bar.delta_1


@SLOW
@given(bar=bars)
def test_relaxed_response_is_continuous_and_monotone(bar):
    delta = np.linspace(-2 * bar.delta_1, 2 * bar.delta_1, 4001)
    rise = np.diff(bar.sigma(delta)) / np.diff(delta)
    assert rise.min() >= -1e-9 / (bar.l * bar.R)
    assert rise.max() <= (1 + 1e-9) / (bar.l * bar.R)
    assert (np.diff(bar.boundary(delta[2000:])) <= 0).all()


@pytest.mark.parametrize("delta", DELTAS)
def test_displacement_is_a_minimiser_without_gaps(delta):
    bar = LONG
    x = np.linspace(0, bar.l, 20001)
    u = bar.displacement(x, delta)
    assert u[[0, -1]] == pytest.approx([0, delta], abs=1e-14)
    strain = np.diff(u) / np.diff(x)
    middle, dx = (x[1:] + x[:-1]) / 2, np.diff(x)
    layer = middle < bar.eps * bar.l
    density_min = density(bar, strain, lowest_phase(bar, strain))
    energy = np.sum(np.where(layer, density_min, bar.K / 2 * strain**2) * dx)
    assert energy == pytest.approx(bar.energy(delta), rel=1e-3, abs=1e-14)
    assert bar.displacement(bar.eps * bar.l, delta) == pytest.approx(bar.U(delta), abs=1e-14)
    first = middle < bar.boundary(delta) - dx[0]
    assert (lowest_phase(bar, strain[layer & first]) == 0).all()
    assert (lowest_phase(bar, strain[layer & (middle > bar.boundary(delta) + dx[0])]) == np.sign(delta)).all()
    thin = replace(bar, eps=0.0)
    assert thin.displacement(0.0, delta) == pytest.approx(thin.U(delta), abs=1e-14)


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


def lowest_phase_by_drive(bar, e):
    return np.where(np.abs(bar.alpha * e) > bar.cbar / bar.eps, np.sign(e), 0)


@pytest.mark.parametrize("delta", [2.9, -3.4])
def test_a_minimiser_stays_at_local_layouts_and_leaves_the_others(delta):
    layouts, n, rng = LONG.layouts(delta, 5), 5, np.random.default_rng(1)
    bounds = LONG.cbar / LONG.eps / LONG.alpha
    stayed = []
    for m in range(n + 1):
        z = np.sign(delta) * (np.arange(n) < m)
        start = equilibrium(LONG, delta, z)[0]
        found = minimize(lambda e: total(LONG, delta, e), start + 1e-4 * bounds * rng.normal(size=n), method="BFGS")
        stayed.append(abs(found.fun - layouts.energy[m]) < 1e-7 and np.allclose(found.x, start, atol=1e-3 * bounds))
    assert stayed == layouts.local.tolist()
    assert any(stayed)


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
    assert back.any() == (mixing < LONG.snap_free)
    assert LONG.lost(mixing) == pytest.approx(lost_in_both(LONG, vertices) if back.any() else 0, rel=1e-12)


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


def test_turning_points():
    assert LONG.turning_points(1e-12) == pytest.approx((LONG.up, LONG.down), rel=1e-10)
    near = LONG.turning_points(LONG.snap_free * (1 - 1e-9))
    assert near[0] == pytest.approx(near[1], rel=1e-8)
    assert near[0] > near[1]
    with pytest.raises(ValueError, match="no snap; allowed: < "):
        LONG.turning_points(LONG.snap_free)
    vertices = LONG.path(1.0)
    assert vertices[1:3, 0] == pytest.approx([LONG.delta_0, LONG.delta_1], rel=1e-12)
    assert vertices[1:3, 1] == pytest.approx([LONG.sigma_m] * 2, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"l": 0.0}, "l is 0.0; allowed: > 0"),
        ({"K": -2.0}, "K is -2.0"),
        ({"kbar": np.inf}, "kbar is inf"),
        ({"alpha": 0}, "alpha is 0"),
        ({"cbar": float("nan")}, "cbar is nan"),
        ({"K": "2"}, "K is '2'"),
        ({"eps": 1.0}, "eps is 1.0; allowed: 0 <= eps < 1"),
        ({"eps": -0.1}, "eps is -0.1"),
        ({"cbar": 0.27}, "cbar is 0.27; allowed: >= alpha.*0.272"),
    ],
)
def test_bar_out_of_range(change, message):
    with pytest.raises(ValueError, match=message):
        replace(LONG, **change)


def test_bound_of_the_transformation_energy_is_allowed():
    bar = limits.Bar(1.1, 1.3, 3, 1.2, 1.2**2 / 6, 0.2)
    assert bar.sigma_m == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: LONG.branch(1.0, 2), "phase is 2; allowed: -1, 0, 1"),
        (lambda: LONG.layouts(1.0, 0), "n is 0"),
        (lambda: LONG.layouts(1.0, 2.5), "n is 2.5"),
        (lambda: LONG.displacement(1.8, 1.0), "allowed: \\[0, 1.7\\]"),
        (lambda: LONG.layer(1.0, 1.1), "mixing = 1.1"),
        (lambda: LONG.lost(-0.1), "mixing = -0.1"),
        (lambda: LONG.path(0.5, end=0.1), "end is 0.1"),
    ],
)
def test_refused_by_the_bar(call, message):
    with pytest.raises(ValueError, match=message):
        call()


# ---------------------------------------------------------------- the interface law
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
@settings(deadline=None, max_examples=25)
@given(a=entries, mu=positive, nu=st.floats(-0.9, 0.48))
def test_lamination_is_the_best_direction(d, a, mu, nu):
    chi = np.array([[a[0], a[1], a[2]], [a[1], a[3], a[4]], [a[2], a[4], a[5]]])[:d, :d] + 0.01 * np.eye(d)
    assume(np.abs(chi).max() > 1e-3)
    lmbda = 2 * mu * nu / (1 - 2 * nu)
    found, k = limits.lamination(lmbda, mu, chi), directions(d)
    values = gain(lmbda, mu, chi, k)
    best = minimize(lambda k: -gain(lmbda, mu, chi, (k / np.linalg.norm(k))[None])[0], k[np.argmax(values)], tol=1e-12)
    scale = gain(lmbda, mu, np.abs(chi).max() * np.eye(d), k[:1])[0] + np.abs(chi).max() ** 2 / mu
    assert found == pytest.approx(-best.fun, abs=1e-7 * scale)
    assert values.max() <= found + 1e-12 * scale


def test_lamination_numbers():
    """At chi = n (x) n the sheets stand inclined; across n alone the gain is less."""
    normal = np.diag([0.0, 1.0])
    assert limits.lamination(60, 40, normal) == pytest.approx(0.00875, rel=1e-14)
    assert limits.lamination(60, 40, np.diag([0.0, 1.0, 0.0])) == pytest.approx(0.00875, rel=1e-14)
    assert gain(60, 40, normal, np.array([[0.0, 1.0]]))[0] == pytest.approx(1 / 140, rel=1e-14)
    assert limits.lamination(60, 40, [[0, 0.5], [0.5, 0]]) == pytest.approx(0.25 / 40, rel=1e-14)  # across n
    assert limits.lamination(0, 40, normal) == pytest.approx(1 / 80, rel=1e-14)  # across n


def relaxed(w, mixing=1.0, n=N, chi=CHI):
    t, phase = limits.non_monotone(LMBDA, MU, ALPHA, C, chi, w, n, mixing)
    return t, phase, limits.non_monotone_energy(LMBDA, MU, ALPHA, C, chi, w, n, phase, mixing)


W = np.random.default_rng(3).uniform(-1.2, 1.2, (40, 2))


def test_relaxed_energy_is_that_of_sheets():
    """Least energy of two phases that differ by a strain sym(a (x) k), over a, k and the fraction."""
    n, frame = N, np.array([[N[1], N[0]], [-N[0], N[1]]])
    chi = frame @ CHI @ frame.T

    def energy(e, z):
        return LMBDA / 2 * np.trace(e) ** 2 + MU * np.sum(e * e) - z * ALPHA * np.sum(chi * e) + C * abs(z)

    mixed = 0
    for w in W[:12]:
        e, sign = (np.outer(w, n) + np.outer(n, w)) / 2, np.sign(limits.non_monotone_drive(ALPHA, C, CHI, w, n))

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
    all_mixtures = limits.non_monotone_energy(LMBDA, MU, ALPHA, C, CHI, W, N, z, mixing)
    assert energy == pytest.approx(all_mixtures.min(axis=0), abs=1e-6)
    assert {-1, 0, 1} <= set(phase)
    for z in (-1, 0, 1):
        pure, holds = limits.non_monotone_branch(LMBDA, MU, ALPHA, C, CHI, W, N, z)
        assert t[phase == z] == pytest.approx(pure[phase == z], abs=1e-13)
        assert holds[phase == z].all()
        least = np.argmin([limits.non_monotone_energy(LMBDA, MU, ALPHA, C, CHI, W, N, y) for y in (-1, 0, 1)], axis=0)
        assert (holds == (least == z + 1)).all()
    assert relaxed(-W, mixing)[0] == pytest.approx(-t, abs=1e-13)


def test_relaxed_energy_is_convex_and_a_softening_one_is_not():
    rng = np.random.default_rng(8)
    a, b = rng.uniform(-1.5, 1.5, (2, 4000, 2))
    excess = lambda mixing: relaxed((a + b) / 2, mixing)[2] - (relaxed(a, mixing)[2] + relaxed(b, mixing)[2]) / 2
    assert excess(1.0).max() < 1e-12
    assert excess(0.1).max() > 1e-2


def test_traction_of_a_pure_phase():
    """Components along and across S by hand; the printed lmbda + mu, [u_1] and chi_12 [u_i] are other laws."""
    w, n = np.array([-0.3, 0.7]), np.array([0.0, 1.0])
    t, holds = limits.non_monotone_branch(LMBDA, MU, ALPHA, C, CHI, w, n, 1)
    assert t == pytest.approx([MU * -0.3 + ALPHA * 0.5, (LMBDA + 2 * MU) * 0.7 - ALPHA * 0.8], rel=1e-14)
    assert holds
    assert limits.non_monotone_drive(ALPHA, C, CHI, w, n) == pytest.approx(ALPHA * (0.5 * 0.3 + 0.8 * 0.7), rel=1e-14)
    assert ALPHA * -0.5 * (-0.3 + 0.7) < C  # printed: would not hold
    assert abs(t[1] - ((LMBDA + MU) * 0.7 - ALPHA * 0.8)) > 0.1 * abs(t[1])
    assert abs(t[1] - ((LMBDA + 2 * MU) * -0.3 - ALPHA * 0.8)) > 0.1 * abs(t[1])
    assert limits.non_monotone_branch(LMBDA, MU, ALPHA, C, CHI, 0 * w, n, 0)[0] == pytest.approx([0, 0])


@SLOW
@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
def test_orientation_turns_with_the_normal(a, b):
    """chi n against the rotation vector from e_2 to n; in 2D its first axis is (n_2, -n_1)."""
    n = np.array([np.sin(a) * np.cos(b), np.cos(a), np.sin(a) * np.sin(b)])
    axis = np.cross([0, 1, 0], n)
    turned = np.arctan2(np.linalg.norm(axis), n[1])
    assume(np.linalg.norm(axis) > 1e-5)
    turn = Rotation.from_rotvec(turned * axis / np.linalg.norm(axis)).as_matrix()
    basis = limits.non_monotone_drive(ALPHA, C, CHI_3, np.eye(3), n)
    assert basis == pytest.approx(ALPHA * turn @ CHI_3 @ turn.T @ n, abs=1e-9)
    plane = np.array([np.sin(a), np.cos(a)])
    frame = np.column_stack([[plane[1], -plane[0]], plane])
    basis = limits.non_monotone_drive(ALPHA, C, CHI, np.eye(2), plane)
    assert basis == pytest.approx(ALPHA * frame @ CHI @ frame.T @ plane, abs=1e-13)


def test_downward_normal_is_a_half_turn_about_the_third_axis():
    basis = limits.non_monotone_drive(1.0, C, CHI_3, np.eye(3), np.array([0.0, -1.0, 0.0]))
    turn = np.diag([-1, -1, 1])
    assert basis == pytest.approx(turn @ CHI_3 @ turn @ [0, -1, 0], abs=1e-15)


@pytest.mark.parametrize("mixing", [0.3, 1.0])
def test_layer_of_the_bar_is_the_interface_law(mixing):
    """lmbda = 0, chi = n (x) n, per thickness eps l: lmbda + 2 mu = kbar/l, C = l cbar; any eps."""
    U, n = np.linspace(-1.4, 1.4, 57), np.array([0.6, 0.8])
    mu, C_layer, chi = LONG.kbar / LONG.l / 2, LONG.l * LONG.cbar, np.diag([0.0, 1.0])
    t, phase = limits.non_monotone(0, mu, LONG.alpha, C_layer, chi, U[:, None] * n, n, mixing)
    energy = limits.non_monotone_energy(0, mu, LONG.alpha, C_layer, chi, U[:, None] * n, n, phase, mixing)
    expected = LONG.layer(U, mixing)
    assert t == pytest.approx(expected[0][:, None] * n, abs=1e-12)
    assert energy == pytest.approx(expected[1], abs=1e-12)
    assert phase == pytest.approx(expected[2], abs=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mu": 0.0}, "mu = 0; allowed: mu > 0"),
        ({"lmbda": -3.0}, "lmbda = -3"),
        ({"alpha": 0.0}, "alpha = 0"),
        ({"alpha": -1.0}, "alpha = -1"),
        ({"transformation_energy": -1.0}, "transformation_energy = -1"),
        ({"transformation_energy": 0.1}, "transformation_energy = 0.1; allowed: >= 0.2"),
        ({"mixing": 0.0}, "mixing = 0; allowed: 0 < mixing <= 1"),
        ({"mixing": 1.5}, "mixing = 1.5"),
        ({"chi": np.array([[0, 1], [0, 0]])}, "symmetric"),
        ({"chi": np.zeros((2, 2))}, "not zero"),
        ({"chi": np.eye(4)}, "\\(2, 2\\) or \\(3, 3\\)"),
        ({"chi": np.eye(3)}, "a unit vector"),
        ({"n": np.array([1.0, 1.0])}, "a unit vector"),
        ({"w": np.ones(3)}, "w \\(3,\\)"),
    ],
)
def test_law_out_of_range(change, message):
    values = {"lmbda": LMBDA, "mu": MU, "alpha": ALPHA, "transformation_energy": C, "chi": CHI, "w": W, "n": N} | change
    with pytest.raises(ValueError, match=message):
        limits.non_monotone(**values)


def test_branch_of_no_phase():
    with pytest.raises(ValueError, match=r"phase is 0.5; allowed: -1, 0, 1"):
        limits.non_monotone_branch(LMBDA, MU, ALPHA, C, CHI, W, N, 0.5)
