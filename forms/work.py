"""Virtual work of laws in bodies, in meshed layers and on S, as UFL forms; the two sides of S.

S is the surface that replaces a layer in an interface model. A `Term` is the virtual work of one law.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import ufl

from forms.base import InputError
from forms.ends.weights import EndWeights
from forms.kinematics import PLANE_STRAIN, Kinematics, ScalarField
from forms.law import BulkLaw, Step, checked_stress
from forms.stations import GAUSS_RULES, AnyStation, Faces, gauss_stations
from forms.tensors import Expr, three_dimensional


def require_constant_law(law: BulkLaw) -> BulkLaw:
    """Return the law itself, if none of its parameters is a numpy function of the place.

    Raises:
        InputError: a parameter is a function of the place, for which a mesh would be needed.
    """
    if law.fields:
        subject = f"{type(law).__name__} with {', '.join(law.fields)} as functions of the place"
        raise InputError(f"{subject}: use it in a Model, or give `Interface(law_on_surface=...)`")
    return law


@dataclass(frozen=True)
class InterfaceSide:
    """One side of S, in d dimensions: the values and gradients that functions on the mesh have there.

    Attributes:
        restrict: function that restricts a UFL function on the mesh to this side.
        inverse_gradient: gradient (d, d) of the map from S to the facets of this side; None: S lies on the facets.
    """

    restrict: Callable[[Expr], Expr]
    inverse_gradient: Expr | None = None

    def __call__(self, f: Expr) -> Expr:
        """Return the restriction of a UFL function `f` on the mesh to this side."""
        return self.restrict(f)

    def gradient(self, f: Expr) -> Expr:
        """Return the gradient of the values of a UFL function `f` on this side, with respect to coordinates on S.

        If S is away from the facets, a value on a facet belongs to the place of S opposite to it. Only the part of the
        gradient along S is meaningful.
        """
        gradient = self.restrict(ufl.grad(f))
        return gradient if self.inverse_gradient is None else ufl.dot(gradient, self.inverse_gradient)


@dataclass(frozen=True)
class Interface:
    """The two sides of S, in d dimensions, with the measure, the normal and the kinematics on S.

    S lies on the facets of the mesh. Where there is a space between the bodies, S lies midway between the facets of its
    two sides. A layer in such a space is strained like a shell whose fibres connect these facets, so that rigid motions
    cause no strain.

    Attributes:
        measure: UFL measure of the facets: dS between two bodies, ds on a rigid base.
        x: coordinates of places on S, (d,).
        n: unit normal from the lower to the upper body, (d,).
        director: vector (d,) from the lower to the upper body along the fibre, with component 1 along n. It is n if S
            lies on the facets.
        upper, lower: sides of S; each restricts a function on the mesh to its side.
        kinematics: kinematics at places on S.
        area_ratio: area of S divided by that of the facets.
        law_on_surface: function that returns a law with UFL expressions on S as parameters, even if these were
            functions of the place. The strains of laws of order 1 need it.
    """

    measure: ufl.Measure
    x: Expr
    n: Expr
    director: Expr
    upper: InterfaceSide
    lower: InterfaceSide
    kinematics: Kinematics = PLANE_STRAIN
    area_ratio: Expr = 1
    law_on_surface: Callable[[BulkLaw], BulkLaw] = require_constant_law

    @classmethod
    def between_bodies(cls, dS: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None) -> Self:
        """Return the interface S between two bodies of the mesh; the "+" side of the measure is the upper body.

        Args:
            dS: measure of the facets, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: vectors (d,) from the facets of both sides to S, UFL on the mesh; None: S lies on the facets.
        """
        mesh, upper, lower = dS.ufl_domain(), InterfaceSide(lambda v: v("+")), InterfaceSide(lambda v: v("-"))
        if to_s is None:
            x, n = upper(ufl.SpatialCoordinate(mesh)), ufl.FacetNormal(mesh)("-")
            return cls(dS, x, n, n, upper, lower, kinematics)
        return cls._off_facets(dS, kinematics, to_s, upper, InterfaceSide(lower.restrict, _inverse_gradient(to_s)("-")))

    @classmethod
    def on_rigid_base(cls, ds: ufl.Measure, kinematics: Kinematics = PLANE_STRAIN, to_s: Expr | None = None) -> Self:
        """Return the interface S between a body of the mesh, above, and a rigid base, which does not move.

        Args:
            ds: measure of the facets of the body, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: vectors (d,) from the facets to S, UFL on the mesh; None: S lies on the facets.
        """
        mesh, upper, lower = ds.ufl_domain(), InterfaceSide(lambda v: v), InterfaceSide(lambda v: 0 * v)
        if to_s is None:
            n = -ufl.FacetNormal(mesh)
            return cls(ds, ufl.SpatialCoordinate(mesh), n, n, upper, lower, kinematics)
        return cls._off_facets(ds, kinematics, to_s, upper, lower)

    @classmethod
    def _off_facets(
        cls, measure: ufl.Measure, kinematics: Kinematics, to_s: Expr, upper: InterfaceSide, lower: InterfaceSide
    ) -> Self:
        """Return the interface S for facets of the mesh that are away from S.

        The places on S, their normal n, and the area of S are computed from the facets of the upper side (Nanson's
        formula).

        Args:
            measure: measure of the facets, with its mesh.
            kinematics: kinematics of the mesh.
            to_s: vectors (d,) from the facets to S, UFL on the mesh.
            upper: upper side of S, still without inverse gradient.
            lower: lower side of S.
        """
        mesh, inverse_grad = measure.ufl_domain(), upper(_inverse_gradient(to_s))
        N = -ufl.dot(upper(ufl.FacetNormal(mesh)), inverse_grad)
        norm_of_N = ufl.sqrt(ufl.dot(N, N))
        n, x = N / norm_of_N, upper(ufl.SpatialCoordinate(mesh) + to_s)
        director = upper(to_s) / ufl.dot(upper(to_s), n)
        ratio = norm_of_N / abs(ufl.det(inverse_grad))
        return cls(measure, x, n, director, InterfaceSide(upper.restrict, inverse_grad), lower, kinematics.at(x), ratio)

    @property
    def factor(self) -> Expr:
        """Factor of the facets' measure in integrals over S, UFL: `area_ratio` times the factor of the kinematics."""
        return self.kinematics.factor * self.area_ratio

    def jump(self, v: Expr) -> Expr:
        """Return the jump [v] of a function `v` on the mesh: its upper value minus its lower value on S."""
        return self.upper(v) - self.lower(v)

    def faces(self, u: Expr, eps: Expr, grad_eps: Expr | None = None, *, uniform: bool = False) -> Faces:
        """Return the faces of a layer on S, with the jump, gradients and mean strain of a displacement.

        Args:
            u: displacement, UFL on the mesh.
            eps: thickness of the layer.
            grad_eps: gradient (d,) of the thickness eps along S, UFL; None: eps is uniform.
            uniform: whether gradients along S count as zero, as in interface laws of order 0.
        """
        u, d = u if u.ufl_shape else ufl.as_vector([u]), len(self.n)  # a script's scalar field may have no shape
        projector = ufl.Identity(d) - ufl.outer(self.director, self.n)
        grad_upper, grad_lower = (ufl.dot(side.gradient(u), projector) for side in (self.upper, self.lower))
        if uniform:
            grad_upper = grad_lower = ufl.zero(len(self.jump(u)), d)
        across, along = self.kinematics.strain_across, self.kinematics.strain_along
        e_mean = along((grad_upper + grad_lower) / 2, (self.upper(u) + self.lower(u)) / 2)
        gradient = None if uniform else self.gradient_along
        return Faces(self.n, eps, self.jump(u), grad_upper - grad_lower, e_mean, across, along, grad_eps, gradient)

    def gradient_along(self, f: Expr) -> Expr:
        """Return the gradient (d,) along S of a scalar `f` on S: UFL of functions that are restricted to the upper side."""
        gradient, inverse = ufl.grad(f), self.upper.inverse_gradient
        gradient = gradient if inverse is None else ufl.dot(gradient, inverse)
        return gradient - ufl.dot(gradient, self.director) * self.n

    def bubble_strain(self, b: Expr, z: float, eps: Expr, grad_eps: Expr | None = None) -> Expr:
        """Return the strain (3, 3) at a height of a layer whose unknown is b times 6 (1/4 - z^2), with the mean b.

        Args:
            b: values on S, UFL on the mesh: those of the upper side are meant.
            z: height over the thickness, from -1/2 to 1/2.
            eps, grad_eps: thickness of the layer, and its gradient along S, as for `faces`.
        """
        value, shape = self.upper(b), 6 * (1 / 4 - z**2)
        gradient = ufl.dot(self.upper.gradient(b), ufl.Identity(len(self.n)) - ufl.outer(self.director, self.n))
        normal = self.n if grad_eps is None else self.n - z * grad_eps  # of the surface at this height
        along = self.kinematics.strain_along(shape * gradient, shape * value)
        return self.kinematics.strain_across(-12 * z * value, normal) / eps + along


