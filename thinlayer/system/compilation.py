"""Cache of compiled forms and C sources, which stays intact if compilations are killed or run at the same time.

FFCx itself compiles in the folder of the cache, where the C file of a form also serves as a lock. If the process is
killed, the C file stays, and every process that needs the form waits in vain. Here each compilation has its own folder.
Its files are moved to the cache when all are complete and on the disk, so that the cache has no incomplete file. Other
processes that need the same form wait for a lock that the operating system frees when its process ends. Importing this
module changes FFCx for the whole process, also for forms that a user's script compiles.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import inspect
import os
import re
import shutil
import sysconfig
import tempfile
from collections.abc import Iterator
from contextlib import chdir, contextmanager, suppress
from importlib.machinery import EXTENSION_SUFFIXES, ExtensionFileLoader, ModuleSpec
from importlib.util import module_from_spec
from pathlib import Path
from types import ModuleType

import cffi
import dolfinx.jit
import ffcx
import numpy as np
from ffcx.codegeneration import jit as ffcx_jit
from mpi4py import MPI

import thinlayer.system.ranks  # noqa: F401  # before DOLFINx, which starts PETSc
from forms.base import InputError, ThinlayerError
from geometry.parallel import on_root
from thinlayer.system.fingerprint import source_content
from thinlayer.system.progress import report_call

# Folder -> descriptor of its lock file. They are never closed, as that would free all locks of the process on the file.
_LOCK_FILES: dict[Path, int] = {}
# Head of a function of a C source that is not static and returns int or double.
EXPORTED_FUNCTION = re.compile(r"^(?:int|double) \w+\([^{;]*\)(?=\s*\{)", re.MULTILINE)
FormModule = tuple[list[object], ModuleType] | tuple[None, None]  # objects of a compiled form, and its module
# Type character of an array -> C type of its pointer; dtype.name would take 5 times as long.
C_ARRAY_TYPES = {"i": "int32_t[]", "l": "intptr_t[]", "?": "uint8_t[]", "d": "double[]"}


class SourceError(ThinlayerError, RuntimeError):
    """Error of a C source that cannot be read or compiled; the compiler prints its messages to standard error."""


def acquire(folder: Path, name: str) -> None:
    """Lock a library of the cache for this process, after a wait while another process has locked it.

    The library may not exist yet.

    Args:
        folder: folder of the cache, which is made if necessary.
        name: name of the library.

    Raises:
        InputError: the folder cannot be made, or no files can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        remedy = "set XDG_CACHE_HOME to a folder that can be written"
        raise InputError(f"compiled forms cannot be kept in {str(folder)!r}: {error.strerror}; {remedy}") from error
    _lock(folder, name, fcntl.LOCK_EX)


def release(folder: Path, name: str) -> None:
    """Free this process's lock on the library `name` in the cache `folder`, so that other processes may compile it."""
    if folder in _LOCK_FILES:
        _lock(folder, name, fcntl.LOCK_UN)


