"""The arguments of the command line: the commands, the options of the studies, PETSc options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from thinlayer.running.catalogue import Study, studies

STATUSES = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 wrong input, nothing is written; 3 a solve failed, "
    "results so far are kept; 5 a file could not be written; 70 a defect, with its traceback; 130 interrupted."
)
PETSC_PREFIX = "-thinlayer_"


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
            "-v", "--verbose", action="count", default=0, help="show the attempts of solves; twice: their steps as well"
        )
    return parser


def refuse(parser: argparse.ArgumentParser, rest: Sequence[str]) -> None:
    """End with an error if arguments are left that no command knows."""
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")


def folder(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> Path:
    """The folder of a run: --out, or out/STUDY."""
    if chosen.out is not None and not chosen.out.strip():
        parser.error("--out is empty; give the name of a folder")
    return Path("out") / chosen.study if chosen.out is None else Path(chosen.out)


def petsc_options(parser: argparse.ArgumentParser, study: Study, rest: Sequence[str]) -> dict[str, str | None]:
    """PETSc options, given as -thinlayer_NAME [VALUE] ..., by their names; ends with an error at any other argument."""
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
