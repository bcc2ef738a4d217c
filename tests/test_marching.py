"""Marches record first states, loads of their time and energies as closed forms and balances have them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms import BulkLaw, LinearElastic, Norton, Stack
from forms.base import InputError
from tests.refused import refused
from tests.viscous_joints import G_N, JOINT, K_N, PULL, SETUP, SLOW, SUDDEN, interface, opening
from thinlayer import Adaptive, ArcLength, RangeWarning, Structure, Surface, ThinLayer, compare, march, solve
from thinlayer.discretisation.addition import Addition
from thinlayer.parts.forms import matrix
from thinlayer.parts.part import Block, Outcome, Part, PartTraits


@dataclass(frozen=True)
class StiffeningSolid(BulkLaw):
    """An energy of second and fourth degree."""

    mu: float
    c: float
    powers: ClassVar = {"mu": 1, "c": 3}

    def stress(self, step):
        return 2 * self.mu * step.e + self.c * ufl.inner(step.e, step.e) * step.e

    def energy(self, step):
        size = ufl.inner(step.e, step.e)
        return self.mu * size + self.c * size**2 / 4


def test_a_law_with_a_rate_starts_at_rest():
    """Backward Euler creep of a spring and a dashpot in parallel, w_n = (1/K)(1 - (1 + K dt/G)^-n)."""
    model = interface()
    history = march(model, [0.1, 0.2, 0.3], observe=opening(model))
    assert history.t == pytest.approx([0.0, 0.1, 0.2, 0.3])
    n = np.arange(4)
    assert history.table["opening"] == pytest.approx((1 - (1 + K_N * 0.1 / G_N) ** -n) / K_N, rel=1e-9, abs=1e-14)
    assert [state.t for state in history] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert history.at(0.2).t == pytest.approx(0.2)
    refused(InputError, r"no state at t = 0\.15 is kept", lambda: history.at(0.15))


def test_a_law_without_a_rate_answers_a_sudden_load_at_once():
    model = interface(SUDDEN)
    history = march(model, [1.1, 1.2], start=1.0, observe=opening(model))
    assert history.t == pytest.approx([1.0, 1.1, 1.2])
    assert history.table["opening"] == pytest.approx((1 + np.array([0.0, 0.1, 0.2]) / 0.7) / K_N, rel=1e-9)
    assert solve(model, 1.0).u.x.array == pytest.approx(history.at(1.0).u.x.array, abs=1e-12)
    refused(InputError, "KelvinVoigt depends on rates: no equilibrium", lambda: solve(interface()))


@pytest.mark.parametrize("law", [SLOW, SUDDEN, Stack((0.4, LinearElastic(6.0, 4.0)), (0.6, SLOW))], ids=str)
def test_steps_that_are_not_well_below_a_laws_own_time_are_told_before_the_march(law, recwarn):
    """Backward Euler in one step of x own times is wrong by 1/(1 + x) - exp(-x): 16 % for x = 5."""
    model, own = interface(law), law.sublayers[-1][1].own_times
    steps = np.arange(1.0, 9.5 * max(own) / min(own)) * min(own) / 8
    march(model, [*steps, 4 * steps[-1]])  # longer when nearly all has crept
    assert not [one for one in recwarn if "well below" in str(one.message)]
    end = 5 * min(own)
    with pytest.warns(
        RangeWarning, match=rf"the step of {end:.3g} at t = 0 is not well below .* about (16|19)% of what"
    ):
        march(model, [end])


def test_a_solve_of_a_law_that_relaxes_says_that_it_knows_no_time():
    with pytest.warns(RangeWarning, match=r"Maxwell relaxes with the time 0\.7, and a solve knows no time"):
        solve(interface(SUDDEN))


@dataclass(frozen=True)
class Dashpots(Addition):
    """Forces c du/dt per area of a side, as users write them; `counts`: the part also remembers its steps."""

    c: float
    counts: bool = False
    key: str = "dashpots"

    def check(self, model):
        pass

    def work(self, model, u, v):
        return self.c * ufl.inner(u, v) * model.ds(model.domain.values("TOP"))

    def part(self, model):
        return DashpotPart(self, model)


class DashpotPart(Part):
    traits = PartTraits(rate=True)

    def __init__(self, given, model):
        self.key, self.counts = given.key, given.counts
        self.C = matrix(given.work(model, ufl.TrialFunction(model.V), ufl.TestFunction(model.V)))

    def rest(self):
        return np.zeros((1, 1)) if self.counts else None

    def evaluate(self, u, mid):
        self.moved = u.x.petsc_vec - self.interval.old.u.x.petsc_vec

    def add_forces(self, out):
        out.axpy(1.0 / self.interval.dt, self.C * self.moved)
        return 0.0

    def tangents(self, relative_residual):
        return [Block(self.C, 1 / self.interval.dt, kept=True)]

    def commit(self):
        return Outcome(dissipated=self.moved.dot(self.C * self.moved) / self.interval.dt)


def test_a_part_of_ones_own_with_a_rate_starts_at_rest(tmp_path):
    """Dashpots beside a column under a sudden load: w_n = w (1 - (1 + dt/(c w))^-n), w that of the column alone."""
    law, dt, c = LinearElastic(60.0, 40.0), 0.03, 3.0
    make = lambda *parts: Structure(JOINT, tractions=PULL, parts=parts, **SETUP).interface(ThinLayer(law, 0.1, at=1.0))
    top = lambda state: float(state.u.x.array.max())  # of a column pulled along y, with sides on rollers
    w = top(solve(make()))
    model = make(Dashpots(c))
    found = march(model, [dt, 2 * dt, 3 * dt], observe={"top": top}).table["top"]
    assert found == pytest.approx(w * (1 - (1 + dt / (c * w)) ** -np.arange(4.0)), rel=1e-9, abs=1e-14)
    refused(InputError, "the part 'dashpots' depends on rates: no equilibrium without time", lambda: solve(model))
    with pytest.raises(InputError, match="the part 'dashpots' depends on rates, and t is no time on a path"):
        march(model, ArcLength(end=1.0, first=0.1))
    with pytest.raises(InputError, match="the part 'dashpots' remembers values that have no order in files"):
        march(make(Dashpots(c, counts=True)), [dt], out=tmp_path / "run")


def test_loads_are_taken_between_the_ends_of_a_midpoint_step():
    """A load that grows in time, from rest; the equilibrium of bodies and layer holds at every end of a step."""
    model = interface(SUDDEN, {"TOP": lambda x, t: (0.0, t**2)})
    history = march(model, [0.1, 0.2, 0.3], theta=0.5)
    surface = Surface(model)
    for state in history:
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(state.t**2, rel=1e-9, abs=1e-12)


def test_midpoint_from_rest_starts_with_two_half_steps_of_backward_euler():
    model = interface()
    history = march(model, [0.1, 0.2], theta=0.5, observe=opening(model))
    assert history.t == pytest.approx([0.0, 0.05, 0.1, 0.2])
    x = K_N * 0.1 / G_N
    half = (1 + x / 2) ** -2.0
    assert history.table["opening"][[2, 3]] == pytest.approx(
        [(1 - half) / K_N, (1 - half * (1 - x / 2) / (1 + x / 2)) / K_N], rel=1e-9
    )


@pytest.mark.parametrize("theta", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("law", [SLOW, SUDDEN, Norton(60.0, 40.0, eta=5.0, p=1.5)], ids=lambda law: type(law).__name__)
def test_energy_balance(law, theta):
    """Loads and moving supports supply what is stored, dissipated and left over by the scheme; nothing for midpoint."""
    moved = {"LEFT": {"x": lambda x, t: 0.02 * t * (x[1] + 0.5)}}
    history = march(interface(law, {"TOP": lambda x, t: (0.0, ufl.cos(3 * t))}, moved), [0.05, 0.1, 0.3], theta=theta)
    table = history.table
    assert np.abs(table["imbalance"]).max() < 1e-10
    later = slice(3, None) if theta == 0.5 and law.traits.rate else slice(1, None)
    assert (table["dissipated"][1:] > 0).all()
    remainder = table["remainder"][later] / np.abs(table["supplied"]).max()
    assert (np.abs(remainder) < 1e-13).all() if theta == 0.5 else (remainder > 0).all()


def test_energy_of_bodies_that_are_not_linear():
    """What is stored at the ends of steps differs by what the step stores."""
    setup = SETUP | {"body": StiffeningSolid(100.0, 3e4)}
    for build in (Structure.interface, Structure.full):
        model = build(Structure(JOINT, tractions={"TOP": (0.4, 2.0)}, **setup), ThinLayer(SLOW, 0.1, at=1.0))
        history = march(model, [0.1, 0.3, 0.35])
        total = [state.audit.total for state in history]
        assert np.diff(total) == pytest.approx(history.table["stored"][1:], rel=1e-9)
        energies = history.last.energies()
        assert energies["bodies"] > 0.1 * total[-1]
        assert energies["bodies"] + energies["layer"] == pytest.approx(total[-1], rel=1e-9)


def test_states_know_the_loads_of_their_time():
    """Body forces reach S: tractions of earlier states are those of their own loads."""
    setup = SETUP | {"body_force": lambda x, t: (0.0, t)}
    model = Structure(JOINT, **setup).interface(ThinLayer(SUDDEN, 0.1, at=1.0))
    history, surface = march(model, [1.0, 2.0]), Surface(model)
    for state in history:  # the time of the last solve, or of the last question, is another one
        assert state.energies()["loads"] == pytest.approx(state.t * mean_displacement(state), rel=1e-9, abs=1e-12)
    for state in reversed([*history]):
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(0.5 * state.t, rel=1e-9, abs=1e-12)
        assert state.energies()["loads"] == pytest.approx(state.t * mean_displacement(state), rel=1e-9, abs=1e-12)


def mean_displacement(state):
    return state.integral(state.u[1] * ufl.dx)


@pytest.mark.parametrize(("law", "theta"), [(SLOW, 1.0), (SUDDEN, 0.5)], ids=["at rest first", "at once"])
def test_a_march_goes_on_from_a_history_or_a_state(law, theta):
    """As if it had not ended; with other steps too, which then keep their own tolerance."""
    model, times = interface(law), [0.1, 0.2, 0.3, 0.4]
    whole = march(model, times, theta=theta, observe=opening(model))
    begun = march(model, times[:2], theta=theta)
    for begin in (begun, begun.last):
        after = march(begin, times[2:], theta=theta, observe=opening(model), keep="last")
        assert after.t == pytest.approx(times[1:])
        assert after.table["opening"] == pytest.approx(whole.table["opening"][-3:], rel=1e-9)
        assert np.abs(after.table["imbalance"]).max() < 1e-10
    finer = march(begun, Adaptive(0.4, first=0.01, tolerance=1e-5), theta=theta, observe=opening(model))
    short = march(begun, 0.2 + np.arange(1, 101) / 500, theta=theta, observe=opening(model), keep="last")
    end = short.table["opening"][-1]  # errors of order 1 add up: 1e-5 in each of 60 steps
    assert finer.table["opening"][-1] == pytest.approx(end, rel=1e-3)


def test_keep_last():
    history = march(interface(), [0.1, 0.2], keep="last")
    assert len(history) == 3
    assert [state.t for state in history] == pytest.approx([0.2])
    refused(InputError, r"there are states at 0\.2", lambda: history.at(0.1))


def test_compare_takes_histories_and_states_of_the_same_time():
    full = Structure(JOINT, tractions=PULL, **SETUP).full(ThinLayer(SLOW, 0.1, at=1.0))
    one, other = march(full, [0.1, 0.2]), march(interface(), [0.1, 0.2])
    assert compare(one, other)["error_jump"] < 1e-9
    assert compare(one, other, at=0.1)["jump"] < compare(one, other)["jump"]
    refused(InputError, r"states of the same time, not t = 0\.1 and 0\.2", lambda: compare(one.at(0.1), other))
