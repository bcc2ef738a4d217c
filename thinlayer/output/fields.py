"""Fields for pictures and files: gathered on rank 0 for pyvista, written in parallel for ParaView."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import dolfinx
import dolfinx.plot
import numpy as np
import numpy.typing as npt
import pyvista
from dolfinx import fem

from geometry.joint import Joint
from geometry.parallel import on_root, world
from geometry.seam import BASE
from geometry.topology import FACET_TYPES
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all, require_same
from thinlayer.parallel.exchange import carry
from thinlayer.time.history import History

VTK_LAGRANGE = {"interval": 68, "triangle": 69, "quadrilateral": 70}  # VTK's numbers of cells of any degree
SUBDIVISION = 3  # subdivision level of curved cells
SHARP = 30.0  # angle (degree) between faces whose common edge is drawn
ALMOST = 0.999  # factor of displacements that keeps the two sides of S apart, so that VTK does not merge them
OFF_MIDDLE = 1e-3  # distance of a cut from the middle, over the structure's size: not along the faces of a grid
BYTES = {"mesh": 128, "u": 24}  # approximate size of a node in a file: its place and cells; its displacement
MIRRORED = (1, 0, 2, 3, 4, 6, 5, 8, 7, 9)  # nodes of a tetrahedron of degree 2 in VTK's order; the first four: degree 1


@dataclass(frozen=True)
class Grid:
    """A displacement field on VTK cells; the nodes on S are double where it jumps.

    Attributes:
        dim: space dimension, 2 or 3; in 2D all third components are zero.
        points: (n, 3) places of the nodes.
        u: (n, 3) displacements.
        cells, types: VTK cells.
        region: (n_cells,) region number from 0; sublayers of the meshed layer are -1, -2, ...
        base: (n, k, 3) nodes of the facets of the rigid base, which do not move, in VTK's order; none between two bodies.
        base_type: VTK type of these facets.
    """

    dim: int
    points: npt.NDArray[np.float64]
    u: npt.NDArray[np.float64]
    cells: npt.NDArray[np.int64]
    types: npt.NDArray[np.uint8]
    region: npt.NDArray[np.int64]
    base: npt.NDArray[np.float64]
    base_type: int

    def component(self, name: str) -> npt.NDArray[np.float64]:
        """(n,) component of the displacement, "x", "y" or "z", or its "size"; raises ModelError for another name."""
        if name == "size":
            return np.linalg.norm(self.u, axis=1)
        if name not in tuple("xyz"[: self.dim]):
            raise ModelError(f"unknown component {name!r}; allowed: size, {', '.join('xyz'[: self.dim])}")
        return self.u[:, "xyz".index(name)]


@dataclass(frozen=True)
class Shape:
    """A deformed structure to draw.

    Attributes:
        regions: region number -> its cells, the layer's last, with point data "u", a component of the displacement, and
            "moved", (n, 3) how far the deformed points are from the undeformed ones.
        base: facets of the rigid base; None between two bodies.
    """

    regions: dict[int, pyvista.UnstructuredGrid]
    base: pyvista.UnstructuredGrid | None

    @classmethod
    def of(cls, grid: Grid, component: str, scale: float, cut: Sequence[float] | None = None) -> Shape:
        """The structure with displacements times a scale; cut: without the half to which this unit vector points."""
        mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points + scale * grid.u)
        mesh.point_data.update({"u": grid.component(component), "moved": scale * grid.u})
        parts = {int(number): mesh.extract_cells(grid.region == number) for number in np.unique(grid.region)[::-1]}
        n, k = grid.base.shape[:2]
        facets = np.insert(np.arange(n * k).reshape(n, k), 0, k, axis=1)
        base = pyvista.UnstructuredGrid(facets, np.full(n, grid.base_type), grid.base.reshape(-1, 3)) if n else None
        if base is not None:
            base.point_data["moved"] = np.zeros(base.points.shape)
        if cut is None:
            return cls(parts, base)
        low, high = grid.points.min(axis=0), grid.points.max(axis=0)
        plane = {"normal": cut, "origin": (low + high) / 2 + OFF_MIDDLE * (high - low).max() * np.asarray(cut)}
        behind = {number: part.clip(**plane) for number, part in parts.items()}
        regions = {number: part for number, part in behind.items() if part.n_cells}
        return cls(regions, base.clip(**plane) if base is not None else None)

    @property
    def points(self) -> npt.NDArray[np.float64]:
        """(n, 3) nodes of the regions and then of the base."""
        meshes = [*self.regions.values(), *([] if self.base is None else [self.base])]
        return np.concatenate([mesh.points for mesh in meshes])

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """(n,) "u" at `points`; not a number on the base."""
        values = np.concatenate([part["u"] for part in self.regions.values()])
        return np.pad(values, (0, 0 if self.base is None else self.base.n_points), constant_values=np.nan)


def surface(mesh: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """Outer surface of a mesh (in 2D the mesh itself), curved cells subdivided."""
    return mesh.extract_surface(algorithm=None, nonlinear_subdivision=SUBDIVISION)


def edges(surface: pyvista.PolyData) -> pyvista.PolyData:
    """Outlines of a surface, and where it has sharp edges before it deforms, at their deformed places."""
    still = surface.copy()
    still.points -= ALMOST * surface["moved"]
    if not surface.n_lines:
        still = still.compute_normals(point_normals=False)  # turns faces alike, for their angles
    lines = still.extract_feature_edges(SHARP, manifold_edges=False, non_manifold_edges=False)
    if lines.n_cells:
        lines.points += ALMOST * lines["moved"]
    return lines


def nodal_displacement(state: State) -> fem.Function:
    """The displacement by nodal values, a copy, or its interpolant where the element's unknowns are no nodal values."""
    nodal = not state.model.element.startswith("S")
    u = fem.Function(state.u.function_space if nodal else state.model.space(2), name="u")
    if nodal:
        u.x.array[:] = state.u.x.array
        return u
    u.interpolate(state.u)
    u.x.scatter_forward()
    return u


