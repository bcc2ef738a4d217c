"""Meshes of DOLFINx: making them, whatever the release from 0.9 to 0.11 on, and the nodes and facets of their cells."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import basix.ufl
import dolfinx
import numpy as np
import ufl
from mpi4py import MPI

from geometry.topology import FloatArray, Indices, IntArray, geometry_degree, local_facets


def first_that_fits(*calls: Callable[[], Any]) -> Any:
    """Result of the first call whose signature exists (a wrong signature raises TypeError before any work is done)."""
    for call in calls[:-1]:
        try:
            return call()
        except TypeError:
            continue
    return calls[-1]()


def create_mesh(comm: MPI.Intracomm, points: FloatArray, cells: IntArray, cell_type: str) -> dolfinx.mesh.Mesh:
    """Distribute cells given by their nodes on rank 0 (other ranks: any value). Collective.

    Ghost cells across facets are for integrals over interior facets. A single rank needs neither them nor a partitioner,
    which would take as long as the mesh itself.
    """
    dim, degree = points.shape[1], geometry_degree(cell_type, cells.shape[1])
    if comm.rank:
        points, cells = np.empty((0, dim)), np.empty((0, cells.shape[1]), np.int64)
    create, mode = dolfinx.mesh.create_cell_partitioner, dolfinx.mesh.GhostMode.shared_facet
    partitioner = first_that_fits(lambda: create(mode), lambda: create(mode, 2)) if comm.size > 1 else None
    element = basix.ufl.element("Lagrange", cell_type, degree, shape=(dim,))
    arguments = {"comm": comm, "cells": cells, "x": np.ascontiguousarray(points), "e": element}
    order = list(inspect.signature(dolfinx.mesh.create_mesh).parameters)[:4]
    return dolfinx.mesh.create_mesh(*(arguments[name] for name in order), partitioner=partitioner)


def cell_nodes(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Nodes of the geometry of each cell of this rank, (cells, nodes)."""
    maps = getattr(mesh.geometry, "dofmaps", None)
    return np.asarray(mesh.geometry.dofmap if maps is None or callable(maps) else maps[0])


def with_cell_points(mesh: dolfinx.mesh.Mesh, x: FloatArray) -> dolfinx.mesh.Mesh:
    """The same cells, facets and vertices with the nodes (cells, k, d) of the cells elsewhere. Collective.

    Each cell has nodes of its own, so that neighbours may stand apart: the facet between them is one, and has a place on
    either side. What DOLFINx computes of it without a side ("+", "-") is that of one of the cells.

    Args:
        mesh: the mesh.
        x: places of the nodes of this rank's cells, ghosts included, in the order of `cell_nodes`.
    """
    cells, k = mesh.topology.index_map(mesh.topology.dim), x.shape[1]
    ghosts = np.asarray(cells.ghosts, np.int64)[:, None] * k + np.arange(k)
    nodes = index_map(mesh.comm, cells.size_local * k, ghosts.ravel(), np.repeat(cells.owners, k))
    old = mesh._cpp_object.geometry
    of_cells = np.arange(x.shape[0] * k, dtype=np.int32).reshape(-1, k)
    from_file = np.asarray(mesh.geometry.input_global_indices, np.int64)[cell_nodes(mesh)].ravel()
    element = old.cmap if callable(old.cmaps) else old.cmaps[0]
    geometry = type(old)(nodes, of_cells, element, np.ascontiguousarray(x.reshape(-1, x.shape[2])), from_file)
    moved = type(mesh._cpp_object)(mesh.comm, mesh._cpp_object.topology, geometry)
    return dolfinx.mesh.Mesh(moved, ufl.Mesh(mesh.ufl_domain().ufl_coordinate_element()))


def index_map(comm: MPI.Intracomm, n: int, ghosts: IntArray, owners: Indices) -> Any:
    """Index map of n owned indices and ghosts given by global number and owner. Collective."""
    arguments = (comm, n, np.asarray(ghosts, np.int64), np.asarray(owners, np.int32))
    create = dolfinx.cpp.common.IndexMap
    return first_that_fits(lambda: create(*arguments), lambda: create(*arguments, 1801))


def facets_of_cells(mesh: dolfinx.mesh.Mesh, cell_type: str) -> Indices:
    """(n_cells, m) facets of the local cells (ghosts included), in the order of the cells' own facets."""
    topology = mesh.topology
    topology.create_entities(topology.dim - 1)
    for pair in ((topology.dim - 1, topology.dim), (topology.dim, topology.dim - 1)):
        topology.create_connectivity(*pair)
    return topology.connectivity(topology.dim, topology.dim - 1).array.reshape(-1, len(local_facets(cell_type)))


def vertices_of_facets(mesh: dolfinx.mesh.Mesh, cell_type: str, facets: Indices, corners: IntArray) -> IntArray:
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
