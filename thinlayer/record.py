"""Record: the folder a study leaves behind, with its tables, its pictures and what it was made from."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

from geometry.parallel import on_root
from thinlayer.comparison import sweep
from thinlayer.failure import SolveError
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.state import State
from thinlayer.table import Table
from thinlayer.time.history import History
from thinlayer.time.marching import march
from thinlayer.time.plan import Adaptive

MARCHES = "unfinished"  # folder for the states of marches, needed to resume
PACKAGES = (
    "fenics-dolfinx",
    "fenics-basix",
    "fenics-ufl",
    "fenics-ffcx",
    "petsc4py",
    "mpi4py",
    "numba",
    "gmsh",
    "meshio",
    "pyvista",
    "vtk",
    "numpy",
    "scipy",
    "matplotlib",
    "rich",
)


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on; "not installed" where one lacks."""
    from petsc4py import PETSc

    import thinlayer

    found = {"python": platform.python_version(), "thinlayer": thinlayer.__version__}
    found["petsc"] = ".".join(map(str, PETSc.Sys.getVersion()))
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


@dataclass
class Check:
    """A number that a study promises to lie in a range.

    Attributes:
        name: what the number is.
        value: the number found.
        low, high: the range; None for an open end.
        passed: whether it lies there.
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
    """What a run of a study keeps: tables, pictures, checks; `run.json` says what they were made from.

    The folder is made with the first file in it, and only rank 0 writes.

    Attributes:
        study: name of the study.
        out: the folder.
        options: what the user chose.
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
        self._start = time.perf_counter()
        self.root = MPI.COMM_WORLD.rank == 0

    def path(self, name: str) -> Path:
        """Path of a file in the folder (whoever writes it makes the folder)."""
        return self.out / name

    def write(self, name: str, table: Table) -> None:
        """Write a table as csv."""
        if self.root:
            table.write(self.path(name))

    def say(self, text: object) -> None:
        """Print on rank 0."""
        if self.root:
            print(text, flush=True)

    def check_resume(self) -> None:
        """Raise ModelError if the run to resume had other options. Collective."""
        problem = self._problem() if self.root and self.resume and self.path("run.json").exists() else None
        if problem := MPI.COMM_WORLD.bcast(problem):
            raise ModelError(problem)

    def _problem(self) -> str | None:
        """What is wrong with resuming the run in the folder."""
        try:
            run = json.loads(self.path("run.json").read_text())
            study, options = run["study"], run["options"]
        except (OSError, ValueError, LookupError, TypeError) as error:
            return f"--resume: {self.path('run.json')} cannot be read ({error})"
        if study != self.study:
            return f"--resume: the run in {self.out} is of the study {study}, not {self.study}"
        if options != json.loads(json.dumps(self.options, default=str)):
            return f"--resume: the run in {self.out} had the options {options}, not {self.options}"
        return None

    def sweep(self, run: Callable[[float], Mapping[str, Any]], eps: Sequence[float], name: str = "table.csv") -> Table:
        """`thinlayer.sweep` into a table of the folder, resumed if the run is. Collective."""

        def noted(e: float) -> Mapping[str, Any]:
            row = run(e)
            self._begin()
            return row

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
        layer = state.model.layer
        self.solves.append(
            {"model": repr(state.model), "eps": layer.eps if layer else None, "t": state.t, **asdict(state.report)}
        )
        return state

    def check(self, name: str, value: float, *, low: float | None = None, high: float | None = None) -> None:
        """Check that a number lies in a range; a failed check makes the run exit with status 1."""
        self.checks.append(Check(name, float(value), low, high))

    @property
    def failed(self) -> list[Check]:
        """Checks that do not hold."""
        return [check for check in self.checks if not check.passed]

    def close(self, error: str | None = None) -> None:
        """Write run.json."""
        if not self.root:
            return
        if error is None:
            shutil.rmtree(self.path(MARCHES), ignore_errors=True)
        self.out.mkdir(parents=True, exist_ok=True)
        content = {
            "study": self.study,
            "options": self.options,
            "parameters": self.parameters,
            "ranks": MPI.COMM_WORLD.size,
            "versions": versions(),
            "seconds": round(time.perf_counter() - self._start, 3),
            "results": self.results,
            "checks": [asdict(check) for check in self.checks],
            "solves": self.solves,
            "error": error,
        }
        partial = self.out / "run.json.part"
        partial.write_text(json.dumps(content, indent=1, default=str) + "\n")
        partial.replace(self.out / "run.json")
