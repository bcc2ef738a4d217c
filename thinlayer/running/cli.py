"""Command line: list the studies, run one, print versions. Heavy imports happen only when a study runs."""

from __future__ import annotations

import argparse
import importlib
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from thinlayer.files.say import say
from thinlayer.running import startup
from thinlayer.running.catalogue import Study, studies

OK, CHECK_FAILED, BAD_INPUT, SOLVE_FAILED, CRASHED, NOT_WRITTEN, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130
PETSC_PREFIX = "-thinlayer_"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status.

    0: done, and all checks of the study hold; 1: a check failed; 2: bad input, nothing was written; 3: a solve failed,
    what was done is kept; 4: a defect, with its traceback (see `start`); 5: a file could not be written, what was done is
    kept; 130: interrupted.
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
    draw.add_argument("study", metavar="STUDY", help="name, see the command list")
    draw.add_argument("--out", metavar="DIR", help="folder of the run (default: out/STUDY)")
    run = commands.add_parser(
        "run",
        allow_abbrev=False,  # --h would print the help
        help="run a study",
        usage="%(prog)s STUDY [options] [PETSc options]",
        description="Run a study. A study takes only the options it uses. PETSc options start with -thinlayer_, "
        "for example -thinlayer_ksp_type cg.",
        epilog="Exit status: 0 all checks of the study hold; 1 a check failed; 2 bad input, nothing written; "
        "3 a solve failed, what was done is kept; 4 a defect; 5 a file could not be written; 130 interrupted.",
    )
    run.add_argument("study", metavar="STUDY", help="name, see the command list")
    run.add_argument("--eps", nargs="+", type=float, metavar="E", help="thicknesses of the layer, > 0")
    run.add_argument("--bodies", choices=("kept", "extended"), help="how the bodies make room for the meshed layer")
    run.add_argument("--order", type=int, choices=(0, 1), help="order of the interface law")
    run.add_argument("--loads", choices=("both", "R1", "R4m"), help="readings of the paper's loads (fig3_mohr_coulomb)")
    run.add_argument("--quick", action="store_true", default=None, help="coarse meshes and few thicknesses")
    run.add_argument("--resume", action="store_true", help="continue a run that was killed, with the same options")
    run.add_argument("--out", metavar="DIR", help="folder for tables and pictures (default: out/STUDY)")
    return parser


def _refuse(parser: argparse.ArgumentParser, rest: Sequence[str]) -> None:
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")


def _study(parser: argparse.ArgumentParser, name: str) -> Study:
    known = studies()
    if name not in known:
        parser.error(f"unknown study {name!r}; known: {', '.join(known)}")
    return known[name]


def _folder(parser: argparse.ArgumentParser, chosen: argparse.Namespace, study: Study) -> Path:
    if chosen.out is not None and not chosen.out.strip():
        parser.error("--out is empty; give the name of a folder")
    return Path("out") / study.name if chosen.out is None else Path(chosen.out)


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    study = _study(parser, chosen.study)
    out = _folder(parser, chosen, study)
    if not (out / "table.csv").is_file():
        parser.error(f"no table.csv in {out}; run the study first")
    from thinlayer import ModelError
    from thinlayer.running.record import Record

    _set_signals()
    try:
        record = Record(study.name, out, {})
        record.check_drawn()
        importlib.import_module(f"studies.{study.name}").draw(record)
    except ModelError as error:
        parser.error(str(error))
    except KeyError as error:
        parser.error(f"table.csv in {out} is not one of {study.name}: it has no column {error}")
    except FileNotFoundError as error:
        parser.error(f"{out} is not a whole run of {study.name}: there is no {error.filename}")
    except OSError as error:
        return _stop(True, NOT_WRITTEN, _not_written(error))
    say(f"drawn again in {out}")
    return OK


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    study = _study(parser, chosen.study)
    known = ("eps", "bodies", "order", "loads", "quick")
    given = {name: getattr(chosen, name) for name in known if getattr(chosen, name) is not None}
    _check_options(parser, study, given)
    petsc = _petsc_options(parser, rest)
    out = _folder(parser, chosen, study)
    if out.exists() and not out.is_dir():
        parser.error(f"--out {out} is a file")
    return _run_study(study, out, given, petsc, chosen.resume)


def _check_options(parser: argparse.ArgumentParser, study: Study, given: dict[str, Any]) -> None:
    for name in given:
        if name not in study.options:
            uses = ", ".join(f"--{option}" for option in study.options) or "none"
            parser.error(f"study {study.name} does not use --{name}; it uses: {uses}")
    for eps in given.get("eps", []):
        if not 0 < eps < float("inf"):
            parser.error(f"--eps {eps:g}: a thickness must be > 0")


def _petsc_options(parser: argparse.ArgumentParser, rest: Sequence[str]) -> dict[str, str | None]:
    """-thinlayer_NAME [VALUE] ... as a dictionary."""
    options: dict[str, str | None] = {}
    name = None
    for word in rest:
        if word.startswith(PETSC_PREFIX):
            name = word[1:]
            options[name] = None
        elif name is not None and options[name] is None and not word.startswith("--"):
            options[name] = word
        else:
            parser.error(f"unrecognized argument {word!r}; PETSc options start with {PETSC_PREFIX}")
    return options


def _run_study(study: Study, out: Path, given: dict[str, Any], petsc: dict[str, str | None], resume: bool) -> int:
    startup.ignore_working_folder()
    from mpi4py import MPI
    from petsc4py import PETSc

    from forms import LawError
    from geometry import GeometryError
    from thinlayer import ModelError, OptionError, SolveError
    from thinlayer.running.record import Record
    from thinlayer.solving.options import given_elsewhere

    _set_signals()
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
                importlib.import_module(f"studies.{study.name}").run(record, **given)
                record.close()
            except (GeometryError, LawError, ModelError, OptionError):
                record.withdraw()
                raise
            except BaseException as error:
                record.stop(_reason(error))
                raise
    except (GeometryError, LawError, ModelError, OptionError) as error:
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
            from thinlayer.parallel.abort import abort

            abort(error, CRASHED)
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
