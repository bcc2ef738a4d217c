"""Cells and facets as plain arrays: facets of a mesh, meshes with cuts, and orders in which places are sorted.

In a mesh that is cut along some facets, the cells around a vertex, edge or face form components. A component is a group
of cells that are connected there by uncut facets. Around a vertex inside a cut there are two components. Around a
vertex at the tip of a cut there is one, and where three cuts meet there are three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, reduce
from itertools import combinations
from typing import TypeVar

import basix
import numpy as np
import numpy.typing as npt
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from forms.base import InputError

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)  # type of the values of an array
Indices = npt.NDArray[np.int32]  # of entities and degrees of freedom on a rank, as in dolfinx

VERTEX_KEY_BITS = 31  # bits for a vertex number in a key
CELL_TYPES = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
FACET_TYPES = dict(zip(CELL_TYPES, ("interval", "interval", "triangle", "quadrilateral"), strict=True))


@cache
def lagrange(cell_type: str, degree: int) -> basix.finite_element.FiniteElement:
    """Return Basix's scalar Lagrange element whose nodes are the geometry nodes of a cell, vertices first.

    Args:
        cell_type: type of the cell, such as "triangle".
        degree: polynomial degree of the cell's geometry.
    """
    return basix.create_element(basix.ElementFamily.P, basix.CellType[cell_type], degree)


@cache
def sub_entities(cell_type: str) -> list[list[list[list[int]]]]:
    """Return Basix's table of the entities (vertices, edges, ...) of a reference cell that belong to each other.

    Its entry [i][j][k], for k <= i, lists the numbers of the entities of dimension k in entity j of dimension i. For k
    > i it lists those that contain entity j.

    Args:
        cell_type: type of the cell, such as "triangle".
    """
    return basix.cell.sub_entity_connectivity(basix.CellType[cell_type])


def corner_count(cell_type: str) -> int:
    """Return the number of vertices of a cell or facet of the type `cell_type`, such as "triangle"."""
    return int(lagrange(cell_type, 1).dim)


def geometry_degree(cell_type: str, n_nodes: int) -> int:
    """Return the polynomial degree, 1 or 2, of the geometry of cells of type `cell_type` that have `n_nodes` nodes.

    Raises:
        InputError: no degree has this number of nodes.
    """
    degrees = {int(lagrange(cell_type, degree).dim): degree for degree in (1, 2)}
    if n_nodes not in degrees:
        raise InputError(f"a {cell_type} has {n_nodes} nodes; allowed: {', '.join(map(str, degrees))} (degree 1 or 2)")
    return degrees[n_nodes]


def local_facets(cell_type: str, degree: int = 1) -> IntArray:
    """Return (n_facets, m) positions in a cell of the m nodes of each of its facets, as a Lagrange element orders them.

    Args:
        cell_type: type of the cell, such as "triangle".
        degree: polynomial degree of the cell's geometry.
    """
    return np.array(lagrange(cell_type, degree).entity_closure_dofs[-2], np.int64)


def sum_by_number(number: IntArray, values: FloatArray, n: int) -> FloatArray:
    """Return `n` sums along a new first axis: sum j is that of all values whose number is j.

    Args:
        number: integers from 0 to n - 1, an array of any shape.
        values: array whose first axes have the shape of `number`; further axes are kept.
        n: number of sums.
    """
    sums = np.zeros((n, *values.shape[number.ndim :]))
    np.add.at(sums, number, values)
    return sums


def positions(items: IntArray | Indices, n: int) -> IntArray:
    """Return (n,) the position in `items` of each number from 0 to n - 1; -1 for numbers that are not among them.

    Args:
        items: distinct numbers from 0 to n - 1.
        n: length of the result.
    """
    indices = np.full(n, -1, np.int64)
    indices[items] = np.arange(len(items))
    return indices


def is_tensor(cell_type: str) -> bool:
    """Return whether cells of the type `cell_type` are quadrilaterals or hexahedra."""
    return cell_type in ("quadrilateral", "hexahedron")


@cache
def vertex_weights(cell_type: str, degree: int) -> FloatArray:
    """Return (m, k) values of the linear shape functions of a cell's k vertices at its m nodes.

    A node inside an edge, face or cell has equal values for the vertices of that edge, face or cell, and 0 for others.

    Args:
        cell_type: type of the cell.
        degree: degree 1 or 2 of the Lagrange element whose nodes are meant.
    """
    weights = lagrange(cell_type, 1).tabulate(0, lagrange(cell_type, degree).points)[0, :, :, 0]
    return np.asarray(np.rint(8 * weights) / 8)  # without rounding errors: all are multiples of 1/8


def facet_nodes(
    cell_nodes: npt.NDArray[Scalar], cell_type: str, cells: IntArray | Indices, local: IntArray | Indices
) -> npt.NDArray[Scalar]:
    """Return (n, m) numbers of the m nodes of n facets, as a facet's Lagrange element orders them.

    Args:
        cell_nodes: (n_cells, k) numbers of the k nodes of each cell, in the order of an element of Lagrange or, without
            nodes inside faces and cells, of a serendipity element; for example the vertices, or the nodes of a function
            space.
        cell_type: type of the cells, such as "triangle".
        cells: (n,) row in `cell_nodes` of a cell at each facet.
        local: (n,) number of the facet within this cell.
    """
    n_nodes = cell_nodes.shape[1]
    nodes_of_facets = local_facets(cell_type, 1 + (n_nodes > corner_count(cell_type)))
    nodes_of_facets = nodes_of_facets[:, (nodes_of_facets < n_nodes).all(axis=0)]
    return np.take_along_axis(cell_nodes[cells], nodes_of_facets[local], axis=1)


@dataclass(frozen=True)
class FacetTable:
    """All facets of a mesh, each once, with the cells that they belong to.

    Attributes:
        vertices: (n_facets, k) numbers of the k vertices of each facet, ascending. Rows are in lexicographic order.
        cells: (n_facets, 2) numbers of the two cells at each facet; on the outer boundary the second is -1.
        local: (n_facets, 2) number of the facet within each of these cells; -1 where there is no cell.
    """

    vertices: IntArray
    cells: IntArray
    local: npt.NDArray[np.int8]

    @classmethod
    def of(cls, corners: IntArray, cell_type: str) -> FacetTable:
        """Return the facets of a mesh.

        Args:
            corners: (n_cells, m) numbers of the m vertices of each cell.
            cell_type: type of the cells.

        Raises:
            InputError: more than two cells share a facet.
        """
        corners_32 = corners.T.astype(np.int32)  # half the memory, and faster
        vertex_columns = zip(*(corners_32[f] for f in local_facets(cell_type)), strict=True)
        columns = sort_each_row([np.concatenate(column) for column in vertex_columns])
        order = np.lexsort(columns[::-1])
        first_index = np.flatnonzero(_is_new_row(columns, order))
        counts = np.diff(first_index, append=len(order))
        if counts.max(initial=0) > 2:
            raise InputError(f"{(counts > 2).sum()} facets belong to more than two cells: the mesh is not conforming")
        has_two_cells = counts == 2
        facet_pairs = np.full((len(first_index), 2), -1, np.int64)  # positions among all cells' facets
        facet_pairs[:, 0] = order[first_index]
        facet_pairs[has_two_cells, 1] = order[first_index[has_two_cells] + 1]
        vertices = np.stack([column[facet_pairs[:, 0]] for column in columns], axis=1, dtype=np.int64)
        del columns, order, first_index, counts  # they are large
        local, cells = np.divmod(facet_pairs, max(len(corners), 1))
        cells[~has_two_cells, 1] = -1
        return cls(vertices, cells, local.astype(np.int8))

    @cached_property
    def _keys(self) -> npt.NDArray[np.void]:
        return row_keys(self.vertices)

    def index(self, facets: IntArray) -> IntArray:
        """Return (n,) row numbers in this table of n facets; -1 where the mesh has no such facet.

        Args:
            facets: (n, k) numbers of the k vertices of each facet, in any order.
        """
        wanted_keys = row_keys(np.sort(facets, axis=1))
        at = np.searchsorted(self._keys, wanted_keys).clip(max=len(self._keys) - 1)
        return np.where(self._keys[at] == wanted_keys, at, -1)

    def nodes(self, rows: IntArray, cells: IntArray, cell_type: str) -> IntArray:
        """Return (n, m) numbers of the m nodes of n facets, as a facet's Lagrange element orders them.

        Args:
            rows: (n,) row numbers of the facets in this table.
            cells: (n_cells, k) numbers of the k nodes of all cells of the mesh, in DOLFINx's order.
            cell_type: type of the cells.
        """
        return facet_nodes(cells, cell_type, self.cells[rows, 0], self.local[rows, 0])

    def local_in(self, rows: IntArray, cells: IntArray) -> IntArray:
        """Return (n,) the number of each of n facets within one of its cells.

        Args:
            rows: (n,) row numbers of the facets in this table.
            cells: (n,) number of a cell at each facet.
        """
        return self.local[rows, (self.cells[rows] == cells[:, None]).argmax(axis=1)].astype(np.int64)


def sort_each_row(columns: Sequence[IntArray]) -> list[IntArray]:
    """Return a table with each row sorted in ascending order; for few columns this is faster than `np.sort`.

    Args:
        columns: the columns of the table, arrays of one length.

    Returns:
        The columns of the sorted table.
    """
    out = list(columns)
    for end in range(len(out) - 1, 0, -1):
        for k in range(end):
            out[k : k + 2] = np.minimum(out[k], out[k + 1]), np.maximum(out[k], out[k + 1])
    return out


def _is_new_row(columns: Sequence[IntArray], order: IntArray) -> BoolArray:
    """Return (n,) whether each row of a table differs from the row before it, with rows in a given order.

    The result is True for the first row.

    Args:
        columns: the columns of the table.
        order: (n,) row numbers in this order.
    """
    is_new = np.ones(len(order), bool)
    is_new[1:] = reduce(np.logical_or, (np.diff(column[order]) != 0 for column in columns))
    return is_new


def row_keys(rows: IntArray) -> npt.NDArray[np.void]:
    """Return (n,) a string of bytes for each row of integers; bytes sort in the lexicographic order of the rows.

    Args:
        rows: (n, k) integers from 0 to 2^31 - 1.
    """
    return np.ascontiguousarray(rows, ">i4").view(f"V{4 * rows.shape[1]}").ravel()


def ridges(facets: IntArray, cell_type: str) -> tuple[IntArray, IntArray]:
    """Return the ridges of facets (vertices in 2D, edges in 3D), each once, and the number of facets at each.

    Args:
        facets: (n_facets, m) numbers of the m nodes of each facet, as a facet's Lagrange element orders them.
        cell_type: type of the mesh's cells.

    Returns:
        (n, 1) vertex in 2D, or (n, 2) ascending vertices in 3D, of each ridge; and (n,) the numbers of facets.
    """
    rows = np.concatenate([facets[:, ridge] for ridge in local_facets(FACET_TYPES[cell_type])])
    return np.unique(np.sort(rows, axis=1), axis=0, return_counts=True)


def ridge_keys(vertices: IntArray) -> IntArray:
    """Return (n,) an integer key for each ridge; keys are equal only for ridges with the same vertices.

    Args:
        vertices: (n, 1) vertex in 2D, or (n, 2) vertices in 3D, in any order, of each ridge.
    """
    return np.asarray((vertices.min(axis=1) << VERTEX_KEY_BITS) + vertices.max(axis=1))


def facet_ridge_keys(facets: IntArray, k: int) -> IntArray:
    """Return (n, m) integer keys, as from `ridge_keys`, of the ridges of n facets.

    A key is returned for each of the m sets of `k` vertices of a facet. For quadrilateral facets these include the two
    diagonals, which are no ridges.

    Args:
        facets: (n, l) numbers of the l vertices of each facet, in any order.
        k: number of vertices of a ridge, 1 in 2D, 2 in 3D.
    """
    return np.stack([ridge_keys(facets[:, list(pair)]) for pair in combinations(range(facets.shape[1]), k)], axis=1)


def node_jacobians(points: FloatArray, cells: IntArray, cell_type: str) -> FloatArray:
    """Return (n_cells, n_nodes) determinants of the Jacobian at the nodes of cells, in length ** d.

    For straight-sided simplices, whose determinant is constant, the shape is (n_cells, 1). A cell with determinants of
    both signs is folded.

    Args:
        points: (n_points, d) coordinates in d dimensions, lengths.
        cells: (n_cells, n_nodes) numbers of the nodes of each cell.
        cell_type: type of the cells.
    """
    element = lagrange(cell_type, geometry_degree(cell_type, cells.shape[1]))
    if element.degree == 1 and not is_tensor(cell_type):
        first, *others = (points.T[:, nodes] for nodes in cells.T)  # one coordinate at a time is faster
        e_1, *edges = (other - first for other in others)
        normal = np.cross(edges[0], edges[1], axis=0) if edges[1:] else np.stack([edges[0][1], -edges[0][0]])
        return np.asarray((e_1 * normal).sum(axis=0)[:, None])
    gradients = element.tabulate(1, element.points)[1:, :, :, 0]
    return np.linalg.det(np.einsum("tqn,cnd->cqtd", gradients, points[cells]))


def normal_vectors(tangents: FloatArray) -> FloatArray:
    """Return (..., d) normals of facets, of either sign, as long as the area of the facet per area of the reference facet.

    Args:
        tangents: (d - 1, ..., d) derivatives of the place by the coordinates in the reference facet, in d dimensions.
    """
    if tangents.shape[-1] == 3:
        return np.asarray(np.cross(*tangents))
    return np.stack([-tangents[0, ..., 1], tangents[0, ..., 0]], axis=-1)


def nodal_normal_vectors(x: FloatArray, cell_type: str, degree: int) -> FloatArray:
    """Return (n, m, d) `normal_vectors` at the m nodes of Lagrange elements of some degree on n facets.

    Args:
        x: (n, k, d) coordinates of the k nodes of the facets' geometry.
        cell_type: type of the mesh's cells.
        degree: degree of the elements.
    """
    facet_type = FACET_TYPES[cell_type]
    element = lagrange(facet_type, geometry_degree(facet_type, x.shape[1]))
    gradients = element.tabulate(1, lagrange(facet_type, degree).points)[1:, :, :, 0]
    return normal_vectors(np.einsum("tqn,fnd->tfqd", gradients, x))


def facet_normals(points: FloatArray, nodes: IntArray, cell_type: str) -> FloatArray:
    """Return (n_facets, n_nodes, d) unit normals, of either sign, at the nodes of facets in d dimensions.

    Args:
        points: (n_points, d) coordinates, lengths.
        nodes: (n_facets, n_nodes) numbers of the nodes of each facet, as a facet's Lagrange element orders them.
        cell_type: type of the mesh's cells.
    """
    normal = nodal_normal_vectors(points[nodes], cell_type, geometry_degree(FACET_TYPES[cell_type], nodes.shape[1]))
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True), float)


def turned_towards(vectors: FloatArray, to: FloatArray) -> FloatArray:
    """Return vectors (..., d), reversed where they point away from the vectors `to`, of the same or a smaller shape."""
    return vectors * np.sign((vectors * to).sum(axis=-1, keepdims=True))


def unit_normals(x: FloatArray, cell_type: str, degree: int, to: FloatArray) -> FloatArray:
    """Return (n, m, d) unit normals at the m nodes of Lagrange elements on n facets, towards the vectors `to` (n, d).

    The other arguments are those of `nodal_normal_vectors`.
    """
    n = turned_towards(nodal_normal_vectors(x, cell_type, degree), to[:, None])
    return np.asarray(n / np.linalg.norm(n, axis=2, keepdims=True))


@dataclass(frozen=True)
class Splitting:
    """A mesh that is cut along some facets, and the components into which the cut divides the cells around each entity.

    An entity is a vertex, edge, face or cell. Cells around it are in one component if uncut facets that contain the
    entity link them.

    Attributes:
        cells: (n_cells, k) numbers of the k nodes of each cell, vertices first.
        cell_type: type of the cells.
        table: facets of the cells.
        cut_rows: (m,) row numbers in `table` of the facets that are cut.
    """

    cells: IntArray
    cell_type: str
    table: FacetTable
    cut_rows: IntArray

    @cached_property
    def _topology(self) -> list[IntArray]:
        return [np.array(of_dim) for of_dim in basix.topology(basix.CellType[self.cell_type])]

    @property
    def _corners(self) -> IntArray:
        return self.cells[:, : len(self._topology[0])]

    def number_entities(self, dim: int, corners: IntArray) -> IntArray:
        """Return (n, m) a number for each of the m entities of one dimension of each of n cells.

        An entity that several cells share has one number.

        Args:
            dim: dimension of the entities, such as 1 for edges.
            corners: (n, k) numbers of the k vertices of each cell.
        """
        if dim == 0:
            return corners
        entity_vertices = self._topology[dim]
        columns = sort_each_row([corners[:, column].ravel() for column in entity_vertices.T])
        order = np.lexsort(columns[::-1])
        number = np.empty(len(order), np.int64)
        number[order] = _is_new_row(columns, order).cumsum() - 1
        return number.reshape(len(corners), len(entity_vertices))

    @cached_property
    def entity_keys(self) -> list[IntArray]:
        """For each dimension from 0 an array (n_cells, m): numbers of the m entities of each cell in the cut mesh.

        An entity that the cut divides has a different number in each component. Entities of different dimensions have
        different numbers.
        """
        out, start = [], 0
        for dim in range(len(self._topology)):
            numbers, component = self.number_entities(dim, self._corners), self.components(dim)
            count = int(component.max(initial=0)) + 1
            out.append(start + numbers * count + component)
            start += (int(numbers.max(initial=-1)) + 1) * count
        return out

    def components(self, dim: int) -> Indices:
        """Return (n_cells, m) the number of the component that contains each cell, for each of the cell's m entities.

        The components at an entity are groups of the cells around it. Cells are in one group if uncut facets that
        contain the entity link them. The components at each entity are numbered from 0, in the order of the lowest cell
        number in each. All cells around an entity that the cut does not divide have 0.

        Args:
            dim: dimension of the entities, such as 1 for edges.
        """
        local = self._topology[dim]
        component = np.zeros((len(self.cells), len(local)), np.int32)
        if dim == len(self._topology) - 1 or not len(self.cut_rows):
            return component
        is_on_cut = np.zeros(int(self.cells.max()) + 1, bool)
        is_on_cut[self.table.vertices[self.cut_rows]] = True
        is_at_cut = is_on_cut[self._corners]
        cells = np.flatnonzero(is_at_cut.any(axis=1))  # other cells have no split entities
        cell_pairs = positions(cells, len(self.cells))[self.table.cells]
        is_linked = (self.table.cells[:, 1] >= 0) & (cell_pairs >= 0).all(axis=1)
        is_linked[self.cut_rows] = False
        keys = self.number_entities(dim, self._corners[cells])
        inside = np.array([[i for i, row in enumerate(local) if set(row) <= set(each)] for each in self._topology[-2]])
        pairs, entities = cell_pairs[is_linked][..., None], inside[self.table.local[is_linked]]
        order = np.argsort(keys[pairs, entities], axis=2)
        links = pairs * len(local) + np.take_along_axis(entities, order, axis=2)
        group = components(links[:, 0].ravel(), links[:, 1].ravel(), keys.size)

        _, first_index = np.unique(group, return_index=True)  # of each component; places are in the order of cells
        order = np.lexsort((first_index, keys.ravel()[first_index]))
        start = np.flatnonzero(np.diff(keys.ravel()[first_index][order], prepend=-1))
        number = np.empty(len(order), np.int64)
        number[order] = np.arange(len(order)) - np.repeat(start, np.diff(start, append=len(order)))
        component[cells] = np.where(is_at_cut[cells][:, local].any(axis=2), number[group].reshape(keys.shape), 0)
        return component

    @cached_property
    def node_components(self) -> Indices:
        """(n_cells, k) numbers from `components` of each cell, for each of the cell's k nodes.

        A node inside an edge or a face has the components around this edge or face.
        """
        dofs = lagrange(self.cell_type, geometry_degree(self.cell_type, self.cells.shape[1])).entity_dofs
        components = np.zeros(self.cells.shape, np.int32)
        for dim, dim_dofs in enumerate(dofs[:-1]):
            if any(map(len, dim_dofs)):
                numbers = self.components(dim)
                for entity, nodes in enumerate(dim_dofs):
                    components[:, nodes] = numbers[:, [entity]]
        return components

    @property
    def at_vertices(self) -> Indices:
        """(n_cells, k) numbers from `components` of each cell, for each of the cell's k vertices."""
        return self.node_components[:, : self._corners.shape[1]]

    @cached_property
    def pieces(self) -> IntArray:
        """(n_cells,) number of the connected piece of the cut mesh that contains each cell.

        Pieces are numbered from 0, in the order of the lowest cell number in each.
        """
        n_copies = self.at_vertices.max(initial=0) + 1
        copies = self._corners.astype(np.int32) * n_copies + self.at_vertices  # numbers of vertices of the cut mesh
        first = copies[:, :1].repeat(copies.shape[1] - 1, axis=1)
        component = components(first.ravel(), copies[:, 1:].ravel(), int(copies.max(initial=-1)) + 1)[copies[:, 0]]
        _, first_cells, piece = np.unique(component, return_index=True, return_inverse=True)
        return np.argsort(np.argsort(first_cells))[piece]

    @cached_property
    def component_counts(self) -> IntArray:
        """(n_points,) number of components into which the cut divides the cells around each vertex.

        It is 1 at vertices away from the cut, and 0 at nodes that are not vertices.
        """
        out = np.zeros(int(self.cells.max(initial=-1)) + 1, np.int64)
        np.maximum.at(out, self._corners.ravel(), self.at_vertices.ravel() + 1)
        return out


