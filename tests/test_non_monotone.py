"""Non-monotone laws at points: the gain of laminates, energies, tangents, frames, drives, temperatures, sublayers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from forms import LawError, LinearElastic, NonMonotone, NonMonotoneUnrelaxed, Stack, Tabulated, limits
from forms.non_monotone import lamination_gain
from geometry import sandwich
from tests.at_points import E2, at_rest, jump_strain, material, respond, tensor, traction, vector
from thinlayer import Structure, ThinLayer, drive
from thinlayer.discretisation.layer import real_law
from thinlayer.errors import ModelError
from thinlayer.pointwise.columns import TIE

LMBDA, MU, ALPHA, C = 60.0, 40.0, 1.2, 0.02
ACROSS, ALONG = np.diag([0.0, 1.0]), np.array([[0.0, 0.5], [0.5, 0.0]])  # n (x) n, sym(tangent (x) n)
CHI2 = np.array([[-0.3, 0.5], [0.5, 0.9]])
CHI3 = np.array([[0.3, 0.5, -0.2], [0.5, 0.9, 0.4], [-0.2, 0.4, -0.6]])
CHIS = {"2D": CHI2, "3D": CHI3, "n (x) n": ACROSS, "sym(tangent (x) n)": ALONG}
RELAXED = {name: NonMonotone(LMBDA, MU, ALPHA, C, chi) for name, chi in CHIS.items()}
PURE = {name: NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, C, chi) for name, chi in CHIS.items()}
STEEP = NonMonotone(LMBDA, MU, ALPHA, C, CHI2, mixing=0.4)
LAWS = {
    "relaxed 2D": RELAXED["2D"],
    "relaxed 3D": RELAXED["3D"],
    "steep": STEEP,
    "pure": PURE["2D"],
    "pure 3D": PURE["3D"],
}
THETAS = [1.0, 0.7, 0.5]
SLOW = settings(deadline=None, max_examples=40)
EPS = 0.05  # a thickness


def lifted(a):
    """(..., 2, 2) tensors or (..., 2) vectors with zeros added; three-dimensional ones unchanged."""
    missing = 3 - a.shape[-1]
    ends = 2 if a.ndim > 1 and a.shape[-1] == a.shape[-2] else 1
    return np.pad(a, [(0, 0)] * (a.ndim - ends) + [(0, missing)] * ends)


def random_strains(law, points, seed=4, spread=2.5):
    """Mandel strains (points, 6), in the plane for two dimensions, whose drives m are spread C to both sides."""
    random, d = np.random.default_rng(seed), len(law.chi)
    a = 0.006 * random.normal(size=(points, d, d))
    e = lifted((a + np.swapaxes(a, 1, 2)) / 2)
    wanted = np.linspace(-spread, spread, points) * law.transformation_energy / law.alpha
    chi = lifted(law.chi)
    return vector(e + ((wanted - np.sum(e * chi, axis=(1, 2))) / np.sum(chi * chi))[:, None, None] * chi)


def drives(law, e):
    """alpha chi:e, for n = e_2."""
    return law.alpha * np.sum(tensor(e) * lifted(law.chi), axis=(1, 2))


def at(law, e, e_old=None, theta=1.0, n=E2, phase=None):
    """Answer of a law to strains after e_old, with phases held if they are given."""
    q = at_rest(law, len(e))
    if phase is not None:
        q[:, 0] = phase
    return respond(law, e, 0 * e if e_old is None else e_old, q, np.broadcast_to(n, (len(e), 3)), 1.0, theta)


def density(e, z, chi, C=C):
    """Energy of the phase z at strains (..., 3, 3), Eq. (39)."""
    elastic = LMBDA / 2 * np.trace(e, axis1=-2, axis2=-1) ** 2 + MU * np.sum(e * e, axis=(-2, -1))
    return elastic - z * ALPHA * np.sum(lifted(chi) * e, axis=(-2, -1)) + C * np.abs(z)


# ---------------------------------------------------------------- the gain of laminates
def gains(lmbda, mu, chi, angles):
    """(chi k).A(k)^-1 (chi k) for directions k of given angles (n,) or (n, 2)."""
    if len(chi) == 2:
        k = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    else:
        a, b = angles[..., 0], angles[..., 1]
        k = np.stack([np.cos(a) * np.sin(b), np.sin(a) * np.sin(b), np.cos(b)], axis=-1)
    v = k @ chi
    inverse = (np.eye(len(chi)) - (lmbda + mu) / (lmbda + 2 * mu) * k[..., :, None] * k[..., None, :]) / mu
    return np.einsum("...i,...ij,...j", v, inverse, v)


def best_gain(lmbda, mu, chi):
    """The largest, on grids of directions that close in on the best one."""
    count, width = len(chi) - 1, np.pi / 2
    centre = np.full(count, width)
    points = 401 if count == 1 else 121
    for _ in range(14):
        axes = [c + np.linspace(-width, width, points) for c in centre]
        angles = axes[0] if count == 1 else np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        found = gains(lmbda, mu, chi, angles)
        centre, width, points = np.atleast_1d(angles[np.argmax(found)]), width / 8, 41
    return found.max()


@given(st.integers(2, 3), st.integers(0, 10**6), st.floats(-0.9, 0.49), st.floats(0.1, 1e3))
@SLOW
def test_gain_is_that_of_the_best_direction(d, seed, nu, mu):
    a = np.random.default_rng(seed).normal(size=(d, d))
    lmbda, chi = 2 * mu * nu / (1 - 2 * nu), a + a.T
    G = lamination_gain(lmbda, mu, chi)
    assert pytest.approx(best_gain(lmbda, mu, chi), rel=1e-9) == G
    assert limits.lamination(lmbda, mu, chi) == pytest.approx(G, rel=1e-12)
    assert lamination_gain(lmbda, mu, -3 * chi) == pytest.approx(9 * G, rel=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_gain_where_it_is_known(d):
    """n (x) n: the best direction is oblique for lmbda > 0, and n for lmbda <= 0; with a tangent it is n, always."""
    across, along = (lifted(a)[:d, :d] for a in (ACROSS, ALONG))
    assert lamination_gain(60.0, 40.0, across) == pytest.approx(0.00875, rel=1e-14)
    at_n = np.array([np.pi / 2] if d == 2 else [[np.pi / 2, np.pi / 2]])
    assert gains(60.0, 40.0, across, at_n)[0] == pytest.approx(1 / 140, rel=1e-14)
    for lmbda in (-20.0, 0.0):
        assert lamination_gain(lmbda, 40.0, across) == pytest.approx(1 / (lmbda + 80), rel=1e-14)
    for lmbda in (-20.0, 0.0, 60.0, 3e3):
        assert lamination_gain(lmbda, 40.0, along) == pytest.approx(1 / (4 * 40), rel=1e-14)
        assert lamination_gain(lmbda, 40.0, np.eye(d)) == pytest.approx(1 / (lmbda + 80), rel=1e-14)


# ---------------------------------------------------------------- energy
def least_of_laminates(e, chi, pair, random, starts=4):
    """Least mean energy of sheets of two phases across k, with strains e - th sym(a (x) k), e + (1 - th) sym(a (x) k).

    The mean is quadratic in a, whose best value is found from differences; th and k are searched for.
    """
    d = len(chi)
    unit = 0.02 * np.eye(d)
    pairs = (unit[:, None] + unit[None]).reshape(-1, d)

    def mean(th, a, k):
        S = np.einsum("ni,j->nij", lifted(a), k)
        S = (S + np.swapaxes(S, 1, 2)) / 2
        return (1 - th) * density(e - th * S, pair[0], chi) + th * density(e + (1 - th) * S, pair[1], chi)

    def least(x):
        th, angles = x[0], [x[1], np.pi / 2 if d == 2 else x[-1]]
        k = np.array([np.cos(angles[0]) * np.sin(angles[1]), np.sin(angles[0]) * np.sin(angles[1]), np.cos(angles[1])])
        values = mean(th, np.concatenate([0 * unit[:1], unit, pairs]), k)
        none, one = values[0], values[1 : 1 + d]
        second = values[1 + d :].reshape(d, d) - one[:, None] - one[None] + none
        best = -np.linalg.solve(second, one - none - np.diag(second) / 2) @ unit
        return 1e2 * mean(th, best[None], k)[0]

    bounds = [(1e-4, 1 - 1e-4)] + [(None, None)] * (d - 1)
    found = [
        minimize(least, [0.5, *random.uniform(0, np.pi, d - 1)], method="L-BFGS-B", bounds=bounds, tol=1e-14).fun
        for _ in range(starts)
    ]
    return min(min(found) / 1e2, *(density(e, z, chi) for z in pair))


@pytest.mark.parametrize("name", ["2D", "3D", "n (x) n"])
def test_energy_is_the_least_of_all_laminates(name):
    """Of phases 0 and 1, 0 and -1; those of -1 and 1 have none that is lower. Another gain is not the least."""
    law, random = RELAXED[name], np.random.default_rng(3)
    e = random_strains(law, 6)
    chi, g = lifted(law.chi), ALPHA**2 * law.G
    wanted = np.array([1, -1, 1, -1, 1, -1]) * (C + g * np.array([-0.4, -0.1, 0.3, 0.45, -0.52, 0.6]))
    e += vector(((wanted - drives(law, e)) / (ALPHA * np.sum(chi**2)))[:, None, None] * chi)
    found = at(law, e)
    assert found.q[:, 0] == pytest.approx([0.1, -0.4, 0.8, -0.95, 0, -1], abs=1e-12)
    for strain, energy, m in zip(tensor(e), found.stored, wanted, strict=True):
        least = least_of_laminates(strain, law.chi, (0, np.sign(m)), random)
        assert energy == pytest.approx(least, rel=1e-9)
        assert least_of_laminates(strain, law.chi, (-1, 1), random, 1) > energy * (1 - 1e-9)
    smaller = at(law.with_parameters({"mixing": 0.8}), e).stored
    assert (smaller[:3] > found.stored[:3] * (1 + 1e-4)).all()


@pytest.mark.parametrize("name", CHIS)
def test_energy_is_below_those_of_phases_and_of_mixtures_of_one_strain(name):
    law = RELAXED[name]
    e = random_strains(law, 300)
    answer, m = at(law, e), drives(law, e)
    pure = np.array([density(tensor(e), z, law.chi) for z in (-1, 0, 1)])
    share = np.abs(answer.q[:, 0])
    transformed = np.where(m > 0, pure[2], pure[0])
    scale = np.abs(pure).max()
    assert (answer.stored <= pure.min(axis=0) + 1e-14 * scale).all()
    mixed = (share > 0.01) & (share < 0.99)
    assert mixed.sum() > 30
    assert (answer.stored < (1 - share) * pure[1] + share * transformed - 1e-6 * scale)[mixed].all()
    assert answer.stored[~mixed & (share == 0)] == pytest.approx(pure[1][share == 0], rel=1e-12)
    assert answer.stored[share == 1] == pytest.approx(transformed[share == 1], rel=1e-12)


def jumps_and_normals(law, count, seed=1):
    """Jumps and normals (count, 3) in the plane for a law of two dimensions, drives within a few C."""
    random, d = np.random.default_rng(seed), len(law.chi)
    w, n = (lifted(random.normal(size=(count, d))) for _ in range(2))
    return 0.015 * w, n / np.linalg.norm(n, axis=1)[:, None]


@pytest.mark.parametrize("least", [False, True], ids=["C", "C = g/2"])
@pytest.mark.parametrize("name", CHIS)
def test_energy_is_convex_along_every_jump(name, least):
    """Strains that differ by sym(a (x) k), for any k: rank-one convex, which is what laminates leave."""
    law = RELAXED[name]
    if least:
        law = NonMonotone(LMBDA, MU, ALPHA, ALPHA**2 * law.G / 2, law.chi)
    e, (a, k) = random_strains(law, 3000), jumps_and_normals(law, 3000)
    change = jump_strain(a, k)
    ends, middle = at(law, e - change).stored + at(law, e + change).stored, at(law, e).stored
    assert (ends - 2 * middle).min() > -1e-13 * ends.max()
    pull = np.sum((at(law, e + change).stress - at(law, e).stress) * change, axis=1)
    assert pull.min() > -1e-13 * np.abs(pull).max()


def test_what_is_not_convex():
    """Smaller gains along the best direction; and along strains that are no jumps, the relaxed energy itself."""
    along = jump_strain(np.array([[1.0, 0.0, 0.0]]), E2[None]) * np.linspace(0, 0.05, 41)[:, None]
    for mixing, monotone in ((1.0, True), (0.98, False)):
        law = NonMonotone(LMBDA, MU, ALPHA, C, ALONG, mixing=mixing)
        t = traction(at(law, along).stress, np.broadcast_to(E2, (41, 3)))[:, 0]
        assert (np.diff(t).min() > -1e-12) == monotone
        assert law.traits.softens == (not monotone)
    swelling = NonMonotone(LMBDA, MU, ALPHA, C, np.eye(2))
    e = np.linspace(0, 2 * C / ALPHA, 101)[:, None] * np.array([0.5, 0.5, 0, 0, 0, 0])
    assert np.diff(at(swelling, e).stored, 2).min() < -1e-6


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["2D", "3D", "n (x) n", "sym(tangent (x) n)"])
def test_stress_is_continuous(name, sign):
    """At both ends of the mixed range, where pure phases jump by alpha chi."""
    law, least = RELAXED[name], 1e-9
    g = ALPHA**2 * law.G
    base = sign * vector(lifted(law.chi))[None] / (ALPHA * np.sum(law.chi**2))  # a drive of 1
    for m, phase in ((C - g / 2, 0), (C + g / 2, sign)):
        below, above = (at(law, base * m * (1 + side * least)) for side in (-1, 1))
        assert below.q[0, 0] == pytest.approx(phase, abs=1e-7)
        assert above.q[0, 0] == pytest.approx(phase, abs=1e-7)
        assert below.q[0, 0] != above.q[0, 0]
        assert above.stress == pytest.approx(below.stress, abs=1e-7 * ALPHA)


@pytest.mark.parametrize("phase", [0, 1, -1])
@pytest.mark.parametrize("name", LAWS)
def test_stress_is_the_derivative_of_the_energy(name, phase):
    """Central differences, exact within a branch; phases of the unrelaxed law are held."""
    law = LAWS[name]
    e = random_strains(law, 200)
    random = np.random.default_rng(6)
    a = lifted(random.normal(size=law.chi.shape))
    direction = vector(a + a.T)[None]
    now = at(law, e, phase=phase)
    up, down = (at(law, e + h * direction, phase=phase) for h in (1e-6, -1e-6))
    slope, expected = (up.stored - down.stored) / 2e-6, np.sum(now.stress * direction, axis=1)
    same = branch(law, up) == branch(law, down)
    assert same.mean() > 0.95
    assert slope[same] == pytest.approx(expected[same], abs=1e-7 * np.abs(expected).max())
    assert slope == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())  # and next to its ends


@pytest.mark.parametrize("name", ["relaxed 2D", "pure"])
def test_three_components_of_strain_are_the_same_law(name):
    """In the plane: what two-dimensional models ask for."""
    law, plane = LAWS[name], [0, 1, 3]
    e = random_strains(law, 60)
    whole = at(law, e)
    part = respond(law, e[:, plane], 0 * e[:, plane], 0 * whole.q, np.tile(E2, (60, 1)), slots=plane)
    assert part.stress == pytest.approx(whole.stress[:, plane], rel=1e-14)
    assert part.tangent == pytest.approx(whole.tangent[:, plane][:, :, plane], rel=1e-14)
    assert part.energies == pytest.approx(whole.energies, rel=1e-14)


# ---------------------------------------------------------------- tangents, signs, frames
def branch(law, answer):
    """-2, 2 pure phases, -1, 1 mixtures, 0."""
    phase = answer.q[:, 0]
    return np.sign(phase) * (1 + (np.abs(phase) == 1))


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """The stress is linear in each branch, so that Taylor's remainder is rounding; a mixture has another tangent."""
    law = LAWS[name]
    e, old = random_strains(law, 200) / theta, random_strains(law, 200, seed=8, spread=0.0)
    mid = lambda strain: at(law, theta * strain + (1 - theta) * old, phase=phase)
    phase = np.resize([0, 1, -1], 200) if law.traits.switches else None
    direction = 0.01 * np.random.default_rng(1).normal(size=e.shape)
    now, kinds, sizes = at(law, e, old, theta, phase=phase), branch(law, mid(e)), (1e-2, 1e-3)
    for h in sizes:
        moved = at(law, e + h * direction, old, theta, phase=phase)
        left = np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max(axis=1)
        same = branch(law, mid(e + h * direction)) == kinds
        assert same.mean() > 0.95
        assert left[same].max() < 1e-13 * np.abs(now.stress).max()
    assert now.tangent == pytest.approx(np.swapaxes(now.tangent, 1, 2), abs=1e-13 * 140)
    elastic = at(LinearElastic(LMBDA, MU), e, old, theta).tangent
    change = (elastic - now.tangent) / theta
    mixed = np.abs(kinds) == 1
    chi = vector(lifted(law.chi))
    if law.traits.switches:
        assert set(kinds) == {-2, 0, 2}
        assert np.abs(change).max() < 1e-12
    else:
        assert set(kinds) == {-2, -1, 0, 1, 2}
        assert np.abs(change[~mixed]).max() < 1e-12
        assert change[mixed] == pytest.approx(np.tile(np.outer(chi, chi) / (law.mixing * law.G), (mixed.sum(), 1, 1)))


