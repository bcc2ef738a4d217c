"""Terms of the weak form: laws with their measures, the two sides of S, and the virtual work of the terms."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import ufl
from ufl.classes import Zero

from forms.base import InputError
from forms.ends.weights import EndWeights
from forms.kinematics import PLANE_STRAIN, Kinematics
from forms.law import BulkLaw, Step, checked_stress
from forms.stations import AnyStation, Faces
from forms.tensors import Expr, jump_strain, three_dimensional


def constant_law(law: BulkLaw) -> BulkLaw:
    """Return the law itself; its parameters must be numbers or UFL expressions.

    Raises:
        InputError: a parameter is a function of the place, which needs a mesh.
    """
    if law.fields:
        subject = f"order=1 of {type(law).__name__} with parameters that are functions"
        raise InputError(f"{subject}: use it in a Model, or give `Interface(law_on_surface=...)`")
    return law


@dataclass(frozen=True)
class InterfaceSide:
    """One side of S, to which functions on the mesh are restricted; d is the number of dimensions.

    Attributes:
        restrict: UFL function -> its restriction to this side.
        inverse_gradient: gradient (d, d) of the map from S to this side's facets; None: S lies on the facets.
    """

    restrict: Callable[[Expr], Expr]
    inverse_gradient: Expr | None = None

    def __call__(self, f: Expr) -> Expr:
        """Restrict a function to this side."""
        return self.restrict(f)

    def gradient(self, f: Expr) -> Expr:
        """Gradient of a function on this side by coordinates of S; its part along S is that of the values on S."""
        gradient = self.restrict(ufl.grad(f))
        return gradient if self.inverse_gradient is None else ufl.dot(gradient, self.inverse_gradient)


@dataclass(frozen=True)
class Interface:
    """The two sides of S, with the measure, the normal and the kinematics on S; d is the number of dimensions.

    S lies on the facets of the mesh; or, where there is a space between the bodies, midway between the facets of its
    two sides. A layer in such a space is strained like a shell whose fibres connect these facets, so that rigid motions
    cause no strain.

    Attributes:
        measure: dS restricted to S between two bodies, ds on a rigid base.
        x: places on S, (d,).
        n: unit normal from the lower to the upper body, (d,).
        director: (d,) vector from the lower to the upper body with component 1 along n; it is n if S lies on the
            facets.
        upper, lower: restrict a function to this side of S.
        kinematics: kinematics at places on S.
        area: area of S per area of the measure.
        law_on_surface: function from a law to the same law with UFL expressions on S as parameters, also for functions
            of the place. The strains of laws of order 1 need it.
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
    def between_bodies(cls, dS: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None) -> Self:
        """Sides of S between two bodies of the mesh; the measure's "+" is the upper body.

        Args:
            dS: measure of the facets, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: (d,) vectors from the facets of either side to S; None: S lies on the facets.
        """
        mesh, upper, lower = dS.ufl_domain(), InterfaceSide(lambda v: v("+")), InterfaceSide(lambda v: v("-"))
        if to_s is None:
            x, n = upper(ufl.SpatialCoordinate(mesh)), ufl.FacetNormal(mesh)("-")
            return cls(dS, x, n, n, upper, lower, kinematics)
        return cls._apart(dS, kinematics, to_s, upper, InterfaceSide(lower.restrict, _inverse_gradient(to_s)("-")))

    @classmethod
    def on_rigid_base(cls, ds: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None) -> Self:
        """Sides of S on the boundary of the upper body; the base below does not move.

        Args:
            ds: measure of the facets, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: (d,) vectors from the facets to S; None: S lies on the facets.
        """
        mesh, upper, lower = ds.ufl_domain(), InterfaceSide(lambda v: v), InterfaceSide(lambda v: 0 * v)
        if to_s is None:
            n = -ufl.FacetNormal(mesh)
            return cls(ds, ufl.SpatialCoordinate(mesh), n, n, upper, lower, kinematics)
        return cls._apart(ds, kinematics, to_s, upper, lower)

    @classmethod
    def _apart(
        cls, measure: ufl.Measure, kinematics: Kinematics, to_s: Expr, upper: InterfaceSide, lower: InterfaceSide
    ) -> Self:
        """Sides of S away from the facets of the mesh.

        The upper side gives n, the places on S and the area of S per area of the facets (Nanson's formula).

        Args:
            measure: measure of the facets, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: (d,) vectors from the facets to S.
            upper, lower: sides of S; the inverse gradient of the upper side is added here.
        """
        mesh, inverse_map = measure.ufl_domain(), upper(_inverse_gradient(to_s))
        N = -ufl.dot(upper(ufl.FacetNormal(mesh)), inverse_map)
        length = ufl.sqrt(ufl.dot(N, N))
        n, x = N / length, upper(ufl.SpatialCoordinate(mesh) + to_s)
        fibre = upper(to_s) / ufl.dot(upper(to_s), n)
        area = length / abs(ufl.det(inverse_map))
        return cls(measure, x, n, fibre, InterfaceSide(upper.restrict, inverse_map), lower, kinematics.at(x), area)

    @property
    def factor(self) -> Expr:
        """Factor of the measure for integrals over S, UFL: that of the kinematics times `area`."""
        return self.kinematics.factor * self.area

    def jump(self, v: Expr) -> Expr:
        """Jump [v] of a function v on S: its value on the upper side minus that on the lower side."""
        return self.upper(v) - self.lower(v)

    def faces(self, u: Expr, eps: Expr, slope: Expr | None = None) -> Faces:
        """Displacements of the faces of a layer on S.

        Args:
            u: displacement.
            eps: thickness of the layer.
            slope: gradient (d,) of the thickness along S; None: it is uniform.
        """
        projector = ufl.Identity(len(self.n)) - ufl.outer(self.director, self.n)
        upper, lower = (ufl.dot(side.gradient(u), projector) for side in (self.upper, self.lower))
        mean = self.kinematics.along((upper + lower) / 2, (self.upper(u) + self.lower(u)) / 2)
        return Faces(self.n, eps, self.jump(u), upper - lower, mean, self.kinematics.along, slope)


