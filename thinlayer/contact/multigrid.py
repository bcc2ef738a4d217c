"""Contact on a wide S, in three dimensions and on several ranks: Newton's method, Krylov, one multigrid hierarchy."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from petsc4py import PETSc

from forms.contact import ContactLaw, LawError, Status
from thinlayer.contact.gauss_seidel import BlockRows, load, sweep_nodes
from thinlayer.contact.nodes import Array
from thinlayer.contact.problem import ContactProblem
from thinlayer.failure import SolveError
from thinlayer.linear_solvers import DIRECT, MULTIGRID
from thinlayer.options import PREFIX, OptionValue, defaults, is_set

Shares = tuple[float, float]  # of the residual, that the first and the later linear solves leave

TOLERANCE = 1e-9  # of the true residual, over the forces
LOOSE: Shares = (0.3, 0.2)  # the status is far off
STRICT: Shares = (0.02, 0.05)  # a prediction is not; and the last attempt
EXPECTED = 3.0  # times what the linear solve has left: the residual of a Newton step that the tangent has foreseen
FINISH = 0.7  # share of the tolerance that the last linear solve aims at
SWEEPS = 4  # of Gauss-Seidel, before a Newton step that goes on from what the tangent has not foreseen
CLIP_NORMAL, CLIP_TANGENTIAL = 30.0, 1.0  # stiffest springs in the hierarchy, times E/h
FLOOR = 1e-3  # softest springs in the hierarchy, times E/h: they hold a body that nothing else holds
DIAGONAL = 3.0  # of the stiffness at a node of S over its area times E/h, at most about
STOP = 1e6  # stiffness that keeps held components in place during sweeps, over that of the node

HIERARCHY: dict[str, OptionValue] = {k: v for k, v in MULTIGRID.items() if k not in (*DIRECT, "ksp_max_it")}
NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # the residual grows on good steps, as springs of S are stiff
    "snes_max_it": 50,
    "snes_divergence_tolerance": -1,
    "snes_max_linear_solve_fail": 4,
    "ksp_type": "fgmres",  # GMRES on the right has one more cycle of multigrid, to form the solution
    "ksp_gmres_restart": 40,
    "ksp_max_it": 120,
}


class MultigridContact:
    """Solves contact problems, one load after the other: SNES, FGMRES and one algebraic multigrid hierarchy. Collective.

    The hierarchy is that of the bodies with springs on S, symmetric and clipped; it is built in the first solve and kept
    until `close`. FGMRES sees the exact tangent, unsymmetric where S slides; its preconditioner is a cycle of multigrid and
    then an exact solve of the nodes of S on a rank. Sweeps of Gauss-Seidel over the nodes of S, each rank its own, come
    before a Newton step whose status is new.

    PETSc options are read under our prefix: snes_ and ksp_ are those of Newton's method, pc_ and mg_ those of the
    hierarchy; the linear tolerances are ours unless ksp_rtol is set.

    Args:
        problem: its matrix is read here, its loads and slip at every `solve`.
        tolerance: of the true residual of the law, over the forces.

    Raises:
        LawError: a law that sweeps do not know.
    """

    def __init__(self, problem: ContactProblem, tolerance: float = TOLERANCE) -> None:
        if problem.law.numbers is None:
            raise LawError(f"{type(problem.law).__name__} is not among the laws that Gauss-Seidel sweeps know")
        load(problem.comm)
        self.problem, self.tolerance = problem, tolerance
        self._surface = _Surface(problem)
        self._tangent: _Tangent | None = None
        self._u = problem.A.createVecRight()
        self._solved = False

    def solve(self, start: Array | None = None) -> tuple[PETSc.Vec, int, list[float]]:
        """Displacements that balance the loads.

        Args:
            start: (n, d) expected jumps in the nodes' frames, lengths: those of the last load or of a similar model. With
                them Newton's method goes on from the last solution, without them from bonded nodes and no displacement.

        Returns:
            Displacements, valid until the next `solve` or `close`; number of Newton steps; residual over the forces at
            first and after each step.

        Raises:
            SolveError: no convergence, as when there is no equilibrium.
        """
        history: list[float] = []
        with defaults({**HIERARCHY, **NEWTON}):
            if self._tangent is None:
                self._tangent = _Tangent(self._surface, start)
            else:
                _count_as_read(("pc_", "mg_"))
            attempts = [(None, LOOSE), (None, STRICT)] if start is None else [(start, STRICT), (None, LOOSE)]
            for guess, shares in attempts:
                newton = _Newton(self._tangent, self.tolerance, shares)
                if guess is None or not self._solved:
                    self._u.set(0.0)
                reason = newton.run(self._u, guess)
                history += newton.residuals
                self._solved = reason > 0
                if self._solved:
                    return self._u, len(newton.residuals) - 1, history
        names = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}
        raise SolveError(
            f"Newton's method for contact failed after {len(history) - 2} steps: {names.get(reason, reason)}, residual "
            f"{history[-1]:.1e} of the forces; a body that is pulled off S, or pushed harder than friction holds, needs "
            f"supports; else try smaller steps of the load, or -{PREFIX}snes_monitor to watch it",
            residuals=tuple(history),
        )

    def close(self) -> None:
        """Free vectors, matrices and the hierarchy."""
        if self._tangent is not None:
            self._tangent.close()
            self._tangent = None
        self._surface.close()
        self._u.destroy()


class _Surface:
    """The stiffness at this rank's nodes of S, upper side.

    Attributes:
        rows: its rows there, (n d, all).
        blocks: between these nodes; held components are decoupled.
        diagonal: (n,) which of the blocks are a node's own.
        scale: (n,) E/h, about: Young's modulus over the size of the cells.
        free: (n, d) components that are not held.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem, self.nodes = problem, problem.nodes
        A, d, n = problem.A, self.nodes.dim, len(self.nodes.upper)
        first, end = A.getOwnershipRange()
        dofs = self.nodes.dofs.ravel()
        index = PETSc.IS().createGeneral((first + dofs).astype(PETSc.IntType), comm=problem.comm)
        self.rows = A.createSubMatrix(index, None)
        index.destroy()
        self._product = self.rows.createVecLeft()
        place = np.full(end - first, -1, np.int64)
        place[dofs] = np.arange(n * d)
        indptr, columns, values = self.rows.getValuesCSR()
        local = (columns >= first) & (columns < end)
        column = np.full(len(columns), -1, np.int64)
        column[local] = place[columns[local] - first]
        here = column >= 0
        row = np.repeat(np.arange(n * d), np.diff(indptr))
        self._stiffness = scipy.sparse.csr_matrix((values[here], (row[here], column[here])), shape=(n * d, n * d))
        blocks = self._stiffness.tobsr((d, d))
        blocks.sort_indices()
        self.blocks = BlockRows(blocks.indptr.astype(np.int32), blocks.indices.astype(np.int32), blocks.data)
        self.diagonal = np.flatnonzero(np.repeat(np.arange(n), np.diff(blocks.indptr)) == blocks.indices)
        own = np.einsum("nii->n", blocks.data[self.diagonal]) / d
        self.scale = own / (DIAGONAL * self.nodes.weights)
        self.free = ~self.nodes.held_upper
        # sweeps move whole nodes
        self._stop = np.where(self.free, 0.0, STOP * (own + problem.law.K_N * self.nodes.weights)[:, None])
        self._swept = self.with_diagonal(self._stop[:, :, None] * np.eye(d))

    def with_diagonal(self, more: Array) -> BlockRows:
        """The blocks with (n, d, d) added to the nodes' own."""
        blocks = self.blocks.blocks.copy()
        blocks[self.diagonal] += more
        return BlockRows(self.blocks.indptr, self.blocks.indices, blocks)

    def of(self, x: PETSc.Vec) -> Array:
        """Displacements or forces there, (n, d)."""
        return np.asarray(x.array_r.reshape(-1, self.nodes.dim)[self.nodes.upper])

    def add(self, values: Array, x: PETSc.Vec) -> None:
        """Add displacements or forces (n, d)."""
        x.array.reshape(-1, self.nodes.dim)[self.nodes.upper] += values

    def forces(self, x: PETSc.Vec) -> Array:
        """Stiffness times displacements, (n, d)."""
        self.rows.mult(x, self._product)
        return np.asarray(self._product.array_r.reshape(-1, self.nodes.dim))

    def sweep(self, u: PETSc.Vec, residual: PETSc.Vec, turned: Array) -> None:
        """Gauss-Seidel sweeps, in place; residual: the true one at u; turned: see `_Newton.turned`."""
        law, nodes, slip = self.problem.law, self.nodes, self.problem.slip
        lower, old = nodes.lower_side(u), self.of(u)
        assert law.numbers is not None
        t = law.traction(np.einsum("nij,nj->ni", nodes.frames, old - lower), slip)
        contact = np.einsum("nji,nj->ni", nodes.frames, t * nodes.weights[:, None])
        near = (self._stiffness @ old.ravel()).reshape(old.shape)
        new = old + np.einsum("nji,nj->ni", nodes.frames, turned)
        sweep_nodes(
            self._swept, near + self._stop * old + contact - self.of(residual), new, lower, nodes.frames, nodes.weights,
            law.numbers, slip=slip, moves=np.asarray(~turned.any(axis=1)), sweeps=SWEEPS,
        )  # fmt: skip
        self.add(np.where(self.free, new - old, 0.0), u)

    def close(self) -> None:
        """Free the matrix."""
        self.rows.destroy()
        self._product.destroy()


