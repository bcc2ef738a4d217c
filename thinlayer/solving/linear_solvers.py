"""Linear solvers for a model: their PETSc options, properties of the matrix, and rigid motions for multigrid."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from petsc4py import PETSc

from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.errors import SolveError
from thinlayer.parts.part import FieldPart, Part
from thinlayer.parts.pressure import PressurePart
from thinlayer.solving.options import OptionError, OptionValue, require_known_values

DIRECT: dict[str, OptionValue] = {
    "ksp_type": "preonly",
    "ksp_rtol": 1e-10,
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_7": 2,
    "mat_mumps_icntl_14": 100,  # spare memory in per cent: with its default of 20, MUMPS sometimes fails on several ranks
}
# for saddle points at which MUMPS puts off pivots again and again: more memory, then smaller pivots, too
SPACIOUS: dict[str, OptionValue] = {"mat_mumps_icntl_14": 1000}
LENIENT: dict[str, OptionValue] = {**SPACIOUS, "mat_mumps_cntl_1": 1e-4}
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
MULTIGRIDS = ("gamg", "hypre", "ml")  # PETSc's kinds of algebraic multigrid, for the displacements
# for saddle points: multigrid for the displacements after a factorisation for the pressures on S (`solving/saddle.py`). A
# preconditioner that is not symmetric takes half the iterations of one for MINRES, and each costs the same.
BLOCKS: dict[str, OptionValue] = {
    "ksp_type": "gmres",
    "ksp_pc_side": "right",  # then the residual itself is tested
    "ksp_gmres_restart": 100,
    "ksp_gmres_cgs_refinement_type": "refine_ifneeded",
    "ksp_rtol": MULTIGRID["ksp_rtol"],
    "ksp_max_it": MULTIGRID["ksp_max_it"],
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    **{
        f"fieldsplit_u_{name}": value
        for name, value in MULTIGRID.items()
        if name not in DIRECT and name != "ksp_max_it"
    },
    "fieldsplit_u_ksp_type": "preonly",
    **{f"fieldsplit_p_{name}": value for name, value in DIRECT.items() if name != "ksp_rtol"},
    "fieldsplit_p_pc_type": "cholesky",
}
MULTIGRID_FROM = {2: 3_000_000, 3: 50_000}  # dimension -> number of unknowns below which factorising is faster


def linear_solvers(model: Model, parts: Sequence[Part], chosen: str | None = None) -> list[dict[str, OptionValue]]:
    """PETSc options to try in turn.

    The direct solver is MUMPS with AMF ordering: Cholesky for symmetric tangents, else LU. Large models try conjugate
    gradients (GMRES without symmetry) with algebraic multigrid first; it knows the rigid motions. Very stiff layers slow
    multigrid down so much that factorising is faster. Layers with a pressure lead to saddle points: if the pressures are on
    S, large models try GMRES with blocks first; if MUMPS fails, it is tried with more memory, then with smaller pivots too.

    Args:
        model: the model.
        parts: the parts of its balance.
        chosen: the user's type of preconditioner; None: ours.

    Raises:
        OptionError: a type of preconditioner that does not suit the model.
    """
    direct = direct_solver(model)
    large = model.unknowns >= MULTIGRID_FROM[model.joint.dim]
    if any(isinstance(part, PressurePart) for part in parts):
        if chosen in MULTIGRIDS:
            raise OptionError(
                f"pc_type {chosen} cannot solve for the pressures of a layer, too; use pc_type fieldsplit"
            )
        factorising = [direct, {**direct, **SPACIOUS}, {**direct, **LENIENT}]
        if chosen != "fieldsplit" and not large:
            return factorising
        unsuited = [part.key for part in parts if isinstance(part, FieldPart) and part.own_mass is None]
        if chosen == "fieldsplit" and unsuited:
            raise OptionError(
                f"pc_type fieldsplit is for displacements and pressures on S; the unknowns {unsuited[0]!r} are others (of "
                "a meshed layer, a plate or a mean stress)"
            )
        return factorising if unsuited else [BLOCKS, *factorising]
    iterative = {**MULTIGRID, "ksp_type": "cg" if model.symmetric else "gmres"}
    if chosen in MULTIGRIDS:
        return [iterative]
    return [iterative, direct] if large else [direct]


def direct_solver(model: Model) -> dict[str, OptionValue]:
    """PETSc options of a factorisation: Cholesky (LDL^T unless the matrix is marked as definite), or LU."""
    return {**DIRECT, "pc_type": "cholesky" if model.symmetric else "lu"}


def solve_linear(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec, ours: Collection[str] | None = None) -> None:
    """Solve A x = b. Collective.

    Args:
        ksp: the solver.
        b: right-hand side.
        x: solution.
        ours: names of the options that are our defaults; None: the caller looks at PETSc's errors.

    Raises:
        OptionError: PETSc does not accept the value of an option. PETSc.Error instead of both if `ours` is None.
        SolveError: PETSc, or a library that it calls, has failed. Do not use the solver again: its vectors stay locked. b
            is unchanged.
    """
    right = b.copy()  # PETSc leaves the right-hand side locked after an error
    try:
        ksp.solve(right, x)
    except PETSc.Error as error:
        if ours is None:
            raise
        require_known_values(error, ours)
        raise failed_in_petsc(error) from error
    finally:
        right.destroy()


def solve_nonlinear(snes: PETSc.SNES, x: PETSc.Vec, *own: PETSc.Vec) -> None:
    """Solve from x, in place, by an SNES. Collective.

    After an error PETSc leaves vectors locked for ever: the solution's after one in a function that it has called, the
    residual's after one in a linear solve. Therefore it gets a copy of x, and after an error the SNES and its vectors go.

    Args:
        snes: the solver.
        x: unknowns; unchanged after an error.
        own: vectors that only this SNES uses, as that of its function; destroyed after an error.

    Raises:
        Exception: what a function that PETSc has called raises. PETSc.Error: PETSc itself has failed.
    """
    inside = x.copy()
    try:
        snes.solve(None, inside)
    except PETSc.Error as error:
        for thing in (snes, *own):
            thing.destroy()
        if error.__cause__ is not None:
            raise error.__cause__ from None
        raise
    else:
        inside.copy(x)
    finally:
        inside.destroy()


def failed_in_petsc(error: PETSc.Error) -> SolveError:
    """A SolveError for an error of PETSc, so that a march can try a shorter step."""
    said = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines()]
    return SolveError(f"PETSc: {said[-1] if said else ''} (error {error.ierr})")


def mark(A: PETSc.Mat, model: Model, *, saddle: bool) -> None:
    """Tell PETSc whether a tangent is symmetric, and whether it is positive definite, as it is not at a saddle point."""
    A.setOption(PETSc.Mat.Option.SYMMETRIC, model.symmetric)
    A.setOption(PETSc.Mat.Option.SPD, model.symmetric and model.linear and not saddle)


def rigid_modes(model: Model) -> list[PETSc.Vec]:
    """Orthonormal rigid motions. Collective."""
    motions = rigid_motions(model.V, model.joint, model.kinematics)
    return orthonormal([motion.x.petsc_vec.copy() for motion in motions.values()])


def orthonormal(vectors: list[PETSc.Vec]) -> list[PETSc.Vec]:
    """Make vectors, which are overwritten, orthonormal; they are independent."""
    for k, v in enumerate(vectors):
        for b in vectors[:k]:
            v.axpy(-v.dot(b), b)
        v.normalize()
    return vectors
