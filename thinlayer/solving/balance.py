"""When forces are in balance: the residual that solvers aim at, and the check of every state before it is returned."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.errors import SolveError
from thinlayer.solving.force_scale import ALLOWED, ForceScale


class Balance(Protocol):
    """What is asked of the balance of forces of a step.

    Attributes:
        comm: communicator.
        failed: number of points where a part of the balance failed.
        scale: what residuals are measured by.
    """

    comm: MPI.Intracomm
    failed: int
    scale: ForceScale

    @property
    def held(self) -> npt.NDArray[np.int32]:
        """Unknowns of this rank that supports prescribe."""

    def failure(self) -> str:
        """What failed, and where."""


def aim(equations: Balance, x: PETSc.Vec) -> float:
    """Norm of a residual at unknowns x that solvers aim at. Collective."""
    return equations.scale.aim(float(x.norm(PETSc.NormType.INFINITY)))


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
    if size <= scale.allowed:
        return
    failed = f"; {equations.failure()}" if equations.failed else ""
    raise SolveError(
        f"what the solver returned is no equilibrium: forces of {scale.relative(size):.1e} of the loads "
        f"and stresses are out of balance, allowed: {ALLOWED:g}{failed}",
        advice="do PETSc options (in the script, on the command line, in PETSC_OPTIONS or a file petscrc) end it early?",
    )
