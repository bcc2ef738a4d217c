"""Meshes as people have them: formats, facets named by place, sets of nodes, doubled nodes, cells that are split."""

from __future__ import annotations

import json
import re

import h5py
import meshio
import numpy as np
import pytest
from scipy.io import netcdf_file

from forms.base import InputError
from forms.traits import RangeWarning
from geometry import read
from tests.documents import CLONE
from tests.meshes import GRID, LINES, NAMES, QUADS, squares, volume, volumes, write
from tests.on_ranks import alone, on_ranks
from tests.refused import refused

BODIES = {"LOW": (1, 2), "UP": (2, 2)}
CUBE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float)
SOLIDS = {  # corners in the unit cube
    "tetra": [0, 1, 3, 4],
    "pyramid": [0, 1, 2, 3, 4],
    "wedge": [0, 1, 3, 4, 5, 7],
    "hexahedron": [*range(8)],
}
EDGES = {  # in VTK's order
    "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "pyramid": [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
    "wedge": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "hexahedron": [(k, (k + 1) % 4) for k in range(4)] + [(4 + k, 4 + (k + 1) % 4) for k in range(4)]
    + [(k, k + 4) for k in range(4)],
}  # fmt: skip


def places(joint, name):
    """The middles of the facets of a set, sorted."""
    return sorted(map(tuple, joint.points[joint.facets[name]].mean(axis=1).tolist()))


def two(kind):
    """Points and two elements of one kind, below and above z = 0 (in 2D y = 0), with no node in common but there."""
    corners = CUBE[SOLIDS[kind]] if kind in SOLIDS else np.array([(0, 0), (2, 0), (2, 1), (0, 1)], float)
    mirrored = corners * ([1, 1, -1] if kind in SOLIDS else [1, -1])
    points, number = np.unique(np.concatenate([mirrored, corners]), axis=0, return_inverse=True)
    return points, number.reshape(2, -1)


def curved(kind, bump=0.1):
    """The same with a node in the middle of each edge, which is moved by a smooth field."""
    points, cells = two(kind)
    edges = np.sort(cells[:, EDGES[kind]].reshape(-1, 2), axis=1)
    ends, number = np.unique(edges, axis=0, return_inverse=True)
    middles = points[ends].mean(axis=1)
    middles += bump * np.sin(middles.sum(axis=1))[:, None] * np.linspace(1.0, 0.3, points.shape[1])
    nodes = np.column_stack([cells, len(points) + number.reshape(2, -1)])
    return np.concatenate([points, middles]), nodes


# ---------------------------------------------------------------- facets that the user names
def test_facets_by_place_and_by_regions(tmp_path):
    path = write(tmp_path / "a.msh", GRID, [("quad", QUADS)], [[1, 1, 2, 2]], BODIES)
    marks = {"S": lambda x: np.isclose(x[1], 0), "TOP": lambda x: x[1] > 5, "LEFT": lambda x: x[0] == 0}
    joint = read(path, upper="UP", names=marks, scale=10.0)
    assert places(joint, "S") == [(5, 0), (15, 0)]
    assert places(joint, "TOP") == [(5, 10), (15, 10)]  # not the side of a cell within UP
    assert places(joint, "LEFT") == [(0, -5), (0, 5)]
    for S, lower in (("GLUE", "LOW"), (["GLUE"], "LOW"), ({"GLUE": ("UP", "LOW")}, "UP")):
        joint = read(path, S=S, names={"GLUE": ("LOW", "UP")})
        assert next(iter(joint.seams.values())).lower == (lower,)
        assert len(joint.surface_rows) == 2
    crack = read(path, S="CRACK", direction=(1, 0), names={"CRACK": lambda x: (x[0] == 1) & (x[1] >= 0)})
    assert places(crack, "S") == [(1, 0.5)]  # within a body
    foot = read(path, S="FOOT", names={"FOOT": lambda x: x[1] == -1})
    assert foot.rigid_base
    for names, words in [
        ({"TOP": lambda x: x[1] > 5}, "the facets named 'TOP' are an empty set"),
        ({"TOP": lambda x: x[1]}, "it must be a numpy function of coordinates .* True or False"),
        ({"TOP": lambda x: x[1] > 0 and x[0] > 0}, "names: 'TOP' fails .*True or False"),
        ({"TOP": (1, 2)}, "names: tags are of DOLFINx meshes; for a file give functions"),
        ({"LOW": lambda x: x[1] > 0}, "'LOW' names both cells and facets"),
        ({"TOP": ("LOW", "UPP")}, "unknown region 'UPP'"),
    ]:
        refused(InputError, words, read, path, S="all", names=names)


