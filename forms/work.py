"""Terms: laws with their measures, the two sides of S, and the line that turns terms into a weak form."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import ufl
from ufl.classes import Zero

from forms.base import InputError
from forms.ends.weights import EndWeights
from forms.kinematics import PLANE_STRAIN, Kinematics
from forms.law import BulkLaw, Step, explained_errors, require_shape
from forms.stations import Faces, Station
from forms.tensors import Expr, jump_strain, three_dimensional


def constant_law(law: BulkLaw) -> BulkLaw:
    """A law of numbers or UFL expressions, itself.

    Raises:
        InputError: parameters of the law are functions of the place, and the mesh is not known.
    """
    if law.fields:
        reason = "the sides of S must know their values; use it in a Model, or give `Interface(law_on_surface=...)`"
        raise InputError(f"order=1 of {type(law).__name__} with parameters that are functions: {reason}")
    return law


@dataclass(frozen=True)
class InterfaceSide:
    """One side of S.

    Attributes:
        restrict: gives a function's value on this side.
        inverse_gradient: (d, d) gradient of the motion from S to this side's facet; None: they coincide.
    """

    restrict: Callable[[Expr], Expr]
    inverse_gradient: Expr | None = None

    def __call__(self, f: Expr) -> Expr:
        """A function on this side."""
        return self.restrict(f)

    def gradient(self, f: Expr) -> Expr:
        """The gradient of a function on this side; along S it is that of its values on S."""
        gradient = self.restrict(ufl.grad(f))
        return gradient if self.inverse_gradient is None else ufl.dot(gradient, self.inverse_gradient)


@dataclass(frozen=True)
class Interface:
    """The two sides of S.

    S lies on the facets of the mesh; or midway between the facets of its two sides, where these are apart. The strains of a
    layer between them are those of a shell with the fibres that lead from one to the other: rigid motions cause none.

    Attributes:
        measure: dS restricted to S between two bodies, ds on a rigid base.
        x: places on S, (d,).
        n: unit normal from the lower to the upper body, (d,).
        director: (d,) what leads from the lower to the upper body, of unit length along n; it is n unless these are apart.
        upper, lower: restrict a function to this side of S.
        kinematics: those of places on S.
        area: area of S per area of the measure.
        law_on_surface: law -> the same law with UFL expressions on S for its parameters, functions too, as strains of
            order 1 need them.
    """

    measure: ufl.Measure
    x: Expr
    n: Expr
    director: Expr
    upper: InterfaceSide
    lower: InterfaceSide
    kinematics: Kinematics = PLANE_STRAIN
    area: Expr = 1
    law_on_surface: Callable[[BulkLaw], BulkLaw] = constant_law

    @classmethod
    def between_bodies(
        cls, dS: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None
    ) -> Interface:
        """S inside the mesh; the measure's "+" is the upper body.

        Args:
            dS: measure of the facets; knows its mesh.
            kinematics: of the mesh.
            to_s: (d,) how far S is from the facets' places, on either side; None: it is there.
        """
        mesh, upper, lower = dS.ufl_domain(), InterfaceSide(lambda v: v("+")), InterfaceSide(lambda v: v("-"))
        if to_s is None:
            x, n = upper(ufl.SpatialCoordinate(mesh)), ufl.FacetNormal(mesh)("-")
            return cls(dS, x, n, n, upper, lower, kinematics)
        return cls._apart(dS, kinematics, to_s, upper, InterfaceSide(lower.restrict, _inverse_gradient(to_s)("-")))

    @classmethod
    def on_rigid_base(
        cls, ds: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None
    ) -> Interface:
        """S on the boundary of the upper body; the base below does not move; arguments as in `between_bodies`."""
        mesh, upper, lower = ds.ufl_domain(), InterfaceSide(lambda v: v), InterfaceSide(lambda v: 0 * v)
        if to_s is None:
            n = -ufl.FacetNormal(mesh)
            return cls(ds, ufl.SpatialCoordinate(mesh), n, n, upper, lower, kinematics)
        return cls._apart(ds, kinematics, to_s, upper, lower)

    @classmethod
    def _apart(
        cls, measure: ufl.Measure, kinematics: Kinematics, to_s: Expr, upper: InterfaceSide, lower: InterfaceSide
    ) -> Interface:
        """S apart from the facets of the mesh, seen from the upper side, whose facets the measure is of (Nanson)."""
        mesh, back = measure.ufl_domain(), upper(_inverse_gradient(to_s))
        N = -ufl.dot(upper(ufl.FacetNormal(mesh)), back)
        length = ufl.sqrt(ufl.dot(N, N))
        n, x = N / length, upper(ufl.SpatialCoordinate(mesh) + to_s)
        fibre = upper(to_s) / ufl.dot(upper(to_s), n)
        area = length / abs(ufl.det(back))
        return cls(measure, x, n, fibre, InterfaceSide(upper.restrict, back), lower, kinematics.at(x), area)

    @property
    def factor(self) -> Any:
        """Factor of the measure for integrals over S."""
        return self.kinematics.factor * self.area

    def jump(self, v: Expr) -> Expr:
        """[v] = v(upper) - v(lower)."""
        return self.upper(v) - self.lower(v)

    def faces(self, u: Expr, eps: Expr, slope: Expr | None = None) -> Faces:
        """The faces of a layer of thickness eps, of gradient `slope` along S, under displacements u."""
        along_s = ufl.Identity(len(self.n)) - ufl.outer(self.director, self.n)
        upper, lower = (ufl.dot(side.gradient(u), along_s) for side in (self.upper, self.lower))
        mean = self.kinematics.along((upper + lower) / 2, (self.upper(u) + self.lower(u)) / 2)
        return Faces(self.n, eps, self.jump(u), upper - lower, mean, self.kinematics.along, slope)


def _inverse_gradient(to_s: Expr) -> Expr:
    return ufl.inv(ufl.Identity(len(to_s)) + ufl.grad(to_s))


@dataclass(frozen=True)
class Term:
    """The integral over a measure of the work of one law.

    Attributes:
        law: the law, with real parameters.
        strain: displacement -> strain (3, 3) at the points.
        weight: factor of the measure.
        measure: dx, ds or dS.
        n: director, (d,), or None in a body.
        prescribed_strain: strain (3, 3) that is added to that of the displacements: the mean strain of a periodic cell,
            less the eigenstrain. An expression of place and time; None: none is.
        key: name of what the law remembers and stores, where several layers have names; "": by kind and order.
        kinematics: those of the strain.
        volume: degree, 0 or 1, of the polynomials onto which the trace of the strain is projected in each cell (B-bar), of
            compiled laws over cells; None: it is that of the displacements.
        traction: on S, stress (3, 3) -> its traction (d,), what it does in [u] per area; None: stress n.
        flow: of a law with a pressure on S at order 1, eps^3/(12 mu): flux along S over the slope of the pressure; else 0.
    """

    law: BulkLaw
    strain: Callable[[Expr], Expr]
    weight: Any
    measure: ufl.Measure
    n: Expr | None = None
    prescribed_strain: Expr | None = None
    key: str = ""
    kinematics: Kinematics = PLANE_STRAIN
    volume: int | None = None
    flow: Any = 0
    traction: Callable[[Expr], Expr] | None = None

    def step(self, u: Expr) -> Step:
        """Input of the law for a displacement u."""
        e = self.strain(u)
        return Step(e if self.prescribed_strain is None else self.prescribed_strain + e, self.n)

    @property
    def proportional(self) -> bool:
        """Whether the law is linear in the strain alone, without stress at zero strain: its form is bilinear."""
        traits = self.law.traits
        if not traits.linear or traits.remembers or traits.rate:
            return False
        laws = [law.in_space for _, law in self.law.sublayers]
        numbered = [law.with_parameters(dict.fromkeys(law.fields, 1.0)) for law in laws]
        return all(isinstance(self._unstrained(law), Zero) for law in numbered)

    def _unstrained(self, law: BulkLaw) -> Expr:
        n = three_dimensional(self.n) if self.n is not None and self.law.traits.compiled else self.n
        with explained_errors(law, "stress"):
            return require_shape(law, "stress", law.stress(Step(ufl.zero(3, 3), n)), (3, 3))


def body(law: BulkLaw, measure: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, volume: int | None = None) -> Term:
    """A law in the volume of a body; the law is that of these kinematics (`Kinematics.law`), `volume` as in `Term`."""
    return Term(law, kinematics.strain, kinematics.factor, measure, kinematics=kinematics, volume=volume)


def band(law: BulkLaw, measure: ufl.Measure, n: Expr, kinematics: Kinematics = PLANE_STRAIN) -> Term:
    """A layer's law in the meshed layer, or in the cells of one sublayer."""
    return Term(law, kinematics.strain, kinematics.factor, measure, n, kinematics=kinematics)


