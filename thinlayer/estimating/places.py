"""Places on S: how far they are from free ends, nodes of its sides, and densities from values at nodes."""

from __future__ import annotations

import basix
import numpy as np
from scipy.spatial import cKDTree

from geometry.inflating.parting import points_on_middle
from geometry.topology import FloatArray, IntArray
from thinlayer.compiling.compat import exterior_facet_entities, interpolation_points
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.seams import SeamLayer, seam_entities
from thinlayer.output.surface import Surface
from thinlayer.parts.part import DISPLACEMENTS, FieldPart
from thinlayer.solving.adjoint import Adjoint

NEAR_ENDS = 3.0  # distance from free ends, over the thickness, within which tractions and jumps are not estimated
SAME_PLACE = 1e-9  # distance of two places that are one, over the size of the joint


def away_from_ends(surface: Surface, one: SeamLayer, length: float) -> FloatArray:
    """(n, q) 1 on the part of a seam that is farther than a length from its free ends, 0 elsewhere. Collective."""
    assert isinstance(surface.model, InterfaceModel)
    rim = surface.model.reductions[one.name].free
    if not len(rim.vertices):
        return np.ones_like(surface.weights)
    x = surface.joint.points[surface.corners].reshape(-1, surface.joint.dim)
    beyond = rim.distance(surface.joint.points, x).reshape(surface.corners.shape) - length * (1 + SAME_PLACE)
    return np.asarray(beyond @ surface.shapes.T > 0, float)


def density_of(adjoint: Adjoint, summands: dict[str, FloatArray]) -> FloatArray:
    """(m,) density, at the nodes of S, of summands at nodes (`Adjoint.summands`). Collective.

    A summand is shared by the vertices of its cell, and by the area around each vertex.
    """
    model = adjoint.model
    joint, surface = model.joint, Surface(model)
    sums, areas = np.zeros((2, len(joint.points)))
    _add_nodal(sums, model, summands[DISPLACEMENTS])
    for part in adjoint.equations.layers:
        if isinstance(part, FieldPart) and part.key in summands:
            x = part.field.function_space.tabulate_dof_coordinates()[: part.own_size, : joint.dim]
            near, number = cKDTree(points_on_middle(model.domain.joint)[surface.corners.ravel()]).query(x)
            assert (near <= SAME_PLACE * np.ptp(joint.points)).all()
            np.add.at(sums, surface.corners.ravel()[number], summands[part.key])
    np.add.at(areas, surface.vertices, surface.areas)
    totals = np.bincount(joint.masters, model.comm.allreduce(sums), len(sums))
    return np.asarray(totals[surface.vertices] / areas[surface.vertices])


def _add_nodal(sums: FloatArray, model: InterfaceModel, values: FloatArray) -> None:
    """Add values (m,) at the displacements of this rank to the vertices of the joint, by functions of degree 1."""
    V, joint = model.V, model.joint
    d = V.dofmap.bs
    of_nodes = values.reshape(-1, d).sum(axis=1)
    dofs = np.asarray(V.dofmap.list)
    nodes, first = np.unique(dofs.ravel(), return_index=True)
    owned = nodes < len(of_nodes)
    cell, place = np.divmod(first[owned], dofs.shape[1])
    element = basix.create_element(basix.ElementFamily.P, basix.CellType[joint.cell_type], 1)
    shares = element.tabulate(0, interpolation_points(V))[0, :, :, 0]
    corners = joint.corners[model.domain.original_cells[cell]]
    np.add.at(sums, corners, shares[place] * of_nodes[nodes[owned], None])


def nodes_of_sides(model: InterfaceModel, name: str) -> tuple[IntArray, IntArray]:
    """Local nodes of the displacements on the upper and on the lower side of a seam (on a rigid base: none). Collective.

    They are those that this rank's facets have, ghosts included.
    """
    domain, d, dofmap = model.domain, model.joint.dim, model.V.dofmap
    if name in model.joint.base_seams:
        entities = exterior_facet_entities(domain.mesh, np.sort(domain.facets(name))).astype(np.int64)
    else:
        entities = seam_entities(domain, name).astype(np.int64)
    sides = np.split(entities, entities.shape[1] // 2, axis=1)
    found = [
        np.unique([dofmap.cell_dofs(cell)[dofmap.dof_layout.entity_closure_dofs(d - 1, facet)] for cell, facet in side])
        for side in sides
    ]
    return found[0].astype(np.int64), (found[1] if len(found) > 1 else np.empty(0)).astype(np.int64)
