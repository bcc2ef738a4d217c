"""Prints what joints from meshes of DOLFINx are and how they deform; test_from_dolfinx runs it on several ranks."""

from __future__ import annotations

import json

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from forms import LinearElastic
from geometry import Domain, Joint, block, disc, from_dolfinx, ring, sandwich
from tests.meshes import drawing, model_to_mesh, stack
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
    state = solve(structure.interface(ThinLayer(LinearElastic(6.0, 4.0), 0.05)))
    return float(state.u.x.petsc_vec.norm())


def main() -> None:
    """Print, on rank 0, name -> identity of the joint and norm of its displacements."""
    joints = {f"back: {name}": taken_back(joint) for name, joint in built().items()} | made_by_dolfinx()
    found = {name: [joint.identity(), norm(joint)] for name, joint in joints.items()}
    assert all(other == COMM.allgather(found)[0] for other in COMM.allgather(found))
    if COMM.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
