"""Marching: what is recorded, adaptive steps and halving, errors, runs that are killed and resumed."""

from __future__ import annotations

import csv
import signal
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import ufl
from scipy.optimize import brentq

from forms.laws import BulkLaw, KelvinVoigt, KernelLaw, LinearElastic, Maxwell, Norton
from geometry import sandwich
from tests import marching_run
from tests.test_parallel import CLEAN, CLONE, mpirun
from thinlayer import (
    Adaptive,
    ModelError,
    OptionError,
    RangeWarning,
    SolveError,
    Structure,
    Surface,
    ThinLayer,
    compare,
    march,
    piecewise,
    solve,
)
from thinlayer.running.cli import main

BODY = LinearElastic.young(100.0, 0.3)
SLOW = KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5)
SUDDEN = Maxwell(60.0, 40.0, t1=0.7)
JOINT = sandwich(1.0, 0.5, 0.5, 0.5)


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


SETUP = {"body": BODY, "supports": {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}}
PULL = {"TOP": (0.0, 1.0)}
K_N, G_N = 140.0, 60.0 * 0.3 + 80.0 * 0.5


def interface(law=SLOW, tractions=PULL, supports=None):
    setup = SETUP | ({"supports": SETUP["supports"] | supports} if supports else {})
    return Structure(JOINT, tractions=tractions, **setup).interface(ThinLayer(law, 0.1))


def opening(model):
    surface = Surface(model)
    return {"opening": lambda state: surface.integral(surface.jump(state)[1])}


# ---------------------------------------------------------------- what is recorded
def test_a_law_with_a_rate_starts_at_rest():
    """Backward Euler creep of a spring and a dashpot in parallel, w_n = (1/K)(1 - (1 + K dt/G)^-n)."""
    model = interface()
    history = march(model, [0.1, 0.2, 0.3], observe=opening(model))
    assert history.t == pytest.approx([0.0, 0.1, 0.2, 0.3])
    n = np.arange(4)
    assert history.table["opening"] == pytest.approx((1 - (1 + K_N * 0.1 / G_N) ** -n) / K_N, rel=1e-9, abs=1e-14)
    assert [state.t for state in history] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert history.at(0.2).t == pytest.approx(0.2)
    with pytest.raises(ModelError, match=r"no state at t = 0\.15 is kept"):
        history.at(0.15)


def test_a_law_without_a_rate_answers_a_sudden_load_at_once():
    model = interface(SUDDEN)
    history = march(model, [1.1, 1.2], start=1.0, observe=opening(model))
    assert history.t == pytest.approx([1.0, 1.1, 1.2])
    assert history.table["opening"] == pytest.approx((1 + np.array([0.0, 0.1, 0.2]) / 0.7) / K_N, rel=1e-9)
    assert solve(model, 1.0).u.x.array == pytest.approx(history.at(1.0).u.x.array, abs=1e-12)
    with pytest.raises(ModelError, match="KelvinVoigt depends on the strain rate"):
        solve(interface())


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
    moved = {"TOP": {"x": lambda x, t: 0.02 * t}}
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
        model = build(Structure(JOINT, tractions={"TOP": (0.4, 2.0)}, **setup), ThinLayer(SLOW, 0.1))
        history = march(model, [0.1, 0.3, 0.35])
        total = [state.audit.total for state in history]
        assert np.diff(total) == pytest.approx(history.table["stored"][1:], rel=1e-9)
        energies = history.last.energies()
        assert energies["bodies"] > 0.1 * total[-1]
        assert energies["bodies"] + energies["layer"] == pytest.approx(total[-1], rel=1e-9)


def test_states_know_the_loads_of_their_time():
    """Body forces reach S: tractions of earlier states are those of their own loads."""
    setup = SETUP | {"body_force": lambda x, t: (0.0, t)}
    model = Structure(JOINT, **setup).interface(ThinLayer(SUDDEN, 0.1))
    history, surface = march(model, [1.0, 2.0]), Surface(model)
    for state in history:  # the time of the last solve, or of the last question, is another one
        assert state.energies()["loads"] == pytest.approx(state.t * mean_displacement(state), rel=1e-9, abs=1e-12)
    for state in reversed([*history]):
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(0.5 * state.t, rel=1e-9, abs=1e-12)
        assert state.energies()["loads"] == pytest.approx(state.t * mean_displacement(state), rel=1e-9, abs=1e-12)


def mean_displacement(state):
    return state.integral(state.u[1] * ufl.dx)


