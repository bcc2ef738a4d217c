"""Versions of packages, PETSc options and hash of the source code, on which results of a study also depend."""

from __future__ import annotations

import os
import platform
from functools import cache
from pathlib import Path
from types import ModuleType

from petsc4py import PETSc

from forms.base import PACKAGES
from forms.law import Law
from thinlayer.system.fingerprint import digest
from thinlayer.system.version import VERSION, version_of

RECORDED_PACKAGES = (
    "fenics-dolfinx fenics-basix fenics-ufl fenics-ffcx petsc4py mpi4py gmsh meshio pyvista vtk numpy scipy matplotlib"
)


@cache
def versions() -> dict[str, str]:
    """Name -> version of Python, PETSc and the packages that results depend on; "not installed" if one is missing."""
    core_versions = {"python": platform.python_version(), "thinlayer": VERSION}
    core_versions["petsc"] = ".".join(map(str, PETSc.Sys.getVersion()))
    return core_versions | {name: version_of(name) for name in RECORDED_PACKAGES.split()}


def petsc_options() -> dict[str, object]:
    """The PETSc options that are set, name -> value, and the environment variable PETSC_OPTIONS, which may set some."""
    options = {f"-{name}": value for name, value in sorted(PETSc.Options().getAll().items())}
    return {"options": options, "PETSC_OPTIONS": os.environ.get("PETSC_OPTIONS", "")}


@cache
def code() -> str:
    """Hash of the Python and C source of the package and of its studies."""
    folder = Path(__file__).parents[2]
    paths = (path for package in (*PACKAGES, "studies") for path in sorted((folder / package).rglob("*")))
    sources = [path for path in paths if path.suffix in (".py", ".c")]
    return digest(b"".join(f"{path.relative_to(folder)}".encode() + path.read_bytes() for path in sources))


def constants(module: ModuleType) -> dict[str, object]:
    """Name -> value of a module's constants (in capitals): numbers, texts, laws, and tuples and dicts of these."""

    def plain(value: object) -> bool:
        if isinstance(value, dict):
            return all(isinstance(key, str) and plain(entry) for key, entry in value.items())
        return all(map(plain, value)) if isinstance(value, tuple) else isinstance(value, (int, float, str, Law))

    return {name: value for name, value in vars(module).items() if name.isupper() and plain(value)}