def unique_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct rows of an array, and for each of its rows the position among the distinct ones.

    Args:
        rows: (n, k) integers.

    Returns:
        (m, k) distinct rows, in lexicographic order, and (n,) positions.
    """
    unique, number = np.unique(rows, axis=0, return_inverse=True)
    return unique, number.ravel()


def components(first: IntArray | Indices, second: IntArray | Indices, n: int) -> IntArray:
    """Return (n,) number of the connected component that each of n nodes of a graph is in.

    Args:
        first, second: (m,) nodes at the two ends of each of the m links of the graph.
        n: number of nodes.
    """
    graph = scipy.sparse.coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


PLACE_TOLERANCE = 1e-9  # distance, over the size of the whole, below which two places count as the same


def place_order(x: FloatArray, size: float) -> IntArray:
    """Return (n,) the numbers of n places, sorted by their first coordinate; where it is equal, by the next, and so on.

    Args:
        x: (n, d) coordinates of the places in d dimensions, lengths.
        size: extent of all places, a length; coordinates that differ by less than about 1e-9 of it count as equal.
    """
    return np.lexsort(np.rint(x[:, ::-1] / (PLACE_TOLERANCE * size)).T)


def curve_order(x: FloatArray, links: IntArray, size: float) -> IntArray:
    """Return (n,) the numbers of n places in their order along the curves that links between neighbouring places form.

    Curves follow one another. An open curve starts at the end that comes first in the order of `place_order`. A closed
    curve starts at the place that comes first, and continues to that neighbour which comes first. If another curve
    begins where one ends, it comes next; an example is the layers of mortar under the bricks of one course.

    Args:
        x: (n, 2) coordinates of the places, lengths.
        links: (m, 2) numbers of the two places of each link.
        size: extent of all places, a length; coordinates that differ by less than about 1e-9 of it count as equal.
    """
    order = place_order(x, size)
    rank = np.argsort(order)
    neighbours: list[list[int]] = [[] for _ in x]
    for a, b in np.concatenate([links, links[:, ::-1]]):
        neighbours[int(a)].append(int(b))
    todo, order_along = set(range(len(x))), list[int]()
    rounded = [*map(tuple, np.rint(x / (PLACE_TOLERANCE * size)).astype(np.int64).tolist())]
    ends: dict[tuple[int, ...], list[int]] = {}
    for k, place in enumerate(rounded):
        if len(neighbours[k]) < 2:
            ends.setdefault(place, []).append(k)
    for first in sorted(map(int, order), key=lambda k: len(neighbours[k]) > 1):
        candidates = [first] if first in todo else []
        while candidates:
            at = min(candidates, key=lambda k: int(rank[k]))
            todo.remove(at)
            order_along.append(at)
            candidates = [k for k in neighbours[at] if k in todo] or [k for k in ends.get(rounded[at], ()) if k in todo]
    return np.array(order_along, np.int64)
