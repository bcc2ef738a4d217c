"""When forces are in balance: how small a residual must be, and the check of every state before it is returned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from thinlayer.failure import SolveError

if TYPE_CHECKING:
    from thinlayer.equations import Equations

TOLERANCE = 1e-10  # that solvers aim at: residual over the forces of the bodies' stresses, or the loads
LARGEST_RESIDUAL = 1e-6  # that a state may have, whoever found it


def aim(equations: Equations, x: PETSc.Vec) -> float:
    """Norm of a residual at unknowns x that solvers aim at: against the forces, or all that rounding allows."""
    rounding = min(equations.rounding_at(x), LARGEST_RESIDUAL * equations.least_scale)
    return max(TOLERANCE * equations.scale, equations.least_residual, rounding)


def free_norm(equations: Equations, r: PETSc.Vec) -> float:
    """Norm of a residual where nothing is held. Collective."""
    free = r.array_r.copy()
    free[equations.held] = 0.0
    return math.sqrt(equations.comm.allreduce(float(free @ free)))


def require_equilibrium(equations: Equations, x: PETSc.Vec, r: PETSc.Vec) -> None:
    """Raise SolveError unless the residual r at unknowns x is small against the forces. Collective.

    No option of PETSc's changes this: a solver that was told to stop early is found out here.
    """
    size, scale = free_norm(equations, r), equations.scale
    if size <= max(LARGEST_RESIDUAL * scale, equations.least_residual):
        return
    failed = f"; {equations.laws.failure()}" if equations.laws.failed else ""
    raise SolveError(
        f"what the solver returned is no equilibrium: forces of {size / max(scale, np.finfo(float).tiny):.1e} of the loads "
        f"and stresses are out of balance, allowed: {LARGEST_RESIDUAL:g}{failed}",
        advice="do PETSc options (in the script, on the command line, in PETSC_OPTIONS or a file petscrc) end it early?",
    )
