"""Distribution of a joint's cells over MPI ranks by recursive coordinate bisection, with ghost cells across facets."""

from __future__ import annotations

from collections.abc import Callable

import dolfinx
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from geometry.joint import Joint
from geometry.parallel import on_root
from geometry.topology import FloatArray, Indices, IntArray, Scalar, positions

Partitioner = Callable[..., dolfinx.cpp.graph.AdjacencyList_int32]


def bisect(x: FloatArray, n_groups: int) -> Indices:
    """Divide places into groups of nearly equal size by repeated cuts across their longest extent.

    Args:
        x: (n, d) coordinates of n places in d dimensions, in any unit.
        n_groups: number of groups, which are numbered from 0.

    Returns:
        (n,) number of the group of each place.
    """
    group_numbers, low = np.zeros(len(x), np.int32), n_groups // 2
    if low and len(x):
        order = np.argsort(x[:, np.ptp(x, axis=0).argmax()], kind="stable")
        first, second = np.split(order, [len(x) * low // n_groups])
        group_numbers[first] = bisect(x[first], low)
        group_numbers[second] = low + bisect(x[second], n_groups - low)
    return group_numbers


def column_numbers(joint: Joint) -> tuple[IntArray, FloatArray]:
    """Return the number of the column that contains each cell of the layers, and the centres of all columns.

    A column is the set of cells above each other through a layer's thickness, over one facet of S. Cells of a junction
    over the same part of S also form a column. In a joint without meshed layers, each facet of S is a column.

    Returns:
        (n_cells,) number of the column of each cell, -1 in bodies; without meshed layers, (n_facets,) number of the
        column of each facet in `Joint.table`, -1 outside S. And (n_columns, d) centres of the columns on S in the joint
        as drawn, lengths.
    """
    if joint.band is None:
        rows = joint.surface_rows
        return positions(rows, len(joint.table.vertices)), joint.points[joint.table.vertices[rows]].mean(axis=1)
    layer_cells = np.flatnonzero(np.isin(joint.region, [joint.regions.index(name) for name in joint.band.regions]))
    points, point = np.unique(joint.reference, axis=0, return_inverse=True)
    s_vertices = np.sort(point.ravel()[joint.corners[layer_cells]], axis=1)  # the facet's vertices, some of them twice
    s_vertices[:, 1:][s_vertices[:, 1:] == s_vertices[:, :-1]] = -1
    facets, column = np.unique(np.sort(s_vertices, axis=1), axis=0, return_inverse=True)
    cell_columns = np.full(len(joint.cells), -1, np.int64)
    cell_columns[layer_cells] = column.ravel()
    is_vertex = (facets >= 0)[:, :, None]
    return cell_columns, (points[facets] * is_vertex).sum(axis=1) / is_vertex.sum(axis=1)


def destination_ranks(joint: Joint, n_ranks: int) -> tuple[IntArray, Indices]:
    """Return the ranks that get each of the n cells of a joint: its owner, and the ranks that have it as a ghost.

    Args:
        joint: the joint.
        n_ranks: number of ranks.

    Returns:
        (n + 1,) position in the second array where the ranks of each cell begin; and these ranks for all cells, for
        each cell the owner first.
    """
    owner = bisect(sum(joint.points[corner] for corner in joint.corners.T), n_ranks)  # faster than means of short rows
    if joint.band is not None:  # columns of cells of layers stay whole, as laws may need their means
        cells = np.flatnonzero((column := column_numbers(joint)[0]) >= 0)
        owner[cells] = owner[cells[np.unique(column[cells], return_index=True)[1]]][column[cells]]
    first, second = joint.table.cells.T
    split_neighbours = joint.table.cells[(owner[first] != owner[second]) & (second >= 0)]
    ghosts = np.unique(np.column_stack([split_neighbours.ravel(), owner[split_neighbours[:, ::-1]].ravel()]), axis=0)
    n_copies = 1 + np.bincount(ghosts[:, 0], minlength=len(owner))
    return np.append(0, n_copies.cumsum()), np.insert(owner, ghosts[:, 0] + 1, ghosts[:, 1])


def rows_of_rank(rows: npt.NDArray[Scalar], rank: int, n_ranks: int) -> npt.NDArray[Scalar]:
    """Return the consecutive rows of an array that one of several ranks passes to DOLFINx.

    Args:
        rows: array with one row for each point, or for each cell.
        rank: number of the rank.
        n_ranks: number of ranks; each gets nearly the same number of rows.
    """
    return rows[len(rows) * rank // n_ranks : len(rows) * (rank + 1) // n_ranks]


def make_partitioner(joint: Joint, comm: MPI.Intracomm) -> Partitioner | None:
    """Return the function by which DOLFINx's `create_mesh` distributes a joint's cells; None for one rank. Collective.

    It sends each cell that this rank passes to its owner, and as a ghost to the owners of its neighbours across facets.

    Args:
        joint: the joint; each rank passes the cells in `rows_of_rank`.
        comm: communicator of the mesh.
    """
    if comm.size == 1:
        return None
    starts, ranks = on_root(comm, lambda: destination_ranks(joint, comm.size))
    own_cells = rows_of_rank(np.arange(len(joint.cells)), comm.rank, comm.size)
    indptr = starts[own_cells[0] : own_cells[-1] + 2] if len(own_cells) else starts[:1]
    graph = dolfinx.cpp.graph.AdjacencyList_int32(ranks[indptr[0] : indptr[-1]], (indptr - indptr[0]).astype(np.int32))
    return lambda *_: graph