@pytest.mark.parametrize("name", LAWS)
def test_both_signs(name):
    """e -> -e turns stress and phase round; chi -> -chi calls phase 1 phase -1, and changes nothing else."""
    law = LAWS[name]
    e = random_strains(law, 100)
    other = type(law)(**{**{k: v for k, v in law.parameters().items() if k not in ("T", "G")}, "chi": -law.chi})
    phase = np.resize([0, 1, -1], 100) if law.traits.switches else None
    back = -phase if law.traits.switches else None
    now, mirrored, renamed = at(law, e, phase=phase), at(law, -e, phase=back), at(other, e, phase=back)
    assert set(np.sign(now.q[:, 0])) == {-1, 0, 1}
    for answer, sign in ((mirrored, -1), (renamed, 1)):
        assert answer.stress == pytest.approx(sign * now.stress, rel=1e-14)
        assert answer.q[:, 0] == pytest.approx(-now.q[:, 0], rel=1e-14)
        assert answer.energies == pytest.approx(now.energies, rel=1e-13)


def turn_to(n):
    """The rotation to the layer's axes by Rodrigues' formula, in the plane and (smallest) in space."""
    if n[1] < -1 + 1e-12:
        return np.diag([-1.0, -1.0, 1.0])
    cross = np.cross(E2, n)
    K = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.eye(3) + K + K @ K * ((1 - n[1]) / (cross @ cross))


