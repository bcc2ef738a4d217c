"""Frequencies: derivatives by parameters, and estimates with the layer meshed, against models with meshed layers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import thinlayer.estimating.frequencies
from forms import Incompressible, LinearElastic
from forms.base import InputError
from tests.on_ranks import on_ranks
from tests.refused import refused
from tests.test_modes import MASS, UNLIKE, beam
from tests.vibrating_bars import SIDES, UNIFORM, bar, frequencies
from thinlayer import (
    Inertia,
    Springs,
    ThinLayer,
    derivative,
    estimate_frequencies,
    frequency_derivatives,
    goals,
    march,
    modes,
    solve,
)
from thinlayer.solving.modes import Pencil

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
GLUE = LinearElastic.young(E=5, nu=0.3)


def changed(name, factor):
    """Data of the bar of unlike bodies, with one parameter multiplied by a factor."""
    data = UNLIKE | {"density": dict(UNLIKE["density"])}
    if name.endswith("density"):
        data["density"][name.partition(".")[0]] *= factor
    else:
        data[{"S.mu": "modulus", "S.eps": "eps"}[name]] *= factor
    return data


NAMES, STENCIL = ("S.mu", "S.eps", "S.density", "LOWER.density"), {-0.02: 1, -0.01: -8, 0.01: 8, 0.02: -1}


def test_derivatives(monkeypatch):
    """Against closed forms and differences; the twin leaves the change of the mass out."""
    lowest = modes(bar(**UNLIKE), 2)
    slopes = frequency_derivatives(lowest, NAMES)
    for name in NAMES:
        closed = sum(k * frequencies(2, **changed(name, 1 + s)) for s, k in STENCIL.items()) / 0.12
        assert slopes[name] == pytest.approx(closed, rel=1e-4)
    differences = sum(k * modes(bar(**changed("S.eps", 1 + s)), 2).omega for s, k in STENCIL.items()) / 0.12
    assert slopes["S.eps"] == pytest.approx(differences, rel=1e-7)

    class SameMass(Pencil):
        def __init__(self, model):
            super().__init__(model)
            self.M = lowest._pencil.M

    monkeypatch.setattr(thinlayer.estimating.frequencies, "Pencil", SameMass)
    twin = frequency_derivatives(lowest, ["S.eps", "S.density"])
    assert (twin["S.density"] == 0).all()
    assert (abs(twin["S.eps"] / differences - 1) > 0.02).all()


def test_multiple_frequencies_have_no_derivatives():
    """Two bars vibrate alike on both sides of a layer that hardly joins them, also if only one mode is asked for."""
    data = {"supports": {"BOTTOM": {"y": 0}, "TOP": {"y": 0}, **SIDES}, "density": {**UNIFORM, "S": 0.0}}
    lowest = modes(bar(modulus=1e-8, **data), 1)
    refused(InputError, "a multiple frequency has no derivative", lambda: frequency_derivatives(lowest, ["S.mu"]))


@pytest.mark.parametrize("order", [0, 1])
def test_estimate_leads_to_the_meshed_layer(order):
    """Order 0 loses 2 % of the first frequency; the twin has no mass in the meshed layer."""
    plates, layer = beam(), ThinLayer(GLUE, 0.8, order=order)
    exact, lowest = modes(plates.full(layer), 4).omega, modes(plates.interface(layer), 4)
    result = estimate_frequencies(lowest)
    assert abs(lowest.omega / exact - 1).max() > 3e-4
    assert result.better == pytest.approx(exact, rel=1e-8)
    assert (result.better >= exact * (1 - 1e-8)).all()
    assert ((result.lower <= exact) & (exact <= result.upper)).all()
    assert (result.upper - result.lower <= np.maximum(0.05 * abs(lowest.omega - exact), 1e-7 * exact)).all()
    twin = modes(beam(parts=[replace(MASS, density={**MASS.density, "S": 0.0})]).full(layer), 4).omega
    assert (twin > result.upper).all()


CASES = {
    "rubber": lambda: (beam(2), Incompressible(mu=1.0), 0.2),
    "springs": lambda: (beam(2, supports={"RIGHT": {"y": 0}}, parts=[MASS, Springs("BOTTOM", 1.0, 1.0)]), GLUE, 0.2),
}


@pytest.mark.parametrize("name", CASES)
def test_estimate_of(name):
    structure, law, eps = CASES[name]()
    layer = ThinLayer(law, eps, order=1)
    exact, lowest = modes(structure.full(layer), 3).omega, modes(structure.interface(layer), 3)
    result = estimate_frequencies(lowest)
    assert result.better == pytest.approx(exact, rel=1e-7)
    assert ((result.lower <= exact) & (exact <= result.upper)).all()


def test_modal_sums_agree_with_the_march():
    """Under a sudden load; the twin is the first mode alone."""
    model = beam(2, tractions={"TOP": (0, 1e-3)}).interface(ThinLayer(GLUE, 0.2, order=1))
    lowest = modes(model, 8)
    top = lambda state: state.integral(state.u[1] * model.ds(model.domain.values("TOP")))
    times = 2 * np.pi / lowest.omega[0] * np.arange(1, 81) / 160
    history = march(model, times, observe={"top": top}, keep="last")
    terms = [
        1e-3 * (top(v) / w) ** 2 * (1 - np.cos(w * times)) for v, w in zip(lowest.shapes, lowest.omega, strict=True)
    ]
    error, of_first = (abs(history.table["top"][1:] - sum(terms[:n])).max() / max(sum(terms)) for n in (8, 1))
    assert error < 4e-3 < of_first


def estimated():
    result = estimate_frequencies(modes(beam(2).interface(ThinLayer(GLUE, 0.4)), 3))
    slopes = frequency_derivatives(modes(beam(2).interface(ThinLayer(GLUE, 0.4, order=1)), 3), ["S.eps", "UPPER.E"])
    return [*result.better, *(slopes["S.eps"] / result.omega), *(slopes["UPPER.E"] / result.omega)]


@on_ranks(estimated, 2)
def test_on_two_ranks(there):
    assert there == pytest.approx(estimated(), rel=1e-7)


def test_refused():
    layer = ThinLayer(GLUE, 0.2, order=1)
    lowest, free = modes(beam(2).interface(layer), 2), modes(beam(2, supports={}).interface(layer), 4)
    meshed, near = modes(beam(2).full(layer), 1), modes(beam(2).interface(layer), 1, near=1e4)
    for wrong in (free, near):
        refused(InputError, "give the lowest modes", lambda m=wrong: estimate_frequencies(m))
    for wrong in (meshed, meshed.model, lowest.model):
        refused(InputError, "for an interface model", lambda m=wrong: estimate_frequencies(m))
    refused(InputError, "for an interface model", lambda: frequency_derivatives(meshed, ["S.E"]))
    refused(InputError, "'S.rho'", lambda: frequency_derivatives(lowest, ["S.rho"]))
    refused(InputError, "it was not solved for; vibrations have none", lambda: lowest.shapes[0].reaction("LEFT"))
    light = beam(2, parts=[Inertia(MASS.density | {"S": 0.0})], tractions={"TOP": (0, -1)}).interface(layer)
    refused(InputError, "it is 0", lambda: frequency_derivatives(modes(light, 1), ["S.density"]))
    moved = march(light, [1e-6], theta=1)
    refused(InputError, "'inertia' moves masses", lambda: derivative(moved, goals.Compliance(), ["S.E"]))
    assert derivative(solve(light), goals.Compliance(), ["UPPER.density"]).by == {"UPPER.density": 0}
