"""Record of a study's run: a folder with tables, pictures and the file run.json on input, checks and solves."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from forms.base import InputError
from geometry.parallel import default_comm, on_root
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.output.sweep import sweep
from thinlayer.running.provenance import code_hash, package_versions, petsc_options
from thinlayer.solving.history import History
from thinlayer.solving.petsc import PREFIX
from thinlayer.system.fingerprint import differences, differences_text
from thinlayer.system.folder import lock_folder, move_away, move_back, replace_file
from thinlayer.system.progress import logger, track
from thinlayer.system.table import ColumnValues, Table
from thinlayer.system.version import error_reason, print_safely
from thinlayer.time.marching import march
from thinlayer.time.plan import Adaptive

SolvedType = TypeVar("SolvedType", State, History)
STUDY_LOGGER = logger("study")
RunContent = dict[str, Any]  # content of run.json
RUN_FILE, RUN_FORMAT = "run.json", 1  # name of the file, and version of its format
MAX_PRINTED_ROWS = 40  # largest number of rows of a table that is printed
ENTRY_TYPES = {"study": str, "options": dict, "code": str, "petsc": dict, "files": list, "checks": list}  # in run.json
UNFINISHED_FOLDER = "unfinished"  # folder for the states of marches, needed to resume


@dataclass
class Check:
    """A number computed by a study, and the range in which it must lie.

    Attributes:
        name: what the number is, in words.
        value: the number.
        low, high: smallest and largest allowed value; None: no bound.
        passed: whether the number lies in the range; NaN does not.
    """

    name: str
    value: float
    low: float | None
    high: float | None
    passed: bool = field(init=False)

    def __post_init__(self) -> None:
        above_low = self.low is None or self.value >= self.low
        below_high = self.high is None or self.value <= self.high
        self.passed = bool(above_low and below_high)  # NaN fails; JSON needs Python's bool

    def __str__(self) -> str:
        ends = [f"{sign} {bound:.6g}" for sign, bound in ((">=", self.low), ("<=", self.high)) if bound is not None]
        return f"{self.name}: {self.value:.6g} ({' and '.join(ends)})"


class Record:
    """Results of a study's run in a folder: tables and pictures, and the file run.json with the input and the checks.

    Use it in a `with` statement. At its start the folder is locked, so that other runs there are refused. Files of an
    earlier run are moved to a subfolder previous-1, previous-2, ... They are moved back if the statement ends with an
    InputError before any file is written. A file that no run.json lists is moved to such a subfolder, too, before a
    file of the same name is written. At the end run.json says whether the study is done, or why it is not. Only rank 0
    writes files.

    Attributes:
        study: name of the study.
        out: the folder.
        options: name of an option -> value chosen by the user.
        resume: whether to continue an earlier run of the study with the same options.
        checks: the checks so far.
        parameters: name -> constant of the study's module; written to run.json.
        results: name -> number that the study computed in addition to its tables; written to run.json.
        solves: for each solved state its model, thickness, time and the solver's report; written to run.json.
        is_root: whether this is rank 0.
        quiet: whether `say` prints nothing.
    """

    def __init__(self, study: str, out: str | Path, options: Mapping[str, object], *, resume: bool = False) -> None:
        self.study, self.out, self.options, self.resume = study, Path(out), dict(options), resume
        self.parameters: dict[str, Any] = {}
        self.results: dict[str, object] = {}
        self.checks: list[Check] = []
        self.solves: list[dict[str, object]] = []
        self._tables: dict[str, Table] = {}
        self._file_names: set[str] = set()  # names of the run's files except run.json
        self._previous_folder: Path | None = None  # where the files of an earlier run are now
        self._lock_stack, self._start_time = ExitStack(), time.perf_counter()
        self.is_root, self.quiet, self._has_lock = default_comm().rank == 0, False, False

    # ---------------------------------------------------------------- the folder
    def __enter__(self) -> Self:
        """Lock the folder and, unless this run continues an earlier one, move the files of that run away. Collective.

        Raises:
            InputError: the folder cannot be written, is in use by another run, or has tables without a run.json; or the
                earlier run cannot be continued.
        """
        with ExitStack() as stack:
            on_root(default_comm(), lambda: self._claim_folder(stack))
            self._lock_stack = stack.pop_all()
        self._has_lock = True
        return self

    def _claim_folder(self, exit_stack: ExitStack) -> None:
        exit_stack.enter_context(lock_folder(self.out))
        if (self.out / RUN_FILE).exists():
            if self.resume:
                self._file_names |= {*self.read_same_run()["files"]}
            else:  # run.json last: it is still there if the process is killed while files are moved
                files = (name for name in self._read_run_file()["files"] if Path(name).name == name)
                self._previous_folder = move_away(self.out, [*files, RUN_FILE])
        elif tables := sorted(path.name for path in self.out.glob("*.csv")):
            raise InputError(f"{self.out} has {', '.join(tables)}, but no run.json; give another --out, or remove them")

    def __exit__(self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None) -> None:
        """Write run.json with the reason for the end of the run, and unlock the folder.

        After an InputError before any file was written, run.json is removed instead, and files of an earlier run return
        to their places. Collective if no exception ends the `with` statement; after an exception, each rank may call it
        alone.

        Args:
            error: exception that ends the `with` statement; None: the run is done.

        Raises:
            OSError: the run is done, but run.json cannot be written; all ranks raise it.
        """
        with self._lock_stack:
            if error is None:
                self.close()
            elif self.is_root:
                with suppress(OSError):
                    if not isinstance(error, InputError):
                        self._write_run_file(error_reason(error))
                    elif not any((self.out / name).exists() for name in self._file_names):
                        (self.out / RUN_FILE).unlink(missing_ok=True)
                        if self._previous_folder:
                            move_back(self._previous_folder)

    def _read_run_file(self) -> RunContent:
        """Return the content of run.json as nested JSON data. To be called on rank 0 only.

        Raises:
            InputError: the file cannot be read or lacks entries.
        """
        path = self.out / RUN_FILE
        try:
            run = dict(json.loads(path.read_text(encoding="utf-8")))
            if wrong_names := [name for name, kind in ENTRY_TYPES.items() if not isinstance(run.get(name), kind)]:
                raise ValueError(f"wrong or missing entries: {', '.join(wrong_names)}")
            Path(*run["files"])
            dict(run["petsc"]["options"])
            return run
        except (OSError, ValueError, LookupError, TypeError, RecursionError) as error:
            raise InputError(f"{path} cannot be read ({error}); give another folder, or remove it") from error

    def _read_study_run(self) -> RunContent:
        """Return the content of run.json after a check that it is of this study. To be called on rank 0 only.

        Raises:
            InputError: the file cannot be read, lacks entries, or belongs to another study.
        """
        content = self._read_run_file()
        if content["study"] != self.study:
            raise InputError(f"the run in {self.out} is of the study {content['study']}, not {self.study}")
        return content

    def read_same_run(self) -> RunContent:
        """Return the content of run.json after a check that its run had the input of this one.

        To be called on rank 0 only.

        Raises:
            InputError: the file cannot be read; or its run differs in the study, its options, the package's PETSc
                options or the source code.
        """
        content = self._read_study_run()
        own_input: RunContent = {"options": self.identity()[1], "code": code_hash(), "petsc": petsc_options()}
        earlier_input = {name: content[name] for name in own_input}
        for data in (earlier_input, own_input):
            data["petsc"] = {k: value for k, value in data["petsc"]["options"].items() if k.startswith(f"-{PREFIX}")}
        if changes := [*differences(earlier_input, own_input)]:
            text = differences_text(changes)
            raise InputError(f"--resume: the run in {self.out} was another one ({text}); run the study anew")
        return content

    def identity(self) -> list[object]:
        """Return the study's name and its options as JSON data: [name, {option: value}].

        They are part of the hash by which a sweep or march of this run recognises its files when it is resumed.
        """
        return [self.study, json.loads(json.dumps(self.options, default=str))]

    def require_run(self) -> None:
        """Check that the folder has a run of this study, whose pictures can be drawn again. Collective.

        Raises:
            InputError: the folder has no readable run.json, or one of another study.
        """
        on_root(default_comm(), self._read_study_run)

    def close(self) -> None:
        """Write run.json for a run that is done. Collective.

        Raises:
            OSError: the file cannot be written; all ranks raise it.
        """
        on_root(default_comm(), lambda: self._write_run_file(None))

    def _write_run_file(self, error: str | None) -> None:
        content: RunContent = {"study": self.study, "options": self.options, "parameters": self.parameters}
        content |= {"results": self.results, "solves": self.solves, "code": code_hash(), "petsc": petsc_options()}
        seconds, checks = round(time.perf_counter() - self._start_time, 3), [*map(asdict, self.checks)]
        content |= {"versions": package_versions(), "ranks": default_comm().size, "seconds": seconds, "checks": checks}
        content |= {"format": RUN_FORMAT, "error": error, "files": sorted(self._file_names)}
        with replace_file(self.out / RUN_FILE) as file:
            file.write((json.dumps(content, indent=1, default=str) + "\n").encode())
        if error is None:
            shutil.rmtree(self.out / UNFINISHED_FOLDER, ignore_errors=True)

    # ---------------------------------------------------------------- files
    def path(self, name: str) -> Path:
        """Return the path of the file `name` in the folder, and add it to the files of this run, which run.json lists.

        The file is not made, nor the folder: the function that writes the file makes both.
        """
        if name not in self._file_names:
            self._file_names.add(name)
            if self._has_lock and self.is_root:  # so that run.json names the files even if the run is killed
                with suppress(OSError):
                    move_away(self.out, [name])  # no file of an earlier run: these have been moved already
                    self._write_run_file("not finished")
        return self.out / name

    def new_table(self, name: str) -> Table:
        """Return a new, empty table, of which each added row is written at once to a csv file. Collective.

        Args:
            name: name of the csv file in the folder.
        """
        self._tables[name] = Table(path=self.path(name))
        return self._tables[name]

    def rows(self, name: str, cases: Iterable[object], row: Callable[..., ColumnValues], label: str = "{}") -> Table:
        """Compute a table with one row for each case, and write each row at once to a csv file. Collective.

        Args:
            name: name of the csv file in the folder.
            cases: for each row the argument of `row`; a tuple stands for several arguments.
            row: function that returns a row of the table: name of a column -> entry.
            label: format string for a case, such as "eps = {}"; it makes the text shown while the row is computed.
        """
        table = self.new_table(name)
        for case in track(list(cases), self.study, label):
            table.append(row(*case) if isinstance(case, tuple) else row(case))
        return table

    def write(self, name: str, table: Table) -> None:
        """Write all rows of `table` to the csv file `name` in the folder. Collective."""
        table.write(self.path(name))
        self._tables[name] = table

    def has(self, name: str) -> bool:
        """Return whether the folder has a file called `name`. Collective."""
        return on_root(default_comm(), (self.out / name).exists)

    def load(self, name: str) -> Table:
        """Read a table from the csv file `name` in the folder. Collective."""
        return Table.load(self.path(name))

    # ---------------------------------------------------------------- results
    def say_tables(self) -> None:
        """Print the tables of this run that have at most 40 rows, unless `quiet` is set."""
        for name, table in self._tables.items():
            if len(table) <= MAX_PRINTED_ROWS:
                self.say(f"{name}\n{table}")

    def say(self, text: object) -> None:
        """Print `text` on rank 0, unless `quiet` is set."""
        if self.is_root and not self.quiet:
            print_safely(text)

    def sweep(self, run: Callable[[float], ColumnValues], eps: Sequence[float], name: str = "table.csv") -> Table:
        """Compute a table of errors over thicknesses by `thinlayer.sweep`, and write it to the folder. Collective.

        If this run continues an earlier one, rows that are in the folder are not computed again.

        Args:
            run: function that takes a thickness and returns a row of the table.
            eps: the thicknesses.
            name: name of the csv file.

        Returns:
            The table.
        """
        self.path(f"{name}.json")
        self._tables[name] = sweep(run, eps, self.path(name), resume=self.resume)
        return self._tables[name]

    def march(self, model: Model, times: Sequence[float] | Adaptive, name: str, **choices: Any) -> History:
        """Solve a model step by step in time by `thinlayer.march`, and return its history. Collective.

        The solver's report of each state is added to `solves`. States are stored in the folder until the run is done,
        so that a later run can continue from them.

        Args:
            model: the model.
            times: ends of the time steps, or settings of adaptive steps.
            name: name of the subfolder for the stored states.
            choices: further arguments of `march`.
        """
        try:
            history = march(model, times, out=self.path(UNFINISHED_FOLDER) / name, resume=self.resume, **choices)
        except SolveError as error:
            for state in error.history or ():
                self.add_report(state)
            raise
        for state in history:
            self.add_report(state)
        return history

    def add_report(self, solution: SolvedType) -> SolvedType:
        """Add the solver's report of a solution to `solves`, for run.json, and return the solution unchanged.

        Args:
            solution: a state; or a history, of which the report of the last state is added.
        """
        state = solution if isinstance(solution, State) else solution.last
        eps_by_name = {name: layer.thin_layer.eps for name, layer in state.model.layers.items() if layer.thin_layer}
        eps = eps_by_name if len(eps_by_name) > 1 else next(iter(eps_by_name.values()), None)
        self.solves.append({"model": repr(state.model), "eps": eps, "t": state.t} | asdict(state.report))
        STUDY_LOGGER.info("%(model)s, eps = %(eps)s, t = %(t)g: %(method)s, %(iterations)d steps", self.solves[-1])
        return solution

    def check(self, name: str, value: float, *, low: float | None = None, high: float | None = None) -> None:
        """Record whether a number lies in a range; if it does not, the run goes on, and its exit status will be 1.

        Args:
            name: what the number is, in words.
            value: the number.
            low, high: smallest and largest allowed value; None: no bound.
        """
        self.checks.append(Check(name, float(value), low, high))
        STUDY_LOGGER.info("check %s", self.checks[-1])

    def check_near(self, name: str, value: float, expected: float, tolerance: float) -> None:
        """Record whether a number is near its expected value; if it is not, the exit status of the run will be 1.

        Args:
            name: what the number is, in words.
            value: the number.
            expected: its expected value.
            tolerance: largest allowed difference, relative to the expected value.
        """
        low, high = sorted((expected * (1 - tolerance), expected * (1 + tolerance)))
        self.check(name, value, low=low, high=high)

    @property
    def failures(self) -> list[Check]:
        """The checks whose numbers do not lie in their ranges."""
        return [check for check in self.checks if not check.passed]
