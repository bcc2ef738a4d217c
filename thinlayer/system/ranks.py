"""MPI ranks: collective checks of data and errors, messages between ranks, and an abort if one rank alone fails.

This module imports neither DOLFINx nor PETSc. It must be imported before them, so that all ranks end if one of them
fails while DOLFINx and PETSc start.
"""

from __future__ import annotations

import json
import re
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING, Any, Protocol
from weakref import ref

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from forms.base import InputError
from geometry.parallel import default_comm
from thinlayer.system.fingerprint import MISSING_VALUE, PROCESS_LABEL, describe, differences, digest

if TYPE_CHECKING:
    from dolfinx.common import IndexMap
    from dolfinx.fem import FunctionSpace
    from dolfinx.mesh import Mesh

Array = npt.NDArray[Any]  # of integers or floats
SAME_RANKS = (MPI.IDENT, MPI.CONGRUENT)
_DUPLICATE_COMMS: list[MPI.Intracomm] = []
# function spaces on several ranks, and their index maps, which keep the communicators alive
_PARALLEL_SPACES: list[tuple[ref[FunctionSpace], IndexMap]] = []
GRACE_SECONDS = 5.0  # s that a rank with an error waits for errors of all other ranks, before it ends them
EXIT_STATUS = 1  # exit status if one rank alone has an error, as for any Python script; the command line sets another
POLL_SECONDS = 1e-3  # s between two tests of a request
MAX_CHARACTERS = 200  # number of characters shown where data differ
MIN_WAIT_SECONDS = 60.0  # s that a rank with an error waits for the others at least
_BLOCK_DEPTHS: Counter[int] = Counter()  # communicator -> number of nested blocks that this rank is in


# ---------------------------------------------------------------- agreement
@contextmanager
def errors_on_all(comm: MPI.Intracomm | None) -> Iterator[None]:
    """Context manager at whose end an error that occurred on one rank is raised on all ranks. Collective.

    The statements in the `with` block may be the user's and may make collective calls. If an error keeps one rank from
    such a call, the other ranks wait in it and never reach the end of the block. The rank with the error therefore
    waits for them, and then ends all ranks. It waits as long as it has spent in the block, and at least 60 s.

    Args:
        comm: communicator of the ranks; None: all ranks, in an `ensemble` those of the group.

    Raises:
        InputError: some ranks have an error; the message names the first of them. If all ranks have an error, each
            raises its own.
    """
    comm = comm or default_comm()
    key, began = comm.py2f(), time.monotonic()
    own_error: Exception | None = None
    _BLOCK_DEPTHS[key] += 1
    try:
        try:
            yield
        except Exception as error:
            own_error = error
        if comm.size > 1:
            texts = _share_errors(comm, _BLOCK_DEPTHS[key], own_error, max(MIN_WAIT_SECONDS, time.monotonic() - began))
            wrong = [rank for rank, text in enumerate(texts) if text is not None]
            if wrong and len(wrong) < comm.size:
                raise _mark_raised_on_all(InputError(f"rank {wrong[0]}: {texts[wrong[0]]}")) from own_error
        if own_error is not None:
            raise _mark_raised_on_all(own_error)
    finally:
        _BLOCK_DEPTHS[key] -= 1
        own_error = None  # its traceback refers to this frame


def _share_errors(comm: MPI.Intracomm, depth: int, own_error: Exception | None, max_wait: float) -> list[str | None]:
    """Wait until all ranks are at the end of the same `errors_on_all` block; return each rank's error as a text.

    The text is None for a rank without an error. Ranks that are still in a block nested within this one receive the
    errors there. They then leave it with an error, and so reach the end of this block.

    Args:
        comm: communicator of the ranks.
        depth: number of nested blocks that this rank is in.
        own_error: error of this rank; None: no error.
        max_wait: longest time, s, for which this rank waits if it has an error. After it all ranks are ended.
    """
    class_text = "" if isinstance(own_error, ValueError) else f"{type(own_error).__name__}: "
    text = None if own_error is None else f"{class_text}{own_error}"
    while True:
        barrier = comm.Ibarrier()
        if own_error is None:
            barrier.Wait()
        elif not completes_within(barrier, max_wait):
            own_error.add_note(
                f"Rank {comm.rank} has had this error for {max_wait:.0f} s. The others have not come to where they would "
                "learn of it: they may wait for this rank in a collective call. All ranks are ended."
            )
            abort(own_error)
        depths_and_texts = comm.allgather((depth, text))
        if max(rank_depth for rank_depth, _ in depths_and_texts) == depth:
            return [rank_text for _, rank_text in depths_and_texts]


