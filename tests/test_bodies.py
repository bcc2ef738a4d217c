"""Bodies with laws that yield, creep or relax: columns against closed forms, files, ranks, what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from forms import (
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulombMonodirectional,
    NonMonotone,
    Stack,
    VonMises,
)
from forms.base import InputError
from geometry import sandwich, wall
from tests.columns_in_time import column, joint
from tests.orders import taylor_order
from tests.refused import refused
from tests.test_mean_volume import Pointwise
from thinlayer import Adaptive, LimitLoad, Springs, Structure, Surface, ThinLayer, march, piecewise, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.solving.solve import Solver

pytestmark = pytest.mark.few(5)

JOINT = sandwich(1.0, 0.5, 0.5, 0.25)
YIELDING = VonMises(60.0, 50.0, strength=1.0, hardening=20.0, kinematic=10.0)
SHEARED = {"TOP": lambda x, t: (0.5 * t * (1 + x[0]), -0.3 * t)}

SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}


def structure(body) -> Structure:
    return Structure(JOINT, body=body, supports=SUPPORTS, tractions=SHEARED)


def yielding(body=YIELDING) -> InterfaceModel:
    return structure(body).interface(LAYER)


MU, Y, H = 50.0, 1.0, 30.0
METAL = VonMises(60.0, MU, strength=Y, hardening=H)
GLUE = LinearElastic(60.0, 40.0)
LAYER = ThinLayer(GLUE, 0.1, at=1.0)
EXACT = 1e-9


def top(state) -> float:
    """Largest displacement: of the top."""
    return float(np.abs(state.u.x.array).max())


def models(body, mode: str, layer=LAYER, **ends):
    structure = Structure(joint(), **column(mode, **ends) | {"body": body})
    return structure.interface(layer), structure.full(layer, cells_through=2)


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_relaxing_bodies_creep_in_shear(theta):
    """Two Maxwell bodies, each 0.5 high: t/mu (1 + t/t1), and the layer's jump t/mu; tractions at the ends of steps."""
    load, times = 0.5, [0.1, 0.3]
    for model in models(Maxwell(60.0, MU, 0.7), "shear", load=load):
        history = march(model, times, theta=theta)
        for state in history:
            assert top(state) == pytest.approx(load / MU * (1 + state.t / 0.7) + load / GLUE.mu, rel=EXACT)
            assert state.mean_stress()[0, 1] == pytest.approx(load, rel=EXACT)
        assert np.abs(history.table["imbalance"]).max() < 1e-10
        stored, work = state.energies(), history.table["supplied"].sum()
        assert stored["bodies"] == pytest.approx(load**2 / (2 * MU), rel=EXACT)
        assert stored["layer"] == pytest.approx(load**2 / (2 * GLUE.mu), rel=EXACT)
        lost = history.table["dissipated bodies"].sum()
        assert lost == pytest.approx(load**2 / MU * 0.3 / 0.7, rel=1e-8)
        assert lost == pytest.approx(history.table["dissipated"].sum())
        assert work == pytest.approx(stored["bodies"] + stored["layer"] + lost + history.table["remainder"].sum())


@pytest.mark.parametrize("theta", [1.0, 0.5, 0.7])
@pytest.mark.parametrize("body", [Maxwell(60.0, MU, 0.7), KelvinVoigt(60.0, MU, 0.2, 0.3)], ids=["relaxes", "creeps"])
def test_tractions_on_bodies_are_those_of_the_end_of_a_step(body, theta):
    """Under a growing load; the stress that balances the forces within a step is another one."""
    for model in models(body, "normal", load=lambda t: 1 + 3 * t):
        state = march(model, [0.1, 0.25, 0.3], theta=theta).last
        surface = Surface(model if model.broken else models(body, "normal", load=lambda t: 1 + 3 * t)[0])
        if model.broken:
            assert surface.integral(surface.traction(state)[1]) == pytest.approx(1.9, rel=1e-8)
        assert state.mean_stress()[1, 1] == pytest.approx(1.9, rel=1e-8)


def test_yielding_bodies_in_shear():
    """tau = mu (gamma - gamma_p), sqrt(3) tau = Y + H gamma_p/sqrt(3): bilinear, and elastic on the way back."""
    path = {0.0: 0.0, 0.5: 0.5, 1.0: 0.9, 1.5: 0.4}
    load = partial(piecewise(path), None)

    for model in models(METAL, "shear", load=load):
        history = march(model, [0.5, 1.0, 1.5])
        slip = 3 * (0.9 - Y / math.sqrt(3)) / H
        for state, expected in zip(history.states.values(), (0, 0, slip, slip), strict=True):
            tau = path[state.t]
            assert top(state) == pytest.approx(tau / MU + tau / GLUE.mu + expected, rel=EXACT, abs=1e-12)
        for key, memory in state.memory.items():
            assert key in ("body LOWER", "body UPPER")
            assert memory[:, 6] == pytest.approx(slip / math.sqrt(3), rel=EXACT)


