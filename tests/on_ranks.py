"""Functions of the tests that run on several ranks, each in a launch of mpirun of its own.

`@on_ranks(numbers, 2, 3)` runs a test with what `numbers` gives on two ranks and on three, as `there`. The function is
collective, is found by its name in a module, gives what JSON knows, and takes a folder if it needs one: `their_folder`.

python3 -m tests.on_ranks FOLDER CASE: run a function, MODULE:NAME; keep what it gives in FOLDER.
"""

from __future__ import annotations

import fcntl
import importlib
import inspect
import json
import os
import subprocess
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mpi4py import MPI

from geometry.parallel import on_root, within
from tests.ranks import mpirun

FEW = 2  # ranks; more of them on two cores take long
PATIENCE = 1800  # s for one function, which may compile forms from an empty cache


class Asked(NamedTuple):
    """A function, MODULE:NAME, and the number of its ranks."""

    case: str
    ranks: int


def on_ranks(run: Callable[..., Any], *ranks: int) -> pytest.MarkDecorator:
    case = f"{run.__module__}:{run.__qualname__}"
    asked = [pytest.param(Asked(case, n), id=f"{n} ranks", marks=[pytest.mark.long] if n > FEW else []) for n in ranks]
    return pytest.mark.parametrize("there", asked, indirect=True)


def alone(act: Callable[[], Any]) -> None:
    """Let one rank do something by itself, before all go on. Collective."""

    def run() -> None:
        with within(MPI.COMM_SELF):
            act()

    on_root(MPI.COMM_WORLD, run)


@pytest.fixture
def there(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What the function of a test gives on several ranks."""
    asked, folder = request.param, _folder(request.param, tmp_path_factory)
    folder.mkdir(exist_ok=True)
    with open(folder / f"{asked.case}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # pytest has several workers: one runs the function, another one waits
        if not _answer(folder, asked.case).exists():
            _launch(asked, folder)
    answer = json.loads(_answer(folder, asked.case).read_text())
    if "error" in answer:
        pytest.fail(f"{asked.case} on {asked.ranks} ranks:\n{answer['error']}", pytrace=False)
    return answer["found"]


@pytest.fixture
def their_folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the function of a test has written on several ranks."""
    asked = request.node.callspec.params["there"]
    return _own(_folder(asked, tmp_path_factory), asked.case)


def _folder(asked: Asked, factory: pytest.TempPathFactory) -> Path:
    """Of all functions on so many ranks, the same for all workers of a session."""
    base = factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"on {asked.ranks} ranks"


def _answer(folder: Path, case: str) -> Path:
    return folder / f"{case}.json"


def _own(folder: Path, case: str) -> Path:
    return folder / case


def _launch(asked: Asked, folder: Path) -> None:
    """Run a function; where the ranks end or hang in it, what they said is its error."""
    try:
        done = mpirun(asked.ranks, "-m", "tests.on_ranks", str(folder), asked.case, timeout=PATIENCE)
        said = done.stdout + done.stderr
    except subprocess.TimeoutExpired as error:
        said = f"{error}\n{error.stdout}\n{error.stderr}"
    if not _answer(folder, asked.case).exists():
        _write(_answer(folder, asked.case), {"error": f"the ranks ended or hung in it:\n{said}"})


def _write(path: Path, content: dict[str, Any]) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(content))
    part.replace(path)


# ---------------------------------------------------------------- on the ranks
def main(folder: Path, case: str) -> None:
    """Run a function and write what it gives on rank 0, or the errors of all ranks."""
    found, error = None, ""
    try:
        found = _called(case, folder)
        json.dumps(found)
    except (Exception, pytest.fail.Exception):
        error = traceback.format_exc()
    errors = MPI.COMM_WORLD.gather(error)
    if errors and any(errors):
        said = "\n".join(f"rank {k}: {one}" for k, one in enumerate(errors))
        _write(_answer(folder, case), {"error": said})
    elif errors:
        _write(_answer(folder, case), {"found": found})


def _called(case: str, folder: Path) -> Any:
    module, name = case.split(":")
    run = getattr(importlib.import_module(module), name)
    if all(one.default is not one.empty for one in inspect.signature(run).parameters.values()):
        return run()
    own = _own(folder, case)
    own.mkdir(exist_ok=True)
    MPI.COMM_WORLD.barrier()
    return run(own)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
