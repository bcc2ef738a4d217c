"""The function `estimate`: by how much results change if an interface law replaces the mesh of a layer."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import scipy.sparse

from forms.base import InputError, is_finite, require
from geometry.inflating.layering import CellsThrough
from geometry.refusals import require_known
from geometry.seam import S
from thinlayer.discretisation.applicability import Applicability
from thinlayer.discretisation.constraints import local_csr
from thinlayer.discretisation.contact_nodes import nodes_of_sides
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import Layers, SeamLayer, ThinLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.estimating.global_local import DEFAULT_WIDTH, GlobalLocal, GoalBounds
from thinlayer.estimating.goals import Compliance, Goal
from thinlayer.estimating.result import ESTIMATED_FIELDS, FIXED_GOAL_TOLERANCE, Estimate, GoalError, LayerError
from thinlayer.estimating.surface_errors import relative_errors, squared_norms
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History
from thinlayer.solving.layer_subproblem import MESH_ADVICE, LayerSubproblem
from thinlayer.solving.part_sum import PartSum
from thinlayer.solving.petsc import Options
from thinlayer.solving.solve import solve
from thinlayer.system.progress import report
from thinlayer.system.ranks import errors_on_all
from thinlayer.time.marching import march

# relative rounding of goals, measured for rubber between steel that is 1e6 times as stiff; it widens their bounds
GOAL_ROUNDING = 3e-8


@report("estimate")
def estimate(
    state: State | History,
    layer: Layers | None = None,
    goals: Sequence[Goal] = (Compliance(),),
    *,
    seam: str = S,
    width: float = DEFAULT_WIDTH,
    cells_through: CellsThrough = 4,
    options: Options | None = None,
) -> Estimate:
    """Estimate how much results change if a layer's mesh is dropped, without meshing it between its bodies. Collective.

    The layer is meshed by itself, without the bodies. A few steps of an iteration (module `global_local`) lead from the
    state to the structure with the meshed layer; for a history they do so at each of its times. If all laws are linear,
    goals have bounds, which hold for the given cells of the bodies and of the layer. For other laws, and one step from
    rest, the potential energy has bounds instead.

    Args:
        state: a state of an interface model, or of a model with bonds, in which bodies are joined without any layer; or
            a history of such states that `march` returned, with theta = 1 (backward Euler).
        layer: the layer that bonds leave out: one layer for all of them, or {name of a seam: its layer}; None if the
            model has no bonds.
        goals: quantities of interest, whose change is estimated.
        seam: name of the seam whose layer is meshed for the estimate; all other seams keep their laws. "S": all seams.
        width: largest width of bounds, relative to the estimated change of their goal, > 0. The iteration ends when all
            bounds are at most so wide, or after five steps (40 if `width` is below its default).
        cells_through: number of cells through the thickness of the meshed layers, or {name of a seam: heights between
            which cells lie, as fractions of the thickness from 0 to 1}.
        options: {name of a PETSc option without its prefix: value}, as in `solve`.

    Returns:
        The estimated changes of tractions and jumps on S and of the goals.

    Raises:
        InputError: a state or law that cannot be estimated, with the reason.
        SolveError: a solve does not converge or has no unique solution; or the iteration does not converge to the
            structure with its meshed layers.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, estimate, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> layer = ThinLayer(glue, eps=0.05)
        >>> result = estimate(solve(plates.interface(layer)))
        >>> f"{result.traction:.2g} in traction, {result.jump:.2g} in jump"
        '0.017 in traction, 0.015 in jump'
    """
    start = time.perf_counter()
    solution = state.last if isinstance(state, History) else state
    hint = "it takes what solve or march returns; a description of a mesh file: thinlayer estimate"
    require(isinstance(solution, State), "estimate: the state", solution, hint)
    with errors_on_all(solution.model.comm):
        require(is_finite(width) and width > 0, "estimate: width", width, "allowed: > 0, over the change of a goal")
        named_goals = _checked_goals(goals)
    model = _with_layers(solution, layer)
    seams = checked_seams(model, solution.model.bonds, seam)
    with errors_on_all(model.comm):
        require_subproblem(model, state, [model.layers[name] for name in seams])
        for name in solution.model.bonds:
            model.applicability[name].require("bonded", "estimate: ")
        for goal in named_goals.values():
            goal.check(model)
    order_1_layers = {name: order_1_layer(model.applicability[name]) for name in seams}
    meshed_layers = {name: replace(thin_layer, order=0, edges=None) for name, thin_layer in order_1_layers.items()}
    subproblem = LayerSubproblem(model, meshed_layers, solution.t, cells_through)
    goal_values = {name: goal.value(solution, model) for name, goal in named_goals.items()}
    bounds: dict[str, GoalBounds] = {}
    old_state: State | None = None
    solve_errors: list[SolveError] = []
    has_bounds = model.linear and model.symmetric and isinstance(state, State)
    bound_width = width if has_bounds else None
    # their tangents are preconditioners of the iteration
    for order, candidate in enumerate(_start_models(model, order_1_layers)):
        try:
            *earlier, first_state = _states_of_path(state, candidate, order > 0, options)
            before = earlier[-1] if earlier else None
            old_state = before if solution.model.bonds or not order else old_state
            _advance_layers(earlier, first_state, subproblem, options)
            with Adjoint(first_state, before, options) as adjoint:
                iteration = GlobalLocal(adjoint, subproblem)
                iterate, adjoints = iteration.run(named_goals, goal_values, bounds, bound_width)
                energy = None if model.linear or before else iteration.energy_bounds(solution, iterate)
                (last_state, layer_state), solve_errors = iteration.states(iterate), []
                if iteration.may_end(iterate, goal_values, bounds, bound_width):
                    break
        except SolveError as error:
            if has_bounds:
                raise
            solve_errors = [error.with_traceback(None)]  # as in `Solver._try_in_turn`
    if solve_errors:
        raise solve_errors.pop()
    squares = {name: squared_norms(solution, last_state, model.layers[name], layer_state) for name in seams}
    errors = {name: LayerError(meshed_layers[name], *relative_errors(square)) for name, square in squares.items()}
    goal_errors = {}
    for name, goal in named_goals.items():
        goal_bounds = bounds.get(name) or GoalBounds(goal.value(last_state, model), math.nan, math.nan)
        goal_errors[name] = _goal_error(
            name, goal_values[name], goal.scale(first_state, model), goal_bounds, has_bounds
        )
    traction, jump = relative_errors(sum(squares.values(), np.zeros(4)))
    seconds = time.perf_counter() - start
    data = (subproblem, first_state, old_state, iterate, adjoints, named_goals, options)
    return Estimate(solution, last_state, errors, goal_errors, traction, jump, seconds, layer_state, energy, *data)


def checked_seams(model: InterfaceModel, bonds: Collection[str], seam: str) -> list[str]:
    """Return the names of the seams whose layers are meshed for the estimate, and check them.

    Args:
        model: the interface model, in which layers replace bonds.
        bonds: names of the seams that are bonded in the state passed to `estimate`.
        seam: name of the seam that the user asks for; "S": all seams.

    Raises:
        InputError: the model has no layer; the seam is unknown; or it has no bond, while other seams have.
    """
    if not model.layers:
        raise InputError("estimate: the model has no layer whose mesh could be dropped; give a model with layers")
    require_known("layer", seam, {S: None, **model.layers}, "estimate")
    if bonds and seam not in (S, *bonds):
        text = f"estimate: {seam!r} has a layer, and bonds are at {', '.join(bonds)}"
        raise InputError(f"{text}; ask of a bond, or of all, or solve it with layers alone")
    return [name for name in model.layers if seam in (S, name)]


def _goal_error(name: str, value: float, scale: float, bounds: GoalBounds, bounded: bool) -> GoalError:
    """Return the estimated error of a goal; its bounds are widened by possible rounding errors.

    Args:
        name: name of the goal.
        value: value of the goal in the state passed to `estimate`.
        scale: reference magnitude of the goal, see `Goal.scale`.
        bounds: estimate and bounds of the goal with the layer meshed.
        bounded: whether the bounds hold; if not, the result has no bounds.

    Raises:
        SolveError: the estimate is not finite, or the lower bound exceeds the upper one.
    """
    has_bounds = bounded and bounds.upper - bounds.lower < math.inf
    rounding = GOAL_ROUNDING * max(abs(value), abs(bounds.estimate)) + bounds.rounding if has_bounds else math.nan
    if not math.isfinite(bounds.estimate):
        raise SolveError(f"estimate: {name} is not finite where a law fails", advice=MESH_ADVICE)
    if bounds.lower - bounds.upper > rounding + FIXED_GOAL_TOLERANCE * scale:
        conflict = f"at least {bounds.lower:.9g}, and at most {bounds.upper:.9g}"
        raise SolveError(f"estimate: the bounds of {name} contradict each other: {conflict}", advice=MESH_ADVICE)
    return GoalError(value, bounds.estimate, scale, bounds.lower - rounding, bounds.upper + rounding)


def _start_models(model: InterfaceModel, layers: Mapping[str, ThinLayer]) -> Iterator[InterfaceModel]:
    """Yield the interface models from which the iteration is started in turn, until it converges.

    The first one is `model` itself. The second one has laws of order 1, for the layers `layers` by the names of their
    seams; it is left out if there are no such laws.
    """
    yield model
    try:
        yield model.with_interface_laws(layers)
    except InputError:  # as for laws of order 1 at junctions
        return


def _states_of_path(state: State | History, model: InterfaceModel, anew: bool, options: Options | None) -> list[State]:
    """Return the states of `model` at the times of the history passed to `estimate`, in order of time. Collective.

    The states of `state` are returned if possible. They are solved again if `anew` is set, if bodies are bonded in
    them, or if the history has not kept all of them.

    Args:
        state: the history; or a single state, for which the result has one state.
        model: the interface model.
        anew: whether the laws of `model` differ from those of `state`.
        options: {name of a PETSc option without its prefix: value}.

    Raises:
        InputError: a history with theta other than 1, or one that does not start from rest.
    """
    anew = anew or bool(state.model.bonds)
    if isinstance(state, State):
        return [solve(model, state.t, options=options) if anew else state]
    if state.theta != 1:
        raise InputError(f"estimate: the history was marched with theta = {state.theta:g}; it must be 1")
    if state.begun:
        raise InputError("estimate: the history goes on from a state, whose past is not known; march from rest")
    if anew or len(state.states) < len(state):
        times = state.t
        state = march(model, times[times > times[0]].tolist(), start=float(times[0]), options=options)
    return list(state)


def _advance_layers(earlier: Sequence[State], last: State, layers: LayerSubproblem, options: Options | None) -> None:
    """March the meshed layers through the times of earlier states, and begin their step to the last state. Collective.

    At each earlier time the structure with meshed layers is solved by `GlobalLocal.newton`, so that the layers have the
    memory of this structure.

    Args:
        earlier: states of the interface model before the last one, in order of time.
        last: the last state.
        layers: the meshed layers.
        options: {name of a PETSc option without its prefix: value}.
    """
    states, before = [*earlier, last], None
    layer_state = layers.rest_state(states[0].t)
    layers.begin(layer_state, states[0].t)
    for now, following in pairwise(states):
        if not now.at_rest:
            with Adjoint(now, before, options) as adjoint:
                iteration = GlobalLocal(adjoint, layers)
                _, layer_state = iteration.states(iteration.newton())
        before = now
        layers.begin(layer_state, following.t)


def require_subproblem(model: InterfaceModel, state: State | History, meshed_layers: Sequence[SeamLayer]) -> None:
    """Raise InputError unless the layers of a model can be meshed without its bodies. Collective.

    Neither plates nor inclined supports may constrain nodes on S. If a law or part has a memory or a rate, the state
    must be the first one after rest. Layers that are meshed are an exception if the history of the state is given.

    Args:
        model: the interface model, with layers in place of bonds.
        state: the state or history that is estimated.
        meshed_layers: the layers that are meshed for the estimate.
    """
    for name in model.layers:
        model.applicability[name].require("estimate", "estimate: ")
    remedy = f"mesh the {'layers' if len(model.layers) > 1 else 'layer'} (structure.full)"
    if _has_mpcs_on_S(model):
        raise InputError(f"estimate: plates or inclined supports tie nodes on S; {remedy}")
    if isinstance(state, State) and state.sudden:
        return
    equations = Equations(model)
    try:
        dropped_parts = [part for part in equations.layers if any(layer.owns_key(part.key) for layer in meshed_layers)]
        others = PartSum(part for part in equations.parts if part not in dropped_parts)
        steady_remedy = model.kinematics.quantities.steady_remedy
        reason = f"estimate: {{}} remembers steps beside the layers; {remedy}{steady_remedy}"
        others.refuse_traits(dict.fromkeys(("remembers", "rate"), reason))
        if isinstance(state, State):
            reason = "estimate: {} remembers, and steps in time have led to this state; give the history"
            equations.refuse_traits(dict.fromkeys(("remembers", "rate"), reason))
    finally:
        equations.destroy()


def _checked_goals(goals: Sequence[Goal]) -> dict[str, Goal]:
    goal_list = list(goals) if isinstance(goals, Sequence) else [goals]
    for goal in goal_list:
        require(isinstance(goal, Goal), "estimate: a goal", goal, "give those of thinlayer.goals")
        good, allowed = isinstance(goal.name, str) and goal.name not in ESTIMATED_FIELDS, ", ".join(ESTIMATED_FIELDS)
        require(good, "estimate: the name of a goal", goal.name, f"allowed: words other than {allowed}")
    names = [goal.name for goal in goal_list]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise InputError(f"estimate: two goals have the name {repeated[0]!r}")
    return dict(zip(names, goal_list, strict=True))


def _has_mpcs_on_S(model: InterfaceModel) -> bool:
    """Return whether plates, inclined supports or other multi-point constraints act on nodes of S. Collective.

    `model` is the interface model; all its seams with layers count.
    """
    constraints, c = model.constraints, model.n_components
    if constraints.T is None:
        return False
    T = local_csr(constraints.T)
    is_constrained = abs(T - scipy.sparse.eye(*T.shape, k=constraints.row_start)).sum(axis=1) > 0
    sides = [nodes_of_sides(model.V, model.domain.sides(name)[0])[0] for name in model.layers]
    nodes = np.concatenate([*map(np.ravel, sides)])
    dofs = (nodes[:, None] * c + np.arange(c)).ravel()
    return bool(model.comm.allreduce(int(np.asarray(is_constrained)[dofs[dofs < constraints.n]].any()), max))


def order_1_layer(applicability: Applicability) -> ThinLayer:
    """Return the layer of `applicability` with its interface law of order 1, without correction at free ends.

    A layer that has no such law is returned as it is, for example if its sublayers are anisotropic. `applicability`
    says which laws the layer may have.
    """
    try:
        return replace(applicability.layer_of_order_1(), edges="plain")
    except InputError:
        return applicability.layer.as_thin_layer


def _with_layers(state: State, layer: Layers | None) -> InterfaceModel:
    """Return the interface model of `state` with layers in place of its bonds. Collective.

    `layer` is the layer of all bonds, or {name of a bonded seam: its layer}; None if there are no bonds.

    Raises:
        InputError: the model is no interface model, or not exactly the bonded seams have a layer.
    """
    model = state.model
    if not isinstance(model, InterfaceModel):
        raise InputError(f"estimate: a {model.name} model drops no mesh; give a state of an interface model")
    layers_at_bonds = layer if isinstance(layer, Mapping) else dict.fromkeys(model.bonds, layer) if layer else {}
    bonded = ", ".join(model.bonds) or "no seam"
    if set(layers_at_bonds) != set(model.bonds) or (layer is not None and not model.bonds):
        raise InputError(f"estimate: give layer=, what was left out at bonds, for these and no others: {bonded}")
    return InterfaceModel(model.structure, {**model.on_seams, **layers_at_bonds}) if layers_at_bonds else model