NORMALS = {
    "relaxed 2D": [(0.6, 0.8, 0), (-0.8, -0.6, 0), (0, -1, 0), (1, 0, 0)],
    "relaxed 3D": [(1 / 3, 2 / 3, -2 / 3), (2 / 3, -1 / 3, 2 / 3), (0, -1, 0), (0, 0, 1), (6e-6, -1, 8e-6)],
}


@pytest.mark.parametrize("name", NORMALS)
def test_axes_turn_with_the_normal(name):
    """The law of another normal is the turned law: chi is in the layer's axes."""
    law, tilted = LAWS[name], LAWS[name.replace("relaxed", "pure").replace(" 2D", "")]
    e = random_strains(law, 100)
    for n in NORMALS[name]:
        n = np.array(n) / np.linalg.norm(n)
        R = turn_to(n)
        assert np.abs(R @ E2 - n).max() < 1e-10
        for one, phase in ((law, None), (tilted, np.resize([0, 1, -1], 100))):
            now, there = at(one, e, phase=phase), at(one, vector(R @ tensor(e) @ R.T), n=n, phase=phase)
            assert there.stress == pytest.approx(vector(R @ tensor(now.stress) @ R.T), abs=1e-9)
            assert there.q == pytest.approx(now.q, abs=1e-9)
            assert there.energies == pytest.approx(now.energies, abs=1e-11)
    ignored = at(law, vector(R @ tensor(e) @ R.T))  # as if n were e_2
    assert np.abs(ignored.stress - vector(R @ tensor(at(law, e).stress) @ R.T)).max() > 0.1


