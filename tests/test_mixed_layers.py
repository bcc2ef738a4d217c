"""Mixed models of layers that remember, of walls, of curved and of heated layers."""

from __future__ import annotations

import numpy as np
import pytest

from forms import KelvinVoigt, LinearElastic, Norton, VonMises
from forms.base import InputError
from geometry import ring, sandwich
from tests.mixed_run import BODY, BRICKS, EPS, LAYER, bricks, mortar, near_ends, near_junctions, on_base
from thinlayer import Structure, ThinLayer, compare, march, solve

pytestmark = pytest.mark.few(5)


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
    layer = ThinLayer(law, EPS, order=order, edges="plain", at=1.0)
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
    layer = ThinLayer(law, eps, order=1, edges="plain", at=1.0)
    near = pressed.mixed(layer, where=lambda x: abs(x[0] - 0.5) > 0.5 - 3 * eps)
    full, mixed, law = (march(model, [1.0]).last for model in (pressed.full(layer), near, pressed.interface(layer)))
    yields = {name: memory[:, -1].max() > 0 for name, memory in mixed.memory.items()}
    assert yields == {"layer": True, "layer 1/law": False, "layer 2/law": False}
    assert compare(full, mixed)["error_jump"] < compare(full, law)["error_jump"] / 10


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
    with pytest.raises(InputError, match="the facets of S there need cells"):
        structure.mixed(mortar(1), where=lambda x: x[0] > joint.points[:, 0].mean() + 0.1)


@pytest.mark.parametrize("profile", [None, lambda x: 1 + 0.3 * x[0]], ids=["uniform", "varying"])
def test_curved_layers_of_a_thickness_that_varies_between_bodies_at_their_true_places(profile):
    joint = ring(0.6, 1.0, 1.5, h=0.15, angle=np.pi / 2, cell="quadrilateral", degree=2)
    pulled = {"OUTSIDE": lambda x, t: (0.5 * x[0] * x[1], 1 + x[1])}
    structure, eps = Structure(joint, body=BODY, supports={"INSIDE": 0.0}, tractions=pulled), 1 / 16
    layer = ThinLayer(LAYER, eps, order=1, profile=profile, at=1.0)
    near = structure.mixed(layer, where=lambda x: np.minimum(x[0], x[1]) < 3 * eps, bodies="extended")
    full, law = structure.full(layer, bodies="extended"), structure.interface(layer, bodies="extended")
    full, mixed, law = (solve(model) for model in (full, near, law))

    def away(x):
        return (x[0] > 0.35) & (x[1] > 0.35)

    ours, theirs = (compare(full, state, where=away) for state in (mixed, law))
    assert ours["error_traction"] < theirs["error_traction"] / 2  # of means through the layer; of reactions a third
    assert ours["error_jump"] < theirs["error_jump"] / 4


def test_eigenstrains_of_layers_act_on_cells_and_by_the_law():
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 8, h_S=1 / 16, cell="triangle")
    layer = ThinLayer(LAYER, 1 / 16, order=1, eigenstrain=lambda x, t: 0.01 * (1 + t), at=1.0)
    for supports in ({"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}, {"BOTTOM": 0.0}):
        structure = Structure(joint, body=BODY, supports=supports)
        near = structure.mixed(layer, where=lambda x: abs(x[0] - 0.5) > 0.3)
        full, mixed = (march(model, [1.0]).last for model in (structure.full(layer), near))
        assert mixed.energies()["layer"] == pytest.approx(full.energies()["layer"], rel=1e-4)  # 1e-15, 1e-5
        assert abs(mixed.audit.imbalance) < 1e-12


@pytest.mark.few(5)
@pytest.mark.parametrize("bodies", ["kept", "extended"])
def test_a_layer_on_a_rigid_base_whose_law_and_cells_hold_the_body_together(bodies):
    structure, layer = on_base(), ThinLayer(LAYER, EPS, order=1, edges="plain", at=1.0)
    near = structure.mixed(layer, where=near_ends, bodies=bodies)
    full, law = structure.full(layer, bodies=bodies), structure.interface(layer, bodies=bodies)
    full, mixed, law = (solve(model) for model in (full, near, law))
    assert mixed.reaction("S").force == pytest.approx([-0.3, 1.0], rel=1e-10)
    ours, theirs = (compare(full, state) for state in (mixed, law))
    assert ours["error_traction"] < theirs["error_traction"] / 5
    assert ours["error_jump"] < theirs["error_jump"] / 5
