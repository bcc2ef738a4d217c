"""Meshed networks of layers in 3D: junction lines and the polyhedra where they meet, and what is refused."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import wall
from geometry.inflating import inflation
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable
from tests.meshed_cases import star
from tests.meshes import grid, parted, renumbered, volumes
from tests.test_meshed_networks import BRICK, RATIOS, WAYS, areas, check
from thinlayer import Structure, Surface, ThinLayer, solve

pytestmark = pytest.mark.few(5)

THICK = {"X": 0.7, "Y": 1.0, "Z": 1.3}  # of the layers of the cube over eps
LAW = {"X": (0.3, 0.45), "Y": (0.6, 0.7), "Z": (0.4, 0.5)}  # their lmbda and mu per thickness
SIDES = ("LEFT", "RIGHT", "BOTTOM", "TOP", "BACK", "FRONT")
BLOCKS = {  # the block of each octant of the cube (-1, 1)^3, from its signs 0 or 1
    "T": lambda x, y, z: np.where(y == 0, 0, 1 + x),
    "X": lambda x, y, z: x + 2 * y,
    "T x collar": lambda x, y, z: np.where(y == 0, 0, 1 + x) + 3 * z,
    "staggered": lambda x, y, z: np.where(y == 0, 0, 1 + x * (z == 0)) + 3 * z,
    "octants": lambda x, y, z: x + 2 * y + 4 * z,
}


@cache
def cube(kind: str, cell: str, m: int = 4) -> Joint:
    """A cube of m^3 cells or 6 m^3, cut into blocks along x = 0, y = 0, z = 0: seams X, Y, Z."""
    axis = np.linspace(-1.0, 1.0, m + 1)
    whole = grid([axis] * 3, lambda x: x[:, 1] > 0, cell)
    region = BLOCKS[kind](*(whole.points[whole.corners].mean(axis=1) > 0).astype(int).T)
    region = np.unique(region, return_inverse=True)[1]
    table = FacetTable.of(whole.cells, cell)
    first, second = table.cells.T
    cut = (second >= 0) & (region[first] != region[second])
    x = whole.points[table.vertices]
    flat = [np.ptp(x[..., k], axis=1) < 1e-12 for k in range(3)]
    facets = {name: table.vertices[cut & flat[k]] for k, name in enumerate("XYZ") if (cut & flat[k]).any()}
    seams = {name: Seam(direction=tuple(np.eye(3)["XYZ".index(name)])) for name in facets}
    for k, (low, high) in enumerate(zip(SIDES[::2], SIDES[1::2], strict=True)):
        facets |= {name: table.vertices[flat[k] & (x[:, 0, k] == at)] for name, at in ((low, -1.0), (high, 1.0))}
    names = tuple(f"BLOCK {k + 1}" for k in range(region.max() + 1))
    return Joint(whole.points, whole.cells, cell, region, names, facets, seams)


def half_star(cell: str, collar: bool) -> Joint:
    """Three wedges of a half-cylinder about the z axis, |z| < 1, that meet on the axis in its flat side x = 0.

    Seams R between them and, where there is a collar, Z at z = 0; facets SIDE on the flat side and RIM elsewhere.
    """
    flat = star((-90, -45, 45, 90), "triangle" if cell == "tetrahedron" else "quadrilateral")
    n, z = len(flat.points), np.linspace(-1.0, 1.0, 5)
    points = np.column_stack([np.tile(flat.points, (5, 1)), np.repeat(z, n)])
    rows = flat.cells[flat.region != 3]
    body, at = np.tile(flat.region[flat.region != 3], 4), np.repeat(np.arange(4), len(rows))
    low = np.tile(rows, (4, 1)) + at[:, None] * n
    if cell == "tetrahedron":  # prisms, split in the order of their vertices
        low = np.sort(low, axis=1)
        cells = np.concatenate([np.column_stack([low[:, : k + 1], low[:, k:] + n]) for k in range(3)])
        body, at = np.tile(body, 3), np.tile(at, 3)
    else:
        cells = np.column_stack([low, low + n])
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(len(body), -1)
    region = body + 3 * collar * (at > 1)
    table = FacetTable.of(cells, cell)
    first, second = table.cells.T
    cut, x = (second >= 0) & (region[first] != region[second]), points[table.vertices]
    across = np.ptp(x[..., 2], axis=1) < 1e-12
    side = (second < 0) & (np.abs(x[..., 0]) < 1e-12).all(axis=1)
    facets = {"R": table.vertices[cut & ~across], "SIDE": table.vertices[side]}
    facets["RIM"] = table.vertices[(second < 0) & ~side]
    seams = {"R": Seam()}
    if collar:
        facets["Z"], seams["Z"] = table.vertices[cut & across], Seam(direction=(0.0, 0.0, 1.0))
    return Joint(points, cells, cell, region, tuple(f"B{k}" for k in range(region.max() + 1)), facets, seams)


def thickness(base: Joint, eps: float) -> dict[str, float]:
    """Of each seam of a cube."""
    return {name: THICK[name] * eps for name in base.seams}


def mortar(base: Joint, eps: float) -> dict[str, ThinLayer]:
    """The layer of each seam of a cube."""
    return {name: ThinLayer(LinearElastic(*LAW[name]), one, at=1.0) for name, one in thickness(base, eps).items()}


def jump_errors(element: str, sizes, m: int = 4, **choices) -> np.ndarray:
    """(sizes,) errors of the jump of the interface model against meshed layers, .3 away from junctions and the outside.

    The top of a cube is shifted.
    """
    structure = Structure(
        cube("T", "tetrahedron" if element[0] == "P" else "hexahedron", m),
        body=LinearElastic.young(1.0, 0.2),
        supports={"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": -0.02, "z": 0.005}},
        element=element,
    )
    limit = structure.interface(mortar(structure.joint, 0.01))
    surface, errors = Surface(limit), []
    inner = (np.hypot(*surface.x[:2]) > 0.3) & (abs(surface.x) < 0.7).all(axis=0)
    w = surface.jump(solve(limit))
    for eps in sizes:
        full = structure.full(mortar(structure.joint, eps), cells_through=2, bodies="extended", **choices)
        errors.append(surface.norm(surface.jump(solve(full)) - w, inner) / surface.norm(w, inner))
    return np.array(errors)


CELLS = ("hexahedron", "tetrahedron")
CASES = [(kind, cell) for kind in BLOCKS for cell in CELLS if (kind, cell) != ("staggered", "hexahedron")]


# ---------------------------------------------------------------- geometry
@pytest.mark.parametrize(("kind", "cell"), CASES)
def test_cubes_of_blocks(kind, cell):
    """No cell is folded, no facet is free inside, the whole keeps its volume, and the numbers do not depend on eps."""
    base, counts = cube(kind, cell), set()
    for ratio in RATIOS:
        opened = inflate(base, thickness(base, ratio), bodies="extended", cells_through=2)
        check(base, opened)
        assert volumes(opened).sum() == pytest.approx(8.0, rel=1e-12)
        counts.add((len(opened.points), len(opened.cells)))
    kept = inflate(base, thickness(base, RATIOS[1]), cells_through=2)
    check(base, kept)
    assert volumes(kept)[: len(base.cells)] == pytest.approx(volumes(base), rel=1e-10)
    counts.add((len(kept.points), len(kept.cells)))
    assert len(counts) == 1


def volumes_of_junctions(kind, a, b, c):
    """For layers of thickness a, b, c: of the first seam's junctions, and of the second's if there are three seams."""
    return {
        "T": (a * b,),
        "X": (2 * a * b,),
        "T x collar": (a * b * (1 - c / 2) + a * c * (1 - b / 2) + a * b * c / 2, b * c * (2 - a / 2)),
        "staggered": (a * b / 2 * (1 - c / 2) + a * c / 2 * (1 - b / 2) + a * b * c / 4, b * c * (2 - a / 4)),
        "octants": (a * b * (2 - c) + a * c * (2 - b) + a * b * c, b * c * (2 - a)),
    }[kind]


@pytest.mark.few(1)
@pytest.mark.parametrize(("kind", "cell"), CASES)
def test_volumes_of_junctions(kind, cell):
    """Triangles and quadrilaterals along lines, and polyhedra between them, however many cells fill them."""
    eps, wanted = 0.02, volumes_of_junctions(kind, 0.014, 0.02, 0.026)
    for through in (2, 4):
        base = renumbered(cube(kind, cell, 2), through)
        opened = inflate(base, thickness(base, eps), bodies="extended", cells_through=through)
        check(base, opened)
        found = [volume for name, volume in areas(opened).items() if "JUNCTIONS" in name]
        assert found == pytest.approx(wanted, rel=1e-10)
        assert set(opened.band.junctions.values()) == {"X", "Y"} if len(wanted) == 2 else {"X"}
    if kind == "octants":
        at_vertex = (opened.reference[opened.corners] == 0.0).all(axis=(1, 2))
        assert volumes(opened)[at_vertex].sum() == pytest.approx(0.014 * 0.02 * 0.026, rel=1e-10)


@pytest.mark.few(1)
@pytest.mark.parametrize("bodies", WAYS)
@pytest.mark.parametrize(("cell", "depth"), [("triangle", None), ("quadrilateral", None), *((c, 0.75) for c in CELLS)])
def test_a_wall_on_a_rigid_base(cell, depth, bodies):
    """A head that ends at the base meets the layer there in a triangle, as at a bed."""
    base = wall(2, 2, BRICK, 0.25, depth=depth, cell=cell)
    base = replace(base, seams=base.seams | {"BOTTOM": Seam()})
    bed, head, bottom = 0.02, 0.01, 0.03
    opened = inflate(base, {"BED": bed, "HEAD": head, "BOTTOM": bottom}, bodies=bodies, junctions=["BED", "BOTTOM"])
    check(base, opened)
    found = {name: volume / (depth or 1.0) for name, volume in areas(opened).items()}
    assert found["LAYER/JUNCTIONS/BED"] == pytest.approx(3 * bed * head / 2)
    assert found["LAYER/JUNCTIONS/BOTTOM"] == pytest.approx(bottom * head / 2)
    corners = (3 * bed + bottom) * head / 2 if bodies == "kept" else -(3 * bed / 2 + bottom) * head
    layers = 2 * bed + 1.5 * head + 2 * bottom + corners
    assert sum(found.values()) == pytest.approx(layers, rel=1e-10)
    kept = volumes(opened)[: len(base.cells)].sum() / (depth or 1.0)
    assert kept == pytest.approx(2.0 if bodies == "kept" else 2.0 - layers, rel=1e-10)
    ends = {name for name in opened.facets if name.endswith("/LAYER")}
    assert ends == {f"{name}/LAYER" for name in base.facets if name not in base.seams}


@pytest.mark.parametrize("collar", [False, True])
@pytest.mark.parametrize("cell", CELLS)
def test_junctions_on_the_outer_boundary(cell, collar):
    """Layers meet along a line in a flat side, and with a collar in a point there: outer faces close what is between."""
    base, eps = renumbered(half_star(cell, collar)), 0.01
    for through in (2, 4):
        opened = inflate(base, eps, bodies="extended", cells_through=through)
        check(base, opened, least=0.01)  # the quadrilaterals at the centre are thin
        assert opened.points[opened.facets["SIDE/LAYER"]][..., 0] == pytest.approx(0.0, abs=1e-15)
        at_axis = (opened.reference[opened.corners][..., :2] == 0.0).all(axis=(1, 2))
        assert volumes(opened)[at_axis].sum() == pytest.approx(2 * eps**2 / 2, rel=1e-10)


@pytest.mark.parametrize("cell", CELLS)
def test_gaps(cell):
    """Open X: Y and Z go on, and all junctions stay. Open Y and Z: X ends at Y and goes on where it crosses Z alone."""
    base, a, b, c = cube("T x collar", cell), 0.014, 0.02, 0.026
    whole = inflate(base, thickness(base, 0.02), bodies="extended", cells_through=2)
    opened = inflate(base, thickness(base, 0.02), bodies="extended", cells_through=2, gaps=["X"])
    assert opened.band.junctions == {"LAYER/JUNCTIONS/Y": "Y", "LAYER/JUNCTIONS/Z": "Z"}
    assert volumes(opened).sum() == pytest.approx(volumes(whole).sum() - areas(whole)["LAYER/X"], rel=1e-12)
    assert areas(opened)["LAYER/JUNCTIONS/Z"] == pytest.approx(a * c * (1 - b / 2))
    alone = inflate(base, thickness(base, 0.02), bodies="extended", cells_through=2, gaps=["Y", "Z"])
    wanted = {"LAYER/X": 2 * a * (1 - b / 2) * (1 - c / 2), "LAYER/JUNCTIONS": a * c * (1 - b / 2)}
    assert areas(alone) == pytest.approx(wanted)


def test_hexahedra_need_three_layers_around_a_corner():
    with pytest.raises(InputError, match=r"S branches at \(0, 0, 0\), .*need three layers.*not 2; use tetrahedra"):
        inflate(cube("staggered", "hexahedron"), 0.01, bodies="extended")


def test_bodies_that_touch_along_an_edge_only():
    """Where layers end at the edge they enclose no polygon; layers that pass it beside one another do not meet."""
    axis = np.linspace(-1.0, 1.0, 5)
    base = grid([axis] * 3, lambda x: x[:, 0] > 0, "tetrahedron", keep=lambda x: x[:, 1] * x[:, 2] > 0)
    opened = inflate(base, 0.01, bodies="extended", cells_through=2)
    assert volumes(opened).sum() == pytest.approx(4.0, rel=1e-12)
    assert opened.band.regions == ("LAYER",)
    y, z = base.points[base.corners].mean(axis=1).T[1:]
    with pytest.raises(InputError, match=r"at \(.*, 0, 0\) bodies only touch at a vertex or an edge"):
        inflate(parted(base, (y > z).astype(int)), 0.01, bodies="extended")
    block = grid([np.arange(4.0), *[np.arange(5.0)] * 2], lambda x: x[:, 0] > 1, "tetrahedron")
    at = np.floor(block.points[block.corners].mean(axis=1)).astype(int)
    cubes = sum(k * (at == place).all(axis=1) for k, place in ((1, (1, 1, 1)), (2, (1, 2, 2))))  # in a third body
    with pytest.raises(InputError, match=r"at \(1.5, 2, 2\) bodies only touch at a vertex or an edge"):
        inflate(parted(block, cubes), 0.01, bodies="extended")


@pytest.mark.parametrize("cell", CELLS)
def test_random_blocks(cell, monkeypatch):
    """Whatever the shape of blocks, the mesh conforms and leaves nothing open between them, or tells what it cannot."""
    monkeypatch.setattr(
        inflation, "_motion", lambda joint, copies, *given: np.zeros((len(joint.points) + len(copies.new), 3))
    )
    monkeypatch.setattr(inflation, "_check_cells", lambda *given: None)
    random, axis, meshed = np.random.default_rng(5), np.linspace(-1.0, 1.0, 4), 0
    refused = []
    whole = grid([axis] * 3, lambda x: x[:, 0] > 0, cell)
    for count in (3, 4, 5) * 8:
        seeds = random.uniform(-1.0, 1.0, (count, 3))
        away = np.linalg.norm(whole.points[whole.corners].mean(axis=1)[:, None] - seeds, axis=2)
        base = parted(whole, np.unique(away.argmin(axis=1), return_inverse=True)[1])
        try:
            opened = inflate(base, 1e-3, bodies="extended", cells_through=2)
        except InputError as error:
            refused.append(str(error))
            continue
        outer = np.flatnonzero(opened.table.cells[:, 1] < 0)
        named = opened.table.index(np.concatenate([opened.facets["OUT"], opened.facets["OUT/LAYER"]]))
        assert np.array_equal(np.sort(named), outer)
        assert (np.diff(np.sort(opened.cells, axis=1), axis=1) > 0).all()
        meshed += 1
    assert meshed >= 4
    reasons = r"S branches at \(|at \(.* bodies only touch|at \(.* one body lies on both sides"
    assert all(re.match(reasons, one) for one in refused)


# ---------------------------------------------------------------- models
@pytest.mark.parametrize("element", ["Q2", "P2"])
def test_jumps_converge(element):
    """At rate 1, for laws by the names of seams."""
    errors = jump_errors(element, (0.04, 0.02))
    assert 0.9 < np.log2(errors[0] / errors[1]) < 1.1
    assert errors[1] < 0.025
