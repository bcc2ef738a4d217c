"""Differences between DOLFINx releases 0.9 to 0.11 in creating meshes. Features are probed, not version strings."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import basix.ufl
import dolfinx
import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI

from geometry.topology import FloatArray, IntArray, geometry_degree


def _partitioner() -> Callable[..., Any]:
    """Partitioner with ghost cells across facets, which integrals over interior facets need."""
    create, mode = dolfinx.mesh.create_cell_partitioner, dolfinx.mesh.GhostMode.shared_facet
    try:
        return create(mode)
    except TypeError:
        return create(mode, 2)


def create_mesh(comm: MPI.Intracomm, points: FloatArray, cells: IntArray, cell_type: str) -> dolfinx.mesh.Mesh:
    """Distribute cells given by their nodes on rank 0 (other ranks: any value). Collective.

    A single rank needs neither ghosts nor a partitioner, which would take as long as the mesh itself.
    """
    dim, degree = points.shape[1], geometry_degree(cell_type, cells.shape[1])
    if comm.rank:
        points, cells = np.empty((0, dim)), np.empty((0, cells.shape[1]), np.int64)
    element = basix.ufl.element("Lagrange", cell_type, degree, shape=(dim,))
    order = list(inspect.signature(dolfinx.mesh.create_mesh).parameters)
    arguments = {"comm": comm, "cells": cells, "x": np.ascontiguousarray(points), "e": element}
    positional = [arguments[name] for name in order[:4]]
    return dolfinx.mesh.create_mesh(*positional, partitioner=_partitioner() if comm.size > 1 else None)


def cell_nodes(mesh: dolfinx.mesh.Mesh) -> npt.NDArray[np.int32]:
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
    owners = np.repeat(np.asarray(cells.owners, np.int32), k)
    nodes = _index_map(mesh.comm, cells.size_local * k, ghosts.ravel(), owners)
    old = mesh._cpp_object.geometry
    of_cells = np.arange(x.shape[0] * k, dtype=np.int32).reshape(-1, k)
    from_file = np.asarray(mesh.geometry.input_global_indices, np.int64)[cell_nodes(mesh)].ravel()
    element = old.cmap if callable(old.cmaps) else old.cmaps[0]
    geometry = type(old)(nodes, of_cells, element, np.ascontiguousarray(x.reshape(-1, x.shape[2])), from_file)
    domain = mesh.ufl_domain()
    moved = type(mesh._cpp_object)(mesh.comm, mesh._cpp_object.topology, geometry)
    return dolfinx.mesh.Mesh(moved, ufl.Mesh(domain.ufl_coordinate_element()))


def _index_map(comm: MPI.Intracomm, n: int, ghosts: npt.NDArray[np.int64], owners: npt.NDArray[np.int32]) -> Any:
    """Index map of n owned indices and ghosts given by global number and owner. Collective."""
    try:
        return dolfinx.cpp.common.IndexMap(comm, n, ghosts, owners)
    except TypeError:
        return dolfinx.cpp.common.IndexMap(comm, n, ghosts, owners, 1801)
