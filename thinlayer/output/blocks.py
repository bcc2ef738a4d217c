"""Blocks of a state for ParaView, on rank 0: bodies, meshed layers and S, with all that is known there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pyvista
from mpi4py import MPI
from vtkmodules.vtkCommonCore import vtkStringArray

from forms.base import Array
from geometry.joint import Joint
from geometry.topology import BoolArray, IntArray, lagrange
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import CONTACT_STATUSES, NO_CONTACT_STATUS, contact_values
from thinlayer.output.grid import VtkGrid, gather_grid, vtk_order, vtk_type
from thinlayer.output.surface import STATUSES, Surface
from thinlayer.output.tractions import LawPoints, law_points

BODIES_BLOCK, LAYER_BLOCK, SURFACE_BLOCK = "bodies", "layer", "S"
VTK_TENSOR_ORDER = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])  # XX, YY, ZZ, XY, YZ, XZ: the order in which VTK names six
STRESS, VON_MISES = "stress", "von Mises"
VTK_POLY_LINE = 4  # of VTK: straight between its nodes; ParaView does not integrate over curved lines
CONTACT_CODES = {NO_CONTACT_STATUS: -1} | {name: code for code, name in enumerate(CONTACT_STATUSES)}
STATUS_CODES = {name: code for code, name in enumerate(STATUSES)}
RESERVED_FIELDS = (
    "u",
    STRESS,
    VON_MISES,
    "region",
    "seam",
    "status",
    "traction",
    "jump",
)  # no names of internal variables


def blocks(state: State, model: InterfaceModel | None) -> pyvista.MultiBlock | None:
    """The blocks "bodies", "layer" (a full model) and "S" (if a model is given); None on other ranks. Collective.

    Args:
        state: the state.
        model: the interface model, of the same joint, to whose S tractions and jumps are brought.
    """
    of_cells, of_facets = _cell_data(state)
    grid = gather_grid(state)
    on_s = None if model is None else _surface_block(state, model, of_facets)
    if grid is None:
        return None
    whole = _volume(state.model.domain.joint, grid, of_cells)
    out = pyvista.MultiBlock()
    out[BODIES_BLOCK] = _part(whole, grid.region >= 0)
    if (grid.region < 0).any():
        out[LAYER_BLOCK] = _part(whole, grid.region < 0)
    if on_s is not None:
        out[SURFACE_BLOCK] = on_s
    return out


def _cell_data(state: State) -> tuple[dict[str, Array], dict[str, Array]]:
    """Stresses and internal variables (means) of the cells, internal variables of the facets of S; on rank 0. Collective.

    A cell or facet whose law has no variable of a name has NaN there.
    """
    model, joint = state.model, state.model.domain.joint
    of_cells, of_facets = _Means(model.comm, np.arange(len(joint.cells))), _Means(model.comm, model.joint.surface_rows)
    through: dict[str, int] = {}  # number of terms so far, on S, of a layer: of order 1 it has two
    for points in law_points(state):
        if points.quadrature.region.dim == joint.dim:
            of_cells.add(points, STRESS, points.stress())
            for name, values in _named_variables(points.internal(), 0, several=False):
                of_cells.add(points, name, values)
            continue
        key = points.term.key
        several = sum(term.key == key for term in model.layer_terms) > 1
        for name, values in _named_variables(points.internal(), through.setdefault(key, 0), several=several):
            of_facets.add(points, name, values)
        through[key] += 1
    return of_cells.arrays, of_facets.arrays


def _named_variables(sublayers: list[dict[str, Array]], before: int, *, several: bool) -> Iterator[tuple[str, Array]]:
    """Names and values of internal variables; where a facet has several points of one name they are numbered from below."""
    for number, variables in enumerate(sublayers, before + 1):
        for name, values in variables.items():
            field_name = f"internal {name}" if name in RESERVED_FIELDS else name
            yield f"{field_name} {number}" if several or len(sublayers) > 1 else field_name, values


class _Means:
    """Means over entities of a joint, gathered on rank 0.

    Args:
        comm: communicator.
        numbers: (n,) numbers of the entities in the joint, ascending.

    Attributes:
        arrays: name -> (n, components), NaN where nothing was added; tensors have VTK's six components.
    """

    def __init__(self, comm: MPI.Intracomm, numbers: IntArray) -> None:
        self._comm, self._numbers = comm, numbers
        self.arrays: dict[str, Array] = {}

    def add(self, points: LawPoints, name: str, values: Array) -> None:
        """Add values (points, ...) to what is known of this name. Collective."""
        means = points.quadrature.means(values[:, *VTK_TENSOR_ORDER] if values.ndim == 3 else values)
        pieces = self._comm.gather((points.entities, means), root=0)
        if pieces is None:
            return
        entities, means = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
        at = np.searchsorted(self._numbers, entities)
        total = self.arrays.setdefault(name, np.full((len(self._numbers), *means.shape[1:]), np.nan))
        total[at] = np.where(np.isnan(total[at]), means, total[at] + means)  # several laws may share cells of junctions


def von_mises(stress: Array) -> Array:
    """(n,) equivalent stress of stresses (n, 6) in VTK's order."""
    normal, shear = stress[:, :3], stress[:, 3:]
    deviator = normal - normal.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(1.5 * ((deviator**2).sum(axis=1) + 2 * (shear**2).sum(axis=1))))


