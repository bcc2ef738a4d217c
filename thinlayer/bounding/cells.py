"""Straight triangles, tetrahedra or quadrilaterals as arrays, with their facets, nodes and stiffnesses."""

from __future__ import annotations

from functools import cached_property

import basix
import numpy as np

from forms.base import Array
from forms.tensors import MANDEL_BASIS, MANDEL_PAIRS
from geometry.topology import (
    FACET_TYPES,
    BoolArray,
    FacetTable,
    FloatArray,
    IntArray,
    is_tensor,
    lagrange,
    local_facets,
    ridge_keys,
    sum_by_number,
)


def mass_matrix(cell_type: str, degree: int) -> FloatArray:
    """Return the integrals (n, n) of products of a Lagrange element's n shape functions, for a cell of volume 1."""
    x, w = basix.make_quadrature(basix.CellType[cell_type], 2 * degree)
    values = lagrange(cell_type, degree).tabulate(0, x)[0, :, :, 0]
    return np.asarray(values.T @ ((w / w.sum())[:, None] * values))


def area_vectors(cell_type: str) -> FloatArray:
    """Return the outward normals (facets, d) of a reference triangle or tetrahedron, each as long as its facet's area."""
    d = 2 if cell_type == "triangle" else 3
    return np.vstack([np.ones(d), -np.eye(d)]) / (d - 1)


