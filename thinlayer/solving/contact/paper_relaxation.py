"""The relaxation method of section 8 of the paper for contact: over-relaxed Gauss-Seidel sweeps, on one rank."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from forms.base import Array, InputError, require
from forms.contact import ContactLaw
from geometry.topology import BoolArray, Indices
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.pairs import C_SOURCE, sweep_parameters
from thinlayer.solving.equations import Equations
from thinlayer.solving.part_sum import ACCEPTED_RESIDUAL, MACHINE_EPSILON
from thinlayer.solving.petsc import PREFIX
from thinlayer.system.compilation import c_pointers, load_own_library

SWEEPS_PER_TEST = 256  # number of sweeps between two tests of the increments
MIN_STAGNANT_SWEEPS = 2048  # number of sweeps from which on stagnation is tested
DIVERGENCE_GROWTH = 1e8  # growth of the changes, relative to the largest of the first sweeps, that means divergence
STAGNATION_RATIO = 0.999  # stagnation: ratio of the least increments of the later and the earlier half of all sweeps
TOLERANCE_DIVISOR = 1.5  # divisor of the tolerance of increments if forces do not balance yet
FIXED_DIAGONAL_RATIO = 1e20  # diagonal entry of constrained components of contact nodes, relative to the mean stiffness
AXIS_TOLERANCE = 1e-9  # largest difference of the axes of S from coordinate axes
RELAXATION_OPTIONS = dict[str, tuple[float, float]](  # name -> default and upper bound
    omega=(1.7, 2), omega_contact=(1.0, 2), tolerance=(1e-12, 1e-3), max_sweeps=(200_000, np.inf)
)


class SeamSystem(NamedTuple):
    """Equations A u + f(u) = b of a contact problem in d dimensions, with the contact forces f of n nodes on S.

    Among the N unknowns u are the jumps at the contact nodes, in the axes of S.

    Attributes:
        A: (N, N) stiffness. Rows of constrained unknowns have a diagonal entry only.
        b: (N,) nodal forces of the loads.
        jump_dofs: (n, d) numbers of the unknowns of each contact node: its tangential jumps, then its normal jump,
            which is positive if S opens.
        weights: (n,) area of S (length in two dimensions) around each node.
        law: the contact law.
        slip: (n, d - 1) slip at the beginning of the time step.
    """

    A: scipy.sparse.csr_matrix
    b: Array
    jump_dofs: Indices
    weights: Array
    law: ContactLaw
    slip: Array


class RelaxationResult(NamedTuple):
    """Result of `relax`: the last iterate, and how the sweeps converged.

    Attributes:
        u: (N,) the last iterate.
        converged: whether the change in the last sweep met the tolerance.
        increments: (sweeps,) Euclidean norm of the change of u in each sweep, relative to the norm of u.
    """

    u: Array
    converged: bool
    increments: Array


def relax(
    system: SeamSystem,
    *,
    u: Array | None = None,
    order: Indices | None = None,
    omega: float = 1.0,
    omega_contact: float = 1.0,
    tolerance: float = 1e-8,
    max_sweeps: int = 100_000,
) -> RelaxationResult:
    """Solve a contact problem A u + f(u) = b by the relaxation of section 8 of the paper.

    It consists of over-relaxed Gauss-Seidel sweeps. A sweep updates one unknown after another: it computes a new value
    with all other unknowns fixed, and moves the unknown towards this value by omega times the difference.

    Let a be the diagonal entry of A in the unknown's row. Let r be the right-hand side minus all other entries of this
    row times u. The new value of an unknown away from S is r / a.

    Now consider a contact node on an area c of S, with the friction threshold rho and the slip s before the step. The
    new normal jump is r / a if that opens S, else r / (a + c K_N). A tangential jump becomes (r + c K_T s) / (a + c
    K_T) if the node sticks, else (r -+ c rho) / a. In three dimensions both tangential jumps are updated together,
    because their traction lies in a disc.

    There are two differences from the paper. Friction thresholds follow the contact pressure within the sweeps. Contact
    nodes have a relaxation factor of their own, by default 1, as one factor everywhere fails for many meshes and
    stiffnesses.

    Args:
        system: the equations, for N unknowns u.
        u: (N,) first iterate, which is not changed; None: zero.
        order: (N,) numbers of the unknowns in the order of a sweep. Both tangential jumps of a node are updated where
            the first of them occurs. None: ascending, but the normal jump of a node before its tangential jumps.
        omega: relaxation factor of unknowns that do not belong to contact nodes.
        omega_contact: relaxation factor of the unknowns of contact nodes.
        tolerance: the relaxation has converged if the change of u in a sweep, relative to u, is at most this.
        max_sweeps: largest number of sweeps.

    Returns:
        The last iterate, even without convergence. Sweeps end without convergence at `max_sweeps`, or if the changes
            stagnate, grow or are not finite.
    """
    c, A, n, d = load_own_library(C_SOURCE), system.A, len(system.b), system.jump_dofs.shape[1]
    u_now, codes = np.zeros(n) if u is None else u.copy(), _update_codes(system.jump_dofs, order, n)
    system_pointers = c_pointers(c, A.indptr.astype(np.int32), A.indices.astype(np.int32), A.data, system.b, u_now)
    law_numbers, omegas = np.array(sweep_parameters(system.law)), np.array([omega, omega_contact])
    node_pointers = c_pointers(c, system.jump_dofs.astype(np.int32), system.weights, law_numbers, system.slip, omegas)
    arguments = len(codes), *c_pointers(c, codes), n, *system_pointers, d, *node_pointers
    (changes, increments), converged = np.empty((2, 0)), False
    while not converged and len(increments) < max_sweeps:
        max_chunk = min(SWEEPS_PER_TEST, max_sweeps - len(increments))
        new_changes, u_norms = np.empty(max_chunk), np.empty(max_chunk)
        n_sweeps = c.lib.relax_sweeps(*arguments, max_chunk, tolerance, *c_pointers(c, new_changes, u_norms))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            relative = np.where(new_changes > 0, new_changes / u_norms, new_changes)
        changes, increments = np.append(changes, new_changes[:n_sweeps]), np.append(increments, relative[:n_sweeps])
        converged = bool(increments[-1] <= tolerance)
        is_diverging = not changes[-1] <= DIVERGENCE_GROWTH * changes[:10].max()
        half = len(increments) // 2
        slow = half >= MIN_STAGNANT_SWEEPS // 2 and increments[half:].min() > STAGNATION_RATIO * increments[:half].min()
        if is_diverging or slow:
            break
    return RelaxationResult(u_now, converged, increments)


def _update_codes(jump_dofs: Indices, order: Indices | None, n_unknowns: int) -> Indices:
    """Return the updates of one sweep in their order, as the integer codes that sweeps.c reads.

    A code >= 0 is the number of an unknown away from S. The code -1 - 2 k stands for the normal jump of contact node k.
    The code -2 - 2 k stands for its tangential jumps.

    Args:
        jump_dofs: (n, d) numbers of the unknowns of each contact node: its tangential jumps, then its normal jump.
        order: (N,) numbers of the unknowns in the order of a sweep; None: ascending.
        n_unknowns: number N of unknowns.
    """
    position = np.arange(n_unknowns) if order is None else np.argsort(order)
    normal, tangential = position[jump_dofs[:, -1]].astype(float), position[jump_dofs[:, :-1]].min(axis=1).astype(float)
    if order is None:
        normal, tangential = (np.minimum(normal, tangential) + shift for shift in (0.0, 0.5))
    others = np.setdiff1d(np.arange(n_unknowns), jump_dofs)
    nodes = np.arange(len(jump_dofs))
    codes: Indices = np.concatenate([others, -1 - 2 * nodes, -2 - 2 * nodes]).astype(np.int32)
    return codes[np.argsort(np.concatenate([position[others], normal, tangential]), kind="stable")]


class ContactRelaxation(ContactSolver):
    """Contact solver by the relaxation of section 8 of the paper, for one seam. It always starts from zero jumps.

    The unknowns at the upper nodes of S are jumps, initial gaps included, in the axes of S. All other unknowns are
    displacements.

    PETSc options, with their defaults: -thinlayer_relaxation_omega (1.7), -thinlayer_relaxation_omega_contact (1),
    -thinlayer_relaxation_tolerance of the relative change of u in a sweep (1e-12), -thinlayer_relaxation_max_sweeps
    (200000).
    """

    has_homotopy = False

    def __init__(self, equations: Equations, like: State | None) -> None:
        super().__init__(equations, like)
        (self.part,) = self.parts
        nodes = self.part.nodes
        self._fixed_jumps = _fixed_components(nodes.frames, nodes.is_fixed)
        if (nodes.is_fixed_upper & ~nodes.is_fixed).any():
            raise InputError("method='relaxation' needs supports on both sides of S or on the lower; use 'condensed'")
        self._fixed = self.is_fixed.copy()
        self._fixed[nodes.dofs] = self._fixed_jumps
        self._T = self._basis_matrix()
        self._K = local_csr(equations.K)
        self._A = self._T.T @ self._K @ self._T

    def _unknown_order(self) -> Indices:
        """Return the numbers (N,) of the unknowns, sorted by the coordinates of their nodes, of which x varies fastest.

        The convergence of the sweeps depends on their order.
        """
        nodes = self.part.nodes
        d, x = nodes.dim, nodes.surface.V.tabulate_dof_coordinates()
        nodes_in_order = np.lexsort(np.rint(x[:, :d] / (1e-9 * self.equations.model.joint.size)).T)
        return np.asarray((nodes_in_order[:, None] * d + np.arange(d)).ravel(), np.int32)

    def _basis_matrix(self) -> scipy.sparse.csr_matrix:
        """Return the matrix (N, N) that turns the N unknowns into displacements, if initial gaps are zero.

        The unknowns are jumps at the upper nodes of S, in the axes of S, and displacements elsewhere.
        """
        nodes, n = self.part.nodes, len(self.is_fixed)
        upper_dofs, other_dofs = nodes.dofs, np.setdiff1d(np.arange(n), nodes.dofs)
        rows = [other_dofs, np.repeat(upper_dofs, nodes.dim, axis=1).ravel()]
        columns = [other_dofs, np.tile(upper_dofs, nodes.dim).ravel()]
        values = [np.ones(len(other_dofs)), nodes.frames.transpose(0, 2, 1).ravel()]
        if nodes.lower_matrix is not None:
            lower_dofs = nodes.global_pairs[:, 1:] * nodes.dim + np.arange(nodes.dim)
            rows, columns = [*rows, upper_dofs.ravel()], [*columns, lower_dofs.ravel()]
            values.append(np.ones(upper_dofs.size))
        indices = np.concatenate(rows), np.concatenate(columns)
        return scipy.sparse.csr_matrix((np.concatenate(values), indices), shape=(n, n))

    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for the displacements in the attribute `x`, in place, by sweeps.

        If the change of the unknowns in a sweep meets its tolerance, but forces do not balance yet, sweeps go on with
        smaller tolerances.

        Args:
            has_guess: not used, as the relaxation always starts from zero.

        Returns:
            Number of sweeps until the tolerance was first met, and norm of the residual relative to the reference
                forces.

        Raises:
            SolveError: no convergence. Its attribute `residuals` has the relative changes of the unknowns in the
                sweeps.
        """
        equations, nodes, x = self.equations, self.part.nodes, self.x
        fixed, is_moving, tolerance = self._fixed, ~self._fixed_jumps.all(axis=1), _option("tolerance")
        x.set(0.0)
        x.array[equations.bc_dofs] = equations.prescribed
        prescribed = x.array_r.copy()
        prescribed[nodes.dofs] = np.where(self._fixed_jumps, nodes.separation(x), 0.0)
        closing_u = np.zeros(len(prescribed))  # displacements of the upper side that close the gaps
        closing_u[nodes.dofs] = nodes.frames[:, -1] * nodes.gap[:, None]
        diagonal = np.where(fixed, equations.mean_stiffness, 0.0)
        diagonal[nodes.dofs[is_moving][self._fixed_jumps[is_moving]]] *= FIXED_DIAGONAL_RATIO
        b = self._T.T @ (equations.external.array_r + self._K @ closing_u) - self._A @ prescribed
        free = scipy.sparse.diags((~fixed).astype(float))
        A, b = (free @ self._A @ free + scipy.sparse.diags(diagonal)).tocsr(), np.where(fixed, diagonal * prescribed, b)
        contact_data = nodes.dofs[is_moving], nodes.weights[is_moving], self.part.law, self.part.slip[is_moving]
        system, order, max_sweeps = SeamSystem(A, b, *contact_data), self._unknown_order(), int(_option("max_sweeps"))
        run_relax = partial(relax, system, order=order, omega=_option("omega"), omega_contact=_option("omega_contact"))
        n_sweeps, u = 0, None  # sweeps until increments met the tolerance
        while True:  # increments may be small before forces balance
            relaxation = run_relax(u=u, tolerance=tolerance, max_sweeps=max_sweeps)
            u, n_sweeps = relaxation.u, n_sweeps or len(relaxation.increments)
            x.array[:] = self._T @ u - closing_u
            x.array[equations.bc_dofs] = equations.prescribed
            residual = self.relative_residual()
            if not relaxation.converged or residual <= ACCEPTED_RESIDUAL or tolerance < MACHINE_EPSILON:
                break
            tolerance /= TOLERANCE_DIVISOR
        if not (relaxation.converged and residual <= ACCEPTED_RESIDUAL):
            last, increments = relaxation.increments[-1], tuple(map(float, relaxation.increments))
            text = f"after {n_sweeps} sweeps the increment is {last:.1e} and the residual {residual:.1e} of the forces"
            advice = f"try -{PREFIX}relaxation_omega and _omega_contact nearer to 1, another method, or smaller loads"
            raise SolveError(f"the relaxation does not converge: {text}", residuals=increments, advice=advice)
        return n_sweeps, residual


