"""Contact solver for large problems on any number of ranks: Newton's method, a Krylov solver and multigrid."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.base import Array, InputError
from thinlayer.discretisation.contact_nodes import NodePairs
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.contact.contact_solver import ContactSolver
from thinlayer.solving.contact.contact_tangent import ContactTangent
from thinlayer.solving.contact.pairs import C_SOURCE, ContactPairs
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import HIERARCHY_OPTIONS
from thinlayer.solving.part_sum import MIN_DIVISOR, SOLVER_RESIDUAL
from thinlayer.solving.petsc import PREFIX, OptionDict, db_options, reason_name, set_defaults, solve_nonlinear
from thinlayer.system.compilation import compile_library
from thinlayer.system.ranks import destroy

Reason = PETSc.SNES.ConvergedReason
Reductions = tuple[float, float]  # factors by which the first and the later linear solves reduce the residual

NEWTON_TOLERANCE = 1e-10  # residual of the law at which Newton's method stops, relative to the forces
LOOSE_REDUCTIONS: Reductions = (0.5, 0.4)  # for a start whose status is wrong at many nodes
STRICT_REDUCTIONS: Reductions = (0.05, 0.1)  # for a start from a guess, and in the last attempt
# largest residual after a Newton step without sweeps, relative to the target of its linear solve
MAX_UNSWEPT_RATIO = 3.0
# residual, relative to the external forces, above which forces of bodies that moved far away are no reference
LARGE_RESIDUAL = 3e-5
MIN_REDUCTION = 0.05  # least factor by which a linear solve after sweeps reduces a residual below the forces
LAST_TARGET_RATIO = 0.7  # target of the last linear solve, relative to NEWTON_TOLERANCE

# GMRES with a right preconditioner needs one more cycle of multigrid for the solution than FGMRES
KRYLOV_OPTIONS = OptionDict(ksp_type="fgmres", ksp_gmres_restart=40, ksp_max_it=120, snes_max_linear_solve_fail=4)
# no line search: the residual grows on good steps, as springs of S are stiff
NEWTON_OPTIONS = OptionDict(
    KRYLOV_OPTIONS, snes_type="newtonls", snes_linesearch_type="basic", snes_max_it=50, snes_divergence_tolerance=-1
)


class MultigridContact(ContactSolver):
    """Contact solver by Newton's method (SNES), with FGMRES and multigrid for its linear systems. Collective.

    There may be several seams. FGMRES uses the exact tangent, which is not symmetric where S slides. Its preconditioner
    is a cycle of algebraic multigrid, then an exact solve for the nodes of S on each rank.

    The multigrid hierarchy is built for the bodies with symmetric springs between the sides of S. It is built in the
    first solve, and kept until `close`. The springs follow the contact status of S, but are hardly stiffer than the
    bodies.

    If the contact status of a node has changed, Gauss-Seidel sweeps over the nodes of S precede the next Newton step.
    Each rank sweeps its own nodes alone. If Newton's method fails from the initial jumps, it starts again with pairs of
    nodes that neither open nor slide.

    PETSc options begin with -thinlayer_: snes_ and ksp_ for Newton's method, pc_ and mg_ for the hierarchy. Tolerances
    of linear solves are chosen here unless ksp_rtol is set.
    """

    def __init__(self, equations: Equations, like: State | None) -> None:
        super().__init__(equations, like)
        compile_library(C_SOURCE, self.comm)
        self.nodes = nodes = NodePairs.join_seams([part.nodes for part in self.parts])
        self.pairs = ContactPairs(self.parts, self.is_fixed, self.x.getOwnershipRange()[0] // nodes.dim, nodes.shared())
        self._tangent: ContactTangent | None = None
        self._forces = equations.create_vector()

    def solve(self, has_guess: bool) -> tuple[int, float]:
        """Solve for the displacements in the attribute `x`, in place.

        Args:
            has_guess: whether `x` already contains a guess of the jumps. If not, Newton's method starts with pairs of
                nodes that neither open nor slide.

        Returns:
            Number of Newton steps, and norm of the residual relative to the reference forces.

        Raises:
            SolveError: no convergence, for instance because there is no equilibrium.
        """
        residuals: list[float] = []
        nodes, old = self.nodes, self.equations.interval.old.u.x.petsc_vec
        start_jumps = nodes.separation(self.x) if has_guess else None
        gap_vector = self.equations.create_vector()
        gap_vector.array[nodes.dofs] = nodes.frames[:, -1] * nodes.gap[:, None]
        self._max_force = float(self.b.norm())
        for u in (old, gap_vector):
            self.equations.K.mult(u, self._forces)
            self._max_force = max(self._max_force, float(self._forces.norm()))
        gap_vector.destroy()
        with set_defaults({**HIERARCHY_OPTIONS, **NEWTON_OPTIONS}):
            if self._tangent is None:
                self._tangent = ContactTangent(self.A, nodes, self.pairs, self.equations, start_jumps)
            else:  # later solves do not read the hierarchy's options, and must not refuse them
                for name in db_options():
                    if name.startswith(("pc_", "mg_")):
                        PETSc.Options().hasName(PREFIX + name)
            attempts = [(start_jumps, STRICT_REDUCTIONS), (None, LOOSE_REDUCTIONS)]
            for guess, reductions in attempts[::-1] if start_jumps is None else attempts:
                newton_run = _NewtonRun(self, self._tangent, reductions)
                if guess is None:
                    self.x.set(0.0)
                reason = newton_run.run(self.x, guess)
                residuals += newton_run.residuals
                if not newton_run.residuals and reason >= 0:  # PETSc itself refuses a first residual that is NaN
                    raise InputError(f"-{PREFIX}snes_type ksponly ignores the residual; contact needs Newton's method")
                if reason > 0:
                    return len(newton_run.residuals) - 1, residuals[-1]
        slow_text = "FGMRES is slow for slender bodies: " * (reason == Reason.DIVERGED_LINEAR_SOLVE)
        load_advice = "smaller load steps, or supports (is a body pulled off S, or pushed harder than friction holds?)"
        advice = f"{slow_text}try method='newton', {load_advice}; -{PREFIX}snes_monitor watches it"
        steps, last = max(len(residuals) - 2, 0), residuals[-1] if residuals else math.nan
        text = f"after {steps} steps: {reason_name(Reason, reason)}, residual {last:.1e} of the forces"
        raise SolveError(f"Newton's method for contact failed {text}", residuals=tuple(residuals), advice=advice)

    def residual(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """Write the residual at displacements `u` into `out`; return its norm relative to the reference forces.

        The residual is set to zero at constrained dofs. The norm is scaled such that it equals NEWTON_TOLERANCE where a
        residual reaches the limit of `ForceScale` at which solvers stop.
        """
        equations = self.equations
        equations.residual(u, out)
        out.array[equations.bc_dofs] = 0.0
        norms, reference = equations.norms(out.array_r), equations.max_norms(u) / SOLVER_RESIDUAL
        if norms[0] > LARGE_RESIDUAL * self._max_force:  # large forces of a body that moved far away are only rounding
            reference = np.minimum(reference, self._max_force)
        return float((norms / np.maximum(reference, MIN_DIVISOR)).max())

    def close(self) -> None:
        """Free vectors, matrices and the hierarchy."""
        super().close()
        self._forces.destroy()
        if self._tangent is not None:
            self._tangent.close()


class _NewtonRun:
    """One run of Newton's method (PETSc SNES) for a contact problem, from one start.

    Args:
        solver: the contact solver.
        tangent: the tangent of the contact problem and its preconditioner.
        reductions: factor by which the first linear solve reduces the residual, and the factor for later ones.

    Attributes:
        residuals: norms of the residual relative to the reference forces, before the first step and after each step.
    """

    def __init__(self, solver: MultigridContact, tangent: ContactTangent, reductions: Reductions) -> None:
        self.solver, self.tangent, self.reductions = solver, tangent, reductions
        self.nodes, self.pairs, self.bc_dofs = solver.nodes, solver.pairs, solver.equations.bc_dofs
        self.residuals: list[float] = []
        self._target = reductions[0]
        self._is_repeated = False  # whether the next call of `_residual` repeats the last one
        self._status: npt.NDArray[np.int8] | None = None  # contact status (n,) at the last tangents
        self._chooses_rtol = "ksp_rtol" not in db_options()

    def run(self, u: PETSc.Vec, start_jumps: Array | None) -> int:
        """Run Newton's method from displacements `u`, which become the solution.

        Args:
            u: initial displacements; overwritten.
            start_jumps: (n, d) jumps of n pairs of nodes in d dimensions, at which the first step takes the contact
                tangents. None: in the first step the pairs neither open nor slide.

        Returns:
            PETSc's number of the reason why the method stopped; positive after convergence.
        """
        solver, self._start_jumps = self.solver, start_jumps
        u.array[self.bc_dofs] = solver.equations.prescribed
        f = self._f = u.duplicate()
        J = PETSc.Mat().createPython(solver.A.getSizes(), self.tangent, comm=solver.comm)
        J.setUp()
        snes = PETSc.SNES().create(solver.comm)
        try:
            snes.setOptionsPrefix(PREFIX)
            snes.setFunction(self._residual, f)
            snes.setJacobian(self._linearise, J)
            snes.setConvergenceTest(self._converged)
            snes.setUpdate(self._decide_sweeps)
            snes.setNGS(self._sweep)
            snes.setNPCSide(PETSc.PC.Side.RIGHT)
            sweep_snes = snes.getNPC()
            sweep_snes.setType("ngs")
            sweep_snes.setTolerances(max_it=1)
            sweep_snes.setNormSchedule(PETSc.SNES.NormSchedule.FINAL_ONLY)
            sweep_snes.destroy()  # drops this reference
            snes.setFromOptions()
            pc = snes.getKSP().getPC()
            pc.setType("python")
            pc.setPythonContext(self.tangent)
            solve_nonlinear(snes, u)
            return int(snes.getConvergedReason())
        finally:
            destroy(snes, J, f)

    def _residual(self, _: PETSc.SNES, u: PETSc.Vec, f: PETSc.Vec) -> None:
        if self._is_repeated:  # without a sweep PETSc asks again for the same residual
            self._is_repeated = False
            self._f.copy(f)
            return
        self._relative_norm = self.solver.residual(u, f)

    def _converged(self, snes: PETSc.SNES, step: int, norms: tuple[float, float, float]) -> PETSc.SNES.ConvergedReason:
        self.residuals.append(self._relative_norm)
        if not math.isfinite(norms[2]):
            return Reason.DIVERGED_FNORM_NAN
        return Reason.CONVERGED_FNORM_ABS if self._relative_norm <= NEWTON_TOLERANCE else False

    def _decide_sweeps(self, snes: PETSc.SNES, step: int) -> None:
        """Decide whether Gauss-Seidel sweeps precede Newton step number `step`; SNES calls this before each step.

        They do if the last step changed the contact status of a node, or reduced the residual too little.
        """
        self._sweeps_now = False
        if step:
            status = self.pairs.status(self.nodes.separation(snes.getSolution()))
            changed = self._status is None or (status != self._status).any()
            any_changed = self.solver.comm.allreduce(int(changed)) > 0
            self._sweeps_now = any_changed or self._relative_norm > MAX_UNSWEPT_RATIO * self._target
            self._linear_ratio = snes.getKSP().getResidualNorm() / snes.getFunctionNorm()

    def _sweep(self, _: PETSc.SNES, u: PETSc.Vec, __: PETSc.Vec | None) -> None:
        """Improve displacements `u` by Gauss-Seidel sweeps over the nodes of S, if `_decide_sweeps` has decided so.

        SNES calls this before each Newton step. Each rank sweeps its own nodes.
        """
        self._is_repeated = not self._sweeps_now
        if self._sweeps_now:
            self.tangent.sweep(u, self._f)

    def _linearise(self, snes: PETSc.SNES, u: PETSc.Vec, _: PETSc.Mat, __: PETSc.Mat) -> None:
        """Set up the linear system of a Newton step at displacements `u`; SNES calls this for a new Jacobian.

        It sets the contact tangents, the springs of the preconditioner and the tolerance of the linear solve. The
        matrices that PETSc passes are ignored, because their products are computed by the `ContactTangent` of this run.
        """
        is_first = not snes.getIterationNumber()
        tangents = self._first_tangents(u, self._f) if is_first else self._next_tangents(u)
        rtol = self.reductions[0] if is_first else min(0.5, self._target / self._relative_norm)
        self._old_relative_norm = self._relative_norm
        self.tangent.update_springs(self._start_jumps if is_first else self.nodes.separation(u))
        self.tangent.set_tangents(tangents)
        if self._chooses_rtol:
            snes.getKSP().setTolerances(rtol=rtol)

    def _first_tangents(self, u: PETSc.Vec, f: PETSc.Vec) -> Array:
        """Return the contact tangents (n, d, d) of n pairs of nodes in d dimensions for the first Newton step.

        They are taken at the jumps `start_jumps` of `run`. If these are None, they are those of pairs that neither open
        nor slide.

        Args:
            u: displacements before the step.
            f: residual at `u`. It is changed to the residual with contact laws linearised at these jumps.
        """
        pairs, jumps, start_jumps = self.pairs, self.nodes.separation(u), self._start_jumps
        if start_jumps is None:
            tangents = pairs.bonded_tangents()
            tractions = np.einsum("nij,nj->ni", tangents, pairs.elastic_jumps(jumps))
        else:
            tangents = pairs.tangents(start_jumps)
            tractions = pairs.tractions(start_jumps) + np.einsum("nij,nj->ni", tangents, jumps - start_jumps)
            self._status = pairs.status(start_jumps)
        self.nodes.add_forces(tractions - pairs.tractions(jumps), f)
        f.array[self.bc_dofs] = 0.0
        return tangents

    def _next_tangents(self, u: PETSc.Vec) -> Array:
        """Return the contact tangents (n, d, d) of n pairs of nodes for a Newton step after the first.

        The method also chooses the relative residual at which the linear solve of this step ends.

        Args:
            u: displacements before the step.
        """
        relative = self._relative_norm
        if self._sweeps_now:
            self._target = max(self.reductions[1] * min(relative, self._target), MIN_REDUCTION * min(relative, 1.0))
        else:
            # the residual that the law's non-linearity leaves is quadratic in the size of the step
            predicted = relative * math.sqrt(abs(1 - self._linear_ratio**2)) * (relative / self._old_relative_norm) ** 2
            self._target = min(self.reductions[1] * relative, predicted)
        self._target = max(self._target, LAST_TARGET_RATIO * NEWTON_TOLERANCE)
        jumps = self.nodes.separation(u)
        self._status = self.pairs.status(jumps)
        return self.pairs.tangents(jumps)
