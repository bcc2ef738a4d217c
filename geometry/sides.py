"""Which cells lie above S when the same body is on both sides of it."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from geometry.topology import FacetTable, FloatArray, IntArray


def sides_by_direction(corners: IntArray, table: FacetTable, rows: IntArray, upper: IntArray) -> IntArray:
    """(n_cells,) +1 above S, -1 elsewhere, for S inside one body.

    Where S cuts the body in two, each part is a side. Where S ends inside, only cells that touch S are sorted: around
    each vertex of S they fall into the groups that S separates. At the tip there is one group, and nothing to sort.

    Args:
        corners: (n_cells, k) vertices of cells.
        table: their facets.
        rows: facets of S.
        upper: for each of them the cell above it.

    Raises:
        ValueError: a cell lies above one part of S and below another.
    """
    inner = np.flatnonzero(table.cells[:, 1] >= 0)
    inner = inner[~np.isin(inner, rows)]
    lower = table.cells[rows].sum(axis=1) - upper
    part = _components(table.cells[inner], len(corners))
    if not np.isin(part[upper], part[lower]).any():
        return np.where(np.isin(part, part[upper]), 1, -1)

    vertices = np.unique(table.vertices[rows])
    on_s = np.isin(corners, vertices)
    cell, place = np.nonzero(on_s)
    key = cell * (corners.max() + 1) + corners[cell, place]  # one node of the graph per cell and vertex of S in it
    order = np.argsort(key)

    def node(cells: IntArray, vertex: IntArray) -> IntArray:
        return order[np.searchsorted(key, cells * (corners.max() + 1) + vertex, sorter=order)]

    facet, position = np.nonzero(np.isin(table.vertices[inner], vertices))
    shared = table.vertices[inner][facet, position]
    pairs = [node(table.cells[inner[facet], k], shared) for k in (0, 1)]
    group = _components(np.column_stack(pairs), len(key))
    above, below = (
        np.unique(group[node(np.repeat(cells, table.vertices.shape[1]), table.vertices[rows].ravel())])
        for cells in (upper, lower)
    )
    above, below = np.setdiff1d(above, below), np.setdiff1d(below, above)
    is_above, is_below = np.zeros(len(corners), bool), np.zeros(len(corners), bool)
    is_above[cell[np.isin(group, above)]] = True
    is_below[cell[np.isin(group, below)]] = True
    is_above[upper], is_below[lower] = True, True
    if (is_above & is_below).any():
        raise ValueError(f"{(is_above & is_below).sum()} cells lie above one part of S and below another")
    return np.where(is_above, 1, -1)


def _components(pairs: IntArray, n: int) -> IntArray:
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], np.int64)


def upper_cells(
    points: FloatArray, corners: IntArray, table: FacetTable, rows: IntArray, direction: FloatArray
) -> IntArray:
    """For each facet of S, the cell on the side that the direction points to."""
    centre = points[table.vertices[rows]].mean(axis=1)
    first, second = (points[corners[table.cells[rows, k]]].mean(axis=1) - centre for k in (0, 1))
    return np.where((first - second) @ direction > 0, table.cells[rows, 0], table.cells[rows, 1])
