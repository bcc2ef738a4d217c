"""Tests of balance: the residual at which solvers stop, and the check of each state before it is returned."""

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
    """The equations of a step, as far as the tests of balance need them.

    Attributes:
        comm: communicator.
        failed: number of points where a part of the balance failed.
        scale: the forces that residuals are compared with.
    """

    comm: MPI.Intracomm
    failed: int
    scale: ForceScale

    @property
    def held(self) -> npt.NDArray[np.int32]:
        """Unknowns of this rank that supports prescribe."""

    def failure(self) -> str:
        """Text that says which part failed and where; "" if none did."""


def aim(equations: Balance, x: PETSc.Vec) -> float:
    """Norm of the residual at which solvers stop, at unknowns x. Collective."""
    return equations.scale.aim(float(x.norm(PETSc.NormType.INFINITY)))


def free_norm(equations: Balance, r: PETSc.Vec) -> float:
    """Norm of a residual over the unknowns that are not held. Collective."""
    free = r.array_r.copy()
    free[equations.held] = 0.0
    return math.sqrt(equations.comm.allreduce(float(free @ free)))


def require_equilibrium(equations: Balance, x: PETSc.Vec, r: PETSc.Vec) -> None:
    """Raise SolveError unless the residual r at unknowns x is small against the forces. Collective.

    PETSc options do not change this test, so a solver that stopped too early is noticed here.
    """
    size, scale = free_norm(equations, r), equations.scale
    if size <= scale.allowed:
        return
    failed = f"; {equations.failure()}" if equations.failed else ""
    raise SolveError(
        f"what the solver returned is no equilibrium: {scale.relative(size):.1e} of the forces of loads and stresses "
        f"is out of balance, allowed: {ALLOWED:g}{failed}",
        advice="do PETSc options (in the script, on the command line, in PETSC_OPTIONS or a file petscrc) end the solve "
        "early?",
    )