def _inverse_gradient(to_s: Expr) -> Expr:
    return ufl.inv(ufl.Identity(len(to_s)) + ufl.grad(to_s))


@dataclass(frozen=True)
class Term:
    """Virtual work of one law, integrated over a measure; d is the number of dimensions.

    Attributes:
        law: the law, with parameters scaled to the thickness of the layer.
        strain: function from a displacement to the strain (3, 3), UFL.
        weight: factor of the measure.
        measure: dx, ds or dS.
        n: unit normal of the layer, from the lower to the upper body, (d,); None in a body.
        prescribed_strain: strain (3, 3) added to the strain of the displacements: mean strain of a periodic cell minus
            eigenstrain. An expression of place and time; None: zero.
        key: name under which internal variables and stored data are kept, if several layers have names; "": the name is
            made of "body" or "layer" and, if there are several terms, a number.
        kinematics: kinematics of the strain.
        volume: degree, 0 or 1, of the polynomials onto which the trace of the strain is projected in each cell (B-bar).
            It applies to compiled laws over cells. None: no projection.
        traction: on S, function from the stress (3, 3) to the traction (d,) per area that is conjugate to [u]; None:
            stress times n.
        flow: flux along S per gradient of the pressure, eps^3/(12 mu), for laws of order 1 with a pressure on S; else
            0.
    """

    law: BulkLaw
    strain: Callable[[Expr], Expr]
    weight: Expr
    measure: ufl.Measure
    n: Expr | None = None
    prescribed_strain: Expr | None = None
    key: str = ""
    kinematics: Kinematics = PLANE_STRAIN
    volume: int | None = None
    flow: Expr = 0
    traction: Callable[[Expr], Expr] | None = None

    def step(self, u: Expr) -> Step:
        """Input of the law for a displacement u."""
        e = self.strain(u)
        return Step(e if self.prescribed_strain is None else self.prescribed_strain + e, self.n)

    @property
    def proportional(self) -> bool:
        """Whether the stress is linear in the strain and depends on nothing else, so that the form is bilinear."""
        traits = self.law.traits
        if not traits.linear or traits.remembers or traits.rate:
            return False
        laws = [law.in_space for _, law in self.law.sublayers]
        numeric_laws = [law.with_parameters(dict.fromkeys(law.fields, 1.0)) for law in laws]
        n = three_dimensional(self.n) if self.n is not None and traits.compiled else self.n
        return all(isinstance(checked_stress(law, Step(ufl.zero(3, 3), n)), Zero) for law in numeric_laws)


def body(law: BulkLaw, measure: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, volume: int | None = None) -> Term:
    """Term of a law in a body.

    Args:
        law: the law for these kinematics (`Kinematics.law`).
        measure: dx of the body.
        kinematics: kinematics of the mesh.
        volume: degree, 0 or 1, of the polynomials onto which the trace of the strain is projected in each cell (B-bar);
            None: no projection.
    """
    return Term(law, kinematics.strain, kinematics.factor, measure, kinematics=kinematics, volume=volume)


