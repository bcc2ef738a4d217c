"""C sources of the package; they are compiled when they are first needed, and the library is kept."""

from __future__ import annotations

import hashlib
import re
import sysconfig
from pathlib import Path
from typing import Any

import cffi
from dolfinx import jit
from mpi4py import MPI

from forms.base import ThinlayerError
from thinlayer.system.compilation import acquire, keep, load, release, workshop
from thinlayer.system.sources import content, contents

_LOADED: dict[Any, Any] = {}  # (source, state of the files that it includes) -> module
_FILES: dict[Path, tuple[Path, ...]] = {}  # source -> the files that it included when it was last loaded
# The head of a function that is not static and returns int or double.
EXPORTED = re.compile(r"^(?:int|double) \w+\([^{;]*\)(?=\s*\{)", re.MULTILINE)


class SourceError(ThinlayerError, RuntimeError):
    """A C source cannot be read or compiled; the compiler prints its messages to standard error."""


def library(source: Path, comm: MPI.Intracomm = MPI.COMM_SELF) -> Any:
    """The module compiled from a C source. Its `lib` has all functions that return int or double and are not static.

    Collective over `comm`: rank 0 compiles. With the default communicator each process compiles the module if it is not
    there.

    Raises:
        SourceError: the source cannot be read or compiled; on all ranks.
    """
    key = source, _state(source)
    if comm.allreduce(int(key not in _LOADED)):
        problem = None
        if comm.rank == 0:
            try:
                _build(source)
            except Exception as error:
                problem = f"{type(error).__name__}: {error}"
        if problem := comm.bcast(problem):
            raise SourceError(f"the C source {str(source)!r} cannot be compiled: {problem}")
        _FILES[source] = tuple(contents(source))
        key = source, _state(source)
        _LOADED[key] = load(_module_file(source))
    return _LOADED[key]


def _state(source: Path) -> tuple[tuple[Path, int], ...]:
    """The files that a source includes, and the time of the last change of each, in ns."""
    return tuple((file, _changed(file)) for file in _FILES.get(source, (source,)))


def _changed(file: Path) -> int:
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0


def _module_file(source: Path) -> Path:
    """The file of a compiled source, in FFCx's folder; its name has a hash of the source and the files it includes."""
    folder = Path(jit.get_options()["cache_dir"]).expanduser()
    name = hashlib.sha256(content(source) + cffi.__version__.encode()).hexdigest()[:16]
    return folder / f"thinlayer_{source.stem}_{name}{sysconfig.get_config_var('EXT_SUFFIX')}"


def _build(source: Path) -> None:
    """Compile a source, unless its library is there."""
    file = _module_file(source)
    if file.exists():
        return
    name = file.name.split(".")[0]
    acquire(file.parent, name)
    try:
        if file.exists():  # another process has compiled it
            return
        text = source.read_text(encoding="utf-8")
        builder = cffi.FFI()
        builder.cdef("\n".join(head + ";" for head in EXPORTED.findall(text)))
        builder.set_source(name, text, extra_compile_args=["-O2"], include_dirs=[str(source.parent.resolve())])
        with workshop(file.parent, name) as work:
            keep(Path(builder.compile(tmpdir=work)), file)
    finally:
        release(file.parent, name)
