"""The command line: estimates how results change without a layer's mesh, runs and draws studies, prints versions.

DOLFINx and PETSc are imported only when something is computed, as their import takes seconds.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from thinlayer.running.catalogue import list_text, studies
from thinlayer.running.process import (
    BAD_INPUT,
    OK,
    UNFINISHED,
    Petsc,
    error_text,
    is_rank_0,
    print_error,
    restore_signals,
    run_with_mpi,
    run_with_record,
)
from thinlayer.system.version import VERSION, error_reason, print_safely, two_columns, version_of

if TYPE_CHECKING:
    from thinlayer.running.description import Description
    from thinlayer.running.record import Record

EXIT_STATUS_HELP = (
    "Exit status: 0 all checks of the study hold; 1 a check failed; 2 wrong input, nothing is written; 3 not finished, "
    "results so far are kept: a solve failed, a file could not be written, an interrupt, or a defect, with its traceback."
)
PAGE_STATUSES = "0 all numbers hold; 1 one does not; 2 wrong input; 3 a study is not finished, as the page shows."
RESUMING = "Started again, it keeps the runs that are done with the same options and code, and goes on with the others."
PETSC_PREFIX = "-thinlayer_"
CommandParsers: TypeAlias = "argparse._SubParsersAction[Parser]"
CommandFunction = Callable[["Parser", argparse.Namespace, Petsc], int]


class Parser(argparse.ArgumentParser):
    """Argument parser that suggests a correction for a misspelt command, choice or option.

    Unlike argparse's own, it does not accept abbreviated options.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self.set_defaults(parser=self)

    def _check_value(self, action: argparse.Action, value: object) -> None:
        if action.choices is not None and value not in action.choices:
            kind = str(action.metavar or action.dest).lower()
            raise argparse.ArgumentError(None, _unknown_name_text(kind, value, action.choices))

    def petsc_options(self, unknown_words: Sequence[str]) -> dict[str, str | None]:
        """Return the PETSc options among words of the command line: name -> value, or None for an option without one.

        Each stands on the command line as `-thinlayer_NAME` or `-thinlayer_NAME VALUE`; the returned name is
        `thinlayer_NAME`. Any other word ends the process with an error message.

        Args:
            unknown_words: words of the command line that the parser itself does not know.
        """
        options: dict[str, str | None] = {}
        name = ""
        for word in unknown_words:
            if word.startswith(PETSC_PREFIX):
                options[name := word[1:]] = None
            elif name and options[name] is None and not word.startswith("--"):
                options[name] = word
            elif word.startswith("--"):
                self.error(_unknown_name_text("option", word.partition("=")[0], self._option_string_actions))
            else:
                prefix_hint = f"; PETSc options start with {PETSC_PREFIX}" if word.startswith("-") else ""
                self.error(f"unrecognized argument {word!r}; --help has all{prefix_hint}")
        return options


