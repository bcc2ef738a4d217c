"""Cells and facets as plain arrays: which facets a mesh has, which cells meet there, which cells are folded."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]

CELL_TYPES = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def local_facets(cell_type: str) -> list[list[int]]:
    """Local vertices of each facet of a cell, in DOLFINx's order."""
    cell = basix.CellType[cell_type]
    return basix.topology(cell)[len(basix.topology(cell)) - 2]


def is_tensor(cell_type: str) -> bool:
    """Whether cells are quadrilaterals or hexahedra."""
    return cell_type in ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class FacetTable:
    """All facets of a mesh.

    Attributes:
        vertices: (n_facets, k) sorted vertex numbers, rows unique and in lexicographic order.
        cells: (n_facets, 2) the cells that meet there; -1 in the second column on the outer boundary.
    """

    vertices: IntArray
    cells: IntArray

    @classmethod
    def of(cls, cells: IntArray, cell_type: str) -> FacetTable:
        """The table of a mesh; raises ValueError if more than two cells share a facet."""
        local = local_facets(cell_type)
        rows = np.sort(np.concatenate([cells[:, f] for f in local]), axis=1)
        owner = np.tile(np.arange(len(cells)), len(local))
        vertices, index, counts = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
        if counts.max(initial=0) > 2:
            raise ValueError(f"{(counts > 2).sum()} facets belong to more than two cells: the mesh is not conforming")
        order = np.argsort(index.ravel(), kind="stable")
        start = np.concatenate([[0], np.cumsum(counts)[:-1]])
        pairs = np.full((len(vertices), 2), -1, np.int64)
        pairs[:, 0] = owner[order[start]]
        double = counts == 2
        pairs[double, 1] = owner[order[start[double] + 1]]
        return cls(vertices, pairs)

    def index(self, facets: IntArray) -> IntArray:
        """Rows of this table for facets given by vertices in any order; -1 where the mesh has no such facet."""
        wanted = np.sort(facets, axis=1)
        both, inverse = np.unique(np.concatenate([self.vertices, wanted]), axis=0, return_inverse=True)
        row = np.full(len(both), -1, np.int64)
        inverse = inverse.ravel()
        row[inverse[: len(self.vertices)]] = np.arange(len(self.vertices))
        return row[inverse[len(self.vertices) :]]


def corner_jacobians(points: FloatArray, cells: IntArray, cell_type: str) -> FloatArray:
    """Signed Jacobian determinants, (n_cells, n_corners): one sign over a row means the cell is not folded."""
    dim = points.shape[1]
    if not is_tensor(cell_type):
        return np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])[:, None]
    determinants = []
    for corner in range(2**dim):
        sign = [1 if not (corner >> axis) & 1 else -1 for axis in range(dim)]
        edges = [sign[a] * (points[cells[:, corner ^ (1 << a)]] - points[cells[:, corner]]) for a in range(dim)]
        determinants.append(np.linalg.det(np.stack(edges, axis=1)))
    return np.stack(determinants, axis=1)


def facet_normals(points: FloatArray, facets: IntArray) -> FloatArray:
    """Unit normals of straight facets (either direction), (n_facets, d)."""
    x = points[facets]
    if points.shape[1] == 2:
        edge = x[:, 1] - x[:, 0]
        normal = np.array([-edge[:, 1], edge[:, 0]]).T
    else:
        normal = np.asarray(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), float)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True), float)
