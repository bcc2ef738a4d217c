"""The two sides of S: jumps, gradients along it, and the measure of integrals over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl

from forms.base import InputError
from forms.kinematics import Expr
from forms.law import BulkLaw
from forms.planes import LIFTED, Kinematics
from forms.stations import Faces


def of_numbers(law: BulkLaw) -> BulkLaw:
    """A law of numbers or UFL expressions, itself.

    Raises:
        InputError: parameters of the law are functions of the place, and the mesh is not known.
    """
    if law.fields:
        reason = "the sides of S must know their values; use it in a Model, or give `Interface(known=...)`"
        raise InputError(f"order=1 of {type(law).__name__} with parameters that are functions: {reason}")
    return law


@dataclass(frozen=True)
class Side:
    """One side of S.

    Attributes:
        restrict: gives a function's value on this side.
        back: (d, d) gradient of the motion from S to the facet of this side, where they are apart; None: they are not.
    """

    restrict: Callable[[Expr], Expr]
    back: Expr | None = None

    def __call__(self, f: Expr) -> Expr:
        """A function on this side."""
        return self.restrict(f)

    def gradient(self, f: Expr) -> Expr:
        """The gradient of a function on this side; along S it is that of its values on S."""
        gradient = self.restrict(ufl.grad(f))
        return gradient if self.back is None else ufl.dot(gradient, self.back)


@dataclass(frozen=True)
class Interface:
    """The two sides of S.

    S lies on the facets of the mesh; or midway between the facets of its two sides, where these are apart. The strains of a
    layer between them are those of a shell with the fibres that lead from one to the other: rigid motions cause none.

    Attributes:
        measure: dS restricted to S between two bodies, ds on a rigid base.
        x: places on S, (d,).
        n: unit normal from the lower to the upper body, (d,).
        fibre: (d,) what leads from the lower to the upper body, of unit length along n; it is n unless these are apart.
        upper, lower: restrict a function to this side of S.
        kinematics: those of places on S.
        area: area of S per area of the measure.
        known: law -> the same law with UFL expressions on S for its parameters, also for those that are functions, as
            strains of order 1 need them.
    """

    measure: ufl.Measure
    x: Expr
    n: Expr
    fibre: Expr
    upper: Side
    lower: Side
    kinematics: Kinematics = LIFTED
    area: Expr = 1
    known: Callable[[BulkLaw], BulkLaw] = of_numbers

    @classmethod
    def between_bodies(cls, dS: ufl.Measure, kinematics: Kinematics = LIFTED, to_s: Expr | None = None) -> Interface:
        """S inside the mesh; the measure's "+" is the upper body.

        Args:
            dS: measure of the facets; knows its mesh.
            kinematics: of the mesh.
            to_s: (d,) how far S is from the facets' places, on either side; None: it is there.
        """
        mesh, upper, lower = dS.ufl_domain(), Side(lambda v: v("+")), Side(lambda v: v("-"))
        if to_s is None:
            x, n = upper(ufl.SpatialCoordinate(mesh)), ufl.FacetNormal(mesh)("-")
            return cls(dS, x, n, n, upper, lower, kinematics)
        return cls._apart(dS, kinematics, to_s, upper, Side(lower.restrict, _back(to_s)("-")))

    @classmethod
    def on_rigid_base(cls, ds: ufl.Measure, kinematics: Kinematics = LIFTED, to_s: Expr | None = None) -> Interface:
        """S on the boundary of the upper body; the base below does not move; arguments as in `between_bodies`."""
        mesh, upper, lower = ds.ufl_domain(), Side(lambda v: v), Side(lambda v: 0 * v)
        if to_s is None:
            n = -ufl.FacetNormal(mesh)
            return cls(ds, ufl.SpatialCoordinate(mesh), n, n, upper, lower, kinematics)
        return cls._apart(ds, kinematics, to_s, upper, lower)

    @classmethod
    def _apart(cls, measure: ufl.Measure, kinematics: Kinematics, to_s: Expr, upper: Side, lower: Side) -> Interface:
        """S apart from the facets of the mesh, seen from the upper side, whose facets the measure is of (Nanson)."""
        mesh, back = measure.ufl_domain(), upper(_back(to_s))
        N = -ufl.dot(upper(ufl.FacetNormal(mesh)), back)
        length = ufl.sqrt(ufl.dot(N, N))
        n, x = N / length, upper(ufl.SpatialCoordinate(mesh) + to_s)
        fibre = upper(to_s) / ufl.dot(upper(to_s), n)
        area = length / abs(ufl.det(back))
        return cls(measure, x, n, fibre, Side(upper.restrict, back), lower, kinematics.at(x), area)

    @property
    def factor(self) -> Any:
        """Factor of the measure for integrals over S."""
        return self.kinematics.factor * self.area

    def jump(self, v: Expr) -> Expr:
        """[v] = v(upper) - v(lower)."""
        return self.upper(v) - self.lower(v)

    def faces(self, u: Expr, eps: Expr, slope: Expr | None = None) -> Faces:
        """The faces of a layer of thickness eps, of gradient `slope` along S, under displacements u."""
        along_s = ufl.Identity(len(self.n)) - ufl.outer(self.fibre, self.n)
        upper, lower = (ufl.dot(side.gradient(u), along_s) for side in (self.upper, self.lower))
        mean = self.kinematics.along((upper + lower) / 2, (self.upper(u) + self.lower(u)) / 2)
        return Faces(self.n, eps, self.jump(u), upper - lower, mean, self.kinematics.along, slope)


def _back(to_s: Expr) -> Expr:
    return ufl.inv(ufl.Identity(len(to_s)) + ufl.grad(to_s))
