"""Tangent matrix of a contact problem and its multigrid preconditioner, for Newton's method."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy.sparse.linalg import splu

from forms.base import Array
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.contact_nodes import NodePairs
from thinlayer.solving.contact.pairs import ContactPairs
from thinlayer.solving.equations import Equations
from thinlayer.solving.petsc import PREFIX, convert_to_baij, lean_products
from thinlayer.system.ranks import destroy

# diagonal pivots unless small, and a column order for such pivots
SUPERLU_OPTIONS = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.01, "options": {"SymmetricMode": True}}
SWEEPS_PER_STEP = 4  # number of Gauss-Seidel sweeps before a Newton step, if sweeps are due
NODE_STIFFNESS_FACTOR = 3.0  # stiffness of a node of S, relative to its area times E/h; an upper estimate
MAX_K_N, MAX_K_T = 10.0, 1.0  # largest stiffness of springs in the hierarchy, relative to E/h
MIN_SPRING_STIFFNESS = 1e-3  # least stiffness of springs in the hierarchy, relative to E/h, for bodies without supports
# the hierarchy changes if the springs of more than this share of the nodes of S change by more than half
MAX_CHANGED_FRACTION = 0.1


class ContactTangent:
    """Tangent matrix of a contact problem and its preconditioner, as Python contexts of a PETSc matrix and a PETSc PC.

    The preconditioner has two stages: a cycle of algebraic multigrid, then an exact solve for the nodes of S. The
    multigrid hierarchy is built for the stiffness of the bodies plus symmetric springs between the sides of S. In the
    second stage each rank factorises the tangent of its own nodes of S, without data of other ranks.

    Vectors are zero at constrained dofs. The product with the tangent is that with the hierarchy's finest matrix, plus
    a correction on S: contact tangents minus springs.

    Args:
        A: stiffness of the bodies with supports.
        nodes: the n pairs of upper and lower nodes whose upper node this rank owns.
        pairs: the same pairs, with their contact laws and the nodes for which this rank solves.
        equations: the balance of forces of the model.
        jumps: (n, d) expected jumps of the pairs in d dimensions. The springs follow the tangents there. None: springs
            for pairs that neither open nor slide.
    """

    def __init__(
        self, A: PETSc.Mat, nodes: NodePairs, pairs: ContactPairs, equations: Equations, jumps: Array | None
    ) -> None:
        self._A, self.nodes, self.pairs, self.bc_dofs = A, nodes, pairs, equations.bc_dofs
        row_start = A.getOwnershipRange()[0]
        index_set = PETSc.IS().createGeneral((row_start + pairs.dofs).astype(PETSc.IntType), comm=A.comm)
        self._pair_rows = A.createSubMatrix(index_set, None)
        index_set.destroy()
        self._pair_product = self._pair_rows.createVecLeft()
        self._local_K = local_csr(self._pair_rows)[:, row_start + pairs.dofs]  # between the nodes of S on this rank
        self._local_blocks = self._local_K.tobsr((pairs.d,) * 2)
        self._local_blocks.sort_indices()
        self._body_stiffness, self._bc_rows = self._adjacent_stiffness(), equations.bc_rows
        self._springs, self._changes = self._spring_stiffness(jumps), dict[int, PETSc.Mat]()
        self._build_hierarchy(equations)

    def _adjacent_stiffness(self) -> Array:
        """Estimate the bodies' stiffness E/h (n,) at each pair of nodes: Young's modulus over cell size. Collective.

        Of the two sides of S the softer one counts.
        """
        nodes, diagonal = self.nodes, self._A.getDiagonal()
        upper = diagonal.array_r.reshape(-1, nodes.dim)[nodes.upper].mean(axis=1)
        lower = nodes.lower_side(diagonal).mean(axis=1)
        diagonal.destroy()
        softer = np.where(lower > 0, np.minimum(upper, lower), upper)  # a rigid base has no stiffness here
        return np.asarray(softer / (NODE_STIFFNESS_FACTOR * nodes.weights))

    def _spring_stiffness(self, jumps: Array | None) -> Array:
        """Return the stiffness (n, d, d) of the preconditioner's springs at n pairs of nodes in d dimensions.

        It is the diagonal of the contact tangent, in the axes of S, within certain limits. They are proportional to the
        stiffness E/h of the bodies: Young's modulus over cell size.

        Args:
            jumps: (n, d) jumps at which tangents are taken. None: pairs that neither open nor slide.
        """
        pairs, scale, d = self.pairs, self._body_stiffness, self.nodes.dim
        D = pairs.bonded_tangents() if jumps is None else pairs.tangents(jumps)
        out, i = np.zeros_like(D), np.arange(d)
        stiffness = D[:, i, i]
        tangential = stiffness[:, :-1].mean(axis=1)
        out[:, i[:-1], i[:-1]] = np.clip(tangential, MIN_SPRING_STIFFNESS * scale, MAX_K_T * scale)[:, None]
        out[:, -1, -1] = np.clip(stiffness[:, -1], MIN_SPRING_STIFFNESS * scale, MAX_K_N * scale)
        return out

    def _build_hierarchy(self, equations: Equations) -> None:
        """Build the multigrid hierarchy for the stiffness of the bodies plus springs between the sides of S.

        Args:
            equations: the balance of forces of the model, for its supports and rigid motions.
        """
        springs, pattern = self.nodes.stiffness(self._springs), PETSc.Mat.Structure
        M, rigid_base = self._A.copy(), self.nodes.lower_matrix is None
        M.axpy(1.0, springs, pattern.SUBSET_NONZERO_PATTERN if rigid_base else pattern.DIFFERENT_NONZERO_PATTERN)
        springs.destroy()
        M.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        equations.apply_bcs(M)
        M.setOption(PETSc.Mat.Option.SPD, True)
        M.setBlockSize(self.nodes.dim)
        M.setNearNullSpace(PETSc.NullSpace().create(vectors=equations.near_null, comm=M.comm))
        self._matrix = M
        self._multigrid = PETSc.PC().create(M.comm)
        self._multigrid.setOptionsPrefix(PREFIX)
        self._multigrid.setOperators(M)
        self._multigrid.setFromOptions()
        with lean_products():
            self._multigrid.setUp()
        if self._multigrid.getType() == "gamg":
            self._multigrid.setReusePreconditioner(True)
            for level in range(1, self._multigrid.getMGLevels()):  # the coarsest has a factor instead of a smoother
                convert_to_baij(self._multigrid.getMGSmoother(level).getOperators()[0])

    def update_springs(self, jumps: Array | None) -> None:
        """Replace the springs in the multigrid hierarchy by those for other jumps, if many of them change. Collective.

        Springs that suit another contact status slow the linear solver down.

        Args:
            jumps: (n, d) jumps of the n pairs in d dimensions. None: pairs that neither open nor slide.
        """
        new_springs, comm = self._spring_stiffness(jumps), self.nodes.comm
        is_changed = (np.abs(new_springs - self._springs) > self._springs / 2).any(axis=(1, 2))
        many_change = comm.allreduce(int(is_changed.sum())) > MAX_CHANGED_FRACTION * comm.allreduce(len(new_springs))
        if not many_change or self._multigrid.getType() != "gamg":
            return
        change = springs = self.nodes.stiffness(new_springs - self._springs)
        change.zeroRowsColumns(self._bc_rows, 0.0)
        for level in reversed(range(self._multigrid.getMGLevels())):
            matrix = self._multigrid.getMGSmoother(level).getOperators()[0]
            matrix.axpy(1.0, change, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            if level:  # the pattern stays the same, so that the symbolic product can be used again
                product = self._changes.get(level)
                change = self._changes[level] = change.ptap(self._multigrid.getMGInterpolation(level), result=product)
        springs.destroy()
        self._springs = new_springs

    def set_tangents(self, tangents: Array) -> None:
        """Set the tangents of the contact laws for all later products and solves.

        The stiffness of this rank's nodes of S is factorised with them.

        Args:
            tangents: (n, d, d) traction per jump of n pairs of nodes, in the axes of S.
        """
        self._tangents = tangents
        if len(self.pairs.nodes):
            self._local_factor = splu((self._local_K + self.pairs.stiffness(tangents)).tocsc(), **SUPERLU_OPTIONS)

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Write the product of the tangent and `x` into `y`; PETSc calls it as the product of a Python matrix."""
        self._matrix.mult(x, y)
        self.nodes.add_forces(np.einsum("nij,nj->ni", self._tangents - self._springs, self.nodes.jump(x)), y)
        y.array[self.bc_dofs] = 0.0

    def apply(self, _: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the preconditioner to the residual `r`, and write the result into `z`; PETSc calls this method.

        A multigrid cycle is followed by a solve for this rank's nodes of S, with all other displacements fixed.
        """
        self._multigrid.apply(r, z)
        z.array[self.bc_dofs] = 0.0
        tractions = np.einsum("nij,nj->ni", self._tangents, self.nodes.jump(z))
        self._pair_rows.mult(z, self._pair_product)
        if len(self.pairs.nodes):
            residual = r.array_r[self.pairs.dofs] - self._pair_product.array_r - self.pairs.nodal_forces(tractions)
            z.array[self.pairs.dofs] += self._local_factor.solve(residual)

    def sweep(self, u: PETSc.Vec, residual: PETSc.Vec) -> None:
        """Improve the displacements `u` in place by Gauss-Seidel sweeps over this rank's nodes of S.

        Args:
            u: displacements of all nodes.
            residual: residual of the contact problem at `u`.
        """
        pairs, w = self.pairs, self.nodes.separation(u)
        u_pairs = u.array_r[pairs.dofs].copy()
        g = self._local_K @ u_pairs + pairs.forces(w) - residual.array_r[pairs.dofs]
        gaps = w - (pairs.jump_matrix @ u_pairs).reshape(w.shape)
        pairs.sweep(self._local_blocks, g, u_pairs, SWEEPS_PER_STEP, gaps)
        u.array[pairs.dofs] = np.where(pairs.free.ravel(), u_pairs, u.array_r[pairs.dofs])

    def close(self) -> None:
        """Free matrices, vectors and the hierarchy."""
        destroy(self._multigrid, self._matrix, self._pair_rows, self._pair_product, *self._changes.values())