def test_all_facets_between_regions(tmp_path):
    """As one seam, or as a seam for each pair."""
    regions = {name: (k, 2) for k, name in enumerate("ABCD", 1)}
    path = write(tmp_path / "a.msh", GRID, [("quad", QUADS)], [[1, 2, 3, 4]], regions)
    joint = read(path, S="all")
    assert places(joint, "S") == [(0.5, 0), (1, -0.5), (1, 0.5), (1.5, 0)]
    assert joint.interface_normals.sum(axis=0).tolist() == [2, 2]  # to the region that comes later
    joint = read(path, S="pairs")
    assert {name: places(joint, name) for name in joint.seams} == {
        "A-B": [(1, -0.5)], "A-C": [(0.5, 0)], "B-D": [(1.5, 0)], "C-D": [(1, 0.5)]
    }  # fmt: skip
    assert joint.seams["B-D"].upper == ("D",)
    refused(InputError, "S names several seams", read, path, S="pairs", upper="B")
    single = write(tmp_path / "one.msh", GRID, [("quad", QUADS)], [[1, 1, 1, 1]], {"A": (1, 2)})
    refused(InputError, "no two regions have a facet in common: A", read, single, S="all")


def test_a_group_of_all_cells_besides_others(tmp_path):
    """gmsh 2.2 writes a cell in each of its groups anew."""
    blocks = [("quad", [*QUADS, *QUADS[:, [1, 2, 3, 0]]]), ("line", LINES[:2])]
    path = write(tmp_path / "a.msh", GRID, blocks, [[1, 1, 2, 2, 3, 3, 3, 3], [1, 1]], NAMES | {"ALL": (3, 2)})
    joint = read(path, upper="UP")
    assert (joint.regions, len(joint.cells)) == (("LOW", "UP"), 4)
    assert read(path, S="S", upper="UP", lower="LOW").seams["S"].lower == ("LOW",)


# ---------------------------------------------------------------- doubled nodes
def test_doubled_nodes_are_joined_on_request(tmp_path):
    """Those of two bodies, and of a crack; what is closer than join is one node, what is not is none."""
    two_bodies = [*QUADS[:2], [9, 10, 7, 6], [10, 11, 8, 7]]
    for gap, join in ((0.0, 1e-9), (1e-6, 1e-6)):
        points = np.vstack([GRID, GRID[3:6] + np.array([0, gap])])
        path = squares(tmp_path / "a.msh", points=points, cells=two_bodies)
        joint = read(path, upper="UP", join=join)
        assert (len(joint.points), places(joint, "S")) == (9, [(0.5, 0), (1.5, 0)])
        refused(InputError, "read with join=1e-6|larger join", read, path, upper="UP")
    refused(InputError, "larger join", read, path, upper="UP", join=1e-7)
    refused(InputError, "have a node twice; is join too large", read, path, upper="UP", join=0.6)
    refused(InputError, "join is 0; it must be a number > 0 and < 1", read, path, upper="UP", join=0)