def _unknown_name_text(kind: str, name: object, choices: Iterable[object]) -> str:
    from forms.base import unknown_name_message  # imported late: it takes a second

    return unknown_name_message(kind, name, [choice for choice in map(str, choices) if choice != "-h"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Carry out a command line and return the exit status of the process.

    Args:
        arguments: words of the command line after the program's name; None: those with which this process was started.

    Returns:
        0 after success, 1 if a check of a study failed, 2 after wrong input, 3 if a study did not finish.

    Raises:
        SystemExit: the command line itself is wrong (its status is then 2), or asks for help.
        Exception: any other error than wrong input or a failed solve, such as a bug of the package.
    """
    words = [*(sys.argv[1:] if arguments is None else arguments)]
    # several studies, `run A B` or `run --all`, have other options than one, `run A --quick`
    is_batch = words[:1] == ["run"] and ("--all" in words or [word[:1] == "-" for word in words[1:3]] == [False, False])
    parser = _batch_parser() if is_batch else command_line_parser()
    if "_ARGCOMPLETE" in os.environ:  # a shell asks for the words that may come next
        with suppress(ImportError):
            importlib.import_module("argcomplete").autocomplete(parser)
    args, unknown_words = parser.parse_known_args(words[is_batch:])
    return int(args.work(args.parser, args, args.parser.petsc_options(unknown_words)))


def start() -> int:
    """Run `main` with the command line of this process, and return its exit status.

    An exception that `main` raises is printed, and the exit status is then 3.
    """
    streams = (sys.stdout, sys.stderr)  # None if closed
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w", encoding="utf-8") for stream in streams)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for characters that its encoding lacks
    try:
        return main()
    except (KeyboardInterrupt, OSError) as error:
        return print_error(True, UNFINISHED, error_reason(error))
    except Exception as error:
        import traceback

        traceback.print_exception(error)
        return print_error(True, UNFINISHED, "this is a defect of thinlayer, or of what it is installed with")


def command_line_parser() -> argparse.ArgumentParser:
    """Make the parser of the command line: all commands, and the options of each study."""
    prog = "thinlayer" if Path(sys.argv[0]).stem == "thinlayer" else "python3 -m thinlayer"
    parser = Parser(prog=prog, description="Thin soft layers, meshed or replaced by their interface law.")
    parser.add_argument("-V", "--version", action="store_true", help="print the versions of thinlayer and of DOLFINx")
    parser.set_defaults(work=_run_without_command)
    commands = parser.add_subparsers(metavar="COMMAND")
    estimate = _add_run_options(_add_command(commands, "estimate", _run_estimate, "joint.toml --set layer.eps=0.1"))
    file_help = "a file in TOML; with --new a mesh file"
    estimate.add_argument("description", type=Path, metavar="DESCRIPTION", help=file_help)
    set_help = "replace a key of the description, as layer.E=2e3 or 'tractions.RIGHT=[60, 0]'; may be repeated"
    question = estimate.add_argument_group("the question", "These options replace keys of the description.")
    question.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=set_help)
    replaces_key: dict[str, Any] = {"dest": "set", "action": "append"}
    eps_help = "thickness of the layer, in the description's unit"
    question.add_argument("--eps", type="layer.eps={}".format, metavar="EPS", help=eps_help, **replaces_key)
    tolerance_help = "largest relative change that is allowed, as 0.05: prints the thickness with this change"
    question.add_argument("--tolerance", type="tolerance={}".format, metavar="T", help=tolerance_help, **replaces_key)
    modes = estimate.add_mutually_exclusive_group()
    modes.add_argument("--check", action="store_true", help="print what is read, and the sum of loads; solve nothing")
    modes.add_argument("--new", action="store_true", help="print a description to fill in, with a mesh file's names")
    _add_json_option(modes)
    run = _add_command(commands, "run", _run_study, "fig6_stratified --quick")
    study_parsers = run.add_subparsers(dest="study", metavar="STUDY")
    for study in studies().values():
        script = _add_run_options(_add_command(study_parsers, study.name, _run_study, "--out DIR", study.summary))
        for name, option_arguments in study.options.items():
            script.add_argument(f"--{name}", default=None, **option_arguments)
        script.add_argument("--resume", action="store_true", help="go on with the sweeps of a killed run, same options")
    description = "Run the studies of the paper, and write a page with its numbers beside those that are computed."
    page_parser = _add_command(commands, "reproduce", _run_batch, "--quick", f"{description} {RESUMING}")
    page_parser.epilog = f"Exit status: {PAGE_STATUSES} {page_parser.epilog}"
    _add_batch_options(page_parser, Path("out", "reproduce"))
    draw = _add_run_options(_add_command(commands, "draw", _draw_study, "fig6_stratified"))
    drawn = [study.name for study in studies().values() if study.drawn]
    draw.add_argument("study", metavar="STUDY", choices=drawn, help="name of a study; the command list prints all")
    _add_command(commands, "schema", _print_schema, "> thinlayer.schema.json")
    _add_json_option(_add_command(commands, "list", _print_studies, "--json"))
    _add_json_option(_add_command(commands, "info", _print_versions, "--json"))
    return parser


def _batch_parser() -> Parser:
    """Make the parser for the command `run` when it is followed by several names of studies, or by --all."""
    description = f"Run several studies, each in its folder DIR/STUDY. {RESUMING}"
    parser = Parser(prog="python3 -m thinlayer run", description=description, epilog=EXIT_STATUS_HELP)
    parser.add_argument("studies", nargs="*", metavar="STUDY", choices=studies(), help="names of studies")
    drawn_names = [study.name for study in studies().values() if study.drawn]
    parser.add_argument("--all", action="store_const", const=drawn_names, help="all studies that draw pictures")
    parser.set_defaults(work=_run_batch)
    _add_batch_options(parser, Path("out"))
    return parser


def _add_batch_options(parser: Parser, out: Path) -> None:
    """Add to `parser` the options --quick, --out and -j, which commands that run several studies have.

    `out` is the default of --out, the folder of the results.
    """
    parser.add_argument("--quick", action="store_true", help="coarser meshes and fewer rows, of studies that have both")
    parser.add_argument("--out", type=_as_path, default=out, metavar="DIR", help=f"folder of the runs (default: {out})")
    parser.add_argument("-j", type=int, metavar="N", help="studies at a time (default: as many as cores)")


def _add_command(commands: CommandParsers, name: str, work: CommandFunction, example: str, what: str = "") -> Parser:
    """Add a command to the command line and return the parser of its arguments.

    Args:
        commands: argparse's object to which a parser for each command is added.
        name: name of the command.
        work: function that carries out the command.
        example: arguments of the command in the example that its help shows.
        what: sentence that describes the command in its help; "": the docstring of `work`.
    """
    what = what or work.__doc__ or name
    summary, epilog = what.rstrip(".").replace("%", "%%"), f"Example: %(prog)s {example}"  # argparse formats both
    parser = commands.add_parser(name, help=summary[0].lower() + summary[1:], description=what, epilog=epilog)
    parser.set_defaults(work=work)
    return parser


def _add_run_options(parser: Parser) -> Parser:
    """Add to `parser` the options --verbose, --quiet and --out, which commands that compute have, and return `parser`.

    Its help also gets a sentence about PETSc options and the list of exit statuses.
    """
    parser.description = f"{parser.description} PETSc options start with {PETSC_PREFIX}, as {PETSC_PREFIX}ksp_type cg."
    parser.epilog = f"{EXIT_STATUS_HELP} {parser.epilog}"
    output = parser.add_argument_group("output")
    level = output.add_mutually_exclusive_group()
    level.add_argument("-v", "--verbose", action="count", default=0, help="show attempts of solves; twice: their steps")
    quiet_help = "print no progress and no tables, only errors, warnings and checks that fail"
    level.add_argument("-q", "--quiet", dest="verbose", action="store_const", const=-1, help=quiet_help)
    out_help = "folder of tables and pictures (default: out/STUDY, out/estimate/NAME)"
    output.add_argument("--out", type=_as_path, metavar="DIR", help=out_help)
    return parser


def _as_path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("it is empty; . is the working folder")
    return Path(text)


def _add_json_option(group: argparse._ActionsContainer) -> None:
    group.add_argument("--json", action="store_true", help="print the answer as JSON, nothing else on standard output")


def _print_answer(args: argparse.Namespace, json_data: object, text: str) -> int:
    """Print the answer of a command on rank 0, and return exit status 0.

    Args:
        args: options of the command line, of which --json decides between the two forms.
        json_data: what is printed with --json, as JSON.
        text: what is printed without --json.
    """
    if is_rank_0():
        print_safely(json.dumps(json_data, indent=1, default=str) if args.json else text)
    return OK


def _run_without_command(parser: Parser, args: argparse.Namespace, _: Petsc) -> int:
    if not args.version:
        parser.print_help()
        return BAD_INPUT
    print_safely(f"thinlayer {VERSION} (DOLFINx {version_of('fenics-dolfinx')})")
    return OK


def _print_studies(_: Parser, args: argparse.Namespace, __: Petsc) -> int:
    """List the studies in groups, with their times on one core (benchmarks only with --json)."""
    return _print_answer(args, {name: vars(study) for name, study in studies().items()}, list_text())


def _print_schema(_: Parser, __: argparse.Namespace, ___: Petsc) -> int:
    """Print the JSON schema of descriptions, by which editors complete and check them."""
    from thinlayer.running.description import description_schema

    print_safely(json.dumps(description_schema(), indent=1, ensure_ascii=False))
    return OK


def _print_versions(_: Parser, args: argparse.Namespace, __: Petsc) -> int:
    """Print the versions of the packages on which results depend."""
    from thinlayer.running.provenance import package_versions

    restore_signals()
    return _print_answer(args, package_versions(), two_columns(package_versions()))


def _draw_study(parser: Parser, args: argparse.Namespace, _: Petsc) -> int:
    """Draw the pictures of a study again, from the tables that an earlier run has written."""
    out = args.out or Path("out", args.study)
    from forms.base import InputError
    from thinlayer.running.record import Record

    restore_signals()
    try:
        record = Record(args.study, out, {})
        record.require_run()
        importlib.import_module(f"studies.{args.study}").draw(record)
    except (InputError, FileNotFoundError, KeyError) as error:
        run_command = f"{parser.prog.removesuffix('draw')}run {args.study}"
        parser.error(f"{out} has no whole run of {args.study} ({error}); run it first: {run_command}")
    if args.verbose >= 0:
        print_safely(f"drawn again in {out}")
    return OK


def _run_study(parser: Parser, args: argparse.Namespace, petsc: Petsc) -> int:
    """Run one study; several names, or --all, run several studies. STUDY --help shows the options of a study."""
    if args.study is None:
        parser.error(f"name a study:\n{list_text()}")
    study = studies()[args.study]
    options = {name: value for name, value in vars(args).items() if name in study.options and value is not None}

    def run_and_draw(record: Record) -> None:
        from thinlayer.running.provenance import constants

        module = importlib.import_module(f"studies.{study.name}")
        record.parameters = constants(module)
        module.run(record, **options)
        record.say_tables()
        if study.drawn:
            module.draw(record)

    out = args.out or Path("out", study.name)
    return run_with_record(study.name, out, run_and_draw, options, petsc, args.verbose, resume=args.resume)


def _run_batch(parser: Parser, args: argparse.Namespace, petsc: Petsc) -> int:
    """Run the studies that the parsed command line `args` names, or those of the paper; return the exit status.

    The command `run` gives the names. The command `reproduce` has none: it runs the studies of the paper and writes a
    page of their numbers. `petsc`, the PETSc options, must be empty, as they belong to one study; else `parser` ends
    the process.
    """
    if petsc:
        parser.error("PETSc options are those of one study; run it by itself")

    def run_studies() -> int:
        from thinlayer.running.batch import Job, quick_options, run_jobs
        from thinlayer.running.reproduce import reproduce

        if "studies" not in args:
            return reproduce(args.out, quick=args.quick, at_a_time=args.j)
        quick, batch_studies = args.quick, (studies()[name] for name in args.all or args.studies)
        durations = {study.name: study.quick if quick else study.full for study in batch_studies}
        jobs = [Job(name, quick_options(name, quick), args.out / name, seconds) for name, seconds in durations.items()]
        return run_jobs(jobs, args.out, args.j)

    return run_with_mpi(run_studies, petsc={}, verbose=0)


def _run_estimate(parser: Parser, args: argparse.Namespace, petsc: Petsc) -> int:
    """Estimate what changes if a layer is not meshed. Keys of the file: thinlayer/docs/reference/description.md"""
    run_function = partial(run_with_mpi, petsc=petsc, verbose=args.verbose)
    if args.new:
        if args.set:
            parser.error("--new reads a mesh file, which has no keys to --set")
        return run_function(partial(_print_template, args))
    from forms.base import InputError
    from thinlayer.running.description import Description

    try:
        description = Description.read(args.description, args.set)
    except InputError as error:
        return print_error(is_rank_0(), BAD_INPUT, error_text(error, args.verbose))
    if args.check:
        return run_function(partial(_print_summary, args, description))

    def run_estimate(record: Record) -> None:
        from thinlayer.running.estimation import run

        record.quiet |= args.json
        with description.file_table.locate_errors():
            run(record, description, args.description)
        if args.json:
            _print_answer(args, record.results, "")

    out = args.out or Path("out", "estimate", args.description.stem)
    return run_with_record("estimate", out, run_estimate, {"set": args.set}, petsc, args.verbose)


def _print_template(args: argparse.Namespace) -> int:
    from thinlayer.running.template import template_text

    return _print_answer(args, None, template_text(args.description))


def _print_summary(args: argparse.Namespace, description: Description) -> int:
    from thinlayer.running.case import DescribedCase
    from thinlayer.running.summary import summarise

    with description.file_table.locate_errors():
        return _print_answer(args, None, summarise(DescribedCase.from_description(description)))
