"""The nodes of a rigid plate: how its motions give their displacements."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from dolfinx import fem

from thinlayer.discretisation.addition import Host
from thinlayer.discretisation.reactions import Array, rigid
from thinlayer.errors import ModelError
from thinlayer.parts.plate_data import PlateData


def tie(plate: PlateData, model: Host, about: Array, size: float) -> Any:
    """(n, k) sparse: displacements of this rank by the plate's motions, rotations times a length. Collective.

    A plate that turns moves bodies on both sides of a layer apart along S, by the layer's thickness as an arm.
    """
    V, d = model.V, model.joint.dim
    facets = model.domain.facets(plate.place, layer_sides=True)
    owned = V.dofmap.index_map.size_local
    found = fem.locate_dofs_topological(V, d - 1, facets)
    blocks = np.unique(found[found < owned])
    try:
        x = V.tabulate_dof_coordinates()[blocks, :d]
    except RuntimeError as error:
        raise ModelError(f"{plate.what} needs nodal displacements, not elements S2") from error
    if (shifts := model.shifts()) is not None:
        by_node = np.zeros((owned + V.dofmap.index_map.num_ghosts, d))
        by_node[V.dofmap.list] = shifts[model.domain.original_cells][:, None]
        least, most = by_node[blocks].min(axis=0, initial=np.inf), by_node[blocks].max(axis=0, initial=-np.inf)
        every = np.array(model.comm.allgather((least, most)))
        middle = (every[:, 0].min(axis=0) + every[:, 1].max(axis=0)) / 2  # the plate's point stays
        x = x + by_node[blocks] - middle
    values = rigid(x, about)
    values[:, :, d:] /= size
    k = values.shape[2]
    rows = np.repeat(blocks[:, None] * d + np.arange(d), k)
    columns = np.tile(np.arange(k), len(blocks) * d)
    return scipy.sparse.csr_matrix((values.ravel(), (rows, columns)), (owned * d, k))
