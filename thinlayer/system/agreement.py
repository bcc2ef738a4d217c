"""Agreement of ranks: the same data on all of them, and errors on some raised on all."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI

from geometry.parallel import world
from thinlayer.errors import ModelError
from thinlayer.system.abort import abort, is_done
from thinlayer.system.identity import ALONE, MISSING, described, differences, digest

SHOWN = 200  # number of characters shown where data differ
PATIENCE = 60.0  # s that a rank with an error waits for the others at least
_DEPTH: Counter[int] = Counter()  # communicator -> number of nested blocks that this rank is in


@contextmanager
def on_all(comm: MPI.Intracomm | None) -> Iterator[None]:
    """Context for code that each rank runs by itself, also users' code: an error on one rank is raised on all. Collective.

    The code may make collective calls. If an error keeps a rank from a call that the others wait in, they never reach the
    end of the block: the rank waits for PATIENCE, or for the time it has been in the block if that is longer, and then ends
    all ranks.

    Raises:
        ModelError: on some ranks an error occurred; it names the first of them. If all have one, each raises its own.
    """
    comm = comm or world()
    key, began = comm.py2f(), time.monotonic()
    problem: Exception | None = None
    _DEPTH[key] += 1
    try:
        try:
            yield
        except Exception as error:
            problem = error
        if comm.size > 1:
            texts = _texts(comm, _DEPTH[key], problem, max(PATIENCE, time.monotonic() - began))
            wrong = [rank for rank, text in enumerate(texts) if text is not None]
            if wrong and len(wrong) < comm.size:
                raise _for_all(ModelError(f"rank {wrong[0]}: {texts[wrong[0]]}")) from problem
        if problem is not None:
            raise _for_all(problem)
    finally:
        _DEPTH[key] -= 1


def _texts(comm: MPI.Intracomm, depth: int, problem: Exception | None, patience: float) -> list[str | None]:
    """Every rank's error, once all ranks have reached the end of the same block.

    Ranks in an inner block receive the errors there, and reach this block with errors of their own.
    """
    text = None if problem is None else _text(problem)
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
        found = comm.allgather((depth, text))
        if max(theirs for theirs, _ in found) == depth:
            return [theirs for _, theirs in found]


def require_same(comm: MPI.Intracomm | None, **given: Any) -> str:
    """Hash of data that all ranks were given; raises ModelError, on all ranks, if they differ. Collective.

    Args:
        comm: communicator (default: the world).
        given: name -> value, see `thinlayer.system.identity.described`; the same names on all ranks.
            What only one process knows, such as a function on a mesh, counts by its class.
    """
    comm = comm or world()
    if comm.size == 1:
        return ""
    with on_all(comm):
        texts = {name: _known_by_all(value) for name, value in given.items()}
    found = comm.allgather({name: digest(text) for name, text in texts.items()})
    for name, first in found[0].items():
        for rank, theirs in enumerate(found):
            if theirs[name] != first:
                full = [json.loads(text) for text in comm.allgather(texts[name])]
                path, *both = next(
                    differences(full[0], full[rank]), ((), full[0], full[rank])
                )  # True and 1.0 are equal
                here, there = ("nothing" if one is MISSING else json.dumps(one)[:SHOWN] for one in both)
                at = f"{'.'.join(path)} is " if path else ""
                what = f"the ranks were given different {name}: {at}{here} on rank 0, {there} on rank {rank}"
                raise _for_all(ModelError(f"{what}; give all ranks the same"))
    return digest(found[0])


def _known_by_all(value: Any) -> str:
    return re.sub(rf"{ALONE} \(\d+\)", "", json.dumps(described(value), sort_keys=True))


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"


def _for_all(error: Exception) -> Exception:
    """The error, marked as raised on all ranks."""
    error.on_all_ranks = True  # type: ignore[attr-defined]
    return error
