"""Files that are replaced as a whole, locks on folders, and moving files of earlier runs out of the way."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
import socket
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from mpi4py import MPI

from forms.base import InputError
from geometry.parallel import on_root

LOCK_FILE = ".lock"
PREVIOUS_PREFIX = "previous-"
NO_LOCK_ERRORS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)  # errors of file systems without locks


# ---------------------------------------------------------------- whole files
@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Context that yields a new file, which replaces `path` when it is complete; after an error `path` is unchanged."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.part")
    try:
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise


def hash_of(path: Path) -> str | None:
    """SHA-256 hash of the content of a file; None if the file does not exist."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


def write_sealed(path: Path, content: Mapping[str, object]) -> None:
    """Write data to a JSON file together with their hash, by which `read_sealed` detects damage."""
    with replace_file(path) as file:
        file.write(json.dumps({**content, "hash": _seal(content)}).encode())


def read_sealed(path: Path) -> dict[str, Any]:
    """Read data from a JSON file with their hash, as `write_sealed` writes them.

    Raises:
        InputError: the file cannot be read, or its hash is wrong.
    """
    try:
        content = dict(json.loads(path.read_text(encoding="utf-8")))
        if content.pop("hash", None) != _seal(content):
            raise ValueError("it is damaged, or has been changed")
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{str(path)!r} cannot be read ({error}); remove it to start anew") from error
    return content


def _seal(content: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


# ---------------------------------------------------------------- locks
@contextmanager
def own_folder(folder: Path | None, comm: MPI.Intracomm | None = None, name: str = LOCK_FILE) -> Iterator[None]:
    """Context that locks a folder, so that no other run writes into it. Collective.

    The folder is made if necessary, and removed again if it is empty at the end. The lock is the operating system's:
    it ends with the process that holds it, even if this is killed.

    Args:
        folder: the folder; None: nothing is locked.
        comm: communicator whose rank 0 writes; None: all ranks, in an `ensemble` those of the group.
        name: name of the lock file; runs that write different files of the folder use different names.

    Raises:
        InputError: another run is at work there, or no files can be written.
    """
    with ExitStack() as stack:
        if folder is not None:
            on_root(comm, lambda: stack.enter_context(lock_folder(folder, name)))
        yield


@contextmanager
def lock_folder(folder: Path, name: str = LOCK_FILE, *, wait: bool = False) -> Iterator[None]:
    """Context that locks a folder on this rank, so that no other run writes into it.

    The folder is made if necessary, and removed again if it is empty at the end.

    Args:
        folder: the folder.
        name: name of the lock file in it.
        wait: whether to wait for another run that has locked the folder.

    Raises:
        InputError: another run has locked the folder, and `wait` is False; or no files can be written there.
    """
    made, file = [], -1
    try:
        try:
            made = [path for path in (folder, *folder.parents) if not path.is_dir()]
            folder.mkdir(parents=True, exist_ok=True)
            file = _lock(folder / name, wait)
        except InputError:  # a ValueError with a complete message
            raise
        except (OSError, ValueError) as error:  # a name with a null character raises ValueError
            raise InputError(f"no files can be written in {str(folder)!r}: {error}; give another folder") from error
        yield
    finally:
        if file >= 0:
            (folder / name).unlink(missing_ok=True)
            os.close(file)
        for path in made:
            with suppress(OSError, ValueError):
                path.rmdir()


def _lock(path: Path, wait: bool) -> int:
    """Open and lock a file, write into it which process has the lock, and return its descriptor.

    If another run has removed the file meanwhile, it is made again. With `wait` the lock of another run is waited for;
    without, it raises an InputError.
    """
    while True:
        with ExitStack() as stack:
            file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            stack.callback(os.close, file)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                who = os.pread(file, 200, 0).decode(errors="replace").strip() or "another process"
                what = f"another run ({who}) is writing into {str(path.parent)!r}"
                raise InputError(f"{what}; wait for it, or give another folder") from None
            except OSError as error:
                if error.errno not in NO_LOCK_ERRORS:  # without locks nothing protects the folder
                    raise
            if os.fstat(file).st_nlink:
                os.truncate(file, 0)
                os.pwrite(file, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
                stack.pop_all()
                return file


# ---------------------------------------------------------------- earlier runs
def move_away(folder: Path, names: Iterable[str]) -> Path | None:
    """Move those of the named files in a folder that exist into a new folder previous-1, previous-2, ... in it.

    Returns:
        The new folder; None if none of the files exists.
    """
    there = [folder / name for name in names if (folder / name).exists()]
    if not there:
        return None
    numbers = [int(m[1]) for path in folder.iterdir() if (m := re.fullmatch(rf"{PREVIOUS_PREFIX}(\d+)", path.name))]
    target = folder / f"{PREVIOUS_PREFIX}{max(numbers, default=0) + 1}"
    target.mkdir()
    for path in there:
        path.rename(target / path.name)
    return target


def move_back(previous: Path) -> None:
    """Move the files in a folder previous-N back to its parent folder, and remove the empty folder."""
    for path in [*previous.iterdir()]:
        path.rename(previous.parent / path.name)
    previous.rmdir()
