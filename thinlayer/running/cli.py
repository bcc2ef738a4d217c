"""The command line: estimates what dropping a layer costs; lists the studies, runs one, draws it again; prints versions.

DOLFINx and PETSc are imported only when something is computed, as that takes seconds.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thinlayer.running.process import BAD_INPUT, OK, UNFINISHED, is_first, recorded, set_signals, stop
from thinlayer.system.words import reason, say


@dataclass(frozen=True)
class Study:
    """A study script.

    Attributes:
        name: module name in `studies`.
        summary: first line of its docstring.
        options: name of a keyword argument of its `run` -> arguments of `ArgumentParser.add_argument` for it.
        drawn: whether it has pictures, which its `draw` makes of its tables; benchmarks have tables alone.
    """

    name: str
    summary: str
    options: dict[str, dict[str, Any]]
    drawn: bool


@cache
def studies() -> dict[str, Study]:
    """All studies by name."""
    found = {}
    for path in sorted((Path(__file__).parents[2] / "studies").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        if run := functions.get("run"):
            text, summary = ast.get_docstring(run) or "", (ast.get_docstring(tree) or "").partition("\n")[0]
            options = {one.arg: _option(one, text) for one in run.args.kwonlyargs}
            found[path.stem] = Study(path.stem, summary, options, "draw" in functions)
    return found


def _option(argument: ast.arg, text: str) -> dict[str, Any]:
    """Arguments of `add_argument` for a keyword argument of `run`.

    Args:
        argument: the keyword argument; its annotation is `bool`, `Sequence[float]` (thicknesses) or `Literal[...]`.
        text: docstring of `run`, in which its description becomes the help of the option.
    """
    line = re.search(rf"^\s+{argument.arg}: (.*)$", text, re.MULTILINE)
    found: dict[str, Any] = {"help": line[1].replace("%", "%%") if line else None}
    match ast.unparse(argument.annotation) if argument.annotation else "":
        case "bool":
            return found | {"action": "store_true"}
        case "Sequence[float]":
            return found | {"nargs": "+", "type": float, "metavar": "E"}
        case kind:
            allowed = tuple(ast.literal_eval(kind.removeprefix("Literal")))
            return found | {"choices": allowed, "type": type(allowed[0])}


if TYPE_CHECKING:
    from thinlayer.running.record import Record

STATUSES = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 wrong input, nothing is written; 3 not finished, "
    "results so far are kept: a solve failed, a file could not be written, an interrupt, or a defect, with its traceback."
)
PETSC_PREFIX = "-thinlayer_"
Petsc = Mapping[str, str | None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status, see `STATUSES`. A defect raises its exception, see `start`."""
    parser = command_line()
    chosen, rest = parser.parse_known_args(arguments)
    status: int = chosen.work(parser, chosen, _petsc_options(parser, rest))
    return status


def start() -> int:
    """`main` for a process of its own: returns an exit status for every exception, too."""
    try:
        return main()
    except KeyboardInterrupt:
        return stop(True, UNFINISHED, "interrupted")
    except Exception as error:
        import traceback

        traceback.print_exception(error)
        return stop(True, UNFINISHED, "this is a defect of thinlayer, or of what it is installed with")


def command_line() -> argparse.ArgumentParser:
    """The parser of the commands and of the studies' options."""
    about = "Thin soft layers, meshed or replaced by their interface law."
    parser = argparse.ArgumentParser(prog="python3 -m thinlayer", description=about)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    shown = commands.add_parser("list", help="list the studies; benchmarks, which draw nothing, are not among them")
    shown.add_argument("--markdown", action="store_true", help="as the table of the README")
    shown.set_defaults(work=_list)
    info = commands.add_parser("info", help="print the versions of the packages that results depend on")
    info.set_defaults(work=_info)
    what = "draw the pictures of a study again, from the tables of an earlier run"
    draw = _add(commands, "draw", _draw, what, help=what)
    drawn = [study.name for study in studies().values() if study.drawn]
    draw.add_argument("study", metavar="STUDY", choices=drawn, help="name of a study; the command list prints all")
    run = commands.add_parser("run", help="run a study", description="Run a study; STUDY --help shows its options.")
    names = run.add_subparsers(dest="study", required=True, metavar="STUDY")
    for study in studies().values():
        one = _add(names, study.name, _run, study.summary)
        for name, details in study.options.items():
            one.add_argument(f"--{name}", default=None, **details)
        one.add_argument("--resume", action="store_true", help="go on with the sweeps of a killed run, same options")
    what = "tell by how much the answer changes if the mesh of a layer is dropped"
    estimate = _add(commands, "estimate", _estimate, f"{what}; thinlayer/guide/estimate.md has the keys", help=what)
    file = "a file in TOML, which names a mesh file"
    estimate.add_argument("description", type=Path, metavar="DESCRIPTION", help=file)
    keys = "a key of the description anew, as layer.E=2e3 or 'tractions.RIGHT=[60, 0]'; may be repeated"
    estimate.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=keys)
    return parser


