"""Spaces of functions that jump where a mesh is cut, and repeat where it is periodic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from geometry.dolfinx_mesh import index_map
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.topology import Splitting
from thinlayer.system.compat import space_with_dofmap
from thinlayer.system.ranks import ask

IntArray = npt.NDArray[np.int64]
OfEntities = Sequence[IntArray]


@dataclass(frozen=True)
class Keys:
    """Which degrees of freedom of the local cells, ghosts included, are the same.

    Attributes:
        whole: the ordinary space.
        keys: (cells, unknowns of a cell) number of each degree of freedom, the same on all ranks.
        meeting: (cells, unknowns of a cell) rank that is told who uses the key, the same on all ranks.
    """

    whole: fem.FunctionSpace
    keys: IntArray
    meeting: IntArray

    @classmethod
    def of_components(cls, comm: MPI.Intracomm, mesh: Mesh, element: Any, components: OfEntities) -> Keys:
        """Keys by place and component; users of a key meet at the owner of the place. Collective.

        Args:
            comm: the domain's communicator.
            mesh: the mesh, with ghost cells across shared facets.
            element: a basix.ufl element.
            components: for each dimension below the mesh's, (local cells, entities of a cell) number >= 0 of the component
                of each local cell, ghosts included, around its entities; the same on all ranks.
        """
        whole = fem.functionspace(mesh, element)
        base_map, base = whole.dofmap.index_map, np.asarray(whole.dofmap.list, np.int64)
        component = _of_unknowns(whole, components, 0)
        count = comm.allreduce(int(component.max(initial=0)) + 1, op=max)
        n_base = base_map.size_local + base_map.num_ghosts
        owner = np.concatenate([np.full(base_map.size_local, comm.rank), base_map.owners]).astype(np.int64)[:n_base]
        numbers = np.asarray(base_map.local_to_global(np.arange(n_base, dtype=np.int32)))
        return cls(whole, numbers[base] * count + component, owner[base])

    @classmethod
    def of_entities(cls, comm: MPI.Intracomm, mesh: Mesh, element: Any, keys: OfEntities) -> Keys:
        """Keys of the entities of each local cell, for elements with one unknown per entity at most. Collective.

        Args:
            comm, mesh, element: as in `of_components`.
            keys: for each dimension, (local cells, entities of a cell) numbers >= 0, other ones in each dimension.
        """
        whole = fem.functionspace(mesh, element)
        found = _of_unknowns(whole, keys, -1)
        count = comm.allreduce(int(found.max(initial=0)) + 1, op=max)
        return cls(whole, found, found * comm.size // count)


def _of_unknowns(whole: fem.FunctionSpace, of_entities: OfEntities, otherwise: int) -> IntArray:
    """(cells, unknowns of a cell) values of the entities that the unknowns of each local cell belong to."""
    out = np.full(np.shape(whole.dofmap.list), otherwise, np.int64)
    for dim, values in enumerate(of_entities):
        for entity in range(values.shape[1]):
            out[:, whole.dofmap.dof_layout.entity_dofs(dim, entity)] = values[: len(out), [entity]]
    return out


def broken_space(comm: MPI.Intracomm, unknowns: Keys) -> fem.FunctionSpace:
    """Space of functions whose degrees of freedom are one for each key. Collective."""
    rank, whole = comm.rank, unknowns.whole
    base = np.asarray(whole.dofmap.list, np.int64)
    keys, at, number_of = np.unique(unknowns.keys, return_index=True, return_inverse=True)
    number_of = number_of.reshape(base.shape)
    place = np.full(len(keys), np.iinfo(np.int64).max)
    np.minimum.at(place, number_of.ravel(), base.ravel())
    order = np.lexsort((keys, place))  # as the ordinary space has them: neighbours in memory
    keys, meeting, local_key = keys[order], unknowns.meeting.ravel()[at[order]], np.argsort(order)[number_of]

    n_cells = whole.mesh.topology.index_map(whole.mesh.topology.dim).size_local
    used = np.zeros(len(keys), np.int64)
    used[local_key[:n_cells].ravel()] = 1
    owner = ask(comm, meeting, np.column_stack([keys, used]), lambda q, src: _elect(q, src, rank))
    own = owner == rank
    n_own = int(own.sum())
    first = comm.exscan(n_own) or 0
    number = np.full(len(keys), -1, np.int64)
    number[own] = first + np.arange(n_own)
    order = np.argsort(keys[own])
    sorted_keys, sorted_numbers = keys[own][order], number[own][order]
    foreign = ~own
    number[foreign] = ask(
        comm, owner[foreign], keys[foreign], lambda q, _: sorted_numbers[np.searchsorted(sorted_keys, q)]
    )
    local = np.empty(len(keys), np.int32)
    local[own] = np.arange(n_own)
    local[foreign] = n_own + np.arange(len(keys) - n_own)
    imap = index_map(comm, n_own, number[foreign], owner[foreign])
    return space_with_dofmap(whole, local[local_key], imap)


def _elect(questions: IntArray, source: IntArray, rank: int) -> IntArray:
    """Owner of each key: this rank, where its users meet, if one of its own cells uses it, else the lowest such rank."""
    key, used = questions[:, 0], questions[:, 1] == 1
    candidate, votes = key[used], np.where(source[used] == rank, -1, source[used])
    order = np.lexsort((votes, candidate))
    distinct, start = np.unique(candidate[order], return_index=True)
    winner = votes[order][start]
    winner[winner < 0] = rank
    return winner[np.searchsorted(distinct, key)]


def vector_space(domain: Domain, cut: Splitting, degree: int, family: str) -> fem.FunctionSpace:
    """Vector functions (d,) on a domain. Collective.

    Args:
        domain: the domain.
        cut: where its mesh is cut.
        degree: polynomial degree.
        family: basix family.
    """
    mesh, dim, comm = domain.mesh, domain.joint.dim, domain.comm
    element = basix.ufl.element(family, mesh.basix_cell(), degree, shape=(dim,))
    if domain.joint.periods:
        of_entities = [domain.on_cells(of_dim) for of_dim in cut.keys]
        return broken_space(comm, Keys.of_entities(comm, mesh, element, of_entities))
    used = [any(map(len, of_dim)) for of_dim in element.basix_element.entity_dofs]
    none = np.empty((0, 0), np.int64)
    components = [domain.on_cells(cut.components(k)) if used[k] else none for k in range(dim)]
    return broken_space(comm, Keys.of_components(comm, mesh, element, components))


def cut_at_faces(joint: Joint) -> Splitting:
    """The joint's mesh, cut along S, or at both faces of the meshed layer."""
    if joint.band is None:
        return joint.splitting
    facets = [joint.facets[name] for name in joint.band.faces]
    return joint.split_along(np.unique(joint.table.index(np.concatenate(facets))))
