"""Contact condensed to the nodes of S: Newton's method with Gauss-Seidel sweeps for their displacements. On one rank.

Jumps are no unknowns here: around a junction they depend on each other, and so their condensed stiffness is singular.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from forms.base import Array
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.balance import ALLOWED, TINY, ForceScale
from thinlayer.solving.contact.condensation import Condensation, FactorError
from thinlayer.solving.contact.finder import ContactFinder
from thinlayer.solving.contact.pairs import Pairs
from thinlayer.solving.equations import Equations

TOLERANCE = 1e-11  # residual at which Newton's method stops, relative to the forces
STALLED = 1e-9  # residual, relative to the forces, that is accepted if Newton steps do not reduce it
SUMMATION = 10.0  # rounding of the condensed stiffness, relative to that of its largest entry, per sqrt(node)
SWEEPS = 4  # number of sweeps before each of the first Newton steps
PATIENCE = 6  # number of Newton steps after which the sweeps double with every step, and steps may be shortened
MOST_SWEEPS = 32  # largest number of sweeps before a Newton step
MOST_STEPS = 30
TRIALS = 12  # largest number of trials of a step's length
FLAT = 0.1  # work along a step at its end, relative to that at its beginning, that ends the search of its length


class Condensed(ContactFinder):
    """The finder for one seam or a network of them, any number of which meet.

    The bodies are condensed to the displacements of all nodes in contact, body by body, once. Newton's method then solves
    the small system. Gauss-Seidel sweeps, node by node with all pairs of a node, precede each of its steps, more of them as
    steps go on. Later steps are shortened if the forces do work against their ends: first ones may let residuals grow.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        super().__init__(equations, like)
        held = np.zeros(self.x.getLocalSize(), bool)
        held[equations.held] = True
        self.pairs = Pairs(self.parts, held)

    @cached_property
    def _condensation(self) -> Condensation:
        """The bodies, condensed to the displacements of nodes in contact; held ones are decoupled."""
        pairs, model = self.pairs, self.equations.model
        x, bodies = model.V.tabulate_dof_coordinates()[:, : pairs.d], int(model.splitting.pieces.max()) + 1
        return Condensation(self.A.getValuesCSR(), pairs.dofs, x, pairs.weights @ pairs.frames[:, -1], bodies)

    @cached_property
    def _blocks(self) -> scipy.sparse.bsr_matrix:
        """The condensed stiffness as sweeps read it."""
        A, d, n = self._condensation.stiffness, self.pairs.d, len(self.pairs.nodes)
        if not isinstance(A, np.ndarray):
            return A.tobsr((d, d))
        blocks = A.reshape(n, d, n, d).swapaxes(1, 2).reshape(-1, d, d)
        return scipy.sparse.bsr_matrix((blocks, np.tile(np.arange(n), n), np.arange(n + 1) * n))

    @cached_property
    def _scale(self) -> ForceScale:
        stiffness, springs = self._condensation.stiffness, self.pairs.bonded()[0]
        largest = max(float(one.diagonal().max(initial=0.0)) for one in (stiffness, springs))
        return ForceScale(SUMMATION * math.sqrt(len(self.pairs.nodes)) * largest)

    def solve(self, known: bool) -> tuple[int, float]:
        """As in `ContactFinder`."""
        equations, pairs, b = self.equations, self.pairs, self.b.array_r
        try:
            condensation = self._condensation
        except FactorError as error:
            held = "is every body supported, or does it meet S in more than a point?"
            raise SolveError(f"contact: {error}; {held}") from error
        g = condensation.condense(b)
        size = max(equations.scale.least, equations.free_norm(equations.external), TINY)
        u = self.x.array_r[pairs.dofs].copy()
        if not known:
            springs, forces = pairs.bonded()
            u = self._linear_solve(springs, g - forces)
        u, residuals = self._newton(u, g, size)
        condensation.expand(b, u, self.x.array)
        self.x.array[equations.held] = equations.prescribed
        relative = self.relative_residual()
        if not relative <= ALLOWED:
            large = f"contact: the residual of the whole problem is {relative:.1e} of the forces"
            raise SolveError(large, residuals=residuals)
        return len(residuals) - 1, relative

    def _residual(self, u: Array, g: Array) -> Array:
        """Forces of bodies and pairs, less g; zero at held displacements."""
        pairs = self.pairs
        return np.asarray(self._condensation.stiffness @ u + pairs.forces(pairs.apart(u)) - g)

    def _linear_solve(self, more: scipy.sparse.csr_matrix, b: Array) -> Array:
        """x with (stiffness + more) x = b; not finite if the matrix is singular."""
        A = self._condensation.stiffness
        try:
            if isinstance(A, np.ndarray):
                return np.linalg.solve(A + more.toarray(), b)
            return np.asarray(splu((A + more).tocsc(), permc_spec="MMD_AT_PLUS_A").solve(b))
        except (np.linalg.LinAlgError, RuntimeError):
            return np.full(len(b), np.nan)

    def _newton(self, u: Array, g: Array, size: float) -> tuple[Array, tuple[float, ...]]:
        """Displacements, from u, and the residuals before each Newton step and after the last, relative to the forces."""
        residuals, pairs = list[float](), self.pairs
        while True:
            forces = pairs.forces(pairs.apart(u))
            r = self._condensation.stiffness @ u + forces - g
            residuals.append(float(np.linalg.norm(r)) / max(size, float(np.linalg.norm(forces))))
            if self._ends(residuals, u, size):
                return u, tuple(residuals)
            if len(residuals) > MOST_STEPS or not math.isfinite(residuals[-1]):
                raise SolveError(
                    f"contact: residual {residuals[-1]:.1e} of the forces after {len(residuals) - 1} Newton steps",
                    residuals=tuple(residuals),
                    advice="is every body supported, or pressed against S? Else try smaller load steps",
                )
            u = u.copy()
            pairs.sweep(self._blocks, g, u, min(SWEEPS * 2 ** max(len(residuals) - PATIENCE, 0), MOST_SWEEPS))
            step = self._linear_solve(pairs.tangent(pairs.apart(u)), -self._residual(u, g))
            u = u + (self._length(u, step, g) if len(residuals) > PATIENCE else 1.0) * step

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
            return float(step @ self._residual(u + a * step, g))

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
        """Free matrices, vectors and factors."""
        super().close()
        if "_condensation" in vars(self):
            self._condensation.close()
