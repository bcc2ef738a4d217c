"""Reference cell cut at its centre, and its polynomial stresses for any divergence and any tractions that balance it.

Straight lines from the centre (mean of the vertices) of a cell to its vertices divide it into simplices, one at each
facet. On each of these parts the stress is symmetric and of degree k; its tractions are continuous between the parts.
A cell with Jacobian A has the stress A y A^T, with a stress y of the reference cell. Its tractions and its
divergence then fulfil the same equations for all cells, so that one decomposition solves all of them.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np

from forms.base import Array
from forms.tensors import MANDEL_BASIS, MANDEL_PAIRS
from geometry.topology import FACET_TYPES, FloatArray, lagrange, local_facets
from thinlayer.bounding.cells import area_vectors, mass_matrix

RANK_TOLERANCE = 1e-10  # singular value of the equations, over the largest, that counts as zero


class MacroCell:
    """Stresses of degree k on the reference cell cut at its centre, for given tractions and divergence.

    A stress is an array (parts, nv, nk): values of its nv components at the nk nodes of each part. With the equations
    B y = data, all stresses are y = P data + N a with arbitrary a.

    Attributes:
        points: (parts, nk, d) nodes of the parts.
        div_points: (parts, ., d) points at which the divergence is prescribed, which has degree k - 1.
        shape: (parts, nv, nk), the shape of a stress.
        equations: (rows, parts nv nk) matrix B. Rows are first tractions times area at a lattice of degree k on each
            facet, then the divergence at `div_points`, then jumps of tractions between parts, which are zero.
        to_tractions: (., m) factors of a facet's m moments in its tractions times area, the data of the first rows.
        n_tractions, n_data: number of the first, and of the first two kinds of rows.
        particular: (parts nv nk, n_data) matrix P.
        null_space: (parts nv nk, .) matrix N.
        mass: (parts, nk, nk) integrals of products of shape functions on each part.

    Args:
        cell_type: "triangle" or "tetrahedron".
        degree: degree of displacements, tractions and stresses.
    """

    def __init__(self, cell_type: str, degree: int) -> None:
        corners, facets = lagrange(cell_type, 1).points, local_facets(cell_type)
        d, centre, facet_type = corners.shape[1], corners.mean(axis=0), FACET_TYPES[cell_type]
        self._element = element = lagrange(cell_type, degree)
        facet_points, inside = lagrange(facet_type, degree).points, lagrange(cell_type, 1).points
        inside = inside if degree > 1 else inside.mean(axis=0, keepdims=True)
        densities = lagrange(facet_type, degree).tabulate(0, facet_points)[0, :, :, 0]
        self.to_tractions = densities @ np.linalg.inv(mass_matrix(facet_type, degree))
        self._basis = MANDEL_BASIS[[j < d for _, j in MANDEL_PAIRS]][:, :d, :d]
        self._parts = np.stack([np.vstack([corners[f], centre]) for f in facets])
        self.points = np.stack([v[0] + element.points @ (v[1:] - v[0]) for v in self._parts])
        self.div_points = np.stack([v[0] + inside @ (v[1:] - v[0]) for v in self._parts])
        self.shape = (len(facets), len(self._basis), element.dim)
        rows = []
        for part, (v, normal) in enumerate(zip(self._parts, area_vectors(cell_type), strict=True)):
            rows.append(self._traction_rows(part, v[0] + facet_points @ (v[1:-1] - v[0]), normal))
        self.n_tractions = sum(map(len, rows))
        rows += [self._divergence_rows(part) for part in range(len(facets))]
        self.n_data = sum(map(len, rows))
        for a, b in combinations(range(len(facets)), 2):
            v = np.vstack([corners[np.intersect1d(facets[a], facets[b])], centre])
            edges = v[1:] - v[0]
            normal = np.cross(*edges) if d == 3 else np.array([edges[0, 1], -edges[0, 0]])
            x = v[0] + facet_points @ edges
            rows.append(self._traction_rows(a, x, normal) - self._traction_rows(b, x, normal))
        self.equations = np.vstack(rows)
        U, s, Vt = np.linalg.svd(self.equations)
        rank = int((s > RANK_TOLERANCE * s[0]).sum())
        self.particular = (Vt[:rank].T / s[:rank]) @ U[: self.n_data, :rank].T
        self.null_space = Vt[rank:].T
        part_volumes = np.abs(np.linalg.det(self._parts[:, 1:] - self._parts[:, :1])) / (2 if d == 2 else 6)
        self.mass = part_volumes[:, None, None] * mass_matrix(cell_type, degree)

    def _reference_points(self, part: int, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points `x` (k, d) in the coordinates of a part as reference cell, and their gradient (d, d)."""
        v = self._parts[part]
        inverse = np.linalg.inv((v[1:] - v[0]).T)
        return (x - v[0]) @ inverse.T, inverse

    def _traction_rows(self, part: int, x: FloatArray, normal: Array) -> Array:
        """Return rows (k d, parts nv nk) of the tractions on a part at k points `x` (k, d), times the normal's length."""
        points, _ = self._reference_points(part, x)
        rows = np.zeros((len(x), len(normal), *self.shape))
        values = self._element.tabulate(0, points)[0, :, :, 0]
        rows[:, :, part] = np.einsum("qn,rij,j->qirn", values, self._basis, normal)
        return rows.reshape(-1, np.prod(self.shape))

    def _divergence_rows(self, part: int) -> Array:
        """Return rows (k d, parts nv nk) of the divergence on a part at its k `div_points`."""
        points, inverse = self._reference_points(part, self.div_points[part])
        gradients = np.einsum("kqn,kj->qnj", self._element.tabulate(1, points)[1:, :, :, 0], inverse)
        rows = np.zeros((len(points), len(inverse), *self.shape))
        rows[:, :, part] = np.einsum("qnj,rij->qirn", gradients, self._basis)
        return rows.reshape(-1, np.prod(self.shape))

    def energy_tensor(self, a: Array, b: Array) -> Array:
        """Return (nv nv, i j) integrals of products of components of stresses `a` (., i) and `b` (., j), in columns."""
        a, b = (stress.reshape(*self.shape, -1) for stress in (a, b))
        products = np.einsum("srmi,smn,stnj->rtij", a, self.mass, b, optimize=True)
        return products.reshape(self.shape[1] ** 2, -1)


@cache
def macro_cell(cell_type: str, degree: int) -> MacroCell:
    """Return the `MacroCell` of a type of cells and a degree, made once."""
    return MacroCell(cell_type, degree)