# ---------------------------------------------------------------- drive and the closed formulas
AXES = {2: ("T", "N"), 3: ("T1", "T2", "N")}


def pulled(kind, values):
    """Steps of a path, jumps ("w") or tractions ("t") in the order of `PointHistory`."""
    return [{f"{kind}_{c}": x for c, x in zip(AXES[len(v)], v, strict=True)} for v in values]


def in_layer_axes(values):
    """From T, N or T1, T2, N to the layer's axes, whose second is N."""
    return values[..., [[0, 1], [0, 2, 1]][values.shape[-1] - 2]]


from_layer_axes = in_layer_axes


PATHS = {
    2: [
        (0.004, 0.002),
        (0.01, 0.008),
        (0.03, 0.05),
        (0.06, 0),
        (-0.002, 0.01),
        (-0.03, 0),
        (-0.04, -0.01),
        (-0.02, 0.01),
    ],
    3: [(0, 0.002, -0.0003), (0.01, 0.01, 0.004), (0.05, 0, 0.04), (0, 0.04, -0.03), (-0.04, -0.02, -0.02)],
}


@pytest.mark.parametrize("n", [(0, 1), (0, -1), (3, -4), (0, 1, 0), (0, -1, 0), (1, 2, -2)], ids=str)
def test_drive_is_the_closed_formula(n):
    """Along jumps, and with mixing = 1 along tractions, which have one jump each."""
    d = len(n)
    chi, path, axis = (CHI2, CHI3)[d - 2], np.array(PATHS[d]), np.eye(d)[1]
    for mixing in (0.4, 1.0):
        law = NonMonotone(LMBDA, MU, ALPHA, C, chi, mixing=mixing)
        found = drive(law, pulled("w", path), n)
        numbers = (LMBDA, MU, ALPHA, C, chi)
        t, phase = limits.non_monotone(*numbers, in_layer_axes(path), axis, mixing)
        assert found.tractions == pytest.approx(from_layer_axes(t), rel=1e-12, abs=1e-13)
        assert found.memory[:, 0] == pytest.approx(phase, abs=1e-13)
        energy = limits.non_monotone_energy(*numbers, in_layer_axes(path), axis, phase, mixing)
        assert found.energies[:, 0] == pytest.approx(energy, rel=1e-11)
        work = np.sum(found.tractions * np.diff(path, axis=0, prepend=0), axis=1)
        assert work == pytest.approx(np.diff(energy, prepend=0) + found.energies[:, 2], rel=1e-10, abs=1e-14)
        assert {-1, 0, 1} <= set(phase)
        assert mixing < 1 or any(0.1 < abs(z) < 0.9 for z in phase)
    back = drive(law, pulled("t", found.tractions), n)
    assert back.jumps == pytest.approx(path, rel=1e-9, abs=1e-11)
    assert back.tractions == pytest.approx(found.tractions, rel=1e-9, abs=1e-11)
    assert back.memory == pytest.approx(found.memory, abs=1e-9)


def test_as_printed_it_is_another_law():
    """Eqs. (41)-(43): lmbda + mu, [u_1] for [u_2], and a threshold for chi_12 [u_i]."""
    law, path = PURE["2D"], np.array(PATHS[2])
    found = drive(law, pulled("w", path))
    t, z = found.tractions, found.memory[:, 0]
    assert set(z) == {-1, 0, 1}
    for phase in (-1, 0, 1):
        formula, holds = limits.non_monotone_branch(LMBDA, MU, ALPHA, C, CHI2, path, np.eye(2)[1], phase)
        assert (holds == (z == phase)).all()
        assert t[holds] == pytest.approx(formula[holds], rel=1e-12)
    softer = (LMBDA + MU) * path[:, 1] - z * ALPHA * CHI2[1, 1]
    crossed = (LMBDA + 2 * MU) * path[:, 0] - z * ALPHA * CHI2[1, 1]
    for printed in (softer, crossed):
        assert np.abs(printed - t[:, 1]).max() > 0.1 * np.abs(t[:, 1]).max()
    by_shear = [ALPHA * CHI2[0, 1] * path[:, i] >= C for i in (0, 1)]
    assert all((switched != (z == 1)).any() for switched in by_shear)
    assert (z == -1).any()  # which (43) does not have


@pytest.mark.parametrize("lmbda", [LMBDA, 0.0, -20.0])
@pytest.mark.parametrize("chi", [ACROSS, ALONG], ids=["n (x) n", "sym(tangent (x) n)"])
def test_tractions_beyond_the_plateau_are_found(chi, lmbda):
    """Where the tangent is singular in the mixture, from below and from above, and through both plateaus at once."""
    law = NonMonotone(lmbda, MU, ALPHA, C, chi)
    path = np.array([(0.1, 0.1), (1.2, 2.9), (-1.2, -2.9), (3.0, 4.0), (0.1, 0.1)])
    found = drive(law, pulled("t", path))
    assert found.tractions == pytest.approx(path, rel=1e-10)
    assert found.memory[:, 0].tolist() == [0, 1, -1, 1, 0]
    assert found.jumps[-1] == pytest.approx(found.jumps[0], rel=1e-10)


