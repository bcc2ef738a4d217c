"""The discrete contact problem of a time step: linear bodies, and a contact law at the nodes of S."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.contact import ContactLaw
from thinlayer.contact.nodes import Array, ContactNodes

ROUNDING = 1e-5  # times 1e-10, what is demanded: stiffness times displacement is rounded to 1e-15
FORGOTTEN = 1e-4  # of the displacements before: where loads vanish, what may be left of them after a solve
LOOSEST = 1e3  # times the loads: what a body far away, on soft springs, is measured by at most
NEAR = 3e-5  # of the loads, or of the forces before


class ContactProblem:
    """Find u with A u + (nodal forces of law.traction(jump(u), slip)) = b. Collective.

    Attributes:
        A: stiffness of the bodies, symmetric; rows and columns of held displacements are zero but for the diagonal. Without
            contact it may be singular: S may be all that holds a body.
        nodes: the nodes of S.
        law: the contact law.
        loads: nodal forces of the loads; zero at held displacements.
        prescribed: held displacements; zero elsewhere.
        b: loads, less what held displacements exert; at held displacements the diagonal times the prescribed value.
        slip: (n, d - 1) slip at the beginning of the step.
        held: local held displacements of this rank.
        largest: norm of b, or of the forces before: beyond it no residual is small.
        least: size of the loads, or of what rounding leaves: the residual is measured by it, or by larger forces.
    """

    def __init__(
        self, K: PETSc.Mat, held: npt.NDArray[np.int32], nodes: ContactNodes, law: ContactLaw, near: PETSc.NullSpace
    ) -> None:
        """K: stiffness without supports; near: the rigid motions, for multigrid."""
        self.K, self.held, self.nodes, self.law, self.near = K, held, nodes, law, near
        self.comm = nodes.comm
        self.b, self.prescribed, self.loads, self._forces = (K.createVecLeft() for _ in range(4))
        self.slip: Array = np.zeros((len(nodes.upper), nodes.dim - 1))

    @cached_property
    def diagonal(self) -> float:
        """Mean diagonal entry of the stiffness, put on held diagonals."""
        d = self.K.getDiagonal()
        mean = float(d.sum() / d.getSize())
        d.destroy()
        return mean

    @cached_property
    def A(self) -> PETSc.Mat:
        """The stiffness with supports taken in."""
        A = self.K.copy()
        first = A.getOwnershipRange()[0]
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        A.zeroRowsColumns((first + self.held).astype(PETSc.IntType), self.diagonal)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        A.setBlockSize(self.nodes.dim)
        A.setNearNullSpace(self.near)
        return A

    @cached_property
    def _rounding(self) -> float:
        """Force over displacement that makes the least size of forces."""
        stiffness = self.diagonal
        if self.nodes.lower is not None:  # springs of two bodies see the difference of their displacements
            area = self.comm.allreduce(float(self.nodes.weights.max(initial=0.0)), max)
            stiffness = max(stiffness, max(self.law.K_N, self.law.K_T) * area)
        return ROUNDING * stiffness * float(np.sqrt(self.b.getSize()))

    def begin(self, loads: PETSc.Vec, prescribed: Array, slip: Array, old: PETSc.Vec | None = None) -> None:
        """Set the step.

        Args:
            loads: nodal forces.
            prescribed: values at held displacements.
            slip: (n, d - 1) slip at its beginning.
            old: displacements at its beginning; None: zero.
        """
        self.slip = slip
        self.prescribed.set(0.0)
        self.prescribed.array[self.held] = prescribed
        self.K.mult(self.prescribed, self.b)
        self.b.aypx(-1.0, loads)
        self.b.array[self.held] = self.diagonal * prescribed
        loads.copy(self.loads)
        self.loads.array[self.held] = 0.0
        farthest = self.comm.allreduce(float(np.abs(prescribed).max(initial=0.0)), max)
        self.largest = float(self.b.norm())
        if old is not None:
            farthest = max(farthest, FORGOTTEN * float(old.norm(PETSc.NormType.INFINITY)))
            self.K.mult(old, self._forces)
            self.largest = max(self.largest, float(self._forces.norm()))
        self.least = max(float(self.loads.norm()), self._rounding * farthest, 1e-300)

    def residual(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """A u + contact forces - b in out, zero at held displacements, and its norm over the size of the forces.

        That is the largest of the loads, of the internal forces at free displacements, and of what rounding leaves of them
        where stiff bodies move far. Nothing in it is linearised: it is the residual of the law itself.
        """
        self.A.mult(u, out)
        out.axpy(-1.0, self.b)
        out.array[self.held] = 0.0
        self.loads.copy(self._forces)
        self._forces.axpy(1.0, out)
        internal = float(self._forces.norm())
        far = self._rounding * float(u.norm(PETSc.NormType.INFINITY))
        scale = max(internal, self.least, min(far, max(LOOSEST * self.least, 100 * internal)))
        self.nodes.add_forces(self.law.traction(self.nodes.jump(u), self.slip), out)
        out.array[self.held] = 0.0
        norm = float(out.norm())
        if norm > NEAR * self.largest:  # a body that has gone away has large forces, of rounding alone
            scale = min(scale, max(self.largest, 1e-300))
        return norm / scale

    def destroy(self) -> None:
        """Free the matrices."""
        for name in ("A", "b", "prescribed", "loads", "_forces"):
            if name in vars(self):
                getattr(self, name).destroy()
