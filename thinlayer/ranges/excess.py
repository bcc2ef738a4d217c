"""Excess of the pressure in laws that let no material flow along S, compared with that of the layer itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.tangent import is_isotropic
from geometry.parallel import on_root
from geometry.topology import FloatArray, IntArray
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.ranges.faces import Faces
from thinlayer.ranges.sublayers import Sublayer, sublayers_of

LEAST_ERROR = 0.1  # relative error of a layer's stiffness from which on there is a warning


def why_unknown(one: SeamLayer) -> str | None:
    """Why `pressure_excess` does not say how much too stiff the law of a layer is; None if it does."""
    if one.thin is None:
        return "it is a law on S, without a thickness"
    if one.thin.eigenstrain is not None:
        return "it has an eigenstrain"
    if one.law.fields:
        return "its parameters are functions"
    if one.flows:
        return None
    tangents = [C for _, _, C in one.at_rest.sublayers]
    if not one.law.traits.linear or one.remembers or len(tangents) != 1 or tangents[0] is None:
        return "it is not one linear elastic material"
    if not is_isotropic(tangents[0]):
        return "it is not isotropic"
    lmbda = sublayers_of(one)[0].lmbda
    return None if 0 <= lmbda < math.inf else f"its lmbda is {lmbda:.4g}, allowed: 0 <= lmbda < infinity"


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


def times_too_stiff(state: State, one: SeamLayer) -> float:
    """1 + opening of `pressure_excess`, 1 of a law with a pressure that flows; nan where `why_unknown`. Collective."""
    if why_unknown(one):
        return math.nan
    if one.flows:
        return 1.0
    faces = Faces.of(state, one)
    return 1 + on_root(state.model.comm, lambda: pressure_excess(faces, sublayers_of(one)[0]).opening if faces else 0.0)


def pressure_excess(faces: Faces, layer: Sublayer) -> Excess:
    """Compare the pressure of the law with that of the layer, for the displacements found.

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
    sheet, areas, eps = faces.sheet, faces.areas, faces.thickness.mean(axis=1)
    mass, compliance = areas.mass, (eps / layer.lmbda)[:, None]
    wb = faces.opening + (eps * areas.divergence((faces.lower + faces.upper) / 2))[:, None]
    used, number = np.unique(sheet.vertices, return_inverse=True)
    number = number.reshape(sheet.vertices.shape)
    b = np.bincount(number.ravel(), _moments(mass, wb).ravel(), len(used))
    stiff = areas.of_simplices[:, None, None] * sheet.gradients @ np.swapaxes(sheet.gradients, 1, 2)
    volume = _assemble(mass * compliance[:, None], number)
    whole = volume + _assemble(stiff * (eps**3 / (12 * layer.mu))[:, None, None], number)
    rim = faces.state.model.reductions[sheet.name].neglected
    fine = rim[rim.depth <= layer.length * eps[rim.simplex]]
    inside = np.setdiff1d(np.arange(len(used)), np.searchsorted(used, fine.vertices))
    if not b[inside].any():
        return Excess()
    p = np.zeros(len(used))
    p[inside] = scipy.sparse.linalg.spsolve(whole[inside][:, inside], b[inside])
    p_0 = scipy.sparse.linalg.spsolve(volume, b)
    of_law, of_layer = float((wb / compliance * _moments(mass, wb)).sum()), float(b @ p)
    slip = areas.at_vertices * faces.slip_squared / eps[:, None]
    work = (of_law - of_layer) / (of_layer + layer.mu * float(slip.sum()))
    if _norm(mass, compliance * p_0[number]) <= faces.rounding * math.sqrt(areas.total):
        return Excess(work=work)
    t_N = _norm(mass, wb / compliance + 2 * layer.mu * faces.opening / eps[:, None])
    t_T = layer.mu * math.sqrt(float((slip / eps[:, None]).sum()))
    return Excess(float(b @ p_0) / of_layer - 1, work, _norm(mass, (p_0 - p)[number]) / math.hypot(t_N, t_T))


def _moments(mass: FloatArray, f: FloatArray) -> FloatArray:
    """(n, d) integrals of f (n, d), given at the vertices of the simplices, times the functions of degree 1."""
    return np.asarray((mass @ f[..., None])[..., 0])


def _norm(mass: FloatArray, f: FloatArray) -> float:
    """Norm in L2(S)."""
    return math.sqrt(max(float((f * _moments(mass, f)).sum()), 0.0))


def _assemble(blocks: FloatArray, number: IntArray) -> scipy.sparse.csc_matrix:
    """Assemble the blocks (n, d, d) of simplices whose vertices have these numbers (n, d)."""
    rows = np.broadcast_to(number[:, :, None], blocks.shape).ravel()
    columns = np.broadcast_to(number[:, None, :], blocks.shape).ravel()
    return scipy.sparse.coo_matrix((blocks.ravel(), (rows, columns))).tocsc()
