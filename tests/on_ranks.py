"""Functions of the tests that run on several ranks, in one launch of mpirun for each worker of pytest.

`@on_ranks(numbers, 2, 3)` runs a test with what `numbers` gives on two ranks and on three, as `there`. The function is
collective, is found by its name in a module, gives what JSON knows, and takes a folder if it needs one: `their_folder`.

python3 -m tests.on_ranks FOLDER OWN: run functions, MODULE:NAME, that files in OWN name; keep what they give in FOLDER.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import importlib
import inspect
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mpi4py import MPI

from geometry.parallel import on_root, use_comm
from tests.mpirun import BROKEN, LAUNCHES, launched

FEW = 2  # ranks; more of them on two cores take long
PATIENCE = 1800  # s for one function, which may compile forms from an empty cache
POLL = 0.02  # s


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
        with use_comm(MPI.COMM_SELF):
            act()

    on_root(MPI.COMM_WORLD, run)


@pytest.fixture(scope="session")
def launches() -> Iterator[dict[int, Waiting]]:
    """Ranks of this worker that wait for functions, by their number."""
    waiting: dict[int, Waiting] = {}
    yield waiting
    for ranks in waiting.values():
        ranks.stack.close()


@pytest.fixture
def there(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, launches: dict[int, Waiting]
) -> Any:
    """What the function of a test gives on several ranks."""
    asked, folder = request.param, _folder(request.param, tmp_path_factory)
    folder.mkdir(exist_ok=True)
    with open(folder / f"{asked.case}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # pytest has several workers: one runs the function, another one waits
        if not _answer(folder, asked.case).exists():
            if asked.ranks not in launches:
                launches[asked.ranks] = Waiting(asked.ranks, folder)
            said = launches[asked.ranks].run(asked.case)
            if not _answer(folder, asked.case).exists():
                _write(_answer(folder, asked.case), {"error": f"the ranks ended or hung in it:\n{said}"})
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


class Waiting:
    """Ranks of one worker of pytest that wait for functions to run, one after the other, until the session ends.

    They read the names of functions in files, since a rank that waits in a call of MPI keeps a core busy.
    """

    def __init__(self, ranks: int, folder: Path) -> None:
        self.ranks, self.folder = ranks, folder
        self.stack = contextlib.ExitStack()
        self.process: subprocess.Popen | None = None

    def run(self, case: str) -> str:
        """Let the ranks run a function until they have written its answer; what they said where they end or hang."""
        for _ in range(LAUNCHES):
            if self.process is None or self.process.poll() is not None:
                self._launch()
            asked, begin = self.launch_folder / f"{self.asked}.case", time.monotonic()
            self.asked += 1
            _replace(asked, case)
            while not _answer(self.folder, case).exists() and self.process.poll() is None:
                if time.monotonic() - begin > PATIENCE:
                    self.stack.close()
                    return f"no answer in {PATIENCE} s"
                time.sleep(POLL)
            said = (self.launch_folder / "output").read_text()
            if _answer(self.folder, case).exists() or BROKEN not in said:
                break
        return said

    def _launch(self) -> None:
        self.stack.close()
        self.asked = 0
        self.launch_folder = Path(tempfile.mkdtemp(dir=self.folder))
        output = self.stack.enter_context((self.launch_folder / "output").open("w"))
        command = "-m", "tests.on_ranks", str(self.folder), str(self.launch_folder)
        self.process = self.stack.enter_context(launched(self.ranks, *command, output=output))


def _write(path: Path, content: dict[str, Any]) -> None:
    _replace(path, json.dumps(content))


def _replace(path: Path, text: str) -> None:
    part = path.with_suffix(".part")
    part.write_text(text)
    part.replace(path)


# ---------------------------------------------------------------- on the ranks
def main(folder: Path, launch_folder: Path) -> None:
    """Run functions as they are asked for, until this process is ended."""
    for number in itertools.count():
        asked = launch_folder / f"{number}.case"
        while not asked.exists():
            time.sleep(POLL)
        run(asked.read_text(), folder)


def run(case: str, folder: Path) -> None:
    """Run a function and write what it gives on rank 0, or the errors of all ranks."""
    result, error = None, ""
    try:
        result = _called(case, folder)
        json.dumps(result)
    except (Exception, pytest.fail.Exception):
        error = traceback.format_exc()
    gc.collect()  # on all ranks together, as PETSc frees objects
    errors = MPI.COMM_WORLD.gather(error)
    if errors and any(errors):
        said = "\n".join(f"rank {k}: {trace}" for k, trace in enumerate(errors))
        _write(_answer(folder, case), {"error": said})
    elif errors:
        _write(_answer(folder, case), {"found": result})


def _called(case: str, folder: Path) -> Any:
    module, name = case.split(":")
    run = getattr(importlib.import_module(module), name)
    if all(parameter.default is not parameter.empty for parameter in inspect.signature(run).parameters.values()):
        return run()
    case_folder = _own(folder, case)
    case_folder.mkdir(exist_ok=True)
    MPI.COMM_WORLD.barrier()
    return run(case_folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
