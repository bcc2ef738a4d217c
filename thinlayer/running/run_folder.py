"""The folder of a run: its lock, the files of the run, and those of earlier runs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from thinlayer.errors import ModelError
from thinlayer.files.folder import Lock, moved_away, moved_back
from thinlayer.files.table import hash_of, replaced

RUN = "run.json"
MARCHES = "unfinished"  # folder for the states of marches, needed to resume


class RunFolder:
    """The folder of a run, on one rank.

    Attributes:
        path: the folder.
        files: names of the run's files without run.json.
        taken: whether the run owns the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.files, self.taken = path, set[str](), False
        self._lock, self._moved = Lock(path), dict[Path, Path]()

    def take(self, problem: Callable[[], str | None] | None) -> None:
        """Lock the folder, and move the files of an earlier run away unless that run is resumed.

        Args:
            problem: returns the reason why the earlier run cannot be resumed, None if it can; without a function nothing is
                resumed.

        Raises:
            ModelError: the folder cannot be written, belongs to a run that goes on, or has tables without a run.json; or
                the earlier run cannot be resumed.
        """
        self._lock.take()
        try:
            if (self.path / RUN).exists() and problem:
                if text := problem():
                    raise ModelError(text)
                self.files |= {*self._earlier()} - {RUN, MARCHES}
            elif (self.path / RUN).exists():
                self._moved = moved_away(self.path, self._earlier())
            elif tables := sorted(path.name for path in self.path.glob("*.csv")):
                raise ModelError(
                    f"{self.path} has tables ({', '.join(tables)}) and no run.json; give another --out, or remove them"
                )
        except (OSError, ModelError):
            self._lock.free()
            raise
        self.taken = True

    def free(self) -> None:
        """Unlock the folder; if the run has left no files, move those of the earlier run back."""
        if not self.taken:
            return
        if self._moved and not self._has(RUN, MARCHES, *self.files):
            with suppress(OSError):
                moved_back(self._moved)
        self._lock.free()

    def withdraw(self) -> None:
        """Remove run.json if the run has written nothing else."""
        if not self._has(MARCHES, *self.files):
            with suppress(OSError):
                (self.path / RUN).unlink(missing_ok=True)

    def _has(self, *names: str) -> bool:
        return any((self.path / name).exists() for name in names)

    def _earlier(self) -> list[str]:
        """Files of the run whose run.json is in the folder."""
        try:
            names = [str(name) for name in json.loads((self.path / RUN).read_text(encoding="utf-8"))["files"]]
            names = [name for name in names if Path(name).name == name]
        except (OSError, ValueError, LookupError, TypeError):
            names = [path.name for path in self.path.iterdir() if path.suffix in (".csv", ".png")]
        return [*names, MARCHES, RUN]  # run.json last: it is still there if the process is killed while files are moved

    def read_run(self, what: str = "") -> dict[str, Any]:
        """The content of run.json, with a study and options at least.

        Raises:
            ModelError: the file cannot be read, or has other content; the message starts with `what`.
        """
        path = self.path / RUN
        try:
            run = json.loads(path.read_text(encoding="utf-8"))
            return run | {"study": str(run["study"]), "options": dict(run["options"])}
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise ModelError(f"{what}{path} cannot be read ({error})") from error

    def write_run(self, content: dict[str, Any], *, done: bool) -> None:
        """Write run.json, with the names of the run's files and, if the run is done, the hashes of its tables."""
        tables = sorted(name for name in self.files if done and name.endswith(".csv"))
        content |= {"files": sorted(self.files), "tables": {name: hash_of(self.path / name) for name in tables}}
        with replaced(self.path / RUN) as file:
            file.write((json.dumps(content, indent=1, default=str) + "\n").encode())
        if done:
            shutil.rmtree(self.path / MARCHES, ignore_errors=True)
