"""Meshes from files that are refused, each with its reason and place."""

from __future__ import annotations

import gmsh
import numpy as np
import pytest

from forms.base import InputError
from geometry import read
from geometry.inflating.inflation import inflate
from tests.meshes import GRID, LINES, NAMES, SPACE, boxes, drawing, in_layer, save, sides, squares, volume, volumes
from tests.refused import refused


@pytest.fixture
def draw():
    with drawing() as occ:
        yield occ


def test_unconnected_bodies(draw, tmp_path):
    low, up = boxes(draw, (0, -1, 2, 1), (0, 0, 2, 1), shared=False)
    path = save(tmp_path / "a.msh", 2, {(2, "LOW"): [low], (2, "UP"): [up], (1, "S"): sides(0, 0, 2, 0)[:1]}, h=0.5)
    words = r"^\S*a\.msh: \d+ pairs of nodes at the same place, .* \(.*BooleanFragments"
    refused(InputError, words, lambda: read(path, upper="UP"))


@pytest.mark.parametrize(
    ("dim", "options", "message"),
    [
        (2, {"ElementOrder": 3}, "triangle10; allowed: triangle, triangle6, quad, .*ElementOrder"),
        (2, {"RecombineAll": 1, "ElementOrder": 2, "SecondOrderIncomplete": 1}, "quad8; .*SecondOrderIncomplete = 0"),
        (3, {}, "2D mesh in 3D: .* triangle at z = 0 to 1.*Physical Volume"),
    ],
)
def test_cells_that_are_not_allowed(draw, tmp_path, dim, options, message):
    (body,) = boxes(draw, (0, 0, 1, 1), dim=dim)
    groups = {(2, "SKIN"): sides(0, 0, 1, 1, 3)} if dim == 3 else {(2, "BODY"): [body]}
    if "RecombineAll" in options:
        gmsh.model.mesh.setTransfiniteSurface(body)
    refused(InputError, message, lambda: read(save(tmp_path / "a.msh", 2, groups, h=1.0, **options)))


def moved(point, *x):
    points = GRID.copy()
    points[point] = x
    return points


FLAT = dict(points=moved(8, 1, 0.5), kind="triangle", cells=[[4, 7, 8], [0, 1, 4]], lines=[[0, 1], [1, 4]])
TETRAHEDRON = dict(points=SPACE, kind="tetra", cells=[[0, 1, 4, 9]], regions=[1], names={"UP": (1, 3), "S": (1, 2)})
BROKEN = [
    (FLAT | dict(regions=[2, 1]), r"1 of 2 cells are degenerate \(no volume\); the first is at \(1, 0\.5\)"),
    (dict(points=moved(8, 1.2, 0.2)), r"1 of 4 cells are folded .*; the first is at \(1\.3, 0\.3\)"),
    (dict(points=moved(8, 1.5, 0.5)), "1 of 4 cells are folded"),
    (dict(points=moved(8, np.nan, 0.5)), "nodes without coordinates"),
    (dict(more=[("quad", [[7, 4, 5, 8]], 1)]), "1 of 5 cells have the vertices of another cell"),
    (dict(more=[("quad", [[3, 4, 8, 6]], 2)]), "1 facets belong to more than two cells"),
    (dict(more=[("triangle", [[5, 8, 7]], 2)]), "mixed cell types: 4 quad, 1 triangle"),
    (dict(points=SPACE, more=[("wedge", [[0, 1, 2, 3, 4, 5]], 2)]), "1 wedge; allowed: triangle, .*with hexahedra"),
    (dict(kind="line", cells=[[0, 1], [1, 2]], regions=[1, 2]), "6 line; .*save the bodies' cells too"),
    (dict(points=np.column_stack([GRID, GRID[:, 1]])), "2D mesh in 3D: 4 quad at z = -1 to 1"),
    (dict(names=NAMES | {"S": (9, 1), "SS": (1, 1)}), "'S', did you mean 'SS'.; known: SS, TOP"),
    (dict(lines=[[3, 4], [7, 8]]), r"1 of 2 facets named 'S' lie on the outer boundary.* is at \(1\.5, 1\)"),
    (dict(lines=[[3, 4], [4, 8]]), r"1 of 2 facets named 'S' are not facets .* is at \(1\.5, 0\.5\)"),
    (dict(points=[*GRID, (1, 0.1)], lines=[[3, 9], [9, 5]]), r"not part of the bodies' mesh, .* at \(0\.5, 0\.05\)"),
    (dict(regions=[1, 2, 1, 2]), r"same body on both sides, the first at \(0\.5, 0\)"),
    (TETRAHEDRON | dict(more=[("quad", [[0, 1, 4, 3]], 1)]), "quad facets, but its tetrahedron cells have triangle"),
    (
        dict(regions=[1, 1, 2, 0]),
        r"1 of 4 cells are in no named group \(physical names: LOW, UP\); the first is at \(1.5, 0.5\)",
    ),
    (dict(names=NAMES | {"LAYER": (1, 2), "LOW": (9, 2)}), "'LAYER' cannot be a name; not allowed: LAYER, LOWER_FACE"),
    (dict(names=NAMES | {"A/B": (2, 1), "TOP": (9, 1)}), "'A/B' cannot be a name; .*names with '/'"),
]


