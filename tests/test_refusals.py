"""Mistakes that would give wrong numbers or an internal error: each is refused with what, where and a remedy."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from forms import Anisotropic, LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.pictures import assert_drawn
from tests.refused import refused
from thinlayer import (
    SolveError,
    Structure,
    Surface,
    Table,
    ThinLayer,
    ThinlayerError,
    compare,
    fields,
    plotting,
    solve,
    sweep,
)
from thinlayer.solving import linear_solvers

GLUE = LinearElastic(lmbda=3.0, mu=2.0)
JOINT = sandwich(2.0, 1.0, 1.0, 0.5)
SETUP = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0}}
LAYER = ThinLayer(GLUE, 0.1, at=1.0)


@pytest.fixture(scope="module")
def states():
    pulled = Structure(JOINT, tractions={"TOP": (0.1, 1.0)}, **SETUP)
    return solve(pulled.full(LAYER)), solve(pulled.interface(LAYER))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"joint": "joint.msh"}, "joint is 'joint.msh'; it must be a Joint"),
        ({"parts": LAYER}, "parts is .* must be a list"),
        ({"comm": "world"}, "comm is 'world'"),
    ],
)
def test_arguments_of_another_kind(wrong, words):
    refused(InputError, words, lambda: Structure(**({"joint": JOINT, **SETUP} | wrong)))


def test_thicknesses_that_coordinates_do_not_resolve():
    with pytest.raises(InputError, match="1e-300, which coordinates do not resolve beside bodies of 2"):
        Structure(JOINT, **SETUP).full(ThinLayer(GLUE, 1e-300, at=1.0))
    with pytest.raises(InputError, match=r"eps is 2\.1e\+06, the bodies measure 2: .* lost in rounding"):
        Structure(JOINT, **SETUP).full(ThinLayer(GLUE, 2.1e6, at=1.0))


@pytest.mark.parametrize(
    "load", [lambda x, t: (x[0] > 1, 0), lambda x, t: x[0], lambda x, t: (1.0,), ("a", 0), {"x": 5}, lambda x, t: 3.0]
)
def test_loads_that_are_no_vectors(load):
    with pytest.raises(InputError, match=r"traction on 'TOP' .*needs 2 "):
        Structure(JOINT, tractions={"TOP": load}, **SETUP).interface(LAYER)


def test_states_of_other_joints(states):
    other = solve(Structure(sandwich(2.0, 1.0, 1.0, 0.4), tractions={"TOP": (0.1, 1.0)}, **SETUP).full(LAYER))
    surface = Surface(states[1].model)
    for field in (surface.traction, surface.jump):
        refused(InputError, "another joint", field, other)
    refused(InputError, "same joint", compare, other, states[1])
    refused(InputError, "not interface and full", compare, *states[::-1])


@pytest.mark.parametrize("where", [lambda x: x[0] > 99.0, lambda x: abs(x[0] - 0.3) < 1e-9])
def test_where_that_holds_nowhere(states, where):
    refused(InputError, "holds nowhere on S", lambda: compare(*states, where=where))


@pytest.mark.parametrize("where", [lambda x: "x", lambda x: x[0], lambda x: 0.5 < x[0] < 1.0, lambda x, t: x[0] > 1])
def test_where_that_is_no_condition(states, where):
    refused(InputError, r"where (is no numpy function|gives numbers)", lambda: compare(*states, where=where))
    both = compare(*states, where=lambda x: (x[0] > 0.5) & (x[0] < 1.5))
    assert 0 < both["error_jump"] < 1


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"tractions": {"TOP": (0.05, 1.0)}}, "loads"),
        ({"tractions": {"TOP": lambda x, t: (0.1 * x[0], 1.0)}}, "loads"),
        ({"body_force": (0.0, -1.0)}, "loads"),
        ({"body": LinearElastic.young(70.0, 0.3)}, "bodies"),
        ({"supports": {"BOTTOM": {"y": 0.0}, "LEFT": 0.0}}, "supports"),
        ({"plane": "stress"}, "plane"),
        ({"layer": ThinLayer(GLUE, 0.1, profile=lambda x: 1 + 0.1 * x[0], at=1.0)}, "profile of the thickness"),
    ],
)
def test_other_structures_are_not_compared(states, change, what):
    full, interface = states
    other = {"tractions": {"TOP": (0.1, 1.0)}} | change
    layer = other.pop("layer", LAYER)
    model = Structure(JOINT, **SETUP | other).interface(layer)
    refused(InputError, f"compare needs the same {what}", lambda: compare(full, replace(interface, model=model)))


def test_structures_that_are_written_in_other_words_are_compared():
    """Loads as functions that do the same, numbers of other types, another law of the layer."""
    words = [{"TOP": lambda x, t: (0.1 * x[0], 1.0)}, {"TOP": lambda x, t: (0.1 * x[0], 1.0)}]
    supports = [{"BOTTOM": 0.0}, {"BOTTOM": np.int64(0)}]
    layers = [
        ThinLayer(GLUE, 0.1, profile=lambda x: 1 + 0 * x[0], at=1.0),
        ThinLayer(LinearElastic(lmbda=3.0, mu=2.5), 0.1, at=1.0),
    ]
    full, interface = (
        solve(build(Structure(JOINT, body=SETUP["body"], supports=support, tractions=load), layer))
        for build, layer, support, load in zip(
            (partial(Structure.full, bodies="extended"), Structure.interface), layers, supports, words, strict=True
        )
    )
    assert 0 < compare(full, interface)["error_jump"] < 1


def test_states_of_another_time_than_asked_for(states):
    """A state has one time, here 0."""
    assert compare(*states, at=0) == compare(*states)
    refused(InputError, "a state is of t = 0, not of at = 7", lambda: compare(*states, at=7.0))
    for at in (float("nan"), "0", True):
        refused(InputError, r"at is .*; give a time, a finite number", compare, *states, at=at)


def test_sweeps(tmp_path):
    with pytest.raises(InputError, match="no number error_jump; return what compare returns"):
        sweep(lambda e: {"eps": e, "error_traction": 1.0}, [0.1])
    refused(ValueError, "is a folder", lambda: sweep(lambda e: {}, [0.1], out=tmp_path))


def test_pictures(states, tmp_path):
    refused(ValueError, "is a folder", lambda: plotting.deformed(states[1], save=tmp_path))
    for zoom in ((0, 1), (0, float("nan"), 0, 1), (1, 0, 0, 1), "0011", 3):
        with pytest.raises(InputError, match="it needs \\(left, right, bottom, top\\)"):
            plotting.deformed(states[1], save=tmp_path / "a.png", zoom=zoom)
    for scale in (float("nan"), "x", float("inf"), True):
        with pytest.raises(InputError, match=r"scale is .*; it must be a finite number"):
            plotting.deformed(states[1], save=tmp_path / "a.png", scale=scale)
    with pytest.raises(ValueError, match="unknown component None; allowed: size, x, y"):
        plotting.deformed(states[1], save=tmp_path / "a.png", component=None)
    refused(InputError, "save is 3; it must be the name", lambda: plotting.deformed(states[1], save=3))
    refused(InputError, "give its name, which ends in", lambda: fields.write(states[1], None))
    with pytest.raises(InputError, match="rates: a is 1; give what sweep returns"):
        plotting.rates({"a": 1}, save=tmp_path / "a.png")
    for lines in ({"a": ([1, 2], [1])}, {"a": None}, {"a": (["x"], [1])}, {"a": ([1], [1j])}, [1]):
        words = r"'a' is no pair \(x, y\) of as many numbers|curves is \[1\]; give \{label: \(x, y\)\}"
        refused(InputError, words, plotting.curves, lines, "x", "y", save=tmp_path / "a.png")
    assert not [*tmp_path.iterdir()]
    plotting.deformed(states[1], save=tmp_path / "amid.png", zoom=np.array([0.01, 0.02, 0.01, 0.02]), scale=0.0)
    assert_drawn(tmp_path / "amid.png")


def test_numbers_of_numpy_and_texts():
    Structure(JOINT, **SETUP | {"supports": {"BOTTOM": np.int64(0), "TOP": {"y": np.float32(0.5)}}}).interface(LAYER)
    refused(InputError, "width is '10'; it must be a number", lambda: sandwich("10", 1.0, 1.0))


def test_free_sliding_is_no_solution_of_multigrid(monkeypatch):
    """A layer without tangential stiffness leaves the upper body free; conjugate gradients alone would not notice."""
    monkeypatch.setitem(linear_solvers.MULTIGRID_FROM, 3, 100)
    joint = sandwich(1.0, 0.5, 0.5, 0.25, depth=1.0, cell="hexahedron")
    layer = ThinLayer(Anisotropic(np.diag([1.0, 1, 1, 0, 0, 0]), "layer"), 0.05, at=1.0)
    model = Structure(joint, **SETUP | {"tractions": {"TOP": (1.0, 0.0, 0.0)}, "element": "Q1"}).interface(layer)
    with pytest.raises(SolveError):
        solve(model)


def test_every_error_is_one_of_the_package(states, tmp_path):
    """One base class of all; those of bad input are ValueErrors, as Python's own."""
    state = states[1]
    refused = [
        lambda: solve(state.model, method="fast"),
        lambda: Table([{"a": 1.0}])["b"],
        lambda: Table([{"a": 1.0}]).append({"b": 1.0}),
        lambda: plotting.deformed(state, save=tmp_path / "u.xyz"),
        lambda: fields.write(state, tmp_path / "u.xyz"),
        lambda: sweep(lambda e: {}, [0.1], tmp_path),
        lambda: LinearElastic(lmbda=1.0, mu=-1.0),
        lambda: sandwich(1.0, -1.0, 1.0, 0.5),
    ]
    for one in refused:
        with pytest.raises(ThinlayerError) as found:
            one()
        assert isinstance(found.value, ValueError)
    assert issubclass(SolveError, ThinlayerError)
    assert issubclass(SolveError, RuntimeError)
