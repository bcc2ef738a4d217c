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
from geometry.topology import FloatArray, IntArray, connected, is_tensor, sum_by_number, unique_rows

THICKNESS_TOLERANCE = 1e-12  # relative difference of thicknesses that counts as zero
FLAT_GAP_TOLERANCE = 1e-9  # relative error of the thickness between bodies that are kept
CURVED_GAP_TOLERANCE = 0.05  # the same error on a curved S: its normals are then within 18 degrees
GAP_WARNING_ERROR = 1e-3  # relative error of the thickness beyond which users are warned
NORMAL_PENALTY = 1e3  # stiffness across the layers over stiffness along them, in the least squares for kept bodies
MAX_MULTIPLIER_STEPS = 200  # largest number of updates of the multiplier in this problem
NOT_KEPT_MESSAGE = "the bodies cannot be moved apart in one piece; use bodies='extended'"
# weights of a facet's vertices: their mean lies above no edge of an aligned grid
RAY_OFFSETS = np.array([1.0, 1.3, 1.7, 2.3])


def kept_motion(joint: Joint, eps: FloatArray) -> FloatArray:
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
    count = int(pieces.max()) + 1
    ends = np.where(cells >= 0, pieces[cells], count)
    count += bool((cells < 0).any())
    complaint = f"one body, as at {{at}}, lies below S and above it: {NOT_KEPT_MESSAGE}"
    refuse(ends[:, 0] == ends[:, 1], joint.points[joint.corners[cells[:, 1]]], complaint)
    sheet = Sheet(joint)
    area = np.bincount(sheet.simplices[0], sheet.areas)
    pairs, at = unique_rows(ends)
    weight: FloatArray = np.bincount(at, area).astype(float)
    moment = sum_by_number(at, area[:, None, None] * n[:, :, None] * n[:, None, :], len(pairs))
    opened = sum_by_number(at, (area * eps)[:, None] * n, len(pairs))
    values, vectors = np.linalg.eigh(moment / weight[:, None, None])
    is_normal = values > 10 * PLANAR_TOLERANCE**2
    inverse = np.where(is_normal, 1 / np.where(is_normal, values, 1.0), 0.0)
    pair_jump = np.einsum("pik,pk,pjk,pj->pi", vectors, inverse, vectors, opened / weight[:, None])
    part = connected(pairs[:, 0], pairs[:, 1], count)
    T = _translations(pairs, part, pair_jump, (vectors * is_normal[:, None, :]) @ np.swapaxes(vectors, 1, 2), weight)

    contradictory = "the layers around the bodies at {at} ask for motions that contradict one another"
    target_gap, mean = (pair_jump[at] * n).sum(axis=1), (np.bincount(at, eps) / np.bincount(at))[at]
    # layers of several thicknesses get the strict tolerance
    tolerance = np.where(np.abs(eps - mean) > FLAT_GAP_TOLERANCE * mean, FLAT_GAP_TOLERANCE, CURVED_GAP_TOLERANCE)
    pair_check = pair_jump[at], eps, tolerance, "S is not planar, as at {at}"
    joint_check = T[ends[:, 1]] - T[ends[:, 0]], target_gap, FLAT_GAP_TOLERANCE, contradictory
    for jump, wanted_gap, allowed, reason in (pair_check, joint_check):
        gap = (jump * n).sum(axis=1)
        sideways = np.linalg.norm(jump - gap[:, None] * n, axis=1)
        is_wrong = np.abs(gap - wanted_gap) > allowed * eps + PLANAR_TOLERANCE * sideways
        refuse(is_wrong, joint.points[joint.surface], f"{reason}: {NOT_KEPT_MESSAGE}")
    opening = np.einsum("nd,nkd->nk", pair_jump[at], joint.node_normals) / eps[:, None]
    if np.abs(opening - 1).max() > GAP_WARNING_ERROR:
        range_text = f"its thickness is {opening.min():.3f} to {opening.max():.3f} of eps with bodies='kept'"
        warn_of_range("curved", f"the meshed layer is curved: {range_text}; use bodies='extended' for a uniform one")
    on_base, part_above, n_parts = cells[:, 0] < 0, part[ends[:, 1]], int(part.max()) + 1
    middle = np.where(on_base[:, None], T[ends[:, 1]], (T[ends[:, 0]] + T[ends[:, 1]]) / 2)
    share = np.where(np.isin(part_above, part_above[on_base]) & ~on_base, 0.0, area)
    total = np.maximum(np.bincount(part_above, share, n_parts), np.finfo(float).tiny)
    shift = np.stack([np.bincount(part_above, share * middle[:, k], n_parts) / total for k in range(d)], axis=1)
    return np.asarray(T - shift[part])