def _inverse_gradient(to_s: Expr) -> Expr:
    return ufl.inv(ufl.Identity(len(to_s)) + ufl.grad(to_s))


@dataclass(frozen=True)
class Term:
    """Virtual work of one law as an integral over a UFL measure, in d dimensions.

    Attributes:
        law: the law, with the parameters that it has at the thickness of the layer (`BulkLaw.scaled`).
        strain: function that returns the strain (3, 3), UFL, of a displacement.
        weight: factor, UFL, on the measure.
        measure: dx of a body or a meshed layer; dS or ds of S.
        n: unit normal of the layer, from the lower to the upper body, (d,); None in a body.
        prescribed_strain: strain (3, 3), an expression of place and time, that is added to the strain of the
            displacements: mean strain of a periodic cell minus eigenstrain. None: zero.
        key: name under which internal variables and stored data are kept, if several layers have names. "": the name is
            made of "body" or "layer" and, if there are several terms, a number.
        kinematics: kinematics of the strain.
        bbar_degree: degree, 0 or 1, of the polynomials onto which the trace of the strain is projected in each cell
            (B-bar). It applies to compiled laws over cells. None: no projection.
        traction: on S, function of a stress (3, 3) that returns the traction (c,) with the same virtual work on [u].
            None: stress times n.
        bubble_strain: in laws of order 2, function that returns the strain (3, 3), UFL, of the bubble's amplitude on S,
            see `Interface.bubble_strain`; it adds to that of displacements. None: there is none.
        mobility: flux along S per gradient of the pressure, for laws of order 1 with a pressure on S; 0 for others. It
            is eps^3/(12 mu) with the thickness eps and the shear modulus mu, near free ends times their `flow_factor`.
    """

    law: BulkLaw
    strain: Callable[[Expr], Expr]
    weight: Expr
    measure: ufl.Measure
    n: Expr | None = None
    prescribed_strain: Expr | None = None
    key: str = ""
    kinematics: Kinematics = PLANE_STRAIN
    bbar_degree: int | None = None
    mobility: Expr = 0
    traction: Callable[[Expr], Expr] | None = None
    bubble_strain: Callable[[Expr], Expr] | None = None

    def step(self, u: Expr) -> Step:
        """Return the input of the law for a displacement `u`: a step that has only a strain and the normal."""
        e = self.strain(u)
        return Step(e if self.prescribed_strain is None else self.prescribed_strain + e, self.normal)

    @property
    def normal(self) -> Expr:
        """Unit normal (3,) of the layer, which laws get; None in a body."""
        return None if self.n is None else three_dimensional(self.n)