# ---------------------------------------------------------------- cells
@pytest.mark.parametrize("kind", ["quad", "hexahedron"])
def test_elements_without_middle_nodes_keep_their_shape(tmp_path, kind):
    """The nodes on faces and inside are where the shape functions of 8 or 20 nodes place them."""
    points, nodes = curved(kind)
    joint = read(meshio_file(tmp_path / "a.vtu", points, f"{kind}{nodes.shape[1]}", nodes), S="all")
    assert joint.degree == 2
    assert len(joint.points) == {"quad": 13 + 2, "hexahedron": 12 + 20 + 11 + 2}[kind]
    assert volume(joint) == pytest.approx(2 * serendipity_volume(points[nodes[1]], points[nodes[0]]), rel=1e-9)


def serendipity_volume(*elements):
    """Mean volume of elements of 8 nodes in 2D or 20 in 3D, from their own shape functions."""
    total, d = 0.0, elements[0].shape[1]
    x, w = np.polynomial.legendre.leggauss(5)
    corners = 2 * (CUBE[:4, :2] if d == 2 else CUBE) - 1
    middles = [corners[list(edge)].mean(axis=0) for edge in EDGES["quad" if d == 2 else "hexahedron"]]
    nodes = np.concatenate([corners, middles])
    for at in np.ndindex(*(5,) * d):
        xi = x[list(at)]
        gradients = np.empty((len(nodes), d))
        for node, gradient in zip(nodes, gradients, strict=True):
            for k in range(d):
                step = 1e-30j * np.eye(d)[k]
                gradient[k] = shape_function(node, xi + step).imag / 1e-30
        total += w[list(at)].prod() * sum(abs(np.linalg.det(gradients.T @ element)) for element in elements)
    return total / len(elements)


def shape_function(node, xi):
    """Of an element with nodes on its corners and edges."""
    on_edge = node == 0
    factors = np.where(on_edge, 1 - xi**2, (1 + node * xi) / 2)
    return factors.prod() * (1 if on_edge.any() else node @ xi - len(node) + 1)


@pytest.mark.parametrize("kind", ["pyramid", "wedge"])
@pytest.mark.parametrize("degree", [1, 2])
def test_elements_that_are_split(tmp_path, kind, degree):
    """Into tetrahedra that fit on each other; with curved edges, which they keep."""
    points, nodes = two(kind) if degree == 1 else curved(kind, 0.02)
    path = meshio_file(tmp_path / "a.vtu", points, f"{kind}{nodes.shape[1]}" if degree == 2 else kind, nodes)
    with pytest.warns(RangeWarning, match=rf"2 {kind}\d* are split into {4 if kind == 'pyramid' else 6} cells"):
        joint = read(path, S="all")
    assert (joint.cell_type, joint.degree) == ("tetrahedron", degree)
    assert volumes(joint)[joint.region == 1].sum() == pytest.approx({"pyramid": 1 / 3, "wedge": 1 / 2}[kind], rel=0.1)
    if degree == 1:
        assert volume(joint) == pytest.approx({"pyramid": 2 / 3, "wedge": 1}[kind], rel=1e-12)
    assert len(joint.surface_rows) == {"pyramid": 2, "wedge": 1}[kind]
    assert {*map(tuple, points)} <= {*map(tuple, joint.points)}  # no node is lost


def meshio_file(path, points, kind, nodes, **more):
    """A file of two cells, of the regions 1 and 2."""
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    meshio.Mesh(points, [(kind, nodes)], cell_data={"part": [np.array([1, 2])], **more}).write(path)
    return path


