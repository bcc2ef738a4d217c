"""Meshes from files: names, S, curved cells, and what is refused."""

from __future__ import annotations

from itertools import cycle

import gmsh
import meshio
import numpy as np
import pytest

from forms.base import InputError
from geometry import block, read, sandwich
from geometry.inflating.inflation import inflate
from geometry.seam import Seam
from geometry.topology import lagrange
from tests.meshes import (
    CELLS,
    GRID,
    LINES,
    QUADS,
    blocks_of,
    boxes,
    rings,
    save,
    sides,
    stack,
    volume,
    write,
)
from tests.refused import refused


@pytest.mark.parametrize(("version", "binary", "dim"), [(2.2, 0, 3), (2.2, 1, 2), (4.1, 0, 2), (4.1, 1, 3)])
def test_gmsh_formats(draw, tmp_path, dim, version, binary, capfd):
    joint = read(stack(draw, tmp_path / "a.msh", dim, version=version, binary=binary), upper="UPPER")
    assert (joint.dim, joint.seams) == (dim, {"S": Seam(("LOWER",), ("UPPER",))})
    assert volume(joint) == pytest.approx(4.0)
    assert set(joint.facets) == {"S", "TOP"}
    assert joint.points[joint.facets["TOP"]][..., 1] == pytest.approx(1.0)
    assert joint.interface_normals == pytest.approx(np.tile(np.eye(dim)[1], (len(joint.facets["S"]), 1)))
    assert capfd.readouterr() == ("", "")
    whole = read(tmp_path / "a.msh", S="S", upper="LOWER", scale=10.0)
    assert whole.points == pytest.approx(10 * joint.points)
    assert whole.interface_normals[0] == pytest.approx(-joint.interface_normals[0])


CURVED = [*((cell, 2, "msh") for cell in CELLS), ("hexahedron", 2, "vtu"), ("quadrilateral", 1, "vtu")]


@pytest.mark.parametrize(("cell", "degree", "suffix"), CURVED)
def test_cells(draw, tmp_path, cell, degree, suffix):
    """Curved cells keep their shape: the order of their nodes is right."""
    path, names = rings(draw, tmp_path / "a.msh", cell, degree), ("S", "CORE", "RING")
    if suffix == "vtu":
        mesh = meshio.read(path)
        numbers = {name: str(tag) for name, (tag, _) in mesh.field_data.items()}
        names = tuple(numbers[name] for name in names)
        data = {"tags": mesh.cell_data["gmsh:physical"]}
        path = tmp_path / "a.vtu"
        meshio.Mesh(mesh.points, mesh.cells, cell_data=data).write(path)
    s, core, ring = names
    joint = read(path, S=s, upper=ring)
    assert (joint.cell_type, joint.seams["S"].lower, set(joint.facets)) == (cell, (core,), {"S"})
    assert joint.cells.shape[1] == lagrange(cell, degree).dim
    assert volume(joint) == pytest.approx(4 * np.pi, rel=0.1 if degree == 1 else 3e-3)
    radial = joint.points[joint.surface] * ([1, 1, 0][: joint.dim])
    assert np.linalg.norm(radial, axis=2) == pytest.approx(1.0, abs=1e-6)
    assert (joint.node_normals * radial).sum(axis=2) == pytest.approx(1.0, abs=0.2 if degree == 1 else 0.01)


SUFFIXES = [*zip(cycle(("triangle", "quadrilateral")), ("msh", "inp", "vtu", "vtk", "mesh"), strict=False)]


