"""Mesh files as meshio reads them, and their cells in DOLFINx's order."""

from __future__ import annotations

import io
import re
import warnings
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import dolfinx
import numpy as np

from geometry.errors import GeometryError, unknown
from geometry.importing.cells import Cells

if TYPE_CHECKING:
    import meshio

CELLS = {
    "triangle": "triangle",
    "triangle6": "triangle",
    "quad": "quadrilateral",
    "quad9": "quadrilateral",
    "tetra": "tetrahedron",
    "tetra10": "tetrahedron",
    "hexahedron": "hexahedron",
    "hexahedron27": "hexahedron",
}
REMEDIES = {
    "quad8|hexahedron20": "save complete cells (gmsh: Mesh.SecondOrderIncomplete = 0)",
    "wedge|pyramid": "mesh with tetrahedra or with hexahedra alone",
    "vertex|line": "save the bodies' cells too (gmsh: name them with Physical Surface or Physical Volume)",
    "": "save cells of degree 1 or 2 (gmsh: Mesh.ElementOrder)",
}


def load(path: Path, scale: float) -> meshio.Mesh:
    """The file as meshio reads it, coordinates times a factor; messages that meshio prints are suppressed.

    Raises:
        GeometryError: no such file, not readable, or two groups with one physical name.
    """
    import meshio  # not needed by joints that are built

    if not path.is_file():
        raise GeometryError("this is a folder, not a file" if path.is_dir() else "there is no such file")
    if not {path.suffix.lower(), "".join(path.suffixes[-2:]).lower()} & meshio.extension_to_filetypes.keys():
        raise GeometryError(unknown("suffix", path.suffix, meshio.extension_to_filetypes))
    if path.suffix.lower() == ".msh":
        _require_single_names(path)
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = meshio.read(path)
    except ImportError as error:
        raise GeometryError(f"{path.suffix} files need the Python package {error.name}") from None
    except (Exception, SystemExit) as error:  # meshio exits Python when no reader succeeds
        why = " ".join(said.getvalue().split()) if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        hint = "; in gmsh save with Mesh.SaveAll = 0, Mesh.SaveParametric = 0" if path.suffix.lower() == ".msh" else ""
        raise GeometryError(f"meshio cannot read this {path.suffix} file ({why}){hint}") from None
    mesh.points = np.asarray(mesh.points, float) * scale
    return mesh


def _require_single_names(path: Path) -> None:
    """Raise GeometryError if two groups have the same physical name: meshio would drop one of them."""
    end = ("$EndPhysicalNames", "$Nodes", "$Elements")
    with path.open("rb") as file:
        lines = (line.decode(errors="replace") for line in file)
        head = "".join(takewhile(lambda line: not line.startswith(end), lines))
    found = re.findall(r'^\s*(\d)\s+(\d+)\s+"(.*)"\s*$', head.partition("$PhysicalNames")[2], re.MULTILINE)
    for name, count in Counter(name for *_, name in found).items():
        if count > 1:
            groups = " and ".join(f"{number} of dimension {dim}" for dim, number, other in found if other == name)
            raise GeometryError(f"the physical name {name!r} stands for the groups {groups}; each needs its own name")


def cells_of(mesh: meshio.Mesh) -> Cells:
    """The cells of highest dimension; raises GeometryError if they are not all of one known type, or a surface in space."""
    dim = max((block.dim for block in mesh.cells if len(block)), default=0)
    blocks = [block for block in mesh.cells if len(block) and block.dim == dim]
    kinds = list(dict.fromkeys(block.type for block in blocks))
    if not kinds:
        raise GeometryError("the file has no cells")
    types = ", ".join(f"{sum(len(block) for block in blocks if block.type == kind)} {kind}" for kind in kinds)
    if len(kinds) > 1:
        raise GeometryError(f"mixed cell types: {types}; a joint needs cells of one type")
    kind = kinds[0]
    if kind not in CELLS:
        remedy = next(text for pattern, text in REMEDIES.items() if re.match(pattern, kind))
        raise GeometryError(f"cells of a type that is not allowed: {types}; allowed: {', '.join(CELLS)}; {remedy}")
    cells = np.concatenate([block.data for block in blocks]).astype(np.int64)
    order = dolfinx.cpp.io.perm_vtk(dolfinx.mesh.to_type(CELLS[kind]), cells.shape[1])
    return Cells.of(mesh.points, cells[:, order], CELLS[kind], types)