def require_same(comm: MPI.Intracomm | None, **data: object) -> str:
    """Check that all ranks have the same data, and return a hash of the data. Collective.

    On a single rank nothing is compared, and the hash is "".

    Args:
        comm: communicator of the ranks; None: all ranks, in an `ensemble` those of the group.
        data: name for errors -> value of any type, with the same names on all ranks. Values are compared by their
            descriptions (`thinlayer.system.fingerprint.describe`). Objects that belong to one process, such as a
            function on a mesh, are compared by class.

    Raises:
        InputError: the data differ; on all ranks.
    """
    comm = comm or default_comm()
    if comm.size == 1:
        return ""
    with errors_on_all(comm):
        descriptions = {name: json.dumps(describe(value), sort_keys=True) for name, value in data.items()}
        descriptions = {name: re.sub(rf"{PROCESS_LABEL} \(\d+\)", "", text) for name, text in descriptions.items()}
    digests = comm.allgather({name: digest(text) for name, text in descriptions.items()})
    for name, rank in product(descriptions, range(comm.size)):
        if digests[rank][name] != digests[0][name]:
            parsed = [json.loads(text) for text in comm.allgather(descriptions[name])]
            whole = (), parsed[0], parsed[rank]  # True and 1.0 are equal
            path, *pair = next(differences(parsed[0], parsed[rank]), whole)
            here, there = ("nothing" if obj is MISSING_VALUE else json.dumps(obj)[:MAX_CHARACTERS] for obj in pair)
            values = f"{'.'.join(path)}{' is ' if path else ''}{here} on rank 0, {there} on rank {rank}"
            raise _mark_raised_on_all(InputError(f"the ranks have different {name}: {values}; give all ranks the same"))
    return digest(digests[0])


def _mark_raised_on_all(error: Exception) -> Exception:
    """Return `error`, marked by an attribute as one that all ranks raise."""
    error.on_all_ranks = True  # type: ignore[attr-defined]
    return error


# ---------------------------------------------------------------- messages
def communicator(mesh: Mesh) -> MPI.Intracomm:
    """Return a communicator with the ranks of `mesh`, which can still be used when the mesh is gone. Collective.

    It is COMM_SELF, COMM_WORLD, or a duplicate of the mesh's communicator. The duplicate is kept for later calls.

    Do not use the mesh's own communicator. If it ever served a pickled collective call, mpi4py 4.0 waits for itself
    when Python's garbage collector frees the mesh during another such call.
    """
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD, *_DUPLICATE_COMMS):
        if MPI.Comm.Compare(mesh.comm, comm) in SAME_RANKS:
            return comm
    _DUPLICATE_COMMS.append(mesh.comm.Dup())
    return _DUPLICATE_COMMS[-1]


def free_petsc_objects(comm: MPI.Intracomm, used: FunctionSpace | None = None) -> None:
    """Free PETSc objects that Python no longer uses. Collective.

    On several ranks, PETSc frees such objects only in a call that all ranks make together.

    Args:
        comm: communicator of the ranks.
        used: function space of a model. This call and later ones also free PETSc objects on the communicator of this
            space, the last time when the space itself is gone. None: only spaces of earlier calls count.
    """
    from petsc4py import PETSc

    if comm.size == 1:
        return
    if used is not None:
        _PARALLEL_SPACES.append((ref(used), used.dofmap.index_map))
    comm_entries = [entry for entry in _PARALLEL_SPACES if MPI.Comm.Compare(entry[1].comm, comm) in SAME_RANKS]
    is_alive = np.any(comm.allgather([space() is not None for space, _ in comm_entries]), axis=0)
    for equal_comm in (comm, MPI.COMM_WORLD, *_DUPLICATE_COMMS, *(imap.comm for _, imap in comm_entries)):
        if MPI.Comm.Compare(equal_comm, comm) in SAME_RANKS:
            PETSc.garbage_cleanup(equal_comm)
    for k in np.flatnonzero(~is_alive):
        _PARALLEL_SPACES.remove(comm_entries[k])


class Destroyable(Protocol):
    """Any object with a method `destroy`: a PETSc object, or one that owns PETSc objects."""

    def destroy(self) -> object: ...  # noqa: D102


def destroy(*things: Destroyable | None) -> None:
    """Call the method `destroy` of each of `things`, PETSc objects or owners of such; None is skipped."""
    for thing in things:
        if thing is not None:
            thing.destroy()


def send(comm: MPI.Intracomm, destinations: Array, rows: Array) -> Array:
    """Send rows of an array to other ranks, and return the rows that this rank receives. Collective.

    Args:
        comm: communicator.
        destinations: (n,) number of the rank to which each row is sent.
        rows: (n, ...) rows of this rank.

    Returns:
        (m, ...) the received rows, those from rank 0 first, then those from rank 1, and so on.
    """
    return np.concatenate(comm.alltoall([rows[destinations == r] for r in range(comm.size)]))


