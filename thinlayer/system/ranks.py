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
EQUAL_COMMUNICATORS = (MPI.IDENT, MPI.CONGRUENT)
_COPIED_COMMS: list[MPI.Intracomm] = []
# function spaces on several ranks, and their index maps, which keep the communicators alive
_SPACES_OF_RANKS: list[tuple[ref[FunctionSpace], IndexMap]] = []
GRACE_SECONDS = 5.0  # s that a rank with an error waits for errors of all other ranks, before it ends them
EXIT_STATUS = 1  # exit status if one rank alone has an error, as for any Python script; the command line sets another
POLL_SECONDS = 1e-3  # s between two tests of a request
MAX_CHARACTERS = 200  # number of characters shown where data differ
MIN_WAIT_SECONDS = 60.0  # s that a rank with an error waits for the others at least
_NESTED_BLOCKS: Counter[int] = Counter()  # communicator -> number of nested blocks that this rank is in


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
    problem: Exception | None = None
    _NESTED_BLOCKS[key] += 1
    try:
        try:
            yield
        except Exception as error:
            problem = error
        if comm.size > 1:
            texts = _error_texts(comm, _NESTED_BLOCKS[key], problem, max(MIN_WAIT_SECONDS, time.monotonic() - began))
            wrong = [rank for rank, text in enumerate(texts) if text is not None]
            if wrong and len(wrong) < comm.size:
                raise _raised_on_all(InputError(f"rank {wrong[0]}: {texts[wrong[0]]}")) from problem
        if problem is not None:
            raise _raised_on_all(problem)
    finally:
        _NESTED_BLOCKS[key] -= 1
        problem = None  # its traceback refers to this frame


def _error_texts(comm: MPI.Intracomm, depth: int, problem: Exception | None, patience: float) -> list[str | None]:
    """Wait until all ranks are at the end of the same `errors_on_all` block; return each rank's error as a text.

    The text is None for a rank without an error. Ranks that are still in a block nested within this one receive the
    errors there. They then leave it with an error, and so reach the end of this block.

    Args:
        comm: communicator of the ranks.
        depth: number of nested blocks that this rank is in.
        problem: error of this rank; None: no error.
        patience: longest time, s, for which this rank waits if it has an error. After it all ranks are ended.
    """
    kind = "" if isinstance(problem, ValueError) else f"{type(problem).__name__}: "
    text = None if problem is None else f"{kind}{problem}"
    while True:
        here = comm.Ibarrier()
        if problem is None:
            here.Wait()
        elif not is_done(here, patience):
            problem.add_note(
                f"Rank {comm.rank} has had this error for {patience:.0f} s. The others have not come to where they would "
                "learn of it: they may wait for this rank in a collective call. All ranks are ended."
            )
            abort(problem)
        reports = comm.allgather((depth, text))
        if max(theirs for theirs, _ in reports) == depth:
            return [theirs for _, theirs in reports]


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
        texts = {name: json.dumps(describe(value), sort_keys=True) for name, value in data.items()}
        texts = {name: re.sub(rf"{PROCESS_LABEL} \(\d+\)", "", text) for name, text in texts.items()}
    digests = comm.allgather({name: digest(text) for name, text in texts.items()})
    for name, rank in product(texts, range(comm.size)):
        if digests[rank][name] != digests[0][name]:
            full = [json.loads(text) for text in comm.allgather(texts[name])]
            same = (), full[0], full[rank]  # True and 1.0 are equal
            path, *both = next(differences(full[0], full[rank]), same)
            here, there = ("nothing" if obj is MISSING_VALUE else json.dumps(obj)[:MAX_CHARACTERS] for obj in both)
            values = f"{'.'.join(path)}{' is ' if path else ''}{here} on rank 0, {there} on rank {rank}"
            raise _raised_on_all(InputError(f"the ranks have different {name}: {values}; give all ranks the same"))
    return digest(digests[0])


def _raised_on_all(error: Exception) -> Exception:
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
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD, *_COPIED_COMMS):
        if MPI.Comm.Compare(mesh.comm, comm) in EQUAL_COMMUNICATORS:
            return comm
    _COPIED_COMMS.append(mesh.comm.Dup())
    return _COPIED_COMMS[-1]


def collect(comm: MPI.Intracomm, used: FunctionSpace | None = None) -> None:
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
        _SPACES_OF_RANKS.append((ref(used), used.dofmap.index_map))
    ours = [entry for entry in _SPACES_OF_RANKS if MPI.Comm.Compare(entry[1].comm, comm) in EQUAL_COMMUNICATORS]
    alive = np.any(comm.allgather([space() is not None for space, _ in ours]), axis=0)
    for each in (comm, MPI.COMM_WORLD, *_COPIED_COMMS, *(imap.comm for _, imap in ours)):
        if MPI.Comm.Compare(each, comm) in EQUAL_COMMUNICATORS:
            PETSc.garbage_cleanup(each)
    for k in np.flatnonzero(~alive):
        _SPACES_OF_RANKS.remove(ours[k])


