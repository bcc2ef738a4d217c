"""Friction on the broken share of a joint that breaks: a cohesive law whose sides slide on each other when pressed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import ufl

from forms.breaking import Cohesive
from forms.law import Step, require_nonnegative
from forms.tensors import Expr
from forms.traction import JumpStep

MIN_STRESS_SQUARED = 1e-290  # of a trial stress, by whose magnitude it is divided


@dataclass(frozen=True)
class CohesiveFriction(Cohesive):
    """Cohesive law with Coulomb's friction on the broken share d of the area (Alfano and Sacco, 2006).

    The sound share 1 - d is that of `Cohesive`. On the broken one the sides slide by s under the pressure
    p = K_N <-w_N>+: the traction K_T (w_T - s) is not longer than f p, and s grows along it where it is as long. With
    the energies Y = Y_I + Y_II that damage releases,

        t = (1 - d) (K_N <w_N>+ n + K_T w_T) - p n + d K_T (w_T - s),
        energy = (1 - d) Y + K_N <-w_N>+^2/2 + d K_T |w_T - s|^2/2.

    Breaking costs Y - K_T |w_T - s|^2/2 per damage, and sliding d |K_T (w_T - s)| per slip: what breaks under pressure
    bears the stress f p at once, and shear costs G_II - (f p)^2/(2 K_T) in place of G_II.

    Attributes:
        friction: coefficient of friction f, >= 0; by keyword.
        K_N, K_T, t_N, t_T, G_I, G_II, eta, cracked: see `Cohesive`.
        knee_jump, knee_stress, softening, criterion, closure: see `MixedModeDamage`.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import CohesiveFriction
        >>> from thinlayer import drive
        >>> data = {"t_N": 20.0, "t_T": 30.0, "G_I": 0.3, "G_II": 0.9}
        >>> joint = CohesiveFriction(K_N=1e4, K_T=6e3, **data, friction=0.5)
        >>> history = drive(joint, [{"w_T": 0.1, "w_N": -0.001}])
        >>> print(history.tractions.round(6))
        [[  5. -10.]]
    """

    friction: float = field(kw_only=True)
    internal: ClassVar = {"d": (), "slip": (3,)}

    def check(self) -> None:
        super().check()
        require_nonnegative(self, "friction")

    def _largest_friction(self, w: Expr, n: Expr) -> Expr:
        """Return f p, the largest frictional stress at a jump."""
        w_N, _ = self.opening_and_slip(w, n)
        return self.friction * ufl.conditional(ufl.lt(w_N, 0), -self.K_N * w_N, 0.0)

    def _elastic_friction(self, w: Expr, slip: Expr, n: Expr) -> Expr:
        """Return the stress (3,) on the broken share at a jump, if its sides have slid by `slip` (3,)."""
        return self.K_T * (self.opening_and_slip(w, n)[1] - slip)

    def _friction(self, step: Step) -> Expr:
        """Return the stress (3,) on the broken share at the end of the step."""
        trial, largest = self._elastic_friction(step.e, step.q["slip"], step.n), self._largest_friction(step.e, step.n)
        bound_squared = ufl.max_value(largest**2, MIN_STRESS_SQUARED)
        return trial * largest / ufl.sqrt(ufl.max_value(ufl.inner(trial, trial), bound_squared))

    def _new_slip(self, step: Step) -> Expr:
        return self.opening_and_slip(step.e, step.n)[1] - self._friction(step) / self.K_T

    def traction(self, step: JumpStep) -> Expr:
        return super().traction(step) + self._new_damage(step) * self._friction(step)

    def evolve(self, step: JumpStep) -> dict[str, Expr]:
        return super().evolve(step) | {"slip": self._new_slip(step)}

    def energy(self, step: JumpStep) -> Expr:
        t_f = self._elastic_friction(step.w, step.q["slip"], step.n)
        return super().energy(step) + step.q["d"] * ufl.inner(t_f, t_f) / (2 * self.K_T)

    def dissipated(self, step: Step) -> Expr:
        """Return the energy that breaking and sliding cost in the step, UFL; its error is of the order of its square.

        Sliding costs the mean of the largest friction at both ends times the mean damage and the slip, never less than
        zero. Breaking costs less than in `Cohesive` by the energy with which the broken share begins.
        """
        old, new, slip = self._old_damage(step), self._new_damage(step), self._new_slip(step) - step.q["slip"]
        friction = (self._largest_friction(step.e, step.n) + self._largest_friction(step.e_old, step.n)) / 2
        ends = self._friction(step), self._elastic_friction(step.e_old, step.q["slip"], step.n)
        end, start = (ufl.inner(t_f, t_f) / (2 * self.K_T) for t_f in ends)
        at_birth = (new - old) * self._mean_of_growth(step, end, start)
        return super().dissipated(step) - at_birth + (old + new) / 2 * friction * ufl.sqrt(ufl.inner(slip, slip))
