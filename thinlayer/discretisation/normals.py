"""Normals of the boundary at the nodes of a space."""

from __future__ import annotations

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from geometry.domain import Domain
from geometry.topology import connected
from thinlayer.compiling.compat import interpolation_points

Array = npt.NDArray[np.float64]
CORNER = 30.0  # degrees; facets whose normals differ by less at a node are one smooth surface there

ALONG_AXES = 1e-12  # a component of a unit normal that counts as rounding


def node_normals(
    domain: Domain, V: fem.FunctionSpace, facets: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.int64], Array]:
    """Outer normals of facets at their nodes, with weights whose sum at a vertex on a circle or sphere is along its normal.

    The weight is sin(angle)/(product of lengths) of the facet's edges at a vertex (Max 1999, Weights for computing vertex
    normals from facet normals), in 2D 1/length, so that the triangulation of a smooth side does not show. Collective.

    Args:
        domain: the domain.
        V: a space of nodal displacements.
        facets: local facets of the outer boundary; ghosts are left out.

    Returns:
        (n,) local numbers of blocks of this rank, one for each of the facets around a node, and (n, d) normals.
    """
    mesh, d = domain.mesh, domain.joint.dim
    kind = basix.CellType[mesh.basix_cell().name] if hasattr(mesh.basix_cell(), "name") else mesh.basix_cell()
    points, layout = interpolation_points(V), V.dofmap.dof_layout
    mesh.topology.create_connectivity(d - 1, d)
    mesh.topology.create_connectivity(d, d - 1)
    to_cells, to_facets = mesh.topology.connectivity(d - 1, d), mesh.topology.connectivity(d, d - 1)
    owned = mesh.topology.index_map(d).size_local
    cells = np.array([to_cells.links(facet)[0] for facet in facets], np.int32)
    facets, cells = facets[cells < owned], cells[cells < owned]
    local = np.array(
        [np.flatnonzero(to_facets.links(cell) == facet)[0] for cell, facet in zip(cells, facets, strict=True)], int
    )
    jacobian = fem.Expression(ufl.Jacobian(mesh), points)
    J = jacobian.eval(mesh, cells).reshape(len(cells), len(points), d, d) if len(cells) else np.empty((0, 1, d, d))
    outward, corners = basix.cell.facet_outward_normals(kind), basix.topology(kind)[d - 1]
    blocks, normals = [np.empty(0, np.int64)], [np.empty((0, d))]
    for number in range(len(corners)):
        here = np.flatnonzero(local == number)
        nodes = np.array(layout.entity_closure_dofs(d - 1, number))
        inverse = np.linalg.inv(J[here][:, nodes])
        n = np.einsum("cnji,j->cni", inverse, outward[number])  # the normal is along J^-T of the reference's
        n /= np.linalg.norm(n, axis=2)[..., None]
        x = mesh.geometry.x[mesh.geometry.dofmap[cells[here]][:, corners[number]]]
        for k, corner in enumerate(corners[number]):
            n[:, nodes == layout.entity_dofs(0, corner)[0]] *= _weights(x, k)[:, None, None]
        blocks.append(np.asarray(V.dofmap.list)[cells[here]][:, nodes].ravel().astype(np.int64))
        normals.append(n.reshape(-1, d))
    return _at_owners(domain, V, np.concatenate(blocks), np.concatenate(normals))


def _weights(x: Array, k: int) -> Array:
    """Weights (n,) of facets, given by their corners (n, m, 3), at the k-th corner."""
    beside = [k ^ 1, k ^ 2] if x.shape[1] == 4 else [j for j in range(x.shape[1]) if j != k]
    edges = x[:, beside] - x[:, k : k + 1]
    squares = (edges**2).sum(axis=2)
    if len(beside) == 1:
        return np.asarray(1 / np.sqrt(squares[:, 0]))
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.asarray(area / squares.prod(axis=1))


def _at_owners(
    domain: Domain, V: fem.FunctionSpace, blocks: npt.NDArray[np.int64], rows: Array
) -> tuple[npt.NDArray[np.int64], Array]:
    """Rows of local blocks on the ranks that own the blocks. Collective."""
    imap, comm = V.dofmap.index_map, domain.comm
    everywhere = comm.allgather((imap.local_to_global(blocks.astype(np.int32)), rows))
    numbers, found = (np.concatenate(some) for some in zip(*everywhere, strict=True))
    first, last = imap.local_range
    mine = (numbers >= first) & (numbers < last)
    return numbers[mine] - first, found[mine]


def smooth(normals: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """Which facet normals (n, d) at a node belong to one smooth surface, and the unit normals (k, d) of these surfaces.

    Facets whose normals differ by less than CORNER are one surface with their mean normal; others meet in a corner.
    """
    unit = normals / np.linalg.norm(normals, axis=1)[:, None]
    one, other = np.nonzero(unit @ unit.T > np.cos(np.deg2rad(CORNER)))
    _, surface = np.unique(connected(one, other, len(unit)), return_inverse=True)
    sums = np.zeros((surface.max() + 1, normals.shape[1]))
    np.add.at(sums, surface, normals)
    sums /= np.linalg.norm(sums, axis=1)[:, None]
    sums[np.abs(sums) < ALONG_AXES] = 0.0
    return surface.ravel().astype(np.int64), sums / np.linalg.norm(sums, axis=1)[:, None]
