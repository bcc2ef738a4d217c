"""Motion of bodies for bodies="kept": the bodies are translated until S is open, without a change of shape."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.base import InputError
from forms.traits import warn_of_range
from geometry.joint import PLANAR_TOLERANCE, Joint
from geometry.refusals import place_text, refuse
from geometry.sheet import Sheet
from geometry.topology import FloatArray, IntArray, components, is_tensor, sum_by_number, unique_rows

THICKNESS_TOLERANCE = 1e-12  # relative difference of thicknesses that counts as zero
FLAT_GAP_TOLERANCE = 1e-9  # relative error of the thickness between bodies that are kept
CURVED_GAP_TOLERANCE = 0.05  # the same error on a curved S: its normals are then within 18 degrees
GAP_WARNING_ERROR = 1e-3  # relative error of the thickness beyond which users are warned
NORMAL_PENALTY = 1e3  # stiffness across the layers over stiffness along them, in the least squares for kept bodies
MAX_MULTIPLIER_STEPS = 200  # largest number of updates of the multiplier in this problem
NOT_KEPT_MESSAGE = "the bodies cannot be moved apart in one piece; use bodies='extended'"
# weights of a facet's vertices: their mean lies above no edge of an aligned grid
RAY_WEIGHTS = np.array([1.0, 1.3, 1.7, 2.3])


def body_translations(joint: Joint, eps: FloatArray) -> FloatArray:
    """Return the translations of the bodies that open S by the thickness of each layer.

    Each piece into which S cuts the joint has one translation.

    Among all such translations, these have the least jumps along S. Bodies on a rigid base do not move: there the base
    moves. In a connected part of the joint without a base, the mean displacement of both sides of S is zero. If S is a
    shallow arc, the mean thickness is the given one, and a RangeWarning gives the least and the largest.

    Args:
        joint: the joint as drawn, before S is opened.
        eps: (n_S,) thickness at each facet of S, lengths.

    Returns:
        (n_pieces, d) translation of each piece in d dimensions, lengths. If there is a rigid base, it is the last
        piece.

    Raises:
        InputError: no such translations exist.
    """
    pieces, cells, n, d = joint.split_mesh.pieces, joint.surface_cells, joint.interface_normals, joint.dim
    n_pieces = int(pieces.max()) + 1
    side_pieces = np.where(cells >= 0, pieces[cells], n_pieces)
    n_pieces += bool((cells < 0).any())
    complaint = f"one body, as at {{at}}, lies below S and above it: {NOT_KEPT_MESSAGE}"
    refuse(side_pieces[:, 0] == side_pieces[:, 1], joint.points[joint.corners[cells[:, 1]]], complaint)
    facet_areas = Sheet(joint).facet_integrals(1.0)
    pairs, pair_no = unique_rows(side_pieces)
    areas: FloatArray = np.bincount(pair_no, facet_areas).astype(float)
    moment = sum_by_number(pair_no, facet_areas[:, None, None] * n[:, :, None] * n[:, None, :], len(pairs))
    opening_sum = sum_by_number(pair_no, (facet_areas * eps)[:, None] * n, len(pairs))
    eigenvalues, vectors = np.linalg.eigh(moment / areas[:, None, None])
    is_normal = eigenvalues > 10 * PLANAR_TOLERANCE**2
    inverse_values = np.where(is_normal, 1 / np.where(is_normal, eigenvalues, 1.0), 0.0)
    pair_jump = np.einsum("pik,pk,pjk,pj->pi", vectors, inverse_values, vectors, opening_sum / areas[:, None])
    group_no = components(pairs[:, 0], pairs[:, 1], n_pieces)
    T = _translations(pairs, group_no, pair_jump, (vectors * is_normal[:, None, :]) @ np.swapaxes(vectors, 1, 2), areas)

    conflict = "the layers around the bodies at {at} ask for motions that contradict one another"
    target_gap, mean = (pair_jump[pair_no] * n).sum(axis=1), (np.bincount(pair_no, eps) / np.bincount(pair_no))[pair_no]
    # layers of several thicknesses get the strict tolerance
    tolerance = np.where(np.abs(eps - mean) > FLAT_GAP_TOLERANCE * mean, FLAT_GAP_TOLERANCE, CURVED_GAP_TOLERANCE)
    pair_check = pair_jump[pair_no], eps, tolerance, "S is not planar, as at {at}"
    joint_check = T[side_pieces[:, 1]] - T[side_pieces[:, 0]], target_gap, FLAT_GAP_TOLERANCE, conflict
    for jump, wanted_gap, gap_tolerance, reason in (pair_check, joint_check):
        gap = (jump * n).sum(axis=1)
        slip = np.linalg.norm(jump - gap[:, None] * n, axis=1)
        is_wrong = np.abs(gap - wanted_gap) > gap_tolerance * eps + PLANAR_TOLERANCE * slip
        refuse(is_wrong, joint.points[joint.surface], f"{reason}: {NOT_KEPT_MESSAGE}")
    gap_ratio = np.einsum("nd,nkd->nk", pair_jump[pair_no], joint.node_normals) / eps[:, None]
    if np.abs(gap_ratio - 1).max() > GAP_WARNING_ERROR:
        range_text = f"its thickness is {gap_ratio.min():.3f} to {gap_ratio.max():.3f} of eps with bodies='kept'"
        warn_of_range("curved", f"the meshed layer is curved: {range_text}; use bodies='extended' for a uniform one")
    on_base, group_above, n_groups = cells[:, 0] < 0, group_no[side_pieces[:, 1]], int(group_no.max()) + 1
    mean_T = np.where(on_base[:, None], T[side_pieces[:, 1]], (T[side_pieces[:, 0]] + T[side_pieces[:, 1]]) / 2)
    weights = np.where(np.isin(group_above, group_above[on_base]) & ~on_base, 0.0, facet_areas)
    total = np.maximum(np.bincount(group_above, weights, n_groups), np.finfo(float).tiny)
    shift = np.stack([np.bincount(group_above, weights * mean_T[:, k], n_groups) / total for k in range(d)], axis=1)
    return np.asarray(T - shift[group_no])


def _translations(pairs: IntArray, group: IntArray, jump: FloatArray, P_n: FloatArray, area: FloatArray) -> FloatArray:
    """Return the translations of pieces that have prescribed jumps normal to S and the least jumps along S.

    Pieces in one connected part may still be translated together: the result fixes this arbitrarily. The method is an
    augmented Lagrangian, which also converges for redundant constraints.

    Args:
        pairs: (n, 2) numbers of the pieces below and above each of n layers.
        group: (n_pieces,) number of the connected part of the joint that each piece is in.
        jump: (n, d) prescribed jump across each layer in d dimensions, lengths.
        P_n: (n, d, d) projector onto the directions in which each layer prescribes the jump. For a plane layer this is
            its normal; a bent layer has several normals.
        area: (n,) area of S between the two pieces.

    Returns:
        (n_pieces, d) translation of each piece, lengths.
    """
    (n, d), n_pieces = jump.shape, len(group)
    low, up = (scipy.sparse.csr_matrix((np.ones(n), (np.arange(n), end)), shape=(n, n_pieces)) for end in pairs.T)
    jump_matrix = scipy.sparse.kron(up - low, np.eye(d), format="csr")
    stiffness = NORMAL_PENALTY * P_n + (area / area.mean())[:, None, None] * (np.eye(d) - P_n)
    block_stiffness = scipy.sparse.bsr_matrix((stiffness, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
    anchors = np.zeros(n_pieces)
    anchors[np.unique(group, return_index=True)[1]] = NORMAL_PENALTY
    matrix = jump_matrix.T @ block_stiffness @ jump_matrix + scipy.sparse.kron(scipy.sparse.diags(anchors), np.eye(d))
    lu = scipy.sparse.linalg.splu(matrix.tocsc())
    T, multiplier = np.zeros((n_pieces, d)), np.zeros((n, d))
    for _ in range(MAX_MULTIPLIER_STEPS):
        residual = jump - np.einsum("nij,nj->ni", P_n, T[pairs[:, 1]] - T[pairs[:, 0]])
        if np.abs(residual).max() <= 10 * np.finfo(float).eps * np.abs(jump).max():
            break
        multiplier += residual
        T = lu.solve(jump_matrix.T @ (NORMAL_PENALTY * multiplier).ravel()).reshape(n_pieces, d)
    return T


def require_room(joint: Joint, translation: FloatArray) -> None:
    """Raise InputError if two bodies, or a body and the rigid base, run into each other while they are translated.

    Args:
        joint: the joint as drawn, before S is opened.
        translation: (n_pieces, d) translation of each piece into which S cuts the joint, and last that of the rigid
            base if there is one, lengths.
    """
    table, cells = joint.table, joint.surface_cells
    outer_rows = np.union1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    piece = joint.split_mesh.pieces[table.cells[outer_rows, 0]]
    piece_below = np.where(cells[:, 0] >= 0, joint.split_mesh.pieces[cells[:, 0]], len(translation) - 1)
    piece[np.searchsorted(outer_rows, joint.surface_rows)] = piece_below
    x = joint.points[table.vertices[outer_rows]]
    low, high = np.full_like(translation, np.inf), np.full_like(translation, -np.inf)
    np.minimum.at(low, piece, x.min(axis=1))
    np.maximum.at(high, piece, x.max(axis=1))
    min_motion = FLAT_GAP_TOLERANCE * np.abs(translation).max()  # largest relative motion of bodies that move together
    for body in range(len(translation) - 1):
        distances = np.linalg.norm(translation[body] - translation[body + 1 :], axis=1)
        gap = np.maximum(low[body + 1 :] - high[body], low[body] - high[body + 1 :]).max(axis=1)  # of bounding boxes
        for other in body + 1 + np.flatnonzero((gap <= distances) & (distances > min_motion)):
            direction, eps = translation[body] - translation[other], float(distances[other - body - 1])
            for moving, fixed, sign in ((body, other, 1.0), (other, body, -1.0)):
                corners = table.vertices[outer_rows[piece == moving]]
                weights = RAY_WEIGHTS[: corners.shape[1]] / RAY_WEIGHTS[: corners.shape[1]].sum()
                probes = np.concatenate([joint.points[np.unique(corners)], weights @ joint.points[corners]])
                hit = _first_hit(joint, probes, outer_rows[piece == fixed], sign * direction / eps, eps)
                if hit is not None:
                    raise InputError(f"no room for a layer of thickness {eps:g} at {place_text(hit)}: bodies overlap")


def _first_hit(joint: Joint, x: FloatArray, rows: IntArray, direction: FloatArray, length: float) -> FloatArray | None:
    """Return the coordinates (d,) of one of the points `x` that passes through a facet while all move along a line.

    None means that no point passes through a facet.

    Args:
        joint: the joint as drawn, before S is opened.
        x: (n, d) coordinates of the points in d dimensions.
        rows: row numbers in `joint.table` of the facets, which do not move.
        direction: (d,) unit vector along which the points move.
        length: length by which they move.
    """
    nodes = joint.table.nodes(rows, joint.corners, joint.cell_type)
    if is_tensor(joint.cell_type) and joint.dim == 3:
        nodes = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [3, 1, 2]]])
    facet_points = joint.points[nodes]
    tolerance = 1e-9 * joint.size
    point_heights, facet_heights = x @ direction, facet_points @ direction
    low, high = point_heights.min(initial=np.inf) + tolerance, point_heights.max(initial=-np.inf) + length
    is_near = (facet_heights.max(axis=1) > low) & (facet_heights.min(axis=1) < high)
    plane_axes = np.linalg.svd(direction[None])[2][1:]
    for facet, height in zip(facet_points[is_near] @ plane_axes.T, facet_heights[is_near], strict=True):
        edges = (facet[1:] - facet[0]).T
        if abs(np.linalg.det(edges)) < tolerance ** (joint.dim - 1):
            continue  # the facet is parallel to the motion
        weights = np.linalg.solve(edges, (x @ plane_axes.T - facet[0]).T).T
        gap = height[0] + weights @ (height[1:] - height[0]) - point_heights
        is_inside = (weights > 1e-9).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-9)
        hit = np.flatnonzero(is_inside & (gap > tolerance) & (gap < length))
        if len(hit):
            return np.asarray(x[hit[0]], float)
    return None
