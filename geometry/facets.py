"""Facets of a rank's part of a DOLFINx mesh, by its cells."""

from __future__ import annotations

import dolfinx
import numpy as np
import numpy.typing as npt

from geometry.topology import IntArray, local_facets

Numbers = npt.NDArray[np.int32]


def facets_of_cells(mesh: dolfinx.mesh.Mesh, cell_type: str) -> Numbers:
    """(n_cells, m) facets of the local cells (ghosts included), in the order of the cells' own facets."""
    topology = mesh.topology
    topology.create_entities(topology.dim - 1)
    for pair in ((topology.dim - 1, topology.dim), (topology.dim, topology.dim - 1)):
        topology.create_connectivity(*pair)
    return topology.connectivity(topology.dim, topology.dim - 1).array.reshape(-1, len(local_facets(cell_type)))


def vertices_of_facets(mesh: dolfinx.mesh.Mesh, cell_type: str, facets: Numbers, corners: IntArray) -> IntArray:
    """(n, k) vertices of local facets, numbered as in `corners`.

    Args:
        mesh: the mesh.
        cell_type: type of its cells.
        facets: (n,) local facets.
        corners: (n_cells, m) vertices of the local cells.
    """
    of_cells = facets_of_cells(mesh, cell_type)
    to_cells = mesh.topology.connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    cells = to_cells.array[to_cells.offsets[facets]]
    which = (of_cells[cells] == facets[:, None]).argmax(axis=1)
    return np.take_along_axis(corners[cells], local_facets(cell_type)[which], axis=1)
