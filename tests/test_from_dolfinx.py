"""Joints from meshes and tags of DOLFINx: the same as built or read, on any number of ranks; what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from forms import LinearElastic
from forms.base import InputError
from geometry import read
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import Seam
from tests.meshes import drawing, model_to_mesh, stack, volume
from tests.on_ranks import on_ranks
from tests.refused import refused
from tests.test_domain import joints
from thinlayer import Structure, ThinLayer, solve

COMM = MPI.COMM_WORLD


def built() -> dict[str, Joint]:
    """Joints of all types of cells, straight and curved, with and without a rigid base."""
    excluded = ("layer", "layer in space", "tip", "fewer cells than ranks")
    return {name: joint for name, joint in joints().items() if name not in excluded}


def taken_back(joint: Joint) -> Joint:
    """A joint, distributed by DOLFINx with its tags, and gathered again."""
    domain = Domain.of(joint)
    names = {name: (joint.dim, number + 1) for number, name in enumerate(joint.regions)}
    names |= {name: (joint.dim - 1, *domain.values(name)) for name in joint.facets}
    return read((domain.mesh, domain.cell_tags, domain.facet_tags), names=names, upper=joint.seams["S"].upper)


def strip() -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """(0, 2) x (-1, 1): cells 1 below and 2 above y = 0, where facets are 3; the lower side 4, the upper side 5."""
    plane = mesh.create_rectangle(COMM, [(0, -1), (2, 1)], (6, 6))
    return plane, *tagged(plane)


def tagged(plane: mesh.Mesh) -> tuple[mesh.MeshTags, mesh.MeshTags]:
    """The tags of `strip` on any mesh of it."""
    plane.topology.create_connectivity(1, 2)
    cells = np.arange(plane.topology.index_map(2).size_local, dtype=np.int32)
    above = mesh.compute_midpoints(plane, 2, cells)[:, 1] > 0
    entities = {tag: mesh.locate_entities(plane, 1, lambda x, y=y: np.isclose(x[1], y)) for tag, y in PLACES.items()}
    facets = np.concatenate(list(entities.values()))
    values = np.repeat(list(entities), [len(f) for f in entities.values()]).astype(np.int32)
    order = np.argsort(facets)
    sides = mesh.meshtags(plane, 1, facets[order], values[order])
    return mesh.meshtags(plane, 2, cells, np.where(above, 2, 1).astype(np.int32)), sides


PLACES = {3: 0.0, 4: -1.0, 5: 1.0}
FACETS = {"S": (1, 3), "BOTTOM": (1, 4), "TOP": (1, 5)}
REGIONS = {"LOWER": (2, 1), "UPPER": (2, 2)}
NAMES = {"names": REGIONS | FACETS, "upper": "UPPER"}


def made_by_dolfinx() -> dict[str, Joint]:
    """A mesh of DOLFINx, a part of one, a refined one, and gmsh's by DOLFINx."""
    plane, *tags = strip()
    ghosted = mesh.create_rectangle(COMM, [(0, -1), (2, 1)], (6, 6), ghost_mode=mesh.GhostMode.shared_facet)
    joints = {"rectangle": read((plane, *tags), **NAMES), "ghosted": read((ghosted, *tagged(ghosted)), **NAMES)}
    assert joints["ghosted"].identity() == joints["rectangle"].identity()
    inside = mesh.locate_entities(plane, 2, lambda x: x[0] < 1.4)
    part = mesh.create_submesh(plane, 2, inside[inside < plane.topology.index_map(2).size_local])[0]
    joints["a part of it"] = read((part, *tagged(part)), **NAMES)
    plane.topology.create_entities(1)
    finer = mesh.refine(plane)[0]
    joints["refined"] = read((finer, *tagged(finer)), **NAMES)
    with drawing() as occ:
        if COMM.rank == 0:
            stack(occ, None, h=0.4)
        solid, *tags, groups = model_to_mesh(COMM, 3)  # a plane mesh in space
    joints["gmsh"] = read((solid, *tags), names={name: group for group, name in groups.items()}, upper="UPPER")
    return joints


def norm(joint: Joint) -> float:
    """Of the displacements of the joint, held at one side or at two corners, and pushed at another side."""
    supported = [name for name in ("BOTTOM", "INSIDE") if name in joint.facets] or [(0.0, -1.0), (2.0, -1.0)]
    pushed = next(name for name in ("TOP", "OUTSIDE") if name in joint.facets)
    push = (0.3, -1.0, 0.2)[: joint.dim]
    supports = {} if joint.rigid_base else dict.fromkeys(supported, 0.0)
    structure = Structure(joint, body=LinearElastic.young(30.0, 0.1), supports=supports, tractions={pushed: push})
    state = solve(structure.interface(ThinLayer(LinearElastic(6.0, 4.0), 0.05, at=1.0)))
    return float(state.u.x.petsc_vec.norm())


def numbers() -> dict[str, list]:
    """Name -> identity of the joint and norm of its displacements."""
    every = {f"back: {name}": taken_back(joint) for name, joint in built().items()} | made_by_dolfinx()
    results = {name: [joint.identity(), norm(joint)] for name, joint in every.items()}
    assert all(other == COMM.allgather(results)[0] for other in COMM.allgather(results))
    return results


