"""Steps of a march follow a tolerance, are halved where they fail, end where loads break, and find stiff equilibria."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl
from scipy.optimize import brentq

from forms import BulkLaw, LinearElastic, MohrCoulomb, Norton
from forms.base import InputError
from forms.contact import IncrementalCoulomb
from geometry import sandwich
from tests.refused import refused
from tests.viscous_joints import BODY, G_N, K_N, SLOW, SUDDEN, interface, opening
from thinlayer import Adaptive, RangeWarning, SolveError, Structure, Surface, ThinLayer, march, piecewise, solve

pytestmark = pytest.mark.few(5)


@pytest.mark.long
@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
def test_adaptive_steps(theta, order):
    """The error follows the tolerance; the steps grow as the creep slows down."""
    errors, counts = [], []
    for tolerance in (1e-2, 1e-3, 1e-4):
        model = interface()
        steps = Adaptive(2.0, 0.01, tolerance, at=[0.7, 1.0])
        history = march(model, steps, theta=theta, observe=opening(model), keep="last")
        errors.append(np.abs(history.table["opening"] - (1 - np.exp(-K_N * history.t / G_N)) / K_N).max() * K_N)
        counts.append(len(history))
        assert {0.7, 1.0, 2.0} <= set(history.t)
        steps = history.table["dt"][1:]
        assert steps.max() > 4 * steps.min()
    assert errors[0] < 0.05
    assert errors[0] > 1.5 * errors[1] > 2 * errors[2]
    assert counts[2] / counts[1] == pytest.approx(10 ** (1 / (order + 1)), rel=0.4)


@dataclass(frozen=True)
class Brittle(BulkLaw):
    """Elastic, without a stress where the strain changes by more than `most` in a step."""

    k: float
    most: float
    internal: ClassVar = {"nothing": ()}

    def advance(self, step):
        return {"nothing": step.q["nothing"]}

    def stress(self, step):
        change = step.e - step.e_old
        left = self.most**2 - ufl.inner(change, change)
        return self.k * step.mid * ufl.sqrt(left) ** 2 / left


def test_failing_steps_are_halved_and_recover():
    """From t = 2.5 strains grow by 0.4 t: steps of 1 are too long then, steps of 3/8 are not."""
    pull = lambda x, t: (0.0, ufl.conditional(ufl.lt(t, 2.5), 0.0, t - 2.5) * 4.0)
    history = march(interface(Brittle(10.0, 0.17), {"TOP": pull}), [1.0, 2.0, 3.0, 6.0])
    elastic = Brittle(10.0, 1e9)
    steps = history.table["dt"][1:]
    assert history.t[-1] == 6.0
    assert {1.0, 2.0, 3.0} <= set(history.t)
    assert steps[0] == steps[1] == 1.0
    assert steps[2:].max() <= 0.5
    assert history.last.u.x.array == pytest.approx(solve(interface(elastic, {"TOP": pull}), 6.0).u.x.array, abs=1e-9)


def test_a_step_that_fails_however_short_keeps_what_was_done(tmp_path):
    jump = piecewise({0.0: (0.0, 0.0), 2.0: (0.0, 0.0), 2.0001: (0.0, 1e3), 9.0: (0.0, 1e3)})
    with pytest.raises(SolveError, match=r"step \d+, from t = 2.* failed at \d+ points") as caught:
        march(interface(Brittle(10.0, 0.01), {"TOP": jump}), [1.0, 2.0, 3.0], out=tmp_path)
    assert caught.value.history.t[-1] >= 2.0
    rows = list(csv.DictReader((tmp_path / "table.csv").open()))
    assert [float(row["t"]) for row in rows] == pytest.approx(caught.value.history.t)


def test_piecewise_loads():
    """Linear between given times, and an error elsewhere, before anything is solved."""
    model = interface(SUDDEN, {"TOP": piecewise({0.0: (0.0, 0.0), 1.0: (0.0, 2.0), 3.0: (0.0, 1.0)})})
    history, surface = march(model, [0.5, 1.0, 2.0]), Surface(model)
    pulls = [surface.integral(surface.traction(state)[1]) for state in history]
    assert pulls == pytest.approx([0.0, 1.0, 2.0, 1.5], abs=1e-9)
    refused(InputError, r"the loads are not finite at t = 3\.5: traction on 'TOP'", march, model, [0.5, 3.5])
    with pytest.raises(InputError, match=r"displacement is not finite at t = 2"):
        march(interface(supports={"TOP": {"y": piecewise({0.0: 0.0, 1.0: 0.1})}}, tractions={}), [0.5, 2.0])
    for bad in ({0.0: (0.0, 1.0)}, {0.0: (0.0, 1.0), 1.0: 2.0}, [1, 2]):
        refused(InputError, "piecewise", piecewise, bad)


def test_adaptive_steps_end_where_piecewise_loads_break():
    """A pulse that no error estimate would see."""
    pulse = piecewise({0.0: (0.0, 1.0), 1.0: (0.0, 1.0), 1.05: (0.0, -5.0), 1.1: (0.0, 1.0), 4.0: (0.0, 1.0)})
    model = interface(SUDDEN, {"TOP": pulse})
    history = march(model, Adaptive(4.0, 0.01, 1e-4), observe=opening(model), keep="last")
    assert {1.0, 1.05, 1.1, 4.0} <= set(history.t)
    assert history.table["opening"][-1] == pytest.approx((1.0 + (4.0 - 0.1 * 3.0) / 0.7) / K_N, rel=2e-3)


def test_adaptive_steps_do_not_depend_on_what_is_kept_and_go_on_after_a_target():
    tractions = {"TOP": lambda x, t: (0.0, ufl.cos(6 * t))}
    steps = Adaptive(1.0, 0.02, 1e-2, at=[0.3, 0.301, 0.302])
    all_kept, last_kept = (march(interface(SLOW, tractions), steps, keep=keep) for keep in ("all", "last"))
    assert all_kept.t == pytest.approx(last_kept.t)
    after, before = all_kept.table["dt"][all_kept.t > 0.3021][0], all_kept.table["dt"][all_kept.t < 0.3][-1]
    assert after > before / 2


@pytest.mark.parametrize(("p", "soft"), [(3.0, 1.0), (5.0, 1e-6)])
def test_a_dashpot_that_is_nothing_at_rest(p, soft):
    """A sudden load: the first linear step goes far too long, where a large residual has to become small."""
    model, times = interface(Norton(60.0 * soft, 40.0 * soft, eta=5.0 * soft, p=p)), [0.02, 0.1, 1.0]
    history = march(model, times, observe=opening(model))
    w, before = 0.0, 0.0
    for t in times:
        balance = lambda x, w=w, dt=t - before: (
            soft * (K_N * x + 5.0 * (x - w) * abs((x - w) / dt) ** (p - 2) / dt) - 1.0
        )
        w, before = brentq(balance, w, 1.0 / (soft * K_N), xtol=1e-16, rtol=1e-14), t
    assert history.table["opening"][-1] == pytest.approx(w, rel=1e-8)
    assert np.abs(history.table["imbalance"]).max() < 1e-8


def test_moved_sides_of_a_layer_that_is_rigid_at_rest():
    """The tangent at rest would make the forces of moved supports look a million times too large."""
    joint = sandwich(1.0, 0.5, 0.5, 0.25)
    left, right = lambda x, t: 0.01 * ufl.sin(9 * t) * (x[1] + 0.5), lambda x, t: 0.01 * ufl.cos(9 * t)
    supports = {"BOTTOM": 0.0, "LEFT": {"x": left}, "RIGHT/UPPER": {"x": right}}
    layer = ThinLayer(Norton(60.0, 40.0, eta=5.0, p=1.3), 0.1, at=1.0)
    history = march(Structure(joint, body=BODY, supports=supports).interface(layer), [0.1, 0.2, 0.3])
    assert np.abs(history.table["imbalance"]).max() < 1e-8


@dataclass(frozen=True)
class Ageing(BulkLaw):
    """Linear in the strain at the end of a step, with a modulus that grows with its age."""

    k: float
    growth: float
    powers = {"k": 1}
    internal = {"age": ()}
    linear = True

    def advance(self, step):
        return {"age": step.q["age"] + step.dt}

    def stress(self, step):
        return self.k * (1 + self.growth * step.q["age"]) * step.mid


@pytest.mark.parametrize("options", [{}, {"ksp_type": "cg", "pc_type": "gamg"}])
def test_a_linear_law_may_change_with_its_memory(options):
    """Factors of earlier steps are tried and, where they are no longer good, made anew."""
    model = interface(Ageing(50.0, 0.5))
    history = march(model, [0.1 * k for k in range(1, 11)], options=options, observe=opening(model))
    assert len(history) == 11
    age = np.array([0.0, *(0.1 * k for k in range(10))])
    assert history.table["opening"] == pytest.approx(1 / (50.0 * (1 + 0.5 * age)), rel=1e-7)


def pushed(law, push=1.0, **kind):
    """Two stones, pressed and pushed along a joint with this law; t = 1 is 95 % of what `MORTAR` carries."""
    supports, loads = {"BOTTOM": 0, "TOP": {"y": -0.02}}, {"TOP": lambda x, t: (push * t, 0)}
    stones, stone = sandwich(200, 60, 60, h=20, h_ends=8), LinearElastic.young(E=20e3, nu=0.2)
    return Structure(stones, body=stone, supports=supports, tractions=loads, **kind).interface(law)


MORTAR = ThinLayer(MohrCoulomb(55.6, 83.3, cohesion=0.2, friction_angle=35), 10, at=1.0)


def test_a_march_that_yields_tells_the_error_of_its_steps_within_a_factor_two():
    """Against the slip of 16 and 32 steps, extrapolated to steps of no length."""
    model = pushed(MORTAR)
    surface, slips, step_errors = Surface(model), {}, {}
    for n in (1, 3, 8, 16, 32):
        with pytest.warns(RangeWarning, match=rf"the {n} steps of this march .* in jumps.*Adaptive"):
            history = march(model, [(k + 1) / n for k in range(n)], keep="last")
        slips[n], step_errors[n] = surface.integral(surface.jump(history.last)[0]), history.step_errors
    exact = 2 * slips[32] - slips[16]
    for n in (1, 3, 8):
        assert 0.5 < step_errors[n]["jumps"] / (1 - exact / slips[n]) < 1.1, n
        assert step_errors[n]["forces"] < 0.02  # forces hardly feel the steps


def test_errors_of_steps_are_zero_where_nothing_is_dissipated_and_rounding_where_slip_is_in_proportion():
    assert march(pushed(MORTAR, 0.1), [0.5, 1.0]).step_errors == {"displacements": 0.0, "jumps": 0.0, "forces": 0.0}
    assert march(pushed(MORTAR), Adaptive(1.0, 0.5, 0.1), keep="last").step_errors == {}
    assert march(pushed(ThinLayer(LinearElastic(55.6, 83.3), 10, at=1.0)), [0.5, 1.0]).step_errors == {}
    friction = pushed(IncrementalCoulomb(1e3, 1e3, friction=0.3), 0.8, element="P1")  # slides; slip grows in proportion
    assert 0 < march(friction, [0.5, 1.0]).step_errors["jumps"] < 1e-9
