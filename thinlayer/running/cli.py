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
from thinlayer.running.arguments import command_line, folder, petsc_options, refuse, uses
from thinlayer.running.catalogue import studies
from thinlayer.running.recorded import (
    BAD_INPUT,
    CRASHED,
    INTERRUPTED,
    NOT_WRITTEN,
    OK,
    not_written,
    recorded,
    set_signals,
    stop,
)
from thinlayer.running.startup import is_first

if TYPE_CHECKING:
    from thinlayer.running.record import Record


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
    if chosen.command == "estimate":
        return _estimate(parser, chosen, rest)
    return _run(parser, chosen, rest)


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


def _draw(parser: argparse.ArgumentParser, chosen: argparse.Namespace) -> int:
    out = folder(parser, chosen, Path(chosen.study))
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


def _run(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    study = studies()[chosen.study]
    petsc = petsc_options(parser, rest, lambda word: uses(study, word))
    given = {name: getattr(chosen, name) for name in study.options if getattr(chosen, name) is not None}

    def work(record: Record) -> None:
        module = importlib.import_module(f"studies.{study.name}")
        module.run(record, **given)
        module.draw(record)

    out = _free_folder(parser, folder(parser, chosen, Path(study.name)))
    return recorded(study.name, out, work, options=given, petsc=petsc, resume=chosen.resume, verbose=chosen.verbose)


def _estimate(parser: argparse.ArgumentParser, chosen: argparse.Namespace, rest: Sequence[str]) -> int:
    petsc = petsc_options(parser, rest)
    from forms.base import InputError
    from thinlayer.running.asked import Asked

    try:
        asked = Asked.of(chosen)
    except InputError as error:
        return stop(is_first(), BAD_INPUT, f"{type(error).__name__}: {error}")

    def work(record: Record) -> None:
        from thinlayer.running.estimation import run

        run(record, asked)

    out = _free_folder(parser, folder(parser, chosen, Path("estimate") / asked.name))
    return recorded("estimate", out, work, options=asked.options, petsc=petsc, resume=None, verbose=chosen.verbose)


def _free_folder(parser: argparse.ArgumentParser, out: Path) -> Path:
    if out.exists() and not out.is_dir():
        parser.error(f"--out {out} is a file")
    return out


def _info() -> int:
    from thinlayer.running.provenance import versions

    found = versions()
    set_signals()
    width = max(map(len, found))
    say("\n".join(f"{name:<{width}}  {version}" for name, version in found.items()))
    return OK