def jump_terms(law: BulkLaw, sides: Interface) -> Term:
    """A law of jumps on S, as one of strains (`TractionLaw.as_bulk_law`): strain sym([u] (x) n), weight 1."""
    n, kinematics = sides.n, sides.kinematics
    return Term(law, lambda u: jump_strain(sides.jump(u), n), sides.factor, sides.measure, n, kinematics=kinematics)


def surface(
    law: BulkLaw,
    sides: Interface,
    eps: Expr,
    order: int = 0,
    prescribed_strain: Expr | None = None,
    slope: Expr | None = None,
    ends: EndWeights | None = None,
) -> list[Term]:
    """A layer's law on S.

    Order 0: strain sym([u] (x) n)/eps, one point of weight eps. Order 1: a term for each of the law's stations through the
    thickness (`BulkLaw.stations`), of weight eps times its share. By default these are two Gauss points: the strain grows
    linearly through the layer, e0 + z e1 at z = -+1/(2 sqrt 3), with e0 = sym([u] (x) n)/eps + sym(grad_S <u>), e1 =
    sym(grad_S [u]). For an energy quadratic in the strain the sum of the two terms is the thickness integral of
    eps e0:C:e0/2 + eps/12 e1:C:e1/2.

    Args:
        law: the law, with real parameters.
        sides: the sides of S.
        eps: the thickness.
        order: of the interface law.
        prescribed_strain: (3, 3), uniform through the layer, added to that of the displacements.
        slope: gradient (d,) of the thickness along S; None: it is uniform.
        ends: weights of free ends, for the stations of laws that know them; None: of an infinite layer.

    Raises:
        InputError: there is no law of order 1.
    """
    n, d, weight = sides.n, len(sides.n), sides.factor * eps
    term = partial(Term, measure=sides.measure, n=n, kinematics=sides.kinematics)
    if order == 0:
        return [term(law, lambda u: jump_strain(sides.jump(u), n) / eps, weight, prescribed_strain=prescribed_strain)]
    fixed_faces = Faces(n, eps, ufl.zero(d), ufl.zero(d, d), prescribed_strain, sides.kinematics.along)

    def opened(i: int) -> Faces:
        unit = ufl.as_vector([float(i == j) for j in range(d)])
        return Faces(n, eps, unit, ufl.zero(d, d), ufl.zero(3, 3), lambda gradient, u: ufl.zero(3, 3), slope)

    def at(station: Station) -> Term:
        surface_law = sides.law_on_surface(station.law)
        return term(
            station.law,
            lambda u: station.strain(surface_law, sides.faces(u, eps, slope)),
            weight * station.share,
            prescribed_strain=None if prescribed_strain is None else station.strain(surface_law, fixed_faces),
            flow=eps**3 * station.flow(surface_law),
            traction=lambda stress: ufl.as_vector(
                [eps * station.share * ufl.inner(stress, station.strain(surface_law, opened(i))) for i in range(d)]
            ),
        )

    return [at(station) for station in (law.stations() if ends is None else law.stations_at_ends(ends))]


