"""Solver of contact problems condensed to the displacements of the nodes on S, on one rank.

The condensed problem is solved by Newton's method, with Gauss-Seidel sweeps before each step. Its unknowns are the
displacements of both sides of S, not the jumps. Jumps at a junction depend on each other, so a stiffness condensed to
jumps would be singular.

Multigrid does not replace it. In units of one linear solve, a first solve and later steps of a march take 1.4 and 0.3
for a bar of 128 x 128 squares, but 7 to 12 and 5 to 7 by multigrid, also with a factor of MUMPS as its preconditioner.
For 217 bricks they take 14 and 6, by multigrid 22 and 12. For a cube of 16 x 16 x 16 cells they take 3 and 0.3, by
multigrid 2 and 0.8. With assembly, `python3 -c "from studies.friction_cost import bar; from thinlayer import solve;
print([solve(bar(128), method=m).report.seconds for m in ('condensed', 'multigrid')])"` shows a factor of 4.

The first system with fewer nodes saves 0.13 of a linear solve with 384 x 384 squares, sparse right-hand sides 0.09, the
order of nodes 0.11. The estimate of rounding is needed where layers are 1e9 times as stiff as cells of the bodies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property

import numpy as np
import scipy.sparse

from forms.base import Array
from geometry.topology import IntArray, curve_order
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.contact.condensation import Condensation
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.pairs import ContactPairs
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import SubmatrixFactor
from thinlayer.solving.part_sum import ACCEPTED_RESIDUAL, MACHINE_EPSILON, MIN_DIVISOR

NEWTON_TOLERANCE = 1e-11  # residual at which Newton's method stops, relative to the forces
COARSE_TOLERANCE = 1e-3  # residual at which it stops in coarser systems
MAX_COARSEST_LINES = 100  # largest number of lines between nodes of a system that is not coarsened
MAX_COARSE_RATIO = 0.75  # largest number of pairs of a coarser system, relative to all; seams of one cell keep all
STALLED_TOLERANCE = 1e-9  # residual, relative to the forces, that is accepted if Newton steps do not reduce it
SUMMATION_FACTOR = 10.0  # rounding of the condensed stiffness over rounding of its largest entry, per sqrt(node)
MIN_SWEEPS = 4  # number of sweeps before each of the first Newton steps
EARLY_STEPS = 6  # number of Newton steps after which the sweeps double with every step, and steps may be shortened
MAX_SWEEPS = 32  # largest number of sweeps before a Newton step
MAX_NEWTON_STEPS = 30
LONG_STEP_RATIO = 1e5  # a long step over the initial displacements, as for a body without supports
MAX_LONG_STEPS = 4  # largest number of successive long steps
MAX_LENGTH_TRIALS = 12  # largest number of trials of a line search
LINE_SEARCH_WORK_RATIO = 0.1  # work along a step at its end over that at its beginning, above which it is shortened


class CondensedContact(ContactSolver):
    """Contact solver that first condenses the bodies to the displacements of the nodes in contact.

    The condensation is done once. In each step only the small condensed system is solved. There may be several seams,
    which may meet.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        super().__init__(equations, like)
        self.pairs = ContactPairs(self.parts, self.is_fixed)

    @cached_property
    def _condensation(self) -> Condensation:
        """Static condensation of the bodies to the displacements of the nodes in contact.

        Constrained displacements are decoupled from all others.
        """
        pairs, K, model = self.pairs, self.equations.K, self.equations.model
        x, n_bodies = model.V.tabulate_dof_coordinates()[:, : pairs.d], int(model.split_mesh.pieces.max()) + 1
        normal = pairs.weights @ pairs.frames[:, -1]
        return Condensation(K.getValuesCSR(), self.is_fixed, pairs.dofs, x, normal, n_bodies)

    @cached_property
    def _condensed_system(self) -> CondensedSystem:
        nodes = [part.nodes for part in self.parts]
        starts = np.cumsum([0, *(len(part_nodes.x) for part_nodes in nodes)])
        lines = np.concatenate([part_nodes.links + start for part_nodes, start in zip(nodes, starts, strict=False)])
        x = np.concatenate([part_nodes.x for part_nodes in nodes])
        return CondensedSystem(self._condensation.stiffness, self.pairs, x, lines)

    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for the displacements in the attribute `x`, in place.

        Args:
            has_guess: whether `x` already contains a guess of the jumps. If not, Newton's method starts from the
                solution with fewer nodes on S, or with pairs of nodes that neither open nor slide.

        Returns:
            Number of Newton steps, and norm of the residual relative to the reference forces.

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
            u = self._condensed_system.guess(g)
            equations.scale.include_displacement(float(np.abs(u).max(initial=0.0)))
        u, residuals = self._condensed_system.newton(u, g, self._relative_norm)
        condensation.expand(b, u, self.x.array)
        self.x.array[equations.bc_dofs] = equations.prescribed
        residual = self.relative_residual()
        if not residual <= ACCEPTED_RESIDUAL:
            text = f"contact: the residual of the whole problem is {residual:.1e} of the forces"
            raise SolveError(text, residuals=residuals)
        return len(residuals) - 1, residual

    def _relative_norm(self, r: Array, forces: Array) -> float:
        """Return the largest ratio of a residual's norm to the reference force, over the blocks of unknowns.

        The reference forces and the blocks are those of `ForceScale`.

        Args:
            r: (n d,) residual at the n nodes in contact, in d dimensions.
            forces: (n d,) contact forces at these nodes.
        """
        block, n_blocks, scale = self.equations.block_of[self.pairs.dofs], self.equations.n_blocks, self.equations.scale
        force_norms, r_norms = (np.sqrt(np.bincount(block, v * v, n_blocks)) for v in (forces, r))
        scale.update_stresses(np.maximum(self._external_norms, force_norms))
        return scale.relative_norm(r_norms)

    def close(self) -> None:
        """Free matrices, vectors and factors."""
        super().close()
        if "_condensation" in vars(self):
            self._condensation.close()


