"""Meshes from files that are refused, each with its reason and place."""

from __future__ import annotations

import numpy as np
import pytest

from forms.base import InputError
from geometry import read
from geometry.inflating.inflation import inflate
from tests.meshes import (
    GRID,
    LINES,
    NAMES,
    QUADS,
    SPACE,
    boxes,
    in_layer,
    save,
    sides,
    squares,
    volume,
    volumes,
)
from tests.refused import refused

NOT_ALLOWED = [
    (2, {"ElementOrder": 3}, "triangle10; save triangle, quad, .*ElementOrder"),
    (3, {}, "2D mesh in 3D: .* triangle cells at z = 0 to 1.*Physical Volume"),
]


@pytest.mark.parametrize(("dim", "options", "message"), NOT_ALLOWED)
def test_cells_that_are_not_allowed(draw, tmp_path, dim, options, message):
    (body,) = boxes(draw, (0, 0, 1, 1), dim=dim)
    groups = {(2, "SKIN"): sides(0, 0, 1, 1, 3)} if dim == 3 else {(2, "BODY"): [body]}
    refused(InputError, message, lambda: read(save(tmp_path / "a.msh", 2, groups, h=1.0, **options)))


def moved(point, *x):
    points = GRID.copy()
    points[point] = x
    return points


FLAT = dict(points=moved(8, 1, 0.5), kind="triangle", cells=[[4, 7, 8], [0, 1, 4]], lines=[[0, 1], [1, 4]])
TETRAHEDRON = dict(points=SPACE, kind="tetra", cells=[[0, 1, 4, 9]], regions=[1], names={"UP": (1, 3), "S": (1, 2)})
AROUND = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 9], [4, 5, 9], [5, 8, 9], [8, 7, 9], [7, 6, 9], [6, 3, 9]]
# three boxes, the last in halves
COLUMN = [[x, y, z] for z in (-1, 0, 1, 2) for x, y in ((0, 0), (3, 0), (3, 2), (0, 2))]
HALVES = [[8, 16, 17, 11, 12, 18, 19, 15], [16, 9, 10, 17, 18, 13, 14, 19]]
HALVED = dict(points=np.array(COLUMN + [[2, y, z] for z in (1, 2) for y in (0, 2)]), kind="hexahedron")
HALVED |= dict(cells=[[*range(8)], [*range(4, 12)], *HALVES], regions=[1, 2, 2, 2], more=[("quad", [[4, 5, 6, 7]], 1)])
HALVED |= dict(names={"LOW": (1, 3), "UP": (2, 3), "S": (1, 2)})
APART = [*QUADS[:2], [9, 10, 7, 6], [10, 11, 8, 7]]  # a body above a gap
TENT = dict(kind="triangle", points=[*GRID, (1, 1.3)], cells=AROUND, regions=[1] * 4 + [2] * 6)
HANGING = dict(points=[*GRID, (2, 2), (0, 2)], more=[("quad", [[6, 8, 9, 10]], 2)])
BROKEN = [
    (FLAT | dict(regions=[2, 1]), r"1 of 2 cells are degenerate \(no volume\); the first is at \(1, 0\.5\)"),
    (dict(points=moved(8, 1.2, 0.2)), r"1 of 4 cells are folded .*; the first is at \(1\.3, 0\.3\)"),
    (dict(points=moved(8, np.nan, 0.5)), "nodes without coordinates"),
    (dict(points=[*GRID, GRID[5]], cells=[*QUADS[:3], [4, 9, 8, 7]], lines=[[3, 4]]), r"1 pairs of nodes .*BooleanF"),
    (
        dict(points=np.vstack([GRID, GRID[3:6] + 1e-3]), cells=APART),
        "S' lies on the outer boundary of LOW, and UP, .* ",
    ),
    (dict(more=[("quad", [[7, 4, 5, 8]], 1)]), "2 of 4 cells are in none of UP; name every region"),  # one cell, twice
    (dict(points=[*GRID, (0, 0.8)], more=[("quad", [[3, 4, 7, 9]], 1)]), "facets belong to more than two cells"),
    (dict(more=[("triangle", [[5, 8, 7]], 2)]), "2 facets have both cells on one side.*overlaps itself"),
    (dict(kind="line", cells=[[0, 1], [1, 2]], regions=[1, 2]), "6 line; save triangle, .*of the bodies too"),
    (dict(names=NAMES | {"S": (9, 1), "SS": (1, 1)}), "'S', did you mean 'SS'.; known: SS, TOP"),
    (dict(lines=[[3, 4], [7, 8]]), r"1 of 2 facets of 'S' lie on the outer boundary, as at \(1\.5, 1\)"),
    (dict(lines=[[3, 4], [4, 8]]), r"some facets named 'S' are not facets .* at \(1\.5, 0\.5\)"),
    (dict(points=[*GRID, (1, 0.1)], lines=[[3, 9], [9, 5]]), r"not part of the bodies' mesh, .* at \(0\.5, 0\.05\)"),
    (TENT, r"2 .* at \(0\.5, 1\.15\): the m.*o"),
    (HANGING, r"1 nodes hang .* at \(1, 1\): these c.* not c"),
    (HALVED, r"2 nodes hang .* at \(2, 0, 1\): these cells"),
    (dict(regions=[1, 2, 1, 2]), r"same body on both sides, the first at \(0\.5, 0\)"),
    (TETRAHEDRON | dict(more=[("quad", [[0, 1, 4, 3]], 1)]), "quad facets, but its tetrahedron cells have triangle"),
    (dict(regions=[1, 1, 2, 0]), r"1 of 4 cells are in no named group \(physical names: LOW, UP\); .* \(1.5, 0.5\)"),
    (dict(names=NAMES | {"LAYER": (1, 2), "LOW": (9, 2)}), "'LAYER' cannot be a name; not allowed: LAYER, JUNCT"),
    (dict(names=NAMES | {"BASE": (2, 1), "TOP": (9, 1)}), "'BASE' cannot be a name; not allowed: LAYER, LOWER_FACE"),
    (dict(names=NAMES | {"A/B": (2, 1), "TOP": (9, 1)}), "'A/B' cannot be a name; .*names with '/'"),
]


