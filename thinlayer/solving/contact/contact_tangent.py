"""The tangent of a contact problem: the nodes of S with their stiffness, a multigrid hierarchy, and products in blocks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array
from thinlayer.solving.contact.gauss_seidel import sorted_blocks, sweep_nodes
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.petsc import PREFIX

SWEEPS = 4  # number of Gauss-Seidel sweeps before a Newton step, if sweeps are due
DIAGONAL = 3.0  # stiffness of a node of S, relative to its area times E/h; an upper estimate
STOP = 1e6  # stiffness that fixes held components during sweeps, relative to the node's stiffness
CLIP_NORMAL, CLIP_TANGENTIAL = 30.0, 1.0  # largest stiffness of springs in the hierarchy, relative to E/h
FLOOR = 1e-3  # least stiffness of springs in the hierarchy, relative to E/h, for bodies that nothing else holds


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
        first, dofs = A.getOwnershipRange()[0], self.nodes.dofs.ravel()
        index = PETSc.IS().createGeneral((first + dofs).astype(PETSc.IntType), comm=problem.comm)
        self.rows = A.createSubMatrix(index, None)
        index.destroy()
        self._product = self.rows.createVecLeft()
        indptr, columns, values = self.rows.getValuesCSR()
        rows = scipy.sparse.csr_matrix((values, columns, indptr), shape=(n * d, A.getSize()[1]))
        self._stiffness = rows[:, first + dofs]
        self.blocks = blocks = sorted_blocks(self._stiffness, d)
        self.diagonal = np.flatnonzero(np.repeat(np.arange(n), np.diff(blocks.indptr)) == blocks.indices)
        own = np.einsum("nii->n", blocks.data[self.diagonal]) / d
        self.scale = own / (DIAGONAL * self.nodes.weights)
        self.free = ~self.nodes.held_upper
        # sweeps move whole nodes, so held components need a stop
        self._stop = np.where(self.free, 0.0, STOP * (own + problem.law.K_N * self.nodes.weights)[:, None])
        self._swept = self.with_diagonal(self._stop[:, :, None] * np.eye(d))

    def with_diagonal(self, more: Array) -> scipy.sparse.bsr_matrix:
        """The blocks with (n, d, d) added to the diagonal ones."""
        blocks = self.blocks.copy()
        blocks.data[self.diagonal] += more
        return blocks

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


class Tangent:
    """The tangent of a contact problem and its preconditioner, as contexts of a PETSc matrix and a PETSc PC.

    Both act on vectors that are zero at held displacements. Both multiply with the hierarchy's matrix in blocks; the
    tangent adds the difference between the tangents of S and the springs of the hierarchy.

    Args:
        surface: the nodes of S.
        start: expected jumps, which choose the springs of the hierarchy; None: bonded.
    """

    _matrix: PETSc.Mat

    def __init__(self, surface: SurfaceStiffness, start: Array | None) -> None:
        self.surface, self.problem, self.nodes = surface, surface.problem, surface.problem.nodes
        self._build(self._springs(start))
        self._contact: PETSc.PC | None = None
        size = self.nodes.dofs.size
        self._vectors = [PETSc.Vec().createSeq(size, comm=PETSc.COMM_SELF) for _ in range(2)]
        if self.nodes.lower is not None:
            self._vectors += [self.nodes.lower.createVecLeft(), self._matrix.createVecLeft()]

    def _springs(self, start: Array | None) -> Array:
        """Clipped tangents (n, d, d) of S without the coupling by friction."""
        law, scale = self.problem.law, self.surface.scale
        D = law.bonded(len(scale), self.nodes.dim) if start is None else law.tangent(start, self.problem.slip)
        i = np.arange(self.nodes.dim)
        own = D[:, i, i]
        out = np.zeros_like(D)
        out[:, i[:-1], i[:-1]] = np.clip(own[:, :-1].mean(axis=1), FLOOR * scale, CLIP_TANGENTIAL * scale)[:, None]
        out[:, -1, -1] = np.clip(own[:, -1], FLOOR * scale, CLIP_NORMAL * scale)
        return out

    def _build(self, springs: Array) -> None:
        """Build the hierarchy."""
        problem, nodes = self.problem, self.nodes
        self._built_with = nodes.blocks(springs)
        added = nodes.stiffness(springs)
        M = problem.A.copy()
        pattern = PETSc.Mat.Structure
        M.axpy(1.0, added, pattern.SUBSET_NONZERO_PATTERN if nodes.lower is None else pattern.DIFFERENT_NONZERO_PATTERN)
        added.destroy()
        M.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        M.zeroRowsColumns(problem.equations.held_rows, problem.diagonal)
        M.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        M.setOption(PETSc.Mat.Option.SPD, True)
        M.setBlockSize(nodes.dim)
        M.setNearNullSpace(problem.near)
        self._matrix: PETSc.Mat = in_blocks(M, nodes.dim)
        self._cycle = PETSc.PC().create(problem.comm)
        self._cycle.setOptionsPrefix(PREFIX)
        self._cycle.setOperators(M)
        self._cycle.setFromOptions()
        with faster_products(serial=problem.comm.size == 1):
            self._cycle.setUp()
        if self._cycle.getType() == "gamg":  # its finest level uses the blocks, too: a solve takes 3 % less time
            finest = self._cycle.getMGLevels() - 1
            if finest:  # a single level has a factor instead of a smoother
                self._cycle.getMGSmoother(finest).setOperators(self._matrix, self._matrix)
            self._cycle.setReusePreconditioner(True)
            self._cycle.setOperators(self._matrix, self._matrix)  # releases M
        M.destroy()

    def linearise(self, tangents: Array) -> None:
        """Use these tangents (n, d, d) of the law from now on."""
        self._of_contact = self.nodes.blocks(tangents)
        self._more = self._of_contact - self._built_with
        free = self.surface.free
        rows = self.surface.with_diagonal(self._of_contact * (free[:, :, None] & free[:, None, :]))
        if self._contact is not None:
            self._contact.destroy()
        if not len(tangents):
            return
        J = _in_petsc(rows, free.size, PETSc.COMM_SELF)
        self._contact = PETSc.PC().create(PETSc.COMM_SELF)
        self._contact.setOperators(J)
        self._contact.setType("lu")
        self._contact.setFactorOrdering("nd")
        self._contact.setUp()
        J.destroy()

    def _jumps(self, x: PETSc.Vec) -> Array:
        """Jumps in global axes, (n, d)."""
        upper = self.surface.of(x)
        if self.nodes.lower is None:
            return upper
        lower = self._vectors[2]
        self.nodes.lower.mult(x, lower)
        return np.asarray(upper - lower.array_r.reshape(upper.shape))

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = tangent times x."""
        self._matrix.mult(x, y)
        forces = np.einsum("nij,nj->ni", self._more, self._jumps(x))
        self.surface.add(forces, y)
        if self.nodes.lower is not None:
            lower, there = self._vectors[2:]
            lower.array[:] = forces.ravel()
            self.nodes.lower.multTranspose(lower, there)
            y.axpy(-1.0, there)
        y.array[self.problem.held] = 0.0

    def apply(self, _: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """z = a cycle of multigrid, then a solve for the nodes of S with all other displacements fixed."""
        self._cycle.apply(r, z)
        z.array[self.problem.held] = 0.0
        contact = np.einsum("nij,nj->ni", self._of_contact, self._jumps(z))
        left = self.surface.of(r) - self.surface.forces(z) - contact
        if self._contact is None:
            return
        q, move = self._vectors[:2]
        q.array[:] = np.where(self.surface.free, left, 0.0).ravel()
        self._contact.apply(q, move)
        self.surface.add(move.array_r.reshape(left.shape), z)

    def close(self) -> None:
        """Free matrices, factors and the hierarchy."""
        for item in (self._cycle, self._matrix, self._contact, *self._vectors):
            if item is not None:
                item.destroy()


# ---------------------------------------------------------------- faster products
@contextmanager
def faster_products(*, serial: bool) -> Iterator[None]:
    """Within a `with` block, PETSc computes A P before P^T A P: a contact solve takes 8 to 10 % less time, more memory."""
    database, name = PETSc.Options(), "matptap_via"  # PETSc reads this option without a prefix
    ours = serial and not database.hasName(name)
    if ours:
        database.setValue(name, "rap")
    try:
        yield
    finally:
        if ours:
            database.delValue(name)


def in_blocks(A: PETSc.Mat, d: int) -> PETSc.Mat:
    """Convert A to blocks of d x d, which multiply twice as fast; PETSc's own conversion is slow."""
    indptr, indices, values = A.getValuesCSR()
    shape = (A.getLocalSize()[0], A.getSize()[1])
    blocks = scipy.sparse.csr_matrix((values, indices, indptr), shape=shape, copy=False).tobsr((d, d))
    return _in_petsc(blocks, A.getSizes(), A.comm)


def _in_petsc(blocks: scipy.sparse.bsr_matrix, sizes: Any, comm: PETSc.Comm) -> PETSc.Mat:
    csr = (*(a.astype(PETSc.IntType, copy=False) for a in (blocks.indptr, blocks.indices)), blocks.data)
    return PETSc.Mat().createBAIJ(sizes, blocks.blocksize[0], csr=csr, comm=comm)
