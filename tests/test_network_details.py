"""Networks seen closely: contact reports where bodies branch, rate laws, loads on seams, gaps on a base, cells."""

from dataclasses import replace

import numpy as np
import pytest

from forms import Incompressible, KelvinVoigt, LinearElastic, Maxwell, Norton, Stack
from forms.base import InputError
from geometry import bond_cell, periodic, sandwich, wall
from geometry.seam import Seam
from tests import own_laws
from tests.contact_bars import contact
from tests.dry_walls import dry_wall
from tests.meshes import renumbered
from tests.network_cases import BED, HEAD, pushed, springs, three_bricks
from tests.pictures import assert_coloured
from tests.refused import refused
from thinlayer import (
    Gap,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    UflPart,
    homogenised_stiffness,
    march,
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
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_zones_of_contact_go_on_where_bodies_branch(cell):
    """A bed that sticks everywhere is one zone, also under the head that ends on it, and its two pieces are curves."""
    state = pushed(three_bricks(4, cell), 0.6, {"BED": BED, "HEAD": HEAD})
    bed = Surface(state.model, "BED").contact(state)
    assert bed.counts["stick"] == 18
    assert [(zone.status, zone.nodes) for zone in bed.zones] == [("stick", 18)]
    assert bed.zones[0].size == pytest.approx(2.0, rel=1e-12)
    lines = bed.surface.along(bed.p)
    assert [len(line.s) for line in lines] == [18]  # where the head ends there are two
    assert sum(line.length for line in lines) == pytest.approx(2.0, rel=1e-12)
    assert np.diff(bed.x[:, 0]).min() > -1e-12
    other = contact(pushed(renumbered(three_bricks(4, cell)), 0.6, {"BED": BED, "HEAD": HEAD}), "BED")
    assert [zone.nodes for zone in other.zones] == [18]
    assert other.p == pytest.approx(bed.p, rel=1e-9)


def test_zones_of_contact_part_at_a_junction_where_the_status_differs():
    state = pushed(three_bricks(4, "quadrilateral", cross=True), 0.6, {"BED": BED, "HEAD": HEAD})
    head = Surface(state.model, "HEAD").contact(state)
    assert {zone.status: zone.nodes for zone in head.zones} == {"pinned": 1, "sliding": 9}
    assert len(head.zones) == 2


@pytest.fixture(scope="module")
def pushed_wall():
    """Two beds, one above the other, brick by brick; the upper one slides first where bricks have a weight."""
    return solve(dry_wall(bricks=2, courses=3, h=0.25, weight=0.1), 0.5)


def test_a_bed_of_several_bricks_is_one_way(pushed_wall):
    bed = Surface(pushed_wall.model, "BED").contact(pushed_wall)
    assert [len(line.s) for line in bed.surface.along(bed.p)] == [12, 12]
    assert bed.x[:, 1].tolist() == [0.5] * 12 + [1.0] * 12  # one bed after the other
    assert np.diff(bed.x[:12, 0]).min() == np.diff(bed.x[12:, 0]).min() == 0.0
    strip, tractions, *_ = plotting.along(bed.surface, bed).axes
    starts = [line.get_xdata()[0] for line in tractions.lines if len(line.get_xdata()) == 12]
    assert starts == pytest.approx([0.0, 2.0])  # one bed after the other
    assert sum(patch.get_width() for patch in strip.patches) == pytest.approx(bed.areas.sum())


@pytest.mark.parametrize("head", ["contact", "layer"])
def test_a_dry_wall_has_the_status_of_each_joint(pushed_wall, head):
    """Of nodes, and of the facets around them; other seams may have layers."""
    state = pushed_wall
    if head == "layer":
        joint, law = pushed_wall.model.joint, pushed_wall.model.contacts["BED"]
        bricks = Structure(joint, body=ROCK, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.4, -1.0)}, element="Q1")
        state = solve(bricks.interface({"BED": law, "HEAD": springs(100.0, 40.0)}))
    surface = Surface(state.model)
    found, nodes = surface.status(state)[:, 0], surface.contact(state).status
    assert set(found[surface.seams == "HEAD"]) <= (
        {"elastic"} if head == "layer" else {"stick", "sliding", "separated"}
    )
    assert len(set(found)) > 1
    for status, corners in zip(found, nodes[surface.nodes], strict=True):
        assert status in corners or set(corners) == {"no contact law"}
    rows = {row["seam"]: row for row in surface.table(state).rows}
    bed = contact(state, "BED")
    for status in ("stick", "sliding", "separated"):
        assert rows["BED"][status] == pytest.approx(bed.areas[bed.status == status].sum() / bed.areas.sum())
    assert rows["BED"]["normal_force"] == pytest.approx(bed.normal_force)
    assert (rows["HEAD"]["normal_force"] is None) == (head == "layer")
    assert_coloured(plotting.on_surface(state, Surface.status), {*found.tolist()})


