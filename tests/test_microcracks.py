"""A layer whose damage is a density of cracks: compliance of single cracks, growth in time, blocks on S and meshed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import ufl
from scipy.integrate import dblquad, solve_ivp

from forms import LinearElastic, Microcracked
from forms.base import InputError
from geometry import block
from tests.at_points import respond
from tests.ranges_told import with_warnings
from tests.refused import refused
from thinlayer import Adaptive, ArcLength, Structure, Surface, ThinLayer, drive, march, solve

E, NU, Y_0, VISCOSITY = 1000.0, 0.25, 1e-3, 1e-3
MORTAR = Microcracked(400.0, 400.0, Y_0, VISCOSITY, rho_0=0.3)


@dataclass(frozen=True)
class Tied(Microcracked):
    """A wrong law: closed cracks do not slide."""

    def _flexibilities(self, rho):
        return super()._flexibilities(rho)[0], 1 / self.mu


def test_compliance_of_penny_cracks():
    """From Irwin's energy release rates around the edge of a crack that grows to the radius 1, with K_I, K_II and K_III."""
    K_I, in_shear = lambda a: 2 * math.sqrt(a / math.pi), lambda a: 4 * math.sqrt(a / math.pi) / (2 - NU)
    opened = dblquad(lambda phi, a: (1 - NU**2) / E * K_I(a) ** 2 * a, 0, 1, 0, 2 * math.pi)[0]
    rate = lambda phi, a: in_shear(a) ** 2 * (math.cos(phi) ** 2 + (1 - NU) * math.sin(phi) ** 2)
    sheared = dblquad(lambda phi, a: (1 - NU**2) / E * rate(phi, a) * a, 0, 1, 0, 2 * math.pi)[0]
    c_N, c_T = MORTAR.crack_compliances()
    assert (c_N / 2, c_T / 2) == pytest.approx((opened, sheared), rel=1e-9)
    assert (c_N, c_T) == pytest.approx((0.005, 0.005 / 0.875))


def test_closed_cracks_slide():
    """Below the threshold, with the stiffnesses of cracks; wrong twin: sides that are tied while they touch."""
    steps = [{"w_T": 1e-5, "w_N": w} for w in (1e-5, -1e-5)]
    history = drive(MORTAR, steps, dt=1.0)
    t_T = 1e-5 / (1 / 400 + 0.3 * 0.005 / 0.875)
    assert history.tractions == pytest.approx(np.array([[t_T, 1e-5 / (1 / 1200 + 0.3 * 0.005)], [t_T, -0.012]]))
    assert history.memory[:, 0] == pytest.approx(0.3)
    assert history.energies[:, 0] == pytest.approx((history.tractions * history.jumps).sum(axis=1) / 2)
    assert drive(Tied(**MORTAR.parameters()), steps, dt=1.0).tractions[1, 0] > 1.5 * t_T


def grown(n, theta=1.0, rate=1.0, law=MORTAR, to=0.1):
    """Opened and sheared in equal steps: the density, the balance of energies, and the last traction."""
    w = to * np.linspace(0, 1, n + 1)
    history = drive(law, [{"w_T": 0.6 * a, "w_N": 0.8 * a} for a in w[1:]], dt=to / n / rate, theta=theta)
    t, jumps = (np.vstack([[0.0, 0.0], a]) for a in (history.tractions, history.jumps))
    mean = t[1:] if theta == 0.5 else (t[1:] + t[:-1]) / 2
    left = (mean * np.diff(jumps, axis=0)).sum() - history.energies[-1, 0] - history.energies[:, 1].sum()
    assert history.energies[:, 1].min() >= 0
    return np.array([history.memory[-1, 0], left]), history.tractions[-1]


@pytest.mark.parametrize(("rate", "density"), [(1.0, 4.292945988), (0.01, 18.09877968), (1e-4, 30.18796393)])
def test_cracks_grow_in_time(rate, density):
    """Against the integral of the rate by a method of high order; errors of the midpoint rule fall with dt^2."""
    c_N, c_T = MORTAR.crack_compliances()

    def growth(a, y):
        t_N, t_T = 0.8 * a / (1 / 1200 + c_N * y[0]), 0.6 * a / (1 / 400 + c_T * y[0])
        return [max((c_N * t_N**2 + c_T * t_T**2) / 2 - Y_0, 0.0) / VISCOSITY / rate]

    exact = solve_ivp(growth, (0, 0.1), [0.3], method="LSODA", rtol=1e-10, atol=1e-12, max_step=1e-3)
    assert exact.y[0, -1] == pytest.approx(density, rel=1e-6)
    errors = [np.abs(grown(n, 0.5, rate)[0] - (density, 0.0)) for n in (200, 400)]
    assert np.log2(errors[0] / errors[1])[0] == pytest.approx(2, abs=0.1)
    assert (errors[1] < (1e-4 * density, 1e-5)).all()
    assert (np.abs(grown(400, 1.0, rate)[0] - (density, 0.0)) < (1e-3 * density, 2e-4)).all()


