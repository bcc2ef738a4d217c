"""Bonds: seams without a layer beside others with one; which of several layers may be dropped, and which ignored."""

from dataclasses import replace

import numpy as np
import pytest

from forms import HolonomicCoulomb, LinearElastic
from forms.base import InputError
from geometry import sandwich
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Bond, Structure, Surface, ThinLayer, estimate, goals, solve, thin_enough

WIDTH, LEVELS = 2.0, (0.5, 1.25)  # of the seams above the lower side; the height is 2
STEEL = LinearElastic(70.0, 40.0)
PRESSED = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
LAYERS = {"LOW": ThinLayer(LinearElastic(1.1, 0.6), 0.03), "HIGH": ThinLayer(LinearElastic(0.7, 0.9), 0.02)}


def three_bodies(*names: str) -> Joint:
    """Three bodies upon each other, of which those seams are named that are wanted."""
    joint = sandwich(WIDTH, 1.0, 1.0, 0.25, structured=True)
    table = FacetTable.of(joint.corners, joint.cell_type)
    y = joint.points[table.vertices][..., 1] - joint.points[:, 1].min()
    levels = dict(zip(LAYERS, LEVELS, strict=True))
    facets = {name: table.vertices[(np.abs(y - levels[name]) < 1e-9).all(axis=1)] for name in names}
    kept = {name: facets for name, facets in joint.facets.items() if name != "S"}
    return replace(joint, facets=kept | facets, seams={name: Seam(direction=(0.0, 1.0)) for name in names})


def loaded(joint: Joint, supports=PRESSED, traction=(0.0, -0.3), **more) -> Structure:
    return Structure(joint, body=STEEL, supports=supports, tractions={"TOP": traction}, **more)


@pytest.mark.parametrize("law", [LAYERS["LOW"], HolonomicCoulomb(9.0, 4.0, friction=0.4)])
def test_a_bond_is_a_seam_that_is_not_there(law):
    twisted = {"element": "P1" if law is not LAYERS["LOW"] else "P2", "supports": {"BOTTOM": 0.0}}
    twisted["traction"] = lambda x, t: (0.02, -0.3 - 0.1 * x[0])
    bonded = solve(loaded(three_bodies("LOW", "HIGH"), **twisted).interface({"LOW": law, "HIGH": Bond()}))
    without = solve(loaded(three_bodies("LOW"), **twisted).interface({"LOW": law}))
    assert bonded.model.V.dofmap.index_map.size_global == without.model.V.dofmap.index_map.size_global
    assert bonded.energies()["bodies"] == pytest.approx(without.energies()["bodies"], rel=1e-8)
    here, there = (Surface(state.model, "LOW") for state in (bonded, without))
    assert np.allclose(here.traction(bonded), there.traction(without), rtol=0, atol=1e-7)
    high = Surface(bonded.model, "HIGH")
    assert np.abs(high.jump(bonded)).max() < 1e-14
    assert high.integral(high.traction(bonded)) == pytest.approx([0.02 * WIDTH, -0.4 * WIDTH], rel=1e-10)
    assert high.traction(bonded) == pytest.approx(high.reaction(bonded), abs=1e-12)


def test_a_rigid_base_holds_what_is_bonded_to_it():
    joint = three_bodies("LOW")
    facets = joint.facets | {"FOOT": joint.facets["BOTTOM"]}
    based = replace(joint, facets=facets, seams=dict(joint.seams) | {"FOOT": Seam()})
    sides = {"LEFT": {"x": 0.0}}
    bonded = solve(loaded(based, sides).interface({"LOW": LAYERS["LOW"], "FOOT": Bond()}))
    supported = solve(loaded(joint, sides | {"BOTTOM": 0.0}).interface({"LOW": LAYERS["LOW"]}))
    assert bonded.energies()["bodies"] == pytest.approx(supported.energies()["bodies"], rel=1e-10)


def test_meshed_models_and_other_bonds_are_refused():
    structure = loaded(three_bodies("LOW", "HIGH"))
    refused(InputError, "'HIGH' has a Bond, for interface models", lambda: structure.full(LAYERS | {"HIGH": Bond()}))
    model = structure.interface(LAYERS | {"HIGH": Bond()})
    refused(InputError, r"bonds on the seams \['HIGH'\], not \[\]", model.with_layer, LAYERS)
    refused(InputError, "same element and bonds", lambda: solve(structure.interface(LAYERS), like=solve(model)))
    with pytest.raises(InputError, match="what was left out at bonds, for these and no others: HIGH"):
        estimate(solve(model), {"LOW": LAYERS["LOW"]})
    refused(InputError, "known: HIGH, LOW", thin_enough, structure, LAYERS, 0.01)


def closing(layer: ThinLayer) -> float:
    """Compliance of a layer in uniaxial strain."""
    law = layer.law
    return layer.eps / (law.lmbda + 2 * law.mu)


BODIES = 2.0 / (STEEL.lmbda + 2 * STEEL.mu)


def ignored() -> dict[str, list[float]]:
    """Of each layer: relative change of the compliance as it is ignored beside the other one, and its part beside none."""
    structure, changes = loaded(three_bodies("LOW", "HIGH"), traction=lambda x, t: (0.0, -0.6 * t)), {}
    both = estimate(solve(structure.bonded(), 0.5), LAYERS)
    parts = both.by_seam()
    assert sum(parts.values()) == pytest.approx(both.goals["compliance"].change, rel=1e-9)
    for name, layer in LAYERS.items():
        alone = estimate(solve(structure.interface(LAYERS | {name: Bond()}), 0.5), layer, seam=name)
        assert str(alone).startswith(f"perfect bond of {name}, order 0: ")
        assert [*alone.layers] == [name]
        changes[name] = [alone.goals["compliance"].relative, parts[name]]
    return changes


@on_ranks(ignored, 2)
def test_which_of_two_layers_may_be_ignored(there):
    """Uniaxial strain: a layer left out takes its share of the compliance with it."""
    whole = BODIES + sum(map(closing, LAYERS.values()))
    for changes in (ignored(), there):
        for name, layer in LAYERS.items():
            assert changes[name] == pytest.approx([closing(layer) / whole, WIDTH * 0.09 * closing(layer)], rel=1e-6)


def test_thickness_of_a_layer_beside_another_one():
    """The layer LOW may be ignored up to c of the compliance: eps/M = c/(1 - c) of the rest."""
    structure, share = loaded(three_bodies("LOW", "HIGH")), 0.2
    result = thin_enough(structure, LAYERS, share, goals.Compliance(), seam="LOW", bonded=True)
    bent = loaded(three_bodies("LOW", "HIGH"), {"BOTTOM": 0.0})
    rows = thin_enough(bent, LAYERS, 0.9, seam="LOW").table
    layers = LAYERS | {"LOW": ThinLayer(LAYERS["LOW"].material, rows["eps"][-1])}
    alone = estimate(solve(bent.interface(layers)), seam="LOW")
    assert rows["error"][-1] == pytest.approx(alone.traction, rel=1e-6)  # that of the layer HIGH does not count
    rest = BODIES + closing(LAYERS["HIGH"])
    assert result.eps == pytest.approx(share / (1 - share) * rest * closing(LAYERS["LOW"]) ** -1 * 0.03, rel=0.02)
