"""When forces are in balance: how small a residual must be, and the check of every state before it is returned."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.errors import SolveError

TOLERANCE = 1e-10  # that solvers aim at: residual over the forces of the bodies' stresses, or the loads
LARGEST_RESIDUAL = 1e-6  # that a state may have, whoever found it


class Balance(Protocol):
    """What is asked of the balance of forces of a step.

    Attributes:
        comm: communicator.
        failed: number of points where a part of the balance failed.
        scale: size of the forces in the last residual.
        least_residual: what rounding leaves of the forces of stiff bodies that supports move.
    """

    comm: MPI.Intracomm
    failed: int
    scale: float
    least_residual: float

    @property
    def held(self) -> npt.NDArray[np.int32]:
        """Unknowns of this rank that supports prescribe."""

    @property
    def least_scale(self) -> float:
        """Size of the loads, or of what rounding leaves."""

    def rounding_at(self, x: PETSc.Vec) -> float:
        """What rounding leaves of the forces at unknowns x."""

    def failure(self) -> str:
        """What failed, and where."""


def aim(equations: Balance, x: PETSc.Vec) -> float:
    """Norm of a residual at unknowns x that solvers aim at: against the forces, or all that rounding allows."""
    rounding = min(equations.rounding_at(x), LARGEST_RESIDUAL * equations.least_scale)
    return max(TOLERANCE * equations.scale, equations.least_residual, rounding)


def free_norm(equations: Balance, r: PETSc.Vec) -> float:
    """Norm of a residual where nothing is held. Collective."""
    free = r.array_r.copy()
    free[equations.held] = 0.0
    return math.sqrt(equations.comm.allreduce(float(free @ free)))


def require_equilibrium(equations: Balance, x: PETSc.Vec, r: PETSc.Vec) -> None:
    """Raise SolveError unless the residual r at unknowns x is small against the forces. Collective.

    No option of PETSc's changes this: a solver that was told to stop early is found out here.
    """
    size, scale = free_norm(equations, r), equations.scale
    if size <= max(LARGEST_RESIDUAL * scale, equations.least_residual):
        return
    failed = f"; {equations.failure()}" if equations.failed else ""
    raise SolveError(
        f"what the solver returned is no equilibrium: forces of {size / max(scale, np.finfo(float).tiny):.1e} of the loads "
        f"and stresses are out of balance, allowed: {LARGEST_RESIDUAL:g}{failed}",
        advice="do PETSc options (in the script, on the command line, in PETSC_OPTIONS or a file petscrc) end it early?",
    )