# ---------------------------------------------------------------- pure phases
def test_pure_phases_switch_at_the_jump_where_their_energies_are_equal():
    """alpha chi:E = C, up and back, both signs; a jump at the threshold keeps the phase that was there."""
    law, direction = PURE["2D"], np.array([0.3, 1.0])
    threshold = C / (ALPHA * direction @ CHI2[:, 1])
    sizes = np.array([1 - 1e-9, 1, 1 + 1e-9, 1, 1 - 1e-9, -1 + 1e-9, -1, -1 - 1e-9, -1, 3, 0, -3, 1e-3])
    phases = [0, 0, 1, 1, 0, 0, 0, -1, -1, 1, 0, -1, 0]
    found = drive(law, pulled("w", threshold * sizes[:, None] * direction))
    assert found.memory[:, 0].tolist() == phases
    assert TIE < 1e-9
    for n in [(0, -1), (-0.6, 0.8)]:
        assert drive(law, pulled("w", threshold * sizes[:, None] * direction), n).memory[:, 0].tolist() == phases
    stored, dissipated, remainder = found.energies.T
    work = np.sum(found.tractions * np.diff(found.jumps, axis=0, prepend=0), axis=1)
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, abs=1e-13)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_thresholds_at_any_size_of_chi(size):
    """alpha chi is what counts; ties are relative to C."""
    for kind in (NonMonotone, NonMonotoneUnrelaxed):
        one = kind(LMBDA, MU, ALPHA, C, CHI2)
        law = kind(LMBDA, MU, ALPHA / size, C, CHI2 * size)
        found, expected = (drive(x, pulled("w", PATHS[2])) for x in (law, one))
        assert found.tractions == pytest.approx(expected.tractions, rel=1e-12, abs=1e-13)
        assert found.memory[:, 0] == pytest.approx(expected.memory[:, 0], abs=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["2D", "n (x) n", "sym(tangent (x) n)", "3D"])
def test_hysteresis_under_prescribed_traction(name, sign):
    """Up at alpha chi n.K^-1 t = C, down where it is C - g_n; g_n = alpha^2 chi n.K^-1 chi n is lost, half each way."""
    law = PURE[name]
    d = len(law.chi)
    K = MU * np.eye(d) + (LMBDA + MU) * np.diag(np.eye(d)[1])
    b = ALPHA * law.chi[:, 1]
    g_n = b @ np.linalg.solve(K, b)
    direction = np.array([0.4, 1.0, 0.3])[:d]
    drive_of = b @ np.linalg.solve(K, direction)
    up, down = C / drive_of, (C - g_n) / drive_of
    if name == "n (x) n":
        assert (up, down) == pytest.approx((140 * C / ALPHA, 140 * C / ALPHA - ALPHA))
    least = 1e-9 * abs(up)
    sizes = np.array([up - least, up + least, 2 * up, up, down + least, down - least, down + least, up - least, 0])
    path = sign * sizes[:, None] * direction
    found = drive(law, pulled("t", from_layer_axes(path)), np.eye(d)[1])
    assert found.memory[:, 0].tolist() == [0, sign, sign, sign, sign, 0, 0, 0, 0]
    expected = np.linalg.solve(K, path.T).T + found.memory[:, :1] * np.linalg.solve(K, b)
    assert in_layer_axes(found.jumps) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    stored, dissipated, remainder = found.energies.T
    t, change = found.tractions, np.diff(found.jumps, axis=0, prepend=0)
    work = np.sum(t * change, axis=1)
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, abs=1e-13)
    assert (dissipated == 0).all()
    assert remainder[[1, 5]] == pytest.approx(g_n / 2 * np.ones(2), rel=1e-6)
    middles = t - np.diff(t, axis=0, prepend=0) / 2
    assert np.sum(middles * change) == pytest.approx(g_n, rel=1e-6)


def test_phases_of_the_two_laws_agree_where_phases_are_pure():
    """And the tractions; in between the relaxed one lies between the branches."""
    path = pulled("w", PATHS[2])
    mixed, pure = drive(RELAXED["2D"], path), drive(PURE["2D"], path)
    same = np.abs(mixed.memory[:, 0]) % 1 == 0
    assert 2 <= same.sum() < len(path)
    assert mixed.tractions[same] == pytest.approx(pure.tractions[same], rel=1e-12)
    assert (mixed.energies[~same, 0] < pure.energies[~same, 0] * (1 - 1e-4)).all()


# ---------------------------------------------------------------- thickness
@pytest.mark.parametrize("name", LAWS)
def test_scaling(name):
    """Moduli ~ eps, alpha ~ eps^0, C ~ 1/eps: traction and eps times the energy of sym([u] (x) n)/eps do not know eps."""
    law = LAWS[name]
    phase = np.resize([0, 1, -1], 50) if law.traits.switches else None
    w, n = jumps_and_normals(law, 50)
    E = jump_strain(w, n)
    there = at(law, E, n=n, phase=phase)
    for eps in (1e-3, 0.5):
        real = real_law(ThinLayer(law, eps), "strain")
        numbers = real.parameters()
        assert (numbers["lmbda"], numbers["mu"], numbers["alpha"], numbers["transformation_energy"]) == pytest.approx(
            (LMBDA * eps, MU * eps, ALPHA, C / eps), rel=1e-15
        )
        built = type(law)(LMBDA * eps, MU * eps, ALPHA, C / eps, law.chi, **extra(law))
        for one in (real, built):
            answer = at(one, E / eps, n=n, phase=phase)
            assert answer.stress == pytest.approx(there.stress, rel=1e-11, abs=1e-12)
            assert eps * answer.energies == pytest.approx(there.energies, rel=1e-10, abs=1e-14)
            assert answer.q[:, 0] == pytest.approx(there.q[:, 0], abs=1e-11)
        per_thickness = built.per_thickness(eps).parameters()
        for key, value in law.parameters().items():
            assert per_thickness[key] == pytest.approx(value, rel=1e-14)
    wrong = law.with_parameters(
        {"lmbda": LMBDA * eps, "mu": MU * eps, "transformation_energy": C}
    )  # "the same power" for alpha and C
    if not law.traits.switches:
        assert np.abs(at(wrong, E / eps, n=n).stress - there.stress).max() > 0.1


def extra(law):
    return {} if law.traits.switches else {"mixing": law.mixing}


# ---------------------------------------------------------------- temperature
TABLE = Tabulated([(0.0, 2.0), (10.0, 1.0), (40.0, 4.0)])


