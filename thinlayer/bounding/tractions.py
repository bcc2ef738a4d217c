"""Moments of tractions on facets that balance every cell, near those of a stress in equilibrium at nodes alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from forms.base import Array
from geometry.topology import BoolArray, sum_by_number
from thinlayer.bounding.cells import StraightCells, mass_matrix
from thinlayer.solving.linear_solvers import SubmatrixFactor


@dataclass(frozen=True)
class CellLoads:
    """Loads on straight cells, and the facets where supports leave tractions free.

    Attributes:
        body_force: (nc, n, d) force per volume at each cell's nodes.
        moments: (nf m, d) moments of the tractions on outer facets; zero on all others.
        is_free: (nf, d) mask of the components of tractions that are not known: on inner facets, and at supports.
    """

    body_force: Array
    moments: Array
    is_free: BoolArray

    def work(self, cells: StraightCells, U: Array) -> float:
        """Return the work of the loads in displacements `U` (nc, n, d) of the nodes of `cells`."""
        is_outer = cells.is_outer[cells.cell_facets][:, :, None, None]
        on_facets = np.where(is_outer, self.moments[cells.moment_rows], 0.0) * U[:, cells.closure]
        return float((cells.nodal_loads(self.body_force) * U).sum() + on_facets.sum())


def balanced_moments(cells: StraightCells, U: Array, loads: CellLoads) -> tuple[Array, float]:
    """Return moments of tractions that balance each cell, near those of the stress of displacements.

    At each node the moments balance the nodal forces of each cell. This is possible if those of all cells balance the
    loads, as in a finite element solution. Of all such moments these have the least weighted difference from the mean
    of the cells' own tractions (Ladeveze and Leguillon 1983).

    Args:
        cells: the cells.
        U: (nc, n, d) displacements of each cell's nodes; they may differ between cells.
        loads: the loads.

    Returns:
        Moments (nf m, d), and the largest unbalanced force on a node of a cell, over the largest nodal force.
    """
    n_cells, n = cells.nodes.shape
    forces = cells.nodal_forces(U) - cells.nodal_loads(loads.body_force)
    start, weight = _mean_moments(cells, U)
    rows = np.arange(n_cells)[:, None, None] * n + cells.closure
    signs = np.broadcast_to(cells.sign[:, :, None], rows.shape)
    columns = (rows.ravel(), cells.moment_rows.ravel())
    sums = scipy.sparse.csr_matrix((signs.ravel(), columns), (n_cells * n, len(start)))[np.unique(rows)]
    moments, unbalanced = np.where(np.repeat(loads.is_free, len(start) // len(loads.is_free), axis=0), start, 0.0), 0.0
    moments += np.where(np.repeat(loads.is_free, len(start) // len(loads.is_free), axis=0), 0.0, loads.moments)
    patterns, pattern_of = np.unique(loads.is_free, axis=1, return_inverse=True)
    for pattern, is_free in enumerate(patterns.T):
        mask = np.repeat(is_free, len(start) // len(is_free))
        projection = _Projection(sums[:, mask], weight[mask])
        for component in np.flatnonzero(pattern_of.ravel() == pattern):
            wanted = forces[:, :, component].ravel()[np.unique(rows)]
            for _ in range(2):  # the second solve removes rounding errors of the first
                moments[mask, component] += projection.change(wanted - sums @ moments[:, component])
            left = np.abs(wanted - sums @ moments[:, component]).max()
            unbalanced = max(unbalanced, float(left))
    return moments, unbalanced / max(float(np.abs(forces).max()), 1e-300)


def _mean_moments(cells: StraightCells, U: Array) -> tuple[Array, Array]:
    """Return mean moments (nf m, d) of the cells' stresses on both sides of facets, and weights (nf m) of changes."""
    mass, softness = mass_matrix(cells.facet_type, cells.degree), np.trace(cells.compliance, axis1=1, axis2=2)
    softness *= cells.volume
    own = np.empty((*cells.moment_rows.shape, cells.d))
    for facet in range(cells.d + 1):
        stress = cells.stress(U, cells.facet_points(facet))
        own[:, facet] = mass @ np.einsum("cqr,rij,cj->cqi", stress, cells.basis, cells.area_vectors[:, facet])
    totals = sum_by_number(cells.cell_facets, np.repeat(softness[:, None], cells.d + 1, axis=1), len(cells.facets))
    m = cells.facet_nodes.shape[1]
    mean = cells.moment_sums((softness[:, None] * cells.sign)[:, :, None, None] * own) / np.repeat(totals, m)[:, None]
    return mean, np.repeat(totals / cells.areas**2, m)


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
        self._factor = SubmatrixFactor(laplacian, ~np.isin(np.arange(len(patch_of)), pins), symmetric=True)

    def change(self, values: Array) -> Array:
        """Return the least change (columns,) of the moments for sums `values` (rows,)."""
        multipliers = np.zeros(len(values))
        self._factor.solve(values, multipliers)
        return np.asarray((self._D.T @ multipliers) / self._weight)