def _lock(folder: Path, name: str, how: int) -> None:
    """Lock or free a library of the cache, by a lock on one byte of the folder's lock file.

    Args:
        folder: folder of the cache.
        name: name of the library, from which the number of the byte follows.
        how: `fcntl.LOCK_EX` to lock, `fcntl.LOCK_UN` to free.
    """
    byte = int(hashlib.sha256(name.encode()).hexdigest()[:15], 16)
    with suppress(OSError):  # a file system without locks: a library may be compiled twice, and the last one is kept
        if folder not in _LOCK_FILES:
            _LOCK_FILES[folder] = os.open(folder / ".thinlayer.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        fcntl.lockf(_LOCK_FILES[folder], how, 1, byte)


@contextmanager
def workshop(folder: Path, name: str) -> Iterator[Path]:
    """Context manager that yields a new, empty folder in which to compile a library, and removes it at the end.

    The library must be locked. Such folders that killed processes have left for it are removed, too.

    Args:
        folder: folder of the cache, in which the new one is made.
        name: name of the library.
    """
    prefix = f".{name}.{os.getpid()}-"
    for old in folder.glob(f".{name}.*"):
        if not old.name.startswith(prefix):
            shutil.rmtree(old, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=prefix, ignore_cleanup_errors=True) as work:
        yield Path(work)


def keep_file(made: Path, file: Path) -> None:
    """Move the file `made` to the path `file`, after all of its data are on the disk."""
    with made.open("rb") as written:
        os.fsync(written.fileno())
    made.replace(file)


def load_library(library: Path) -> ModuleType:
    """Load the compiled library in the file `library` as a Python module.

    Raises:
        ImportError: the file is not such a library.
    """
    loader = ExtensionFileLoader(library.name.split(".")[0], str(library))
    module = module_from_spec(ModuleSpec(loader.name, loader, origin=loader.path))
    loader.exec_module(module)
    return module


def _mend_ffcx() -> None:
    """Replace FFCx's functions that look for a compiled form and that compile one.

    The new functions use locks of the operating system, and a folder of its own for each compilation.
    """
    find, build = ffcx_jit.get_cached_module, ffcx_jit._compile_objects
    parameters = inspect.signature(build)

    def read_cache(module_name: str, object_names: list[str], folder: Path) -> FormModule:
        """Return the objects and the module of a compiled form in the cache; (None, None) if it is not there or broken.

        FFCx itself would list the whole folder for each form, which takes long with thousands of files.

        Args:
            module_name: name of the form's library.
            object_names: names of the objects in the library.
            folder: folder of the cache.
        """
        source, ready = (folder / f"{module_name}{end}" for end in (".c", ".c.cached"))
        for library in (folder / f"{module_name}{end}" for end in EXTENSION_SUFFIXES):
            if library.exists() and source.exists() and ready.exists():
                with suppress(ImportError):
                    module = load_library(library)
                    return [getattr(module.lib, name) for name in object_names], module
        return None, None

    @functools.wraps(find)
    def get_cached_module(module_name: str, object_names: list[str], cache_dir: str | Path, timeout: int) -> FormModule:
        folder = Path(cache_dir)
        cached = read_cache(module_name, object_names, folder)
        if cached[0] is None:
            acquire(folder, module_name)
            cached = read_cache(module_name, object_names, folder)  # another process may have compiled it
            if cached[0] is not None:
                release(folder, module_name)
        return cached

    @functools.wraps(build)
    def compile_objects(*arguments: object, **options: object) -> object:
        call = parameters.bind(*arguments, **options)
        folder, name = Path(call.arguments["cache_dir"]), call.arguments["module_name"]
        try:
            with report_call("compiling a form, kept for later runs"), workshop(folder, name) as work:
                call.arguments["cache_dir"] = work
                code = build(*call.args, **call.kwargs)
                made = {file.name: file for file in work.iterdir() if file.name.startswith(f"{name}.")}
                ready = made.pop(f"{name}.c.cached")
                made.pop(f"{name}.o", None)
                for file in [*made.values(), ready]:  # `ready` last: it says that all others are there
                    keep_file(file, folder / file.name)
        finally:
            release(folder, name)
        return code

    ffcx_jit.get_cached_module, ffcx_jit._compile_objects = get_cached_module, compile_objects


_mend_ffcx()


def load_options() -> None:
    """Make FFCx and DOLFINx's compiler read their options now; then option files in the working folder have no effect.

    Both keep the options that they read first.
    """
    with tempfile.TemporaryDirectory() as empty, chdir(empty):
        ffcx.get_options()
        dolfinx.jit.get_options()


# ---------------------------------------------------------------- C sources
def library(source: Path, comm: MPI.Intracomm = MPI.COMM_SELF) -> ModuleType:
    """Return the Python module of a C source: compile the source, unless the cache has its library. Collective.

    The attribute `lib` of the module has all functions of the source that are not static and return int or double.

    Args:
        source: path of the C file.
        comm: communicator of the ranks that call this; its rank 0 compiles. By default each process compiles for
            itself.

    Raises:
        SourceError: the source cannot be read or compiled; on all ranks.
    """

    def build() -> None:
        try:
            _build(source, _file_of(source))
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise SourceError(f"the C source {str(source)!r} cannot be compiled: {reason}") from None

    on_root(comm, build)
    return _loaded(_file_of(source))


own_library = functools.cache(library)  # for sources of the package, which do not change while it runs
_loaded = functools.cache(load_library)


def pointers(library: ModuleType, *arrays: np.ndarray) -> list[object]:
    """Return C pointers to the data of arrays, for calls of functions of a compiled library.

    An array that is not contiguous is copied first, so that C cannot write to it: arrays for results must be
    contiguous.

    Args:
        library: module of the library.
        *arrays: arrays of int32, intp, bool or float64.
    """
    return [library.ffi.from_buffer(C_ARRAY_TYPES[a.dtype.char], a) for a in map(np.ascontiguousarray, arrays)]


def _file_of(source: Path) -> Path:
    """Return the path at which the cache has, or would have, the compiled library of the C file `source`.

    The name of the library contains a hash of the source and of the files that it includes.
    """
    folder = Path(dolfinx.jit.get_options()["cache_dir"]).expanduser()
    name = hashlib.sha256(source_content(source) + cffi.__version__.encode()).hexdigest()[:16]
    return folder / f"thinlayer_{source.stem}_{name}{sysconfig.get_config_var('EXT_SUFFIX')}"


def _build(source: Path, file: Path) -> None:
    """Compile the C file `source` to the library `file` in the cache; do nothing if `file` exists."""
    if file.exists():
        return
    name = file.name.split(".")[0]
    acquire(file.parent, name)
    try:
        if file.exists():  # another process has compiled it
            return
        text = source.read_text(encoding="utf-8")
        builder = cffi.FFI()
        builder.cdef("\n".join(head + ";" for head in EXPORTED_FUNCTION.findall(text)))
        builder.set_source(name, text, extra_compile_args=["-O2"], include_dirs=[str(source.parent.resolve())])
        with workshop(file.parent, name) as work:
            keep_file(Path(builder.compile(tmpdir=work)), file)
    finally:
        release(file.parent, name)