def test_a_table_is_linear_in_between():
    assert TABLE(5.0) == pytest.approx(1.5)
    assert TABLE(np.array([0.0, 10.0, 25.0, 40.0])) == pytest.approx([2.0, 1.0, 2.5, 4.0])
    assert TABLE([[0, 40]]).shape == (1, 2)
    assert Tabulated(iter([(1, 2), (3, 4)])).values == ((1.0, 2.0), (3.0, 4.0))


@pytest.mark.parametrize(
    "values",
    [
        [], [(1.0, 2.0)], [(2.0, 1.0), (1.0, 1.0)], [(1.0, 1.0), (1.0, 2.0)], [(1.0, np.nan), (2.0, 1.0)],
        [(np.nan, 1.0), (2.0, 1.0)], [(1.0, 1.0), (np.inf, 1.0)], [1.0, 2.0], [(1, 2, 3), (2, 3, 4)], "ab", None,
        [("cold", 1.0), ("hot", 2.0)],
    ],
)  # fmt: skip
def test_a_bad_table(values):
    with pytest.raises(LawError, match=r"Tabulated needs .*pairs \(T, value\)"):
        Tabulated(values)


@pytest.mark.parametrize(("T", "named"), [(-0.1, "-0.1"), (np.array([20.0, 41.0]), "41"), (np.nan, "nan")])
def test_temperatures_outside_the_table(T, named):
    with pytest.raises(LawError, match=f"T is {named}; the table knows 0 to 40"):
        TABLE(T)


def test_the_layer_switches_only_above_a_temperature():
    """alpha chi:E = C(T) at T = 20; alpha grows with T too, and both are values at T whatever the form they come in."""
    jump = [{"w_T": 0.0, "w_N": 0.03}]
    reached = ALPHA * 0.9 * 0.03
    falling = Tabulated([(0.0, 2 * reached), (40.0, 1e-9)])
    for kind, warm in ((NonMonotoneUnrelaxed, 20.1), (NonMonotone, 36.0)):
        cold = kind(LMBDA, MU, lambda T: ALPHA + 0 * T, lambda T: falling(T) + 0.008, CHI2, T=0.0)
        hot = kind(
            LMBDA, MU, ALPHA, falling if kind is NonMonotoneUnrelaxed else lambda T: falling(T) + 0.008, CHI2, T=warm
        )
        assert drive(cold, jump).memory[0, 0] == 0
        assert drive(hot, jump).memory[0, 0] == 1
        number = kind(LMBDA, MU, ALPHA, float(hot.parameters()["transformation_energy"]), CHI2)
        assert drive(hot, jump).tractions == pytest.approx(drive(number, jump).tractions, rel=1e-14)
    just = NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, falling, CHI2, T=19.9)
    assert drive(just, jump).memory[0, 0] == 0
    grown = NonMonotoneUnrelaxed(LMBDA, MU, Tabulated([(0.0, 1.0), (40.0, 2.0)]), reached, CHI2, T=20.0)
    assert grown.parameters()["alpha"] == pytest.approx(1.5)
    assert drive(grown, jump).memory[0, 0] == 1


def test_a_field_of_temperatures():
    """Each point has its parameters; and eps is that of the layer, whose real C is C/eps."""
    law = NonMonotone(LMBDA, MU, ALPHA, lambda T: 0.01 + 0.001 * T, CHI2, T=lambda x, t: 10 * x[0] + t)
    assert law.traits.varies
    x = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    values = law.at(x, 3.0)
    assert values["T"] == pytest.approx([3.0, 13.0, 23.0])
    assert values["transformation_energy"] == pytest.approx([0.013, 0.023, 0.033])
    assert values["alpha"] == pytest.approx(3 * [ALPHA])
    real = real_law(ThinLayer(law, EPS), "strain")
    assert real.at(x, 3.0)["transformation_energy"] == pytest.approx(values["transformation_energy"] / EPS)
    assert real.per_thickness(EPS).at(x, 3.0)["transformation_energy"] == pytest.approx(values["transformation_energy"])
    w = np.array([[0.0, 0.02, 0.0]] * 3)
    n = np.tile(E2, (3, 1))
    for one, eps in ((law, 1.0), (real, EPS)):
        points = material(one)
        points.take_at(x, 3.0)
        e = jump_strain(w, n) / eps
        stress, _, q, _, failed = points.update(range(6), e, 0 * e, np.zeros((3, 2)), n, 1.0, 1.0)
        assert failed == 0
        for k, C_k in enumerate((0.013, 0.023, 0.033)):
            t, phase = limits.non_monotone(LMBDA, MU, ALPHA, C_k, CHI2, w[k, :2], np.eye(2)[1])
            assert traction(stress, n)[k, :2] == pytest.approx(t, rel=1e-11, abs=1e-13)
            assert q[k, 0] == pytest.approx(phase, abs=1e-11)
    assert len(set(q[:, 0])) == 3
    with pytest.raises(ModelError, match="temperature that is a number, not a field"):
        drive(law, [{"w_T": 0.0, "w_N": 0.1}])
    arrays = NonMonotone(LMBDA, MU, np.array(ALPHA), np.array(C), CHI2, T=lambda x, t: x[0])
    assert arrays.at(x, 0.0)["alpha"] == pytest.approx(3 * [ALPHA])


def test_functions_of_temperature_per_thickness():
    """Functions are scaled as numbers are: a law of real values, in a layer of thickness EPS."""
    for T in (15.0, lambda x, t: 15.0 + 0 * x[0]):
        real = NonMonotone(LMBDA * EPS, MU * EPS, lambda T: 0.08 * T, lambda T: T / 1000 / EPS, CHI2, T=T)
        law = real.per_thickness(EPS)
        values = law.at(np.zeros((2, 1)), 0.0) if law.traits.varies else law.parameters()
        assert [*np.ravel(values["alpha"]), *np.ravel(values["transformation_energy"])] == pytest.approx(
            [1.2, 0.015], rel=1e-14
        )
        assert abs(law.G / lamination_gain(LMBDA, MU, CHI2) - 1) < 1e-13


X = np.array([[0.0, 1.0], [0.0, 0.5]])


