"""Cells above S if the same body is on both sides of S."""

from __future__ import annotations

import basix
import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from forms.base import InputError
from geometry.topology import FACET_TYPES, FacetTable, FloatArray, IntArray

LEAST_COSINE = 0.02  # smallest cosine allowed between the direction of the upper side and the normals of S


def sides_by_direction(
    corners: IntArray, cell_type: str, table: FacetTable, rows: IntArray, upper: IntArray
) -> IntArray:
    """(n_cells,) +1 above S, -1 elsewhere, for S inside one body.

    Where S cuts the body in two, each part is a side. Where S ends inside, only cells that touch S are sorted: around
    each vertex and edge of S they fall into the groups that S separates. At the tip there is one group only.

    Args:
        corners: (n_cells, k) vertices of cells.
        cell_type: type of these cells.
        table: facets of these cells.
        rows: facets of S.
        upper: the cell above each of these facets.

    Raises:
        InputError: the sides of S change along S, or a cell lies above one part of S and below another.
    """
    inner = np.flatnonzero(table.cells[:, 1] >= 0)
    inner = inner[~np.isin(inner, rows)]
    lower = table.cells[rows].sum(axis=1) - upper
    part = _components(table.cells[inner], len(corners))
    if not np.isin(part[upper], part[lower]).any():
        return np.where(np.isin(part, part[upper]), 1, -1)

    above, below = np.zeros(len(corners), bool), np.zeros(len(corners), bool)
    above[upper], below[lower] = True, True
    for dim in range(len(basix.topology(basix.CellType[cell_type])) - 2):  # vertices of S, in 3D its edges too
        in_cells = _entities(corners, cell_type, dim)
        facet_type, ordered = FACET_TYPES[cell_type], table.nodes(inner, corners, cell_type)
        in_facets = _entities(ordered, facet_type, dim)
        in_surface = _entities(table.nodes(rows, corners, cell_type), facet_type, dim)
        mark_above, mark_below = _sorted_around(in_cells, in_facets, in_surface, table.cells[inner], upper, lower)
        above[mark_above], below[mark_below] = True, True
    if (above & below).any():
        raise InputError(f"{(above & below).sum()} cells lie above one part of S and below another")
    return np.where(above, 1, -1)


def _entities(rows: IntArray, cell_type: str, dim: int) -> IntArray:
    """Keys of the vertices (dim 0) or edges (dim 1) of cells or facets given by their vertices."""
    local = np.array(basix.topology(basix.CellType[cell_type])[dim])
    ends = np.sort(rows[:, local], axis=2)
    return (ends[:, :, 0] << 32) + ends[:, :, -1]


def _sorted_around(
    in_cells: IntArray, in_facets: IntArray, in_surface: IntArray, pairs: IntArray, upper: IntArray, lower: IntArray
) -> tuple[IntArray, IntArray]:
    """Cells above and cells below S among those around each vertex (or edge) of S.

    Args:
        in_cells, in_facets, in_surface: keys of these entities in all cells, in the inner facets that are not in S, in
            the facets of S.
        pairs: the two cells at each of these inner facets.
        upper, lower: cells at each facet of S.
    """
    around = np.unique(in_surface)
    cell, position = np.nonzero(np.isin(in_cells, around))
    entity = np.searchsorted(around, in_cells[cell, position])
    key = cell * len(around) + entity  # one node of a graph per cell and entity in it
    order = np.argsort(key)

    def node(cells: IntArray, entities: IntArray) -> IntArray:
        wanted = cells * len(around) + np.searchsorted(around, entities)
        return order[np.searchsorted(key, wanted, sorter=order)]

    facet, position = np.nonzero(np.isin(in_facets, around))
    links = [node(pairs[facet, k], in_facets[facet, position]) for k in (0, 1)]
    group = _components(np.column_stack(links), len(key))
    above, below = (
        np.unique(group[node(np.repeat(cells, in_surface.shape[1]), in_surface.ravel())]) for cells in (upper, lower)
    )
    groups_at = np.unique(np.column_stack([group, entity]), axis=0)
    several = np.bincount(groups_at[:, 1])[groups_at[:, 1]] > 1
    both = np.intersect1d(above, below)
    if np.isin(both, groups_at[several, 0]).any():
        raise InputError("it points out of S in one part and into it in another")
    above, below = np.setdiff1d(above, both), np.setdiff1d(below, both)
    return cell[np.isin(group, above)], cell[np.isin(group, below)]


def _components(pairs: IntArray, n: int) -> IntArray:
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], np.int64)


def upper_cells(centres: FloatArray, cells: IntArray, x: FloatArray, n: FloatArray, direction: FloatArray) -> IntArray:
    """For each facet of S, the cell on the side that the direction points to.

    Args:
        centres: (n_cells, d) of all cells.
        cells: (n_S, 2) the cells at each facet.
        x, n: (n_S, d) centres and normals (either direction, any length) of the facets.
        direction: (d,) vector to the upper side.

    Raises:
        InputError: the direction lies in a facet.
    """
    cosine = n @ direction / np.linalg.norm(n, axis=1) / np.linalg.norm(direction)
    along = np.abs(cosine) < LEAST_COSINE
    if along.any():
        raise InputError(f"it lies in S near ({', '.join(f'{c:.6g}' for c in x[along][0])})")
    first = ((centres[cells[:, 0]] - x) * n).sum(axis=1) * cosine > 0
    return np.where(first, cells[:, 0], cells[:, 1])
