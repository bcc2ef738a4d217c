"""Refinement of a joint by bisection, with its regions, facet sets and seams."""

from __future__ import annotations

from dataclasses import replace

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from geometry.domain import Domain, cell_nodes, create_connectivity
from geometry.joint import Joint
from geometry.topology import IntArray


def refined(joint: Joint, cells: IntArray, rows: IntArray) -> Joint:
    """Return a joint of straight triangles or tetrahedra with some cells divided, by DOLFINx's Plaza algorithm.

    Each edge of a marked cell or facet is bisected. Neighbours are divided too, so that the mesh conforms and angles
    keep a lower bound (Plaza and Carey 2000). The two sides of S stay matched. Nothing is projected onto a curve.

    Args:
        joint: the joint as drawn, not periodic, without meshed layers.
        cells: numbers of the marked cells.
        rows: row numbers in `joint.table` of the marked facets.
    """
    domain, d = Domain.of(joint, MPI.COMM_SELF), joint.dim
    topology = domain.mesh.topology
    topology.create_entities(1)
    create_connectivity(domain.mesh, 1)
    facets = np.arange(len(joint.table.vertices), dtype=np.int32)
    marked = domain.local_cells[cells].astype(np.int32), facets[np.isin(domain.numbers(d - 1, facets), rows)]
    topology.create_connectivity(d - 1, 1)
    edges = [
        dolfinx.mesh.compute_incident_entities(topology, *of_dim, 1) for of_dim in zip(marked, (d, d - 1), strict=True)
    ]
    option = dolfinx.mesh.RefinementOption.parent_cell_and_facet
    mesh, parent_cell, parent_facet = dolfinx.mesh.refine(domain.mesh, np.unique(np.concatenate(edges)), option=option)
    create_connectivity(mesh, d - 1)
    region = dolfinx.mesh.transfer_meshtag(domain.cell_tags, mesh, parent_cell).values - 1
    tags = dolfinx.mesh.transfer_meshtag(domain.facet_tags, mesh, parent_cell, parent_facet)
    vertices = dolfinx.mesh.entities_to_geometry(mesh, d - 1, tags.indices).astype(np.int64)
    named = {name: vertices[np.isin(tags.values, domain.values(name))] for name in joint.facets}
    return replace(
        joint,
        points=mesh.geometry.x[:, :d].copy(),
        cells=np.asarray(cell_nodes(mesh), np.int64),
        region=region.astype(np.int64),
        facets=named,
    )
