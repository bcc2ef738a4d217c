"""Columns in time have the closed forms of their laws, first states, and the energies that laws store and dissipate."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, Stack
from forms.base import InputError
from tests import closed_forms
from tests.columns_in_time import (
    AXIS,
    EXACT,
    LAWS,
    LOAD,
    MOVE,
    T1,
    T2,
    TIMES,
    C,
    G,
    K,
    both,
    check_balance,
    check_same,
    column,
    joint,
    jump_of,
    marched,
)
from tests.laws_at_points import CREEP, KELVIN, LMBDA, MAXWELL, MAXWELL_2, MU, NORTON_3, NORTON_15
from tests.own_laws import AgeingFluid, AgeingKelvinVoigt, AgeingSpring, Slipping
from thinlayer import Structure, Surface, ThinLayer, march

pytestmark = pytest.mark.few(5)

SERIES = Stack((0.3, MAXWELL), (0.5, KELVIN), (0.2, LinearElastic(LMBDA, MU)))


def series_creep(mode, t):
    parts = [
        closed_forms.maxwell_creep(LOAD[mode], K[mode], T1, t),
        closed_forms.kelvin_voigt_creep(LOAD[mode], K[mode], G[mode], t),
        LOAD[mode] / K[mode],
    ]
    return closed_forms.stack_creep(SERIES.fractions, parts)


def kelvin_creep(mode, t):
    return closed_forms.kelvin_voigt_creep(LOAD[mode], K[mode], G[mode], t)


def kelvin_moved(mode, t):
    return closed_forms.kelvin_voigt_displaced(MOVE[mode], K[mode], G[mode], C[mode], t)


def maxwell_moved(mode, t):
    return MOVE[mode] - C[mode] * closed_forms.maxwell_relaxation(MOVE[mode], K[mode], C[mode], T1, t)


def two_times_creep(mode, t):
    return closed_forms.maxwell_normal_creep(LMBDA, MU, T1, T2, LOAD[mode], t)


def norton_creep(p):
    return lambda mode, t: closed_forms.norton_creep(LOAD[mode], K[mode], 5.0, p, t, shear=mode == "shear")


def power_creep_normal(mode, t):
    return closed_forms.power_creep_normal(LMBDA, MU, CREEP.A, CREEP.n, LOAD[mode], t)


def power_moved(mode, t):
    compliance = 1 / MU + C[mode]
    return MOVE[mode] - C[mode] * closed_forms.power_relaxation(
        compliance, CREEP.A, CREEP.n, MOVE[mode] / compliance, t
    )


CLOSED = {  # law, mode, whether the end is moved, end of time, jump(mode, t), number at t = 1 from independent code
    "Kelvin-Voigt creep N": (KELVIN, "normal", False, 1.0, kelvin_creep, 0.00650374813452),
    "Kelvin-Voigt creep T": (KELVIN, "shear", False, 1.0, kelvin_creep, 0.0108083089595),
    "Kelvin-Voigt moved N": (KELVIN, "normal", True, 0.3, kelvin_moved, None),
    "Kelvin-Voigt moved T": (KELVIN, "shear", True, 0.3, kelvin_moved, None),
    "Maxwell moved N": (MAXWELL, "normal", True, 1.0, maxwell_moved, 0.02 - C["normal"] * 0.681396777691),
    "Maxwell moved T": (MAXWELL, "shear", True, 1.0, maxwell_moved, 0.05 - C["shear"] * 0.486711984065),
    "Maxwell t1 != t2 creep N": (MAXWELL_2, "normal", False, 1.0, two_times_creep, None),
    "Maxwell t1 != t2 moved T": (MAXWELL_2, "shear", True, 1.0, maxwell_moved, None),
    "Norton 1.5 creep N": (NORTON_15, "normal", False, 0.3, norton_creep(1.5), None),
    "Norton 1.5 creep T": (NORTON_15, "shear", False, 1.0, norton_creep(1.5), 0.00866886620207),
    "Norton 3 creep N": (NORTON_3, "normal", False, 0.01, norton_creep(3.0), None),
    "Norton 3 creep T": (NORTON_3, "shear", False, 0.01, norton_creep(3.0), None),
    "Norton's creep N": (CREEP, "normal", False, 0.5, power_creep_normal, None),
    "Norton's creep moved T": (CREEP, "shear", True, 1.0, power_moved, None),
    "stack creep N": (SERIES, "normal", False, 1.0, series_creep, None),
    "stack creep T": (SERIES, "shear", False, 1.0, series_creep, None),
}


@pytest.mark.parametrize(("theta", "order"), [(1.0, 1), (0.5, 2)])
@pytest.mark.parametrize("name", CLOSED)
def test_order_in_time(name, theta, order):
    """Jumps at the last time; their extrapolation to steps of length zero is the closed form, and the number."""
    law, mode, moved, end, closed, number = CLOSED[name]
    ends = {"move": MOVE[mode]} if moved else {"load": LOAD[mode]}
    expected = float(closed(mode, end))
    steps = (16, 32)
    found = [jump_of(marched(law, mode, theta, np.linspace(0, end, n + 1)[1:], **ends), mode) for n in steps]
    coarse, fine = np.abs(np.array(found) / expected - 1)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.12)
    extrapolated = found[-1] + (found[-1] - found[-2]) / (2**order - 1)
    near = 2e-3 if order == 1 else 2e-5
    assert extrapolated == pytest.approx(expected, rel=near)
    if number:
        assert expected == pytest.approx(number, rel=1e-11)
        assert extrapolated == pytest.approx(number, rel=near)


@pytest.mark.parametrize("mode", ["normal", "shear"])
def test_maxwell_creep_is_exact(mode):
    """A constant traction makes the jump linear in time: both schemes are exact."""
    for theta in (1.0, 0.5):
        history = marched(MAXWELL, mode, theta, [0.1, 0.5, 1.0], load=LOAD[mode])
        for state in history:
            expected = closed_forms.maxwell_creep(LOAD[mode], K[mode], T1, state.t)
            assert jump_of(history, mode, state) == pytest.approx(expected, rel=1e-11)


@pytest.mark.long
def test_norton_above_two_comes_to_rest_in_finite_time():
    """p = 3: the end of the closed form is the elastic jump, reached and kept."""
    load, stop = LOAD["shear"], 2 * (0.5 * 5.0 * 2**-1.5) ** 0.5 / MU
    assert closed_forms.norton_creep(load, MU, 5.0, 3.0, 0.999 * stop, shear=True) < load / MU
    assert closed_forms.norton_creep(load, MU, 5.0, 3.0, 1.001 * stop, shear=True) == pytest.approx(
        load / MU, rel=EXACT
    )
    history = marched(NORTON_3, "shear", 1.0, np.linspace(0, 2 * stop, 201)[1:], load=load)
    assert jump_of(history, "shear") == pytest.approx(load / MU, rel=1e-3)


def test_creep_by_nortons_power_law_goes_on_and_that_of_the_papers_law_stops():
    """A held shear traction: steady rate A s^n of the equivalent stress, exact in any steps; `Norton` ends at t/mu."""
    eta, p = (2 / 3) ** ((CREEP.n + 1) / (2 * CREEP.n)) * CREEP.A ** (-1 / CREEP.n), 1 + 1 / CREEP.n
    for theta in (1.0, 0.5):
        history = marched(CREEP, "shear", theta, [0.1, 0.5, 2.0], load=LOAD["shear"])
        for state in history:
            expected = closed_forms.power_creep(MU, CREEP.A, CREEP.n, LOAD["shear"], state.t)
            assert jump_of(history, "shear", state) == pytest.approx(expected, rel=1e-9)
    dashpot = closed_forms.norton(
        0.0, 0.0, eta, p, np.zeros(2), np.array([3 ** ((CREEP.n + 1) / 2) * CREEP.A, 0.0]), [0, 1]
    )
    assert dashpot == pytest.approx([1.0, 0.0], rel=1e-12)  # its dashpot alone, from the numbers of a data sheet
    stopped = closed_forms.norton_creep(LOAD["shear"], MU, eta, p, 1e3, shear=True)
    assert stopped < 0.1 * closed_forms.power_creep(MU, CREEP.A, CREEP.n, LOAD["shear"], 1e3)


def test_incompressible_column():
    """[u_N] = 0 whatever the normal traction; [u_T] = t_T/mu at any time."""
    for mode, expected in (("normal", 0.0), ("shear", 0.5 * 1.3 / MU)):
        history = marched(LAWS["incompressible"], mode, 0.5, TIMES, load=lambda t, m=mode: LOAD[m] * (1 + 3 * t))
        assert jump_of(history, mode) == pytest.approx(expected, rel=1e-10, abs=1e-14)
        surface = Surface(history.model)
        t = surface.integral(surface.traction(history.last)[AXIS[mode]])
        assert t == pytest.approx(LOAD[mode] * 1.3, rel=1e-10)


def test_traction_law_in_time():
    """A law of jump and traction on S, without eps: a Maxwell law when sheared, in closing stiffer than in opening."""
    law = Slipping(70.0, MU, MU * T1, 900.0)
    for mode, move in (("normal", 0.02), ("normal", -0.02), ("shear", 0.05)):
        setup = column(mode, move=move)
        history = march(Structure(joint(), **setup).interface(law), np.linspace(0, 1, 21)[1:], theta=0.5)
        if mode == "shear":
            assert jump_of(history, mode) == pytest.approx(maxwell_moved(mode, 1.0), rel=1e-4)
        else:  # (d - w)/c = k_N w - closed w^2
            b, c = 70.0 + 1 / C[mode], move / C[mode]
            root = 2 * c / (b + np.sqrt(b**2 - 4 * 900.0 * c))
            assert jump_of(history, mode) == pytest.approx(root, rel=1e-9)
        assert np.isnan(history.table["imbalance"]).all()  # it declares no energy
        assert np.isfinite(history.table["supplied"]).all()
    with pytest.raises(InputError, match="Slipping is a law on S, without a thickness"):
        Structure(joint(), **column("shear", load=0.5)).full(law)


# ---------------------------------------------------------------- the first state
@pytest.mark.parametrize("name", LAWS)
def test_first_state(name):
    """Laws that answer at once: the elastic response to the sudden load; laws with a rate: rest."""
    law = LAWS[name]
    history = marched(law, "shear", 1.0, [0.1], load=0.5)
    first = next(iter(history))
    assert first.t == 0.0
    assert len(history) == 2
    if law.traits.rate:
        assert not first.u.x.array.any()
        assert history.table["supplied"][0] == 0.0
        return
    stiffness = MU + 25.0 if name == "user" else MU  # both springs of the solid
    w = 0.5 / stiffness
    assert jump_of(history, "shear", first) == pytest.approx(w, rel=1e-10)
    work = 0.5 * (w + 0.5 * C["shear"])
    row = {key: history.table[key][0] for key in ("supplied", "stored", "dissipated", "remainder")}
    expected = {"supplied": work, "stored": work / 2, "dissipated": 0.0, "remainder": work / 2}
    assert row == pytest.approx(expected, rel=1e-10, abs=1e-15)


# ---------------------------------------------------------------- energies
def dissipated(name: str, mode: str, dt: float, rate: float, t: float) -> float:
    """Of a step: dt G v^2, dt t^2/(K t1), dt c v^p with the rate of the jump and the traction at t + theta dt."""
    if name == "Kelvin-Voigt":
        return dt * G[mode] * rate**2
    if name == "Maxwell":
        return dt * t**2 / (K[mode] * T1)
    p = LAWS[name].p
    return dt * 5.0 * (2 ** (-p / 2) if mode == "shear" else 1.0) * abs(rate) ** p


@pytest.mark.parametrize("theta", [1.0, 0.75, 0.5])
@pytest.mark.parametrize(
    ("name", "mode"),
    [("Kelvin-Voigt", "normal"), ("Maxwell", "shear"), ("Norton 1.5", "shear"), ("Norton 3", "normal")],
)
def test_energy_balance(name, mode, theta):
    """The remainder is (2 theta - 1) times the energy of the increments; what is dissipated has its closed form."""
    law, load = LAWS[name], lambda t: LOAD[mode] * (1 + 3 * t)
    history = marched(law, mode, theta, TIMES, load=load)
    check_balance(history)
    assert (history.table["dissipated"][1:] > 0).all()
    jumps = [jump_of(history, mode, state) for state in history]
    first = 1 if law.traits.rate else 0
    for k in range(1, len(history)):
        # the first interval of a march from rest is made of two backward Euler steps unless theta = 1
        share = 1.0 if law.traits.rate and k <= 2 and theta < 1 else theta
        row = {key: history.table[key][k] for key in ("dissipated", "remainder", "dt", "t", "supplied")}
        before = row["t"] - row["dt"]
        at_rest = law.traits.rate and k == first  # the traction was still zero
        t, t_old = load(row["t"]), 0.0 if at_rest else load(before)
        mid = share * load(row["t"]) + (1 - share) * load(before)
        change, rate = jumps[k] - jumps[k - 1], (jumps[k] - jumps[k - 1]) / row["dt"]
        spring = (t - t_old) ** 2 / K[mode] if name == "Maxwell" else K[mode] * change**2
        expected = (2 * share - 1) * (spring + C[mode] * (t - t_old) ** 2) / 2
        # forces balance at t + theta dt: tractions at the ends of steps are those of the load only for theta = 1
        if share == 1.0 or theta == 0.5:
            assert row["remainder"] == pytest.approx(expected, rel=1e-8, abs=1e-12 * row["supplied"])
        assert row["dissipated"] == pytest.approx(dissipated(name, mode, row["dt"], rate, mid), rel=1e-8)
    if theta < 1:
        assert len(history) == len(TIMES) + 1 + law.traits.rate
    if theta > 0.5:
        assert (history.table["remainder"][first:] > 0).all()


FLUID, SOLID = AgeingFluid(MU, 0.4, 3.0), AgeingKelvinVoigt(LMBDA, MU, 0.3, 0.5, 2.0)


@pytest.mark.parametrize(
    ("law", "theta"),
    [
        (AgeingSpring(MU, 5.0), 1.0),
        (FLUID, 1.0),
        (FLUID, 0.5),
        (SOLID, 0.75),
        (Stack((0.3, FLUID), (0.7, SOLID)), 1.0),
        (Stack((0.3, FLUID), (0.7, SOLID)), 0.5),
    ],
    ids=["spring", "fluid", "fluid, midpoint", "solid", "stack", "stack, midpoint"],
)
def test_parameters_that_vary_in_time(law, theta):
    """Energies of both models: a stack's own, on S, are those of its laws one by one, in the meshed layer."""
    setup = column("shear", load=lambda t: 0.5 * (1 + 3 * t))
    limit, full = both(joint(), ThinLayer(law, 0.02, at=1.0), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


def test_energy_of_a_stiffness_that_varies_in_time():
    """Stored is K(t) w^2/2; the remainder also has what the change of K takes out at the strain before, -dK w_old^2/2."""
    load = lambda t: 1 + 3 * t
    history = marched(AgeingSpring(MU, 5.0), "normal", 1.0, TIMES, load=load)
    w = [jump_of(history, "normal", state) for state in history]
    for k, state in enumerate(history):
        now, before = (2 * MU * (1 + 5 * history.t[i]) for i in (k, max(k - 1, 0)))
        assert state.energies()["layer"] == pytest.approx(now * w[k] ** 2 / 2, rel=1e-8)
        if k:
            bodies = C["normal"] * (load(history.t[k]) - load(history.t[k - 1])) ** 2 / 2
            expected = bodies + now * (w[k] - w[k - 1]) ** 2 / 2 - (now - before) * w[k - 1] ** 2 / 2
            assert history.table["remainder"][k] == pytest.approx(expected, rel=1e-8)


def test_energy_at_the_end_of_a_midpoint_step():
    """It has the strain, the flow and the parameters of the end: mu(t) (w - eps flow)^2."""
    history = marched(FLUID, "normal", 0.5, TIMES, load=lambda t: 1 + 3 * t)
    for state in history:
        flow = state.memory["layer"][:, 1]
        assert flow == pytest.approx(flow[0], rel=1e-9)
        elastic = jump_of(history, "normal", state) - 0.1 * flow[0]
        expected = MU * (1 + 3 * state.t) * elastic**2
        assert state.energies()["layer"] == pytest.approx(expected, rel=1e-8)