@pytest.mark.parametrize(("cell", "suffix"), SUFFIXES)
def test_round_trip(tmp_path, cell, suffix):
    """What a builder made comes back from a file with the same cells, names and normals."""
    joint = sandwich(2.0, 0.8, 1.1, 0.4, cell=cell) if cell == "triangle" else block(2.0, 1.5, 0.5, cell=cell)
    blocks, tags = blocks_of(joint)
    path, facets, regions = tmp_path / f"a.{suffix}", tuple(joint.facets), joint.regions
    if suffix == "msh":
        names = {name: [k, d] for d, of in ((1, facets), (2, regions)) for k, name in enumerate(of, 1)}
        write(path, joint.points, blocks, tags, names)
    elif suffix == "inp":
        at = lambda k, rows: [*([[]] * (k + 1)), np.arange(len(rows)), *([[]] * (len(facets) - k - 1))]
        sets = {name: at(k, rows) for k, (name, rows) in enumerate(joint.facets.items())}
        sets |= {name: [np.flatnonzero(joint.region == k), *([[]] * len(facets))] for k, name in enumerate(regions)}
        meshio.Mesh(joint.points, blocks, cell_sets=sets).write(path)
    else:
        meshio.Mesh(np.pad(joint.points, ((0, 0), (0, 1))), blocks, cell_data={"tags": tags}).write(path)
        facets, regions = (tuple(str(k + 1) for k in range(len(names))) for names in (facets, regions))
    back = read(path, S=facets[list(joint.facets).index("S")], upper=None if joint.rigid_base else regions[-1])
    assert (back.rigid_base, len(back.regions)) == (joint.rigid_base, len(joint.regions))
    assert back.points == pytest.approx(joint.points, abs=1e-12)
    assert (back.cells == joint.cells).all()
    assert [back.regions[k] for k in back.region] == [regions[k] for k in joint.region]
    for name, other in zip(joint.facets, facets, strict=True):
        rows = back.facets["S" if name == "S" else other]
        assert (rows == np.unique(np.sort(joint.facets[name], axis=1), axis=0)).all()
    assert back.interface_normals == pytest.approx(joint.interface_normals)


def test_whole_boundary_between_bodies(draw, tmp_path):
    """S=None; three regions, two of them one body."""
    low, left, right = boxes(draw, (0, -1, 2, 1), (0, 0, 1, 1), (1, 0, 1, 1))
    path = save(tmp_path / "a.msh", 2, {(2, "LOW"): [low], (2, "LEFT"): [left], (2, "RIGHT"): [right]})
    joint = read(path, S=None, upper=["LEFT", "RIGHT"], lower="LOW")
    assert np.ptp(joint.points[joint.facets["S"]][..., 0]) == pytest.approx(2.0)
    assert joint.tip is None
    inflate(joint, 0.1)
    joint = read(path, S=None, upper="LEFT", lower=["LOW", "RIGHT"])  # an angle
    assert np.abs(joint.interface_normals).min(axis=1) == pytest.approx(0.0, abs=1e-12)
    assert {tuple(n) for n in np.rint(joint.interface_normals).astype(int)} == {(0, 1), (-1, 0)}
    joint = read(path, S=None, upper="LEFT", lower="LOW")  # the third region is bonded to both
    assert joint.points[joint.facets["S"]][..., 0].max() == pytest.approx(1.0)
    assert (joint.bodies, joint.tip) == (("LOW", "LEFT", "RIGHT"), pytest.approx([1.0, 0.0]))
    refused(InputError, r"S=None .*give upper and lower; regions: LOW, LEFT, RIGHT", read, path, S=None, upper="LEFT")
    words = r"physical names: unknown region 'RIHT', did you mean 'RIGHT'\?; known: LEFT, LOW, RIGHT"
    refused(InputError, words, read, path, S=None, upper="RIHT", lower="LOW")
    refused(InputError, "unknown set of facets 'S'; known: none$", read, path, upper="LEFT")


def test_rigid_base(draw, tmp_path):
    left, right = boxes(draw, (0, 0, 1, 1), (1, 0, 1, 1), dim=3)
    path = save(tmp_path / "a.msh", 3, {(3, "ONE"): [left], (3, "TWO"): [right], (2, "FOOT"): sides(0, 0, 2, 0, 3)})
    joint = read(path, S="FOOT")
    assert joint.rigid_base
    assert (joint.seams["S"].upper, set(joint.facets)) == (("ONE", "TWO"), {"S"})
    assert joint.interface_normals[:, 1] == pytest.approx(1.0)
    inflate(joint, 0.1)
    both = dict(upper="TWO", lower="ONE")
    refused(InputError, "'S' lie on the outer .*; between ONE and TWO", lambda: read(path, S="FOOT", **both))


