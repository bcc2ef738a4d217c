"""Parts that are UFL forms, by a matrix or by assembling: those of laws, springs, or a user's own form."""

from __future__ import annotations

from functools import cached_property

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr
from thinlayer.discretisation.measures import compiled, compiled_summands
from thinlayer.discretisation.state import Configuration
from thinlayer.parts.part import Block, Interval, Outcome, Part
from thinlayer.pointwise.assembling import add_forces_of, matrix_of
from thinlayer.system.ranks import communicator


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
        self._product, self._change = (u.x.petsc_vec.duplicate() for _ in range(2))
        self._F = [] if F is None else compiled_summands(F)
        self._J = [] if F is None else compiled_summands(ufl.derivative(F, u, ufl.TrialFunction(V)))
        self._tangents: list[PETSc.Mat] = []  # of the forms in _J
        self._g = [] if g is None else compiled_summands(g)

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._end, self._mid = u, mid
        if self._F or self._g:
            self._take(mid.x.petsc_vec)

    def _take(self, u: PETSc.Vec, into: fem.Function | None = None) -> None:
        """From now on compute F and its energy at displacements u; or put what they are here into another function."""
        own = into or self._u
        u.copy(own.x.petsc_vec)
        own.x.scatter_forward()

    def add_fixed(self, out: PETSc.Vec) -> None:
        if self._g:
            add_forces_of(out, *self._g)

    def add_forces(self, out: PETSc.Vec) -> float:
        return self._add(self._mid.x.petsc_vec, out)

    def _add(self, u: PETSc.Vec, out: PETSc.Vec) -> float:
        """Add the forces at displacements u, which `_take` has got; returns the larger norm of K u and F + g."""
        size = 0.0
        if self.K is not None:
            self.K.mult(u, self._product)
            size = float(self._product.norm())
            out.axpy(1.0, self._product)
        if self._F or self._g:
            size = max(size, add_forces_of(out, *self._F, *self._g))
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

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        if self._F or self._g:
            self._take(state.u.x.petsc_vec)
        self._add(state.u.x.petsc_vec, out)

    # ---------------------------------------------------------------- an accepted step
    def commit(self) -> Outcome:
        now, old = self._end.x.petsc_vec, self.interval.old.u.x.petsc_vec
        change, theta = self._change, self.interval.theta
        now.copy(change)
        change.axpy(-1.0, old)
        before, after, of_change = (self._quadratic(v) for v in (old, now, change))
        supplied = 0.0
        remainder = (2 * theta - 1) * of_change
        if self._F or self._g:
            self._product.set(0.0)
            add_forces_of(self._product, *self._F, *self._g)
            supplied = self._supplied()
            worked = float(self._product.dot(change)) + supplied
            taken = self._u.x.array.copy()  # `now` may be the vector of these values
            last, first = self._stored(now, self.interval), self._stored(old, self.interval, before=True)
            self._u.x.array[:] = taken
            before, after, remainder = before + first, after + last, remainder + worked - (last - first)
        return Outcome(before, after, 0.0, remainder, kept=self._kept, supplied=supplied)

    def _supplied(self) -> float:
        """Work of given strains in the step, with the stresses of the last evaluation."""
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

    def _stored(self, u: PETSc.Vec, interval: Interval, *, before: bool = False) -> float:
        """The energy of F and g at displacements u at the end of a step, or `before` it; NaN if they have none."""
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
    return matrix_of(compiled(form))