def test_cells_of_several_shapes(tmp_path):
    """Hexahedra on a wedge beside a pyramid and a tetrahedron; facets of both shapes are named."""
    more = [(2, 0, 0), (2, 1, 0), (0.5, 0.5, 2), (2, 0.5, 1.5)]
    points = np.concatenate([CUBE, more])  # a cube, a wedge beside it, a pyramid on top and a tetrahedron on that
    cells = [("hexahedron", [[*range(8)]]), ("wedge", [[1, 8, 5, 2, 9, 6]]), ("pyramid", [[4, 5, 6, 7, 10]])]
    cells += [("tetra", [[5, 6, 10, 11]]), ("quad", [[4, 5, 6, 7], [0, 3, 7, 4]]), ("triangle", [[5, 6, 10]])]
    tags = [[1], [1], [2], [2], [8, 7], [9]]
    data = {"part": [np.array(tag) for tag in tags]}
    meshio.Mesh(points, cells, cell_data=data).write(tmp_path / "a.vtu")
    with pytest.warns(RangeWarning, match="1 hexahedron, 1 wedge, 1 pyramid, 1 tetra are split into 12 cells"):
        joint = read(tmp_path / "a.vtu", S="8", upper="2")
    assert [len(joint.facets[name]) for name in ("S", "7", "9")] == [2, 2, 1]
    assert volume(joint) == pytest.approx(1 + 0.5 + 1 / 3 + abs(np.linalg.det(points[[5, 6, 10]] - points[11])) / 6)
    refused(
        InputError, "cells of degree 1 and 2: 1 triangle6, 1 quad", read, of_two_degrees(tmp_path / "b.vtu"), S="all"
    )


def of_two_degrees(path):
    points = np.array([(0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5), (1, -1), (0, -1)], float)
    points = np.pad(points, ((0, 0), (0, 1)))
    data = {"part": [np.array([1]), np.array([2])]}
    meshio.Mesh(points, [("triangle6", [[*range(6)]]), ("quad", [[7, 6, 1, 0]])], cell_data=data).write(path)
    return path


def test_an_array_is_chosen(tmp_path):
    """Of several arrays of integers one numbers the groups."""
    points, cells = two("quad")
    path = meshio_file(tmp_path / "a.vtu", points, "quad", cells, number=[np.array([7, 7])])
    assert read(path, S="all", regions="part").regions == ("1", "2")
    refused(InputError, "several arrays of integers .*: part, number; give regions", read, path, S="all")
    refused(InputError, "regions: unknown array of integers 'parts', did", read, path, S="all", regions="parts")


# ---------------------------------------------------------------- Abaqus
PLANE_PARTS = """*Part, name=Low
*Node
1, 0., 0.
2, 2., 0.
3, 2., 1.
4, 0., 1.
*Element, type=CPE4
1, 1, 2, 3, 4
*Elset, elset=Body
1
*Nset, nset=Far
1, 2
*End Part
*Part, name=Up
*Node
1, 0., 0.
2, 0., 2.
3, -1., 2.
4, -1., 0.
*Element, type=CPS4R
5, 1, 2, 3, 4
*Elset, elset=Body, generate
5, 5
*Elset, elset=_Face_S3, internal
5
*Surface, type=ELEMENT, name=Far
_Face_S3, S3
*End Part
*Assembly, name=A
*Instance, name=Low-1, part=Low
*End Instance
*Instance, name=Up-1, part=Up
0., 1., 0.
0., 1., 0., 0., 1., 3., -90.
*End Instance
*Nset, nset=Glue, instance=Low-1
3, 4
*Nset, nset=Glue, instance=Up-1
1
*Elset, elset=Everything
Low-1.Body, Up-1.5
*Surface, name=Side
Low-1.Body, S2
Up-1.Body, S2
*End Assembly
"""


def test_instances_of_parts(tmp_path):
    """Moved and turned to their places; sets of both have the name of the instance before their own."""
    (tmp_path / "a.inp").write_text(PLANE_PARTS)
    joint = read(tmp_path / "a.inp", S="Glue", upper="Up-1.Body", join=1e-9)
    assert joint.regions == ("Low-1.Body", "Up-1.Body")
    assert volume(joint) == pytest.approx(4.0)
    assert places(joint, "S") == [(1, 1)]
    assert places(joint, "Low-1.Far") == [(1, 0)]
    assert np.allclose(places(joint, "Side"), [(2, 0.5), (2, 1.5)])


