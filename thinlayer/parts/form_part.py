"""Parts of the balance of forces that are UFL forms: laws of bodies and layers, springs and user-defined forms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property, reduce
from operator import or_

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch

from forms.base import InputError
from forms.check import check
from forms.law import Step
from forms.law_tangents import equations_key
from forms.tensors import Expr
from forms.work import Term, stress, work
from thinlayer.discretisation.form_compilation import compiled, compiled_summands, zero_matrix
from thinlayer.discretisation.state import Configuration
from thinlayer.discretisation.time_functions import StepStrains, with_strains
from thinlayer.errors import make_module_getattr
from thinlayer.parts.part import Block, Part, PartTraits, StepOutcome, TimeStep
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
        if (
            self.K is not None
        ):  # the work, without an energy, of a matrix that is not symmetric; _K_u is K times the change
            remainder += after - before - change_energy - float(old.dot(self._K_u))
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


class LinearPart(FormPart):
    """Nodal forces K u of those laws of bodies or layers whose stress is proportional to the strain.

    If there are bodies but no such law, K is zero with the nonzero pattern of the bodies' tangent. Prescribed strains
    cause forces g that do not depend on u, and do work as they grow.

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
            check(p.law)
        self._strained = strained = [p for p in terms if p.prescribed_strain is not None]
        self._step_strains = step_strains = StepStrains(V.mesh, strained)
        u, v, stored_energy = fem.Function(V), ufl.TestFunction(V), None
        if strained and all(p.law.traits.has_energy for p in strained):  # it adds to u.K u/2
            stored_energy = sum(_strain_energy(p, u) for p in with_strains(strained, step_strains.now))
        K = _linear_stiffness(V, terms, body_terms, other_terms) if terms or body_terms else None
        strained_terms = with_strains(strained, step_strains.at_balance_time)
        g = sum(strain_work(p, p.prescribed_strain, p.strain(v)) for p in strained_terms) if strained else None
        super().__init__(key, u, K, None, stored_energy, g=g)
        traits = reduce(or_, (PartTraits.of(p.law) for p in terms), PartTraits())
        self.traits = replace(traits, within_bodies=all(p.n is None for p in terms))

    def law_traits(self) -> dict[str, PartTraits]:
        return {type(p.law).__name__: PartTraits.of(p.law) for p in self._terms}

    # ---------------------------------------------------------------- prescribed strains
    @cached_property
    def _supplied_work_form(self) -> fem.Form:
        """Compiled form of the work of the stresses in the strains prescribed during the step.

        The stresses are those of the last call of `evaluate`. The strains are the increments of prescribed strains over
        the step.
        """
        strains = self._step_strains
        stresses = [stress(p, self._u) for p in with_strains(self._strained, strains.at_balance_time)]
        pairs = zip(stresses, self._strained, strict=True)
        return compiled(sum(ufl.inner(s, strains.growth(p.prescribed_strain)) * p.weight * p.measure for s, p in pairs))

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        self._step_strains.begin(interval.old.t, interval.t, interval.theta, at_rest=interval.old.at_rest)

    def _supplied_work(self) -> float:
        strains_grow = self._strained and self._step_strains.has_increment
        return float(self.comm.allreduce(fem.assemble_scalar(self._supplied_work_form))) if strains_grow else 0.0

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        copy_of_z = fem.Function(self._u.function_space)
        for u, target in ((z, copy_of_z), (self._u_mid, self._u)):
            self._copy_u(u.x.petsc_vec, target)
        for p in with_strains(self._terms, self._step_strains.at_balance_time):
            density = ufl.inner(stress(p, self._u), p.strain(copy_of_z)) * p.weight
            add_integral_to_nodes(density, copy_of_z.function_space, p.measure, out)

    def _energy_at(self, u: PETSc.Vec, interval: TimeStep, *, at_start: bool = False) -> float:
        old = interval.old
        self._step_strains.set_now(old.t if at_start else interval.t, at_rest=at_start and old.at_rest)
        return super()._energy_at(u, interval, at_start=at_start)


def strain_work(p: Term, strain: Expr, virtual_strain: Expr) -> Expr:
    """Return the virtual work, a UFL form, of the stress that the strain `strain` (3, 3) of the linear law `p` causes.

    The work is done in the strain `virtual_strain` (3, 3).
    """
    return ufl.inner(p.law.stress(Step(strain, p.normal)), virtual_strain) * p.weight * p.measure


def _strain_energy(p: Term, u: fem.Function) -> Expr:
    """Return, as a UFL form, the energy that the prescribed strain of the linear law `p` adds to that of `u`.

    The energy of the displacements `u` alone is u.K u/2.
    """
    energy_of_strain = p.law.energy(Step(p.prescribed_strain, p.normal)) * p.weight * p.measure
    return strain_work(p, p.prescribed_strain, p.strain(u)) + energy_of_strain


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
