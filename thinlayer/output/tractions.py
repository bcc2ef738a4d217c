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
    """Tractions (m, d) of layers and contact laws at the m nodes of S in d dimensions. Collective.

    They are the L2 projection of the tractions at quadrature points to functions linear on each facet. With a contact
    law in the surface's model, the mass matrix of the projection is lumped.
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
    """Yield the quadrature points of each layer's law, and the facets of the surface they belong to. Collective.

    The second value of a pair is the number on the surface of the facet of each of the law's facets or layer cells. It
    is -1 where there is none, as in cells where layers meet.
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
        moments: (n, k, d) integrals for the k corners of n facets of the surface.
        surface: the surface.
        rows: number on the surface of the facet of each of the law's facets; -1: not on this surface.
        points: quadrature points of the law.
    """
    rule, mine = surface.rule(points.quadrature.degree), rows[rows >= 0]
    t = _point_tractions(points)[points_of_rule(rule, rows, points)]
    np.add.at(moments, mine, np.einsum("fq,fqa,fqd->fad", rule.weights[mine], rule.shapes[mine], t))


def points_of_rule(rule: FacetPoints, rows: IntArray, points: LawPoints) -> IntArray:
    """Find which of the law's points coincides with each quadrature point of a surface.

    Args:
        rule: quadrature points of the surface, of the same degree as those of the law.
        rows: number on the surface of the facet of each of the law's facets; -1: not on this surface.
        points: quadrature points of the law.

    Returns:
        (facets, q) numbers of the law's points, for the facets other than -1, in the order of the rule's q points.
    """
    q = points.quadrature
    cells, there = q.cells[rows >= 0], np.moveaxis(rule.x[:, rows[rows >= 0]], 0, -1)
    order = np.linalg.norm(there[:, :, None] - q.joint_x.T[cells][:, None], axis=3).argmin(axis=2)
    return np.take_along_axis(cells, order, axis=1)


def _point_tractions(points: LawPoints) -> Array:
    """Tractions (points, d) of an interface law, conjugate to the jump: the virtual work of its stresses per area."""
    q, stress = points.quadrature, points.stress()
    if points.term.traction is None:
        return np.asarray(np.einsum("pij,pj->pi", stress, q.n)[:, : q.dim])
    if q not in _UNIT_STRESS_TRACTIONS:
        _UNIT_STRESS_TRACTIONS[q] = _unit_stress_tractions(points.term.traction, q)
    return np.asarray(np.einsum("pkd,pk->pd", _UNIT_STRESS_TRACTIONS[q], mandel_vectors(stress)))


def _unit_stress_tractions(traction: Callable[[Expr], Expr], q: Quadrature) -> Array:
    """Tractions (points, 6, d) of the six unit stresses in Mandel notation, at the points of a law on S.

    Args:
        traction: the law's function from a UFL stress to its UFL traction.
        q: the points.
    """
    units = [mandel_tensor(ufl.as_vector([float(i == k) for i in range(6)])) for k in range(6)]
    components = [t[i] for t in map(traction, units) for i in range(q.dim)]
    if all(isinstance(t, Zero) for t in components):  # a station whose strain does not depend on [u]
        return np.zeros((q.count, 6, q.dim))
    return q.values(ufl.as_vector(components)).reshape(q.count, 6, q.dim)


def _facet_of_cells(surface: SurfaceMesh, state: State) -> IntArray:
    """Number on the surface of the facet from which each cell of a meshed layer was extruded.

    It is -1 in bodies, where layers meet, and for layers of other seams.
    """
    joint = surface.joint
    numbers, centres = column_numbers(state.model.domain.joint)
    distance, row = cKDTree(joint.points[surface.corners].mean(axis=1)).query(centres)
    row = np.where(distance <= CENTRE_DISTANCE * joint.size, row, -1)
    return np.where(numbers >= 0, row[numbers], -1)


def _add_cell_moments(moments: Array, surface: SurfaceMesh, rows: IntArray, points: LawPoints) -> None:
    """Add to `moments` the integrals of the mean traction through a meshed layer times the shape functions of degree 1.

    Args:
        moments: (n, k, d) integrals for the k corners of n facets of the surface.
        surface: the surface.
        rows: number on the surface of the facet of each layer cell; -1: none.
        points: quadrature points of the layer's law.
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
    """Weights of a sublayer's tangential and normal traction in the mean through the layer's thickness.

    A weight is the sublayer's fraction of the jump, divided by its fraction of the thickness. The mean is then
    conjugate to the jump. In elastic layers these fractions of the jump follow from the sublayers' compliances. In
    other layers, and in layers of one material, both weights are 1.
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
    """Tractions (m, d) at the nodes of S that are equivalent to the nodal forces of the bodies. Collective.

    The tractions are linear on each facet; `Surface.reaction` says how they are chosen where supports hide the forces.

    Args:
        surface: all of S, with m nodes in d dimensions.
        state: the state.
        joined: whether to regard bonded bodies as one body. Only layers then exert forces at S.
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
    """Number the nodes that the bodies have at the corners of the facets of S, one for each body at a vertex.

    Args:
        surface: the surface, with n facets of k corners.
        joined: whether bonded bodies share one node.

    Returns:
        (2, n, k) numbers of the nodes below and above the corners, and the number of nodes.
    """
    joint = surface.joint
    cut = surface.model.split_mesh if joined else joint.split_mesh
    of = np.stack([joint.components_at(cells, surface.corners, cut) for cells in surface.cells.T])
    numbers = joint.masters[surface.corners] * (of.max() + 2) + of + 1
    unique, positions = np.unique(numbers, return_inverse=True)
    return positions.reshape(numbers.shape), len(unique)


def _to_sides(surface: SurfaceMesh, sides: IntArray, count: int) -> scipy.sparse.csr_matrix:
    """Matrix (count, m) from the values of tractions at the m nodes of S to nodal forces on the bodies.

    `sides` has the numbers of the bodies' nodes below and above the facets' corners, `count` is how many there are.
    """
    M = np.einsum("fq,qa,qb->fab", surface.weights, surface.shapes, surface.shapes)
    rows, columns = np.broadcast_arrays(sides[..., None], surface.nodes[:, None])  # (2, n, k, k)
    values, shape = np.stack([M, -M]), (count, len(surface.numbers))
    return scipy.sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _lumped(surface: SurfaceMesh, sides: IntArray, means: Array, valid: BoolArray) -> Array:
    """First guess of one component of the tractions at the m nodes of S, from nodal forces over areas.

    Args:
        surface: the surface.
        sides: (2, n, k) numbers of the bodies' nodes below and above the facets' corners.
        means: force over area at each node of the bodies.
        valid: where this value is known. Elsewhere the guess is the mean over neighbouring nodes of S.
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
