"""The arguments of the command line: the commands, the options of the studies and of an estimate, PETSc options."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from thinlayer.running.catalogue import Study, studies

STATUSES = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 wrong input, nothing is written; 3 a solve failed, "
    "results so far are kept; 5 a file could not be written; 70 a defect, with its traceback; 130 interrupted."
)
PETSC_PREFIX = "-thinlayer_"
VERBOSE = "show the attempts of solves; twice: their steps as well"
WORDS = {
    "layer": (
        "WORDS",
        "its law, real moduli and thickness: 'LinearElastic E=2000 nu=0.4 eps=0.2', of a seam 'NAME: ...'",
    ),
    "body": ("WORDS", "the law of the bodies: 'E=210e3 nu=0.3', of a region 'NAME: ...'"),
    "support": ("WORDS", "what a place is held by: LEFT=0, 'RIGHT x=0 y=0.1', '(40,0) y=0'"),
    "load": ("WORDS", "a traction, TOP=0,-50 or 'TOP pressure=5', or a force at a vertex, '(20,10)=0,-300'"),
    "body-force": ("WORDS", "a force per volume: 0,-1e-5, of a region NAME=0,-1e-5"),
    "goal": (
        "WORDS",
        "what else may change: compliance, 'reaction place=LEFT direction=1,0', 'tip: displacement x=40,0 direction=0,1'",
    ),
    "tolerance": (
        "WORDS",
        "the change that is allowed: 0.05 (in traction), jump=0.05, or of a goal: the thickness is told",
    ),
}  # options that may be repeated
ENTRIES = {
    "S": ("NAME", "the set of facets where the layer is (default: S)"),
    "upper": ("NAMES", "regions above S"),
    "lower": ("NAMES", "regions below S"),
    "direction": ("X,Y", "vector to the upper side, for S inside one body"),
    "scale": ("FACTOR", "on the coordinates of the mesh file, 1e3 from m to mm"),
    "units": ("L,P", "units of lengths and of stresses, for pictures: mm,MPa"),
    "plane": ("KIND", "strain (default), stress or axisymmetric"),
    "element": ("NAME", "P2, Q2 or S2"),
    "bodies": ("KIND", "kept, or extended: bodies at their true places, for a curved S"),
    "times": ("T,T", "ends of time steps, for laws with a rate or a memory: 0.5,1,2"),
}


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
        one.add_argument("-v", "--verbose", action="count", default=0, help=VERBOSE)
    _add_estimate(commands)
    return parser


def _add_estimate(commands: Any) -> None:
    """The command `estimate`: options that are entries of a description replace those of the file."""
    one = commands.add_parser(
        "estimate",
        allow_abbrev=False,
        help="tell by how much the answer changes if the mesh of a layer is dropped",
        usage="%(prog)s [MESH] [DESCRIPTION] [options] [PETSc options]",
        description="May you drop the layer, and by how much does the answer change? MESH is a file that meshio reads, "
        "DESCRIPTION one in TOML, which may name the mesh file itself, or in Python. Options add to it, or replace what it "
        f"has. PETSc options start with {PETSC_PREFIX}.",
        epilog=STATUSES.replace("all checks of the study hold; 1 a check failed", "told"),
    )
    one.add_argument("files", nargs="+", metavar="FILE", help="the mesh file, a description (.toml, .py), or both")
    for name, (metavar, text) in WORDS.items():
        one.add_argument(f"--{name}", action="append", default=[], metavar=metavar, help=text)
    for name, (metavar, text) in ENTRIES.items():
        one.add_argument(f"--{name}", metavar=metavar, help=text)
    one.add_argument("--bonded", action="store_true", help="ask as well if the layer may be ignored altogether")
    one.add_argument("--out", metavar="DIR", help="folder for tables and pictures (default: out/estimate/NAME)")
    one.add_argument("-v", "--verbose", action="count", default=0, help=VERBOSE)


def refuse(parser: argparse.ArgumentParser, rest: Sequence[str]) -> None:
    """End with an error if arguments are left that no command knows."""
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")


def folder(parser: argparse.ArgumentParser, chosen: argparse.Namespace, name: Path) -> Path:
    """The folder of a run: --out, or one of a name in out."""
    if chosen.out is not None and not chosen.out.strip():
        parser.error("--out is empty; give the name of a folder")
    return Path("out") / name if chosen.out is None else Path(chosen.out)


def uses(study: Study, word: str) -> str | None:
    """Words for an option that another study has, and this one does not use."""
    if not any(word == f"--{option}" for one in studies().values() for option in one.options):
        return None
    used = ", ".join(f"--{option}" for option in study.options) or "none"
    return f"study {study.name} does not use {word}; it uses: {used}"


def petsc_options(
    parser: argparse.ArgumentParser, rest: Sequence[str], why: Callable[[str], str | None] = lambda word: None
) -> dict[str, str | None]:
    """PETSc options, given as -thinlayer_NAME [VALUE] ..., by their names; ends with an error at any other argument.

    Args:
        parser: prints the error.
        rest: the arguments.
        why: words for an argument that is none of these, or None.
    """
    options: dict[str, str | None] = {}
    name = None
    for word in rest:
        if word.startswith(PETSC_PREFIX):
            name = word[1:]
            options[name] = None
        elif name is not None and options[name] is None and not word.startswith("--"):
            options[name] = word
        else:
            parser.error(why(word) or f"unrecognized argument {word!r}; PETSc options start with {PETSC_PREFIX}")
    return options
