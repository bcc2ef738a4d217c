"""Laws with time at points, without a mesh: tangents, energies, rotations, closed forms, series, bad laws."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from scipy.optimize import minimize_scalar

from forms import (
    Anisotropic,
    BulkLaw,
    Incompressible,
    KelvinVoigt,
    KernelLaw,
    LawError,
    LinearElastic,
    Maxwell,
    Norton,
    Stack,
    TractionLaw,
    limits,
)
from forms.kinematics import MANDEL, ROOT2, lift
from forms.law import Step
from forms.traction import JumpStep
from geometry import sandwich
from tests.own_laws import Fragile, Hardening, Mises, Slipping, StandardSolid
from thinlayer import Structure, ThinLayer, solve
from thinlayer.discretisation.layer import real_law
from thinlayer.pointwise.kernels import SIZES
from thinlayer.pointwise.material import Material

EXACT = 1e-12  # relative: a few operations, and of a stack the last Newton step of its local problem
ROUNDING = 1e-14
DT = 0.1
THETAS = [1.0, 0.7, 0.5]
LMBDA, MU = 60.0, 40.0
K_N, K_T = LMBDA + 2 * MU, MU
E2 = np.array([0.0, 1.0, 0.0])


ELASTIC = LinearElastic(LMBDA, MU)
KELVIN = KelvinVoigt(LMBDA, MU, 0.3, 0.5)
MAXWELL, MAXWELL_2 = Maxwell(LMBDA, MU, 0.7), Maxwell(LMBDA, MU, 0.7, 1.5)
NORTON_15, NORTON_3 = Norton(LMBDA, MU, 5.0, 1.5), Norton(LMBDA, MU, 5.0, 3.0)
SOLID = StandardSolid(LMBDA, MU, 25.0, 0.4)
MISES = Mises(LMBDA, MU, 6.0)
STIFF = LinearElastic(20.0, 90.0)
STACKS = {
    "Maxwell, Norton 1.5": Stack((0.3, MAXWELL), (0.7, NORTON_15)),
    "Maxwell, Kelvin-Voigt": Stack((0.3, MAXWELL), (0.7, KELVIN)),
    "elastic, plastic": Stack((0.4, STIFF), (0.6, MISES)),
    "three": Stack((0.2, KELVIN), (0.5, MAXWELL_2), (0.3, NORTON_3)),
    "nested": Stack((0.5, Stack((0.4, MAXWELL), (0.6, SOLID))), (0.5, STIFF)),
    "user, Norton 1.5": Stack((0.6, Hardening(LMBDA, MU)), (0.4, NORTON_15)),
}
LAWS: dict[str, BulkLaw] = {
    "Kelvin-Voigt": KELVIN,
    "Maxwell": MAXWELL,
    "Maxwell t1 != t2": MAXWELL_2,
    "Norton 1.5": NORTON_15,
    "Norton 3": NORTON_3,
    "user": SOLID,
    "user, not quadratic": Hardening(LMBDA, MU),
    "point": MISES,
    "traction": Slipping(70.0, 30.0, 12.0, 90.0),
    **STACKS,
}
BALANCED = [name for name, law in LAWS.items() if not isinstance(law, TractionLaw)]  # those that declare an energy
QUADRATIC = [name for name in BALANCED if name not in ("user, not quadratic", "user, Norton 1.5")]


# ---------------------------------------------------------------- running a law over points
@cache
def material(law: BulkLaw) -> Material:
    return Material(MPI.COMM_SELF, law.of_strains())


@dataclass(frozen=True)
class Answer:
    stress: np.ndarray
    tangent: np.ndarray
    q: np.ndarray
    energies: np.ndarray
    failed: int

    @property
    def stored(self):
        return self.energies[:, 0]

    @property
    def dissipated(self):
        return self.energies[:, 1]

    @property
    def remainder(self):
        return self.energies[:, 2]


def respond(law, e, e_old, q, n, dt=DT, theta=1.0, slots=range(6)) -> Answer:
    return Answer(*material(law).update(slots, e, e_old, q, n, dt, theta))


@dataclass(frozen=True)
class Situation:
    """Points in the middle of a history: the step that is to come goes from e_old to e."""

    e: np.ndarray
    e_old: np.ndarray
    q: np.ndarray
    n: np.ndarray
    stored: np.ndarray

    def respond(self, law, theta, e=None) -> Answer:
        return respond(law, self.e if e is None else e, self.e_old, self.q, self.n, DT, theta)


def situation(law: BulkLaw, theta: float, points: int = 20, steps: int = 3) -> Situation:
    random = np.random.default_rng(7)
    n = random.normal(size=(points, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    e, q, stored = np.zeros((points, 6)), np.zeros((points, material(law).memory)), np.zeros(points)
    for _ in range(steps - 1):
        old, e = e, e + 0.1 * random.normal(size=e.shape)
        answer = respond(law, e, old, q, n, DT, theta)
        assert answer.failed == 0
        q, stored = answer.q, answer.stored
    return Situation(e + 0.1 * random.normal(size=e.shape), e, q, n, stored)


def tensor(a: np.ndarray) -> np.ndarray:
    """(..., 3, 3) of Mandel vectors (..., 6)."""
    out = np.empty((*a.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(MANDEL):
        out[..., i, j] = out[..., j, i] = a[..., k] / (1 if i == j else ROOT2)
    return out


def vector(a: np.ndarray) -> np.ndarray:
    """Mandel vectors (..., 6) of symmetric tensors (..., 3, 3)."""
    return np.stack([a[..., i, j] * (1 if i == j else ROOT2) for i, j in MANDEL], axis=-1)


def jump_strain(w: np.ndarray, n: np.ndarray) -> np.ndarray:
    outer = w[..., :, None] * n[..., None, :]
    return vector((outer + np.swapaxes(outer, -1, -2)) / 2)


def traction(stress: np.ndarray, n: np.ndarray) -> np.ndarray:
    return np.einsum("kij,kj->ki", tensor(stress), n)


def memory_blocks(law: BulkLaw) -> list[int]:
    """Sizes of what is remembered: 1 a number, 3 a vector, 6 a symmetric tensor."""
    if isinstance(law, Stack) and len(law.laws) > 1:
        return [3] * len(law.laws) + [size for one in law.laws for size in memory_blocks(one)]
    return [6] * (law.memory // 6) if isinstance(law, KernelLaw) else [SIZES[shape] for shape in law.internal.values()]


# ---------------------------------------------------------------- tangents, energies, rotations
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", LAWS)
def test_tangent_is_the_derivative_of_the_stress(name, theta):
    """Remainder of Taylor's expansion: second order, or rounding where the law is linear."""
    law = LAWS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    assert now.failed == 0
    direction = 0.1 * np.random.default_rng(1).normal(size=start.e.shape)
    left = []
    for h in (1e-2, 1e-3):
        moved = start.respond(law, theta, start.e + h * direction)
        left.append(np.abs(moved.stress - now.stress - h * np.einsum("kij,kj->ki", now.tangent, direction)).max())
    size = np.abs(now.stress).max()
    if law.traits.linear:
        assert max(left) < EXACT * size
    else:
        assert left[1] > 100 * ROUNDING * size  # it is the law's curvature that is seen
        assert np.log10(left[0] / left[1]) > 1.95
    if law.traits.symmetric:
        assert now.tangent == pytest.approx(np.swapaxes(now.tangent, 1, 2), abs=EXACT * np.abs(now.tangent).max())


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", BALANCED)
def test_energy_of_a_step_is_accounted_for(name, theta):
    """stress : (e - e_old) = stored + dissipated + remainder; remainder > 0, or zero for the midpoint rule."""
    law = LAWS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    work = np.sum(now.stress * (start.e - start.e_old), axis=1)
    size = np.max(np.abs([work, now.stored, start.stored, now.dissipated, now.remainder]), axis=0)
    assert (np.abs(work - (now.stored - start.stored) - now.dissipated - now.remainder) < EXACT * size).all()
    assert (now.stored > 0).all()
    assert (now.dissipated >= -ROUNDING * size).all()
    if name in QUADRATIC:
        assert now.dissipated.max() > 1e-3 * size.max()
        assert (now.remainder > 0).all() if theta > 0.5 else (np.abs(now.remainder) < EXACT * size).all()


