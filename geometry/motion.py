"""Motion of nodes when a layer opens: directions at the faces, harmonic motion of the bodies, room for the layer."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from geometry.joint import GeometryError, Joint, place
from geometry.topology import FloatArray, IntArray, facet_normals, is_tensor, lagrange

SMOOTH = 0.01  # squared sine below which outer faces around a vertex of S count as one smooth surface
EXACT = 1e-10  # the same for the bodies' other vertices, which must stay on their outer faces
LEAST_COSINE = 0.1  # smallest cosine of the angle between S's normal and the direction in which its vertices can move
TOLERANCE = 1e-12  # relative residual of the linear solve for the harmonic motion
ASKEW = np.array(
    [1.0, 1.3, 1.7, 2.3]
)  # weights of a facet's vertices: their mean lies above no edge of an aligned grid


def face_directions(joint: Joint, nodes: IntArray, side: int) -> FloatArray:
    """Directions d (n, d) in which the nodes of S leave it, scaled to d . n = 1, from the lower to the upper body.

    At edges and corners of S this holds for each facet around a node (least squares where there are many); at the end of S
    d is along the outer faces of the body on that side.

    Args:
        joint: the joint before inflating.
        nodes: of S.
        side: 0 the lower one, 1 the upper one.

    Raises:
        GeometryError: S is folded; an outer face touches S nearly parallel to it.
    """
    surface, normals = joint.surface, joint.node_normals
    index, d = np.searchsorted(nodes, surface), joint.dim
    total, count, moment = np.zeros((len(nodes), d)), np.zeros(len(nodes)), np.zeros((len(nodes), d, d))
    np.add.at(total, index, normals)
    np.add.at(count, index, 1.0)
    np.add.at(moment, index, normals[..., :, None] * normals[..., None, :])
    folded = np.flatnonzero(np.linalg.norm(total, axis=1) < 0.3 * count)
    if len(folded):
        raise GeometryError(
            f"S is folded at {place(joint.points[nodes[folded[0]]])}: a layer there would overlap itself"
        )

    outer, faces = _outer_moments(joint, sides_at_nodes(joint)[side])
    values, vectors = np.linalg.eigh(outer[nodes] / np.maximum(faces[nodes], 1)[:, None, None])
    slip = (vectors * (values < SMOOTH)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    values, vectors = np.linalg.eigh(slip @ moment @ slip / count[:, None, None])
    inverse = np.where(values > LEAST_COSINE**2, 1 / np.maximum(values, LEAST_COSINE**2), 0.0)
    along = np.einsum("nik,nk,njk,nj->ni", vectors, inverse, vectors, np.einsum("nij,nj->ni", slip, total))
    along /= count[:, None]
    lowest = np.full(len(nodes), np.inf)
    np.minimum.at(lowest, index, np.einsum("fkd,fkd->fk", along[index], normals))
    steep = np.flatnonzero(lowest < LEAST_COSINE)
    if len(steep):
        raise GeometryError(
            f"bodies='extended' cannot keep the shape: an outer face touches S at {place(joint.points[nodes[steep[0]]])} "
            "and is nearly parallel to it, so the body cannot give way there; use bodies='kept' if S is planar"
        )
    return along


def require_no_branches(joint: Joint) -> None:
    """Raise GeometryError where more than two facets of S meet at a ridge."""
    if joint.branch is not None:
        raise GeometryError(
            f"S branches at {place(joint.branch)}, where three or more parts of the bodies meet: a layer is meshed between "
            "two sides; use the interface model"
        )


def sides_at_nodes(joint: Joint) -> tuple[IntArray, IntArray]:
    """(n_points,) the component of the cells below and above S around each node of S; -1 where there is none.

    Raises:
        GeometryError: the upper side of S changes from facet to facet.
    """
    split, found = joint.splitting.of_nodes, []
    for cells in joint.surface_cells.T:
        there = cells >= 0
        nodes, own = joint.surface[there], joint.cells[cells[there]]
        component = np.take_along_axis(split[cells[there]], (own[:, None] == nodes[:, :, None]).argmax(axis=2), axis=1)
        out = np.full(len(joint.points), -1, np.int64)
        out[nodes] = component
        changes = (out[nodes] != component).any(axis=1)
        if changes.any():
            x = joint.points[nodes[changes][0]].mean(axis=0)
            raise GeometryError(
                f"the upper side of S changes at {place(x)}: a layer needs one upper side and one lower side there"
            )
        found.append(out)
    return found[0], found[1]


def _outer_moments(joint: Joint, component: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
    """For every node the sum of m m^T over the unit normals m of outer faces there, except S, and their number.

    If `component` is given, (n_points,), only faces of cells in this component around the node count.
    """
    table = joint.table
    outer = np.setdiff1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    nodes = table.nodes(outer, joint.cells, joint.cell_type)
    normals = facet_normals(joint.points, nodes, joint.cell_type)
    counted = np.ones(nodes.shape, bool)
    if component is not None:
        counted = table.nodes(outer, joint.splitting.of_nodes, joint.cell_type) == component[nodes]
    moments, count = np.zeros((len(joint.points), joint.dim, joint.dim)), np.zeros(len(joint.points))
    np.add.at(moments, nodes, (counted[..., None] * normals)[..., :, None] * normals[..., None, :])
    np.add.at(count, nodes, counted.astype(float))
    return moments, count


def extended_motion(
    joint: Joint, body_cells: IntArray, n_nodes: int, known: IntArray, values: FloatArray
) -> FloatArray:
    """Motion (n_nodes, d) of the bodies' nodes: given at the layer's faces, harmonic inside, sliding along outer faces.

    Args:
        joint: the joint before inflating.
        body_cells: (n_cells, k) nodes of its cells, numbered as in the inflated joint.
        n_nodes: number of nodes of the inflated joint.
        known: nodes of the faces.
        values: (n, d) their motion.
    """
    d, k = joint.dim, joint.corners.shape[1]
    corners = body_cells[:, :k]
    motion = np.zeros((n_nodes, d))
    motion[known] = values
    free = np.setdiff1d(np.unique(corners), known)

    moments, count = _outer_moments(joint)
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


def require_room(joint: Joint, n: FloatArray, eps: float) -> None:
    """Raise GeometryError if the body below S, or the layer on a rigid base, moved by -eps n, hits the upper body."""
    table = joint.table
    outer = np.union1d(np.flatnonzero(table.cells[:, 1] < 0), joint.surface_rows)
    on_s = np.isin(outer, joint.surface_rows)
    pieces, under = joint.splitting.pieces, joint.surface_cells[:, 0]
    below = on_s | np.isin(pieces[table.cells[outer, 0]], pieces[under[under >= 0]])
    moving, fixed = outer[below], outer[~below]
    for rows, others, way in ((moving, fixed, -1.0), (fixed, moving, 1.0)):
        corners = table.vertices[rows]
        weights = ASKEW[: corners.shape[1]] / ASKEW[: corners.shape[1]].sum()
        probes = np.concatenate([joint.points[np.unique(corners)], weights @ joint.points[corners]])
        x = _first_hit(joint, probes, others, way * n, eps)
        if x is not None:
            raise GeometryError(
                f"no room for a layer of thickness {eps:g} at {place(x)}: moved apart, the bodies would overlap"
            )


def _first_hit(joint: Joint, x: FloatArray, rows: IntArray, way: FloatArray, eps: float) -> FloatArray | None:
    """The first of the points (n, d) that meets one of the facets on its way, a length eps along a unit vector."""
    nodes = joint.table.nodes(rows, joint.corners, joint.cell_type)
    if is_tensor(joint.cell_type) and joint.dim == 3:
        nodes = np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [3, 1, 2]]])
    facets = joint.points[nodes]
    tolerance = 1e-9 * float(np.ptp(joint.points, axis=0).max())
    start, heights = x @ way, facets @ way
    near = (heights.max(axis=1) > start.min(initial=np.inf) + tolerance) & (
        heights.min(axis=1) < start.max(initial=-np.inf) + eps
    )
    plane = np.linalg.svd(way[None])[2][1:]
    for facet, height in zip(facets[near] @ plane.T, heights[near], strict=True):
        edges = (facet[1:] - facet[0]).T
        if abs(np.linalg.det(edges)) < tolerance ** (joint.dim - 1):
            continue  # the facet is parallel to the way
        weights = np.linalg.solve(edges, (x @ plane.T - facet[0]).T).T
        gap = height[0] + weights @ (height[1:] - height[0]) - start
        inside = (weights > 1e-9).all(axis=1) & (weights.sum(axis=1) < 1 - 1e-9)
        hit = np.flatnonzero(inside & (gap > tolerance) & (gap < eps))
        if len(hit):
            return np.asarray(x[hit[0]], float)
    return None
