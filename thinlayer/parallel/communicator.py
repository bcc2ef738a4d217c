"""The communicator for our own messages on a mesh that somebody else made."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from dolfinx.mesh import Mesh
from mpi4py import MPI

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
