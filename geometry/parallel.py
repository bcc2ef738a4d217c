"""Work that one rank does for all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from mpi4py import MPI

T = TypeVar("T")


def on_root(comm: MPI.Intracomm | None, build: Callable[[], T]) -> T:
    """Result of a function run on rank 0 only, on every rank; its exception too. Collective."""
    comm = comm or MPI.COMM_WORLD
    result: T | Exception | None = None
    if comm.rank == 0:
        try:
            result = build()
        except Exception as error:
            result = error
    result = comm.bcast(result, root=0)
    if isinstance(result, Exception):
        raise result
    return cast(T, result)