def test_faces_of_surfaces(tmp_path):
    """Each face of each element by its number; a surface of nodes, and one of elements without faces."""
    # middles of faces 1, 2, ... in the manual of Abaqus
    faces = {
        "tetra": [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)],
        "wedge": [(0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
        "hexahedron": [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)],
    }
    for kind, name in (("tetra", "C3D4H"), ("wedge", "C3D6"), ("hexahedron", "C3D8RH")):
        corners = CUBE[SOLIDS[kind]]
        text = "*NODE, NSET=Nall\n" + "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(corners, 1))
        text += f"*ELEMENT, TYPE={name}, ELSET=E\n1, {', '.join(map(str, range(1, len(corners) + 1)))}\n"
        text += "".join(f"*SURFACE, NAME=F{k}\nE, S{k}\n" for k in range(1, len(faces[kind]) + 1))
        text += "*NSET, NSET=N\n1, 2, 3\n4\n*SURFACE, TYPE=NODE, NAME=BY NODES\nN,\n1, 1.\n*SURFACE, NAME=SKIN\nE,\n"
        (tmp_path / "a.inp").write_text(text)
        if kind == "wedge":
            with pytest.warns(RangeWarning, match="split"):
                joint = read(tmp_path / "a.inp", S="F1")
        else:
            joint = read(tmp_path / "a.inp", S="F1")
        for k, face in enumerate(faces[kind], 1):
            rows = joint.facets["S" if k == 1 else f"F{k}"]
            assert {*map(tuple, joint.points[rows.ravel()])} == {*map(tuple, corners[list(face)])}, (kind, k)
        if kind == "hexahedron":
            assert len(joint.facets["SKIN"]) == 5
            assert "N" not in joint.facets  # it is S alone
    refused(InputError, "'S9', only|has no face 7", read, with_face(tmp_path, text, "S7"), S="F1")
    refused(
        InputError, r"\*SURFACE in line \d+ .* the face N is not read; give S1", read, with_face(tmp_path, text, "N")
    )


def with_face(folder, text, face):
    (folder / "b.inp").write_text(text + f"*SURFACE, NAME=X\nE, {face}\n")
    return folder / "b.inp"


# ---------------------------------------------------------------- other formats
def exodus(path, points, blocks, sides=(), nodes=(), hdf=False, names=True):
    """An Exodus II file: blocks (name, type, (n, k) nodes), side sets (name, [(element, side)]), node sets."""
    arrays = {"coord": np.asarray(points, float).T}
    kinds = {}
    for k, (_, kind, cells) in enumerate(blocks, 1):
        arrays[f"connect{k}"], kinds[f"connect{k}"] = np.asarray(cells, np.int32) + 1, kind
    for k, (_, pairs) in enumerate(sides, 1):
        arrays[f"elem_ss{k}"], arrays[f"side_ss{k}"] = np.array(pairs, np.int32).T
    for k, (_, members) in enumerate(nodes, 1):
        arrays[f"node_ns{k}"] = np.array(members, np.int32) + 1
    for kind, of in (("eb", blocks), ("ss", sides), ("ns", nodes)):
        if of:
            arrays[f"{kind}_prop1"] = 10 * np.arange(1, len(of) + 1, dtype=np.int32)
            if names:
                arrays[f"{kind}_names"] = np.array([[*name.ljust(33, "\0")] for name, *_ in of], "S1")
    if hdf:
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
                file[name].attrs["elem_type"] = kinds.get(name, "")
        return path
    with netcdf_file(path, "w") as file:
        for name, array in arrays.items():
            axes = [f"{name}{k}" for k in range(array.ndim)]
            for axis, n in zip(axes, array.shape, strict=True):
                file.createDimension(axis, n)
            variable = file.createVariable(name, {"i": "i", "f": "d", "S": "c"}[array.dtype.kind], axes)
            variable[:] = array
            if name in kinds:
                variable.elem_type = kinds[name]
    return path


