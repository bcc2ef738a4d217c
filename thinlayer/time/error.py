"""The error of a step of adaptive length, estimated in displacements, jumps and forces."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from thinlayer.discretisation.state import State
from thinlayer.solving.equations import Equations

Array = npt.NDArray[np.float64]
LEAST_JUMP = 1e-6  # of the displacements: what is left of a jump that is none lies far below, errors that matter above


class ErrorEstimate:
    """Compares a step with its two halves. Collective, as all methods are.

    What is compared, in L2 norms: the displacements of nodes; the strains of the layer at its points, which on S are jumps
    over the thickness (under a contact law the jumps at nodes); and the nodal forces of the bodies' stresses, which where
    loads do not change are reactions of supports and tractions on the layer. A layer may relax under bodies that hardly
    move, and a jump may be small against displacements that a body has as a whole.

    Args:
        equations: of the model.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations, self.comm = equations, equations.comm
        self._unit = self._of_unit_displacements()

    def error(self, whole: State, halves: State, order: int, largest: list[float]) -> float:
        """Estimated error of the two halves' end, the largest of the three, each over the largest of its kind so far."""
        ends = [self._seen(state.u) for state in (whole, halves)]
        apart = self._norms([b - a for a, b in zip(*ends, strict=True)])
        sizes = np.maximum(self._norms(ends[1]), largest)
        moved = float(halves.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))
        least = np.array([0.0, LEAST_JUMP * self._unit * moved, self._equations.scale.forces])
        sizes = np.maximum(sizes, least)
        share = np.divide(apart, sizes, out=np.zeros(3), where=sizes > 0)
        return float(share.max()) / (2**order - 1)

    def sizes(self, state: State) -> Array:
        """Of the three in a state."""
        return self._norms(self._seen(state.u))

    def _seen(self, u: fem.Function) -> list[Array]:
        """What is compared, of displacements, on this rank."""
        forces = u.x.petsc_vec.duplicate()
        forces.set(0.0)
        jumps = [part.error_measure(u, forces) for part in self._equations.parts]
        of_forces = forces.array_r.copy()
        forces.destroy()
        return [u.x.petsc_vec.array_r.copy(), np.concatenate(jumps), of_forces]

    def _norms(self, parts: list[Array]) -> Array:
        return np.sqrt(self.comm.allreduce(np.array([part @ part for part in parts])))

    def _of_unit_displacements(self) -> float:
        """The norm that strains or jumps may have, about, where displacements of size 1 differ by 1 across the layer."""
        return float(np.sqrt(sum(part.unit_jump_measure() for part in self._equations.parts)))