def at_corners(state: State) -> npt.NDArray[np.float64]:
    """Displacements (cells, corners, d) of the bodies' cells of the joint, on rank 0 (other ranks: none). Collective."""
    model, joint = state.model, state.model.joint
    u, n = nodal_displacement(state), len(joint.cells)
    original = model.domain.original_cells[: model.domain.mesh.topology.index_map(joint.dim).size_local]
    own = np.flatnonzero(original < n)
    nodes = np.asarray(u.function_space.dofmap.list)[own][:, : joint.corners.shape[1]]
    values = u.x.array.reshape(-1, joint.dim)[nodes].reshape(len(own), nodes.shape[1] * joint.dim)
    wanted = np.arange(n if model.comm.rank == 0 else 0)
    return carry(model.comm, original[own], values, wanted).reshape(len(wanted), nodes.shape[1], joint.dim)


def gather(state: State) -> Grid:
    """The field of a state, on rank 0 (other ranks: no cells). Collective."""
    model, joint = state.model, state.model.domain.joint
    u = nodal_displacement(state)
    nodes = u.function_space.dofmap.index_map
    cells, types, x = dolfinx.plot.vtk_mesh(u.function_space)
    number = nodes.local_to_global(np.arange(len(x), dtype=np.int32))
    rows = cells.reshape(len(types), cells.size // max(len(types), 1)).astype(np.int64)
    if joint.cell_type == "tetrahedron" and len(rows):
        _orient(x, rows[:, 1:])
    rows[:, 1:] = number[rows[:, 1:]]
    region = model.domain.on_cells(joint.region)[: len(types)]
    n_layers = len(model.domain.layer_regions)
    first_layer = len(joint.regions) - n_layers
    region = np.where(region >= first_layer, first_layer - region - 1, region) if n_layers else region
    displacement = u.x.array.reshape(-1, joint.dim)[: len(x)]
    piece = (number, x, displacement, rows.ravel(), types, region)
    pieces = model.comm.gather(piece, root=0) or [tuple(array[:0] for array in piece)]
    number, x, displacement, cells, types, region = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    points, values = np.zeros((2, number.max(initial=-1) + 1, 3))
    points[number] = x
    values[number, : joint.dim] = displacement
    return Grid(joint.dim, points, values, cells, types, region, *_base(joint))


def _orient(points: npt.NDArray[np.float64], cells: npt.NDArray[np.int64]) -> None:
    """Turn tetrahedra (n, 4 or 10) right-handed, in place: VTK takes inner faces of others for outer ones."""
    corners = points[cells[:, :4]]
    left = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    cells[left] = cells[left][:, MIRRORED[: cells.shape[1]]]


def _base(joint: Joint) -> tuple[npt.NDArray[np.float64], int]:
    """Facets of the rigid base, (n, k, 3) in VTK's order of nodes, and their VTK type."""
    kind = FACET_TYPES[joint.cell_type]
    names = joint.base_seams if joint.band is None else (BASE,) if BASE in joint.facets else ()
    if not names:
        return np.empty((0, joint.dim, 3)), VTK_LAGRANGE[kind]
    rows = np.unique(joint.table.index(np.concatenate([joint.facets[name] for name in names])))
    nodes = joint.table.nodes(rows, joint.cells, joint.cell_type)
    order = np.argsort(dolfinx.cpp.io.perm_vtk(dolfinx.mesh.to_type(kind), nodes.shape[1]))
    facets = joint.points[nodes[:, order]]
    return np.pad(facets, ((0, 0), (0, 0), (0, 3 - joint.dim))), VTK_LAGRANGE[kind]


def write(solution: State | History, path: str | Path) -> None:
    """Write displacements for ParaView: VTX for a path that ends in .bp, VTK for .pvd. Collective.

    The jump is kept: nodes on S are written once for each side. Of a history all states that it keeps are written.

    Raises:
        ModelError: no state, no name of a file, or another ending.
        RuntimeError: this DOLFINx has no ADIOS2, which VTX needs.
        OSError: the files could not be written; on all ranks.
    """
    comm = solution.model.comm if isinstance(solution, (State, History)) else world()
    with on_all(comm):
        states = _states(solution)
        if not isinstance(path, (str, Path)):
            raise ModelError(f"fields are written to a file, not to {path!r}; give its name, which ends in .bp or .pvd")
        suffix = Path(path).suffix
        if suffix not in (".bp", ".pvd"):
            raise ModelError(f"cannot write {str(path)!r}; allowed endings: .bp (VTX), .pvd (VTK)")
        if suffix == ".bp" and not dolfinx.has_adios2:
            raise ModelError("VTX needs a DOLFINx with ADIOS2; write a .pvd file instead")
    require_same(comm, models=states[0].model.mark, states=[state.t for state in states], path=str(path))
    u = nodal_displacement(states[0])
    nodes, meshes = u.function_space.dofmap.index_map.size_global, 1 if suffix == ".bp" else len(states)
    size = BYTES["mesh"] * nodes * meshes + BYTES["u"] * nodes * len(states)
    on_root(comm, lambda: _make_room(Path(path), size))
    problem = None
    try:
        with dolfinx.io.VTXWriter(comm, path, [u]) if suffix == ".bp" else dolfinx.io.VTKFile(comm, path, "w") as file:
            for state in states:
                u.x.array[:] = nodal_displacement(state).x.array
                if suffix == ".bp":
                    file.write(state.t)
                else:
                    file.write_function(u, state.t)
    except Exception as error:
        problem = f"{type(error).__name__}: {error}"
    if problem := next(filter(None, comm.allgather(problem)), None):
        raise OSError(f"{path} could not be written: {problem}")
    on_root(comm, lambda: _require_whole(Path(path)))


def _states(solution: State | History) -> list[State]:
    """The states to write."""
    if not isinstance(solution, (State, History)):
        raise ModelError(
            f"fields are written of a state or a history, as solve and march return them, not of {solution!r}"
        )
    states = [solution] if isinstance(solution, State) else list(solution)
    if not states:
        raise ModelError(f"there is nothing to write: {solution!r} has no state")
    return states


def _make_room(path: Path, size: int) -> None:
    """Make the folder of files of about this size; raises OSError where they cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(path.parent).free < size or not os.access(path.parent, os.W_OK):
        raise OSError(errno.ENOSPC, "the disk is full, or not to be written", str(path))
    if path.suffix == ".pvd":
        path.open("ab").close()
    elif path.exists() and not path.is_dir():
        raise FileExistsError(errno.EEXIST, "there is a file of this name, not a folder of a writer", str(path))


def _require_whole(path: Path) -> None:
    """Raise OSError unless all files of a .pvd end as they should: its writer does not notice a full disk."""
    if path.suffix != ".pvd":
        return
    names = re.findall(r'(?:file|Source)="([^"]*)"', _whole(path))
    for name in names:
        found = _whole(path.parent / name)
        names += re.findall(r'Source="([^"]*)"', found) if name.endswith(".pvtu") else []


def _whole(path: Path) -> str:
    """The text of a VTK file, but for a large one's, which is not looked for names."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(end - 100, 0))
        if not file.read().rstrip().endswith(b"</VTKFile>"):
            raise OSError(errno.EIO, "the file is not whole", str(path))
        file.seek(0)
        return "" if path.suffix == ".vtu" else file.read().decode()
