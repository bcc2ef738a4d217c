"""Joints from meshes and tags of DOLFINx: the same as built or read, on any number of ranks; what is refused."""

from __future__ import annotations

import json
import re

import basix.ufl
import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from geometry import GeometryError, from_dolfinx, read
from geometry.seam import Seam
from tests.from_dolfinx_run import FACETS, REGIONS, built, made_by_dolfinx, norm, strip, tagged, taken_back
from tests.meshes import CELLS, drawing, model_to_mesh, rings, stack, volume
from tests.ranks import CLONE, mpirun

NAMES = {"regions": REGIONS, "facets": FACETS, "upper": "UPPER"}


@pytest.fixture(scope="module")
def alone():
    joints = {f"back: {name}": taken_back(joint) for name, joint in built().items()} | made_by_dolfinx()
    return {name: (joint.identity(), norm(joint)) for name, joint in joints.items()}


def test_joints_come_back(alone):
    """What DOLFINx has been given, with all names, is what it gives, but for the numbers of nodes and cells."""
    for name, joint in built().items():
        back = taken_back(joint)
        assert (back.cell_type, back.degree, back.regions) == (joint.cell_type, joint.degree, joint.regions), name
        assert back.seams == joint.seams, name
        assert {key: len(rows) for key, rows in back.facets.items()} == {
            key: len(rows) for key, rows in joint.facets.items()
        }, name
        assert volume(back) == pytest.approx(volume(joint), rel=1e-13), name
        assert np.array_equal(np.unique(back.points, axis=0), np.unique(joint.points, axis=0)), name
        assert back.interface_normals.mean(axis=0) == pytest.approx(joint.interface_normals.mean(axis=0), abs=1e-12)
        assert alone[f"back: {name}"][1] == pytest.approx(norm(joint), rel=1e-11), name


@pytest.mark.parametrize("ranks", [2, 3])
def test_several_ranks(alone, ranks):
    """The joint does not depend on them."""
    done = mpirun(ranks, "-m", "tests.from_dolfinx_run")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.keys() == alone.keys()
    for name, (identity, size) in alone.items():
        assert found[name][0] == json.loads(json.dumps(identity)), name
        assert found[name][1] == pytest.approx(size, rel=1e-12), name


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", CELLS)
def test_as_read_from_gmsh(tmp_path, cell, degree):
    """The mesh that gmsh hands to DOLFINx and the file that it writes give the same joint."""
    with drawing() as occ:
        path = rings(occ, tmp_path / "a.msh", cell, degree)
        solid, cell_tags, facet_tags, known = model_to_mesh(MPI.COMM_WORLD, 3)
    dim = CELLS[cell][0]
    regions, facets = ({tag: name for (d, tag), name in known.items() if d == k} for k in (dim, dim - 1))
    joint = from_dolfinx(solid, cell_tags, facet_tags, regions=regions, facets=facets, upper="RING")
    other = read(path, upper="RING")
    assert (joint.cell_type, joint.degree, joint.dim) == (cell, degree, dim)
    assert sorted(joint.regions) == sorted(other.regions)
    assert joint.seams == other.seams
    assert volume(joint) == pytest.approx(volume(other), rel=1e-12)
    assert np.sort(joint.points[joint.surface].mean(axis=1), axis=0) == pytest.approx(
        np.sort(other.points[other.surface].mean(axis=1), axis=0), abs=1e-12
    )


def test_solution_as_of_a_file(tmp_path, alone):
    with drawing() as occ:
        path = stack(occ, tmp_path / "a.msh", h=0.4)
    assert alone["gmsh"][1] == pytest.approx(norm(read(path, upper="UPPER")), rel=1e-11)


