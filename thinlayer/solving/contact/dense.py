"""Newton's method for the jumps on S with a dense stiffness matrix, Gauss-Seidel sweeps and coarser chains."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy import sparse

from forms.base import Array
from forms.contact import ContactLaw
from geometry.topology import BoolArray
from thinlayer.solving.balance import ALLOWED, ForceScale
from thinlayer.solving.contact.gauss_seidel import Sliding, sliding, sweep_nodes, turned
from thinlayer.solving.petsc import PREFIX, OptionValue, defaults

Chains = list[tuple[np.ndarray, Array]]  # of each piece of S its nodes, and their arc lengths
NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # the residual may grow on the way to a solution, which line searches prevent
    "snes_max_it": 30,
    "dense_ksp_type": "preonly",
    "dense_pc_type": "lu",
}
COARSE = "coarse_"  # prefix of the options of Newton's method on coarse chains
SWEEPS = 2  # number of sweeps before each of the first Newton steps
PATIENCE = 6  # number of Newton steps after which the sweeps double with every step, and a prediction is given up
MOST_SWEEPS = 256  # largest number of sweeps before a Newton step
COARSEST = 48  # largest number of nodes of a chain that is not coarsened
COARSE_TOLERANCE = 1e-3  # residual of solutions on coarse chains, relative to the forces
STALLED = 1e-9  # residual, relative to the forces, that is accepted if Newton steps do not reduce it
SUMMATION = 10.0  # rounding of the condensed stiffness, relative to the rounding of its largest entry, per sqrt(node)


@dataclass(frozen=True)
class Load:
    """A load on the nodes.

    Attributes:
        g: (n, d) forces.
        slip: (n, d - 1) slip at the beginning of the step.
        held_jumps: (n, d) held components of the jump; zero for free components.
        size: norm of the loads, those of given strains included: bodies may shrink until no other forces are left.
    """

    g: Array
    slip: Array
    held_jumps: Array
    size: float


class DenseSystem:
    """H w + weights frames^T t(frames w) = g for the jumps w of n nodes, (n, d) in global axes, and its coarser versions.

    Attributes:
        H: (n d, n d) stiffness, symmetric.
        held: (n, d) components that are held.
        chains: for each piece of S in two dimensions, its nodes in order and their arc lengths.
        converged: whether the last run of Newton's method converged.
    """

    def __init__(
        self, H: Array, weights: Array, frames: Array, held: BoolArray, chains: Chains, prefix: str = ""
    ) -> None:
        self.H, self.weights, self.frames, self.held, self.chains = H, weights, frames, held, chains
        self.n, self.d = held.shape
        self.converged = False
        self._moves: BoolArray = np.asarray(~held.any(axis=1))
        self._base = np.zeros((self.n, self.d))
        self._axes = weights[:, None, None] * frames  # from tractions to nodal forces
        nodes = np.arange(self.n * self.d).reshape(self.n, self.d)
        self._rows, self._columns = np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :])
        self._prefix = prefix
        self._snes: PETSc.SNES | None = None
        self._size = 0.0  # norm of the last contact forces
        self._at: Sliding | None = None  # sliding state at the last tangents

    # ---------------------------------------------------------------- law
    def _forces(self, law: ContactLaw, slip: Array, w: Array) -> Array:
        t = law.traction(np.einsum("nij,nj->ni", self.frames, w), slip)
        out: Array = np.einsum("nij,ni->nj", self._axes, t)
        out[self.held] = 0.0
        self._size = float(np.linalg.norm(out))
        return out

    def _stiffness(self, law: ContactLaw, slip: Array, local: Array) -> Array:
        """Nodal tangents (n, d, d) at jumps in the nodes' frames."""
        out: Array = self._axes.transpose(0, 2, 1) @ law.tangent(local, slip) @ self.frames
        out[self.held] = 0.0
        return out

    def residual(self, law: ContactLaw, load: Load, w: Array) -> Array:
        """Residual, (n, d), zero at held components."""
        out = (self.H @ w.ravel()).reshape(w.shape)
        out += self._forces(law, load.slip, w)
        out -= load.g
        out[self.held] = 0.0
        return out

    def bonded(self, law: ContactLaw, load: Load) -> Array:
        """Jumps with bonded springs, which neither open nor slide."""
        local = np.zeros((self.n, self.d))
        local[:, :-1], local[:, -1] = load.slip, -1.0
        D = self._stiffness(law, load.slip, local)
        rest = local.copy()
        rest[:, -1] = 0.0
        M = self.H.copy()
        M[self._rows, self._columns] += D
        g = load.g + np.einsum("nij,nj->ni", D, np.einsum("nij,ni->nj", self.frames, rest))
        w = np.linalg.solve(M, g.ravel()).reshape(g.shape)
        return np.where(self.held, load.held_jumps, w)

    # ---------------------------------------------------------------- Newton's method
    def newton(
        self, law: ContactLaw, load: Load, w: Array, tolerance: float, history: list[float], *, few: bool = False
    ) -> int:
        """Run Newton's method from w, in place; returns the number of steps. `history` gets the relative residuals."""
        if self._snes is None:
            self._snes = self._create()
            self._most = self._snes.getTolerances()[3]
        self._snes.setTolerances(max_it=min(PATIENCE, self._most) if few else self._most)
        self._law, self._load, self._tolerance, self._history = law, load, tolerance, history
        snes, x = self._snes, self._x
        x.array.reshape(w.shape)[:] = w
        try:
            snes.solve(None, x)
            self.converged = snes.getConvergedReason() > 0
        except PETSc.Error as error:  # a singular tangent
            if error.__cause__ is not None:  # an error in one of the callbacks
                self.destroy()
                raise error.__cause__ from None
            self.converged = False
        w[:] = x.array_r.reshape(w.shape)
        steps = int(snes.getIterationNumber())
        if not np.isfinite(w).all():
            self.converged = False
        if not self.converged:
            self.destroy()  # the SNES may have stopped in the middle of a step
        return steps

    def _create(self) -> PETSc.SNES:
        size = self.n * self.d
        self._x, self._f = (PETSc.Vec().createSeq(size, comm=PETSc.COMM_SELF) for _ in range(2))
        self._tangent = np.empty((size, size))
        self._J = PETSc.Mat().createDense((size, size), array=self._tangent.T, comm=PETSc.COMM_SELF)
        snes = PETSc.SNES().create(PETSc.COMM_SELF)
        snes.setOptionsPrefix(PREFIX + self._prefix)
        snes.getKSP().setOptionsPrefix(PREFIX + self._prefix + "dense_")
        snes.setFunction(self._function, self._f)
        snes.setJacobian(self._jacobian, self._J)
        snes.setUpdate(self._count_sweeps)
        snes.setConvergenceTest(self._test)
        snes.setNGS(self._sweep)
        snes.setNPCSide(PETSc.PC.Side.RIGHT)
        self._sweeps = snes.getNPC()
        self._sweeps.setType("ngs")
        self._sweeps.setNormSchedule(PETSc.SNES.NormSchedule.FINAL_ONLY)
        with defaults({self._prefix + name: value for name, value in NEWTON.items()}):
            snes.setFromOptions()
        return snes

    def _function(self, _: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        f.array[:] = self.residual(self._law, self._load, x.array_r.reshape(self.n, self.d)).ravel()

    def _jacobian(self, _: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, __: PETSc.Mat) -> None:
        local = np.einsum("nij,nj->ni", self.frames, x.array_r.reshape(self.n, self.d))
        D = self._stiffness(self._law, self._load.slip, local)
        self._at = sliding(self._law, local, self._load.slip)
        self._tangent[:] = self.H
        self._tangent[self._columns, self._rows] += D  # the array is the transpose of PETSc's matrix
        J.assemble()

    def _count_sweeps(self, _: PETSc.SNES, step: int) -> None:
        """Set the number of sweeps before a Newton step; it doubles after PATIENCE steps, which often go in circles."""
        count = min(SWEEPS * 2 ** max(step - PATIENCE, 0), MOST_SWEEPS) if self._law.numbers else 0
        self._sweeps.setTolerances(max_it=count)
        if not step:
            self._at = None

    def _sweep(self, _: PETSc.SNES, x: PETSc.Vec, __: PETSc.Vec | None) -> None:
        """A Gauss-Seidel sweep, in place; nodes whose slip has reversed stick in all sweeps before a step."""
        load, numbers = self._load, self._law.numbers
        assert numbers is not None
        w = x.array.reshape(self.n, self.d)
        if not self._sweeps.getIterationNumber():
            local = np.einsum("nij,nj->ni", self.frames, w)
            turn = turned(self._law, local, load.slip, self._at)
            turn[~self._moves] = 0.0
            w += np.einsum("nji,nj->ni", self.frames, turn)
            self._swept = self._moves & ~turn.any(axis=1)
        sides = self._base, self.frames, self.weights, numbers
        sweep_nodes(self.H, load.g, w, *sides, slip=load.slip, moves=self._swept)

    @cached_property
    def _scale(self) -> ForceScale:
        return ForceScale(SUMMATION * math.sqrt(self.n) * float(self.H.diagonal().max()))

    def _test(self, snes: PETSc.SNES, step: int, norms: tuple[float, float, float]) -> Any:
        history = self._history
        history.append(norms[2] / max(self._load.size, self._size))
        if not math.isfinite(norms[2]):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if history[-1] <= self._tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS
        if step > 1 and history[-1] > history[-2] / 2:
            largest = float(snes.getSolution().norm(PETSc.NormType.INFINITY))
            forces = max(self._load.size, self._size)
            rounding = self._scale.rounding(largest) / forces  # large for soft or stiff springs
            if history[-1] <= max(STALLED, min(rounding, ALLOWED)):
                return PETSc.SNES.ConvergedReason.CONVERGED_SNORM_RELATIVE
        return False

    # ---------------------------------------------------------------- coarser chains
    @cached_property
    def coarse(self) -> DenseSystem | None:
        """The system on every second node of the chains; None if there are no chains or only a few nodes."""
        if not self.chains or self.n <= COARSEST:
            return None
        rows, columns, shares, kept = [], [], [], []
        chains: Chains = []
        count = 0
        for nodes, s in self.chains:
            stays = np.zeros(len(nodes), bool)
            stays[::2] = stays[-1] = True
            stays |= ~self._moves[nodes]
            c = np.flatnonzero(stays)
            left = np.clip(np.cumsum(stays) - 1, 0, max(len(c) - 2, 0))
            right = np.minimum(left + 1, len(c) - 1)
            length = s[c[right]] - s[c[left]]
            t = np.divide(s - s[c[left]], length, out=np.zeros(len(s)), where=length > 0)
            rows += [nodes, nodes]
            columns += [count + left, count + right]
            shares += [1 - t, t]
            kept.append(nodes[c])
            chains.append((count + np.arange(len(c)), s[c]))
            count += len(c)
        if count == self.n:
            return None
        d, place = self.d, np.arange(self.d)
        i, j, t = (np.concatenate(parts) for parts in (rows, columns, shares))
        entries = np.repeat(t, d), ((i[:, None] * d + place).ravel(), (j[:, None] * d + place).ravel())
        self._P = P = sparse.csr_matrix(entries, shape=(self.n * d, count * d))
        P.eliminate_zeros()
        self._R = R = P.T.tocsr()
        self._kept = k = np.concatenate(kept)
        H = np.ascontiguousarray(R @ (R @ self.H).T)
        held = self.held[k].ravel()
        if held.any():
            H[held], H[:, held] = 0.0, 0.0
            H[held, held] = H.diagonal().max()
        weights: Array = np.bincount(j, t * self.weights[i], count).astype(float)
        return DenseSystem(H, weights, self.frames[k], self.held[k], chains, COARSE)

    def nested(self, law: ContactLaw, load: Load) -> Array:
        """Jumps to start from: the solution of the coarse system, found in the same way."""
        coarse = self.coarse
        if coarse is None:
            return self.bonded(law, load)
        g = (self._R @ load.g.ravel()).reshape(coarse.n, self.d)
        on_coarse = Load(g, load.slip[self._kept], load.held_jumps[self._kept], load.size)
        w = coarse.nested(law, on_coarse)
        coarse.newton(law, on_coarse, w, COARSE_TOLERANCE, [])
        if not coarse.converged:
            return self.bonded(law, load)
        return np.where(self.held, load.held_jumps, (self._P @ w.ravel()).reshape(self.n, self.d))

    def destroy(self) -> None:
        """Free the solver and those of the coarser systems."""
        if self._snes is not None:
            for thing in (self._snes, self._sweeps, self._J, self._x, self._f):
                thing.destroy()
            self._snes = None
        if vars(self).get("coarse") is not None:
            assert self.coarse is not None
            self.coarse.destroy()
