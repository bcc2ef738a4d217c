"""The record of a study's run: a folder with tables, pictures and a description of the input."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from geometry.parallel import on_root, world
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError, SolveError
from thinlayer.files.say import say
from thinlayer.files.table import Table, hash_of
from thinlayer.output.sweep import sweep
from thinlayer.parallel.log import logger
from thinlayer.running.provenance import code, petsc_options, versions
from thinlayer.running.run_folder import MARCHES, RUN, RunFolder
from thinlayer.solving.options import PREFIX
from thinlayer.time.history import History
from thinlayer.time.marching import march
from thinlayer.time.plan import Adaptive

LOG = logger("study")


@dataclass
class Check:
    """A number that a study promises to lie in a range.

    Attributes:
        name: description of the number.
        value: the number.
        low, high: ends of the range; None: no bound.
        passed: whether the number lies in the range.
    """

    name: str
    value: float
    low: float | None
    high: float | None
    passed: bool = field(init=False)

    def __post_init__(self) -> None:
        above = self.low is None or self.value >= self.low
        below = self.high is None or self.value <= self.high
        self.passed = above and below  # NaN passes neither

    def __str__(self) -> str:
        ends = [
            f">= {self.low:.6g}" if self.low is not None else "",
            f"<= {self.high:.6g}" if self.high is not None else "",
        ]
        return f"{self.name}: {self.value:.6g} ({' and '.join(e for e in ends if e)})"


class Record:
    """The results of a study's run: tables, pictures, checks. The file run.json describes the input they are from.

    In a `with` statement the record owns its folder: other runs there are refused, and the files of an earlier run are
    moved to previous-1, previous-2, ... They come back if the study stops before it writes anything. Only rank 0 writes.

    Attributes:
        study: name of the study.
        out: the folder.
        options: options chosen by the user.
        resume: whether to continue an earlier run of the study with the same options.
        checks: the checks so far.
        parameters: parameters of the study, for run.json.
        results: numbers that the study found besides its tables, for run.json.
        solves: how each state was found, for run.json.
        root: whether this is rank 0.
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
        self.root = world().rank == 0

    def __enter__(self) -> Self:
        """Lock the folder; errors as in `RunFolder.take`. Collective."""
        on_root(world(), lambda: self._folder.take(self._problem if self.resume else None))
        return self

    def __exit__(self, *_: object) -> None:
        """Unlock the folder; not collective."""
        self._folder.free()

    def withdraw(self) -> None:
        """Remove run.json if the run has written nothing else; not collective."""
        if self.root:
            self._folder.withdraw()

    def identity(self) -> list[Any]:
        """Identity of the run, independent of its folder."""
        return [self.study, json.loads(json.dumps(self.options, default=str))]

    def path(self, name: str) -> Path:
        """Path of a file in the folder. From now on it counts as one of the run's files; its writer makes the folder."""
        if name not in self._folder.files and name != RUN:
            self._folder.files.add(name)
            if self._folder.taken and self.root:  # so that run.json names the files even if the run is killed
                self.stop("not finished")
        return self.out / name

    def table(self, name: str) -> Table:
        """A new table in the folder; every row is written to the disk as it is added. Collective."""
        return Table(path=self.path(name))

    def write(self, name: str, table: Table) -> None:
        """Write a table as csv. Collective."""
        table.write(self.path(name))

    def has(self, name: str) -> bool:
        """Whether the folder has a file of this name. Collective."""
        return on_root(world(), (self.out / name).exists)

    def load(self, name: str) -> Table:
        """Read a table of the folder. Collective."""
        return Table.load(self.path(name))

    def say(self, text: object) -> None:
        """Print on rank 0."""
        if self.root:
            say(text)

    def check_drawn(self) -> None:
        """Raise ModelError if the tables in the folder are not those of a run of the study. Collective."""

        def check() -> None:
            run = self._folder.read_run()
            if run["study"] != self.study:
                raise ModelError(f"the run in {self.out} is of the study {run['study']}, not {self.study}")
            for name, found in dict(run.get("tables", {})).items():
                if hash_of(self.out / name) not in (None, found):
                    raise ModelError(f"{self.out / name} is not the table that the run in {self.out} wrote")

        on_root(world(), check)

    def _problem(self) -> str | None:
        """Reason why the run in the folder cannot be resumed; None if it can."""
        run = self._folder.read_run("--resume: ")
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
        """Run `thinlayer.sweep`, with its table in the folder; it is resumed if the run is. Collective."""

        def noted(e: float) -> Mapping[str, Any]:
            row = run(e)
            self._begin()
            return row

        self.path(f"{name}.json")
        return sweep(noted, eps, self.path(name), resume=self.resume)

    def march(self, model: Model, times: Sequence[float] | Adaptive, name: str, **choices: Any) -> History:
        """Run `thinlayer.march`; files to resume it from are kept until the run is done. Collective."""
        if not (self._begun or self.resume):  # files of a run that was killed
            on_root(world(), lambda: shutil.rmtree(self.path(MARCHES), ignore_errors=True))
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
        """Write run.json as soon as there is a result that a later run can resume."""
        if not self._noted:
            self._noted = True
            self.close("not finished")

    def solved(self, state: State) -> State:
        """Note for run.json how a state was found; returns the state."""
        thin = {name: one.thin.eps for name, one in state.model.layers.items() if one.thin}
        eps = thin if len(thin) > 1 else next(iter(thin.values()), None)
        self.solves.append({"model": repr(state.model), "eps": eps, "t": state.t} | asdict(state.report))
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
        on_root(world(), lambda: self._write(error))

    def stop(self, error: str) -> None:
        """Write run.json, unless that raises OSError; not collective."""
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
            "ranks": world().size,
            "versions": versions(),
            "seconds": round(time.perf_counter() - self._start, 3),
            "results": self.results,
            "checks": [asdict(check) for check in self.checks],
            "solves": self.solves,
            "error": error,
        }
        self._folder.write_run(content, done=error is None)
