"""Changes along a straight S with y = 0, and where on it the change of the compliance comes from."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from studies.dropping.measuring import FIELDS, Dropped
from thinlayer import Probe, Surface, Table

Array = npt.NDArray[np.float64]
ROUND = 9  # digits of places


def along(one: Dropped) -> Table:
    """Changes of the normal components of t and [u] along S, and densities of the change of the compliance.

    Bodies, loads and supports are linear and fixed. With L the loads, t_0, u_0 of the law of order 0 and u with meshed
    layers, L(u) - L(u_0) = int_S t_0 . [u] - int_layer stress(u) : strain(v) for any v that is u_0 on the faces; v is
    linear between them. Of the estimate the density is its own.

    Args:
        one: two bodies in 2D, S between them on y = 0 at all x, linear laws, loads alone.
    """
    found, surface = one.found, Surface(one.found.better.model)
    columns = {}
    for name, field in zip(FIELDS, (surface.traction, surface.jump), strict=True):
        before = field(found.state)
        for which, state in (("true", one.full), ("estimated", found.better)):
            x, values = surface.profile(field(state) - before)
            columns[f"{which}_{name}"] = values[:, 1]
    density = found.density()
    order = np.argsort(density.x[:, 0])
    _, on_s = surface.profile(ufl.dot(surface.traction(found.state), surface.jump(one.full)))
    columns["density"] = density.values[order]
    columns["true_density"] = on_s - _of_layer(one, x[:, 0]) / density.areas[order]
    return Table(
        {"x": float(x[k, 0]), **{name: float(c[k]) for name, c in columns.items()}} for k in np.argsort(x[:, 0])
    )


def _of_layer(one: Dropped, at: Array) -> Array:
    """Work of the meshed layer's stress in displacements u_0 of its faces, spread over the places x of columns."""
    model, state = one.full.model, one.full
    v, q = fem.Function(model.V), ufl.TestFunction(fem.functionspace(model.domain.mesh, ("Lagrange", 1)))
    x = model.V.tabulate_dof_coordinates()[:, :2]
    layer = np.flatnonzero(np.abs(x[:, 1]) <= one.eps / 2 * (1 + 1e-9))
    probe, share = Probe(one.found.state), x[layer, 1:] / one.eps + 0.5
    places = np.column_stack([x[layer, 0], np.zeros(len(layer))])
    upper, lower = (probe.displacement(places, side=side) for side in ("upper", "lower"))
    v.x.array.reshape(-1, 2)[layer] = share * upper + (1 - share) * lower
    (term,) = state.layers
    work = ufl.inner(state.stress(term), term.strain(v)) * term.weight * q * term.measure
    found = fem.assemble_vector(fem.form(work)).array
    nodes = q.ufl_function_space().tabulate_dof_coordinates()[:, 0]
    return np.array([found[np.abs(nodes - one_x) < 10.0**-ROUND].sum() for one_x in at])