@pytest.mark.parametrize(("theta", "share"), [(1.0, 1.0), (0.7, 0.4), (0.5, 0.0)])
def test_remainder_is_the_energy_of_the_increments(theta, share):
    """(2 theta - 1) times the elastic energy of what the springs have been strained by in the step."""
    for law, springs in ((KELVIN, ELASTIC), (NORTON_15, ELASTIC), (NORTON_3, ELASTIC)):
        start = situation(law, theta)
        increment = start.e - start.e_old
        zero = np.zeros_like(increment)
        energy = respond(springs, increment, zero, np.zeros((len(zero), 0)), start.n).stored
        assert start.respond(law, theta).remainder == pytest.approx(share * energy, rel=EXACT)
    for law in (MAXWELL, MAXWELL_2):  # the spring carries the stress: complementary energy of its increment
        start = situation(law, theta)
        now = start.respond(law, theta)
        change = tensor(now.q - start.q)
        mean = np.trace(change, axis1=1, axis2=2) / 3
        dev = change - mean[:, None, None] * np.eye(3)
        energy = np.einsum("kij,kij->k", dev, dev) / (4 * MU) + mean**2 / (2 * (LMBDA + 2 * MU / 3))
        assert now.remainder == pytest.approx(share * energy, rel=1e-10, abs=ROUNDING)


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", LAWS)
def test_no_direction_is_preferred(name, theta):
    """When strains, memory and director turn, so do stress, tangent and memory."""
    law = LAWS[name]
    start = situation(law, theta)
    turn, triangle = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    turn = turn * np.sign(np.diag(triangle))
    turn = turn * np.sign(np.linalg.det(turn))

    def turned(a):
        if a.shape[-1] == 6:
            return vector(turn @ tensor(a) @ turn.T)
        return a @ turn.T if a.shape[-1] == 3 else a

    def memory(q):
        parts = np.split(q, np.cumsum(memory_blocks(law))[:-1], axis=1) if q.shape[1] else []
        return np.concatenate([np.empty((len(q), 0)), *map(turned, parts)], axis=1)

    def close(found, expected):
        return found == pytest.approx(expected, abs=1e-11 * np.abs(expected).max(initial=1e-300))

    now = start.respond(law, theta)
    found = respond(law, turned(start.e), turned(start.e_old), memory(start.q), turned(start.n), DT, theta)
    assert close(found.stress, turned(now.stress))
    assert close(found.q, memory(now.q))
    assert close(found.energies, now.energies)
    assert close(found.tangent, np.swapaxes(turned(np.swapaxes(turned(now.tangent), 1, 2)), 1, 2))


@pytest.mark.parametrize("name", ["Maxwell t1 != t2", "Norton 1.5", "user", "point", "three"])
def test_two_dimensions_are_the_same_law(name):
    """Plane strain: three components of strain, the others zero; the stress out of the plane is still remembered."""
    law, plane = LAWS[name], [0, 1, 3]
    random = np.random.default_rng(2)
    e, n = np.zeros((8, 6)), np.zeros((8, 3))
    e[:, plane], n[:, :2] = 0.1 * random.normal(size=(8, 3)), random.normal(size=(8, 2))
    n /= np.linalg.norm(n, axis=1)[:, None]
    q = np.zeros((8, material(law).memory))
    whole = respond(law, e, 0 * e, q, n)
    part = respond(law, e[:, plane], 0 * e[:, plane], q, n, slots=plane)
    assert part.stress == pytest.approx(whole.stress[:, plane], rel=ROUNDING)
    assert part.tangent == pytest.approx(whole.tangent[:, plane][:, :, plane], rel=ROUNDING)
    assert part.q == pytest.approx(whole.q, rel=ROUNDING)
    assert part.energies == pytest.approx(whole.energies, rel=ROUNDING)


def test_a_point_law_yields_somewhere_and_not_everywhere():
    """The points of these tests see both branches."""
    for theta in THETAS:
        start = situation(MISES, theta)
        flow = np.abs(start.respond(MISES, theta).q - start.q).max(axis=1)
        assert 0 < np.count_nonzero(flow > 1e-3) < len(flow)