def errors() -> list[list[str]]:
    """What each rank is told of a mesh that is on one rank alone, of a name that is none, of a mesh of other ranks."""
    plane, *tags = strip()
    said = []
    for data, upper in (
        ((plane if COMM.rank == 0 else None, *tags), "UPPER"),
        ((plane, *tags), "UPPERS"),
        ((mesh.create_unit_square(MPI.COMM_SELF, 2, 2),), "UPPER"),
    ):
        try:
            read(data, names=NAMES["names"] if len(data) > 1 else None, upper=upper)
        except InputError as error:
            said.append(str(error))
    return COMM.allgather(said)


@pytest.fixture(scope="module")
def alone():
    return numbers()


def test_joints_come_back(alone):
    """What DOLFINx has been given, with all names, is what it gives, but for the numbers of nodes and cells."""
    for name, joint in built().items():
        back = taken_back(joint)
        assert repr(back).split("; ")[0] == repr(joint).split("; ")[0], name
        assert (back.degree, back.seams) == (joint.degree, joint.seams), name
        assert {key: len(rows) for key, rows in back.facets.items()} == {k: len(r) for k, r in joint.facets.items()}
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


def test_names():
    plane, bodies, sides = strip()
    numbers = read((plane, bodies, sides), S="3", upper="2")
    assert (numbers.seams, set(numbers.facets)) == ({"S": Seam(("1",), ("2",))}, {"S", "4", "5"})
    between = read((plane, bodies), S=None, lower="1", upper="2")
    assert set(between.facets) == {"S"}
    assert len(between.facets["S"]) == len(numbers.facets["S"]) == 6
    merged = read((plane, bodies, sides), names=REGIONS | {"GLUE": (1, 3), "ENDS": (1, 4, 5)}, S="GLUE", upper="UPPER")
    assert len(merged.facets["ENDS"]) == 12
    cut = read((plane, None, sides), names={"S": (1, 3)}, direction=(0, 1))
    assert (cut.bodies, cut.seams["S"].direction) == (("BODY",), (0.0, 1.0))
    base = read((plane, None, sides), names={"S": (1, 4), "TOP": (1, 5)}, scale=10.0)
    assert base.rigid_base
    assert base.points.max(axis=0) == pytest.approx([20.0, 10.0], rel=1e-15)
    assert base.interface_normals == pytest.approx(np.tile([0.0, 1.0], (6, 1)))


def test_refused():
    plane, bodies, sides = strip()
    floats = mesh.meshtags(plane, 2, bodies.indices, bodies.values.astype(float))
    for change, message in (
        ({"mesh": None}, "mesh is None; give the name of a file, or a dolfinx.mesh.Mesh"),
        ({"cell_tags": 1}, "cell_tags is 1; give dolfinx.mesh.MeshTags"),
        ({"cell_tags": sides}, "cell_tags are of entities of dimension 1; those of this mesh have dimension 2"),
        ({"cell_tags": strip()[1]}, "cell_tags are of another mesh"),
        ({"cell_tags": floats}, "cell_tags have values of type float64; they must be integers"),
        ({"names": {"LOWER": (2, 1)} | FACETS, "upper": "LOWER"}, "36 of 72 cells are in no named group .*LOWER"),
        ({"names": {"LOWER": (2, 1), "UPPER": (2, 7)}}, "names: no cell has the tag 7, named 'UPPER'; tags: 1, 2"),
        ({"names": REGIONS | {"S": (1, 6)}}, "names: no facet has the tag 6, named 'S'; tags: 3, 4, 5"),
        ({"facet_tags": None}, "names: no facet has the tag 3, named 'S'; tags: none"),
        ({"names": {"LOWER": 1}}, r"names is \{'LOWER': 1\}; give \{name: \(dimension, number of its tags\)\}"),
        ({"names": {"LOWER": (2,)}}, r"names is \{'LOWER': \(2,\)\}; give"),
        ({"names": {1: (2, 1)}}, r"names is \{1: \(2, 1\)\}; give"),
        ({"S": "GLUE"}, "tags: unknown set of facets 'GLUE'; known: BOTTOM, S, TOP"),
        ({"names": REGIONS | {"S": (1, 3, 4)}}, "6 of 12 facets of 'S' lie on the outer boundary"),
    ):
        arguments = {"mesh": plane, "cell_tags": bodies, "facet_tags": sides, **NAMES, **change}
        data = [arguments.pop(name) for name in ("mesh", "cell_tags", "facet_tags")]
        refused(InputError, message, read, data, **arguments)
    for other, message in (
        (mesh.create_unit_interval(COMM, 3), "cells are of type interval; allowed: one of tri"),
        (mesh.create_unit_cube(COMM, 1, 1, 1, mesh.CellType.prism), "cells are of type prism; allowed: one of"),
    ):
        refused(InputError, message, read, other)


@pytest.mark.long
@on_ranks(errors, 2)
def test_errors_on_two_ranks(there):
    """All ranks have them, and none waits."""
    (first, two, three), others = there
    assert others == [first, two, three]
    assert first == "mesh is None; give the name of a file, or a dolfinx.mesh.Mesh"
    assert two.startswith("tags: unknown region 'UPPERS', did you mean 'UPPER'")
    assert three.startswith("the mesh is distributed on 1 ranks, comm has 2; give comm the communicator")
