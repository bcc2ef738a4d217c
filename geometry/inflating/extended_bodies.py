"""Motion of nodes for bodies="extended": bodies give way to the layers, and their inner nodes follow harmonically."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from scipy import ndimage

from forms.base import InputError
from geometry.inflating.band_cells import NodeCopies
from geometry.inflating.kept_bodies import THICKNESS_TOLERANCE
from geometry.joint import Joint
from geometry.refusals import place_text, refuse
from geometry.topology import FloatArray, IntArray, facet_normals, is_tensor, lagrange, sum_by_number, vertex_weights

SMOOTH_SQUARED_SINE = 0.01  # squared sine below which outer faces around a vertex of S count as one smooth surface
EXACT_SQUARED_SINE = 1e-10  # the same bound for the bodies' other vertices, which must stay on their outer faces
MIN_COSINE = 0.1  # smallest cosine of the angle between S's normal and the direction in which its vertices can move
MIN_FACET_ANGLE = 1e-3  # smallest angle, in radians, between facets of S whose layers have different thicknesses
MAX_THICKNESS_ERROR = 0.02  # relative error of a thickness beyond which a body has no corner between two layers
CG_TOLERANCE = 1e-12  # relative residual of the linear solve for the harmonic motion


def face_motion(joint: Joint, copies: NodeCopies, depths: tuple[FloatArray, FloatArray]) -> tuple[IntArray, FloatArray]:
    """Return the motion of the nodes between bodies and layers: how far each copy of a node of S moves into its body.

    The motion d of a copy is the shortest vector with n . d = g at each facet of S around it. There n is the unit
    normal of S that points into the body, and g is the thickness that the body gives up. If no d is exact at all
    facets, it is that of least squares. Where S ends, d is tangential to the outer boundary of the body.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body.
        depths: values of g for the bodies below S, and for those above S. Each array is (n_S, k) at the k nodes of each
            facet of S, lengths.

    Returns:
        (n,) numbers of the copies that are on bodies, not on a rigid base, and (n, d) their motion in d dimensions,
        lengths.

    Raises:
        InputError: S is folded; the outer boundary meets S nearly parallel to it; layers of different thickness meet
            nearly in line.
    """
    upper_normals, has_lower = joint.node_normals, joint.surface_cells[:, 0] >= 0
    at = np.concatenate([copies.above, copies.below[has_lower]])
    normals = np.concatenate([upper_normals, -upper_normals[has_lower]])
    g = np.concatenate([depths[1], depths[0][has_lower]])
    face_nodes, first, index = np.unique(at, return_index=True, return_inverse=True)
    x = joint.points[np.concatenate([joint.surface, joint.surface[has_lower]]).ravel()[first]]
    n, n_terms = len(face_nodes), np.bincount(index.ravel())
    g_sum, n_sum = sum_by_number(index, g[..., None] * normals, n), sum_by_number(index, normals, n)
    moment = sum_by_number(index, normals[..., :, None] * normals[..., None, :], n)
    refuse(np.linalg.norm(n_sum, axis=1) < MIN_COSINE * n_terms, x, "S is folded at {at}: a layer would overlap itself")

    max_g, min_g = ndimage.maximum(g, index, np.arange(n)), ndimage.minimum(g, index, np.arange(n))
    is_uniform = max_g - min_g <= THICKNESS_TOLERANCE * max_g
    min_eigenvalue = np.where(is_uniform, MIN_COSINE, MIN_FACET_ANGLE)[:, None] ** 2
    moments, n_outer = _outer_moments(joint, copies.body_cells)
    eigenvalues, vectors = np.linalg.eigh(moments[face_nodes] / np.maximum(n_outer[face_nodes], 1)[:, None, None])
    free_projector = (vectors * (eigenvalues < SMOOTH_SQUARED_SINE)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    eigenvalues, vectors = np.linalg.eigh(free_projector @ moment @ free_projector / n_terms[:, None, None])
    inverse = np.where(eigenvalues > min_eigenvalue, 1 / np.maximum(eigenvalues, min_eigenvalue), 0.0)
    motion = np.einsum("nik,nk,njk,nj->ni", vectors, inverse, vectors, np.einsum("nij,nj->ni", free_projector, g_sum))
    motion /= n_terms[:, None]
    gap_ratio = np.einsum("fkd,fkd->fk", motion[index], normals) / g
    min_gap = ndimage.minimum(gap_ratio, index, np.arange(n))
    complaint = "an outer face touches S at {at} and is nearly parallel to it, so the body cannot give way there"
    refuse((min_gap < MIN_COSINE) & is_uniform, x, f"bodies='extended': {complaint}; use bodies='kept' if S is planar")
    gap_error = np.where(is_uniform[index].all(axis=1, keepdims=True), 0.0, np.abs(gap_ratio - 1))
    if gap_error.max() > MAX_THICKNESS_ERROR:
        at = index.flat[gap_error.argmax()]
        conflict = f"layers of different thickness, {min_g[at]:g} and {max_g[at]:g} on one side"
        raise InputError(f"{conflict}, meet nearly in line at {place_text(x[at])}; give them one thickness")
    return face_nodes, motion


def _outer_moments(joint: Joint, cells: IntArray) -> tuple[FloatArray, IntArray]:
    """Return for each node the sum of m m^T, where m are the unit normals of the outer facets with this node.

    Outer facets are those on the outer boundary, except facets of S.

    Args:
        joint: the joint as drawn, before S is opened.
        cells: (n_cells, k) numbers of the k nodes of its cells. If bodies have their own copies of nodes, the sum at a
            copy is over the facets of its body.

    Returns:
        (n_nodes, d, d) the sums, in d dimensions, and (n_nodes,) the numbers of their terms.
    """
    table, outer_rows = joint.table, joint.outer_rows
    m = facet_normals(joint.points, table.nodes(outer_rows, joint.cells, joint.cell_type), joint.cell_type)
    nodes, n_all = table.nodes(outer_rows, cells, joint.cell_type), int(cells.max()) + 1
    return sum_by_number(nodes, m[..., :, None] * m[..., None, :], n_all), np.bincount(nodes.ravel(), minlength=n_all)


def extended_motion(
    joint: Joint, body_cells: IntArray, n_nodes: int, face_nodes: IntArray, motions: FloatArray, fixed_nodes: IntArray
) -> FloatArray:
    """Return the motion (n_nodes, d) of all nodes of the bodies, if nodes between bodies and layers move as prescribed.

    The other nodes follow by a discrete harmonic motion, and slide along flat parts of the outer boundary.

    Args:
        joint: the joint as drawn, before S is opened, in d dimensions.
        body_cells: (n_cells, k) numbers of the k nodes of each cell of the joint. Each body has its own copies of the
            nodes on S.
        n_nodes: number of all nodes, copies included.
        face_nodes: (n,) numbers of the nodes between bodies and layers.
        motions: (n, d) prescribed motion of these nodes, lengths.
        fixed_nodes: numbers of nodes that do not move, such as nodes of periodic sides.

    Raises:
        InputError: the conjugate gradients for the other nodes do not converge.
    """
    d, k = joint.dim, joint.corners.shape[1]
    corners = body_cells[:, :k]
    motion = np.zeros((n_nodes, d))
    motion[face_nodes] = motions
    free_nodes = np.setdiff1d(np.unique(corners), np.concatenate([face_nodes, fixed_nodes]))

    moments, n_outer = _outer_moments(joint, body_cells)
    eigenvalues, vectors = np.linalg.eigh(moments[free_nodes] / np.maximum(n_outer[free_nodes], 1)[:, None, None])
    node, direction = np.nonzero(eigenvalues < EXACT_SQUARED_SINE)
    rows, columns = (node[:, None] * d + np.arange(d)).ravel(), np.repeat(np.arange(len(node)), d)
    entries, shape = vectors[node, :, direction].ravel(), (len(free_nodes) * d, len(node))
    basis = scipy.sparse.csr_matrix((entries, (rows, columns)), shape=shape)
    if len(node):
        laplacian = _laplacian(joint.points[joint.corners], corners, joint.cell_type, n_nodes)
        load = -(laplacian[free_nodes] @ motion).ravel()
        K = (basis.T @ scipy.sparse.kron(laplacian[free_nodes][:, free_nodes], np.eye(d), format="csr") @ basis).tocsr()
        jacobi = scipy.sparse.diags(1 / K.diagonal())
        q, status = scipy.sparse.linalg.cg(K, basis.T @ load, rtol=CG_TOLERANCE, atol=0.0, maxiter=50_000, M=jacobi)
        if status:
            raise InputError("the harmonic motion of the bodies' nodes was not found: the mesh has nearly flat cells")
        motion[free_nodes] = (basis @ q).reshape(-1, d)
    if body_cells.shape[1] > k:
        motion[body_cells[:, k:]] = vertex_weights(joint.cell_type, 2)[k:] @ motion[corners]
        motion[face_nodes] = motions
    return motion


def _laplacian(x: FloatArray, corners: IntArray, cell_type: str, n: int) -> scipy.sparse.csr_matrix:
    """Return the stiffness matrix of -div grad for linear elements, with quadrature points at the cells' vertices.

    Args:
        x: (n_cells, k, d) coordinates of the k vertices of each straight-sided cell in d dimensions.
        corners: (n_cells, k) numbers of these vertices, from 0 to n - 1.
        cell_type: type of the cells.
        n: number of rows and columns of the matrix.
    """
    element = lagrange(cell_type, 1)
    q_points = element.points if is_tensor(cell_type) else element.points[:1]
    X_gradients = element.tabulate(1, q_points)[1:, :, :, 0]
    jacobian = np.einsum("tqn,cnd->cqtd", X_gradients, x)
    gradients = np.einsum("cqdt,tqn->cqnd", np.linalg.inv(jacobian), X_gradients)
    matrices = np.einsum("cqnd,cqmd,cq->cnm", gradients, gradients, np.abs(np.linalg.det(jacobian)) / len(q_points))
    k = corners.shape[1]
    rows, columns = np.repeat(corners, k, axis=1).ravel(), np.tile(corners, (1, k)).ravel()
    return scipy.sparse.coo_matrix((matrices.ravel(), (rows, columns)), shape=(n, n)).tocsr()
