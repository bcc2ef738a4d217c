"""The nodes of a rigid plate: how its motions give their displacements, and supports that they have besides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.sparse
from dolfinx import fem

from geometry.errors import place as at_place
from thinlayer.discretisation.addition import Host
from thinlayer.discretisation.prescribed import AGREE, ROUNDING
from thinlayer.discretisation.reactions import Array, rigid
from thinlayer.errors import ModelError
from thinlayer.parts.plate_data import PlateData

FOLLOWS = 1e-9  # share of a free motion in a displacement that counts as rounding


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


def release(plate: PlateData, model: Host) -> int:
    """Take out conditions of supports at nodes of the plate that follow from its prescribed motions; their number.

    Raises:
        ModelError: a support at a node of the plate prescribes what does not.
    """
    about, size, d = plate.point(model), plate.size(model), model.joint.dim
    tied = np.flatnonzero(np.diff(tie(plate, model, about, size).indptr)) // d
    prescribed = model.prescribed
    rows = np.flatnonzero(np.isin(prescribed.blocks, tied) & (prescribed.entry >= 0))
    x = model.V.tabulate_dof_coordinates()[prescribed.blocks[rows], :d]
    directions = prescribed.directions[rows]
    ways = np.einsum("nd,ndk->nk", directions, rigid(x, about))
    free = np.setdiff1d(np.arange(ways.shape[1]), plate.motions_held(model))
    scaled = np.where(np.arange(ways.shape[1]) < d, ways, ways / size)
    wrong = np.abs(scaled[:, free]).max(axis=1, initial=0.0) > FOLLOWS
    message = ""
    if wrong.any():
        place, _ = model.supports.entries[prescribed.entry[rows[wrong][0]]]
        where = np.where(np.abs(x[wrong][0]) > ROUNDING * size, x[wrong][0], 0.0)
        message = (
            f"the support on {place!r} acts on a node of the rigid plate on {plate.place!r}, at {at_place(where)}, and "
            f"does not follow from its prescribed motions; prescribe them, RigidPlate({plate.place!r}, motion={{...}})"
        )
    if messages := [one for one in model.comm.allgather(message) if one]:
        raise ModelError(messages[0])
    prescribed.released[plate.key] = prescribed.release(rows), ways
    return len(rows)


def require_agreement(plate: PlateData, model: Host, motions: Mapping[int, float], t: float) -> None:
    """Raise ModelError if supports at nodes of the plate prescribe other values than its motions. Collective."""
    released, ways = model.prescribed.released[plate.key]
    q = np.array([motions.get(k, 0.0) for k in range(ways.shape[1])])
    values, by_plate = released.values(), ways @ q
    apart = np.abs(values - by_plate)
    largest = max(np.abs(values).max(initial=0.0), np.abs(by_plate).max(initial=0.0))
    message = ""
    if apart.max(initial=0.0) > max(AGREE * largest, ROUNDING * plate.size(model)):
        k = int(apart.argmax())
        place, _ = model.supports.entries[released.entry[k]]
        message = (
            f"contradictory at t = {t:g}: the support on {place!r} prescribes {values[k]:.6g} where the motion of the "
            f"rigid plate on {plate.place!r} is {by_plate[k]:.6g}"
        )
    if messages := [one for one in model.comm.allgather(message) if one]:
        raise ModelError(messages[0])
