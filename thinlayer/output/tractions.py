"""Tractions on S in a state: from interface laws, from meshed layers, and from the nodal forces of the bodies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from weakref import WeakKeyDictionary

import basix
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
import ufl
from dolfinx import fem
from scipy.spatial import cKDTree
from ufl.classes import Zero

from forms.base import Array, InputError
from forms.tensors import Expr, mandel_tensor, mandel_vectors
from geometry.domain import cell_nodes
from geometry.topology import BoolArray, IntArray, lagrange
from thinlayer.discretisation.form_compilation import column_numbers
from thinlayer.discretisation.layer import SeamLayer, law_with_numbers
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import contact_values
from thinlayer.output.nodal_forces import layer_forces
from thinlayer.pointwise.quadrature import Quadrature
from thinlayer.surface.law_points import LawPoints, law_points
from thinlayer.surface.surface_mesh import FacetPoints, SurfaceMesh

# relative tolerances of LSQR for consistent tractions, and its limit of iterations: uniform meshes need 29 to 45
LSQR_OPTIONS = {"atol": 1e-15, "btol": 1e-15, "iter_lim": 2000}
_UNIT_STRESS_TRACTIONS: WeakKeyDictionary[Quadrature, Array] = WeakKeyDictionary()
CENTRE_DISTANCE = 1e-9  # largest distance of the centres of a facet and of its column, over the size of the joint


# ---------------------------------------------------------------- of layers
def layer_tractions(surface: SurfaceMesh, state: State) -> Array:
    """Return the tractions (m, d) of layers and contact laws at the m nodes of S, in d dimensions. Collective.

    Tractions of layers at quadrature points are projected in L2 to functions that are linear on each facet. The mass
    matrix of the projection is lumped if the surface's model has a contact law. Contact laws have their tractions at
    the nodes.
    """
    moments = np.zeros((*surface.corners.shape, surface.joint.dim))
    for points, rows in layer_points(surface, state):
        add = _add_law_moments if points.quadrature.region.dim < surface.joint.dim else _add_cell_moments
        add(moments, surface, rows, points)
    moments = state.model.comm.allreduce(moments)
    nodal = surface.lumped(moments) if surface.model.contact else surface.projected(moments)
    if state.model.contacts and (of_contact := contact_values(surface, state)):
        nodal += np.einsum("nij,ni->nj", of_contact["frames"], np.column_stack([of_contact["t_T"], -of_contact["p"]]))
    return nodal


def layer_points(surface: SurfaceMesh, state: State) -> Iterator[tuple[LawPoints, IntArray]]:
    """Yield each layer law's quadrature points, and the facets of the surface to which they belong. Collective.

    Yields:
        Pairs of the quadrature points and an array of integers. For each facet of an interface law, or each
        cell of a meshed layer, the array has the number of the facet on the surface, or -1. It is -1 for facets of
        other seams, and for cells where layers meet.
    """
    joint = surface.joint
    place = np.full(len(joint.table.vertices), -1)
    place[joint.surface_rows[surface.rows]] = np.arange(len(surface.rows))
    columns = _facet_of_cells(surface, state) if not state.model.broken else None
    for points in law_points(state):
        if points.quadrature.region.dim < joint.dim:
            yield points, place[points.entities]
        elif points.term.n is not None and columns is not None:
            yield points, columns[points.entities]


def _add_law_moments(moments: Array, surface: SurfaceMesh, rows: IntArray, points: LawPoints) -> None:
    """Add to `moments` the integrals of an interface law's traction times the shape functions of degree 1.

    Args:
        moments: (n, k, d) integrals, a force for each of the k corners of n facets of the surface; changed.
        surface: the surface.
        rows: for each facet where the law acts, its number on the surface; -1: it is not on this surface.
        points: quadrature points of the law.
    """
    rule, mine = surface.rule(points.quadrature.degree), rows[rows >= 0]
    t = _point_tractions(points)[points_of_rule(rule, rows, points)]
    np.add.at(moments, mine, np.einsum("fq,fqa,fqd->fad", rule.weights[mine], rule.shapes[mine], t))


def points_of_rule(rule: FacetPoints, rows: IntArray, points: LawPoints) -> IntArray:
    """Find, for the quadrature points on a surface, the points of a law that coincide with them.

    Args:
        rule: quadrature points of the surface, q on each facet, of the same degree as those of the law.
        rows: for each facet where the law acts, its number on the surface; -1: it is not on this surface.
        points: quadrature points of the law.

    Returns:
        (facets, q) numbers of the law's points, for the facets where `rows` is not -1. The q points of a facet have the
        order of `rule`.
    """
    q = points.quadrature
    cells, there = q.cells[rows >= 0], np.moveaxis(rule.x[:, rows[rows >= 0]], 0, -1)
    order = np.linalg.norm(there[:, :, None] - q.joint_x.T[cells][:, None], axis=3).argmin(axis=2)
    return np.take_along_axis(cells, order, axis=1)


def _point_tractions(points: LawPoints) -> Array:
    """Return the tractions (points, d) of an interface law, conjugate to the jump, at the law's quadrature points.

    A traction times a virtual jump is the virtual work of the law's stresses per area of S.
    """
    q, stress = points.quadrature, points.stress()
    if points.term.traction is None:
        return np.asarray(np.einsum("pij,pj->pi", stress, q.n)[:, : q.dim])
    if q not in _UNIT_STRESS_TRACTIONS:
        _UNIT_STRESS_TRACTIONS[q] = _unit_stress_tractions(points.term.traction, q)
    return np.asarray(np.einsum("pkd,pk->pd", _UNIT_STRESS_TRACTIONS[q], mandel_vectors(stress)))


def _unit_stress_tractions(traction: Callable[[Expr], Expr], q: Quadrature) -> Array:
    """Return the tractions (points, 6, d) that belong to the six unit stresses in Mandel notation, in d dimensions.

    Args:
        traction: function of the law from a UFL stress to the UFL traction that is conjugate to the jump.
        q: quadrature points of the law on S.
    """
    units = [mandel_tensor(ufl.as_vector([float(i == k) for i in range(6)])) for k in range(6)]
    components = [t[i] for t in map(traction, units) for i in range(q.dim)]
    if all(isinstance(t, Zero) for t in components):  # a station whose strain does not depend on [u]
        return np.zeros((q.count, 6, q.dim))
    return q.values(ufl.as_vector(components)).reshape(q.count, 6, q.dim)


def _facet_of_cells(surface: SurfaceMesh, state: State) -> IntArray:
    """Return for each cell of the joint the number of the facet on the surface from which the cell was extruded.

    The number is -1 for cells of bodies, for cells where layers meet, and for cells of layers on other seams.
    """
    joint = surface.joint
    numbers, centres = column_numbers(state.model.domain.joint)
    distance, row = cKDTree(joint.points[surface.corners].mean(axis=1)).query(centres)
    row = np.where(distance <= CENTRE_DISTANCE * joint.size, row, -1)
    return np.where(numbers >= 0, row[numbers], -1)


def _add_cell_moments(moments: Array, surface: SurfaceMesh, rows: IntArray, points: LawPoints) -> None:
    """Add to `moments` the integrals of the mean traction through a meshed layer times the shape functions of degree 1.

    Args:
        moments: (n, k, d) integrals, a force for each of the k corners of n facets of the surface; changed.
        surface: the surface.
        rows: for each cell of the layer the number of the facet on the surface from which it was extruded; -1: it is on
            no facet of the surface.
        points: quadrature points of the law of the layer, or of one sublayer.
    """
    joint, q, mine = surface.joint, points.quadrature, np.flatnonzero(rows >= 0)
    layer = next(seam_layer for seam_layer in points.state.model.layers.values() if seam_layer.key == points.term.key)
    cells, rows = q.cells[mine], rows[mine]
    X, _ = basix.make_quadrature(basix.CellType[joint.cell_type], q.degree)
    shapes, region = lagrange(joint.cell_type, 1).tabulate(0, X)[0, :, :, 0], q.region.mesh
    vertices = np.asarray(region.geometry.input_global_indices)[cell_nodes(region)[mine][:, : shapes.shape[1]]]
    on_s, reference = joint.points[surface.corners[rows]], points.state.model.domain.joint.reference[vertices]
    corner = np.linalg.norm(reference[:, :, None] - on_s[:, None], axis=3).argmin(axis=2)
    N = np.einsum("qc,fca->fqa", shapes, (corner[..., None] == np.arange(on_s.shape[1])).astype(float))
    eps = np.einsum("fqa,fa->fq", N, surface.thickness(layer, surface.corners[rows]))
    n = q.n[:, : joint.dim]
    t = np.einsum("pij,pj->pi", points.stress(), q.n)[:, : joint.dim]
    along, across = _sublayer_weights(layer, points)
    t = along * t + (across - along) * np.einsum("pi,pi,pj->pj", t, n, n)
    np.add.at(moments, rows, np.einsum("fq,fqa,fqd->fad", q.weights[cells] / eps, N, t[cells]))


def _sublayer_weights(layer: SeamLayer, points: LawPoints) -> tuple[float, float]:
    """Return the weights of a sublayer's tangential and normal traction in the mean through the layer's thickness.

    A weight is the sublayer's fraction of the jump, divided by its fraction of the thickness. The work of this mean in
    the jump is then the sum of the sublayers' work. In elastic layers the fraction of the jump follows from the
    sublayers' compliances. In layers of one material, and in layers that are not elastic, both weights are 1.

    Args:
        layer: the layer.
        points: quadrature points of the sublayer's law.
    """
    if len(layer.law.sublayers) == 1:
        return 1.0, 1.0
    model = points.state.model
    sublayers = law_with_numbers(layer.layer, model.kinematics).sublayers
    try:
        moduli = [law.elastic_moduli() for _, law in sublayers]
    except InputError:
        return 1.0, 1.0
    k = [p.measure for p in model.layer_terms if p.key == layer.key].index(points.term.measure)
    shares = np.array([(a / mu, a / (lmbda + 2 * mu)) for (a, _), (lmbda, mu) in zip(sublayers, moduli, strict=True)])
    along, across = shares[k] / shares.sum(axis=0) / sublayers[k][0]
    return float(along), float(across)


# ---------------------------------------------------------------- of the bodies' nodal forces
def consistent_tractions(surface: SurfaceMesh, state: State, *, joined: bool = False) -> Array:
    """Return the tractions (m, d) at the m nodes of S that are equivalent to the bodies' nodal forces.

    Collective. d is the number of dimensions. The tractions are linear on each facet. `Surface.reaction` tells which
    are chosen if the nodal forces do not determine them, as where supports act.

    Args:
        surface: all of S.
        state: the state.
        joined: whether bonded bodies count as one body, so that only layers exert forces at S. If not, bonded bodies
            exert forces on each other.
    """
    model, d = state.model, surface.joint.dim
    r = layer_forces(state, joined)
    bc_marker = fem.Function(r.function_space)
    bc_marker.x.array[model.bc_dofs_in(r.function_space)] = 1.0
    bc_marker.x.scatter_forward()
    # both of shape (2, n, k, d)
    forces, fixed = (np.moveaxis(surface.sides(f, model, surface.corner_points), 1, -1) for f in (r, bc_marker))
    sides, count = _side_nodes(surface, joined)
    force, valid = np.zeros((count, d)), np.zeros((count, d), bool)
    force[sides], valid[sides] = forces, fixed < 0.5
    there, is_split = np.zeros(count, bool), sides[0] != sides[1]
    tip = surface.sums(is_split.astype(float)) == 0  # both sides share one node there
    there[sides[1][is_split]] = True
    there[sides[0][is_split & (surface.cells[:, :1] >= 0)]] = True  # the forces of a rigid base are unknown
    valid &= there[:, None]
    both = np.stack([sides.ravel(), np.broadcast_to(surface.nodes, sides.shape).ravel()])
    single = np.bincount(np.unique(both, axis=1)[0], minlength=count) == 1  # elsewhere forces of several seams add up
    areas = surface.areas
    M = _to_sides(surface, sides, count)
    around = np.where(there, np.abs(M) @ np.ones(len(areas)), 1.0)
    out = np.zeros((len(areas), d))
    for k in range(d):
        guess, rows = _lumped(surface, sides, force[:, k] / around, valid[:, k] & single), np.flatnonzero(valid[:, k])
        guess, scale = np.where(tip, 0.0, [guess, areas**-0.5])
        A = scipy.sparse.diags(around[rows] ** -0.5) @ M[rows] @ scipy.sparse.diags(scale)
        b = (force[rows, k] - M[rows] @ guess) * around[rows] ** -0.5
        size = np.abs(b).max(initial=0.0) or 1.0
        out[:, k] = guess + size * scale * scipy.sparse.linalg.lsqr(A, b / size, **LSQR_OPTIONS)[0]
    return out


def _side_nodes(surface: SurfaceMesh, joined: bool) -> tuple[IntArray, int]:
    """Number the nodes of the bodies on S, where each body has a node of its own at a vertex of S.

    Args:
        surface: the surface, with n facets of k corners.
        joined: whether bonded bodies share one node.

    Returns:
        (2, n, k) numbers of the nodes at each corner, first of the body below S, then of the body above; the number of
        nodes.
    """
    joint = surface.joint
    cut = surface.model.split_mesh if joined else joint.split_mesh
    of = np.stack([joint.components_at(cells, surface.corners, cut) for cells in surface.cells.T])
    numbers = joint.masters[surface.corners] * (of.max() + 2) + of + 1
    unique, positions = np.unique(numbers, return_inverse=True)
    return positions.reshape(numbers.shape), len(unique)


def _to_sides(surface: SurfaceMesh, sides: IntArray, count: int) -> scipy.sparse.csr_matrix:
    """Return the sparse matrix (count, m) that converts nodal values of a traction on S to nodal forces on the bodies.

    The traction acts on the lower body, and its opposite on the upper body.

    Args:
        surface: the surface, with n facets of k corners.
        sides: (2, n, k) numbers of the bodies' nodes below and above the corners.
        count: number of the bodies' nodes.
    """
    M = np.einsum("fq,qa,qb->fab", surface.weights, surface.shapes, surface.shapes)
    rows, columns = np.broadcast_arrays(sides[..., None], surface.nodes[:, None])  # (2, n, k, k)
    values, shape = np.stack([M, -M]), (count, len(surface.numbers))
    return scipy.sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _lumped(surface: SurfaceMesh, sides: IntArray, means: Array, valid: BoolArray) -> Array:
    """Estimate one component of the traction at the m nodes of S (m,), from nodal forces divided by areas.

    Args:
        surface: the surface, with n facets of k corners.
        sides: (2, n, k) numbers of the bodies' nodes below and above the corners.
        means: (count,) force over area at each of the bodies' nodes.
        valid: (count,) whether this force is known. Nodes of S without such a force get the mean over their neighbours.
    """
    signs = np.array([1.0, -1.0])[:, None, None]
    counts = surface.sums(valid[sides].sum(axis=0).astype(float))
    nodal = surface.sums((signs * means[sides] * valid[sides]).sum(axis=0)) / np.maximum(counts, 1.0)
    seen = np.minimum(counts, 1.0)[surface.nodes]
    of_facets = seen.sum(axis=1)
    mean = (nodal[surface.nodes] * seen).sum(axis=1) / np.maximum(of_facets, 1.0)
    around = np.broadcast_to(np.minimum(of_facets, 1.0)[:, None], surface.nodes.shape)
    neighbour_mean = surface.sums(mean[:, None] * around) / np.maximum(surface.sums(around), 1.0)
    return np.where(counts > 0, nodal, neighbour_mean)