@pytest.mark.parametrize(
    ("alpha", "C", "T", "message"),
    [
        (lambda T: np.ones(3), C, None, r"alpha\(T\) fails for T of shape \(2,\).*numpy function"),
        (lambda T: 1 / 0, C, None, r"alpha\(T\) fails .*ZeroDivisionError"),
        (lambda T: "warm", C, None, r"alpha\(T\) fails"),
        (lambda: 1.0, C, None, r"alpha\(T\) fails .*TypeError"),
        (ALPHA, lambda T: np.nan * T, None, r"transformation_energy\(T\) is not finite at T = 5"),
        (ALPHA, lambda T: None, None, r"transformation_energy\(T\) fails .*it gives object values"),
        (ALPHA, lambda T: 5 - T, None, r"transformation_energy at x = \(1, 0.5\), t = 0.5 is -5; allowed: > 0"),
        (lambda T: 0 * T, C, None, r"alpha at x = \(0, 0\), t = 0.5 is 0; allowed: > 0"),
        (lambda T: 0.3 * T, C, None, r"transformation_energy at x = .* is 0.02; allowed: >= mixing alpha\^2 G/2 = "),
        (TABLE, C, lambda x, t: 50 * x[0], r"alpha\(T\): T is 50; the table knows 0 to 40"),
        (ALPHA, C, lambda x, t: np.zeros(3), r"T\(x, t\) fails for x of shape \(2, 2\)"),
        (ALPHA, C, lambda x: 1.0, r"T\(x, t\) fails .*TypeError"),
        (ALPHA, C, lambda x, t: np.where(x[0] > 0, np.inf, 1.0), r"T is inf at x = \(1, 0.5\), t = 0.5"),
        (ALPHA, C, lambda x, t: "cold", r"T\(x, t\) fails .*TypeError"),
    ],
)
def test_functions_that_are_none(alpha, C, T, message):
    law = NonMonotone(LMBDA, MU, alpha, C, CHI2, T=T or (lambda x, t: 5 + 5 * x[0]))
    with pytest.raises(LawError, match=f"^NonMonotone: {message}"):
        law.at(X, 0.5)


# ---------------------------------------------------------------- sublayers in series
STIFF, SHARE = LinearElastic(20.0, 90.0), 0.4


def in_series(w):
    """Traction and phase of an elastic sublayer and a non-monotone one, by hand."""
    n = np.eye(2)[1]
    K = [mu * np.eye(2) + (lmbda + mu) * np.outer(n, n) for lmbda, mu in ((STIFF.lmbda, STIFF.mu), (LMBDA, MU))]
    F = SHARE * np.linalg.inv(K[0]) + (1 - SHARE) * np.linalg.inv(K[1])
    b, g = ALPHA * CHI2[:, 1], ALPHA**2 * RELAXED["2D"].G
    free = np.linalg.solve(K[1], b)

    def strain(z):
        """Of the non-monotone sublayer, with traction: w = F t + (1 - SHARE) z K^-1 b."""
        t = np.linalg.solve(F, w - (1 - SHARE) * z * free)
        return np.linalg.solve(K[1], t) + z * free, t

    side = np.sign(b @ strain(0.0)[0])
    lack = lambda z: abs(b @ strain(z)[0]) - C - g * (abs(z) - 0.5)  # linear in the phase fraction
    start, end = lack(0.0), lack(side)
    z = 0.0 if start <= 0 else side if end >= 0 else side * start / (start - end)
    return strain(z)[1], z


@pytest.mark.parametrize("order", [1, -1])
def test_in_series_with_an_elastic_sublayer(order):
    law = Stack(*[(SHARE, STIFF), (1 - SHARE, RELAXED["2D"])][::order])
    assert law.traits.phases
    assert not law.traits.softens
    path = np.array([*PATHS[2], (0.02, 0.03), (0.0, 0.02), (0.0, -0.02)])
    found = drive(law, pulled("w", path))
    expected = [in_series(w) for w in path]
    assert found.tractions == pytest.approx(np.array([t for t, _ in expected]), rel=1e-9, abs=1e-12)
    phase = found.memory[:, 6]
    assert phase == pytest.approx(np.array([z for _, z in expected]), abs=1e-10)
    assert {-1, 0, 1} <= set(phase)
    assert any(0.05 < z < 0.95 for z in phase)
    assert any(-0.95 < z < -0.05 for z in phase)
    stored, dissipated, remainder = found.energies.T
    work = np.sum(found.tractions * np.diff(path, axis=0, prepend=0), axis=1)
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, rel=1e-8, abs=1e-13)
    alone = drive(RELAXED["2D"], pulled("w", path))
    assert np.abs(alone.tractions - found.tractions).max() > 0.1


# ---------------------------------------------------------------- bad input
GOOD = {"lmbda": LMBDA, "mu": MU, "alpha": ALPHA, "transformation_energy": C, "chi": CHI2}
BOUND = ALPHA**2 * lamination_gain(LMBDA, MU, CHI2) / 2
BAD = [
    *(({name: value}, f"{name} is .*allowed: .*")
      for name in ("alpha", "transformation_energy")
      for value in (0.0, -1.0, np.nan, np.inf, "1", None, [1.0, 2.0], True, 1j)),
    ({"alpha": -0.1}, "alpha is -0.1; allowed: > 0"),
    ({"transformation_energy": 0}, "transformation_energy is 0; allowed: > 0"),
    ({"mu": 0.0}, "mu is 0.0; allowed: > 0"),
    ({"lmbda": -27.0}, "lmbda is -27.0; allowed: > -2 mu/3 = -26.6"),
    ({"lmbda": "soft"}, "lmbda is 'soft'; allowed: a number"),
    ({"mu": lambda T: T}, "mu is .*allowed: a number"),
    ({"chi": np.array([[1.0, 0.2], [0.1, 1.0]])}, r"chi is \[\[1.0, 0.2\], \[0.1, 1.0\]\]; allowed: a symmetric tensor"),
    ({"chi": [[1.0, 1e-6], [0.0, 1.0]]}, "chi is .*allowed: a symmetric tensor"),
    ({"chi": np.zeros((2, 2))}, "chi is zero; allowed: a tensor that is not zero"),
    ({"chi": np.eye(2) * np.nan}, "chi is not finite; allowed: finite numbers"),
    ({"chi": [[1.0, np.inf], [np.inf, 1.0]]}, "chi is not finite"),
    ({"chi": np.ones((2, 3))}, r"shape of chi is \(2, 3\); allowed: \(2, 2\) in plane strain, \(3, 3\) in 3D"),
    ({"chi": np.eye(4)}, r"shape of chi is \(4, 4\)"),
    ({"chi": 1.0}, r"shape of chi is \(\)"),
    ({"chi": np.ones(6)}, r"shape of chi is \(6,\)"),
    ({"chi": [[1.0, 2.0], [3.0]]}, r"chi is \[\[1.0, 2.0\], \[3.0\]\]; allowed: numbers"),
    ({"chi": [["1", "2"], ["2", "1"]]}, "chi is .*allowed: numbers"),
    ({"chi": None}, "chi is None; allowed: numbers"),
    ({"chi": lambda T: np.eye(2)}, "chi is <.*allowed: numbers"),
    ({"T": "warm"}, "T is 'warm'; allowed: "),
    ({"T": np.nan}, "T is nan; allowed: a number, a function"),
    ({"alpha": TABLE}, r"alpha is a function of T; give T, a number or a function \(x, t\)"),
    ({"transformation_energy": lambda T: T}, "transformation_energy is a function of T; give T"),
    ({"alpha": TABLE, "T": 41.0}, r"alpha\(T\): T is 41; the table knows 0 to 40"),
    ({"transformation_energy": lambda T: -T, "T": 2.0}, "transformation_energy is -2; allowed: > 0"),
]  # fmt: skip
BAD_RELAXED = [
    (
        {"transformation_energy": 0.999 * BOUND},
        rf"transformation_energy is {0.999 * BOUND:g}; allowed: >= mixing alpha\^2 G/2 = {BOUND:g}: phases 1 and -1",
    ),
    ({"transformation_energy": 0.499 * BOUND, "mixing": 0.5}, "transformation_energy is .*: phases 1 and -1 would mix"),
    (
        {"transformation_energy": lambda T: 0.999 * BOUND + 0 * T, "T": 20.0},
        "transformation_energy is .*: phases 1 and -1 would mix",
    ),
    *(({"mixing": value}, "mixing is .*allowed: .*") for value in (0.0, -0.5, 1.0001, np.nan, np.inf, "all", None)),
    ({"G": 0.01}, "has no parameter 'G'; known: lmbda, mu, alpha, transformation_energy, chi, T, mixing"),
]


