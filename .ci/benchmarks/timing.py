"""Measurements for benchmarks: stages, processor time of works in turn, memory, and rows that compare two works."""

from __future__ import annotations

import ctypes
import gc
import math
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

from geometry.parallel import ResultType
from thinlayer.running.record import Record
from thinlayer.solving.petsc import PREFIX, OptionValue, set_defaults
from thinlayer.system.ranks import destroy
from thinlayer.system.table import Row

# "seconds" of a work; if known, also "peak_mb", "unknowns", "dim", "energy", stages
Measured = Mapping[str, float]
WorkName = TypeVar("WorkName", bound=Hashable)
ENOUGH = 20.0  # s for which short works are repeated in turn: the load of shared cores varies within seconds


def timed(work: Callable[[], ResultType]) -> tuple[float, ResultType]:
    """Return the processor time of some work, s, and its result."""
    gc.collect()
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


class Stages(dict[str, float]):
    """Name of a stage -> its seconds by the clock; each stage begins when the stage before it ends."""

    def __init__(self) -> None:
        super().__init__()
        self._begin = time.perf_counter()

    def end(self, name: str) -> None:
        """End a stage."""
        self[name], self._begin = time.perf_counter() - self._begin, time.perf_counter()

    def measured(self, energy: float, unknowns: int, dim: int) -> dict[str, float]:
        """All stages as one work, with the largest memory of a rank, MB; ranks divide shared pages. Collective."""
        shared = status("VmRSS") - status("Pss:", "smaps_rollup")
        peak_mb = MPI.COMM_WORLD.allreduce(status("VmHWM") - shared, MPI.MAX)
        of_work = {"dim": dim, "unknowns": int(unknowns), "energy": float(energy), "peak_mb": peak_mb}
        return {**of_work, "seconds": sum(self.values()), **self}


def compared(work: str, ours: Measured, reference: str, other: Measured, limit: float = math.inf) -> Row:
    """A row: a work, its reference work, the ratio of times and its limit, the relative difference of energies."""
    error = abs(ours["energy"] / other["energy"] - 1) if {"energy"} <= {*ours} & {*other} else None
    row: Row = {"work": work, **ours, "reference": reference, "limit": limit, "error": error}
    row |= {"reference_seconds": other["seconds"], "reference_peak_mb": other.get("peak_mb")}
    return row | {"ratio": ours["seconds"] / other["seconds"]}


def in_turn(
    works: Mapping[WorkName, Callable[[], ResultType]], repeats: int, key: Callable[[ResultType], float] | None = None
) -> dict[WorkName, ResultType]:
    """Return the least of several results of each work, by a key; works run in turn, so that a busy machine slows all.

    Short works are repeated until `ENOUGH` seconds have passed, unless `repeats` is 1.
    """
    begin, runs = time.perf_counter(), list[list[ResultType]]()
    while len(runs) < repeats or (repeats > 1 and time.perf_counter() - begin < ENOUGH):
        runs.append([work() for work in works.values()])
    return {name: min(results, key=key) for name, results in zip(works, zip(*runs, strict=True), strict=True)}


def timed_in_turn(
    works: Mapping[WorkName, Callable[[], ResultType]], repeats: int
) -> dict[WorkName, tuple[float, ResultType]]:
    """Return the least processor time of each work, s, and its result; works run in turn, see `in_turn`."""
    return in_turn({name: partial(timed, work) for name, work in works.items()}, repeats, itemgetter(0))


def check_ratios(record: Record, rows: Iterable[Row]) -> None:
    """Check the ratio of times in each row of `compared` that has a limit."""
    for row in rows:
        if math.isfinite(limit := float(row["limit"] or math.inf)):
            record.check(f"{row['work']}, {row['unknowns']} unknowns", float(row["ratio"] or math.nan), high=limit)


def peak(work: Callable[[], object]) -> float:
    """Largest additional memory that this process takes during some work, MB; Linux only."""
    ctypes.CDLL(None).malloc_trim(0)  # return freed memory to the system
    before = status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # reset the peak
    work()
    return max(status("VmHWM") - before, 0.0)


def status(name: str, file: str = "status") -> float:
    """A memory size of this process, MB, by its name in a file of /proc/self; NaN if the name is missing."""
    for line in Path("/proc/self", file).read_text(encoding="utf-8").splitlines():
        if line.startswith(name):
            return int(line.split()[1]) / 1024
    return float("nan")


def solve_once(A: PETSc.Mat, b: PETSc.Vec, options: Mapping[str, OptionValue]) -> float:
    """Processor time of a linear solve, ordering or the set-up of a hierarchy included, s; infinite if it fails."""
    x, ksp = b.duplicate(), PETSc.KSP().create(A.comm)

    def work() -> None:
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        ksp.setFromOptions()
        ksp.solve(b, x)

    with set_defaults(options):
        spent, _ = timed(work)
    failed = ksp.getConvergedReason() < 0
    destroy(ksp, x)
    return math.inf if failed else spent
