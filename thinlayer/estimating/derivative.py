"""Derivatives of goals of an interface model by parameters of its layers, bodies, loads and supports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError, require
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers
from thinlayer.discretisation.state import Configuration, State
from thinlayer.estimating.goals import Compliance, Goal, MeanTraction
from thinlayer.estimating.parameters import (
    BEND_MESSAGE,
    BEND_TOLERANCE,
    FACTORS,
    SLOPE_ROUNDING,
    STEP,
    Change,
    Parameters,
    with_layers,
)
from thinlayer.estimating.surface_errors import work_density
from thinlayer.parts.part import TimeStep
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History
from thinlayer.solving.petsc import Options
from thinlayer.system.progress import report
from thinlayer.system.ranks import destroy
from thinlayer.system.table import Table

BALANCE_TOLERANCE = 1e-6  # largest residual of a state, over its forces: derivatives have about three times its error
FIELD_TOLERANCE = 1e-6  # difference of a field's integral from the derivative, over its size, that counts as rounding
LayerOfFactor = Callable[[float], Layers] | Sequence[str]


@dataclass(frozen=True)
class AdjointStep:
    """A time step of a march, with the adjoint solution of a goal at the end of the march.

    Attributes:
        state, interval: the state at the end of the step, and the step.
        z: adjoint solution of the step.
        later: key of a part -> derivative of the goal by the part's memory at the end of the step, through later steps.
        residual: residual (n,) of the model at the n unknowns of this rank, with reactions where supports prescribe them.
        held_weights: (n,) derivative of the goal by these unknowns through later steps.
        is_last: whether the march ends with the step, so that the goal depends on it directly.
    """

    state: State
    interval: TimeStep
    z: Configuration
    later: Mapping[str, Array]
    residual: Array
    held_weights: Array
    is_last: bool


@dataclass(frozen=True, repr=False)
class Derivative:
    """Value of a goal and its derivatives by parameters, the result of `derivative`.

    Attributes:
        goal: the goal.
        value: its value Q.
        by: name of a parameter p -> p dQ/dp, the change of the goal per relative change of the parameter.
        model: the interface model.
    """

    goal: Goal
    value: float
    by: Mapping[str, float]
    model: InterfaceModel
    _steps: Sequence[AdjointStep] = field(repr=False)
    _changes: Mapping[str, Change] = field(repr=False)

    def __repr__(self) -> str:
        return f"Derivative of {self.goal.name} by {', '.join(self.by)}"

    def __str__(self) -> str:
        ordered = sorted(self.by, key=lambda name: -abs(self.by[name]))
        changes = ", ".join(f"{self._percent(name)} ({name})" for name in ordered)
        return f"{self.goal.name} = {self.value:.4g}; with 1 % more of one parameter it changes by {changes}"

    def _percent(self, name: str) -> str:
        """Return the change of the goal for a parameter that is 1 % larger, in per cent or, of a zero goal, in units."""
        change = self.by[name]
        return f"{change / abs(self.value):+.3g} %" if self.value else f"{0.01 * change:+.3g}"

    def table(self) -> Table:
        """Return a table with a row for each parameter: its name, the derivative, and the derivative over the value."""
        relative = {name: by / abs(self.value) if self.value else math.nan for name, by in self.by.items()}
        return Table({"parameter": name, "derivative": by, "relative": relative[name]} for name, by in self.by.items())

    def field(self, name: str) -> Array:
        """Return the derivative by a parameter of layers that varies along S, as a density. Collective.

        If the parameter is multiplied by 1 + s f at the nodes of S, with small s, the goal changes by s times the
        integral of the density times f.

        Args:
            name: parameter of a layer, one of `by`.

        Returns:
            (m,) values at the m nodes of `Surface(model)`, per area; their integral is `by[name]`.

        Raises:
            InputError: no such parameter, or one that changes more than stresses of layers; a layer that remembers.
        """
        require(name in self.by, "field", name, f"give one of {', '.join(self.by)}")
        if len(self._steps) > 1:
            raise InputError("field: a layer remembers; there are fields of parameters for laws without memory")
        (step,), work = self._steps, []
        for factor in FACTORS:
            with equations_of(changed_model(self.model, self._changes[name], factor)) as equations:
                _evaluate(equations, step)
                shares = fem.Function(self.model.V)
                for part in equations.layers:
                    part.add_work_in(step.z.u, shares.x.petsc_vec)
                work.append(shares.x.petsc_vec.array_r.copy())
        slopes = (work[1] - work[0]) / (2 * STEP)
        total, size = self.model.comm.allreduce(np.array([slopes.sum(), np.abs(slopes).sum()]))
        if not abs(total - self.by[name]) <= FIELD_TOLERANCE * max(size, abs(self.by[name])):
            reason = "does not act through stresses of layers alone, but also through equations of a part, or the goal"
            raise InputError(f"field: {name!r} {reason}")
        return work_density(self.model, slopes)


@report("derivative")
def derivative(
    solution: State | History,
    goal: Goal,
    parameters: Sequence[str] | None = None,
    *,
    of: Mapping[str, LayerOfFactor] | None = None,
    options: Options | None = None,
) -> Derivative:
    """Compute the derivatives of a goal by parameters, at an equilibrium or at the end of a march. Collective.

    They are exact for the discrete model: one solve with the transposed tangent for each time step, and two residuals
    for each parameter, whose central differences have a relative error of about 1e-8, up to 1e-6 for nu. Steps of a
    march are those that it took, also if it chose them.

    Args:
        solution: a state of an interface model; or a history from rest with theta = 1 and all states, as laws with
            memory need.
        goal: the goal, one of `thinlayer.goals`. In a history it is taken at the last state.
        parameters: names of parameters, such as "S.mu", "S.eps", "LOWER.E", "load TOP", "support TOP x", "body force",
            "eigenstrain UPPER"; None: all of the model's by which there are derivatives, but moduli once, as E and nu.
        of: name -> names of parameters that change together, such as those of the same glue in two layers; or, for
            parameters without a name, a function of a factor that returns layers, as for `Structure.interface`. At the
            factor 1 it must return those of the model.
        options: {name of a PETSc option without its prefix: value} for the linear solver.

    Raises:
        InputError: no such parameter or goal; a full model; contact, or phases that switch; a state or history whose
            past is not known; a state out of balance; a kink of a law, as where loads stay constant while it yields; a
            law that fails at a changed parameter.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, derivative, goals, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> change = derivative(state, goals.Compliance(), ["S.E", "S.eps", "load TOP"])
        >>> {name: f"{slope:.3g}" for name, slope in change.by.items()}
        {'S.E': '-0.00846', 'S.eps': '0.00846', 'load TOP': '0.0323'}
    """
    model, steps_of_march = steps_of(solution)
    steps_of_march = steps_of_march if steps_of_march[-1][1] else steps_of_march[-1:]
    require(isinstance(goal, Goal), "derivative: the goal", goal, "give one of thinlayer.goals")
    goal.check(model)
    if model.stress and isinstance(goal, Compliance | MeanTraction):
        reason = "it depends on the mean strain that the mean stress causes; take sensitivity(...).of(goal)"
        raise InputError(f"derivative: no derivative of the {goal.name}: {reason}")
    changes = chosen_changes(model, parameters, of or {})
    value = goal.value(steps_of_march[-1][0], model)
    if not math.isfinite(value):
        raise InputError(f"derivative: the goal, {goal.name}, is {value} in this model")
    steps, moved, later = list[AdjointStep](), np.zeros(model.constraints.n), dict[str, Array]()
    for state, old in reversed(steps_of_march):
        with Adjoint(state, old, options) as adjoint:
            step, moved, later = _step_back(adjoint, goal if not steps else None, moved, later)
        steps.append(step)
    by = {name: _slope(model, steps, goal, change) for name, change in changes.items()}
    return Derivative(goal, value, by, model, steps, changes)


def steps_of(solution: State | History) -> tuple[InterfaceModel, list[tuple[State, State | None]]]:
    """Return the model, and the steps that led to a solution: pairs of states at their ends and starts; None: at rest.

    If no part of the model remembers earlier steps, each step begins at rest.

    Raises:
        InputError: derivatives do not exist, or the steps are not known.
    """
    require(isinstance(solution, State | History), "derivative: the solution", solution, "give a state or a history")
    model = solution.model
    if not isinstance(model, InterfaceModel):
        raise InputError("derivative: a full model; give a state of an interface model (structure.interface)")
    if model.contacts:
        raise InputError("derivative: a law of contact has kinks, where derivatives do not exist")
    model.family.is_shared = True  # changed models, which follow, need the same stiffness of the bodies
    equations = Equations(model)
    try:
        equations.refuse_traits({"switches": "derivative: phases of {} switch, where derivatives do not exist"})
        remembers = equations.traits.remembers or equations.traits.rate
        if isinstance(solution, State) and not solution.sudden:
            reason = "derivative: {} remembers, and steps in time have led to this state; give the history"
            equations.refuse_traits(dict.fromkeys(("remembers", "rate"), reason))
        if isinstance(solution, History):
            equations.refuse_traits({"inert": "derivative: {} moves masses; take a static state, or modes"})
    finally:
        equations.destroy()
    if isinstance(solution, State):
        return model, [(solution, None)]
    if not remembers:
        return model, [(state, None) for state in solution if not state.at_rest]
    if solution.theta != 1 or solution.begun or len(solution.states) < len(solution):
        raise InputError("derivative: the history must start at rest, with theta = 1 and keep='all'")
    states = list(solution)
    pairs = zip(states, [None, *states[:-1]], strict=True)
    return model, [(state, old) for state, old in pairs if not state.at_rest]


def chosen_changes(
    model: InterfaceModel, names: Sequence[str] | None, of: Mapping[str, LayerOfFactor]
) -> dict[str, Change]:
    """Return the functions that change the chosen parameters, by name; see `derivative` for the arguments."""
    available = Parameters(model)
    if names is None:
        doubled = {name[:-1] + p for name in available if name.endswith(".E") for p in ("lmbda", "mu")}
        names = [name for name in available if name not in {*available.reasons, *doubled}] if not of else []
    require(not isinstance(names, str), "derivative: parameters", names, "give a list of names")
    changes: dict[str, Change] = {name: available.change(name, "derivative") for name in names}
    return changes | {name: _change_by(of[name], available) for name in of}


def _change_by(layers: LayerOfFactor, available: Parameters) -> Change:
    if callable(layers):
        return lambda model, factor: with_layers(model, layers(factor))
    data = [available.change(name, "derivative") for name in layers]
    return lambda model, factor: reduce(lambda changed, datum: datum(changed, factor), data, model)


def _step_back(
    adjoint: Adjoint, goal: Goal | None, moved: Array, later: Mapping[str, Array]
) -> tuple[AdjointStep, Array, dict[str, Array]]:
    """Solve the adjoint equations of a time step, from what later steps pass to its end to what it passes to its start.

    Args:
        adjoint: the linearised step.
        goal: the goal, if the step is the last; else None.
        moved: (n,) derivative of the goal by the displacements at the end, through later steps, on this rank.
        later: key of a part -> derivative by its memory at the end, through later steps; {} for the last step.

    Returns:
        The step; `moved` and `later` at its start.
    """
    equations, bc_dofs = adjoint.equations, adjoint.equations.bc_dofs
    residual = equations.create_vector()
    equations.residual(adjoint.unknowns, residual)
    if not (error := equations.relative_norm(residual)) <= BALANCE_TOLERANCE:
        raise InputError(f"derivative: the state is out of balance by {error:.2g} of its forces; solve more accurately")
    traits = [(part, part.traits) for part in equations.parts]
    parts = [
        part for part, t in traits if (t.remembers or t.rate) and not t.inert
    ]  # `steps_of` refuses masses that move
    later = {part.key: later.get(part.key, np.zeros_like(part.rest())) for part in parts}
    forces = equations.u.x.petsc_vec.duplicate()
    forces.array[:] = moved
    # memory at the end of the step changes with prescribed displacements, too: `_slope` evaluates it there
    held_weights = equations.forces_on_unknowns(forces).array_r[bc_dofs].copy()
    for part in parts:
        if later[part.key].any():
            forces.axpy(1.0, part.memory_forces(later[part.key]))
    q = equations.forces_on_unknowns(forces)
    dual, g = goal.dual(adjoint) if goal else (equations.create_vector(), equations.create_vector())
    q.axpy(1.0, dual)
    if isinstance(goal, Compliance):  # whose weights leave out the loads on layers, which `estimate` takes apart
        q.axpy(1.0, adjoint.layer_load_weights())
    z = adjoint.weights(q, g)
    step = AdjointStep(
        adjoint.state, adjoint.interval, z, later, residual.array_r.copy(), held_weights, goal is not None
    )
    equations.residual(adjoint.unknowns, residual)
    forces.set(0.0)
    before = dict[str, Array]()
    for part in parts:
        old_forces, before[part.key] = part.pullback(later[part.key], step.z.u)
        forces.axpy(1.0, old_forces)
    return step, forces.array_r.copy(), before


@contextmanager
def equations_of(model: InterfaceModel) -> Iterator[Equations]:
    """Within a `with` block, return the equations of a model."""
    equations = Equations(model)
    try:
        yield equations
    finally:
        equations.destroy()


def _evaluate(equations: Equations, step: AdjointStep) -> tuple[PETSc.Vec, PETSc.Vec]:
    """Evaluate the equations of a changed model at a step of the march. Collective.

    Returns:
        The unknowns of the step, with the displacements that supports of the changed model prescribe; the residual.
    """
    equations.begin(step.interval)
    x = equations.create_vector()
    equations.put_state(step.state, x)
    return x, residual_at(equations, x)


def residual_at(equations: Equations, x: PETSc.Vec) -> PETSc.Vec:
    """Put the prescribed displacements into unknowns `x`, and return the residual there, a new vector. Collective."""
    residual = equations.create_vector()
    x.array[equations.bc_dofs] = equations.prescribed
    equations.residual(x, residual)
    return residual


def _slope(model: InterfaceModel, steps: Sequence[AdjointStep], goal: Goal, change: Change) -> float:
    """Return p dQ/dp for the goal Q and the parameter p of a model that `change` multiplies. Collective."""
    slope, residuals = 0.0, list[PETSc.Vec]()
    for factor in FACTORS:  # one after the other, as only one at a time has the matrices that models share
        with equations_of(changed_model(model, change, factor)) as equations:
            for k, step in enumerate(steps):
                value, residual = _lagrangian(equations, step, goal)
                slope += (value if factor > 1 else -value) / (2 * STEP)
                residuals.append(residual)
                if len(residuals) > len(steps):
                    difference, bend = residuals[k] - residual, residuals[k] + residual
                    bend.array[:] -= 2 * step.residual
                    sizes = [equations.relative_norm(vector) for vector in (bend, difference)]
                    if sizes[0] > BEND_TOLERANCE * max(sizes[1], SLOPE_ROUNDING):
                        raise InputError(BEND_MESSAGE.format(step.interval.t))
    if not math.isfinite(slope):
        raise InputError("derivative: a law fails at a changed parameter")
    return float(slope)


def changed_model(model: InterfaceModel, change: Change, factor: float) -> InterfaceModel:
    """Return the model in which a parameter is multiplied by a factor near 1. Collective.

    Raises:
        InputError: the correction of free ends sets in at this value of the parameter.
    """
    changed = change(model, factor)
    if changed.remarks != model.remarks:
        text = "the correction of free ends sets in at this value of a parameter"
        raise InputError(f"derivative: {text}; give layers edges='plain'")
    return changed


def _lagrangian(equations: Equations, step: AdjointStep, goal: Goal) -> tuple[float, PETSc.Vec]:
    """Return what a step adds to the Lagrangian function, and the residual.

    The function is the goal, minus the work of residuals in adjoint solutions. Its derivative by a parameter, at the
    displacements and adjoint solutions of the march, is that of the goal.
    """
    x, residual = _evaluate(equations, step)
    z = equations.create_vector()
    equations.put_state(step.z, z)
    held_x = x.array_r[equations.bc_dofs]
    sums = [step.held_weights @ held_x, step.residual[equations.bc_dofs] @ held_x]
    sums[0] += sum(
        float(np.vdot(step.later[part.key], np.asarray(part.commit().memory)))
        for part in equations.parts
        if part.key in step.later
    )
    added, held_work = equations.comm.allreduce(np.array(sums))
    value = float(added - z.dot(residual))
    if step.is_last:
        model, end = equations.model, equations.configuration(x)
        assert isinstance(model, InterfaceModel)
        state = replace(step.state, u=end.u, model=model, fields=end.fields, prescribed_work=float(held_work))
        value += goal.value(state, model)
    destroy(x, z)
    return value, residual
