"""Mixed models: the layer meshed on a part of S, replaced by its interface law on the rest."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import ufl

from forms import Incompressible, KelvinVoigt, LinearElastic, Norton, VonMises
from geometry import GeometryError, ring, sandwich
from geometry.inflating.inflation import inflate
from tests.mixed_run import BODY, BRICKS, EPS, LAYER, bricks, mortar, near_ends, near_junctions, numbers, plane, space
from tests.ranks import mpirun
from thinlayer import ModelError, Structure, Surface, ThinLayer, compare, estimate, march, observed_orders, solve
from thinlayer.output.concentration import most_of

M, MU = 140.0, 40.0  # of the layer, per thickness


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("order", [0, 1])
def test_a_uniform_jump_of_stiff_bodies_passes_the_cuts(cell, order):
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 4, h_S=1 / 8, cell=cell)
    stiff = LinearElastic.young(E=1e9, nu=0.3)
    moved = Structure(joint, body=stiff, supports={"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": 0.02}})
    layer = ThinLayer(LAYER, EPS, order=order, edges="plain")
    model = moved.mixed(layer, where=lambda x: abs(x[0] - 0.5) < 0.2)
    state, surface = solve(model), Surface(model)
    apart = surface.jump(state) - ufl.as_vector([0.01, 0.02])
    assert surface.norm(apart) < 1e-6 * 0.02  # bodies strain by 1e-7
    assert state.energies()["layer"] == pytest.approx((M * 0.02**2 + MU * 0.01**2) / 2, rel=1e-6)
    if order and cell == "triangle":
        model.followers = None  # a free end at each cut gives way
        assert solve(model).energies()["layer"] < 0.03 * (1 - 0.01)


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize(
    ("law", "theta"),
    [
        (VonMises(60.0, 40.0, strength=0.3, hardening=5.0), 1.0),
        (Norton(60.0, 40.0, 5.0, 1.5), 0.5),
        (KelvinVoigt(60.0, 40.0, 6.0, 4.0), 0.5),
    ],
    ids=["yields", "creeps", "in forms"],
)
def test_laws_that_are_not_linear_and_remember_pass_the_cuts(law, order, theta):
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 4, h_S=1 / 8, cell="quadrilateral")
    top = {"x": lambda x, t: 0.01 * t, "y": lambda x, t: -0.005 * t}
    moved = Structure(joint, body=LinearElastic.young(E=1e8, nu=0.3), supports={"BOTTOM": 0.0, "TOP": top})
    layer = ThinLayer(law, EPS, order=order, edges="plain")
    mixed, law = (
        march(model, [0.4, 1.0], theta=theta).last
        for model in (moved.mixed(layer, where=lambda x: abs(x[0] - 0.5) < 0.2), moved.interface(layer))
    )
    for name in ("stored", "dissipated", "supplied"):  # bodies have 1e-6 of them
        ours, theirs = (getattr(state.audit, name) for state in (mixed, law))
        assert ours == pytest.approx(theirs, rel=1e-5, abs=1e-9), name
    assert mixed.reaction("TOP").force == pytest.approx(law.reaction("TOP").force, rel=1e-5)
    assert mixed.energies()["layer"] == pytest.approx(law.energies()["layer"], rel=1e-5)


def test_a_layer_that_yields_at_its_free_ends_alone_is_followed_there():
    eps, law = 1 / 16, VonMises(60.0, 40.0, strength=1.2, hardening=4.0)
    joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 16, h_ends=eps / 4, cell="quadrilateral")
    load = {"TOP": lambda x, t: (0.3 * t, -t)}
    pressed = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions=load)
    layer = ThinLayer(law, eps, order=1, edges="plain")
    near = pressed.mixed(layer, where=lambda x: abs(x[0] - 0.5) > 0.5 - 3 * eps)
    full, mixed, law = (march(model, [1.0]).last for model in (pressed.full(layer), near, pressed.interface(layer)))
    yields = {name: memory[:, -1].max() > 0 for name, memory in mixed.memory.items()}
    assert yields == {"layer": True, "layer 1/law": False, "layer 2/law": False}
    assert compare(full, mixed)["error_jump"] < compare(full, law)["error_jump"] / 10


@cache
def blocks(eps):
    joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 8, cell="quadrilateral")
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})


@cache
def meshed(eps):
    return solve(blocks(eps).full(ThinLayer(LAYER, eps), cells_through=8))


def errors(eps, model):
    full, state = meshed(eps), solve(model)
    inner, all_of_it = compare(full, state, where=lambda x: abs(x[0] - 0.5) < 0.25), compare(full, state)
    work = abs(state.energies()["loads"] / full.energies()["loads"] - 1)
    return np.array([inner["error_traction"], inner["error_jump"], work, all_of_it["error_traction"]])


def mixed(eps, thicknesses, order=1):
    return blocks(eps).mixed(
        ThinLayer(LAYER, eps, order=order), where=lambda x: abs(x[0] - 0.5) > 0.5 - thicknesses * eps, cells_through=8
    )


def test_errors_are_of_order_two_where_the_free_ends_are_meshed_and_tractions_at_the_ends_are_known():
    some = [1 / 16, 1 / 32]
    found = np.array([errors(eps, mixed(eps, 2)) for eps in some])
    law = np.array([errors(eps, blocks(eps).interface(ThinLayer(LAYER, eps, order=1, edges="plain"))) for eps in some])
    for k in range(3):  # traction, jump, work: 1.9, 2.1, 1.8; of the law alone 0.8, 0.8, 0.7
        assert observed_orders(some, found[:, k])[-1] > 1.7
        assert observed_orders(some, law[:, k])[-1] < 1.1
    assert (found[:, 3] < law[:, 3] / 15).all()  # 3e-3 against 6e-2, at the singular corners
    loose = mixed(1 / 32, 2)
    loose.followers = None
    assert (errors(1 / 32, loose) > 10 * found[1]).all()


def test_cuts_too_near_the_end_or_a_law_of_order_0_are_worse():
    two = errors(1 / 32, mixed(1 / 32, 2))
    assert (errors(1 / 32, mixed(1 / 32, 0.5)) > 3 * two).all()
    assert (errors(1 / 32, mixed(1 / 32, 2, order=0)) > 5 * two).all()


def test_a_layer_that_is_meshed_everywhere_is_that_of_the_full_model():
    full, mixed = (
        solve(model)
        for model in (
            plane("triangle").full(ThinLayer(LAYER, EPS)),
            plane("triangle").mixed(ThinLayer(LAYER, EPS), where=lambda x: x[0] > -1),
        )
    )
    assert mixed.energies()["loads"] == pytest.approx(full.energies()["loads"], rel=1e-12)
    assert mixed.model.followers is None


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_in_space_with_rollers_on_the_cuts_forces_and_energies_balance(cell):
    structure, layer = space(cell), ThinLayer(LAYER, EPS, order=1)
    full, law = solve(structure.full(layer, cells_through=2)), solve(structure.interface(replace(layer, edges="plain")))
    state = solve(structure.mixed(layer, where=near_ends, cells_through=2))
    held = sum(one.force for one in state.reactions_by_place().values())
    energies = state.energies()
    assert held == pytest.approx(-state.applied().force, abs=1e-12)
    assert 2 * (energies["bodies"] + energies["layer"]) == pytest.approx(energies["loads"], rel=1e-11)
    ours, theirs = (compare(full, one) for one in (state, law))
    assert ours["error_jump"] < theirs["error_jump"] / 2
    assert ours["error_traction"] < theirs["error_traction"] / 1.5


def test_a_wall_with_meshed_junctions_and_laws_of_order_1_between_them():
    structure = bricks(1 / 16)
    full = solve(structure.full(mortar(0), cells_through=4))
    where = near_junctions(structure, 2.5 * BRICKS)
    models = [structure.interface(mortar(0)), *(structure.mixed(mortar(k), where=where) for k in (0, 1))]
    assert models[2].meshed.mean() < 0.8
    law, mixed_0, mixed_1 = (solve(model) for model in models)
    rows = [compare(full, state) for state in (law, mixed_0, mixed_1)]
    traction, jump = ([row[f"error_{name}"] for row in rows] for name in ("traction", "jump"))
    assert traction[2] < 6e-3 < 2e-2 < traction[1] < traction[0]
    assert jump[2] < 2e-3 < 2e-2 < jump[1] < jump[0]  # 1.4e-2 at order 1 if posts of the layer were upright
    for name in ("layer BED", "layer HEAD"):
        true, found = full.energies()[name], mixed_1.energies()[name]
        assert found == pytest.approx(true, rel=5e-3), name
    joint = structure.joint
    with pytest.raises(GeometryError, match="the facets of S there need cells"):
        structure.mixed(mortar(1), where=lambda x: x[0] > joint.points[:, 0].mean() + 0.1)


@pytest.mark.parametrize("profile", [None, lambda x: 1 + 0.3 * x[0]], ids=["uniform", "varying"])
def test_curved_layers_of_a_thickness_that_varies_between_bodies_at_their_true_places(profile):
    joint = ring(0.6, 1.0, 1.5, h=0.15, angle=np.pi / 2, cell="quadrilateral", degree=2)
    pulled = {"OUTSIDE": lambda x, t: (0.5 * x[0] * x[1], 1 + x[1])}
    structure, eps = Structure(joint, body=BODY, supports={"INSIDE": 0.0}, tractions=pulled), 1 / 16
    layer = ThinLayer(LAYER, eps, order=1, profile=profile)
    near = structure.mixed(layer, where=lambda x: np.minimum(x[0], x[1]) < 3 * eps, bodies="extended")
    full, law = structure.full(layer, bodies="extended"), structure.interface(layer, bodies="extended")
    full, mixed, law = (solve(model) for model in (full, near, law))

    def away(x):
        return ufl.And(x[0] > 0.35, x[1] > 0.35)

    ours, theirs = (compare(full, state, where=away) for state in (mixed, law))
    assert ours["error_traction"] < theirs["error_traction"] / 3
    assert ours["error_jump"] < theirs["error_jump"] / 4


def test_eigenstrains_of_layers_act_on_cells_and_by_the_law():
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 8, h_S=1 / 16, cell="triangle")
    layer = ThinLayer(LAYER, 1 / 16, order=1, eigenstrain=lambda x, t: 0.01 * (1 + t))
    for supports in ({"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}, {"BOTTOM": 0.0}):
        structure = Structure(joint, body=BODY, supports=supports)
        near = structure.mixed(layer, where=lambda x: abs(x[0] - 0.5) > 0.3)
        full, mixed = (march(model, [1.0]).last for model in (structure.full(layer), near))
        assert mixed.energies()["layer"] == pytest.approx(full.energies()["layer"], rel=1e-4)  # 1e-15, 1e-5
        assert abs(mixed.audit.imbalance) < 1e-12


def test_other_layers_and_loads_share_the_mesh():
    model = mixed(1 / 16, 2)
    other = ThinLayer(LinearElastic.shear(20.0, 0.2), 1 / 16, order=1)
    again = solve(model.with_layer(other))
    new = solve(blocks(1 / 16).mixed(other, where=model.meshed, cells_through=8))
    assert again.energies()["loads"] == pytest.approx(new.energies()["loads"], rel=1e-11)
    twice = solve(model.with_loads(tractions={"TOP": (0.6, -2.0)}))
    assert twice.energies()["loads"] == pytest.approx(4 * solve(model).energies()["loads"], rel=1e-11)


def test_the_fewest_facets_hold_all_but_a_share():
    assert most_of(np.array([1.0, 4.0, 0.0, 2.0, 3.0]), 0.1).tolist() == [False, True, False, True, True]
    assert most_of(np.array([1.0, 4.0, 0.0, 2.0, 3.0]), 0.09).tolist() == [True, True, False, True, True]
    model = plane("triangle").interface(ThinLayer(LAYER, EPS))
    surface = Surface(model)
    x = ufl.SpatialCoordinate(model.domain.mesh)("+")
    joint = model.joint
    places = joint.points[joint.surface].mean(axis=1)[:, 0]
    most = surface.most_of(-x[0], 1 / 4)  # all but a quarter of the integral of x lies right of 1/2
    assert (most == (places > 0.5)).all()
    wider = surface.most_of(-x[0], 1 / 4, margin=0.1)
    assert (wider == (places > 0.4)).all()
    with pytest.raises(ModelError, match="all_but is 1"):
        surface.most_of(x[0], 1)
    with pytest.raises(ModelError, match="the integral over S is 0"):
        surface.most_of(0 * x[0], 0.1)


def test_the_map_of_an_estimate_tells_where_to_mesh():
    eps = 1 / 16
    found = estimate(solve(blocks(eps).interface(ThinLayer(LAYER, eps))))
    where = Surface(found.better.model).most_of(found.map(), 0.1, margin=eps)
    joint = blocks(eps).joint
    places = joint.points[joint.surface].mean(axis=1)[:, 0]
    assert where[places > 1 - eps].all()
    assert not where.all()
    model = blocks(eps).mixed(ThinLayer(LAYER, eps, order=1), where=where, cells_through=8)
    law = errors(eps, blocks(eps).interface(ThinLayer(LAYER, eps, order=1, edges="plain")))
    assert (errors(eps, model) < law / 3).all()


def test_facets_without_cells_leave_the_thickness_empty():
    joint = plane("triangle").joint
    places = joint.points[joint.surface].mean(axis=1)
    opened = inflate(joint, EPS, meshed=places[:, 0] < 0.5)
    x = opened.points[opened.facets["LAYER/CUT"]]
    assert x[..., 0] == pytest.approx(0.5)
    assert np.ptp(x[..., 1]) == pytest.approx(EPS)
    assert len(opened.facets["LAYER/CUT"]) == 4
    assert "RIGHT/LAYER" not in opened.facets
    for wrong, what in ((np.ones(3, bool), "needs 16 truth values"), (np.zeros(16, bool), "no facet of S gets cells")):
        with pytest.raises(GeometryError, match=what):
            inflate(joint, EPS, meshed=wrong)


@pytest.mark.parametrize(
    ("layer", "where", "message"),
    [
        (ThinLayer(LAYER, EPS), lambda x: x[0] > 2, "no part of the layer is meshed"),
        (ThinLayer(LAYER, EPS), lambda x: x[0], "must say for each of the 16 facets"),
        (ThinLayer(LAYER, EPS), lambda x: x.nothing, "no numpy function of places"),
        (ThinLayer(Incompressible(40.0), EPS), near_ends, "which has a pressure"),
        (LAYER, near_ends, "a ThinLayer on each seam"),
    ],
)
def test_what_cannot_be_mixed_is_refused(layer, where, message):
    with pytest.raises(ModelError, match=message):
        plane("triangle").mixed(layer, where=where)


def test_two_ranks_have_the_same_numbers():
    here = numbers()
    run = mpirun(2, "tests/mixed_run.py")
    assert run.returncode == 0, run.stderr
    there = json.loads(run.stdout)
    for name, value in here.items():
        assert there[name] == pytest.approx(value, rel=1e-10, abs=1e-12), name