def test_broken_meshes(tmp_path):
    joint = read(squares(tmp_path / "a.msh", names=NAMES | {"BASE": (1, 2), "LOW": (9, 2)}), upper="UP")  # a region
    assert inflate(joint, 0.1).regions[:2] == ("BASE", "UP")
    for change, message in BROKEN:
        refused(InputError, message, read, squares(tmp_path / "a.msh", **change), upper="UP")


def test_arguments(tmp_path):
    path = squares(tmp_path / "a.msh")
    for arguments, message in [
        (dict(), "'S' lies inside LOW and UP; name the regions above it in upper.*regions: LOW, UP"),
        (dict(upper="UP", scale=0.0), "scale is 0.0; it must be a number > 0"),
        (dict(S=["BED", 1]), r"S is \['BED', 1\]; give the name of one set of facets, .* or None"),
        (dict(S={"BED": 3}), "S: the upper side of 'BED' is 3; give a vector, .* or None"),
        (dict(S={"BED": None}, upper="UP"), "S names several seams: give the sides of each there"),
        (dict(upper=3), "upper is 3; give the name of a region, or several in a list"),
        (dict(upper="UP", direction="up"), "it needs 2 components"),
        (dict(names={"S": (1, 3)}), "names: tags are of DOLFINx meshes; for a file give"),
        (dict(upper="UP", S="TOPP"), "unknown set of facets 'TOPP', did you mean 'TOP'"),
        (dict(upper="UP", S="TOP"), "other facets are named 'S'"),
        (dict(upper="UP", lower="TOP"), "unknown region 'TOP'"),
        (dict(S={"S": ("UP", "DOWN")}), "unknown region 'DOWN'"),
        (dict(S=["S", "TOPP"]), "unknown set of facets 'TOPP', did you mean 'TOP'"),
    ]:
        refused(InputError, message, read, path, **arguments)


def test_files_that_cannot_be_read(tmp_path, capfd):
    for name, text, message in [
        ("a.msh", None, "a.msh: the file does not exist in "),
        ("a.node", "", "a.node: the file is empty"),
        ("a.mhs", "nothing", r"meshio cannot read this \.mhs file"),
        ("a.msh", "nothing", r"meshio cannot read this \.msh file"),
        ("a.med", "nothing", r"meshio cannot read this \.med file"),
        ("a.e", "nothing", r"this is no Exodus II file in NetCDF 3 or 4"),
        ("a.off", "OFF\n0 0 0\n", "the file has no cells|cannot read"),
    ]:
        if text is not None:
            (tmp_path / name).write_text(text)
        refused(InputError, message, read, tmp_path / name)
    assert capfd.readouterr() == ("", "")


def test_branching_interface(tmp_path):
    """A checkerboard: the corners of four squares are those of the square between the layers that cross."""
    names = NAMES | {"S": (9, 1), "TOP": (1, 1)}
    path = squares(tmp_path / "a.msh", lines=LINES[2:], regions=[1, 2, 2, 1], names=names)
    joint = read(path, S=None, upper="UP", lower="LOW")
    assert len(joint.facets["S"]) == 4
    for bodies, whole, layer in (("kept", 4.0401, 0.0401), ("extended", 4.0, 0.0399)):
        opened = inflate(joint, 0.01, bodies=bodies)
        assert opened.band.regions == ("LAYER", "LAYER/JUNCTIONS")
        assert volume(opened) == pytest.approx(whole, rel=1e-12)
        assert volumes(opened)[in_layer(opened)].sum() == pytest.approx(layer, rel=1e-10)


def test_no_room_for_the_layer(draw, tmp_path):
    """A C on a rigid base at the lower face of its upper arm: the layer grows down into the lower arm."""
    parts = boxes(draw, (0, 0, 1, 4), (1, 0, 1.7, 1), (1, 2, 2, 2))
    joint = read(save(tmp_path / "a.msh", 2, {(2, "C"): parts, (1, "S"): sides(1, 2, 2, 0)}), scale=10.0)
    assert joint.rigid_base
    assert volume(inflate(joint, 9.0)) == pytest.approx(100 * (8 + 1.7) + 20 * 9)
    refused(InputError, r"no room for a layer of thickness 11 at \([\d.]+, [\d.]+\)", lambda: inflate(joint, 11.0))


def test_bridge(draw, tmp_path):
    """The upper body stands with one leg on S, with the other one it is bonded: one body, on both sides of S."""
    low = [(0, 0, 3, 1), (0, 1, 1, 1), (2, 1, 1, 1)]
    parts = boxes(draw, *low, (0, 2, 1, 1), (2, 2, 1, 1), (0, 3, 3, 1))
    groups = {(2, "LOW"): parts[:3], (2, "UP"): parts[3:], (1, "S"): sides(0, 2, 1, 0)}
    joint = read(save(tmp_path / "a.msh", 2, groups), upper="UP")
    assert joint.tip is None
    refused(InputError, r"one body, as at .*, lies below S and above it: .*'extended'", lambda: inflate(joint, 0.1))
    assert volume(inflate(joint, 0.1, bodies="extended")) == pytest.approx(10.0)
