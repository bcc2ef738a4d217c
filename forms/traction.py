"""TractionLaw: an interface law written for jump and traction, on S only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import ufl

from forms.kinematics import Expr
from forms.law import Law, LawError, Step, shaped


class JumpStep(NamedTuple):
    """What a traction law is told at one point of S; as `Step`, with jumps (3,) for strains, and n (3,) in 2D too."""

    w: Expr
    w_old: Expr | None
    n: Expr
    q: Mapping[str, Expr]
    dt: Expr | None
    theta: Expr

    @property
    def mid(self) -> Expr:
        """Jump at t + theta dt."""
        return self.w if self.w_old is None else self.theta * self.w + (1 - self.theta) * self.w_old

    @property
    def rate(self) -> Expr:
        """Rate of the jump over the step."""
        return (self.w - self.w_old) / self.dt

    @classmethod
    def of(cls, step: Step) -> JumpStep:
        """From a step whose strains are sym(w (x) n)."""
        n = step.n

        def jump(e: Expr) -> Expr:
            return 2 * ufl.dot(e, n) - ufl.dot(ufl.dot(e, n), n) * n

        w_old = None if step.e_old is None else jump(step.e_old)
        return cls(jump(step.e), w_old, n, step.q, step.dt, step.theta)


class _NoRate(JumpStep):
    __slots__ = ()

    @property
    def rate(self) -> Expr:
        raise LawError("a law that asks for step.rate must declare rate = True")


class TractionLaw(Law):
    """A law t = t([u]) that no bulk law stands behind: printed formulas, measured curves. On S only, of order 0.

    Subclasses are frozen dataclasses with their parameters as fields (per jump: nothing is multiplied by eps). They give
    `traction(step)`, UFL, (3,), and with internal variables (shape (), (3,) or (3, 3)) `evolve(step)`, of a `JumpStep`.
    One whose tangent is not symmetric says `symmetric = False`, as any law.
    """

    def __post_init__(self) -> None:
        if self.powers:
            raise LawError(f"{type(self).__name__}: a traction law has no powers of eps")
        super().__post_init__()

    def _told_by_methods(self) -> dict[str, bool]:
        return super()._told_by_methods() | {"compiled": True, "in_series": False}

    def traction(self, step: JumpStep) -> Expr:
        """Traction at t + theta dt, (3,)."""
        raise LawError(f"{type(self).__name__} gives no traction; a traction law needs a method traction(step)")

    def evolve(self, step: JumpStep) -> dict[str, Expr]:
        """Internal variables at the end of the step."""
        known = ", ".join(self.internal)
        raise LawError(f"{type(self).__name__} gives no new {known}; a law with internal needs a method evolve(step)")

    def stress(self, step: Step) -> Expr:
        """The symmetric tensor T with T n = t and T : sym(v (x) n) = t . v."""
        t, n = shaped(self, "traction", self.traction(self._jumps(step)), (3,)), step.n
        return ufl.outer(t, n) + ufl.outer(n, t) - ufl.dot(t, n) * ufl.outer(n, n)

    def advance(self, step: Step) -> dict[str, Expr]:
        return self.evolve(self._jumps(step)) if self.internal else {}

    def plane_stress(self) -> TractionLaw:
        """The law itself: jumps and tractions know no plane."""
        return self

    def _jumps(self, step: Step) -> JumpStep:
        return JumpStep.of(step) if self.traits.rate else _NoRate(*JumpStep.of(step))
