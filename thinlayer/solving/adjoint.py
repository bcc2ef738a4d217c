"""The class `Adjoint`: linear responses of a model to forces, and adjoint solutions of goals, at an equilibrium."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property

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
from thinlayer.parts.bubble_part import BubblePart
from thinlayer.parts.part import DISPLACEMENT_KEY, Part, TimeStep
from thinlayer.pointwise.quadrature import assemble_forces, set_owned_values
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import mark_symmetry, needs_factor_only, solver_options
from thinlayer.solving.part_sum import PartSum, TangentMatrix
from thinlayer.solving.petsc import Options, set_defaults, solve_linear, user_value
from thinlayer.system.ranks import destroy

# relative difference of changes of a goal that counts as rounding: forces of random motions are large
GOAL_CHANGE_TOLERANCE = 1e-6
LOAD_DIFFERENCE_TOLERANCE = 1e-12  # relative difference of two loads that counts as rounding


class Adjoint(AbstractContextManager["Adjoint"]):
    """Linear responses of an interface model at an equilibrium: to nodal forces, and adjoint solutions of goals.

    Use it in a `with` statement. K is the tangent stiffness at the equilibrium, K^t its transpose.

    A goal is a number Q = q . u - g . r that depends on the nodal displacements u and on the nodal reactions r at
    constrained dofs. It is described by two vectors of weights: q has the unit of forces, and g that of displacements.
    The adjoint solution z of the goal satisfies z = g at constrained dofs, and K^t z = q at all other dofs.

    Args:
        state: the equilibrium.
        old: the configuration at the start of the time step that ended at `state`. None: the model at rest, loaded
            suddenly at the time of `state`.
        options: {name of a PETSc option without prefix: value} for the linear solver. If the model is linear, and these
            are the options with which `state` was computed, the factor of that solve is used again.

    Attributes:
        state, model, equations: the equilibrium, its model, and the balance of forces of this model.
        unknowns: vector of the unknowns at the equilibrium.
        interval: the time step from `old` to `state`.
        transposed: whether the method `displacements` solves with K^t instead of K. It is False at first.
    """

    def __init__(self, state: State, old: Configuration | None = None, options: Options | None = None) -> None:
        assert isinstance(state.model, InterfaceModel)
        self.state, self.model = state, state.model
        self.equations = equations = Equations(self.model)
        self.unknowns, self._r = equations.create_vector(), equations.create_vector()
        initial = equations.rest_state(state.t) if old is None else old
        self.interval = TimeStep(initial, state.t, state.t - initial.t, 1.0)
        equations.begin(self.interval)
        equations.put_state(state, self.unknowns)
        equations.residual(self.unknowns, self._r)
        linear_options = solver_options(self.model, equations.parts, user_value("pc_type", options or {}))
        self._options = {**linear_options[0], **(options or {})}
        self._tangent: PETSc.Mat | None = None
        self.transposed = False
        self._has_one_factor = self.model.linear and self.model.symmetric  # for all states and the transpose
        if self._has_one_factor and equations.factor.matrix_key == (0.0, 1.0):
            return
        with set_defaults(self._options):
            in_place = self._has_one_factor and needs_factor_only()
            with equations.constrained_tangent(in_place=True) if in_place else nullcontext(equations.tangent()) as A:
                if not in_place:
                    self._tangent = A.copy()
                    equations.apply_bcs(A)
                mark_symmetry(A, self.model, is_saddle=equations.traits.saddle)
                equations.factor.renew(A, None, equations.set_preconditioner_data)
                if in_place:
                    equations.factor.set_up()

    def __exit__(self, *_: object) -> None:
        self.equations.destroy()

    # ---------------------------------------------------------------- goals, as vectors of unknowns
    def zero_vector(self) -> PETSc.Vec:
        """Return a new vector of unknowns, filled with zeros."""
        return self.equations.create_vector()

    def form_weights(self, form: Expr) -> PETSc.Vec:
        """Assemble a linear form as a vector q, so that its value for displacements u is q . u.

        Args:
            form: UFL form that is linear in a test function of the model's displacements.
        """
        return self.equations.forces_on_unknowns(assemble_forces(compiled(form)))

    def nodal_weights(self, dofs: IntArray, values: Array) -> PETSc.Vec:
        """Return the vector q for which q . u is the sum of `values` times the displacements u at `dofs`.

        Args:
            dofs: (n,) local numbers of displacement dofs on this rank, ghosts included.
            values: (n,) factors of the displacements at `dofs`. Factors that several ranks give for one dof are added.
        """
        f, forces = fem.Function(self.model.V), self.equations.u.x.petsc_vec.duplicate()
        np.add.at(f.x.array, dofs, values)
        f.x.scatter_reverse(la.InsertMode.add)
        forces.array[:] = f.x.array[: self.equations.n_displacements]
        return self.equations.forces_on_unknowns(forces)

    def load_weights(self) -> PETSc.Vec:
        """Return the vector q of nodal forces of the loads, for which q . u is their work in displacements u.

        Loads on rigid plates, and loads of parts on their own unknowns, are included. Loads on the layers are not, see
        `layer_load_weights`.
        """
        parts = self.equations.field_parts
        weights = self.equations.forces_on_unknowns(self.equations.loads, [part.load for part in parts])
        weights.axpy(-1.0, self.layer_load_weights())
        return weights

    def layer_load_weights(self) -> PETSc.Vec:
        """Return the vector q of the loads on the layers, those on their own unknowns included."""
        parts, forces = self.equations.field_parts, self.equations.u.x.petsc_vec.duplicate()
        forces.array[:] = self.layer_loads
        own_loads = [part.load * isinstance(part, BubblePart) for part in parts]
        return self.equations.forces_on_unknowns(forces, own_loads)

    @cached_property
    def layer_loads(self) -> Array:
        """Nodal forces (m,) of the loads on the layers, at the m displacement dofs that this rank owns. Collective."""
        return np.asarray(self.model.forces.nodal_forces_at(self.model.V, self.state.t, layers=True).array_r.copy())

    def prescribed_displacements(self) -> PETSc.Vec:
        """Return the vector g of the prescribed displacements at constrained dofs, with zeros at all other dofs.

        With reactions r at these dofs, g . r is their work.
        """
        g = self.zero_vector()
        g.array[self.equations.bc_dofs] = self.equations.prescribed
        return g

    def support_force_weights(self, place: Place, direction: Array) -> PETSc.Vec:
        """Return the vector g for which -g . r is a component of the reaction of a support or a rigid plate.

        Here r is the residual on the unknowns, whose entries at constrained dofs are the reactions there.

        Args:
            place: name of the support's facet set, or coordinates of its point.
            direction: (d,) vector along which the component is taken, in d dimensions.
        """
        g, constraints = self.zero_vector(), self.model.constraints
        dual = constraints.resultant_weights(self.model.held_indices(place), direction)
        g.array[: self.equations.n_displacements] = -dual
        return g

    def check_goal(
        self, name: str, value: Callable[[State, InterfaceModel], float], q: PETSc.Vec, g: PETSc.Vec, *, on_layers: bool
    ) -> None:
        """Check that the weights q and g of a goal are the derivative of its value.

        The displacements u are changed by a random vector d, which changes the reactions r at constrained dofs. The
        value of the goal must then change by q . d - g . (change of r). This holds only for linear goals of linear
        models.

        Args:
            name: name of the goal, for the message of the error.
            value: function of a state and the model that returns the goal's value.
            q: weights of the displacements.
            g: weights of the reactions.
            on_layers: whether the goal also contains the work of the loads on the layers, which q leaves out.

        Raises:
            InputError: the value does not change as the weights say.
        """
        equations, bc_dofs = self.equations, self.equations.bc_dofs
        d, residuals, goal_values = equations.create_vector(), [], []
        amplitude = float(self.unknowns.norm(PETSc.NormType.INFINITY)) or 1.0
        d.array[:] = np.random.default_rng(self.model.comm.rank).uniform(-amplitude, amplitude, d.getLocalSize())
        d.array[bc_dofs] = 0.0
        for factor in (1.0, 0.0):  # the last evaluation of the parts is at the state, as before
            x, r = self.unknowns.copy(), equations.create_vector()
            x.axpy(factor, d)
            equations.residual(x, r)
            bc_work = self.model.comm.allreduce(float(r.array_r[bc_dofs] @ x.array_r[bc_dofs]))
            shifted = {"u": equations.u, "fields": equations.configuration(x).fields}
            data = {"reactions": equations.reactions(), "prescribed_work": bc_work}
            shifted_state = replace(self.state, **shifted, **data)
            goal_values.append(value(shifted_state, self.model))
            residuals.append(r.array_r.copy())
            destroy(x, r)
        after, before = residuals
        layer_weights = self.layer_load_weights()
        layer_weights.scale(float(on_layers))
        change_terms = np.concatenate([(q.array_r + layer_weights.array_r) * d.array_r, g.array_r * (before - after)])
        destroy(d, layer_weights)
        expected, abs_sum = self.model.comm.allreduce(np.array([change_terms.sum(), np.abs(change_terms).sum()]))
        actual, magnitude = goal_values[0] - goal_values[1], abs_sum + abs(goal_values[0]) + abs(goal_values[1])
        if not abs(actual - expected) <= GOAL_CHANGE_TOLERANCE * magnitude:
            text = f"the goal {name!r} changes by {actual:.6g} along a random motion, its weights say {expected:.6g}"
            raise InputError(f"estimate: {text}: `value` and `dual` differ; write `dual` as the derivative of `value`")

    # ---------------------------------------------------------------- displacements and weights
    def displacements(self, dofs: IntArray, forces: Array) -> Array:
        """Return the displacements (m,) that small nodal forces cause, at the m displacement dofs that this rank owns.

        They solve K u = forces, with the tangent stiffness K, and are zero at constrained dofs. If the attribute
        `transposed` is set, the transpose of K takes its place.

        Args:
            dofs: (n,) local numbers of displacement dofs on this rank, ghosts included.
            forces: (n,) nodal forces at `dofs`. Forces that several ranks give at the same dof are added.
        """
        q, x = self.nodal_weights(dofs, forces), self.equations.create_vector()
        q.array[self.equations.bc_dofs] = 0.0
        self._solve(q, x, transposed=self.transposed)
        return np.asarray(self.equations.configuration(x).u.x.array[: self.equations.n_displacements])

    def solve(self, r: PETSc.Vec) -> PETSc.Vec:
        """Return a new vector of unknowns x with K x = r, where `r` is zero at constrained unknowns."""
        x = self.equations.create_vector()
        self._solve(r, x, transposed=False)
        return x

    def weights(self, q: PETSc.Vec, g: PETSc.Vec) -> Configuration:
        """Return the adjoint solution z of a goal q . u - g . r, with displacements u and reactions r.

        With the transposed tangent K^t it satisfies K^t z = q, and z = g at constrained dofs.

        Args:
            q: weights of the displacements; overwritten.
            g: weights of the reactions; overwritten.

        Returns:
            Configuration with the displacements of z, and those of its fields that belong to layers, such as pressures.
        """
        equations, bc_dofs = self.equations, self.equations.bc_dofs
        if self._has_one_factor and self._equilibrium_is_adjoint(q, g):
            return equations.configuration(self.unknowns)
        z, out = equations.create_vector(), equations.create_vector()
        g.array[np.setdiff1d(np.arange(g.getLocalSize()), bc_dofs)] = 0.0
        if g.norm():
            self._transposed_product(g, out)
            q.axpy(-1.0, out)
        q.array[bc_dofs] = 0.0
        self._solve(q, z, transposed=True)
        z.array[bc_dofs] = g.array_r[bc_dofs]
        return equations.configuration(z)

    def _solve(self, q: PETSc.Vec, x: PETSc.Vec, *, transposed: bool) -> None:
        with set_defaults(self._options):
            if transposed and not self.model.symmetric:
                self.equations.factor.ksp.solveTranspose(q, x)
            else:
                solve_linear(self.equations.factor.ksp, q, x)

    def _equilibrium_is_adjoint(self, q: PETSc.Vec, g: PETSc.Vec) -> bool:
        """Whether `q` equals the nodal forces of the loads, and `g` the prescribed displacements.

        In a linear, symmetric model the equilibrium itself is then the adjoint solution.
        """
        bc_dofs, r = self.equations.bc_dofs, self._r
        self.equations.residual(self.equations.create_vector(), r)  # minus the loads
        r.array[bc_dofs] = 0.0
        load_norm = r.norm()
        r.axpy(1.0, q)
        r.array[bc_dofs] = np.where(g.array_r == self.unknowns.array_r, 0.0, np.inf)[bc_dofs]
        return bool(r.norm() <= LOAD_DIFFERENCE_TOLERANCE * load_norm)

    def _transposed_product(self, x: PETSc.Vec, out: PETSc.Vec) -> None:
        """Write the product of the transposed tangent and `x` into `out`; Dirichlet conditions are not applied.

        If no tangent was stored, it is symmetric. Its product is then the residual at `x` minus the residual at zero.
        """
        if self._tangent is not None:
            self._tangent.multTranspose(x, out)
            return
        zero_residual = self.equations.create_vector()
        self.equations.residual(x, out)
        self.equations.residual(self.equations.create_vector(), zero_residual)
        out.axpy(-1.0, zero_residual)

    # ---------------------------------------------------------------- parts of the balance
    def tangent_of(self, parts: PartSum) -> PETSc.Mat:
        """Return the tangent stiffness of a sum of parts, at the displacements of their last evaluation.

        This is the tangent at the equilibrium, unless the parts were evaluated elsewhere since. Do not change the
        matrix: it may belong to the parts.
        """
        first, *others = blocks = parts.blocks()
        if first.kept and first.factor == 1.0 and not (others or parts.traits.nonlinear):
            return first.matrix  # no copy, as the matrix of the bodies is the largest
        return TangentMatrix(self.model.comm, {DISPLACEMENT_KEY: self.equations.n_displacements}).fill(blocks)

    def forces(self, parts: Sequence[Part], state: Configuration, u: fem.Function, interval: TimeStep) -> Array:
        """Return the nodal forces (m,) that some parts exert, at the m displacement dofs that this rank owns.

        Args:
            parts: the parts.
            state: configuration from which parts take their own unknowns, such as pressures.
            u: displacements at which the forces are computed.
            interval: the time step at whose end the forces are computed.
        """
        out = fem.Function(self.model.V)
        if parts:
            part_sum = PartSum(parts)
            part_sum.begin_parts(interval)
            for part in part_sum.field_parts:
                set_owned_values(part.field, part.own_values_before(state))
            part_sum.forces(u, u, out.x.petsc_vec)
        return np.asarray(out.x.petsc_vec.array_r.copy())

    def work(self, parts: Sequence[Part], z: Configuration) -> Array:
        """Return the work (m,) of stresses in the displacements of `z`, as shares of this rank's m displacement dofs.

        The stresses are those of the last evaluation of the parts. The sum of all ranks' shares is the work.
        """
        out = fem.Function(self.model.V)
        for part in parts:
            part.add_work_in(z.u, out.x.petsc_vec)
        return np.asarray(out.x.petsc_vec.array_r.copy())
