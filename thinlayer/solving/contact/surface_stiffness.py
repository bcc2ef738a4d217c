"""The stiffness at the nodes of S, and Gauss-Seidel sweeps over them."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.contact.gauss_seidel import BlockRows, sweep_nodes
from thinlayer.solving.contact.problem import ContactProblem

SWEEPS = 4  # number of Gauss-Seidel sweeps before a Newton step, if sweeps are due
DIAGONAL = 3.0  # stiffness of a node of S, relative to its area times E/h; an upper estimate
STOP = 1e6  # stiffness that fixes held components during sweeps, relative to the node's stiffness


class SurfaceStiffness:
    """The stiffness at this rank's nodes of S, upper side.

    Attributes:
        rows: (n d, all) rows of the stiffness matrix.
        blocks: blocks between these nodes; held components are decoupled.
        diagonal: (n,) indices of the diagonal blocks.
        scale: (n,) estimate of E/h, Young's modulus over the size of the cells.
        free: (n, d) components that are not held.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem, self.nodes = problem, problem.nodes
        A, d, n = problem.A, self.nodes.dim, len(self.nodes.upper)
        first, end = A.getOwnershipRange()
        dofs = self.nodes.dofs.ravel()
        index = PETSc.IS().createGeneral((first + dofs).astype(PETSc.IntType), comm=problem.comm)
        self.rows = A.createSubMatrix(index, None)
        index.destroy()
        self._product = self.rows.createVecLeft()
        place = np.full(end - first, -1, np.int64)
        place[dofs] = np.arange(n * d)
        indptr, columns, values = self.rows.getValuesCSR()
        local = (columns >= first) & (columns < end)
        column = np.full(len(columns), -1, np.int64)
        column[local] = place[columns[local] - first]
        here = column >= 0
        row = np.repeat(np.arange(n * d), np.diff(indptr))
        self._stiffness = scipy.sparse.csr_matrix((values[here], (row[here], column[here])), shape=(n * d, n * d))
        blocks = self._stiffness.tobsr((d, d))
        blocks.sort_indices()
        self.blocks = BlockRows(blocks.indptr.astype(np.int32), blocks.indices.astype(np.int32), blocks.data)
        self.diagonal = np.flatnonzero(np.repeat(np.arange(n), np.diff(blocks.indptr)) == blocks.indices)
        own = np.einsum("nii->n", blocks.data[self.diagonal]) / d
        self.scale = own / (DIAGONAL * self.nodes.weights)
        self.free = ~self.nodes.held_upper
        # sweeps move whole nodes, so held components need a stop
        self._stop = np.where(self.free, 0.0, STOP * (own + problem.law.K_N * self.nodes.weights)[:, None])
        self._swept = self.with_diagonal(self._stop[:, :, None] * np.eye(d))

    def with_diagonal(self, more: Array) -> BlockRows:
        """The blocks with (n, d, d) added to the diagonal ones."""
        blocks = self.blocks.blocks.copy()
        blocks[self.diagonal] += more
        return BlockRows(self.blocks.indptr, self.blocks.indices, blocks)

    def of(self, x: PETSc.Vec) -> Array:
        """Values (n, d) of a vector of displacements or forces at these nodes."""
        return np.asarray(x.array_r.reshape(-1, self.nodes.dim)[self.nodes.upper])

    def add(self, values: Array, x: PETSc.Vec) -> None:
        """Add values (n, d) to a vector at these nodes."""
        x.array.reshape(-1, self.nodes.dim)[self.nodes.upper] += values

    def forces(self, x: PETSc.Vec) -> Array:
        """Stiffness times displacements, (n, d)."""
        self.rows.mult(x, self._product)
        return np.asarray(self._product.array_r.reshape(-1, self.nodes.dim))

    def sweep(self, u: PETSc.Vec, residual: PETSc.Vec, turned: Array) -> None:
        """Gauss-Seidel sweeps, in place.

        Args:
            u: displacements.
            residual: residual of the law at u.
            turned: (n, d) changes of the jumps of nodes that shall stick; these nodes are not swept.
        """
        law, nodes, slip = self.problem.law, self.nodes, self.problem.slip
        lower, old = nodes.lower_side(u), self.of(u)
        assert law.numbers is not None
        t = law.traction(np.einsum("nij,nj->ni", nodes.frames, old - lower), slip)
        contact = np.einsum("nji,nj->ni", nodes.frames, t * nodes.weights[:, None])
        near = (self._stiffness @ old.ravel()).reshape(old.shape)
        new = old + np.einsum("nji,nj->ni", nodes.frames, turned)
        sweep_nodes(
            self._swept, near + self._stop * old + contact - self.of(residual), new, lower, nodes.frames, nodes.weights,
            law.numbers, slip=slip, moves=np.asarray(~turned.any(axis=1)), sweeps=SWEEPS,
        )  # fmt: skip
        self.add(np.where(self.free, new - old, 0.0), u)

    def close(self) -> None:
        """Free the matrix."""
        self.rows.destroy()
        self._product.destroy()
