"""Command line: list the studies, run one, print versions. Heavy imports happen only when a study runs."""

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
from thinlayer.running.catalogue import Study, studies
from thinlayer_base import InputError

OK, CHECK_FAILED, BAD_INPUT, SOLVE_FAILED, NOT_WRITTEN, CRASHED, INTERRUPTED = 0, 1, 2, 3, 5, 70, 130
STATUSES = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 bad input, nothing written; 3 a solve failed, what "
    "was done is kept; 5 a file could not be written; 70 a defect, with its traceback; 130 interrupted."
)
PETSC_PREFIX = "-thinlayer_"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status.

    They are those of `STATUSES`; a defect raises here, see `start`.
    """
    parser = _parser()
    chosen, rest = parser.parse_known_args(arguments)
    if chosen.command == "list":
        _refuse(parser, rest)
        width = max(map(len, studies()))
        say("\n".join(f"{study.name:<{width}}  {study.summary}" for study in studies().values()))
        return OK
    if chosen.command == "draw":
        _refuse(parser, rest)
        return _draw(parser, chosen)
    if chosen.command == "info":
        _refuse(parser, rest)
        return _info()
    return _run(parser, chosen, rest)


def start() -> int:
    """`main` as a process of its own: the exit status of whatever happens."""
    try:
        return main()
    except KeyboardInterrupt:
        return _stop(True, INTERRUPTED, "interrupted")
    except Exception as error:
        import traceback

        traceback.print_exception(error)
        return _stop(True, CRASHED, "this is a defect of thinlayer, or of what it is installed with")


def _set_signals() -> None:
    """Python's own handling of signals, as PETSc takes them over with reports of its own."""
    startup.raise_on_interrupt()
    for number in (signal.SIGPIPE, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.getsignal(number))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python3 -m thinlayer", description="Thin soft layers, meshed or replaced by their interface law."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="the studies, a line each")
    commands.add_parser("info", help="versions of everything results depend on")
    draw = commands.add_parser("draw", help="draw a study's curves again from the tables of an earlier run")
    draw.add_argument("study", metavar="STUDY", choices=studies(), help="name, see the command list")
    draw.add_argument("--out", metavar="DIR", help="folder of the run (default: out/STUDY)")
    run = commands.add_parser("run", help="run a study", description="Run a study; STUDY --help shows its options.")
    names = run.add_subparsers(dest="study", required=True, metavar="STUDY")
    for study in studies().values():
        one = names.add_parser(
            study.name,
            allow_abbrev=False,  # --h would print the help
            usage="%(prog)s [options] [PETSc options]",
            description=f"{study.summary} PETSc options start with {PETSC_PREFIX}, as {PETSC_PREFIX}ksp_type cg.",
            epilog=STATUSES,
        )
        for name, details in study.options.items():
            one.add_argument(f"--{name}", default=None, **details)
        one.add_argument("--resume", action="store_true", help="continue a run that was killed, with the same options")
        one.add_argument("--out", metavar="DIR", help="folder for tables and pictures (default: out/STUDY)")
        one.add_argument(
            "-v", "--verbose", action="count", default=0, help="tell what solves try; twice: every step of them"
        )
    return parser


def _refuse(parser: argparse.ArgumentParser, rest: Sequence[str]) -> None:
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")


def _folder(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> Path:
    if chosen.out is not None and not chosen.out.strip():
        parser.error("--out is empty; give the name of a folder")
    return Path("out") / chosen.study if chosen.out is None else Path(chosen.out)


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    out = _folder(parser, chosen)
    if not (out / "table.csv").is_file():
        parser.error(f"no table.csv in {out}; run the study first")
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
        parser.error(f"table.csv in {out} is not one of {chosen.study}: it has no column {error}")
    except FileNotFoundError as error:
        parser.error(f"{out} is not a whole run of {chosen.study}: there is no {error.filename}")
    except OSError as error:
        return _stop(True, NOT_WRITTEN, _not_written(error))
    say(f"drawn again in {out}")
    return OK


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    study = studies()[chosen.study]
    petsc = _petsc_options(parser, study, rest)
    given = {name: getattr(chosen, name) for name in study.options if getattr(chosen, name) is not None}
    out = _folder(parser, chosen)
    if out.exists() and not out.is_dir():
        parser.error(f"--out {out} is a file")
    return _run_study(study, out, given, petsc, chosen.resume, chosen.verbose)


def _petsc_options(parser: argparse.ArgumentParser, study: Study, rest: Sequence[str]) -> dict[str, str | None]:
    """-thinlayer_NAME [VALUE] ... as a dictionary."""
    options: dict[str, str | None] = {}
    name = None
    for word in rest:
        if word.startswith(PETSC_PREFIX):
            name = word[1:]
            options[name] = None
        elif name is not None and options[name] is None and not word.startswith("--"):
            options[name] = word
        elif any(word == f"--{option}" for one in studies().values() for option in one.options):
            uses = ", ".join(f"--{option}" for option in study.options) or "none"
            parser.error(f"study {study.name} does not use {word}; it uses: {uses}")
        else:
            parser.error(f"unrecognized argument {word!r}; PETSc options start with {PETSC_PREFIX}")
    return options


def _run_study(
    study: Study, out: Path, given: dict[str, Any], petsc: dict[str, str | None], resume: bool, verbose: int
) -> int:
    startup.ignore_working_folder()
    from mpi4py import MPI
    from petsc4py import PETSc

    from thinlayer.errors import SolveError
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
    PETSc.Options().setValue("options_left", False)  # we tell ourselves which were not read
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
        return _stop(root, SOLVE_FAILED, f"{error}\nwhat was done is kept in {out}")
    except OSError as error:
        message = f"{_not_written(error)}\nwhat was done is kept in {out}, --resume continues"
        if not getattr(error, "on_all_ranks", False):
            _end_all_ranks(MPI.COMM_WORLD, NOT_WRITTEN, message)
        return _stop(root, NOT_WRITTEN, message)
    except KeyboardInterrupt:
        message = f"interrupted; what was done is kept in {out}, --resume continues"
        _end_all_ranks(MPI.COMM_WORLD, INTERRUPTED, message)
        return _stop(root, INTERRUPTED, message)
    except BaseException as error:
        if MPI.COMM_WORLD.size > 1:  # it may be on one rank only: the others must not wait for it for ever
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
    """For run.json."""
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
    """An error that other ranks may not know of ends them; a serial run goes on."""
    if comm.size > 1:
        _stop(True, status, message)
        sys.stderr.flush()
        comm.Abort(status)


def _info() -> int:
    from thinlayer.running.record import versions

    found = versions()
    _set_signals()
    width = max(map(len, found))
    say("\n".join(f"{name:<{width}}  {version}" for name, version in found.items()))
    return OK
