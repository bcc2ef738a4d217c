"""Communicators: for our own messages on a mesh that somebody else made, and of what is to be freed."""

from __future__ import annotations

from collections.abc import Iterable
from weakref import WeakKeyDictionary

from dolfinx.mesh import Mesh
from mpi4py import MPI
from petsc4py import PETSc

SAME = (MPI.IDENT, MPI.CONGRUENT)
_COPIES: WeakKeyDictionary[Mesh, MPI.Intracomm] = WeakKeyDictionary()


def communicator(mesh: Mesh) -> MPI.Intracomm:
    """A communicator of the ranks of a mesh, which outlives it: this rank's, the world, else a copy. Collective.

    The mesh's own will not do: when Python's garbage collector frees a mesh amid a pickled collective, mpi4py 4.0 waits for
    itself if the mesh's communicator was ever used for one.
    """
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        if MPI.Comm.Compare(mesh.comm, comm) in SAME:
            return comm
    if mesh not in _COPIES:
        _COPIES[mesh] = mesh.comm.Dup()
    return _COPIES[mesh]


def collect(comms: Iterable[MPI.Intracomm]) -> None:
    """Free what Python has dropped: PETSc keeps the objects of several ranks until all ranks are asked together."""
    for comm in comms:
        if comm.size > 1:
            PETSc.garbage_cleanup(comm)
