"""Contact in networks, condensed: Newton's method with Gauss-Seidel sweeps for the displacements of nodes in contact.

Jumps are no unknowns here: around a junction they depend on each other, and so their condensed stiffness is singular.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array
from thinlayer.discretisation.state import State, displacements_of
from thinlayer.errors import SolveError
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.part import DISPLACEMENTS, Block
from thinlayer.solving.balance import ALLOWED, TINY, ForceScale, TangentMatrix
from thinlayer.solving.contact.gauss_seidel import sorted_blocks
from thinlayer.solving.contact.pair_nodes import PairNodes
from thinlayer.solving.contact.schur import Condensation, FactorError, in_petsc
from thinlayer.solving.equations import Equations
from thinlayer.solving.equilibrium import Finder, Found
from thinlayer.solving.linear_solvers import DIRECT, Factor
from thinlayer.solving.petsc import chosen, solve_linear

TOLERANCE = 1e-11  # residual at which Newton's method stops, relative to the forces
STALLED = 1e-9  # residual, relative to the forces, that is accepted if Newton steps do not reduce it
SUMMATION = 10.0  # rounding of the condensed stiffness, relative to that of its largest entry, per sqrt(node)
SWEEPS = 2  # number of sweeps before each of the first Newton steps
PATIENCE = 4  # number of Newton steps after which the sweeps double with every step
MOST_SWEEPS = 32  # largest number of sweeps before a Newton step
MOST_STEPS = 30
TRIALS = 12  # largest number of trials of a step's length
FLAT = 0.1  # work along a step at its end, relative to that at its beginning, that ends the search of its length


class NetworkFinder(Finder):
    """Steps of a contact model with linear bodies, any number of which meet: a `Finder`. On one rank.

    The bodies are condensed to the displacements of all nodes in contact, body by body, once. Newton's method then solves
    the small sparse system. Gauss-Seidel sweeps, node by node with all pairs of a node, precede each of its steps, more of
    them as steps go on. The length of a step is at most 1, and such that the forces do no more work along it.

    PETSc options under our prefix: those of the linear solves; with "inner_" before their names, of the bodies' factor.

    Args:
        equations: the equations of the model.
        like: a state of a model of the same joint, from which the first step begins; None: that before the step.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        self.equations, self._like = equations, like
        self._x, self._r = equations.vector(), equations.vector()
        held = np.zeros(self._x.getLocalSize(), bool)
        held[equations.held] = True
        self.pairs = PairNodes(equations.of_kind(ContactPart), held)
        dofs = (self.pairs.nodes[:, None] * self.pairs.d + np.arange(self.pairs.d)).ravel()
        inner = np.setdiff1d(np.flatnonzero(~held), dofs)
        self._free = self.pairs.free.ravel()
        self._dofs, self._kept, self._inner = dofs, dofs[self._free], inner

    @cached_property
    def _K(self) -> scipy.sparse.csr_matrix:
        indptr, indices, values = self.equations.K.getValuesCSR()
        return scipy.sparse.csr_matrix((values, indices, indptr))

    @cached_property
    def condensation(self) -> Condensation:
        """The bodies, condensed to the free displacements of nodes in contact."""
        return Condensation(self._K, self._kept, self._inner)

    @cached_property
    def _system(self) -> _System:
        """With a row for each displacement of nodes in contact; held ones are decoupled."""
        free, stiffness = np.flatnonzero(self._free), self.condensation.stiffness.tocoo()
        rows, columns = free[stiffness.row], free[stiffness.col]
        size = len(self._free)
        rest = np.flatnonzero(~self._free)
        fixed = np.full(len(rest), stiffness.data.max(initial=1.0))
        entries = np.concatenate([stiffness.data, fixed])
        places = np.concatenate([rows, rest]), np.concatenate([columns, rest])
        return _System(self.pairs, scipy.sparse.csr_matrix((entries, places), shape=(size, size)))

    def find(self, start: PETSc.Vec | None = None) -> Found:
        """Displacements at the end of the step, from those of `start` or from those before the step.

        Raises:
            SolveError: no convergence.
        """
        equations, x = self.equations, self._x
        self.reused = "_system" in vars(self)
        try:
            system, condensation = self._system, self.condensation
        except FactorError as error:
            held = "is every body supported, or does it meet S in more than a point?"
            raise SolveError(f"contact: {error}; {held}") from error
        if start is None:
            equations.put_state(equations.interval.old, x)
        else:
            start.copy(x)
        if start is None and self._like is not None:
            similar = displacements_of(self._like, equations.model)  # owns the vector
            similar.x.petsc_vec.copy(x)
        self._like = None
        known = bool(x.array_r[self._dofs].any())
        x.array[equations.held] = equations.prescribed
        u = x.array_r[self._dofs].copy()
        b = equations.external.array_r - self._K[:, equations.held] @ equations.prescribed
        g = np.where(self._free, 0.0, system.stiffness.diagonal() * u)
        g[self._free] = condensation.condense(b)
        size = max(equations.scale.least, equations.free_norm(equations.external), TINY)
        u, residuals = system.solve(u if known else system.bonded(g), g, size)
        condensation.expand(b, u[self._free], x.array)
        equations.residual(x, self._r)
        relative = equations.scale.relative(equations.free_norm(self._r))
        if not relative <= ALLOWED:
            large = f"contact: the residual of the whole problem is {relative:.1e} of the forces"
            raise SolveError(large, residuals=residuals)
        return Found(x, len(residuals) - 1, relative)

    def close(self) -> None:
        """Free the factor and vectors."""
        for vector in (self._x, self._r):
            vector.destroy()
        for name in ("condensation", "_system"):
            if name in vars(self):
                getattr(self, name).close()


