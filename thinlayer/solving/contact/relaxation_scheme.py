"""The paper's relaxation over all displacements, on a contact problem."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.errors import ModelError, SolveError
from thinlayer.solving.balance import ALLOWED
from thinlayer.solving.contact.gauss_seidel import relax
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.petsc import PREFIX, OptionError

SLOW = 1e5  # largest residual, relative to the tolerance of the increments: slow convergence has small increments
FIXED = 1e20  # diagonal entry of held components of contact nodes, relative to the mean stiffness
ALIGNED = 1e-9  # largest difference of the axes of S from coordinate axes


def _options() -> dict[str, Any]:
    """The options of the relaxation in PETSc's database. OptionError: a value is out of range."""
    options = PETSc.Options(PREFIX + "relaxation_")
    chosen: dict[str, Any] = {
        "omega": options.getReal("omega", 1.7),
        "omega_contact": options.getReal("omega_contact", 1.0),
        "tolerance": options.getReal("tolerance", 1e-12),
        "max_sweeps": options.getInt("max_sweeps", 200_000),
        "fixed_point": options.getBool("fixed_point", False),
    }
    ranges = {"omega": (0, 2), "omega_contact": (0, 2), "tolerance": (0, 1e-3), "max_sweeps": (0, np.inf)}
    for name, (low, high) in ranges.items():
        if not low < chosen[name] < high:
            raise OptionError(f"-{PREFIX}relaxation_{name} is {chosen[name]:g}; allowed: > {low} and < {high:g}")
    return chosen


class ContactRelaxation:
    """Over-relaxed Gauss-Seidel over all displacements, as in section 8 of the paper; on one rank.

    At contact nodes the unknowns are the jumps in the axes of S instead of the upper side's displacements.

    PETSc options thinlayer_relaxation_NAME: omega (1.7), omega_contact (1), tolerance of the increments (1e-12), max_sweeps
    (200000), fixed_point (false: thresholds follow the pressure within the sweeps; true: the paper's outer fixed point).
    """

    def __init__(self, problem: ContactProblem) -> None:
        if problem.comm.size > 1:
            raise ModelError("method='relaxation' runs on one rank; use 'multigrid'")
        self.problem, nodes = problem, problem.nodes
        self._lower = self._lower_dofs()
        held = np.zeros(problem.b.getLocalSize(), bool)
        held[problem.held] = True
        self._held_jumps = self._components(nodes.held)
        self._moving = np.flatnonzero(~self._held_jumps.all(axis=1))
        if (nodes.held_upper & ~nodes.held).any():
            raise ModelError(
                "method='relaxation' needs supports on both sides of S or on the lower one; use 'condensed'"
            )
        self.T = self._change()
        self.A = problem.K.ptap(self.T)
        slots = nodes.dofs
        held[slots] = self._held_jumps
        self._held = np.flatnonzero(held).astype(PETSc.IntType)
        self._order = self._row_by_row()
        self._u = problem.b.duplicate()

    def _row_by_row(self) -> npt.NDArray[np.int32]:
        """Unknowns in the order of the nodes' places, along x first: convergence depends on the order of sweeps."""
        nodes = self.problem.nodes
        d, x = nodes.dim, nodes.surface.V.tabulate_dof_coordinates()
        close = 1e-9 * self.problem.equations.model.joint.size
        rows = np.lexsort(np.rint(x[:, :d] / close).T)
        return (rows[:, None] * d + np.arange(d)).ravel().astype(np.int32)

    def _lower_dofs(self) -> npt.NDArray[np.int64] | None:
        """Numbers of the displacements of the lower side, (n, d); None on a rigid base."""
        nodes = self.problem.nodes
        return None if nodes.lower is None else nodes.lower.getValuesCSR()[1].reshape(-1, nodes.dim)

    def _components(self, held: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Held components of jumps in the axes of S, (n, d)."""
        along = np.abs(self.problem.nodes.frames)
        aligned = (np.abs(along - np.rint(along)) < ALIGNED).all(axis=(1, 2))
        if (~aligned & held.any(axis=1) & ~held.all(axis=1)).any():
            raise ModelError("method='relaxation' needs supports along the axes of S at its nodes; use 'condensed'")
        return np.asarray(np.einsum("nij,nj->ni", along > 0.5, held) > 0)

    def _change(self) -> PETSc.Mat:
        """Matrix from the unknowns (jumps and other displacements) to all displacements."""
        nodes, n = self.problem.nodes, self.problem.b.getLocalSize()
        d, slots = nodes.dim, nodes.dofs
        T = PETSc.Mat().createAIJ((n, n), nnz=2 * d, comm=self.problem.comm)
        others = np.setdiff1d(np.arange(n), slots)
        for k in others:
            T.setValue(k, k, 1.0)
        for i, rows in enumerate(slots):
            T.setValues(rows, rows, nodes.frames[i].T.copy())  # petsc4py would read a transposed view untransposed
            if self._lower is not None:
                T.setValues(rows, self._lower[i], np.eye(d))
        T.assemble()
        return T

    def solve(self, start: Array | None) -> tuple[PETSc.Vec, int, list[float]]:
        """Displacements, number of sweeps, residual relative to the forces; `start` is not used.

        Raises:
            SolveError: no convergence; its residuals are the increments of the sweeps.
        """
        problem, nodes = self.problem, self.problem.nodes
        chosen = _options()
        b, z = problem.b.duplicate(), problem.b.duplicate()
        problem.loads.copy(z)
        z.axpy(1.0, problem.pull)
        self.T.multTranspose(z, b)
        z.set(0.0)
        prescribed = problem.prescribed
        z.array[problem.held] = prescribed.array_r[problem.held]
        below = 0.0 if self._lower is None else prescribed.array_r[self._lower]
        jumps = np.einsum("nij,nj->ni", nodes.frames, prescribed.array_r[nodes.dofs] - below)
        z.array[nodes.dofs.ravel()] = np.where(self._held_jumps, jumps, 0.0).ravel()
        A = self.A.copy()
        A.zeroRowsColumns(self._held, problem.diagonal, z, b)
        at = nodes.dofs[self._moving][self._held_jumps[self._moving]]
        diagonal = A.getDiagonal()
        diagonal.array[at] *= FIXED
        A.setDiagonal(diagonal)
        b.array[at] *= FIXED
        indptr, indices, data = A.getValuesCSR()
        found = relax(
            indptr, indices, data, b.array_r.copy(), nodes.dofs[self._moving], nodes.weights[self._moving], problem.law,
            slip=problem.slip[self._moving], order=self._order, **chosen,
        )  # fmt: skip
        z.array[:] = found.u
        u = self._u
        self.T.mult(z, u)
        u.array[problem.held] = prescribed.array_r[problem.held]
        residual = problem.residual(u, b)
        for thing in (A, b, z, diagonal):
            thing.destroy()
        if not (found.converged and residual <= max(ALLOWED, min(SLOW * chosen["tolerance"], 1e-2))):
            last = found.increments[-1] if len(found.increments) else np.nan
            raise SolveError(
                f"the relaxation does not converge: after {found.sweeps} sweeps the increment is {last:.1e} and the "
                f"residual {residual:.1e} of the forces",
                residuals=tuple(map(float, found.increments)),
                advice=f"try -{PREFIX}relaxation_omega nearer to 1, -{PREFIX}relaxation_omega_contact 1, another solver, "
                "or smaller loads",
            )
        return u, found.sweeps, [residual]

    def close(self) -> None:
        """Free the matrices."""
        self._u.destroy()
        self.T.destroy()
        self.A.destroy()
