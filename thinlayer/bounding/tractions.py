"""Moments of tractions on facets that balance every cell, near those of a stress in equilibrium at nodes alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from scipy.sparse.csgraph import connected_components

from forms.base import Array
from geometry.topology import BoolArray, sum_by_number
from thinlayer.bounding.cells import StraightCells, mass_matrix

MIN_FORCE_RATIO = 1e-12  # force on a node, over that of its displacement alone, below which it is rounding


@dataclass(frozen=True)
class CellLoads:
    """Loads on straight cells. Letters in shapes are those of `StraightCells`.

    Attributes:
        body_force: (nc, n, d) force per volume at each cell's nodes.
        moments: (nf m, d) moments of the tractions on outer facets; zero on all others.
        is_free: (nf, d) mask of the components of tractions that are not known: on inner facets, and at supports.
        eigenstress: (nc, nv) stiffness times the eigenstrain of each cell.
    """

    body_force: Array
    moments: Array
    is_free: BoolArray
    eigenstress: Array

    def work(self, cells: StraightCells, U: Array) -> float:
        """Return the work of loads and eigenstresses in displacements `U` (nc, n, d) of the nodes of `cells`."""
        is_outer = cells.is_outer[cells.cell_facets][:, :, None, None]
        on_facets = np.where(is_outer, self.moments[cells.moment_rows], 0.0) * U[:, cells.closure]
        eigenstress = np.repeat(self.eigenstress[:, None], len(cells.stress_points), axis=1)
        forces = cells.nodal_loads(self.body_force) + cells.nodal_forces(eigenstress)
        return float((forces * U).sum() + on_facets.sum())


class TractionBalance:
    """Moments of tractions that balance each cell, near those of the stress of displacements.

    At each node the moments balance the nodal forces of each cell. This is possible if those of all cells balance the
    loads, as in a finite element solution. Of all such moments these have the least weighted difference from the mean
    of the cells' own tractions (Ladeveze and Leguillon 1983).

    Args:
        cells: the cells.
        is_free: (nf, d) mask of the components of tractions that are not known.
    """

    def __init__(self, cells: StraightCells, is_free: BoolArray) -> None:
        self._cells, (n_cells, n), n_rows = cells, cells.nodes.shape, cells.facet_nodes.size
        rows = np.arange(n_cells)[:, None, None] * n + cells.closure
        self._rows, signs = np.unique(rows), np.broadcast_to(cells.sign[:, :, None], rows.shape)
        entries = (signs.ravel(), (rows.ravel(), cells.moment_rows.ravel()))
        self._sums = scipy.sparse.csr_matrix(entries, (n_cells * n, n_rows))[self._rows]
        weight = np.repeat(_softness(cells)[1] / cells.areas**2, cells.facet_nodes.shape[1])
        self._is_free = np.repeat(is_free, cells.facet_nodes.shape[1], axis=0)
        self._projections: list[_Projection] = []  # one for each component
        for component, mask in enumerate(self._is_free.T):
            equal = [k for k in range(component) if (self._is_free[:, k] == mask).all()]
            projection = self._projections[equal[0]] if equal else _Projection(self._sums[:, mask], weight[mask])
            self._projections.append(projection)

    def moments(self, stress: Array, loads: CellLoads, U: Array) -> tuple[Array, float]:
        """Return the moments that balance each cell, near those of stresses (nc, k, nv) at `stress_points`.

        `U` (nc, n, d) are displacements of the cells' nodes; their size tells forces from rounding.

        Returns:
            Moments (nf m, d), and the largest unbalanced force on a node of a cell, over the largest nodal force.
        """
        cells, unbalanced = self._cells, 0.0
        forces = cells.nodal_forces(stress) - cells.nodal_loads(loads.body_force)
        size = float(np.abs(forces).max())
        largest = float((cells.node_stiffness * np.abs(U).max(axis=(1, 2))).max())
        if size <= MIN_FORCE_RATIO * largest:  # a motion without strain
            return np.where(self._is_free, 0.0, loads.moments), 0.0
        moments = np.where(self._is_free, mean_moments(cells, stress), loads.moments)
        for component, projection in enumerate(self._projections):
            mask, cell_forces = self._is_free[:, component], forces[:, :, component].ravel()[self._rows]
            for _ in range(2):  # the second solve removes rounding errors of the first
                change = projection.change(cell_forces - self._sums @ moments[:, component])
                moments[mask, component] += change
            unbalanced = max(unbalanced, float(np.abs(cell_forces - self._sums @ moments[:, component]).max()))
        return moments, unbalanced / size


def _softness(cells: StraightCells) -> tuple[Array, Array]:
    """Return the trace of the compliance times the volume of cells (nc,), and its sums (nf,) over the cells at facets."""
    of_cells = np.trace(cells.compliance, axis1=1, axis2=2) * cells.volume
    at_facets = np.repeat(of_cells[:, None], cells.sign.shape[1], axis=1)
    return of_cells, sum_by_number(cells.cell_facets, at_facets, len(cells.facets))


def mean_moments(cells: StraightCells, stress: Array) -> Array:
    """Return the weighted means (nf m, d) of the moments that stresses (nc, k, nv) have on both sides of facets."""
    mass, cell_moments = mass_matrix(cells.facet_type, cells.degree), np.empty((*cells.moment_rows.shape, cells.d))
    for facet in range(cells.sign.shape[1]):
        values = cells.stress_values(cells.facet_points(facet)) @ stress
        cell_moments[:, facet] = mass @ np.einsum("cqr,rij,cj->cqi", values, cells.basis, cells.area_vectors[:, facet])
    weights, totals = _softness(cells)
    sums = cells.moment_sums((weights[:, None] * cells.sign)[:, :, None, None] * cell_moments)
    return np.asarray(sums / np.repeat(totals, cells.facet_nodes.shape[1])[:, None])


class _Projection:
    """Least weighted change x of moments for which the sums over the nodes of cells, D x, have given values.

    Args:
        D: (rows, columns) matrix of the sums; a column has one or two entries.
        weight: (columns,) weights of the squared changes.
    """

    def __init__(self, D: scipy.sparse.csr_matrix, weight: Array) -> None:
        self._D, self._weight = D, weight
        laplacian = (D @ scipy.sparse.diags(1 / weight) @ D.T).tocsr()
        n_patches, patch_of = connected_components(laplacian, directed=False)
        is_single = np.asarray(abs(D).sum(axis=0)).ravel() == 1
        is_pinned = np.ones(n_patches, bool)  # a patch without a support: its forces are in balance
        is_pinned[patch_of[np.unique(D[:, is_single].tocoo().row)]] = False
        pins = np.unique(patch_of, return_index=True)[1][is_pinned]
        self._kept = np.setdiff1d(np.arange(len(patch_of)), pins)
        matrix = laplacian[self._kept][:, self._kept].tocsc()
        # for many small blocks SuperLU is much faster than MUMPS
        self._factor = scipy.sparse.linalg.splu(matrix, "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})

    def change(self, values: Array) -> Array:
        """Return the least change (columns,) of the moments for sums `values` (rows,)."""
        multipliers = np.zeros(len(values))
        multipliers[self._kept] = self._factor.solve(values[self._kept])
        return np.asarray((self._D.T @ multipliers) / self._weight)