class _System:
    """stiffness u + forces of the pairs = g, for displacements u (n d,) of the nodes in contact."""

    def __init__(self, pairs: PairNodes, stiffness: scipy.sparse.csr_matrix) -> None:
        self.pairs, self.stiffness, self._blocks = pairs, stiffness, sorted_blocks(stiffness, pairs.d)
        self._factor, self._matrix = Factor(), TangentMatrix(PETSc.COMM_SELF, {DISPLACEMENTS: stiffness.shape[0]})
        # with all entries that pairs may add, so that MUMPS orders the unknowns once
        self._matrix.fill([Block(in_petsc(one)) for one in (stiffness, pairs.pattern)])
        largest = max(float(one.diagonal().max(initial=0.0)) for one in (stiffness, pairs.bonded()[0]))
        self._scale = ForceScale(SUMMATION * math.sqrt(len(pairs.nodes)) * largest)

    def residual(self, u: Array, g: Array) -> Array:
        """Forces of bodies and pairs, less g; zero at held displacements."""
        return np.asarray(self.stiffness @ u + self.pairs.forces(u) - g)

    def bonded(self, g: Array) -> Array:
        """Displacements with bonded springs, which neither open nor slide."""
        springs, forces = self.pairs.bonded()
        return self._linear_solve(springs, g - forces)

    def _linear_solve(self, more: scipy.sparse.csr_matrix, b: Array) -> Array:
        """x with (stiffness + more) x = b; not finite if the matrix is singular."""
        A = self._matrix.fill([Block(in_petsc(one)) for one in (self.stiffness, more)])
        x, right = A.createVecs()
        right.array[:] = b
        with chosen({**DIRECT, "pc_type": "lu"}):
            self._factor.renew(A, None, lambda *_: None)
            solve_linear(self._factor.ksp, right, x)
        found = x.array_r.copy() if self._factor.ksp.getConvergedReason() > 0 else np.full(len(b), np.nan)
        x.destroy()
        right.destroy()
        return found

    def solve(self, u: Array, g: Array, size: float) -> tuple[Array, tuple[float, ...]]:
        """Displacements, from u, and the residuals before each Newton step and after the last, relative to the forces.

        Raises:
            SolveError: no convergence.
        """
        residuals: list[float] = []
        while True:
            r = self.residual(u, g)
            residuals.append(float(np.linalg.norm(r)) / max(size, float(np.linalg.norm(self.pairs.forces(u)))))
            if self._ends(residuals, u, size):
                return u, tuple(residuals)
            if len(residuals) > MOST_STEPS or not math.isfinite(residuals[-1]):
                raise SolveError(
                    f"contact: residual {residuals[-1]:.1e} of the forces after {len(residuals) - 1} Newton steps",
                    residuals=tuple(residuals),
                    advice="is every body supported, or pressed against S? Else try smaller load steps",
                )
            u = u.copy()
            sweeps = min(SWEEPS * 2 ** max(len(residuals) - PATIENCE, 0), MOST_SWEEPS)
            self.pairs.sweep(self._blocks, g, u, sweeps)
            step = self._linear_solve(self.pairs.tangent(u), -self.residual(u, g))
            u = u + self._length(u, step, g) * step

    def _ends(self, residuals: list[float], u: Array, size: float) -> bool:
        """Whether the residual is small enough, or as small as rounding lets it be."""
        if residuals[-1] <= TOLERANCE:
            return True
        if len(residuals) < 3 or residuals[-1] <= residuals[-2] / 2:
            return False
        share = self._scale.rounding(float(np.abs(u).max(initial=0.0))) / size
        return residuals[-1] <= max(STALLED, min(share, ALLOWED))

    def _length(self, u: Array, step: Array, g: Array) -> float:
        """Length of a step, at most 1, at which the work of the residual along it vanishes; by regula falsi."""

        def work(a: float) -> float:
            return float(step @ self.residual(u + a * step, g))

        first, last = work(0.0), work(1.0)
        if not (first < 0 and last > FLAT * abs(first)):
            return 1.0
        low, high, below, above = 0.0, 1.0, first, last
        for _ in range(TRIALS):
            a = low - below * (high - low) / (above - below)
            a = min(max(a, low + 0.1 * (high - low)), high - 0.1 * (high - low))
            now = work(a)
            if abs(now) <= FLAT * abs(first):
                break
            if now < 0:
                low, below = a, now
            else:
                high, above = a, now
        return a

    def close(self) -> None:
        """Free matrix and factor."""
        self._matrix.destroy()
        self._factor.destroy()