def test_keep_last():
    history = march(interface(), [0.1, 0.2], keep="last")
    assert len(history) == 3
    assert [state.t for state in history] == pytest.approx([0.2])
    with pytest.raises(ModelError, match=r"there are states at 0\.2"):
        history.at(0.1)


def test_compare_takes_histories_and_states_of_the_same_time():
    full = Structure(JOINT, tractions=PULL, **SETUP).full(ThinLayer(SLOW, 0.1))
    one, other = march(full, [0.1, 0.2]), march(interface(), [0.1, 0.2])
    assert compare(one, other)["error_jump"] < 1e-9
    assert compare(one, other, at=0.1)["jump"] < compare(one, other)["jump"]
    with pytest.raises(ModelError, match=r"states of the same time, not t = 0\.1 and 0\.2"):
        compare(one.at(0.1), other)


# ---------------------------------------------------------------- steps
@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
def test_adaptive_steps(theta, order):
    """The error follows the tolerance; the steps grow as the creep slows down."""
    errors, counts = [], []
    for tolerance in (1e-2, 1e-3, 1e-4):
        model = interface()
        history = march(
            model, Adaptive(2.0, 0.01, tolerance, at=[0.7, 1.0]), theta=theta, observe=opening(model), keep="last"
        )
        exact = (1 - np.exp(-K_N * history.t / G_N)) / K_N
        errors.append(np.abs(history.table["opening"] - exact).max() * K_N)
        counts.append(len(history))
        assert {0.7, 1.0, 2.0} <= set(history.t)
        steps = history.table["dt"][1:]
        assert steps.max() > 4 * steps.min()
    assert errors[0] < 0.05
    assert errors[0] > 1.5 * errors[1] > 2 * errors[2]
    assert counts[2] / counts[1] == pytest.approx(10 ** (1 / (order + 1)), rel=0.4)


@dataclass(frozen=True)
class Brittle(KernelLaw):
    """Elastic, but gives up where the strain changes by more than `most` in a step."""

    k: float
    most: float

    def kernel(e, e_old, q, dt, theta, n, parameters, stress, tangent, q_new, energies):
        largest = 0.0
        for i in range(6):
            stress[i] = parameters[0] * (theta * e[i] + (1 - theta) * e_old[i])
            tangent[i, i] = theta * parameters[0]
            largest = max(largest, abs(e[i] - e_old[i]))
        return largest <= parameters[1]


def test_failing_steps_are_halved_and_recover():
    """From t = 2.5 strains grow by 0.4 t: steps of 1 are too long then, steps of 3/8 are not."""
    pull = lambda x, t: (0.0, ufl.conditional(ufl.lt(t, 2.5), 0.0, t - 2.5) * 4.0)
    model = interface(Brittle(10.0, 0.17), {"TOP": pull})
    history = march(model, [1.0, 2.0, 3.0, 6.0])
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
        march(interface(Brittle(10.0, 0.1), {"TOP": jump}), [1.0, 2.0, 3.0], out=tmp_path)
    assert caught.value.history.t[-1] >= 2.0
    rows = list(csv.DictReader((tmp_path / "table.csv").open()))
    assert [float(row["t"]) for row in rows] == pytest.approx(caught.value.history.t)


def test_piecewise_loads():
    """Linear between given times, and an error elsewhere, before anything is solved."""
    load = piecewise({0.0: (0.0, 0.0), 1.0: (0.0, 2.0), 3.0: (0.0, 1.0)})
    model = interface(SUDDEN, {"TOP": load})
    history, surface = march(model, [0.5, 1.0, 2.0]), Surface(model)
    pulls = [surface.integral(surface.traction(state)[1]) for state in history]
    assert pulls == pytest.approx([0.0, 1.0, 2.0, 1.5], abs=1e-9)
    with pytest.raises(ModelError, match=r"the loads are not finite at t = 3\.5: traction on 'TOP'"):
        march(model, [0.5, 3.5])
    with pytest.raises(ModelError, match=r"displacement is not finite at t = 2"):
        march(interface(supports={"TOP": {"y": piecewise({0.0: 0.0, 1.0: 0.1})}}, tractions={}), [0.5, 2.0])
    for bad in ({}, {0.0: (0.0, 1.0)}, {0.0: (0.0, 1.0), 1.0: 2.0}, {0.0: "a", 1.0: "b"}, [1, 2]):
        with pytest.raises(ModelError, match="piecewise"):
            piecewise(bad)


