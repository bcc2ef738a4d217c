"""Columns in time have the closed forms of their laws, first states, and the energies that laws store and dissipate."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic, Stack
from forms.base import InputError
from tests import closed_forms
from tests.columns_in_time import (
    AXIS,
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
from thinlayer import Structure, Surface, ThinLayer, drive, march

pytestmark = pytest.mark.few(5)

SERIES = Stack((0.3, MAXWELL), (0.5, KELVIN), (0.2, LinearElastic(LMBDA, MU)))


def kelvin_creep(mode, t):
    return closed_forms.kelvin_voigt_creep(LOAD[mode], K[mode], G[mode], t)


def maxwell_creep(mode, t):
    return closed_forms.maxwell_creep(LOAD[mode], K[mode], T1, t)


def two_times_creep(mode, t):
    return closed_forms.maxwell_normal_creep(LMBDA, MU, T1, T2, LOAD[mode], t)


def norton_creep(p):
    return lambda mode, t: closed_forms.norton_creep(LOAD[mode], K[mode], 5.0, p, t, shear=mode == "shear")


def power_creep(mode, t):
    if mode == "normal":
        return closed_forms.power_creep_normal(LMBDA, MU, CREEP.A, CREEP.n, LOAD[mode], t)
    return closed_forms.power_creep(MU, CREEP.A, CREEP.n, LOAD[mode], t)


CREEPS = {  # law, mode, end of time, jump(mode, t) under a held traction, number at t = 1 from independent code
    "Kelvin-Voigt N": (KELVIN, "normal", 1.0, kelvin_creep, 0.00650374813452),
    "Kelvin-Voigt T": (KELVIN, "shear", 1.0, kelvin_creep, 0.0108083089595),
    "Maxwell N": (MAXWELL, "normal", 1.0, maxwell_creep, None),
    "Maxwell t1 != t2 N": (MAXWELL_2, "normal", 1.0, two_times_creep, None),
    "Norton 1.5 N": (NORTON_15, "normal", 0.3, norton_creep(1.5), None),
    "Norton 1.5 T": (NORTON_15, "shear", 1.0, norton_creep(1.5), 0.00866886620207),
    "Norton 3 N": (NORTON_3, "normal", 0.01, norton_creep(3.0), None),
    "Norton 3 T": (NORTON_3, "shear", 0.01, norton_creep(3.0), None),
    "Norton's creep N": (CREEP, "normal", 0.5, power_creep, None),
    "Norton's creep T": (CREEP, "shear", 1.0, power_creep, None),
}
STRAIGHT = ("Maxwell N", "Norton's creep T")  # creep that any steps give exactly
ORDERS = [(1.0, 1), (0.5, 2)]  # of both time schemes


def crept(law, mode, end, steps, theta):
    """Jump of a point after some steps under a held traction; laws that answer at once get it before."""
    prescribed = {"w_T": 0.0, "t_N": LOAD[mode]} if mode == "normal" else {"t_T": LOAD[mode], "w_N": 0.0}
    lengths = [*([] if law.traits.rate else [0.0]), *[end / steps] * steps]
    return drive(law, [prescribed] * len(lengths), dt=lengths, theta=theta).jumps[-1, AXIS[mode]]


def check_order(computed, expected, order, number=None):
    """Numbers of 16 and 32 steps; their extrapolation to steps of length zero is what is expected."""
    coarse, fine = np.abs(np.array(computed) / expected - 1)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.12)
    extrapolated = computed[1] + (computed[1] - computed[0]) / (2**order - 1)
    assert extrapolated == pytest.approx(expected, rel=2e-3 if order == 1 else 2e-5)
    assert number is None or expected == pytest.approx(number, rel=1e-11)


@pytest.mark.few(1)
@pytest.mark.parametrize(("theta", "order"), ORDERS)
@pytest.mark.parametrize("name", CREEPS)
def test_order_in_time_of_creep(name, theta, order):
    law, mode, end, closed, number = CREEPS[name]
    expected = float(closed(mode, end))
    jumps = [crept(law, mode, end, steps, theta) for steps in (16, 32)]
    if name in STRAIGHT:
        assert jumps == pytest.approx([expected] * 2, rel=1e-9)
    else:
        check_order(jumps, expected, order, number)


def kelvin_moved(t):
    return closed_forms.kelvin_voigt_displaced(MOVE["normal"], K["normal"], G["normal"], C["normal"], t)


def maxwell_moved(t, mode="shear"):
    return MOVE[mode] - C[mode] * closed_forms.maxwell_relaxation(MOVE[mode], K[mode], C[mode], T1, t)


def power_moved(t):
    compliance = 1 / MU + C["shear"]
    relaxed = closed_forms.power_relaxation(compliance, CREEP.A, CREEP.n, MOVE["shear"] / compliance, t)
    return MOVE["shear"] - C["shear"] * relaxed


def series_creep(t):
    parts = [maxwell_creep("shear", t), kelvin_creep("shear", t), LOAD["shear"] / K["shear"]]
    return closed_forms.stack_creep(SERIES.fractions, parts)


COLUMNS = {  # law, mode, end of time, what is held, jump(t), number at t = 1 from independent code
    "Kelvin-Voigt": (KELVIN, "normal", 0.3, "move", kelvin_moved, None),
    "Maxwell": (MAXWELL_2, "shear", 1.0, "move", maxwell_moved, 0.05 - C["shear"] * 0.486711984065),
    "Norton's creep": (CREEP, "shear", 1.0, "move", power_moved, None),
    "stack": (SERIES, "shear", 1.0, "load", series_creep, None),
}


@pytest.mark.few(1)
@pytest.mark.parametrize(("theta", "order"), ORDERS)
@pytest.mark.parametrize("name", COLUMNS)
def test_order_in_time_of_a_column(name, theta, order):
    """Whose end is moved, or loaded, at once."""
    law, mode, end, control, closed, number = COLUMNS[name]
    loading = {control: (MOVE if control == "move" else LOAD)[mode]}
    times = [np.linspace(0, end, steps + 1)[1:] for steps in (16, 32)]
    jumps = [jump_of(marched(law, mode, theta, grid, **loading), mode) for grid in times]
    check_order(jumps, float(closed(end)), order, number)


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
            assert jump_of(history, mode) == pytest.approx(maxwell_moved(1.0), rel=1e-4)
        else:  # (d - w)/c = k_N w - closed w^2
            b, c = 70.0 + 1 / C[mode], move / C[mode]
            root = 2 * c / (b + np.sqrt(b**2 - 4 * 900.0 * c))
            assert jump_of(history, mode) == pytest.approx(root, rel=1e-9)
        assert np.isnan(history.table["imbalance"]).all()  # it declares no energy
        assert np.isfinite(history.table["supplied"]).all()
    with pytest.raises(InputError, match="Slipping is a law on S, without a thickness"):
        Structure(joint(), **column("shear", load=0.5)).full(law)


def test_first_state():
    """Laws that answer at once: the elastic response to the sudden load; laws with a rate: rest."""
    history = marched(MAXWELL_2, "shear", 1.0, [0.1], load=0.5)
    first, w = next(iter(history)), 0.5 / MU
    assert (first.t, len(history)) == (0.0, 2)
    assert jump_of(history, "shear", first) == pytest.approx(w, rel=1e-10)
    work = 0.5 * (w + 0.5 * C["shear"])
    row = {key: history.table[key][0] for key in ("supplied", "stored", "dissipated", "remainder")}
    expected = {"supplied": work, "stored": work / 2, "dissipated": 0.0, "remainder": work / 2}
    assert row == pytest.approx(expected, rel=1e-10, abs=1e-15)
    assert not next(iter(marched(KELVIN, "shear", 1.0, [0.1], load=0.5))).u.x.array.any()


# ---------------------------------------------------------------- energies
STEPPED = [(KELVIN, "normal"), (MAXWELL, "shear"), (NORTON_15, "shear"), (NORTON_3, "normal")]


@pytest.mark.parametrize("theta", [1.0, 0.75, 0.5])
@pytest.mark.parametrize(("law", "mode"), STEPPED)
def test_energies_of_steps(law, mode, theta):
    """The remainder is (2 theta - 1) times the energy of the increments; what is dissipated has its closed form."""
    sizes, dt, axis = np.array([0.01, 0.03, 0.02, 0.025]), np.array([0.02, 0.05, 0.03, 0.1]), AXIS[mode]
    path = [{"w_T": 0.0, "w_N": w} if mode == "normal" else {"w_T": w, "w_N": 0.0} for w in sizes]
    history = drive(law, path, dt=dt, theta=theta)
    change, t = np.diff(sizes, prepend=0.0), history.tractions[:, axis]
    rate = np.abs(change / dt)
    if law is MAXWELL:  # it remembers its stress, here the component sqrt2 12
        stresses = history.memory[:, 3] / np.sqrt(2)
        lost, increments = dt * t**2 / (K[mode] * T1), np.diff(stresses, prepend=0.0) ** 2 / K[mode]
    else:
        p, c = (2.0, G[mode]) if law is KELVIN else (law.p, 5.0 * (2 ** (-law.p / 2) if mode == "shear" else 1.0))
        lost, increments = dt * c * rate**p, K[mode] * change**2
    assert history.energies[:, 1] == pytest.approx(lost, rel=1e-8)
    assert history.energies[:, 2] == pytest.approx((2 * theta - 1) * increments / 2, rel=1e-8, abs=1e-14)


FLUID, SOLID = AgeingFluid(MU, 0.4, 3.0), AgeingKelvinVoigt(LMBDA, MU, 0.3, 0.5, 2.0)


VARYING = [(AgeingSpring(MU, 5.0), 1.0), (SOLID, 0.75), (Stack((0.3, FLUID), (0.7, SOLID)), 0.5)]


@pytest.mark.parametrize(("law", "theta"), VARYING)
def test_parameters_that_vary_in_time(law, theta):
    """Energies of both models: a stack's own, on S, are those of its laws one by one, in the meshed layer."""
    setup = column("shear", load=lambda t: 0.5 * (1 + 3 * t))
    limit, full = both(joint(), ThinLayer(law, 0.02, at=1.0), setup, TIMES, theta=theta)
    check_same(limit, full)
    for history in (limit, full):
        check_balance(history)


def test_energy_at_the_end_of_a_midpoint_step():
    """It has the strain, the flow and the parameters of the end: mu(t) (w - eps flow)^2."""
    history = marched(FLUID, "normal", 0.5, TIMES, load=lambda t: 1 + 3 * t)
    for state in history:
        flow = state.memory["layer"][:, 1]
        assert flow == pytest.approx(flow[0], rel=1e-9)
        elastic = jump_of(history, "normal", state) - 0.1 * flow[0]
        assert state.energies()["layer"] == pytest.approx(MU * (1 + 3 * state.t) * elastic**2, rel=1e-8)