@pytest.mark.parametrize("hdf", [False, True])
def test_exodus(tmp_path, hdf):
    """Blocks, side sets and node sets, with names or numbers."""
    blocks = [("LOW", "QUAD4", QUADS[:2]), ("UP", "QUAD", QUADS[2:])]
    sides, nodes = [("GLUE", [(1, 3), (4, 1)]), ("RIGHT", [(2, 2), (4, 2)])], [("TOP", [6, 7, 8]), ("POINT", [0])]
    joint = read(exodus(tmp_path / "a.e", GRID, blocks, sides, nodes, hdf), S="GLUE", upper="UP")
    assert places(joint, "S") == [(0.5, 0), (1.5, 0)]
    assert places(joint, "RIGHT") == [(2, -0.5), (2, 0.5)]
    assert places(joint, "TOP") == [(0.5, 1), (1.5, 1)]
    assert "POINT" not in joint.facets
    joint = read(exodus(tmp_path / "b.exo", GRID, blocks, sides, nodes, hdf, names=False), S="10", upper="20")
    assert (joint.regions, sorted(joint.facets)) == (("10", "20"), ["20", "S"])


def test_sides_of_exodus(tmp_path):
    """Each side of each element by its number, in the manual of Exodus."""
    sides = {
        "TET": ("tetra", [(0, 1, 3), (1, 2, 3), (0, 2, 3), (0, 1, 2)]),
        "HEX8": ("hexahedron", [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 1, 2, 3), (4, 5, 6, 7)]),
        "WEDGE": ("wedge", [(0, 1, 4, 3), (1, 2, 5, 4), (0, 2, 5, 3), (0, 1, 2), (3, 4, 5)]),
        "PYRAMID5": ("pyramid", [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (0, 1, 2, 3)]),
    }
    for name, (kind, faces) in sides.items():
        corners = CUBE[SOLIDS[kind]]
        sets = [(f"F{k}", [(1, k)]) for k in range(1, len(faces) + 1)]
        path = exodus(tmp_path / "a.e", corners, [("BODY", name, [[*range(len(corners))]])], sets)
        joint = split_or_not(path, kind, S="F1")
        for k, face in enumerate(faces, 1):
            rows = joint.facets["S" if k == 1 else f"F{k}"]
            assert {*map(tuple, joint.points[rows.ravel()])} == {*map(tuple, corners[list(face)])}, (kind, k)


def split_or_not(path, kind, **choice):
    """The joint, with a warning if its cells were split."""
    if kind not in ("wedge", "pyramid"):
        return read(path, **choice)
    with pytest.warns(RangeWarning, match="split"):
        return read(path, **choice)


@pytest.mark.parametrize("kind", ["quad", "wedge", "hexahedron"])
def test_middle_nodes_of_exodus(tmp_path, kind):
    """Upright edges come before those of the upper face."""
    points, nodes = curved(kind, 0.05)
    n = nodes.shape[1]
    columns = {"hexahedron": [*range(12), *range(16, 20), *range(12, 16)], "wedge": [*range(9), 12, 13, 14, 9, 10, 11]}
    blocks = [
        (str(k), f"{kind}{n}".replace("hexahedron", "HEX"), row[None, columns.get(kind, [*range(n)])])
        for k, row in enumerate(nodes)
    ]
    joint = split_or_not(exodus(tmp_path / "a.e", points, blocks), kind, S="all")
    same = split_or_not(meshio_file(tmp_path / "a.vtu", points, f"{kind}{n}", nodes), kind, S="all")
    assert volumes(joint) == pytest.approx(volumes(same), rel=1e-12)


