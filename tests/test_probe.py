"""Values at places: displacements and stresses against closed forms, internal variables against memory."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Incompressible, LinearElastic, MohrCoulombMonodirectional, Stack
from forms.base import InputError
from geometry import sandwich, wall
from tests.fields_run import BODY, CASES, EPS, K, axes, slipping, uniform
from tests.refused import refused
from thinlayer import Probe, Structure, ThinLayer, march, solve

PLACES = {2: [[0.31, -0.27], [1.73, 0.4], [0.9, 0.05]], 3: [[0.31, -0.27, 0.6], [1.73, 0.4, 0.21], [0.9, 0.05, 0.9]]}


@pytest.mark.parametrize(("d", "cell", "element"), CASES)
def test_displacements_and_stresses_of_a_linear_field(d, cell, element):
    """At places inside cells, on their corners, and on S from either side."""
    structure, stress, jump = uniform(d, cell, element)
    model = structure.interface(ThinLayer(K, EPS, at=1.0))
    probe = Probe(march(model, [1.0]).last)
    x = np.array(PLACES[d]) @ axes(d)
    corners = model.joint.points[model.joint.surface[:, :d]].mean(axis=1)  # on S
    mean = np.trace(stress) / (2 * BODY.mu + d * BODY.lmbda)
    strain = (stress - BODY.lmbda * mean * np.eye(d)) / (2 * BODY.mu)
    above = (x @ axes(d)[1] > 0)[:, None]
    assert probe.displacement(x) == pytest.approx(x @ strain + above * jump, rel=1e-9, abs=1e-12)
    assert probe.stress(x)[:, :d, :d] == pytest.approx(np.tile(stress, (len(x), 1, 1)), rel=1e-9, abs=1e-9)
    assert probe.stress(x[0])[0, 1] == pytest.approx(stress[0, 1], rel=1e-8)
    assert probe.displacement(corners, side="lower") == pytest.approx(corners @ strain, rel=1e-8, abs=1e-11)
    assert probe.displacement(corners, side="upper") == pytest.approx(corners @ strain + jump, rel=1e-8, abs=1e-11)
    every = probe.displacement(np.vstack([corners, x]), side="upper")
    assert every == pytest.approx(np.vstack([corners @ strain + jump, x @ strain + above * jump]), rel=1e-8, abs=1e-11)
    if d == 2:
        nu = BODY.lmbda / (2 * (BODY.lmbda + BODY.mu))
        assert probe.stress(x)[:, 2, 2] == pytest.approx(nu * np.trace(stress), rel=1e-9)


def test_stresses_that_are_linear_in_a_cell():
    """A beam bent by its own supports: u = (x y, -x^2/2) without Poisson's effect; stress E y."""
    E = 50.0
    joint = sandwich(2.0, 0.5, 0.7, 0.5)
    bent = {"x": lambda x, t: 0.1 * x[0] * x[1], "y": lambda x, t: -0.05 * x[0] ** 2}
    supports = dict.fromkeys(["LEFT", "RIGHT", "TOP", "BOTTOM"], bent)
    probe = Probe(solve(Structure(joint, body=LinearElastic.young(E, 0.0), supports=supports).bonded()))
    x = np.array([[0.31, -0.27], [1.73, 0.4], [1.0, 0.61], [0.0, -0.5]])
    s = probe.stress(x)
    assert s[:, 0, 0] == pytest.approx(0.1 * E * x[:, 1], rel=1e-5, abs=1e-6)
    assert np.abs(s[:, 0, 1]).max() < 1e-5
    assert s[:, 0, 0] != pytest.approx(0.1 * E * (x[:, 1] + 0.05), rel=1e-2)


