"""Tests whether results of a scalar field are in the range of a layer's interface law; a RangeWarning says if not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from forms.base import is_number
from forms.law_tangents import tangent_at_rest
from forms.tensors import VALUE_INDEX, mandel_vector
from geometry.refusals import place_text
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.layer import SeamLayer, conductivities_of
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.solving.history import History
from thinlayer.surface.law_points import law_points
from thinlayer.surface.surface_mesh import surface_of

# estimated error of variations along S above which there is a warning; in tests half to twice the error
MAX_VARIATION_ERROR = 0.03
MAX_RISE = 0.05  # difference of mean values of layer and faces, over the span of values, above which there is a warning
MESH_REMEDY = "mesh the layer (structure.full)"
MIN_GRADIENT_RATIO = 1e-2  # gradient, over the largest of a law, from which on its conductivity counts
GRADIENT_ROUNDING = 1e-9  # gradient, times the size of the joint over the largest value, that counts as rounding
MIN_NEGATIVE_RATIO = 1e-3  # negative conductivity, over the largest of a law, that does not count as an error of steps


class Conductivities(NamedTuple):
    """Conductivities of a layer, through all its sublayers.

    Attributes:
        along: conductivity along S, in the direction in which it is largest: mean through the thickness.
        across: conductivity across S: harmonic mean through the thickness.
        capacity: capacity per volume: mean through the thickness; 0 without `Heat`.
    """

    along: float
    across: float
    capacity: float

    @classmethod
    def of(cls, layer: SeamLayer, state: State | None = None) -> Conductivities | None:
        """Return the conductivities of a layer; None if it has no thickness, or its tangent is unknown or not positive.

        The tangent is that at rest, or else that at the mean value of the field in `state`. Where parameters vary in
        space, conductivities and capacity are those that make errors largest.
        """
        T = float(state.u.x.petsc_vec.sum()) / state.model.unknowns if state else 0.0
        sampled = [cls._of_numbers(sample, T) for sample in (layer.samples if layer.thin_layer else ())]
        positive = [conductivities for conductivities in sampled if conductivities]
        if not positive or len(positive) < len(sampled):
            return None
        along, across, capacity = np.transpose(positive)
        return cls(along.max(), across.min(), capacity.max())

    @classmethod
    def _of_numbers(cls, layer: SeamLayer, T: float) -> Conductivities | None:
        """Return the conductivities of a layer whose parameters are numbers, at the value T of the field; see `of`."""
        sublayers, n = layer.initial_tangents.sublayers, layer.initial_tangents.n
        tangents = [tangent_at_rest(law, n, T) if C is None else C for _, law, C in sublayers]
        positive = [C for C in tangents if C is not None and np.linalg.eigvalsh(C[:3, :3] + C[:3, :3].T)[0] > 0]
        if len(positive) < len(tangents):
            return None
        fractions, (across, along) = np.array([a for a, *_ in sublayers]), conductivities_of(positive, n)
        capacities = [c if is_number(c := law.parameters().get("c")) else 0.0 for _, law, _ in sublayers]
        return cls(float(fractions @ along), float(1 / (fractions @ (1 / across))), float(fractions @ capacities))


def warn_of_insulated_sides(model: Model) -> None:
    """Warn, before a solve, if the side of a conducting layer is insulated where the bodies beside it are held. Collective.

    Such a layer touches the two supports in points alone, at which its flux is singular, and no mesh resolves it.
    """
    body_tangents = [C for C in model.structure.extreme_body_tangents if C is not None]
    for name, layer in model.layers.items() if model.broken else ():
        rim, k = model.applicability[name].free_rim.vertices.ravel(), Conductivities.of(layer)
        if k is None or not body_tangents or k.along <= (least := min(C[0, 0] for C in body_tangents)) or not len(rim):
            continue
        surface, is_held = surface_of(model, name), fem.Function(model.V)
        is_held.x.array[model.bc_dofs_in(model.V)] = 1.0
        is_held.x.scatter_forward()
        held_sides = surface.side_values(is_held, model, surface.corner_points).min(axis=(0, 1)) > 0.5
        at_end = np.isin(surface.corners, rim) & held_sides
        if at_end.any():
            place = place_text(model.joint.points[surface.corners[at_end][0]])
            text = f"the side of {layer} is insulated at {place}, between bodies that are held there, and the layer"
            effect = (
                f"conducts {k.along / least:.3g} times as well as a body: its value there depends on the mesh alone"
            )
            model.warn("insulated side", f"{text} {effect}; let the support hold the layer's side, too", name)


def warn_of_fluxes(states: Sequence[State]) -> None:
    """Warn, once for all states, if values vary so along S that an interface law has large errors. Collective.

    A law of order 0 leaves out the flux along S. One of order 1 takes the field as linear through the layer: along S its
    flux is 1 + (delta/L)^2 times too large, with delta = eps sqrt(k_T/(12 k_n)) and the length L over which the mean
    value on S varies. At order 2 it is that of the jump which is too small, by (delta/L)^4/5.
    """
    model = states[0].model
    for name, layer in model.layers.items() if model.broken else ():
        if (k := Conductivities.of(layer, states[-1])) is None:
            continue
        _warn_of_sinks(states, layer, k)
        delta, order = layer.eps * np.sqrt(k.along / (12 * k.across)), layer.as_thin_layer.order
        errors = [_variation_error(state, layer, k, delta) for state in states]
        worst = int(np.argmax([error for error, _ in errors]))
        error, length = errors[worst]
        if error <= MAX_VARIATION_ERROR:
            continue
        if order == 0:
            text, remedy = f"order 0 leaves out the flux along {layer}", "use order=1"
        else:
            text = (
                f"the law of {layer} is for values that vary over more than delta = {delta:.3g}, and it is {length:.3g}"
            )
            remedy = _better_law(layer)
        text = f"at t = {states[worst].t:.4g} {text}: values vary along S with errors of about {error:.2g}"
        model.warn("flux along", f"{text}; {remedy}", name, states[-1].t)


def _warn_of_sinks(states: Sequence[State], layer: SeamLayer, k: Conductivities) -> None:
    """Warn if sinks or sources of a law that is not linear, as of curing, act on a value that is not the layer's mean.

    A source d per area moves the mean of the layer by eps d/(12 k_n) from that of its faces. Up to order 1 laws do not
    know this. Collective.
    """
    thin, model = layer.as_thin_layer, states[0].model
    keys = [key for key, points in model.quadratures.items() if points.term.key == layer.key]
    if thin.law.traits.linear or thin.order == 2 or not keys:
        return
    sinks = np.array([[np.abs(s.stresses[key][:, VALUE_INDEX]).max(initial=0.0) for key in keys] for s in states])
    values = [s.u.x.petsc_vec for s in states]
    span = max(v.max()[1] for v in values) - min(v.min()[1] for v in values)
    rise = layer.eps**2 * float(model.comm.allreduce(float(sinks.max()), MPI.MAX)) / (12 * k.across)
    if rise > MAX_RISE * span:
        text = f"sinks and sources in {layer} move its mean value by up to {rise:.3g} from that of its faces"
        model.warn("sinks", f"{text}, and its law is not linear; {_better_law(layer)}", layer.name)


def _better_law(layer: SeamLayer) -> str:
    """Return the remedy for a layer whose law of order 1 or 2 leaves its range."""
    has_order_2 = layer.as_thin_layer.order < 2 and not layer.as_thin_layer.fractions
    return f"use order=2, or {MESH_REMEDY}" if has_order_2 else MESH_REMEDY


def warn_of_negative_conductivities(states: Sequence[State]) -> None:
    """Warn, once for each law, if the flux of a non-linear law runs against the field's gradient in a state. Collective.

    Such a problem has no unique solution, and depends on the mesh.

    Args:
        states: states of one model.
    """
    model = states[0].model
    for state in states if not all(term.law.traits.linear for term in model.terms) else ():
        for points in law_points(state):
            if points.term.law.traits.linear:
                continue
            e, term = points.quadrature.values(mandel_vector(points.term.step(state.u).e)), points.term
            b = state.fields.get(str(Key.parse(term.key).bubble_key))  # states at rest have none, as it is zero
            if term.bubble_strain is not None and b is not None:
                e += points.quadrature.values(mandel_vector(term.bubble_strain(b)))
            power, squares = np.einsum("pii,pi->p", points.stress(), e[:, :3]), (e[:, :3] ** 2).sum(axis=1)
            rounding = GRADIENT_ROUNDING * np.abs(e[:, 3]).max(initial=0.0) / model.joint.size
            largest = max(float(squares.max(initial=0.0)) ** 0.5 * MIN_GRADIENT_RATIO, rounding)
            counts = squares > model.comm.allreduce(largest, max) ** 2
            k, T, x = power[counts] / squares[counts], e[counts, 3], points.quadrature.joint_x.T[counts]
            most = model.comm.allreduce(float(np.abs(k).max(initial=0.0)), max)
            worst = int(k.argmin()) if k.size else -1
            rows = model.comm.allgather((float(k[worst]), float(T[worst]), x[worst].tolist()) if k.size else None)
            least, value, place = min(row for row in rows if row) if any(rows) else (0.0, 0.0, [])
            if least < -MIN_NEGATIVE_RATIO * most:
                law = f"at t = {state.t:.4g} the conductivity of {points.term.key}"
                effect = "fluxes run against gradients, and depend on the mesh"
                text = f"{law} is {least:.3g} near {place_text(place)}, for the value {value:.4g}: {effect}"
                remedy = "take other loads, or a law that is positive there, as by ufl.max_value"
                model.warn("negative conductivity", f"{text}; {remedy}", points.term.key, states[-1].t)


def _variation_error(state: State, layer: SeamLayer, k: Conductivities, delta: float) -> tuple[float, float]:
    """Return the estimated error of variations along S, over their size, and the length over which mean values vary.

    It is the relative error of the flux along S, times the layer's share in what conducts along S over that length.
    """
    surface, model = surface_of(state.model, layer.name), state.model
    lower, upper = surface.side_values(state.u, model, surface.corner_points)[:, 0]
    T = surface.nodal(surface.from_corners((lower + upper) / 2))
    stiffness, is_inner = surface.stiffness(), ~np.isin(surface.vertices, layer.sheet.rim.vertices)
    laplacian, is_order_0 = stiffness @ T / surface.areas * is_inner, layer.as_thin_layer.order == 0
    gradient_squared = float(T @ stiffness @ T)
    if gradient_squared <= 1e-16 * float(np.abs(T).max(initial=0.0)) ** 2:
        return 0.0, np.inf
    wave_number = float(np.sqrt(surface.areas @ laplacian**2 / gradient_squared))
    if is_order_0:  # which also leaves out a uniform flux along S
        wave_number = max(wave_number, 1 / float(np.ptp(surface.places, axis=0).max()))
    k_bodies = np.mean([C[0, 0] for C in model.structure.extreme_body_tangents if C is not None] or [np.inf])
    share = layer.eps * k.along * wave_number / (k_bodies + layer.eps * k.along * wave_number)
    x = (delta * wave_number) ** 2
    return share * min(1.0, (1.0, x, x**2 / 5)[layer.as_thin_layer.order]), 1 / max(wave_number, 1e-300)


def warn_of_layer_times(history: History) -> None:
    """Warn, after a march, if steps are shorter than the time in which values even out inside a layer.

    Interface laws take values as linear through the layer, which holds for changes that are slow beside the time of its
    slowest mode between held faces, eps^2 c/(pi^2 k_n). At that length of the steps, errors are 1 to 3 %. The law of
    order 2 has this mode, and lacks the next one, with a quarter of the time.
    """
    model, step = history.model, min(np.diff(history.t), default=np.inf)
    for name, layer in model.layers.items() if model.broken and model.n_components == 1 else ():
        if (k := Conductivities.of(layer, history.last)) is None:
            continue
        mode = 2 if layer.thin_layer and layer.thin_layer.order == 2 else 1  # the first that the law lacks
        if (time := layer.eps**2 * k.capacity / ((mode * np.pi) ** 2 * k.across)) > step:
            text = (
                f"values even out inside {layer} in {time:.3g}, longer than a step, {step:.3g}: the results of so short"
            )
            model.warn("layer time", f"{text} steps have errors of some per cent; {_better_law(layer)}", name)
