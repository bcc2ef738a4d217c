"""Tractions on S in a state: from interface laws, from meshed layers, and from the nodal forces of the bodies."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from dolfinx import fem

from forms.base import Array
from geometry.topology import BoolArray, IntArray
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import contact_values
from thinlayer.output.nodal_forces import layer_forces
from thinlayer.surface.law_points import law_tractions
from thinlayer.surface.surface_mesh import SurfaceMesh

# relative tolerances of LSQR for consistent tractions, and its limit of iterations: uniform meshes need 29 to 45
LSQR_OPTIONS = {"atol": 1e-15, "btol": 1e-15, "iter_lim": 2000}


# ---------------------------------------------------------------- of layers
def layer_tractions(surface: SurfaceMesh, state: State) -> Array:
    """Return the tractions (m, d) of layers and contact laws at the m nodes of S, in d dimensions. Collective.

    Those of layers are `law_tractions`. Contact laws have their tractions at the nodes.
    """
    tractions = law_tractions(surface, state)
    if state.model.contacts and (contact := contact_values(surface, state)):
        tractions += np.einsum("nij,ni->nj", contact["frames"], np.column_stack([contact["t_T"], -contact["p"]]))
    return tractions


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