# ---------------------------------------------------------------- the paper's interface laws, and what it prints
@pytest.fixture(scope="module")
def jumps():
    """Jumps before and after a step, and normals."""
    random = np.random.default_rng(11)
    n = random.normal(size=(10, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    w_old = 0.1 * random.normal(size=n.shape)
    return w_old, w_old + 0.1 * random.normal(size=n.shape), n


def traction_of(law, jumps, theta=1.0, dt=DT):
    w_old, w, n = jumps
    q = np.zeros((len(n), material(law).memory))
    return traction(respond(law, jump_strain(w, n), jump_strain(w_old, n), q, n, dt, theta).stress, n)


@pytest.mark.parametrize("theta", THETAS)
def test_kelvin_voigt_traction(jumps, theta):
    """Eq. (17)."""
    w_old, w, n = jumps
    mid, rate = theta * w + (1 - theta) * w_old, (w - w_old) / DT
    expected = [limits.kelvin_voigt(LMBDA, MU, 0.3, 0.5, *one) for one in zip(mid, rate, n, strict=True)]
    assert traction_of(KELVIN, jumps, theta) == pytest.approx(np.array(expected), rel=EXACT)


@pytest.mark.parametrize("p", [1.1, 1.5, 2.0, 3.0, 4.5])
@pytest.mark.parametrize("theta", THETAS)
def test_norton_traction(jumps, theta, p):
    """Eq. (22) with the modulus of the symmetrised product, 1 and 1/2."""
    w_old, w, n = jumps
    mid, rate = theta * w + (1 - theta) * w_old, (w - w_old) / DT
    expected = [limits.norton(LMBDA, MU, 5.0, p, *one) for one in zip(mid, rate, n, strict=True)]
    assert traction_of(Norton(LMBDA, MU, 5.0, p), jumps, theta) == pytest.approx(np.array(expected), rel=EXACT)


@pytest.mark.parametrize("p", [1.5, 3.0])
def test_norton_as_printed_is_another_law(jumps, p):
    """Without the 1/2, or with the bars around the rate alone; both show only where the layer is sheared."""
    w_old, w, n = jumps
    v = (w - w_old) / DT
    v_N = np.einsum("ki,ki->k", v, n)[:, None] * n
    v_T = v - v_N
    modulus = np.sqrt(np.sum(v_N**2, axis=1) + np.sum(v_T**2, axis=1) / 2)[:, None]
    viscous = traction_of(Norton(LMBDA, MU, 5.0, p), jumps) - traction_of(ELASTIC, jumps)
    without_half = 5.0 * modulus ** (p - 2) * (v_N + v_T)
    bars_around_rate = 5.0 * np.linalg.norm(v, axis=1)[:, None] ** (p - 2) * (v_N + v_T / 2)
    right = 5.0 * modulus ** (p - 2) * (v_N + v_T / 2)
    size = np.linalg.norm(right)
    assert np.linalg.norm(viscous - right) < EXACT * size
    assert np.linalg.norm(viscous - without_half) > 0.2 * size
    assert np.linalg.norm(viscous - bars_around_rate) > 0.1 * size


def test_norton_of_exponent_two_is_a_linear_dashpot(jumps):
    """p = 2: K_th = eta (I + n n)/2, a Kelvin-Voigt law without viscosity of volume."""
    w_old, w, n = jumps
    norton, kelvin = Norton(LMBDA, MU, 5.0, 2.0), KelvinVoigt(LMBDA, MU, 0.0, 5.0 / (2 * MU))
    assert traction_of(norton, jumps) == pytest.approx(traction_of(kelvin, jumps), rel=EXACT)
    v = (w - w_old) / DT
    dashpot = 5.0 / 2 * (v + np.einsum("ki,ki->k", v, n)[:, None] * n)
    assert traction_of(norton, jumps) - traction_of(ELASTIC, jumps) == pytest.approx(dashpot, rel=1e-10)


def test_norton_of_exponent_one_is_a_threshold():
    """p -> 1: a stress of modulus eta along the rate, however fast; a 1000th above 1, within (10^3)^(p - 1) = 0.7 %."""
    law = Norton(LMBDA, MU, 5.0, 1.001)
    direction = np.random.default_rng(4).normal(size=6)
    direction /= np.linalg.norm(direction)
    rates = np.logspace(-3, 3, 7)[:, None] * direction
    q, n = np.zeros((7, 0)), np.tile(E2, (7, 1))
    viscous = respond(law, rates * DT, 0 * rates, q, n).stress - respond(ELASTIC, rates * DT, 0 * rates, q, n).stress
    assert viscous == pytest.approx(np.tile(5.0 * direction, (7, 1)), rel=8e-3)
    tangent = respond(law, rates * DT, 0 * rates, q, n).tangent
    assert (np.diff(tangent[:, 3, 3]) < 0).all()  # the faster, the softer: it is almost rigid near rest


def test_maxwell_answers_at_once_with_the_elastic_stiffness(jumps):
    """Sudden load: the coefficients of Eq. (19) corrected. The printed ones are 2 mu and a negative normal stiffness."""
    _, w, n = jumps
    sudden = (0 * w, w, n)
    for law in (MAXWELL, MAXWELL_2):
        assert traction_of(law, sudden, dt=0.0) == pytest.approx(traction_of(ELASTIC, sudden), rel=EXACT)
    nu = LMBDA / (2 * (LMBDA + MU))
    E = 2 * MU * (1 + nu)
    printed_T, printed_N = E / (1 + nu), -E * nu / (1 - nu)
    t = traction_of(MAXWELL, (0 * w, w, n), dt=0.0)
    t_N, w_N = np.einsum("ki,ki->k", t, n), np.einsum("ki,ki->k", w, n)
    stiffness_N = t_N / w_N
    stiffness_T = np.linalg.norm(t - t_N[:, None] * n, axis=1) / np.linalg.norm(w - w_N[:, None] * n, axis=1)
    assert stiffness_N == pytest.approx(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), rel=EXACT)
    assert stiffness_T == pytest.approx(E / (2 * (1 + nu)), rel=EXACT)
    assert (np.abs(stiffness_N - printed_N) > K_N).all()
    assert (np.abs(stiffness_T - printed_T) > 0.9 * K_T).all()


@pytest.mark.parametrize("theta", [1.0, 0.7, 0.5])
def test_maxwell_rate_form(jumps, theta):
    """t1 = t2: (t - t_old)/dt + t_mid/t1 = K_L d[u]/dt, the end value of t being what is remembered."""
    w_old, w, n = jumps
    q = np.zeros((len(n), 6))
    first = respond(MAXWELL, jump_strain(w_old, n), np.zeros((len(n), 6)), q, n, 0.0, 1.0)
    then = respond(MAXWELL, jump_strain(w, n), jump_strain(w_old, n), first.q, n, DT, theta)
    t_old, t_mid, t = (traction(s, n) for s in (first.q, then.stress, then.q))
    elastic = np.array([limits.elastic(LMBDA, MU, *one) for one in zip(w - w_old, n, strict=True)])
    assert (t - t_old) / DT + t_mid / 0.7 == pytest.approx(elastic / DT, rel=1e-11)


def test_maxwell_with_two_times_is_no_equation_of_first_order():
    """The best single exponential misses the relaxation of the normal traction; two relaxing parts do not."""
    t = np.linspace(0.0, 3.0, 301)
    w = np.zeros((1, 3)) + 0.02 * E2
    n, e = E2[None], jump_strain(w, E2[None])
    answer = respond(MAXWELL_2, e, 0 * e, np.zeros((1, 6)), n, 0.0, 1.0)
    found = [answer.q[0, 1]]
    for dt in np.diff(t):
        answer = respond(MAXWELL_2, e, e, answer.q, n, dt, 0.5)
        found.append(answer.q[0, 1])
    expected = limits.maxwell_normal_relaxation(LMBDA, MU, 0.7, 1.5, 0.02, t)
    assert found == pytest.approx(expected, rel=1e-3)

    def worst(rate):
        return np.abs(K_N * 0.02 * np.exp(-rate * t) / expected - 1).max()

    assert minimize_scalar(worst, bounds=(0.5, 5.0), method="bounded").fun > 0.1
    shear = jump_strain(np.array([[0.02, 0.0, 0.0]]), n)
    held = respond(MAXWELL_2, shear, shear, vector(2 * MU * tensor(shear)), n, DT, 1.0)
    assert held.stress == pytest.approx(2 * MU * shear / (1 + DT / 0.7), rel=EXACT)  # shear: t1 alone


def test_volumetric_rate_at_the_bound_of_t2():
    """t2 = 3 nu t1/(1 + nu): the mean stress does not relax."""
    nu = LMBDA / (2 * (LMBDA + MU))
    t2 = 3 * nu * 0.7 / (1 + nu)
    assert limits.volumetric_rate(LMBDA, MU, 0.7, t2) == pytest.approx(0.0, abs=ROUNDING)
    assert limits.volumetric_rate(LMBDA, MU, 0.7, 0.7) == pytest.approx(1 / 0.7, rel=EXACT)
    law = Maxwell(LMBDA, MU, 0.7, t2 * (1 + 1e-12))
    e = vector(0.01 * np.eye(3)[None])
    q = np.zeros((1, 6))
    first = respond(law, e, 0 * e, q, E2[None], 0.0)
    assert respond(law, e, e, first.q, E2[None], 10.0).stress == pytest.approx(first.stress, rel=1e-9, abs=1e-14)


def test_traction_law_is_the_traction(jumps):
    """Its stress has the traction on n, and does its work in the strain of every jump."""
    w_old, w, n = jumps
    law = LAWS["traction"]
    e, old = jump_strain(w, n), jump_strain(w_old, n)
    q = 0.01 * np.random.default_rng(8).normal(size=(len(n), 4))
    slip = q[:, :3] = q[:, :3] - np.einsum("ki,ki->k", q[:, :3], n)[:, None] * n
    answer = respond(law, e, old, q, n, DT, 1.0)
    t, w_N = traction(answer.stress, n), np.einsum("ki,ki->k", w, n)[:, None]
    x = DT * law.k_T / law.viscosity
    new_slip = (slip + x * (w - w_N * n)) / (1 + x)
    assert t == pytest.approx((law.k_N * w_N - law.closed * w_N**2) * n + law.k_T * (w - w_N * n - new_slip), rel=EXACT)
    assert answer.q[:, :3] == pytest.approx(new_slip, rel=EXACT)
    assert answer.q[:, 3] - q[:, 3] == pytest.approx(np.sum((w - w_old) ** 2, axis=1), rel=EXACT)
    v = np.random.default_rng(9).normal(size=w.shape)
    assert np.sum(answer.stress * jump_strain(v, n), axis=1) == pytest.approx(np.sum(t * v, axis=1), rel=1e-11)


# ---------------------------------------------------------------- closed forms in time
def follow(law, direction, load, *, end, steps, theta, compliance=None):
    """Jumps along a direction under a traction held from t = 0, or of an end of a body (compliance) moved and held.

    Laws with a rate start at rest, with two steps of backward Euler instead of one of any other; the others at once.
    """
    n, a = E2[None], np.asarray(direction, float)
    q, x = np.zeros((1, material(law).memory)), 0.0
    lengths = [(end / steps, theta)] * steps
    if not law.traits.rate:
        lengths = [(0.0, 1.0), *lengths]
    elif theta < 1:
        lengths = [(end / steps / 2, 1.0)] * 2 + lengths[1:]
    strain = lambda x: jump_strain(x * a[None], n)
    one = strain(1.0)[0]
    for dt, th in lengths:
        new = x
        for _ in range(100):
            answer = respond(law, strain(new), strain(x), q, n, dt, th)
            wanted, softer = load, 0.0
            if compliance:
                wanted, softer = (load - th * new - (1 - th) * x) / compliance, th / compliance
            step = (wanted - answer.stress[0] @ one) / (one @ answer.tangent[0] @ one + softer)
            new += step
            if abs(step) < 1e-13 * abs(new):
                break
        answer = respond(law, strain(new), strain(x), q, n, dt, th)
        assert answer.failed == 0
        q, x = answer.q, new
    return x


NORMAL, SHEAR = (0, 1, 0), (1, 0, 0)
C_N, C_T = 0.2 / 26.923076923076923, 0.026  # of two bodies 0.5 high with E = 100, nu = 0.3, roller sides
G_N, G_T = LMBDA * 0.3 + 2 * MU * 0.5, MU * 0.5
SERIES = Stack((0.3, MAXWELL), (0.5, KELVIN), (0.2, ELASTIC))


def series_creep(load, K, G):
    def at(t):
        parts = [limits.maxwell_creep(load, K, 0.7, t), limits.kelvin_voigt_creep(load, K, G, t), load / K]
        return limits.stack_creep(SERIES.fractions, parts)

    return at


CLOSED = {  # law, direction, load, end, compliance, jump(t)
    "Kelvin-Voigt creep N": (KELVIN, NORMAL, 1.0, 1.0, None, lambda t: limits.kelvin_voigt_creep(1.0, K_N, G_N, t)),
    "Kelvin-Voigt creep T": (KELVIN, SHEAR, 0.5, 1.0, None, lambda t: limits.kelvin_voigt_creep(0.5, K_T, G_T, t)),
    "Kelvin-Voigt moved N": (
        KELVIN, NORMAL, 0.02, 0.5, C_N, lambda t: limits.kelvin_voigt_displaced(0.02, K_N, G_N, C_N, t)
    ),
    "Kelvin-Voigt moved T": (
        KELVIN, SHEAR, 0.05, 0.5, C_T, lambda t: limits.kelvin_voigt_displaced(0.05, K_T, G_T, C_T, t)
    ),
    "Maxwell creep N": (MAXWELL, NORMAL, 1.0, 1.0, None, lambda t: limits.maxwell_creep(1.0, K_N, 0.7, t)),
    "Maxwell creep T": (MAXWELL, SHEAR, 0.5, 1.0, None, lambda t: limits.maxwell_creep(0.5, K_T, 0.7, t)),
    "Maxwell moved N": (
        MAXWELL, NORMAL, 0.02, 1.0, C_N, lambda t: 0.02 - C_N * limits.maxwell_relaxation(0.02, K_N, C_N, 0.7, t)
    ),
    "Maxwell moved T": (
        MAXWELL, SHEAR, 0.05, 1.0, C_T, lambda t: 0.05 - C_T * limits.maxwell_relaxation(0.05, K_T, C_T, 0.7, t)
    ),
    "Maxwell t1 != t2 creep N": (
        MAXWELL_2, NORMAL, 1.0, 1.0, None, lambda t: limits.maxwell_normal_creep(LMBDA, MU, 0.7, 1.5, 1.0, t)
    ),
    "Maxwell t1 != t2 moved T": (
        MAXWELL_2, SHEAR, 0.05, 1.0, C_T, lambda t: 0.05 - C_T * limits.maxwell_relaxation(0.05, K_T, C_T, 0.7, t)
    ),
    "Norton 1.5 creep N": (
        NORTON_15, NORMAL, 1.0, 0.5, None, lambda t: limits.norton_creep(1.0, K_N, 5.0, 1.5, t, shear=False)
    ),
    "Norton 1.5 creep T": (
        NORTON_15, SHEAR, 0.5, 0.5, None, lambda t: limits.norton_creep(0.5, K_T, 5.0, 1.5, t, shear=True)
    ),
    "Norton 3 creep N": (
        NORTON_3, NORMAL, 1.0, 0.02, None, lambda t: limits.norton_creep(1.0, K_N, 5.0, 3.0, t, shear=False)
    ),
    "Norton 3 creep T": (
        NORTON_3, SHEAR, 0.5, 0.02, None, lambda t: limits.norton_creep(0.5, K_T, 5.0, 3.0, t, shear=True)
    ),
    "stack creep N": (SERIES, NORMAL, 1.0, 1.0, None, series_creep(1.0, K_N, G_N)),
    "stack creep T": (SERIES, SHEAR, 0.5, 1.0, None, series_creep(0.5, K_T, G_T)),
}  # fmt: skip


@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
@pytest.mark.parametrize("name", CLOSED)
def test_order_in_time(name, theta, order):
    """Backward Euler is of order 1, the midpoint rule of order 2; a Maxwell layer under constant traction is exact."""
    law, direction, load, end, compliance, closed = CLOSED[name]
    expected = float(closed(end))
    found = [
        follow(law, direction, load, end=end, steps=steps, theta=theta, compliance=compliance)
        for steps in (20, 40, 80, 160)
    ]
    errors = np.abs(np.array(found) / expected - 1)
    assert errors[-1] < (2e-2 if order == 1 else 2e-4)
    if name in ("Maxwell creep N", "Maxwell creep T"):
        assert errors.max() < 1e-11
    else:
        assert [np.log2(a / b) for a, b in pairwise(errors)][-1] == pytest.approx(order, abs=0.06)


def test_norton_above_two_comes_to_rest_in_finite_time():
    """p = 3: the end of the closed form is the elastic jump, reached and kept."""
    stop = 2 * (0.5 * 5.0 * 2**-1.5) ** 0.5 / K_T
    assert limits.norton_creep(0.5, K_T, 5.0, 3.0, 0.999 * stop, shear=True) < 0.5 / K_T
    assert limits.norton_creep(0.5, K_T, 5.0, 3.0, 1.001 * stop, shear=True) == pytest.approx(0.5 / K_T, rel=EXACT)
    assert follow(NORTON_3, SHEAR, 0.5, end=2 * stop, steps=200, theta=1.0) == pytest.approx(0.5 / K_T, rel=1e-3)


def test_closed_forms_have_the_reference_numbers():
    """Values of the closed forms at t = 1, evaluated with independent code."""
    numbers = {
        "Kelvin-Voigt creep N": 0.00650374813452,
        "Kelvin-Voigt creep T": 0.0108083089595,
        "Maxwell moved N": 0.02 - C_N * 0.681396777691,
        "Maxwell moved T": 0.05 - C_T * 0.486711984065,
        "Norton 1.5 creep T": 0.00866886620207,
    }
    for name, number in numbers.items():
        assert CLOSED[name][-1](1.0) == pytest.approx(number, rel=1e-11), name


# ---------------------------------------------------------------- sublayers in series
@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell t1 != t2", "Norton 1.5", "Norton 3", "user", "point"])
def test_sublayers_of_one_law_are_that_law(name, theta):
    law = LAWS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    alone = situation(Stack((1.0, law)), theta).respond(Stack((1.0, law)), theta)
    assert np.array_equal(alone.stress, now.stress)
    assert np.array_equal(alone.tangent, now.tangent)
    for fractions in ((0.5, 0.5), (0.1, 0.7, 0.2)):
        stack = Stack(*((a, law) for a in fractions))
        again = situation(stack, theta)
        found = again.respond(stack, theta)
        scale = np.abs(now.stress).max()
        assert found.stress == pytest.approx(now.stress, abs=EXACT * scale)
        assert found.tangent == pytest.approx(now.tangent, abs=1e-11 * np.abs(now.tangent).max())
        assert found.energies == pytest.approx(now.energies, abs=EXACT * np.abs(now.energies).max())
        assert np.abs(found.q[:, : 3 * len(fractions)]).max() < 1e-13


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", STACKS)
def test_order_of_sublayers_does_not_matter(name, theta):
    law = STACKS[name]
    turned = Stack(*reversed(law.sublayers))
    one, other = (situation(stack, theta).respond(stack, theta) for stack in (law, turned))
    assert other.stress == pytest.approx(one.stress, abs=1e-11 * np.abs(one.stress).max())
    assert other.tangent == pytest.approx(one.tangent, abs=1e-10 * np.abs(one.tangent).max())
    assert other.energies == pytest.approx(one.energies, abs=1e-11 * np.abs(one.energies).max())


@pytest.mark.parametrize("theta", [1.0, 0.5])
@pytest.mark.parametrize("name", STACKS)
def test_sublayers_share_traction_and_add_up_jumps(name, theta):
    """Each law run by itself with its share of the jump: equal tractions; shares cancel; stresses and energies average."""
    law = STACKS[name]
    start = situation(law, theta)
    now = start.respond(law, theta)
    count, at = len(law.laws), 3 * len(law.laws)
    shares = [q[:, 3 * i : 3 * i + 3] for q in (start.q, now.q) for i in range(count)]
    old, new = shares[:count], shares[count:]
    assert sum(a * g for a, g in zip(law.fractions, new, strict=True)) == pytest.approx(0.0, abs=EXACT)
    mean, energies, tractions = 0.0, 0.0, []
    for (a, one), g_old, g in zip(law.sublayers, old, new, strict=True):
        memory = material(one).memory
        e, e_old = start.e + jump_strain(g, start.n), start.e_old + jump_strain(g_old, start.n)
        part = respond(one, e, e_old, start.q[:, at : at + memory], start.n, DT, theta)
        assert now.q[:, at : at + memory] == pytest.approx(part.q, abs=1e-12)
        mean, energies = mean + a * part.stress, energies + a * part.energies
        tractions.append(traction(part.stress, start.n))
        at += memory
    size = np.abs(now.stress).max()
    for t in tractions[1:]:
        assert t == pytest.approx(tractions[0], abs=1e-11 * size)
    assert now.stress == pytest.approx(mean, abs=1e-11 * size)
    assert now.energies == pytest.approx(energies, abs=1e-11 * np.abs(energies).max())


def test_nested_stacks_are_taken_apart():
    nested = STACKS["nested"]
    assert nested.fractions == pytest.approx((0.2, 0.3, 0.5))
    assert nested.laws == (MAXWELL, SOLID, STIFF)
    flat = Stack((0.2, MAXWELL), (0.3, SOLID), (0.5, STIFF))
    one, other = (situation(stack, 0.7).respond(stack, 0.7) for stack in (nested, flat))
    assert other.stress == pytest.approx(one.stress, rel=1e-10, abs=1e-12)


def test_elastic_sublayers_have_the_harmonic_means(jumps):
    """Compliances add: 1/mu and 1/(lmbda + 2 mu); not lmbda, and not the sums that Eq. (52) calls stiffnesses."""
    _, w, n = jumps
    soft = LinearElastic.young(12.0, 0.42)
    law = Stack((0.3, STIFF), (0.45, soft), (0.25, ELASTIC))
    found = traction_of(law, (0 * w, w, n), dt=0.0)
    for t, one, normal in zip(found, w, n, strict=True):
        stiffnesses = [limits.elastic_stiffness(part.lmbda, part.mu, normal) for part in law.laws]
        assert t == pytest.approx(limits.stratified(law.fractions, stiffnesses) @ one, rel=1e-11)
    mean = lambda values: 1 / sum(a / value for a, value in zip(law.fractions, values, strict=True))
    mu, lmbda = (mean([getattr(part, name) for part in law.laws]) for name in ("mu", "lmbda"))
    normal = traction_of(law, (np.zeros((1, 3)), E2[None], E2[None]), dt=0.0)[0, 1]
    assert normal == pytest.approx(mean([part.lmbda + 2 * part.mu for part in law.laws]), rel=EXACT)
    assert abs(normal / (lmbda + 2 * mu) - 1) > 0.02
    sheared = traction_of(law, (np.zeros((1, 3)), np.array([[1.0, 0, 0]]), E2[None]), dt=0.0)[0, 0]
    assert sheared == pytest.approx(mu, rel=EXACT)
    arithmetic = sum(a * part.mu for a, part in law.sublayers)
    assert abs(sheared / arithmetic - 1) > 0.2


def test_elastic_sublayer_over_a_plastic_one_carries_its_limit():
    """The common traction is bounded by the plastic sublayer, the jump goes on in it."""
    law = STACKS["elastic, plastic"]
    t_T = MISES.limit / ROOT2  # |dev stress| = sqrt 2 t_T in shear
    e, q, found = np.zeros((1, 6)), np.zeros((1, material(law).memory)), []
    for w in np.linspace(0.0, 1.0, 21)[1:]:
        old, e = e, jump_strain(np.array([[w, 0, 0]]), E2[None])
        answer = respond(law, e, old, q, E2[None])
        q = answer.q
        found.append(traction(answer.stress, E2[None])[0, 0])
    K = 1 / (0.4 / STIFF.mu + 0.6 / MISES.mu)
    expected = np.minimum(K * np.linspace(0.0, 1.0, 21)[1:], t_T)
    assert found == pytest.approx(expected, rel=1e-9)
    assert q[0, 0] == pytest.approx(t_T / STIFF.mu - 1.0, rel=1e-9)  # share of the elastic sublayer beyond the jump


@pytest.mark.parametrize(
    "laws",
    [
        (MAXWELL, NORTON_15),
        (MAXWELL, Norton(LMBDA, MU, 5.0, 1.2)),
        (NORTON_3, NORTON_15),
        (STIFF, MISES),
        (LinearElastic(6e4, 4e4), LinearElastic(0.6, 0.4)),
        (KELVIN, MAXWELL, NORTON_15, NORTON_3, MISES),
    ],
    ids=lambda laws: ", ".join(f"{type(one).__name__} {getattr(one, 'p', '')}".strip() for one in laws),
)
def test_a_stack_finds_its_shares_for_steps_of_any_size(laws):
    """Jumps and steps over powers of ten: dashpots that are almost rigid, sublayers far beyond yield.

    Where it says that it has found them, the tractions are equal: the work of the step is the sublayers' energies, to
    1e-3 (a dashpot with p = 1.2 that hardly moves magnifies the rounding of its strain by 1e10).
    """
    law = Stack(*((1 / len(laws), one) for one in laws))
    random, failed, wrong = np.random.default_rng(0), {}, {}
    for size in (1e-6, 1e-4, 1e-2, 1.0):
        for dt in (1e-3, 1e-1, 10.0):
            n = random.normal(size=(20, 3))
            n /= np.linalg.norm(n, axis=1)[:, None]
            e, q, stored = np.zeros((20, 6)), np.zeros((20, material(law).memory)), np.zeros(20)
            for _ in range(3):
                old, e = e, e + size * jump_strain(random.normal(size=n.shape), n)
                answer = respond(law, e, old, q, n, dt)
                if answer.failed:
                    failed[size, dt] = answer.failed
                    break
                work = np.sum(answer.stress * (e - old), axis=1)
                left = work - (answer.stored - stored) - answer.dissipated - answer.remainder
                scale = np.max(np.abs([answer.stored, answer.dissipated, answer.remainder, stored]), axis=0)
                if (np.abs(left) > 1e-3 * scale).any():
                    wrong[size, dt] = np.abs(left / scale).max()
                q, stored = answer.q, answer.stored
    assert (failed, wrong) == ({}, {})


# ---------------------------------------------------------------- points that fail
def test_failed_points_are_counted_and_have_no_stress():
    law = Fragile(LMBDA, MU, 1.0)
    e = np.zeros((5, 6))
    e[:, 0] = [0.1, 0.7, 0.2, 0.9, 0.3]
    answer = respond(law, e, 0 * e, np.zeros((5, 6)), np.tile(E2, (5, 1)))
    assert answer.failed == 2
    assert np.isnan(answer.stress[:, 0]).tolist() == [False, True, False, True, False]
    assert answer.stress[[0, 2, 4]] == pytest.approx(MU * e[[0, 2, 4]])


def test_failed_points_of_a_stack():
    law = Stack((0.5, ELASTIC), (0.5, Fragile(LMBDA, MU, 1.0)))
    e = np.zeros((3, 6))
    e[:, 0] = [0.1, 0.7, 0.2]
    answer = respond(law, e, 0 * e, np.zeros((3, material(law).memory)), np.tile(E2, (3, 1)))
    assert answer.failed == 1
    assert np.isnan(answer.stress[:, 0]).tolist() == [False, True, False]


def test_laws_with_a_rate_have_no_answer_to_a_sudden_load():
    e, n = jump_strain(np.array([[0.1, 0.2, 0.0]]), E2[None]), E2[None]
    for law in (KELVIN, NORTON_15):
        assert respond(law, e, 0 * e, np.zeros((1, 0)), n, dt=0.0).failed == 1


def test_norton_starts_from_rest():
    """p < 2 at a rate of zero: no stress, a finite tangent that is the largest there is."""
    e, n = np.zeros((1, 6)), E2[None]
    rest = respond(NORTON_15, e, e, np.zeros((1, 0)), n)
    assert rest.failed == 0
    assert not rest.stress.any()
    moved = respond(NORTON_15, e + 1e-3, e, np.zeros((1, 0)), n)
    assert rest.tangent[0, 3, 3] > 1e3 * moved.tangent[0, 3, 3]


# ---------------------------------------------------------------- bad parameters and laws
POINT = "laws that give a stress for a strain"


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: KelvinVoigt(LMBDA, MU, 0.3, 0.0), "KelvinVoigt: theta_mu is 0.0; allowed: > 0"),
        (lambda: KelvinVoigt(LMBDA, MU, 0.3, -1.0), "theta_mu is -1.0"),
        (lambda: KelvinVoigt(LMBDA, MU, -1.0, 0.5), r"theta_lmbda is -1.0; allowed: lmbda theta_lmbda \+ 2 mu theta_mu/3"),
        (lambda: KelvinVoigt(LMBDA, MU, float("nan"), 0.5), "theta_lmbda is nan"),
        (lambda: KelvinVoigt(LMBDA, 0.0, 0.3, 0.5), "mu is 0.0; allowed: > 0"),
        (lambda: KelvinVoigt(-30.0, MU, 0.3, 0.5), "lmbda is -30.0; allowed: > -2 mu/3"),
        (lambda: KelvinVoigt(lmbda=1.0, mu=1.0, theta=0.1), "no parameter 'theta'; known: lmbda, mu, theta_lmbda"),
        (lambda: Maxwell(LMBDA, MU, 0.0), "Maxwell: t1 is 0.0; allowed: > 0"),
        (lambda: Maxwell(LMBDA, MU, float("inf")), "t1 is inf"),
        (lambda: Maxwell(LMBDA, MU, 1.0, 0.69), r"t2 is 0.69; allowed: > 0 and >= 3 nu t1/\(1 \+ nu\) = 0.692308"),
        (lambda: Maxwell(-20.0, MU, 1.0, -0.1), "t2 is -0.1; allowed: > 0"),
        (lambda: Maxwell(LMBDA, -1.0, 1.0), "mu is -1.0"),
        (lambda: Norton(LMBDA, MU, 5.0, 1.0), "Norton: p is 1.0; allowed: > 1"),
        (lambda: Norton(LMBDA, MU, 5.0, 0.5), "p is 0.5"),
        (lambda: Norton(LMBDA, MU, 5.0, float("nan")), "p is nan"),
        (lambda: Norton(LMBDA, MU, 0.0, 1.5), "eta is 0.0; allowed: > 0"),
        (lambda: Norton(LMBDA, MU, 5.0, 1.5, -1e-3), "rest is -0.001; allowed: >= 0"),
        (lambda: Incompressible(0.0), "Incompressible: mu is 0.0; allowed: > 0"),
        (lambda: Stack((0.5, MAXWELL), (0.4, KELVIN)), "sum of the fractions is 0.9; allowed: 1"),
        (lambda: Stack((0.0, MAXWELL), (1.0, KELVIN)), "each > 0"),
        (lambda: Stack((float("nan"), MAXWELL)), "each > 0"),
        (lambda: Stack(MAXWELL), r"Stack needs pairs \(fraction, law\)"),
        (lambda: Stack([(1.0, MAXWELL)]), r"Stack needs pairs \(fraction, law\)"),
        (lambda: Stack((0.5, MAXWELL, KELVIN)), r"Stack needs pairs \(fraction, law\)"),
        (lambda: Stack(("all", MAXWELL)), r"Stack needs pairs \(fraction, law\)"),
        (lambda: Stack((1.0, "glue")), f"a sublayer is glue; allowed: {POINT}"),
        (lambda: Stack((0.5, MAXWELL), (0.5, Incompressible(1.0))), r"a sublayer is Incompressible\(mu=1.0\); allowed"),
        (lambda: Stack((1.0, Incompressible(1.0))), f"allowed: {POINT}"),
        (lambda: Stack((0.5, MAXWELL), (0.5, LAWS["traction"])), rf"a sublayer is Slipping\(.*; allowed: {POINT}"),
        (lambda: KELVIN.plane_stress(), "plane stress is not defined for KelvinVoigt; use plane='strain'"),
        (lambda: MAXWELL.plane_stress(), "plane stress is not defined for Maxwell"),
        (lambda: NORTON_3.plane_stress(), "plane stress is not defined for Norton"),
        (lambda: Incompressible(1.0).plane_stress(), "plane stress is not defined for Incompressible"),
        (lambda: SERIES.plane_stress(), "plane stress is not defined for Maxwell"),
        (lambda: SOLID.plane_stress(), "plane stress is not defined for StandardSolid"),
        (lambda: MISES.plane_stress(), "plane stress is not defined for Mises"),
    ],
)  # fmt: skip
def test_what_a_law_refuses(build, message):
    with pytest.raises(LawError, match=message):
        build()


