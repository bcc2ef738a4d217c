"""Contact on a wide S, in three dimensions and on several ranks: Newton's method, Krylov, one multigrid hierarchy."""

from __future__ import annotations

import math
from copy import copy
from typing import Any

import numpy as np
from petsc4py import PETSc

from forms.base import Array, InputError
from thinlayer.discretisation.contact_nodes import ContactNodes
from thinlayer.errors import SolveError
from thinlayer.solving.contact.contact_tangent import SurfaceStiffness, Tangent
from thinlayer.solving.contact.gauss_seidel import Sliding, load, sliding, turned
from thinlayer.solving.contact.problem import ContactProblem
from thinlayer.solving.linear_solvers import DIRECT, MULTIGRID
from thinlayer.solving.petsc import PREFIX, OptionValue, defaults, is_set, options_set, reason_name, solve_nonlinear
from thinlayer.system.ranks import carry

Reductions = tuple[float, float]  # factors by which the first and the later linear solves reduce the residual

TOLERANCE = 1e-10  # residual of the law at which Newton's method stops, relative to the forces
LOOSE: Reductions = (0.3, 0.2)  # for a start whose status is wrong at many nodes
STRICT: Reductions = (0.02, 0.05)  # for a prediction, and in the last attempt
EXPECTED = 3.0  # largest residual after a Newton step without sweeps, relative to the target of its linear solve
FINISH = 0.7  # target of the last linear solve, relative to the tolerance

HIERARCHY: dict[str, OptionValue] = {k: v for k, v in MULTIGRID.items() if k not in (*DIRECT, "ksp_max_it")}
NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",  # the residual grows on good steps, as springs of S are stiff
    "snes_max_it": 50,
    "snes_divergence_tolerance": -1,
    "snes_max_linear_solve_fail": 4,
    "ksp_type": "fgmres",  # GMRES with a right preconditioner needs one more cycle of multigrid for the solution
    "ksp_gmres_restart": 40,
    "ksp_max_it": 120,
}


class MultigridContact:
    """Solves contact problems, one load after the other: SNES, FGMRES and one algebraic multigrid hierarchy. Collective.

    The hierarchy is built for the bodies with symmetric, clipped springs on S, in the first solve, and kept until `close`.
    FGMRES uses the exact tangent, which is not symmetric where S slides. Its preconditioner is a cycle of multigrid, then
    an exact solve for the nodes of S on each rank. If the status of a node has changed, Gauss-Seidel sweeps over the nodes
    of S, on each rank alone, precede a Newton step.

    PETSc options under our prefix: snes_ and ksp_ for Newton's method, pc_ and mg_ for the hierarchy. Tolerances of linear
    solves are chosen here unless ksp_rtol is set.

    Args:
        problem: the contact problem; its matrix is read here, its loads and slip at every `solve`.
    """

    def __init__(self, problem: ContactProblem) -> None:
        load(problem.comm)
        self.given = problem
        self.problem = _from_softer_side(problem)
        self._surface = SurfaceStiffness(self.problem)
        self._tangent: Tangent | None = None
        self._u = problem.A.createVecRight()
        self._solved = False

    def solve(self, start: Array | None = None) -> tuple[PETSc.Vec, int, list[float]]:
        """Displacements that balance the loads.

        Args:
            start: (n, d) expected jumps in the nodes' frames, lengths, as those of the last load or of a similar model;
                Newton's method then starts from the last solution. None: it starts from zero with bonded nodes.

        Returns:
            Displacements, valid until the next `solve` or `close`; number of Newton steps; residuals relative to the
            forces, before the first and after each step.

        Raises:
            SolveError: no convergence, for instance without an equilibrium.
        """
        history: list[float] = []
        start = self._take_load(start)
        with defaults({**HIERARCHY, **NEWTON}):
            if self._tangent is None:
                self._tangent = Tangent(self._surface, start)
            else:
                _count_as_read(("pc_", "mg_"))
            attempts = [(None, LOOSE), (None, STRICT)] if start is None else [(start, STRICT), (None, LOOSE)]
            for guess, reductions in attempts:
                newton = _Newton(self._tangent, reductions)
                if guess is None or not self._solved:
                    self._u.set(0.0)
                reason = newton.run(self._u, guess)
                history += newton.residuals
                if not newton.residuals and reason >= 0:  # PETSc itself refuses a first residual that is NaN
                    raise InputError(f"-{PREFIX}snes_type ksponly ignores the residual; contact needs Newton's method")
                self._solved = reason > 0
                if self._solved:
                    return self._u, len(newton.residuals) - 1, history
        last = history[-1] if history else math.nan
        raise SolveError(
            f"Newton's method for contact failed after {max(len(history) - 2, 0)} steps: "
            f"{reason_name(PETSc.SNES.ConvergedReason, reason)}, residual {last:.1e} of the forces",
            residuals=tuple(history),
            advice="a body that is pulled off S, or pushed harder than friction holds, needs supports; else try smaller "
            f"steps of the load, or -{PREFIX}snes_monitor to watch it",
        )

    def _take_load(self, start: Array | None) -> Array | None:
        """Take over load and slip of the given problem; returns the jumps to start from, at the nodes used here."""
        given, here = self.given, self.problem
        if here is given:
            return start
        here.largest = given.largest
        places = given.nodes.numbers, here.nodes.numbers
        here.slip = carry(given.comm, places[0], given.slip, places[1])
        return None if start is None else carry(given.comm, places[0], start, places[1])

    def close(self) -> None:
        """Free vectors, matrices and the hierarchy."""
        if self.problem is not self.given:
            self.problem.nodes.destroy()
        if self._tangent is not None:
            self._tangent.close()
            self._tangent = None
        self._surface.close()
        self._u.destroy()


