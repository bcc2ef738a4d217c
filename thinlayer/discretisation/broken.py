"""The broken space: one mesh, one function, one matrix, and jumps across cuts.

An ordinary space numbers its degrees of freedom by their place. Here a degree of freedom is a place *and* a component of
the cells around it: cells of one component share it, cells of different components do not, so functions are continuous
except across the cuts that part the components. Everything else (forms, boundary conditions, matrices) is standard.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from thinlayer.compiling.compat import index_map, space_with_dofmap
from thinlayer.parallel.exchange import ask

Components = Sequence[npt.NDArray[np.int64]]


def broken_space(comm: MPI.Intracomm, mesh: Mesh, element: Any, components: Components) -> fem.FunctionSpace:
    """Space of an element whose functions jump between components of cells. Collective.

    Args:
        comm: the domain's communicator.
        mesh: the mesh, with ghost cells across shared facets.
        element: a basix.ufl element.
        components: for each dimension below the mesh's, (local cells, entities of a cell) number >= 0 of the component of
            each local cell, ghosts included, around its entities; the same on all ranks.
    """
    rank = comm.rank
    whole = fem.functionspace(mesh, element)
    base_map, base_dofs = whole.dofmap.index_map, np.asarray(whole.dofmap.list, np.int64)
    component = np.zeros_like(base_dofs)
    for dim, numbers in enumerate(components):
        for entity in range(numbers.shape[1]):
            dofs = whole.dofmap.dof_layout.entity_dofs(dim, entity)
            component[:, dofs] = numbers[: len(base_dofs), [entity]]
    count = comm.allreduce(int(component.max(initial=0)) + 1, op=max)
    keys, local_key = np.unique(base_dofs * count + component, return_inverse=True)
    local_key = local_key.reshape(base_dofs.shape)
    base, number_there = np.divmod(keys, count)
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    used = np.zeros(len(keys), np.int64)
    used[local_key[:n_cells].ravel()] = 1

    n_base = base_map.size_local + base_map.num_ghosts
    base_owner = np.concatenate([np.full(base_map.size_local, rank), base_map.owners]).astype(np.int64)[:n_base]
    global_base = np.asarray(base_map.local_to_global(np.arange(n_base, dtype=np.int32)))
    global_key = global_base[base] * count + number_there

    owner = ask(comm, base_owner[base], np.column_stack([global_key, used]), lambda q, src: _elect(q, src, rank))
    own = owner == rank
    n_own = int(own.sum())
    first = comm.exscan(n_own) or 0
    number = np.full(len(keys), -1, np.int64)
    number[own] = first + np.arange(n_own)
    order = np.argsort(global_key[own])
    sorted_keys, sorted_numbers = global_key[own][order], number[own][order]
    foreign = ~own
    number[foreign] = ask(
        comm, owner[foreign], global_key[foreign], lambda q, _: sorted_numbers[np.searchsorted(sorted_keys, q)]
    )
    local = np.empty(len(keys), np.int32)
    local[own] = np.arange(n_own)
    local[foreign] = n_own + np.arange(len(keys) - n_own)
    imap = index_map(comm, n_own, number[foreign], owner[foreign])
    return space_with_dofmap(whole, local[local_key], imap)


def _elect(questions: npt.NDArray[np.int64], source: npt.NDArray[np.int64], rank: int) -> npt.NDArray[np.int64]:
    """Owner of each key: this rank (which owns its place) if one of its own cells uses it, else the lowest such rank."""
    key, used = questions[:, 0], questions[:, 1] == 1
    candidate, votes = key[used], np.where(source[used] == rank, -1, source[used])
    order = np.lexsort((votes, candidate))
    distinct, start = np.unique(candidate[order], return_index=True)
    winner = votes[order][start]
    winner[winner < 0] = rank
    return winner[np.searchsorted(distinct, key)]
