"""Start and end of commands: interrupts, PETSc options, the folder of results, errors and exit statuses."""

from __future__ import annotations

import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from thinlayer.system.version import error_reason

if TYPE_CHECKING:
    from thinlayer.running.record import Record

Petsc = Mapping[str, str | None]  # PETSc options
Work = Callable[["Record"], None]
OK, CHECK_FAILED, BAD_INPUT, UNFINISHED = range(4)


def end_on_interrupt() -> None:
    """Let an interrupt (SIGINT) end the process at once, without a Python exception.

    Without this, an interrupt while C++ modules are loaded would end in a crash with a report.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def is_rank_0() -> bool:
    """Return whether this process is rank 0, from environment variables of mpirun.

    For use before MPI is initialised.
    """
    return all(os.environ.get(name, "0") == "0" for name in ("PMIX_RANK", "PMI_RANK", "OMPI_COMM_WORLD_RANK"))


def restore_signals() -> None:
    """Let Python handle signals again, instead of PETSc.

    When PETSc starts, it installs handlers that print reports of their own.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for signal_number in (signal.SIGPIPE, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signal_number, signal.getsignal(signal_number))


def run_with_record(
    name: str, out: Path, work: Work, options: Mapping[str, object], petsc: Petsc, verbose: int, *, resume: bool = False
) -> int:
    """Run a function that writes results to a folder, print its checks, and return the exit status. Collective.

    Args:
        name: name of the study, stored in run.json.
        out: the folder.
        work: the function; its argument is the `Record` of the folder.
        options: name of an option -> value chosen by the user, stored in run.json.
        petsc: name of a PETSc option to set -> its value; None: the option has no value.
        verbose: how much is printed. 0: progress, tables and checks; 1: also attempts of solves; 2: also their steps.
            -1: only errors, warnings and checks that fail.
        resume: whether to continue an earlier run in the folder.
    """

    def run_and_check() -> int:
        from thinlayer.running.record import Record

        record = Record(name, out, {**options, **petsc}, resume=resume)
        record.quiet = verbose < 0
        with record:
            work(record)
        for check in record.checks:
            record.say(f"{'ok  ' if check.passed else 'FAIL'} {check}")
        record.say(f"written to {out}")
        if record.failures:
            return print_error(record.is_root, CHECK_FAILED, "checks failed: " + "; ".join(map(str, record.failures)))
        return OK

    return run_with_mpi(run_and_check, petsc=petsc, verbose=verbose, note=f"\nresults so far are kept in {out}")


def run_with_mpi(work: Callable[[], int], *, petsc: Petsc, verbose: int, note: str = "") -> int:
    """Start MPI, PETSc and DOLFINx, run a function, and return the exit status. Collective.

    Wrong input, a failed solve, a file that cannot be written or an interrupt gives a printed message and an exit
    status. Any other exception is raised.

    Args:
        work: the function, without arguments, which returns an exit status.
        petsc: name of a PETSc option to set -> its value; None: the option has no value.
        verbose: how much is printed. 0: progress; 1: also attempts of solves; 2: also their steps; -1: only errors and
            warnings.
        note: text printed after the error if `work` does not finish; it says where results so far are.
    """
    import petsc4py

    petsc4py.init(["thinlayer", "-skip_petscrc"])  # neither PETSc nor FFCx reads options from the working folder
    from thinlayer.system.compilation import load_ffcx_options

    load_ffcx_options()
    from mpi4py import MPI
    from petsc4py import PETSc

    import thinlayer.running.record  # noqa: F401  (its C++ modules, while an interrupt still ends the process)
    from thinlayer.errors import InputError, SolveError
    from thinlayer.solving.petsc import command_line_text
    from thinlayer.system import ranks

    restore_signals()
    ranks.EXIT_STATUS = UNFINISHED
    if verbose:
        logging.basicConfig(format="%(name)s: %(message)s")
        logging.getLogger("thinlayer").setLevel({-1: logging.ERROR, 1: logging.INFO}.get(verbose, logging.DEBUG))
    comm, root = MPI.COMM_WORLD, MPI.COMM_WORLD.rank == 0
    if root and (other_options := command_line_text()):
        print(f"thinlayer: PETSc options from PETSC_OPTIONS or a file petscrc: {other_options}", file=sys.stderr)
    # unread options raise our errors, instead of PETSc's report
    for option, value in {"options_left": False, **petsc}.items():
        PETSc.Options().setValue(option, value)
    # without the line of code: warnings are about results, and the line is not the user's
    category_name = (lambda category: category.__name__) if verbose > 0 else (lambda _: "warning")
    warnings.formatwarning = lambda message, category, *_, **__: f"thinlayer: {category_name(category)}: {message}\n"
    try:
        return work()
    except InputError as error:
        return print_error(root, BAD_INPUT, error_text(error, verbose))
    except (SolveError, OSError, KeyboardInterrupt) as error:
        message = f"{error_text(error, verbose)}{note}"
        if comm.size > 1 and not (isinstance(error, SolveError) or getattr(error, "on_all_ranks", False)):
            print_error(True, UNFINISHED, message)  # the others may not know of it
            sys.stderr.flush()
            comm.Abort(UNFINISHED)
        return print_error(root, UNFINISHED, message)
    except BaseException as error:
        if comm.size > 1:  # the error may be on one rank only, for which the others would wait for ever
            ranks.abort(error)
        raise


def error_text(error: BaseException, verbose: int) -> str:
    """Return the text of an error that ends a command; with `verbose` > 0 the name of the error's class comes first."""
    reason = str(error) if isinstance(error, ValueError) else error_reason(error)
    return f"{type(error).__name__}: {reason}" if verbose > 0 else reason


def print_error(root: bool, status: int, message: str) -> int:
    """Print `message` on standard error if `root` is true (this is rank 0), and return the exit status `status`."""
    if root:
        print(f"thinlayer: {message}", file=sys.stderr)
    return status