class Destroyable(Protocol):
    """Any object with a method `destroy`: a PETSc object, or one that owns PETSc objects."""

    def destroy(self) -> object: ...  # noqa: D102


def destroy(*things: Destroyable | None) -> None:
    """Call the method `destroy` of each of `things`, PETSc objects or owners of such; None is skipped."""
    for thing in things:
        if thing is not None:
            thing.destroy()


def send(comm: MPI.Intracomm, rank: Array, rows: Array) -> Array:
    """Send rows of an array to other ranks, and return the rows that this rank receives. Collective.

    Args:
        comm: communicator.
        rank: (n,) number of the rank to which each row is sent.
        rows: (n, ...) rows of this rank.

    Returns:
        (m, ...) the received rows, those from rank 0 first, then those from rank 1, and so on.
    """
    return np.concatenate(comm.alltoall([rows[rank == r] for r in range(comm.size)]))


def ask(comm: MPI.Intracomm, rank: Array, questions: Array, answer: Callable[[Array, Array], Array]) -> Array:
    """Send each row of numbers to a rank that answers it, and return the answers in the order of the rows. Collective.

    Args:
        comm: communicator.
        rank: (n,) number of the rank that answers each row.
        questions: (n, ...) rows of numbers to send.
        answer: function that is called once on each rank. Its arguments are all rows that the rank receives, and the
            number of the rank from which each came. It returns an array with one row of answers for each.

    Returns:
        (n, ...) for each row of `questions` its row of answers.
    """
    order = [np.flatnonzero(rank == r) for r in range(comm.size)]
    received = comm.alltoall([questions[rows] for rows in order])
    sizes = [len(rows) for rows in received]
    answers = answer(np.concatenate(received), np.repeat(np.arange(comm.size), sizes))
    back = np.concatenate(comm.alltoall(np.split(answers, np.cumsum(sizes)[:-1])))
    out = np.empty_like(back)
    out[np.concatenate(order)] = back
    return out


def carry_cell_values(comm: MPI.Intracomm, cells: Array, values: Callable[[Array], Array], wanted: Array) -> Array:
    """Send values of cells from the ranks that have them to the ranks that need them. Collective.

    Cells have the numbers of the joint, which are the same on all ranks.

    Args:
        comm: communicator.
        cells: (n,) numbers of the cells whose values this rank has.
        values: function that takes positions (i,) in `cells`, and returns the values (i, k) of the cells there.
        wanted: (m,) numbers of the cells whose values this rank needs.

    Returns:
        (m, k) values of the cells in `wanted`; NaN for cells whose values no rank has.
    """
    highest = comm.allreduce(int(max(cells.max(initial=-1), wanted.max(initial=-1))), MPI.MAX) + 1

    def meeting_rank(c: Array) -> Array:
        return c * comm.size // max(highest, 1)

    here = np.column_stack([cells, np.full(len(cells), comm.rank), np.arange(len(cells))])
    rows = send(comm, meeting_rank(cells), here)
    rows = rows[np.argsort(rows[:, 0], kind="stable")]

    def find_holders(questions: Array, _: Array) -> Array:
        """Return which rank has the values of each cell, and at what position in its array `cells`.

        Args:
            questions: (m,) numbers of cells.
            _: ranks that ask; not used.

        Returns:
            (m, 2) rank and position; -1 for cells whose values no rank has.
        """
        out = np.full((len(questions), 2), -1)
        if len(rows):
            at = np.minimum(np.searchsorted(rows[:, 0], questions), len(rows) - 1)
            matches = rows[at, 0] == questions
            out[matches] = rows[at[matches], 1:]
        return out

    holder, at = ask(comm, meeting_rank(wanted), wanted, find_holders).T
    received = ask(comm, holder[holder >= 0], at[holder >= 0], lambda places, _: values(places))
    out = np.full((len(wanted), received.shape[1]), np.nan)
    out[holder >= 0] = received
    return out


# ---------------------------------------------------------------- the end
def abort(error: BaseException) -> None:
    """Print `error` with its traceback, and end the processes of all ranks."""
    traceback.print_exception(error)
    _end(EXIT_STATUS)


def is_done(request: MPI.Request, within: float) -> bool:
    """Wait for an MPI request, at most `within` seconds, and return whether it has completed."""
    end = time.monotonic() + within
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(POLL_SECONDS)
    return True


def _end(status: int) -> None:
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    MPI.COMM_WORLD.Abort(status)


def _end_before_petsc() -> None:
    """Make `python3 -m mpi4py` abort all ranks as soon as a script ends with an error on only one of them.

    mpi4py itself aborts only after Python has freed the script's PETSc objects and PETSc has ended. Both are
    collective, so that the rank with the error would wait for the others.
    """
    note = MPI._set_abort_status

    def note_and_end(status: int) -> None:
        note(status)
        if status and not is_done(MPI.COMM_WORLD.Ibarrier(), GRACE_SECONDS):
            error = sys.exception()
            if not isinstance(error, SystemExit):
                traceback.print_exception(error)
            _end(status)

    MPI._set_abort_status = note_and_end


if MPI.COMM_WORLD.size > 1:
    _end_before_petsc()
