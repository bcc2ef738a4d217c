"""Cache of compiled forms and C sources, which stays intact if compilations are killed or run at the same time.

FFCx compiles in this folder and uses a form's C file as a lock. If the process is killed, the lock stays, and every
process that needs the form waits in vain. Here each compilation has its own folder. Its files are moved to the common
folder when all are complete and on the disk, so that no file there is incomplete. Other processes that need the same
form wait for a lock that the operating system frees when its process ends. FFCx is changed for the whole process: this
also applies to forms that a script compiles itself.
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
    """Lock the library of this name for this process, after waiting for another process that compiles it.

    Raises:
        InputError: the folder cannot be made, or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        remedy = "set XDG_CACHE_HOME to a folder that can be written"
        raise InputError(f"compiled forms cannot be kept in {str(folder)!r}: {error.strerror}; {remedy}") from error
    _lock(folder, name, fcntl.LOCK_EX)


def release(folder: Path, name: str) -> None:
    """Free the lock on the library of this name, so that other processes may compile it."""
    if folder in _LOCK_FILES:
        _lock(folder, name, fcntl.LOCK_UN)


def _lock(folder: Path, name: str, how: int) -> None:
    """Lock or free a library, by a byte of the folder's lock file; `how` is `fcntl.LOCK_EX` or `fcntl.LOCK_UN`."""
    byte = int(hashlib.sha256(name.encode()).hexdigest()[:15], 16)
    with suppress(OSError):  # a file system without locks: a library may be compiled twice, and the last one is kept
        if folder not in _LOCK_FILES:
            _LOCK_FILES[folder] = os.open(folder / ".thinlayer.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        fcntl.lockf(_LOCK_FILES[folder], how, 1, byte)


@contextmanager
def workshop(folder: Path, name: str) -> Iterator[Path]:
    """Context with an empty folder in which to compile a locked library; old ones of killed processes are deleted."""
    prefix = f".{name}.{os.getpid()}-"
    for old in folder.glob(f".{name}.*"):
        if not old.name.startswith(prefix):
            shutil.rmtree(old, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=prefix, ignore_cleanup_errors=True) as work:
        yield Path(work)


def keep_file(made: Path, file: Path) -> None:
    """Flush the file `made` to the disk and move it to its final path `file`."""
    with made.open("rb") as written:
        os.fsync(written.fileno())
    made.replace(file)


def load_library(library: Path) -> ModuleType:
    """Load a compiled library as a module.

    Raises:
        ImportError: the file is not such a library.
    """
    loader = ExtensionFileLoader(library.name.split(".")[0], str(library))
    module = module_from_spec(ModuleSpec(loader.name, loader, origin=loader.path))
    loader.exec_module(module)
    return module


def _mend_ffcx() -> None:
    """Replace FFCx's functions that find and compile a form by ones with a lock and a folder for each compilation."""
    find, build = ffcx_jit.get_cached_module, ffcx_jit._compile_objects
    parameters = inspect.signature(build)

    def read_cache(module_name: str, object_names: list[str], folder: Path) -> FormModule:
        """Return the objects and the module of a compiled form; (None, None) if files are missing or broken.

        FFCx itself would list the whole folder for each form, which takes long with thousands of files.
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
    """Let FFCx and DOLFINx's compiler read their options now, without option files in the working folder."""
    with tempfile.TemporaryDirectory() as empty, chdir(empty):
        ffcx.get_options()
        dolfinx.jit.get_options()


# ---------------------------------------------------------------- C sources
def library(source: Path, comm: MPI.Intracomm = MPI.COMM_SELF) -> ModuleType:
    """Compile a C source and return its module, or load the module if it is in the cache. Collective over `comm`.

    The attribute `lib` of the module has all non-static functions that return int or double.

    Args:
        source: the C file.
        comm: communicator whose rank 0 compiles; by default each process does it by itself.

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
    """Return C pointers to arrays, or to contiguous copies of others; arrays that C writes to must be contiguous."""
    return [library.ffi.from_buffer(C_ARRAY_TYPES[a.dtype.char], a) for a in map(np.ascontiguousarray, arrays)]


def _file_of(source: Path) -> Path:
    """Path in the cache of the library of a C source; its name has a hash of the source and the files it includes."""
    folder = Path(dolfinx.jit.get_options()["cache_dir"]).expanduser()
    name = hashlib.sha256(source_content(source) + cffi.__version__.encode()).hexdigest()[:16]
    return folder / f"thinlayer_{source.stem}_{name}{sysconfig.get_config_var('EXT_SUFFIX')}"


def _build(source: Path, file: Path) -> None:
    """Compile a C source to the library `file`, unless it exists."""
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
