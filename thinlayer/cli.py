"""Command line: list the studies, run one, print versions. Heavy imports happen only when a study runs."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from thinlayer.catalogue import Study, studies

OK, CHECK_FAILED, BAD_INPUT, SOLVE_FAILED, INTERRUPTED = 0, 1, 2, 3, 130
PETSC_PREFIX = "-thinlayer_"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status.

    0: done, and all checks of the study hold; 1: a check failed; 2: bad input, nothing was written; 3: a solve failed,
    what was done is kept.
    """
    parser = _parser()
    chosen, rest = parser.parse_known_args(arguments)
    if chosen.command == "list":
        _refuse(parser, rest)
        width = max(map(len, studies()))
        print("\n".join(f"{study.name:<{width}}  {study.summary}" for study in studies().values()))
        return OK
    if chosen.command == "draw":
        _refuse(parser, rest)
        return _draw(parser, chosen)
    if chosen.command == "info":
        _refuse(parser, rest)
        return _info()
    return _run(parser, chosen, rest)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python3 -m thinlayer", description="Thin soft layers, meshed or replaced by their interface law."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="the studies, a line each")
    commands.add_parser("info", help="versions of everything results depend on")
    draw = commands.add_parser("draw", help="draw a study's curves again from the tables of an earlier run")
    draw.add_argument("study", metavar="STUDY", help="name, see the command list")
    draw.add_argument("--out", type=Path, metavar="DIR", help="folder of the run (default: out/STUDY)")
    run = commands.add_parser(
        "run",
        allow_abbrev=False,  # --h would print the help
        help="run a study",
        usage="%(prog)s STUDY [options] [PETSc options]",
        description="Run a study. A study takes only the options it uses. PETSc options start with -thinlayer_, "
        "for example -thinlayer_ksp_type cg.",
        epilog="Exit status: 0 all checks of the study hold; 1 a check failed; 2 bad input, nothing written; "
        "3 a solve failed, what was done is kept.",
    )
    run.add_argument("study", metavar="STUDY", help="name, see the command list")
    run.add_argument("--eps", nargs="+", type=float, metavar="E", help="thicknesses of the layer, > 0")
    run.add_argument("--bodies", choices=("kept", "extended"), help="how the bodies make room for the meshed layer")
    run.add_argument("--order", type=int, choices=(0, 1), help="order of the interface law")
    run.add_argument("--loads", choices=("both", "R1", "R4m"), help="readings of the paper's loads (fig3_mohr_coulomb)")
    run.add_argument("--quick", action="store_true", default=None, help="coarse meshes and few thicknesses")
    run.add_argument("--resume", action="store_true", help="continue a run that was killed, with the same options")
    run.add_argument("--out", type=Path, metavar="DIR", help="folder for tables and pictures (default: out/STUDY)")
    return parser


def _refuse(parser: argparse.ArgumentParser, rest: Sequence[str]) -> None:
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")


def _study(parser: argparse.ArgumentParser, name: str) -> Study:
    known = studies()
    if name not in known:
        parser.error(f"unknown study {name!r}; known: {', '.join(known)}")
    return known[name]


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    study = _study(parser, chosen.study)
    out = chosen.out or Path("out") / study.name
    if not (out / "table.csv").is_file():
        parser.error(f"no table.csv in {out}; run the study first")
    from thinlayer.record import Record

    try:
        importlib.import_module(f"studies.{study.name}").draw(Record(study.name, out, {}))
    except KeyError as error:
        parser.error(f"table.csv in {out} is not one of {study.name}: it has no column {error}")
    except FileNotFoundError as error:
        parser.error(f"{out} is not a whole run of {study.name}: there is no {error.filename}")
    print(f"drawn again in {out}")
    return OK


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    study = _study(parser, chosen.study)
    known = ("eps", "bodies", "order", "loads", "quick")
    given = {name: getattr(chosen, name) for name in known if getattr(chosen, name) is not None}
    _check_options(parser, study, given)
    petsc = _petsc_options(parser, rest)
    out = chosen.out or Path("out") / study.name
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
    from thinlayer import startup

    startup.ignore_working_folder()
    from mpi4py import MPI
    from petsc4py import PETSc

    from forms import LawError
    from geometry import GeometryError
    from thinlayer import ModelError, OptionError, SolveError
    from thinlayer.record import Record

    for name, value in petsc.items():
        PETSc.Options().setValue(name, value)
    record = Record(study.name, out, given | petsc, resume=resume)
    root = MPI.COMM_WORLD.rank == 0
    startup.raise_on_interrupt()
    try:
        record.check_resume()
        importlib.import_module(f"studies.{study.name}").run(record, **given)
    except (GeometryError, LawError, ModelError, OptionError) as error:
        return _stop(root, BAD_INPUT, f"{type(error).__name__}: {error}")
    except SolveError as error:
        record.close(str(error))
        return _stop(root, SOLVE_FAILED, f"{error}\nwhat was done is kept in {out}")
    except KeyboardInterrupt:
        record.close("interrupted")
        return _stop(root, INTERRUPTED, f"interrupted; what was done is kept in {out}, --resume continues")
    except BaseException as error:
        _abort(MPI.COMM_WORLD, error)
    record.close()
    if root:
        print("\n".join(f"{'ok  ' if check.passed else 'FAIL'} {check}" for check in record.checks))
        print(f"written to {out}")
    if record.failed:
        return _stop(root, CHECK_FAILED, "checks failed: " + "; ".join(str(check) for check in record.failed))
    return OK


def _stop(root: bool, status: int, message: str) -> int:
    if root:
        print(f"thinlayer: {message}", file=sys.stderr)
    return status


def _abort(comm: Any, error: BaseException) -> NoReturn:
    """An unexpected error may be on one rank only: the others must not wait for it for ever."""
    if comm.size > 1:
        from thinlayer.abort import abort

        abort(error)
    raise error


def _info() -> int:
    from thinlayer.record import versions

    found = versions()
    width = max(map(len, found))
    print("\n".join(f"{name:<{width}}  {version}" for name, version in found.items()))
    return OK
