"""Meshed networks of layers in 3D: lines along which layers meet, and what is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import wall
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from tests.meshes import grid, parted, renumbered, volumes
from tests.refused import refused
from tests.test_meshed_networks import BRICK, WAYS, areas, check
from thinlayer import Structure, Surface, ThinLayer, solve

pytestmark = pytest.mark.few(5)

THICK = {"X": 0.7, "Y": 1.0, "Z": 1.3}  # of the layers of the cube over eps
LAW = {"X": (0.3, 0.45), "Y": (0.6, 0.7)}  # their lmbda and mu per thickness
BLOCKS = {  # the block of each octant of the cube (-1, 1)^3, from its signs 0 or 1
    "T": lambda x, y, z: np.where(y == 0, 0, 1 + x),
    "X": lambda x, y, z: x + 2 * y,
    "T x collar": lambda x, y, z: np.where(y == 0, 0, 1 + x) + 3 * z,
}


@cache
def cube(kind: str, cell: str, m: int = 4) -> Joint:
    """A cube of m^3 cells or 6 m^3, cut into blocks along x = 0, y = 0, z = 0: seams X, Y, Z."""
    whole = grid([np.linspace(-1.0, 1.0, m + 1)] * 3, lambda x: x[:, 1] > 0, cell)
    region = BLOCKS[kind](*(whole.points[whole.corners].mean(axis=1) > 0).astype(int).T)
    table, x = whole.table, whole.points[whole.table.vertices]
    first, second = table.cells.T
    cut = (second >= 0) & (region[first] != region[second])
    flat = [np.ptp(x[..., k], axis=1) < 1e-12 for k in range(3)]
    facets = {name: table.vertices[cut & flat[k]] for k, name in enumerate("XYZ") if (cut & flat[k]).any()}
    seams = {name: Seam(direction=tuple(np.eye(3)["XYZ".index(name)])) for name in facets}
    for name, at in (("BOTTOM", -1.0), ("TOP", 1.0)):
        facets[name] = table.vertices[flat[1] & (x[:, 0, 1] == at)]
    facets["SIDE"] = table.vertices[(second < 0) & ~flat[1]]
    names = tuple(f"BLOCK {k + 1}" for k in range(region.max() + 1))
    return Joint(whole.points, whole.cells, cell, region, names, facets, seams)


def jump_errors(element: str, sizes) -> np.ndarray:
    """(sizes,) errors of the jump of the interface model against meshed layers, .3 away from junctions and the outside.

    The top of a cube is shifted.
    """
    joint = cube("T", "tetrahedron" if element[0] == "P" else "hexahedron")
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": -0.02, "z": 0.005}}
    structure = Structure(joint, body=LinearElastic.young(1.0, 0.2), supports=supports, element=element)
    layers = lambda eps: {name: ThinLayer(LinearElastic(*LAW[name]), THICK[name] * eps, at=1.0) for name in LAW}
    limit = structure.interface(layers(0.01))
    surface, errors = Surface(limit), []
    inner = (np.hypot(*surface.x[:2]) > 0.3) & (abs(surface.x) < 0.7).all(axis=0)
    w = surface.jump(solve(limit))
    for eps in sizes:
        full = structure.full(layers(eps), cells_through=2, bodies="extended")
        errors.append(surface.norm(surface.jump(solve(full)) - w, inner) / surface.norm(w, inner))
    return np.array(errors)


CELLS = ("hexahedron", "tetrahedron")


# ---------------------------------------------------------------- geometry
CUBES = [("T", "hexahedron", 1), ("T", "tetrahedron", 1), ("X", "tetrahedron", 2)]


@pytest.mark.few(1)
@pytest.mark.parametrize(("kind", "cell", "wanted"), CUBES)
def test_cubes_of_blocks(kind, cell, wanted):
    """Nothing is folded or free inside, triangles or quadrilaterals fill the lines, and numbers do not depend on eps."""
    base, counts = renumbered(cube(kind, cell)), set()
    for eps, through, bodies in ((0.1, 2, "extended"), (1e-4, 2, "extended"), (0.02, 2, "kept"), (0.02, 4, "extended")):
        opened = inflate(base, {name: THICK[name] * eps for name in base.seams}, bodies=bodies, cells_through=through)
        check(base, opened)
        assert opened.band.junctions == {"LAYER/JUNCTIONS": "X"}
        cell_volumes = volumes(opened)
        if bodies == "extended":
            assert cell_volumes.sum() == pytest.approx(8.0, rel=1e-12)
            assert areas(opened)["LAYER/JUNCTIONS"] == pytest.approx(wanted * 0.7 * eps**2, rel=1e-7)
        else:
            assert cell_volumes[: len(base.cells)] == pytest.approx(volumes(base), rel=1e-10)
        counts |= {(len(opened.points), len(opened.cells))} if through == 2 else set()
    assert len(counts) == 1


WALLS = [("triangle", None, "kept"), ("quadrilateral", None, "extended"), *zip(CELLS, (0.75, 0.75), WAYS, strict=True)]


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "depth", "bodies"), WALLS)
def test_a_wall_on_a_rigid_base(cell, depth, bodies):
    """A head that ends at the base meets the layer there in a triangle, as at a bed."""
    base = wall(2, 2, BRICK, 0.25, depth=depth, cell=cell)
    base = replace(base, seams=base.seams | {"BOTTOM": Seam()})
    bed, head, bottom = 0.02, 0.01, 0.03
    opened = inflate(base, {"BED": bed, "HEAD": head, "BOTTOM": bottom}, bodies=bodies, junctions=["BED", "BOTTOM"])
    check(base, opened)
    region_areas = {name: volume / (depth or 1.0) for name, volume in areas(opened).items()}
    assert region_areas["LAYER/JUNCTIONS/BED"] == pytest.approx(3 * bed * head / 2)
    assert region_areas["LAYER/JUNCTIONS/BOTTOM"] == pytest.approx(bottom * head / 2)
    corners = (3 * bed + bottom) * head / 2 if bodies == "kept" else -(3 * bed / 2 + bottom) * head
    layers = 2 * bed + 1.5 * head + 2 * bottom + corners
    assert sum(region_areas.values()) == pytest.approx(layers, rel=1e-10)
    kept = volumes(opened)[: len(base.cells)].sum() / (depth or 1.0)
    assert kept == pytest.approx(2.0 if bodies == "kept" else 2.0 - layers, rel=1e-10)
    ends = {name for name in opened.facets if name.endswith("/LAYER")}
    assert ends == {f"{name}/LAYER" for name in base.facets if name not in base.seams}


def test_junctions_on_the_outer_boundary():
    """Layers meet along a line in a flat side: outer faces close what is between."""
    half = grid([np.linspace(0.0, 1.0, 3), *[np.linspace(-1.0, 1.0, 5)] * 2], lambda x: x[:, 1] > 0, "tetrahedron")
    x, y, _ = half.points[half.corners].mean(axis=1).T
    base, counts = renumbered(parted(half, (y > 0).astype(int) + (y > x))), set()
    for eps in (0.01, 1e-4):
        opened = inflate(base, eps, bodies="extended", cells_through=2)
        check(base, opened)
        # the layer's end cuts the edge x = y = 1
        assert volumes(opened).sum() == pytest.approx(4.0 - eps**2 / 2, rel=1e-12)
        # between the layers along y = 0 and y = x a triangle, its base in x = 0 as long as it is high
        assert areas(opened)["LAYER/JUNCTIONS"] == pytest.approx((0.5 + 0.5**0.5) ** 2 * eps**2, rel=1e-7)
        counts.add((len(opened.points), len(opened.cells)))
    assert len(counts) == 1


def test_gaps():
    """Open Y: X ends at it. Open X: Y passes its end."""
    base, thick = cube("T", "tetrahedron"), {"X": 0.014, "Y": 0.02}
    opened = inflate(base, thick, bodies="extended", cells_through=2, gaps=["X"])
    assert opened.band.junctions == {"LAYER/JUNCTIONS": "Y"}
    assert areas(opened) == pytest.approx({"LAYER/Y": 0.02 * (4 - 0.014), "LAYER/JUNCTIONS": 0.014 * 0.02})
    alone = inflate(base, thick, bodies="extended", cells_through=2, gaps=["Y"])
    assert areas(alone) == pytest.approx({"LAYER/X": 2 * 0.014 * (1 - 0.01)})


def test_bodies_that_touch_along_an_edge_only():
    """Where layers end at the edge they enclose no polygon; layers that pass it beside one another do not meet."""
    axis = np.linspace(-1.0, 1.0, 5)
    base = grid([axis] * 3, lambda x: x[:, 0] > 0, "tetrahedron", keep=lambda x: x[:, 1] * x[:, 2] > 0)
    opened = inflate(base, 0.01, bodies="extended", cells_through=2)
    assert volumes(opened).sum() == pytest.approx(4.0, rel=1e-12)
    assert opened.band.regions == ("LAYER",)
    y, z = base.points[base.corners].mean(axis=1).T[1:]
    touching = parted(base, (y > z).astype(int))
    block = grid([np.arange(4.0), *[np.arange(5.0)] * 2], lambda x: x[:, 0] > 1, "tetrahedron")
    at = np.floor(block.points[block.corners].mean(axis=1)).astype(int)
    cubes = sum(k * (at == place).all(axis=1) for k, place in ((1, (1, 1, 1)), (2, (1, 2, 2))))  # in a third body
    for joint, words in (
        (touching, r"at \(.*, 0, 0\) bodies only touch at a vertex or an edge"),
        (parted(block, cubes), r"at \(1.5, 2, 2\) bodies only touch at a vertex or an edge"),
        (cube("T x collar", "hexahedron"), r"S branches at \(0, 0, 0\), where lines along which layers meet come"),
    ):
        refused(InputError, words, inflate, joint, 0.01, bodies="extended")


# ---------------------------------------------------------------- models
@pytest.mark.parametrize("element", ["Q2", "P2"])
def test_jumps_converge(element):
    """At rate 1, for laws by the names of seams."""
    errors = jump_errors(element, (0.04, 0.02))
    assert 0.9 < np.log2(errors[0] / errors[1]) < 1.1
    assert errors[1] < 0.025