def test_names():
    plane, bodies, sides = strip()
    numbers = from_dolfinx(plane, bodies, sides, S="3", upper="2")
    assert (numbers.regions, numbers.seams, set(numbers.facets)) == (
        ("1", "2"),
        {"S": Seam(("1",), ("2",))},
        {"S", "4", "5"},
    )
    between = from_dolfinx(plane, bodies, S=None, lower="1", upper="2")
    assert set(between.facets) == {"S"}
    assert len(between.facets["S"]) == len(numbers.facets["S"]) == 6
    merged = from_dolfinx(plane, bodies, sides, regions=REGIONS, facets={3: "GLUE", 4: "ENDS", 5: "ENDS"}, S="GLUE",
                          upper="UPPER")  # fmt: skip
    assert len(merged.facets["ENDS"]) == 12
    cut = from_dolfinx(plane, facet_tags=sides, facets={3: "S"}, direction=(0, 1))
    assert (cut.bodies, cut.seams["S"].direction) == (("BODY",), (0.0, 1.0))
    base = from_dolfinx(plane, facet_tags=sides, facets={4: "S", 5: "TOP"})
    assert base.rigid_base
    assert base.interface_normals == pytest.approx(np.tile([0.0, 1.0], (6, 1)))


def test_ghosts_and_tags_on_ghosts_do_not_count_twice():
    plane = mesh.create_rectangle(MPI.COMM_WORLD, [(0, -1), (2, 1)], (6, 6), ghost_mode=mesh.GhostMode.shared_facet)
    joint = from_dolfinx(plane, *tagged(plane), **NAMES)
    assert joint.identity() == from_dolfinx(*strip(), **NAMES).identity()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mesh": None}, "mesh is None; give a dolfinx.mesh.Mesh"),
        ({"cell_tags": 1}, "cell_tags is 1; give dolfinx.mesh.MeshTags"),
        ({"swapped": True}, "cell_tags are of entities of dimension 1; those of this mesh have dimension 2"),
        ({"other": True}, "cell_tags are of another mesh"),
        ({"floats": True}, "cell_tags have values of type float64; they must be integers"),
        (
            {"regions": {1: "LOWER"}, "upper": "LOWER"},
            "36 of 72 cells are in no named group .*LOWER.*; the first is at",
        ),
        ({"regions": {1: "LOWER", 7: "UPPER"}}, "regions: no cell has the tag 7, named 'UPPER'; tags: 1, 2"),
        ({"facets": {6: "S"}}, "facets: no facet has the tag 6, named 'S'; tags: 3, 4, 5"),
        ({"facet_tags": None, "facets": None}, "no facets are named 'S' or anything else"),
        ({"facet_tags": None}, "facets: no facet has the tag 3, named 'S'; tags: none"),
        ({"regions": {"LOWER": 1}}, r"regions is \{'LOWER': 1\}; give \{number in cell_tags: name\}"),
        ({"facets": ["S"]}, r"facets is \['S'\]; give \{number in facet_tags: name\}"),
        ({"S": "GLUE"}, "unknown set of facets 'GLUE'; known: BOTTOM, S, TOP"),
        ({"facets": {3: "GLUE", 4: "BOTTOM"}}, "unknown set of facets 'S'; known: BOTTOM, GLUE"),
        ({"upper": "UPPERS"}, "unknown region 'UPPERS', did you mean 'UPPER'"),
        ({"upper": None}, "lies inside LOWER and UPPER; name the regions above it in upper"),
        ({"facets": {3: "UPPER"}, "S": "UPPER"}, "'UPPER' names both cells and facets"),
        ({"facets": {3: "S", 4: "S"}}, "6 of 12 facets named 'S' lie on the outer boundary"),
        ({"regions": {1: "LAYER", 2: "UPPER"}}, "'LAYER' cannot be a name"),
        ({"direction": (1, 0, 0), "upper": None}, r"direction is \(1.0, 0.0, 0.0\); it needs 2 components"),
    ],
)
def test_refused(change, message):
    plane, bodies, sides = strip()
    given = {"mesh": plane, "cell_tags": bodies, "facet_tags": sides, **NAMES, **change}
    if given.pop("swapped", False):
        given["cell_tags"], given["facet_tags"] = sides, bodies
    if given.pop("other", False):
        given["cell_tags"] = strip()[1]
    if given.pop("floats", False):
        given["cell_tags"] = mesh.meshtags(plane, 2, bodies.indices, bodies.values.astype(float))
    with pytest.raises(GeometryError, match=message):
        from_dolfinx(given.pop("mesh"), given.pop("cell_tags"), given.pop("facet_tags"), **given)


def whole(cell, degree, points, cells):
    """A mesh of DOLFINx given by points and cells."""
    points = np.asarray(points, float)
    element = basix.ufl.element("Lagrange", cell, degree, shape=(points.shape[1],))
    parameters = {"cells": np.array(cells, np.int64), "x": points, "e": element}
    return mesh.create_mesh(MPI.COMM_WORLD, **parameters)