def _from_softer_side(problem: ContactProblem) -> ContactProblem:
    """Swap the two sides of S if the lower bodies are softer: the preconditioner moves the upper side only."""
    nodes = problem.nodes
    if nodes.lower is None:
        return problem
    diagonal = problem.A.getDiagonal()
    above, below = diagonal.array_r.reshape(-1, nodes.dim)[nodes.upper], nodes.lower_side(diagonal)
    diagonal.destroy()
    sums = [float(((~held) * side).sum()) for held, side in ((nodes.held_upper, above), (nodes.held_lower, below))]
    upper, lower = problem.comm.allreduce(np.array(sums))
    if not 0 < lower < upper:
        return problem
    turned = copy(problem)
    turned.nodes = ContactNodes(nodes.surface, problem.held, gap=problem.law.gaps, turned=True)
    return turned


class _Newton:
    """One run of SNES.

    Attributes:
        residuals: relative to the forces, before the first and after each step.
    """

    def __init__(self, tangent: Tangent, reductions: Reductions) -> None:
        self.tangent, self.surface, self.problem = tangent, tangent.surface, tangent.problem
        self.nodes, self.reductions = self.problem.nodes, reductions
        self.residuals: list[float] = []
        self._target = reductions[0]
        self._known = False  # whether the next call of `_residual` repeats the last one
        self._at: Sliding | None = None  # sliding state at the last tangents
        self._set_rtol = not is_set("ksp_rtol", {})

    def run(self, u: PETSc.Vec, start: Array | None) -> int:
        """Solve from u, in place, first with the tangent at the jumps `start` (None: bonded); returns PETSc's reason."""
        problem, self._start = self.problem, start
        u.array[problem.held] = problem.prescribed.array_r[problem.held]
        f = self._f = u.duplicate()
        J = PETSc.Mat().createPython(problem.A.getSizes(), self.tangent, comm=problem.comm)
        J.setUp()
        snes = PETSc.SNES().create(problem.comm)
        try:
            snes.setOptionsPrefix(PREFIX)
            snes.setFunction(self._residual, f)
            snes.setJacobian(self._linearise, J)
            snes.setConvergenceTest(self._test)
            snes.setUpdate(self._choose_sweeps)
            snes.setNGS(self._sweep)
            snes.setNPCSide(PETSc.PC.Side.RIGHT)
            sweeps = snes.getNPC()
            sweeps.setType("ngs")
            sweeps.setTolerances(max_it=1)
            sweeps.setNormSchedule(PETSc.SNES.NormSchedule.FINAL_ONLY)
            sweeps.destroy()  # drops this reference
            snes.setFromOptions()
            pc = snes.getKSP().getPC()
            pc.setType("python")
            pc.setPythonContext(self.tangent)
            solve_nonlinear(snes, u)
            return int(snes.getConvergedReason())
        finally:
            for item in (snes, J, f):
                item.destroy()

    def _residual(self, _: PETSc.SNES, u: PETSc.Vec, f: PETSc.Vec) -> None:
        if self._known:  # without a sweep PETSc asks again for the same residual
            self._known = False
            self._f.copy(f)
            return
        self._h = self.problem.residual(u, f)

    def _test(self, snes: PETSc.SNES, step: int, norms: tuple[float, float, float]) -> Any:
        reason = PETSc.SNES.ConvergedReason
        self.residuals.append(self._h)
        if not math.isfinite(norms[2]):
            return reason.DIVERGED_FNORM_NAN
        return reason.CONVERGED_FNORM_ABS if self._h <= TOLERANCE else False

    def _choose_sweeps(self, snes: PETSc.SNES, step: int) -> None:
        """Before a Newton step: sweep if the last step has changed the status or not reduced the residual as expected."""
        self._swept = False
        if step:
            w = self.nodes.jump(snes.getSolution())
            self._turn = turned(self.problem.law, w, self.problem.slip, self._at)
            self._swept = self._is_new(w, self._turn) or self._h > EXPECTED * self._target
            ksp = snes.getKSP()
            self._left = ksp.getResidualNorm() / snes.getFunctionNorm()

    def _sweep(self, _: PETSc.SNES, u: PETSc.Vec, __: PETSc.Vec | None) -> None:
        """Gauss-Seidel sweeps over the nodes of S, on each rank alone, if they are due. `_f` is the residual at u."""
        self._known = not self._swept
        if self._swept:
            self.surface.sweep(u, self._f, self._turn)

    def _linearise(self, snes: PETSc.SNES, u: PETSc.Vec, _: PETSc.Mat, __: PETSc.Mat) -> None:
        """Set the tangents of a step, and the tolerance of its linear solve."""
        first = not snes.getIterationNumber()
        tangents = self._begin(u, self._f) if first else self._go_on(u)
        share = self.reductions[0] if first else min(0.5, self._target / self._h)
        self._before = self._h
        self.tangent.linearise(tangents)
        if self._set_rtol:
            snes.getKSP().setTolerances(rtol=share)

    def _begin(self, u: PETSc.Vec, f: PETSc.Vec) -> Array:
        """Tangents of the first step; f becomes the residual of the law linearised at the jumps to start from."""
        law, slip, w, s = self.problem.law, self.problem.slip, self.nodes.jump(u), self._start
        if s is None:
            tangents = law.bonded(len(w), self.nodes.dim)
            t = np.einsum("nij,nj->ni", tangents, w - np.column_stack([slip, np.zeros(len(slip))]))
        else:
            tangents = law.tangent(s, slip)
            t = law.traction(s, slip) + np.einsum("nij,nj->ni", tangents, w - s)
            self._at = sliding(law, s, slip)
        self.nodes.add_forces(t - law.traction(w, slip), f)
        f.array[self.problem.held] = 0.0
        return tangents

    def _go_on(self, u: PETSc.Vec) -> Array:
        """Tangents of a later step; sets the target of its linear solve."""
        if self._swept:
            self._target = self.reductions[1] * min(self._h, self._target)
        else:
            # the residual that the law's non-linearity leaves is quadratic in the size of the step
            nonlinear = self._h * math.sqrt(abs(1 - self._left**2)) * (self._h / self._before) ** 2
            self._target = min(self.reductions[1] * self._h, nonlinear)
        self._target = max(self._target, FINISH * TOLERANCE)
        w = self.nodes.jump(u)
        law, slip = self.problem.law, self.problem.slip
        self._at = sliding(law, w, slip)
        return law.tangent(w, slip)

    def _is_new(self, w: Array, turn: Array) -> bool:
        """Whether the status of a node on any rank has changed since the last tangents."""
        other = self._at is None or bool((self.problem.law.status(w, self.problem.slip) != self._at[0]).any())
        return bool(self.problem.comm.allreduce(int(other or bool(turn.any()))))


def _count_as_read(beginnings: tuple[str, ...]) -> None:
    """Mark options as read that only the first solve reads, so that later solves do not refuse them."""
    for name in options_set():
        if name.startswith(beginnings):
            PETSc.Options().hasName(PREFIX + name)