def test_jumps_know_no_plane():
    law = LAWS["traction"]
    assert real_law(law, "stress").parameters() == law.parameters()


def test_a_traction_law_has_no_powers_of_eps():
    @dataclass(frozen=True)
    class Scaled(TractionLaw):
        k: float
        powers: ClassVar = {"k": 1}

    with pytest.raises(LawError, match="Scaled: a traction law has no powers of eps"):
        Scaled(1.0)


@dataclass(frozen=True)
class Remembering(BulkLaw):
    """A law in order, to be spoiled."""

    mu: float
    internal: ClassVar = {"old": (3, 3)}

    def stress(self, step):
        return 2 * self.mu * step.e

    def advance(self, step):
        return {"old": step.e}


def spoiled(**changes) -> type[BulkLaw]:
    return type("Spoiled", (Remembering,), changes)


@dataclass(frozen=True)
class PlaneTraction(TractionLaw):
    k: float

    def traction(self, step: JumpStep):
        return self.k * ufl.as_vector([step.w[0], step.w[1]])


def in_plane(a):
    return ufl.as_tensor([[a[i, j] for j in range(2)] for i in range(2)])


SPOILED = {
    "stress (2, 2)": spoiled(stress=lambda self, step: in_plane(step.e)),
    "stress (4, 4)": spoiled(stress=lambda self, step: ufl.Identity(4)),
    "stress (3,)": spoiled(stress=lambda self, step: ufl.dot(step.e, step.n)),
    "stress ()": spoiled(stress=lambda self, step: ufl.tr(step.e)),
    "stress a number": spoiled(stress=lambda self, step: 0.0),
    "stress None": spoiled(stress=lambda self, step: None),
    "other name": spoiled(advance=lambda self, step: {"new": step.e}),
    "name missing": spoiled(advance=lambda self, step: {}),
    "advance None": spoiled(advance=lambda self, step: None),
    "() for (3, 3)": spoiled(advance=lambda self, step: {"old": ufl.tr(step.e)}),
    "(2, 2) for (3, 3)": spoiled(advance=lambda self, step: {"old": in_plane(step.e)}),
    "(3, 3) for ()": spoiled(internal={"old": ()}),
    "(3, 3) for (3,)": spoiled(internal={"old": (3,)}),
    "declared (2,)": spoiled(internal={"old": (2,)}),
    "traction (2,)": PlaneTraction,
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_law_that_gives_something_else_than_it_must(name):
    """The message names the law."""
    kind = SPOILED[name]
    with pytest.raises(LawError, match=kind.__name__):
        Material(MPI.COMM_SELF, kind(1.0).of_strains())


def test_the_law_in_order_is_accepted():
    e = np.arange(6.0)[None]
    assert respond(Remembering(2.0), e, 0 * e, np.zeros((1, 6)), E2[None]).stress == pytest.approx(4 * e)


def test_a_rate_that_is_not_declared():
    """Step.rate outside a march: a law must declare rate = True."""
    with pytest.raises(LawError, match="rate = True"):
        KELVIN.stress(Step(ufl.Identity(3), e_old=ufl.Identity(3)))


# ---------------------------------------------------------------- declarations and kernels
def declared(body: str, decorated: bool = True):
    """A law's class from source."""
    names = {"BulkLaw": BulkLaw, "KernelLaw": KernelLaw, "dataclass": dataclass, "np": np}
    decorator = "@dataclass(frozen=True)\n" if decorated else ""
    exec(f"{decorator}class Mine(BulkLaw):\n    k: float = 30.0\n" + body, names)
    return names["Mine"]


@pytest.mark.parametrize(
    ("body", "decorated", "message"),
    [
        ('    powers = {"K": 1}\n', True, "powers has 'K'; parameters: k"),
        ('    powers = {"k": float("nan")}\n', True, "power of k is nan"),
        ('    powers = ["k"]\n', True, r"powers is \{parameter: power\}"),
        ('    internal = ["a"]\n', True, r"internal is \{name: shape\}"),
        ('    powers = {"k": 1}\n', False, r"no dataclass: write @dataclass\(frozen=True\)"),
    ],
)
def test_what_a_class_declares_fits_its_parameters(body, decorated, message):
    with pytest.raises(LawError, match=message):
        declared(body, decorated)()


@pytest.mark.parametrize("value", [None, "1", [1.0, 2.0], np.ones(3)])
def test_parameters_are_numbers(value):
    for build in (
        lambda: Norton(1.0, 1.0, value, 1.5),
        lambda: LinearElastic(1.0, value),
        lambda: LinearElastic.young(value, 0.3),
        lambda: ELASTIC.per_thickness(value),
    ):
        with pytest.raises(LawError, match=r"allowed|must be > 0"):
            build()


def spoiled_kernel(body: str, memory: object = 0):
    names: dict = {"np": np}
    arguments = "e, e_old, q, dt, theta, n, parameters, stress, tangent, q_new, energies"
    exec(f"def kernel({arguments}):\n" + body, names)
    return dataclass(frozen=True)(
        type("Spoiled", (KernelLaw,), {"kernel": staticmethod(names["kernel"]), "memory": memory})
    )


@pytest.mark.parametrize(
    ("body", "memory", "message"),
    [
        ("    q_new[3] = 1.0\n    return True\n", 0, "IndexError"),
        ("    stress[0] = nonsense\n    return True\n", 0, "NameError"),
        ("    stress[0] = 1.0\n", 0, "returns None"),
        ("    return True\n", "6", "memory is '6'; allowed: a whole number"),
    ],
)
def test_mistakes_in_kernels_are_found_before_they_are_compiled(body, memory, message):
    with pytest.raises(LawError, match=message):
        material(spoiled_kernel(body, memory)())


def test_errors_in_a_compiled_kernel_are_failed_points():
    law = spoiled_kernel(
        "    stress[0] = parameters.sum() + e[0]\n"
        "    if e[0] > 0.5:\n        raise ValueError('beyond')\n"
        "    tangent[0, 0] = 1 / (e[0] - 0.25)\n    return True\n"
    )()
    e = np.zeros((3, 6))
    e[1, 0], e[2, 0] = 0.25, 0.75
    stress, _, _, _, failed = material(law).update(range(6), e, 0 * e, np.zeros((3, 0)), np.tile(E2, (3, 1)), DT, 1.0)
    assert failed == 2
    assert np.isnan(stress[:, 0]).tolist() == [False, True, True]


def test_sublayers_with_springs_alone_in_plane_stress():
    """Their stiffness out of the plane is not zero, or they could not be in series."""
    springs = Anisotropic.springs(K_N, K_T)
    law = Stack((0.5, springs), (0.5, Anisotropic.springs(2 * K_N, 2 * K_T))).plane_stress()
    w = np.array([[0.3, 0.7, 0.0]])
    answer = respond(law, jump_strain(w, E2[None]), 0 * jump_strain(w, E2[None]), np.zeros((1, 6)), E2[None], dt=0.0)
    assert traction(answer.stress, E2[None])[0] == pytest.approx([0.3 * K_T * 4 / 3, 0.7 * K_N * 4 / 3, 0.0], rel=EXACT)


# ---------------------------------------------------------------- symmetry
@dataclass(frozen=True)
class Sheared(BulkLaw):
    """Pressure that grows with shear, shear that does not grow with closing: no symmetry, whatever the class says."""

    k: float
    g: float
    powers: ClassVar = {"k": 1, "g": 1}
    linear: ClassVar = True

    def stress(self, step):
        n = lift(step.n)
        return 2 * self.k * step.mid + self.g * step.mid[0, 1] * ufl.outer(n, n)


@dataclass(frozen=True)
class ShearedWithMemory(Sheared):
    internal: ClassVar = {"last": (3, 3)}

    def advance(self, step):
        return {"last": step.e}


@dataclass(frozen=True)
class SaysSo(ShearedWithMemory):
    symmetric: ClassVar = False


@dataclass(frozen=True)
class Triangle(BulkLaw):
    k: float
    powers: ClassVar = {"k": 1}

    def stress(self, step):
        return 2 * self.k * step.mid + ufl.as_tensor([[0, step.mid[0, 0], 0], [0, 0, 0], [0, 0, 0]])


@dataclass(frozen=True)
class TriangleWithMemory(Triangle):
    internal: ClassVar = {"last": (3, 3)}

    def advance(self, step):
        return {"last": step.e}


def of_blocks(law, kind="S", **choices):
    build = Structure.interface if kind == "S" else Structure.full
    joint = sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral", structured=True)
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.02, "y": -0.01}}
    return build(
        Structure(joint, body=LinearElastic(60.0, 40.0), supports=supports, element="Q1", **choices),
        ThinLayer(law, 0.1),
    )


