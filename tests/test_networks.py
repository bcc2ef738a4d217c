"""Networks of layers: split numbers, a law for each seam, junctions, contact between several bricks, on several ranks."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import Incompressible, LinearElastic, Stack
from forms.base import InputError
from geometry import sandwich, wall
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable, Splitting, facet_normals
from tests.meshed_cases import mortar, panel, yielding
from tests.meshes import renumbered
from tests.network_cases import (
    BED,
    HEAD,
    PANEL,
    PUSHED,
    WALL,
    YIELDED,
    pushed,
    springs,
    square,
    three_bricks,
    wall_energy,
)
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, march, solve

pytestmark = pytest.mark.few(5)

ROCK = LinearElastic.young(10.0, 0.25)


def cut_at(joint: Joint, cut) -> Joint:
    """The mesh of a joint as one region, with seams where functions of places (n, d) and normals hold."""
    table, (_first, second) = joint.table, joint.table.cells.T
    x = joint.points[table.vertices].mean(axis=1)
    nodes = table.nodes(np.arange(len(table.vertices)), joint.cells, joint.cell_type)
    normal = np.abs(facet_normals(joint.points, nodes, joint.cell_type).mean(axis=1))
    facets = {name: table.vertices[(second >= 0) & holds(x, normal)] for name, (holds, _) in cut.items()}
    facets |= {name: rows for name, rows in joint.facets.items() if name not in joint.seams}
    seams = {name: Seam(direction=tuple(map(float, way))) for name, (_, way) in cut.items()}
    return Joint(joint.points, joint.cells, joint.cell_type, 0 * joint.region, ("ROCK",), facets, seams)


def counts(joint: Joint) -> dict[int, int]:
    """Number of vertices with each number of components."""
    number, times = np.unique(joint.split_mesh.component_counts, return_counts=True)
    return dict(zip(number.tolist(), times.tolist(), strict=True))


def on(axis: int, place: float):
    """Whether facets lie in a plane."""
    return lambda x, n: (np.abs(x[:, axis] - place) < 1e-9) & (n[:, axis] > 0.9)


# ---------------------------------------------------------------- split numbers
SQUARE = sandwich(8.0, 4.0, 4.0, 1.0, cell="quadrilateral")


def test_components_around_vertices():
    cross = cut_at(SQUARE, {"FLAT": (on(1, 0.0), (0, 1)), "STEEP": (on(0, 4.0), (1, 0))})
    assert counts(cross) == {1: 64, 2: 16, 4: 1}
    assert cross.split_mesh.pieces.max() == 3
    tip = cut_at(SQUARE, {"S": (lambda x, n: on(1, 0.0)(x, n) & (x[:, 0] < 5), (0, 1))})
    assert counts(tip) == {1: 76, 2: 5}
    assert tip.split_mesh.components(1).sum() == 5  # facets
    single_facet = cut_at(SQUARE, {"S": (lambda x, n: on(1, 0.0)(x, n) & (np.abs(x[:, 0] - 3.5) < 0.1), (0, 1))})
    assert counts(single_facet) == {1: 81}
    assert single_facet.split_mesh.components(1).sum() == 1
    bond = wall(3, 4, (1.0, 0.5), 0.25)
    assert counts(bond) == {1: 63, 2: 39, 3: 15}
    assert bond.split_mesh.pieces.max() + 1 == 14


def test_components_follow_cells_not_numbers():
    bond = wall(2, 3, (1.0, 0.5), 0.25, cell="triangle")
    assert counts(renumbered(bond)) == counts(bond)
    whole = Splitting(bond.cells, bond.cell_type, FacetTable.of(bond.cells, bond.cell_type), np.empty(0, np.int64))
    assert whole.component_counts.max() == 1
    assert not whole.components(0).any()
    assert whole.pieces.max() == 0


# ---------------------------------------------------------------- the interface model
@pytest.mark.parametrize("element", WALL)
def test_wall(element):
    assert wall_energy(element) == pytest.approx(WALL[element], rel=1e-12)


def test_a_wall_does_not_depend_on_numbers_or_orientation():
    joint = wall(3, 4, (1.0, 0.5), 0.25)
    assert wall_energy("Q2", renumbered(joint)) == pytest.approx(WALL["Q2"], rel=1e-12)
    assert wall_energy("Q2", joint.swapped()) == pytest.approx(WALL["Q2"], rel=1e-12)
    aside = replace(joint, seams={"BED": Seam(direction=(0.3, -1.0)), "HEAD": Seam(direction=(-1.0, 0.2))})
    assert wall_energy("Q2", aside) == pytest.approx(WALL["Q2"], rel=1e-12)
    assert wall_energy("Q2", replace(joint, seams=dict(reversed(joint.seams.items())))) == pytest.approx(WALL["Q2"])


@pytest.mark.parametrize("element", PANEL)
def test_a_law_for_each_seam(element):
    state = solve(panel(element, 0.0625).interface(mortar(0.01)), 1.0)
    energies, surface = state.energies(), Surface(state.model)
    assert energies["bodies"] + energies["layer"] == pytest.approx(PANEL[element], rel=1e-12)
    if element == "P2":
        assert surface.norm(surface.jump(state)) == pytest.approx(0.0109003443, rel=1e-9)
        traction = surface.norm(surface.traction(state))
        assert traction == pytest.approx(0.01999684277, rel=2e-5)  # of the law at the jump; reactions are projections


@pytest.mark.few(5)
@pytest.mark.parametrize("element", YIELDED)
def test_elastic_beds_and_heads_that_yield(element):
    history = march(panel(element, 0.0625).interface(yielding(0.01)), [0.25, 0.5, 0.75, 1.0])
    energies = history.last.audit.total, history.table["dissipated"].sum()
    assert energies == pytest.approx(YIELDED[element], rel=1e-8)  # the digits that are known
    assert np.abs(history.table["imbalance"]).max() < 1e-12


@pytest.mark.few(1)
@pytest.mark.parametrize("build", [Structure.interface, Structure.full])
def test_two_layers_in_series(build):
    """Three plates, two glue lines: in series with the plates, each with its law, by name."""
    column = cut_at(SQUARE, {"LOW": (on(1, -1.0), (0, 1)), "HIGH": (on(1, 2.0), (0, 1))})
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    structure = Structure(column, body=LinearElastic(0.0, 5.0), supports=supports, tractions={"TOP": (0.0, 2.0)})
    high = Stack((0.5, LinearElastic(0.0, 4.0)), (0.5, LinearElastic(0.0, 2.0)))
    layers = {"LOW": springs(4.0, 2.0, 0.1), "HIGH": ThinLayer(high, 0.2, at=1.0)}
    state, compliances = solve(build(structure, layers)), {"LOW": 1 / 4, "HIGH": 0.5 / 8 + 0.5 / 4}
    for name, compliance in compliances.items():
        surface = Surface(structure.interface(layers), name)
        assert surface.integral(surface.jump(state)[1]) == pytest.approx(8 * 2.0 * compliance, rel=1e-10)
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(16.0, rel=1e-10)
    assert state.energies()["layer"] == pytest.approx(8 * 2.0**2 / 2 * sum(compliances.values()), rel=1e-10)


# ---------------------------------------------------------------- contact
@pytest.mark.parametrize(("cell", "push"), PUSHED)
def test_three_bricks(cell, push):
    assert square(pushed(three_bricks(8, cell), push, BED)) == pytest.approx(PUSHED[cell, push], rel=1e-12)


def test_a_contact_law_for_each_seam():
    """The push goes through the head and the left part of the bed; all pressure through the bed."""
    m, force = 8, 0.10473
    joint = three_bricks(m, "quadrilateral")
    state = pushed(joint, 0.6, {"BED": BED, "HEAD": HEAD})
    bed, head = Surface(state.model, "BED").contact(state), Surface(state.model, "HEAD").contact(state)
    assert bed.force == pytest.approx([-0.3, 2.0], rel=1e-12)
    assert head.force[0] == pytest.approx(force, abs=5e-6)
    assert max(bed.equilibrium, bed.clapeyron) < 1e-12
    away = pushed(joint, -0.6, {"BED": BED, "HEAD": HEAD})
    assert Surface(away.model, "HEAD").contact(away).counts["separated"] == m + 1
    assert not Surface(away.model, "HEAD").contact(away).force.any()


# ---------------------------------------------------------------- what is refused
def test_refused_joints():
    joint = wall(2, 2, (1.0, 0.5), 0.25)
    cracked, both = joint.seams | {"CRACK": Seam(direction=(1.0, 0.0))}, {"BED": Seam(), "HEAD": Seam()}
    twice = joint.facets | {"HEAD": joint.facets["BED"]}
    all_s = dict(facets=joint.facets | {"S": joint.facets["TOP"]}, seams=joint.seams | {"S": Seam()})
    for change, message in (
        (dict(facets=twice), r"are in two seams, 'BED' and 'HEAD', the first at \("),
        (dict(seams=both), "'HEAD' does not separate two bodies.*one region on both sides; give the"),
        (dict(seams=cracked), "unknown set of facets 'CRACK'"),
        (all_s, "'S' is all seams together"),
    ):
        refused(InputError, message, replace, joint, **change)
    for bad in (dict(bricks=1, courses=1), dict(bricks=1.5, courses=2), dict(bricks=2, courses=0)):
        refused(InputError, "a joint needs a seam|whole number", wall, **bad, brick=(1.0, 0.5))
    bricks = Structure(joint, body=ROCK, supports={"BOTTOM": 0.0})
    layer = springs(2.0, 1.0)
    refused(InputError, "unknown seam 'BEDS', did you mean 'BED'", bricks.interface, {"BEDS": layer, "HEAD": layer})
    refused(InputError, "the seam 'HEAD' has no layer", lambda: bricks.interface({"BED": layer}))
    refused(InputError, "unknown seam 'BEDS'", lambda: Surface(bricks.interface(layer), "BEDS"))


def test_order_one_beside_a_seam_that_ends():
    """Order 1 asks its own seam to have no ends inside and no junctions; elsewhere there may be some."""
    glue, up = on(1, 0.0), (0.0, 1.0)
    parallel = cut_at(SQUARE, {"GLUE": (glue, up), "CRACK": (lambda x, n: on(1, 2.0)(x, n) & (x[:, 0] < 3), up)})
    above = lambda x, n: on(0, 4.0)(x, n) & (x[:, 1] > 0) & (x[:, 1] < 2)
    meeting = cut_at(SQUARE, {"GLUE": (glue, up), "CRACK": (above, (1.0, 0.0))})
    left, right = lambda x, n: glue(x, n) & (x[:, 0] < 3), lambda x, n: glue(x, n) & (x[:, 0] > 3)
    in_line = cut_at(SQUARE, {"GLUE": (left, up), "CRACK": (right, up)})
    law = LinearElastic(2.0, 0.7)
    ends = {"BOTTOM": 0.0, "TOP": {"x": 0.1, "y": -0.05}}
    bodies = lambda joint: Structure(joint, body=ROCK, supports=ends, element="Q2")
    total = lambda model: sum(solve(model).energies()[part] for part in ("bodies", "layer"))
    closed = ThinLayer(LinearElastic(1e8, 1e8), 1e-8, at=1.0)
    energies = []
    for order in (0, 1):
        layer = ThinLayer(law, 0.2, order=order)
        cracked = bodies(parallel).interface({"GLUE": layer, "CRACK": closed})
        energies.append((total(bodies(SQUARE).interface(layer)), total(cracked)))
    for joint in (meeting, in_line):
        both = {"GLUE": layer, "CRACK": closed}
        refused(InputError, "the layer 'GLUE' meets another one", bodies(joint).interface, both)
    (order0, cracked0), (order1, cracked1) = energies
    assert (cracked0, cracked1) == pytest.approx((order0, order1), rel=1e-6)  # the crack is closed by springs of 1e8
    assert abs(order1 / order0 - 1) > 1e-3
    words = r"the layer 'CRACK' ends at \(3, 2\)"
    refused(InputError, words, bodies(parallel).interface, {"GLUE": layer, "CRACK": layer})


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of the free ends
def test_two_incompressible_seams():
    """They do not open: as layers that hardly do; each has its pressure, which is the stress across it."""
    soft, hard = 0.7, 0.45  # shear, per thickness
    rubber = lambda mu, eps: ThinLayer(Incompressible(mu), eps, at=1.0)
    layers = {"HEAD": rubber(hard, 0.007), "BED": rubber(soft, 0.01)}
    nearly = {"BED": springs(1e6, soft, 0.01), "HEAD": springs(1e6, hard, 0.007)}
    state, other = (solve(panel("P2").interface(case), 1.0) for case in (layers, nearly))
    energies, expected = state.energies(), other.energies()
    assert energies["bodies"] == pytest.approx(expected["bodies"], rel=5e-3)  # held weakly, and at each point
    assert energies["layer"] == pytest.approx(expected["layer"], rel=0.01)
    for name in layers:
        surface = Surface(state.model, name)
        assert abs(surface.integral(surface.frame(surface.jump(state))[1])) < 1e-12 * surface.norm(surface.jump(state))
        p = state.fields[f"pressure {name}"]
        pressed = fem.assemble_scalar(fem.form(p * ufl.dx(p.function_space.mesh)))
        surface = Surface(other.model, name)
        across = 1e6 * surface.integral(surface.frame(surface.jump(other))[1])
        assert across == pytest.approx(pressed, rel=0.06), name  # a head is four cells high
    with pytest.raises(InputError, match="pressure BED, pressure HEAD"):
        _ = state.p
