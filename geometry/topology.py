"""Cells and facets as plain arrays: which facets a mesh has, which cells meet there, normals, folded cells."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import basix
import numpy as np
import numpy.typing as npt

from forms.base import InputError

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

BITS = 31  # bits for a vertex number in a key
CELL_TYPES = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
FACET_TYPES = {
    "triangle": "interval",
    "quadrilateral": "interval",
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
}


@cache
def lagrange(cell_type: str, degree: int) -> basix.finite_element.FiniteElement:
    """The scalar Lagrange element whose nodes carry the geometry of cells, vertices first."""
    return basix.create_element(basix.ElementFamily.P, basix.CellType[cell_type], degree)


def corner_count(cell_type: str) -> int:
    """Number of vertices of a cell."""
    return int(lagrange(cell_type, 1).dim)


def geometry_degree(cell_type: str, n_nodes: int) -> int:
    """Degree of cells with that many nodes, 1 or 2; raises InputError for another number."""
    allowed = {int(lagrange(cell_type, degree).dim): degree for degree in (1, 2)}
    if n_nodes not in allowed:
        raise InputError(f"a {cell_type} has {n_nodes} nodes; allowed: {', '.join(map(str, allowed))}")
    return allowed[n_nodes]


def local_facets(cell_type: str, degree: int = 1) -> IntArray:
    """Local nodes of each facet of a cell, in the order of the facet's own element: (n_facets, nodes per facet)."""
    return np.array(lagrange(cell_type, degree).entity_closure_dofs[-2], np.int64)


def is_tensor(cell_type: str) -> bool:
    """Whether cells are quadrilaterals or hexahedra."""
    return cell_type in ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class FacetTable:
    """All facets of a mesh.

    Attributes:
        vertices: (n_facets, k) sorted vertex numbers, rows unique and in lexicographic order.
        cells: (n_facets, 2) the cells that meet there; -1 in the second column on the outer boundary.
        local: (n_facets, 2) which facet of each of these cells it is; -1 where there is no cell.

    Rows are found vertex by vertex: `_keys[k]` holds the different tuples of the first k + 2 vertices in ascending order,
    each as one integer: the number of the tuple of the first k + 1 vertices, then the last vertex.
    """

    vertices: IntArray
    cells: IntArray
    local: npt.NDArray[np.int8]
    _keys: tuple[IntArray, ...] = field(repr=False)

    @classmethod
    def of(cls, corners: IntArray, cell_type: str) -> FacetTable:
        """The table of a mesh given by its cells' vertices; raises InputError if more than two cells share a facet."""
        rows = np.sort(np.concatenate([corners[:, f] for f in local_facets(cell_type)]), axis=1)
        beginning, keys = rows[:, 0], []
        for column in rows.T[1:-1]:
            key, beginning = np.unique(beginning << BITS | column, return_inverse=True)
            keys.append(key)
        whole = beginning << BITS | rows[:, -1]
        order = np.argsort(whole, kind="stable")
        whole = whole[order]
        start = np.flatnonzero(np.diff(whole, prepend=-1))
        keys.append(whole[start])
        counts = np.diff(start, append=len(whole))
        if counts.max(initial=0) > 2:
            raise InputError(f"{(counts > 2).sum()} facets belong to more than two cells: the mesh is not conforming")
        double = counts == 2
        pairs = np.full((len(start), 2), -1, np.int64)  # positions among all cells' facets
        pairs[:, 0] = order[start]
        pairs[double, 1] = order[start[double] + 1]
        local, cells = np.divmod(pairs, max(len(corners), 1))
        cells[~double, 1] = -1
        return cls(rows[pairs[:, 0]], cells, local.astype(np.int8), tuple(keys))

    def index(self, facets: IntArray) -> IntArray:
        """Rows of this table for facets given by vertices in any order; -1 where the mesh has no such facet."""
        columns = np.sort(facets, axis=1).T
        number, found = columns[0], ((columns >= 0) & (columns < 1 << BITS)).all(axis=0)
        for column, key in zip(columns[1:], self._keys, strict=True):
            wanted = np.where(found, number << BITS | column, -1)
            number = np.searchsorted(key, wanted)
            found &= np.searchsorted(key, wanted, "right") > number
        return np.where(found, number, -1)

    def nodes(self, rows: IntArray, cells: IntArray, cell_type: str) -> IntArray:
        """Nodes of facets, (n, nodes per facet), in the order of the facet's own element; `cells`: all nodes of cells."""
        local = local_facets(cell_type, geometry_degree(cell_type, cells.shape[1]))[self.local[rows, 0]]
        return np.take_along_axis(cells[self.cells[rows, 0]], local, axis=1)


def ridges(facets: IntArray, cell_type: str) -> tuple[IntArray, IntArray]:
    """Ridges of facets, vertices in 2D and edges in 3D: (n, k) their sorted vertices, and the number of facets at each.

    Args:
        facets: (n_facets, m) nodes in the order of the facet's own element.
        cell_type: type of the cells.
    """
    element = lagrange(FACET_TYPES[cell_type], 1)
    rows = np.concatenate([facets[:, ridge] for ridge in element.entity_closure_dofs[-2]])
    found, counts = np.unique(np.sort(rows, axis=1), axis=0, return_counts=True)
    return found, counts


def ridge_keys(rows: IntArray) -> IntArray:
    """(n,) a number for each ridge, given by one vertex or two, (n, k)."""
    ordered = np.sort(rows, axis=1)
    return np.asarray((ordered[:, 0] << BITS) + ordered[:, -1])


def node_jacobians(points: FloatArray, cells: IntArray, cell_type: str) -> FloatArray:
    """Signed Jacobian determinants at the nodes of cells: one sign over a row means the cell is not folded.

    Shape (n_cells, n_nodes); (n_cells, 1) for straight-sided simplices, whose Jacobian is constant.
    """
    element = lagrange(cell_type, geometry_degree(cell_type, cells.shape[1]))
    at = element.points[:1] if element.degree == 1 and not is_tensor(cell_type) else element.points
    gradients = element.tabulate(1, at)[1:, :, :, 0]
    return np.linalg.det(np.einsum("tqn,cnd->cqtd", gradients, points[cells]))


def facet_normals(points: FloatArray, nodes: IntArray, cell_type: str) -> FloatArray:
    """Unit normals (either direction) at the nodes of facets, (n_facets, n_nodes, d); nodes in the facet's own order."""
    facet_type = FACET_TYPES[cell_type]
    element = lagrange(facet_type, geometry_degree(facet_type, nodes.shape[1]))
    gradients = element.tabulate(1, element.points)[1:, :, :, 0]
    tangents = np.einsum("tqn,fnd->tfqd", gradients, points[nodes])
    if points.shape[1] == 2:
        normal = np.stack([-tangents[0, ..., 1], tangents[0, ..., 0]], axis=-1)
    else:
        normal = np.cross(tangents[0], tangents[1])
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True), float)
