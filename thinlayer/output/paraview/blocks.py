"""VTK blocks of a state for ParaView, on rank 0: bodies, meshed layers and S, with all their arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np
import pyvista
from vtkmodules.vtkCommonCore import vtkStringArray

from forms.base import Array
from forms.kinematics import QuantityNames
from forms.tensors import scalar_gradients
from geometry.joint import Joint
from geometry.topology import BoolArray, IntArray, lagrange
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import CONTACT_STATUSES, NO_CONTACT_STATUS, contact_values
from thinlayer.output.paraview.grid import VtkGrid, gather_grid, vtk_code, vtk_perm
from thinlayer.output.surface import Surface, all_statuses
from thinlayer.surface.law_points import LawPoints, law_points

BODIES_BLOCK, LAYER_BLOCK, SURFACE_BLOCK = "bodies", "layer", "S"
VTK_TENSOR_PAIRS = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])  # VTK's order of symmetric tensors: XX, YY, ZZ, XY, YZ, XZ
STRESS_ARRAY, VON_MISES_ARRAY = "stress", "von Mises"
LINE_CODE = 4  # VTK cell type, straight between nodes, as ParaView does not integrate over curved lines
CONTACT_CODES = {NO_CONTACT_STATUS: -1} | {name: code for code, name in enumerate(CONTACT_STATUSES)}
# names of arrays; internal variables with these names get the prefix "internal"
RESERVED_NAMES = ("u", "T", "flux", STRESS_ARRAY, VON_MISES_ARRAY, "region", "seam", "status", "traction", "jump")


def make_vtk_blocks(state: State, model: InterfaceModel | None) -> pyvista.MultiBlock | None:
    """Convert a state to the VTK blocks "bodies", "layer" and "S", on rank 0; other ranks return None. Collective.

    Args:
        state: the state. Only a full model, whose layer is meshed, has a block "layer".
        model: interface model of the same joint, on whose S tractions and jumps are evaluated; None: no block "S".
    """
    cell_arrays, facet_arrays = _cell_and_facet_arrays(state)
    grid = gather_grid(state)
    s_grid = None if model is None else _make_s_grid(state, model, facet_arrays)
    if grid is None:
        return None
    all_cells = _make_volume_grid(state.model.domain.joint, grid, cell_arrays)
    layer_grid = _extract_cells(all_cells, grid.region < 0) if (grid.region < 0).any() else None
    grids = {BODIES_BLOCK: _extract_cells(all_cells, grid.region >= 0), LAYER_BLOCK: layer_grid, SURFACE_BLOCK: s_grid}
    return pyvista.MultiBlock({name: block for name, block in grids.items() if block is not None})


def _cell_and_facet_arrays(state: State) -> tuple[dict[str, Array], dict[str, Array]]:
    """Compute means of stresses (or fluxes) and internal variables over cells, and of the latter over facets of S.

    Collective. A value is NaN where the law of a cell or facet has no variable of this name.

    Returns:
        Two dictionaries, for the cells and for the facets of S, which are empty except on rank 0. Each maps the name of
        a VTK array to its values, ordered as the joint numbers its cells or facets.
    """
    model, joint = state.model, state.model.domain.joint
    cell_arrays, facet_arrays = dict[str, Array](), dict[str, Array]()
    n_terms_below = Counter[str]()  # number of terms of each layer on S so far; a layer of order 1 has two
    for points in law_points(state):
        if points.quadrature.region.dim == joint.dim:
            stress, name = points.stress(), model.kinematics.quantities.stress
            variables = {name: scalar_gradients(stress) if model.n_components == 1 else stress}
            variables |= _named_arrays(points.internal())
            _add_means(cell_arrays, np.arange(len(joint.cells)), points, variables)
        else:
            key = points.term.key
            is_numbered = sum(term.key == key for term in model.layer_terms) > 1
            variables = _named_arrays(points.internal(), n_terms_below[key], numbered=is_numbered)
            _add_means(facet_arrays, model.joint.surface_rows, points, variables)
            n_terms_below[key] += 1
    return cell_arrays, facet_arrays


def _named_arrays(sublayers: list[dict[str, Array]], n_below: int = 0, *, numbered: bool = False) -> dict[str, Array]:
    """Name VTK arrays of internal variables: "plastic" or, with several points through the thickness, "plastic 1", ...

    Args:
        sublayers: for each sublayer of a law, from the lower to the upper face, name of a variable -> values.
        n_below: how many points through the thickness lie below these sublayers; numbers start at `n_below` + 1.
        numbered: whether names are numbered although the law has only one sublayer, as other laws act at further points
            through the thickness.

    Returns:
        Name of a VTK array -> values.
    """
    arrays: dict[str, Array] = {}
    for number, variables in enumerate(sublayers, n_below + 1):
        for name, values in variables.items():
            array_name = f"internal {name}" if name in RESERVED_NAMES else name
            arrays[f"{array_name} {number}" if numbered or len(sublayers) > 1 else array_name] = values
    return arrays


def _add_means(arrays: dict[str, Array], entity_ids: IntArray, points: LawPoints, fields: Mapping[str, Array]) -> None:
    """Add the means of a law's fields over each of its cells or facets to `arrays`, on rank 0. Collective.

    Args:
        arrays: name of a VTK array -> (n, components) means over n cells or facets, NaN where no law has given a value.
            Tensors have the six components XX, YY, ZZ, XY, YZ, XZ. Changed on rank 0.
        entity_ids: (n,) numbers of these cells or facets in the joint, ascending.
        points: quadrature points of the law, which acts in some of these cells or facets.
        fields: name of a VTK array -> values at the quadrature points, (points,), (points, 3) or (points, 3, 3).
    """
    for name, values in fields.items():
        means = points.quadrature.cell_means(values[:, *VTK_TENSOR_PAIRS] if values.ndim == 3 else values)
        if pieces := points.state.model.comm.gather((points.quadrature.entity_numbers, means), root=0):
            entities, means = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
            rows = np.searchsorted(entity_ids, entities)
            sums = arrays.setdefault(name, np.full((len(entity_ids), *means.shape[1:]), np.nan))
            sums[rows] = np.where(np.isnan(sums[rows]), means, sums[rows] + means)  # laws may share cells of junctions


def von_mises(stress: Array) -> Array:
    """Return the von Mises equivalent stresses (n,) of n stresses (n, 6) with the components XX, YY, ZZ, XY, YZ, XZ."""
    normal, shear = stress[:, :3], stress[:, 3:]
    deviator = normal - normal.mean(axis=1, keepdims=True)
    return np.asarray(np.sqrt(1.5 * ((deviator**2).sum(axis=1) + 2 * (shear**2).sum(axis=1))))


def _make_volume_grid(joint: Joint, grid: VtkGrid, cell_arrays: Mapping[str, Array]) -> pyvista.UnstructuredGrid:
    """Make the VTK grid of all cells of bodies and meshed layers, with the unknown and data of cells.

    Args:
        joint: the joint, whose names of regions and seams are added as well.
        grid: cells, nodes and displacements.
        cell_arrays: name of a VTK array -> values (cells, components); "von Mises" is computed from "stress".
    """
    mesh = pyvista.UnstructuredGrid(grid.cells, grid.cell_codes, grid.points)
    mesh.point_data[grid.symbol] = grid.u if grid.value is None else grid.value
    mesh.cell_data.update(cell_arrays)
    if STRESS_ARRAY in cell_arrays:
        mesh.cell_data[VON_MISES_ARRAY] = von_mises(cell_arrays[STRESS_ARRAY])
    mesh.cell_data["region"] = joint.region
    _add_texts(mesh, "regions", joint.regions)
    if joint.band is not None:
        seam_of_region = {name: seam for seam, names in joint.band.regions_of_seam.items() for name in names}
        seam_of_region |= joint.band.junctions
        seams = list(joint.band.drawn_joint.seams)
        seam_numbers = [seams.index(seam_of_region[name]) if name in seam_of_region else -1 for name in joint.regions]
        mesh.cell_data["seam"] = np.array(seam_numbers)[joint.region]
        _add_texts(mesh, "seams", seams)
    return mesh


def _extract_cells(mesh: pyvista.UnstructuredGrid, is_chosen: BoolArray) -> pyvista.UnstructuredGrid:
    """Return the cells of `mesh` for which `is_chosen` is True, with their data, as a new VTK grid.

    Arrays of cell data are left out if all their values in these cells are NaN: the variable does not exist there.
    """
    extracted = mesh.extract_cells(np.flatnonzero(is_chosen))
    extracted.point_data.pop("vtkOriginalPointIds")
    extracted.cell_data.pop("vtkOriginalCellIds")
    for name, values in list(extracted.cell_data.items()):
        if np.issubdtype(values.dtype, np.floating) and np.isnan(values).all():
            extracted.cell_data.pop(name)
    return extracted


# ---------------------------------------------------------------- S
def _make_s_grid(state: State, model: InterfaceModel, means: Mapping[str, Array]) -> pyvista.UnstructuredGrid | None:
    """Make the VTK grid of the facets of S, in the joint's order, on rank 0; other ranks return None. Collective.

    Each facet has its own nodes. `writer.write` lists the data of nodes and facets. Codes of contact statuses are those
    of `CONTACT_CODES`.

    Args:
        state: a state of the model, or of another model of the same joint. In the second case statuses and contact data
            are left out.
        model: an interface model.
        means: name of a VTK array -> (facets, components) means of an internal variable; empty except on rank 0.
    """
    joint, d, surface, is_same_model = model.joint, model.joint.dim, Surface(model), state.model is model
    lower, upper = surface.displacements(state)
    fields = {"x": surface.x, "n": surface.n, "traction": surface.traction(state), "upper": upper, "lower": lower}
    status = surface.status(state)[:, 0] if is_same_model else None
    contact = contact_values(surface, state) if is_same_model else {}
    if model.comm.rank:
        return None
    degree = max(joint.degree, model.structure.degree)
    # extrapolation from quadrature points to nodes, exact for polynomials of this degree
    extrapolation = np.linalg.pinv(lagrange(surface.kind, degree).tabulate(0, surface.points)[0, :, :, 0])
    nodal_fields = {name: np.einsum("nq,dfq->fnd", extrapolation, f) for name, f in fields.items()}
    n, k = nodal_fields["x"].shape[:2]
    code, perm = (vtk_code(surface.kind, k), vtk_perm(surface.kind, k)) if d == 3 else (LINE_CODE, np.r_[0, 2:k, 1])
    cells = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)[:, perm]]).ravel()
    block = pyvista.UnstructuredGrid(cells, np.full(n, code), _pad_to_3d(nodal_fields.pop("x")))
    block.point_data.update(_nodal_arrays(nodal_fields, model.kinematics.quantities))
    block.cell_data["seam"] = joint.seam_numbers
    _add_texts(block, "seams", joint.seams)
    if status is not None:
        status_codes = {name: code for code, name in enumerate(all_statuses(model))}
        block.cell_data["status"] = [status_codes[name] for name in status]
        block.field_data["status codes"] = _code_texts(status_codes)
    if contact:
        slip = np.einsum("mk,mkj->mj", contact["slip"], contact["frames"][:, :-1])
        codes = np.array([CONTACT_CODES[name] for name in contact["status"]])
        shapes = lagrange(surface.kind, 1).tabulate(0, lagrange(surface.kind, degree).points)[0, :, :, 0]
        codes = codes[surface.nodes][:, shapes.argmax(axis=1)]  # a node between corners has the code of one corner
        slip = shapes @ slip[surface.nodes]
        slip[codes < 0] = np.nan
        block.point_data.update({"contact": codes.ravel(), "slip": _pad_to_3d(slip)})
        block.field_data["contact codes"] = _code_texts(CONTACT_CODES)
    block.cell_data.update(means)
    return block


def _add_texts(mesh: pyvista.UnstructuredGrid, name: str, texts: Iterable[str]) -> None:
    """Add `texts` to a mesh as VTK field data called `name`; unlike in pyvista, non-ASCII characters are allowed."""
    array = vtkStringArray()
    array.SetName(name)
    for text in texts:
        array.InsertNextValue(text)
    mesh.GetFieldData().AddArray(array)


def _code_texts(codes: Mapping[str, int]) -> list[str]:
    return [f"{code} {name}" for name, code in sorted(codes.items(), key=lambda item: item[1])]


def _pad_to_3d(values: Array) -> Array:
    """Return the vectors `values` (n, k, d) as an array (n k, 3), where missing components are zero."""
    flat = values.reshape(-1, values.shape[-1])
    return np.pad(flat, ((0, 0), (0, 3 - flat.shape[1])))


def _nodal_arrays(fields: Mapping[str, Array], names: QuantityNames) -> dict[str, Array]:
    """Compute the VTK point data of S, which `writer.write` lists, from fields at the nodes of each facet.

    Args:
        fields: name -> vectors (facets, nodes, c): "traction"; "upper" and "lower", the displacements of both sides;
            and of length d "n", the normal, whose length need not be 1.
        names: names of the unknown's quantities.

    Returns:
        Name of a VTK array -> its values, (facets * nodes,) or (facets * nodes, 3).
    """
    t, upper, lower = fields["traction"], fields["upper"], fields["lower"]
    n = fields["n"] / np.linalg.norm(fields["n"], axis=2, keepdims=True)
    jump, u, d = upper - lower, names.symbol, n.shape[2]
    vectors = {names.traction: t, "jump": jump, u: (upper + lower) / 2, f"{u}_upper": upper, f"{u}_lower": lower}
    if t.shape[2] == 1:
        return {name: values.ravel() for name, values in vectors.items()} | {"normal": _pad_to_3d(n)}
    arrays = {name: _pad_to_3d(values) for name, values in (vectors | {"normal": n}).items()}
    for name, vector in (("t", t), ("w", jump)):
        along_n = np.einsum("fki,fki->fk", vector, n)
        tangential = vector - along_n[..., None] * n
        arrays[f"{name}_N"] = along_n.ravel()
        along_tangent = n[..., 1] * vector[..., 0] - n[..., 0] * vector[..., 1]
        arrays[f"{name}_T"] = along_tangent.ravel() if d == 2 else _pad_to_3d(tangential)
    return arrays
