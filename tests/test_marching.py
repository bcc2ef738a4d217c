"""Marches record first states, loads of their time and energies as closed forms and balances have them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import LinearElastic, Norton, Stack
from forms.base import InputError
from tests.own_laws import Stiffening
from tests.refused import refused
from tests.viscous_joints import G_N, JOINT, K_N, PULL, SETUP, SLOW, SUDDEN, interface, opening
from thinlayer import Adaptive, RangeWarning, Structure, Surface, ThinLayer, compare, march, solve


def test_a_law_with_a_rate_starts_at_rest():
    """Backward Euler creep of a spring and a dashpot in parallel, w_n = (1/K)(1 - (1 + K dt/G)^-n)."""
    model = interface()
    history = march(model, [0.1, 0.2, 0.3], observe=opening(model))
    assert history.t == pytest.approx([0.0, 0.1, 0.2, 0.3])
    n = np.arange(4)
    assert history.table["opening"] == pytest.approx((1 - (1 + K_N * 0.1 / G_N) ** -n) / K_N, rel=1e-9, abs=1e-14)
    assert history.at(0.2).t == pytest.approx(0.2)
    refused(InputError, r"no state at t = 0\.15 is kept", lambda: history.at(0.15))


def test_a_law_without_a_rate_answers_a_sudden_load_at_once():
    model = interface(SUDDEN)
    history = march(model, [1.1, 1.2], start=1.0, observe=opening(model))
    assert history.t == pytest.approx([1.0, 1.1, 1.2])
    assert history.table["opening"] == pytest.approx((1 + np.array([0.0, 0.1, 0.2]) / 0.7) / K_N, rel=1e-9)
    with pytest.warns(RangeWarning, match=r"Maxwell relaxes with the time 0\.7, and a solve knows no time"):
        assert solve(model, 1.0).u.x.array == pytest.approx(history.at(1.0).u.x.array, abs=1e-12)


@pytest.mark.parametrize("law", [SLOW, SUDDEN, Stack((0.4, LinearElastic(6.0, 4.0)), (0.6, SLOW))], ids=str)
def test_steps_that_are_not_well_below_a_laws_own_time_are_told_before_the_march(law, recwarn):
    """Backward Euler in one step of x own times is wrong by 1/(1 + x) - exp(-x): 16 % for x = 5."""
    model, time_scales = interface(law), law.sublayers[-1][1].relaxation_times
    steps = np.arange(1.0, 9.5 * max(time_scales) / min(time_scales)) * min(time_scales) / 8
    march(model, [*steps, 4 * steps[-1]])  # longer when nearly all has crept
    assert not [warning for warning in recwarn if "well below" in str(warning.message)]
    end = 5 * min(time_scales)
    words = rf"the step of {end:.3g} at t = 0 is not well below .* about (16|19)% of what"
    with pytest.warns(RangeWarning, match=words):
        march(model, [end])


def test_midpoint_from_rest_starts_with_two_half_steps_of_backward_euler():
    model = interface()
    history = march(model, [0.1, 0.2], theta=0.5, observe=opening(model))
    assert history.t == pytest.approx([0.0, 0.05, 0.1, 0.2])
    x = K_N * 0.1 / G_N
    half = (1 + x / 2) ** -2.0
    expected = [(1 - half) / K_N, (1 - half * (1 - x / 2) / (1 + x / 2)) / K_N]
    assert history.table["opening"][[2, 3]] == pytest.approx(expected, rel=1e-9)


NORTON = Norton(60.0, 40.0, eta=5.0, p=1.5)


@pytest.mark.parametrize(("law", "theta"), [(SLOW, 0.5), (SUDDEN, 0.5), (SUDDEN, 0.75), (NORTON, 0.75), (NORTON, 1.0)])
def test_energy_balance(law, theta):
    """Loads and moving supports supply what is stored, dissipated and left over by the scheme; nothing for midpoint."""
    moved = {"LEFT": {"x": lambda x, t: 0.02 * t * (x[1] + 0.5)}}
    history = march(interface(law, {"TOP": lambda x, t: (0.0, ufl.cos(3 * t))}, moved), [0.05, 0.1, 0.3], theta=theta)
    table = history.table
    for state in [*history][1:]:
        assert state.reaction("BOTTOM").force[1] == pytest.approx(-np.cos(3 * state.t), rel=1e-8)
    assert np.abs(table["imbalance"]).max() < 1e-10
    later = slice(3, None) if theta == 0.5 and law.traits.rate else slice(1, None)
    assert (table["dissipated"][1:] > 0).all()
    remainder = table["remainder"][later] / np.abs(table["supplied"]).max()
    assert (np.abs(remainder) < 1e-13).all() if theta == 0.5 else (remainder > 0).all()


def test_energy_of_bodies_that_are_not_linear():
    """What is stored at the ends of steps differs by what the step stores."""
    setup = SETUP | {"body": Stiffening(0.0, 100.0, 3e4)}
    model = Structure(JOINT, tractions={"TOP": (0.4, 2.0)}, **setup).interface(ThinLayer(SLOW, 0.1, at=1.0))
    history = march(model, [0.1, 0.3, 0.35])
    total = [state.audit.total for state in history]
    assert np.diff(total) == pytest.approx(history.table["stored"][1:], rel=1e-9)
    energies = history.last.energies()
    assert energies["bodies"] > 0.1 * total[-1]
    assert energies["bodies"] + energies["layer"] == pytest.approx(total[-1], rel=1e-9)


def test_states_know_the_loads_of_their_time():
    """Body forces reach S: tractions of earlier states are those of their own loads."""
    model = Structure(JOINT, **SETUP | {"body_force": lambda x, t: (0.0, t)}).interface(ThinLayer(SUDDEN, 0.1, at=1.0))
    history, surface = march(model, [1.0, 2.0]), Surface(model)
    for state in [*history, *reversed([*history])]:  # the time of the last solve, or question, is another one
        moved = state.integral(state.u[1] * ufl.dx)
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(0.5 * state.t, rel=1e-9, abs=1e-12)
        assert state.energies()["loads"] == pytest.approx(state.t * moved, rel=1e-9, abs=1e-12)


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
        assert [state.t for state in after] == pytest.approx([0.4])
    finer = march(begun, Adaptive(0.4, first=0.05, tolerance=1e-3), theta=theta, observe=opening(model))
    assert finer.table["opening"][-1] == pytest.approx(whole.table["opening"][-1], rel=0.05)  # errors of other steps


def test_compare_takes_histories_and_states_of_the_same_time():
    full = Structure(JOINT, tractions=PULL, **SETUP).full(ThinLayer(SLOW, 0.1, at=1.0))
    history, other = march(full, [0.1, 0.2]), march(interface(), [0.1, 0.2])
    assert compare(history, other)["error_jump"] < 1e-9
    assert compare(history, other, at=0.1)["jump"] < compare(history, other)["jump"]
    refused(InputError, r"the same time, not t = 0\.1 and 0\.2", lambda: compare(history.at(0.1), other))