def _volume(joint: Joint, grid: VtkGrid, of_cells: Mapping[str, Array]) -> pyvista.UnstructuredGrid:
    """All cells with their data."""
    mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points)
    mesh.point_data["u"] = grid.u
    mesh.cell_data.update(of_cells)
    mesh.cell_data[VON_MISES] = von_mises(of_cells[STRESS])
    mesh.cell_data["region"] = joint.region
    _add_texts(mesh, "regions", joint.regions)
    if joint.band is not None:
        of_regions: dict[str, Any] = {name: seam for seam, names in joint.band.of_seam.items() for name in names}
        of_regions |= joint.band.junctions
        seams = list(joint.band.base.seams)
        numbers = [seams.index(of_regions[name]) if name in of_regions else -1 for name in joint.regions]
        mesh.cell_data["seam"] = np.array(numbers)[joint.region]
        _add_texts(mesh, "seams", seams)
    return mesh


def _part(mesh: pyvista.UnstructuredGrid, chosen: BoolArray) -> pyvista.UnstructuredGrid:
    """Some cells with their points and data; data that are NaN in all of them, which VTK cannot read, are left out."""
    part = mesh.extract_cells(np.flatnonzero(chosen))
    for name in ("vtkOriginalCellIds", "vtkOriginalPointIds"):
        part.point_data.pop(name, None)
        part.cell_data.pop(name, None)
    for name, values in list(part.cell_data.items()):
        if np.issubdtype(values.dtype, np.floating) and np.isnan(values).all():
            part.cell_data.pop(name)
    return part


