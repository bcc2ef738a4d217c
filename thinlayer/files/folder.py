"""Folders that one run at a time writes into, and files of earlier runs in them."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mpi4py import MPI

from geometry.parallel import on_root
from thinlayer.errors import ModelError

LOCK = ".lock"
PREVIOUS = "previous-"
PROBE = 1 << 16  # bytes that must be free on the disk before a run starts
WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)  # errors of file systems without locks


@contextmanager
def owned(folder: Path, comm: MPI.Intracomm | None = None, name: str = LOCK) -> Iterator[None]:
    """Own a folder in a block: no other run may write into it. Collective.

    The folder is made if necessary, and removed again if it is empty at the end. The lock is the operating system's:
    it ends with the process that holds it, however that ends.

    Args:
        folder: the folder.
        comm: communicator whose rank 0 writes (default: the world).
        name: name of the lock file; runs that write different files of the folder use different names.

    Raises:
        ModelError: another run is at work there, or no files can be written.
    """
    lock = Lock(folder, name)
    on_root(comm, lock.take)
    try:
        yield
    finally:
        lock.free()  # nothing on ranks that have not taken it


class Lock:
    """A lock on a folder, on one rank."""

    def __init__(self, folder: Path, name: str = LOCK) -> None:
        self.folder, self.path = folder, folder / name
        self._file: int | None = None
        self._made: list[Path] = []

    def take(self) -> None:
        """Make the folder and lock it; errors as in `owned`."""
        try:
            self._make()
            while self._file is None:
                self._open()
            self._try_disk()
        except ModelError:  # a ValueError with a complete message
            self.free()
            raise
        except (OSError, ValueError) as error:  # a name with a null character is no OSError
            self.free()
            what = getattr(error, "strerror", None) or str(error)
            raise ModelError(f"no files can be written in {str(self.folder)!r}: {what}; give another folder") from error

    def _make(self) -> None:
        absolute = self.folder.absolute()
        for folder in (*reversed(absolute.parents), absolute):
            if not folder.is_dir():
                if folder.is_symlink():
                    raise OSError(
                        errno.ENOENT, f"{str(folder)!r} is a link to {os.readlink(folder)!r}, which is no folder"
                    )
                folder.mkdir(exist_ok=True)
                self._made.insert(0, folder)

    def _open(self) -> None:
        """Try once to open and lock the file; a run that ends removes it, so that an opened file may be there no more."""
        file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            with _maybe_without_locks():
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            there = os.stat(self.path)
            if os.path.samestat(there, os.fstat(file)):
                self._file, file = file, -1
        except BlockingIOError:
            who = os.pread(file, 200, 0).decode(errors="replace").strip() or "another process"
            raise ModelError(
                f"another run ({who}) is writing into {str(self.folder)!r}; wait for it, or give another folder"
            ) from None
        except FileNotFoundError:
            pass
        finally:
            if file >= 0:
                os.close(file)

    def _try_disk(self) -> None:
        assert self._file is not None
        os.ftruncate(self._file, 0)
        written = os.pwrite(self._file, b" " * PROBE, 0)
        if written < PROBE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(self._file)
        os.ftruncate(self._file, 0)
        os.pwrite(self._file, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)

    def free(self) -> None:
        """Remove the lock, and the folders made for it if they are empty."""
        if self._file is not None:
            with suppress(OSError):
                self.path.unlink()
            with suppress(OSError):
                os.close(self._file)
            self._file = None
        with suppress(OSError):
            for folder in self._made:
                folder.rmdir()
        self._made = []


@contextmanager
def _maybe_without_locks() -> Iterator[None]:
    """Ignore errors of file systems without locks: runs go on without protection."""
    try:
        yield
    except OSError as error:
        if error.errno not in WITHOUT_LOCKS:
            raise


def moved_away(folder: Path, names: Iterable[str]) -> dict[Path, Path]:
    """Move files of an earlier run into folder/previous-N, N counting up; where they are now -> where they were."""
    there = [folder / name for name in names if (folder / name).exists()]
    if not there:
        return {}
    numbers = [int(m[1]) for path in folder.iterdir() if (m := re.fullmatch(rf"{PREVIOUS}(\d+)", path.name))]
    target = folder / f"{PREVIOUS}{max(numbers, default=0) + 1}"
    target.mkdir()
    moved = {}
    for path in there:
        path.rename(target / path.name)
        moved[target / path.name] = path
    return moved


def moved_back(moved: dict[Path, Path]) -> None:
    """Undo `moved_away`."""
    for now, before in moved.items():
        now.rename(before)
    for folder in {now.parent for now in moved}:
        folder.rmdir()
