"""S as a block for ParaView: facets with tractions, jumps, displacements of both sides, and what laws remember there."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pyvista

from forms.contact import Status
from geometry.joint import Joint
from geometry.topology import lagrange
from thinlayer.discretisation.contact_nodes import pair_numbers
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.output.contact_report import NAMES, PINNED, ContactReport
from thinlayer.output.layer_report import STATUSES, LayerReport
from thinlayer.output.surface import Surface
from thinlayer.output.vtk_cells import vtk_order, vtk_type

Array = npt.NDArray[np.float64]
NO_CONTACT = -1
POLY_LINE = 4  # of VTK: straight between its nodes; ParaView does not integrate over curved lines
CONTACT_CODES = {**{name: int(code) for code, name in NAMES.items()}, PINNED: max(map(int, Status)) + 1}
STATUS_CODES = {name: code for code, name in enumerate(STATUSES)}
FIELDS = ("x", "n", "traction", "upper", "lower")


def surface_block(
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
    joint, d, surface = model.joint, model.joint.dim, Surface(model)
    lower, upper = surface.displacements(state)
    fields = dict(zip(FIELDS, (surface.x, surface.n, surface.traction(state), upper, lower), strict=True))
    degree = max(joint.degree, model.structure.degree)
    # from values at the points of quadrature to those at the nodes: exact for polynomials of this degree
    to_nodes = np.linalg.pinv(lagrange(surface.kind, degree).tabulate(0, surface.points)[0, :, :, 0])
    at = {name: np.einsum("nq,dfq->fnd", to_nodes, f) for name, f in fields.items()}
    own = state.model is model
    contacts = {name: ContactReport(state, name) for name in model.contacts if own}
    status = {name: LayerReport(state, name).status for name in joint.seams if own and name not in contacts}
    if model.comm.rank:
        return None
    n, k = at["x"].shape[:2]
    kind, in_vtk = (
        (POLY_LINE, [0, *range(2, k), 1]) if d == 2 else (vtk_type(surface.kind, k), vtk_order(surface.kind, k))
    )
    cells = np.column_stack([np.full(n, k), np.arange(n * k).reshape(n, k)[:, in_vtk]]).ravel()
    block = pyvista.UnstructuredGrid(cells, np.full(n, kind), _in_space(at["x"]))
    block.point_data.update(_of_nodes({name: at[name] for name in FIELDS if name != "x"}, d))
    block.cell_data["seam"] = joint.seam_numbers
    block.field_data["seams"] = list(joint.seams)
    if status:
        codes = np.full(n, STATUS_CODES[STATUSES[-1]])
        for name, found_there in status.items():
            codes[joint.seam_numbers == list(joint.seams).index(name)] = [STATUS_CODES[one] for one in found_there]
        block.cell_data["status"] = codes
        block.field_data["status codes"] = _legend(STATUS_CODES)
    if contacts:
        block.point_data.update(_of_contact(joint, contacts))
        block.field_data["contact codes"] = _legend(CONTACT_CODES | {"no contact law": NO_CONTACT})
    block.cell_data.update(of_facets)
    return block


def _legend(codes: Mapping[str, int]) -> list[str]:
    return [f"{code} {name}" for name, code in sorted(codes.items(), key=lambda one: one[1])]


def _in_space(values: Array) -> Array:
    """Vectors (n, k, d) as (n k, 3)."""
    flat = values.reshape(-1, values.shape[-1])
    return np.pad(flat, ((0, 0), (0, 3 - flat.shape[1])))


def _of_nodes(at: Mapping[str, Array], d: int) -> dict[str, Array]:
    """Point data from values (facets, nodes, d)."""
    t, upper, lower = at["traction"], at["upper"], at["lower"]
    n = at["n"] / np.linalg.norm(at["n"], axis=2, keepdims=True)
    jump = upper - lower
    data = {"traction": t, "jump": jump, "normal": n, "u": (upper + lower) / 2, "u_upper": upper, "u_lower": lower}
    found = {name: _in_space(values) for name, values in data.items()}
    for name, vector in (("t", t), ("w", jump)):
        along_n = np.einsum("fki,fki->fk", vector, n)
        tangential = vector - along_n[..., None] * n
        found[f"{name}_N"] = along_n.ravel()
        signed = n[..., 1] * vector[..., 0] - n[..., 0] * vector[..., 1]
        found[f"{name}_T"] = signed.ravel() if d == 2 else _in_space(tangential)
    return found


def _of_contact(joint: Joint, reports: Mapping[str, ContactReport]) -> dict[str, Array]:
    """Status and slip at the vertices of all facets of S, from the nodes of contact."""
    rows, d = joint.surface_rows, joint.dim
    corners = joint.table.nodes(rows, joint.corners, joint.cell_type)
    column = (joint.table.vertices[rows][:, None] == corners[:, :, None]).argmax(axis=2)
    pairs = np.take_along_axis(pair_numbers(joint), column, axis=1)
    status, slip = np.full(corners.shape, NO_CONTACT), np.full((*corners.shape, d), np.nan)
    for name, report in reports.items():
        order = np.argsort(report.pairs)
        node = order[np.minimum(np.searchsorted(report.pairs[order], pairs), len(order) - 1)]
        there = (report.pairs[node] == pairs) & (joint.seam_numbers == list(joint.seams).index(name))[
            :, None
        ]  # no tips
        codes = np.array([CONTACT_CODES[str(one)] for one in report.status])
        in_space = np.einsum("nk,nkj->nj", report.slip, report.frames[:, :-1])
        status[there], slip[there] = codes[node[there]], in_space[node[there]]
    return {"contact": status.ravel(), "slip": _in_space(slip)}
