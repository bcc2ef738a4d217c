"""How small a residual must be: the size of the forces in a step, and what rounding leaves of them."""

from __future__ import annotations

import numpy as np

AIM = 1e-10  # share of the forces that solvers leave out of balance
ALLOWED = 1e-6  # share of the forces that an accepted state may have out of balance, whoever found it
EPSILON = float(np.finfo(float).eps)
ROUNDED = 1e-14  # share of stiffness times displacement that is rounding, once it has been added up
TINY = 1e-300  # in place of zero, where there are no forces at all


class ForceScale:
    """The one measure of residuals of a step, all norms over the free displacements or forces of a model.

    Its rules:

    1. A residual is measured by the forces: the largest of the loads, of the forces of stresses at the last residual, and
       of what was out of balance when the step began.
    2. Where supports move stiff bodies, or loads end at zero, forces may be nothing but rounding. No forces are smaller
       than those of which that rounding, 1e-14 of stiffness times displacement, is the share allowed to a state.
    3. Solvers aim at 1e-10 of the forces.
    4. Bodies that have moved far on soft springs leave more than that: solvers need not go below the rounding of stiffness
       times displacement, but to 1e-6 of what rules 1 and 2 give without the forces of stresses.
    5. Rounding of prescribed displacements is always allowed; no solver can remove it.
    6. A state is accepted with 1e-6 of the forces out of balance, or with what rule 5 allows.

    A factor common to all forces, as a change of units, and a rigid motion of supports and bodies change no ratio.

    Attributes:
        stiffness: norm of the diagonal of the bodies' stiffness.
        cancelling: the same of springs that act on differences of displacements.
        forces: rules 1 and 2, for the last residual.
    """

    def __init__(self, stiffness: float, cancelling: float = 0.0) -> None:
        self.stiffness, self._stiffest = stiffness, max(stiffness, cancelling)
        self.begin(0.0, 0.0, 0.0)

    def begin(self, loads: float, prescribed: float, moved: float) -> None:
        """Begin a step.

        Args:
            loads: norm of the loads.
            prescribed: largest displacement that supports prescribe.
            moved: largest displacement of the state before.
        """
        self._loads, self._unbalanced = loads, 0.0
        self._least_forces = ROUNDED / ALLOWED * self.stiffness * max(prescribed, moved)
        self._of_supports = EPSILON * self.stiffness * prescribed
        self.forces = self.least

    def start(self, unbalanced: float) -> None:
        """Take the norm of what is out of balance at the start of the step; it may be all the forces there are."""
        self._unbalanced = unbalanced if np.isfinite(unbalanced) else 0.0

    @property
    def least(self) -> float:
        """Size of the forces without those of stresses."""
        return max(self._loads, self._unbalanced, self._least_forces)

    def see(self, *stresses: float) -> None:
        """Take norms of the forces of stresses at a new residual."""
        self.forces = max([self.least, *stresses])

    def rounding(self, farthest: float) -> float:
        """What rounding leaves of the forces where the largest displacement is `farthest`."""
        return EPSILON * self._stiffest * farthest

    def aim(self, farthest: float) -> float:
        """Norm of a residual that solvers aim at, where the largest displacement is `farthest`."""
        return max(AIM * self.forces, self._of_supports, min(self.rounding(farthest), ALLOWED * self.least))

    @property
    def allowed(self) -> float:
        """Norm of the residual that a state may have."""
        return max(ALLOWED * self.forces, self._of_supports)

    def relative(self, norm: float) -> float:
        """The norm of a residual over the forces."""
        return norm / max(self.forces, TINY)
