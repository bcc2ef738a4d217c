"""Stresses and internal variables of all laws of a state, at the quadrature points where the laws act."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem

from forms.base import Array
from forms.declarations import SIZES
from forms.kinematics import MANDEL, mandel, tensors
from forms.law import BulkLaw
from forms.work import Term, stress
from geometry.topology import IntArray
from thinlayer.discretisation.layer import LAYER, PRESSURE
from thinlayer.discretisation.measures import compiled_terms
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.pointwise.quadrature import Quadrature

MEMORY = "memory"  # name of the internal values of a law that does not name them
_FOUND: WeakKeyDictionary[Model, list[Quadrature]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class LawPoints:
    """The quadrature points of one term in a state, those of this rank.

    Attributes:
        state: the state.
        term: the term, with the strains that are given or found beside those of u.
        quadrature: its points.
        key: of what its law remembers, in `State.memory`; "" for a law that has neither memory nor rate.
    """

    state: State
    term: Term
    quadrature: Quadrature
    key: str

    @cached_property
    def entities(self) -> IntArray:
        """Numbers in the joint of this rank's cells, or rows of its table of facets, of the points."""
        return self.quadrature.original[: len(self.quadrature.cells)]

    def stress(self) -> Array:
        """Stresses (points, 3, 3), with the pressure of an incompressible law. Collective."""
        term, points = self.term, self.quadrature
        if term.law.traits.compiled:
            at_rest = np.zeros((points.count, len(MANDEL)))
            known = self.state.stresses.get(self.key, at_rest)
        else:
            known = points.values(mandel(stress(term, self.state.u)))
        return tensors(known) + self._pressure()[:, None, None] * np.eye(3)

    def _pressure(self) -> Array:
        """Pressure (points,) of an incompressible law, a part of its stress; else zero."""
        if not self.term.law.traits.constrained:
            return np.zeros(self.quadrature.count)
        region = self.quadrature.region
        p = self.state.fields[PRESSURE + self.term.key.removeprefix(LAYER)]
        here = fem.Function(fem.functionspace(region.mesh, ("Lagrange", 1)))
        here.x.array[here.function_space.dofmap.list] = p.x.array[p.function_space.dofmap.list]
        return self.quadrature.values(ufl.as_vector([region.side(here)]))[:, 0]

    def internal(self) -> list[dict[str, Array]]:
        """Internal variables by name, (points, *shape), of each sublayer from the lower to the upper face of the layer."""
        sublayers = [law for _, law in self.term.law.sublayers]
        if not self.key:
            return [{} for _ in sublayers]
        at_rest = np.zeros((self.quadrature.count, self.term.law.memory))
        memory = self.state.memory.get(self.key, at_rest)
        start, found = self.term.law.memory - sum(law.memory for law in sublayers), []
        for law in sublayers:
            found.append(unpacked(law, memory[:, start : start + law.memory]))
            start += law.memory
        return found


def law_points(state: State) -> Iterator[LawPoints]:
    """The points of all laws of a state, bodies first, then layers; without contact laws. Collective."""
    model = state.model
    terms = state.bodies + state.layers
    keys = {id(term): key for key, term in compiled_terms(model.terms).items()}
    for own, term, quadrature in zip(model.terms, terms, _quadratures(model), strict=True):
        yield LawPoints(state, term, quadrature, keys.get(id(own), ""))


def _quadratures(model: Model) -> list[Quadrature]:
    """The quadrature points of all terms of a model, made once. Collective."""
    if model not in _FOUND:
        compiled = {id(one.term): one for one in model.quadratures.values()}
        _FOUND[model] = [compiled.get(id(term)) or Quadrature(model.V, term, model.origin) for term in model.terms]
    return _FOUND[model]


def unpacked(law: BulkLaw, memory: Array) -> dict[str, Array]:
    """The internal variables of a law by name, (points, *shape), from the rows of its memory (points, values)."""
    if sum(SIZES[shape] for shape in law.internal.values()) != memory.shape[1]:
        return {MEMORY: memory}
    found, start = {}, 0
    for name, shape in law.internal.items():
        part = memory[:, start : start + SIZES[shape]]
        found[name] = tensors(part) if shape == (3, 3) else part if shape else part[:, 0]
        start += SIZES[shape]
    return found
