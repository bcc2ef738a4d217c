"""Ranks that are told the same, and errors that only some of them have."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI

from thinlayer.identity import MISSING, described, differences, digest, in_full
from thinlayer.loads import ModelError

SHOWN = 60  # characters from where data differ
LONG = 4000  # characters of data that are compared as a whole; of longer ones a digest is


@contextmanager
def on_all(comm: MPI.Intracomm | None) -> Iterator[None]:
    """What each rank checks by itself, without a collective call: an error of one rank is an error of all. Collective.

    Raises:
        ModelError: not all ranks have an error; it names the first that has. Else each rank's own error.
    """
    problem: Exception | None = None
    try:
        yield
    except Exception as error:
        problem = error
    comm = comm or MPI.COMM_WORLD
    if comm.size > 1:
        texts = comm.allgather(None if problem is None else _text(problem))
        wrong = [rank for rank, text in enumerate(texts) if text is not None]
        if wrong and len(wrong) < comm.size:
            raise _for_all(ModelError(f"rank {wrong[0]}: {texts[wrong[0]]}")) from problem
    if problem is not None:
        raise _for_all(problem)


def require_same(comm: MPI.Intracomm | None, **given: Any) -> str:
    """What stands for data that all ranks were given; raises ModelError, on all ranks, where they differ. Collective.

    Args:
        comm: communicator (default: the world).
        given: name -> value, see `thinlayer.identity.described`; the same names on all ranks.
    """
    comm = comm or MPI.COMM_WORLD
    if comm.size == 1:
        return ""
    with on_all(comm):
        texts = {name: json.dumps(described(value), sort_keys=True) for name, value in given.items()}
    mine = {name: text if len(text) <= LONG else f"data {digest(text)}" for name, text in texts.items()}
    found = comm.allgather(mine)
    for name, first in found[0].items():
        for rank, theirs in enumerate(found):
            if theirs[name] != first:
                at, here, there = _differing(comm, rank, given[name], first, theirs[name])
                what = f"the ranks were given different {name}: {at}{here} on rank 0, {there} on rank {rank}"
                raise _for_all(ModelError(f"{what}; give all ranks the same"))
    return digest(mine)


def _differing(comm: MPI.Intracomm, rank: int, value: Any, first: str, theirs: str) -> tuple[str, str, str]:
    """Where the values of rank 0 and of another rank differ, and what either has there. Collective."""
    full = comm.allgather(in_full(value))
    for path, *both in differences(full[0], full[rank]):
        texts = ["nothing" if one is MISSING else json.dumps(one) for one in both]
        return (f"{'.'.join(path)} is " if path else "", *_from_where_they_differ(*texts))
    return ("", *_from_where_they_differ(first, theirs))


def _from_where_they_differ(one: str, other: str) -> tuple[str, str]:
    """The parts of two texts from a little before they differ."""
    shorter = min(len(one), len(other))
    alike = next((k for k in range(shorter) if one[k] != other[k]), shorter)
    start = max(alike - SHOWN // 2, 0)
    end = start + SHOWN
    here, there = ("... " * (start > 0) + text[start:end] + " ..." * (end < len(text)) for text in (one, other))
    return here, there


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"


def _for_all(error: Exception) -> Exception:
    """An error that no rank is left waiting for."""
    error.on_all_ranks = True  # type: ignore[attr-defined]
    return error