def with_added_strain(terms: Iterable[Term], strain: Expr) -> list[Term]:
    """The terms, a strain (3, 3) added to those that are given."""
    return [
        replace(
            p, prescribed_strain=strain if p.prescribed_strain is None else sum_strains(p.prescribed_strain, strain)
        )
        for p in terms
    ]


def sum_strains(*strains: Expr) -> Expr:
    """The sum of strains (3, 3), component by component, so that zeros stay zeros."""
    return ufl.as_tensor([[sum(e[i, j] for e in strains) for j in range(3)] for i in range(3)])


def stress(term: Term, u: Expr) -> Expr:
    """The stress (3, 3) of a term's law at displacements u."""
    with explained_errors(term.law, "stress"):
        return term.kinematics.restricted(require_shape(term.law, "stress", term.law.stress(term.step(u)), (3, 3)))


def work(terms: Iterable[Term], u: Expr, v: Expr) -> Expr:
    """Virtual work of the stresses of u in the strains of v, a UFL form linear in v."""
    return sum(ufl.inner(stress(p, u), p.strain(v)) * p.weight * p.measure for p in terms)


def energy(terms: Iterable[Term], u: Expr) -> Expr:
    """Stored energy of a displacement, a UFL form."""
    return sum(p.law.energy(p.step(u)) * p.weight * p.measure for p in terms)
