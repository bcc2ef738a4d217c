"""Joints from meshes and tags of DOLFINx: the same as built or read, on any number of ranks; what is refused."""

from __future__ import annotations

import json

import basix.ufl
import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from forms import LinearElastic
from forms.base import InputError
from geometry import Joint, block, disc, from_dolfinx, read, ring, sandwich
from geometry.domain import Domain
from geometry.seam import Seam
from tests.meshes import CELLS, drawing, model_to_mesh, rings, stack, volume
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Structure, ThinLayer, solve

COMM = MPI.COMM_WORLD


def built() -> dict[str, Joint]:
    """Joints of all types of cells, straight and curved, with and without a rigid base."""
    return {
        "triangles": sandwich(1.0, 0.5, 0.5, 0.2),
        "quadrilaterals": block(1.0, 0.5, 0.25, cell="quadrilateral"),
        "tetrahedra": sandwich(1.0, 0.5, 0.5, 0.4, depth=0.5),
        "hexahedra": block(1.0, 0.5, 0.25, depth=0.5, cell="hexahedron"),
        "curved triangles": ring(1.0, 1.5, 2.0, 0.5, degree=2),
        "curved quadrilaterals": ring(1.0, 1.5, 2.0, 0.5, degree=2, cell="quadrilateral"),
        "curved tetrahedra": disc(1.0, 0.5, 0.5, 0.5, degree=2),
        "curved hexahedra": disc(1.0, 0.5, 0.5, 0.5, degree=2, cell="hexahedron"),
    }


def taken_back(joint: Joint) -> Joint:
    """A joint, distributed by DOLFINx with its tags, and gathered again."""
    domain = Domain.of(joint)
    return from_dolfinx(
        domain.mesh,
        domain.cell_tags,
        domain.facet_tags,
        regions={number + 1: name for number, name in enumerate(joint.regions)},
        facets={value: name for name in joint.facets for value in domain.values(name)},
        upper=joint.seams["S"].upper,
    )


def strip() -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """(0, 2) x (-1, 1): cells 1 below and 2 above y = 0, where facets are 3; the lower side 4, the upper side 5."""
    plane = mesh.create_rectangle(COMM, [(0, -1), (2, 1)], (6, 6))
    return plane, *tagged(plane)


def tagged(plane: mesh.Mesh) -> tuple[mesh.MeshTags, mesh.MeshTags]:
    """The tags of `strip` on any mesh of it."""
    plane.topology.create_connectivity(1, 2)
    cells = np.arange(plane.topology.index_map(2).size_local, dtype=np.int32)
    above = mesh.compute_midpoints(plane, 2, cells)[:, 1] > 0
    found = {tag: mesh.locate_entities(plane, 1, lambda x, y=y: np.isclose(x[1], y)) for tag, y in PLACES.items()}
    facets = np.concatenate(list(found.values()))
    values = np.repeat(list(found), [len(f) for f in found.values()]).astype(np.int32)
    order = np.argsort(facets)
    sides = mesh.meshtags(plane, 1, facets[order], values[order])
    return mesh.meshtags(plane, 2, cells, np.where(above, 2, 1).astype(np.int32)), sides


PLACES = {3: 0.0, 4: -1.0, 5: 1.0}
FACETS = {3: "S", 4: "BOTTOM", 5: "TOP"}
REGIONS = {1: "LOWER", 2: "UPPER"}


def made_by_dolfinx() -> dict[str, Joint]:
    """A mesh of DOLFINx, a part of one, a refined one, and gmsh's by DOLFINx."""
    names = {"regions": REGIONS, "facets": FACETS, "upper": "UPPER"}
    plane, *tags = strip()
    joints = {"rectangle": from_dolfinx(plane, *tags, **names)}
    inside = mesh.locate_entities(plane, 2, lambda x: x[0] < 1.4)
    owned = inside[inside < plane.topology.index_map(2).size_local]
    part = mesh.create_submesh(plane, 2, owned)[0]
    joints["a part of it"] = from_dolfinx(part, *tagged(part), **names)
    plane.topology.create_entities(1)
    finer = mesh.refine(plane)[0]
    joints["refined"] = from_dolfinx(finer, *tagged(finer), **names)
    with drawing() as occ:
        if COMM.rank == 0:
            stack(occ, None, h=0.4)
        solid, *tags, known = model_to_mesh(COMM, 3)  # a plane mesh in space
    regions, facets = ({tag: name for (d, tag), name in known.items() if d == dim} for dim in (2, 1))
    joints["gmsh"] = from_dolfinx(solid, *tags, regions=regions, facets=facets, upper="UPPER")
    return joints


def norm(joint: Joint) -> float:
    """Of the displacements of the joint, held at one side or at two corners, and pushed at another side."""
    held = [name for name in ("BOTTOM", "INSIDE") if name in joint.facets] or [(0.0, -1.0), (2.0, -1.0)]
    pushed = next(name for name in ("TOP", "OUTSIDE") if name in joint.facets)
    push = (0.3, -1.0, 0.2)[: joint.dim]
    supports = {} if joint.rigid_base else dict.fromkeys(held, 0.0)
    structure = Structure(joint, body=LinearElastic.young(30.0, 0.1), supports=supports, tractions={pushed: push})
    state = solve(structure.interface(ThinLayer(LinearElastic(6.0, 4.0), 0.05, at=1.0)))
    return float(state.u.x.petsc_vec.norm())


