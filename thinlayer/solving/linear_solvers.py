"""Linear solvers for a model: PETSc options to try, and what multigrid must know."""

from __future__ import annotations

from collections.abc import Collection

from petsc4py import PETSc

from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.errors import SolveError
from thinlayer.solving.options import OptionValue, require_known_values

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


def linear_solvers(model: Model) -> list[dict[str, OptionValue]]:
    """PETSc options to try in turn.

    Direct: MUMPS, Cholesky where the tangent is symmetric, else LU; AMF ordering. Large models start with conjugate
    gradients (GMRES without symmetry) and algebraic multigrid that knows the rigid motions; very stiff layers slow it down
    so much that factorising is faster. Incompressible layers make a saddle point: direct.
    """
    direct = direct_solver(model)
    unknowns = model.V.dofmap.index_map.size_global * model.V.dofmap.index_map_bs
    saddle = any(p.law.traits.constrained for p in model.layer_terms)
    if saddle or unknowns < MULTIGRID_FROM[model.joint.dim]:
        return [direct]
    return [{**MULTIGRID, "ksp_type": "cg" if model.symmetric else "gmres"}, direct]


def direct_solver(model: Model) -> dict[str, OptionValue]:
    """PETSc options of a factorisation: Cholesky, which is LDL^T unless the matrix is marked as definite, or LU."""
    return {**DIRECT, "pc_type": "cholesky" if model.symmetric else "lu"}


def tell_multigrid(ksp: PETSc.KSP, A: PETSc.Mat, model: Model) -> None:
    """Rigid motions for algebraic multigrid; nobody else reads them."""
    if ksp.getPC().getType() in ("gamg", "hypre", "ml"):
        A.setNearNullSpace(PETSc.NullSpace().create(vectors=rigid_modes(model), comm=model.comm))


def solve_linear(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, ours: Collection[str]) -> None:
    """Solve A x = b. Collective.

    Args:
        ksp: the solver.
        b: right-hand side.
        x: solution.
        ours: names of options that are not the user's.

    Raises:
        OptionError: PETSc does not take the value of an option.
        SolveError: PETSc, or a library that it calls, has ended with an error. It leaves what it worked on locked: the
            solver is of no more use; b is not touched, as a copy of it was solved for.
    """
    right = b.copy()
    try:
        ksp.solve(right, x)
    except PETSc.Error as error:
        require_known_values(error, ours)
        raise failed_in_petsc(error) from error
    finally:
        right.destroy()


def failed_in_petsc(error: PETSc.Error) -> SolveError:
    """What an error of PETSc is for who marches: a solve that has failed."""
    said = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines()]
    return SolveError(f"PETSc: {said[-1] if said else ''} (error {error.ierr})")


def mark(A: PETSc.Mat, model: Model, *, saddle: bool) -> None:
    """Tell PETSc whether a tangent is symmetric and positive definite, which that of a saddle point of energy is not."""
    A.setOption(PETSc.Mat.Option.SYMMETRIC, model.symmetric)
    A.setOption(PETSc.Mat.Option.SPD, model.symmetric and model.linear and not saddle)


def rigid_modes(model: Model) -> list[PETSc.Vec]:
    """Orthonormal rigid motions. Collective."""
    basis: list[PETSc.Vec] = []
    for motion in rigid_motions(model.V, model.joint).values():
        v = motion.x.petsc_vec.copy()
        for b in basis:
            v.axpy(-v.dot(b), b)
        v.normalize()
        basis.append(v)
    return basis
