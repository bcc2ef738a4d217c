"""The ranks that work together, and work that one of them does for all."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar, cast

from mpi4py import MPI

from forms.base import require

T = TypeVar("T")
_WORLD: ContextVar[MPI.Intracomm] = ContextVar("_WORLD", default=MPI.COMM_WORLD)


def world() -> MPI.Intracomm:
    """The communicator of calls that are given none: MPI.COMM_WORLD, or that of `within`."""
    return _WORLD.get()


@contextmanager
def within(comm: MPI.Intracomm) -> Iterator[None]:
    """In this block calls that are given no communicator use this one, so that groups of ranks work side by side."""
    token = _WORLD.set(comm)
    try:
        yield
    finally:
        _WORLD.reset(token)


def on_root(comm: MPI.Intracomm | None, build: Callable[[], T]) -> T:
    """Run a function on rank 0 only; return its result, or raise its exception, on every rank. Collective.

    The exception has an attribute `on_all_ranks`: it shows that no rank is left waiting.
    """
    comm = world() if comm is None else comm
    require(isinstance(comm, MPI.Comm), "comm", comm, "it must be an MPI communicator")
    result: T | Exception | None = None
    if comm.rank == 0:
        try:
            result = build()
        except Exception as error:
            error.on_all_ranks = True  # type: ignore[attr-defined]
            result = error
    received = result
    if comm.size > 1:
        received = comm.bcast(_sendable(result) if isinstance(result, Exception) else result, root=0)
    if isinstance(received, Exception):
        raise result if isinstance(result, Exception) else received
    return cast(T, received)


def _sendable(error: Exception) -> Exception:
    """An error that pickle can send to the other ranks: some exceptions cannot be restored from a pickle."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__} on rank 0: {error}")
        error.on_all_ranks = True  # type: ignore[attr-defined]
    return error
