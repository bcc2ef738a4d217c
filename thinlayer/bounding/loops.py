"""Changes of tractions that leave every cell in balance, and conjugate gradients that lower the energy with them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import scipy.sparse

from forms.base import Array
from forms.kinematics import UNIT_ROTATIONS
from geometry.topology import BoolArray, FloatArray, IntArray, facet_ridge_keys
from thinlayer.bounding.cells import StraightCells
from thinlayer.bounding.stresses import Stresses
from thinlayer.bounding.tractions import CellLoads
from thinlayer.solving.linear_solvers import SubmatrixFactor

DEPENDENCE_SHIFT = 1e-11  # relative increase of the diagonal of changes that may depend on each other
RANK_TOLERANCE = 1e-9  # singular value of a facet's rigid motions, over the largest, that counts as zero
GAIN_TOLERANCE = 1e-14  # gain of energy by a step, over the energy, below which steps end


class _Columns:
    """Columns of a sparse matrix, collected group by group."""

    def __init__(self) -> None:
        self.rows, self.columns = list[IntArray](), list[IntArray]()
        self.values, self.count = list[FloatArray](), 0

    def add(self, rows: IntArray, columns: IntArray, values: FloatArray) -> None:
        """Add entries (n,) of any shape to the group; its columns are numbered from 0."""
        self.rows.append(rows.ravel())
        self.columns.append(columns.ravel() + self.count)
        self.values.append(np.broadcast_to(values, rows.shape).ravel())

    def end_group(self, n: int) -> None:
        """End a group of `n` columns, and begin the next."""
        self.count += n

    def matrix(self, n_rows: int) -> scipy.sparse.csr_matrix:
        """Return the matrix (n_rows, columns) without empty columns."""
        used, columns = np.unique(np.concatenate(self.columns), return_inverse=True)
        entries = np.concatenate(self.values), (np.concatenate(self.rows), columns)
        return scipy.sparse.csr_matrix(entries, (n_rows, len(used)))


def balanced_changes(cells: StraightCells, is_free: BoolArray) -> scipy.sparse.csr_matrix:
    """Return changes of the facets' moments, as columns (nf m d, k), under which each cell stays in balance.

    A ridge is a vertex in 2D, an edge in 3D. There are three kinds of change: a moment of a vertex, passed on through
    all cells around a ridge that contains it; a couple, in 3D about the ridge, passed on likewise; and tractions on a
    single facet that have neither a force nor a couple. Letters in shapes are those of `StraightCells`.

    Args:
        cells: the cells.
        is_free: (nf, d) mask of the components of tractions that may change.
    """
    d, n_facets, m = cells.d, len(cells.facets), cells.facet_nodes.shape[1]
    columns, facet_dofs = _Columns(), np.arange(n_facets * m * d).reshape(n_facets, m, d)
    keys, ridge_of = np.unique(facet_ridge_keys(cells.facets, d - 1), return_inverse=True)
    ridge_of = ridge_of.reshape(n_facets, -1)
    cell_ridges = np.searchsorted(keys, facet_ridge_keys(cells.corners, d - 1))
    n_at_ridge, n_cells_at = np.bincount(ridge_of.ravel()), np.bincount(cell_ridges.ravel(), minlength=len(keys))
    # facets around a ridge are a single ring, inside, or a single fan, at the boundary
    is_fan = (n_at_ridge == n_cells_at) | (n_at_ridge == n_cells_at + 1)
    senses = _senses(cells)

    def closed(mask: BoolArray) -> BoolArray:
        """Return the mask (n,) of the ridges at which `mask` (nf, d), of facets and their ridges, holds for all facets."""
        counts = np.bincount(ridge_of[mask], minlength=len(keys))
        return np.asarray(is_fan & (counts == n_at_ridge))

    node_vertices, n_nodes = cells.node_vertices[cells.facet_nodes], len(cells.node_vertices)
    node_vertex = np.where(node_vertices[..., 0] == node_vertices[..., 1], node_vertices[..., 0], -1)
    for component in range(d):
        is_closed = closed(np.broadcast_to(is_free[:, [component]], ridge_of.shape))
        for k, vertices in enumerate(combinations(range(d), d - 1)):
            on_ridge = (node_vertex[..., None] == cells.facets[:, None, list(vertices)]).any(axis=2)
            facets, nodes = np.nonzero(on_ridge & is_closed[ridge_of[:, k], None])
            loops = ridge_of[facets, k] * n_nodes + cells.facet_nodes[facets, nodes]
            columns.add(facet_dofs[facets, nodes, component], loops, senses[facets, k])
        columns.end_group(len(keys) * n_nodes)
    motions, size = _facet_motions(cells)
    sums = np.swapaxes(motions, 1, 2) * np.tile(is_free, m)[:, None]  # forces and couples of the free moments
    ends = cells.points[cells.facets][:, [*combinations(range(d), d - 1)]]
    axes = ends[:, :, 1] - ends[:, :, 0] if d == 3 else np.ones((n_facets, d, 1))
    couples = np.insert(axes / np.linalg.norm(axes, axis=2, keepdims=True), [0] * d, 0.0, axis=2)  # no force
    moments = couples @ np.swapaxes(np.linalg.pinv(sums, RANK_TOLERANCE), 1, 2)
    is_closed = closed(np.abs(moments @ np.swapaxes(sums, 1, 2) - couples).max(axis=2) < RANK_TOLERANCE)
    for k in range(d):
        facets = np.flatnonzero(is_closed[ridge_of[:, k]])
        loops = np.repeat(ridge_of[facets, k, None], m * d, axis=1)
        values = moments[facets, k] * (senses[facets, k] / size[facets])[:, None]
        columns.add(facet_dofs[facets].reshape(len(facets), -1), loops, values)
    columns.end_group(len(keys))
    pattern_codes = is_free @ (1 << np.arange(d))
    for code in np.unique(pattern_codes[pattern_codes > 0]):
        facets = np.flatnonzero(pattern_codes == code)
        mask = np.tile(is_free[facets[0]], m)
        left, singular, _ = np.linalg.svd(motions[facets][:, mask])
        ranks = (singular > RANK_TOLERANCE * singular[:, :1]).sum(axis=1)
        for rank in np.unique(ranks):
            group = facets[ranks == rank]
            null_space = left[ranks == rank][:, :, rank:]
            rows = np.broadcast_to(facet_dofs[group].reshape(len(group), -1)[:, mask][:, :, None], null_space.shape)
            numbers = group[:, None, None] * m * d + np.arange(null_space.shape[2])
            columns.add(rows, np.broadcast_to(numbers, null_space.shape), null_space)
    return columns.matrix(n_facets * m * d)


def _senses(cells: StraightCells) -> FloatArray:
    """Return the sense (nf, d), 1 or -1, in which the normal of a facet's first cell turns about its d ridges."""
    d, x = cells.d, cells.points[cells.facets]
    first = cells.facet_cells[:, 0]
    local = (cells.cell_facets[first] == np.arange(len(first))[:, None]).argmax(axis=1)
    normals, senses = cells.area_vectors[first, local], np.empty((len(first), d))
    for k, vertices in enumerate(combinations(range(d), d - 1)):
        arm = x[:, d - 1 - k] - x[:, vertices[0]]  # from the ridge to the vertex of the facet that is not on it
        frame = [arm, normals] if d == 2 else [x[:, vertices[1]] - x[:, vertices[0]], arm, normals]
        senses[:, k] = np.sign(np.linalg.det(np.stack(frame, axis=1)))
    return senses


