"""Contact condensed to S: one factorisation, then Newton's method with Gauss-Seidel sweeps on a small dense system."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc
from scipy import linalg, sparse

from forms.contact import ContactLaw
from thinlayer.contact.gauss_seidel import sweep_nodes
from thinlayer.contact.nodes import Array, ContactNodes
from thinlayer.contact.problem import ContactProblem
from thinlayer.contact.schur import FactorError, SchurFactor
from thinlayer.failure import SolveError
from thinlayer.options import PREFIX, OptionValue, defaults

Indices = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]

NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # the residual may grow on the way to a solution: searches that want less get stuck
    "snes_max_it": 30,
    "dense_ksp_type": "preonly",
    "dense_pc_type": "lu",
}
COARSE = "coarse_"  # before the options of Newton's method on coarse chains
SWEEPS = 2  # before every Newton step
PATIENCE = 6  # steps from a prediction; after as many the sweeps double with every step
MOST_SWEEPS = 256
COARSEST = 48  # nodes of chains that are not coarsened any more
ROUGH = 1e-3  # tolerance on coarse chains, whose solution is a start
TOLERANCE = 1e-11  # of Newton's method, over the forces
LARGEST_RESIDUAL = 1e-9
RAMP = (0.1, 0.3, 0.6, 1.0)  # of stiffness and friction, where Newton's method fails at once
SLOPE = 1.2  # against S of the front that sweeps over the nodes in the order of their numbers
SAMPLE = 64  # nodes whose edges are looked at


class Condensed:
    """Solves contact problems, one load after the other, by Newton's method for the jumps on S. Serial.

    A Cholesky factorisation condenses the bodies to their displacements at S, and algebra there to the jumps, whose
    matrix is dense: for two dimensions and narrow S. Newton's method (SNES, with the unsymmetric tangent of friction)
    starts from the same law on a chain with half as many nodes, which starts likewise, or from a prediction. Sweeps of
    Gauss-Seidel, node by node, come before each of its steps. The factor is kept until `close`.

    Args:
        problem: its matrix is read at the first `solve`, its loads and slip at every one.

    Raises:
        ValueError: several processes, or no free displacement on S.
    """

    def __init__(self, problem: ContactProblem) -> None:
        if problem.comm.size > 1:
            raise ValueError("the condensed contact solver is serial; use another one on several processes")
        self.problem, self.law = problem, problem.law
        self._sides = _Sides(problem)
        if not len(self._sides.dofs):
            raise ValueError("supports hold every displacement on S: nothing is left for contact")

    @cached_property
    def _factor(self) -> SchurFactor:
        problem, dofs = self.problem, self._sides.dofs
        diagonal = problem.A.getDiagonal()
        springs = diagonal.array_r[dofs] / len(problem.nodes.upper)
        diagonal.destroy()
        return SchurFactor(problem.A, problem.nodes.dim, dofs, springs, _oblique(problem))

    @cached_property
    def _system(self) -> _System:
        nodes, moving = self.problem.nodes, self._sides.moving
        H = self._sides.to_jumps(self._factor.take_complement())
        return _System(H, nodes.weights[moving], nodes.frames[moving], nodes.held[moving], _chains(nodes, moving))

    def solve(self, start: Array | None) -> tuple[PETSc.Vec, int, list[float]]:
        """Equilibrium under the problem's loads.

        Args:
            start: (n, d) jumps to start from, in the nodes' frames, a length; None: no prediction.

        Returns:
            Displacements, a new vector; number of Newton steps; the residual over the forces before each step and after
            the last, and at the end that of the displacements in the problem itself.

        Raises:
            SolveError: no convergence, as where there is no equilibrium; it has the residuals.
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
        u, r = problem.b.duplicate(), problem.b.duplicate()
        u.array[:] = self._factor.expand(b, condensed, sides.displacements(w))
        history.append(problem.residual(u, r))
        r.destroy()
        if not history[-1] <= LARGEST_RESIDUAL:
            u.destroy()
            raise self._failure(history)
        return u, steps, history

    def _find(self, system: _System, start: Array | None, history: list[float]) -> tuple[Array, int]:
        """Jumps of the moving nodes in global axes, and the number of Newton steps to them."""
        sides, problem = self._sides, self.problem
        load = _Load(sides.forces(system.H), problem.slip[sides.moving], sides.held_jumps, problem.least)
        steps = 0
        for law, w, few in self._starts(system, load, start):
            steps += system.newton(law, load, w, TOLERANCE, history, few=few)
            if system.converged and law is self.law:
                return w, steps
        raise self._failure(history)

    def _starts(self, system: _System, load: _Load, start: Array | None) -> Iterator[tuple[ContactLaw, Array, bool]]:
        """Laws, jumps to start from, and whether they deserve a few steps only, in turn, until the law itself converges."""
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
            "steps; is every body supported, or pressed against S rather than pulled off it? Else try smaller load "
            "steps, or another solver",
            residuals=tuple(history),
        )

    def close(self) -> None:
        """Free the factor."""
        for name, free in (("_factor", SchurFactor.close), ("_system", _System.destroy)):
            if (thing := vars(self).pop(name, None)) is not None:
                free(thing)