def _add(commands: Any, name: str, work: Callable[..., int], what: str, **more: str) -> argparse.ArgumentParser:
    """The parser of a command that has a folder; --h does not print its help."""
    more["description"] = f"{what} PETSc options start with {PETSC_PREFIX}, as {PETSC_PREFIX}ksp_type cg."
    one: argparse.ArgumentParser = commands.add_parser(name, allow_abbrev=False, epilog=STATUSES, **more)
    verbose = "show the attempts of solves; twice: their steps as well"
    one.add_argument("-v", "--verbose", action="count", default=0, help=verbose)
    where = "folder of tables and pictures (default: out/STUDY, out/estimate/NAME)"
    one.add_argument("--out", type=Path, metavar="DIR", help=where)
    one.set_defaults(work=work)
    return one


def _petsc_options(parser: argparse.ArgumentParser, rest: Sequence[str]) -> dict[str, str | None]:
    """PETSc options, given as -thinlayer_NAME [VALUE] ..., by their names; ends with an error at any other argument."""
    options: dict[str, str | None] = {}
    name = ""
    for word in rest:
        if word.startswith(PETSC_PREFIX):
            options[name := word[1:]] = None
        elif name and options[name] is None and not word.startswith("--"):
            options[name] = word
        else:
            parser.error(f"unrecognized argument {word!r}; --help has all; PETSc options start with {PETSC_PREFIX}")
    return options


def _list(_: argparse.ArgumentParser, chosen: argparse.Namespace, __: Petsc) -> int:
    texts = {study.name: study.summary for study in studies().values() if study.drawn}
    if chosen.markdown:
        say("\n".join(f"| [`{name}`](studies/{name}.py) | {text} |" for name, text in texts.items()))
        return OK
    return _told(texts)


def _info(*_: object) -> int:
    from thinlayer.running.provenance import versions

    set_signals()
    return _told(versions())


def _told(texts: Mapping[str, str]) -> int:
    width = max(map(len, texts))
    say("\n".join(f"{name:<{width}}  {text}" for name, text in texts.items()))
    return OK


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace, _: Petsc) -> int:
    out = chosen.out or Path("out", chosen.study)
    from forms.base import InputError
    from thinlayer.running.record import Record

    set_signals()
    try:
        record = Record(chosen.study, out, {})
        record.check_drawn()
        importlib.import_module(f"studies.{chosen.study}").draw(record)
    except (InputError, FileNotFoundError, KeyError) as error:
        parser.error(f"{out} is not a whole run of {chosen.study}: {error}; run the study first")
    except OSError as error:
        return stop(True, UNFINISHED, reason(error))
    say(f"drawn again in {out}")
    return OK


def _run(_: argparse.ArgumentParser, chosen: argparse.Namespace, petsc: Petsc) -> int:
    study = studies()[chosen.study]
    given = {name: getattr(chosen, name) for name in study.options if getattr(chosen, name) is not None}

    def work(record: Record) -> None:
        from thinlayer.running.provenance import constants

        module = importlib.import_module(f"studies.{study.name}")
        record.parameters = constants(module)
        module.run(record, **given)
        record.say_tables()
        if study.drawn:
            module.draw(record)

    out = chosen.out or Path("out", study.name)
    return recorded(study.name, out, work, options=given, petsc=petsc, resume=chosen.resume, verbose=chosen.verbose)


def _estimate(_: argparse.ArgumentParser, chosen: argparse.Namespace, petsc: Petsc) -> int:
    from forms.base import InputError
    from thinlayer.running.description import Description

    try:
        given = Description.read(chosen.description, chosen.set)
    except InputError as error:
        return stop(is_first(), BAD_INPUT, f"{type(error).__name__}: {error}")

    def work(record: Record) -> None:
        from thinlayer.running.estimation import run

        run(record, given, chosen.description)

    out = chosen.out or Path("out", "estimate", chosen.description.stem)
    return recorded("estimate", out, work, options={"set": chosen.set}, petsc=petsc, verbose=chosen.verbose)
