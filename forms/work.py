"""Where laws act, and the one line that turns a law into a weak form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import ufl

from forms.kinematics import Expr, jump_strain, strain
from forms.law import Law, Step


@dataclass(frozen=True)
class Points:
    """Points where one law acts.

    Attributes:
        law: the law, its parameters real.
        strain: displacement -> strain (3, 3) at the points.
        weight: factor of the measure.
        measure: dx, ds or dS.
        n: director, (d,), or None in a body.
    """

    law: Law
    strain: Callable[[Expr], Expr]
    weight: Any
    measure: ufl.Measure
    n: Expr | None = None

    def step(self, u: Expr) -> Step:
        """What the law is told when the displacement is u."""
        return Step(self.strain(u), self.n)


@dataclass(frozen=True)
class Interface:
    """The two sides of S.

    Attributes:
        measure: dS restricted to S between two bodies, ds on a rigid base.
        n: unit normal from the lower to the upper body, (d,).
        upper, lower: value of a function on either side.
    """

    measure: ufl.Measure
    n: Expr
    upper: Callable[[Expr], Expr]
    lower: Callable[[Expr], Expr]

    @classmethod
    def between_bodies(cls, mesh: Any, measure: ufl.Measure) -> Interface:
        """S inside the mesh; the measure's "+" is the upper body."""
        return cls(measure, ufl.FacetNormal(mesh)("-"), lambda v: v("+"), lambda v: v("-"))

    @classmethod
    def on_rigid_base(cls, mesh: Any, measure: ufl.Measure) -> Interface:
        """S on the boundary of the upper body; what is below does not move."""
        return cls(measure, -ufl.FacetNormal(mesh), lambda v: v, lambda v: 0 * v)

    def jump(self, v: Expr) -> Expr:
        """[v] = v(upper) - v(lower)."""
        return self.upper(v) - self.lower(v)


def body(law: Law, measure: ufl.Measure) -> Points:
    """A law in the volume of a body."""
    return Points(law, strain, 1, measure)


def band(law: Law, measure: ufl.Measure, n: Expr) -> Points:
    """A layer's law in the meshed layer (or in one of its sublayers)."""
    return Points(law, strain, 1, measure, n)


def surface(law: Law, interface: Interface, eps: Expr) -> Points:
    """A layer's law on S, order 0: strain sym([u] (x) n)/eps, weight eps."""
    return Points(law, lambda u: jump_strain(interface.jump(u), interface.n) / eps, eps, interface.measure, interface.n)


def work(points: Iterable[Points], u: Expr, v: Expr) -> Expr:
    """Virtual work of the stresses of u in the strains of v, a UFL form linear in v."""
    return sum(ufl.inner(p.law.stress(p.step(u)), p.strain(v)) * p.weight * p.measure for p in points)


def energy(points: Iterable[Points], u: Expr) -> Expr:
    """Stored energy of a displacement, a UFL form."""
    return sum(p.law.energy(p.step(u)) * p.weight * p.measure for p in points)
