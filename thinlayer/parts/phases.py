"""Phases of a non-monotone layer: their shares, their boundaries, and their profile along S."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from forms.law import BulkLaw, Law
from geometry.order import along, by_place
from geometry.topology import IntArray
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.pointwise.kernels import memory_slots
from thinlayer.pointwise.quadrature import Quadrature

Array = npt.NDArray[np.float64]
NO_PHASES = "PhaseReport needs a layer whose law has phases, such as NonMonotone"


@dataclass(frozen=True)
class PhaseReport:
    """Phases of the layer in a state of either model. Collective.

    The phase is a number in [-1, 1]. -1, 0 and 1 are pure phases; others are the share of phase 1 (or -1) beside phase 0.

    Attributes:
        state: the state; the layer's law, or one of a Stack, has phases (`forms.NonMonotone`).
        seam: name of the layer's seam; "": the only one with phases.

    Raises:
        ModelError: a layer without phases; no seam is named, and several layers have phases.
    """

    state: State
    seam: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.state, State):
            raise ModelError(f"state is {self.state!r}; PhaseReport takes what solve or march returns")
        _ = self._layer

    @cached_property
    def _layer(self) -> SeamLayer:
        return _with_phases(self.state.model, self.seam)

    @cached_property
    def _parts(self) -> list[tuple[Quadrature, Array, Array]]:
        """Quadrature points, phases (n,) and weights (n,) of each law that has phases."""
        parts = []
        for key, quadrature in self.state.model.quadratures.items():
            if quadrature.term.key != self._layer.key:
                continue
            memory = self.state.memory[key]
            for a, k in phase_slots(quadrature.term.law):
                parts.append((quadrature, memory[:, k], a * quadrature.weights))
        return parts

    @property
    def plus(self) -> float:
        """Share of the layer (of its sublayers with phases) in phase 1."""
        return self._share(1.0)

    @property
    def minus(self) -> float:
        """Share in phase -1."""
        return self._share(-1.0)

    def _share(self, sign: float) -> float:
        sums = [(float(w @ np.maximum(sign * phase, 0.0)), float(w.sum())) for _, phase, w in self._parts]
        part, whole = self.state.model.comm.allreduce(np.sum(sums, axis=0))
        return float(part / whole)

    @property
    def boundary(self) -> float:
        """Thickness of phase 0 if the other phases lie above it, a length; the mean over S.

        For the bar of section 6.2 it is the position eps S of the phase boundary, Eq. (47).
        """
        thin = self._layer.thin
        assert thin is not None
        return max(1 - self.plus - self.minus, 0.0) * float(thin.eps) * phase_thickness(thin.law)

    def profile(self) -> tuple[Array, Array]:
        """Centres (columns, d) of the facets of the layer's seam and the mean phase (columns,) of the layer there.

        Centres are those before inflating. They are ordered along S in 2D, else by coordinates, the same on all ranks.
        """
        sums = []
        for quadrature, phase, weights in self._parts:
            columns = quadrature.columns
            places = columns.centres
            sums.append([columns.sum_of(weights * phase), columns.sum_of(weights)])
        part, whole = np.sum(sums, axis=0)
        covered = whole > 0  # of several seams, the one of this layer
        places, part, whole = places[covered], part[covered], whole[covered]
        order = self._order(places)
        return places[order], (part / whole)[order]

    def _order(self, places: Array) -> IntArray:
        """Order of the facets of S with these centres: along S in 2D, else by coordinates."""
        size = float(np.ptp(self.state.model.joint.points, axis=0).max())
        return along(places, self._neighbours(places), size) if places.shape[1] == 2 else by_place(places, size)

    def _neighbours(self, places: Array) -> IntArray:
        """(n, 2) pairs of facets of S, with centres at these places, that share a vertex; in 2D."""
        joint = self.state.model.joint
        vertices = joint.table.vertices[joint.surface_rows]
        _, facet = cKDTree(joint.points[vertices].mean(axis=1)).query(places)
        ends = vertices[facet]
        column = np.tile(np.arange(len(ends)), 2)
        order = np.argsort(ends.T.ravel(), kind="stable")
        vertex, column = ends.T.ravel()[order], column[order]
        same = vertex[1:] == vertex[:-1]
        return np.column_stack([column[:-1][same], column[1:][same]])

    @property
    def fronts(self) -> Array:
        """Places (k, 2) on S, in 2D, at which half of the layer is in phase 1 or -1."""
        x, phase = self.profile()
        if x.shape[1] != 2:
            raise ModelError("fronts are places on a line; in 3D look at profile()")
        above = np.abs(phase) - 0.5
        pairs = np.sort(self._neighbours(x), axis=1)
        a, b = pairs[np.lexsort(pairs.T[::-1])].T
        crossed = above[a] * above[b] < 0
        a, b = a[crossed], b[crossed]
        share = (above[a] / (above[a] - above[b]))[:, None]
        return x[a] + share * (x[b] - x[a])

    def __str__(self) -> str:
        return f"phase 1: {self.plus:.4g}, phase -1: {self.minus:.4g} of the layer, boundary at {self.boundary:.6g}"


def seams_with_phases(model: Model) -> list[str]:
    """Names of the seams whose layers have phases."""
    return [name for name, one in model.layers.items() if one.thin and one.law.traits.phases]


def _with_phases(model: Model, seam: str) -> SeamLayer:
    """The layer with phases of a seam; "": the only one."""
    names = seams_with_phases(model)
    if not names:
        raise ModelError(NO_PHASES)
    if not seam and len(names) > 1:
        raise ModelError(f"several layers have phases; a report is of one: give seam=, one of {', '.join(names)}")
    if seam and seam not in names:
        raise ModelError(f"seam is {seam!r}; name one whose layer has phases: {', '.join(names)}")
    return model.layers[seam or names[0]]


def phase_slots(law: BulkLaw) -> list[tuple[float, int]]:
    """Fraction of the thickness, and index among the internal variables, of each phase of a law."""
    return [(a, k) for a, one, k in memory_slots(law, "phase") if one.traits.phases]


def phase_thickness(law: Law) -> float:
    """Fraction of the thickness taken by sublayers whose laws have phases."""
    return sum(a for a, one in law.sublayers if one.traits.phases)