class StraightCells:
    """Straight cells of bodies and layers with shape functions of a degree, and the facets between them.

    In d dimensions a cell has n nodes, l vertices, f facets and nv components of stress (Mandel's order) at k points,
    see `stress_points`; a facet has m nodes. A moment is the integral of a traction times the shape function of a node.
    It is stored once for each facet, as a load on the first of its cells; the second cell sees it with the opposite
    sign.

    Attributes:
        d, degree, cell_type: dimension; degree 1 or 2 of displacements; "triangle", "tetrahedron", "quadrilateral".
        basis: (nv, d, d) symmetric tensors of norm 1, to which the components of stress belong.
        corners: (nc, l) numbers of the vertices of nc cells.
        A, A_inverse: (nc, d, d) Jacobians of the cells and their inverses, of quadrilaterals at the first corner.
        J, volume: (nc,) absolute determinants of the Jacobians, and volumes of the cells; areas in 2D.
        C, compliance: (nc, nv, nv) stiffness of each cell (unit: stress), and its inverse.
        nodes: (nc, n) numbers of the nodes of each cell.
        node_vertices: (nn, 2) the two vertices midway between which each node lies; twice the same for a vertex.
        closure: (f, m) positions of the nodes of each facet among the n nodes of a cell.
        element, facet_element: Lagrange elements of the degree on the reference cell and on its facets.
        facets, facet_cells: (nf, d) vertices, and (nf, 2) cells of each facet; -1: no second cell.
        cell_facets, sign: (nc, f) numbers of a cell's facets, and 1 or -1 for its first or second cell.
        area_vectors: (nc, f, d) outward normals of a cell's facets, as long as their area.
        facet_nodes: (nf, m) numbers of the nodes of each facet.
        moment_rows: (nc, f, m) row of each facet's node, in the order of the cell, among all nf m moments.

    Args:
        points: (n_points, d) coordinates, lengths.
        corners: (nc, l) numbers of the vertices of each cell.
        cell_type: type of the cells.
        degree: polynomial degree of displacements.
        C: (nc, nv, nv) stiffness of each cell in Mandel's order (unit: stress).
    """

    def __init__(self, points: FloatArray, corners: IntArray, cell_type: str, degree: int, C: Array) -> None:
        self.points, self.corners, self.degree, self.d = points, corners, degree, points.shape[1]
        self.cell_type = cell_type
        self.element, self.facet_element = (lagrange(kind, degree) for kind in (self.cell_type, self.facet_type))
        self.basis = MANDEL_BASIS[[j < self.d for _, j in MANDEL_PAIRS]][:, : self.d, : self.d]
        self.C, self.compliance = C, np.linalg.inv(C)
        self.A = np.swapaxes(points[corners[:, 1 : self.d + 1]] - points[corners[:, :1]], 1, 2)
        self.A_inverse, self.J = np.linalg.inv(self.A), np.abs(np.linalg.det(self.A))
        self._inverses, self._weights = self.A_inverse[:, None], self.J[:, None] * self._rule[1]
        if is_tensor(cell_type):
            gradients = np.moveaxis(lagrange(cell_type, 1).tabulate(1, self._rule[0])[1:, :, :, 0], 0, 2)
            jacobians = np.einsum("qnk,cni->cqik", gradients, points[corners])
            self._inverses, dets = np.linalg.inv(jacobians), np.abs(np.linalg.det(jacobians))
            self._weights, sides = dets * self._rule[1], points[corners[:, local_facets(cell_type)]]
            normals = (sides[:, :, 1] - sides[:, :, 0])[..., ::-1] * np.array([1.0, -1.0])
            outward = sides.mean(axis=2) - points[corners].mean(axis=1, keepdims=True)
            self.area_vectors = normals * np.sign((normals * outward).sum(axis=2, keepdims=True))
        else:
            self.area_vectors = self.J[:, None, None] * (area_vectors(cell_type) @ self.A_inverse)
        self.volume = self._weights.sum(axis=1)
        table = FacetTable.of(corners, self.cell_type)
        self.facets, self.facet_cells = table.vertices, table.cells
        self.cell_facets = table.index(corners[:, local_facets(self.cell_type)].reshape(-1, self.d))
        self.cell_facets = self.cell_facets.reshape(len(corners), -1)
        self.sign = np.where(self.facet_cells[self.cell_facets, 0] == np.arange(len(corners))[:, None], 1.0, -1.0)
        self._number_nodes()

    @property
    def facet_type(self) -> str:
        """Type of the facets: "interval" or "triangle"."""
        return FACET_TYPES[self.cell_type]

    def _number_nodes(self) -> None:
        corners, nodes = self.corners, [self.corners]
        vertices = np.unique(corners)
        self.node_vertices = np.column_stack([np.arange(vertices[-1] + 1)] * 2)
        if self.degree == 2:
            edges = np.array(basix.topology(basix.CellType[self.cell_type])[1])
            pairs = corners[:, edges].reshape(-1, 2)
            _, first, numbers = np.unique(ridge_keys(pairs), return_index=True, return_inverse=True)
            nodes.append(numbers.reshape(len(corners), -1) + len(self.node_vertices))
            self.node_vertices = np.vstack([self.node_vertices, pairs[first]])
            if is_tensor(self.cell_type):
                nodes.append(np.arange(len(corners))[:, None] + len(self.node_vertices))
                self.node_vertices = np.vstack([self.node_vertices, corners[:, [0, 3]]])
        self.nodes = np.hstack(nodes)
        self.closure = np.array(self.element.entity_closure_dofs[-2])
        nodes_of_facets = self.nodes[:, self.closure]
        rank = nodes_of_facets.argsort(axis=2).argsort(axis=2)
        self.moment_rows = self.cell_facets[:, :, None] * self.closure.shape[1] + rank
        self.facet_nodes = np.empty((len(self.facets), self.closure.shape[1]), np.int64)
        self.facet_nodes.ravel()[self.moment_rows] = nodes_of_facets

    @cached_property
    def areas(self) -> FloatArray:
        """(nf,) areas of the facets; lengths in 2D."""
        out = np.empty(len(self.facets))
        out[self.cell_facets] = np.linalg.norm(self.area_vectors, axis=2)
        return out

    @property
    def node_stiffness(self) -> FloatArray:
        """(nc,) size of the force on a node of each cell per displacement of this node alone."""
        return np.asarray(np.abs(self.C).max(axis=(1, 2)) * self.volume * np.abs(self.A_inverse).max(axis=(1, 2)) ** 2)

    @property
    def is_outer(self) -> BoolArray:
        """(nf,) mask of the facets that belong to a single cell."""
        return np.asarray(self.facet_cells[:, 1] < 0)

    @cached_property
    def _rule(self) -> tuple[FloatArray, FloatArray]:
        """Quadrature points and weights; on quadrilaterals those of the package's laws, so that nodes are in balance."""
        return basix.make_quadrature(basix.CellType[self.cell_type], 2 * self.degree + is_tensor(self.cell_type))

    @cached_property
    def _stress_element(self) -> basix.finite_element.FiniteElement | None:
        """Element that contains the strains of displacements in a cell; None: they are constant."""
        if is_tensor(self.cell_type):
            return self.element
        return lagrange(self.cell_type, 1) if self.degree == 2 else None

    @cached_property
    def stress_points(self) -> FloatArray:
        """(k, d) points of the reference cell whose stresses determine those of displacements in the whole cell."""
        element = self._stress_element
        if is_tensor(self.cell_type):
            return self._rule[0]
        return np.asarray(element.points if element else lagrange(self.cell_type, 1).points.mean(axis=0, keepdims=True))

    def stress_values(self, x: FloatArray) -> FloatArray:
        """Return (n, k) factors that make the stresses at n points `x` (n, d) from those at the k `stress_points`."""
        element = self._stress_element
        values = element.tabulate(0, x)[0, :, :, 0] if element else np.ones((len(x), 1))
        if element and is_tensor(self.cell_type):
            values = values @ np.linalg.inv(element.tabulate(0, self.stress_points)[0, :, :, 0])
        return np.asarray(values)

    def strain(self, U: Array) -> Array:
        """Return the strains (nc, k, nv) of displacements `U` (nc, n, d) at the `stress_points`."""
        gradients = np.moveaxis(self.element.tabulate(1, self.stress_points)[1:, :, :, 0], 0, 1)  # (k, d, n)
        grad_u = np.swapaxes(self._inverses, 2, 3) @ (gradients.reshape(-1, gradients.shape[2]) @ U).reshape(
            len(U), -1, self.d, self.d
        )
        return np.asarray(grad_u.reshape(*grad_u.shape[:2], -1) @ self.basis.reshape(len(self.basis), -1).T)

    def stress(self, U: Array) -> Array:
        """Return the stresses (nc, k, nv) of displacements `U` (nc, n, d) at the `stress_points`."""
        return np.asarray(self.strain(U) @ self.C)

    def nodal_forces(self, stress: Array) -> Array:
        """Return the forces (nc, n, d) on each cell's nodes that balance stresses (nc, k, nv) at `stress_points`."""
        x = self._rule[0]
        gradients = np.moveaxis(self.element.tabulate(1, x)[1:, :, :, 0], 0, 2)
        tensors = self.stress_values(x) @ stress @ self.basis.reshape(len(self.basis), -1) * self._weights[..., None]
        tensors = tensors.reshape(*tensors.shape[:2], self.d, self.d) @ np.swapaxes(self._inverses, 2, 3)
        return np.asarray(np.einsum("cqik,qnk->cni", tensors, gradients, optimize=True))

    def nodal_loads(self, f: Array) -> Array:
        """Return the loads (nc, n, d) on each cell's nodes of a force per volume with values `f` (nc, n, d) there."""
        values = self.element.tabulate(0, self._rule[0])[0, :, :, 0]
        return np.asarray(values.T @ (self._weights[..., None] * (values @ f)))

    def facet_points(self, facet: int) -> FloatArray:
        """Return the places (m, d) of a reference cell's nodes on a facet."""
        x, v = self.facet_element.points, lagrange(self.cell_type, 1).points
        v = v[local_facets(self.cell_type)[facet]]
        return np.asarray(v[0] + x @ (v[1:] - v[0]))

    def moment_sums(self, cell_moments: Array) -> Array:
        """Return the sums (nf m, ...), over the cells at each facet, of the cells' values (nc, f, m, ...)."""
        return sum_by_number(self.moment_rows, cell_moments, self.facet_nodes.size)
