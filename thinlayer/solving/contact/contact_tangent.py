"""The tangent of a contact problem, and its preconditioner: a multigrid hierarchy and the nodes of S."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.contact.node_blocks import faster_products, in_blocks, smooth_in_blocks
from thinlayer.solving.contact.surface_stiffness import SurfaceStiffness
from thinlayer.solving.petsc import PREFIX

CLIP_NORMAL, CLIP_TANGENTIAL = 30.0, 1.0  # largest stiffness of springs in the hierarchy, relative to E/h
FLOOR = 1e-3  # least stiffness of springs in the hierarchy, relative to E/h, for bodies that nothing else holds


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
        M.zeroRowsColumns((M.getOwnershipRange()[0] + problem.held).astype(PETSc.IntType), problem.diagonal)
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
        if self._cycle.getType() == "gamg":
            smooth_in_blocks(self._cycle, self._matrix)
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
        csr = (rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.blocks)
        J = PETSc.Mat().createBAIJ(free.size, self.nodes.dim, csr=csr, comm=PETSc.COMM_SELF)
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