def test_the_traction_is_bounded_at_slow_rates():
    """By the threshold: sqrt(2 Y_0/c_N) in opening; long steps do not overshoot."""
    for steps, dt, error in ((400, 1e3, 1e-3), (40, 1e6, 0.05)):
        history = drive(MORTAR, [{"w_T": 0.0, "w_N": 0.1 * (k + 1) / steps} for k in range(steps)], dt=dt)
        assert history.tractions[-1, 1] == pytest.approx((2 * Y_0 / 0.005) ** 0.5, rel=error)
        assert (np.diff(history.memory[:, 0]) >= 0).all()


@pytest.mark.parametrize("n", [[0.0, 1.0, 0.0], [0.36, 0.48, 0.8]])
def test_the_tangent_is_the_derivative_of_the_stress(n):
    """With cracks that grow in opening, in closing, and not at all; in both time schemes."""
    random = np.random.default_rng(2)
    e, at, h = 0.01 * random.normal(size=(8, 6)), np.tile(n, (8, 1)), 1e-8
    e[6:] *= 1e-3
    q = random.uniform(0.0, 2.0, size=(8, 1))
    for theta in (1.0, 0.5):
        answer = respond(MORTAR, e, 0.1 * e, q, at, 0.1, theta)
        sides = [
            [respond(MORTAR, e + s * h * v, 0.1 * e, q, at, 0.1, theta).stress for s in (1, -1)] for v in np.eye(6)
        ]
        quotients = np.stack([(a - b) / (2 * h) for a, b in sides], axis=-1)
        assert answer.tangent == pytest.approx(quotients, abs=1e-6 * np.abs(answer.tangent).max())
        assert (answer.q > q).sum() >= 4
    frozen = [[respond(MORTAR, e + s * h * v, e, q, at, 0.0).stored for s in (1, -1)] for v in np.eye(6)]
    stress = np.stack([(a - b) / (2 * h) for a, b in frozen], axis=-1)
    answer = respond(MORTAR, e, e, q, at, 0.0)
    assert stress == pytest.approx(answer.stress, abs=1e-6 * np.abs(answer.stress).max())


BLOCK = Microcracked(60.0, 40.0, 2e-3, 1e-2, rho_0=lambda x: 0.2 + 0.1 * x[0])


def lifted():
    """A block on its layer, between rollers, whose top is moved unevenly."""
    top = {"x": lambda x, t: 0.02 * t * ufl.sin(math.pi * x[0]), "y": lambda x, t: 0.03 * t * (1 - 0.5 * x[0])}
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": top}
    joint = block(1.0, 0.25, 0.125, cell="quadrilateral", structured=True)
    return Structure(joint, body=LinearElastic.young(100.0, 0.3), supports=supports)


def test_meshed_blocks_converge_to_the_law_on_s():
    """Density, forces and energy, at the rate 1, with all parameters scaled."""
    times = np.linspace(0.1, 1.0, 10)

    def numbers(model):
        history = march(model, times)
        density = Surface(model).internal(history.last, "rho").mean()
        return np.array([density, history.last.prescribed_work, history.table["dissipated"].sum()])

    expected = numbers(lifted().interface(ThinLayer(BLOCK, 0.1, at=1.0)))
    errors = [np.abs(numbers(lifted().full(ThinLayer(BLOCK, eps, at=1.0), cells_through=1)) / expected - 1)
        for eps in (1 / 64, 1 / 128)]  # fmt: skip
    assert np.log2(errors[0] / errors[1]).min() > 0.9
    assert errors[1].max() < 5e-4
    assert expected[0] > 0.5


def test_uses_that_are_refused_or_warned_of():
    layer = ThinLayer(replace(BLOCK, rho_0=0.2), 0.1, at=1.0)
    model = lifted().interface(layer)
    refused(InputError, "Microcracked creeps or relaxes, and t is not a time on a path", march, model,
        ArcLength(end=1.0, first=0.1))  # fmt: skip
    (warning,) = with_warnings(lambda: solve(model, 1e-3))[1]
    assert "Microcracked relaxes with the time 5" in warning
    adaptive, equal = march(model, Adaptive(end=1.0, first=0.1)), march(model, np.linspace(0.02, 1, 50), theta=0.5)
    spent = [history.table["dissipated"].sum() for history in (adaptive, equal)]
    assert spent[0] == pytest.approx(spent[1], rel=0.01)
    refused(InputError, "rho_0 is -0.1; allowed: >= 0", replace, MORTAR, rho_0=-0.1)
    refused(InputError, "Y_0 is 0.0; allowed: > 0", replace, MORTAR, Y_0=0.0)
    refused(InputError, "viscosity is 0.0; allowed: > 0", replace, MORTAR, viscosity=0.0)
