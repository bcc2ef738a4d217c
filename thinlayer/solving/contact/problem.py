"""The contact problem of a time step for solvers with sweeps: linear bodies, and a contact law at the nodes of S."""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

from thinlayer.parts.contact_part import ContactPart
from thinlayer.solving.balance import AIM, TINY
from thinlayer.solving.equations import Equations

LARGE = 3e-5  # residual, relative to `largest`, above which the rounding of a body far away is no force


class ContactProblem:
    """Find u with A u + (nodal forces of law.traction(jump(u), slip)) = b, for the step that equations have begun.

    Where there are initial gaps, u are the displacements from contact: those of the model, and the gaps at the nodes of the
    upper side (`lift`). So schemes need not know of gaps. All methods are collective.

    Attributes:
        equations: the balance of forces of a model with linear bodies and a contact law.
        A: stiffness of the bodies, symmetric; rows and columns of held displacements are zero but for the diagonal. It is
            singular if only S resists a motion of a body.
        nodes: the nodes of S.
        law: the contact law.
        near: the rigid motions, as near null space for multigrid.
        loads: nodal forces of loads and given strains; zero at held displacements.
        pull: nodal forces that the gaps would cause as displacements; zero at held displacements.
        prescribed: prescribed values at held displacements; zero at the others.
        b: loads less the forces of prescribed displacements; at held displacements the diagonal times the prescribed value.
        slip: (n, d - 1) slip at the beginning of the step.
        held: local numbers of the held displacements of this rank.
        largest: the larger norm of b and of the bodies' forces before the step.
    """

    def __init__(self, equations: Equations) -> None:
        (part,) = equations.of_kind(ContactPart)
        self.equations, self.comm = equations, equations.comm
        self.K, self.held, self.nodes, self.law = equations.K, equations.held, part.nodes, part.law
        self.near = PETSc.NullSpace().create(vectors=equations.near_null(), comm=self.comm)
        self.b, self.prescribed, self.loads, self._forces = (self.K.createVecLeft() for _ in range(4))
        self.slip, self._key = part.rest(), part.key
        self.lift, self.pull, self._displacements = (self.K.createVecLeft() for _ in range(3))
        self.lift.array[self.nodes.dofs.ravel()] = (self.nodes.frames[:, -1] * self.nodes.gap[:, None]).ravel()
        self.K.mult(self.lift, self.pull)
        self.pull.array[self.held] = 0.0

    @cached_property
    def diagonal(self) -> float:
        """Mean diagonal entry of the stiffness: the diagonal entry of held displacements."""
        d = self.K.getDiagonal()
        mean = float(d.sum() / d.getSize())
        d.destroy()
        return mean

    @cached_property
    def A(self) -> PETSc.Mat:
        """The stiffness with supports."""
        A = self.K.copy()
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        A.zeroRowsColumns(self.equations.held_rows, self.diagonal)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        A.setBlockSize(self.nodes.dim)
        A.setNearNullSpace(self.near)
        return A

    def begin(self) -> None:
        """Take over the step that the equations have begun."""
        equations, old = self.equations, self.equations.interval.old
        self.slip = old.memory[self._key]
        self.prescribed.set(0.0)
        self.prescribed.array[self.held] = equations.prescribed + self.lift.array_r[self.held]
        self.K.mult(self.prescribed, self.b)
        self.b.aypx(-1.0, equations.external)
        self.b.axpy(1.0, self.pull)
        self.b.array[self.held] = self.diagonal * self.prescribed.array_r[self.held]
        equations.external.copy(self.loads)
        self.loads.array[self.held] = 0.0
        self.K.mult(old.u.x.petsc_vec, self._forces)
        self.largest = max(float(self.b.norm()), float(self._forces.norm()))

    def displacements(self, u: PETSc.Vec) -> PETSc.Vec:
        """The displacements of the model, for those from contact; valid until the next call."""
        u.copy(self._displacements)
        self._displacements.axpy(-1.0, self.lift)
        return self._displacements

    def residual(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """Write A u + contact forces - b, zero at held displacements; returns its norm relative to the forces.

        It is the residual of the law itself, not a linearised one. The norm is scaled so that AIM is the residual at which
        `ForceScale` lets solvers stop.
        """
        scale = self.equations.scale
        self.A.mult(u, out)
        out.axpy(-1.0, self.b)
        out.array[self.held] = 0.0
        self.loads.copy(self._forces)
        self._forces.axpy(1.0, out)
        scale.see(float(self._forces.norm()), float(self.loads.norm()))
        self.nodes.add_forces(self.law.traction(self.nodes.jump(u), self.slip), out)
        out.array[self.held] = 0.0
        norm = float(out.norm())
        forces = max(scale.aim(float(u.norm(PETSc.NormType.INFINITY))) / AIM, TINY)
        if norm > LARGE * self.largest:  # the large forces of a body far away are only rounding
            forces = min(forces, max(self.largest, TINY))
        return norm / forces

    def destroy(self) -> None:
        """Free the matrices."""
        for name in ("A", "b", "prescribed", "loads", "lift", "pull", "_forces", "_displacements"):
            if name in vars(self):
                getattr(self, name).destroy()
