"""The command line: estimates what dropping a layer costs; lists the studies, runs one, draws it again; prints versions.

DOLFINx and PETSc are imported only when something is computed, as that takes seconds.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from thinlayer.files.say import say
from thinlayer.running.catalogue import studies
from thinlayer.running.process import (
    BAD_INPUT,
    CRASHED,
    INTERRUPTED,
    NOT_WRITTEN,
    OK,
    is_first,
    not_written,
    recorded,
    set_signals,
    stop,
)

if TYPE_CHECKING:
    from thinlayer.running.record import Record

STATUSES = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 wrong input, nothing is written; 3 a solve failed, "
    "results so far are kept; 5 a file could not be written; 70 a defect, with its traceback; 130 interrupted."
)
PETSC_PREFIX = "-thinlayer_"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status, see `STATUSES`. A defect raises its exception, see `start`."""
    parser = command_line()
    chosen, rest = parser.parse_known_args(arguments)
    if chosen.command in ("run", "estimate"):
        petsc = _petsc_options(parser, rest)
        return (_run if chosen.command == "run" else _estimate)(parser, chosen, petsc)
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    if chosen.command == "draw":
        return _draw(parser, chosen)
    if chosen.command == "info":
        from thinlayer.running.provenance import versions

        told = versions()
        set_signals()
    else:
        told = {study.name: study.summary for study in studies().values()}
    width = max(map(len, told))
    say("\n".join(f"{name:<{width}}  {text}" for name, text in told.items()))
    return OK


def start() -> int:
    """`main` for a process of its own: returns an exit status for every exception, too."""
    try:
        return main()
    except KeyboardInterrupt:
        return stop(True, INTERRUPTED, "interrupted")
    except Exception as error:
        import traceback

        traceback.print_exception(error)
        return stop(True, CRASHED, "this is a defect of thinlayer, or of what it is installed with")


def command_line() -> argparse.ArgumentParser:
    """The parser of the commands and of the studies' options."""
    parser = argparse.ArgumentParser(
        prog="python3 -m thinlayer", description="Thin soft layers, meshed or replaced by their interface law."
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="list the studies")
    commands.add_parser("info", help="print the versions of the packages that results depend on")
    draw = commands.add_parser("draw", help="draw the pictures of a study again, from the tables of an earlier run")
    draw.add_argument("study", metavar="STUDY", choices=studies(), help="name of a study; the command list prints all")
    draw.add_argument("--out", metavar="DIR", help="folder of the run (default: out/STUDY)")
    run = commands.add_parser("run", help="run a study", description="Run a study; STUDY --help shows its options.")
    names = run.add_subparsers(dest="study", required=True, metavar="STUDY")
    works = {}
    for study in studies().values():
        works[study.name] = one = names.add_parser(
            study.name,
            allow_abbrev=False,  # --h would print the help
            usage="%(prog)s [options] [PETSc options]",
            description=f"{study.summary} PETSc options start with {PETSC_PREFIX}, as {PETSC_PREFIX}ksp_type cg.",
            epilog=STATUSES,
        )
        for name, details in study.options.items():
            one.add_argument(f"--{name}", default=None, **details)
        one.add_argument("--resume", action="store_true", help="continue a run that was killed, with the same options")
    works["estimate/NAME"] = estimate = commands.add_parser(
        "estimate",
        allow_abbrev=False,
        help="tell by how much the answer changes if the mesh of a layer is dropped",
        usage="%(prog)s DESCRIPTION [options] [PETSc options]",
        description="May you drop the layer, and by how much does the answer change? DESCRIPTION is a file in TOML, which "
        f"names a mesh file; thinlayer/guide/estimate.md has its keys. PETSc options start with {PETSC_PREFIX}.",
        epilog=STATUSES.replace("all checks of the study hold; 1 a check failed", "told"),
    )
    estimate.add_argument("description", type=Path, metavar="DESCRIPTION", help="the description, a file in TOML")
    keys = "a key of the description anew, as layer.E=2e3 or 'tractions.RIGHT=[60, 0]'; may be repeated"
    estimate.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=keys)
    for name, one in works.items():
        one.add_argument("--out", metavar="DIR", help=f"folder for tables and pictures (default: out/{name})")
        verbose = "show the attempts of solves; twice: their steps as well"
        one.add_argument("-v", "--verbose", action="count", default=0, help=verbose)
    return parser


def _petsc_options(parser: argparse.ArgumentParser, rest: Sequence[str]) -> dict[str, str | None]:
    """PETSc options, given as -thinlayer_NAME [VALUE] ..., by their names; ends with an error at any other argument."""
    options: dict[str, str | None] = {}
    name = None
    for word in rest:
        if word.startswith(PETSC_PREFIX):
            name = word[1:]
            options[name] = None
        elif name is not None and options[name] is None and not word.startswith("--"):
            options[name] = word
        else:
            parser.error(f"unrecognized argument {word!r}; --help has all; PETSc options start with {PETSC_PREFIX}")
    return options


def _folder(parser: argparse.ArgumentParser, chosen: argparse.Namespace, name: str) -> Path:
    """The folder of a run: --out, or one of a name in out."""
    out = Path("out") / name if chosen.out is None else Path(chosen.out)
    if chosen.out is not None and not chosen.out.strip():
        parser.error("--out is empty; give the name of a folder")
    if out.exists() and not out.is_dir():
        parser.error(f"--out {out} is a file")
    return out


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    out = _folder(parser, chosen, chosen.study)
    if not any(out.glob("*.csv")):
        parser.error(f"no table in {out}; run the study first")
    from thinlayer import ModelError
    from thinlayer.running.record import Record

    set_signals()
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
        return stop(True, NOT_WRITTEN, not_written(error))
    say(f"drawn again in {out}")
    return OK


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, petsc: dict[str, str | None]) -> int:
    study = studies()[chosen.study]
    given = {name: getattr(chosen, name) for name in study.options if getattr(chosen, name) is not None}

    def work(record: Record) -> None:
        module = importlib.import_module(f"studies.{study.name}")
        module.run(record, **given)
        module.draw(record)

    out = _folder(parser, chosen, study.name)
    return recorded(study.name, out, work, options=given, petsc=petsc, resume=chosen.resume, verbose=chosen.verbose)


def _estimate(parser: argparse.ArgumentParser, chosen: argparse.Namespace, petsc: dict[str, str | None]) -> int:
    from forms.base import InputError
    from thinlayer.describing.description import Description

    try:
        given = Description.read(chosen.description, chosen.set)
    except InputError as error:
        return stop(is_first(), BAD_INPUT, f"{type(error).__name__}: {error}")

    def work(record: Record) -> None:
        from thinlayer.running.estimation import run

        run(record, given, chosen.description)

    out = _folder(parser, chosen, f"estimate/{chosen.description.stem}")
    options = {"set": chosen.set} if chosen.set else {}
    return recorded("estimate", out, work, options=options, petsc=petsc, resume=None, verbose=chosen.verbose)
