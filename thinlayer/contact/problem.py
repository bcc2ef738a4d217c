"""The discrete contact problem of a time step: linear bodies, and a contact law at the nodes of S."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.contact import ContactLaw
from thinlayer.contact.nodes import Array, ContactNodes

ROUNDING = 1e-5  # times 1e-10, what is demanded: stiffness times displacement is rounded to 1e-15


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

    def begin(self, loads: PETSc.Vec, prescribed: Array, slip: Array) -> None:
        """Set the step: nodal forces of the loads, values at held displacements, slip at its beginning."""
        self.slip = slip
        self.prescribed.set(0.0)
        self.prescribed.array[self.held] = prescribed
        self.K.mult(self.prescribed, self.b)
        self.b.aypx(-1.0, loads)
        self.b.array[self.held] = self.diagonal * prescribed
        loads.copy(self.loads)
        self.loads.array[self.held] = 0.0
        farthest = self.comm.allreduce(float(np.abs(prescribed).max(initial=0.0)), max)
        rounding = ROUNDING * self.diagonal * np.sqrt(self.b.getSize()) * farthest
        self.least = max(float(self.loads.norm()), rounding, 1e-300)

    def residual(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """A u + contact forces - b in out, zero at held displacements, and its norm over the size of the forces.

        That is the largest of the loads, of the internal forces at free displacements, and of what rounding leaves of them
        where supports move stiff bodies. Nothing in it is linearised: it is the residual of the law itself.
        """
        self.A.mult(u, out)
        out.axpy(-1.0, self.b)
        out.array[self.held] = 0.0
        self.loads.copy(self._forces)
        self._forces.axpy(1.0, out)
        scale = max(float(self._forces.norm()), self.least)
        self.nodes.add_forces(self.law.traction(self.nodes.jump(u), self.slip), out)
        out.array[self.held] = 0.0
        return float(out.norm()) / scale

    def destroy(self) -> None:
        """Free the matrices."""
        for name in ("A", "b", "prescribed", "loads", "_forces"):
            if name in vars(self):
                getattr(self, name).destroy()
