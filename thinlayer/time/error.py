"""Estimated errors of steps: of displacements, jumps and forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.discretisation.state import State
from thinlayer.solving.equations import Equations

Array = npt.NDArray[np.float64]
# Least size of jumps to which errors are relative, as a share of the displacements; rounding is smaller.
LEAST_JUMP = 1e-6
QUANTITIES = ("displacements", "jumps", "forces")


class ErrorEstimate:
    """Compares a step with its two halves. All methods are collective.

    Three quantities are compared in L2 norms:

    - the displacements of nodes;
    - the strains of the layer at its points; on S these are jumps over the thickness, under a contact law jumps at nodes;
    - the nodal forces of the bodies' stresses, which change with reactions of supports and tractions on the layer.

    Displacements are not enough: a layer may relax under bodies that hardly move, and a jump may be small compared with
    the motion of a whole body.

    Args:
        equations: the equations of the model.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, self.comm = equations, equations.comm
        self._unit = self._of_unit_displacements()

    def error(self, whole: State, halves: State, order: int, largest: list[float]) -> float:
        """Estimated error at the end of the two halves: the largest of the three quantities' relative errors.

        Args:
            whole: state at the end of the step.
            halves: state at the end of the two halves.
            order: order of the time scheme.
            largest: norms of the three quantities to which errors are relative, at least.
        """
        return float(self.shares(whole, halves, largest).max()) / (2**order - 1)

    def shares(self, other: State, state: State, largest: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
        """Differences of two states in the three quantities, over their norms in the second one, or over `largest`."""
        ends = [self._quantities(one) for one in (other, state)]
        apart = self._norms([b - a for a, b in zip(*ends, strict=True)])
        sizes = np.maximum(self._norms(ends[1]), largest)
        moved = float(state.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))
        least = np.array([0.0, LEAST_JUMP * self._unit * moved, self._equations.scale.forces])
        sizes = np.maximum(sizes, least)
        return np.divide(apart, sizes, out=np.zeros(3), where=sizes > 0)

    def sizes(self, state: State) -> Array:
        """Norms of the three quantities in a state."""
        return self._norms(self._quantities(state))

    def _quantities(self, state: State) -> list[Array]:
        """The three quantities in a state, on this rank."""
        u = state.u
        forces = u.x.petsc_vec.duplicate()
        forces.set(0.0)
        jumps = self._equations.ask("error_measure", u)
        self._equations.ask("add_forces_in", state, forces)
        of_forces = forces.array_r.copy()
        forces.destroy()
        return [u.x.petsc_vec.array_r.copy(), np.concatenate([np.empty(0), *jumps]), of_forces]

    def _norms(self, parts: list[Array]) -> Array:
        return np.sqrt(self.comm.allreduce(np.array([part @ part for part in parts])))

    def _of_unit_displacements(self) -> float:
        """Estimated norm of strains or jumps for a unit jump across the layer."""
        return float(np.sqrt(sum(self._equations.ask("unit_jump_measure"))))
