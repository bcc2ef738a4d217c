"""Energies of layers on the facets of S: dissipated in the steps of a march, and released by damage in both modes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array, InputError
from forms.law import BulkLaw, Step
from forms.parameter_fields import parameter_numbers
from forms.tensors import MANDEL_PAIRS, mandel_tensor
from geometry.topology import IntArray
from thinlayer.discretisation.state import Configuration, State
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.parts.part import TimeStep
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.solving.history import History
from thinlayer.surface.law_points import layer_points
from thinlayer.surface.surface_mesh import SurfaceMesh

ZERO_ENERGY_RATIO = 1e-12  # energy of both modes on a facet, over the largest of all, that counts as none


@contextmanager
def _layer_parts(surface: SurfaceMesh, state: State) -> Iterator[list[tuple[CompiledPart, IntArray]]]:
    """Context manager that yields the parts of compiled laws of layers, each with the facet of S at each of its cells.

    The cells of a law on S are facets. The number of a facet is -1 off the surface.
    """
    model = state.model
    parts = [
        (CompiledPart(points.key, model.V, model.quadratures[points.key].term, model.origin), facets)
        for points, facets in layer_points(surface, state)
        if points.key
    ]
    try:
        yield parts
    finally:
        for part, _ in parts:
            part.destroy()


def _add_to_facets(out: Array, part: CompiledPart, facets: IntArray, values: Array) -> None:
    """Add the values (points, ...) of a part to `out` (n, ...), at the n facets of S; `facets` as in `_layer_parts`."""
    np.add.at(out, facets[facets >= 0], values[part.points.cells[facets >= 0]].sum(axis=1))


def dissipated_in_steps(surface: SurfaceMesh, history: History) -> Array:
    """Return the energies (rows, n, 1) per area that layers dissipate, in the step of each row of a history's table.

    Raises:
        InputError: states are missing; a contact law, or a law whose phases switch, which have no such field.
    """
    if len(history.states) < len(history) or not history.states:
        raise InputError("dissipated: the history needs all its states; march with keep='all'")
    model, states = history.model, list(history)
    laws = {seam: layer.law for seam, layer in model.layers.items() if seam in surface.seams}
    for seam, law in laws.items():
        if law.traits.switches or seam in model.contacts:
            raise InputError(f"dissipated: no field of {type(law).__name__} on {seam!r}; the table has its sum")
    energies = np.zeros((len(states), len(surface.rows)))
    with _layer_parts(surface, states[0]) as parts:
        rest = {part.key: part.rest() for part, _ in parts}
        start = Configuration(fem.Function(model.V), states[0].t, rest, at_rest=True)
        before = [states[0] if history.begun or states[0].at_rest else start, *states[:-1]]
        for row, (old, new) in enumerate(zip(before, states, strict=True)):
            if old is new:
                continue
            for part, facets in parts:
                part.begin(TimeStep(old, new.t, new.t - old.t, history.theta))
                part.evaluate(new.u, new.u)
                _add_to_facets(energies[row], part, facets, part.dissipated())
    return np.asarray(model.comm.allreduce(energies) / surface.weights.sum(axis=1))[..., None]


def mode_mix(surface: SurfaceMesh, state: State) -> Array:
    """Return the mode mixities (n, 1) of the n facets of a surface, as `Surface.mode_mix` defines them.

    Raises:
        InputError: no layer has modes, or one is a sublayer of a `Stack`.
    """
    laws = [sublayer for layer in state.model.layers.values() for sublayer in layer.law.sublayers]
    if not any(law.has_modes for _, law in laws):
        raise InputError("mode_mix: no layer has a law with modes, such as Breaking or Cohesive")
    if any(law.has_modes and fraction < 1 for fraction, law in laws):
        raise InputError("mode_mix: a sublayer of a Stack has modes, and its strains are not known; make it the layer")
    energies = np.zeros((len(surface.rows), 2))
    with _layer_parts(surface, state) as parts:
        for part, facets in parts:
            e = part.points.driving_strain(part.strain_in(state))
            if part.law.has_modes:
                _add_to_facets(energies, part, facets, _mode_energies(part.points, part.law, e))
    energies = state.model.comm.allreduce(energies)
    total = energies.sum(axis=1, keepdims=True)
    return np.where(total > ZERO_ENERGY_RATIO * total.max(), energies[:, 1:] / np.where(total > 0, total, 1.0), np.nan)


def _mode_energies(points: CompiledTerm, law: BulkLaw, e: Array) -> Array:
    """Return the energies (points, 2) around each point that damage of a law releases in modes I and II. Collective.

    Args:
        points: the law at its quadrature points.
        law: the law, or a sublayer.
        e: (points, m) strains, as the m Mandel components of `points`.
    """
    strain = np.zeros((points.count, len(MANDEL_PAIRS)))
    strain[:, points.mandel] = e
    numbers = {name: parameter_numbers(value) for name, value in law.parameters().items()}
    parameters = [np.broadcast_to(value, points.count) for value in (numbers | law.fields_at(points.joint_x)).values()]
    # parameters are functions, too, so that a law is compiled once for all parameters
    f = points.region.plus_side(points.region_function(np.column_stack([strain, points.n, *parameters])))
    *components, n_1, n_2, n_3 = (f[k] for k in range(len(MANDEL_PAIRS) + 3))
    step = Step(mandel_tensor(ufl.as_vector(components)), ufl.as_vector([n_1, n_2, n_3]))
    local = law.with_parameters({name: f[len(components) + 3 + k] for k, name in enumerate(numbers)})
    return points.weights[:, None] * points.values(ufl.as_vector(local.mode_energies(step)))
