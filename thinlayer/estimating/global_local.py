"""Global-local iteration from an interface model, and a subproblem of its layers, to the structure with meshed layers.

An iterate is a displacement u whose bodies are in equilibrium except on S: forces F on the layers' faces balance them.
Meshed layers need the forces E u - l there, with their stiffness E and loads l, both condensed to the faces. The
residual is r = F - (E u - l), on the faces alone. With the tangent K_b of the bodies, steps solve (K_b + E) d = r by
conjugate gradients; the interface model's tangent K_1 is the preconditioner (Gosselet, Blanchard, Allix and Guguin
2018). By the theorem of Prager and Synge (1947) a goal Q with weights z is bounded, with the layer meshed, by

    Q in Q(u) + z . r + r . E^+ r_z/2 -+ (r . E^+ r)^(1/2) (r_z . E^+ r_z)^(1/2)/2, r_z = F_z - E z.

E^+ is the pseudo-inverse of E. The forces F_z balance the bodies under the weights z, as F does under u.

If the layers' laws are not linear, E is their tangent at the face displacements of the iterate, and follows the
iterate. Goals then have no bounds. If energies are convex, the energy J(u_0) of the state u_0, with the layer in place
of its law, has bounds. With W(v) the least energy of the layers for face displacements v, and W* its convex conjugate,

    gap = W(u) + W*(F) - F . u >= J(u) - min J, D - gap <= J(u_0) - min J <= D,

where D has two parts. In the bodies it is |u_0 - u|^2/2. In the layers it is the energy of u_0 above the tangent plane
at the displacements under F.

E^+ needs forces without resultants. Laws that resist rotations of the layer, as laws of order 0 do, leave resultants.
Loads on the faces that are proportional to rigid motions there ("couples") balance them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.linalg import norm

from forms.base import Array, InputError
from thinlayer.discretisation.state import Configuration, State, displacements_of
from thinlayer.errors import SolveError
from thinlayer.estimating.goals import Goal
from thinlayer.pointwise.quadrature import set_owned_values
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_subproblem import MESH_REMEDY, LayerSubproblem, line_search_share
from thinlayer.solving.part_sum import ROUNDING_SHARE, PartSum

MAX_STEPS = 5
ITERATE_TOLERANCE = 1e-10  # relative difference of two iterates that counts as rounding
RESULTANT_TOLERANCE = 1e-9  # resultant of the forces on a layer, over the sum of their sizes, that counts as rounding
COUPLE_REDUCTION = 0.01  # largest resultant that couples leave, over the resultant that counts as rounding
NEW_AXIS_SHARE = 0.1  # share of a resultant along no earlier axis above which a couple is added
MAX_NEWTON_STEPS, MAX_CG_STEPS = 20, 30  # largest numbers of Newton steps, and of conjugate steps in each
GAIN_TOLERANCE = 1e-20  # gain of a step, over the work of the forces on the layers, that counts as rounding
RELATIVE_RESIDUAL = 1e-3  # largest final residual, over the residual of the interface law
MISSING_FORCE_SHARE = 1e-4  # part of the largest final residual, over the forces on the faces
MAX_WIDTH_RATIO = 1e3  # width of bounds over their rounding below which they are narrow in any case
MIN_CG_GAIN = 1e-3  # gain of a conjugate step over the gain of its Newton step at which conjugate steps end
ENERGY_TOLERANCE = 1e-6  # gain of a Newton step over the gain of all steps at which Newton's method ends
DEFAULT_WIDTH = 0.05  # default width of bounds over the change at which steps end


class BodyEquilibrium(NamedTuple):
    """Iterate whose bodies are in equilibrium except on S: displacements, or the weights z of a goal.

    m is the number of displacements of this rank, n that of the unknowns of the layers.

    Attributes:
        u: (m,) displacements.
        v: (n,) displacements of the layers' faces.
        F: (n,) forces of the bodies on the faces.
        load: (n,) forces on the layers; for weights, the goal's weights there.
        values: (n,) prescribed displacements of the layers' sides; for weights, the goal's motions there.
        directions: directions of the steps that led to it: d (m,), v (n,), F (n,) of each, and (K_b + E) d at the faces
            (n,).
        gained: decrease of twice the energy by these steps.
    """

    u: Array
    v: Array
    F: Array
    load: Array
    values: Array
    directions: tuple[tuple[Array, Array, Array, Array], ...] = ()
    gained: float = 0.0

    def is_near(self, other: BodyEquilibrium) -> bool:
        """Whether two iterates agree to rounding on the faces; then their steps agree too. Every rank has all faces."""
        pairs = ((self.v, other.v), (self.F, other.F), (self.load, other.load), (self.values, other.values))
        return all(np.abs(a - b).max(initial=0.0) <= ITERATE_TOLERANCE * np.abs(a).max(initial=0.0) for a, b in pairs)


class GoalBounds(NamedTuple):
    """Estimate and bounds of a goal with the layer meshed.

    Attributes:
        estimate: estimated value of the goal: its value in an iterate, corrected by the residual on S times the
            weights.
        lower, upper: bounds of the goal.
        rounding: change of the bounds by rounding of forces, which is large if bodies move far.
    """

    estimate: float = math.nan
    lower: float = -math.inf
    upper: float = math.inf
    rounding: float = 0.0

    def within(self, other: GoalBounds) -> GoalBounds:
        """Intersection with earlier bounds, into which the estimate is moved, as earlier bounds may be much better."""
        lower, upper = max(self.lower, other.lower), min(self.upper, other.upper)
        return self._replace(estimate=min(max(self.estimate, lower), upper), lower=lower, upper=upper)

    def is_narrow(self, value: float, share: float) -> bool:
        """Whether the width is at most a fraction `share` of the change from `value`, or little more than rounding."""
        return self.upper - self.lower <= max(share * abs(self.estimate - value), MAX_WIDTH_RATIO * self.rounding)


class GlobalLocal:
    """Global-local iteration between an interface model and a subproblem of its layers.

    Arrays (m,) are values at this rank's displacements of the interface model, arrays (n,) at the layers' unknowns.

    Args:
        adjoint: linear responses and adjoint solutions of the interface model at a state.
        layers: the subproblem of the meshed layers.
    """

    def __init__(self, adjoint: Adjoint, layers: LayerSubproblem) -> None:
        self.adjoint, self.equations, self.state, self.layers = adjoint, adjoint.equations, adjoint.state, layers
        self.model, self.n = adjoint.model, adjoint.equations.n_displacements
        dropped = [self.model.layers[name] for name in layers.seams]
        self._law_parts = [part for part in self.equations.layers if any(layer.owns_key(part.key) for layer in dropped)]
        others = PartSum(part for part in self.equations.parts if part not in self._law_parts)
        if others.with_own:
            key = others.with_own[0].key
            raise InputError(f"estimate: {key!r} has unknowns of its own; mesh the layer (structure.full)")
        self._other_parts, self._nonlinear = others.parts, others.traits.nonlinear
        self._K_b = adjoint.tangent_of(others)
        self._x = self.equations.u.x.petsc_vec.duplicate()
        self._loads = self.equations.loads.array_r - adjoint.layer_loads
        self._shares = layers.free_face_values(layers.K.diagonal())[:, None]
        gram = layers.R.T @ (self._shares * layers.R)
        self._R = layers.R @ np.linalg.inv(np.linalg.cholesky(gram)).T if gram.size else layers.R
        self._reset()

    def _reset(self) -> None:
        self._axes = np.empty((self._R.shape[1], 0))  # axes of the motions that have couples
        self._couples: list[tuple[Array, Array]] = []

    # ---------------------------------------------------------------- the interface model
    def _field(self, u: Array) -> fem.Function:
        return set_owned_values(fem.Function(self.model.V), u)

    def _missing_forces(self, u: Array) -> Array:
        """Nodal loads minus forces of all parts except the layers' laws, at displacements u; both (m,) on this rank."""
        others = self.adjoint.forces(self._other_parts, self.state, self._field(u), self.adjoint.interval)
        return np.asarray(self._loads - others)

    def _face_forces(self, forces: Array) -> Array:
        """Forces (n,) on the layers' faces, from nodal forces (m,) of the interface model."""
        return self.layers.free_face_values(self.layers.at_faces(forces))

    def _resistance(self, d: Array) -> Array:
        """Linearised forces of all parts except the layers' laws, at small displacements d; both (m,) on this rank."""
        self._x.array[:] = d
        out = self._x.duplicate()
        (self._K_b.multTranspose if self.adjoint.transposed else self._K_b.mult)(self._x, out)
        forces = np.asarray(out.array_r.copy())
        out.destroy()
        return forces

    def _displacements_under(self, r: Array) -> tuple[Array, Array]:
        """Displacements (m,) of the interface model under face forces r (n,), and forces (n,) on its layers."""
        d = self.adjoint.displacements(*self.layers.face_values(r))
        return d, r - self._face_forces(self._resistance(d))

    def _with_couples(self, u: Array, F: Array, load: Array, values: Array) -> BodyEquilibrium:
        """Iterate with added couples, so that the forces on the layers, F and their loads, have no resultants.

        A couple is a load on the faces in proportion to a rigid motion, and its response by a solve with K_1. Only
        motions that laws resist, or that loads on the layers drive, need one.

        Args:
            u: (m,) displacements, without couples.
            F: (n,) forces of the bodies on the faces, without couples.
            load: (n,) forces on the layers.
            values: (n,) prescribed displacements of the layers' sides.
        """
        iterate = BodyEquilibrium(u, self.layers.at_faces(u), F, load, values)
        for _ in range(len(self._axes) + 1):  # a couple may leave a resultant along other axes
            left, least = self._resultant(iterate)
            if left <= COUPLE_REDUCTION * least:  # well below rounding, as the resultants of steps add up
                break
            along = self._R.T @ (iterate.F + load)
            self._add_couple(along)
            resultants = self._axes.T @ self._R.T @ np.column_stack([dF for _, dF in self._couples])
            for share, (d, dF) in zip(-np.linalg.solve(resultants, self._axes.T @ along), self._couples, strict=True):
                u, F = u + share * d, F + share * dF
            iterate = BodyEquilibrium(u, self.layers.at_faces(u), F, load, values)
        return iterate

    def _add_couple(self, along: Array) -> None:
        """Add nodal forces on the layers' faces that can cancel a resultant, and the bodies' response to them.

        They are called a couple, and are a rigid motion times the diagonal of the layers' stiffness. The motion is the
        part of the resultant along rigid motions without a couple so far. If this part is very small, nothing is added.

        Args:
            along: the resultant, as coefficients of the orthonormal rigid motions of the layers.
        """
        new_part = along - self._axes @ (self._axes.T @ along)
        if norm(new_part) > NEW_AXIS_SHARE * norm(along):  # a smaller part is left to the next pass, or is rounding
            axis = new_part / norm(new_part)
            couple = self._shares[:, 0] * (self._R @ axis)
            d, pulled = self._displacements_under(couple)
            self._couples.append((d, pulled - couple))
            self._axes = np.column_stack([self._axes, axis])

    def _resultant(self, iterate: BodyEquilibrium) -> tuple[float, float]:
        """Largest resultant of the forces on the layers in an iterate, and the resultant that counts as rounding."""
        total, layers = iterate.F + iterate.load, self.layers
        rounding = ROUNDING_SHARE * float(np.abs(layers.K.diagonal()).sum() * np.abs(iterate.v).max())
        return np.abs(layers.R.T @ total).max(initial=0.0), RESULTANT_TOLERANCE * float(np.abs(total).sum()) + rounding

    # ---------------------------------------------------------------- iterates
    def first_iterate(self) -> BodyEquilibrium:
        """First iterate: the displacements of the state, with couples; the layers are linearised there."""
        u = self.state.u.x.array[: self.n].copy()
        start = self._with_couples(u, self._face_forces(self._missing_forces(u)), self.layers.load, self.layers.values)
        self._start_forces = start.F
        return self._linearised(start)

    def weights(self, goal: Goal) -> tuple[Array, BodyEquilibrium]:
        """Nodal weights q (m,) of a goal at this rank's displacements, and its adjoint solution z, an iterate."""
        q, g = goal.dual(self.adjoint)
        if self.model.linear and goal.is_linear(self.model):
            self.adjoint.require_dual(goal.name, goal.value, q, g, layers=bool(goal.in_layers(self.layers)[0].any()))
        b = q.array_r[: self.n].copy()
        z = self.adjoint.weights(q, g).u.x.array[: self.n].copy()
        with self._transposed():
            return b, self._with_couples(z, self._face_forces(b - self._resistance(z)), *goal.in_layers(self.layers))

    @contextmanager
    def _transposed(self) -> Iterator[None]:
        """Within a `with` block, use the transposed stiffness, with couples of its own, for adjoint solutions."""
        if self.model.symmetric:
            yield
            return
        self.adjoint.transposed = True
        self._reset()
        try:
            yield
        finally:
            self.adjoint.transposed = False
            self._reset()

    def layer_unknowns(self, iterate: BodyEquilibrium) -> Array:
        """Unknowns (n,) of the layers in equilibrium with the face displacements of an iterate."""
        return self.layers.dirichlet_displacements(iterate.v, iterate.load, iterate.values)

    def residual(self, iterate: BodyEquilibrium) -> Array:
        """Residual r = F - (E u - l) (n,) of an iterate: forces on the faces that meshed layers do not balance."""
        return iterate.F - self.layers.dirichlet_reactions(iterate.v, iterate.load, iterate.values)

    def step(self, old: BodyEquilibrium) -> BodyEquilibrium:
        """Next iterate, after one conjugate-gradient step from `old` towards the structure with meshed layers."""
        layers, r, zero = self.layers, self.residual(old), np.zeros_like(old.v)
        d, F = self._displacements_under(r)
        new = self._with_couples(d, F, zero, zero)
        d, v, F = new.u, new.v, new.F - r
        Kd = layers.dirichlet_reactions(v, zero, zero) - F
        for d_old, v_old, F_old, Kd_old in old.directions:
            share = (v_old @ Kd) / (v_old @ Kd_old)
            d, v, F, Kd = d - share * d_old, v - share * v_old, F - share * F_old, Kd - share * Kd_old
        if not (size := v @ Kd) > 0:  # the residual is zero
            return old
        length = (r @ v) / size
        directions, gained = (*old.directions, (d, v, F, Kd)), old.gained + float(length * (r @ v))
        u, v, F = old.u + length * d, old.v + length * v, old.F + length * F
        return old._replace(u=u, v=v, F=F, directions=directions, gained=gained)

    def _linearised(self, iterate: BodyEquilibrium) -> BodyEquilibrium:
        """The iterate, with the layers' tangent and loads linearised at its face displacements."""
        self.layers.equilibrate_dirichlet(iterate.v)
        return iterate._replace(load=self.layers.load, directions=())

    def _equilibrate_bodies(self, iterate: BodyEquilibrium) -> BodyEquilibrium:
        """The iterate with its bodies in equilibrium except on S, to first order; unchanged for linear bodies."""
        if not self._nonlinear:
            return iterate
        missing = self._missing_forces(iterate.u)
        missing[self.layers.face_values(iterate.F)[0]] = 0.0
        d = self.adjoint.displacements(np.arange(self.n), missing)
        v, F = iterate.v + self.layers.at_faces(d), iterate.F - self._face_forces(self._resistance(d))
        return iterate._replace(u=iterate.u + d, v=v, F=F, gained=iterate.gained + self._work(missing, d))

    def _work(self, forces: Array, d: Array) -> float:
        """Work of nodal forces (m,) in small displacements d (m,), without forces at constrained displacements.

        Rounding may move constrained displacements.
        """
        constraints = self.equations.constraints
        forces = constraints.forces(forces).copy()
        forces[constraints.bc_dofs] = 0.0
        return self._dot(forces, constraints.unknowns(d))

    def newton_step(self, iterate: BodyEquilibrium) -> BodyEquilibrium:
        """Next iterate by a Newton step, for layers with non-linear laws.

        Conjugate-gradient steps with the layers' tangent give its direction, and a line search its length.
        """
        target = self._equilibrate_bodies(iterate)
        for _ in range(MAX_CG_STEPS):
            before, target = target.gained, self.step(target)
            if target.gained - before <= MIN_CG_GAIN * (target.gained - iterate.gained):
                break
        else:
            text = f"estimate: the interface law is too far from its layer: {MAX_CG_STEPS} steps hardly lead to it"
            raise SolveError(text, advice=MESH_REMEDY)
        du, dv, new = target.u - iterate.u, target.v - iterate.v, iterate

        def decrease(share: float) -> float:
            nonlocal new
            u = iterate.u + share * du
            missing = self._missing_forces(u)
            new = self._linearised(target._replace(u=u, v=iterate.v + share * dv, F=self._face_forces(missing)))
            return self._work(missing, du) - float(self.layers.dirichlet_reactions(new.v, new.load, new.values) @ dv)

        if (start := target.gained - iterate.gained) > GAIN_TOLERANCE * abs(iterate.F @ iterate.v):
            line_search_share(decrease, start)
        return new

    def newton(self) -> BodyEquilibrium:
        """Solve for the structure with meshed layers by Newton's method, starting from the state.

        Raises:
            SolveError: no convergence.
        """
        iterate, u = self.first_iterate(), self.state.u.x.array
        moved = self.model.comm.allreduce(float(np.abs(u).max(initial=0.0)), op=MPI.MAX)
        rounding = ROUNDING_SHARE * self.equations.scale.stiffness[0] * moved
        if norm(iterate.F) <= rounding:  # supports have moved a structure without forces on the layers
            return iterate
        least = RELATIVE_RESIDUAL * norm(self.residual(iterate)) + RESULTANT_TOLERANCE * norm(iterate.F)
        for _ in range(MAX_NEWTON_STEPS):
            old, iterate = iterate, self.newton_step(iterate)
            gained, tolerance = iterate.gained - old.gained, GAIN_TOLERANCE * abs(float(iterate.F @ iterate.v))
            if gained <= max(ENERGY_TOLERANCE * iterate.gained, tolerance) and norm(self.residual(iterate)) <= least:
                return iterate
        text = f"estimate: the structure with its layers is not found in {MAX_NEWTON_STEPS} of Newton's steps"
        raise SolveError(f"{text}, at t = {self.state.t:g}", advice=MESH_REMEDY)

    def _dot(self, a: Array, b: Array) -> float:
        """Scalar product of vectors a and b (m,), over all ranks."""
        return float(self.model.comm.allreduce(float(a @ b)))

    def _require_balance(self, iterate: BodyEquilibrium) -> None:
        """Raise SolveError if the forces on the layers of an iterate have a resultant that is more than rounding."""
        left, least = self._resultant(iterate)
        if left > 2 * least:
            raise SolveError(f"estimate: forces on the layers have a resultant, {left:.2g}; allowed: {least:.2g}")

    def energy_gap(self, iterate: BodyEquilibrium) -> float:
        """Upper bound r . E^+ r of twice the energy of the iterate above that of the solution (Prager and Synge)."""
        return self.layers.compliance(self.residual(iterate))[1]

    def energy(self, state: State, iterate: BodyEquilibrium) -> GoalBounds | None:
        """Bounds of the energy J of a state, with the layers meshed, above its minimum. Collective.

        None if bodies are not linear, tangents are not symmetric, the layers cannot bear the forces on their faces, or
        an energy is not convex.

        Args:
            state: the state u_0.
            iterate: the last iterate.
        """
        if self._nonlinear or not self.model.symmetric:
            return None
        u = displacements_of(state, self.model).x.array[: self.n]
        layers, du = self.layers, iterate.u - u
        try:
            self._require_balance(iterate)
            w = layers.equilibrate_dirichlet(iterate.v)
            w_neumann = layers.equilibrate_neumann(w, iterate.F)
            gap = layers.bregman_divergence(w, w_neumann)[1]
            law_bounds = layers.bregman_divergence(layers.equilibrate_dirichlet(layers.at_faces(u)), w_neumann)
        except SolveError:
            return None
        body_energy = self._dot(du, self._resistance(du)) / 2
        lower, upper = (body_energy + part for part in law_bounds)
        return GoalBounds((lower - gap + upper) / 2, max(lower - gap, 0.0), upper)

    def is_near(
        self, last: BodyEquilibrium, values: Mapping[str, float], bounds: Mapping[str, GoalBounds], width: float | None
    ) -> bool:
        """Whether bounds are narrow, and the residual is small relative to the steps, in its energy and its forces.

        Args:
            last: the last iterate.
            values: values of the goals from which changes count, by name.
            bounds: bounds of the goals, by name.
            width: largest width of narrow bounds, relative to the change; None: there are no bounds, and True is
                returned.
        """
        if width is None:
            return True
        narrow, share = all(b.is_narrow(values[name], width) for name, b in bounds.items()), min(width, DEFAULT_WIDTH)
        if not narrow or self.energy_gap(last) > share**2 * last.gained:
            return False
        # a small energy may hide large forces, as in incompressible layers
        allowed = share * norm(last.F - self._start_forces) + MISSING_FORCE_SHARE * norm(last.F)
        return bool(norm(self.residual(last)) <= allowed)

    # ---------------------------------------------------------------- goals
    def bounds(self, at_rest: float, q: Array, last: BodyEquilibrium, z: BodyEquilibrium) -> GoalBounds:
        """Estimate and bounds of a linear goal with the layer meshed. Collective.

        Args:
            at_rest: value of the goal at zero displacements.
            q: (m,) its nodal weights at the displacements of this rank.
            last: the last iterate.
            z: the goal's adjoint solution; its weights in the layers are z.load.

        Raises:
            SolveError: forces on the layers are not in equilibrium.
        """
        r, r_z = self.residual(last), self.residual(z)
        self._require_balance(last)
        self._require_balance(z)
        (moved, work), (_, work_z) = map(self.layers.compliance, (r, r_z))
        half_width = math.sqrt(work) * math.sqrt(work_z) / 2 if max(work, work_z) < math.inf else math.inf
        estimate = self.goal_estimate(at_rest, q, last, z)
        middle = float(estimate + r_z @ moved / 2)
        rounding = float(self.equations.scale.rounding(np.abs(last.v).max())[0]) * math.sqrt(self._dot(z.u, z.u))
        return GoalBounds(estimate, middle - half_width, middle + half_width, rounding)

    def goal_estimate(self, at_rest: float, q: Array, last: BodyEquilibrium, z: BodyEquilibrium) -> float:
        """Estimate a linear goal of the structure with meshed layers from an iterate. Collective.

        The estimate is the goal's value in the iterate, plus the work of the iterate's residual forces in the adjoint
        solution.

        Args:
            at_rest: value of the goal at zero displacements.
            q: (m,) derivative of the goal by the displacements of this rank.
            last: the last iterate.
            z: the goal's adjoint solution; z.load is the derivative of the goal by the layers' unknowns.
        """
        layers, w, w_z = self.layers, self.layer_unknowns(last), self.layer_unknowns(z)
        bulk = self._dot(q, self.equations.constraints.unknowns(last.u)) + self._dot(z.u, self._missing_forces(last.u))
        return float(at_rest + bulk + z.load @ w - w_z @ (layers.K @ w - last.load))

    def work_of_laws(self, u: fem.Function, z: BodyEquilibrium, *, bonded: bool = False) -> Array:
        """Work (m,) of the interface laws in the weights z, minus the work of loads on them, for each displacement.

        Bonded bodies have no laws: the forces that the bodies need replace them.

        Args:
            u: displacements at which the laws are evaluated.
            z: adjoint solution of a goal.
            bonded: whether the bodies are bonded.
        """
        adjoint = self.adjoint
        if bonded:
            forces = self._missing_forces(u.x.array[: self.n])
            forces[self.equations.constraints.bc_dofs] = 0.0
            return z.u * forces
        adjoint.forces(self._law_parts, self.state, u, adjoint.interval)
        return adjoint.work(self._law_parts, Configuration(self._field(z.u), self.state.t)) - z.u * adjoint.layer_loads

    def states(self, last: BodyEquilibrium) -> tuple[State, State]:
        """State of the interface model, and state of the meshed layers, at the last iterate."""
        return replace(self.state, u=self._field(last.u)), self.layers.state(self.layers.equilibrate_dirichlet(last.v))

    def run(
        self, goals: Mapping[str, Goal], values: Mapping[str, float], bounds: dict[str, GoalBounds], width: float | None
    ) -> tuple[BodyEquilibrium, dict[str, BodyEquilibrium]]:
        """Iterate until bounds are narrow, or `MAX_STEPS` times; return the iterate and the goals' weights. Collective.

        Args:
            goals: goals by their names.
            values: values of the goals from which changes count, by name.
            bounds: earlier bounds of goals that are linear, by name; the new bounds replace them.
            width: largest width of narrow bounds, relative to the change of the goal. None: there are no bounds, and
                Newton's method iterates to convergence.
        """
        iterate = self.newton() if width is None else self.first_iterate()
        weights = {name: self.weights(goal) for name, goal in goals.items()}
        # goals whose adjoint solution is the state itself, such as the compliance
        same_names = [name for name, (_, z) in weights.items() if iterate.is_near(z)]
        linear = {name: goal for name, goal in goals.items() if goal.is_linear(self.model)}
        at_rest = {name: goal.at_rest(self.state, self.model) for name, goal in linear.items()}
        for step in range(MAX_STEPS + 1):
            for name, rest in at_rest.items():
                q, z = weights[name]
                if width is None:
                    bounds[name] = GoalBounds(self.goal_estimate(rest, q, iterate, z), math.nan, math.nan)
                else:
                    bounds[name] = self.bounds(rest, q, iterate, z).within(bounds.get(name, GoalBounds()))
            if step == MAX_STEPS or self.is_near(iterate, values, bounds, width):
                break
            iterate = self.step(iterate)
            weights = {name: (q, iterate if name in same_names else self.step(z)) for name, (q, z) in weights.items()}
        return iterate, {name: z for name, (_, z) in weights.items()}