class CondensedSystem:
    """Condensed contact problem K u + f(u) = g at n nodes in d dimensions, and its solver by Newton's method.

    u are the displacements of the nodes, f the nodal forces of the contact laws, and g the condensed loads.

    Newton's method starts from the solution of the same problem with about half of the nodes. Before each Newton step,
    Gauss-Seidel sweeps solve for the displacements of one node after another. There are more sweeps before later steps.
    The residual may grow in the first steps. Later steps are shortened if they go too far, see `_step_length`.

    Args:
        K: (n d, n d) condensed stiffness of the bodies.
        pairs: the pairs of an upper and a lower node in contact, and these n nodes.
        x: (pairs, d) coordinates of the pairs.
        lines: (m, 2) numbers of two pairs that are neighbours along S, for each of m lines. If m is small, no problem
            with fewer nodes is solved first.
    """

    def __init__(self, K: Array | scipy.sparse.csr_matrix, pairs: ContactPairs, x: Array, lines: IntArray) -> None:
        self._stiffness, self.pairs, self._x, self._lines = K, pairs, x, lines

    @cached_property
    def _bsr_K(self) -> scipy.sparse.bsr_matrix:
        """The stiffness K of n nodes as a sparse matrix of (n, n) blocks (d, d), for the Gauss-Seidel sweeps."""
        A, d, n = self._stiffness, self.pairs.d, len(self.pairs.nodes)
        if not isinstance(A, np.ndarray):
            return A.tobsr((d, d))
        blocks = A.reshape(n, d, n, d).swapaxes(1, 2).reshape(-1, d, d)
        return scipy.sparse.bsr_matrix((blocks, np.tile(np.arange(n), n), np.arange(n + 1) * n))

    @cached_property
    def _rounding(self) -> float:
        """Estimated norm of the rounding errors of the nodal forces, for displacements of size 1."""
        springs = self.pairs.bonded_springs()[0]
        largest = max(float(matrix.diagonal().max(initial=0.0)) for matrix in (self._stiffness, springs))
        return MACHINE_EPSILON * SUMMATION_FACTOR * math.sqrt(len(self.pairs.nodes)) * largest

    @cached_property
    def _coarse_system(self) -> tuple[CondensedSystem, scipy.sparse.csr_matrix] | None:
        """The contact problem with every second pair along S, and the matrix that interpolates displacements from it.

        None: S has too few nodes for this, or too few of them could be left out.
        """
        if len(self._lines) <= MAX_COARSEST_LINES:
            return None
        chosen, P_pairs, lines = every_second_point(self._x, self._lines)
        if len(chosen) > MAX_COARSE_RATIO * len(self._x):
            return None
        coarse_pairs = self.pairs.subset(chosen, P_pairs.T @ self.pairs.weights)
        pair, side = np.nonzero(self.pairs.pair_nodes >= 0)
        node, first = np.unique(self.pairs.pair_nodes[pair, side], return_index=True)
        P_rows = P_pairs[pair[first]]  # if a node is in several pairs, these are ends of curves, which are all chosen
        columns = coarse_pairs.pair_nodes[P_rows.indices, side[first].repeat(np.diff(P_rows.indptr))]
        P = scipy.sparse.csr_matrix((P_rows.data, columns, P_rows.indptr), shape=(len(node), len(coarse_pairs.nodes)))
        P = scipy.sparse.kron(P, scipy.sparse.eye(self.pairs.d), format="csr")
        return CondensedSystem(P.T @ self._stiffness @ P, coarse_pairs, self._x[chosen], lines), P

    def guess(self, g: Array) -> Array:
        """Return displacements (n d,) of n nodes in d dimensions from which Newton's method starts.

        They are interpolated from the solution with every second pair of nodes. If there is none, they are those of
        pairs that springs bond: such pairs neither open nor slide.

        Args:
            g: (n d,) condensed loads.
        """
        if self._coarse_system is not None:
            system, P = self._coarse_system
            with suppress(SolveError):
                return np.asarray(P @ system.newton(system.guess(P.T @ g), P.T @ g, _force_ratio, COARSE_TOLERANCE)[0])
        springs, forces = self.pairs.bonded_springs()
        return self._linear_solve(springs, g - forces)

    def _residual(self, u: Array, g: Array) -> Array:
        """Return the residual K u + f(u) - g, as nodal forces (n d,) on n nodes in d dimensions.

        K is the stiffness of the bodies, and f(u) are the contact forces. Entries of constrained displacements are
        zero.

        Args:
            u: (n d,) displacements.
            g: (n d,) condensed loads.
        """
        return np.asarray(self._stiffness @ u + self.pairs.forces(self.pairs.jumps_with_gaps(u)) - g)

    def _linear_solve(self, springs: scipy.sparse.csr_matrix, b: Array) -> Array:
        """Solve (K + springs) x = b, where K is the stiffness of the bodies; return x (n d,).

        If the sum is singular, x contains NaN or infinity.

        Args:
            springs: (n d, n d) stiffness of springs between n nodes in d dimensions.
            b: (n d,) nodal forces.
        """
        A = self._stiffness
        if isinstance(A, np.ndarray):
            try:
                return np.linalg.solve(A + springs.toarray(), b)
            except np.linalg.LinAlgError:
                return np.full(len(b), np.nan)
        x = np.empty(len(b))
        SubmatrixFactor((A + springs).tocsr()).solve(b, x)  # unlike SuperLU it makes use of the dense blocks of bodies
        return x

    def newton(
        self, u: Array, g: Array, norm_of: Callable[[Array, Array], float], tolerance: float = NEWTON_TOLERANCE
    ) -> tuple[Array, tuple[float, ...]]:
        """Solve the condensed contact problem by Newton's method, at n nodes in d dimensions.

        Args:
            u: (n d,) displacements from which the method starts.
            g: (n d,) condensed loads.
            norm_of: function that returns the norm of a residual relative to the reference forces. Its arguments are
                the residual and the contact forces, each (n d,).
            tolerance: relative residual at which the method stops.

        Returns:
            Displacements (n d,) at the solution, and the relative residuals before each step and after the last one.

        Raises:
            SolveError: no convergence.
        """
        residuals, pairs, long_steps, limit = list[float](), self.pairs, 0, LONG_STEP_RATIO * np.abs(u).max(initial=0.0)
        while True:
            forces = pairs.forces(pairs.jumps_with_gaps(u))
            residuals.append(norm_of(self._stiffness @ u + forces - g, forces))
            if residuals[-1] <= tolerance or self._stalls(residuals, u, forces):
                return u, tuple(residuals)
            if len(residuals) > MAX_NEWTON_STEPS or long_steps > MAX_LONG_STEPS or not math.isfinite(residuals[-1]):
                text = f"contact: residual {residuals[-1]:.1e} of the forces after {len(residuals) - 1} Newton steps"
                advice = "is every body supported, or pressed against S? Else try smaller load steps"
                raise SolveError(text, residuals=tuple(residuals), advice=advice)
            u = u.copy()
            pairs.sweep(self._bsr_K, g, u, min(MIN_SWEEPS * 2 ** max(len(residuals) - EARLY_STEPS, 0), MAX_SWEEPS))
            step = self._linear_solve(pairs.stiffness(pairs.tangents(pairs.jumps_with_gaps(u))), -self._residual(u, g))
            long_steps = long_steps + 1 if 0 < limit < np.abs(step).max() else 0
            u = u + (self._step_length(u, step, g) if len(residuals) > EARLY_STEPS else 1.0) * step

    def _stalls(self, residuals: list[float], u: Array, forces: Array) -> bool:
        """Whether the last Newton step hardly reduced the residual, which is already as small as rounding errors allow.

        Args:
            residuals: relative residuals before each step and after the last one.
            u: (n d,) displacements of n nodes in d dimensions after the last step.
            forces: (n d,) contact forces at `u`, to which the rounding errors are compared.
        """
        if len(residuals) < 3 or residuals[-1] <= residuals[-2] / 2:
            return False
        rounding = self._rounding * float(np.abs(u).max(initial=0.0)) / max(float(np.linalg.norm(forces)), MIN_DIVISOR)
        return residuals[-1] <= max(STALLED_TOLERANCE, min(rounding, ACCEPTED_RESIDUAL))

    def _step_length(self, u: Array, step: Array, g: Array) -> float:
        """Return the factor, at most 1, by which a Newton step is shortened.

        The work of the residual along the step is negative at its start. If it is clearly positive at its end, the
        factor is one at which this work almost vanishes. Otherwise the factor is 1.

        Args:
            u: (n d,) displacements of n nodes in d dimensions before the step.
            step: (n d,) increment of the displacements.
            g: (n d,) condensed loads.
        """

        from scipy.optimize import brentq  # most problems need no line search

        def work(length: float) -> float:
            return float(step @ self._residual(u + length * step, g))

        start_work, end_work = work(0.0), work(1.0)
        if not (start_work < 0 and end_work > LINE_SEARCH_WORK_RATIO * abs(start_work)):
            return 1.0
        return float(brentq(work, 0.0, 1.0, maxiter=MAX_LENGTH_TRIALS, disp=False))


