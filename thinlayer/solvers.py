"""Linear and Newton (SNES) solvers of a model."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.work import work
from thinlayer.model import Model
from thinlayer.options import PREFIX, OptionValue, defaults, is_set, require_all_read
from thinlayer.rigid import rigid_motions
from thinlayer.state import Report, State

DIRECT: dict[str, OptionValue] = {
    "ksp_type": "preonly",
    "ksp_rtol": 1e-10,
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_7": 2,
    "mat_mumps_icntl_14": 100,  # per cent of spare memory: with MUMPS's own 20 it fails now and then on several ranks
}
MULTIGRID: dict[str, OptionValue] = {
    **DIRECT,
    "ksp_max_it": 200,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_aggressive_coarsening": 2,
    "pc_gamg_aggressive_square_graph": False,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
}
MULTIGRID_FROM = {2: 3_000_000, 3: 50_000}  # unknowns; below, factorising is faster
NEWTON: dict[str, OptionValue] = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",
    "snes_rtol": 1e-10,
    "snes_stol": 0,
    "snes_max_it": 30,
}
LARGEST_RESIDUAL = 1e-6
LARGEST_ITERATIVE_RESIDUAL = 1e-3  # Krylov methods converge in the preconditioned norm: singular systems too
REFINED_RESIDUAL = 1e-15


class SolveError(RuntimeError):
    """A solve that did not converge: PETSc's reason, the last residual, and what to try."""


def solve(
    model: Model, t: float = 0.0, *, options: Mapping[str, OptionValue] | None = None, method: str | None = None
) -> State:
    """Equilibrium of a model at a time. Collective.

    Args:
        model: the model.
        t: the time that loads and supports are taken at.
        options: PETSc options without prefix, over our defaults; options given to PETSc as -thinlayer_NAME come first.
        method: "linear" (default if every law is linear) or "newton".

    Raises:
        SolveError: no convergence, or no unique solution. OptionError: a PETSc option that the solver does not read.
        ValueError: unknown method, or a linear solve of a non-linear law.
    """
    method = method or ("linear" if model.linear else "newton")
    if method not in ("linear", "newton"):
        raise ValueError(f"unknown method {method!r}; allowed: linear, newton")
    if method == "linear" and not model.linear:
        raise ValueError("method='linear' cannot solve a non-linear law; use method='newton'")
    start = time.perf_counter()
    model.coordinates.t.value = t
    model.conditions.update()
    given = dict(options or {})
    choices = linear_solvers(model)
    if is_set("ksp_type", given) or is_set("pc_type", given):
        choices = choices[:1]
    while True:
        ours = {**choices.pop(0), **(NEWTON if method == "newton" else {})}
        try:
            with defaults({**ours, **given}):
                u, iterations, residual = (_linear if method == "linear" else _newton)(model)
                require_all_read(method, ours.keys() - given.keys())
        except SolveError:
            if not choices:
                raise
        else:
            return State(model, u, t, Report(method, iterations, residual, time.perf_counter() - start))


def linear_solvers(model: Model) -> list[dict[str, OptionValue]]:
    """PETSc options to try in turn.

    Direct: MUMPS, Cholesky where the tangent is symmetric, else LU; AMF ordering. Large models start with conjugate
    gradients (GMRES without symmetry) and algebraic multigrid that knows the rigid motions; very stiff layers slow it down
    so much that factorising is faster.
    """
    direct = {**DIRECT, "pc_type": "cholesky" if model.symmetric else "lu"}
    unknowns = model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs
    if unknowns < MULTIGRID_FROM[model.joint.dim]:
        return [direct]
    return [{**MULTIGRID, "ksp_type": "cg" if model.symmetric else "gmres"}, direct]


def _mark(A: PETSc.Mat, model: Model) -> None:
    A.setOption(PETSc.Mat.Option.SYMMETRIC, model.symmetric)
    A.setOption(PETSc.Mat.Option.SPD, model.symmetric and model.linear)


def _tell_multigrid(ksp: PETSc.KSP, A: PETSc.Mat, model: Model) -> None:
    """Rigid motions for algebraic multigrid; nobody else reads them."""
    if ksp.getPC().getType() in ("gamg", "hypre", "ml"):
        A.setNearNullSpace(PETSc.NullSpace().create(vectors=_orthonormal(model), comm=model.comm))


def _orthonormal(model: Model) -> list[PETSc.Vec]:
    basis: list[PETSc.Vec] = []
    for motion in rigid_motions(model.V, model.joint).values():
        v = motion.x.petsc_vec.copy()
        for b in basis:
            v.axpy(-v.dot(b), b)
        v.normalize()
        basis.append(v)
    return basis