def numbers() -> dict[str, list]:
    """Name -> identity of the joint and norm of its displacements."""
    joints = {f"back: {name}": taken_back(joint) for name, joint in built().items()} | made_by_dolfinx()
    found = {name: [joint.identity(), norm(joint)] for name, joint in joints.items()}
    assert all(other == COMM.allgather(found)[0] for other in COMM.allgather(found))
    return found


def errors() -> list[list[str]]:
    """What each rank is told of a mesh that is on one rank alone, of a name that is none, of a mesh of other ranks."""
    plane, *tags = strip()
    names = {"regions": REGIONS, "facets": FACETS}
    said = []
    for data, upper in (
        ((plane if COMM.rank == 0 else None, *tags), "UPPER"),
        ((plane, *tags), "UPPERS"),
        ((mesh.create_unit_square(MPI.COMM_SELF, 2, 2),), "UPPER"),
    ):
        try:
            from_dolfinx(*data, **names if len(data) > 1 else {}, upper=upper)
        except InputError as found:
            said.append(str(found))
    return COMM.allgather(said)


NAMES = {"regions": REGIONS, "facets": FACETS, "upper": "UPPER"}


@pytest.fixture(scope="module")
def alone():
    return numbers()


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


@pytest.mark.long
@on_ranks(numbers, 2, 3)
def test_several_ranks(alone, there):
    """The joint does not depend on them."""
    assert there.keys() == alone.keys()
    for name, (identity, size) in alone.items():
        assert there[name][0] == json.loads(json.dumps(identity)), name
        assert there[name][1] == pytest.approx(size, rel=1e-12), name


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
        ({"regions": {1: "LOWER"}, "upper": "LOWER"}, "36 of 72 cells are in no named group .*LOWER.*; the first is"),
        ({"regions": {1: "LOWER", 7: "UPPER"}}, "regions: no cell has the tag 7, named 'UPPER'; tags: 1, 2"),
        ({"facets": {6: "S"}}, "facets: no facet has the tag 6, named 'S'; tags: 3, 4, 5"),
        ({"facet_tags": None, "facets": None}, "no facets are named 'S' or anything else"),
        ({"facet_tags": None}, "facets: no facet has the tag 3, named 'S'; tags: none"),
        ({"regions": {"LOWER": 1}}, r"regions is \{'LOWER': 1\}; give \{number in cell_tags: name\}"),
        ({"facets": ["S"]}, r"facets is \['S'\]; give \{number in facet_tags: name\}"),
        ({"S": "GLUE"}, "unknown set of facets 'GLUE'; known: BOTTOM, S, TOP"),
        ({"facets": {3: "GLUE", 4: "BOTTOM"}}, "unknown set of facets 'S'; known: BOTTOM, GLUE"),
        ({"facets": {3: "UPPER"}, "S": "UPPER"}, "'UPPER' names both cells and facets"),
        ({"facets": {3: "S", 4: "S"}}, "6 of 12 facets named 'S' lie on the outer boundary"),
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
    with pytest.raises(InputError, match=message):
        from_dolfinx(given.pop("mesh"), given.pop("cell_tags"), given.pop("facet_tags"), **given)


def whole(cell, degree, points, cells):
    """A mesh of DOLFINx given by points and cells."""
    points = np.asarray(points, float)
    element = basix.ufl.element("Lagrange", cell, degree, shape=(points.shape[1],))
    parameters = {"cells": np.array(cells, np.int64), "x": points, "e": element}
    return mesh.create_mesh(MPI.COMM_WORLD, **parameters)


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
    "folded": (lambda: whole("quadrilateral", 1, [(0, 0), (1, 0), (0, 1), (0.2, 0.2)], [[0, 1, 2, 3]]), "are folded"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_unusable_meshes(name):
    make, message = UNUSABLE[name]
    refused(InputError, message, lambda: on_its_boundary(make()))


def on_its_boundary(m):
    """The joint of a mesh whose whole boundary is S."""
    dim = m.topology.dim
    m.topology.create_entities(dim - 1)
    m.topology.create_connectivity(dim - 1, dim)
    prisms = m.topology.cell_name() == "prism"  # of which DOLFINx 0.11 does not know the boundary
    facets = np.arange(1, dtype=np.int32) if prisms else mesh.exterior_facet_indices(m.topology)
    return from_dolfinx(m, facet_tags=mesh.meshtags(m, dim - 1, facets, np.ones(len(facets), np.int32)), S="1")


@pytest.mark.long
@on_ranks(errors, 2)
def test_errors_on_two_ranks(there):
    """All ranks have them, and none waits."""
    (one, two, three), others = there
    assert others == [one, two, three]
    assert one == "mesh is None; give a dolfinx.mesh.Mesh"
    assert two.startswith("unknown region 'UPPERS', did you mean 'UPPER'")
    assert three.startswith("the mesh is distributed on 1 ranks, comm has 2; give comm the communicator")
