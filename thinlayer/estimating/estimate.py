"""`estimate`: by how much the answer changes as the mesh of a layer is dropped."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from forms.base import InputError
from geometry.refusals import unknown as no_such
from geometry.seam import LAYER, S
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers, ThinLayer
from thinlayer.discretisation.reduction import Reduction
from thinlayer.discretisation.state import State
from thinlayer.estimating.better import BetterLaw, better_model, creeps, why_unknown
from thinlayer.estimating.global_local import NARROW, Bounds, GlobalLocal
from thinlayer.estimating.goal import Goal
from thinlayer.estimating.goals import Compliance, Reaction, nodes_of_sides
from thinlayer.estimating.on_surface import NEAR_ENDS, errors_of, field_of_ends, squares_of
from thinlayer.estimating.result import Estimate, GoalError, LayerError, Meshed
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.history import History
from thinlayer.solving.layer_alone import LayerAlone
from thinlayer.solving.petsc import OptionValue
from thinlayer.solving.solvers import solve
from thinlayer.system.progress import telling
from thinlayer.system.ranks import on_all
from thinlayer.time.marching import march

ROUNDING = 3e-8  # of goals, relative: found between steel and rubber 1e6 times as soft; bounds are as much wider


@telling("estimate")
def estimate(
    state: State | History,
    layer: Layers | None = None,
    goals: Sequence[Goal] = (Compliance(),),
    *,
    seam: str = S,
    options: Mapping[str, OptionValue] | None = None,
) -> Estimate:
    """By how much the answer changes if a layer's mesh is dropped, without meshing it between its bodies. Collective.

    If the bodies are linear and the layers' laws have an energy (linear ones, or plasticity in one step from rest), the
    layer is meshed by itself. A few steps lead from the given state to the structure with it (`global_local`). For linear
    laws goals have bounds that hold for these cells of the bodies and of the layer; for others the energy has.

    Otherwise, and for histories of layers that remember, the structure is solved once more on the same mesh with a better
    law of the layer, of order 1. The difference of the two answers is, as the thickness tends to zero, the error of the
    first one. Near free ends, within three thicknesses, tractions and jumps of neither law are those of the layer.

    Args:
        state: a state of an interface model, or of one with bonds ("may the layer be ignored altogether?"). If laws are
            not linear its layers are of order 0; or it is a history (marched with theta = 1, all states kept), which is
            then marched again.
        layer: what was left out at the bonds: one layer for all of them, or {name of a seam: its layer}.
        goals: numbers whose change is wanted.
        seam: name of the seam whose layer is dropped; the others stay as they are in the state. "S": all of them.
        options: PETSc options, as in `solve`.

    Raises:
        InputError: a state or law of which nothing can be estimated, with the reason.
        SolveError: as in `solve`.
    """
    start = time.perf_counter()
    given = state.last if isinstance(state, History) else state
    if not isinstance(given, State):
        raise InputError(f"estimate takes a state or a history, as solve and march return them, not {given!r:.80}")
    with on_all(given.model.comm):
        checked = _checked_goals(goals)
        if isinstance(state, State) and not state.sudden:
            _require_no_memory(state)
    model = _with_layers(given, layer)
    if not model.layers:
        raise InputError("estimate: there is no layer whose mesh could be dropped")
    if seam not in (S, *model.layers):
        raise InputError(f"estimate: {no_such('layer', seam, model.layers)}")
    chosen = [name for name in model.layers if seam in (S, name)]
    if is_alone(model, in_time=isinstance(state, History)):
        return _by_layers(given, model, chosen, checked, options, start)
    model, laws = better_model(model, seam)
    with on_all(model.comm):
        for goal in checked.values():
            goal.check(model)
    if isinstance(state, History):
        theirs, times = _one_before(state), state.t
        history = march(model, times[times > times[0]].tolist(), start=float(times[0]), options=options)
        better, before = history.last, (_one_before(history), theirs)
    else:
        like = given if not (given.model.bonds or model.linear) else None
        better, before = solve(model, given.t, options=options, like=like), (None, None)
    unknown = why_unknown(better) or next((law.lacks for law in laws.values() if math.isnan(law.off)), "")
    total, layers = np.zeros(4), {}
    for name, law in laws.items():
        squares = np.zeros(4) if unknown else squares_of(given, better, model.layers[name])
        near = NEAR_ENDS * float(law.layer.eps) if law.ends else 0.0
        layers[name] = LayerError(law, near, *errors_of(squares), field_of_ends(model, model.layers[name]))
        total += squares
    traction, jump = errors_of(total)
    largest = max([traction, *(one.ends for one in layers.values())])
    found = {}
    for name, goal in checked.items():
        scale = max(goal.scale(given, model), goal.scale(better, model))
        known = not unknown and _is_known(goal, model)
        found[name] = GoalError(goal.value(given, model), goal.value(better, model), scale, largest, known)
    return Estimate(
        given, better, layers, found, traction, jump, unknown, time.perf_counter() - start, checked, before, options
    )


def _require_no_memory(state: State) -> None:
    """Raise InputError if a state that steps in time led to cannot be found again by one solve."""
    for law in (term.law for term in state.model.terms):
        if law.traits.remembers or law.traits.rate:
            raise InputError(
                f"estimate: {type(law).__name__} remembers, and steps in time have led to this state; give the history, "
                "which is marched again"
            )


def _is_known(goal: Goal, model: InterfaceModel) -> bool:
    """Whether laws on S leave out nothing of a goal that forces on a layer's own side bring about.

    Tractions there do work inside the layer; of what supports hold there, a rigid base takes a half.
    """
    if isinstance(goal, Compliance):
        return not any(name.endswith(f"/{LAYER}") for name in model.structure.tractions or {})
    based = [known for name, known in model.reductions.items() if name in model.joint.base_seams]
    free = [len(known.rim("free").vertices) == len(known.one.sheet.rim.vertices) for known in based]
    return not isinstance(goal, Reaction) or all(free)


def _checked_goals(goals: Any) -> dict[str, Goal]:
    given = list(goals) if isinstance(goals, Sequence) else [goals]
    for goal in given:
        if not isinstance(goal, Goal):
            raise InputError(f"estimate: {goal!r:.80} is no goal; give those of thinlayer.goals")
    names = [goal.name for goal in given]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"estimate: two goals have the name {twice[0]!r}")
    return dict(zip(names, given, strict=True))


def is_alone(model: InterfaceModel, *, in_time: bool) -> bool:
    """Whether the layers of a model can be meshed by themselves between its bodies. Collective.

    The bodies' laws are linear, and none has a rate; nodes on S follow neither plates nor inclined supports. What
    remembers must have been at rest before.

    Args:
        model: the interface model.
        in_time: whether steps in time have led to its state.
    """
    laws = [term.law for term in model.terms]
    if not model.symmetric or model.contacts or any(creeps(law) or (in_time and law.traits.remembers) for law in laws):
        return False
    linear = all(term.law.traits.linear for term in model.bodies) and all(part.is_linear(model) for part in model.parts)
    if not linear:
        return False
    return not any(model.reductions[name].why_not("alone") for name in model.layers) and not _is_tied(model)


def _is_tied(model: InterfaceModel) -> bool:
    """Whether displacements on S follow others, or are turned. Collective."""
    if (T := model.constraints.T) is None:
        return False
    starts, columns, shares = T.getValuesCSR()
    own = np.diff(starts) == 1
    first, count = T.getOwnershipRange()[0], len(own)
    own[own] = (columns[starts[:-1][own]] == first + np.flatnonzero(own)) & (shares[starts[:-1][own]] == 1.0)
    nodes = np.concatenate([side for name in model.layers for side in nodes_of_sides(model, name)])
    dofs = (nodes[:, None] * model.joint.dim + np.arange(model.joint.dim)).ravel()
    return bool(model.comm.allreduce(int(not own[dofs[dofs < count]].all()), max))


def _by_layers(
    given: State,
    model: InterfaceModel,
    chosen: Sequence[str],
    goals: Mapping[str, Goal],
    options: Mapping[str, OptionValue] | None,
    start: float,
) -> Estimate:
    """The estimate from layers by themselves, with bounds. Collective."""
    with on_all(model.comm):
        for goal in goals.values():
            goal.check(model)
        for name in chosen:
            model.reductions[name].require("mesh", "estimate: ")
    better = {name: _of_order_1(model.reductions[name]) for name in chosen}
    meshed = {name: replace(one, order=0, edges=None) for name, one in better.items()}
    layers = LayerAlone(model, meshed, given.t)
    values = {name: goal.value(given, model) for name, goal in goals.items()}
    known: dict[str, Bounds] = {}
    first = solve(model, given.t, options=options) if given.model.bonds else given
    for order in range(max(one.order for one in better.values()) + 1 if model.linear else 1):
        if order == 1:
            first = solve(model.with_layer(model.on_seams | better), given.t, options=options)
        with Adjoint(first, options=options, meshed=True) as adjoint:
            iteration = GlobalLocal(adjoint, layers)
            one, weights = iteration.run(goals, values, known)
            energy = None if model.linear else iteration.energy(given, one)
            last, inside = iteration.states(one)
            if iteration.gap(one) <= NARROW**2 * one.gained and all(
                bounds.narrow(values[name], NARROW) for name, bounds in known.items()
            ):
                break
    total, errors = np.zeros(4), {}
    for name in chosen:
        squares = squares_of(given, last, model.layers[name], inside)
        by_itself = BetterLaw(meshed[name], f"{type(meshed[name].law).__name__}, meshed by itself", ends=False)
        errors[name] = LayerError(by_itself, 0.0, *errors_of(squares), ends=0.0, of_jumps=0.0)
        total += squares
    traction, jump = errors_of(total)
    found = {}
    for name, goal in goals.items():
        scale = max(goal.scale(given, model), goal.scale(last, model))
        at = known.get(name, Bounds(goal.value(last, model), math.nan, math.nan))
        at = at if model.linear else Bounds(at.told, math.nan, math.nan)
        slack = ROUNDING * max(abs(values[name]), abs(at.told))
        bounds = at.lower - slack, at.upper + slack
        found[name] = GoalError(values[name], at.told, scale, 0.0, True, *bounds)
    seconds = time.perf_counter() - start
    by_layers = Meshed(inside, layers, first, weights, energy)
    return Estimate(given, last, errors, found, traction, jump, "", seconds, goals, (None, None), options, by_layers)


def _of_order_1(reduction: Reduction) -> ThinLayer:
    """The layer with its plain law of order 1; as it is where none is known, as of sublayers that are anisotropic."""
    assert reduction.one.thin
    try:
        return replace(reduction.better(), edges="plain")
    except InputError:
        return reduction.one.thin


def _with_layers(state: State, layer: Layers | None) -> InterfaceModel:
    """The interface model with the layers whose mesh is dropped. Collective."""
    model = state.model
    if not isinstance(model, InterfaceModel):
        raise InputError(f"estimate: a {model.name} model has nothing dropped; give a state of an interface model")
    if not model.bonds:
        if layer is not None:
            raise InputError("estimate: layer= is for seams with a Bond, of which this model has none")
        return model
    if layer is None:
        raise InputError(f"estimate: bodies are bonded at {', '.join(model.bonds)}; give layer=, what was left out")
    left_out = layer if isinstance(layer, Mapping) else dict.fromkeys(model.bonds, layer)
    if set(left_out) != set(model.bonds):
        raise InputError(f"estimate: layer= has the seams {', '.join(left_out)}; bonded are {', '.join(model.bonds)}")
    return InterfaceModel(model.structure, {**model.on_seams, **left_out})


def _one_before(history: History) -> State | None:
    """The state from which the last step of a history was made; None: rest."""
    if history.theta != 1:
        raise InputError(f"estimate: the history was marched with theta = {history.theta:g}; it must be 1")
    if len(history) > 1 and len(history) - 2 not in history.states:
        raise InputError("estimate: the history lacks the state before its last step; march with keep='all'")
    return history.states[len(history) - 2] if len(history) > 1 else None