def query(comm: MPI.Intracomm, answerers: Array, queries: Array, answer: Callable[[Array, Array], Array]) -> Array:
    """Send each row of numbers to a rank that answers it, and return the answers in the order of the rows. Collective.

    Args:
        comm: communicator.
        answerers: (n,) number of the rank that answers each row.
        queries: (n, ...) rows of numbers to send.
        answer: function that is called once on each rank. Its arguments are all rows that the rank receives, and the
            number of the rank from which each came. It returns an array with one row of answers for each.

    Returns:
        (n, ...) for each row of `queries` its row of answers.
    """
    rows_by_rank = [np.flatnonzero(answerers == r) for r in range(comm.size)]
    received = comm.alltoall([queries[rows] for rows in rows_by_rank])
    n_received = [len(rows) for rows in received]
    answers = answer(np.concatenate(received), np.repeat(np.arange(comm.size), n_received))
    returned = np.concatenate(comm.alltoall(np.split(answers, np.cumsum(n_received)[:-1])))
    out = np.empty_like(returned)
    out[np.concatenate(rows_by_rank)] = returned
    return out


def carry_cell_values(comm: MPI.Intracomm, cells: Array, values_at: Callable[[Array], Array], wanted: Array) -> Array:
    """Send values of cells from the ranks that have them to the ranks that need them. Collective.

    Cells have the numbers of the joint, which are the same on all ranks.

    Args:
        comm: communicator.
        cells: (n,) numbers of the cells whose values this rank has.
        values_at: function that takes positions (i,) in `cells`, and returns the values (i, k) of the cells there.
        wanted: (m,) numbers of the cells whose values this rank needs.

    Returns:
        (m, k) values of the cells in `wanted`; NaN for cells whose values no rank has.
    """
    n_cells = comm.allreduce(int(max(cells.max(initial=-1), wanted.max(initial=-1))), MPI.MAX) + 1

    def meeting_rank(c: Array) -> Array:
        return c * comm.size // max(n_cells, 1)

    own_entries = np.column_stack([cells, np.full(len(cells), comm.rank), np.arange(len(cells))])
    entries = send(comm, meeting_rank(cells), own_entries)
    entries = entries[np.argsort(entries[:, 0], kind="stable")]

    def find_holders(cells_asked: Array, _: Array) -> Array:
        """Return which rank has the values of each cell, and at what position in its array `cells`.

        Args:
            cells_asked: (m,) numbers of cells.
            _: ranks that ask; not used.

        Returns:
            (m, 2) rank and position; -1 for cells whose values no rank has.
        """
        ranks_and_positions = np.full((len(cells_asked), 2), -1)
        if len(entries):
            entry_rows = np.minimum(np.searchsorted(entries[:, 0], cells_asked), len(entries) - 1)
            is_held = entries[entry_rows, 0] == cells_asked
            ranks_and_positions[is_held] = entries[entry_rows[is_held], 1:]
        return ranks_and_positions

    holders, positions = query(comm, meeting_rank(wanted), wanted, find_holders).T
    received = query(comm, holders[holders >= 0], positions[holders >= 0], lambda at, _: values_at(at))
    out = np.full((len(wanted), received.shape[1]), np.nan)
    out[holders >= 0] = received
    return out


# ---------------------------------------------------------------- the end
def abort(error: BaseException) -> None:
    """Print `error` with its traceback, and end the processes of all ranks."""
    traceback.print_exception(error)
    _abort_all(EXIT_STATUS)


def completes_within(request: MPI.Request, seconds: float) -> bool:
    """Wait for an MPI request, at most `seconds` seconds, and return whether it has completed."""
    deadline = time.monotonic() + seconds
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_SECONDS)
    return True


def _abort_all(status: int) -> None:
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    MPI.COMM_WORLD.Abort(status)


def _install_early_abort() -> None:
    """Make `python3 -m mpi4py` abort all ranks as soon as a script ends with an error on only one of them.

    mpi4py itself aborts only after Python has freed the script's PETSc objects and PETSc has ended. Both are
    collective, so that the rank with the error would wait for the others.
    """
    set_status = MPI._set_abort_status

    def set_status_and_abort(status: int) -> None:
        set_status(status)
        if status and not completes_within(MPI.COMM_WORLD.Ibarrier(), GRACE_SECONDS):
            error = sys.exception()
            if not isinstance(error, SystemExit):
                traceback.print_exception(error)
            _abort_all(status)

    MPI._set_abort_status = set_status_and_abort


if MPI.COMM_WORLD.size > 1:
    _install_early_abort()
