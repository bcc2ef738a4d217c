"""Elements of mesh files: their shapes and faces, and the cells of a joint that they become."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import basix
import numpy as np
from dolfinx.cpp.io import perm_vtk
from dolfinx.mesh import to_type
from scipy.spatial import cKDTree

from forms.base import InputError, import_optional
from forms.traits import warn_of_range
from geometry.importing.naming import NODE_TOLERANCE
from geometry.topology import (
    CELL_TYPES,
    FloatArray,
    IntArray,
    components,
    corner_count,
    lagrange,
    row_keys,
    sub_entities,
)

if TYPE_CHECKING:
    import meshio

SHAPES = {  # start of meshio's names of elements -> type of cells in DOLFINx
    "vertex": "point", "line": "interval", "triangle": "triangle", "quad": "quadrilateral", "tetra": "tetrahedron",
    "wedge": "prism", "pyramid": "pyramid", "hexahedron": "hexahedron",
}  # fmt: skip
FACES = {  # shape -> positions of the vertices of each face in meshio's order of nodes; faces in the order of Abaqus
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "pyramid": ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    "prism": ((0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)),
    "hexahedron": ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
FACE_NAMES = {2: "line", 3: "triangle", 4: "quad"}  # number of vertices -> meshio's name
XDMF_POLYLINE = 2  # number of the type of elements after which their number of nodes follows
SIMPLICES = "point", "interval", "triangle", "tetrahedron"  # by dimension

Elements = Sequence[tuple[str, Sequence[int]]]  # meshio's name of the type, and the nodes, of each element
Sets = Mapping[str, Collection[int]]  # name of a set -> its members


def shape_of(kind: str) -> str:
    """Return DOLFINx's type of the elements that meshio calls `kind`, such as "triangle6"; "" if it has none."""
    return SHAPES.get(kind.rstrip("0123456789"), "")


def mesh_of(points: FloatArray, elements: Elements, sets: Sets, node_sets: Sets) -> meshio.Mesh:
    """Return the mesh with these elements and named sets.

    Args:
        points: (n, 2 or 3) coordinates of the nodes.
        elements: meshio's name of the type of each element, and the row numbers in `points` of its nodes.
        sets: name -> numbers of the elements in this set.
        node_sets: name -> row numbers in `points` of the nodes in this set.
    """
    kinds = np.array([kind for kind, _ in elements])
    numbers = {kind: np.flatnonzero(kinds == kind) for kind in dict.fromkeys(kinds.tolist())}
    cells = [(kind, np.array([elements[k][1] for k in of_kind], np.int64)) for kind, of_kind in numbers.items()]
    cell_sets = {name: [np.flatnonzero(np.isin(k, [*its])) for k in numbers.values()] for name, its in sets.items()}
    point_sets = {name: np.array([*its], np.int64) for name, its in node_sets.items()}
    return import_optional("meshio").Mesh(points, cells, cell_sets=cell_sets, point_sets=point_sets)


def add_face(elements: list[tuple[str, Sequence[int]]], number: int, face: int) -> int:
    """Append a face of the element `number` to the elements, and return its number among them.

    Args:
        elements: meshio's name of the type of each element, and its nodes.
        number: number of the element.
        face: number of the face, from 0, in the order of `FACES`.

    Raises:
        ValueError: the element has no such face.
    """
    kind, nodes = elements[number]
    faces = FACES.get(shape_of(kind), ())
    if not 0 <= face < len(faces):
        raise ValueError(f"a {kind} has no face {face + 1}")
    elements.append((FACE_NAMES[len(faces[face])], [nodes[k] for k in faces[face]]))
    return len(elements) - 1