def body(law: BulkLaw, measure: ufl.Measure, kinematics: Kinematics | None = None, degree: int | None = None) -> Term:
    """Return the term of a law in a body.

    Args:
        law: the law for these kinematics (`Kinematics.law`).
        measure: dx of the body.
        kinematics: kinematics of the mesh; None: plane strain or 3D, or for a law of a scalar field, this field.
        degree: degree, 0 or 1, of the polynomials onto which the trace of the strain is projected in each cell (B-bar);
            None: no projection.
    """
    kinematics = kinematics or (ScalarField() if law.unknown == ScalarField.unknown else PLANE_STRAIN)
    return Term(law, kinematics.strain, kinematics.factor, measure, kinematics=kinematics, bbar_degree=degree)


def layer_term(law: BulkLaw, measure: ufl.Measure, n: Expr, kinematics: Kinematics = PLANE_STRAIN) -> Term:
    """Return the term of a layer's law in the cells of the meshed layer, or of one of its sublayers.

    Args:
        law: the law, with the parameters that it has at the thickness of the layer (`BulkLaw.scaled`).
        measure: dx of these cells.
        n: unit normal of the layer, (d,).
        kinematics: kinematics of the mesh.
    """
    return Term(law, kinematics.strain, kinematics.factor, measure, n, kinematics=kinematics)


