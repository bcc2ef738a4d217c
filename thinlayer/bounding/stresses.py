"""Stresses of cells: those of displacements, and those in equilibrium with tractions, with their complementary energy."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from forms.base import Array
from thinlayer.bounding.cells import StraightCells
from thinlayer.bounding.macro import macro_cell
from thinlayer.errors import SolveError

ROW_TOLERANCE = 1e-6  # largest residual of the equations of equilibrium in a cell, over the data: rounding


class Stresses:
    """Stresses of affine cells that are polynomials on the parts of each cell, see `MacroCell`.

    A stress is an array (nc, parts, nv, nk): values at the nodes of the parts, mapped to the reference cell. Letters in
    shapes are those of `StraightCells` and `MacroCell`.

    Args:
        cells: the cells.
    """

    def __init__(self, cells: StraightCells) -> None:
        self.cells, self.macro = cells, macro_cell(cells.cell_type, cells.degree)
        A, basis = cells.A, cells.basis
        to_cell = np.einsum("rij,cik,tkl,cjl->crt", basis, A, basis, A, optimize=True)
        self._to_reference = np.linalg.inv(to_cell)
        self._metric = np.swapaxes(to_cell, 1, 2) @ cells.compliance @ to_cell * cells.J[:, None, None]

    def of(self, values: Array) -> Array:
        """Return the stress that has the values (nc, k, nv) at the cells' `stress_points`."""
        in_reference = np.einsum("crs,cqs->cqr", self._to_reference, values)
        parts, nv, nk = self.macro.shape
        at_nodes = self.cells.stress_values(self.macro.points.reshape(-1, self.cells.d)) @ in_reference
        return np.asarray(np.swapaxes(at_nodes.reshape(-1, parts, nk, nv), 2, 3))

    def product(self, a: Array, b: Array) -> Array:
        """Return the integrals (nc,) of a : C^-1 : b over each cell; for a = b twice the complementary energy."""
        # products of matrices are much faster than a single sum by einsum
        a, b = (np.swapaxes(stress, 1, 2).reshape(len(a), a.shape[2], -1) for stress in (a, b @ self.macro.mass))
        return np.asarray((self._metric * (a @ np.swapaxes(b, 1, 2))).sum(axis=(1, 2)))

    @cached_property
    def _null_energy_inverse(self) -> Array:
        """(nc, i, i) inverses of the energy of each cell's i stresses in `MacroCell.null_space`."""
        N = self.macro.null_space
        return np.asarray(np.linalg.inv(self._energies(self.macro.energy_tensor(N, N), N.shape[1], N.shape[1])))

    def _energies(self, tensor: Array, *shape: int) -> Array:
        """Return the energies (nc, *shape) of each cell, from an energy tensor of the reference cell."""
        return (self._metric.reshape(len(self._metric), -1) @ tensor).reshape(-1, *shape)

    def in_equilibrium(self, moments: Array, f: Array, seed: Array) -> Array:
        """Return the stress in equilibrium that is nearest to another one in complementary energy.

        Args:
            moments: (nf m, d) moments of the tractions, for the first cell of each facet; each cell is in balance.
            f: (nc, n, d) force per volume at the cells' nodes, of a degree below that of the stress.
            seed: the other stress.

        Raises:
            SolveError: a cell is not in balance.
        """
        cells, macro = self.cells, self.macro
        densities = macro.to_tractions @ (moments[cells.moment_rows] * cells.sign[:, :, None, None])
        tractions = np.einsum("cij,cfpj->cfpi", cells.A_inverse, densities) / cells.J[:, None, None, None]
        values = cells.element.tabulate(0, macro.div_points.reshape(-1, cells.d))[0, :, :, 0]
        divergence = -np.einsum("cij,qn,cnj->cqi", cells.A_inverse, values, f, optimize=True)
        data = np.hstack([tractions.reshape(len(f), -1), divergence.reshape(len(f), -1)])
        y = data @ macro.particular.T
        residual = y @ macro.equations.T
        residual[:, : macro.n_data] -= data
        if (left := np.abs(residual).max() / np.abs(data).max(initial=1e-300)) > ROW_TOLERANCE:
            reason = f"tractions do not balance each cell: {left:.1e} of them is left"
            raise SolveError(reason, advice="use a thicker layer, or less contrast")
        y = y.reshape(seed.shape)
        if macro.null_space.shape[1]:
            N = macro.null_space.reshape(*macro.shape, -1)
            pairs = np.einsum("csrn,smn,stmi->crti", seed - y, macro.mass, N, optimize=True)
            right_side = np.einsum("crt,crti->ci", self._metric, pairs)
            a = np.einsum("cij,cj->ci", self._null_energy_inverse, right_side)
            y = y + (a @ macro.null_space.T).reshape(seed.shape)
        return np.asarray(y)

    @cached_property
    def _unit_moments(self) -> Array:
        """(parts nv nk, facets m d) stresses of the reference cell for unit moments on its facets."""
        cells, macro = self.cells, self.macro
        by_node = macro.particular[:, : macro.n_tractions].reshape(-1, macro.shape[0], len(macro.to_tractions), cells.d)
        return np.einsum("yfpd,pn->yfnd", by_node, macro.to_tractions).reshape(len(by_node), -1)

    def flexibilities(self) -> Array:
        """Return matrices (nc, k, k) of the complementary energy of a cell's k outward moments on its facets."""
        N, Y = self.macro.null_space, self._unit_moments
        k, m = Y.shape[1], N.shape[1]
        H = self._energies(self.macro.energy_tensor(Y, Y), k, k)
        if m:
            mixed = self._energies(self.macro.energy_tensor(N, Y), m, k)
            H = H - np.swapaxes(mixed, 1, 2) @ (self._null_energy_inverse @ mixed)
        return self._to_cells(self._to_cells(H), transpose=True)

    def _to_cells(self, H: Array, transpose: bool = False) -> Array:
        """Return B^T H or, with `transpose`, H B for H (nc, k, k); B maps a cell's moments to the reference cell."""
        H = np.swapaxes(H, 1, 2) if transpose else H
        inverse = np.swapaxes(self.cells.A_inverse, 1, 2) / self.cells.J[:, None, None]
        out = (inverse[:, None] @ H.reshape(len(H), -1, self.cells.d, H.shape[2])).reshape(H.shape)
        return np.asarray(np.swapaxes(out, 1, 2) if transpose else out)

    def moment_gradient(self, change: Array) -> Array:
        """Return the derivative (nc, facets, m, d), by a cell's outward moments, of half the squared norm of `change`."""
        cells, Y = self.cells, self._unit_moments.reshape(*self.macro.shape, -1)
        pairs = np.einsum("csrn,smn,stmi->crti", change, self.macro.mass, Y, optimize=True)
        by_moment = np.einsum("crt,crti->ci", self._metric, pairs).reshape(len(change), len(Y), -1, cells.d)
        return np.asarray(np.einsum("cfni,cik->cfnk", by_moment, cells.A_inverse / cells.J[:, None, None]))