def test_hexahedra_of_27_nodes_in_exodus(tmp_path):
    """The middle comes first, then the lower, upper, left, right, front and rear face."""
    points, nodes = curved("hexahedron", 0.0)
    corners = points[nodes[1, :8]]
    axis = {(k, side): np.isclose(corners[:, k], side) for k in range(3) for side in (0, 1)}
    middles = [
        corners.mean(axis=0),
        *(corners[axis[at]].mean(axis=0) for at in [(2, 0), (2, 1), (0, 0), (0, 1), (1, 0), (1, 1)]),
    ]
    x = np.concatenate([points[nodes[1]], middles])
    order = [*range(12), *range(16, 20), *range(12, 16), *range(20, 27)]
    joint = read(exodus(tmp_path / "a.e", x[order], [("BODY", "HEX27", [[*range(27)]])], [("S", [(1, 5)])]))
    assert volumes(joint) == pytest.approx(1.0)


def test_xdmf_of_degree_2(tmp_path):
    """With facets, which make its cells mixed."""
    points, nodes = curved("quad")
    ends = sorted({*nodes[0]} & {*nodes[1]})
    blocks = [("quad8", nodes), ("line3", [ends])]
    data = {"part": [np.array([1, 2]), np.array([7])]}
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), blocks, cell_data=data).write(tmp_path / "a.xdmf")
    joint = read(tmp_path / "a.xdmf", S="7", upper="2")
    assert (joint.degree, len(joint.surface_rows)) == (2, 1)


def on_two_ranks(folder):
    """Identities of joints from a file and from DOLFINx."""
    from dolfinx import mesh
    from mpi4py import MPI

    path = folder / "a.msh"
    points = np.vstack([GRID, GRID[3:6]])
    alone(lambda: squares(path, points=points, cells=[*QUADS[:2], [9, 10, 7, 6], [10, 11, 8, 7]]))
    marks = {"LEFT": lambda x: x[0] == 0}
    plane = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -1), (2, 1)], (4, 4))
    marks_too = {"S": lambda x: np.isclose(x[1], 0)} | marks
    return [
        read(path, upper="UP", join=1e-9, names=marks).identity(),
        read(plane, direction=(0, 1), names=marks_too).identity(),
    ]


@on_ranks(on_two_ranks, 2)
def test_two_ranks(there, tmp_path):
    here = on_two_ranks(tmp_path)
    assert [{**joint, "coordinates": None} for joint in there] == json.loads(
        json.dumps([{**joint, "coordinates": None} for joint in here])
    )
    assert "LEFT" in here[1]["facets"]


# ---------------------------------------------------------------- the table of formats
def mesh_of(feature):
    """Points, blocks with meshio's name, and the number of the group of each element: bodies 1 and 2, S 5."""
    if feature == "names":
        return GRID, {"quad": QUADS, "line": LINES[:2]}, [[1, 1, 2, 2], [5, 5]]
    if feature == "several shapes":
        triangles = [[3, 4, 7], [3, 7, 6], [4, 5, 7], [5, 8, 7]]
        return GRID, {"quad": QUADS[:2], "triangle": triangles, "line": LINES[:2]}, [[1, 1], [2] * 4, [5, 5]]
    kind, facets = {"8": ("quad", "line3"), "20": ("hexahedron", "quad8"), "wedges": ("wedge", "triangle")}[feature]
    points, nodes = two(kind) if feature == "wedges" else curved(kind, 0.02)
    shared = [[node for node in nodes[1] if node in nodes[0]]]
    return points, {f"{kind}{feature if feature.isdigit() else ''}": nodes, facets: shared}, [[1, 2], [5]]