SQUARE = [(0, 0), (1, 0), (0, 1), (1, 1)]
UNUSABLE = {
    "a line": (lambda: mesh.create_unit_interval(MPI.COMM_WORLD, 3), "cells are of type interval; allowed: one of tri"),
    "prisms": (
        lambda: mesh.create_unit_cube(MPI.COMM_WORLD, 1, 1, 1, mesh.CellType.prism),
        "cells are of type prism; allowed: one of",
    ),
    "degree 3": (
        lambda: whole("triangle", 3, basix.ufl.element("Lagrange", "triangle", 3).basix_element.points, [range(10)]),
        r"a triangle has 10 nodes; allowed: 3, 6 \(degree 1 or 2\)",
    ),
    "a surface in space": (
        lambda: whole("quadrilateral", 1, [(*x, x[0] + x[1]) for x in SQUARE], [[0, 1, 2, 3]]),
        "2D mesh in 3D: 1 quadrilateral cells at z = 0 to 2",
    ),
    "nodes at one place": (
        lambda: whole("triangle", 1, [*SQUARE, (1, 0), (0, 1)], [[0, 1, 2], [4, 5, 3]]),
        "2 pairs of nodes at the same place",
    ),
    "no volume": (
        lambda: whole("triangle", 1, [*SQUARE, (2, 2)], [[0, 1, 3], [0, 3, 4]]),
        "1 of 2 cells are degenerate",
    ),
    "folded": (lambda: whole("quadrilateral", 1, [(0, 0), (1, 0), (0, 1), (0.2, 0.2)], [[0, 1, 2, 3]]), "are folded"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_unusable_meshes(name):
    make, message = UNUSABLE[name]
    with pytest.raises(GeometryError, match=message):
        on_its_boundary(make())


def on_its_boundary(m):
    """The joint of a mesh whose whole boundary is S."""
    dim = m.topology.dim
    m.topology.create_entities(dim - 1)
    m.topology.create_connectivity(dim - 1, dim)
    facets = mesh.exterior_facet_indices(m.topology)
    return from_dolfinx(m, facet_tags=mesh.meshtags(m, dim - 1, facets, np.ones(len(facets), np.int32)), S="1")


ERRORS = """
from mpi4py import MPI
from dolfinx import mesh
from geometry import GeometryError, from_dolfinx
from tests.from_dolfinx_run import FACETS, REGIONS, strip
comm = MPI.COMM_WORLD
def error(*data, **names):
    try: from_dolfinx(*data, **names)
    except GeometryError as found: return str(found)
plane, bodies, sides = strip()
said = [
    error(plane if comm.rank == 0 else None, bodies, sides, regions=REGIONS, facets=FACETS, upper="UPPER"),
    error(plane, bodies, sides, regions=REGIONS, facets=FACETS, upper="UPPERS"),
    error(mesh.create_unit_square(MPI.COMM_SELF, 2, 2)),
]
said = comm.allgather(said)
assert said[0] == said[1]
if comm.rank == 0: print("|".join(said[0]))
"""


def test_errors_on_two_ranks(tmp_path):
    """All ranks have them, and none waits."""
    (tmp_path / "script.py").write_text(ERRORS)
    done = mpirun(2, str(tmp_path / "script.py"))
    assert done.returncode == 0, done.stderr
    one, two, three = done.stdout.strip().split("|")
    assert one == "mesh is None; give a dolfinx.mesh.Mesh"
    assert two.startswith("unknown region 'UPPERS', did you mean 'UPPER'")
    assert three.startswith("the mesh is distributed on 1 ranks, comm has 2; give comm the communicator")


@pytest.mark.parametrize("ranks", [1, 2])
def test_script(ranks):
    """S opens by the traction over the stiffness; the text says so."""
    done = mpirun(ranks, str(CLONE / "tests" / "own_scripts" / "joint.py"))
    assert done.returncode == 0, done.stderr
    found = re.search(r"S opens by (\S+) mm;", done.stdout)
    assert float(found[1]) == pytest.approx(0.005, rel=1e-7)
    assert float(re.search(r"but for (\S+) of it", done.stdout)[1]) < 1e-4
