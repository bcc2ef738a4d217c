"""How the two faces of a layer are displaced at places of S, in numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
import numpy.typing as npt

from geometry.seam import S
from geometry.topology import lagrange
from thinlayer.discretisation.state import State, cell_values
from thinlayer.parallel.agreement import on_all, require_same
from thinlayer.surface.locating import SIDES, Located

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FacesAt:
    """Displacements of both sides of S at n places of it, and normals, the same on all ranks.

    Where places lie between facets values are means of theirs.

    Attributes:
        x: (n, d) the places.
        n: (n, d) unit normals of S.
        u: (2, n, d) displacements of the lower and the upper side; zero of a rigid base.
        gradient: (2, n, d, d) their gradients, [..., j] along x_j.
    """

    x: Array
    n: Array
    u: Array
    gradient: Array

    @classmethod
    def of(cls, state: State, x: Any, seam: str) -> FacesAt:
        """Those of a state of an interface model whose bodies meet on S. Collective.

        Raises:
            ModelError: places that are not on this seam.
        """
        comm, joint = state.model.comm, state.model.domain.joint
        require_same(comm, places=np.asarray(x))
        with on_all(comm):
            located = Located.of(joint, x).on_seam(seam)
            based = set(joint.base_seams) >= {*(joint.seams if seam == S else (seam,))}
            sides = {name: located.on_side(name, seam) for name in SIDES[based:]}
        d, count = joint.dim, len(located.x)
        u, gradient = np.zeros((2, count, d)), np.zeros((2, count, d, d))
        for name, side in sides.items():
            k = SIDES.index(name)
            u[k], gradient[k] = _values(state, side)
        return cls(located.x, _normals(sides["upper"], seam), u, gradient)


def mean_at(located: Located, values: Array) -> Array:
    """Means (n, ...) over the cells at each place."""
    out = np.zeros((len(located.x), *values.shape[1:]))
    np.add.at(out, located.point, values)
    counts = np.bincount(located.point, minlength=len(located.x))
    return np.asarray(out / counts.reshape(-1, *[1] * (values.ndim - 1)))


def slopes(located: Located) -> Array:
    """(m, d, d) gradient of the places, [:, i, k] of x_i along the k-th coordinate of the reference cell."""
    joint = located.joint
    table = lagrange(joint.cell_type, joint.degree).tabulate(1, located.X)[1:, :, :, 0]
    return np.asarray(np.einsum("kmn,mni->mik", table, joint.cell_points[located.cell]))


def _values(state: State, located: Located) -> tuple[Array, Array]:
    """Displacements and gradients at places, means over the cells. Collective."""
    domain, joint, comm = state.model.domain, located.joint, state.model.comm
    owned = domain.original_cells[: domain.mesh.topology.index_map(joint.dim).size_local]
    order = np.argsort(owned)
    at = np.minimum(np.searchsorted(owned[order], located.cell), max(len(owned) - 1, 0))
    mine = np.flatnonzero(owned[order][at] == located.cell) if len(owned) else np.empty(0, np.int64)
    found = np.zeros((len(located.cell), joint.dim, 1 + joint.dim))
    if len(mine):  # basix takes no empty arrays
        table = state.u.function_space.ufl_element().basix_element.tabulate(1, located.X[mine])[..., 0]
        nodal = cell_values(state.u, order[at[mine]]).reshape(len(mine), table.shape[2], joint.dim)
        to_x = np.linalg.inv(slopes(located)[mine])
        found[mine, :, 0] = np.einsum("mn,mni->mi", table[0], nodal)
        found[mine, :, 1:] = np.einsum("kmn,mni,mkj->mij", table[1:], nodal, to_x)
    means = mean_at(located, np.asarray(comm.allreduce(found)))
    return means[..., 0], means[..., 1:]


def _normals(upper: Located, seam: str) -> Array:
    """Unit normals of S at places in the cells above it."""
    joint = upper.joint
    outward = basix.cell.facet_outward_normals(basix.CellType[joint.cell_type])
    at, row, side = upper.facets()
    above = np.isin(row, joint.rows_of(seam)) & (side == 1)
    at, row = at[above], row[above]
    cells = joint.table.cells[row] == upper.cell[at][:, None]
    local = joint.table.local[row][np.arange(len(row)), cells.argmax(axis=1)]
    normals = -np.einsum("mk,mki->mi", outward[local], np.linalg.inv(slopes(upper)[at]))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    total = np.zeros_like(upper.x)
    np.add.at(total, upper.point[at], normals)
    return np.asarray(total / np.linalg.norm(total, axis=1, keepdims=True))
