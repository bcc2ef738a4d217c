"""Refinement of the cells of layers towards the layers' ends, where stresses change over less than the thickness."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import basix
import numpy as np
from scipy.spatial import cKDTree

from geometry.joint import Joint
from geometry.topology import BoolArray, FloatArray, IntArray, components, is_tensor, lagrange, local_facets

NODE_TOLERANCE = 1e-10  # largest distance of nodes that count as one, over the size of the joint
LENGTH_TOLERANCE = 1e-9  # relative tolerance of lengths, and tolerance of reference coordinates


class RefinedLayers(NamedTuple):
    """Layers whose cells are parts of coarser cells, so that functions on the coarse cells transfer exactly.

    Attributes:
        joint: the layers with n fine cells.
        parent: (n,) number of the coarse cell that each fine cell is a part of.
        corner_X: (n, k, d) reference coordinates, in its coarse cell, of the k vertices of each fine cell in d
            dimensions.
    """

    joint: Joint
    parent: IntArray
    corner_X: FloatArray

    def parent_coordinates(self, X: FloatArray) -> FloatArray:
        """Return, for q places in the reference cell and each fine cell, the reference coordinates in its coarse cell.

        Args:
            X: (q, d) reference coordinates of the places, the same in all fine cells, in d dimensions.

        Returns:
            (n, q, d) reference coordinates of the q places of each of the n fine cells in its coarse cell.
        """
        return np.asarray(_shape_functions(self.joint.cell_type, 1, X) @ self.corner_X)


def refined_towards_ends(layers: Joint, distance: FloatArray, size: float) -> RefinedLayers:
    """Return layers with smaller cells at their ends, which are parts of the given cells.

    Edges that begin at an end are halved until they reach no farther than `size` from it.

    Args:
        layers: meshed layers without bodies.
        distance: (n_points,) distance along S of each point from the nearest end, a length; 0 at ends.
        size: this largest distance from the end, a length > 0.
    """
    kind = layers.cell_type
    edge_ends = np.array(basix.topology(basix.CellType[kind])[1])  # vertices of edges; parallel edges have one order
    cells: IntArray = layers.corners.copy()
    parent: IntArray = np.arange(len(cells))
    X = np.tile(basix.geometry(basix.CellType[kind]), (len(cells), 1, 1))
    while True:
        end_pairs, edges = np.unique(np.sort(cells[:, edge_ends], axis=2).reshape(-1, 2), axis=0, return_inverse=True)
        edges, (a, b) = edges.reshape(len(cells), -1), end_pairs.T
        near_end, far_end = np.sort([distance[a], distance[b]], axis=0)
        is_halved = _conforming_edges(kind, edges, far_end, (near_end == 0) & (far_end > size * (1 + LENGTH_TOLERANCE)))
        if not is_halved.any():
            return _refined_joint(layers, parent, X)
        midpoint = np.where(is_halved, len(distance) - 1 + np.cumsum(is_halved), -1)
        distance = np.concatenate([distance, (near_end + far_end)[is_halved] / 2])
        halved, local_edge = np.nonzero(is_halved[edges])
        halved, local_edge = np.unique(halved), local_edge.reshape(len(np.unique(halved)), -1)
        first, last = np.moveaxis(edge_ends[local_edge], 2, 0)
        new_vertices, at = midpoint[edges[halved[:, None], local_edge]], halved[:, None]
        new_X = (X[at, first] + X[at, last]) / 2
        second, second_X = cells[halved], X[halved]
        index = np.arange(len(halved))[:, None]
        cells[at, last], X[at, last] = new_vertices, new_X
        second[index, first], second_X[index, first] = new_vertices, new_X
        cells, X, parent = (np.concatenate(pair) for pair in ((cells, second), (X, second_X), (parent, parent[halved])))


def _conforming_edges(kind: str, edges: IntArray, far_distance: FloatArray, to_halve: BoolArray) -> BoolArray:
    """Return which edges to halve in one pass, so that the mesh conforms: further passes halve the others.

    In one pass a simplex is halved at one edge. A quadrilateral or hexahedron is halved at one edge and all edges
    parallel to it. This also halves the edges parallel to these in neighbouring cells, and so on.

    Args:
        kind: type of the cells.
        edges: (n, k) numbers, from 0 to m - 1, of the k edges of each cell.
        far_distance: (m,) distance from the layer's end to the farther vertex of each edge, lengths. In simplices edges
            with larger distances come first.
        to_halve: (m,) whether each edge must be halved, now or later.

    Returns:
        (m,) whether each edge is halved in this pass.
    """
    first, last = np.array(basix.topology(basix.CellType[kind])[1]).T
    direction = last - first if is_tensor(kind) else np.arange(len(first))  # parallel edges have one label
    parallel, no_edge = [np.flatnonzero(direction == label) for label in np.unique(direction)], len(far_distance)
    if is_tensor(kind):
        links = np.concatenate([edges[:, [same_way[0], edge]] for same_way in parallel for edge in same_way[1:]])
        group_no = components(links[:, 0], links[:, 1], no_edge)
    else:
        group_no = np.argsort(np.lexsort([np.arange(no_edge), -far_distance]))
    is_group_halved = np.zeros(no_edge + 1, bool)
    is_group_halved[group_no[to_halve]] = True
    groups = np.where(is_group_halved[group_no], group_no, no_edge)[edges[:, [same_way[0] for same_way in parallel]]]
    first = groups.min(axis=1, keepdims=True)
    is_alone = (groups == first).sum(axis=1, keepdims=True) == 1  # else parallel edges meet in a cell: they stay whole
    is_group_halved[groups[(groups != first) | ~is_alone]] = False
    return np.asarray(is_group_halved[group_no])


def _shape_functions(kind: str, degree: int, X: FloatArray) -> FloatArray:
    """Return the values (..., m) of a cell's m Lagrange shape functions at places of the reference cell.

    Args:
        kind: type of the cell.
        degree: degree of the shape functions, 1 or 2.
        X: (..., d) reference coordinates of the places in d dimensions.
    """
    table = lagrange(kind, degree).tabulate(0, X.reshape(-1, X.shape[-1]))[0, :, :, 0]
    return np.asarray(table.reshape(*X.shape[:-1], -1))


def _refined_joint(layers: Joint, parent: IntArray, corner_X: FloatArray) -> RefinedLayers:
    """Return the layers with fine cells; regions, facet sets, normals and `reference` come from the coarse cells.

    Args:
        layers: the layers with coarse cells.
        parent: (n,) number of the coarse cell that has each fine cell.
        corner_X: (n, k, d) reference coordinates, in its coarse cell, of the k vertices of each fine cell.
    """
    band, kind = layers.band, layers.cell_type
    assert band is not None
    node_X = _shape_functions(kind, 1, lagrange(kind, layers.degree).points) @ corner_X
    shapes = _shape_functions(kind, layers.degree, node_X)
    parent_nodes = layers.cells[parent]
    coordinates = (layers.points[parent_nodes], band.reference[parent_nodes])
    x, reference = (np.einsum("nqk,nkd->nqd", shapes, values).reshape(-1, layers.dim) for values in coordinates)
    twins = cKDTree(x).query_pairs(NODE_TOLERANCE * layers.size, output_type="ndarray")
    _, kept, number = np.unique(components(twins[:, 0], twins[:, 1], len(x)), return_index=True, return_inverse=True)
    cells = number.reshape(node_X.shape[:2])
    linear_shapes = _shape_functions(kind, 1, corner_X)
    director = linear_shapes @ band.director[parent]
    director /= np.linalg.norm(director, axis=2, keepdims=True)

    facet_vertices = local_facets(kind)
    is_opposite = np.array([np.isin(np.arange(linear_shapes.shape[2]), facet, invert=True) for facet in facet_vertices])
    # whether all vertices of a facet of a cell lie on a facet of the parent: (n, its facets, the parent's facets)
    lies_on = (np.einsum("nqk,fk->nqf", linear_shapes, is_opposite)[:, facet_vertices] < LENGTH_TOLERANCE).all(axis=2)
    facets = {}
    for name, parent_facets in layers.facets.items():
        rows = layers.table.index(parent_facets)
        is_named = np.zeros((len(layers.cells), len(facet_vertices)), bool)
        is_named[layers.table.cells[rows, 0], layers.table.local[rows, 0]] = True
        facets[name] = cells[:, facet_vertices][(lies_on & is_named[parent][:, None]).any(axis=2)]
    points, region = x[kept], layers.region[parent]
    new_band = replace(band, reference=reference[kept], director=director, face_nodes=band.face_nodes[:, :0])
    joint = replace(layers, points=points, cells=cells, region=region, facets=facets, band=new_band)
    return RefinedLayers(joint, parent, corner_X)
