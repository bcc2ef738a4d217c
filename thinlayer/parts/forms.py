"""Parts that are UFL forms: the bodies, the layer's laws without memory or rate, or a user's own form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.algorithms.check_arities import ArityMismatch

from forms.elastic import LinearElastic
from forms.kinematics import Expr
from forms.law import LawError
from forms.symmetry import require_declared_stress, require_symmetric_tangent
from forms.trace import named, stress_key
from forms.work import Term, energy, work
from thinlayer.discretisation.model import Model
from thinlayer.parts.part import Array, Block, Outcome, Part, PartTraits, may_weaken
from thinlayer.parts.softening import Softening


class FormPart(Part):
    """Forces K mid + F(mid), a linear and a non-linear part.

    Args:
        key: key of the part.
        V: space of the displacements.
        K: matrix of the linear forces; None: there are none.
        residual: displacement, test function -> F, a UFL form; None: there is no F.
        energy: displacement -> the stored energy of F, a UFL form; None: F has no energy.
    """

    def __init__(
        self,
        key: str,
        V: fem.FunctionSpace,
        K: PETSc.Mat | None,
        residual: Callable[[Expr, Expr], Expr] | None = None,
        energy: Callable[[Expr], Expr] | None = None,
    ) -> None:
        self.key, self.K, self._energy = key, K, energy
        self._u = fem.Function(V)  # argument of the compiled F, its derivative and its energy
        self._product, self._change = (PETSc.Vec().createWithArray(self._owned(), comm=V.mesh.comm) for _ in range(2))
        self._F: fem.Form | None = None
        if residual is not None:
            F = residual(self._u, ufl.TestFunction(V))
            self._F, self._J = fem.form(F), fem.form(ufl.derivative(F, self._u, ufl.TrialFunction(V)))

    def _owned(self) -> Array:
        dofmap = self._u.function_space.dofmap
        return self._u.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs].copy()

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        self._end, self._mid = u, mid
        if self._F is not None:
            self._take(mid.x.petsc_vec)

    def _take(self, u: PETSc.Vec) -> None:
        """From now on compute F and its energy at displacements u."""
        u.copy(self._u.x.petsc_vec)
        self._u.x.scatter_forward()

    def _nonlinear(self) -> PETSc.Vec:
        """Nodal forces F; the caller destroys the vector."""
        b = dolfinx.fem.petsc.assemble_vector(self._F)
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
        if self._F is not None:
            b = self._nonlinear()
            size = max(size, float(b.norm()))
            out.axpy(1.0, b)
            b.destroy()
        return size

    def tangents(self, relative_residual: float) -> list[Block]:
        theta = self.interval.theta
        found = [] if self.K is None else [Block(self.K, theta, kept=True)]
        if self._F is not None:
            J = dolfinx.fem.petsc.assemble_matrix(self._J)
            J.assemble()
            found.append(Block(J, theta))
        return found

    def error_measure(self, u: fem.Function, forces: PETSc.Vec) -> Array:
        if self._F is not None:
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
        remainder = (2 * theta - 1) * of_change
        if self._F is not None:
            b = self._nonlinear()
            worked = float(b.dot(change))
            b.destroy()
            first, last = self._stored(old), self._stored(now)
            before, after, remainder = before + first, after + last, remainder + worked - (last - first)
        return Outcome(before, after, 0.0, remainder, kept=False)

    def _quadratic(self, u: PETSc.Vec) -> float:
        """u.K u / 2."""
        if self.K is None:
            return 0.0
        self.K.mult(u, self._product)
        return float(u.dot(self._product)) / 2

    @cached_property
    def _energy_form(self) -> fem.Form | None:
        return fem.form(self._energy(self._u)) if self._energy else None

    def _stored(self, u: PETSc.Vec) -> float:
        """The energy of F at displacements u; NaN if F has none."""
        if self._energy_form is None:
            return float("nan")
        self._take(u)
        comm = self._u.function_space.mesh.comm
        return float(comm.allreduce(fem.assemble_scalar(self._energy_form)))

    def destroy(self) -> None:
        for thing in (self.K, self._product, self._change):
            if thing is not None:
                thing.destroy()


class LawForms(FormPart):
    """The terms of bodies and layer whose laws are not compiled: linear laws in K, the others in F.

    If no law is linear, K is zero with the nonzero pattern of the tangent.
    """

    def __init__(self, model: Model) -> None:
        terms = [p for p in model.terms if not p.law.traits.compiled]
        for p in terms:
            computed = stress_key(p.law, None if p.n is None else p.n.ufl_shape[0])
            require_declared_stress(p.law, computed)
            require_symmetric_tangent(p.law, computed)
        proportional = [p.proportional for p in terms]
        linear = [p for p, yes in zip(terms, proportional, strict=True) if yes]
        self._others = others = [p for p, yes in zip(terms, proportional, strict=True) if not yes]
        has_energy = all(p.law.traits.has_energy for p in others)
        super().__init__(
            "forms",
            model.V,
            _stiffness(model, linear),
            (lambda u, v: work(others, u, v)) if others else None,
            (lambda u: energy(others, u)) if has_energy else None,
        )
        self._model, self._in_layer = model, any(p.n is not None for p in terms)
        laws = [p.law for p in model.layer_terms if not p.law.traits.compiled]
        self.traits = PartTraits(weakens=any(may_weaken(law) for law in laws))

    @property
    def largest(self) -> float:
        """Largest diagonal entry of K."""
        assert self.K is not None
        diagonal = self.K.getDiagonal()
        largest = float(diagonal.max()[1])
        diagonal.destroy()
        return largest

    @property
    def resists_rigid(self) -> bool:
        return self._in_layer

    @property
    def unchecked(self) -> Sequence[str]:
        return [type(p.law).__name__ for p in self._others]

    @cached_property
    def _softening(self) -> Softening:
        return Softening(self._model)

    def undeclared_softening(self) -> tuple[str, str] | None:
        name, share = self._softening.found(self._end, self.interval.old.u)
        return (name, f"on {share:.3g} of the layer") if name else None


def _stiffness(model: Model, linear: Sequence[Term]) -> PETSc.Mat:
    """The assembled matrix of the linear laws; if there are none, zeros in the nonzero pattern of elastic bodies.

    Raises:
        LawError: a law declares that it is linear and is not.
    """
    trial, test = ufl.TrialFunction(model.V), ufl.TestFunction(model.V)
    pattern = linear or [replace(p, law=LinearElastic(0.0, 1.0)) for p in model.bodies]
    try:
        form = fem.form(work(pattern, trial, test))
    except ArityMismatch as error:
        names = " or ".join(sorted({type(p.law).__name__ for p in linear if named(p.law) is None}))
        raise LawError(
            f"{names} says linear = True, but is not linear, or UFL does not see that it is: {error}; "
            "write linear = False in the class"
        ) from error
    K = dolfinx.fem.petsc.assemble_matrix(form)
    K.assemble()
    if not linear:
        K.zeroEntries()
    return K
