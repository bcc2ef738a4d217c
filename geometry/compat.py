"""Differences between DOLFINx releases 0.9 to 0.11 met while creating meshes; features are probed, not version strings."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import basix.ufl
import dolfinx
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from geometry.topology import FloatArray, IntArray, geometry_degree


def _partitioner() -> Callable[..., Any]:
    """Cells of the other side of a facet are kept as ghosts: integrals over interior facets need them."""
    create, mode = dolfinx.mesh.create_cell_partitioner, dolfinx.mesh.GhostMode.shared_facet
    try:
        return create(mode)
    except TypeError:
        return create(mode, 2)


def create_mesh(comm: MPI.Intracomm, points: FloatArray, cells: IntArray, cell_type: str) -> dolfinx.mesh.Mesh:
    """Distribute cells given by their nodes on rank 0 (other ranks: any value). Collective."""
    dim, degree = points.shape[1], geometry_degree(cell_type, cells.shape[1])
    if comm.rank:
        points, cells = np.empty((0, dim)), np.empty((0, cells.shape[1]), np.int64)
    element = basix.ufl.element("Lagrange", cell_type, degree, shape=(dim,))
    order = list(inspect.signature(dolfinx.mesh.create_mesh).parameters)
    arguments = {"comm": comm, "cells": cells, "x": np.ascontiguousarray(points), "e": element}
    positional = [arguments[name] for name in order[:4]]
    return dolfinx.mesh.create_mesh(*positional, partitioner=_partitioner())


def create_tags(
    mesh: dolfinx.mesh.Mesh, dim: int, entities: IntArray, values: npt.NDArray[np.int32]
) -> dolfinx.mesh.MeshTags:
    """Tags of entities given by their nodes' original numbers on rank 0 (other ranks: any value). Collective."""
    if mesh.comm.rank:
        entities, values = np.empty((0, entities.shape[1]), np.int64), np.empty(0, np.int32)
    mesh.topology.create_entities(dim)
    mesh.topology.create_connectivity(dim, 0)
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    local, tags = dolfinx.io.utils.distribute_entity_data(
        mesh, dim, np.ascontiguousarray(entities, np.int64), np.ascontiguousarray(values, np.int32)
    )
    adjacency = dolfinx.graph.adjacencylist(local)
    return dolfinx.mesh.meshtags_from_entities(mesh, dim, adjacency, tags.astype(np.int32, copy=False))
