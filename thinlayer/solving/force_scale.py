"""The force scale of a step: the forces that residuals are compared with, and their rounding."""

from __future__ import annotations

import numpy as np

AIM = 1e-10  # residual at which solvers stop, relative to the forces
ALLOWED = 1e-6  # largest residual of an accepted state, relative to the forces
EPSILON = float(np.finfo(float).eps)
ROUNDING_SHARE = 1e-14  # rounding of summed forces, relative to stiffness times displacement
TINY = 1e-300  # divisor instead of zero if there are no forces


class ForceScale:
    """The forces that the residuals of a step are compared with. Norms of forces and residuals are Euclidean.

    Its rules:

    1. Residuals are relative to "the forces": the largest of the loads, the forces of the stresses at the last residual,
       and the residual at the start of the step.
    2. If supports move stiff bodies, or if loads end at zero, all forces may be rounding errors. Therefore the forces have
       a lower bound: 1e-14 of stiffness times displacement, their rounding, divided by the 1e-6 of rule 6.
    3. Solvers stop at a residual of 1e-10 of the forces.
    4. If bodies have moved far on soft springs, rounding may exceed rule 3. Solvers then stop at the rounding of stiffness
       times displacement, but at no more than 1e-6 of the forces of rules 1 and 2 without those of the stresses.
    5. A residual as small as the rounding of prescribed displacements is always allowed; no solver can reduce it.
    6. A state is accepted with a residual of at most 1e-6 of the forces, or at most that of rule 5.

    Neither a factor common to all forces, such as a change of units, nor a rigid motion of supports and bodies changes a
    relative residual.

    Args:
        stiffness: norm of the diagonal of the bodies' stiffness.
        cancelling: norm of the diagonal of the stiffness of springs that act on differences of displacements.

    Attributes:
        stiffness: the argument.
        forces: the forces of rules 1 and 2 for the last residual.
        displacement: largest displacement that is known before the step: prescribed, or that of the state before.
    """

    def __init__(self, stiffness: float, cancelling: float = 0.0) -> None:
        self.stiffness, self._largest_stiffness = stiffness, max(stiffness, cancelling)
        self.begin(0.0, 0.0, 0.0)

    def begin(self, loads: float, prescribed: float, moved: float) -> None:
        """Begin a step.

        Args:
            loads: norm of the loads.
            prescribed: largest displacement that supports prescribe.
            moved: largest displacement of the state before.
        """
        self._loads, self._unbalanced, self.displacement = loads, 0.0, max(prescribed, moved)
        self._least_forces = ROUNDING_SHARE / ALLOWED * self.stiffness * self.displacement
        self._support_rounding = EPSILON * self.stiffness * prescribed
        self.forces = self.least

    def start(self, unbalanced: float) -> None:
        """Take the norm of the residual at the start of the step; the step may have no other forces."""
        self._unbalanced = unbalanced if np.isfinite(unbalanced) else 0.0

    @property
    def least(self) -> float:
        """The forces of rules 1 and 2 without those of the stresses."""
        return max(self._loads, self._unbalanced, self._least_forces)

    def see(self, *stresses: float) -> None:
        """Take norms of the forces of the stresses at a new residual."""
        self.forces = max([self.least, *stresses])

    def rounding(self, largest_displacement: float) -> float:
        """Rounding of the forces."""
        return EPSILON * self._largest_stiffness * largest_displacement

    def aim(self, largest_displacement: float) -> float:
        """Norm of the residual at which solvers stop."""
        return max(
            AIM * self.forces, self._support_rounding, min(self.rounding(largest_displacement), ALLOWED * self.least)
        )

    @property
    def allowed(self) -> float:
        """Largest norm of the residual of an accepted state."""
        return max(ALLOWED * self.forces, self._support_rounding)

    def relative(self, norm: float) -> float:
        """The norm of a residual divided by the forces."""
        return norm / max(self.forces, TINY)