@pytest.mark.parametrize("kind", [NonMonotone, NonMonotoneUnrelaxed])
@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_parameters(kind, change, message):
    with pytest.raises(LawError, match=f"^{kind.__name__}: {message}"):
        kind(**{**GOOD, **change})


@pytest.mark.parametrize(("change", "message"), BAD_RELAXED)
def test_bad_parameters_of_the_relaxed_law(change, message):
    with pytest.raises(LawError, match=f"^NonMonotone:? {message}"):
        NonMonotone(**{**GOOD, **change})


def test_parameters_that_are_just_allowed():
    """C = g/2 to rounding; a chi whose symmetry is lost by rounding; whole numbers; an unrelaxed law of any C."""
    assert drive(
        NonMonotone(**{**GOOD, "transformation_energy": BOUND}), [{"w_T": 0.0, "w_N": 0.0}]
    ).tractions == pytest.approx(0, abs=1e-14)
    assert NonMonotone(**{**GOOD, "transformation_energy": BOUND / 2, "mixing": 0.5}).mixing == 0.5
    rounded = NonMonotone(**{**GOOD, "chi": np.array([[1.0, 1e-17], [3e-17, 0.5]])})
    assert (rounded.chi == rounded.chi.T).all()
    assert NonMonotone(60, 40, 1, 1, [[0, 1], [1, 2]]).chi.dtype == float
    assert NonMonotoneUnrelaxed(**{**GOOD, "transformation_energy": 0.01 * BOUND}).transformation_energy == 0.01 * BOUND
    given = CHI2.copy()
    law = NonMonotone(LMBDA, MU, ALPHA, C, given)
    given[:] = 0
    assert (law.chi == CHI2).all()


def test_a_law_equals_itself_alone():
    """Not every other one of its kind."""
    law = RELAXED["2D"]
    same = {law, law, RELAXED["n (x) n"], NonMonotone(LMBDA, MU, ALPHA, 2 * C, CHI2)}
    assert len(same) == 3
    assert law != RELAXED["n (x) n"]
    assert Stack((0.5, STIFF), (0.5, law)) != Stack((0.5, STIFF), (0.5, RELAXED["n (x) n"]))


@pytest.mark.parametrize("kind", [NonMonotone, NonMonotoneUnrelaxed])
def test_unknown_names(kind):
    with pytest.raises(
        LawError,
        match=f"{kind.__name__} has no parameter 'cbar'; known: lmbda, mu, alpha, transformation_energy, chi, T",
    ):
        kind(LMBDA, MU, ALPHA, cbar=C, chi=CHI2)
    if kind is NonMonotoneUnrelaxed:
        with pytest.raises(LawError, match="no parameter 'mixing'"):
            kind(**GOOD, mixing=0.5)


def test_where_the_laws_have_no_place():
    """Columns that switch are not points in series; bodies have no axes; softening localises; dimensions."""
    pure, relaxed = PURE["2D"], RELAXED["2D"]
    with pytest.raises(LawError, match="Stack: a sublayer is NonMonotoneUnrelaxed"):
        Stack((0.5, STIFF), (0.5, pure))
    with pytest.raises(LawError, match="order=1 of NonMonotoneUnrelaxed"):
        ThinLayer(pure, 0.1, order=1)
    with pytest.raises(LawError, match="plane stress is not defined for NonMonotone"):
        relaxed.plane_stress()
    for law, n in ((relaxed, (0, 1, 0)), (RELAXED["3D"], (0, 1)), (Stack((0.5, STIFF), (0.5, relaxed)), (0, 0, 1))):
        d = len(n)
        with pytest.raises(
            LawError, match=rf"NonMonotone: shape of chi is .*allowed: \({d}, {d}\) in a model of dimension"
        ):
            drive(law, pulled("w", [(0.0,) * d]), n)
    plates = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    setup = dict(supports={"BOTTOM": 0.0}, element="Q1")
    for build, law, body, error, message in (
        (
            Structure.interface,
            relaxed,
            relaxed,
            ModelError,
            "body '.*': NonMonotone is for layers; bodies take elastic laws",
        ),
        (Structure.interface, relaxed, pure, ModelError, "NonMonotoneUnrelaxed is for layers"),
        (
            Structure.interface,
            RELAXED["3D"],
            STIFF,
            LawError,
            r"chi is \(3, 3\); allowed: \(2, 2\) in a model of dimension 2",
        ),
        (Structure.full, STEEP, STIFF, ModelError, "falls as strains grow.*take mixing=1, or NonMonotoneUnrelaxed"),
    ):
        with pytest.raises(error, match=message):
            build(Structure(plates, body=body, **setup), ThinLayer(law, 0.1))