class _Tangent:
    """The tangent of a contact problem and its preconditioner: contexts of a matrix and a PC of PETSc.

    Both live on displacements that are zero where supports hold. The matrix of the hierarchy, in blocks, multiplies for
    both; what the tangents of S differ from its springs is added.

    Args:
        surface: the nodes.
        start: expected jumps, for the springs of the hierarchy; None: bonded.
    """

    def __init__(self, surface: _Surface, start: Array | None) -> None:
        self.surface, self.problem, self.nodes = surface, surface.problem, surface.problem.nodes
        self._build(self._springs(start))
        self._contact: PETSc.PC | None = None
        size = self.nodes.dofs.size
        self._vectors = [PETSc.Vec().createSeq(size, comm=PETSc.COMM_SELF) for _ in range(2)]
        if self.nodes.lower is not None:
            self._vectors += [self.nodes.lower.createVecLeft(), self._matrix.createVecLeft()]

    def _springs(self, start: Array | None) -> Array:
        """Tangents of S without friction's coupling, clipped, (n, d, d)."""
        law, scale = self.problem.law, self.surface.scale
        D = bonded(law, len(scale), self.nodes.dim) if start is None else law.tangent(start, self.problem.slip)
        i = np.arange(self.nodes.dim)
        own = D[:, i, i]
        out = np.zeros_like(D)
        out[:, i[:-1], i[:-1]] = np.clip(own[:, :-1].mean(axis=1), FLOOR * scale, CLIP_TANGENTIAL * scale)[:, None]
        out[:, -1, -1] = np.clip(own[:, -1], FLOOR * scale, CLIP_NORMAL * scale)
        return out

    def _build(self, springs: Array) -> None:
        """The hierarchy."""
        problem, nodes = self.problem, self.nodes
        self._built_with = nodes.blocks(springs)
        added = nodes.stiffness(springs)
        M = problem.A.copy()
        pattern = PETSc.Mat.Structure
        M.axpy(1.0, added, pattern.SUBSET_NONZERO_PATTERN if nodes.lower is None else pattern.DIFFERENT_NONZERO_PATTERN)
        added.destroy()
        M.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        M.zeroRowsColumns((M.getOwnershipRange()[0] + problem.held).astype(PETSc.IntType), problem.diagonal)
        M.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        M.setOption(PETSc.Mat.Option.SPD, True)
        M.setBlockSize(nodes.dim)
        M.setNearNullSpace(problem.near)
        self._matrix = _in_blocks(M, nodes.dim)
        self._cycle = PETSc.PC().create(problem.comm)
        self._cycle.setOptionsPrefix(PREFIX)
        self._cycle.setOperators(M)
        self._cycle.setFromOptions()
        with _faster_products(serial=problem.comm.size == 1):
            self._cycle.setUp()
        if self._cycle.getType() == "gamg":
            _multiply_in_blocks(self._cycle, self._matrix)
        M.destroy()

    def linearise(self, tangents: Array) -> None:
        """Take over tangents of S, (n, d, d)."""
        self._of_contact = self.nodes.blocks(tangents)
        self._more = self._of_contact - self._built_with
        free = self.surface.free
        rows = self.surface.with_diagonal(self._of_contact * (free[:, :, None] & free[:, None, :]))
        if self._contact is not None:
            self._contact.destroy()
        if not len(tangents):
            return
        csr = (rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.blocks)
        J = PETSc.Mat().createBAIJ(free.size, self.nodes.dim, csr=csr, comm=PETSc.COMM_SELF)
        self._contact = PETSc.PC().create(PETSc.COMM_SELF)
        self._contact.setOperators(J)
        self._contact.setType("lu")
        self._contact.setFactorOrdering("nd")
        self._contact.setUp()
        J.destroy()

    def _jumps(self, x: PETSc.Vec) -> Array:
        """Jumps in global axes, (n, d)."""
        upper = self.surface.of(x)
        if self.nodes.lower is None:
            return upper
        lower = self._vectors[2]
        self.nodes.lower.mult(x, lower)
        return np.asarray(upper - lower.array_r.reshape(upper.shape))

    def mult(self, _: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """y = tangent times x."""
        self._matrix.mult(x, y)
        forces = np.einsum("nij,nj->ni", self._more, self._jumps(x))
        self.surface.add(forces, y)
        if self.nodes.lower is not None:
            lower, there = self._vectors[2:]
            lower.array[:] = forces.ravel()
            self.nodes.lower.multTranspose(lower, there)
            y.axpy(-1.0, there)
        y.array[self.problem.held] = 0.0

    def apply(self, _: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """z = a cycle of multigrid, then the nodes of S with all else in place."""
        self._cycle.apply(r, z)
        z.array[self.problem.held] = 0.0
        contact = np.einsum("nij,nj->ni", self._of_contact, self._jumps(z))
        left = self.surface.of(r) - self.surface.forces(z) - contact
        if self._contact is None:
            return
        q, move = self._vectors[:2]
        q.array[:] = np.where(self.surface.free, left, 0.0).ravel()
        self._contact.apply(q, move)
        self.surface.add(move.array_r.reshape(left.shape), z)

    def close(self) -> None:
        """Free matrices, factors and the hierarchy."""
        for item in (self._cycle, self._matrix, self._contact, *self._vectors):
            if item is not None:
                item.destroy()


class _Newton:
    """One run of SNES.

    Attributes:
        residuals: over the forces, at first and after each step.
        iterations: of FGMRES in each step.
    """

    def __init__(self, tangent: _Tangent, tolerance: float, shares: Shares) -> None:
        self.tangent, self.surface, self.problem = tangent, tangent.surface, tangent.problem
        self.nodes, self.tolerance, self.shares = self.problem.nodes, tolerance, shares
        self.residuals: list[float] = []
        self.iterations: list[int] = []
        self._target = shares[0]
        self._at: tuple[npt.NDArray[np.int8], Array] | None = None  # status and elastic slip of the last tangent
        self._set_rtol = not is_set("ksp_rtol", {})

    def run(self, u: PETSc.Vec, start: Array | None) -> int:
        """Go on from u, in place, with the tangent at the jumps `start` (None: bonded); PETSc's reason for the end."""
        problem, self._start = self.problem, start
        u.array[problem.held] = problem.prescribed.array_r[problem.held]
        f = u.duplicate()
        J = PETSc.Mat().createPython(problem.A.getSizes(), self.tangent, comm=problem.comm)
        J.setUp()
        snes = PETSc.SNES().create(problem.comm)
        try:
            snes.setOptionsPrefix(PREFIX)
            snes.setFunction(self._residual, f)
            snes.setJacobian(_nothing, J)
            snes.setConvergenceTest(self._test)
            snes.setUpdate(self._prepare)
            snes.setFromOptions()
            pc = snes.getKSP().getPC()
            pc.setType("python")
            pc.setPythonContext(self.tangent)
            snes.solve(None, u)
            return int(snes.getConvergedReason())
        finally:
            for item in (snes, J, f):
                item.destroy()

    def _residual(self, _: PETSc.SNES, u: PETSc.Vec, f: PETSc.Vec) -> None:
        self._h = self.problem.residual(u, f)

    def _test(self, snes: PETSc.SNES, step: int, norms: tuple[float, float, float]) -> Any:
        reason = PETSc.SNES.ConvergedReason
        self.residuals.append(self._h)
        if step:
            self.iterations.append(snes.getKSP().getIterationNumber())
        if not math.isfinite(norms[2]):
            return reason.DIVERGED_FNORM_NAN
        # a body far away has large forces to measure the residual by, of rounding alone
        near = norms[2] <= math.sqrt(self.tolerance) * float(self.problem.b.norm())
        return reason.CONVERGED_FNORM_ABS if self._h <= self.tolerance and near else False

    def _prepare(self, snes: PETSc.SNES, step: int) -> None:
        """Before a Newton step: sweeps if need be, tangents, tolerance of the linear solve."""
        u, f, ksp = snes.getSolution(), snes.getFunction()[0], snes.getKSP()
        if step == 0:
            tangents = self._begin(u, f)
            share = self.shares[0]
        else:
            left = ksp.getResidualNorm() / snes.getFunctionNorm()
            tangents = self._go_on(u, f, left)
            share = min(0.5, self._target / self._h)
        self._before = self._h
        self.tangent.linearise(tangents)
        if self._set_rtol:
            ksp.setTolerances(rtol=share)

    def _begin(self, u: PETSc.Vec, f: PETSc.Vec) -> Array:
        """Tangents of the first step; its residual is that of the law made linear there."""
        law, slip, w, s = self.problem.law, self.problem.slip, self.nodes.jump(u), self._start
        if s is None:
            tangents = bonded(law, len(w), self.nodes.dim)
            t = np.einsum("nij,nj->ni", tangents, w - np.column_stack([slip, np.zeros(len(slip))]))
        else:
            tangents = law.tangent(s, slip)
            t = law.traction(s, slip) + np.einsum("nij,nj->ni", tangents, w - s)
            self._note(s)
        self.nodes.add_forces(t - law.traction(w, slip), f)
        f.array[self.problem.held] = 0.0
        return tangents

    def _go_on(self, u: PETSc.Vec, f: PETSc.Vec, left: float) -> Array:
        """Tangents of a later step, after sweeps if the last step has gone another way than its tangents said.

        Args:
            u, f: displacements and residual, in place.
            left: what the last linear solve has left, over the norm of f.
        """
        problem, w = self.problem, self.nodes.jump(u)
        turned = self.turned(w)
        if self._is_new(w, turned) or self._h > EXPECTED * self._target:
            self.surface.sweep(u, f, turned)
            self._residual(None, u, f)
            w = self.nodes.jump(u)
            self._target = self.shares[1] * min(self._h, self._target)
        else:
            # what the law's curvature leaves goes down with the square of the steps
            curved = self._h * math.sqrt(abs(1 - left**2)) * (self._h / self._before) ** 2
            self._target = min(self.shares[1] * self._h, curved)
        self._target = max(self._target, FINISH * self.tolerance)
        self._note(w)
        return problem.law.tangent(w, problem.slip)

    # ---------------------------------------------------------------- status
    def _note(self, w: Array) -> None:
        """Remember the jumps of tangents."""
        self._at = self.problem.law.status(w, self.problem.slip), w[:, :-1] - self.problem.slip

    def turned(self, w: Array) -> Array:
        """What makes nodes stick that slide, but the other way than at the last tangents: change of the jumps (n, d).

        Along its slip a sliding node has no stiffness of its own. If it should stick, Newton's method can throw it to and
        fro for ever, and sweeps follow.
        """
        out = np.zeros_like(w)
        if self._at is None:
            return out
        slip, (status, old) = self.problem.slip, self._at
        now = w[:, :-1] - slip
        back = (status == Status.SLIDING) & (self.problem.law.status(w, slip) == Status.SLIDING)
        back &= (old * now).sum(axis=1) < 0
        way = old[back] - now[back]
        part = -(now[back] * way).sum(axis=1) / (way**2).sum(axis=1)
        out[back, :-1] = part[:, None] * way
        return out

    def _is_new(self, w: Array, turned: Array) -> bool:
        """Whether on some rank the status is not that of the last tangents."""
        other = self._at is None or bool((self.problem.law.status(w, self.problem.slip) != self._at[0]).any())
        return bool(self.problem.comm.allreduce(int(other or bool(turned.any()))))


def bonded(law: ContactLaw, n: int, d: int) -> Array:
    """Tangents of n nodes that stick, (n, d, d)."""
    return np.tile(np.diag([law.K_T] * (d - 1) + [law.K_N]), (n, 1, 1))


def _nothing(*_: Any) -> None:
    """The Jacobian: its context has the tangents already."""


def _count_as_read(beginnings: tuple[str, ...]) -> None:
    """Options that only the first solve reads shall not count as unread in later ones."""
    database = PETSc.Options()
    for name in database.getAll():
        if name.startswith(tuple(PREFIX + beginning for beginning in beginnings)):
            database.hasName(name)


@contextmanager
def _faster_products(*, serial: bool) -> Iterator[None]:
    """Galerkin products by way of A P, a fifth off the setup for more memory; PETSc reads no prefix there."""
    database, name = PETSc.Options(), "matptap_via"
    ours = serial and not database.hasName(name)
    if ours:
        database.setValue(name, "rap")
    try:
        yield
    finally:
        if ours:
            database.delValue(name)


def _in_blocks(A: PETSc.Mat, d: int) -> PETSc.Mat:
    """A matrix in blocks of d x d, which multiplies twice as fast; PETSc's own conversion is slow."""
    indptr, indices, values = A.getValuesCSR()
    shape = (A.getLocalSize()[0], A.getSize()[1])
    blocks = scipy.sparse.csr_matrix((values, indices, indptr), shape=shape, copy=False).tobsr((d, d))
    del indptr, indices, values
    ints: Sequence[Any] = [a.astype(PETSc.IntType, copy=False) for a in (blocks.indptr, blocks.indices)]
    return PETSc.Mat().createBAIJ(A.getSizes(), d, csr=(*ints, blocks.data), comm=A.comm)


def _multiply_in_blocks(cycle: PETSc.PC, fine: PETSc.Mat) -> None:
    """Give a hierarchy of GAMG its matrices in blocks, `fine` on the finest level."""
    library = ctypes.CDLL(PETSc.__file__)
    number = np.ctypeslib.as_ctypes_type(PETSc.IntType)
    library.PCMGSetResidual.argtypes = [ctypes.c_void_p, number, ctypes.c_void_p, ctypes.c_void_p]
    finest = cycle.getMGLevels() - 1
    for level in range(finest, 0, -1):
        smoother, P = cycle.getMGSmoother(level), cycle.getMGInterpolation(level)
        A = smoother.getOperators()[0]
        matrix = fine if level == finest else _in_blocks(A, A.getBlockSize())
        smoother.setOperators(matrix, matrix)
        library.PCMGSetResidual(cycle.handle, level, None, matrix.handle)
        if level < finest:
            matrix.destroy()
        size = math.gcd(*P.getBlockSizes())
        if size > 1:
            blocks = _in_blocks(P, size)
            cycle.setMGInterpolation(level, blocks)
            cycle.setMGRestriction(level, blocks)
            blocks.destroy()
    cycle.setReusePreconditioner(True)
    cycle.setOperators(fine, fine)  # lets go of the matrix it was built from
