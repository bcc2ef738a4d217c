"""Progress of long work: a bar on a terminal, on rank 0 only, gone when the work is done."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TypeVar

from mpi4py import MPI
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")


def track(items: Sequence[T], what: str, label: str = "{}") -> Iterator[T]:
    """The items one after the other, with a bar that names the present one: label.format(item)."""
    if MPI.COMM_WORLD.rank or not sys.stderr.isatty():
        yield from items
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=len(items))
        for item in items:
            bar.update(task, description=f"{what}: {label.format(item)}")
            yield item
            bar.advance(task)
