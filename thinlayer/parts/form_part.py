"""Parts of the balance of forces that are UFL forms: laws of bodies and layers, springs and user-defined forms."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from operator import or_

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch

from forms.base import Array, InputError
from forms.check import check
from forms.law import BulkLaw, Step
from forms.law_tangents import equations_key
from forms.tensors import Expr
from forms.work import Term, energy, stress, work
from thinlayer.discretisation.form_compilation import compiled, compiled_summands, zero_matrix
from thinlayer.discretisation.state import Configuration
from thinlayer.discretisation.time_functions import StepStrains, with_strains
from thinlayer.errors import make_module_getattr
from thinlayer.parts.compiled_part import find_softening, prescribed_strain_function
from thinlayer.parts.part import Block, Part, PartTraits, Softening, StepOutcome, TimeStep
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.quadrature import add_assembled_forces, add_integral_to_nodes, assemble_matrix
from thinlayer.system.ranks import communicator, destroy


class FormPart(Part):
    """Nodal forces K u + F(u) + g of UFL forms at the displacements u.

    K u is linear in u, F(u) is non-linear and g does not depend on u. In a time step u are the displacements at which
    forces balance, u_old + theta (u_new - u_old).

    Args:
        key: name of the part in states and files.
        u: displacement function that occurs in the forms `F` and `energy`. The part writes values into it.
        K: matrix of the linear forces, which the method `destroy` frees; None: no linear forces.
        F: virtual work of the non-linear forces, a UFL form of u, linear in a test function; None: no such forces.
        energy: stored energy of the forces F(u) and g, a UFL form of u; None: they have no energy.
        kept: whether states store the part's energy under its key.
        g: virtual work of the constant forces, a UFL form that is linear in a test function; None: no such forces.
    """

    def __init__(
        self, key: str, u: fem.Function, K: PETSc.Mat | None = None, F: Expr | None = None,
        energy: Expr | None = None, *, kept: bool = False, g: Expr | None = None,
    ) -> None:  # fmt: skip
        self.key, self.K, self._energy, self._kept = key, K, energy, kept
        V, self._u = u.function_space, u
        self.comm = communicator(V.mesh)
        self._K_u = u.x.petsc_vec.duplicate()
        self._F = [] if F is None else compiled_summands(F)
        tangent = ufl.Form([]) if F is None else ufl.derivative(F, u, ufl.TrialFunction(V))
        self._J = compiled_summands(tangent)
        self._tangent = zero_matrix(V, tangent) if self._J else None
        self._g = [] if g is None else compiled_summands(g)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._u_end, self._u_mid = u, mid
        if self._F or self._g:
            self._copy_u(mid.x.petsc_vec)

    def _copy_u(self, u: PETSc.Vec, into: fem.Function | None = None) -> None:
        """Copy the displacements `u`, ghosts included, into the function `into`.

        If `into` is None, they are copied into the function that occurs in the part's UFL forms.
        """
        target = into or self._u
        u.copy(target.x.petsc_vec)
        target.x.scatter_forward()

    def add_constant_forces(self, out: PETSc.Vec) -> None:
        if self._g:
            add_assembled_forces(out, *self._g)

    def add_forces(self, out: PETSc.Vec) -> float:
        return self._add_forces_at(self._u_mid.x.petsc_vec, out)

    def _add_forces_at(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """Add the nodal forces K u + F(u) + g to `out`, and return a norm of them.

        It is the larger of the norms of K u and of F(u) + g. Before the call, the caller copies the displacements `u`
        into the function that occurs in the form F.
        """
        force_norm = 0.0
        if self.K is not None:
            self.K.mult(u, self._K_u)
            force_norm = float(self._K_u.norm())
            out.axpy(1.0, self._K_u)
        if self._F or self._g:
            force_norm = max(force_norm, add_assembled_forces(out, *self._F, *self._g))
        return force_norm

    def tangents(self, relative_residual: float) -> list[Block]:
        theta = self.interval.theta
        blocks = [] if self.K is None else [Block(self.K, theta, kept=True)]
        return blocks + [Block(J, theta, kept=True) for J in self._assembled_tangents()]

    def _assembled_tangents(self) -> list[PETSc.Mat]:
        """Return the tangent matrix of the non-linear forces at the last displacements, in a list.

        The list is empty if there are no such forces.
        """
        if self._tangent is None:
            return []
        self._tangent.zeroEntries()
        for form in self._J:
            dolfinx.fem.petsc.assemble_matrix(self._tangent, form)
        self._tangent.assemble()
        return [self._tangent]

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        if self._F or self._g:
            self._copy_u(state.u.x.petsc_vec)
        self._add_forces_at(state.u.x.petsc_vec, out)

    # ---------------------------------------------------------------- an accepted step
    def commit(self) -> StepOutcome:
        now, old = self._u_end.x.petsc_vec, self.interval.old.u.x.petsc_vec
        change, theta = now.duplicate(), self.interval.theta
        change.waxpy(-1.0, old, now)
        before, after, change_energy = (self._quadratic_energy(v) for v in (old, now, change))
        supplied, remainder = 0.0, (2 * theta - 1) * change_energy
        if self._F or self._g:
            self._K_u.set(0.0)
            add_assembled_forces(self._K_u, *self._F, *self._g)
            supplied = self._supplied_work()
            work_done = float(self._K_u.dot(change)) + supplied
            u_values = self._u.x.array.copy()  # `now` may share these values, which `_energy_at` overwrites
            psi_new, psi_old = self._energy_at(now, self.interval), self._energy_at(old, self.interval, at_start=True)
            self._u.x.array[:] = u_values
            before, after, remainder = before + psi_old, after + psi_new, remainder + work_done - (psi_new - psi_old)
        change.destroy()
        return StepOutcome(before, after, 0.0, remainder, kept=self._kept, supplied=supplied)

    def _supplied_work(self) -> float:
        """Return the work of the stresses in the strains prescribed during the step; 0 if no strains are prescribed.

        The stresses are those of the last call of `evaluate`. The strains are the increments of prescribed strains over
        the step.
        """
        return 0.0

    def _quadratic_energy(self, u: PETSc.Vec) -> float:
        """Return the energy u.K u/2 of the linear forces at displacements `u`; 0 without such forces."""
        if self.K is None:
            return 0.0
        self.K.mult(u, self._K_u)
        return float(u.dot(self._K_u)) / 2

    @cached_property
    def _energy_forms(self) -> list[fem.Form]:
        return [] if self._energy is None else compiled_summands(self._energy)

    def _energy_at(self, u: PETSc.Vec, interval: TimeStep, *, at_start: bool = False) -> float:
        """Return the stored energy of the forces F(u) and g at displacements `u`; NaN if they have no energy.

        Args:
            u: displacements at the beginning or at the end of a step.
            interval: the step.
            at_start: True if `u` belongs to the beginning of the step, False if it belongs to the end.
        """
        if self._energy is None:
            return float("nan")
        self._copy_u(u)
        return float(self.comm.allreduce(sum(map(fem.assemble_scalar, self._energy_forms))))

    def destroy(self) -> None:
        destroy(self.K, self._K_u, self._tangent)


def assemble_plain_matrix(form: Expr) -> PETSc.Mat:
    """Assemble the matrix of a UFL bilinear form; no rows or columns are changed for supports."""
    return assemble_matrix(compiled(form))


class LawFormPart(FormPart):
    """Nodal forces of those laws of bodies or layers that are UFL forms: K u of linear laws, F(u) of the others.

    If there are bodies but no linear law, K is zero with the nonzero pattern of the bodies' tangent. Prescribed strains
    of linear laws cause forces g that do not depend on u. Prescribed strains of all laws do work as they grow.

    Args:
        key: name of the part in states and files.
        V: space of the displacements.
        terms: virtual works of the laws. Those of compiled laws are left out.
        other_terms: virtual works that belong to other parts. If they are UFL forms on S between two bodies, the
            nonzero pattern of K includes their entries.
    """

    def __init__(self, key: str, V: fem.FunctionSpace, terms: Sequence[Term], other_terms: Iterable[Term] = ()) -> None:
        body_terms = [p for p in terms if p.n is None]
        self._terms = terms = [p for p in terms if not p.law.traits.compiled]
        for p in terms:
            check(p.law, None if p.n is None else p.n.ufl_shape[0])
        terms_and_linearity = [(p, p.is_proportional) for p in terms]
        linear = [p for p, is_linear in terms_and_linearity if is_linear]
        nonlinear = [p for p, is_linear in terms_and_linearity if not is_linear]
        prestrained = [p for p in linear if p.prescribed_strain is not None]
        self._step_strain = step_strains = StepStrains(V.mesh, terms)
        self._has_prescribed_strains, stored_energy = any(p.prescribed_strain is not None for p in terms), None
        u, v = fem.Function(V), ufl.TestFunction(V)
        if (nonlinear or prestrained) and all(p.law.traits.has_energy for p in nonlinear + prestrained):
            # prescribed strains of linear laws add energy to u.K u/2
            strain_energies = [_strain_energy(p, u) for p in with_strains(prestrained, step_strains.now)]
            stored_energy = energy(with_strains(nonlinear, step_strains.now), u) + sum(strain_energies)
        K = _linear_stiffness(V, linear, body_terms, other_terms) if linear or body_terms else None
        F = work(with_strains(nonlinear, step_strains.at_balance_time), u, v) if nonlinear else None
        strained_terms = with_strains(prestrained, step_strains.at_balance_time)
        g = sum(strain_work(p, p.prescribed_strain, p.strain(v)) for p in strained_terms) if prestrained else None
        super().__init__(key, u, K, F, stored_energy, g=g)
        strained_bodies = [p for p in nonlinear if p.n is None and p.prescribed_strain is not None]
        self._scale_forms = _strain_force_integrals(with_strains(strained_bodies, step_strains.at_balance_time), u)
        traits = reduce(or_, map(_form_traits, terms), PartTraits())
        self.traits = replace(traits, within_bodies=all(p.n is None for p in terms))

    def law_traits(self) -> dict[str, PartTraits]:
        traits_by_name: dict[str, PartTraits] = {}
        for name, traits in ((type(p.law).__name__, _form_traits(p)) for p in self._terms):
            traits_by_name[name] = traits_by_name.get(name, PartTraits()) | traits
        return traits_by_name

    # ---------------------------------------------------------------- prescribed strains
    @cached_property
    def _supplied_work_form(self) -> fem.Form:
        """Compiled form of the work of the stresses in the strains prescribed during the step.

        The stresses are those of the last call of `evaluate`. The strains are the increments of prescribed strains over
        the step.
        """
        strains, terms = self._step_strain, [p for p in self._terms if p.prescribed_strain is not None]
        pairs = zip([stress(p, self._u) for p in with_strains(terms, strains.at_balance_time)], terms, strict=True)
        return compiled(sum(ufl.inner(s, strains.growth(p.prescribed_strain)) * p.weight * p.measure for s, p in pairs))

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        self._step_strain.begin(interval.old.t, interval.t, interval.theta, at_rest=interval.old.at_rest)

    def _supplied_work(self) -> float:
        strains_grow = self._has_prescribed_strains and self._step_strain.has_increment
        return float(self.comm.allreduce(fem.assemble_scalar(self._supplied_work_form))) if strains_grow else 0.0

    def add_forces(self, out: PETSc.Vec) -> float:
        return max(super().add_forces(out), self._strain_force_scale())

    def _strain_force_scale(self) -> float:
        """Return a reference force, with which residuals are compared, of non-linear bodies with prescribed strains e.

        It is a mean stress times V^(1 - 1/d), with the volume V of these bodies and the number d of dimensions. The
        mean stress is |int stress : e|/sqrt(V int e : e), or 0 if e is zero. Nodal forces give no reference force, as
        they cancel if stresses are uniform. K gives none either, as it contains no stiffness of non-linear bodies.
        """
        if not self._scale_forms:
            return 0.0
        work, square, volume = self.comm.allreduce(np.array([fem.assemble_scalar(form) for form in self._scale_forms]))
        strain_scale = np.sqrt(square * volume) * volume ** (1 / self._u.function_space.mesh.geometry.dim) / volume
        return float(abs(work) / strain_scale) if strain_scale > 0 and np.isfinite(work) else 0.0

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        copy_of_z = fem.Function(self._u.function_space)
        for u, target in ((z, copy_of_z), (self._u_mid, self._u)):
            self._copy_u(u.x.petsc_vec, target)
        for p in with_strains(self._terms, self._step_strain.at_balance_time):
            density = ufl.inner(stress(p, self._u), p.strain(copy_of_z)) * p.weight
            add_integral_to_nodes(density, copy_of_z.function_space, p.measure, out)

    def _energy_at(self, u: PETSc.Vec, interval: TimeStep, *, at_start: bool = False) -> float:
        old = interval.old
        self._step_strain.set_now(old.t if at_start else interval.t, at_rest=at_start and old.at_rest)
        return super()._energy_at(u, interval, at_start=at_start)

    def largest_nonlinear_stiffness(self) -> float:
        """Return the largest diagonal entry of the non-linear laws' tangent before loading. Collective.

        It is a force per displacement. The result is 0 if there is no non-linear law, or if that entry is not a
        positive finite number.
        """
        self._u.x.array[:] = 0.0
        diagonals = [A.getDiagonal() for A in self._assembled_tangents()]
        largest = max((float(diagonal.max()[1]) for diagonal in diagonals), default=0.0)
        destroy(*diagonals)
        return largest if 0 < largest < np.inf else 0.0

    @cached_property
    def _softening_terms(self) -> list[tuple[CompiledTerm, Callable[[float], Array]]]:
        """Those laws of layers that may soften, each compiled at its quadrature points.

        Each entry is a pair: the compiled law, and a function of the time that returns the prescribed strains (points,
        m) at the points. Laws with a parameter that is a function of the place are left out.
        """
        terms = [p for p in self._terms if p.n is not None and p.law.traits.may_soften and _is_homogeneous(p.law)]
        compiled_terms = [CompiledTerm(self._u.function_space, replace(p, law=_to_compiled_law(p.law))) for p in terms]
        return [(compiled_term, prescribed_strain_function(compiled_term)) for compiled_term in compiled_terms]

    def undeclared_softening(self) -> Softening | None:
        old = self.interval.old
        step_ends = (self._u_end, self.interval.t), (old.u, old.t)
        for points, prescribed_strain_at in self._softening_terms:
            e, e_old = (points.strain(u.x.petsc_vec) + prescribed_strain_at(t) for u, t in step_ends)
            response = points.respond(e, e_old, points.rest(), 0.0, 1.0)
            if softening := find_softening(points, e, e_old, points.rest(), response):
                return softening
        return None

    def destroy(self) -> None:
        super().destroy()
        destroy(*(points for points, _ in vars(self).get("_softening_terms", ())))


def _is_homogeneous(law: BulkLaw) -> bool:
    """Tell whether all parameters of `law`, or of its sublayers, are numbers or DOLFINx Constants."""
    parameters = [value for _, sublayer in law.sublayers for value in sublayer.parameters().values()]
    return all(isinstance(value, fem.Constant) or not isinstance(value, ufl.core.expr.Expr) for value in parameters)


def _to_compiled_law(law: BulkLaw) -> BulkLaw:
    """Return the law in UFL `law` as a compiled law, with the present values of its DOLFINx Constants as numbers."""
    return law.mapped(lambda value, _: np.asarray(getattr(value, "value", value), float)).compiled_copy()


def _form_traits(term: Term) -> PartTraits:
    """Return the traits of a law in a UFL form, from its virtual work `term`.

    They are the traits of the law, without those that only compiled laws have. A law in a UFL form has no homotopy, and
    its tangent is not regularised. In bodies the trait `weakens` is set to False.
    """
    traits = PartTraits.of(term.law)
    weakens, unchecked_stresses = traits.weakens and term.n is not None, not term.is_proportional
    return replace(traits, singular=False, has_homotopy=False, weakens=weakens, unchecked_stresses=unchecked_stresses)


def strain_work(p: Term, strain: Expr, virtual_strain: Expr) -> Expr:
    """Return the virtual work, a UFL form, of the stress that the strain `strain` (3, 3) of the linear law `p` causes.

    The work is done in the strain `virtual_strain` (3, 3).
    """
    return ufl.inner(p.law.stress(Step(strain, p.n)), virtual_strain) * p.weight * p.measure


def _strain_energy(p: Term, u: fem.Function) -> Expr:
    """Return, as a UFL form, the energy that the prescribed strain of the linear law `p` adds to that of `u`.

    The energy of the displacements `u` alone is u.K u/2.
    """
    energy_of_strain = p.law.energy(Step(p.prescribed_strain, p.n)) * p.weight * p.measure
    return strain_work(p, p.prescribed_strain, p.strain(u)) + energy_of_strain


def _strain_force_integrals(strained: Sequence[Term], u: fem.Function) -> list[fem.Form]:
    """Return three compiled integrals over bodies with prescribed strains e: of stress : e, of e : e, and of 1.

    Args:
        strained: virtual works of these bodies' laws; without any, the result is an empty list.
        u: displacements, from which and from e the stress follows.
    """
    unity = fem.Constant(u.function_space.mesh, 1.0)
    densities = [(ufl.inner(stress(p, u), e), ufl.inner(e, e), unity) for p in strained for e in [p.prescribed_strain]]
    forms_of_terms = [[f * p.weight * p.measure for f in row] for p, row in zip(strained, densities, strict=True)]
    return [compiled(sum(summands)) for summands in zip(*forms_of_terms, strict=True)]


def _linear_stiffness(
    V: fem.FunctionSpace, linear: Sequence[Term], body_terms: Sequence[Term], other_terms: Iterable[Term]
) -> PETSc.Mat:
    """Assemble the stiffness matrix of linear laws; without linear laws, zeros in the nonzero pattern of `body_terms`.

    Args:
        V: space of the displacements.
        linear: virtual works of the linear laws.
        body_terms: virtual works of all bodies' laws.
        other_terms: virtual works that belong to other parts. If they are UFL forms on S between two bodies, the
            nonzero pattern includes their entries.

    Raises:
        InputError: a law declares that it is linear and is not.
    """
    interfaces = [p for p in other_terms if p.measure.integral_type() == "interior_facet" and not p.law.traits.compiled]
    K = zero_matrix(V, sum(1 * p.measure for p in (*(linear or body_terms), *interfaces)))
    try:
        form = work((replace(p, prescribed_strain=None) for p in linear), ufl.TrialFunction(V), ufl.TestFunction(V))
        for summand in compiled_summands(form) if linear else ():
            dolfinx.fem.petsc.assemble_matrix(K, summand)
    except ArityMismatch as error:
        names = " or ".join(sorted({type(p.law).__name__ for p in linear if equations_key(p.law) is None}))
        text = f"{names} says linear = True, but is not linear, or UFL does not see that it is: {error}"
        raise InputError(f"{text}; write linear = False in the class") from error
    K.assemble()
    return K


__getattr__ = make_module_getattr(__name__, {"matrix": assemble_plain_matrix})
