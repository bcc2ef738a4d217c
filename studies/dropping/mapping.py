"""Changes along a straight S with y = 0, and where on it the change of the compliance comes from."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la

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
        one: two bodies in 2D, S between them on y = 0, elastic laws without a pressure, loads alone.
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
    V, Q = model.V, fem.functionspace(model.domain.mesh, ("Lagrange", 1))
    v, q = fem.Function(V), ufl.TestFunction(Q)
    x = V.tabulate_dof_coordinates()[:, :2]
    layer = np.flatnonzero(np.abs(x[:, 1]) <= one.eps / 2 * (1 + 1e-9))
    v.x.array.reshape(-1, 2)[layer] = _between(one, x[layer])
    (term,) = state.layers
    work = ufl.inner(state.stress(term), term.strain(v)) * term.weight * q * term.measure
    found = fem.assemble_vector(fem.form(work))
    found.scatter_reverse(la.InsertMode.add)
    mine = Q.dofmap.index_map.size_local
    near = np.abs(Q.tabulate_dof_coordinates()[:mine, 0] - at[:, None]) < 10.0**-ROUND
    return np.asarray(model.comm.allreduce(near @ found.array[:mine]))


def _between(one: Dropped, x: Array) -> Array:
    """Displacements u_0 (n, 2) at places (n, 2) of the meshed layer, linear from face to face. Collective."""
    comm, count = one.full.model.comm, len(x)
    everywhere = comm.allgather(x)  # a probe has the same places on all ranks
    probe, places = Probe(one.found.state), np.concatenate(everywhere) * (1.0, 0.0)
    begin = sum(len(there) for there in everywhere[: comm.rank])
    upper, lower = (probe.displacement(places, side=side)[begin : begin + count] for side in ("upper", "lower"))
    share = x[:, 1:] / one.eps + 0.5
    return np.asarray(share * upper + (1 - share) * lower)