def _facet_motions(cells: StraightCells) -> tuple[FloatArray, FloatArray]:
    """Return k rigid motions (nf, m d, k) of facets at their nodes, and the sizes (nf,) that divide their rotations."""
    x = cells.points[cells.node_vertices].mean(axis=1)[cells.facet_nodes]
    arms = x - cells.points[cells.facets].mean(axis=1, keepdims=True)
    size = np.linalg.norm(arms, axis=2).max(axis=1)
    rotations = np.einsum("kij,fnj->fnik", UNIT_ROTATIONS[cells.d], arms / size[:, None, None])
    translations = np.broadcast_to(np.eye(cells.d), (*arms.shape, cells.d))
    return np.concatenate([translations, rotations], axis=3).reshape(len(x), arms[0].size, -1), size


def _matrix(blocks: Array, dofs: IntArray, n: int) -> scipy.sparse.csr_matrix:
    """Return the sum (n, n) of blocks (m, k, k) at rows and columns `dofs` (m, k)."""
    rows, columns = np.repeat(dofs, dofs.shape[1], axis=1).ravel(), np.tile(dofs, (1, dofs.shape[1])).ravel()
    return scipy.sparse.csr_matrix((blocks.ravel(), (rows, columns)), (n, n))


class TractionImprovement:
    """Lowers the complementary energy of stresses in equilibrium by a few conjugate-gradient steps on tractions.

    The preconditioner inverts the energy's second derivative among the changes that touch some cells: those of the
    layers, as thin cells couple the tractions along a layer strongly, or all cells. For all others it is the diagonal,
    without the coupling of facets, with which cells of very different sizes need many steps. Any number of steps leaves
    each cell in balance.

    Args:
        stresses: stresses of the cells.
        is_free: (nf, d) mask of the components of tractions that may change.
        coupled: (nc,) mask of the cells whose changes the preconditioner inverts together.
    """

    def __init__(self, stresses: Stresses, is_free: BoolArray, coupled: BoolArray) -> None:
        self._stresses, cells = stresses, stresses.cells
        self._T = balanced_changes(cells, is_free)
        n, k = self._T.shape[0], cells.closure.shape[1] * cells.d
        sign = np.repeat(cells.sign, k, axis=1)
        self._H = stresses.flexibilities() * sign[:, :, None] * sign[:, None]
        self._dofs = (cells.moment_rows[..., None] * cells.d + np.arange(cells.d)).reshape(len(sign), -1)
        facet_numbers, T = np.arange(cells.sign.shape[1]), self._T
        by_facet = self._H.reshape(len(sign), len(facet_numbers), k, len(facet_numbers), k)
        facet_blocks = by_facet[:, facet_numbers, :, facet_numbers]  # (facets, nc, k, k)
        facet_dofs = np.swapaxes(self._dofs.reshape(len(sign), -1, k), 0, 1)
        facet_matrix = _matrix(facet_blocks.reshape(-1, k, k), facet_dofs.reshape(-1, k), n)
        self._diagonal = np.maximum(np.asarray(T.multiply(facet_matrix @ T).sum(axis=0)).ravel(), 1e-300)
        self._in_block = self._touching(self._dofs[coupled].ravel())
        near = np.asarray(abs(T[:, self._in_block]).sum(axis=1)).ravel() > 0
        cells_near = near[self._dofs].any(axis=1)
        block = T[:, self._in_block]
        block = (block.T @ (_matrix(self._H[cells_near], self._dofs[cells_near], n) @ block)).tocsr()
        shift = scipy.sparse.diags(DEPENDENCE_SHIFT * block.diagonal())
        self._factor = SubmatrixFactor(block + shift, symmetric=True)

    def _touching(self, dofs: IntArray) -> BoolArray:
        """Return the mask of the columns of `balanced_changes` that change any of the moments `dofs`."""
        marked = np.zeros(self._T.shape[0])
        marked[dofs] = 1.0
        return np.asarray(abs(self._T).T @ marked).ravel() > 0

    def _curvature(self, p: Array) -> Array:
        """Return the product of the energy's second derivative with changes `p`."""
        moments = (self._T @ p)[self._dofs]
        forces = np.bincount(self._dofs.ravel(), (self._H @ moments[..., None]).ravel(), self._T.shape[0])
        return np.asarray(self._T.T @ forces)

    def _precondition(self, r: Array) -> Array:
        """Return the preconditioned residual: `r` over the diagonal, or solved with the factor of coupled changes."""
        z = r / self._diagonal
        if self._in_block.any():
            block = np.zeros(int(self._in_block.sum()))
            self._factor.solve(r[self._in_block], block)
            z[self._in_block] = block
        return z

    def improved(self, loads: CellLoads, moments: Array, seed: Array, steps: int) -> Array:
        """Return a stress (nc, parts, nv, nk) in equilibrium, after steps on tractions that bring it nearer to `seed`.

        Args:
            loads: the loads.
            moments: (nf m, d) moments of the tractions to start from.
            seed: stress from which the distance in complementary energy is lowered.
            steps: number of conjugate-gradient steps.
        """
        stresses, cells = self._stresses, self._stresses.cells
        stress = stresses.in_equilibrium(moments, loads.body_force, seed)
        if not (steps and self._T.shape[1]):
            return stress
        energy = float(stresses.product(stress - seed, stress - seed).sum())
        gradient = cells.moment_sums(stresses.moment_gradient(stress - seed) * cells.sign[:, :, None, None])
        x, r = np.zeros(self._T.shape[1]), -(self._T.T @ gradient.ravel())
        p = z = self._precondition(r)
        rz = float(r @ z)
        for _ in range(steps):
            Ap = self._curvature(p)
            if not rz > GAIN_TOLERANCE * energy:
                break
            alpha = rz / float(p @ Ap)
            x, r = x + alpha * p, r - alpha * Ap
            z = self._precondition(r)
            rz, old_rz = float(r @ z), rz
            p = z + rz / old_rz * p
        return stresses.in_equilibrium(moments + (self._T @ x).reshape(moments.shape), loads.body_force, seed)