def _force_ratio(r: Array, forces: Array) -> float:
    return float(np.linalg.norm(r)) / max(float(np.linalg.norm(forces)), MIN_DIVISOR)


def every_second_point(x: Array, lines: IntArray) -> tuple[IntArray, scipy.sparse.csr_matrix, IntArray]:
    """Choose every second point along curves that are given as lines between points.

    Ends and branching points of the curves are always chosen.

    Args:
        x: (n, d) coordinates of the n points.
        lines: (m, 2) numbers of the two points that each of m lines joins.

    Returns:
        Numbers (k,) of the chosen points, ascending; a matrix (n, k) that interpolates values from the chosen points to
            all points; and pairs (.., 2) of chosen points that are now neighbours, numbered from 0 to k - 1.
    """
    is_chosen = np.bincount(lines.ravel(), minlength=len(x)) != 2
    is_chosen[curve_order(x, lines, float(np.ptp(x)))[::2]] = True
    point, neighbour = np.concatenate([lines, lines[:, ::-1]]).T
    # a ring with an odd number of places may begin and end with places that are not chosen
    is_chosen |= np.bincount(point, is_chosen[neighbour], len(x)) < 2
    chosen_points, number = np.flatnonzero(is_chosen), np.cumsum(is_chosen) - 1
    is_used = is_chosen[neighbour] & ~is_chosen[point]
    point, neighbour = point[is_used], neighbour[is_used]
    weights = 1.0 / np.linalg.norm(x[point] - x[neighbour], axis=1)
    entries = np.append(weights / np.bincount(point, weights)[point], np.ones(len(chosen_points)))
    rows_columns = np.append(point, chosen_points), number[np.append(neighbour, chosen_points)]
    interpolation = scipy.sparse.csr_matrix((entries, rows_columns), shape=(len(x), len(chosen_points)))
    coarse_lines = interpolation[np.diff(interpolation.indptr) == 2].indices.reshape(-1, 2)
    return chosen_points, interpolation, np.concatenate([coarse_lines, number[lines[is_chosen[lines].all(axis=1)]]])
