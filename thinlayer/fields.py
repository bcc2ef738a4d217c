"""Fields for pictures and files: gathered on rank 0 for pyvista, written in parallel for ParaView."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dolfinx
import dolfinx.plot
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from geometry.joint import BASE, S
from thinlayer.model import Model
from thinlayer.state import State


@dataclass(frozen=True)
class Grid:
    """A displacement field on VTK cells; the nodes on S are double where it jumps.

    Attributes:
        points: (n, 3) places of the nodes.
        u: (n, 3) displacements.
        cells, types: VTK cells.
        region: (n_cells,) region number from 0; sublayers of the meshed layer are -1, -2, ...
        base: (n, 2, 3) edges of the rigid base in 2D, which do not move; none between two bodies.
    """

    points: npt.NDArray[np.float64]
    u: npt.NDArray[np.float64]
    cells: npt.NDArray[np.int64]
    types: npt.NDArray[np.uint8]
    region: npt.NDArray[np.int64]
    base: npt.NDArray[np.float64]


def nodal_displacement(state: State) -> fem.Function:
    """The displacement by nodal values: itself, or its interpolant where the element's unknowns are no nodal values."""
    if not state.model.element.startswith("S"):
        return state.u
    u = fem.Function(state.model.space(2), name="u")
    u.interpolate(state.u)
    u.x.scatter_forward()
    return u


def gather(state: State) -> Grid:
    """The field of a state, on rank 0 (other ranks: empty). Collective."""
    model = state.model
    u = nodal_displacement(state)
    cells, types, points = dolfinx.plot.vtk_mesh(u.function_space)
    d = model.joint.dim
    values = np.zeros((len(points), 3))
    values[:, :d] = u.x.array.reshape(-1, d)[: len(points)]
    original = model.domain.original_cells[: len(types)]
    region = model.domain.joint.region[original]
    n_layers = len(model.domain.layer_regions)
    first_layer = len(model.domain.joint.regions) - n_layers
    region = np.where(region >= first_layer, first_layer - region - 1, region) if n_layers else region
    rows = cells.reshape(len(types), -1) if len(types) else None
    pieces = model.comm.gather((points, values, rows, types, region), root=0)
    if pieces is None:
        return Grid(points[:0], values[:0], cells[:0], types[:0], region[:0], np.empty((0, 2, 3)))
    pieces = [piece for piece in pieces if piece[2] is not None]  # a rank may have no cells
    shifted, offset = [], 0
    for x, _, c, _, _ in pieces:
        c = c.copy()
        c[:, 1:] += offset
        shifted.append(c)
        offset += len(x)
    joined: list[Any] = [np.concatenate([piece[k] for piece in pieces]) for k in (0, 1, 3, 4)]
    return Grid(joined[0], joined[1], np.concatenate(shifted).ravel(), joined[2], joined[3], _base(model))


def _base(model: Model) -> npt.NDArray[np.float64]:
    joint = model.domain.joint
    if not joint.rigid_base or joint.dim != 2:
        return np.empty((0, 2, 3))
    edges = joint.points[joint.facets[BASE if joint.band else S]]
    return np.concatenate([edges, np.zeros((len(edges), 2, 1))], axis=2)


def write(state: State, path: str | Path) -> None:
    """Write the displacement for ParaView: VTX for a path that ends in .bp, VTK for .pvd. Collective.

    The jump is kept: nodes on S are written once for each side.

    Raises:
        ValueError: another ending. RuntimeError: this DOLFINx has no ADIOS2, which VTX needs.
    """
    u, comm = nodal_displacement(state), state.model.comm
    u.name = "u"
    suffix = Path(path).suffix
    if suffix == ".bp":
        if not dolfinx.has_adios2:
            raise RuntimeError("VTX needs a DOLFINx with ADIOS2; write a .pvd file instead")
        with dolfinx.io.VTXWriter(comm, path, [u]) as file:
            file.write(state.t)
    elif suffix == ".pvd":
        with dolfinx.io.VTKFile(comm, path, "w") as file:
            file.write_function(u, state.t)
    else:
        raise ValueError(f"cannot write {str(path)!r}; allowed endings: .bp (VTX), .pvd (VTK)")
