"""Record: the folder of a study's run, with tables, pictures, and a description of its input."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from mpi4py import MPI

from geometry.parallel import on_root
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError, SolveError
from thinlayer.files.say import say
from thinlayer.files.table import Table, hash_of
from thinlayer.output.sweep import sweep
from thinlayer.parallel.log import logger
from thinlayer.running.check import Check
from thinlayer.running.provenance import code, petsc_options, versions
from thinlayer.running.run_folder import MARCHES, RUN, RunFolder
from thinlayer.solving.options import PREFIX
from thinlayer.time.history import History
from thinlayer.time.marching import march
from thinlayer.time.plan import Adaptive

LOG = logger("study")


class Record:
    """Results of a study's run: tables, pictures, checks; `run.json` describes their input.

    Used in a `with` statement it owns its folder: another run is refused as long as it lasts, and the files of an earlier
    run are in previous-1, previous-2, ... from the start; nothing is left if the study stops before it writes anything.
    Only rank 0 writes.

    Attributes:
        study: name of the study.
        out: the folder.
        options: options chosen by the user.
        resume: whether to continue an earlier run of the study with the same options.
        checks: the checks so far.
        parameters, results: what the study was made from, and numbers that it found besides its tables; for run.json.
    """

    def __init__(self, study: str, out: str | Path, options: Mapping[str, Any], *, resume: bool = False) -> None:
        self.study, self.out, self.options, self.resume = study, Path(out), dict(options), resume
        self.parameters: dict[str, Any] = {}
        self.results: dict[str, Any] = {}
        self.checks: list[Check] = []
        self.solves: list[dict[str, Any]] = []
        self._begun = self._noted = False
        self._folder = RunFolder(self.out)
        self._start = time.perf_counter()
        self.root = MPI.COMM_WORLD.rank == 0

    def __enter__(self) -> Self:
        """Take the folder; errors as in `RunFolder.take`. Collective."""
        on_root(MPI.COMM_WORLD, lambda: self._folder.take(self._problem if self.resume else None))
        return self

    def __exit__(self, *_: object) -> None:
        """Give the folder back; on each rank by itself."""
        self._folder.free()

    def withdraw(self) -> None:
        """Leave nothing behind if no more than run.json has been written; not collective."""
        if self.root:
            self._folder.withdraw()

    def identity(self) -> list[Any]:
        """Identity of the run, independent of its folder."""
        return [self.study, json.loads(json.dumps(self.options, default=str))]

    def path(self, name: str) -> Path:
        """Path of a file in the folder (whoever writes it makes the folder); from now on it is one of the run's files."""
        if name not in self._folder.files and name != RUN:
            self._folder.files.add(name)
            if self._folder.taken and self.root:  # a run that is killed leaves the names of what it had begun
                self.stop("not finished")
        return self.out / name

    def table(self, name: str) -> Table:
        """A table of the folder to add rows to: each is on the disk before the next one is computed. Collective."""
        return Table(path=self.path(name))

    def write(self, name: str, table: Table) -> None:
        """Write a table as csv. Collective."""
        table.write(self.path(name))

    def has(self, name: str) -> bool:
        """Whether the run has left a file. Collective."""
        return on_root(MPI.COMM_WORLD, (self.out / name).exists)

    def load(self, name: str) -> Table:
        """A table of the folder. Collective."""
        return Table.load(self.path(name))

    def say(self, text: object) -> None:
        """Print on rank 0."""
        if self.root:
            say(text)

    def check_drawn(self) -> None:
        """Raise ModelError if the tables in the folder are not those of a run of the study. Collective."""

        def check() -> None:
            run = self._folder.told()
            if run["study"] != self.study:
                raise ModelError(f"the run in {self.out} is of the study {run['study']}, not {self.study}")
            for name, found in dict(run.get("tables", {})).items():
                if hash_of(self.out / name) not in (None, found):
                    raise ModelError(f"{self.out / name} is not the table that the run in {self.out} wrote")

        on_root(MPI.COMM_WORLD, check)

    def _problem(self) -> str | None:
        """Reason why the run in the folder cannot be resumed; None if it can."""
        run = self._folder.told("--resume: ")
        if run["study"] != self.study:
            return f"--resume: the run in {self.out} is of the study {run['study']}, not {self.study}"
        if run["options"] != self.identity()[1]:
            return f"--resume: the run in {self.out} had the options {run['options']}, not {self.options}"
        if run.get("code") != code():
            return f"--resume: the run in {self.out} was made with other source code; run the study anew"
        there = run["petsc"]["options"] if isinstance(run.get("petsc"), dict) else {}
        here = petsc_options()["options"]
        names = [
            name for name in {**there, **here} if name.startswith(f"-{PREFIX}") and there.get(name) != here.get(name)
        ]
        if names:
            return f"--resume: the run in {self.out} had other PETSc options: {', '.join(sorted(names))}"
        return None

    def sweep(self, run: Callable[[float], Mapping[str, Any]], eps: Sequence[float], name: str = "table.csv") -> Table:
        """`thinlayer.sweep` into a table of the folder, resumed if the run is. Collective."""

        def noted(e: float) -> Mapping[str, Any]:
            row = run(e)
            self._begin()
            return row

        self.path(f"{name}.json")
        return sweep(noted, eps, self.path(name), resume=self.resume)

    def march(self, model: Model, times: Sequence[float] | Adaptive, name: str, **choices: Any) -> History:
        """`thinlayer.march` with files to resume from until the run is done; notes its solves. Collective."""
        if not (self._begun or self.resume):  # of a run that was killed
            on_root(MPI.COMM_WORLD, lambda: shutil.rmtree(self.path(MARCHES), ignore_errors=True))
        self._begun = True
        try:
            history = march(model, times, out=self.path(MARCHES) / name, resume=self.resume, **choices)
        except SolveError as error:
            self._noted_states(error.history)
            raise
        self._begin()
        self._noted_states(history)
        return history

    def _noted_states(self, history: History | None) -> None:
        for state in history or ():
            self.solved(state)

    def _begin(self) -> None:
        """Write down the options once there is something to resume."""
        if not self._noted:
            self._noted = True
            self.close("not finished")

    def solved(self, state: State) -> State:
        """Note how a state was found; returns it."""
        layer, report = state.model.thin_layer, state.report
        noted = {"model": repr(state.model), "eps": layer.eps if layer else None, "t": state.t}
        self.solves.append(noted | asdict(report))
        LOG.info("%(model)s, eps = %(eps)s, t = %(t)g: %(method)s, %(iterations)d steps", self.solves[-1])
        return state

    def check(self, name: str, value: float, *, low: float | None = None, high: float | None = None) -> None:
        """Check that a number lies in a range; a failed check makes the run exit with status 1."""
        self.checks.append(Check(name, float(value), low, high))
        LOG.info("check %s", self.checks[-1])

    def check_near(self, name: str, value: float, expected: float, tolerance: float) -> None:
        """Check that a number is the expected one, to a relative tolerance."""
        low, high = sorted((expected * (1 - tolerance), expected * (1 + tolerance)))
        self.check(name, value, low=low, high=high)

    @property
    def failed(self) -> list[Check]:
        """Checks that do not hold."""
        return [check for check in self.checks if not check.passed]

    def close(self, error: str | None = None) -> None:
        """Write run.json. Collective; raises OSError on all ranks."""
        on_root(MPI.COMM_WORLD, lambda: self._write(error))

    def stop(self, error: str) -> None:
        """Write run.json if that can be done; not collective."""
        if self.root:
            with suppress(OSError):
                self._write(error)

    def _write(self, error: str | None) -> None:
        content = {
            "study": self.study,
            "options": self.options,
            "code": code(),
            "petsc": petsc_options(),
            "parameters": self.parameters,
            "ranks": MPI.COMM_WORLD.size,
            "versions": versions(),
            "seconds": round(time.perf_counter() - self._start, 3),
            "results": self.results,
            "checks": [asdict(check) for check in self.checks],
            "solves": self.solves,
            "error": error,
        }
        self._folder.tell(content, done=error is None)
