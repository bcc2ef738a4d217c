"""Common base of the solvers "condensed", "multigrid" and "relaxation" under contact laws."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from thinlayer.discretisation.state import State, displacements_of
from thinlayer.parts.contact_part import ContactPart
from thinlayer.solving.equations import Equations
from thinlayer.solving.newton import EquilibriumSolver, StepSolution
from thinlayer.system.ranks import destroy


class ContactSolver(EquilibriumSolver):
    """Base of the solvers of time steps for linear bodies in contact. Collective.

    Subclasses solve A u + f(u) = b for the displacements u. A is the stiffness of the bodies, f the nodal forces of the
    contact laws, and b the loads. A and b contain the Dirichlet conditions.

    Args:
        equations: the balance of forces of the model.
        like: a state of a model of the same joint, whose displacements are the initial guess in the first step. None:
            the guess is the state before the step.

    Attributes:
        equations, comm: the balance of forces and its communicator.
        parts: the contact laws with their pairs of nodes, one part for each seam in contact.
        is_fixed: (N,) mask of the constrained displacements among the N that this rank owns.
        x: vector of displacements: the initial guess of a step, then its solution.
        b: vector of the right-hand side.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        self.equations, self.comm, self._like = equations, equations.comm, like
        self.parts = equations.of_kind(ContactPart)
        self.x, self.b, self._r = (equations.create_vector() for _ in range(3))
        self.is_fixed = np.zeros(self.x.getLocalSize(), bool)
        self.is_fixed[equations.bc_dofs] = True
        self._has_solved = False

    @cached_property
    def A(self) -> PETSc.Mat:
        """Stiffness matrix of the bodies with Dirichlet conditions."""
        A = self.equations.K.copy()
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.equations.apply_bcs(A)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return A

    def solve_step(self, start: PETSc.Vec | None = None) -> StepSolution:
        """Solve for the displacements at the end of the time step.

        Args:
            start: initial guess of the displacements. None: those before the step, or in the first step those of the
                state `like` that the constructor was given.

        Raises:
            SolveError: no convergence.
        """
        equations, x = self.equations, self.x
        self.reused_solver = self._has_solved
        if start is not None:
            start.copy(x)
        elif self._like is not None:
            u = displacements_of(self._like, equations.model)  # must live as long as its vector
            u.x.petsc_vec.copy(x)
        else:
            equations.put_state(equations.interval.old, x)
        has_guess = self.comm.allreduce(int(any(part.nodes.jump(x).any() for part in self.parts))) > 0
        prescribed_u = equations.create_vector()
        prescribed_u.array[equations.bc_dofs] = x.array[equations.bc_dofs] = equations.prescribed
        equations.K.mult(prescribed_u, self.b)
        prescribed_u.destroy()
        self.b.aypx(-1.0, equations.external)
        self.b.array[equations.bc_dofs] = (equations.mean_stiffness or 1.0) * equations.prescribed
        self._like, self._has_solved = None, True
        return StepSolution(x, *self.solve(has_guess))

    @abstractmethod
    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for the displacements in the attribute `x`, in place, starting from its values.

        These initial values already have the prescribed displacements at constrained dofs.

        Args:
            has_guess: whether some jump of the initial values is not zero, on any rank. A solver may then start from
                these jumps.

        Returns:
            Number of iterations, and norm of the residual relative to the reference forces. Iterations are Newton steps
                or, in a relaxation, sweeps.
        """

    def relative_residual(self) -> float:
        """Return the norm of the residual at the displacements in the attribute `x`, relative to the reference forces.

        It is the residual of the full balance of forces, not of a condensed one.
        """
        self.equations.residual(self.x, self._r)
        return self.equations.relative_norm(self._r)

    def close(self) -> None:
        """Free matrices and vectors."""
        destroy(self.x, self.b, self._r, vars(self).get("A"))