class _Sides:
    """Free displacements on both sides of S, and jumps; global axes.

    Where a component of the jump has a side that is held, the displacement of the other one stands for it.

    Attributes:
        dofs: (c,) the free displacements, local.
        moving: the nodes that have a free component of the jump.
        held_jumps: (moving nodes, d) the jump where both sides are held, else zero.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, nodes = problem, problem.nodes
        below = np.zeros_like(nodes.dofs)
        if nodes.lower is not None:
            below = nodes.lower.getValuesCSR()[1].astype(np.int32).reshape(below.shape)
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
        """Stiffness of the jumps, (n d, n d), from that of the free displacements; held components are left out: only the
        diagonal of their rows and columns is not zero."""
        carrier, sign = self._carrier, self._sign
        H = S
        if not (np.array_equal(carrier, np.arange(len(S))) and (sign > 0).all()):
            H = S[np.ix_(carrier, carrier)] * np.outer(sign, sign)
        if len(self._two):  # with the jump kept, both sides move by what the lower one does
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
        self._shift = (lower - upper)[self._free]  # from a jump to the displacement that stands for it, signed
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


@dataclass(frozen=True)
class _Load:
    """Forces g on the nodes (n, d), slip (n, d - 1), held components of the jump (n, d; else zero), size of the loads."""

    g: Array
    slip: Array
    held_jumps: Array
    size: float


class _System:
    """H w + weights frames^T t(frames w) = g for the jumps w of n nodes, (n, d) in global axes, and its coarser versions.

    Attributes:
        H: (n d, n d) stiffness, symmetric.
        held: (n, d) components that stay.
        chains: of each piece of S in two dimensions, the nodes along it and their arc lengths.
        converged: what Newton's method did last.
    """

    def __init__(
        self, H: Array, weights: Array, frames: Array, held: Mask, chains: list[tuple[Indices, Array]], prefix: str = ""
    ) -> None:
        self.H, self.weights, self.frames, self.held, self.chains = H, weights, frames, held, chains
        self.n, self.d = held.shape
        self.converged = False
        self._moves: Mask = np.asarray(~held.any(axis=1))
        self._base = np.zeros((self.n, self.d))
        self._axes = weights[:, None, None] * frames  # of forces
        nodes = np.arange(self.n * self.d).reshape(self.n, self.d)
        self._rows, self._columns = np.broadcast_arrays(nodes[:, :, None], nodes[:, None, :])
        self._prefix = prefix
        self._snes: PETSc.SNES | None = None
        self._size = 0.0  # of the contact forces

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

    def residual(self, law: ContactLaw, load: _Load, w: Array) -> Array:
        """Out of balance, (n, d)."""
        out = (self.H @ w.ravel()).reshape(w.shape)
        out += self._forces(law, load.slip, w)
        out -= load.g
        out[self.held] = 0.0
        return out

    def bonded(self, law: ContactLaw, load: _Load) -> Array:
        """Jumps with springs that pull as well as they press, and do not slide."""
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
        self, law: ContactLaw, load: _Load, w: Array, tolerance: float, history: list[float], *, few: bool = False
    ) -> int:
        """Newton's method from w on, in place; number of steps. Appends the residuals over the forces to the history."""
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
        except PETSc.Error:  # a singular tangent
            self.converged = False
        w[:] = x.array_r.reshape(w.shape)
        steps = int(snes.getIterationNumber())
        if not np.isfinite(w).all():
            self.converged = False
        if not self.converged:
            self.destroy()  # which may be left in the middle of a step
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
        snes.setUpdate(self._sweep)
        snes.setConvergenceTest(self._test)
        with defaults({self._prefix + name: value for name, value in NEWTON.items()}):
            snes.setFromOptions()
        return snes

    def _function(self, _: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        f.array[:] = self.residual(self._law, self._load, x.array_r.reshape(self.n, self.d)).ravel()

    def _jacobian(self, _: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, __: PETSc.Mat) -> None:
        local = np.einsum("nij,nj->ni", self.frames, x.array_r.reshape(self.n, self.d))
        D = self._stiffness(self._law, self._load.slip, local)
        self._tangent[:] = self.H
        self._tangent[self._columns, self._rows] += D  # PETSc's matrix is the transposed one
        J.assemble()

    def _sweep(self, snes: PETSc.SNES, step: int) -> None:
        """Gauss-Seidel before a Newton step, which takes the state and its residual from here."""
        if (numbers := self._law.numbers) is None:
            return
        # Where Newton's steps go in circles, more sweeps come closer to where they converge.
        sweeps = min(SWEEPS * 2 ** max(step - PATIENCE, 0), MOST_SWEEPS)
        x, load = snes.getSolution(), self._load
        w = x.array.reshape(self.n, self.d)
        sweep_nodes(
            self.H, load.g, w, self._base, self.frames, self.weights, numbers,
            slip=load.slip, moves=self._moves, sweeps=sweeps,
        )  # fmt: skip
        self._function(snes, x, snes.getFunction()[0])

    def _test(self, _: PETSc.SNES, step: int, norms: tuple[float, float, float]) -> Any:
        history = self._history
        history.append(norms[2] / max(self._load.size, self._size))
        if not math.isfinite(norms[2]):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if history[-1] <= self._tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS
        if step > 1 and history[-1] <= LARGEST_RESIDUAL and history[-1] > history[-2] / 2:
            return PETSc.SNES.ConvergedReason.CONVERGED_SNORM_RELATIVE  # rounding
        return False

    # ---------------------------------------------------------------- coarser chains
    @cached_property
    def coarse(self) -> _System | None:
        """The system on every second node of the chains; None where there are no chains, or few nodes."""
        if not self.chains or self.n <= COARSEST:
            return None
        rows, columns, shares, kept = [], [], [], []
        chains: list[tuple[Indices, Array]] = []
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
        return _System(H, weights, self.frames[k], self.held[k], chains, COARSE)

    def nested(self, law: ContactLaw, load: _Load) -> Array:
        """Jumps to start from: those of the coarse system, which starts likewise."""
        coarse = self.coarse
        if coarse is None:
            return self.bonded(law, load)
        g = (self._R @ load.g.ravel()).reshape(coarse.n, self.d)
        on_coarse = _Load(g, load.slip[self._kept], load.held_jumps[self._kept], load.size)
        w = coarse.nested(law, on_coarse)
        coarse.newton(law, on_coarse, w, ROUGH, [])
        if not coarse.converged:
            return self.bonded(law, load)
        return np.where(self.held, load.held_jumps, (self._P @ w.ravel()).reshape(self.n, self.d))

    def destroy(self) -> None:
        """Free the solver, of the coarser systems too."""
        if self._snes is not None:
            for thing in (self._snes, self._J, self._x, self._f):
                thing.destroy()
            self._snes = None
        if vars(self).get("coarse") is not None:
            assert self.coarse is not None
            self.coarse.destroy()


def _chains(nodes: ContactNodes, moving: Indices) -> list[tuple[Indices, Array]]:
    """The moving nodes along each piece of S, with their arc lengths; none in three dimensions."""
    if nodes.dim != 2:
        return []
    joint = nodes.model.joint
    number = dict(zip(nodes.numbers[moving].tolist(), range(len(moving)), strict=True))
    neighbours: list[list[int]] = [[] for _ in number]
    edges: list[list[int]] = joint.table.vertices[joint.surface_rows].tolist()  # type: ignore[assignment]
    for a, b in edges:
        if a in number and b in number:
            neighbours[number[a]].append(number[b])
            neighbours[number[b]].append(number[a])
    x, chains = nodes.x[moving], []
    left = set(range(len(moving)))
    ends = [k for k, near in enumerate(neighbours) if len(near) != 2]
    for first in [*ends, *range(len(moving))]:  # rings have no ends
        if first not in left:
            continue
        left.discard(first)
        chain, here = [first], first
        while (following := next((k for k in neighbours[here] if k in left), None)) is not None:
            left.discard(following)
            chain.append(following)
            here = following
        places = np.array(chain)
        steps = np.linalg.norm(np.diff(x[places], axis=0), axis=1)
        chains.append((places, np.concatenate([[0.0], np.cumsum(steps)]).astype(float)))
    return chains


def _oblique(problem: ContactProblem) -> Indices:
    """Nodes of the bodies in an order whose numbers follow a front oblique to S, away from it.

    MUMPS's minimum degree, its ordering beside a Schur complement, decides between equals by their numbers: on grids a bad
    order costs twice the work, and this one comes close to the best ordering without a complement. The front goes along
    the diagonals of the cells.
    """
    nodes = problem.nodes
    n = problem.A.getSize()[0] // nodes.dim
    x = nodes.model.V.tabulate_dof_coordinates()[:n, : nodes.dim]
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
