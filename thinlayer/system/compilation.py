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
EXPORTED_FUNCTION_REGEX = re.compile(r"^(?:int|double) \w+\([^{;]*\)(?=\s*\{)", re.MULTILINE)
FormModule = tuple[list[object], ModuleType] | tuple[None, None]  # objects of a compiled form, and its module
# Type character of an array -> C type of its pointer; dtype.name would take 5 times as long.
C_ARRAY_TYPES = {"i": "int32_t[]", "l": "intptr_t[]", "?": "uint8_t[]", "d": "double[]"}


class SourceError(ThinlayerError, RuntimeError):
    """Error of a C source that cannot be read or compiled; the compiler prints its messages to standard error."""


def lock_library(folder: Path, name: str) -> None:
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
    _lock_byte(folder, name, fcntl.LOCK_EX)


def unlock_library(folder: Path, name: str) -> None:
    """Free this process's lock on the library `name` in the cache `folder`, so that other processes may compile it."""
    if folder in _LOCK_FILES:
        _lock_byte(folder, name, fcntl.LOCK_UN)


def _lock_byte(folder: Path, name: str, operation: int) -> None:
    """Lock or free a library of the cache, by a lock on one byte of the folder's lock file.

    Args:
        folder: folder of the cache.
        name: name of the library, from which the number of the byte follows.
        operation: `fcntl.LOCK_EX` to lock, `fcntl.LOCK_UN` to free.
    """
    byte = int(hashlib.sha256(name.encode()).hexdigest()[:15], 16)
    with suppress(OSError):  # a file system without locks: a library may be compiled twice, and the last one is kept
        if folder not in _LOCK_FILES:
            _LOCK_FILES[folder] = os.open(folder / ".thinlayer.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        fcntl.lockf(_LOCK_FILES[folder], operation, 1, byte)


@contextmanager
def build_folder(folder: Path, name: str) -> Iterator[Path]:
    """Context manager that yields a new, empty folder in which to compile a library, and removes it at the end.

    The library must be locked. Such folders that killed processes have left for it are removed, too.

    Args:
        folder: folder of the cache, in which the new one is made.
        name: name of the library.
    """
    prefix = f".{name}.{os.getpid()}-"
    for old_folder in folder.glob(f".{name}.*"):
        if not old_folder.name.startswith(prefix):
            shutil.rmtree(old_folder, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=prefix, ignore_cleanup_errors=True) as new_folder:
        yield Path(new_folder)


def move_to_cache(built: Path, target: Path) -> None:
    """Move the file `built` to the path `target`, after all of its data are on the disk."""
    with built.open("rb") as written:
        os.fsync(written.fileno())
    built.replace(target)


def load_library(path: Path) -> ModuleType:
    """Load the compiled library in the file `path` as a Python module.

    Raises:
        ImportError: the file is not such a library.
    """
    loader = ExtensionFileLoader(path.name.split(".")[0], str(path))
    module = module_from_spec(ModuleSpec(loader.name, loader, origin=loader.path))
    loader.exec_module(module)
    return module


def _replace_ffcx_cache() -> None:
    """Replace FFCx's functions that look for a compiled form and that compile one.

    The new functions use locks of the operating system, and a folder of its own for each compilation.
    """
    find_module, build_module = ffcx_jit.get_cached_module, ffcx_jit._compile_objects
    signature = inspect.signature(build_module)

    def read_cache(module_name: str, object_names: list[str], folder: Path) -> FormModule:
        """Return the objects and the module of a compiled form in the cache; (None, None) if it is not there or broken.

        FFCx itself would list the whole folder for each form, which takes long with thousands of files.

        Args:
            module_name: name of the form's library.
            object_names: names of the objects in the library.
            folder: folder of the cache.
        """
        source, ready_marker = (folder / f"{module_name}{end}" for end in (".c", ".c.cached"))
        for library_file in (folder / f"{module_name}{end}" for end in EXTENSION_SUFFIXES):
            if library_file.exists() and source.exists() and ready_marker.exists():
                with suppress(ImportError):
                    module = load_library(library_file)
                    return [getattr(module.lib, name) for name in object_names], module
        return None, None

    @functools.wraps(find_module)
    def get_cached_module(module_name: str, object_names: list[str], cache_dir: str | Path, timeout: int) -> FormModule:
        folder = Path(cache_dir)
        cached = read_cache(module_name, object_names, folder)
        if cached[0] is None:
            lock_library(folder, module_name)
            cached = read_cache(module_name, object_names, folder)  # another process may have compiled it
            if cached[0] is not None:
                unlock_library(folder, module_name)
        return cached

    @functools.wraps(build_module)
    def compile_objects(*arguments: object, **options: object) -> object:
        bound_call = signature.bind(*arguments, **options)
        folder, name = Path(bound_call.arguments["cache_dir"]), bound_call.arguments["module_name"]
        try:
            with report_call("compiling a form, kept for later runs"), build_folder(folder, name) as new_folder:
                bound_call.arguments["cache_dir"] = new_folder
                result = build_module(*bound_call.args, **bound_call.kwargs)
                built_files = {file.name: file for file in new_folder.iterdir() if file.name.startswith(f"{name}.")}
                ready_marker = built_files.pop(f"{name}.c.cached")
                built_files.pop(f"{name}.o", None)
                for file in [*built_files.values(), ready_marker]:  # the marker says that all others are there
                    move_to_cache(file, folder / file.name)
        finally:
            unlock_library(folder, name)
        return result

    ffcx_jit.get_cached_module, ffcx_jit._compile_objects = get_cached_module, compile_objects


_replace_ffcx_cache()


def load_ffcx_options() -> None:
    """Make FFCx and DOLFINx's compiler read their options now; then option files in the working folder have no effect.

    Both keep the options that they read first.
    """
    with tempfile.TemporaryDirectory() as empty, chdir(empty):
        ffcx.get_options()
        dolfinx.jit.get_options()


# ---------------------------------------------------------------- C sources
def compile_library(source: Path, comm: MPI.Intracomm = MPI.COMM_SELF) -> ModuleType:
    """Return the Python module of a C source: compile the source, unless the cache has its library. Collective.

    The attribute `lib` of the module has all functions of the source that are not static and return int or double.

    Args:
        source: path of the C file.
        comm: communicator of the ranks that call this; its rank 0 compiles. By default each process compiles for
            itself.

    Raises:
        SourceError: the source cannot be read or compiled; on all ranks.
    """

    def build_on_root() -> None:
        try:
            _build_library(source, _library_path(source))
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise SourceError(f"the C source {str(source)!r} cannot be compiled: {reason}") from None

    on_root(comm, build_on_root)
    return _load_once(_library_path(source))


load_own_library = functools.cache(compile_library)  # for sources of the package, which do not change while it runs
_load_once = functools.cache(load_library)


def c_pointers(library: ModuleType, *arrays: np.ndarray) -> list[object]:
    """Return C pointers to the data of arrays, for calls of functions of a compiled library.

    An array that is not contiguous is copied first, so that C cannot write to it: arrays for results must be
    contiguous.

    Args:
        library: module of the library.
        *arrays: arrays of int32, intp, bool or float64.
    """
    return [library.ffi.from_buffer(C_ARRAY_TYPES[a.dtype.char], a) for a in map(np.ascontiguousarray, arrays)]


def _library_path(source: Path) -> Path:
    """Return the path at which the cache has, or would have, the compiled library of the C file `source`.

    The name of the library contains a hash of the source and of the files that it includes.
    """
    folder = Path(dolfinx.jit.get_options()["cache_dir"]).expanduser()
    digest = hashlib.sha256(source_content(source) + cffi.__version__.encode()).hexdigest()[:16]
    return folder / f"thinlayer_{source.stem}_{digest}{sysconfig.get_config_var('EXT_SUFFIX')}"


def _build_library(source: Path, target: Path) -> None:
    """Compile the C file `source` to the library `target` in the cache; do nothing if `target` exists."""
    if target.exists():
        return
    name = target.name.split(".")[0]
    lock_library(target.parent, name)
    try:
        if target.exists():  # another process has compiled it
            return
        source_text = source.read_text(encoding="utf-8")
        builder = cffi.FFI()
        builder.cdef("\n".join(function_head + ";" for function_head in EXPORTED_FUNCTION_REGEX.findall(source_text)))
        builder.set_source(name, source_text, extra_compile_args=["-O2"], include_dirs=[str(source.parent.resolve())])
        with build_folder(target.parent, name) as new_folder:
            move_to_cache(Path(builder.compile(tmpdir=new_folder)), target)
    finally:
        unlock_library(target.parent, name)
