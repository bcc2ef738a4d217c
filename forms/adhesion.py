"""Adhesion that time takes to be lost, and may restore: a law of jumps whose intensity of adhesion follows a rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import ufl

from forms.breaking import DamageResults, ElasticJumpLaw
from forms.law import choice, require_positive
from forms.tensors import Expr
from forms.traction import JumpStep


@dataclass(frozen=True)
class Adhesion(DamageResults, ElasticJumpLaw):
    """Adhesion of intensity beta, from 1 to 0, lost at a rate (Raous, Cangemi and Cocou, 1999), without friction.

    With c = K_N <w_N>+^2 + K_T |w_T|^2, where w is the jump,

        t = beta^2 (K_N <w_N>+ n + K_T w_T) - K_N <-w_N>+ n,   b d(beta)/dt = -<beta c - W>+,

    and without the brackets where adhesion heals. At slow rates a ray costs W, with the largest stress sqrt(K W), and
    faster ones cost more. The internal variable d is 1 - beta^2. The stored energy is beta^2 c/2 + K_N <-w_N>+^2/2, and
    W (1 - beta) is dissipated; where adhesion heals, this is stored.

    Stresses may fall in time as jumps grow, while t(w) has no path that knows no time: the law is not `softens`, and a
    `march` takes its times as they are. Take steps in which beta changes little, such as those of `Adaptive`. A sudden
    load finds the adhesion unchanged.

    Attributes:
        K_N, K_T: stiffnesses in opening and in shear at beta = 1, stress per length.
        W: work of adhesion, energy per area, > 0.
        b: viscosity of adhesion, energy times time per area, > 0.
        heals: whether beta grows, up to 1, at most at the rate W/b, where beta c < W.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import Adhesion
        >>> from thinlayer import drive
        >>> tape = Adhesion(K_N=1e4, K_T=1e4, W=0.3, b=0.01)
        >>> history = drive(tape, [{"w_T": 0.0, "w_N": 0.01}] * 2, dt=[0, 0.01])
        >>> print(history.tractions[:, 1].round(3))
        [100.    42.25]
    """

    W: float
    b: float
    heals: bool = choice(False)
    internal: ClassVar = {"d": ()}
    symmetric: ClassVar = False
    takes_fields: ClassVar = True

    def check(self) -> None:
        super().check()
        require_positive(self, "W", "b")
        self.require(isinstance(self.heals, bool), "heals", "True or False")

    @property
    def relaxation_times(self) -> tuple[float, ...]:
        """The time b/W, in which lost adhesion heals."""
        return (self.b / self.W,)

    def _parts(self, w: Expr, n: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the tractions (3,) at beta = 1 of adhesion and of closing, and c, at a jump w."""
        w_N = ufl.dot(w, n)
        opening, w_T = ufl.conditional(ufl.ge(w_N, 0), w_N, 0.0), w - w_N * n
        c = self.K_N * opening**2 + self.K_T * ufl.inner(w_T, w_T)
        return self.K_N * opening * n + self.K_T * w_T, self.K_N * (w_N - opening) * n, c

    @staticmethod
    def _intensity(d: Expr) -> Expr:
        return ufl.sqrt(ufl.max_value(1 - d, 0.0))

    def _intensities(self, step: JumpStep) -> tuple[Expr, Expr, Expr]:
        """Return beta at the beginning, at the time in the step at which forces balance, and at the end."""
        dt: Expr = step.dt
        old, loss = self._intensity(step.q["d"]), dt * self._parts(step.mid, step.n)[2]
        new = (self.b * old - (1 - step.theta) * loss * old + self.W * dt) / (self.b + step.theta * loss)
        new = ufl.max_value(ufl.min_value(new, 1.0 if self.heals else old), 0.0)
        return old, step.between(old, new), new

    def traction(self, step: JumpStep) -> Expr:
        adhesion, closing, _ = self._parts(step.mid, step.n)
        return self._intensities(step)[1] ** 2 * adhesion + closing

    def evolve(self, step: JumpStep) -> dict[str, Expr]:
        d = 1 - self._intensities(step)[2] ** 2
        return {"d": d if self.heals else ufl.max_value(d, step.q["d"])}

    def energy(self, step: JumpStep) -> Expr:
        (_, closing, c), d = self._parts(step.w, step.n), step.q["d"]
        surface = self.W * (1 - self._intensity(d)) if self.heals else 0.0
        return (1 - d) * c / 2 + ufl.inner(closing, closing) / (2 * self.K_N) + surface

    def dissipated(self, step: JumpStep) -> Expr:
        """Return the energy that the loss of adhesion, or its healing, costs in the step, UFL; never negative."""
        (old, mid, new), c = self._intensities(step), self._parts(step.mid, step.n)[2]
        return (old - new) * (mid * c - (self.W if self.heals else 0.0))