def read_as(suffix, folder, feature):
    """The joint of such a mesh from a file of this format."""
    points, blocks, tags = mesh_of(feature)
    path, names = folder / f"a{suffix}", {"S": "5", "upper": "2"}
    rows = [(kind, np.array(nodes), np.array(tag)) for (kind, nodes), tag in zip(blocks.items(), tags, strict=True)]
    if suffix in (".e", ".exo"):
        parts = [(kind, nodes[tag == k], k) for kind, nodes, tag in rows for k in (1, 2) if (tag == k).any()]
        order = {20: [*range(12), *range(16, 20), *range(12, 16)]}
        listed = [
            (str(k), of.replace("hexahedron", "HEX"), n[:, order.get(n.shape[1], slice(None))]) for of, n, k in parts
        ]
        exodus(path, points, listed, (), [("5", np.unique(rows[-1][1]))], hdf=suffix == ".exo")
    elif suffix == ".inp":
        abaqus(path, points, rows)
    else:
        key = {".msh": "gmsh:physical", ".med": "cell_tags", ".mesh": "medit:ref"}.get(suffix, "part")
        tagged = [tag for *_, tag in rows]
        data = {key: tagged} | ({"gmsh:geometrical": tagged} if suffix == ".msh" else {})
        padded = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
        mesh = meshio.Mesh(padded, [row[:2] for row in rows], cell_data=data)
        if suffix == ".med":
            mesh.cell_tags = {k: [str(k)] for k in (1, 2, 5)}
        meshio.write(path, mesh, **({"file_format": "gmsh22"} if suffix == ".msh" else {}))
    return read(path, **names)


def abaqus(path, points, rows):
    """With the facets as a set of nodes."""
    types = {"quad": "CPE4", "triangle": "CPE3", "quad8": "CPE8R", "hexahedron20": "C3D20R", "wedge": "C3D6"}
    text, number = ["*NODE", *(", ".join(map(str, [k, *x])) for k, x in enumerate(points.tolist(), 1))], 0
    for kind, nodes, tag in rows[:-1]:
        for k, element in zip(tag, nodes, strict=True):
            number += 1
            text += [f"*ELEMENT, TYPE={types[kind]}, ELSET={k}", ", ".join(map(str, [number, *(element + 1)]))]
    text += ["*NSET, NSET=5", *(f"{node + 1}" for node in np.unique(rows[-1][1]))]
    path.write_text("\n".join(text))


PAGE = (CLONE / "thinlayer/docs/reference/joints.md").read_text()
FORMATS = [[cell.strip() for cell in row] for row in re.findall(r"^\|(.*?)\|(.*?)\|(.*?)\|(.*?)\|(.*?)\|$", PAGE, re.M)]
COLUMNS = {3: ("8", "20"), 4: ("wedges", "several shapes")}
SUFFIXES = [(suffix, row) for row in FORMATS for suffix in re.findall(r"`(\.\w+)`", row[0])]


@pytest.mark.parametrize(("suffix", "row"), SUFFIXES, ids=[suffix for suffix, _ in SUFFIXES])
@pytest.mark.filterwarnings("ignore:.*are split into:forms.traits.RangeWarning")
def test_the_table_of_formats(tmp_path, suffix, row):
    """Each row of the page says what is read."""
    assert len(read_as(suffix, tmp_path, "names").surface_rows) == 2
    for column, features in COLUMNS.items():
        for feature in features:
            if row[column] == "yes":
                joint = read_as(suffix, tmp_path, feature)
                assert (joint.regions, len(joint.surface_rows) > 0) == (("1", "2"), True)
            else:
                refused(InputError, "", read_as, suffix, tmp_path, feature)


def test_all_rows_of_the_table_are_tested():
    suffixes = {".msh", ".inp", ".e", ".exo", ".vtu", ".vtk", ".xdmf", ".med", ".mesh"}
    assert {suffix for suffix, _ in SUFFIXES} == suffixes
    assert {row[column] for _, row in SUFFIXES for column in COLUMNS} == {"yes", "no"}


# ---------------------------------------------------------------- messages
def test_the_cause_is_named(tmp_path):
    """A body without a group; facets that cut through cells."""
    top = squares(
        tmp_path / "a.msh", cells=QUADS[:2], regions=[1, 1], names={"LOW": (1, 2), "S": (1, 1), "TOP": (2, 1)}
    )
    refused(InputError, r"2 of 2 facets named 'TOP' .* at \(0.5, 1\): the body there has no named group", read, top)
