"""Splitting of a mesh along some of its facets: into which components the cells around each entity fall.

The cells around a vertex, an edge or a face are in one component there if facets that are not cut lead from one to the
other, around this entity. A vertex on a cut has two components, one at its tip, three where three cuts meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import basix
import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from geometry.topology import BITS, FacetTable, IntArray, geometry_degree, lagrange


@dataclass(frozen=True)
class Splitting:
    """The components of a mesh that is cut along some facets. The cut does not depend on the numbers of cells.

    Attributes:
        cells: (n_cells, k) nodes, vertices first.
        cell_type: type of the cells.
        table: their facets.
        cut: (m,) rows of `table`.
    """

    cells: IntArray
    cell_type: str
    table: FacetTable
    cut: IntArray

    @cached_property
    def _topology(self) -> list[IntArray]:
        return [np.array(of_dim) for of_dim in basix.topology(basix.CellType[self.cell_type])]

    @property
    def _corners(self) -> IntArray:
        return self.cells[:, : len(self._topology[0])]

    def entities(self, dim: int) -> IntArray:
        """(n_cells, entities of a cell) number of each of the cell's entities of a dimension, among those of the mesh."""
        topology = self._topology
        top = len(topology) - 1
        if dim == top:
            return np.arange(len(self.cells))[:, None]
        if dim == 0:
            return self._corners
        if dim == top - 1:
            out = np.empty((len(self.cells), len(topology[dim])), np.int64)
            for cell, local in zip(self.table.cells.T, self.table.local.T, strict=True):
                there = np.flatnonzero(cell >= 0)
                out[cell[there], local[there]] = there
            return out
        ends = np.sort(self._corners[:, topology[dim]], axis=2)
        _, number = np.unique((ends[..., 0] << BITS) + ends[..., 1], return_inverse=True)
        return np.asarray(number.reshape(ends.shape[:2]), np.int64)

    @cached_property
    def keys(self) -> list[IntArray]:
        """For each dimension (n_cells, entities of a cell): a number >= 0 for each component of each entity of the mesh."""
        out, start = [], 0
        for dim in range(len(self._topology)):
            numbers, split = self.entities(dim), self.components(dim)
            count = int(split.max(initial=0)) + 1
            out.append(start + numbers * count + split)
            start += (int(numbers.max(initial=-1)) + 1) * count
        return out

    @cached_property
    def _touched(self) -> IntArray:
        """(n_cells, corners) whether each corner lies on the cut."""
        on_cut = np.zeros(int(self.cells.max(initial=-1)) + 1, bool)
        on_cut[self.table.vertices[self.cut]] = True
        return on_cut[self._corners]

    def components(self, dim: int) -> IntArray:
        """(n_cells, entities of a cell) number of the cell's component around each of its entities of a dimension.

        The component with the smallest cell has number 0; so have all cells around entities that are not split.
        """
        topology = self._topology
        out = np.zeros((len(self.cells), len(topology[dim])), np.int64)
        top = len(topology) - 1
        if dim == top - 1:
            second = self.table.cells[self.cut, 1] >= 0
            rows = self.cut[second]
            out[self.table.cells[rows, 1], self.table.local[rows, 1]] = 1
        elif dim < top - 1:
            self._around(dim, out)
        return out

    def _around(self, dim: int, out: IntArray) -> None:
        """Fill in the components around vertices, or edges of a mesh in 3D."""
        near = np.flatnonzero(self._touched.any(axis=1))
        local = self._topology[dim]
        touched = self._touched[near][:, local].any(axis=2)
        ends = np.sort(self._corners[near][:, local], axis=2)
        keys = (ends[..., 0] << BITS) + ends[..., -1]
        position = np.full(len(self.cells), -1, np.int64)
        position[near] = np.arange(len(near))

        first, second = self.table.cells.T
        linked = (second >= 0) & (position[first] >= 0) & (position[second] >= 0)
        linked[self.cut] = False
        facets = np.flatnonzero(linked)
        pairs = position[self.table.cells[facets]]
        inside = np.array(
            [[i for i, entity in enumerate(local) if set(entity) <= set(facet)] for facet in self._topology[-2]]
        )
        links: list[IntArray] = []
        for cell, facet in zip(pairs.T, self.table.local[facets].T, strict=True):
            entity = inside[facet]
            order = np.argsort(np.take_along_axis(keys[cell], entity, axis=1), axis=1)
            links.append((cell[:, None] * len(local) + np.take_along_axis(entity, order, axis=1)).ravel())
        label = connected(links[0], links[1], keys.size)

        _, first_place = np.unique(label, return_index=True)  # of each component; places are in the order of cells
        order = np.lexsort((first_place, keys.ravel()[first_place]))
        start = np.flatnonzero(np.diff(keys.ravel()[first_place][order], prepend=-1))
        number = np.empty(len(order), np.int64)
        number[order] = np.arange(len(order)) - np.repeat(start, np.diff(start, append=len(order)))
        out[near] = np.where(touched, number[label].reshape(keys.shape), 0)

    @cached_property
    def of_nodes(self) -> IntArray:
        """(n_cells, k) number of the cell's component around each of its nodes."""
        dofs = lagrange(self.cell_type, geometry_degree(self.cell_type, self.cells.shape[1])).entity_dofs
        out = np.zeros(self.cells.shape, np.int64)
        for dim, of_dim in enumerate(dofs[:-1]):
            if any(map(len, of_dim)):
                numbers = self.components(dim)
                for entity, nodes in enumerate(of_dim):
                    out[:, nodes] = numbers[:, [entity]]
        return out

    @cached_property
    def copies(self) -> tuple[IntArray, IntArray]:
        """The nodes of the split mesh beyond those of the mesh: (m, 2) node and component > 0, in ascending order.

        And (n_cells, k) nodes of the split mesh: component 0 keeps a node's number, copies follow after the last node.
        """
        split, n = self.of_nodes, int(self.cells.max(initial=-1)) + 1
        where = np.nonzero(split)
        pairs, number = np.unique(np.column_stack([self.cells[where], split[where]]), axis=0, return_inverse=True)
        cells = self.cells.copy()
        cells[where] = n + number.ravel()
        return pairs, cells

    @cached_property
    def pieces(self) -> IntArray:
        """(n_cells,) number of the connected piece of each cell, in the order of their first cells."""
        corners = self.copies[1][:, : self._corners.shape[1]]
        first = corners[:, :1].repeat(corners.shape[1] - 1, axis=1)
        label = connected(first.ravel(), corners[:, 1:].ravel(), int(corners.max(initial=-1)) + 1)[corners[:, 0]]
        _, start, number = np.unique(label, return_index=True, return_inverse=True)
        return np.argsort(np.argsort(start))[number.ravel()]

    @cached_property
    def valence(self) -> IntArray:
        """(n_points,) number of components of the cells around each vertex; 0 for nodes that are no vertices."""
        corners, split = self._corners, self.of_nodes[:, : self._corners.shape[1]]
        out = np.zeros(int(self.cells.max(initial=-1)) + 1, np.int64)
        np.maximum.at(out, corners.ravel(), split.ravel() + 1)
        return out


def connected(first: IntArray, second: IntArray, n: int) -> IntArray:
    """(n,) labels of the connected components of a graph, given by its links."""
    graph = scipy.sparse.coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)
