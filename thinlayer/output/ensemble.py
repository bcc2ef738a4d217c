"""Ensembles: a table of many runs of one model, by groups of MPI ranks, by processes of an executor, or by jobs."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from uuid import uuid4

from mpi4py import MPI

from forms.base import InputError, require
from geometry.parallel import default_comm, on_root, use_comm
from thinlayer.errors import SolveError
from thinlayer.output.row_file import GENERATOR_TEXT, RowFile, checked_row, require_csv
from thinlayer.system.fingerprint import Resume, random_states
from thinlayer.system.folder import LOCK_FILE, lock_folder, lock_from_root
from thinlayer.system.progress import report, track
from thinlayer.system.ranks import errors_on_all, require_same
from thinlayer.system.table import Row, Table

RUN_COLUMN, FAILURE_COLUMN = "run", "failure"  # columns that an ensemble adds

CaseValues = Mapping[str, float | str]
RunFunction = Callable[[CaseValues], Mapping[str, object]]
Make = Callable[[], RunFunction]
NumberedRow = tuple[int, Row, bool]  # number of a run, its row, and whether it has advanced a generator
_IMPORTING_PROCESS = os.getpid()  # process in which MPI has been started
_THREAD_LOCK = threading.Lock()  # DOLFINx is for one thread of a process
# in a process of an executor: identifier of an ensemble -> what `make` returns
_RUN_FUNCTIONS: dict[str, RunFunction] = {}


def ensemble(
    make: Make,
    cases: Sequence[CaseValues],
    out: str | Path | None = None,
    resume: Resume = False,
    *,
    ranks: int | None = None,
    part: tuple[int, int] = (0, 1),
    keep_failures: bool = False,
    executor: Executor | None = None,
) -> Table:
    """Compute a table with one row for each of many cases, such as layers with random properties. Collective.

    A run computes the row of one case. The MPI ranks form groups, which work on different cases at the same time. Run k
    belongs to group k modulo the number of groups. Functions that `make` and the runs call without a communicator use
    that of the group.

    Args:
        make: function without arguments, called once in each group. It builds what the runs share, such as a joint and
            a model, and returns a function. The returned function takes a case and returns its row, name of a column ->
            number or text.
        cases: list of the inputs of the runs. Each case maps names to numbers or texts, with the same names in all
            cases.
        out: csv file for the table, written at the end, also after an error; None: no file. Before a group starts its
            next run, it stores the row of the last one in the file called `out` + ".json". A description of `make`, and
            of the objects it refers to, is stored with the rows.
        resume: False: compute all rows; files of an earlier ensemble are moved away. True: keep the stored rows and
            compute the others; the number of ranks, groups and parts may differ. Stored rows are refused if several
            runs took random numbers from the same generator. So create a generator in each run, from a seed in its
            case. The global generators of `random` and `numpy.random` count as common to all runs, unless code of the
            runs seeds them. "anyway": keep such rows too, and rows of another `make`; the cases must be the same.
        ranks: number of ranks of a group, a divisor of the number of all ranks (default: all ranks are one group).
        part: (k, n): divide the cases into n parts and compute only part k, with k = 0, ..., n - 1. Use it for n jobs
            that run at the same time or one after the other, with the same `out` and `resume=True`.
        keep_failures: True: a run that fails with a SolveError gets a row with the error in the column "failure", and
            None for its results; the other runs continue. False: the error is raised when the other groups, or the
            runs that the executor has begun, have finished.
        executor: object with the method `submit` of `concurrent.futures.Executor`, whose processes compute one row at a
            time, each on one MPI rank; None: the ranks of this program compute. `make` is called once in each process,
            and must be picklable, such as a function of a module. The processes must not be forked from this one.

    Returns:
        The table of all rows, also of those that were stored before. Its columns are "run" (number of the case), the
        names in the cases, the names in the rows and, with `keep_failures`, "failure".

    Raises:
        InputError: entries of cases or rows that are neither numbers nor texts, or cases with different names;
            ranks or part out of range; `out` belongs to another ensemble; runs of several groups, processes or parts
            take random numbers from one generator; a process of the executor has been forked.
        OSError: a file could not be written. An error of a run, or of the executor, is raised unchanged.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, ensemble, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> def make():
        ...     def run(case):
        ...         layer = ThinLayer(LinearElastic.young(E=case["E"], nu=0.4), eps=0.05)
        ...         return {"energy": solve(plates.interface(layer)).energies()["layer"]}
        ...     return run
        ...
        >>> table = ensemble(make, [{"E": 1e3}, {"E": 2e3}])
        >>> print(table["energy"].round(4))
        [0.0085 0.0042]
    """
    with ExitStack() as stack:
        if executor is not None:  # other ranks, if there are any, belong to it
            stack.enter_context(use_comm(MPI.COMM_SELF))
        with errors_on_all(None):
            comm = default_comm()
            require(callable(make), "make", make, "it must be a function that returns a function of a case")
            can_submit = executor is None or callable(getattr(executor, "submit", None))
            require(can_submit, "executor", executor, "it must have the method submit, as those of concurrent.futures")
            require_csv(out, resume)
            inputs = _checked_cases(cases)
            ranks = comm.size if ranks is None else ranks
            divisors = [n for n in range(1, comm.size + 1) if comm.size % n == 0]
            divides = f"allowed: a number that divides the number of ranks, {comm.size}"
            require(ranks in divisors, "ranks", ranks, divides)
            is_valid_part = isinstance(part, tuple) and [*map(type, part)] == [int, int] and 0 <= part[0] < part[1]
            require(is_valid_part, "part", part, "allowed: (k, n), the k-th of n parts, 0 <= k < n")
            parts_can_join = part[1] == 1 or (out is not None and resume)
            require(parts_can_join, "part", part, "parts of an ensemble share a table: give out=... and resume=True")
        require_same(None, cases=inputs, out=out and str(out), resume=resume, ranks=ranks, part=list(part))
        group, n_groups = comm.rank // ranks, comm.size // ranks
        first_run, step = part[0] * n_groups + group, part[1] * n_groups
        path = None if out is None else Path(out)
        lock_name = f".{path and path.name}.{part[0]}-of-{part[1]}{LOCK_FILE}"
        stack.enter_context(lock_from_root(path and path.parent, name=lock_name))
        subcomm = MPI.Intracomm(comm.Split(group))
        stack.callback(subcomm.Free)
        file = None if path is None else RowFile(path, make, "ensemble")
        stored_rows = {} if file is None else on_root(None, lambda: _read_stored_rows(file, inputs, resume))
        new_cases = {k: inputs[k] for k in range(first_run, len(inputs), step) if k not in stored_rows}
        runs = _Runs(make, keep_failures, may_draw=step == 1 and executor is None)
        rows, error = dict[int, Row](), None
        try:
            with use_comm(subcomm):
                for k, row, drawn in runs.rows(new_cases, executor):
                    rows[k] = row
                    with errors_on_all(subcomm):
                        if file and subcomm.rank == 0:
                            file.add(row, drawn=drawn)
        except Exception as problem:  # raised below, so that the other groups continue
            error = problem
        all_rows = {k: row for group_rows in comm.allgather(rows) for k, row in group_rows.items()}
        if file is not None:
            all_rows = on_root(None, lambda: _write_table(file, inputs))
        failure = None if error is None else f"group {group} of ranks has failed: {type(error).__name__}: {error}"
        if failures := [*filter(None, comm.allgather(failure))]:
            raise error or InputError(failures[0])
        return _make_table(inputs, all_rows)


@dataclass(frozen=True)
class _Runs:
    """The runs of an ensemble, which this group of ranks computes or sends, pickled, to processes of an executor.

    Attributes:
        make: the user's function, which returns the function of a case.
        keep_failures: whether a run that raises a SolveError gets a row with the error, instead of ending the ensemble.
        may_draw: whether runs may take random numbers from one generator, as all are computed here, one after the other.
        identifier: text that no other ensemble has; objects with the same one are equal.
    """

    make: Make = field(compare=False)
    keep_failures: bool
    may_draw: bool
    identifier: str = field(default_factory=lambda: uuid4().hex)

    def rows(self, cases: Mapping[int, Row], executor: Executor | None) -> Iterator[NumberedRow]:
        """Compute and yield rows, in the order in which they are done. Collective over the default communicator.

        Args:
            cases: number of a run -> its case.
            executor: object whose processes compute; None: these ranks do. After an error, cases that no process has
                begun are cancelled, and the error is raised when the others are done.
        """
        if executor is None and cases:
            run = self.run_function()
            for k in track([*cases], "ensemble", "run {}"):
                yield self.row(run, k, cases[k])
        if executor is None:
            return
        pending, error = {executor.submit(self.row_in_process, k, case) for k, case in cases.items()}, None
        try:
            with report("ensemble") as set_share:
                while pending:
                    n_done = len(cases) - len(pending)
                    set_share(n_done / len(cases), f"{n_done} of {len(cases)} runs")
                    done, pending = wait(pending, return_when=FIRST_COMPLETED)
                    for future in done:
                        if (problem := future.exception()) is None:
                            yield future.result()
                        error = error or problem
                    if error:
                        pending = {future for future in pending if not future.cancel()}
        finally:  # if the loop was left
            for future in pending:
                future.cancel()
        if error:
            raise error

    def run_function(self) -> RunFunction:
        """Call the user's `make`, and return the function of a case. Collective over the default communicator."""
        with errors_on_all(None):
            run = self.make()
            if not callable(run):
                raise InputError(f"make returns {run!r}; it must return a function of a case")
        return run

    def row(self, run: RunFunction, k: int, case: Row) -> NumberedRow:
        """Compute one row. Collective over the default communicator.

        Args:
            run: the user's function of a case.
            k: number of the run.
            case: its inputs.
        """
        states, row, failure = random_states((self.make, run)), Row(), None
        try:
            with errors_on_all(None):
                inputs = {name: value for name, value in case.items() if value is not None}  # None is refused
                row = checked_row(run(inputs), f"the row of run {k}", (RUN_COLUMN, FAILURE_COLUMN, *case))
        except SolveError as error:
            if not self.keep_failures:
                raise
            failure = str(error)
        row = {RUN_COLUMN: float(k), **case, **row} | ({FAILURE_COLUMN: failure} if self.keep_failures else {})
        with errors_on_all(None):
            new_states = random_states((self.make, run))
            if new_states[0] != states[0] and not self.may_draw:
                text = f"draw the same numbers, as from {GENERATOR_TEXT}"
                raise InputError(f"groups, processes and parts of an ensemble {text}")
        return k, row, new_states != states

    def row_in_process(self, k: int, case: Row) -> NumberedRow:
        """Compute one row in a process of an executor, which calls `make` for its first row; see `row`."""
        if os.getpid() != _IMPORTING_PROCESS:
            remedy = "start it anew, as ProcessPoolExecutor(mp_context=multiprocessing.get_context('spawn')) does"
            raise InputError(f"a process of the executor was forked from one with MPI, which MPI forbids; {remedy}")
        with _THREAD_LOCK, use_comm(MPI.COMM_SELF):
            return self.row(_run_function_of(self), k, case)


