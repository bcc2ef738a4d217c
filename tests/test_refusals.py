"""Mistakes that would give wrong numbers or an internal error: each is refused with what, where and a remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.pictures import assert_drawn
from tests.refused import refused
from thinlayer import (
    Structure,
    Surface,
    ThinLayer,
    compare,
    plotting,
    solve,
)

GLUE = LinearElastic(lmbda=3.0, mu=2.0)
JOINT = sandwich(2.0, 1.0, 1.0, 0.5)
SETUP = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0}}
LAYER = ThinLayer(GLUE, 0.1, at=1.0)


@pytest.fixture(scope="module")
def states():
    pulled = Structure(JOINT, tractions={"TOP": (0.1, 1.0)}, **SETUP)
    return solve(pulled.full(LAYER)), solve(pulled.interface(LAYER))


def test_arguments_of_another_kind():
    for wrong, words in [
        ({"joint": "joint.msh"}, "joint is 'joint.msh'; it must be a Joint"),
        ({"parts": LAYER}, "parts is .* must be a list"),
        ({"comm": "world"}, "comm is 'world'"),
    ]:
        refused(InputError, words, Structure, **{"joint": JOINT, **SETUP} | wrong)


def test_states_of_other_joints(states):
    other = solve(Structure(sandwich(2.0, 1.0, 1.0, 0.4), tractions={"TOP": (0.1, 1.0)}, **SETUP).full(LAYER))
    surface = Surface(states[1].model)
    for field in (surface.traction, surface.jump):
        refused(InputError, "another joint", field, other)
    refused(InputError, "same joint", compare, other, states[1])
    refused(InputError, "not interface and full", compare, *states[::-1])


@pytest.mark.parametrize("where", [lambda x: x[0] > 99.0, lambda x: abs(x[0] - 0.3) < 1e-9])
def test_where_that_holds_nowhere(states, where):
    refused(InputError, "is true nowhere on S", lambda: compare(*states, where=where))


@pytest.mark.parametrize("where", [lambda x: "x", lambda x: x[0], lambda x: 0.5 < x[0] < 1.0, lambda x, t: x[0] > 1])
def test_where_that_is_no_condition(states, where):
    refused(InputError, r"where (is not a numpy function|gives numbers)", lambda: compare(*states, where=where))
    assert 0 < compare(*states, where=lambda x: (x[0] > 0.5) & (x[0] < 1.5))["error_jump"] < 1


def test_other_structures_are_not_compared(states):
    for change, what in [
        ({"tractions": {"TOP": lambda x, t: (0.1 * x[0], 1.0)}}, "loads"),
        ({"body": LinearElastic.young(70.0, 0.3)}, "bodies"),
        ({"supports": {"BOTTOM": {"y": 0.0}, "LEFT": 0.0}}, "supports"),
        ({"plane": "stress"}, "plane"),
        ({"layer": ThinLayer(GLUE, 0.1, profile=lambda x: 1 + 0.1 * x[0], at=1.0)}, "profile of the thickness"),
    ]:
        layer, other = change.pop("layer", LAYER), {"tractions": {"TOP": (0.1, 1.0)}} | change
        model = Structure(JOINT, **SETUP | other).interface(layer)
        refused(InputError, f"compare needs the same {what}", compare, states[0], replace(states[1], model=model))


def test_states_of_another_time_than_asked_for(states):
    """A state has one time, here 0."""
    assert compare(*states, at=0) == compare(*states)
    refused(InputError, "a state is of t = 0, not of t = 7", lambda: compare(*states, at=7.0))
    for at in (float("nan"), "0", True):
        refused(InputError, r"at is .*; give a time, a finite number", compare, *states, at=at)


def test_pictures(states, tmp_path):
    for zoom in ((0, 1), (0, float("nan"), 0, 1), (1, 0, 0, 1), "0011"):
        refused(InputError, r"it must be \(left, right, bottom, top\)", plotting.View, zoom=zoom)
    for scale in (float("nan"), "x", True):
        refused(InputError, r"scale is .*; it must be a finite number", plotting.View, scale=scale)
    refused(InputError, "unknown component None; allowed: size", plotting.deformed, states[1], plotting.View(None))
    other = tmp_path / "u.xyz", "formats: .*png"
    for save, words in ((tmp_path, "is a folder"), (3, "save is 3; it must be"), other):
        refused(ValueError, words, plotting.deformed, states[1], save=save)
    refused(InputError, "rates: a is 1; give what sweep returns", plotting.rates, {"a": 1})
    refused(InputError, r"curves is \[1\]; give \{label: \(x, y\)\}", plotting.curves, [1], "x", "y")
    assert not [*tmp_path.iterdir()]
    inside = plotting.View(zoom=np.array([0.01, 0.02, 0.01, 0.02]), scale=0.0)
    plotting.deformed(states[1], inside, save=tmp_path / "amid.png")
    assert_drawn(tmp_path / "amid.png")
