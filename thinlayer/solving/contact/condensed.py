"""Contact condensed to S: one factorisation, then Newton's method with Gauss-Seidel sweeps on a small dense system."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
from petsc4py import PETSc
from scipy import linalg
from scipy.sparse.csgraph import connected_components, depth_first_order

from forms.base import Array, InputError
from forms.contact import ContactLaw
from thinlayer.errors import SolveError
from thinlayer.solving.balance import TINY
from thinlayer.solving.contact.dense import STALLED, Chains, DenseSystem, Load
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.contact.schur import FactorError, SchurFactor

SLOPE = 1.2  # slope, relative to S, of the front along which nodes are numbered
SAMPLE = 64  # number of nodes whose edges show the diagonals of the cells
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
        InputError: no free displacement on S.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem, self.law = problem, problem.law
        self._u, self._r = problem.b.duplicate(), problem.b.duplicate()
        self._sides = SideDisplacements(problem)
        if not len(self._sides.dofs):
            raise InputError("supports hold every displacement on S: nothing is left for contact")

    @cached_property
    def _factor(self) -> SchurFactor:
        problem, dofs = self.problem, self._sides.dofs
        diagonal = problem.A.getDiagonal()
        springs = diagonal.array_r[dofs] / len(problem.nodes.upper)
        diagonal.destroy()
        return SchurFactor(problem.A.getValuesCSR(), problem.nodes.dim, dofs, springs, oblique_order(problem))

    @cached_property
    def _system(self) -> DenseSystem:
        nodes, at = self.problem.nodes, self._sides.moving
        H = self._sides.to_jumps(self._factor.complement)
        return DenseSystem(H, nodes.weights[at], nodes.frames[at], nodes.held[at], chains_of(self.problem, at))

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
        size = max(problem.equations.scale.least, float(problem.loads.norm()), TINY)
        load = Load(sides.forces(system.H), problem.slip[sides.moving], sides.held_jumps, size)
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
            f"contact: no equilibrium found, residual {history[-1]:.1e} of the forces after {len(history) - 1} steps",
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


class SideDisplacements:
    """Free displacements on both sides of S, and jumps; global axes.

    If supports hold a component on one side, the displacement of the other side is the unknown of this jump component.

    Attributes:
        dofs: (c,) local numbers of the free displacements.
        moving: the nodes with a free component of the jump.
        held_jumps: (moving nodes, d) jump components held on both sides; zero for free components.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, nodes = problem, problem.nodes
        below = nodes.pairs[:, 1:] * nodes.dim + np.arange(nodes.dim)
        self.moving = moving = np.flatnonzero(~nodes.held.all(axis=1))
        self._free = ~nodes.held[moving]
        self._on_rigid = nodes.lower is None
        self._places = nodes.dofs[moving], below[moving]
        self._held = nodes.held_upper[moving], nodes.held_lower[moving]
        self.dofs = np.concatenate([dofs[~held] for dofs, held in zip(self._places, self._held, strict=True)])
        # numbers in `dofs` of the upper and the lower displacement of each free component of the jump
        counts = np.cumsum(np.concatenate([~held.ravel() for held in self._held])) - 1
        upper, lower = (part.reshape(self._free.shape)[self._free] for part in np.split(counts, 2))
        top, bottom = (~held[self._free] for held in self._held)
        self._carrier, self._sign = np.where(top, upper, lower), np.where(top, 1.0, -1.0)
        self._upper, self._lower = upper[top & bottom], lower[top & bottom]
        self._two = np.flatnonzero(top & bottom)

    def to_jumps(self, S: Array) -> Array:
        """Stiffness (n d, n d) of the jumps, from the stiffness S of the free displacements.

        In rows and columns of held components only the diagonal is not zero.
        """
        carrier, sign = self._carrier, self._sign
        H = S
        if not (np.array_equal(carrier, np.arange(len(S))) and (sign > 0).all()):
            H = S[np.ix_(carrier, carrier)] * np.outer(sign, sign)
        if len(self._two):  # eliminate common motions of both sides, which do not change the jump
            rows = S[self._upper] + S[self._lower]
            self._coupling = rows[:, carrier] * sign
            self._together = linalg.cho_factor(rows[:, self._upper] + rows[:, self._lower], lower=True)
            H = H - self._coupling.T @ linalg.cho_solve(self._together, self._coupling)
            H = (H + H.T) / 2
        free = self._free.ravel()
        if free.all():
            return H
        out = np.diag(np.full(len(free), H.diagonal().mean()))
        out[np.ix_(free, free)] = H
        return out

    def take(self, condensed: Array) -> None:
        """Take the condensed forces (c,) and the prescribed displacements of a load."""
        known = self._problem.prescribed.array_r
        self._condensed = condensed
        upper, lower = (known[dofs] for dofs in self._places)
        if self._on_rigid:
            lower = np.zeros_like(upper)
        self.held_jumps = np.where(self._free, 0.0, upper - lower)
        self._shift = (lower - upper)[self._free]  # the unknown displacement, times its sign, less the jump
        self._shift[self._two] = 0.0

    def _lower_forces(self) -> Array:
        return self._condensed[self._upper] + self._condensed[self._lower]

    def forces(self, H: Array) -> Array:
        """Forces on the jumps, (n, d)."""
        g = self._condensed[self._carrier] * self._sign
        if len(self._two):
            g -= self._coupling.T @ linalg.cho_solve(self._together, self._lower_forces())
        out = np.zeros(self._free.shape)
        out[self._free] = g
        if self._shift.any():
            shift = np.zeros_like(out)
            shift[self._free] = self._shift
            out -= (H @ shift.ravel()).reshape(out.shape)
        return np.where(self._free, out, 0.0)

    def displacements(self, w: Array) -> Array:
        """Free displacements (c,) at jumps (n, d)."""
        y = w[self._free] + self._shift
        out = np.zeros(len(self.dofs))
        out[self._carrier] = y * self._sign
        if len(self._two):
            v = linalg.cho_solve(self._together, self._lower_forces() - self._coupling @ y)
            out[self._lower] = v
            out[self._upper] += v
        return out