@pytest.mark.parametrize("theta", [1.0, 0.7])
@pytest.mark.parametrize("body", [replace(METAL, strength=1e-4), Maxwell(60.0, MU, 0.7)], ids=["yields", "relaxes"])
def test_the_tangent_is_that_of_the_residual(body, theta):
    for model in (yielding(body), yielding({"LOWER": body, "UPPER": GLUE})):
        with Solver(model, method="newton") as solver:
            assert taylor_order(solver, theta=theta, longest=1e-3) > 1.9


def test_bodies_reach_their_limit():
    """Ideal plasticity in shear: Y/sqrt(3)."""
    model = models(VonMises(60.0, MU, strength=Y), "shear", load=lambda t: t)[0]
    error = refused(LimitLoad, "", march, model, [0.1 * k for k in range(1, 9)])
    assert error.t == pytest.approx(Y / math.sqrt(3), rel=2e-3)
    assert error.t <= Y / math.sqrt(3) * (1 + 1e-9)


def test_laws_that_are_no_bodies():
    for law, message in [
        (Stack((0.5, GLUE), (0.5, METAL)), "Stack is for layers: its sublayers lie across the thickness"),
        (NonMonotone(60.0, 40.0, 0.2, 0.02, ((0, 1), (1, 0))), "NonMonotone is for layers: its phases"),
        (MohrCoulombMonodirectional(60.0, 40.0, 0.2, 30.0), "Monodirectional is for layers: .* normal of S"),
    ]:
        bodies = {"LOWER": GLUE, "UPPER": law}
        refused(InputError, f"body 'UPPER': .*{message}", Structure, JOINT, body=bodies, supports={})


def test_what_does_not_go_with_them_is_refused():
    refused(InputError, r"VonMises bounds stresses.* theta = 1", lambda: march(yielding(), [1.0], theta=0.5))
    with pytest.raises(InputError, match="KelvinVoigt depends on rates: no equilibrium without time"):
        solve(yielding(KelvinVoigt(60.0, 40.0, 0.1, 0.1)))
    springs = Springs("TOP", normal=1.0)
    object.__setattr__(springs, "key", "body UPPER")
    structure = Structure(JOINT, body=METAL, supports={}, parts=[springs], tractions=SHEARED)
    refused(InputError, "two parts are called 'body UPPER'", lambda: structure.bonded())


STRONG = Pointwise(60.0, 40.0, strength=1e6)
ELASTIC = LinearElastic(60.0, 40.0)
PLACES = {
    "wall": (wall(2, 3, (1.0, 0.5), 0.25), (0.1, -0.4)),
    "solid": (sandwich(1.0, 0.5, 0.5, 0.5, depth=0.7, structured=True), (0.1, -0.4, 0.2)),
}


@pytest.mark.parametrize("name", PLACES)
def test_a_body_that_does_not_yield_is_elastic(name):
    """What is read off states is the same: tractions, also around junctions, reactions, energies, mean stresses."""
    place, load = PLACES[name]
    made = lambda body: Structure(place, body=body, supports={"BOTTOM": 0.0}, tractions={"TOP": load})
    elastic, other = (solve(made(body).interface(LAYER)) for body in (ELASTIC, STRONG))
    same = 1e-7
    tractions = []
    for state in (elastic, other):
        surface = Surface(state.model)
        tractions.append(surface.profile(surface.traction(state))[1])
    assert tractions[1] == pytest.approx(tractions[0], abs=same * np.abs(tractions[0]).max())
    assert other.energies() == pytest.approx(elastic.energies(), rel=same, abs=1e-12)
    assert other.mean_stress() == pytest.approx(elastic.mean_stress(), abs=same * np.abs(elastic.mean_stress()).max())
    assert other.reaction("BOTTOM").force == pytest.approx(elastic.reaction("BOTTOM").force, abs=1e-8)


def test_adaptive_steps_see_stresses_that_no_displacement_shows():
    """A bar that relaxes between supports: its displacements are those of the supports, whatever the steps."""
    supports = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "TOP": {"y": piecewise({0: 0.0, 2: -0.01, 6: -0.01})}}
    bar = Structure(joint(), body=Maxwell(60.0, MU, 3.0), supports=supports).bonded()
    pushed = lambda history: np.array([state.reaction("TOP", about=(0, 0)).force[1] for state in history])
    exact = march(bar, np.linspace(0, 6, 121)[1:])
    errors, steps = [], []
    for tolerance in (1e-2, 1e-3):
        history = march(bar, Adaptive(end=6, first=0.05, tolerance=tolerance))
        difference = pushed(history) - np.interp(history.t, exact.t, pushed(exact))
        errors.append(np.abs(difference).max() / np.abs(pushed(exact)).max())
        steps.append(len(history))
    assert errors[0] < 0.03
    assert errors[1] < errors[0] / 2  # the error of a step falls with its square, and there are more of them
    assert steps[1] > 2 * steps[0]
