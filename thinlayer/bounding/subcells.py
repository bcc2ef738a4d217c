"""Quadrilaterals cut into four triangles about the mean of their corners, on which stresses are made."""

from __future__ import annotations

import numpy as np

from forms.base import Array
from geometry.topology import BoolArray, is_tensor, lagrange, local_facets
from thinlayer.bounding.cells import StraightCells, mass_matrix
from thinlayer.bounding.loops import RANK_TOLERANCE
from thinlayer.bounding.tractions import CellLoads, mean_moments

MAX_NEWTON_STEPS = 6  # for coordinates in the reference cell; cells are convex, so that Newton's method converges fast
PLACE_TOLERANCE = 1e-14  # distance from the places, over the coordinates, that is rounding
N_SUBCELLS = 4  # triangles of a quadrilateral


class Subcells:
    """Triangles into which quadrilaterals are cut, with displacements of degree 2; other cells stay whole.

    Displacements of quadrilaterals are interpolated on the subcells, where their stresses are polynomials. They stay
    continuous and keep their values on the sides of quadrilaterals. Letters in shapes are those of `StraightCells`.

    Attributes:
        cells: the subcells; four in a row belong to a quadrilateral.
        is_free: (nf, d) mask of the components of tractions on the subcells' facets that are not known.
        count: number of subcells of a cell.

    Args:
        cells: the cells.
        is_free: the same mask for the facets of the cells.
    """

    def __init__(self, cells: StraightCells, is_free: BoolArray) -> None:
        self._whole, self.cells, self.is_free, self.count = cells, cells, is_free, 1
        if not is_tensor(cells.cell_type):
            return
        self.count, n_cells, n_points = N_SUBCELLS, len(cells.corners), len(cells.points)
        x = cells.points[cells.corners]
        sides, centres = cells.corners[:, local_facets(cells.cell_type)], np.arange(n_cells)[:, None] + n_points
        corners = np.dstack([sides, np.broadcast_to(centres, (n_cells, N_SUBCELLS))]).reshape(-1, 3)
        points, C = np.vstack([cells.points, x.mean(axis=1)]), np.repeat(cells.C, N_SUBCELLS, axis=0)
        self.cells = subcells = StraightCells(points, corners, "triangle", 2, C)
        self.is_free = np.ones((len(subcells.facets), cells.d), bool)
        self.is_free[subcells.cell_facets[:, 2]] = is_free[cells.cell_facets].reshape(-1, cells.d)
        linear = lagrange("triangle", 1).tabulate(0, subcells.element.points)[0, :, :, 0]
        vertices = np.array([[*side, len(sides[0])] for side in local_facets(cells.cell_type)])
        reference = np.vstack([lagrange(cells.cell_type, 1).points, np.full((1, cells.d), 0.5)])
        self._vertices = reference[vertices]
        places = linear @ points[corners].reshape(n_cells, N_SUBCELLS, 3, cells.d)
        X: Array = np.broadcast_to(linear @ self._vertices, places.shape).reshape(-1, cells.d)
        for _ in range(MAX_NEWTON_STEPS):
            values = lagrange(cells.cell_type, 1).tabulate(1, X)[..., 0].reshape(3, n_cells, -1, N_SUBCELLS)
            distance = places.reshape(n_cells, -1, cells.d) - values[0] @ x
            if np.abs(distance).max() < PLACE_TOLERANCE * np.abs(x).max():  # at once in parallelograms
                break
            J = np.stack([values[1] @ x, values[2] @ x], axis=3)
            X = X + np.linalg.solve(J, distance[..., None]).reshape(X.shape)
        self._interpolation = cells.element.tabulate(0, X)[0, :, :, 0].reshape(n_cells, -1, cells.nodes.shape[1])

    def repeated(self, values: Array) -> Array:
        """Return values (nc, ...) of cells for each of their subcells."""
        return np.asarray(np.repeat(values, self.count, axis=0))

    def displacements(self, U: Array) -> Array:
        """Return displacements (n_subcells, n, d) of the nodes of the subcells, from those `U` (nc, n, d) of the cells."""
        if self.count == 1:
            return U
        return np.asarray((self._interpolation @ U).reshape(*self.cells.nodes.shape, U.shape[2]))

    def stress(self, stress: Array, U: Array) -> Array:
        """Return stresses at the `stress_points` of the subcells, near those of the cells at theirs.

        `U` are displacements of the cells' nodes that cause the stress, up to eigenstresses and pressures.
        """
        if self.count == 1:
            return stress
        rest = stress - self._whole.stress(U)
        rest = self._whole.stress_values(self._vertices.reshape(-1, self.cells.d)) @ rest
        return self.cells.stress(self.displacements(U)) + rest.reshape(len(self.cells.corners), 3, -1)

    def loads(self, loads: CellLoads) -> CellLoads:
        """Return the loads on the subcells, from those on the cells."""
        if self.count == 1:
            return loads
        force, moments = self.displacements(loads.body_force), self._side_moments(loads.moments)
        return CellLoads(force, moments, self.is_free, self.repeated(loads.eigenstress))

    def _side_moments(self, moments: Array) -> Array:
        """Return the subcells' moments of the same tractions on the sides of cells; zero between subcells of a cell."""
        whole, subcells = self._whole, self.cells
        quadratic, element = subcells.facet_element, whole.facet_element
        values = element.tabulate(0, quadratic.points)[0, :, :, 0]
        to_quadratic = mass_matrix("interval", 2) @ values @ np.linalg.inv(mass_matrix("interval", whole.degree))
        of_cells = to_quadratic @ (moments[whole.moment_rows] * whole.sign[:, :, None, None])
        out = np.zeros((subcells.facet_nodes.size, subcells.d))
        out[subcells.moment_rows[:, 2]] = (
            of_cells.reshape(len(subcells.corners), -1, subcells.d) * subcells.sign[:, 2, None, None]
        )
        return out

    def moments(self, moments: Array, stress: Array, loads: CellLoads) -> Array:
        """Return moments that balance each subcell, from those that balance each cell.

        Args:
            moments: moments on the facets of cells.
            stress: stresses at the `stress_points` of the subcells; tractions between subcells are near theirs.
            loads: the loads on the subcells.
        """
        if self.count == 1:
            return moments
        subcells, d = self.cells, self.cells.d
        is_inner = np.ones(subcells.facet_nodes.size, bool)
        is_inner[subcells.moment_rows[:, 2]] = False
        out = np.where(is_inner[:, None], mean_moments(subcells, stress), self._side_moments(moments))
        x = subcells.points[subcells.node_vertices].mean(axis=1)[subcells.nodes]
        arms = x - x[:, 2:3]  # the last vertex is the centre of the cell
        arms = arms / np.linalg.norm(arms, axis=2).max(axis=1)[:, None, None]
        turns = np.stack([-arms[..., 1], arms[..., 0]], axis=2)[..., None]
        motions = np.concatenate(
            [np.broadcast_to(np.eye(d), (*arms.shape, d)), turns], axis=3
        )  # (subcells, nodes, d, 3)
        on_facets = motions[:, subcells.closure] * subcells.sign[:, :, None, None, None]
        left = np.einsum("cfmi,cfmir->cr", out[subcells.moment_rows], on_facets)
        left += np.einsum("cni,cnir->cr", subcells.nodal_loads(loads.body_force), motions)
        E = np.zeros(
            (len(left) // N_SUBCELLS, N_SUBCELLS, 3, N_SUBCELLS, 3, d)
        )  # resultants of subcells by moments between them
        by_cell, rows = (
            on_facets.reshape(-1, N_SUBCELLS, *on_facets.shape[1:]),
            np.empty((len(E), N_SUBCELLS, 3), np.int64),
        )
        for subcell, ends in enumerate(local_facets(self._whole.cell_type)):
            for facet, corner in zip((1, 0), ends, strict=True):
                E[:, subcell, :, corner] += np.moveaxis(by_cell[:, subcell, facet], 3, 1)
                rows[:, corner] = subcells.moment_rows[subcell::N_SUBCELLS, facet]
        change = -np.linalg.pinv(E.reshape(len(E), N_SUBCELLS * 3, -1), RANK_TOLERANCE) @ left.reshape(len(E), -1, 1)
        out[rows.ravel()] += change.reshape(-1, d)
        return out
