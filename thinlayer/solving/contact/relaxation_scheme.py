"""The paper's relaxation over all displacements, on a contact problem."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array, InputError
from geometry.topology import BoolArray, Indices
from thinlayer.errors import SolveError
from thinlayer.solving.balance import ALLOWED
from thinlayer.solving.contact.gauss_seidel import relax
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.petsc import PREFIX

SLOW = 1e5  # largest residual, relative to the tolerance of the increments: slow convergence has small increments
FIXED = 1e20  # diagonal entry of held components of contact nodes, relative to the mean stiffness
ALIGNED = 1e-9  # largest difference of the axes of S from coordinate axes
OPTIONS = {  # name -> default and bound
    "omega": (1.7, 2),
    "omega_contact": (1.0, 2),
    "tolerance": (1e-12, 1e-3),
    "max_sweeps": (200_000, np.inf),
}


class ContactRelaxation:
    """Over-relaxed Gauss-Seidel over all displacements, as in section 8 of the paper; on one rank.

    At contact nodes the unknowns are the jumps in the axes of S instead of the upper side's displacements.

    PETSc options thinlayer_relaxation_NAME: omega (1.7), omega_contact (1), tolerance of the increments (1e-12), max_sweeps
    (200000).
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem, nodes = problem, problem.nodes
        self._held_jumps = _held_components(nodes.frames, nodes.held)
        if (nodes.held_upper & ~nodes.held).any():
            raise InputError("method='relaxation' needs supports on both sides of S or on the lower; use 'condensed'")
        self._moving = np.flatnonzero(~self._held_jumps.all(axis=1))
        self._lower = None if nodes.lower is None else nodes.pairs[:, 1:] * nodes.dim + np.arange(nodes.dim)
        self._held = np.zeros(problem.b.getLocalSize(), bool)
        self._held[problem.held] = True
        self._held[nodes.dofs] = self._held_jumps
        self._T = self._change()
        indptr, indices, values = problem.K.getValuesCSR()
        self._A = self._T.T @ scipy.sparse.csr_matrix((values, indices, indptr)) @ self._T
        self._u, self._r = problem.b.duplicate(), problem.b.duplicate()

    def _order(self) -> Indices:
        """Unknowns in the order of the nodes' places, along x first: convergence depends on the order of sweeps."""
        nodes = self.problem.nodes
        d, x = nodes.dim, nodes.surface.V.tabulate_dof_coordinates()
        close = 1e-9 * self.problem.equations.model.joint.size
        rows = np.lexsort(np.rint(x[:, :d] / close).T)
        return (rows[:, None] * d + np.arange(d)).ravel().astype(np.int32)

    def _change(self) -> scipy.sparse.csr_matrix:
        """Matrix from the unknowns (jumps and other displacements) to all displacements."""
        nodes, n = self.problem.nodes, self.problem.b.getLocalSize()
        upper, others = nodes.dofs, np.setdiff1d(np.arange(n), nodes.dofs)
        rows = [others, np.repeat(upper, nodes.dim, axis=1).ravel()]
        columns = [others, np.tile(upper, nodes.dim).ravel()]
        values = [np.ones(len(others)), nodes.frames.transpose(0, 2, 1).ravel()]
        if self._lower is not None:
            rows, columns = [*rows, upper.ravel()], [*columns, self._lower.ravel()]
            values.append(np.ones(upper.size))
        places = np.concatenate(rows), np.concatenate(columns)
        return scipy.sparse.csr_matrix((np.concatenate(values), places), shape=(n, n))

    def solve(self, start: Array | None) -> tuple[PETSc.Vec, int, list[float]]:
        """Displacements, number of sweeps, residual relative to the forces; `start` is not used.

        Raises:
            SolveError: no convergence; its residuals are the increments of the sweeps.
        """
        problem, nodes, moving = self.problem, self.problem.nodes, self._moving
        chosen = _options()
        prescribed, known = problem.prescribed.array_r, np.zeros(len(self._held))
        known[problem.held] = prescribed[problem.held]
        below = 0.0 if self._lower is None else prescribed[self._lower]
        jumps = np.einsum("nij,nj->ni", nodes.frames, prescribed[nodes.dofs] - below)
        known[nodes.dofs] = np.where(self._held_jumps, jumps, 0.0)
        diagonal = np.where(self._held, problem.diagonal, 0.0)
        diagonal[nodes.dofs[moving][self._held_jumps[moving]]] *= FIXED
        b = self._T.T @ (problem.loads.array_r + problem.pull.array_r) - self._A @ known
        b = np.where(self._held, diagonal * known, b)
        free = scipy.sparse.diags((~self._held).astype(float))
        found = relax(
            (free @ self._A @ free + scipy.sparse.diags(diagonal)).tocsr(), b, nodes.dofs[moving], nodes.weights[moving],
            problem.law, slip=problem.slip[moving], order=self._order(), **chosen,
        )  # fmt: skip
        self._u.array[:] = self._T @ found.u
        self._u.array[problem.held] = prescribed[problem.held]
        residual, sweeps = problem.residual(self._u, self._r), len(found.increments)
        if not (found.converged and residual <= max(ALLOWED, min(SLOW * chosen["tolerance"], 1e-2))):
            raise SolveError(
                f"the relaxation does not converge: after {sweeps} sweeps the increment is {found.increments[-1]:.1e} and "
                f"the residual {residual:.1e} of the forces",
                residuals=tuple(map(float, found.increments)),
                advice=f"try -{PREFIX}relaxation_omega nearer to 1, -{PREFIX}relaxation_omega_contact 1, another solver, "
                "or smaller loads",
            )
        return self._u, sweeps, [residual]

    def close(self) -> None:
        """Free the vectors."""
        self._u.destroy()
        self._r.destroy()


def _options() -> dict[str, Any]:
    """The options of the relaxation in PETSc's database. InputError: a value is out of range."""
    options, chosen = PETSc.Options(PREFIX + "relaxation_"), dict[str, Any]()
    for name, (default, bound) in OPTIONS.items():
        chosen[name] = (options.getInt if isinstance(default, int) else options.getReal)(name, default)
        if not 0 < chosen[name] < bound:
            raise InputError(f"-{PREFIX}relaxation_{name} is {chosen[name]:g}; allowed: > 0 and < {bound:g}")
    return chosen


def _held_components(frames: Array, held: BoolArray) -> BoolArray:
    """Held components (n, d) of jumps in the axes of S."""
    along = np.abs(frames)
    aligned = (np.abs(along - np.rint(along)) < ALIGNED).all(axis=(1, 2))
    if (~aligned & held.any(axis=1) & ~held.all(axis=1)).any():
        raise InputError("method='relaxation' needs supports along the axes of S at its nodes; use 'condensed'")
    return np.asarray(np.einsum("nij,nj->ni", along > 0.5, held) > 0)
