"""Stresses, internal variables and tractions of laws at points in a state, and volume fractions of a layer's phases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import basix
import numpy as np
import ufl
from dolfinx import fem
from scipy.spatial import cKDTree
from ufl.classes import Zero

from forms.base import Array, InputError
from forms.law import BulkLaw, Law
from forms.tensors import MANDEL_PAIRS, Expr, mandel_tensor, mandel_tensors, mandel_vector, mandel_vectors
from forms.traits import VARIABLE_SIZES
from forms.work import Term, stress
from geometry.domain import cell_nodes
from geometry.topology import IntArray, lagrange
from thinlayer.discretisation.form_compilation import column_numbers, law_with_expressions
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.layer import SeamLayer, law_with_numbers
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.pointwise.quadrature import Quadrature
from thinlayer.surface.surface_mesh import FacetPoints, SurfaceMesh

_UNIT_STRESS_TRACTIONS: WeakKeyDictionary[Quadrature, Array] = WeakKeyDictionary()

UNNAMED_MEMORY_KEY = "memory"  # name of the internal values of a law that does not name them
CENTRE_TOLERANCE = 1e-9  # largest distance of the centres of a facet and of its column, over the size of the joint
_QUADRATURES: WeakKeyDictionary[Model, list[Quadrature]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class LawPoints:
    """This rank's quadrature points of one law, with stresses and internal variables there in a state.

    Attributes:
        state: the state.
        term: virtual work of the law at the time of the state. Its prescribed strain includes the mean strain of a
            periodic cell under a prescribed mean stress.
        quadrature: the quadrature points of the law.
        key: key of a compiled law in `State.memory`; "" for a law that is not compiled.
    """

    state: State
    term: Term
    quadrature: Quadrature
    key: str

    def stress(self) -> Array:
        """Return the stresses (points, 3, 3), with the pressure of an incompressible law. Collective."""
        term, points = self.term, self.quadrature
        if term.law.traits.compiled:
            mandel_stresses = self.state.stresses.get(self.key, np.zeros((points.count, len(MANDEL_PAIRS))))
        else:
            mandel_stresses = points.values(mandel_vector(stress(term, self.state.u)))
        return mandel_tensors(mandel_stresses) + self._pressure()[:, None, None] * np.eye(3)

    def _pressure(self) -> Array:
        """Return the pressure (points,) of an incompressible law, positive in tension; zeros for other laws."""
        if not self.term.law.traits.constrained:
            return np.zeros(self.quadrature.count)
        region = self.quadrature.region
        p = self.state.fields[str(Key.parse(self.term.key).pressure_key)]
        region_p = fem.Function(fem.functionspace(region.mesh, ("Lagrange", 1)))
        region_p.x.array[region_p.function_space.dofmap.list] = p.x.array[p.function_space.dofmap.list]
        return self.quadrature.values(ufl.as_vector([region.plus_side(region_p)]))[:, 0]

    def internal(self) -> list[dict[str, Array]]:
        """Return the internal variables of each sublayer: name -> values (points, *shape), with the variable's shape.

        The list has one dictionary for each sublayer, from the lower to the upper face. A law that is no `Stack` is one
        sublayer.
        """
        sublayers = [law for _, law in self.term.law.sublayers]
        if not self.key:
            return [{} for _ in sublayers]
        memory = self.state.memory.get(self.key, np.zeros((self.quadrature.count, self.term.law.memory)))
        memory_sizes = [law.memory for law in sublayers]
        slices = np.split(memory[:, self.term.law.memory - sum(memory_sizes) :], np.cumsum(memory_sizes)[:-1], axis=1)
        return [unpack_memory(law, values) for law, values in zip(sublayers, slices, strict=True)]


def seams_with_shares(model: Model) -> list[str]:
    """Return the names of the seams whose layers have phases or can break; only for them `layer_shares` has numbers."""
    return [name for name, layer in model.layers.items() if share_columns(layer.law)]


def share_columns(law: Law) -> tuple[str, ...]:
    """Return the names of the numbers that `layer_shares` computes for a layer with the law `law`.

    The result is () if the law has no phases and cannot break.
    """
    return tuple(dict.fromkeys(name for _, sublayer in law.sublayers for name in sublayer.share_columns))


def layer_shares(state: State, seam: str) -> dict[str, float]:
    """Return which volume fractions of a layer's material are in phases 1 and -1, or are broken. Collective.

    A point's phase is a number in [-1, 1]: -1, 0 and 1 are pure phases. Any other value is a mixture with phase 0. Its
    absolute value is then the volume fraction of phase 1 (or -1).

    Args:
        state: state of a full or an interface model.
        seam: name of the layer's seam.

    Returns:
        Numbers by the names that the law declares (`share_columns`). For a layer with phases they are:

        - "plus", "minus": volume fractions of phases 1 and -1 in those sublayers that have phases;
        - "boundary": mean thickness of phase 0 over S, a length. If the other phases lie above phase 0, it is the
          height of the phase boundary above the lower face. For the bar of section 6.2 of the paper it is the position
          of the phase boundary in Eq. (47), there called eps S.
    """
    model, layer, shares = state.model, state.model.layers[seam], dict[str, float]()
    eps = float(layer.thin_layer.eps) if layer.thin_layer else 0.0
    layer_points = [LawPoints(state, q.term, q, key) for key, q in model.quadratures.items() if q.term.key == layer.key]
    for names in dict.fromkeys(law.share_columns for _, law in layer.law.sublayers if law.share_columns):
        share_sums: dict[str, float] = {}
        for points in layer_points:
            for (a, law), internal in zip(points.term.law.sublayers, points.internal(), strict=True):
                if law.share_columns == names:
                    weights = a * points.quadrature.weights
                    integrals = {name: weights @ values for name, values in law.shares(internal).items()}
                    for name, value in (integrals | {"": weights.sum()}).items():
                        share_sums[name] = share_sums.get(name, 0.0) + value
        totals = dict(zip(share_sums, map(float, model.comm.allreduce(np.array([*share_sums.values()]))), strict=True))
        fraction = sum(a for a, law in layer.law.sublayers if law.share_columns == names)
        law = next(law for _, law in layer.law.sublayers if law.share_columns == names)
        shares |= law.mean_shares(totals, totals.pop(""), eps, fraction)
    return shares


def law_points(state: State) -> Iterator[LawPoints]:
    """Yield the `LawPoints` of each law in `state`, first of bodies, then of layers. Collective.

    Contact laws, which have no quadrature points, are left out.
    """
    model = state.model
    key_of_term = {id(q.term): key for key, q in model.quadratures.items()}
    if model not in _QUADRATURES:
        by_term = {id(q.term): q for q in model.quadratures.values()}
        _QUADRATURES[model] = [by_term.get(id(term)) or Quadrature(model.V, term, model.origin) for term in model.terms]
    for model_term, term, quadrature in zip(model.terms, state.bodies + state.layers, _QUADRATURES[model], strict=True):
        yield LawPoints(state, term, quadrature, key_of_term.get(id(model_term), ""))


def layer_points(surface: SurfaceMesh, state: State) -> Iterator[tuple[LawPoints, IntArray]]:
    """Yield each layer law's quadrature points, and the facets of the surface to which they belong. Collective.

    Yields:
        Pairs of the quadrature points and an array of integers. For each facet of an interface law, or each
        cell of a meshed layer, the array has the number of the facet on the surface, or -1. It is -1 for facets of
        other seams, and for cells where layers meet.
    """
    joint = surface.joint
    column, column_centres = column_numbers(state.model.domain.joint)
    distance, facet_of_column = cKDTree(joint.points[surface.corners].mean(axis=1)).query(column_centres)
    facet_of_column = np.where(distance <= CENTRE_TOLERANCE * joint.size, facet_of_column, -1)
    facets = np.where(column >= 0, facet_of_column[column], -1)
    for points in law_points(state):
        if points.term.n is not None:
            yield points, facets[points.quadrature.entity_numbers]


def unpack_memory(law: BulkLaw, memory: Array) -> dict[str, Array]:
    """Split the `memory` (points, values) of `law` into its internal variables: name -> values (points, *shape).

    A law that does not name its internal variables gets one entry with all values.
    """
    ends = np.cumsum([VARIABLE_SIZES[shape] for shape in law.internal.values()], dtype=int)
    if ends.max(initial=0) != memory.shape[1]:
        return {UNNAMED_MEMORY_KEY: memory}
    variables = zip(law.internal.items(), np.split(memory, ends, axis=1), strict=False)  # the last part is empty
    return {name: mandel_tensors(q) if shape == (3, 3) else q if shape else q[:, 0] for (name, shape), q in variables}


# ---------------------------------------------------------------- tractions
def law_tractions(surface: SurfaceMesh, state: State) -> Array:
    """Return the tractions (m, d) of layers, without contact laws, at the m nodes of S, in d dimensions. Collective.

    Tractions at quadrature points are projected in L2 to functions that are linear on each facet. The mass matrix of
    the projection is lumped if the surface's model has a contact law.
    """
    corner_forces = np.zeros((*surface.corners.shape, state.model.n_components))
    for points, facets in layer_points(surface, state):
        add_forces = _add_interface_forces if points.quadrature.region.dim < surface.joint.dim else _add_meshed_forces
        add_forces(corner_forces, surface, facets, points)
    corner_forces = state.model.comm.allreduce(corner_forces)
    return surface.lumped(corner_forces) if surface.model.contact else surface.projected(corner_forces)


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
    t = tangential_weight * (t - t_N) + np.reshape(normal_weight, (-1, 1)) * t_N
    np.add.at(corner_forces, facets, np.einsum("fq,fqa,fqd->fad", q.weights[point_ids] / point_eps, N, t[point_ids]))


def _sublayer_weights(layer: SeamLayer, points: LawPoints) -> tuple[float, float | Array]:
    """Return the weights of a sublayer's tangential and normal traction in the mean through the layer's thickness.

    A weight is the sublayer's fraction of the jump, divided by its fraction of the thickness. The work of this mean in
    the jump is then the sum of the sublayers' work. In elastic layers the fraction of the jump follows from the
    sublayers' compliances. In layers of one material, and in layers that are not elastic, both weights are 1.

    Fluxes have the second weight, by the conductivities of the sublayers; (points,) if these vary along S.

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
        if layer.law.fields and layer.law.traits.linear:
            across = np.array([_conductivities_across(points, law) for _, law in sublayers])
        return 1.0, 1 / across[k] / (fractions @ (1 / across))
    try:
        lame = [law.elastic_moduli() for _, law in sublayers]
    except InputError:
        return 1.0, 1.0
    compliance = np.array([(a / mu, a / (lmbda + 2 * mu)) for (a, _), (lmbda, mu) in zip(sublayers, lame, strict=True)])
    tangential_weight, normal_weight = compliance[k] / compliance.sum(axis=0) / sublayers[k][0]
    return float(tangential_weight), float(normal_weight)


def _conductivities_across(points: LawPoints, law: BulkLaw) -> Array:
    """Return the conductivities (points,) across the layer of a sublayer's law, at points in its cells. Collective."""
    q = points.quadrature
    f = q.region_function(np.column_stack([q.n, *law.fields_at(q.joint_x).values()]))
    parameters = {name: f[k] for k, name in enumerate(law.fields, 3)}
    local: Any = law_with_expressions(law, q.region.mesh, parameters)
    return q.values(ufl.as_vector([local.conductivity_across(ufl.as_vector([f[i] for i in range(q.dim)]))]))[:, 0]
