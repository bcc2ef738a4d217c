"""Tractions on S in a state: from interface laws, from meshed layers, and from the nodal forces of the bodies."""

from __future__ import annotations

from collections.abc import Callable
from weakref import WeakKeyDictionary

import basix
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
import ufl
from dolfinx import fem
from ufl.classes import Zero

from forms.base import Array, InputError
from forms.tensors import Expr, mandel_tensor, mandel_vectors
from geometry.domain import cell_nodes
from geometry.topology import BoolArray, IntArray, lagrange
from thinlayer.discretisation.layer import SeamLayer, law_with_numbers
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import contact_values
from thinlayer.output.nodal_forces import layer_forces
from thinlayer.pointwise.quadrature import Quadrature
from thinlayer.surface.law_points import LawPoints, layer_points
from thinlayer.surface.surface_mesh import FacetPoints, SurfaceMesh

# relative tolerances of LSQR for consistent tractions, and its limit of iterations: uniform meshes need 29 to 45
LSQR_OPTIONS = {"atol": 1e-15, "btol": 1e-15, "iter_lim": 2000}
_UNIT_STRESS_TRACTIONS: WeakKeyDictionary[Quadrature, Array] = WeakKeyDictionary()


# ---------------------------------------------------------------- of layers
def layer_tractions(surface: SurfaceMesh, state: State) -> Array:
    """Return the tractions (m, d) of layers and contact laws at the m nodes of S, in d dimensions. Collective.

    Tractions of layers at quadrature points are projected in L2 to functions that are linear on each facet. The mass
    matrix of the projection is lumped if the surface's model has a contact law. Contact laws have their tractions at
    the nodes.
    """
    corner_forces = np.zeros((*surface.corners.shape, state.model.n_components))
    for points, facets in layer_points(surface, state):
        add_forces = _add_interface_forces if points.quadrature.region.dim < surface.joint.dim else _add_meshed_forces
        add_forces(corner_forces, surface, facets, points)
    corner_forces = state.model.comm.allreduce(corner_forces)
    tractions = surface.lumped(corner_forces) if surface.model.contact else surface.projected(corner_forces)
    if state.model.contacts and (contact := contact_values(surface, state)):
        tractions += np.einsum("nij,ni->nj", contact["frames"], np.column_stack([contact["t_T"], -contact["p"]]))
    return tractions


def _add_interface_forces(corner_forces: Array, surface: SurfaceMesh, facets: IntArray, points: LawPoints) -> None:
    """Add to `corner_forces` the integrals of an interface law's traction times the shape functions of degree 1.

    Args:
        corner_forces: (n, k, d) integrals, a force for each of the k corners of n facets of the surface; changed.
        surface: the surface.
        facets: for each facet where the law acts, its number on the surface; -1: it is not on this surface.
        points: quadrature points of the law.
    """
    rule, s_facets = surface.rule(points.quadrature.degree), facets[facets >= 0]
    t = _point_tractions(points)[match_law_points(rule, facets, points)]
    np.add.at(corner_forces, s_facets, np.einsum("fq,fqa,fqd->fad", rule.weights[s_facets], rule.shapes[s_facets], t))


def match_law_points(rule: FacetPoints, facets: IntArray, points: LawPoints) -> IntArray:
    """Find, for the quadrature points on a surface, the points of a law that coincide with them.

    Args:
        rule: quadrature points of the surface, q on each facet, of the same degree as those of the law.
        facets: for each facet where the law acts, its number on the surface; -1: it is not on this surface.
        points: quadrature points of the law.

    Returns:
        (facets, q) numbers of the law's points, for the entries of `facets` that are not -1. The q points of a facet
        have the order of `rule`.
    """
    q = points.quadrature
    point_numbers, rule_x = q.cells[facets >= 0], np.moveaxis(rule.x[:, facets[facets >= 0]], 0, -1)
    nearest = np.linalg.norm(rule_x[:, :, None] - q.joint_x.T[point_numbers][:, None], axis=3).argmin(axis=2)
    return np.take_along_axis(point_numbers, nearest, axis=1)