def _option(name: str) -> float:
    """Return the value of the relaxation's option `name` in PETSc's database, or its default.

    Raises:
        InputError: the value is out of range.
    """
    options, (default, bound) = PETSc.Options(PREFIX + "relaxation_"), RELAXATION_OPTIONS[name]
    value: float = (options.getInt if isinstance(default, int) else options.getReal)(name, default)
    require(0 < value < bound, f"-{PREFIX}relaxation_{name}", value, f"allowed: > 0 and < {bound:g}")
    return value


def _fixed_components(frames: Array, is_fixed: BoolArray) -> BoolArray:
    """Return a mask (n, d) of the jump components, in the axes of S, that supports constrain at n contact nodes.

    Args:
        frames: (n, d, d) axes of S at the contact nodes, as rows.
        is_fixed: (n, d) mask of the constrained components of the jumps in the coordinate axes.

    Raises:
        InputError: a node is constrained along axes other than those of S.
    """
    cosines = np.abs(frames)
    is_aligned = (np.abs(cosines - np.rint(cosines)) < AXIS_TOLERANCE).all(axis=(1, 2))
    if (~is_aligned & is_fixed.any(axis=1) & ~is_fixed.all(axis=1)).any():
        raise InputError("method='relaxation' needs supports along the axes of S at its nodes; use 'condensed'")
    return np.asarray(np.einsum("nij,nj->ni", cosines > 0.5, is_fixed) > 0)