@pytest.mark.parametrize("kind", ["full", "interface"])
def test_internal_variables_are_those_of_the_memory(kind):
    """By name, in bodies, meshed layers and on S; their integrals, and the nearest one at a place."""
    law = MohrCoulombMonodirectional(3.0, 2.0, cohesion=0.05, friction_angle=20.0, elastic_fraction=0.1)
    state = slipping(kind, Stack((0.4, LinearElastic(4.0, 3.0)), (0.6, law))).last
    probe = Probe(state)
    (key,) = probe.names
    assert probe.names[key] == ["plastic", "accumulated"]
    assert key == "layer 2" if kind == "interface" else "layer"
    points = probe.points("plastic")
    assert points.key == key
    order = np.lexsort([*np.round(points.x.T[::-1], 9), points.entity])  # by cell or facet, then by place
    assert np.array_equal(order, np.arange(len(order)))
    assert points.values.shape == (len(points.x), 3, 3)
    assert points.values == pytest.approx(points.values.swapaxes(1, 2))
    assert points.weights.sum() == pytest.approx(2.0 * EPS * 0.6)
    memory = state.memory[next(iter(state.memory))][:, -7:-1]
    norms = np.sort(np.linalg.norm(points.values, axis=(1, 2)))
    assert norms == pytest.approx(np.sort(np.linalg.norm(memory, axis=1)))  # Mandel's components keep it
    assert norms.max() > 0.1
    places = points.x[[3, 10]] if kind == "full" else np.column_stack([points.x[[3, 10], 0], [0.0, 0.0]])
    assert probe.internal("plastic", places, key) == pytest.approx(points.values[[3, 10]])
    refused(InputError, "unknown internal variable 'flow'; known: layer", lambda: probe.points("flow"))
    where = "does not act at" if kind == "full" else "are not on S"
    refused(InputError, where, lambda: probe.internal("plastic", [1.0, -0.31]))


def test_stress_of_an_incompressible_layer_has_its_pressure():
    """Confined, it passes the load on as a pressure, in all directions."""
    joint = sandwich(2.0, 0.5, 0.7, 0.5)
    rollers = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    structure = Structure(joint, body=BODY, supports=rollers, tractions={"TOP": (0.0, -0.3)})
    s = Probe(solve(structure.full(ThinLayer(Incompressible(2.0), EPS, at=1.0)))).stress([[0.7, 0.03], [1.3, -0.01]])
    assert s == pytest.approx(np.tile(-0.3 * np.eye(3), (2, 1, 1)), rel=1e-6, abs=1e-8)


def test_several_bodies_meet():
    joint = wall(2, 3, brick=(2.0, 1.0), h=0.5)
    structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.05, -0.1)})
    probe = Probe(solve(structure.interface(ThinLayer(K, EPS, at=1.0))))
    t_joint = [2.0, 1.0]  # two bricks below, one above
    with pytest.raises(InputError, match=r"jump at \(2, 1\): several bodies meet there; give side= and seam="):
        probe.displacement(t_joint, side="lower")
    above = probe.displacement(t_joint, side="upper", seam="BED")
    assert above == pytest.approx(probe.displacement([2.0, 1.0 + 1e-7]), rel=1e-5)
    left, right = (probe.displacement(t_joint, side=side, seam="HEAD") for side in ("lower", "upper"))
    adjacent = probe.displacement([[2.0 - 1e-7, 1.0 - 1e-7], [2.0 + 1e-7, 1.0 - 1e-7]])
    assert np.array([left, right]) == pytest.approx(adjacent, rel=1e-5)
    assert np.abs([left - right, left - above]).max(axis=1).min() > 1e-4


def test_places_that_are_none():
    structure, _, _ = uniform()
    probe = Probe(solve(structure.interface(ThinLayer(K, EPS, at=1.0))))
    meshed = Probe(solve(structure.full(ThinLayer(K, EPS, at=1.0))))
    words = r"1 of 2 places are in no cell of the mesh, the first at \(9, 9\)"
    refused(InputError, words, probe.stress, [[0.31, 0.2], [9.0, 9.0]])
    parted = Probe(solve(structure.interface(ThinLayer(K, EPS, at=1.0), bodies="extended")))
    on_s = structure.joint.points[structure.joint.surface[0]].mean(axis=0)
    refused(InputError, "half a thickness away from S", parted.displacement, on_s, side="upper")
    for wrong in ("x", [[1.0], [2.0]], [np.nan, 1.0]):
        refused(InputError, "2 finite coordinates each", probe.displacement, wrong)
    refused(InputError, "allowed: lower, upper", probe.displacement, [0.3, 0.2], side="top")
    refused(InputError, "places on S of an interface model", meshed.displacement, [0.3, 0.2], side="upper")
    refused(InputError, "known: none, as no law has any", probe.points, "plastic")
    refused(InputError, "give a state, as solve", Probe, structure)
