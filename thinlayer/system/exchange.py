"""Messages between ranks: communicators for meshes of other owners, questions, and values that travel."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI
from petsc4py import PETSc

Array = npt.NDArray[Any]
SAME = (MPI.IDENT, MPI.CONGRUENT)
_COPIES: WeakKeyDictionary[Mesh, MPI.Intracomm] = WeakKeyDictionary()


def communicator(mesh: Mesh) -> MPI.Intracomm:
    """A communicator of the ranks of a mesh, which outlives it: this rank's, the world, else a copy. Collective.

    The mesh's own communicator cannot be used: if it ever served a pickled collective, mpi4py 4.0 waits for itself when
    Python's garbage collector frees the mesh amid another one.
    """
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        if MPI.Comm.Compare(mesh.comm, comm) in SAME:
            return comm
    if mesh not in _COPIES:
        _COPIES[mesh] = mesh.comm.Dup()
    return _COPIES[mesh]


def collect(comms: Iterable[MPI.Intracomm]) -> None:
    """Free PETSc objects that Python has dropped: objects of several ranks need a collective call."""
    for comm in comms:
        if comm.size > 1:
            PETSc.garbage_cleanup(comm)


def send(comm: MPI.Intracomm, rank: Array, rows: Array) -> Array:
    """Send row k to rank[k]; returns the rows received, by the rank they came from. Collective."""
    return np.concatenate(comm.alltoall([rows[rank == r] for r in range(comm.size)]))


def ask(comm: MPI.Intracomm, rank: Array, questions: Array, answer: Callable[[Array, Array], Array]) -> Array:
    """Send question k to rank[k] and return the answers in the same order. Collective.

    Args:
        comm: communicator.
        rank: (n,) rank that knows the answer.
        questions: (n, ...) rows to send.
        answer: called once on each rank with all rows received and the rank each came from; one answer per row.
    """
    order = [np.flatnonzero(rank == r) for r in range(comm.size)]
    received = comm.alltoall([questions[rows] for rows in order])
    source = np.repeat(np.arange(comm.size), [len(rows) for rows in received])
    answers = answer(np.concatenate(received), source)
    edges = np.cumsum([len(rows) for rows in received])[:-1]
    returned = comm.alltoall(np.split(answers, edges))
    back = np.concatenate(returned)
    out = np.empty_like(back)
    out[np.concatenate(order)] = back
    return out


def carry(comm: MPI.Intracomm, cells: Array, values: Array, wanted: Array) -> Array:
    """Send values of cells, known by their original numbers, to the ranks that want them. Collective.

    Args:
        comm: communicator.
        cells: (n,) original numbers of the cells whose values this rank holds.
        values: (n, k) their values.
        wanted: (m,) original numbers of the cells whose values this rank wants.

    Returns:
        (m, k) values; NaN for cells that no rank holds.
    """
    highest = comm.allreduce(int(max(cells.max(initial=-1), wanted.max(initial=-1))), MPI.MAX) + 1

    def meeting_rank(c: Array) -> Array:
        return c * comm.size // max(highest, 1)

    rows = send(comm, meeting_rank(cells), np.column_stack([cells.astype(float), values]))
    rows = rows[np.argsort(rows[:, 0])]
    known = rows[:, 0].astype(np.int64)

    def tell(asked: Array, _: Array) -> Array:
        out = np.full((len(asked), rows.shape[1] - 1), np.nan)
        if len(known):
            at = np.minimum(np.searchsorted(known, asked), len(known) - 1)
            out[known[at] == asked] = rows[at[known[at] == asked], 1:]
        return out

    return ask(comm, meeting_rank(wanted), wanted, tell)
