"""Differences between DOLFINx releases 0.9 to 0.11 in creating meshes. Features are probed, not version strings."""

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
