"""Surface: the fields of states on S, as numbers, the same on all ranks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from thinlayer.discretisation.state import State
from thinlayer.output.tractions import by_reactions, of_layers
from thinlayer.surface.surface_mesh import SurfaceMesh

Array = npt.NDArray[np.float64]


class Surface(SurfaceMesh):
    """S of a joint, or one of its seams, and the fields of states of all models of the joint there.

    The constructor and all methods that take a state are collective; the results are those of all S on every rank.
    Arguments, attributes and errors are those of `SurfaceMesh`.
    """

    def traction(self, state: State) -> Array:
        """(d, n, q) traction t = stress n on S, linear on each facet: an L2 projection.

        On the surface of a model with a contact law, whose tractions are at nodes, all are lumped there.

        - Of an interface law it is its own: what works in [u]. Under contact it is that at the nodes.
        - Of a meshed layer it is the mean of stress n through the thickness, elastic sublayers weighted by compliance; zero
          where layers meet. Where the thickness varies on a rigid base it differs from the law's by O(eps).
        - At bonds it is the bodies' reaction (`reaction`).
        """
        self._require_same_joint(state)
        model = state.model
        if not model.bonds:
            return self.at_points(of_layers(self, state))
        bonded = np.isin(
            self.joint.seam_numbers[self.rows], [list(self.joint.seams).index(name) for name in model.bonds]
        )
        reaction = self.reaction(state)
        return reaction if bonded.all() else np.where(bonded[:, None], reaction, self.at_points(of_layers(self, state)))

    def reaction(self, state: State) -> Array:
        """(d, n, q) the traction whose nodal forces are the bodies' reactions on both sides, linear on each facet.

        Where a support holds one side it is that of the other side. Where supports hold both sides, and in a cycle of
        seams around a vertex, reactions do not tell all of it: it is then the one closest to the means around.
        At a tip of S it is zero.
        """
        self._require_same_joint(state)
        whole = SurfaceMesh(self.model)  # forces at junctions are of all seams there
        nodal = by_reactions(whole, state)
        return self.at_points(nodal[np.searchsorted(whole.numbers, self.numbers)])
