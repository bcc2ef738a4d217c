"""Functions of degree 1 on a region: at vertices that periodic sides identify, and at places."""

from __future__ import annotations

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from geometry.dolfinx_mesh import cell_nodes
from geometry.topology import IntArray
from thinlayer.discretisation.broken import Keys, broken_space
from thinlayer.parallel.communicator import communicator
from thinlayer.parts.part import Array
from thinlayer.pointwise.quadrature import Region

SAME_PLACE = 1e-9  # distance, relative to the size of S, at which two vertices are one


def identified(region: Region, masters: IntArray) -> fem.FunctionSpace:
    """Functions that are the same at vertices that periodic sides identify (`Joint.masters`). Collective."""
    mesh = region.mesh
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
    corners = cell_nodes(mesh)[:, : element.basix_element.dim]
    vertices = np.asarray(mesh.geometry.input_global_indices, np.int64)[corners]
    comm = communicator(region.parent_mesh)
    return broken_space(comm, Keys.of_entities(comm, mesh, element, [masters[vertices]]))


def at_places(space: fem.FunctionSpace, places: Array) -> npt.NDArray[np.int64]:
    """Unknowns of this rank of a space of degree 1 at some of its vertices (n, d). Collective."""
    owned = space.dofmap.index_map.size_local
    x = space.tabulate_dof_coordinates()[:owned, : places.shape[1]]
    ends = space.mesh.comm.allgather((x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)))
    low, high = (np.array(one) for one in zip(*ends, strict=True))
    size = float((high.max(axis=0) - low.min(axis=0)).max())
    distance, _ = cKDTree(places).query(x)
    return np.flatnonzero(distance <= SAME_PLACE * size).astype(np.int64)
