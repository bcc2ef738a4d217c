"""Parts that are UFL forms: the bodies, the layer's laws without memory or rate, or a user's own form."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch

from forms.elastic import LinearElastic
from forms.kinematics import Expr, lift
from forms.law import LawError, Step
from forms.symmetry import require_declared_stress, require_symmetric_tangent
from forms.trace import named, stress_key
from forms.work import Term, energy, stress, work
from thinlayer.discretisation.mean_strain import MeanStrain
from thinlayer.discretisation.measures import compiled, compiled_summands
from thinlayer.parallel.communicator import communicator
from thinlayer.parts.part import Array, Block, Interval, Outcome, Part, PartTraits, may_weaken
from thinlayer.parts.softening import Softening


class FormPart(Part):
    """Forces K mid + F(mid) + g, a linear part, a non-linear one, and one that does not depend on the displacements.

    Args:
        key: key of the part.
        u: the displacements that F and its energy are forms of; the part writes values into them.
        K: matrix of the linear forces, which the part destroys in the end; None: there are none.
        F: virtual work, a UFL form of u, linear in a test function; None: there is no F.
        energy: the stored energy of F and g, a UFL form of u; None: they have no energy.
        kept: whether states keep the energy, under the key.
        g: virtual work of the constant forces, a UFL form that is linear in a test function; None: there are none.
    """

    def __init__(
        self,
        key: str,
        u: fem.Function,
        K: PETSc.Mat | None = None,
        F: Expr | None = None,
        energy: Expr | None = None,
        *,
        kept: bool = False,
        g: Expr | None = None,
    ) -> None:
        self.key, self.K, self._energy, self._kept = key, K, energy, kept
        V, self._u = u.function_space, u
        self.comm = communicator(V.mesh)
        self._product, self._change = (PETSc.Vec().createWithArray(self._owned(), comm=V.mesh.comm) for _ in range(2))
        self._F: list[fem.Form] = []
        self._J: list[fem.Form] = []
        self._tangents: list[PETSc.Mat] = []  # of the forms in _J
        if F is not None:
            self._F = compiled_summands(F)
            self._J = compiled_summands(ufl.derivative(F, u, ufl.TrialFunction(V)))
        if g is not None:
            self._F += compiled_summands(g)

    def _owned(self) -> Array:
        dofmap = self._u.function_space.dofmap
        return self._u.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs].copy()

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._end, self._mid = u, mid
        if self._F:
            self._take(mid.x.petsc_vec)

    def _take(self, u: PETSc.Vec) -> None:
        """From now on compute F and its energy at displacements u."""
        u.copy(self._u.x.petsc_vec)
        self._u.x.scatter_forward()

    def _nonlinear(self) -> PETSc.Vec:
        """Nodal forces F; the caller destroys the vector."""
        first, *others = self._F
        b = dolfinx.fem.petsc.assemble_vector(first)
        for form in others:
            dolfinx.fem.petsc.assemble_vector(b, form)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        return b

    def add_forces(self, out: PETSc.Vec) -> float:
        return self._add(self._mid.x.petsc_vec, out)

    def _add(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """Add the forces at displacements u, which `_take` has got; returns the larger norm of K u and F."""
        size = 0.0
        if self.K is not None:
            self.K.mult(u, self._product)
            size = float(self._product.norm())
            out.axpy(1.0, self._product)
        if self._F:
            b = self._nonlinear()
            size = max(size, float(b.norm()))
            out.axpy(1.0, b)
            b.destroy()
        return size

    def tangents(self, relative_residual: float) -> list[Block]:
        theta = self.interval.theta
        found = [] if self.K is None else [Block(self.K, theta, kept=True)]
        if not self._tangents:
            self._tangents = [dolfinx.fem.petsc.create_matrix(form) for form in self._J]
        for J, form in zip(self._tangents, self._J, strict=True):
            J.zeroEntries()
            dolfinx.fem.petsc.assemble_matrix(J, form)
            J.assemble()
            found.append(Block(J, theta, kept=True))
        return found

    def error_measure(self, u: fem.Function, forces: PETSc.Vec) -> Array:
        if self._F:
            self._take(u.x.petsc_vec)
        self._add(u.x.petsc_vec, forces)
        return super().error_measure(u, forces)

    # ---------------------------------------------------------------- an accepted step
    def commit(self) -> Outcome:
        now, old, change, theta = (
            self._end.x.petsc_vec, self.interval.old.u.x.petsc_vec, self._change, self.interval.theta
        )  # fmt: skip
        now.copy(change)
        change.axpy(-1.0, old)
        before, after, of_change = (self._quadratic(v) for v in (old, now, change))
        supplied = 0.0
        remainder = (2 * theta - 1) * of_change
        if self._F:
            b = self._nonlinear()
            supplied = self._supplied()
            worked = float(b.dot(change)) + supplied
            b.destroy()
            taken = self._u.x.array.copy()  # `now` may be the vector of these values
            last, first = self._stored(now, self.interval.t), self._stored(old, self.interval.old.t)
            self._u.x.array[:] = taken
            before, after, remainder = before + first, after + last, remainder + worked - (last - first)
        return Outcome(before, after, 0.0, remainder, kept=self._kept, supplied=supplied)

    def _supplied(self) -> float:
        """Work of prescribed strains in the step, with the stresses of the last evaluation."""
        return 0.0

    def _quadratic(self, u: PETSc.Vec) -> float:
        """u.K u / 2."""
        if self.K is None:
            return 0.0
        self.K.mult(u, self._product)
        return float(u.dot(self._product)) / 2

    @cached_property
    def _energy_form(self) -> fem.Form | None:
        return None if self._energy is None else compiled(self._energy)

    def _stored(self, u: PETSc.Vec, t: float) -> float:
        """The energy of F and g at displacements u and time t; NaN if they have none."""
        if self._energy_form is None:
            return float("nan")
        self._take(u)
        return float(self.comm.allreduce(fem.assemble_scalar(self._energy_form)))

    def destroy(self) -> None:
        for thing in (self.K, self._product, self._change, *self._tangents):
            if thing is not None:
                thing.destroy()


def matrix(form: Expr) -> PETSc.Mat:
    """The assembled matrix of a bilinear form, without supports."""
    K = dolfinx.fem.petsc.assemble_matrix(compiled(form))
    K.assemble()
    return K


class LawForms(FormPart):
    """The terms of bodies and layer whose laws are not compiled: linear laws in K, the others in F.

    If no law is linear, K is zero with the nonzero pattern of the tangent.

    Args:
        V: space of the displacements.
        terms: all terms; those whose laws are compiled are left out.
        mean: mean strain of the bodies; the forces that it causes by linear laws do not depend on the displacements.
    """

    def __init__(self, V: fem.FunctionSpace, terms: Iterable[Term], mean: MeanStrain | None = None) -> None:
        terms = list(terms)
        everywhere = [p for p in terms if p.n is None]
        self._terms = terms = [p for p in terms if not p.law.traits.compiled]
        for p in terms:
            computed = stress_key(p.law, None if p.n is None else p.n.ufl_shape[0])
            require_declared_stress(p.law, computed)
            require_symmetric_tangent(p.law, computed)
        proportional = [p.proportional for p in terms]
        linear = [p for p, yes in zip(terms, proportional, strict=True) if yes]
        self._others = others = [p for p, yes in zip(terms, proportional, strict=True) if not yes]
        bodies = [p for p in terms if p.n is None]
        u, v = fem.Function(V), ufl.TestFunction(V)
        self._mean, g = mean, None
        moved = linear_bodies = [p for p in linear if p.n is None and mean]
        if mean:
            self._E = mean.constant()
            others, moved = mean.added(others, self._E), mean.added(linear_bodies, self._E)
            g = sum(ufl.inner(_stress_of_mean(p), p.strain(v)) * p.weight * p.measure for p in moved) if moved else None
            self._dE = mean.constant()
            power = [
                ufl.inner(stress(p, u), lift(self._dE)) * p.weight * p.measure for p in mean.added(bodies, self._E)
            ]
            self._power = compiled(sum(power))
        stored = None
        if (others or moved) and all(p.law.traits.has_energy for p in others + moved):
            stored = energy(others + moved, u)
            if moved:
                stored -= energy(linear_bodies, u)  # K has the energy of the displacements alone
        super().__init__(
            "forms",
            u,
            _stiffness(V, linear, everywhere),
            work(others, u, v) if others else None,
            stored,
            g=g,
        )
        self._in_layer = len(bodies) < len(terms)
        self._middle: Array = np.zeros((1, 1))
        self._judged = bool(mean) and any(p.n is None for p in others)
        self.traits = PartTraits(weakens=any(may_weaken(p.law) for p in terms if p.n is not None))

    # ---------------------------------------------------------------- the mean strain
    def at_time(self, t: float) -> None:
        self._t = t

    def parameters(self) -> list[Array]:
        return [self._mean.at(self._t).ravel()] if self._mean else []

    def begin(self, interval: Interval) -> None:
        super().begin(interval)
        if self._mean:
            old, new = self._mean.at(interval.old.t), self._mean.at(interval.t)
            self._E.value[:] = self._middle = interval.theta * new + (1 - interval.theta) * old
            self._growth = new - old

    def _supplied(self) -> float:
        return self._work_of(self._growth) if self._mean else 0.0

    def _work_of(self, strain: Array) -> float:
        """Work of the stresses of the bodies, at the last evaluation, in a strain (d, d) of the whole cell."""
        self._dE.value[:] = strain
        return float(self.comm.allreduce(fem.assemble_scalar(self._power)))

    def add_forces(self, out: PETSc.Vec) -> float:
        """As in `Part`. The scale of forces also knows that of the mean stress on a side of the cell.

        Nodal forces of equal stresses cancel, and bodies that are not linear have no stiffness in K to judge them by.
        """
        size, strain = super().add_forces(out), float(np.abs(self._middle).max())
        if not self._judged or not strain:
            return size
        force = abs(self._work_of(self._middle)) / (strain * self._mean.size)  # type: ignore[union-attr]
        return max(size, force) if np.isfinite(force) else size

    def _stored(self, u: PETSc.Vec, t: float) -> float:
        if not self._mean:
            return super()._stored(u, t)
        self._E.value[:] = self._mean.at(t)
        found = super()._stored(u, t)
        self._E.value[:] = self._middle
        return found

    @property
    def resists_rigid(self) -> bool:
        return self._in_layer

    @property
    def unchecked(self) -> Sequence[str]:
        return [type(p.law).__name__ for p in self._others]

    @cached_property
    def _softening(self) -> Softening:
        return Softening(self._u.function_space, self._terms)

    def undeclared_softening(self) -> tuple[str, str] | None:
        return self._softening.found(self._end, self.interval.old.u)


def _stress_of_mean(p: Term) -> Expr:
    """The stress of a linear law at the mean strain alone."""
    return p.law.stress(Step(p.mean, p.n))


def _stiffness(V: fem.FunctionSpace, linear: Sequence[Term], bodies: Sequence[Term]) -> PETSc.Mat:
    """The assembled matrix of the linear laws; if there are none, zeros in the nonzero pattern of elastic bodies.

    Raises:
        LawError: a law declares that it is linear and is not.
    """
    trial, test = ufl.TrialFunction(V), ufl.TestFunction(V)
    pattern = linear or [replace(p, law=LinearElastic(0.0, 1.0)) for p in bodies]
    try:
        K = matrix(work(pattern, trial, test))
    except ArityMismatch as error:
        names = " or ".join(sorted({type(p.law).__name__ for p in linear if named(p.law) is None}))
        raise LawError(
            f"{names} says linear = True, but is not linear, or UFL does not see that it is: {error}; "
            "write linear = False in the class"
        ) from error
    if not linear:
        K.zeroEntries()
    return K