@pytest.mark.parametrize("kind", ["S", "band"])
@pytest.mark.parametrize(
    "law", [Sheared(3.0, 2.0), ShearedWithMemory(3.0, 2.0), Stack((0.4, Sheared(3.0, 2.0)), (0.6, ELASTIC))]
)
def test_a_tangent_that_is_not_symmetric_is_told(law, kind):
    """Cholesky's factor would be of another matrix: half of it is lost."""
    with pytest.raises(
        LawError, match=rf"^(Stack|{type(law).__name__}|Sheared): the tangent is not symmetric.* symmetric = False"
    ):
        solve(of_blocks(law, kind))


@pytest.mark.parametrize("g", [0.0, 2.0])
def test_one_that_says_so_is_solved(g):
    state = solve(of_blocks(SaysSo(3.0, g)))
    assert state.report.residual < 1e-8
    if g == 0:
        assert solve(of_blocks(ShearedWithMemory(3.0, 0.0))).u.x.array == pytest.approx(state.u.x.array, rel=1e-10)


@pytest.mark.parametrize("law", [Triangle(3.0), TriangleWithMemory(3.0)])
def test_a_stress_that_is_not_symmetric_is_told(law):
    with pytest.raises(LawError, match=rf"^{type(law).__name__}\.stress is not symmetric"):
        solve(of_blocks(law))