def test_adaptive_steps_end_where_piecewise_loads_break():
    """A pulse that no error estimate would see."""
    pulse = piecewise({0.0: (0.0, 1.0), 1.0: (0.0, 1.0), 1.05: (0.0, -5.0), 1.1: (0.0, 1.0), 4.0: (0.0, 1.0)})
    model = interface(SUDDEN, {"TOP": pulse})
    history = march(model, Adaptive(4.0, 0.01, 1e-4), observe=opening(model), keep="last")
    assert {1.0, 1.05, 1.1, 4.0} <= set(history.t)
    exact = (1.0 + (4.0 - 0.1 * 3.0) / 0.7) / K_N
    assert history.table["opening"][-1] == pytest.approx(exact, rel=2e-3)


def test_adaptive_steps_do_not_depend_on_what_is_kept_and_go_on_after_a_target():
    tractions = {"TOP": lambda x, t: (0.0, ufl.cos(6 * t))}
    steps = Adaptive(1.0, 0.01, 1e-3, at=[0.3, 0.301, 0.302])
    all_kept, last_kept = (march(interface(SLOW, tractions), steps, keep=keep) for keep in ("all", "last"))
    assert all_kept.t == pytest.approx(last_kept.t)
    after, before = all_kept.table["dt"][all_kept.t > 0.3021][0], all_kept.table["dt"][all_kept.t < 0.3][-1]
    assert after > before / 2


@pytest.mark.parametrize("p", [3.0, 5.0])
@pytest.mark.parametrize("soft", [1.0, 1e-3, 1e-6])
def test_a_dashpot_that_is_nothing_at_rest(p, soft):
    """A sudden load: the first linear step goes far too long, where a large residual has to become small."""
    law = Norton(60.0 * soft, 40.0 * soft, eta=5.0 * soft, p=p)
    model, times = interface(law), [0.02, 0.1, 1.0]
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
    supports = {
        "BOTTOM": 0.0,
        "LEFT": {"x": lambda x, t: 0.01 * ufl.sin(9 * t) * x[1]},
        "RIGHT/UPPER": {"x": lambda x, t: 0.01 * ufl.cos(9 * t)},
    }
    layer = ThinLayer(Norton(60.0, 40.0, eta=5.0, p=1.3), 0.1)
    for build in (Structure.full, Structure.interface):
        history = march(build(Structure(joint, body=BODY, supports=supports), layer), [0.1, 0.2, 0.3])
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


@pytest.mark.parametrize("options", [{}, {"ksp_type": "cg", "pc_type": "gamg"}, {"pc_type": "lu"}])
def test_a_linear_law_may_change_with_its_memory(options):
    """Factors of earlier steps are tried and, where they are no longer good, made anew."""
    model = interface(Ageing(50.0, 0.5))
    history = march(model, [0.1 * k for k in range(1, 11)], options=options, observe=opening(model))
    assert len(history) == 11
    age = np.array([0.0, *(0.1 * k for k in range(10))])
    assert history.table["opening"] == pytest.approx(1 / (50.0 * (1 + 0.5 * age)), rel=1e-7)


# ---------------------------------------------------------------- bad input
@pytest.mark.parametrize(
    ("times", "options", "message"),
    [
        ([], {}, "increase"),
        ([0.2, 0.1], {}, "increase"),
        ([0.0, 0.1], {}, "increase"),
        ([0.1, float("nan")], {}, "finite"),
        ("soon", {}, "sequence of numbers"),
        (0.1, {}, "sequence of numbers"),
        ([0.1], {"theta": 0.4}, "theta is 0.4"),
        ([0.1], {"keep": "some"}, "'all', 'last'"),
        ([0.1], {"resume": True}, "needs out="),
        ([0.1], {"observe": {"t": len}}, "column 't'"),
        ([0.1], {"observe": {"a": 5}}, "must be a function of a state"),
        ([0.1], {"observe": len}, "name of a column"),
        ([0.1], {"observe": {"a": lambda state: None}}, r"observe\['a'\] at t = 0: .* returns a number"),
        ([0.1], {"theta": "half"}, "theta is 'half'"),
        ([0.1], {"start": None}, "start is None"),
        ("12", {}, "sequence of numbers"),
        ([0.1], {"out": ""}, "name of a folder"),
        ([0.1], {"options": {"ksp_nonsense": 1}}, "not read"),
        (Adaptive(-1.0, 0.1), {}, "increase"),
    ],
)
def test_bad_input(times, options, message, tmp_path):
    if not options.get("resume"):
        options = {"out": tmp_path / "out"} | options
    with pytest.raises((ModelError, OptionError), match=message):
        march(interface(), times, **options)
    assert not (tmp_path / "out").exists()


