"""The broken space: one mesh, one function, one matrix, and jumps wherever cells of two colours meet.

An ordinary space numbers its degrees of freedom by their place. Here a degree of freedom is a place *and* a colour: cells
of one colour share it, cells of different colours do not, so functions are continuous inside each colour and jump
between them. Everything else (forms, boundary conditions, matrices) is standard.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI

from thinlayer.compiling.compat import index_map, interior_facet_entities, space_with_dofmap
from thinlayer.errors import ModelError
from thinlayer.parallel.exchange import ask

Colours = npt.NDArray[np.int32]
NO_FACETS = np.empty(0, np.int32)


def broken_space(
    comm: MPI.Intracomm, mesh: Mesh, element: Any, colours: Colours, bonded: npt.NDArray[np.int32] = NO_FACETS
) -> fem.FunctionSpace:
    """Space of an element, continuous inside each colour, discontinuous between colours. Collective.

    Args:
        comm: the domain's communicator.
        mesh: the mesh, with ghost cells across shared facets.
        element: a basix.ufl element.
        colours: colour >= 0 of each local cell, ghosts included.
        bonded: local facets between two colours where functions do not jump; functions are continuous at their edges too.
    """
    rank = comm.rank
    whole = fem.functionspace(mesh, element)
    base_map, base_dofs = whole.dofmap.index_map, np.asarray(whole.dofmap.list, np.int64)
    n_colours = comm.allreduce(int(colours.max(initial=0)) + 1, op=max)

    joined = np.zeros(base_map.size_local + base_map.num_ghosts, bool)
    joined[fem.locate_dofs_topological(whole, mesh.topology.dim - 1, bonded)] = True
    colour_there = np.where(joined[base_dofs], 0, colours[: len(base_dofs), None])
    keys, local_key = np.unique(base_dofs * n_colours + colour_there, return_inverse=True)
    local_key = local_key.reshape(base_dofs.shape)
    base, colour = np.divmod(keys, n_colours)
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_local
    used = np.zeros(len(keys), np.int64)
    used[local_key[:n_cells].ravel()] = 1

    n_base = base_map.size_local + base_map.num_ghosts
    base_owner = np.concatenate([np.full(base_map.size_local, rank), base_map.owners]).astype(np.int64)[:n_base]
    global_base = np.asarray(base_map.local_to_global(np.arange(n_base, dtype=np.int32)))
    global_key = global_base[base] * n_colours + colour

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


def interface_measure(
    comm: MPI.Intracomm, mesh: Mesh, facets: npt.NDArray[np.int32], colours: Colours, tag: int = 1
) -> tuple[ufl.Measure, npt.NDArray[np.int32]]:
    """dS over facets between two colours, with "+" the higher colour on each of them. Collective.

    Args:
        comm: the domain's communicator.
        mesh: the mesh.
        facets: local facets of the interface (ghosts allowed, each is integrated once).
        colours: colour of each local cell.
        tag: the measure is dS(tag).

    Returns:
        The measure, and (n, 4) the facets' (upper cell, local facet, lower cell, local facet).
    """
    topology = mesh.topology
    topology.create_connectivity(topology.dim - 1, topology.dim)
    topology.create_connectivity(topology.dim, topology.dim - 1)
    owned = facets[facets < topology.index_map(topology.dim - 1).size_local]
    entities = interior_facet_entities(mesh, np.sort(owned))
    equal = (colours[entities[:, 0]] == colours[entities[:, 2]]).sum() if len(entities) else 0
    lost, equal = comm.allreduce(np.array([len(owned) - len(entities), equal]))
    if lost or equal:
        raise ModelError(f"interface: {lost} facets with one local cell, {equal} facets between cells of equal colour")
    swap = colours[entities[:, 0]] < colours[entities[:, 2]]
    entities[swap] = entities[swap][:, [2, 3, 0, 1]]
    return ufl.Measure("dS", domain=mesh, subdomain_data=[(tag, entities.ravel())])(tag), entities