def _point_tractions(points: LawPoints) -> Array:
    """Return the tractions (points, d) of an interface law, conjugate to the jump, at the law's quadrature points.

    A traction times a virtual jump is the virtual work of the law's stresses per area of S.
    """
    q, stress = points.quadrature, points.stress()
    if points.term.traction is None:
        return points.term.kinematics.tractions(stress, q.n[:, : q.dim])
    if q not in _UNIT_STRESS_TRACTIONS:
        _UNIT_STRESS_TRACTIONS[q] = _unit_stress_tractions(points.term.traction, q)
    return np.asarray(np.einsum("pkd,pk->pd", _UNIT_STRESS_TRACTIONS[q], mandel_vectors(stress)))


def _unit_stress_tractions(traction: Callable[[Expr], Expr], q: Quadrature) -> Array:
    """Return the tractions (points, 6, d) that belong to the six unit stresses in Mandel notation, in d dimensions.

    Args:
        traction: function of the law from a UFL stress to the UFL traction that is conjugate to the jump.
        q: quadrature points of the law on S.
    """
    unit_stresses = [mandel_tensor(ufl.as_vector([float(i == k) for i in range(6)])) for k in range(6)]
    components = [t[i] for t in map(traction, unit_stresses) for i in range(len(t))]
    if all(isinstance(t, Zero) for t in components):  # a station whose strain does not depend on [u]
        return np.zeros((q.count, 6, len(components) // 6))
    return q.values(ufl.as_vector(components)).reshape(q.count, 6, -1)


def _add_meshed_forces(corner_forces: Array, surface: SurfaceMesh, facets: IntArray, points: LawPoints) -> None:
    """Add to `corner_forces` the integrals of a meshed layer's mean traction times the shape functions of degree 1.

    Args:
        corner_forces: (n, k, d) integrals, a force for each of the k corners of n facets of the surface; changed.
        surface: the surface.
        facets: for each cell of the layer the number of the facet on the surface from which it was extruded; -1: it is
            on no facet of the surface.
        points: quadrature points of the law of the layer, or of one sublayer.
    """
    joint, q, own_cells = surface.joint, points.quadrature, np.flatnonzero(facets >= 0)
    layer = next(seam_layer for seam_layer in points.state.model.layers.values() if seam_layer.key == points.term.key)
    point_ids, facets = q.cells[own_cells], facets[own_cells]
    X, _ = basix.make_quadrature(basix.CellType[joint.cell_type], q.degree)
    shapes, submesh = lagrange(joint.cell_type, 1).tabulate(0, X)[0, :, :, 0], q.region.mesh
    vertices = np.asarray(submesh.geometry.input_global_indices)[cell_nodes(submesh)[own_cells][:, : shapes.shape[1]]]
    facet_x, cell_x = joint.points[surface.corners[facets]], points.state.model.domain.joint.reference[vertices]
    nearest_corner = np.linalg.norm(cell_x[:, :, None] - facet_x[:, None], axis=3).argmin(axis=2)
    N = np.einsum("qc,fca->fqa", shapes, (nearest_corner[..., None] == np.arange(facet_x.shape[1])).astype(float))
    point_eps = np.einsum("fqa,fa->fq", N, surface.thickness(layer, surface.corners[facets]))
    n = q.n[:, : joint.dim]
    t = points.term.kinematics.tractions(points.stress(), n)
    tangential_weight, normal_weight = _sublayer_weights(layer, points)
    t_N = np.einsum("pi,pi,pj->pj", t, n, n) if t.shape == n.shape else t  # a flux is that along n
    t = tangential_weight * (t - t_N) + normal_weight * t_N
    np.add.at(corner_forces, facets, np.einsum("fq,fqa,fqd->fad", q.weights[point_ids] / point_eps, N, t[point_ids]))


def _sublayer_weights(layer: SeamLayer, points: LawPoints) -> tuple[float, float]:
    """Return the weights of a sublayer's tangential and normal traction in the mean through the layer's thickness.

    A weight is the sublayer's fraction of the jump, divided by its fraction of the thickness. The work of this mean in
    the jump is then the sum of the sublayers' work. In elastic layers the fraction of the jump follows from the
    sublayers' compliances. In layers of one material, and in layers that are not elastic, both weights are 1.

    Fluxes have the second weight, by the conductivities of the sublayers.

    Args:
        layer: the layer.
        points: quadrature points of the sublayer's law.
    """
    if len(layer.law.sublayers) == 1:
        return 1.0, 1.0
    model = points.state.model
    k = [p.measure for p in model.layer_terms if p.key == layer.key].index(points.term.measure)
    sublayers = law_with_numbers(layer.layer, model.kinematics).sublayers
    if model.n_components == 1:
        fractions, across, _ = layer.samples[0].initial_tangents.conductivities
        return 1.0, float(1 / across[k] / (fractions @ (1 / across)))
    try:
        lame = [law.elastic_moduli() for _, law in sublayers]
    except InputError:
        return 1.0, 1.0
    compliance = np.array([(a / mu, a / (lmbda + 2 * mu)) for (a, _), (lmbda, mu) in zip(sublayers, lame, strict=True)])
    tangential_weight, normal_weight = compliance[k] / compliance.sum(axis=0) / sublayers[k][0]
    return float(tangential_weight), float(normal_weight)


# ---------------------------------------------------------------- of the bodies' nodal forces
def consistent_tractions(surface: SurfaceMesh, state: State, *, bonds_joined: bool = False) -> Array:
    """Return the tractions (m, d) at the m nodes of S that are equivalent to the bodies' nodal forces.

    Collective. d is the number of dimensions. The tractions are linear on each facet. `Surface.reaction` tells which
    are chosen if the nodal forces do not determine them, as where supports act.

    Args:
        surface: all of S.
        state: the state.
        bonds_joined: whether bonded bodies count as one body, so that only layers exert forces at S. If not, bonded
            bodies exert forces on each other.
    """
    model, d = state.model, state.model.n_components
    r = layer_forces(state, bonds_joined)
    bc_marker = fem.Function(r.function_space)
    bc_marker.x.array[model.bc_dofs_in(r.function_space)] = 1.0
    bc_marker.x.scatter_forward()
    side_values = (surface.side_values(f, model, surface.corner_points) for f in (r, bc_marker))
    forces, bc_markers = (np.moveaxis(values, 1, -1) for values in side_values)  # both of shape (2, n, k, d)
    side_nodes, n_nodes = _side_nodes(surface, bonds_joined)
    nodal_force, is_known = np.zeros((n_nodes, d)), np.zeros((n_nodes, d), bool)
    nodal_force[side_nodes], is_known[side_nodes] = forces, bc_markers < 0.5
    has_traction, is_split = np.zeros(n_nodes, bool), side_nodes[0] != side_nodes[1]
    is_tip = surface.nodal_sums(is_split.astype(float)) == 0  # both sides share one node there
    has_traction[side_nodes[1][is_split]] = True
    has_traction[side_nodes[0][is_split & (surface.cells[:, :1] >= 0)]] = True  # the forces of a rigid base are unknown
    is_known &= has_traction[:, None]
    node_pairs = np.stack([side_nodes.ravel(), np.broadcast_to(surface.nodes, side_nodes.shape).ravel()])
    # elsewhere forces of several seams add up
    has_one_pair = np.bincount(np.unique(node_pairs, axis=1)[0], minlength=n_nodes) == 1
    areas = surface.areas
    M = _traction_to_force_matrix(surface, side_nodes, n_nodes)
    node_areas = np.where(has_traction, np.abs(M) @ np.ones(len(areas)), 1.0)
    tractions = np.zeros((len(areas), d))
    for k in range(d):
        guess = _first_guess(surface, side_nodes, nodal_force[:, k] / node_areas, is_known[:, k] & has_one_pair)
        known_rows = np.flatnonzero(is_known[:, k])
        guess, column_scale = np.where(is_tip, 0.0, [guess, areas**-0.5])
        A = scipy.sparse.diags(node_areas[known_rows] ** -0.5) @ M[known_rows] @ scipy.sparse.diags(column_scale)
        b = (nodal_force[known_rows, k] - M[known_rows] @ guess) * node_areas[known_rows] ** -0.5
        b_norm = np.abs(b).max(initial=0.0) or 1.0
        tractions[:, k] = guess + b_norm * column_scale * scipy.sparse.linalg.lsqr(A, b / b_norm, **LSQR_OPTIONS)[0]
    return tractions


def _side_nodes(surface: SurfaceMesh, bonds_joined: bool) -> tuple[IntArray, int]:
    """Number the nodes of the bodies on S, where each body has a node of its own at a vertex of S.

    Args:
        surface: the surface, with n facets of k corners.
        bonds_joined: whether bonded bodies share one node.

    Returns:
        (2, n, k) numbers of the nodes at each corner, first of the body below S, then of the body above; the number of
        nodes.
    """
    joint = surface.joint
    split_mesh = surface.model.split_mesh if bonds_joined else joint.split_mesh
    body_numbers = joint.side_components(split_mesh)[:, surface.rows, : surface.corners.shape[1]]
    keys = joint.masters[surface.corners] * (body_numbers.max() + 2) + body_numbers + 1
    unique_keys, node_numbers = np.unique(keys, return_inverse=True)
    return node_numbers.reshape(keys.shape), len(unique_keys)


def _traction_to_force_matrix(surface: SurfaceMesh, side_nodes: IntArray, n_nodes: int) -> scipy.sparse.csr_matrix:
    """Return the sparse matrix (n_nodes, m) from nodal values of a traction on S to nodal forces on the bodies.

    The traction acts on the lower body, and its opposite on the upper body.

    Args:
        surface: the surface, with n facets of k corners.
        side_nodes: (2, n, k) numbers of the bodies' nodes below and above the corners.
        n_nodes: number of the bodies' nodes.
    """
    M = np.einsum("fq,qa,qb->fab", surface.weights, surface.shapes, surface.shapes)
    rows, columns = np.broadcast_arrays(side_nodes[..., None], surface.nodes[:, None])  # (2, n, k, k)
    values, shape = np.stack([M, -M]), (n_nodes, len(surface.node_numbers))
    return scipy.sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _first_guess(surface: SurfaceMesh, side_nodes: IntArray, tractions: Array, is_known: BoolArray) -> Array:
    """Estimate one component of the traction at the m nodes of S (m,), from nodal forces divided by areas.

    Args:
        surface: the surface, with n facets of k corners.
        side_nodes: (2, n, k) numbers of the bodies' nodes below and above the corners.
        tractions: (n_nodes,) force over area at each of the bodies' nodes.
        is_known: (n_nodes,) whether this force is known. Nodes of S without such a force get the mean over their
            neighbours.
    """
    signs = np.array([1.0, -1.0])[:, None, None]
    n_known = surface.nodal_sums(is_known[side_nodes].sum(axis=0).astype(float))
    known_sums = surface.nodal_sums((signs * tractions[side_nodes] * is_known[side_nodes]).sum(axis=0))
    averages = known_sums / np.maximum(n_known, 1.0)
    corner_weights = np.minimum(n_known, 1.0)[surface.nodes]
    weight_sums = corner_weights.sum(axis=1)
    facet_means = (averages[surface.nodes] * corner_weights).sum(axis=1) / np.maximum(weight_sums, 1.0)
    facet_weights = np.broadcast_to(np.minimum(weight_sums, 1.0)[:, None], surface.nodes.shape)
    neighbour_sums = surface.nodal_sums(facet_means[:, None] * facet_weights)
    neighbour_means = neighbour_sums / np.maximum(surface.nodal_sums(facet_weights), 1.0)
    return np.where(n_known > 0, averages, neighbour_means)
