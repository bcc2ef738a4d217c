"""What results of a study depend on besides its input: versions of packages, PETSc options, hash of the source code."""

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
def package_versions() -> dict[str, str]:
    """Return name -> version of Python, PETSc and the packages that results depend on.

    The version of a package that is missing is "not installed".
    """
    core_versions = {"python": platform.python_version(), "thinlayer": VERSION}
    core_versions["petsc"] = ".".join(map(str, PETSc.Sys.getVersion()))
    return core_versions | {name: version_of(name) for name in RECORDED_PACKAGES.split()}


def petsc_options() -> dict[str, object]:
    """Return all options in PETSc's database, and the environment variable from which some of them may come.

    Returns:
        {"options": {"-NAME": value}, "PETSC_OPTIONS": text of the variable}.
    """
    options = {f"-{name}": value for name, value in sorted(PETSc.Options().getAll().items())}
    return {"options": options, "PETSC_OPTIONS": os.environ.get("PETSC_OPTIONS", "")}


@cache
def code_hash() -> str:
    """Return a hash of the Python and C sources of the package and of its studies."""
    folder = Path(__file__).parents[2]
    paths = (path for package in (*PACKAGES, "studies") for path in sorted((folder / package).rglob("*")))
    sources = [path for path in paths if path.suffix in (".py", ".c")]
    return digest(b"".join(f"{path.relative_to(folder)}".encode() + path.read_bytes() for path in sources))


def constants(module: ModuleType) -> dict[str, object]:
    """Return name -> value of the constants of a study's module, to be stored with its results.

    Constants are variables with a name in capitals whose value is a number, a text, a law, or a tuple or dict of these.
    """

    def is_storable(value: object) -> bool:
        if isinstance(value, dict):
            return all(isinstance(key, str) and is_storable(entry) for key, entry in value.items())
        return all(map(is_storable, value)) if isinstance(value, tuple) else isinstance(value, (int, float, str, Law))

    return {name: value for name, value in vars(module).items() if name.isupper() and is_storable(value)}
