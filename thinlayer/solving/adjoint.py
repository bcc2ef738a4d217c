"""Adjoint: responses of a model at one of its equilibria to small forces and motions, with the tangent there."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.tensors import Expr
from geometry.topology import IntArray
from thinlayer.discretisation.form_compilation import compiled
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import Configuration, State
from thinlayer.discretisation.supports import Place
from thinlayer.parts.part import DISPLACEMENT_KEY, Part, TimeStep
from thinlayer.pointwise.quadrature import assemble_forces, set_owned_values
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import linear_solvers, mark_symmetry, needs_factor_only
from thinlayer.solving.part_sum import PartSum, TangentMatrix
from thinlayer.solving.petsc import Options, default_options, solve_linear, value_of
from thinlayer.system.ranks import destroy

GOAL_CHANGE_TOLERANCE = (
    1e-6  # difference of changes of a goal, relative, that counts as rounding: forces of random motions are large
)
LOAD_TOLERANCE = 1e-12  # difference of two loads, relative, that counts as rounding


class Adjoint(AbstractContextManager["Adjoint"]):
    """Linear responses of an interface model at an equilibrium, to forces and to goals. Use it in a `with` statement.

    A goal is Q(u) = q . u - g . r(u), with nodal weights q, the reactions r of what holds the model, and motions g of it.
    Its weights z are K^t z = q, z = g where displacements are held.

    Args:
        state: the equilibrium.
        old: the configuration from which it was found in one step; None: from rest at its time.
        options: PETSc options of the solve, as in `solve`; its factor is then used again if the model is linear.

    Attributes:
        transposed: whether `displacements` solves with the transpose, as weights need it.
    """

    def __init__(self, state: State, old: Configuration | None = None, options: Options | None = None) -> None:
        assert isinstance(state.model, InterfaceModel)
        self.state, self.model = state, state.model
        self.equations = equations = Equations(self.model)
        self._given = dict(options or {})
        self._x, self._r = equations.vector(), equations.vector()
        begun = equations.rest(state.t) if old is None else old
        self.interval = TimeStep(begun, state.t, state.t - begun.t, 1.0)
        equations.begin(self.interval)
        equations.put_state(state, self._x)
        equations.residual(self._x, self._r)
        linear = linear_solvers(self.model, equations.parts, value_of("pc_type", self._given))
        self._options = {**linear[0], **self._given}
        self._tangent: PETSc.Mat | None = None
        self.transposed = False
        self._same = self.model.linear and self.model.symmetric  # its factor serves all states, and the transpose
        if self._same and equations.factor.of == (0.0, 1.0):
            return
        with default_options(self._options):
            if self._same and needs_factor_only():
                with equations.with_supports(lend=True) as A:
                    self._renew(A)
                    equations.factor.set_up()
            else:
                A = equations.tangent()
                self._tangent = A.copy()
                equations.apply_bcs(A)
                self._renew(A)

    def _renew(self, A: PETSc.Mat) -> None:
        mark_symmetry(A, self.model, saddle=self.equations.traits.saddle)
        self.equations.factor.renew(A, None, self.equations.set_preconditioner_data)

    def __exit__(self, *_: object) -> None:
        self.equations.destroy()

    # ---------------------------------------------------------------- goals, as vectors of unknowns
    def zero_vector(self) -> PETSc.Vec:
        """Zero."""
        return self.equations.vector()

    def form_weights(self, form: Expr) -> PETSc.Vec:
        """The values q of a UFL form that is linear in a test function of the model's displacements."""
        return self.equations.on_unknowns(assemble_forces(compiled(form)))

    def nodal_weights(self, dofs: IntArray, values: Array) -> PETSc.Vec:
        """Weights q (n,) at displacements (n,), local numbers that one rank gives, ghosts included."""
        f, forces = fem.Function(self.model.V), self.equations.u.x.petsc_vec.duplicate()
        np.add.at(f.x.array, dofs, values)
        f.x.scatter_reverse(la.InsertMode.add)
        forces.array[:] = f.x.array[: self.equations.n_displacements]
        return self.equations.on_unknowns(forces)

    def load_weights(self) -> PETSc.Vec:
        """The loads as weights q, those of plates included, without those on the layers, which bear these themselves."""
        loads = self.equations.loads.copy()
        loads.array[:] -= self.layer_loads
        return self.equations.on_unknowns(loads, [part.load for part in self.equations.with_own])

    @cached_property
    def layer_loads(self) -> Array:
        """Nodal forces (m,) that the interface model has for loads on its layers. Collective."""
        return np.asarray(self.model.forces.nodal_at(self.model.V, self.state.t, layers=True).array_r.copy())

    def prescribed_motions(self) -> PETSc.Vec:
        """Motions g: the displacements that supports prescribe."""
        g = self.zero_vector()
        g.array[self.equations.bc_dofs] = self.equations.prescribed
        return g

    def reaction_motions(self, place: Place, direction: Array) -> PETSc.Vec:
        """Motions g for which -g . r is the force along a direction (d,) of supports and plates at a place."""
        g, model = self.zero_vector(), self.model
        dual = model.constraints.dual_to_resultant(model.holder_rows(place), direction)
        g.array[: self.equations.n_displacements] = -dual
        return g

    def require_dual(self, goal: Any, q: PETSc.Vec, g: PETSc.Vec, *, layers: bool) -> None:
        """Raise InputError unless a linear goal of a linear model changes by q . d - g . r along a random motion d.

        Where the goal weighs the forces on `layers`, these are on S in the model, and beside q.
        """
        equations, bc_dofs = self.equations, self.equations.bc_dofs
        d, residuals, values = equations.vector(), [], []
        size = float(self._x.norm(PETSc.NormType.INFINITY)) or 1.0
        d.array[:] = np.random.default_rng(self.model.comm.rank).uniform(-size, size, d.getLocalSize())
        d.array[bc_dofs] = 0.0
        for share in (1.0, 0.0):  # the last evaluation of the parts is at the state, as before
            x, r = self._x.copy(), equations.vector()
            x.axpy(share, d)
            equations.residual(x, r)
            work = self.model.comm.allreduce(float(r.array_r[bc_dofs] @ x.array_r[bc_dofs]))
            here = replace(self.state, u=equations.u, reactions=equations.reactions(), prescribed_work=work)
            values.append(goal.value(here, self.model))
            residuals.append(r.array_r.copy())
            destroy(x, r)
        after, before = residuals
        on_S = equations.vector()
        on_S.array[: equations.n_displacements] = self.model.constraints.forces(self.layer_loads) * layers
        terms = np.concatenate([(q.array_r + on_S.array_r) * d.array_r, g.array_r * (before - after)])
        destroy(d, on_S)
        change, least = self.model.comm.allreduce(np.array([terms.sum(), np.abs(terms).sum()]))
        if not abs(values[0] - values[1] - change) <= GOAL_CHANGE_TOLERANCE * (least + abs(values[0]) + abs(values[1])):
            what = f"the goal {goal.name!r} changes by {values[0] - values[1]:.6g}, its weights say by {change:.6g}"
            raise InputError(f"estimate: {what}, along a random motion: `value` and `dual` are not of one goal")

    # ---------------------------------------------------------------- displacements and weights
    def displacements(self, dofs: IntArray, forces: Array) -> Array:
        """Small displacements (m,) under forces (n,) at displacements, local numbers that one rank gives; supports hold."""
        q, x = self.nodal_weights(dofs, forces), self.equations.vector()
        q.array[self.equations.bc_dofs] = 0.0
        self._solve(q, x, transposed=self.transposed)
        return np.asarray(self.equations.configuration(x).u.x.array[: self.equations.n_displacements])

    def weights(self, q: PETSc.Vec, g: PETSc.Vec) -> Configuration:
        """The weights z, as displacements and the layers' own fields; q and g are overwritten."""
        equations, bc_dofs = self.equations, self.equations.bc_dofs
        if self._same and self._are_given(q, g):
            return equations.configuration(self._x)
        z, out = equations.vector(), equations.vector()
        g.array[np.setdiff1d(np.arange(g.getLocalSize()), bc_dofs)] = 0.0
        if g.norm():
            self._times(g, out)
            q.axpy(-1.0, out)
        q.array[bc_dofs] = 0.0
        self._solve(q, z, transposed=True)
        z.array[bc_dofs] = g.array_r[bc_dofs]
        return equations.configuration(z)

    def _solve(self, q: PETSc.Vec, x: PETSc.Vec, *, transposed: bool) -> None:
        with default_options(self._options):
            if transposed and not self.model.symmetric:
                self.equations.factor.ksp.solveTranspose(q, x)
            else:
                solve_linear(self.equations.factor.ksp, q, x)

    def _are_given(self, q: PETSc.Vec, g: PETSc.Vec) -> bool:
        """Whether q are the loads, and g the displacements of supports, so that the state itself is the weights."""
        equations, bc_dofs, r = self.equations, self.equations.bc_dofs, self._r
        equations.residual(equations.vector(), r)  # the loads, from the other side
        r.array[bc_dofs] = 0.0
        size = r.norm()
        r.axpy(1.0, q)
        r.array[bc_dofs] = np.where(g.array_r == self._x.array_r, 0.0, np.inf)[bc_dofs]
        return bool(r.norm() <= LOAD_TOLERANCE * size)

    def _times(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """K^t x; by residuals if the matrix of the factor is the tangent, with its held rows replaced."""
        if self._tangent is not None:
            self._tangent.multTranspose(x, out)
            return
        at_zero = self.equations.vector()
        self.equations.residual(x, out)
        self.equations.residual(self.equations.vector(), at_zero)
        out.axpy(-1.0, at_zero)

    # ---------------------------------------------------------------- parts of the balance
    def tangent_of(self, parts: PartSum) -> PETSc.Mat:
        """Tangent of some parts in their last evaluation, after the constructor's the state; do not change it."""
        first, *others = blocks = parts.blocks()
        if first.kept and first.factor == 1.0 and not (others or parts.traits.nonlinear):
            return first.matrix  # the matrix of the bodies is the largest
        return TangentMatrix(self.model.comm, {DISPLACEMENT_KEY: self.equations.n_displacements}).fill(blocks)

    def forces(self, parts: Sequence[Part], state: Configuration, u: fem.Function, interval: TimeStep) -> Array:
        """Nodal forces (m,) of layers at displacements u, with their own fields in a state."""
        out = self.equations.u.x.petsc_vec.duplicate()
        out.set(0.0)
        if parts:
            layers = PartSum(parts)
            layers.begin_parts(interval)
            for part in layers.with_own:
                set_owned_values(part.field, part.own_start(state))
            layers.forces(u, u, out)
        return np.asarray(out.array_r.copy())

    def work(self, parts: Sequence[Part], z: Configuration) -> Array:
        """Work (m,) of the layers' stresses of the last evaluation in displacements z, spread over nodes."""
        out = self.equations.u.x.petsc_vec.duplicate()
        forces = out.duplicate()
        out.set(0.0)
        for part in parts:
            if hasattr(part, "add_work_in"):
                part.add_work_in(z.u, out)
                continue
            forces.set(0.0)
            part.add_forces(forces)
            forces.pointwiseMult(forces, z.u.x.petsc_vec)
            out.axpy(1.0, forces)
        return np.asarray(out.array_r.copy())
