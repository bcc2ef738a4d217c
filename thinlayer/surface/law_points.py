"""Stresses and internal variables of laws at quadrature points in a state, and volume fractions of a layer's phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem
from scipy.spatial import cKDTree

from forms.base import Array
from forms.law import BulkLaw, Law
from forms.tensors import MANDEL_PAIRS, mandel_tensors, mandel_vector
from forms.traits import VARIABLE_SIZES
from forms.work import Term, stress
from geometry.topology import IntArray
from thinlayer.discretisation.form_compilation import column_numbers
from thinlayer.discretisation.key import Key
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.pointwise.quadrature import Quadrature
from thinlayer.surface.surface_mesh import SurfaceMesh

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
