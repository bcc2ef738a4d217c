"""Mesh files as meshio reads them: points and cells in DOLFINx's order, and what makes them unusable."""

from __future__ import annotations

import io
import re
import warnings
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import dolfinx
import meshio
import numpy as np
import numpy.typing as npt
import scipy.spatial

from geometry.joint import GeometryError, place, unknown
from geometry.topology import FACET_TYPES, FacetTable, FloatArray, IntArray, corner_count, node_jacobians

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
CLOSE = 1e-9  # of the mesh's size: nodes this close to each other are two nodes at one place
FLAT_CELL = 1e-12  # Jacobian over size^d of a cell without volume
FOLDED = 1e-10  # smallest over largest Jacobian in a cell that is folded


def load(path: Path, scale: float) -> meshio.Mesh:
    """The file as meshio reads it, without what meshio prints; coordinates times a factor.

    Raises:
        GeometryError: no such file, not readable, or a physical name is there twice.
    """
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
    except (Exception, SystemExit) as error:  # meshio leaves Python when no reader succeeds
        why = " ".join(said.getvalue().split()) if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        hint = "; in gmsh save with Mesh.SaveAll = 0, Mesh.SaveParametric = 0" if path.suffix.lower() == ".msh" else ""
        raise GeometryError(f"meshio cannot read this {path.suffix} file ({why}){hint}") from None
    mesh.points = np.asarray(mesh.points, float) * scale
    return mesh


def _require_single_names(path: Path) -> None:
    """Raise GeometryError for a physical name that stands for two groups, of which meshio would drop one."""
    end = ("$EndPhysicalNames", "$Nodes", "$Elements")
    with path.open("rb") as file:
        lines = (line.decode(errors="replace") for line in file)
        head = "".join(takewhile(lambda line: not line.startswith(end), lines))
    found = re.findall(r'^\s*(\d)\s+(\d+)\s+"(.*)"\s*$', head.partition("$PhysicalNames")[2], re.MULTILINE)
    for name, count in Counter(name for *_, name in found).items():
        if count > 1:
            groups = " and ".join(f"{number} of dimension {dim}" for dim, number, other in found if other == name)
            raise GeometryError(f"the physical name {name!r} stands for the groups {groups}; each needs its own name")


@dataclass(frozen=True)
class Cells:
    """The cells of highest dimension of a file.

    Attributes:
        points: (n_points, d) coordinates of their nodes.
        nodes: (n_cells, k) in DOLFINx's order.
        type: as in `Joint.cell_type`.
        used: (n_points,) numbers of these points in the file.
    """

    points: FloatArray
    nodes: IntArray
    type: str
    used: IntArray

    @classmethod
    def of(cls, mesh: meshio.Mesh) -> Cells:
        """Take the cells over; raises GeometryError if they are not all of one known type, or a surface in space."""
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
        used, nodes = np.unique(cells[:, order], return_inverse=True)
        if used[0] < 0 or used[-1] >= len(mesh.points) or not np.isfinite(mesh.points[used]).all():
            raise GeometryError("the cells have nodes without coordinates")
        points = mesh.points[used]
        height = points[:, dim:]
        if height.size and np.ptp(height) > CLOSE * np.ptp(points, axis=0).max():
            raise GeometryError(
                f"2D mesh in 3D: {types} at z = {height.min():g} to {height.max():g}, not in a plane z = const; "
                "for a solid save the cells of the volume too (gmsh: name them with Physical Volume)"
            )
        return cls(points[:, :dim].copy(), nodes.reshape(cells.shape), CELLS[kind], used)

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) vertices of each cell."""
        return self.nodes[:, : corner_count(self.type)]

    def refuse(self, bad: npt.NDArray[np.bool_], what: str) -> None:
        """Raise GeometryError if there are bad cells, with their number and the first one's place."""
        if bad.any():
            x = self.points[self.nodes[bad.argmax()]].mean(axis=0)
            raise GeometryError(f"{bad.sum()} of {len(bad)} cells {what}; the first is at {place(x)}")

    def require_sound(self) -> None:
        """Raise GeometryError for cells without volume, folded or there twice, and for nodes at the same place."""
        size = np.ptp(self.points[self.nodes], axis=1).max(axis=1)
        jacobian = node_jacobians(self.points, self.nodes, self.type)
        largest = np.abs(jacobian).max(axis=1)
        self.refuse(largest <= FLAT_CELL * size ** self.points.shape[1], "are degenerate (no volume)")
        smallest = (jacobian * np.sign(jacobian.sum(axis=1))[:, None]).min(axis=1)
        self.refuse(
            smallest <= FOLDED * largest, "are folded (their Jacobian vanishes or changes sign within the cell)"
        )
        _, first = np.unique(np.sort(self.corners, axis=1), axis=0, return_index=True)
        self.refuse(
            ~np.isin(np.arange(len(self.nodes)), first),
            "have the vertices of another cell; each needs to be there once, in one group",
        )
        tree = scipy.spatial.cKDTree(self.points)
        pairs = tree.query_pairs(CLOSE * np.ptp(self.points, axis=0).max(), output_type="ndarray")
        if len(pairs):
            x = self.points[pairs[pairs[:, 0].argmin(), 0]]
            raise GeometryError(
                f"{len(pairs)} pairs of nodes at the same place, the first at {place(x)}: the cells there are not "
                "connected; let bodies share their nodes (gmsh: BooleanFragments or Coherence before meshing, "
                f"removeDuplicateNodes after it), or, for a gap that is to stay unbonded, draw it wider than {CLOSE:g} of "
                "the mesh's size"
            )

    def facets_among(self, vertices: IntArray) -> FacetTable:
        """Facets of the cells that have a whole facet among the given vertices; cells numbered as in `nodes`."""
        near = np.flatnonzero(np.isin(self.corners, vertices).sum(axis=1) >= corner_count(FACET_TYPES[self.type]))
        try:
            table = FacetTable.of(self.corners[near], self.type)
        except ValueError as error:
            raise GeometryError(str(error)) from None
        return replace(table, cells=np.where(table.cells < 0, -1, near[table.cells]))
