"""Refinement of the cells of layers towards the layers' ends, where stresses change over less than the thickness."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import basix
import numpy as np
from scipy.spatial import cKDTree

from geometry.joint import Joint
from geometry.topology import BoolArray, FloatArray, IntArray, connected, is_tensor, lagrange, local_facets

NODE_TOLERANCE = 1e-10  # largest distance of nodes that count as one, over the size of the joint
LENGTH_TOLERANCE = 1e-9  # relative tolerance of lengths, and tolerance of reference coordinates


class RefinedLayers(NamedTuple):
    """Layers whose cells are parts of coarser cells, so that functions on the coarse cells transfer exactly.

    Attributes:
        joint: the layers with n fine cells.
        parent: (n,) number of the coarse cell that each fine cell is a part of.
        corners: (n, k, d) reference coordinates, in its coarse cell, of the k vertices of each fine cell in d
            dimensions.
    """

    joint: Joint
    parent: IntArray
    corners: FloatArray

    def in_parents(self, X: FloatArray) -> FloatArray:
        """Return, for q places in the reference cell and each fine cell, the reference coordinates in its coarse cell.

        Args:
            X: (q, d) reference coordinates of the places, the same in all fine cells, in d dimensions.

        Returns:
            (n, q, d) reference coordinates of the q places of each of the n fine cells in its coarse cell.
        """
        return np.asarray(_shapes(self.joint.cell_type, 1, X) @ self.corners)


def refined_towards_ends(layers: Joint, distance: FloatArray, size: float) -> RefinedLayers:
    """Return layers with smaller cells at their ends, which are parts of the given cells.

    Edges that begin at an end are halved until they reach no farther than `size` from it.

    Args:
        layers: meshed layers without bodies.
        distance: (n_points,) distance along S of each point from the nearest end, a length; 0 at ends.
        size: this largest distance from the end, a length > 0.
    """
    kind = layers.cell_type
    local = np.array(basix.topology(basix.CellType[kind])[1])  # vertices of edges; parallel edges have one order
    cells: IntArray = layers.corners.copy()
    parent: IntArray = np.arange(len(cells))
    X = np.tile(basix.geometry(basix.CellType[kind]), (len(cells), 1, 1))
    while True:
        pairs, edges = np.unique(np.sort(cells[:, local], axis=2).reshape(-1, 2), axis=0, return_inverse=True)
        edges, (a, b) = edges.reshape(len(cells), -1), pairs.T
        near_end, far_end = np.sort([distance[a], distance[b]], axis=0)
        is_halved = _conforming_edges(kind, edges, far_end, (near_end == 0) & (far_end > size * (1 + LENGTH_TOLERANCE)))
        if not is_halved.any():
            return _refined_joint(layers, parent, X)
        middle = np.where(is_halved, len(distance) - 1 + np.cumsum(is_halved), -1)
        distance = np.concatenate([distance, (near_end + far_end)[is_halved] / 2])
        rows, local_edge = np.nonzero(is_halved[edges])
        rows, local_edge = np.unique(rows), local_edge.reshape(len(np.unique(rows)), -1)
        first, last = np.moveaxis(local[local_edge], 2, 0)
        new, at = middle[edges[rows[:, None], local_edge]], rows[:, None]
        new_X = (X[at, first] + X[at, last]) / 2
        upper, second_X = cells[rows], X[rows]
        index = np.arange(len(rows))[:, None]
        cells[at, last], X[at, last] = new, new_X
        upper[index, first], second_X[index, first] = new, new_X
        cells, X, parent = (np.concatenate(pair) for pair in ((cells, upper), (X, second_X), (parent, parent[rows])))


def _conforming_edges(kind: str, edges: IntArray, far: FloatArray, to_halve: BoolArray) -> BoolArray:
    """Return which edges to halve in one pass, so that the mesh conforms: further passes halve the others.

    In one pass a simplex is halved at one edge. A quadrilateral or hexahedron is halved at one edge and all edges
    parallel to it. This also halves the edges parallel to these in neighbouring cells, and so on.

    Args:
        kind: type of the cells.
        edges: (n, k) numbers, from 0 to m - 1, of the k edges of each cell.
        far: (m,) distance from the layer's end to the farther vertex of each edge, lengths. In simplices edges with
            larger distances come first.
        to_halve: (m,) whether each edge must be halved, now or later.

    Returns:
        (m,) whether each edge is halved in this pass.
    """
    first, last = np.array(basix.topology(basix.CellType[kind])[1]).T
    edge_label = last - first if is_tensor(kind) else np.arange(len(first))  # parallel edges have one label
    parallel, no_edge = [np.flatnonzero(edge_label == label) for label in np.unique(edge_label)], len(far)
    if is_tensor(kind):
        links = np.concatenate([edges[:, [labelled[0], edge]] for labelled in parallel for edge in labelled[1:]])
        group = connected(links[:, 0], links[:, 1], no_edge)
    else:
        group = np.argsort(np.lexsort([np.arange(no_edge), -far]))
    is_halved = np.zeros(no_edge + 1, bool)
    is_halved[group[to_halve]] = True
    in_cell = np.where(is_halved[group], group, no_edge)[edges[:, [labelled[0] for labelled in parallel]]]
    first = in_cell.min(axis=1, keepdims=True)
    alone = (in_cell == first).sum(axis=1, keepdims=True) == 1  # else parallel edges meet in a cell: they stay whole
    is_halved[in_cell[(in_cell != first) | ~alone]] = False
    return np.asarray(is_halved[group])


def _shapes(kind: str, degree: int, X: FloatArray) -> FloatArray:
    """Return the values (..., m) of a cell's m Lagrange shape functions at places of the reference cell.

    Args:
        kind: type of the cell.
        degree: degree of the shape functions, 1 or 2.
        X: (..., d) reference coordinates of the places in d dimensions.
    """
    table = lagrange(kind, degree).tabulate(0, X.reshape(-1, X.shape[-1]))[0, :, :, 0]
    return np.asarray(table.reshape(*X.shape[:-1], -1))


def _refined_joint(layers: Joint, parent: IntArray, corners: FloatArray) -> RefinedLayers:
    """Return the layers with fine cells; regions, facet sets, normals and `reference` come from the coarse cells.

    Args:
        layers: the layers with coarse cells.
        parent: (n,) number of the coarse cell that has each fine cell.
        corners: (n, k, d) reference coordinates, in its coarse cell, of the k vertices of each fine cell.
    """
    band, kind = layers.band, layers.cell_type
    assert band is not None
    nodes = _shapes(kind, 1, lagrange(kind, layers.degree).points) @ corners
    shapes = _shapes(kind, layers.degree, nodes)
    old = layers.cells[parent]
    places = (layers.points[old], band.reference[old])
    x, reference = (np.einsum("nqk,nkd->nqd", shapes, values).reshape(-1, layers.dim) for values in places)
    same = cKDTree(x).query_pairs(NODE_TOLERANCE * layers.size, output_type="ndarray")
    _, chosen, number = np.unique(connected(same[:, 0], same[:, 1], len(x)), return_index=True, return_inverse=True)
    cells = number.reshape(nodes.shape[:2])
    linear = _shapes(kind, 1, corners)
    director = linear @ band.director[parent]
    director /= np.linalg.norm(director, axis=2, keepdims=True)

    local = local_facets(kind)
    is_outside = np.array([np.isin(np.arange(linear.shape[2]), facet, invert=True) for facet in local])
    # whether all vertices of a facet of a cell lie on a facet of the parent: (n, its facets, the parent's facets)
    on = (np.einsum("nqk,fk->nqf", linear, is_outside)[:, local] < LENGTH_TOLERANCE).all(axis=2)
    facets = {}
    for name, parent_facets in layers.facets.items():
        rows = layers.table.index(parent_facets)
        is_named = np.zeros((len(layers.cells), len(local)), bool)
        is_named[layers.table.cells[rows, 0], layers.table.local[rows, 0]] = True
        facets[name] = cells[:, local][(on & is_named[parent][:, None]).any(axis=2)]
    points, region = x[chosen], layers.region[parent]
    new_band = replace(band, reference=reference[chosen], director=director)
    joint = replace(layers, points=points, cells=cells, region=region, facets=facets, band=new_band)
    return RefinedLayers(joint, parent, corners)
