"""TractionLaw: an interface law that gives the traction for a jump; it acts on S only, not in a meshed layer."""

from __future__ import annotations

from functools import cache, cached_property
from typing import ClassVar

import ufl

from forms.base import InputError
from forms.law import BulkLaw, Law, Step, WrappedLaw, require_shape
from forms.tensors import Expr
from forms.traits import STRESS_ATTRIBUTES, Traits


class JumpStep(Step):
    """Input of a traction law at one point of S over a time step: a `Step` with jumps (3,) in place of strains.

    The normal n and the jumps have 3 components in 2D, too.

    Attributes:
        w, w_old: jump (3,) at the end of the step, and at its beginning.
    """

    w: Expr = Step.e
    w_old: Expr = Step.e_old
    n: Expr = Step.n

    @classmethod
    def of_step(cls, step: Step) -> JumpStep:
        """Return the step of a traction law for a `step` whose strains are sym(w (x) n) with jumps w."""
        n = step.n

        def jump(e: Expr) -> Expr:
            return 2 * ufl.dot(e, n) - ufl.dot(ufl.dot(e, n), n) * n

        return cls(*step._replace(e=jump(step.e), e_old=None if step.e_old is None else jump(step.e_old)))


class TractionLaw(Law):
    """A law t = t([u]) between traction and jump, such as a published formula or a measured curve; on S only.

    It is not derived from the law of a material. Subclasses are frozen dataclasses with their parameters as fields; no
    parameter depends on the thickness. They define `traction(step)`, UFL (3,), where `step` is a `JumpStep`. A subclass
    with internal variables, of shape (), (3,) or (3, 3), also defines `evolve(step)`. It may define `energy(step)`, and
    with it `dissipated(step)` or `dissipation(step)`. If its tangent is not symmetric, it declares `symmetric = False`.
    """

    ignored: ClassVar = (*STRESS_ATTRIBUTES, "stress", "advance", "homotopy")

    def __post_init__(self) -> None:
        if self.powers:
            raise InputError(f"{type(self).__name__}: a traction law has no powers of eps")
        super().__post_init__()

    def _traits_of_methods(self) -> dict[str, bool]:
        has_energy = type(self).energy is not TractionLaw.energy
        traits = {"has_energy": has_energy, "in_ufl": True, "of_jumps": True, "compiled": True}
        return super()._traits_of_methods() | traits

    def as_bulk_law(self) -> BulkLaw:
        cls: type = type(self)
        return _make_bulk_law_class(cls)(self)

    def traction(self, step: JumpStep) -> Expr:
        """Return the traction (3,), UFL, at t + theta dt, the time in the step at which forces balance."""
        raise InputError(f"{type(self).__name__} has no traction; a traction law needs a method traction(step)")

    def evolve(self, step: JumpStep) -> dict[str, Expr]:
        """Return the internal variables at the end of the step, UFL by name."""
        names = ", ".join(self.internal)
        raise InputError(f"{type(self).__name__} gives no new {names}; a law with internal needs a method evolve(step)")

    def energy(self, step: JumpStep) -> Expr:
        """Return the stored energy per unit area, UFL, at the jump step.w and the internal variables step.q."""
        raise InputError(f"{type(self).__name__} declares no energy; a traction law needs a method energy(step) for it")

    def dissipation(self, step: JumpStep) -> Expr:
        """Return the mean dissipated power per unit area over the step, UFL: the dissipated energy divided by dt."""
        return ufl.as_ufl(0.0)

    def dissipated(self, step: JumpStep) -> Expr:
        """Return the energy per unit area that is dissipated in the step, UFL.

        A law without rate defines this method in place of `dissipation`.
        """
        return step.dt * self.dissipation(step)


class TractionAsBulkLaw(WrappedLaw):
    """A traction law t([u]) in the form of a law of strains, for the strains sym(w (x) n) of jumps w.

    Its stress T is such that T n = t, and T : sym(v (x) n) = t . v for all vectors v. It is the same in plane stress.

    Attributes:
        law: the traction law.
    """

    methods: ClassVar = ("traction", "evolve")

    @cached_property
    def traits(self) -> Traits:
        return self.law.traits

    def stress(self, step: Step) -> Expr:
        t, n = require_shape(self, "traction", self.law.traction(JumpStep.of_step(step)), (3,)), step.n
        return ufl.outer(t, n) + ufl.outer(n, t) - ufl.dot(t, n) * ufl.outer(n, n)

    def advance(self, step: Step) -> dict[str, Expr]:
        return self.law.evolve(JumpStep.of_step(step)) if self.internal else {}

    def energy(self, step: Step) -> Expr:
        return self.law.energy(JumpStep.of_step(step))

    def dissipated(self, step: Step) -> Expr:
        return self.law.dissipated(JumpStep.of_step(step))

    @property
    def has_modes(self) -> bool:
        return self.law.has_modes

    def mode_energies(self, step: Step) -> tuple[Expr, Expr]:
        return self.law.mode_energies(JumpStep.of_step(step))


@cache
def _make_bulk_law_class(cls: type) -> type[TractionAsBulkLaw]:
    """Return a subclass of `TractionAsBulkLaw` that has the name and the module of `cls`, a class of traction laws.

    Messages, and the keys of compiled code, contain this name.
    """
    return type(cls.__name__, (TractionAsBulkLaw,), {"__module__": cls.__module__, "__qualname__": cls.__qualname__})
