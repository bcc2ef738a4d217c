"""Adhesion that time takes to be lost, and may restore: at a point, in a block that is torn off, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from forms import Adhesion, LinearElastic
from forms.base import InputError
from geometry import block
from tests.at_points import respond
from tests.ranges_told import with_warnings
from tests.refused import refused
from thinlayer import Adaptive, ArcLength, Structure, drive, march, solve

K, W, B = 1e4, 0.3, 0.01
TAPE = Adhesion(K, K, W, B)


@dataclass(frozen=True)
class Late(Adhesion):
    """A wrong step: the loss is that at the intensity of its beginning."""

    def _intensities(self, step):
        old, loss = self._intensity(step.q["d"]), step.dt / self.b * self._parts(step.mid, step.n)[2]
        new = old - (old * loss - self.W * step.dt / self.b)
        return old, step.between(old, new), new


def torn(law, rate, n, theta=1.0, to=1.0):
    """Opened at a rate, in steps that are finer at first: the largest stress, work, and what the energies leave of it."""
    w = to * np.linspace(0, 1, n + 1) ** 3
    history = drive(law, [{"w_T": 0.0, "w_N": a} for a in w[1:]], dt=np.diff(w) / rate, theta=theta)
    t = history.tractions[:, 1]
    work = (t if theta == 0.5 else (t + np.append(0.0, t[:-1])) / 2) @ np.diff(w)
    return np.array([t.max(), work, work - history.energies[-1, 0] - history.energies[:, 1].sum()])


@pytest.mark.parametrize(("rate", "largest", "spent"), [
    (1.0, 76.89688, 0.8782885), (0.1, 58.65493, 0.4041954), (0.01, 55.21972, 0.3136949),
    (1e-5, (K * W) ** 0.5, W)])  # fmt: skip
def test_tearing_costs_more_at_larger_rates(rate, largest, spent):
    """Against the integral of the rate by a method of high order; W and sqrt(K W) at slow rates."""
    if rate > 1e-3:
        start = (W / K) ** 0.5
        equation = lambda w, y: [(W - y[0] * K * w * w) / B / rate, y[0] ** 2 * K * w]
        exact = solve_ivp(equation, (start, 1.0), [1.0, W / 2], method="LSODA", rtol=1e-10, atol=1e-12)
        assert exact.y[1, -1] == pytest.approx(spent, rel=1e-6)
        assert (exact.y[0] ** 2 * K * exact.t).max() == pytest.approx(largest, rel=1e-3)
    stress, work, left = torn(TAPE, rate, 4000)
    assert (stress, work) == (pytest.approx(largest, rel=3e-3), pytest.approx(spent, rel=3e-3))
    assert abs(left) < 1e-3 * spent


@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
def test_errors_of_steps(theta, order):
    """Of the work and of the balance of energies: backward Euler's, and those of the midpoint rule."""
    errors = [np.abs(torn(TAPE, 1.0, n, theta)[1:] - (0.87828850, 0.0)) for n in (1000, 2000)]
    rates = np.log2(errors[0] / errors[1])
    assert rates[1] == pytest.approx(order, abs=0.15)
    assert theta == 0.5 or rates[0] == pytest.approx(order, abs=0.15)
    assert (errors[1] < (2e-3 if order == 1 else 2e-5)).all()


def test_steps_of_any_length():
    """Adhesion stays between 0 and 1, however long the step: beta = W/(K w^2) after long; a sudden load keeps it."""
    for dt, beta in ((1e9, W / (K * 0.04)), (0.0, 1.0), (0.1, (B + 0.1 * W) / (B + 0.1 * K * 0.04))):
        history = drive(TAPE, [{"w_T": 0.2, "w_N": 0.0}], dt=dt)
        assert history.memory[0, 0] == pytest.approx(1 - beta**2, abs=1e-12)
        assert history.tractions[0] == pytest.approx([beta**2 * K * 0.2, 0.0], abs=1e-9)
        assert history.energies[0, 1] >= 0
    assert drive(Late(K, K, W, B), [{"w_T": 0.2, "w_N": 0.0}], dt=0.1).memory[0, 0] == 0  # the wrong twin: as sound


def test_adhesion_heals():
    """At the rate W/b while unloaded, up to 1, and costs nothing less than zero; without healing nothing returns."""
    steps = [{"w_T": 0.0, "w_N": w} for w in (0.05, 0.0, 0.0, 0.0, 0.005)]
    dt = [0.05, 0.01, 0.01, 0.1, 1.0]
    healing = drive(Adhesion(K, K, W, B, heals=True), steps, dt=dt)
    beta = np.sqrt(1 - healing.memory[:, 0])
    start = (B + 0.05 * W) / (B + 0.05 * K * 0.0025)
    assert beta == pytest.approx([start, start + 0.3, start + 0.6, 1.0, 1.0])
    assert healing.tractions[-1, 1] == pytest.approx(50.0)
    assert healing.energies[:, 1].min() >= 0
    assert healing.energies[3, 0] == pytest.approx(0.0, abs=1e-12)
    lasting = drive(TAPE, steps, dt=dt)
    assert np.ptp(lasting.memory[:, 0]) < 1e-15
    assert lasting.energies[1:, 1] == pytest.approx(0.0, abs=1e-12)