# ---------------------------------------------------------------- orders of nodes
def chains_of(problem: ContactProblem, moving: np.ndarray) -> Chains:
    """For each piece of S, its moving nodes in order and their arc lengths; [] in three dimensions."""
    nodes, joint = problem.nodes, problem.equations.model.joint
    if nodes.dim != 2:
        return []
    number = np.full(len(joint.points), -1)
    number[nodes.numbers[moving]] = np.arange(len(moving))
    edges = number[joint.table.vertices[joint.surface_rows]]
    edges = edges[(edges >= 0).all(axis=1)]
    graph = scipy.sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(len(moving),) * 2).tocsr()
    graph = graph + graph.T
    count, piece = connected_components(graph, directed=False)
    inside = np.diff(graph.indptr) == 2
    chains = []
    for k in range(count):
        first = np.lexsort((inside, piece != k))[0]  # an end; rings have none
        places = depth_first_order(graph, first, directed=False, return_predecessors=False)
        steps = np.linalg.norm(np.diff(nodes.x[moving][places], axis=0), axis=1)
        chains.append((places, np.concatenate([[0.0], np.cumsum(steps)])))
    return chains


def oblique_order(problem: ContactProblem) -> np.ndarray:
    """Nodes of the bodies in the order of a front that is oblique to S and moves away from it.

    With a Schur complement MUMPS orders by minimum degree and decides ties by the numbers. On grids bad numbers cost twice
    the work; these come close to the best ordering without a complement. The front follows the diagonals of the cells.
    """
    nodes = problem.nodes
    n = problem.A.getSize()[0] // nodes.dim
    x = nodes.surface.V.tabulate_dof_coordinates()[:n, : nodes.dim]
    normal = nodes.weights @ nodes.frames[:, -1]
    size = float(np.linalg.norm(normal))
    normal = np.asarray(normal / size if size > 1e-6 * nodes.weights.sum() else np.eye(nodes.dim)[-1])
    tangents = linalg.null_space(normal[None]).T
    height = (x - nodes.x.mean(axis=0)) @ normal
    key = SLOPE * np.abs(height)
    rows = np.linspace(0, n - 1, min(n, SAMPLE)).astype(int)
    edges = np.concatenate([x[problem.A.getRow(int(r) * nodes.dim)[0][:: nodes.dim] // nodes.dim] - x[r] for r in rows])
    for tangent in tangents:
        lean = np.sign((edges @ tangent) @ (edges @ normal)) or 1.0
        key += lean * np.sign(height) * (x @ tangent)
    return np.argsort(key, kind="stable")
