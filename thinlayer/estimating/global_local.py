"""Global-local iteration, which leads from an interface model to the structure with meshed layers.

The layers are meshed by themselves, without bodies. An iterate is a displacement u of the interface model, with which
the bodies are in equilibrium except on S. For equilibrium on S they need forces F on the layers' faces. For the same
displacements of their faces, meshed layers need the forces E u - l. Here E is the stiffness and l are the loads of the
layers, both condensed to the faces. The residual of the iterate is r = F - (E u - l), a force on the faces alone.

A step solves (K_b + E) d = r for the change d of u, with the tangent K_b of the bodies. This is done by conjugate
gradients; the tangent K_1 of the interface model is the preconditioner (Gosselet, Blanchard, Allix and Guguin 2018).

A goal Q has an adjoint solution z. The forces F_z balance the bodies under z, as F does under u. With the
pseudo-inverse E^+ of E, the goal of the structure with meshed layers is within (Prager and Synge 1947)

    Q(u) + z . r + r . E^+ r_z/2 -+ (r . E^+ r)^(1/2) (r_z . E^+ r_z)^(1/2)/2, where r_z = F_z - E z.

If the layers' laws are not linear, E is their tangent at the face displacements of the iterate, and is computed anew
for each iterate. Goals then have no bounds. Let J be the energy of the structure with meshed layers, and u_0 the state
of the interface model. If energies are convex, J(u_0) has bounds. With the least energy W(v) of the layers for face
displacements v, and its convex conjugate W*,

    gap = W(u) + W*(F) - F . u >= J(u) - min J, D - gap <= J(u_0) - min J <= D,

where D has two parts. In the bodies it is |u_0 - u|^2/2. In the layers it is the energy of u_0 above the tangent plane
at their displacements under the forces F.

E^+ r exists only if the forces r on each layer have no resultant. Laws that resist rotations of the layer, as laws of
order 0 do, leave a resultant. Additional loads on the faces, each proportional to a rigid motion of them (a "couple"),
balance it.
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
from thinlayer.solving.layer_subproblem import MESH_ADVICE, LayerSubproblem, line_search_fraction
from thinlayer.solving.part_sum import FORCE_ROUNDING, PartSum

MAX_ITERATIONS, MAX_FINE_ITERATIONS = 5, 40  # the second for bounds narrower than by default
ITERATE_TOLERANCE = 1e-10  # relative difference of two iterates that counts as rounding
RESULTANT_TOLERANCE = 1e-9  # resultant of the forces on a layer, over the sum of their sizes, that counts as rounding
COUPLE_REDUCTION = 0.01  # largest resultant that couples leave, over the resultant that counts as rounding
NEW_AXIS_SHARE = 0.1  # share of a resultant along no earlier axis above which a couple is added
MAX_NEWTON_STEPS, MAX_CG_STEPS = 20, 30  # largest numbers of Newton steps, and of conjugate steps in each
GAIN_TOLERANCE = 1e-20  # gain of a step, over the work of the forces on the layers, that counts as rounding
RESIDUAL_TOLERANCE = 1e-3  # largest final residual, over the residual of the interface law
FACE_FORCE_TOLERANCE = 1e-4  # part of the largest final residual, over the forces on the faces
NARROW_WIDTH_RATIO = 1e3  # width of bounds over their rounding below which they are narrow in any case
MIN_CG_GAIN_RATIO = 1e-3  # gain of a conjugate step over the gain of its Newton step at which conjugate steps end
ENERGY_TOLERANCE = 1e-6  # gain of a Newton step over the gain of all steps at which Newton's method ends
DEFAULT_WIDTH = 0.05  # default width of bounds over the change at which steps end


class BodyEquilibrium(NamedTuple):
    """Displacements with which bodies are in equilibrium except on S (an iterate), or the adjoint solution z of a goal.

    m is the number of displacements of this rank, n the number of unknowns of the meshed layers. Every rank has all n
    of them.

    Attributes:
        u: (m,) displacements, or z.
        face_u: (n,) displacements of the layers' faces, or z there; zero at other unknowns of the layers.
        F: (n,) forces on the faces that the bodies need for equilibrium.
        load: (n,) loads on the layers; for z, the derivative of the goal by the layers' unknowns.
        side_u: (n,) prescribed displacements of the layers' lateral sides; for z, their values in the adjoint problem.
        directions: four arrays for each conjugate-gradient step that led to the iterate. They are the changes d of u
            (m,), of face_u (n,) and of F (n,), and (K_b + E) d at the faces (n,).
        energy_gain: twice the decrease of the energy by these steps.
    """

    u: Array
    face_u: Array
    F: Array
    load: Array
    side_u: Array
    directions: tuple[tuple[Array, Array, Array, Array], ...] = ()
    energy_gain: float = 0.0

    def is_near(self, other: BodyEquilibrium) -> bool:
        """Return whether this iterate and `other` agree to rounding on the layers' faces.

        Conjugate-gradient steps from both then agree, too. The result is the same on all ranks, as every rank has the
        values on all faces.
        """
        pairs = ((self.face_u, other.face_u), (self.F, other.F), (self.load, other.load), (self.side_u, other.side_u))
        return all(np.abs(a - b).max(initial=0.0) <= ITERATE_TOLERANCE * np.abs(a).max(initial=0.0) for a, b in pairs)


class GoalBounds(NamedTuple):
    """Estimate and bounds of a goal, or of an energy, with the layer meshed.

    Attributes:
        estimate: the goal's value in an iterate, plus the work of the residual on S in the goal's adjoint solution;
            nan: not known.
        lower, upper: bounds of the goal; infinite or nan if there are none.
        rounding: possible change of the bounds by rounding of forces, which is large if bodies move far.
    """

    estimate: float = math.nan
    lower: float = -math.inf
    upper: float = math.inf
    rounding: float = 0.0

    def cut_to(self, other: GoalBounds) -> GoalBounds:
        """Return the intersection of these bounds with the bounds of `other`, from an earlier iterate.

        Earlier bounds may be much better. The estimate is moved into the intersection.
        """
        lower, upper = max(self.lower, other.lower), min(self.upper, other.upper)
        return self._replace(estimate=min(max(self.estimate, lower), upper), lower=lower, upper=upper)

    def is_narrow(self, value: float, fraction: float) -> bool:
        """Return whether the bounds are at most as wide as a fraction of the goal's change.

        The change is that from `value`, the goal with the interface laws, to the estimate; `fraction` is the fraction.
        Bounds are also narrow if their width is little more than rounding.
        """
        return self.upper - self.lower <= max(fraction * abs(self.estimate - value), NARROW_WIDTH_RATIO * self.rounding)


class GlobalLocal:
    """Global-local iteration between an interface model and its layers, which are meshed by themselves.

    The first lines of the module explain the method. Arrays (m,) are values at this rank's displacements of the
    interface model, arrays (n,) at the layers' unknowns.

    Args:
        adjoint: interface model linearised at its state u_0, which solves for responses and adjoint solutions.
        layers: the meshed layers, a subproblem for displacements or forces of their faces.

    Raises:
        InputError: a part other than the layers' laws has unknowns in addition to displacements.
    """

    def __init__(self, adjoint: Adjoint, layers: LayerSubproblem) -> None:
        self.adjoint, self.equations, self.state, self.layers = adjoint, adjoint.equations, adjoint.state, layers
        self.model, self.n = adjoint.model, adjoint.equations.n_displacements
        dropped = [self.model.layers[name] for name in layers.seams]
        self._law_parts = [part for part in self.equations.layers if any(layer.owns_key(part.key) for layer in dropped)]
        others = PartSum(part for part in self.equations.parts if part not in self._law_parts)
        if others.field_parts:
            key = others.field_parts[0].key
            raise InputError(f"estimate: {key!r} has unknowns of its own; mesh the layer (structure.full)")
        self._other_parts, self._nonlinear = others.parts, others.traits.nonlinear
        self._K_b = adjoint.tangent_of(others)
        self._work_vector = self.equations.u.x.petsc_vec.duplicate()
        self._loads = self.equations.loads.array_r - adjoint.layer_loads
        self._face_stiffnesses = layers.free_face_values(layers.K.diagonal())[:, None]
        gram = layers.R.T @ (self._face_stiffnesses * layers.R)
        self._motion_basis = layers.R @ np.linalg.inv(np.linalg.cholesky(gram)).T if gram.size else layers.R
        self._reset_couples()

    def _reset_couples(self) -> None:
        self._axes = np.empty((self._motion_basis.shape[1], 0))  # axes of the motions that have couples
        self._couples: list[tuple[Array, Array]] = []

    # ---------------------------------------------------------------- the interface model
    def _to_fem(self, u: Array) -> fem.Function:
        return set_owned_values(fem.Function(self.model.V), u)

    def _missing_forces(self, u: Array) -> Array:
        """Return the nodal forces (m,) that the interface model lacks for equilibrium at the displacements `u` (m,).

        They are the loads minus the forces of bodies, springs and all other parts except the layers' laws.
        """
        other_forces = self.adjoint.forces(self._other_parts, self.state, self._to_fem(u), self.adjoint.interval)
        return np.asarray(self._loads - other_forces)

    def _face_forces(self, forces: Array) -> Array:
        """Return the nodal forces on the layers' faces (n,), which are some of the nodal forces `forces` (m,)."""
        return self.layers.free_face_values(self.layers.to_layers(forces))

    def _resisting_forces(self, d: Array) -> Array:
        """Return the forces (m,) with which all parts except the layers' laws resist small displacements `d` (m,).

        The forces are linearised at the state from which the iteration starts.
        """
        self._work_vector.array[:] = d
        out = self._work_vector.duplicate()
        (self._K_b.multTranspose if self.adjoint.transposed else self._K_b.mult)(self._work_vector, out)
        forces = np.asarray(out.array_r.copy())
        out.destroy()
        return forces

    def _response_to(self, r: Array) -> tuple[Array, Array]:
        """Solve the linearised interface model for forces `r` (n,) on the layers' faces.

        Returns:
            The displacements (m,) under these forces; and the forces (n,) that the interface laws bear: `r` minus what
            bodies and other parts bear.
        """
        d = self.adjoint.displacements(*self.layers.to_interface(r))
        return d, r - self._face_forces(self._resisting_forces(d))

    def _with_couples(self, u: Array, F: Array, load: Array, side_u: Array) -> BodyEquilibrium:
        """Return an iterate with additional loads on the layers' faces ("couples"), which balance their resultants.

        Without couples, F and the loads on a layer may have a resultant. A couple is a load on the faces in proportion
        to a rigid motion of them. The response of the interface model to it is added, too. Only motions that laws
        resist, or that loads on the layers drive, need one.

        Args:
            u: (m,) displacements, without couples.
            F: (n,) forces of the bodies on the faces, without couples.
            load: (n,) loads on the layers.
            side_u: (n,) prescribed displacements of the layers' lateral sides.
        """
        iterate = BodyEquilibrium(u, self.layers.to_layers(u), F, load, side_u)
        for _ in range(len(self._axes) + 1):  # a couple may leave a resultant along other axes
            resultant, limit = self._resultant_and_limit(iterate)
            if resultant <= COUPLE_REDUCTION * limit:  # well below rounding, as the resultants of steps add up
                break
            along = self._motion_basis.T @ (iterate.F + load)
            self._add_couple(along)
            resultants = self._axes.T @ self._motion_basis.T @ np.column_stack([dF for _, dF in self._couples])
            for factor, (d, dF) in zip(-np.linalg.solve(resultants, self._axes.T @ along), self._couples, strict=True):
                u, F = u + factor * d, F + factor * dF
            iterate = BodyEquilibrium(u, self.layers.to_layers(u), F, load, side_u)
        return iterate

    def _add_couple(self, resultant: Array) -> None:
        """Add a couple, a load on the layers' faces that can cancel a resultant, and the response to it.

        A couple consists of the nodal forces of a rigid motion, multiplied by the diagonal of the layers' stiffness.
        The motion is that part of the resultant along which there is no couple so far. If this part is very small,
        nothing is added.

        Args:
            resultant: (k,) the resultant, as coefficients of the k orthonormal rigid motions of the layers.
        """
        new_part = resultant - self._axes @ (self._axes.T @ resultant)
        if norm(new_part) > NEW_AXIS_SHARE * norm(resultant):  # a smaller part is left to the next pass, or is rounding
            axis = new_part / norm(new_part)
            couple = self._face_stiffnesses[:, 0] * (self._motion_basis @ axis)
            d, law_forces = self._response_to(couple)
            self._couples.append((d, law_forces - couple))
            self._axes = np.column_stack([self._axes, axis])

    def _resultant_and_limit(self, iterate: BodyEquilibrium) -> tuple[float, float]:
        """Return the largest resultant of the forces on the layers in `iterate`, and a bound of its rounding error."""
        total, layers = iterate.F + iterate.load, self.layers
        rounding = FORCE_ROUNDING * float(np.abs(layers.K.diagonal()).sum() * np.abs(iterate.face_u).max())
        return np.abs(layers.R.T @ total).max(initial=0.0), RESULTANT_TOLERANCE * float(np.abs(total).sum()) + rounding

    # ---------------------------------------------------------------- iterates
    def first_iterate(self) -> BodyEquilibrium:
        """Return the first iterate, from the state of the interface model.

        Loads on the faces are added ("couples"), so that the forces on each layer have no resultant. The layers are
        linearised at the iterate's face displacements.
        """
        u = self.state.u.x.array[: self.n].copy()
        start = self._with_couples(u, self._face_forces(self._missing_forces(u)), self.layers.load, self.layers.side_u)
        self._start_forces = start.F
        return self._linearised(start)

    def weights_and_adjoint(self, goal: Goal) -> tuple[Array, BodyEquilibrium]:
        """Return the weights of a goal and its adjoint solution.

        The weights (m,) are the derivatives of `goal` by the m displacements of this rank, at the state of the
        interface model. If they act as loads, the adjoint solution is in equilibrium in the bodies, except on S.
        """
        (q, g), (layer_q, layer_g) = goal.dual(self.adjoint), goal.layer_weights(self.layers)
        if self.model.linear and goal.is_linear(self.model):
            self.adjoint.check_goal(goal.name, goal.value, q, g, on_layers=bool(layer_q.any()))
        b = q.array_r[: self.n].copy()
        z = self.adjoint.weights(q, g).u.x.array[: self.n].copy()
        with self._transposed():
            return b, self._with_couples(z, self._face_forces(b - self._resisting_forces(z)), layer_q, layer_g)

    @contextmanager
    def _transposed(self) -> Iterator[None]:
        """Return a context manager within which the transposed stiffness is used, as adjoint solutions need it.

        Couples, the loads that balance resultants on the layers, are computed anew for it. Nothing changes if the model
        is symmetric.
        """
        if self.model.symmetric:
            yield
            return
        self.adjoint.transposed = True
        self._reset_couples()
        try:
            yield
        finally:
            self.adjoint.transposed = False
            self._reset_couples()

    def layer_unknowns(self, iterate: BodyEquilibrium) -> Array:
        """Return the unknowns (n,) of the meshed layers in equilibrium with the face displacements of `iterate`."""
        return self.layers.dirichlet_displacements(iterate.face_u, iterate.load, iterate.side_u)

    def residual(self, iterate: BodyEquilibrium) -> Array:
        """Return the residual (n,) of `iterate`: the forces on the layers' faces that meshed layers do not balance.

        It is r = F - (E u - l) in the notation of the module.
        """
        return iterate.F - self.layers.dirichlet_reactions(iterate.face_u, iterate.load, iterate.side_u)

    def cg_step(self, old: BodyEquilibrium) -> BodyEquilibrium:
        """Return the iterate after one conjugate-gradient step from `old` towards the structure with meshed layers."""
        layers, r, zero = self.layers, self.residual(old), np.zeros_like(old.face_u)
        d, F = self._response_to(r)
        new = self._with_couples(d, F, zero, zero)
        d, v, F = new.u, new.face_u, new.F - r
        Kd = layers.dirichlet_reactions(v, zero, zero) - F
        for d_old, v_old, F_old, Kd_old in old.directions:
            ratio = (v_old @ Kd) / (v_old @ Kd_old)
            d, v, F, Kd = d - ratio * d_old, v - ratio * v_old, F - ratio * F_old, Kd - ratio * Kd_old
        if not (curvature := v @ Kd) > 0:  # the residual is zero
            return old
        step_length = (r @ v) / curvature
        directions, energy_gain = (*old.directions, (d, v, F, Kd)), old.energy_gain + float(step_length * (r @ v))
        u, v, F = old.u + step_length * d, old.face_u + step_length * v, old.F + step_length * F
        return old._replace(u=u, face_u=v, F=F, directions=directions, energy_gain=energy_gain)

    def _linearised(self, iterate: BodyEquilibrium) -> BodyEquilibrium:
        """Linearise the layers at the face displacements of `iterate`, and return the iterate with their loads.

        Its earlier directions are dropped, as they belong to another tangent.
        """
        self.layers.equilibrate_dirichlet(iterate.face_u)
        return iterate._replace(load=self.layers.load, directions=())

    def _equilibrate_bodies(self, start: BodyEquilibrium) -> BodyEquilibrium:
        """Return the iterate after one linear solve from `start` that brings the bodies into equilibrium except on S.

        If all parts except the layers' laws are linear, `start` itself is returned.
        """
        if not self._nonlinear:
            return start
        missing = self._missing_forces(start.u)
        missing[self.layers.to_interface(start.F)[0]] = 0.0
        d = self.adjoint.displacements(np.arange(self.n), missing)
        v, F = start.face_u + self.layers.to_layers(d), start.F - self._face_forces(self._resisting_forces(d))
        return start._replace(u=start.u + d, face_u=v, F=F, energy_gain=start.energy_gain + self._work(missing, d))

    def _work(self, forces: Array, d: Array) -> float:
        """Return the work of nodal forces `forces` (m,) in small displacements `d` (m,), summed over all ranks.

        Forces at prescribed displacements are left out, as rounding may change these displacements.
        """
        constraints = self.equations.constraints
        forces = constraints.forces_on_y(forces).copy()
        forces[constraints.bc_dofs] = 0.0
        return self._dot(forces, constraints.unknowns(d))

    def newton_step(self, iterate: BodyEquilibrium) -> BodyEquilibrium:
        """Return the iterate after a Newton step from `iterate`, for layers with non-linear laws.

        Conjugate-gradient steps with the layers' tangent give the direction of the step, a line search its length.

        Raises:
            SolveError: the conjugate-gradient steps do not converge.
        """
        cg_end = self._equilibrate_bodies(iterate)
        for _ in range(MAX_CG_STEPS):
            old_gain, cg_end = cg_end.energy_gain, self.cg_step(cg_end)
            if cg_end.energy_gain - old_gain <= MIN_CG_GAIN_RATIO * (cg_end.energy_gain - iterate.energy_gain):
                break
        else:
            text = f"estimate: the interface law is too far from its layer: {MAX_CG_STEPS} steps hardly lead to it"
            raise SolveError(text, advice=MESH_ADVICE)
        du, dv, new = cg_end.u - iterate.u, cg_end.face_u - iterate.face_u, iterate

        def decrease_rate(step_length: float) -> float:
            nonlocal new
            u, face_u = iterate.u + step_length * du, iterate.face_u + step_length * dv
            missing = self._missing_forces(u)
            new = self._linearised(cg_end._replace(u=u, face_u=face_u, F=self._face_forces(missing)))
            return self._work(missing, du) - float(self.layers.dirichlet_reactions(face_u, new.load, new.side_u) @ dv)

        if (rate_0 := cg_end.energy_gain - iterate.energy_gain) > GAIN_TOLERANCE * abs(iterate.F @ iterate.face_u):
            line_search_fraction(decrease_rate, rate_0)
        return new

    def newton(self) -> BodyEquilibrium:
        """Solve for the structure with meshed layers by Newton's method, starting from the interface model's state.

        Raises:
            SolveError: no convergence.
        """
        iterate, u = self.first_iterate(), self.state.u.x.array
        largest_displacement = self.model.comm.allreduce(float(np.abs(u).max(initial=0.0)), op=MPI.MAX)
        rounding = FORCE_ROUNDING * self.equations.scale.stiffness[0] * largest_displacement
        if norm(iterate.F) <= rounding:  # supports have moved a structure without forces on the layers
            return iterate
        limit = RESIDUAL_TOLERANCE * norm(self.residual(iterate)) + RESULTANT_TOLERANCE * norm(iterate.F)
        for _ in range(MAX_NEWTON_STEPS):
            old_gain, iterate = iterate.energy_gain, self.newton_step(iterate)
            gain, tolerance = iterate.energy_gain - old_gain, GAIN_TOLERANCE * abs(float(iterate.F @ iterate.face_u))
            if gain <= max(ENERGY_TOLERANCE * iterate.energy_gain, tolerance) and norm(self.residual(iterate)) <= limit:
                return iterate
        text = f"estimate: the structure with its layers is not found in {MAX_NEWTON_STEPS} of Newton's steps"
        raise SolveError(f"{text}, at t = {self.state.t:g}", advice=MESH_ADVICE)

    def _dot(self, a: Array, b: Array) -> float:
        """Return the scalar product of the vectors `a` and `b` (m,), summed over all ranks."""
        return float(self.model.comm.allreduce(float(a @ b)))

    def _require_balance(self, iterate: BodyEquilibrium) -> None:
        """Raise SolveError if the forces on the layers in `iterate` have a resultant that is more than rounding."""
        resultant, limit = self._resultant_and_limit(iterate)
        if resultant > 2 * limit:
            raise SolveError(f"estimate: forces on the layers have a resultant, {resultant:.2g}; allowed: {limit:.2g}")

    def energy_gap(self, iterate: BodyEquilibrium) -> float:
        """Return twice an upper bound of the energy of `iterate` above the solution's energy (Prager and Synge).

        It is r . E^+ r. Here r is the residual of the iterate, forces on the layers' faces. E^+ is the pseudo-inverse
        of the layers' stiffness E, condensed to the faces.
        """
        return self.layers.compliance(self.residual(iterate))[1]

    def energy_bounds(self, state: State, iterate: BodyEquilibrium) -> GoalBounds | None:
        """Return bounds of the energy of a state with the layers meshed, above the least energy. Collective.

        This is J(u_0) - min J in the notation of the module.

        Args:
            state: the state u_0 of the interface model.
            iterate: the last iterate.

        Returns:
            The bounds. None if bodies are not linear, tangents are not symmetric, the layers cannot bear the forces on
            their faces, or an energy is not convex.
        """
        if self._nonlinear or not self.model.symmetric:
            return None
        u = displacements_of(state, self.model).x.array[: self.n]
        layers, du = self.layers, iterate.u - u
        try:
            self._require_balance(iterate)
            w = layers.equilibrate_dirichlet(iterate.face_u)
            w_neumann = layers.equilibrate_neumann(w, iterate.F)
            gap = layers.bregman_divergence(w, w_neumann)[1]
            law_bounds = layers.bregman_divergence(layers.equilibrate_dirichlet(layers.to_layers(u)), w_neumann)
        except SolveError:
            return None
        body_energy = self._dot(du, self._resisting_forces(du)) / 2
        lower, upper = (body_energy + part for part in law_bounds)
        return GoalBounds((lower - gap + upper) / 2, max(lower - gap, 0.0), upper)

    def may_end(
        self, last: BodyEquilibrium, values: Mapping[str, float], bounds: Mapping[str, GoalBounds], width: float | None
    ) -> bool:
        """Return whether the iteration may end: all bounds are narrow, and the residual of the last iterate is small.

        The residual is compared with the changes by all steps so far, in its energy and in its forces.

        Args:
            last: the last iterate.
            values: name of a goal -> its value in the state passed to `estimate`.
            bounds: name of a goal -> its bounds.
            width: largest width of narrow bounds, relative to the change of the goal; None: there are no bounds, and
                the result is True.
        """
        if width is None:
            return True
        narrow, ratio = all(b.is_narrow(values[name], width) for name, b in bounds.items()), min(width, DEFAULT_WIDTH)
        if not narrow or self.energy_gap(last) > ratio**2 * last.energy_gain:
            return False
        # a small energy may hide large forces, as in incompressible layers
        allowed = ratio * norm(last.F - self._start_forces) + FACE_FORCE_TOLERANCE * norm(last.F)
        return bool(norm(self.residual(last)) <= allowed)

    # ---------------------------------------------------------------- goals
    def goal_bounds(self, at_rest: float, q: Array, last: BodyEquilibrium, z: BodyEquilibrium) -> GoalBounds:
        """Return the estimate and the bounds of a linear goal with the layer meshed. Collective.

        Args:
            at_rest: value of the goal at zero displacements.
            q: (m,) derivative of the goal by the displacements of this rank.
            last: the last iterate.
            z: adjoint solution of the goal; z.load is the derivative of the goal by the layers' unknowns.

        Raises:
            SolveError: forces on the layers have a resultant, in the iterate or in the adjoint solution.
        """
        r, r_z = self.residual(last), self.residual(z)
        self._require_balance(last)
        self._require_balance(z)
        (displacements, work), (_, work_z) = map(self.layers.compliance, (r, r_z))
        half_width = math.sqrt(work) * math.sqrt(work_z) / 2 if max(work, work_z) < math.inf else math.inf
        estimate = self.goal_estimate(at_rest, q, last, z)
        middle, largest_u = float(estimate + r_z @ displacements / 2), np.abs(last.face_u).max()
        rounding = float(self.equations.scale.force_rounding(largest_u)[0]) * math.sqrt(self._dot(z.u, z.u))
        return GoalBounds(estimate, middle - half_width, middle + half_width, rounding)

    def goal_estimate(self, at_rest: float, q: Array, last: BodyEquilibrium, z: BodyEquilibrium) -> float:
        """Return the estimated value of a linear goal of the structure with meshed layers. Collective.

        It is the goal's value in the last iterate, plus the work of the iterate's residual forces in the adjoint
        solution.

        Args:
            at_rest: value of the goal at zero displacements.
            q: (m,) derivative of the goal by the displacements of this rank.
            last: the last iterate.
            z: adjoint solution of the goal; z.load is the derivative of the goal by the layers' unknowns.
        """
        layers, w, w_z = self.layers, self.layer_unknowns(last), self.layer_unknowns(z)
        bulk = self._dot(q, self.equations.constraints.unknowns(last.u)) + self._dot(z.u, self._missing_forces(last.u))
        return float(at_rest + bulk + z.load @ w - w_z @ (layers.K @ w - last.load))

    def nodal_work_of_laws(self, u: fem.Function, z: BodyEquilibrium, *, bonded: bool = False) -> Array:
        """Return the work of the interface laws in an adjoint solution, for each displacement of this rank (m,).

        Each entry is the nodal force of the laws, minus the load on the layers, times the adjoint solution there.

        Args:
            u: displacements at which the laws are evaluated.
            z: adjoint solution of a goal.
            bonded: whether the bodies are bonded. There are then no laws, and the forces that the bodies need for
                equilibrium replace them.
        """
        adjoint = self.adjoint
        if bonded:
            forces = self._missing_forces(u.x.array[: self.n])
            forces[self.equations.constraints.bc_dofs] = 0.0
            return z.u * forces
        adjoint.forces(self._law_parts, self.state, u, adjoint.interval)
        return adjoint.work(self._law_parts, Configuration(self._to_fem(z.u), self.state.t)) - z.u * adjoint.layer_loads

    def states(self, last: BodyEquilibrium) -> tuple[State, State]:
        """Return a state of the interface model and a state of the meshed layers, both for the last iterate `last`."""
        w, u = self.layers.equilibrate_dirichlet(last.face_u), self._to_fem(last.u)
        # reactions and their work are those of the state before; goals have those of this one
        better = replace(self.state, u=u, reactions=None, prescribed_work=math.nan, with_meshed_layers=True)
        return better, self.layers.state(w)

    def run(
        self, goals: Mapping[str, Goal], values: Mapping[str, float], bounds: dict[str, GoalBounds], width: float | None
    ) -> tuple[BodyEquilibrium, dict[str, BodyEquilibrium]]:
        """Iterate until the bounds of all goals are narrow, or a limited number of times. Collective.

        Args:
            goals: name -> goal.
            values: name of a goal -> its value in the state passed to `estimate`.
            bounds: name of a goal -> its bounds so far; they are replaced by new bounds of the goals that are linear.
            width: largest width of narrow bounds, relative to the change of the goal. None: there are no bounds, and
                Newton's method iterates to convergence.

        Returns:
            The last iterate; and name of a goal -> its adjoint solution.
        """
        iterate = self.newton() if width is None else self.first_iterate()
        duals = {name: self.weights_and_adjoint(goal) for name, goal in goals.items()}
        # goals whose adjoint solution is the state itself, such as the compliance
        self_adjoint = [name for name, (_, z) in duals.items() if iterate.is_near(z)]
        linear_goals = {name: goal for name, goal in goals.items() if goal.is_linear(self.model)}
        values_at_rest = {name: goal.at_rest(self.state, self.model) for name, goal in linear_goals.items()}
        n_steps = MAX_ITERATIONS if width is None or width >= DEFAULT_WIDTH else MAX_FINE_ITERATIONS
        for step in range(n_steps + 1):
            for name, value_at_rest in values_at_rest.items():
                q, z = duals[name]
                if width is None:
                    bounds[name] = GoalBounds(self.goal_estimate(value_at_rest, q, iterate, z), math.nan, math.nan)
                else:
                    bounds[name] = self.goal_bounds(value_at_rest, q, iterate, z).cut_to(bounds.get(name, GoalBounds()))
            if step == n_steps or self.may_end(iterate, values, bounds, width):
                break
            iterate = self.cg_step(iterate)
            duals = {name: (q, iterate if name in self_adjoint else self.cg_step(z)) for name, (q, z) in duals.items()}
        return iterate, {name: z for name, (_, z) in duals.items()}
