"""Contact condensed to S: one factorisation, then Newton's method with Gauss-Seidel sweeps on a small dense system."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from forms.contact import ContactLaw
from thinlayer.discretisation.contact_nodes import Array
from thinlayer.errors import ModelError, SolveError
from thinlayer.solving.balance import TINY
from thinlayer.solving.contact.dense import STALLED, DenseSystem, Load
from thinlayer.solving.contact.orders import chains_of, oblique_order
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.contact.schur import FactorError, SchurFactor
from thinlayer.solving.contact.side_displacements import SideDisplacements

TOLERANCE = 1e-11  # residual at which Newton's method stops, relative to the forces
RAMP = (0.1, 0.3, 0.6, 1.0)  # factors of stiffness and friction in the last attempt, solve after solve


class Condensed:
    """Solves contact problems, one load after the other, by Newton's method for the jumps on S. Serial.

    A Cholesky factorisation condenses the bodies to their displacements at S, and these are condensed to the jumps. The
    matrix of the jumps is dense, so the method suits two dimensions and narrow S. Newton's method (SNES, with the
    unsymmetric tangent of friction) starts from a prediction, or from the solution on a chain with half as many nodes,
    found in the same way. Gauss-Seidel sweeps, node by node, precede each of its steps. The factor is kept until `close`.

    Args:
        problem: the contact problem; its matrix is read at the first `solve`, its loads and slip at every `solve`.

    Raises:
        ModelError: several ranks, or no free displacement on S.
    """

    def __init__(self, problem: ContactProblem) -> None:
        if problem.comm.size > 1:
            raise ModelError("method='condensed' runs on one rank; use 'multigrid'")
        self.problem, self.law = problem, problem.law
        self._u, self._r = problem.b.duplicate(), problem.b.duplicate()
        self._sides = SideDisplacements(problem)
        if not len(self._sides.dofs):
            raise ModelError("supports hold every displacement on S: nothing is left for contact")

    @cached_property
    def _factor(self) -> SchurFactor:
        problem, dofs = self.problem, self._sides.dofs
        diagonal = problem.A.getDiagonal()
        springs = diagonal.array_r[dofs] / len(problem.nodes.upper)
        diagonal.destroy()
        return SchurFactor(problem.rows, problem.nodes.dim, dofs, springs, oblique_order(problem))

    @cached_property
    def _system(self) -> DenseSystem:
        nodes, moving = self.problem.nodes, self._sides.moving
        H = self._sides.to_jumps(self._factor.complement)
        return DenseSystem(
            H, nodes.weights[moving], nodes.frames[moving], nodes.held[moving], chains_of(self.problem, moving)
        )

    def solve(self, start: Array | None) -> tuple[PETSc.Vec, int, list[float]]:
        """Equilibrium under the problem's loads.

        Args:
            start: (n, d) jumps to start from, in the nodes' frames, a length; None: no prediction.

        Returns:
            Displacements, valid until the next `solve` or `close`; number of Newton steps; residuals relative to the
            forces: of the condensed problem before each step and after the last, then of the whole problem.

        Raises:
            SolveError: no convergence, for instance without an equilibrium; the error has the residuals.
        """
        problem, sides, history = self.problem, self._sides, list[float]()
        b = problem.b.array_r
        try:
            system = self._system
            condensed = self._factor.condense(b)
            sides.take(condensed)
            w, steps = self._find(system, start, history)
        except (FactorError, np.linalg.LinAlgError) as error:
            raise SolveError(f"contact: {error}; is every body supported, or does it meet S?") from error
        self._u.array[:] = self._factor.expand(b, condensed, sides.displacements(w))
        history.append(problem.residual(self._u, self._r))
        if not history[-1] <= STALLED:
            raise self._failure(history)
        return self._u, steps, history

    def _find(self, system: DenseSystem, start: Array | None, history: list[float]) -> tuple[Array, int]:
        """Jumps of the moving nodes in global axes, and the number of Newton steps."""
        sides, problem = self._sides, self.problem
        load = Load(
            sides.forces(system.H),
            problem.slip[sides.moving],
            sides.held_jumps,
            max(problem.equations.scale.least, float(problem.loads.norm()), TINY),
        )
        steps = 0
        for law, w, few in self._trials(system, load, start):
            steps += system.newton(law, load, w, TOLERANCE, history, few=few)
            if system.converged and law is self.law:
                return w, steps
        raise self._failure(history)

    def _trials(self, system: DenseSystem, load: Load, start: Array | None) -> Iterator[tuple[ContactLaw, Array, bool]]:
        """Trials in turn: a law, the jumps to start from (changed in place), and whether to stop after a few steps."""
        law = self.law
        if start is not None:
            w = np.einsum("nij,ni->nj", system.frames, start[self._sides.moving])
            yield law, np.where(system.held, load.held_jumps, w), True
        if system.coarse is not None:
            yield law, system.nested(law, load), False
        yield law, system.bonded(law, load), False
        if not is_dataclass(law):
            return
        names = [f.name for f in fields(law) if f.name in ("K_N", "K_T", "friction", "cohesion", "bound")]
        w = np.empty(0)
        for share in RAMP:
            softer = law if share == 1.0 else replace(law, **{name: share * getattr(law, name) for name in names})
            w = w if len(w) else system.bonded(softer, load)
            yield softer, w, False
            if not system.converged:
                return

    def _failure(self, history: list[float]) -> SolveError:
        return SolveError(
            f"contact: no equilibrium found, residual {history[-1]:.1e} of the forces after {len(history) - 1} Newton "
            "steps",
            residuals=tuple(history),
            advice="is every body supported, or pressed against S rather than pulled off it? Else try smaller load steps, "
            "or another solver",
        )

    def close(self) -> None:
        """Free the factor and vectors."""
        self._u.destroy()
        self._r.destroy()
        for name, free in (("_factor", SchurFactor.close), ("_system", DenseSystem.destroy)):
            if (thing := vars(self).pop(name, None)) is not None:
                free(thing)