def test_sides_that_touch_stay_stiff():
    history = drive(replace(TAPE, K_N=2e4), [{"w_T": 0.1, "w_N": 0.1}, {"w_T": 0.0, "w_N": -0.1}], dt=1.0)
    assert history.tractions[1] == pytest.approx([0.0, -2e3])
    assert history.energies[1, :2] == pytest.approx([100.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("heals", [False, True])
def test_the_tangent_is_the_derivative_of_the_stress(heals):
    """Growing, healing, closing and sound, with both time schemes."""
    law = Adhesion(K, 6e3, W, B, heals=heals)
    normal = np.array([0.36, 0.48, 0.8])
    w = 0.01 * np.array([[1.0, 0.5, -0.2], [0.1, 0.0, 0.05], [0.3, -1.0, -2.0], [0.02, 0.1, 0.1]])
    tensors = (w[:, :, None] * normal + w[:, None] * normal[:, None]) / 2
    e = np.array([[a[0, 0], a[1, 1], a[2, 2], *(2**0.5 * np.array([a[0, 1], a[0, 2], a[1, 2]]))] for a in tensors])
    q, at, h = np.array([[0.1], [0.5], [0.2], [0.0]]), np.tile(normal, (4, 1)), 1e-8
    for theta in (1.0, 0.5):
        answer = respond(law, e, 0.1 * e, q, at, 0.01, theta)
        sides = [[respond(law, e + s * h * v, 0.1 * e, q, at, 0.01, theta).stress for s in (1, -1)] for v in np.eye(6)]
        quotients = np.stack([(a - b) / (2 * h) for a, b in sides], axis=-1)
        assert answer.tangent == pytest.approx(quotients, abs=1e-6 * np.abs(answer.tangent).max())


def lifted():
    """A block whose top is turned off its base."""
    top = {"x": lambda x, t: 0.02 * t * (1 - 0.5 * x[0]), "y": lambda x, t: 0.01 * t * x[0]}
    joint = block(1.0, 0.25, 0.25, cell="quadrilateral", structured=True)
    return Structure(joint, body=LinearElastic.young(1e5, 0.3), supports={"TOP": top})


def test_a_block_is_torn_off_in_time():
    """Steps by an estimate of their error, and many equal ones; energies add up with the midpoint rule."""
    model = lifted().interface(Adhesion(K, 6e3, W, B))
    adaptive = march(model, Adaptive(end=1.0, first=0.01, tolerance=1e-4))
    equal = march(model, np.linspace(0.01, 1.0, 100), theta=0.5)
    spent = [history.table["dissipated"].sum() for history in (adaptive, equal)]
    assert spent == pytest.approx([0.277438, 0.277438], rel=1e-3)
    assert equal.table["breaking"][-1] > 0.9 > equal.table["breaking"][10]


def test_step_errors_count_what_is_torn_before_the_end():
    """The largest force is 8 % too small with 32 steps; that at the end, where all is torn, hardly differs."""
    top = {"TOP": {"x": 0.0, "y": lambda x, t: t}}
    joint = block(1.0, 0.25, 0.25, cell="quadrilateral", structured=True)
    model = Structure(joint, body=LinearElastic.young(1e5, 0.0), supports=top).interface(TAPE)
    observe = {"P": lambda state: state.reaction("TOP").force[1]}
    runs = [
        with_warnings(lambda n=n: march(model, 0.06 * np.linspace(1 / n, 1, n), observe=observe)) for n in (32, 512)
    ]
    (coarse, warnings), (fine, none) = runs
    loads = [history.table["P"] for history in (coarse, fine)]
    assert loads[0].max() / loads[1].max() - 1 == pytest.approx(-0.0742, abs=0.002)
    assert 0.074 < coarse.step_errors["forces"] < 0.15
    assert abs(loads[0][-1] / loads[1][-1] - 1) < 1e-2  # wrong twin: the error of the last state
    assert ("of this march leave" in warnings[0], none) == (True, [])


def test_uses_that_are_refused_or_warned_of():
    model = lifted().interface(TAPE)
    refused(InputError, "and t is not a time on a path; march in time, with a list", march, model,
        ArcLength(end=1.0, first=0.1))  # fmt: skip
    refused(InputError, "dt is missing: Adhesion depends on the length", drive, TAPE, [{"w_T": 0.1, "w_N": 0.0}])
    refused(InputError, "Adhesion is a law on S", lifted().full, TAPE)
    (warning,) = with_warnings(lambda: solve(model, 0.1))[1]
    assert "Adhesion relaxes with the time 0.0333, and a solve knows no time" in warning
    refused(InputError, "b is 0.0; allowed: > 0", replace, TAPE, b=0.0)
    refused(InputError, "W is -1.0; allowed: > 0", replace, TAPE, W=-1.0)
    refused(InputError, "heals is 1; allowed: True or False", replace, TAPE, heals=1)
