"""Communicators for our messages on meshes of other owners, and collection of freed PETSc objects."""

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
