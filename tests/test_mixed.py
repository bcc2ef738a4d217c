"""Mixed models: the layer meshed on a part of S, replaced by its interface law on the rest."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import LinearElastic, Stack
from forms.base import InputError
from geometry import sandwich
from geometry.inflating.inflation import inflate
from tests.mixed_run import BODY, EPS, LAYER, near_ends, plane, space
from tests.refused import refused
from thinlayer import RangeWarning, Structure, Surface, ThinLayer, compare, estimate, observed_orders, solve
from thinlayer.surface.surface_mesh import most_of

SOFT = LinearElastic.shear(8.0, 0.3)  # free ends of which the law of order 1 knows
M, MU = 140.0, 40.0  # of the layer, per thickness


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("order", [0, 1])
def test_a_uniform_jump_of_stiff_bodies_passes_the_cuts(cell, order):
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 4, h_S=1 / 8, cell=cell)
    stiff = LinearElastic.young(E=1e9, nu=0.3)
    moved = Structure(joint, body=stiff, supports={"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": 0.02}})
    layer = ThinLayer(LAYER, EPS, order=order, edges="plain", at=1.0)
    model = moved.mixed(layer, where=lambda x: abs(x[0] - 0.5) < 0.2)
    state, surface = solve(model), Surface(model)
    apart = surface.jump(state) - np.reshape([0.01, 0.02], (2, 1, 1))
    assert surface.norm(apart) < 1e-6 * 0.02  # bodies strain by 1e-7
    assert state.energies()["layer"] == pytest.approx((M * 0.02**2 + MU * 0.01**2) / 2, rel=1e-6)
    if order and cell == "triangle":
        model.followers = None  # a free end at each cut gives way
        model.constraints = model._constrained()
        assert solve(model).energies()["layer"] < 0.03 * (1 - 0.01)


@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_a_uniform_jump_passes_the_cuts_of_sublayers(turned):
    """Nodes at cuts move as sublayers in series do, not linearly from face to face; also where n is no axis."""
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 4, h_S=1 / 8, cell="quadrilateral").rotated(turned)
    c, s = np.cos(turned), np.sin(turned)
    up = {"x": 0.01 * c - 0.02 * s, "y": 0.01 * s + 0.02 * c}
    moved = Structure(joint, body=LinearElastic.young(E=1e9, nu=0.3), supports={"BOTTOM": 0.0, "TOP": up})
    sublayers = (0.4, LinearElastic(60.0, 40.0)), (0.3, LinearElastic(10.0, 2.5)), (0.3, LinearElastic(30.0, 45.0))
    layer = ThinLayer(Stack(*sublayers), EPS, order=1, edges="plain", at=1.0)
    state = solve(moved.mixed(layer, where=lambda x: abs(c * x[0] + s * x[1] - 0.5) < 0.2, cells_through=10))
    energy = 0.02**2 / (2 * sum(a / (m.lmbda + 2 * m.mu) for a, m in sublayers))
    energy += 0.01**2 / (2 * sum(a / m.mu for a, m in sublayers))
    assert state.energies()["layer"] == pytest.approx(energy, rel=1e-6)  # straight between the faces: 6 % too much


@cache
def blocks(eps):
    joint = sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 8, cell="quadrilateral")
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})


@cache
def meshed(eps):
    return solve(blocks(eps).full(ThinLayer(LAYER, eps, at=1.0), cells_through=8))


def errors(eps, model):
    full, state = meshed(eps), solve(model)
    inner, all_of_it = compare(full, state, where=lambda x: abs(x[0] - 0.5) < 0.25), compare(full, state)
    work = abs(state.energies()["loads"] / full.energies()["loads"] - 1)
    return np.array([inner["error_traction"], inner["error_jump"], work, all_of_it["error_traction"]])


def mixed(eps, thicknesses, order=1):
    return blocks(eps).mixed(
        ThinLayer(LAYER, eps, order=order, at=1.0),
        where=lambda x: abs(x[0] - 0.5) > 0.5 - thicknesses * eps,
        cells_through=8,
    )


def test_errors_are_of_order_two_where_the_free_ends_are_meshed_and_tractions_at_the_ends_are_known():
    some = [1 / 16, 1 / 32]
    found = np.array([errors(eps, mixed(eps, 2)) for eps in some])
    law = np.array(
        [errors(eps, blocks(eps).interface(ThinLayer(LAYER, eps, order=1, edges="plain", at=1.0))) for eps in some]
    )
    for k in range(3):  # traction, jump, work: 1.9, 2.1, 1.8; of the law alone 0.8, 0.8, 0.7
        assert observed_orders(some, found[:, k])[-1] > 1.7
        assert observed_orders(some, law[:, k])[-1] < 1.1
    assert (found[:, 3] < law[:, 3] / 9).all()  # 2e-3 against 2e-2, at the singular corners
    loose = mixed(1 / 32, 2)
    loose.followers = None
    loose.constraints = loose._constrained()
    assert (errors(1 / 32, loose) > 10 * found[1]).all()


def test_cuts_too_near_the_end_or_a_law_of_order_0_are_worse():
    two = errors(1 / 32, mixed(1 / 32, 2))
    with pytest.warns(RangeWarning, match="meshed over 0.45 thicknesses at its free end"):
        near = mixed(1 / 32, 0.5)
    assert (errors(1 / 32, near) > 3 * two).all()
    assert (errors(1 / 32, mixed(1 / 32, 2, order=0)) > 5 * two).all()


def test_a_layer_that_is_meshed_everywhere_is_that_of_the_full_model():
    full, mixed = (
        solve(model)
        for model in (
            plane("triangle").full(ThinLayer(LAYER, EPS, at=1.0)),
            plane("triangle").mixed(ThinLayer(LAYER, EPS, at=1.0), where=lambda x: x[0] > -1),
        )
    )
    assert mixed.energies()["loads"] == pytest.approx(full.energies()["loads"], rel=1e-12)
    assert mixed.model.followers is None


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_in_space_with_rollers_on_the_cuts_forces_and_energies_balance(cell):
    structure, layer = space(cell), ThinLayer(LAYER, EPS, order=1, at=1.0)
    full, law = solve(structure.full(layer, cells_through=2)), solve(structure.interface(replace(layer, edges="plain")))
    state = solve(structure.mixed(layer, where=near_ends, cells_through=2))
    held = sum(one.force for one in state.reactions_by_place().values())
    energies = state.energies()
    assert held == pytest.approx(-state.applied().force, abs=1e-12)
    assert 2 * (energies["bodies"] + energies["layer"]) == pytest.approx(energies["loads"], rel=1e-11)
    ours, theirs = (compare(full, one) for one in (state, law))
    assert ours["error_jump"] < theirs["error_jump"] / 2
    assert ours["error_traction"] < theirs["error_traction"] / 1.5


def test_other_layers_and_loads_share_the_mesh():
    model = mixed(1 / 16, 2)
    other = ThinLayer(LinearElastic.shear(20.0, 0.2), 1 / 16, order=1, at=1.0)
    again = solve(model.with_layer(other))
    new = solve(blocks(1 / 16).mixed(other, where=model.meshed, cells_through=8))
    assert again.energies()["loads"] == pytest.approx(new.energies()["loads"], rel=1e-11)
    twice = solve(model.with_loads(tractions={"TOP": (0.6, -2.0)}))
    assert twice.energies()["loads"] == pytest.approx(4 * solve(model).energies()["loads"], rel=1e-11)


def test_the_fewest_facets_hold_all_but_a_share():
    assert most_of(np.array([1.0, 4.0, 0.0, 2.0, 3.0]), 0.1).tolist() == [False, True, False, True, True]
    assert most_of(np.array([1.0, 4.0, 0.0, 2.0, 3.0]), 0.09).tolist() == [True, True, False, True, True]
    model = plane("triangle").interface(ThinLayer(LAYER, EPS, at=1.0))
    surface = Surface(model)
    x = surface.x
    joint = model.joint
    places = joint.points[joint.surface].mean(axis=1)[:, 0]
    most = surface.most_of(-x[0], 1 / 4)  # all but a quarter of the integral of x lies right of 1/2
    assert (most == (places > 0.5)).all()
    wider = surface.most_of(-x[0], 1 / 4, margin=0.1)
    assert (wider == (places > 0.4)).all()
    refused(InputError, "all_but is 1", lambda: surface.most_of(x[0], 1))
    refused(InputError, "the integral over S is 0", lambda: surface.most_of(0 * x[0], 0.1))


def test_the_map_of_an_estimate_tells_where_to_mesh():
    eps = 1 / 16
    found = estimate(solve(blocks(eps).interface(ThinLayer(LAYER, eps, at=1.0))))
    where = Surface(found.better.model).most_of(found.density(), 0.1, margin=eps)
    joint = blocks(eps).joint
    places = joint.points[joint.surface].mean(axis=1)[:, 0]
    assert where[places > 1 - eps].all()
    assert not where.all()
    model = blocks(eps).mixed(ThinLayer(LAYER, eps, order=1, at=1.0), where=where, cells_through=8)
    law = errors(eps, blocks(eps).interface(ThinLayer(LAYER, eps, order=1, edges="plain", at=1.0)))
    assert (errors(eps, model) < law / [3, 3, 3, 1.2]).all()


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
        refused(InputError, what, inflate, joint, EPS, meshed=wrong)


@pytest.mark.parametrize(
    ("layer", "where", "message"),
    [
        (ThinLayer(LAYER, EPS, at=1.0), lambda x: x[0] > 2, "no part of the layer is meshed"),
        (ThinLayer(LAYER, EPS, at=1.0), lambda x: x[0], "must say for each of the 16 facets"),
        (ThinLayer(LAYER, EPS, at=1.0), lambda x: x.nothing, "no numpy function of places"),
    ],
)
def test_what_cannot_be_mixed_is_refused(layer, where, message):
    refused(InputError, message, lambda: plane("triangle").mixed(layer, where=where))
