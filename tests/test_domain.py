"""Joints distributed over MPI ranks."""

from __future__ import annotations

from dataclasses import replace

import dolfinx
import numpy as np
import pytest

from geometry import block, disc, ring, sandwich
from geometry.domain import Domain
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from tests.meshes import renumbered
from tests.on_ranks import on_ranks


def joints() -> dict[str, Joint]:
    """All types of cells, straight and curved; a rigid base, a meshed layer, S that ends inside."""
    flat, cube = sandwich(1.0, 0.5, 0.5, 0.2), sandwich(1.0, 0.5, 0.5, 0.4, depth=0.5)
    centres = flat.points[flat.facets["S"]].mean(axis=1)
    return {
        "triangles": flat,
        "fewer cells than ranks": sandwich(1.0, 0.5, 0.5, 1.0, cell="quadrilateral"),
        "renumbered": renumbered(cube),
        "quadrilaterals": block(1.0, 0.5, 0.25, cell="quadrilateral"),
        "hexahedra": block(1.0, 0.5, 0.25, depth=0.5, cell="hexahedron"),
        "curved triangles": ring(1.0, 1.5, 2.0, 0.5, degree=2),
        "curved quadrilaterals": ring(1.0, 1.5, 2.0, 0.5, degree=2, cell="quadrilateral"),
        "curved tetrahedra": disc(1.0, 0.5, 0.5, 0.5, degree=2),
        "curved hexahedra": disc(1.0, 0.5, 0.5, 0.5, degree=2, cell="hexahedron"),
        "layer": inflate(flat, 0.05),
        "layer in space": inflate(cube, 0.05),
        "tip": replace(flat, facets={**flat.facets, "S": flat.facets["S"][centres[:, 0] < 0.5]}),
    }


def distributed(domain: Domain, dim: int, entities: np.ndarray, values: np.ndarray) -> dolfinx.mesh.MeshTags:
    """Tags of entities given by nodes of the joint, as DOLFINx distributes them from rank 0."""
    mesh = domain.mesh
    if domain.comm.rank:
        entities, values = entities[:0], values[:0]
    mesh.topology.create_connectivity(dim, 0)
    local, tags = dolfinx.io.utils.distribute_entity_data(mesh, dim, entities.astype(np.int64), values.astype(np.int32))
    adjacency = dolfinx.graph.adjacencylist(local)
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, adjacency, tags.astype(np.int32))


def compare_tags() -> None:
    """Raise AssertionError unless the tags of every joint are those that DOLFINx distributes."""
    for name, joint in joints().items():
        domain = Domain.of(joint)
        regions = distributed(domain, joint.dim, joint.cells, joint.region + 1)
        assert np.array_equal(domain.cell_tags.indices, regions.indices), name
        assert np.array_equal(domain.cell_tags.values, regions.values), name
        sets = {which: joint.table.index(facets) for which, facets in joint.facets.items()}
        assert sets.keys() <= domain.facet_values.keys()
        for which, rows in sets.items():
            nodes = joint.table.nodes(rows, joint.cells, joint.cell_type)
            there = distributed(domain, joint.dim - 1, nodes, np.ones(len(rows)))
            assert np.array_equal(domain.facets(which), there.indices), (name, which)
            assert np.isin(domain.numbers(joint.dim - 1, there.indices), rows).all(), (name, which)


def test_tags():
    """Those that DOLFINx distributes."""
    compare_tags()


@pytest.mark.long
@on_ranks(compare_tags, 2, 3)
def test_tags_on_several_ranks(there):
    assert there is None  # no error on any rank