def band(law: BulkLaw, measure: ufl.Measure, n: Expr, kinematics: Kinematics = PLANE_STRAIN) -> Term:
    """Term of a layer's law in the meshed layer, or in the cells of one sublayer.

    Args:
        law: the law, with parameters scaled to the thickness of the layer.
        measure: dx of these cells.
        n: unit normal of the layer, (d,).
        kinematics: kinematics of the mesh.
    """
    return Term(law, kinematics.strain, kinematics.factor, measure, n, kinematics=kinematics)


def jump_term(law: BulkLaw, sides: Interface) -> Term:
    """Term of a traction law on S, with the strain sym([u] (x) n) of the jump [u] and no thickness.

    Args:
        law: the traction law in the form of a law of strains (`TractionLaw.as_bulk_law`).
        sides: the sides of S.
    """
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
    """Terms of a layer's law on S.

    Order 0: one term with the strain sym([u] (x) n)/eps and the weight eps.

    Order 1: one term for each of the law's stations (`BulkLaw.stations`), with the weight eps times the weight of the
    station. By default these are two Gauss points z = -+1/(2 sqrt 3) of a strain e0 + z e1 that is linear through the
    layer. Here e0 = sym([u] (x) n)/eps + sym(grad_S <u>); e1 = sym(grad_S [u]). For an energy quadratic in the strain
    the sum of the two terms is the thickness integral eps e0:C:e0/2 + eps/12 e1:C:e1/2.

    Args:
        law: the law, with parameters scaled to the thickness of the layer.
        sides: the sides of S.
        eps: the thickness.
        order: order of the interface law in eps, 0 or 1.
        prescribed_strain: (3, 3), uniform through the layer, added to the strain of the displacements.
        slope: gradient (d,) of the thickness along S; None: it is uniform.
        ends: reductions of the stiffness near free ends, for laws with `end_strips`; None: the law of an infinite
            layer.

    Raises:
        InputError: the law has no interface law of order 1.
    """
    n, d, weight = sides.n, len(sides.n), sides.factor * eps
    term = partial(Term, measure=sides.measure, n=n, kinematics=sides.kinematics)
    if order == 0:
        return [term(law, lambda u: jump_strain(sides.jump(u), n) / eps, weight, prescribed_strain=prescribed_strain)]
    fixed_faces = Faces(n, eps, ufl.zero(d), ufl.zero(d, d), prescribed_strain, sides.kinematics.along)

    def unit_opening(i: int) -> Faces:
        unit = ufl.as_vector([float(i == j) for j in range(d)])
        return Faces(n, eps, unit, ufl.zero(d, d), ufl.zero(3, 3), lambda gradient, u: ufl.zero(3, 3), slope)

    def at(station: AnyStation) -> Term:
        surface_law, share = sides.law_on_surface(station.law), station.share
        strain = partial(station.strain, surface_law)

        def traction(stress: Expr) -> Expr:
            return ufl.as_vector([eps * share * ufl.inner(stress, strain(unit_opening(i))) for i in range(d)])

        fixed = None if prescribed_strain is None else strain(fixed_faces)
        at_station = partial(term, prescribed_strain=fixed, flow=eps**3 * station.flow(surface_law), traction=traction)
        return at_station(station.law, lambda u: strain(sides.faces(u, eps, slope)), weight * share)

    return [at(station) for station in (law.stations() if ends is None else law.stations_at_ends(ends))]


def with_added_strain(terms: Iterable[Term], strain: Expr) -> list[Term]:
    """Copies of the terms with a strain (3, 3) added to their prescribed strains."""
    pairs = ((term, term.prescribed_strain) for term in terms)
    return [replace(term, prescribed_strain=strain if e is None else sum_strains(e, strain)) for term, e in pairs]


def sum_strains(*strains: Expr) -> Expr:
    """Sum of strains (3, 3), UFL, component by component, so that components that are zero in all of them stay zero."""
    return ufl.as_tensor([[sum(e[i, j] for e in strains) for j in range(3)] for i in range(3)])


def stress(term: Term, u: Expr) -> Expr:
    """Stress (3, 3), UFL, of a term's law at displacements u, without the components that its kinematics exclude."""
    return term.kinematics.restricted(checked_stress(term.law, term.step(u)))


def work(terms: Iterable[Term], u: Expr, v: Expr) -> Expr:
    """Virtual work of the stresses at u on the strains of v, a UFL form linear in v."""
    return sum(ufl.inner(stress(term, u), term.strain(v)) * term.weight * term.measure for term in terms)


def energy(terms: Iterable[Term], u: Expr) -> Expr:
    """Stored energy of a displacement u, a UFL form."""
    return sum(term.law.energy(term.step(u)) * term.weight * term.measure for term in terms)