def test_bad_adaptive_steps():
    for values in ({"first": 0.0}, {"first": 0.1, "tolerance": -1.0}, {"first": 0.1, "largest": 0.0}):
        with pytest.raises(ModelError, match="allowed: a number > 0"):
            Adaptive(1.0, **values)
    with pytest.raises(ModelError, match="at has t = 2; times increase to end = 1"):
        Adaptive(1.0, 0.1, at=[2.0])


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of bodies softer than the layer
@pytest.mark.parametrize(
    ("change", "what"),
    [
        (dict(body=LinearElastic.young(1.0, 0.3)), "bodies"),
        (dict(supports=SETUP["supports"] | {"BOTTOM": {"y": 0.01, "x": 0.0}}), "supports"),
        (dict(tractions={"TOP": (0.0, 2.0)}), "loads"),
        (dict(body_force=(0.0, 1.0)), "loads"),
        (dict(layer=ThinLayer(SLOW, 0.2)), "eps"),
        (dict(layer=ThinLayer(SUDDEN, 0.1)), "law"),
    ],
)
def test_another_structure_is_not_resumed_and_not_overwritten(tmp_path, change, what):
    data, layer = SETUP | {"tractions": PULL}, ThinLayer(SLOW, 0.1)
    march(Structure(JOINT, **data).interface(layer), [0.1], out=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    other_layer = change.pop("layer", layer)
    other = Structure(JOINT, **data | change).interface(other_layer)
    for resume in (True, False):
        with pytest.raises(ModelError, match=rf"another march \(.*{what}: .* give another folder"):
            march(other, [0.1, 0.2], out=tmp_path, resume=resume)
    with pytest.raises(ModelError, match=r"start: 0\.0 there, -1\.0 here"):
        march(Structure(JOINT, **data).interface(layer), [0.1, 0.2], out=tmp_path, resume=True, start=-1.0)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    same = KelvinVoigt(np.float64(60.0), 40, theta_lmbda=0.3, theta_mu=0.5)
    again = Structure(JOINT, **data).interface(ThinLayer(same, 0.1))
    assert len(march(again, [0.1, 0.2], out=tmp_path, resume=True)) == 3


def test_times_may_be_negative(tmp_path):
    for resume in (False, True):
        history = march(interface(), [-2.0, -1.0], start=-3.0, out=tmp_path, resume=resume)
        assert history.t == pytest.approx([-3.0, -2.0, -1.0])


def test_times_that_a_resumed_march_has_passed(tmp_path):
    """A row for them there will never be, and who asks for it is told."""
    march(interface(), [0.2, 0.4], out=tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        march(interface(), [0.2, 0.4, 0.5], out=tmp_path, resume=True)
    with pytest.warns(
        RangeWarning, match=r"is at t = 0\.5 and has no step that ended at t = 0\.3, which times ask for"
    ):
        history = march(interface(), [0.3, 0.5, 0.6], out=tmp_path, resume=True)
    assert history.t == pytest.approx([0.0, 0.2, 0.4, 0.5, 0.6])


def test_what_is_observed_in_another_order(tmp_path):
    observe = {"one": lambda state: 2 * state.t, "other": lambda state: -state.t}
    march(interface(), [0.2], out=tmp_path, observe=observe)
    resumed = march(interface(), [0.2, 0.3], out=tmp_path, observe=dict(reversed(observe.items())), resume=True)
    assert resumed.table["one"] == pytest.approx([0.0, 0.4, 0.6])
    assert resumed.table["other"] == pytest.approx([0.0, -0.2, -0.3])


def test_files_that_do_not_fit_together(tmp_path):
    march(interface(), [0.1, 0.2], out=tmp_path)
    with pytest.raises(ModelError, match=r"is at t = 0\.2; times end before"):
        march(interface(), [0.1], out=tmp_path, resume=True)
    states = tmp_path / "states"
    (states / "000002.npz").write_bytes((states / "000001.npz").read_bytes())
    with pytest.raises(ModelError, match="another time than row 2"):
        march(interface(), [0.3], out=tmp_path, resume=True)
    (states / "000002.npz").unlink()
    with pytest.raises(ModelError, match=r"000002\.npz cannot be read"):
        march(interface(), [0.3], out=tmp_path, resume=True)


def test_only_the_same_march_is_resumed(tmp_path):
    march(interface(), [0.1, 0.2], out=tmp_path)
    first = (tmp_path / "table.csv").read_text()
    longer = march(interface(), [0.1, 0.2, 0.3], out=tmp_path, resume=True)
    assert (tmp_path / "table.csv").read_text().startswith(first)
    assert len(longer) == 4
    with pytest.raises(
        ModelError, match=r"another march \(law: KelvinVoigt.*theta_mu=0.5.* there, Kelvin.*theta_mu=0.6"
    ):
        march(interface(KelvinVoigt(60.0, 40.0, 0.3, 0.6)), [0.1], out=tmp_path, resume=True)
    assert [state.t for state in longer] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    for name in ("states/000002.npz", "march.json"):
        (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:700])
        with pytest.raises(ModelError, match=f"{Path(name).name} cannot be read"):
            march(interface(), [0.1], out=tmp_path, resume=True)
    assert len(march(interface(), [0.1], out=tmp_path)) == 2
    assert len(list((tmp_path / "states").iterdir())) == 2


# ---------------------------------------------------------------- killed and resumed
def run(ranks: int, *words: str) -> subprocess.CompletedProcess:
    if ranks > 1:
        return mpirun(ranks, "-m", "tests.marching_run", *words)
    command = [sys.executable, "-m", "tests.marching_run", *words]
    return subprocess.run(command, env=CLEAN | {"PYTHONPATH": str(CLONE)}, cwd=CLONE, capture_output=True, timeout=240)


def test_a_killed_study_is_resumed(tmp_path, capsys):
    """In the middle of the second thickness, on one rank; resumed on two."""
    words = ["run", "sweep_maxwell", "--quick", "--eps", "0.04", "0.02", "--out"]
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, signal, sys\n"
        "from itertools import count\n"
        "from thinlayer.solving.solvers import Solver\n"
        "from thinlayer.running.cli import main\n"
        "step, calls = Solver.step, count()\n"
        "Solver.step = lambda *a: step(*a) if next(calls) < 15 else os.kill(os.getpid(), signal.SIGKILL)\n"
        "main(sys.argv[1:])\n"
    )
    environment = CLEAN | {"PYTHONPATH": str(CLONE)}
    done = subprocess.run([sys.executable, str(script), *words, str(tmp_path / "a")], env=environment, cwd=CLONE)
    assert done.returncode == -signal.SIGKILL
    assert len((tmp_path / "a" / "table.csv").read_text().splitlines()) == 2
    assert main([w.replace("maxwell", "stack") for w in words] + [str(tmp_path / "a"), "--resume"]) == 2
    assert "is of the study sweep_maxwell, not sweep_stack" in capsys.readouterr().err
    assert main([*words[:-2], "0.01", "--out", str(tmp_path / "a"), "--resume"]) == 2
    assert "had the options" in capsys.readouterr().err
    resumed = mpirun(2, "-m", "thinlayer", *words, str(tmp_path / "a"), "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert main([*words, str(tmp_path / "b")]) == 0
    for name in ("table.csv", "table_t1.csv"):
        a, b = (np.genfromtxt(tmp_path / out / name, delimiter=",", skip_header=1) for out in "ab")
        assert a == pytest.approx(b, rel=1e-9, nan_ok=True)
    assert not (tmp_path / "a" / "unfinished").exists()


def tables(out: Path) -> dict[str, np.ndarray]:
    found = {path.parent.name: np.genfromtxt(path, delimiter=",", names=True) for path in out.glob("*/table.csv")}
    columns = ("t", "dt", "supplied", "stored", "dissipated", "energy")
    return {name: np.array([table[column] for column in columns]) for name, table in found.items()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    marching_run.main([str(out)])
    return tables(out)


@pytest.mark.parametrize(
    ("killed_on", "resumed_on", "row", "writing", "first"),
    [(1, 1, 4, False, 2), (1, 2, 10, True, 3), (2, 1, 16, False, 4), (2, 2, 22, True, 6)],
)
def test_killed_and_resumed(undisturbed, tmp_path, killed_on, resumed_on, row, writing, first):
    """A run killed with -9 in a step, or as it writes its files, ends with the table of a run that was left alone.

    The first, second, third and fourth march are killed. Later ones than the next are not disturbed by that: they run only
    with the last, on two ranks.
    """
    words = [str(tmp_path), "--first", str(first)]
    done = run(killed_on, *words, "--kill", str(row), *(["--writing"] if writing else []))
    assert done.returncode != 0
    if killed_on == 1:
        assert done.returncode == -signal.SIGKILL
    if resumed_on == 1:
        marching_run.main([*words, "--resume"])
    else:
        done = run(resumed_on, *words, "--resume")
        assert done.returncode == 0, done.stderr
    found = tables(tmp_path)
    assert len(found) == first
    assert len(undisturbed) == 6
    for name, table in found.items():
        assert table == pytest.approx(undisturbed[name], rel=1e-9, abs=1e-13), name