@lru_cache(maxsize=1)
def _run_function_of(runs: _Runs) -> RunFunction:
    """Return what `make` returns, in a process of an executor, which calls it once for all cases of an ensemble."""
    return runs.run_function()


# ---------------------------------------------------------------- files, on one rank
def _read_stored_rows(file: RowFile, cases: list[Row], resume: Resume) -> dict[int, Row]:
    """Return number of a run -> the row that earlier jobs of an ensemble have stored.

    Args:
        file: the file of rows.
        cases: inputs of all runs, which must be those of the earlier jobs.
        resume: the argument of `ensemble`.

    Raises:
        InputError: rows of other cases or of another `make`, or rows that took random numbers from one generator.
    """
    rows = _map_by_run(file.resume(resume))
    for k, row in rows.items():
        case = cases[k] if k < len(cases) else {}
        changed_inputs = [f"{name} = {row.get(name)!r} there" for name, value in case.items() if row.get(name) != value]
        if reasons := changed_inputs or ["no such run here"] * (not case):
            remedy = f"give another name, or remove it and {file.path.name!r}"
            raise InputError(f"{str(file.table)!r} is the table of other cases (run {k}: {reasons[0]}); {remedy}")
    return rows


def _write_table(file: RowFile, cases: list[Row]) -> dict[int, Row]:
    """Write the rows that all jobs have stored to the csv table, and return them: number of a run -> its row.

    A lock prevents two jobs from doing so at the same time.
    """
    with lock_folder(file.table.parent, f".{file.path.name}{LOCK_FILE}", wait=True):
        rows = _map_by_run(file.rows())
        if rows:
            _make_table(cases, rows).write_on_this_rank(file.table)
    return rows


