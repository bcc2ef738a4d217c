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
NO_LOCK_ERRNOS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EINVAL)  # errors of file systems without locks


# ---------------------------------------------------------------- whole files
@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Context manager that yields a new binary file; at its end the file takes the place of `path`.

    If an error occurs in the `with` statement, the file at `path` stays as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.part")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename is None:
            error.filename = str(path)
        raise


def file_hash(path: Path) -> str | None:
    """Return the SHA-256 hash of the content of the file `path`, as a text; None if the file does not exist."""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None


def append_sealed(path: Path, *contents: Mapping[str, object]) -> None:
    """Append lines of JSON to a file, each with a hash of its data. Several processes may append to the file.

    The lines are on the disk when this returns. If the process is killed while it writes, the file ends with part of a
    line, which `read_sealed_lines` skips.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps({**content, "hash": _content_hash(content)}) for content in contents]
    try:
        with path.open("ab") as file:
            with suppress(OSError):  # file systems without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            file.write("\n".join(["", *lines, ""]).encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        error.filename = str(path)
        raise


def read_sealed_lines(path: Path) -> list[dict[str, Any]]:
    """Return the data in the lines that `append_sealed` has written, without their hashes; [] if there is no file.

    Raises:
        InputError: the file cannot be read, or the hash of a whole line is not that of its data.
    """
    contents = []
    try:
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
            with suppress(json.JSONDecodeError):
                contents.append(dict(json.loads(line)))
        if any(content.pop("hash", None) != _content_hash(content) for content in contents):
            raise ValueError("it is damaged, or has been changed")
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InputError(f"{str(path)!r} cannot be read ({error}); remove it to start anew") from error
    return contents


def _content_hash(content: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


# ---------------------------------------------------------------- locks
@contextmanager
def lock_from_root(folder: Path | None, comm: MPI.Intracomm | None = None, name: str = LOCK_FILE) -> Iterator[None]:
    """Context manager that locks a folder, so that no other run writes into it. Collective.

    The folder is made if necessary, and removed at the end if it is empty. The operating system frees the lock when the
    process that holds it ends, even if the process is killed.

    Args:
        folder: the folder; None: nothing is locked.
        comm: communicator whose rank 0 writes; None: all ranks, in an `ensemble` those of the group.
        name: name of the lock file; runs that write different files of the folder use different names.

    Raises:
        InputError: another run has locked the folder, or no files can be written there.
    """
    with ExitStack() as stack:
        if folder is not None:
            on_root(comm, lambda: stack.enter_context(lock_folder(folder, name)))
        yield


@contextmanager
def lock_folder(folder: Path, name: str = LOCK_FILE, *, wait: bool = False) -> Iterator[None]:
    """Context manager that locks a folder, so that no other run writes into it. Only this rank takes part.

    The folder is made if necessary, and removed at the end if it is empty.

    Args:
        folder: the folder.
        name: name of the lock file in it.
        wait: whether to wait until another run that has locked the folder frees it.

    Raises:
        InputError: another run has locked the folder, and `wait` is False; or no files can be written there.
    """
    made_folders, descriptor = [], -1
    try:
        try:
            made_folders = [path for path in (folder, *folder.parents) if not path.is_dir()]
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = _open_and_lock(folder / name, wait)
        except InputError:  # a ValueError with a complete message
            raise
        except (OSError, ValueError) as error:  # a name with a null character raises ValueError
            raise InputError(f"no files can be written in {str(folder)!r}: {error}; give another folder") from error
        yield
    finally:
        if descriptor >= 0:
            (folder / name).unlink(missing_ok=True)
            os.close(descriptor)
        for path in made_folders:
            with suppress(OSError, ValueError):
                path.rmdir()


def _open_and_lock(path: Path, wait: bool) -> int:
    """Open and lock a file, made if necessary, and return its descriptor.

    The number of this process and the name of its computer are written into the file.

    Args:
        path: path of the file.
        wait: whether to wait until another run that has locked the file frees it.

    Raises:
        InputError: another run has locked the file, and `wait` is False.
    """
    while True:
        with ExitStack() as stack:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            stack.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                holder = os.pread(descriptor, 200, 0).decode(errors="replace").strip() or "another process"
                text = f"another run ({holder}) is writing into {str(path.parent)!r}"
                raise InputError(f"{text}; wait for it, or give another folder") from None
            except OSError as error:
                if error.errno not in NO_LOCK_ERRNOS:  # without locks nothing protects the folder
                    raise
            if os.fstat(descriptor).st_nlink:
                os.truncate(descriptor, 0)
                os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode(), 0)
                stack.pop_all()
                return descriptor


# ---------------------------------------------------------------- earlier runs
def move_away(folder: Path, names: Iterable[str]) -> Path | None:
    """Move files of a folder into a new subfolder previous-1, or previous-2 if that exists, and so on.

    Args:
        folder: the folder.
        names: names of the files; those that do not exist are skipped.

    Returns:
        The subfolder; None if none of the files exists.
    """
    existing = [folder / name for name in names if (folder / name).exists()]
    if not existing:
        return None
    numbers = [int(m[1]) for path in folder.iterdir() if (m := re.fullmatch(rf"{PREVIOUS_PREFIX}(\d+)", path.name))]
    subfolder = folder / f"{PREVIOUS_PREFIX}{max(numbers, default=0) + 1}"
    subfolder.mkdir()
    for path in existing:
        path.rename(subfolder / path.name)
    return subfolder


def move_back(previous: Path) -> None:
    """Move all files of the subfolder `previous`, which `move_away` has made, back to its parent.

    The subfolder, then empty, is removed.
    """
    for path in [*previous.iterdir()]:
        path.rename(previous.parent / path.name)
    previous.rmdir()