# ---------------------------------------------------------------- laws
def test_laws_that_start_at_rest_on_several_seams():
    """Viscous springs do not answer at once: a march begins with the state at rest, which has dissipated nothing."""
    joint = wall(2, 2, (1.0, 0.5), 0.25)
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 1e-3 * t, "y": lambda x, t: -5e-4 * t}}
    bricks = Structure(joint, body=ROCK, supports=supports)
    layers = {
        "BED": ThinLayer(Norton(2.0, 1.0, 3.0, 1.5), 0.01, at=1.0),
        "HEAD": ThinLayer(KelvinVoigt(2.0, 1.0, 0.7, 0.5), 0.01, at=1.0),
    }
    history = march(bricks.interface(layers), [0.5, 1.0])
    assert history.states[0].dissipated == {"BED": 0.0, "HEAD": 0.0}
    bed, head, both = (history.table[name] for name in ("dissipated BED", "dissipated HEAD", "dissipated"))
    assert bed + head == pytest.approx(both, rel=1e-12)
    assert max(abs(state.audit.imbalance) for state in history) < 1e-10
    assert min(history.last.dissipated.values()) > 0


# ---------------------------------------------------------------- loads
def test_loads_on_a_seam_are_refused():
    joint, layer = on_a_base(), springs(3.0, 1.3)

    def made(**given):
        return Structure(joint, body=ROCK, **({"supports": {}} | given)).interface(layer)

    for name in ("BOTTOM", "GLUE"):
        with pytest.raises(InputError, match=f"support on '{name}': its facets lie inside, or below a layer"):
            made(supports={name: {"x": 0.1}})
    with pytest.raises(InputError, match="traction on 'BOTTOM': its facets lie inside, or below a layer"):
        made(tractions={"BOTTOM": (0.3, 0.0)})
    with pytest.raises(InputError, match="springs on 'BOTTOM': its facets lie inside, or below a layer"):
        made(parts=[Springs("BOTTOM", normal=2.0)])


def test_parts_do_not_take_the_names_of_layers():
    """What sublayers and pressures remember has such keys; a part of the same name would replace it."""
    bricks = wall(2, 2, (1.0, 0.5), 0.25)

    def made(key, joint=bricks):
        extra = UflPart(energy=lambda u, model: u[1] ** 2 * model.ds(model.domain.values("TOP")), key=key)
        structure = Structure(joint, body=ROCK, supports={"BOTTOM": 0.0}, parts=[extra])
        return structure.interface(springs(3.0, 1.3))

    for key in ("layer BED", "layer BED/1", "pressure HEAD", "contact BED", "layer 1"):
        refused(InputError, f"two parts are called '{key}'", made, key)
    assert made("layer of paint").parts[0].key == "layer of paint"


def test_loads_inside_a_meshed_network_are_refused():
    bricks = wall(2, 2, (1.0, 0.5), 0.25)
    loads = {"BED/LOWER_FACE": (0.1, -1.0)}
    structure = Structure(bricks, body=ROCK, supports={"BOTTOM": 0.0}, tractions=loads)
    with pytest.raises(InputError, match="traction on 'BED/LOWER_FACE': its facets lie inside"):
        structure.full(springs(3.0, 1.3))