def _translations(pair: IntArray, part: IntArray, jump: FloatArray, P_n: FloatArray, area: FloatArray) -> FloatArray:
    """Return the translations of pieces that have prescribed jumps normal to S and the least jumps along S.

    Pieces in one connected part may still be translated together: the result fixes this arbitrarily. The method is an
    augmented Lagrangian, which also converges for redundant constraints.

    Args:
        pair: (n, 2) numbers of the pieces below and above each of n layers.
        part: (n_pieces,) number of the connected part of the joint that each piece is in.
        jump: (n, d) prescribed jump across each layer in d dimensions, lengths.
        P_n: (n, d, d) projector onto the directions in which each layer prescribes the jump. For a plane layer this is
            its normal; a bent layer has several normals.
        area: (n,) area of S between the two pieces.

    Returns:
        (n_pieces, d) translation of each piece, lengths.
    """
    (n, d), count = jump.shape, len(part)
    low, up = (scipy.sparse.csr_matrix((np.ones(n), (np.arange(n), end)), shape=(n, count)) for end in pair.T)
    jumps = scipy.sparse.kron(up - low, np.eye(d), format="csr")
    stiffness = NORMAL_PENALTY * P_n + (area / area.mean())[:, None, None] * (np.eye(d) - P_n)
    blocks = scipy.sparse.bsr_matrix((stiffness, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
    anchor = np.zeros(count)
    anchor[np.unique(part, return_index=True)[1]] = NORMAL_PENALTY
    matrix = jumps.T @ blocks @ jumps + scipy.sparse.kron(scipy.sparse.diags(anchor), np.eye(d))
    factors = scipy.sparse.linalg.splu(matrix.tocsc())
    T, multiplier = np.zeros((count, d)), np.zeros((n, d))
    for _ in range(MAX_MULTIPLIER_STEPS):
        residual = jump - np.einsum("nij,nj->ni", P_n, T[pair[:, 1]] - T[pair[:, 0]])
        if np.abs(residual).max() <= 10 * np.finfo(float).eps * np.abs(jump).max():
            break
        multiplier += residual
        T = factors.solve(jumps.T @ (NORMAL_PENALTY * multiplier).ravel()).reshape(count, d)
    return T


def require_room(joint: Joint, translation: FloatArray) -> None:
    """Raise InputError if two bodies, or a body and the rigid base, run into each other while they are translated.

    Args:
        joint: the joint as drawn, before S is opened.
        translation: (n_pieces, d) translation of each piece into which S cuts the joint, and last that of the rigid
            base if there is one, lengths.
    """
    table, cells = joint.table, joint.surface_cells
    outer = np.union1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    piece = joint.split_mesh.pieces[table.cells[outer, 0]]
    below = np.where(cells[:, 0] >= 0, joint.split_mesh.pieces[cells[:, 0]], len(translation) - 1)
    piece[np.searchsorted(outer, joint.surface_rows)] = below
    x = joint.points[table.vertices[outer]]
    low, high = np.full_like(translation, np.inf), np.full_like(translation, -np.inf)
    np.minimum.at(low, piece, x.min(axis=1))
    np.maximum.at(high, piece, x.max(axis=1))
    min_motion = FLAT_GAP_TOLERANCE * np.abs(translation).max()  # largest relative motion of bodies that move together
    for body in range(len(translation) - 1):
        lengths = np.linalg.norm(translation[body] - translation[body + 1 :], axis=1)
        gap = np.maximum(low[body + 1 :] - high[body], low[body] - high[body + 1 :]).max(axis=1)  # of bounding boxes
        for other in body + 1 + np.flatnonzero((gap <= lengths) & (lengths > min_motion)):
            direction, eps = translation[body] - translation[other], float(lengths[other - body - 1])
            for moving, fixed, sign in ((body, other, 1.0), (other, body, -1.0)):
                corners = table.vertices[outer[piece == moving]]
                weights = RAY_OFFSETS[: corners.shape[1]] / RAY_OFFSETS[: corners.shape[1]].sum()
                probes = np.concatenate([joint.points[np.unique(corners)], weights @ joint.points[corners]])
                hit = _first_hit(joint, probes, outer[piece == fixed], sign * direction / eps, eps)
                if hit is not None:
                    raise InputError(f"no room for a layer of thickness {eps:g} at {place_text(hit)}: bodies overlap")


def _first_hit(joint: Joint, x: FloatArray, rows: IntArray, direction: FloatArray, eps: float) -> FloatArray | None:
    """Return the coordinates (d,) of one of the points `x` that passes through a facet while all move along a line.

    None means that no point passes through a facet.

    Args:
        joint: the joint as drawn, before S is opened.
        x: (n, d) coordinates of the points in d dimensions.
        rows: row numbers in `joint.table` of the facets, which do not move.
        direction: (d,) unit vector along which the points move.
        eps: length by which they move.
    """
    nodes = joint.table.nodes(rows, joint.corners, joint.cell_type)
    if is_tensor(joint.cell_type) and joint.dim == 3:
        nodes = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [3, 1, 2]]])
    facets = joint.points[nodes]
    tolerance = 1e-9 * joint.size
    start, heights = x @ direction, facets @ direction
    low, high = start.min(initial=np.inf) + tolerance, start.max(initial=-np.inf) + eps
    is_near = (heights.max(axis=1) > low) & (heights.min(axis=1) < high)
    plane_axes = np.linalg.svd(direction[None])[2][1:]
    for facet, height in zip(facets[is_near] @ plane_axes.T, heights[is_near], strict=True):
        edges = (facet[1:] - facet[0]).T
        if abs(np.linalg.det(edges)) < tolerance ** (joint.dim - 1):
            continue  # the facet is parallel to the motion
        weights = np.linalg.solve(edges, (x @ plane_axes.T - facet[0]).T).T
        gap = height[0] + weights @ (height[1:] - height[0]) - start
        is_inside = (weights > 1e-9).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-9)
        hit = np.flatnonzero(is_inside & (gap > tolerance) & (gap < eps))
        if len(hit):
            return np.asarray(x[hit[0]], float)
    return None
