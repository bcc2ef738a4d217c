"""Spaces with jumps or periodicity on the mesh of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from geometry.domain import Domain, Element, index_map
from geometry.joint import InflatedBand, Joint
from geometry.topology import Indices, IntArray, Splitting
from thinlayer.system.compat import space_with_dofmap
from thinlayer.system.ranks import query

EntityKeys = Sequence[IntArray | Indices]


def band_of(joint: Joint) -> InflatedBand:
    """Return the regions and faces of the meshed layers of a joint, and how they were meshed.

    The joint must have meshed layers.
    """
    assert joint.band is not None
    return joint.band


@dataclass(frozen=True)
class SharedDofs:
    """Numbering of the degrees of freedom (dofs) of a space in which only chosen cells share dofs.

    The dofs of local cells, ghosts included, have keys: dofs with the same key are one dof.

    Attributes:
        continuous_space: the continuous space with the same element.
        keys: (n,) distinct keys of the dofs of the local cells, the same on all ranks, in the order of the dofs of
            `continuous_space`.
        meeting_ranks: (n,) for each key the rank that decides which rank owns the dof, the same on all ranks.
        cell_dofs: (cells, dofs per cell) indices in `keys`.
    """

    continuous_space: fem.FunctionSpace
    keys: IntArray
    meeting_ranks: IntArray
    cell_dofs: IntArray

    @classmethod
    def of_components(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, components: EntityKeys) -> SharedDofs:
        """Return dofs for a mesh with cuts: cells share a dof only on the same side of the cuts around it. Collective.

        The cuts divide the cells around each vertex, edge or facet into one or several components. The dofs of the
        entity have a copy for each component. The owner of a dof in the continuous space is the meeting rank of its
        copies.

        Args:
            comm: the domain's communicator.
            mesh: the mesh, with ghost cells across shared facets.
            element: a basix.ufl element.
            components: for each dimension of entities below that of the mesh an array (local cells, entities of a
                cell), ghosts included. It has the number >= 0, the same on all ranks, of the cell's component around
                each entity.
        """
        space = fem.functionspace(mesh, element)
        index_map, dof_components = space.dofmap.index_map, _dof_values(space, components, 0)
        n_copies = comm.allreduce(int(dof_components.max(initial=0)) + 1, op=max)
        n_local = index_map.size_local + index_map.num_ghosts
        copies = np.asarray(space.dofmap.list, np.int64) * n_copies + dof_components
        is_used = np.zeros(n_local * n_copies, bool)
        is_used[copies] = True
        local_dof, copy_number = np.divmod(np.flatnonzero(is_used), n_copies)
        owner = np.concatenate([np.full(index_map.size_local, comm.rank), index_map.owners]).astype(np.int64)[:n_local]
        numbers = np.asarray(index_map.local_to_global(np.arange(n_local, dtype=np.int32)))
        return cls(space, numbers[local_dof] * n_copies + copy_number, owner[local_dof], (is_used.cumsum() - 1)[copies])

    @classmethod
    def of_entities(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, keys: EntityKeys) -> SharedDofs:
        """Return dofs for a mesh in which several entities count as one, as on two periodic sides. Collective.

        Args:
            comm: the domain's communicator.
            mesh: the mesh.
            element: a basix.ufl element, with at most one dof for each vertex, edge, facet or cell.
            keys: for each dimension of entities an array (local cells, entities of a cell) of numbers >= 0. Entities
                that count as one have the same number. Entities of different dimensions have different numbers.
        """
        space = fem.functionspace(mesh, element)
        distinct, key_indices = np.unique(_dof_values(space, keys, -1), return_inverse=True)
        first_dof = np.full(len(distinct), np.iinfo(np.int64).max)
        np.minimum.at(first_dof, key_indices.ravel(), np.asarray(space.dofmap.list, np.int64).ravel())
        order = np.lexsort((distinct, first_dof))
        distinct, key_indices = distinct[order], np.argsort(order)[key_indices.reshape(np.shape(space.dofmap.list))]
        meeting_ranks = distinct * comm.size // comm.allreduce(int(distinct.max(initial=0)) + 1, op=max)
        return cls(space, distinct, meeting_ranks, key_indices)


def _dof_values(space: fem.FunctionSpace, entity_values: EntityKeys, default: int) -> IntArray:
    """Return for each dof of each local cell the value of the vertex, edge, facet or cell to which the dof belongs.

    Args:
        space: the space of the dofs.
        entity_values: for each dimension of entities, from 0, their values (cells, entities of a cell).
        default: value of dofs on entities of other dimensions.

    Returns:
        Values (cells, dofs per cell).
    """
    out = np.full(np.shape(space.dofmap.list), default, np.int64)
    for dim, values in enumerate(entity_values):
        for entity in range(values.shape[1]):
            out[:, space.dofmap.dof_layout.entity_dofs(dim, entity)] = values[: len(out), [entity]]
    return out


def broken_space(comm: MPI.Intracomm, shared: SharedDofs) -> fem.FunctionSpace:
    """Return the function space with one degree of freedom for each key of `shared`. Collective."""
    rank, space, keys, meeting_ranks = comm.rank, shared.continuous_space, shared.keys, shared.meeting_ranks
    n_owned_cells = space.mesh.topology.index_map(space.mesh.topology.dim).size_local
    is_used = np.zeros(len(keys), np.int64)
    is_used[shared.cell_dofs[:n_owned_cells]] = 1
    owner = query(comm, meeting_ranks, np.column_stack([keys, is_used]), lambda q, src: _elect_owners(q, src, rank))
    is_owned = owner == rank
    n_own = int(is_owned.sum())
    first_number = comm.exscan(n_own) or 0
    number = np.full(len(keys), -1, np.int64)
    number[is_owned] = first_number + np.arange(n_own)
    order = np.argsort(keys[is_owned])
    owned_keys, numbers = keys[is_owned][order], number[is_owned][order]
    foreign = ~is_owned
    number[foreign] = query(comm, owner[foreign], keys[foreign], lambda q, _: numbers[np.searchsorted(owned_keys, q)])
    local = np.empty(len(keys), np.int32)
    local[is_owned] = np.arange(n_own)
    local[foreign] = n_own + np.arange(len(keys) - n_own)
    return space_with_dofmap(space, local[shared.cell_dofs], index_map(comm, n_own, number[foreign], owner[foreign]))


def _elect_owners(requests: IntArray, source_rank: IntArray, rank: int) -> IntArray:
    """Return the ranks that own the dofs about which other ranks ask this rank.

    This rank owns a dof if one of its local or ghost cells has it. Otherwise the owner is the lowest rank with an own
    cell that has it. Both sides of S then belong to one rank at nearly all places, as contact solvers need.

    Args:
        requests: (n, 2) key of each dof; and 1 if a cell that the asking rank owns has it, else 0.
        source_rank: (n,) the asking ranks.
        rank: this rank.

    Returns:
        Owner (n,) of each dof.
    """
    key, is_used = requests[:, 0], (requests[:, 1] == 1) | (source_rank == rank)
    used_keys, votes = key[is_used], np.where(source_rank[is_used] == rank, -1, source_rank[is_used])
    order = np.lexsort((votes, used_keys))
    distinct, start = np.unique(used_keys[order], return_index=True)
    winners = votes[order][start]
    winners[winners < 0] = rank
    return winners[np.searchsorted(distinct, key)]


def vector_space(domain: Domain, cut: Splitting, degree: int, family: str, n_components: int) -> fem.FunctionSpace:
    """Return a space of vector functions, which may jump across cuts. Collective.

    Args:
        domain: the distributed mesh.
        cut: the joint's mesh with cuts where the functions may jump.
        degree: polynomial degree.
        family: basix family.
        n_components: number of components of the functions, also a single one.
    """
    mesh, dim, comm = domain.mesh, domain.joint.dim, domain.comm
    element = basix.ufl.element(family, mesh.basix_cell(), degree, shape=(n_components,))
    if domain.joint.periods:
        entity_keys = [domain.to_local(of_dim) for of_dim in cut.entity_keys]
        return broken_space(comm, SharedDofs.of_entities(comm, mesh, element, entity_keys))
    used = [any(map(len, of_dim)) for of_dim in element.basix_element.entity_dofs]
    none = np.empty((0, 0), np.int64)
    components = [domain.to_local(cut.components(k) if k else cut.at_vertices) if used[k] else none for k in range(dim)]
    return broken_space(comm, SharedDofs.of_components(comm, mesh, element, components))


def mesh_cut_at_faces(joint: Joint) -> Splitting:
    """Return the joint's mesh cut along both faces of the meshed layers, or along S if there are none."""
    if joint.band is None:
        return joint.split_mesh
    facets = [joint.facets[name] for name in joint.band.faces]
    return joint.split_along(np.unique(joint.table.index(np.concatenate(facets))))