def jump_term(law: BulkLaw, sides: Interface) -> Term:
    """Return the term on S of a traction law, which has no thickness; its strain is sym([u] (x) n) with the jump [u].

    Args:
        law: the traction law in the form of a law of strains (`TractionLaw.as_bulk_law`).
        sides: the two sides of S.
    """
    n, kinematics = sides.n, sides.kinematics

    def strain(u: Expr) -> Expr:
        return kinematics.strain_across(sides.jump(u), n)

    return Term(law, strain, sides.factor, sides.measure, n, kinematics=kinematics)


def s_terms(
    law: BulkLaw,
    sides: Interface,
    eps: Expr,
    order: int = 0,
    prescribed_strain: Expr | tuple[Expr, Expr] | None = None,
    grad_eps: Expr | None = None,
    ends: EndWeights | None = None,
) -> list[Term]:
    """Return the terms on S of the interface law that replaces a layer.

    Order 0: one term with the strain sym([u] (x) n)/eps, and eps as weight. For a scalar field, whose value counts too,
    the terms are those of order 1 without gradients along S.

    Order 1: one term for each of the law's stations (`BulkLaw.stations`). Its weight is eps times the weight of the
    station. Let z be the distance from the middle of the layer, divided by eps: -1/2 at the lower face, 1/2 at the
    upper one. By default the strain is e0 + z e1, and the stations are the two Gauss points z = -+1/(2 sqrt 3). Here e0
    = sym([u] (x) n)/eps + sym(grad_S <u>), with the mean <u> of both sides, and e1 = sym(grad_S [u]). If the energy
    is quadratic in the strain, the two terms have the energies eps e0:C:e0/2 + eps/12 e1:C:e1/2. This is the integral
    over the thickness.

    Order 2, of a scalar field alone: the field is quadratic through the thickness, by a bubble that is zero on both
    faces. There are three Gauss points. The bubble's mean b through the thickness is a further unknown on S.

    Args:
        law: the law of the layer's material, with the parameters that it has at the thickness eps (`BulkLaw.scaled`).
        sides: the two sides of S.
        eps: the thickness, UFL.
        order: order of the interface law in eps: 0, 1 or 2.
        prescribed_strain: strain (3, 3), uniform through the layer, that is added to that of the displacements; or two,
            at the lower and at the upper face, linear between them; None: zero.
        grad_eps: gradient (d,) of the thickness eps along S, UFL; None: eps is uniform.
        ends: reductions of the stiffness near free ends, for laws with `end_constants`; None: no reductions.

    Raises:
        InputError: the law has no interface law of order 1.
    """
    n, d, weight, kinematics = sides.n, len(sides.n), sides.factor * eps, sides.kinematics
    c, across = len(kinematics.components(d)), kinematics.strain_across
    prescribed_change = ufl.zero(3, 3)
    if isinstance(prescribed_strain, tuple):
        lower, upper = prescribed_strain
        prescribed_strain, prescribed_change = (lower + upper) / 2, upper - lower
    term = partial(Term, measure=sides.measure, n=n, kinematics=kinematics)
    if order == 0 and not kinematics.has_value_in_strain:
        return [term(law, lambda u: across(sides.jump(u), n) / eps, weight, prescribed_strain=prescribed_strain)]
    grad_eps = grad_eps if order else None
    fixed_faces = Faces(
        n, eps, ufl.zero(c), ufl.zero(c, d), prescribed_strain, across, lambda gradient, u: prescribed_change
    )

    def jump_faces(i: int) -> Faces:
        unit_jump, no_strain = ufl.as_vector([float(i == j) for j in range(c)]), ufl.zero(3, 3)
        return Faces(n, eps, unit_jump, ufl.zero(c, d), no_strain, across, lambda gradient, u: no_strain, grad_eps)

    def term_at(station: AnyStation, z: float = math.nan) -> Term:
        surface_laws = tuple(map(sides.law_on_surface, station.strain_laws))
        surface_law, station_weight = surface_laws or sides.law_on_surface(station.law), station.station_weight
        strain_of = partial(station.strain, surface_law)

        def traction(stress: Expr) -> Expr:
            return ufl.as_vector([eps * station_weight * ufl.inner(stress, strain_of(jump_faces(i))) for i in range(c)])

        prescribed = None if prescribed_strain is None else strain_of(fixed_faces)
        mobility = eps**3 * station.mobility(surface_law)
        bubble_strain = partial(sides.bubble_strain, z=z, eps=eps, grad_eps=grad_eps) if order == 2 else None
        at_station = partial(
            term, prescribed_strain=prescribed, mobility=mobility, traction=traction, bubble_strain=bubble_strain
        )

        def strain(u: Expr) -> Expr:
            return strain_of(sides.faces(u, eps, grad_eps, uniform=order == 0))

        return at_station(station.law, strain, weight * station_weight)

    if order == 2:
        rule = GAUSS_RULES[3]
        return [term_at(station, z) for station, (z, _) in zip(gauss_stations(law, count=3), rule, strict=True)]
    return [term_at(station) for station in (law.stations() if ends is None else law.stations_at_ends(ends))]


