"""Common base of all solvers under contact laws."""

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
    """Base of the solvers of time steps with linear bodies in contact. Collective.

    A method solves A u + (nodal forces of the contact laws) = b, where A and b contain the Dirichlet conditions.

    Args:
        equations: the equations of the model.
        like: a state of a model of the same joint, from which the first step begins; None: the state before the step.

    Attributes:
        equations, comm: the equations and their communicator.
        parts: the contact laws with their pairs of nodes.
        is_fixed: (N,) mask of the constrained displacements of this rank.
        x: displacements: initial values of a step, then its solution.
        b: the right-hand side.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        self.equations, self.comm, self._like = equations, equations.comm, like
        self.parts = equations.of_kind(ContactPart)
        self.x, self.b, self._r = (equations.vector() for _ in range(3))
        self.is_fixed = np.zeros(self.x.getLocalSize(), bool)
        self.is_fixed[equations.bc_dofs] = True
        self._has_solved = False

    @cached_property
    def A(self) -> PETSc.Mat:
        """The bodies' stiffness with Dirichlet conditions."""
        A = self.equations.K.copy()
        A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.equations.apply_bcs(A)
        A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return A

    def solve_step(self, start: PETSc.Vec | None = None) -> StepSolution:
        """Solve for the displacements at the end of the step.

        Args:
            start: initial unknowns; None: those of the state `like` in the first step, else of the old state.

        Raises:
            SolveError: no convergence.
        """
        equations, x = self.equations, self.x
        self.reused = self._has_solved
        if start is not None:
            start.copy(x)
        elif self._like is not None:
            u = displacements_of(self._like, equations.model)  # must live as long as its vector
            u.x.petsc_vec.copy(x)
        else:
            equations.put_state(equations.interval.old, x)
        has_guess = self.comm.allreduce(int(any(part.nodes.jump(x).any() for part in self.parts))) > 0
        prescribed_u = equations.vector()
        prescribed_u.array[equations.bc_dofs] = x.array[equations.bc_dofs] = equations.prescribed
        equations.K.mult(prescribed_u, self.b)
        prescribed_u.destroy()
        self.b.aypx(-1.0, equations.external)
        self.b.array[equations.bc_dofs] = (equations.mean_stiffness or 1.0) * equations.prescribed
        self._like, self._has_solved = None, True
        return StepSolution(x, *self.solve(has_guess))

    @abstractmethod
    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for x in place; return the number of steps, and the residual relative to the reference forces.

        The initial values in x have the prescribed displacements. What a step is depends on the method.

        Args:
            has_guess: whether the jumps of x are an initial guess; otherwise they are zero.
        """

    def relative_residual(self) -> float:
        """Norm of the residual of the whole problem at x, relative to the reference forces."""
        self.equations.residual(self.x, self._r)
        return self.equations.relative(self._r)

    def close(self) -> None:
        """Free matrices and vectors."""
        destroy(self.x, self.b, self._r, vars(self).get("A"))
