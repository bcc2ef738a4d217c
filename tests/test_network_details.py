"""Networks seen closely: contact reports where bodies branch, rate laws, loads on seams, gaps on a base, cells."""

from dataclasses import replace

import numpy as np
import pytest

from forms import Incompressible, LinearElastic, Maxwell
from forms.base import InputError
from geometry import bond_cell, periodic, sandwich, wall
from geometry.seam import Seam
from tests.contact_bars import contact
from tests.dry_walls import dry_wall
from tests.meshes import renumbered
from tests.network_cases import BED, HEAD, pushed, springs, three_bricks
from tests.refused import refused
from thinlayer import (
    Gap,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    homogenised_stiffness,
    plotting,
    solve,
)

ROCK = LinearElastic.young(20.0, 0.2)


def on_a_base():
    """Two glued plates; the lower one stands on a seam of its own."""
    joint = sandwich(8.0, 4.0, 4.0, 1.0, cell="quadrilateral")
    facets = {"GLUE" if name == "S" else name: rows for name, rows in joint.facets.items()}
    return replace(joint, facets=facets, seams={"GLUE": joint.seams["S"], "BOTTOM": Seam()})


# ---------------------------------------------------------------- contact reports
def test_zones_of_contact_go_on_where_bodies_branch():
    """A bed that sticks everywhere is one zone, also under the head that ends on it, and its two pieces are curves."""
    state = pushed(three_bricks(4, "triangle"), 0.6, {"BED": BED, "HEAD": HEAD})
    bed = Surface(state.model, "BED").contact(state)
    assert bed.counts["stick"] == 18
    assert [(zone.status, zone.nodes) for zone in bed.zones] == [("stick", 18)]
    assert bed.zones[0].size == pytest.approx(2.0, rel=1e-12)
    lines = bed.surface.along(bed.p)
    assert [len(line.s) for line in lines] == [18]  # where the head ends there are two
    assert sum(line.length for line in lines) == pytest.approx(2.0, rel=1e-12)
    assert np.diff(bed.x[:, 0]).min() > -1e-12
    other = contact(pushed(renumbered(three_bricks(4, "triangle")), 0.6, {"BED": BED, "HEAD": HEAD}), "BED")
    assert [zone.nodes for zone in other.zones] == [18]
    assert other.p == pytest.approx(bed.p, rel=1e-9)


@pytest.fixture(scope="module")
def pushed_wall():
    """Two beds, one above the other, brick by brick; the upper one slides first where bricks have a weight."""
    return solve(dry_wall(bricks=2, courses=3, h=0.25, weight=0.1), 0.5)


def test_a_bed_of_several_bricks_is_one_way(pushed_wall):
    bed = Surface(pushed_wall.model, "BED").contact(pushed_wall)
    assert [len(line.s) for line in bed.surface.along(bed.p)] == [12, 12]
    assert bed.x[:, 1].tolist() == [0.5] * 12 + [1.0] * 12  # one bed after the other
    assert np.diff(bed.x[:12, 0]).min() == np.diff(bed.x[12:, 0]).min() == 0.0
    tractions, *_ = plotting.along(bed.surface, bed).axes
    starts = [line.get_xdata()[0] for line in tractions.lines if len(line.get_xdata()) == 12]
    assert starts == pytest.approx([0.0, 2.0])  # one bed after the other


# ---------------------------------------------------------------- loads
def test_loads_on_a_seam_are_refused():
    joint, layer = on_a_base(), springs(3.0, 1.3)

    def made(**data):
        return Structure(joint, body=ROCK, **({"supports": {}} | data)).interface(layer)

    for what, data in (
        ("support on 'BOTTOM'", dict(supports={"BOTTOM": {"x": 0.1}})),
        ("support on 'GLUE'", dict(supports={"GLUE": {"x": 0.1}})),
        ("traction on 'BOTTOM'", dict(tractions={"BOTTOM": (0.3, 0.0)})),
        ("springs on 'BOTTOM'", dict(parts=[Springs("BOTTOM", normal=2.0)])),
    ):
        refused(InputError, f"{what}: its facets lie inside, or below a layer", made, **data)
    bricks, loads = wall(2, 2, (1.0, 0.5), 0.25), {"BED/LOWER_FACE": (0.1, -1.0)}
    meshed = Structure(bricks, body=ROCK, supports={"BOTTOM": 0.0}, tractions=loads)
    refused(InputError, "traction on 'BED/LOWER_FACE': its facets lie inside", meshed.full, springs(3.0, 1.3))


# ---------------------------------------------------------------- gaps
def test_a_gap_on_a_rigid_base():
    """It is empty: the meshed model has the energies of one that does not know the base."""
    joint, glue = on_a_base(), springs(5.0, 2.1, 0.001)
    slab = Structure(joint, body=ROCK, supports={"LEFT/LOWER": 0.0}, tractions={"TOP": (0.1, -0.2)})
    layers = {"GLUE": glue, "BOTTOM": Gap(1e-6)}
    full, limit = (solve(model).energies() for model in (slab.full(layers, bodies="extended"), slab.interface(layers)))
    joint, loads = sandwich(8.0, 4.0, 4.0, 1.0, cell="quadrilateral"), {"TOP": (0.1, -0.2)}
    alone = Structure(joint, body=ROCK, supports={"LEFT/LOWER": 0.0}, tractions=loads)
    assert full["layer"] == pytest.approx(limit["layer"], rel=1e-3)  # the glue has a thickness
    assert full["bodies"] == pytest.approx(solve(alone.full(glue, bodies="extended")).energies()["bodies"], rel=1e-5)


# ---------------------------------------------------------------- cells


def test_laws_without_a_stiffness_of_a_cell():
    cell = Structure(bond_cell((2.0, 1.0), h=0.5), body=ROCK, supports={})
    creeps = cell.interface({"BED": ThinLayer(Maxwell(2.0, 1.0, 0.7), 0.01, at=1.0), "HEAD": springs(3.0, 1.3)})
    refused(InputError, "stresses without strains; march under", homogenised_stiffness, creeps)
    assert homogenised_stiffness(cell.interface(ThinLayer(Incompressible(0.7), 0.01, at=1.0))).shape == (3, 3)
    strip = Structure(periodic(sandwich(4.0, 1.0, 1.0, 0.5), ("LEFT", "RIGHT")), body=ROCK, supports={})
    along = strip.interface(ThinLayer(LinearElastic(0.8, 2.1), 0.01, order=1, at=1.0))
    refused(InputError, "the layer has order=1, whose strains along S", homogenised_stiffness, along)
