"""Excess of the pressure in laws that let no material flow along S, compared with that of the layer itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from geometry.topology import FloatArray
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.ranges.sublayers import Sublayer, sublayers_of
from thinlayer.surface.surface_mesh import SurfaceMesh, surface_of

JUMP_ROUNDING = 1e-9  # rounding of jumps, relative to the displacements
LEAST_ERROR = 0.1  # relative error of a layer's stiffness from which on there is a warning


@dataclass(frozen=True)
class Faces:
    """How the faces of a layer are displaced in a state, at the k corners of the n facets of its seam. Collective.

    Attributes:
        surface: the seam.
        state: of an interface model.
        one: the layer.
    """

    surface: SurfaceMesh
    state: State
    one: SeamLayer

    @classmethod
    def of(cls, state: State, one: SeamLayer) -> Faces:
        """Those of a layer by itself."""
        return cls(surface_of(state.model, one.name), state, one)

    @cached_property
    def sides(self) -> FloatArray:
        """(2, d, n, k) displacements of the lower and of the upper face."""
        return self.surface.sides(self.state.u, self.state.model, self.surface.corner_points)

    @property
    def rounding(self) -> float:
        """Rounding of jumps."""
        return JUMP_ROUNDING * float(np.abs(self.sides).max())

    @property
    def opening(self) -> FloatArray:
        """(n, k) [u_N]."""
        return np.asarray(((self.sides[1] - self.sides[0]) * self.surface.corner_points.n).sum(axis=0))

    @property
    def slip_squared(self) -> FloatArray:
        """(n, k) |w_T|^2 plus the square of the rounding of displacements."""
        slip = self.sides[1] - self.sides[0] - self.opening * self.surface.corner_points.n
        return np.asarray((slip**2).sum(axis=0) + self.rounding**2)

    @property
    def closing(self) -> FloatArray:
        """(n, k) approach of the faces, relative to the thickness."""
        return -self.opening / self.surface.thickness(self.one, self.surface.corners)

    @property
    def mean_closing(self) -> float:
        """Mean closing over S; an opening counts as zero."""
        surface = self.surface
        return float(surface.integral(surface.between(np.maximum(self.closing, 0))) / surface.integral(1.0))

    @property
    def stretching(self) -> FloatArray:
        """(n, q) div_S <u>, of displacements that are linear between corners."""
        surface, mean = self.surface, self.sides.mean(axis=0)
        radius = self.state.model.kinematics.radius(surface.x.reshape(len(surface.x), -1).T)
        hoops = surface.between(mean[0]) / radius.reshape(surface.weights.shape)
        return np.asarray(np.einsum("dfk,fqkd->fq", mean, surface.quadrature.slopes) + hoops)


@dataclass(frozen=True)
class Excess:
    """How much a layer's law is too stiff, as it lets no material flow along S: its pressure p_0 is in excess of p.

    Attributes:
        opening: int (p_0 - p) wb/int p wb: the law is 1 + opening times too stiff against openings.
        work: the same excess over the work of the layer, int p wb + int mu/eps |w_T|^2, to which shear belongs.
        traction: |p_0 - p| over the traction of the law, norms in L2(S).
    """

    opening: float = 0.0
    work: float = 0.0
    traction: float = 0.0

    @property
    def hidden(self) -> bool:
        """Whether the traction is wrong, and shear hides it in the work."""
        return self.work <= LEAST_ERROR < self.traction


def times_too_stiff(state: State, one: SeamLayer) -> float | None:
    """1 + opening of `pressure_excess`, 1 of a law with a pressure that flows; None of laws without it. Collective."""
    if state.model.reductions[one.name].why_not("excess of pressure"):
        return None
    if one.flows:
        return 1.0
    return 1 + pressure_excess(Faces.of(state, one), sublayers_of(one)[0]).opening


def pressure_excess(faces: Faces, layer: Sublayer) -> Excess:
    """Compare the pressure of the law with that of the layer, for the displacements found. Collective.

    With wb = [u_N] + eps div_S <u> the pressure of the law is p_0 = lmbda wb/eps, and the pressure p of the layer solves

        (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = wb, p = 0 at free ends, no flow through the others,

    continuous and of degree 1; ends whose loss the law knows (edges="free") are among the others. If cells at a free end
    are larger than the length of the pressure, p is not set to zero there, as it cannot fall within a cell. On straight
    facets of a curved S slip opens the layer at one end of a facet and closes it at the other, and the law resists that,
    too: `work` has it, for the others p_0 is continuous like p. Openings as small as the rounding of
    displacements count as none.
    """
    if not layer.lmbda:
        return Excess()
    surface, joint = faces.surface, faces.surface.joint
    eps = surface.between(surface.thickness(faces.one, surface.corners))
    opening = surface.between(faces.opening)
    stiff, wb = layer.lmbda / eps, opening + eps * faces.stretching
    vertex = np.zeros(len(surface.numbers), np.int64)
    vertex[surface.nodes] = joint.masters[surface.corners]
    used, number = np.unique(vertex, return_inverse=True)  # the pressure is continuous where bodies branch
    joined = scipy.sparse.csc_matrix((np.ones(len(vertex)), (np.arange(len(vertex)), number)))
    b = joined.T @ surface.sums(surface.moments(wb))
    volume = joined.T @ surface.mass(1 / stiff) @ joined
    whole = volume + joined.T @ surface.stiffness(eps**3 / (12 * layer.mu)) @ joined
    rim = faces.state.model.reductions[faces.one.name].neglected
    at_rim = surface.thickness(faces.one, rim.vertices).mean(axis=1)
    fine = joint.masters[rim[rim.depth <= layer.length * at_rim].vertices]
    inside = np.flatnonzero(~np.isin(used, fine))
    if not b[inside].any():
        return Excess()
    p = np.zeros(len(used))
    p[inside] = scipy.sparse.linalg.spsolve(whole[inside][:, inside], b[inside])
    p_0 = scipy.sparse.linalg.spsolve(volume, b)
    of_law, of_layer = float(surface.integral(stiff * wb**2)), float(b @ p)
    slip = surface.between(faces.slip_squared) / eps
    work = (of_law - of_layer) / (of_layer + layer.mu * float(surface.integral(slip)))
    if surface.norm(surface.at_points(joined @ p_0) / stiff) <= faces.rounding * math.sqrt(surface.integral(1.0)):
        return Excess(work=work)
    t_N = surface.norm(stiff * wb + 2 * layer.mu * opening / eps)
    t_T = layer.mu * math.sqrt(surface.integral(slip / eps))
    off = surface.norm(surface.at_points(joined @ (p_0 - p)))
    return Excess(float(b @ p_0) / of_layer - 1, work, off / math.hypot(t_N, t_T))