# ---------------------------------------------------------------- gaps
@pytest.mark.parametrize("bodies", ["kept", "extended"])
def test_a_gap_on_a_rigid_base(bodies):
    """It is empty: the meshed model has the energies of one that does not know the base."""
    joint, glue = on_a_base(), springs(5.0, 2.1, 0.001)
    held = Structure(joint, body=ROCK, supports={"LEFT/LOWER": 0.0}, tractions={"TOP": (0.1, -0.2)})
    layers = {"GLUE": glue, "BOTTOM": Gap(1e-6)}
    full, limit = (solve(model).energies() for model in (held.full(layers, bodies=bodies), held.interface(layers)))
    alone = Structure(
        sandwich(8.0, 4.0, 4.0, 1.0, cell="quadrilateral"), body=ROCK, supports={"LEFT/LOWER": 0.0},
        tractions={"TOP": (0.1, -0.2)},
    )  # fmt: skip
    assert full["layer"] == pytest.approx(limit["layer"], rel=1e-3)  # the glue has a thickness
    assert full["bodies"] == pytest.approx(solve(alone.full(glue, bodies=bodies)).energies()["bodies"], rel=1e-5)


# ---------------------------------------------------------------- cells
def test_stiffness_of_a_cell_with_sublayers():
    """Compliances of sublayers add, K = 1 / sum of a_i / K_i, across and along."""
    cell = Structure(bond_cell((2.0, 1.0), h=0.5), body=ROCK, supports={}, element="Q1")
    first, second, head = LinearElastic(0.8, 2.1), LinearElastic(1.0, 0.5), springs(3.0, 1.3)
    across, along = (1 / (0.3 / a + 0.7 / b) for a, b in ((5.0, 2.0), (2.1, 0.5)))
    stacked = homogenised_stiffness(
        cell.interface({"BED": ThinLayer(Stack((0.3, first), (0.7, second)), 0.01, at=1.0), "HEAD": head})
    )
    assert stacked == pytest.approx(
        homogenised_stiffness(cell.interface({"BED": springs(across, along), "HEAD": head}))
    )
    stiffer = homogenised_stiffness(cell.interface({"BED": springs(1.5 * across, along), "HEAD": head}))
    assert np.abs(stacked - stiffer).max() > 0.05 * stacked.max()


def test_stiffness_of_a_cell_with_a_linear_traction_law():
    cell = Structure(bond_cell((2.0, 1.0), h=0.5), body=ROCK, supports={}, element="Q1")
    head = springs(3.0, 1.3)
    given, other = (
        homogenised_stiffness(cell.interface({"BED": bed, "HEAD": head}))
        for bed in (own_laws.Springs(2.1, 5.0), springs(5.0, 2.1))
    )
    assert given == pytest.approx(other, abs=1e-12 * other.max())


def test_laws_without_a_stiffness_of_a_cell():
    cell = Structure(bond_cell((2.0, 1.0), h=0.5), body=ROCK, supports={})
    for law in (Maxwell(2.0, 1.0, 0.7), KelvinVoigt(2.0, 1.0, 0.7, 0.5)):
        with pytest.raises(InputError, match="there is no stiffness but at a state; march under"):
            homogenised_stiffness(cell.interface({"BED": ThinLayer(law, 0.01, at=1.0), "HEAD": springs(3.0, 1.3)}))
    assert homogenised_stiffness(cell.interface(ThinLayer(Incompressible(0.7), 0.01, at=1.0))).shape == (3, 3)
    strip = Structure(periodic(sandwich(4.0, 1.0, 1.0, 0.5), ("LEFT", "RIGHT")), body=ROCK, supports={})
    with pytest.raises(InputError, match="the layer has order=1, whose strains along S"):
        homogenised_stiffness(strip.interface(ThinLayer(LinearElastic(0.8, 2.1), 0.01, order=1, at=1.0)))


def test_places_of_contact_in_a_cell():
    """Of the places that periodic sides identify with each other a report names the first, whatever rank has its node."""
    joint = bond_cell((2.0, 1.0), h=0.25)
    cell = Structure(joint, body=ROCK, supports={}, strain=((-1e-3, 2e-4), (2e-4, -3e-3)), element="Q1")
    report = contact(solve(cell.interface({"BED": BED, "HEAD": springs(3.0, 1.3)})), "BED")
    vertices = report.surface.vertices
    assert (joint.masters[vertices] == vertices).all()
    assert report.x == pytest.approx(joint.points[vertices], abs=1e-12)
    assert report.areas.sum() == pytest.approx(4.0, rel=1e-12)  # two beds of one brick each