@pytest.mark.parametrize(("change", "message"), BROKEN)
def test_broken_meshes(tmp_path, change, message):
    assert read(squares(tmp_path / "a.msh"), upper="UP").planar
    refused(InputError, message, lambda: read(squares(tmp_path / "a.msh", **change), upper="UP"))


def test_arguments(tmp_path):
    path = squares(tmp_path / "a.msh")
    for arguments, message in [
        (dict(), "'S' lies inside LOW and UP; name the regions above it in upper.*regions: LOW, UP"),
        (dict(upper="UP", scale=0.0), "scale is 0.0; it must be a number > 0"),
        (dict(upper="UP", scale=-1.0), "scale is -1.0; it must be a number > 0"),
        (dict(upper="UP", S="TOPP"), "unknown set of facets 'TOPP', did you mean 'TOP'"),
        (dict(upper="UP", lower="LOW", S=None), "other facets are named 'S'"),
        (dict(upper="UP", S="TOP"), "other facets are named 'S'"),
        (dict(upper="UP", lower="TOP"), "unknown region 'TOP'"),
        (dict(upper=["LOW", "UP"], direction=(0, 0, 1)), "it needs 2 components"),
    ]:
        refused(InputError, message, read, path, **arguments)


def test_files_that_cannot_be_read(tmp_path, capfd):
    for name, text, message in [
        ("a.msh", None, "there is no such file"),
        ("a.mhs", "", r"unknown suffix '\.mhs', did you mean '\.msh'"),
        ("a.vtu", "nothing", r"meshio cannot read this \.vtu file"),
        ("a.msh", "nothing", r"meshio cannot read this \.msh file"),
        ("a.med", "nothing", r"meshio cannot read this \.med file|\.med files need the Python package h5py"),
        ("a.off", "OFF\n0 0 0\n", "the file has no cells|cannot read"),
    ]:
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=message):
            read(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def plate(occ, path, lower, upper):
    """Two polygons LOW and UP, S between them."""

    def polygon(corners):
        points = [occ.addPoint(x, y, 0) for x, y in corners]
        lines = [occ.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
        return occ.addPlaneSurface([occ.addCurveLoop(lines)])

    low, up = polygon(lower), polygon(upper)
    occ.fragment([(2, low)], [(2, up)])
    return read(save(path, 2, {(2, "LOW"): [low], (2, "UP"): [up]}, h=0.3), S=None, upper="UP", lower="LOW")


def test_folded_interface(draw, tmp_path):
    """A needle of the lower body in the upper one."""
    s = [(0, 0), (0.99, 0), (1, 0.7), (1.01, 0), (2, 0)]
    joint = plate(draw, tmp_path / "a.msh", [(0, -1), (2, -1), *s[::-1]], [*s, (2, 1), (0, 1)])
    refused(InputError, r"S is folded at \(1, 0\.7\)", lambda: inflate(joint, 0.001, bodies="extended"))


def test_branching_interface(tmp_path):
    """A checkerboard: the corners of four squares are those of the square between the layers that cross."""
    path = squares(
        tmp_path / "a.msh", lines=LINES[2:], regions=[1, 2, 2, 1], names=NAMES | {"S": (9, 1), "TOP": (1, 1)}
    )
    joint = read(path, S=None, upper="UP", lower="LOW")
    assert len(joint.facets["S"]) == 4
    for bodies, whole, layer in (("kept", 4.0401, 0.0401), ("extended", 4.0, 0.0399)):
        opened = inflate(joint, 0.01, bodies=bodies)
        assert opened.band.regions == ("LAYER", "LAYER/JUNCTIONS")
        assert volume(opened) == pytest.approx(whole, rel=1e-12)
        assert volumes(opened)[in_layer(opened)].sum() == pytest.approx(layer, rel=1e-10)


@pytest.mark.parametrize("width", [2.0, 1.7])
def test_no_room_for_the_layer(draw, tmp_path, width):
    """A C on a rigid base at the lower face of its upper arm: the layer grows down into the lower arm."""
    parts = boxes(draw, (0, 0, 1, 4), (1, 0, width, 1), (1, 2, 2, 2))
    groups = {(2, "C"): parts, (1, "S"): sides(1, 2, 2, 0)}
    joint = read(save(tmp_path / "a.msh", 2, groups), scale=10.0)
    assert joint.rigid_base
    assert volume(inflate(joint, 9.0)) == pytest.approx(100 * (8 + width) + 20 * 9)
    refused(InputError, r"no room for a layer of thickness 11 at \([\d.]+, [\d.]+\)", lambda: inflate(joint, 11.0))


@pytest.mark.parametrize("choice", [dict(direction=(0, 1)), dict(upper="IN")])
def test_several_joints(draw, tmp_path, choice):
    """Two parallel lines: S does not end there; with the upper body on both sides n turns round, which is no curved S."""
    parts = boxes(draw, (0, 0, 2, 1), (0, 1, 2, 1), (0, 2, 2, 1))
    groups = {(2, "OUT"): parts[::2], (2, "IN"): parts[1:2], (1, "S"): sides(0, 1, 2, 0) + sides(0, 2, 2, 0)}
    joint = read(save(tmp_path / "a.msh", 2, groups), **choice)
    assert joint.tip is None
    assert not joint.seams_meet
    assert volume(inflate(joint, 0.1)) == pytest.approx(6.4)
    assert volume(inflate(joint, 0.1, bodies="extended")) == pytest.approx(6.0)


def test_bonded_beside_s(draw, tmp_path):
    parts = boxes(draw, (0, 0, 3, 1), (0, 1, 1, 1), (2, 1, 1, 1))
    groups = {(2, "LOW"): parts[:1], (2, "UP"): parts[1:], (1, "S"): sides(0, 1, 1, 0)}
    joint = read(save(tmp_path / "a.msh", 2, groups), upper="UP")
    opened = inflate(joint, 0.1)  # what is bonded to the lower body goes down with it
    x = opened.points[opened.corners[opened.region == opened.regions.index("UP")]]
    assert x[x[..., 0] < 1.5].max(axis=0)[1] == pytest.approx(2.05)
    assert x[x[..., 0] > 1.5].max(axis=0)[1] == pytest.approx(1.95)
    assert volume(opened) == pytest.approx(5.1)


def test_bridge(draw, tmp_path):
    """The upper body stands with one leg on S, with the other one it is bonded: one body, on both sides of S."""
    low = [(0, 0, 3, 1), (0, 1, 1, 1), (2, 1, 1, 1)]
    parts = boxes(draw, *low, (0, 2, 1, 1), (2, 2, 1, 1), (0, 3, 3, 1))
    groups = {(2, "LOW"): parts[:3], (2, "UP"): parts[3:], (1, "S"): sides(0, 2, 1, 0)}
    joint = read(save(tmp_path / "a.msh", 2, groups), upper="UP")
    assert joint.tip is None
    refused(InputError, r"one body, as at .*, lies below S and above it: .*'extended'", lambda: inflate(joint, 0.1))
    assert volume(inflate(joint, 0.1, bodies="extended")) == pytest.approx(10.0)


def wall(draw, tmp_path):
    """A wall in running bond, two courses high."""
    parts = boxes(draw, (0, 0, 2, 1), (2, 0, 2, 1), (0, 1, 1, 1), (1, 1, 2, 1), (3, 1, 1, 1))
    bed, head = sides(0, 1, 4, 0), sides(2, 0, 0, 1) + sides(1, 1, 0, 1) + sides(3, 1, 0, 1)
    ends = {"BOTTOM": (0, 0, 4, 0), "TOP": (0, 2, 4, 0), "LEFT": (0, 0, 0, 2), "RIGHT": (4, 0, 0, 2)}
    groups = {(1, name): sides(*where) for name, where in ends.items()} | {(1, "JOINTS"): bed + head}
    path = save(tmp_path / "a.msh", 2, {(2, "WALL"): parts, (1, "BED"): bed, (1, "HEAD"): head, **groups})
    return lambda **data: read(path, **data)


def test_running_bond(draw, tmp_path):
    """S branches, whatever tells its upper side, and opens as that of a built wall does."""
    build = wall(draw, tmp_path)
    with pytest.raises(InputError, match=r"does not tell the upper side of 'S': it lies in the facet near \(\d, "):
        build(S="JOINTS", direction=(0, 1))
    choices = [{"S": "JOINTS", "direction": way} for way in [(1, 1), (0.3, 1), (-1, 0.5)]]
    choices += [{"S": {"BED": (0, 1), "HEAD": (1, 0)}}, {"S": {"BED": (0, -1), "HEAD": (1, 1)}}]
    for choice in choices:
        joint = build(**choice)
        branches = np.unique(joint.points[joint.splitting.valence == 3], axis=0)
        assert branches == pytest.approx(np.array([[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]]))
        assert set(joint.splitting.pieces) == set(range(5))
        assert volume(inflate(joint, 0.01, bodies="extended")) == pytest.approx(8.0, rel=1e-12)
        assert volumes(inflate(joint, 0.01))[in_layer(inflate(joint, 0.01))].sum() == pytest.approx(0.07015, rel=1e-10)


@pytest.mark.parametrize("open_end", [0.0, 1e-6])
def test_gap_beside_s(draw, tmp_path, open_end):
    """Unbonded beside S: two nodes at one place may be a mistake, a gap that is drawn is none."""
    points = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1), (0, 2), (1, 2), (2, 2), (2, 1 + 2 * open_end)]
    cells = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 9, 8, 7]]
    path = squares(tmp_path / "a.msh", np.array(points, float), cells, [[3, 4]], names={**NAMES, "S": (1, 1)})
    if not open_end:
        words = r"1 pairs of nodes .* \(2, 1\).* stay unbonded wider than 1e-09"
        refused(InputError, words, lambda: read(path, upper="UP"))
    else:
        assert volume(inflate(read(path, upper="UP"), 0.1)) == pytest.approx(4.1, rel=1e-5)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"S": ["BED", 1]}, r"S is \['BED', 1\]; give the name of one set of facets .* or None"),
        ({"S": []}, r"S is \[\]; give the name of one set of facets"),
        ({"S": {"BED": 3}}, "S: the upper side of 'BED' is 3; give a vector, .* or None"),
        ({"S": {"BED": None}, "upper": "UP"}, "S names several seams: give the sides of each there"),
        ({"upper": 3}, "upper is 3; give the name of a region, or several in a list"),
        ({"lower": ["LOW", 1]}, r"lower is \['LOW', 1\]; give"),
        ({"direction": "up"}, "direction is 'up'; it needs 2 components"),
        ({"direction": (0, float("nan"))}, "direction is"),
        ({"scale": True}, "scale is True; it must be a number > 0"),
        ({"mesh": None}, "mesh is None; give the name of a file, or a dolfinx.mesh.Mesh"),
        ({"names": {"S": (1, 3)}}, "names are those of tags of DOLFINx; a file has its own"),
    ],
)
def test_arguments_of_read(data, message):
    refused(InputError, message, lambda: read(**{"mesh": "a.msh"} | data))