def _linear(model: Model) -> tuple[fem.Function, int, float]:
    """A u = b with one or two steps of iterative refinement after a direct solve."""
    bcs = model.conditions.bcs
    u, trial, test = fem.Function(model.V), ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
    a, L = fem.form(work(model.points, trial, test)), fem.form(model.external_work(test))
    A = dolfinx.fem.petsc.assemble_matrix(a, bcs=bcs)
    A.assemble()
    _mark(A, model)
    b = dolfinx.fem.petsc.assemble_vector(L)
    dolfinx.fem.petsc.apply_lifting(b, [a], [bcs])
    b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    dolfinx.fem.petsc.set_bc(b, bcs)

    ksp = PETSc.KSP().create(model.comm)
    ksp.setOptionsPrefix(PREFIX)
    ksp.setOperators(A)
    ksp.setFromOptions()
    _tell_multigrid(ksp, A, model)
    x, r, correction = u.x.petsc_vec, b.duplicate(), b.duplicate()
    size = max(b.norm(), 1e-300)
    ksp.solve(b, x)
    iterations, residual = ksp.getIterationNumber(), _residual(A, x, b, r, size)
    direct = ksp.getType() == "preonly"
    while direct and REFINED_RESIDUAL < residual < LARGEST_RESIDUAL:
        ksp.solve(r, correction)
        correction.aypx(1.0, x)
        refined = _residual(A, correction, b, r, size)
        if refined >= residual / 2:
            break
        correction.copy(x)
        residual = refined
    reason = ksp.getConvergedReason()
    for thing in (A, b, r, correction, ksp):
        thing.destroy()
    if reason < 0 or not residual < (LARGEST_RESIDUAL if direct else LARGEST_ITERATIVE_RESIDUAL):
        raise SolveError(
            f"linear solve failed: {_reason(PETSc.KSP.ConvergedReason, reason)}, relative residual {residual:.1e}; "
            "a body without supports and without a stiff enough layer can move freely; with an iterative solver try "
            f"-{PREFIX}ksp_max_it or -{PREFIX}pc_type cholesky"
        )
    u.x.scatter_forward()
    return u, iterations, residual


def _residual(A: PETSc.Mat, x: PETSc.Vec, b: PETSc.Vec, r: PETSc.Vec, size: float) -> float:
    A.mult(x, r)
    r.aypx(-1.0, b)
    return float(r.norm() / size)


def _reason(kind: Any, value: int) -> str:
    names = {v: k for k, v in vars(kind).items() if isinstance(v, int) and not k.startswith("_")}
    return names.get(value, str(value))


class _Equations:
    """Residual and tangent of a model for SNES."""

    def __init__(self, model: Model) -> None:
        self.model, self.u = model, fem.Function(model.V)
        test, du = ufl.TestFunction(model.V), ufl.TrialFunction(model.V)
        residual = work(model.points, self.u, test) - model.external_work(test)
        self.F, self.J = fem.form(residual), fem.form(ufl.derivative(residual, self.u, du))
        self.A = dolfinx.fem.petsc.create_matrix(self.J)
        self.b, self.x = self.u.x.petsc_vec.duplicate(), self.u.x.petsc_vec.duplicate()

    def put(self, x: PETSc.Vec) -> None:
        """Take over a trial solution, ghosts included."""
        x.copy(self.u.x.petsc_vec)
        self.u.x.scatter_forward()

    def residual(self, snes: PETSc.SNES, x: PETSc.Vec, b: PETSc.Vec) -> None:
        bcs = self.model.conditions.bcs
        self.put(x)
        with b.localForm() as local:
            local.set(0)
        dolfinx.fem.petsc.assemble_vector(b, self.F)
        dolfinx.fem.petsc.apply_lifting(b, [self.J], [bcs], x0=[self.u.x.petsc_vec], alpha=-1.0)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        dolfinx.fem.petsc.set_bc(b, bcs, self.u.x.petsc_vec, -1.0)

    def tangent(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        P.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(P, self.J, bcs=self.model.conditions.bcs)
        P.assemble()


def _newton(model: Model) -> tuple[fem.Function, int, float]:
    """Newton's method from zero displacements."""
    equations = _Equations(model)
    _mark(equations.A, model)
    snes = PETSc.SNES().create(model.comm)
    snes.setOptionsPrefix(PREFIX)
    snes.setFunction(equations.residual, equations.b)
    snes.setJacobian(equations.tangent, equations.A)
    snes.setFromOptions()
    _tell_multigrid(snes.getKSP(), equations.A, model)
    snes.setConvergenceHistory()
    snes.solve(None, equations.x)
    reason, iterations = snes.getConvergedReason(), snes.getIterationNumber()
    history = snes.getConvergenceHistory()[0]
    first = max(float(history[0]) if len(history) else 0.0, 1e-300)
    last = float(snes.getFunctionNorm())
    ksp_reason = snes.getKSP().getConvergedReason()
    equations.put(equations.x)
    for thing in (snes, equations.A, equations.b, equations.x):
        thing.destroy()
    if reason < 0:
        raise SolveError(
            f"Newton's method failed after {iterations} steps: {_reason(PETSc.SNES.ConvergedReason, reason)}"
            + (f" (linear solver: {_reason(PETSc.KSP.ConvergedReason, ksp_reason)})" if ksp_reason < 0 else "")
            + f", residual {last:.1e} of {first:.1e} at the start; try a smaller load, -{PREFIX}snes_linesearch_type bt, "
            f"or -{PREFIX}snes_monitor to watch it"
        )
    return equations.u, iterations, last / first
