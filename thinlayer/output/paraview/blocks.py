"""VTK blocks of a state for ParaView, on rank 0: bodies, meshed layers and S, with all their arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
import pyvista
from vtkmodules.vtkCommonCore import vtkStringArray

from forms.base import Array
from geometry.joint import Joint
from geometry.topology import BoolArray, IntArray, lagrange
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import CONTACT_STATUSES, NO_CONTACT_STATUS, contact_values
from thinlayer.output.paraview.grid import VtkGrid, gather_grid, vtk_order, vtk_type
from thinlayer.output.surface import Surface, all_statuses
from thinlayer.surface.law_points import LawPoints, law_points

BODIES_BLOCK, LAYER_BLOCK, SURFACE_BLOCK = "bodies", "layer", "S"
VTK_TENSOR_ORDER = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])  # VTK's order of symmetric tensors: XX, YY, ZZ, XY, YZ, XZ
STRESS, VON_MISES = "stress", "von Mises"
POLY_LINE = 4  # VTK cell type, straight between nodes, as ParaView does not integrate over curved lines
CONTACT_CODES = {NO_CONTACT_STATUS: -1} | {name: code for code, name in enumerate(CONTACT_STATUSES)}
# names of arrays; internal variables with these names get the prefix "internal"
RESERVED_ARRAYS = ("u", STRESS, VON_MISES, "region", "seam", "status", "traction", "jump")


def blocks(state: State, model: InterfaceModel | None) -> pyvista.MultiBlock | None:
    """Convert a state to the VTK blocks "bodies", "layer" and "S", on rank 0; other ranks return None. Collective.

    Args:
        state: the state. Only a full model, whose layer is meshed, has a block "layer".
        model: interface model of the same joint, on whose S tractions and jumps are evaluated; None: no block "S".
    """
    of_cells, of_facets = _cell_data(state)
    grid = gather_grid(state)
    on_s = None if model is None else _surface_block(state, model, of_facets)
    if grid is None:
        return None
    whole = _volume(state.model.domain.joint, grid, of_cells)
    layer = _part(whole, grid.region < 0) if (grid.region < 0).any() else None
    parts = {BODIES_BLOCK: _part(whole, grid.region >= 0), LAYER_BLOCK: layer, SURFACE_BLOCK: on_s}
    return pyvista.MultiBlock({name: part for name, part in parts.items() if part is not None})


def _cell_data(state: State) -> tuple[dict[str, Array], dict[str, Array]]:
    """Compute means of stresses and internal variables over cells, and of internal variables over facets of S.

    Collective. A value is NaN where the law of a cell or facet has no variable of this name.

    Returns:
        Two dictionaries, for the cells and for the facets of S, which are empty except on rank 0. Each maps the name of
        a VTK array to its values, ordered as the joint numbers its cells or facets.
    """
    model, joint = state.model, state.model.domain.joint
    of_cells, of_facets = dict[str, Array](), dict[str, Array]()
    through = Counter[str]()  # number of terms of each layer on S so far; a layer of order 1 has two
    for points in law_points(state):
        if points.quadrature.region.dim == joint.dim:
            variables = {STRESS: points.stress()} | _named_variables(points.internal())
            _add_means(of_cells, np.arange(len(joint.cells)), points, variables)
        else:
            key = points.term.key
            several = sum(term.key == key for term in model.layer_terms) > 1
            variables = _named_variables(points.internal(), through[key], several=several)
            _add_means(of_facets, model.joint.surface_rows, points, variables)
            through[key] += 1
    return of_cells, of_facets


def _named_variables(sublayers: list[dict[str, Array]], before: int = 0, *, several: bool = False) -> dict[str, Array]:
    """Name VTK arrays of internal variables: "plastic" or, with several points through the thickness, "plastic 1", ...

    Args:
        sublayers: for each sublayer of a law, from the lower to the upper face, name of a variable -> values.
        before: how many points through the thickness lie below these sublayers; numbers start at `before` + 1.
        several: whether names are numbered although the law has only one sublayer, as other laws act at further points
            through the thickness.

    Returns:
        Name of a VTK array -> values.
    """
    named: dict[str, Array] = {}
    for number, variables in enumerate(sublayers, before + 1):
        for name, values in variables.items():
            array_name = f"internal {name}" if name in RESERVED_ARRAYS else name
            named[f"{array_name} {number}" if several or len(sublayers) > 1 else array_name] = values
    return named


def _add_means(arrays: dict[str, Array], numbers: IntArray, points: LawPoints, fields: Mapping[str, Array]) -> None:
    """Add the means of a law's fields over each of its cells or facets to `arrays`, on rank 0. Collective.

    Args:
        arrays: name of a VTK array -> (n, components) means over n cells or facets, NaN where no law has given a value.
            Tensors have the six components XX, YY, ZZ, XY, YZ, XZ. Changed on rank 0.
        numbers: (n,) numbers of these cells or facets in the joint, ascending.
        points: quadrature points of the law, which acts in some of these cells or facets.
        fields: name of a VTK array -> values at the quadrature points, (points,) or (points, 3, 3).
    """
    for name, values in fields.items():
        means = points.quadrature.means(values[:, *VTK_TENSOR_ORDER] if values.ndim == 3 else values)
        if pieces := points.state.model.comm.gather((points.entities, means), root=0):
            entities, means = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
            at = np.searchsorted(numbers, entities)
            total = arrays.setdefault(name, np.full((len(numbers), *means.shape[1:]), np.nan))
            total[at] = np.where(np.isnan(total[at]), means, total[at] + means)  # laws may share cells of junctions


def von_mises(stress: Array) -> Array:
    """Return the von Mises equivalent stresses (n,) of n stresses (n, 6) with the components XX, YY, ZZ, XY, YZ, XZ."""
    normal, shear = stress[:, :3], stress[:, 3:]
    deviator = normal - normal.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(1.5 * ((deviator**2).sum(axis=1) + 2 * (shear**2).sum(axis=1))))


def _volume(joint: Joint, grid: VtkGrid, of_cells: Mapping[str, Array]) -> pyvista.UnstructuredGrid:
    """Make the VTK grid of all cells of bodies and meshed layers, with displacements and data of cells.

    Args:
        joint: the joint, whose names of regions and seams are added as well.
        grid: cells, nodes and displacements.
        of_cells: name of a VTK array -> values (cells, components), among them "stress"; "von Mises" is computed from
            it.
    """
    mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points)
    mesh.point_data["u"] = grid.u
    mesh.cell_data.update(of_cells)
    mesh.cell_data[VON_MISES] = von_mises(of_cells[STRESS])
    mesh.cell_data["region"] = joint.region
    _add_texts(mesh, "regions", joint.regions)
    if joint.band is not None:
        of_regions = {name: seam for seam, names in joint.band.of_seam.items() for name in names}
        of_regions |= joint.band.junctions
        seams = list(joint.band.base.seams)
        numbers = [seams.index(of_regions[name]) if name in of_regions else -1 for name in joint.regions]
        mesh.cell_data["seam"] = np.array(numbers)[joint.region]
        _add_texts(mesh, "seams", seams)
    return mesh


def _part(mesh: pyvista.UnstructuredGrid, chosen: BoolArray) -> pyvista.UnstructuredGrid:
    """Return the cells of `mesh` for which `chosen` is True, with their data, as a new VTK grid.

    Arrays of cell data are left out if all their values in these cells are NaN: the variable does not exist there.
    """
    part = mesh.extract_cells(np.flatnonzero(chosen))
    part.point_data.pop("vtkOriginalPointIds")
    part.cell_data.pop("vtkOriginalCellIds")
    for name, values in list(part.cell_data.items()):
        if np.issubdtype(values.dtype, np.floating) and np.isnan(values).all():
            part.cell_data.pop(name)
    return part


# ---------------------------------------------------------------- S
def _surface_block(state: State, model: InterfaceModel, means: Mapping[str, Array]) -> pyvista.UnstructuredGrid | None:
    """Make the VTK grid of the facets of S, in the joint's order, on rank 0; other ranks return None. Collective.

    Each facet has its own nodes. Point data are "traction", "jump", "normal", the displacements "u_upper" and "u_lower"
    of both sides, and their mean "u", by which ParaView can warp S. "t_N" and "w_N" are the normal components of
    traction and jump. "t_T" and "w_T" are their tangential parts: in 2D the component along (n_2, -n_1), in 3D the
    vector in S. With contact laws there are also "contact", a code of `CONTACT_CODES`, and the vector "slip".
    Facet data are "seam", the seam's number, "status", a code, and means of internal variables. Texts in the grid's
    field data explain the numbers and codes.

    Args:
        state: a state of the model, or of another model of the same joint. In the second case statuses and contact data
            are left out.
        model: an interface model.
        means: name of a VTK array -> (facets, components) means of an internal variable; empty except on rank 0.
    """
    joint, d, surface, same_model = model.joint, model.joint.dim, Surface(model), state.model is model
    lower, upper = surface.displacements(state)
    on_s = {"x": surface.x, "n": surface.n, "traction": surface.traction(state), "upper": upper, "lower": lower}
    status = surface.status(state)[:, 0] if same_model else None
    contact = contact_values(surface, state) if same_model else {}
    if model.comm.rank:
        return None
    degree = max(joint.degree, model.structure.degree)
    # extrapolation from quadrature points to nodes, exact for polynomials of this degree
    to_nodes = np.linalg.pinv(lagrange(surface.kind, degree).tabulate(0, surface.points)[0, :, :, 0])
    at = {name: np.einsum("nq,dfq->fnd", to_nodes, f) for name, f in on_s.items()}
    n, k = at["x"].shape[:2]
    kind, order = (vtk_type(surface.kind, k), vtk_order(surface.kind, k)) if d == 3 else (POLY_LINE, np.r_[0, 2:k, 1])
    cells = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)[:, order]]).ravel()
    block = pyvista.UnstructuredGrid(cells, np.full(n, kind), _three_components(at.pop("x")))
    block.point_data.update(_nodal_data(at, d))
    block.cell_data["seam"] = joint.seam_numbers
    _add_texts(block, "seams", joint.seams)
    if status is not None:
        status_codes = {name: code for code, name in enumerate(all_statuses(model))}
        block.cell_data["status"] = [status_codes[name] for name in status]
        block.field_data["status codes"] = _legend(status_codes)
    if contact:
        slip = np.einsum("mk,mkj->mj", contact["slip"], contact["frames"][:, :-1])
        codes = np.array([CONTACT_CODES[name] for name in contact["status"]])
        at_corners = lagrange(surface.kind, 1).tabulate(0, lagrange(surface.kind, degree).points)[0, :, :, 0]
        codes = codes[surface.nodes][:, at_corners.argmax(axis=1)]  # a node between corners has the code of one corner
        slip = at_corners @ slip[surface.nodes]
        slip[codes < 0] = np.nan
        block.point_data.update({"contact": codes.ravel(), "slip": _three_components(slip)})
        block.field_data["contact codes"] = _legend(CONTACT_CODES)
    block.cell_data.update(means)
    return block


def _add_texts(mesh: pyvista.UnstructuredGrid, name: str, texts: Iterable[str]) -> None:
    """Add `texts` to a mesh as VTK field data called `name`; unlike in pyvista, non-ASCII characters are allowed."""
    array = vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(text)
    mesh.GetFieldData().AddArray(array)


def _legend(codes: Mapping[str, int]) -> list[str]:
    return [f"{code} {name}" for name, code in sorted(codes.items(), key=lambda item: item[1])]


def _three_components(values: Array) -> Array:
    """Return the vectors `values` (n, k, d) as an array (n k, 3), where missing components are zero."""
    flat = values.reshape(-1, values.shape[-1])
    return np.pad(flat, ((0, 0), (0, 3 - flat.shape[1])))


def _nodal_data(at: Mapping[str, Array], d: int) -> dict[str, Array]:
    """Compute the VTK point data of S that `_surface_block` lists, from fields at the nodes of each facet.

    Args:
        at: name -> vectors (facets, nodes, d): "traction"; "upper" and "lower", the displacements of both sides; "n",
            the normal, whose length need not be 1.
        d: number of dimensions.

    Returns:
        Name of a VTK array -> its values, (facets * nodes,) or (facets * nodes, 3).
    """
    t, upper, lower = at["traction"], at["upper"], at["lower"]
    n = at["n"] / np.linalg.norm(at["n"], axis=2, keepdims=True)
    jump = upper - lower
    data = {"traction": t, "jump": jump, "normal": n, "u": (upper + lower) / 2, "u_upper": upper, "u_lower": lower}
    arrays = {name: _three_components(values) for name, values in data.items()}
    for name, vector in (("t", t), ("w", jump)):
        along_n = np.einsum("fki,fki->fk", vector, n)
        tangential = vector - along_n[..., None] * n
        arrays[f"{name}_N"] = along_n.ravel()
        signed = n[..., 1] * vector[..., 0] - n[..., 0] * vector[..., 1]
        arrays[f"{name}_T"] = signed.ravel() if d == 2 else _three_components(tangential)
    return arrays