def with_added_strain(terms: Iterable[Term], strain: Expr) -> list[Term]:
    """Return copies of terms with the strain `strain` (3, 3) added to their prescribed strains."""
    terms_and_e = ((term, term.prescribed_strain) for term in terms)
    return [replace(term, prescribed_strain=strain if e is None else sum_strains(e, strain)) for term, e in terms_and_e]


def sum_strains(*strains: Expr) -> Expr:
    """Return the sum of strains (3, 3), UFL, in which components that are zero in all strains are exactly zero."""
    return ufl.as_tensor([[sum(e[i, j] for e in strains) for j in range(3)] for i in range(3)])


def stress(term: Term, u: Expr) -> Expr:
    """Return the stress (3, 3), UFL, of a term's law at displacements `u`.

    Components that the term's kinematics exclude, such as out-of-plane stresses in plane stress, are zero.
    """
    return term.kinematics.admissible_part(checked_stress(term.law, term.step(u)))


def work(terms: Iterable[Term], u: Expr, v: Expr) -> Expr:
    """Return the virtual work of all terms, a UFL form that is linear in the virtual displacements `v`.

    It is the work of the stresses at the displacements `u` on the strains of `v`.
    """
    return sum(ufl.inner(stress(term, u), term.strain(v)) * term.weight * term.measure for term in terms)


def energy(terms: Iterable[Term], u: Expr) -> Expr:
    """Return the energy of all terms that is stored at displacements `u`, a UFL form."""
    return sum(term.law.energy(term.step(u)) * term.weight * term.measure for term in terms)
