"""Meshed networks of layers in 3D: junction lines and the polyhedra where they meet, and what is refused."""

import pytest

from geometry import GeometryError, inflate
from tests.meshed_cases3d import BLOCKS, cube
from tests.meshes import renumbered, volumes
from tests.test_meshed_networks import RATIOS, areas, check

CELLS = ("hexahedron", "tetrahedron")
THICK = {"X": 0.7, "Y": 1.0, "Z": 1.3}
CASES = [(kind, cell) for kind in BLOCKS for cell in CELLS if (kind, cell) != ("staggered", "hexahedron")]


def thickness(base, eps):
    """Of each seam."""
    return {name: eps * THICK[name] for name in base.seams}


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


def test_hexahedra_need_three_layers_around_a_corner():
    with pytest.raises(GeometryError, match=r"S branches at \(0, 0, 0\), .*need three layers.*not 2; use tetrahedra"):
        inflate(cube("staggered", "hexahedron"), 0.01, bodies="extended")
