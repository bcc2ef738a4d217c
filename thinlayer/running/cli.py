"""The command line: lists the studies, runs one, draws it again, prints versions.

DOLFINx and PETSc are imported only when a study runs, as that takes seconds.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from thinlayer.files.say import say
from thinlayer.running import startup
from thinlayer.running.arguments import command_line, folder, petsc_options, refuse
from thinlayer.running.catalogue import Study, studies

OK, CHECK_FAILED, BAD_INPUT, SOLVE_FAILED, NOT_WRITTEN, CRASHED, INTERRUPTED = 0, 1, 2, 3, 5, 70, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status, see `arguments.STATUSES`. A defect raises its exception, see `start`."""
    parser = command_line()
    chosen, rest = parser.parse_known_args(arguments)
    if chosen.command == "list":
        refuse(parser, rest)
        width = max(map(len, studies()))
        say("\n".join(f"{study.name:<{width}}  {study.summary}" for study in studies().values()))
        return OK
    if chosen.command == "draw":
        refuse(parser, rest)
        return _draw(parser, chosen)
    if chosen.command == "info":
        refuse(parser, rest)
        return _info()
    return _run(parser, chosen, rest)


def start() -> int:
    """`main` for a process of its own: returns an exit status for every exception, too."""
    try:
        return main()
    except KeyboardInterrupt:
        return _stop(True, INTERRUPTED, "interrupted")
    except Exception as error:
        import traceback

        traceback.print_exception(error)
        return _stop(True, CRASHED, "this is a defect of thinlayer, or of what it is installed with")


def _set_signals() -> None:
    """Restore Python's handling of signals. PETSc replaces it when it starts, and prints reports of its own."""
    startup.raise_on_interrupt()
    for number in (signal.SIGPIPE, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.getsignal(number))


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    out = folder(parser, chosen)
    if not any(out.glob("*.csv")):
        parser.error(f"no table in {out}; run the study first")
    from thinlayer import ModelError
    from thinlayer.running.record import Record

    _set_signals()
    try:
        record = Record(chosen.study, out, {})
        record.check_drawn()
        importlib.import_module(f"studies.{chosen.study}").draw(record)
    except ModelError as error:
        parser.error(str(error))
    except KeyError as error:
        parser.error(f"a table in {out} is not one of {chosen.study}: it has no column {error}")
    except FileNotFoundError as error:
        parser.error(f"{out} is not a whole run of {chosen.study}: there is no {error.filename}")
    except OSError as error:
        return _stop(True, NOT_WRITTEN, _not_written(error))
    say(f"drawn again in {out}")
    return OK


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    study = studies()[chosen.study]
    petsc = petsc_options(parser, study, rest)
    given = {name: getattr(chosen, name) for name in study.options if getattr(chosen, name) is not None}
    out = folder(parser, chosen)
    if out.exists() and not out.is_dir():
        parser.error(f"--out {out} is a file")
    return _run_study(study, out, given, petsc, chosen.resume, chosen.verbose)


def _run_study(
    study: Study, out: Path, given: dict[str, Any], petsc: dict[str, str | None], resume: bool, verbose: int
) -> int:
    startup.ignore_working_folder()
    from mpi4py import MPI
    from petsc4py import PETSc

    from thinlayer.errors import InputError, SolveError
    from thinlayer.parallel import abort, log
    from thinlayer.running.record import Record
    from thinlayer.solving.options import given_elsewhere

    _set_signals()
    abort.STATUS = CRASHED
    if verbose:
        log.show(logging.INFO if verbose == 1 else logging.DEBUG)
    root = MPI.COMM_WORLD.rank == 0
    if root and (elsewhere := given_elsewhere()):
        print(f"thinlayer: PETSc options from PETSC_OPTIONS or a file petscrc: {elsewhere}", file=sys.stderr)
    PETSc.Options().setValue("options_left", False)  # options that are not read are errors of ours, not PETSc's report
    for name, value in petsc.items():
        PETSc.Options().setValue(name, value)
    record = Record(study.name, out, given | petsc, resume=resume)
    try:
        with record:
            try:
                module = importlib.import_module(f"studies.{study.name}")
                module.run(record, **given)
                module.draw(record)
                record.close()
            except InputError:
                record.withdraw()
                raise
            except BaseException as error:
                record.stop(_reason(error))
                raise
    except InputError as error:
        return _stop(root, BAD_INPUT, f"{type(error).__name__}: {error}")
    except SolveError as error:
        return _stop(root, SOLVE_FAILED, f"{error}\nresults so far are kept in {out}")
    except OSError as error:
        message = f"{_not_written(error)}\nresults so far are kept in {out}; --resume continues"
        if not getattr(error, "on_all_ranks", False):
            _end_all_ranks(MPI.COMM_WORLD, NOT_WRITTEN, message)
        return _stop(root, NOT_WRITTEN, message)
    except KeyboardInterrupt:
        message = f"interrupted; results so far are kept in {out}; --resume continues"
        _end_all_ranks(MPI.COMM_WORLD, INTERRUPTED, message)
        return _stop(root, INTERRUPTED, message)
    except BaseException as error:
        if MPI.COMM_WORLD.size > 1:  # the error may be on one rank only, for which the others would wait for ever
            abort.abort(error)
        raise
    if root:
        for check in record.checks:
            say(f"{'ok  ' if check.passed else 'FAIL'} {check}")
        say(f"written to {out}")
    if record.failed:
        return _stop(root, CHECK_FAILED, "checks failed: " + "; ".join(str(check) for check in record.failed))
    return OK


def _reason(error: BaseException) -> str:
    """Text of an error for run.json."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return str(error) if isinstance(error, (RuntimeError, OSError)) else f"{type(error).__name__}: {error}"


def _not_written(error: OSError) -> str:
    where = f" {str(error.filename)!r}" if error.filename else ""
    return f"a file{where} could not be written or read: {error.strerror or error}"


def _stop(root: bool, status: int, message: str) -> int:
    if root:
        print(f"thinlayer: {message}", file=sys.stderr)
    return status


def _end_all_ranks(comm: Any, status: int, message: str) -> None:
    """End all ranks of a parallel run, as the others may not know of the error; a serial run goes on."""
    if comm.size > 1:
        _stop(True, status, message)
        sys.stderr.flush()
        comm.Abort(status)


def _info() -> int:
    from thinlayer.running.provenance import versions

    found = versions()
    _set_signals()
    width = max(map(len, found))
    say("\n".join(f"{name:<{width}}  {version}" for name, version in found.items()))
    return OK
