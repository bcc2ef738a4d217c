"""The pressure of a layer on S, and its slope along S, at places, in numbers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from geometry.topology import lagrange
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.output.faces_at import mean_at, slopes
from thinlayer.surface.locating import Located

Array = npt.NDArray[np.float64]


def pressure_at(state: State, one: SeamLayer, x: Array) -> tuple[Array, Array]:
    """Pressures (n,) of a layer and their slopes (n, d) along the facets, at places (n, d) of its seam. Collective.

    Where places lie between facets values are means of theirs.
    """
    joint, f = state.model.joint, state.fields[one.pressure_key]
    owned = f.function_space.dofmap.index_map.size_local
    mine = np.column_stack([f.function_space.tabulate_dof_coordinates()[:owned, : joint.dim], f.x.array[:owned]])
    known = np.concatenate(state.model.comm.allgather(mine))
    vertices = np.unique(joint.table.vertices[joint.rows_of(one.name)])
    _, nearest = cKDTree(joint.points[vertices]).query(known[:, :-1])
    at_masters = np.zeros(len(joint.points))
    at_masters[joint.masters[vertices[nearest]]] = known[:, -1]
    nodal = np.zeros(len(joint.points))  # off S without meaning: it does not change what is along S
    nodal[vertices] = at_masters[joint.masters[vertices]]
    above = Located.of(joint, x).on_side("upper", one.name)
    table = lagrange(joint.cell_type, 1).tabulate(1, above.X)[..., 0]
    at_corners = nodal[joint.corners[above.cell]]
    values = np.einsum("mn,mn->m", table[0], at_corners)
    gradient = np.einsum("kmn,mn,mkj->mj", table[1:], at_corners, np.linalg.inv(slopes(above)))
    return mean_at(above, values), mean_at(above, gradient)