def _map_by_run(rows: Sequence[Row]) -> dict[int, Row]:
    """Return number of a run -> its row, from rows with a column of these numbers."""
    return {int(row[RUN_COLUMN]): row for row in rows}  # type: ignore[arg-type]


def _make_table(cases: list[Row], rows: Mapping[int, Row]) -> Table:
    """Make the table of `rows`, number of a run -> row, ordered by run; entries that a row lacks are None."""
    ordered = [rows[k] for k in sorted(rows)]
    names = dict.fromkeys(name for row in ([RUN_COLUMN, *cases[0]], *ordered) for name in row if name != FAILURE_COLUMN)
    failure_columns = [FAILURE_COLUMN] if any(FAILURE_COLUMN in row for row in ordered) else []
    return Table({name: row.get(name) for name in (*names, *failure_columns)} for row in ordered)


def _checked_cases(cases: object) -> list[Row]:
    """Return the user's cases as rows; raise InputError unless all have the same names, of numbers or texts."""
    if not isinstance(cases, Iterable) or not (entries := [*cases]):
        raise InputError(f"cases is {cases!r:.80}; give a list of one case or more")
    rows = [checked_row(case, f"case {k}", (RUN_COLUMN, FAILURE_COLUMN)) for k, case in enumerate(entries)]
    for k, row in enumerate(rows):
        if [*row] != [*rows[0]] or None in row.values():
            raise InputError(f"case {k} has {', '.join(row)}, the first one {', '.join(rows[0])}; all need the same")
    return rows