def test_s_inside_one_body(draw, tmp_path):
    """S cuts a body in two, or ends inside it."""
    parts = boxes(draw, (0, -1, 1, 1), (0, 0, 1, 1), (1, -1, 1, 1), (1, 0, 1, 1))
    groups = {(2, "BODY"): parts, (1, "CUT"): sides(0, 0, 2, 0), (1, "CRACK"): sides(0, 0, 1, 0)}
    path, up = save(tmp_path / "a.msh", 2, groups), np.eye(2)[1]
    joint = read(path, S="CUT", direction=up)
    assert joint.bodies == ("BODY",)
    assert joint.interface_normals @ up == pytest.approx(1.0)
    assert joint.tip is None
    assert volume(inflate(joint, 0.1)) == pytest.approx(4.2)
    crack = read(path, S="CRACK", direction=-up)
    assert crack.interface_normals @ up == pytest.approx(-1.0)
    assert len(crack.facets["CUT"]) == len(joint.facets["S"]) - len(crack.facets["S"])  # what is S is S alone
    refused(InputError, r"'CUT' lies inside BODY; name the regions above it .*direction", read, path, S="CUT")
    refused(InputError, "have the same body on both sides", lambda: read(path, S="CUT", upper="BODY"))


def test_names_of_gmsh(draw, tmp_path):
    """Facets with several names, groups without one, a name for two groups, cells without a group."""
    low, up = boxes(draw, (0, -1, 2, 1), (0, 0, 2, 1))
    s, top = sides(0, 0, 2, 0), sides(0, 1, 2, 0)
    gmsh.model.addPhysicalGroup(2, [up], 7)
    path = save(tmp_path / "a.msh", 2, {(2, "LOW"): [low], (1, "S"): s, (1, "BOTH"): s + top})

    def saved(**options):
        for name, value in options.items():
            gmsh.option.setNumber(f"Mesh.{name}", value)
        gmsh.write(str(path))
        return path

    for version in (2.2, 4.1):
        joint = read(saved(MshFileVersion=version), upper="7")
        assert (joint.seams["S"].lower, set(joint.facets)) == (("LOW",), {"S", "BOTH"})
        assert len(joint.facets["BOTH"]) == len(joint.facets["S"])  # the top; what is S is S alone
    gmsh.model.addPhysicalGroup(2, [up], name="S")
    words = r"physical name 'S' stands for the groups \d+ of dimension 1 and \d+ of"
    refused(InputError, words, read, saved(), upper="7")
    gmsh.model.removePhysicalGroups()
    gmsh.model.removePhysicalName("S")
    gmsh.model.addPhysicalGroup(2, [low], name="LOW")
    refused(InputError, r"meshio cannot read this \.msh file .*Mesh\.SaveAll = 0", lambda: read(saved(SaveAll=1)))
    gmsh.model.removePhysicalGroups()
    words = r'no named groups of cells .* Surface\("BODY"\) .*SaveAll = 0'
    refused(InputError, words, read, saved(MshFileVersion=2.2))


def test_arrays_of_numbers(tmp_path):
    """Without names the only array of integers counts; several are ambiguous; negative numbers are no group.

    But gmsh gives facets that it has turned round the negative number of their group.
    """
    names = {"LOW": (1, 2), "UP": (2, 2), "S": (7, 1)}
    for tags in ([7, 7], [7, -7], [-7, -7]):
        path = write(tmp_path / "a.msh", GRID, [("line", LINES[:2]), ("quad", QUADS)], [tags, [1, 1, 2, 2]], names)
        assert read(path, upper="UP").facets["S"].tolist() == LINES[:2].tolist()
    points, blocks = np.pad(GRID, ((0, 0), (0, 1))), [("quad", QUADS), ("line", LINES)]
    tags = [np.array([1, 1, 2, 2]), np.array([5, 5, -1, -1])]
    mesh = meshio.Mesh(points, blocks, cell_data={"part": tags, "size": [t * 0.5 for t in tags]})
    mesh.write(tmp_path / "a.vtu")
    assert set(read(tmp_path / "a.vtu", S="5", upper="2").facets) == {"S"}
    words = "numbers in the cell data 'part': unknown set of facets 'S'; known: 5"
    refused(InputError, words, read, tmp_path / "a.vtu", upper="2")
    mesh.cell_data["other"] = tags
    mesh.write(tmp_path / "a.vtu")
    words = "several arrays of integers could number the groups: part, other; give regions"
    refused(InputError, words, read, tmp_path / "a.vtu", S="5", upper="2")


