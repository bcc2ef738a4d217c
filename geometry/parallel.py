"""The default MPI communicator, and functions that rank 0 runs for all ranks."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import accumulate
from mmap import PROT_READ, PROT_WRITE, mmap
from typing import TypeVar, cast

from mpi4py import MPI

from forms.base import require

ResultType = TypeVar("ResultType")
Comm = MPI.Intracomm | None  # a communicator; None: the default
SHARED_MEMORY_BYTES = 100_000  # size from which an array of a result is stored once per machine, bytes
MAX_MESSAGE_BYTES = 2**30  # largest message, bytes: counts of MPI may be limited to 2**31
ALIGNMENT_BYTES = 64  # alignment of shared arrays, bytes
_DEFAULT_COMM: ContextVar[MPI.Intracomm] = ContextVar("_DEFAULT_COMM", default=MPI.COMM_WORLD)


def default_comm() -> MPI.Intracomm:
    """Return the communicator of calls in which the user gives none: MPI.COMM_WORLD, or the one set by `use_comm`."""
    return _DEFAULT_COMM.get()


@contextmanager
def use_comm(comm: MPI.Intracomm) -> Iterator[None]:
    """Make `comm` the default communicator within a `with` block, so that groups of ranks can work side by side."""
    token = _DEFAULT_COMM.set(comm)
    try:
        yield
    finally:
        _DEFAULT_COMM.reset(token)


def on_root(comm: Comm, build: Callable[[], ResultType]) -> ResultType:
    """Run a function on rank 0 only; return its result, or raise its exception, on every rank. Collective.

    Several ranks of one machine share the large arrays of the result in memory, which are then read-only. An exception
    gets the attribute `on_all_ranks` = True, by which callers know that every rank raises it.

    Args:
        comm: communicator of the ranks; None: the default communicator.
        build: the function, without arguments; its result must be picklable if there are several ranks.
    """
    comm = default_comm() if comm is None else comm
    require(isinstance(comm, MPI.Comm), "comm", comm, "it must be an MPI communicator")
    result: ResultType | Exception | None = None
    if comm.rank == 0:
        try:
            result = build()
        except Exception as error:
            result = error
    received = result
    if comm.size > 1:
        received = _broadcast(comm, _picklable(result) if isinstance(result, Exception) else result)
    if isinstance(received, Exception):
        failure = result if isinstance(result, Exception) else received
        vars(failure)["on_all_ranks"] = True
        raise failure
    return cast(ResultType, received)


def _broadcast(comm: MPI.Intracomm, result: ResultType) -> ResultType:
    """Return the `result` of rank 0 on every rank; ranks of one machine share its large arrays. Collective."""
    large_buffers: list[memoryview] = []

    def store_large(buffer: pickle.PickleBuffer) -> bool:
        raw = buffer.raw()
        if raw.nbytes >= SHARED_MEMORY_BYTES:
            large_buffers.append(raw)
        return raw.nbytes < SHARED_MEMORY_BYTES

    pickled = pickle.dumps(result, 5, buffer_callback=store_large) if comm.rank == 0 else b""
    pickled, sizes = comm.bcast((pickled, [raw.nbytes for raw in large_buffers]))
    received: ResultType = pickle.loads(pickled, buffers=_shared_copies(comm, large_buffers, sizes) if sizes else ())
    return received


def _shared_copies(comm: MPI.Intracomm, sources: list[memoryview], sizes: list[int]) -> list[memoryview]:
    """Return on every rank read-only copies of buffers of rank 0, which the ranks of one machine share. Collective.

    Memory is freed when the last view of it is deleted. If a machine does not let ranks share memory, each rank has its
    own copies.

    Args:
        comm: communicator of the ranks.
        sources: the buffers, on rank 0; other ranks do not use this argument.
        sizes: sizes of the buffers in bytes, on every rank.
    """
    *starts, total = accumulate((size + -size % ALIGNMENT_BYTES for size in sizes), initial=0)
    host, memory_file = comm.Split_type(MPI.COMM_TYPE_SHARED), os.memfd_create("thinlayer")
    path, inode = host.bcast((f"/proc/{os.getpid()}/fd/{memory_file}", os.fstat(memory_file).st_ino))
    can_read = os.access(path, os.R_OK) and os.stat(path).st_ino == inode
    is_owner = not comm.allreduce(can_read, MPI.LAND) or host.rank == 0  # if a machine hides it, each rank has its own
    if is_owner:
        os.ftruncate(memory_file, total)
    host.Barrier()
    descriptor = memory_file if is_owner else os.open(path, os.O_RDONLY)
    memory = memoryview(mmap(descriptor, total, prot=PROT_READ | (PROT_WRITE if is_owner else 0)))
    buffers = [memory[start : start + size] for start, size in zip(starts, sizes, strict=True)]
    owner_comm = comm.Split(int(not is_owner), comm.rank)
    for k, buffer in enumerate(buffers if is_owner else ()):
        if comm.rank == 0:
            buffer[:] = sources[k]
        for begin in range(0, len(buffer), MAX_MESSAGE_BYTES):
            owner_comm.Bcast(buffer[begin : begin + MAX_MESSAGE_BYTES])
    host.Barrier()
    for descriptor_ in {memory_file, descriptor}:
        os.close(descriptor_)
    for subcomm in (host, owner_comm):
        subcomm.Free()
    return [buffer.toreadonly() for buffer in buffers]


def _picklable(error: Exception) -> Exception:
    """Return the error, or a RuntimeError with its message if pickle cannot restore it on other ranks."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__} on rank 0: {error}")
    return error