def cells_of(points: FloatArray, blocks: Sequence[meshio.CellBlock]) -> tuple[FloatArray, IntArray, str, IntArray]:
    """Return the cells, all of one type, that the elements of a mesh file become.

    Elements of degree 2 without nodes on their faces or inside get these nodes, which does not change their shape.
    Wedges, pyramids, and elements of several shapes are split into triangles or tetrahedra; a RangeWarning says so.
    Equal elements, which gmsh 2.2 writes if groups overlap, become one cell.

    Args:
        points: (n_points, 2 or 3) coordinates of the nodes.
        blocks: the elements, all of one dimension.

    Returns:
        The points, with those that complete elements as last rows; (n_cells, k) numbers of the k nodes of each cell, in
        DOLFINx's order; the type of the cells; and (2, n) numbers of an element, and of a cell that is this element or
        a part of it.

    Raises:
        InputError: elements have a type that is not allowed, or are of several degrees.
    """
    kind_of = np.concatenate([[block.type] * len(block) for block in blocks])
    by_kind = {kind: np.concatenate([b.data for b in blocks if b.type == kind]) for kind in dict.fromkeys(kind_of)}
    elements, shapes = [np.flatnonzero(kind_of == kind) for kind in by_kind], [*map(shape_of, by_kind)]
    points, cells = _completed(points, by_kind)
    text = ", ".join(f"{len(nodes)} {kind}" for kind, nodes in by_kind.items())
    if len({nodes.shape[1] > corner_count(shape) for shape, nodes in zip(shapes, cells, strict=True)}) > 1:
        raise InputError(f"cells of degree 1 and 2: {text}; a joint needs cells of one degree")
    if len({*shapes}) > 1 or shapes[0] not in CELL_TYPES:
        parts, cells = zip(*map(split, cells, shapes), strict=True)
        elements = [of_kind[part] for of_kind, part in zip(elements, parts, strict=True)]
        shapes = [SIMPLICES[blocks[0].dim]]
        effect = "at degree 1 they are stiffer than the elements of the file: take element='P2', or smaller ones"
        warn_of_range("split", f"{text} are split into {sum(map(len, cells))} cells of type {shapes[0]}; {effect}")
    nodes, element = np.concatenate(cells), np.concatenate(elements)
    keys = row_keys(np.sort(nodes[:, : corner_count(shapes[0])], axis=1))
    first, number = np.unique(keys, return_index=True, return_inverse=True)[1:]
    return points, nodes[np.sort(first)], shapes[0], np.stack([element, np.argsort(np.argsort(first))[number]])


def _completed(points: FloatArray, by_kind: Mapping[str, IntArray]) -> tuple[FloatArray, Sequence[IntArray]]:
    """Return the points and the elements' nodes in DOLFINx's order, with nodes on faces and inside for degree 2.

    The new nodes are where the elements' own shape functions place the middles.

    Args:
        points: (n_points, d) coordinates of the nodes in d dimensions.
        by_kind: meshio's name of a type -> (n, k) nodes of its n elements, in the order of meshio and VTK.
    """
    x, cells = [points], list[IntArray]()
    for kind, nodes in by_kind.items():
        shape, n = shape_of(kind), nodes.shape[1]
        entities = sub_entities(shape) if shape in FACES else [[], []]
        n_vertices, n_edges = map(len, entities[:2])
        n_complete = int(lagrange(shape, 2).dim) if shape in CELL_TYPES else n_vertices
        if n not in {n_vertices, n_vertices + n_edges, n_complete} or not n_vertices:
            names = ", ".join(name for name, of in SHAPES.items() if of in FACES)
            remedy = f"{names} of degree 1 or 2 (gmsh: Mesh.ElementOrder), of the bodies too (gmsh: in Physical groups)"
            raise InputError(f"cells of a type that is not allowed: {len(nodes)} {kind}; save {remedy}")
        nodes = nodes[:, perm_vtk(to_type(shape), max(n, n_complete) if n > n_vertices else n)[:n]]
        wholes = [of for entity in entities[2:] for of in entity if len(of[0]) in (4, 8)]  # not triangles, wedges, ...
        for vertices, edges, *_ in wholes if n_vertices < n != n_complete else ():
            corners, middles, weight = nodes[:, vertices], nodes[:, np.array(edges) + n_vertices], len(vertices) / 4
            nodes = np.column_stack([nodes, sum(map(len, x)) + np.arange(len(nodes))])
            x.append((1 + weight) * points[middles].mean(axis=1) - weight * points[corners].mean(axis=1))
        cells.append(nodes)
    if len(x) == 1:
        return points, cells
    completed = np.concatenate(x)
    masters = joined(completed, np.arange(len(points), len(completed)), NODE_TOLERANCE)
    return completed, [masters[nodes] for nodes in cells]


