"""Contact condensed to the nodes of S: Newton's method with Gauss-Seidel sweeps for their displacements. On one rank.

The unknowns are displacements, not jumps. Around a junction jumps depend on each other, so that their condensed
stiffness is singular.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array
from geometry.topology import IntArray, along
from thinlayer.discretisation.constraints import create_aij
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.contact.condensation import Condensation
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.pairs import ContactPairs
from thinlayer.solving.equations import Equations
from thinlayer.solving.part_sum import MACHINE_EPSILON, MIN_DIVISOR, STATE_TOLERANCE
from thinlayer.system.ranks import destroy

NEWTON_TOLERANCE = 1e-11  # residual at which Newton's method stops, relative to the forces
COARSE_TOLERANCE = 1e-3  # residual at which it stops in coarser systems
MAX_COARSEST_LINES = 100  # largest number of lines between nodes of a system that is not coarsened
MAX_COARSE_RATIO = 0.75  # largest number of pairs of a coarser system, relative to all; seams of one cell keep all
STALLED_TOLERANCE = 1e-9  # residual, relative to the forces, that is accepted if Newton steps do not reduce it
SUMMATION_FACTOR = 10.0  # rounding of the condensed stiffness over rounding of its largest entry, per sqrt(node)
MIN_SWEEPS = 4  # number of sweeps before each of the first Newton steps
DOUBLING_STEPS = 6  # number of Newton steps after which the sweeps double with every step, and steps may be shortened
MAX_SWEEPS = 32  # largest number of sweeps before a Newton step
MAX_NEWTON_STEPS = 30
LONG_STEP_RATIO = 1e5  # a long step over the initial displacements, as for a body without supports
MAX_LONG_STEPS = 4  # largest number of successive long steps
MAX_LENGTH_TRIALS = 12  # largest number of trials of a line search
WORK_RATIO = 0.1  # work along a step at its end, relative to that at its beginning, at which a line search ends


class CondensedContact(ContactSolver):
    """Contact solver with static condensation of the bodies, for one seam or any number of seams, which may meet.

    The bodies are condensed to the displacements of all nodes in contact, body by body, once. A small system is left.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        super().__init__(equations, like)
        self.pairs = ContactPairs(self.parts, self.is_fixed)

    @cached_property
    def _condensation(self) -> Condensation:
        """The bodies, condensed to the displacements of nodes in contact; constrained displacements are decoupled."""
        pairs, K, model = self.pairs, self.equations.K, self.equations.model
        x, bodies = model.V.tabulate_dof_coordinates()[:, : pairs.d], int(model.split_mesh.pieces.max()) + 1
        normal = pairs.weights @ pairs.frames[:, -1]
        return Condensation(K.getValuesCSR(), self.is_fixed, pairs.dofs, x, normal, bodies)

    @cached_property
    def _system(self) -> CondensedSystem:
        nodes = [part.nodes for part in self.parts]
        begins = np.cumsum([0, *(len(part_nodes.x) for part_nodes in nodes)])
        lines = np.concatenate([part_nodes.lines + begin for part_nodes, begin in zip(nodes, begins, strict=False)])
        x = np.concatenate([part_nodes.x for part_nodes in nodes])
        return CondensedSystem(self._condensation.stiffness, self.pairs, x, lines)

    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for x in place; return the number of Newton steps and the residual relative to the reference forces.

        Args:
            has_guess: whether the jumps of x are an initial guess; otherwise Newton's method starts from a coarser
                system or from bonded nodes.

        Raises:
            SolveError: no convergence.
        """
        equations, pairs, b = self.equations, self.pairs, self.b.array
        condensation = self._condensation
        u, constrained = self.x.array_r[pairs.dofs], ~pairs.free.ravel()
        b[equations.bc_dofs] = 0.0  # decoupled; prescribed displacements are restored at the end
        g = condensation.condense(b)
        g[constrained] = (condensation.stiffness.diagonal() * u)[constrained]
        self._external_norms = equations.residual_norms(equations.external)
        if not has_guess:
            u = self._system.start(g)
            equations.scale.include_displacement(float(np.abs(u).max(initial=0.0)))
        u, residuals = self._system.newton(u, g, self._relative)
        condensation.expand(b, u, self.x.array)
        self.x.array[equations.bc_dofs] = equations.prescribed
        relative = self.relative_residual()
        if not relative <= STATE_TOLERANCE:
            text = f"contact: the residual of the whole problem is {relative:.1e} of the forces"
            raise SolveError(text, residuals=residuals)
        return len(residuals) - 1, relative

    def _relative(self, r: Array, forces: Array, u: Array) -> float:
        """Largest ratio, over the blocks of unknowns (see `ForceScale`), of a residual's norm to the reference force.

        Args:
            r: (n d,) residual at the nodes in contact.
            forces: (n d,) contact forces at these nodes.
            u: (n d,) displacements of these nodes, not used.
        """
        block, count, scale = self.equations.block_of[self.pairs.dofs], self.equations.n_blocks, self.equations.scale
        pair_norms, r_norms = (np.sqrt(np.bincount(block, v * v, count)) for v in (forces, r))
        scale.update_stresses(np.maximum(self._external_norms, pair_norms))
        return scale.relative(r_norms)

    def close(self) -> None:
        """Free matrices, vectors and factors."""
        super().close()
        if "_condensation" in vars(self):
            self._condensation.close()


class CondensedSystem:
    """Solver of K u + f(u) = g, with the contact forces f of the pairs, by Newton's method.

    Newton's method starts from the solution of a system with half as many nodes. Gauss-Seidel sweeps, node by node with
    all pairs of a node, precede each Newton step. Their number grows with the number of steps. Later steps are
    shortened if the residual does positive work at their end. In the first steps residuals may grow.

    Args:
        K: (n d, n d) condensed stiffness of the bodies.
        pairs: the pairs, and their n nodes.
        x: (pairs, d) places of the pairs.
        lines: (m, 2) numbers of two pairs that are neighbours along S; if m is small there is no coarser system.
    """

    def __init__(self, K: Array | scipy.sparse.csr_matrix, pairs: ContactPairs, x: Array, lines: IntArray) -> None:
        self._stiffness, self.pairs, self._x, self._lines = K, pairs, x, lines

    @cached_property
    def _blocks(self) -> scipy.sparse.bsr_matrix:
        """The stiffness in blocks, as the sweeps read it."""
        A, d, n = self._stiffness, self.pairs.d, len(self.pairs.nodes)
        if not isinstance(A, np.ndarray):
            return A.tobsr((d, d))
        blocks = A.reshape(n, d, n, d).swapaxes(1, 2).reshape(-1, d, d)
        return scipy.sparse.bsr_matrix((blocks, np.tile(np.arange(n), n), np.arange(n + 1) * n))

    @cached_property
    def _rounding(self) -> float:
        """Norm of the rounding errors of the forces for displacements of size 1."""
        springs = self.pairs.bonded()[0]
        largest = max(float(matrix.diagonal().max(initial=0.0)) for matrix in (self._stiffness, springs))
        return MACHINE_EPSILON * SUMMATION_FACTOR * math.sqrt(len(self.pairs.nodes)) * largest

    @cached_property
    def _coarse_system(self) -> tuple[CondensedSystem, scipy.sparse.csr_matrix] | None:
        """System of every second pair along S, and the matrix that interpolates from it; None: there is none."""
        if len(self._lines) <= MAX_COARSEST_LINES:
            return None
        chosen, shares, lines = every_second(self._x, self._lines)
        if len(chosen) > MAX_COARSE_RATIO * len(self._x):
            return None
        coarse_pairs = self.pairs.subset(chosen, shares.T @ self.pairs.weights)
        pair, side = np.nonzero(self.pairs.pair_nodes >= 0)
        node, first = np.unique(self.pairs.pair_nodes[pair, side], return_index=True)
        rows = shares[pair[first]]  # if a node is in several pairs, these are ends of curves, which are all chosen
        columns = coarse_pairs.pair_nodes[rows.indices, side[first].repeat(np.diff(rows.indptr))]
        P = scipy.sparse.csr_matrix((rows.data, columns, rows.indptr), shape=(len(node), len(coarse_pairs.nodes)))
        P = scipy.sparse.kron(P, scipy.sparse.eye(self.pairs.d), format="csr")
        return CondensedSystem(P.T @ self._stiffness @ P, coarse_pairs, self._x[chosen], lines), P

    def start(self, g: Array) -> Array:
        """Initial displacements (n d,) of Newton's method, under forces g (n d,).

        They are interpolated from the coarser system. Without it, or if it fails, pairs are bonded by springs.
        """
        if self._coarse_system is not None:
            system, P = self._coarse_system
            with suppress(SolveError):
                return np.asarray(P @ system.newton(system.start(P.T @ g), P.T @ g, _force_ratio, COARSE_TOLERANCE)[0])
        springs, forces = self.pairs.bonded()
        return self._linear_solve(springs, g - forces)

    def _residual(self, u: Array, g: Array) -> Array:
        """Residual (n d,) at displacements u: forces of bodies and pairs, minus g; zero where u is constrained."""
        return np.asarray(self._stiffness @ u + self.pairs.forces(self.pairs.separation(u)) - g)

    def _linear_solve(self, springs: scipy.sparse.csr_matrix, b: Array) -> Array:
        """Solve (K + more) x = b with another matrix `springs`; x is not finite if the sum is singular."""
        A = self._stiffness
        if isinstance(A, np.ndarray):
            try:
                return np.linalg.solve(A + springs.toarray(), b)
            except np.linalg.LinAlgError:
                return np.full(len(b), np.nan)
        rows = (A + springs).tocsr()
        rows.sort_indices()
        matrix = create_aij(rows, PETSc.COMM_SELF)
        pc = PETSc.PC().create(PETSc.COMM_SELF)
        pc.setOperators(matrix)
        pc.setType("lu")
        pc.setFactorSolverType("mumps")  # unlike SuperLU it makes use of the dense blocks of bodies
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, 100)  # as in `DIRECT_OPTIONS`: spare memory in per cent
        x, right = matrix.createVecs()
        right.array = b
        pc.setUp()
        pc.apply(right, x)
        out = x.array_r.copy()
        destroy(pc, matrix, x, right)
        return np.asarray(out)

    def newton(
        self, u: Array, g: Array, relative: Callable[[Array, Array, Array], float], tolerance: float = NEWTON_TOLERANCE
    ) -> tuple[Array, tuple[float, ...]]:
        """Solve from u by Newton's method; return displacements (n d,), and the history of relative residuals.

        The history has the residuals before each step and after the last one.

        Args:
            u: (n d,) initial displacements.
            g: (n d,) forces.
            relative: function of the residual, the forces of the pairs and u that returns the relative residual.
            tolerance: relative residual at which the method stops.

        Raises:
            SolveError: no convergence.
        """
        residuals, pairs, long_steps, limit = list[float](), self.pairs, 0, LONG_STEP_RATIO * np.abs(u).max(initial=0.0)
        while True:
            forces = pairs.forces(pairs.separation(u))
            residuals.append(relative(self._stiffness @ u + forces - g, forces, u))
            if residuals[-1] <= tolerance or self._stalls(residuals, u, forces):
                return u, tuple(residuals)
            if len(residuals) > MAX_NEWTON_STEPS or long_steps > MAX_LONG_STEPS or not math.isfinite(residuals[-1]):
                text = f"contact: residual {residuals[-1]:.1e} of the forces after {len(residuals) - 1} Newton steps"
                advice = "is every body supported, or pressed against S? Else try smaller load steps"
                raise SolveError(text, residuals=tuple(residuals), advice=advice)
            u = u.copy()
            pairs.sweep(self._blocks, g, u, min(MIN_SWEEPS * 2 ** max(len(residuals) - DOUBLING_STEPS, 0), MAX_SWEEPS))
            step = self._linear_solve(pairs.stiffness(pairs.tangents(pairs.separation(u))), -self._residual(u, g))
            long_steps = long_steps + 1 if 0 < limit < np.abs(step).max() else 0
            u = u + (self._step_length(u, step, g) if len(residuals) > DOUBLING_STEPS else 1.0) * step

    def _stalls(self, residuals: list[float], u: Array, forces: Array) -> bool:
        """Whether the last of the relative residuals hardly fell, and is as small as rounding allows.

        Args:
            residuals: relative residuals of all steps.
            u: (n d,) displacements now.
            forces: (n d,) contact forces now, for the size of rounding.
        """
        if len(residuals) < 3 or residuals[-1] <= residuals[-2] / 2:
            return False
        share = self._rounding * float(np.abs(u).max(initial=0.0)) / max(float(np.linalg.norm(forces)), MIN_DIVISOR)
        return residuals[-1] <= max(STALLED_TOLERANCE, min(share, STATE_TOLERANCE))

    def _step_length(self, u: Array, step: Array, g: Array) -> float:
        """Length, at most 1, of a Newton step from u under forces g at which the residual does no work along it.

        It is found by regula falsi.
        """

        def work(length: float) -> float:
            return float(step @ self._residual(u + length * step, g))

        start_work, end_work = work(0.0), work(1.0)
        if not (start_work < 0 and end_work > WORK_RATIO * abs(start_work)):
            return 1.0
        low, high, low_work, high_work = 0.0, 1.0, start_work, end_work
        for _ in range(MAX_LENGTH_TRIALS):
            length = low - low_work * (high - low) / (high_work - low_work)
            length = min(max(length, low + 0.1 * (high - low)), high - 0.1 * (high - low))
            work_now = work(length)
            if abs(work_now) <= WORK_RATIO * abs(start_work):
                break
            if work_now < 0:
                low, low_work = length, work_now
            else:
                high, high_work = length, work_now
        return length


def _force_ratio(r: Array, forces: Array, u: Array) -> float:
    return float(np.linalg.norm(r)) / max(float(np.linalg.norm(forces)), MIN_DIVISOR)


def every_second(x: Array, lines: IntArray) -> tuple[IntArray, scipy.sparse.csr_matrix, IntArray]:
    """Choose every second place along the curves that lines between places form, with all ends and branches.

    Args:
        x: (n, d) coordinates of the places.
        lines: (m, 2) numbers of the two places of each line.

    Returns:
        Numbers (k,) of the chosen places, ascending; weights (n, k) that interpolate from them to all places; lines
            between them (.., 2), numbered from 0 to k - 1.
    """
    chosen = np.bincount(lines.ravel(), minlength=len(x)) != 2
    chosen[along(x, lines, float(np.ptp(x)))[::2]] = True
    place, other = np.concatenate([lines, lines[:, ::-1]]).T
    # a ring with an odd number of places may begin and end with places that are not chosen
    chosen |= np.bincount(place, chosen[other], len(x)) < 2
    kept, number = np.flatnonzero(chosen), np.cumsum(chosen) - 1
    is_used = chosen[other] & ~chosen[place]
    place, other = place[is_used], other[is_used]
    weights = 1.0 / np.linalg.norm(x[place] - x[other], axis=1)
    entries = np.append(weights / np.bincount(place, weights)[place], np.ones(len(kept)))
    places = np.append(place, kept), number[np.append(other, kept)]
    shares = scipy.sparse.csr_matrix((entries, places), shape=(len(x), len(kept)))
    coarse_lines = shares[np.diff(shares.indptr) == 2].indices.reshape(-1, 2)
    return kept, shares, np.concatenate([coarse_lines, number[lines[chosen[lines].all(axis=1)]]])
