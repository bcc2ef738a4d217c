"""Joints distributed over MPI ranks."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
import pytest
from mpi4py import MPI

from geometry import block, disc, parallel, ring, sandwich
from geometry.domain import Domain
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.parallel import on_root
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
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, dolfinx.graph.adjacencylist(local), tags.astype(np.int32))


def compare_tags() -> None:
    """Raise AssertionError unless the tags of every joint are those that DOLFINx distributes."""
    for name, joint in joints().items():
        domain = Domain.of(joint)
        regions = distributed(domain, joint.dim, joint.cells, joint.region + 1)
        assert np.array_equal(domain.cell_tags.indices, regions.indices), name
        assert np.array_equal(domain.cell_tags.values, regions.values), name
        sets = {which: joint.table.index(facets) for which, facets in joint.facets.items()}
        assert sets.keys() <= domain.set_tags.keys()
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


def of_rank_0() -> dict[str, Any]:
    """Arrays that rank 0 makes and every rank reads: how often they stand in memory, if ranks share it or cannot."""
    made = {"large": 0.5 * np.arange(2_000_000), "columns": np.arange(60_000).reshape(3, -1).T, "small": np.arange(7)}

    def in_memory() -> float:
        rollup = Path("/proc/self/smaps_rollup").read_text().splitlines()
        n_bytes = next(int(line.split()[1]) * 1024 for line in rollup if line.startswith("Pss_Shmem"))
        return float(MPI.COMM_WORLD.allreduce(n_bytes))

    def copies() -> float:
        before = in_memory()
        read = on_root(None, lambda: made)
        assert all(np.array_equal(read[name], made[name]) for name in made)
        assert not read["large"].flags.writeable
        MPI.COMM_WORLD.Barrier()
        return (in_memory() - before) / made["large"].nbytes

    reachable: Callable[..., bool] = os.access
    shared, piece = copies(), parallel.MAX_MESSAGE_BYTES
    os.access, parallel.MAX_MESSAGE_BYTES = lambda *_: False, 1_000_003
    try:
        return {"shared": shared, "apart": copies(), "left": in_memory() / made["large"].nbytes}
    finally:
        os.access, parallel.MAX_MESSAGE_BYTES = reachable, piece


@on_ranks(of_rank_0, 2)
def test_large_arrays_of_rank_0_stand_once_in_the_memory_of_a_machine(there):
    assert there["shared"] == pytest.approx(1.0, abs=0.2)  # MPI's own memory is shared, too
    assert there["apart"] == pytest.approx(2.0, abs=0.2)
    assert there["left"] < 0.8  # nothing but memory of MPI stays when nobody uses them
