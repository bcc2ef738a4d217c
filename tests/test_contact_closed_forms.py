"""Friction cycles, uniform stresses and bonded columns in contact have closed forms; what has no equilibrium raises."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pytest

from forms import ContactLaw, HolonomicCoulomb, IncrementalCoulomb, LinearElastic, Tresca
from geometry import block, sandwich
from studies.problems import sliding_bar
from tests.contact_bars import SOLVERS, bar, coulomb, solved
from tests.contact_run import to_and_fro
from tests.own_laws import Stiffening
from tests.refused import refused
from thinlayer import LimitLoad, SolveError, Structure, Surface, march, piecewise, solve

pytestmark = pytest.mark.few(5)


# ------------------------------------------------------------------------ closed forms
def test_friction_cycle_of_a_rigid_block():
    """Pressed by d, moved to and fro: the loop of an elastic-plastic spring, and the energy in it."""
    K_N, K_T, f, d = 300.0, 80.0, 0.4, 0.02
    path = {0: 0.0, 1: 0.06, 3: -0.06, 5: 0.06}

    supports = {"TOP": {"x": piecewise(path), "y": -d}}
    setup = {"body": LinearElastic.young(1e9, 0.3), "supports": supports, "element": "P1"}
    structure = Structure(block(3.0, 1.0, 0.5, structured=True), **setup)
    times = [0.25 * k for k in range(1, 21)]
    observe = {"t_T": lambda s: Surface(s.model).contact(s).friction_force[0] / 3.0}
    history = march(structure.interface(IncrementalCoulomb(K_N, K_T, f)), times, observe=observe)
    p, bound = K_N * d, f * K_N * d
    slip, expected, dissipated = 0.0, [], []
    for t in [0.0, *times]:
        g = np.interp(t, list(path), list(path.values()))
        t_T = np.clip(K_T * (g - slip), -bound, bound)
        dissipated.append(3.0 * t_T * (g - t_T / K_T - slip))
        slip = g - t_T / K_T
        expected.append(t_T)
    assert history.table["t_T"] == pytest.approx(np.array(expected), abs=1e-5)
    assert history.table["dissipated"] == pytest.approx(np.array(dissipated), abs=1e-5)
    assert max(dissipated) > 0.05
    assert Surface(history.last.model).contact(history.last).p == pytest.approx(p, rel=1e-5)


def test_solvers_agree_on_a_march_that_turns():
    histories = [to_and_fro(method=method) for method in (*SOLVERS, "relaxation")]
    for history in histories[1:]:
        for state, other in zip(history, histories[0], strict=True):
            assert state.u.x.array == pytest.approx(other.u.x.array, rel=1e-7, abs=1e-7 * np.abs(other.u.x.array).max())
            assert state.memory["contact"] == pytest.approx(other.memory["contact"], rel=1e-5, abs=1e-6)
        assert np.abs(history.table["imbalance"]).max() < 1e-6
    assert (np.array(histories[0].table["dissipated"])[-3:] > 1e-3).all()


def sheared(law, q, method):
    """A block without any support, under a pressure of 5 and a shear stress."""
    joint = block(3.0, 1.0, 0.5, structured=True)
    loads = {"TOP": (q, -5.0), "LEFT": (0.0, -q), "RIGHT": (0.0, q)}
    data = {"body": LinearElastic.young(1e4, 0.0), "supports": {}, "element": "P1", "tractions": loads}
    return solved(joint, law, data, method=method)


@pytest.mark.parametrize("method", SOLVERS)
def test_uniform_stress_without_any_support(method):
    """Pressure and shear that S alone carries, up to f p + C: the stiffness of the body is singular, the answer is not."""
    law = HolonomicCoulomb(300.0, 80.0, 0.4, 0.2)
    for contact_law, q in ((law, 2.1), (Tresca(300.0, 80.0, 2.0), 1.7)):
        report = sheared(contact_law, q, method)
        assert report.p == pytest.approx(5.0, rel=1e-7)
        assert report.t_T == pytest.approx(q, rel=1e-7)
        assert report.u_T == pytest.approx(q / 80.0, rel=1e-7)
        assert set(report.status) == {"stick"}
    assert len(refused(SolveError, r"support|load", sheared, law, 2.3, method).residuals) > 1


ENDS = [(lambda x, t: (0.1, 1.5 * t - 2.0), 1.9 / 1.5), (lambda x, t: (t, -2.0), 0.9)]


@pytest.mark.few(12)
@pytest.mark.parametrize(("load", "limit"), ENDS)
@pytest.mark.parametrize("method", ["condensed", "multigrid", "newton", "relaxation"])
def test_a_march_ends_at_the_limit_of_contact(method, load, limit):
    """Pushed, the block slides at f p + C; pulled off, it tips where the mean pressure is the shear, at half its width."""
    few = {"options": {"relaxation_max_sweeps": 20000}} if method == "relaxation" else {}
    joint = sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral", structured=True)
    setup = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": load}, "element": "Q1"}
    structure = Structure(joint, body=LinearElastic.young(1e3, 0.2), **setup)
    model = structure.interface(IncrementalCoulomb(300.0, 80.0, 0.35, 0.2))
    error = refused(LimitLoad, "", march, model, [0.5, limit, 2.0], method=method, **few)
    longest = max(limit - 0.5, 2.0 - limit)
    assert error.t == error.history.last.t > 0.5
    assert error.t <= limit * (1 + 1e-9)
    assert error.failed_at >= limit * (1 - 1e-9)
    assert error.failed_at - error.t < (0.02 if few else 1.01 / 1024) * longest
    assert error.growth > 1e3
    assert not re.search("smaller|supported", str(error))  # what a solver that fails advises
    report = Surface(error.history.last.model).contact(error.history.last)
    assert abs(report.friction_force[0]) == pytest.approx(load(0, error.t)[0], rel=1e-6)


@pytest.mark.few(5)
@pytest.mark.parametrize("method", SOLVERS)
def test_a_body_pulled_off(method):
    joint, setup = sliding_bar(12)
    pulled = setup | {"tractions": {"TOP": (0.0, 50.0)}}
    report = solved(joint, coulomb("middle"), pulled, method=method)
    assert report.counts["separated"] >= 11
    assert report.counts["stick"] == report.counts["sliding"] == 0
    assert not report.p.any()
    with pytest.raises(SolveError):
        solved(joint, coulomb("middle"), pulled | {"supports": {"RIGHT": {"x": 0.0}}}, method=method)


def test_tresca_bounds_the_traction():
    assert np.abs(bar(12, Tresca(4e5, 6e4, 10.0)).t_T).max() == pytest.approx(10.0)


# ------------------------------------------------------------------------ laws and bodies of one's own
@dataclass(frozen=True)
class Saturating(ContactLaw):
    """Friction that grows more and more slowly with the pressure."""

    f: float
    largest: float

    def threshold(self, p):
        return self.largest * np.tanh(self.f * p / self.largest)

    def threshold_rate(self, p):
        return self.f / np.cosh(self.f * p / self.largest) ** 2


def test_a_law_of_ones_own():
    report = bar(12, Saturating(4e5, 6e4, 1.0, 25.0))
    assert np.abs(report.t_T).max() == pytest.approx(25.0 * np.tanh(report.p / 25.0)[report.status == "sliding"].max())
    assert report.clapeyron < 1e-9
    refused(ValueError, "method='newton'", lambda: bar(12, Saturating(4e5, 6e4, 1.0, 25.0), method="condensed"))


def test_bodies_that_are_not_linear():
    joint, setup = sliding_bar(8)
    state = solve(Structure(joint, **setup | {"body": Stiffening(5e3, 4e3, 1e6)}).interface(coulomb("middle")))
    assert state.report.method == "newton"
    assert Surface(state.model).contact(state).equilibrium < 1e-9