ABAQUS = (
    "*Heading|*Part, name=P|*NODE, NSET=ALL|1, 0., 0.|2, 1., 0.|3, 3., 0.|4, 0., 1.|5, 1., 1.|*NODE|6, 3., 1.|7, , 2."
    "|8, 1., 2.|9, 3., 2.|** 10, 3., 2.|*ELEMENT, TYPE=CPE4R, ELSET=LOW|1, 1, 2, 5, 4|12, 2, 3,|6, 5|*Element, type=C"
    "AX4, elset=High|3, 4, 5, 8, 7|*ELEMENT, TYPE=T2D2|5, 4, 5|6, 5, 6|7, 7, 8|9, 8, 9|*ELEMENT, TYPE=CPE4R,| ELSET=H"
    "IGH|4, 5, 6, 9, 8|"
)


SETS = [
    ("*ELSET, ELSET=GLUE|5|", "*ELSET, ELSET=TOP|7, 9,|*ELSET, ELSET=Glue|6|"),
    ('*ELSET , ELSET = "GLUE", GENERATE|5, 5, 1|6, 6|', "*elset, elset=TOP, generate|7, 9, 2|"),
    ("*ELSET, ELSET=A|5|*ELSET, ELSET=B, INTERNAL|6|*ELSET, ELSET=GLUE|a, B|", "*INCLUDE, INPUT=top.inc|"),
]


@pytest.mark.parametrize("part", ["", "*End Part|*INSTANCE, NAME=P-1, PART=P|*End Instance|*Assembly|"])
@pytest.mark.parametrize(("glue", "top"), SETS)
def test_sets_of_abaqus(tmp_path, part, glue, top):
    """Sets in several blocks, of the names of others, and in other files have all their facets."""
    (tmp_path / "a.inp").write_text((ABAQUS + part + glue + top).replace("|", "\n"))
    (tmp_path / "top.inc").write_text("*ELSET, ELSET=TOP\n7\n*ELSET, ELSET=TOP\n9\n")
    joint = read(tmp_path / "a.inp", S="GLUE", upper="High", scale=2.0)
    assert joint.points[joint.facets["S"], 0].tolist() == [[0, 2], [2, 6]]
    assert joint.points[joint.facets["TOP"]].tolist() == [[[0, 4], [2, 4]], [[2, 4], [6, 4]]]
    assert volume(joint) == pytest.approx(24.0)


def test_what_is_not_read_of_abaqus(tmp_path):
    """Each with its keyword and line."""
    for more, words in [
        ("*ELSET, ELSET=GLUE|5, G1|", r"a\.inp: \*ELSET in line 29 of a\.inp: 'G1' does not exist before it"),
        ("*ELSET, ELSET=GLUE|5|*ELSET, ELSET=GLUE, GENERATE|5|", r"\*ELSET in line 31 of a"),
        ("*ELSET, ELSET=GLUE|5, 13|", r"\*ELSET in line 29 .* '13' does not exist before it"),
        ("*ELEMENT, TYPE=COH2D4|8, 4, 5, 6, 9|", r"\*ELEMENT in line 29 of a\.inp: elements COH2D4 of 4 nodes are not"),
        ("*ELEMENT, TYPE=T2D2|8, 4, 99|", r"\*ELEMENT in line 29 .* '99' does not exist before it"),
        ("*Node|1, 0., 5.|", r"\*NODE in line 29 of .*: the number 1 is in the file twice"),
        ("*Instance, name=Q, part=Q|", r"\*INSTANCE in line 29 of .*: 'Q' does not exist before it"),
        ("*End Part|*Part, name=Q|*Node|1,|*End Part|*Nset, nset=A|1|", r"'1' is in 2 instances; write INSTANCE\.1"),
        ("*ELGEN, ELSET=LOW|1, 2, 1, 1|", r"\*ELGEN in line 29"),
    ]:
        (tmp_path / "a.inp").write_text((ABAQUS + more).replace("|", "\n"))
        refused(InputError, words, read, tmp_path / "a.inp", S="GLUE", upper="HIGH")
