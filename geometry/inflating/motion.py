"""Motion of nodes when layers open: of the copies of the nodes of S, harmonic motion of the bodies."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from geometry.errors import GeometryError, place
from geometry.inflating.bands import Copies
from geometry.joint import FLAT, Joint
from geometry.topology import FloatArray, IntArray, facet_normals, is_tensor, lagrange

SMOOTH = 0.01  # squared sine below which outer faces around a vertex of S count as one smooth surface
EXACT = 1e-10  # the same for the bodies' other vertices, which must stay on their outer faces
LEAST_COSINE = 0.1  # smallest cosine of the angle between S's normal and the direction in which its vertices can move
LEAST_ANGLE = 1e-3  # the same, in radians, between facets of S whose layers have different thicknesses
NO_CORNER = 0.02  # error of a thickness, relative to it, from which on a body has no corner between two layers
UNIFORM = 1e-12  # relative difference of thicknesses that counts as none
SAME_GAP = 1e-9  # relative error of the thickness between bodies that are kept
STIFF = 1e3  # stiffness across the layers relative to that along them, in the least squares for kept bodies
TOLERANCE = 1e-12  # relative residual of the linear solve for the harmonic motion
NOT_KEPT = "the bodies cannot be moved apart in one piece; use bodies='extended'"


def face_motion(joint: Joint, copies: Copies, given_up: tuple[FloatArray, FloatArray]) -> tuple[IntArray, FloatArray]:
    """The copies of the nodes of S on bodies, and how each of them moves into its body, (n, d).

    The motion d is the least one with n . d = g for each facet of S around the copy, where n points into the body (least
    squares where there are many); at the end of S it is along the outer faces of the body.

    Args:
        joint: the joint before inflating.
        copies: of its nodes.
        given_up: g, (n_S, k) at the nodes of each facet: what the body below gives up, and the body above.

    Raises:
        GeometryError: S is folded; an outer face touches S nearly parallel to it; layers of different thickness meet nearly
            in line.
    """
    upper, there = joint.node_normals, joint.surface_cells[:, 0] >= 0
    at = np.concatenate([copies.above, copies.below[there]])
    normals = np.concatenate([upper, -upper[there]])
    g = np.concatenate([given_up[1], given_up[0][there]])
    original = np.concatenate([joint.surface, joint.surface[there]])
    known, first, index = np.unique(at, return_index=True, return_inverse=True)
    index = index.reshape(at.shape)
    x, d = joint.points[original.ravel()[first]], joint.dim
    total, along_n, count = np.zeros((len(known), d)), np.zeros((len(known), d)), np.zeros(len(known))
    moment = np.zeros((len(known), d, d))
    np.add.at(total, index, g[..., None] * normals)
    np.add.at(along_n, index, normals)
    np.add.at(count, index, 1.0)
    np.add.at(moment, index, normals[..., :, None] * normals[..., None, :])
    folded = np.flatnonzero(np.linalg.norm(along_n, axis=1) < LEAST_COSINE * count)
    if len(folded):
        raise GeometryError(f"S is folded at {place(x[folded[0]])}: a layer there would overlap itself")

    thick, thin = np.zeros(len(known)), np.full(len(known), np.inf)
    np.maximum.at(thick, index, g)
    np.minimum.at(thin, index, g)
    uniform = thick - thin <= UNIFORM * thick
    least = np.where(uniform, LEAST_COSINE, LEAST_ANGLE)[:, None] ** 2
    outer, faces = _outer_moments(joint, copies.cells)
    values, vectors = np.linalg.eigh(outer[known] / np.maximum(faces[known], 1)[:, None, None])
    slip = (vectors * (values < SMOOTH)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    values, vectors = np.linalg.eigh(slip @ moment @ slip / count[:, None, None])
    inverse = np.where(values > least, 1 / np.maximum(values, least), 0.0)
    motion = np.einsum("nik,nk,njk,nj->ni", vectors, inverse, vectors, np.einsum("nij,nj->ni", slip, total))
    motion /= count[:, None]
    gap = np.einsum("fkd,fkd->fk", motion[index], normals) / g
    lowest = np.full(len(known), np.inf)
    np.minimum.at(lowest, index, gap)
    steep = np.flatnonzero((lowest < LEAST_COSINE) & uniform)
    if len(steep):
        raise GeometryError(
            f"bodies='extended' cannot keep the shape: an outer face touches S at {place(x[steep[0]])} "
            "and is nearly parallel to it, so the body cannot give way there; use bodies='kept' if S is planar"
        )
    wrong = np.flatnonzero((np.abs(gap - 1).max(axis=1) > NO_CORNER) & ~uniform[index].all(axis=1))
    if len(wrong):
        k = np.abs(gap[wrong[0]] - 1).argmax()
        here = index[wrong[0], k]
        raise GeometryError(
            f"layers of different thickness, {thin[here]:g} and {thick[here]:g} on one side, meet nearly in line at "
            f"{place(x[here])}: the body between them has no corner there; give them one thickness"
        )
    return known, motion


def _outer_moments(joint: Joint, cells: IntArray) -> tuple[FloatArray, FloatArray]:
    """For every node the sum of m m^T over the unit normals m of outer faces there, except S, and their number.

    Args:
        joint: the joint before inflating.
        cells: (n_cells, k) nodes of its cells; where bodies have parted, each copy counts the faces of its own body.
    """
    table = joint.table
    outer = np.setdiff1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    normals = facet_normals(joint.points, table.nodes(outer, joint.cells, joint.cell_type), joint.cell_type)
    nodes, size = table.nodes(outer, cells, joint.cell_type), int(cells.max()) + 1
    moments, count = np.zeros((size, joint.dim, joint.dim)), np.zeros(size)
    np.add.at(moments, nodes, normals[..., :, None] * normals[..., None, :])
    np.add.at(count, nodes, 1.0)
    return moments, count


def kept_motion(joint: Joint, eps: FloatArray) -> FloatArray:
    """Translations (n_pieces, d) of the bodies' pieces that open each facet of S by its thickness.

    Of all such motions it is the one with the least jumps along S. The middle of S stays where it is, and so do bodies on
    a rigid base. The base is the last piece, if there is one.

    Args:
        joint: the joint before inflating.
        eps: (n_S,) thickness at each facet of S.

    Raises:
        GeometryError: there is no such motion.
    """
    pieces, cells, n, d = joint.splitting.pieces, joint.surface_cells, joint.interface_normals, joint.dim
    count = int(pieces.max()) + 1
    ends = np.where(cells >= 0, pieces[cells], count)
    count += bool((cells < 0).any())
    same = np.flatnonzero(ends[:, 0] == ends[:, 1])
    if len(same):
        at = joint.points[joint.corners[cells[same[0], 1]]].mean(axis=0)
        raise GeometryError(f"one body, as at {place(at)}, lies below S and above it: {NOT_KEPT}")
    area = _areas(joint)
    pairs, at = np.unique(ends, axis=0, return_inverse=True)
    at = at.ravel()
    weight: FloatArray = np.bincount(at, area).astype(float)
    moment, opened = np.zeros((len(pairs), d, d)), np.zeros((len(pairs), d))
    np.add.at(moment, at, area[:, None, None] * n[:, :, None] * n[:, None, :])
    np.add.at(opened, at, (area * eps)[:, None] * n)
    values, vectors = np.linalg.eigh(moment / weight[:, None, None])
    across = values > 10 * FLAT**2
    inverse = np.where(across, 1 / np.where(across, values, 1.0), 0.0)
    wanted = np.einsum("pik,pk,pjk,pj->pi", vectors, inverse, vectors, opened / weight[:, None])
    T = _translations(pairs, count, wanted, (vectors * across[:, None, :]) @ np.swapaxes(vectors, 1, 2), weight)

    for jump, reason in (
        (wanted[at], "S is not planar, as at {}"),
        (
            T[ends[:, 1]] - T[ends[:, 0]],
            "the layers around the bodies at {} ask for motions that contradict one another",
        ),
    ):
        gap = (jump * n).sum(axis=1)
        lean = np.linalg.norm(jump - gap[:, None] * n, axis=1)
        wrong = np.abs(gap - eps) > SAME_GAP * eps + FLAT * lean
        if wrong.any():
            x = joint.points[joint.surface[wrong][0]].mean(axis=0)
            raise GeometryError(f"{reason.format(place(x))}: {NOT_KEPT}")
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs), np.int8), tuple(pairs.T)), shape=(count, count))
    part = connected_components(graph, directed=False)[1]
    based = np.zeros(part.max() + 1, bool)
    based[part[ends[cells[:, 0] < 0, 1]]] = True
    on_base, mine = cells[:, 0] < 0, part[ends[:, 1]]
    middle = np.where(on_base[:, None], T[ends[:, 1]], (T[ends[:, 0]] + T[ends[:, 1]]) / 2)
    share = np.where(based[mine] & ~on_base, 0.0, area)
    total = np.maximum(np.bincount(mine, share, len(based)), np.finfo(float).tiny)
    shift = np.stack([np.bincount(mine, share * middle[:, k], len(based)) / total for k in range(d)], axis=1)
    return np.asarray(T - shift[part])


def _areas(joint: Joint) -> FloatArray:
    """(n_S,) areas of the straight facets between the vertices of S, lengths in 2D."""
    x = joint.points[joint.surface]
    if joint.dim == 2:
        return np.asarray(np.linalg.norm(x[:, 1] - x[:, 0], axis=1))
    first, second = (
        (x[:, 3] - x[:, 0], x[:, 2] - x[:, 1]) if is_tensor(joint.cell_type) else (x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    )
    return np.asarray(np.linalg.norm(np.cross(first, second), axis=1) / 2)


def _translations(
    pairs: IntArray, count: int, wanted: FloatArray, across: FloatArray, weight: FloatArray
) -> FloatArray:
    """Least squares of the jumps along S, under the constraint of those across: (count, d), up to a common translation.

    By an augmented Lagrangian, whose multiplier exists for redundant constraints, too.

    Args:
        pairs: (n, 2) pieces below and above.
        count: number of pieces.
        wanted: (n, d) jump across the layers between two pieces.
        across: (n, d, d) projector to the directions across these layers.
        weight: (n,) area of S between them.
    """
    n, d = wanted.shape
    low, up = (scipy.sparse.csr_matrix((np.ones(n), (np.arange(n), end)), shape=(n, count)) for end in pairs.T)
    jump = scipy.sparse.kron(up - low, np.eye(d), format="csr")
    stiffness = STIFF * across + (weight / weight.mean())[:, None, None] * (np.eye(d) - across)
    blocks = scipy.sparse.bsr_matrix((stiffness, np.arange(n), np.arange(n + 1)), shape=(n * d, n * d))
    part = connected_components((up - low).T @ (up - low), directed=False)[1]
    ground = np.zeros(count)
    ground[np.unique(part, return_index=True)[1]] = STIFF
    matrix = jump.T @ blocks @ jump + scipy.sparse.kron(scipy.sparse.diags(ground), np.eye(d))
    factors = scipy.sparse.linalg.splu(matrix.tocsc())
    multiplier, best, last = np.zeros((n, d)), np.zeros((count, d)), np.inf
    for _ in range(200):
        T = factors.solve(jump.T @ (STIFF * (wanted + multiplier)).ravel()).reshape(count, d)
        missing = wanted - np.einsum("nij,nj->ni", across, T[pairs[:, 1]] - T[pairs[:, 0]])
        error = float(np.abs(missing).max())
        if error >= 0.9 * last:
            break
        best, last, multiplier = T, error, multiplier + missing
    return best


def extended_motion(
    joint: Joint, body_cells: IntArray, n_nodes: int, known: IntArray, values: FloatArray, fixed: IntArray
) -> FloatArray:
    """Motion (n_nodes, d) of the bodies' nodes: given at the layer's faces, harmonic inside, sliding along outer faces.

    Args:
        joint: the joint before inflating.
        body_cells: (n_cells, k) nodes of its cells, numbered as in the inflated joint.
        n_nodes: number of nodes of the inflated joint.
        known: nodes of the faces.
        values: (n, d) their motion.
        fixed: nodes of the joint that do not move, as those of periodic sides.
    """
    d, k = joint.dim, joint.corners.shape[1]
    corners = body_cells[:, :k]
    motion = np.zeros((n_nodes, d))
    motion[known] = values
    free = np.setdiff1d(np.unique(corners), np.concatenate([known, fixed]))

    moments, count = _outer_moments(joint, body_cells)
    eigenvalues, vectors = np.linalg.eigh(moments[free] / np.maximum(count[free], 1)[:, None, None])
    node, way = np.nonzero(eigenvalues < EXACT)
    unknown = np.arange(len(node))
    directions = scipy.sparse.csr_matrix(
        (
            vectors[node, :, way].ravel(),
            ((node[:, None] * d + np.arange(d)).ravel(), np.repeat(unknown, d)),
        ),
        shape=(len(free) * d, len(node)),
    )
    if len(node):
        laplacian = _laplacian(joint.points[joint.corners], corners, joint.cell_type, n_nodes)
        load = -(laplacian[free] @ motion).ravel()
        matrix = directions.T @ scipy.sparse.kron(laplacian[free][:, free], np.eye(d), format="csr") @ directions
        motion[free] = (directions @ _solve(matrix.tocsr(), directions.T @ load)).reshape(-1, d)
    if body_cells.shape[1] > k:
        between = lagrange(joint.cell_type, 1).tabulate(0, lagrange(joint.cell_type, 2).points[k:])[0, :, :, 0]
        motion[body_cells[:, k:]] = np.einsum("qn,cnd->cqd", between, motion[corners])
        motion[known] = values
    return motion


def _laplacian(x: FloatArray, corners: IntArray, cell_type: str, n: int) -> scipy.sparse.csr_matrix:
    """Stiffness matrix of -div grad on straight-sided cells x (n_cells, k, d), with quadrature at their vertices."""
    element = lagrange(cell_type, 1)
    at = element.points if is_tensor(cell_type) else element.points[:1]
    reference = element.tabulate(1, at)[1:, :, :, 0]
    jacobian = np.einsum("tqn,cnd->cqtd", reference, x)
    gradients = np.einsum("cqdt,tqn->cqnd", np.linalg.inv(jacobian), reference)
    weight = np.abs(np.linalg.det(jacobian)) / len(at)
    local = np.einsum("cqnd,cqmd,cq->cnm", gradients, gradients, weight)
    k = corners.shape[1]
    rows, columns = np.repeat(corners, k, axis=1).ravel(), np.tile(corners, (1, k)).ravel()
    return scipy.sparse.coo_matrix((local.ravel(), (rows, columns)), shape=(n, n)).tocsr()


def _solve(matrix: scipy.sparse.csr_matrix, b: FloatArray) -> FloatArray:
    """Conjugate gradients; the same on every rank, each for itself."""
    if not np.any(b):
        return np.zeros_like(b)
    A = PETSc.Mat().createAIJ(
        matrix.shape,
        csr=(matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data),
        comm=MPI.COMM_SELF,
    )
    ksp = PETSc.KSP().create(MPI.COMM_SELF)
    ksp.setOperators(A)
    ksp.setType("cg")
    ksp.getPC().setType("icc")
    ksp.setTolerances(rtol=TOLERANCE, atol=0.0, max_it=5000)
    right, x = A.createVecLeft(), A.createVecRight()
    right.array[:] = b
    ksp.solve(right, x)
    solution, reason = x.array.copy(), ksp.getConvergedReason()
    for thing in (A, ksp, right, x):
        thing.destroy()
    if reason < 0:
        raise GeometryError("the harmonic motion of the bodies' nodes was not found: the mesh has nearly flat cells")
    return solution