def split(nodes: IntArray, shape: str) -> tuple[IntArray, IntArray]:
    """Return the triangles or tetrahedra into which elements are split, with the same nodes.

    A facet is split alike from both sides, as its lowest vertex alone decides how.

    Args:
        nodes: (n, k) numbers of the k nodes of each element, in DOLFINx's order.
        shape: type of the elements.

    Returns:
        (m,) number of the element that each simplex is a part of, and (m, l) numbers of the simplex's nodes.
    """
    n, (element, vertices) = corner_count(shape), _simplices(nodes[:, : corner_count(shape)], shape)
    dim, degree = vertices.shape[1] - 1, 1 if nodes.shape[1] == n else 2
    edges = basix.topology(basix.CellType[SIMPLICES[dim]])[1] if degree == 2 else []
    first, second = np.array([(k, k) for k in range(dim + 1)] + edges).T
    x = lagrange(shape, degree).points
    middle = np.abs((x[:n, None, None] + x[:n, None]) / 2 - x).sum(axis=3).argmin(axis=2)  # node between two vertices
    return element, nodes[element[:, None], middle[vertices[:, first], vertices[:, second]]]


def _simplices(corners: IntArray, shape: str) -> tuple[IntArray, IntArray]:
    """Return the number of the element, and positions of vertices in it, of each simplex of split elements.

    The vertex of an element with the lowest number is one of each of its simplices. The others are those of the
    simplices of the facets without this vertex.

    Args:
        corners: (n, k) numbers of the k vertices of each element, in DOLFINx's order.
        shape: type of the elements.
    """
    topology = basix.topology(basix.CellType[shape])
    if shape in SIMPLICES:
        return np.arange(len(corners)), np.tile(np.arange(corners.shape[1]), (len(corners), 1))
    lowest, parts = corners.argmin(axis=1), list[tuple[IntArray, IntArray]]()
    for facet in map(np.array, topology[-2]):
        rows = np.flatnonzero(~np.isin(lowest, facet))
        element, vertices = _simplices(corners[rows][:, facet], shape_of(FACE_NAMES[len(facet)]))
        parts.append((rows[element], np.column_stack([lowest[rows[element]], facet[vertices]])))
    return np.concatenate([rows for rows, _ in parts]), np.concatenate([vertices for _, vertices in parts])


def joined(points: FloatArray, nodes: IntArray, join: float | None) -> IntArray:
    """Return (n_points,) for each point the number of the point with which it is joined; of several, the lowest.

    Args:
        points: (n_points, d) coordinates in d dimensions.
        nodes: numbers of the points that are nodes of cells; others stay.
        join: largest distance of nodes that become one, over the size of the mesh; None: nodes stay.
    """
    masters = np.arange(len(points))
    if join is None or not np.isfinite(x := points[(used := np.unique(nodes))]).all():
        return masters
    near = cKDTree(x).query_pairs(join * np.ptp(x, axis=0).max(), output_type="ndarray")
    group = components(near[:, 0], near[:, 1], len(used))
    masters[used] = used[np.unique(group, return_index=True)[1]][group]
    return masters


def xdmf_blocks(data: IntArray) -> list[meshio.CellBlock]:
    """Return the elements of several types of an XDMF file; meshio's function with this task knows none of degree 2.

    Args:
        data: for each element the number of its type, and its nodes.
    """
    from meshio import CellBlock
    from meshio._common import num_nodes_per_cell
    from meshio.xdmf.common import xdmf_idx_to_meshio_type

    elements, start = list[tuple[str, IntArray]](), 0
    while start < len(data):
        kind, first = xdmf_idx_to_meshio_type[data[start]], start + (2 if data[start] == XDMF_POLYLINE else 1)
        start = first + num_nodes_per_cell[kind]
        elements.append((kind, data[first:start]))
    groups = groupby(elements, lambda element: element[0])
    return [CellBlock(kind, np.array([nodes for _, nodes in group])) for kind, group in groups]