# ---------------------------------------------------------------- S
def _surface_block(
    state: State, model: InterfaceModel, of_facets: Mapping[str, Array]
) -> pyvista.UnstructuredGrid | None:
    """The facets of S, in the joint's order; None on other ranks. Collective.

    Each facet has nodes of its own. Point data are "traction", "jump", "normal", "u_upper", "u_lower", their mean "u" (to
    warp S by), "t_N", "w_N", and "t_T", "w_T": in 2D the component along (n_2, -n_1), in 3D the vector in S; with contact
    laws "contact" (`CONTACT_CODES`, -1 where there is none) and the vector "slip". Facet data are "seam" (its
    position in the field "seams"), "status" (`STATUS_CODES`), and means of internal variables.

    Args:
        state: a state of the model, or of another one of the same joint, of whose laws nothing is told.
        model: an interface model.
        of_facets: name -> means (n_S, components), on rank 0.
    """
    joint, d, surface, same_model = model.joint, model.joint.dim, Surface(model), state.model is model
    lower, upper = surface.displacements(state)
    fields = {"x": surface.x, "n": surface.n, "traction": surface.traction(state), "upper": upper, "lower": lower}
    status = surface.status(state)[:, 0] if same_model else None
    contact = contact_values(surface, state) if same_model else {}
    if model.comm.rank:
        return None
    degree = max(joint.degree, model.structure.degree)
    # from values at the points of quadrature to those at the nodes: exact for polynomials of this degree
    to_nodes = np.linalg.pinv(lagrange(surface.kind, degree).tabulate(0, surface.points)[0, :, :, 0])
    at = {name: np.einsum("nq,dfq->fnd", to_nodes, f) for name, f in fields.items()}
    n, k = at["x"].shape[:2]
    kind, in_vtk = (
        (vtk_type(surface.kind, k), vtk_order(surface.kind, k)) if d == 3 else (VTK_POLY_LINE, np.r_[0, 2:k, 1])
    )
    cells = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)[:, in_vtk]]).ravel()
    block = pyvista.UnstructuredGrid(cells, np.full(n, kind), _three_components(at.pop("x")))
    block.point_data.update(_nodal_data(at, d))
    block.cell_data["seam"] = joint.seam_numbers
    _add_texts(block, "seams", joint.seams)
    if status is not None:
        block.cell_data["status"] = [STATUS_CODES[name] for name in status]
        block.field_data["status codes"] = _legend(STATUS_CODES)
    if contact:
        slip = np.einsum("mk,mkj->mj", contact["slip"], contact["frames"][:, :-1])
        codes = np.array([CONTACT_CODES[name] for name in contact["status"]])
        at_corners = lagrange(surface.kind, 1).tabulate(0, lagrange(surface.kind, degree).points)[0, :, :, 0]
        codes = codes[surface.nodes][:, at_corners.argmax(axis=1)]  # of nodes between corners, that of one of these
        slip = at_corners @ slip[surface.nodes]
        slip[codes < 0] = np.nan
        block.point_data.update({"contact": codes.ravel(), "slip": _three_components(slip)})
        block.field_data["contact codes"] = _legend(CONTACT_CODES)
    block.cell_data.update(of_facets)
    return block


def _add_texts(mesh: pyvista.UnstructuredGrid, name: str, texts: Iterable[str]) -> None:
    """Give the mesh a field of texts in any language; pyvista itself takes ASCII alone."""
    array = vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(text)
    mesh.GetFieldData().AddArray(array)


def _legend(codes: Mapping[str, int]) -> list[str]:
    return [f"{code} {name}" for name, code in sorted(codes.items(), key=lambda item: item[1])]


def _three_components(values: Array) -> Array:
    """Vectors (n, k, d) as (n k, 3)."""
    flat = values.reshape(-1, values.shape[-1])
    return np.pad(flat, ((0, 0), (0, 3 - flat.shape[1])))


def _nodal_data(at: Mapping[str, Array], d: int) -> dict[str, Array]:
    """Point data from values (facets, nodes, d)."""
    t, upper, lower = at["traction"], at["upper"], at["lower"]
    n = at["n"] / np.linalg.norm(at["n"], axis=2, keepdims=True)
    jump = upper - lower
    data = {"traction": t, "jump": jump, "normal": n, "u": (upper + lower) / 2, "u_upper": upper, "u_lower": lower}
    fields = {name: _three_components(values) for name, values in data.items()}
    for name, vector in (("t", t), ("w", jump)):
        along_n = np.einsum("fki,fki->fk", vector, n)
        tangential = vector - along_n[..., None] * n
        fields[f"{name}_N"] = along_n.ravel()
        signed = n[..., 1] * vector[..., 0] - n[..., 0] * vector[..., 1]
        fields[f"{name}_T"] = signed.ravel() if d == 2 else _three_components(tangential)
    return fields
