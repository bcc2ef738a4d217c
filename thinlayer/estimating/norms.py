"""Norms on S, away from its free ends, of what a layer bears and how far it opens."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.estimating.places import NEAR_ENDS, away_from_ends
from thinlayer.output.surface import Surface
from thinlayer.ranges.areas import Areas
from thinlayer.ranges.sublayers import stiffness_of_jumps, sublayers_of

Array = npt.NDArray[np.float64]
NOTHING = (1e-11, 1e-9)  # traction over the layer's stiffness times displacements, jump over these: rounding up to here


@dataclass(frozen=True)
class Norms:
    """Squares of norms on S: of the changes of t and of [u], of t(u_0) and of [u_0]; zero where they are not known."""

    squares: Array

    @classmethod
    def on(cls, before: State, better: State, one: SeamLayer) -> Norms:
        """Those on a seam, away from its free ends. Collective."""
        model = better.model
        surface = Surface(model, one.name)
        assert one.thin
        part = away_from_ends(surface, one, NEAR_ENDS * float(one.thin.eps))
        has_law = one.name in before.model.layers
        traction = surface.traction if has_law else surface.reaction
        t, w = traction(before), surface.jump(before)
        fields = [traction(better) - t, t]
        if has_law:
            fields += [surface.jump(better) - w, w]
        found = np.array([surface.norm(f, part) ** 2 for f in fields])
        moved = float(better.u.x.petsc_vec.norm(PETSc.NormType.INFINITY)) ** 2 * surface.integral(part)
        for k, size in ((1, max(stiffness_of_jumps(one.samples[0])) ** 2), (3, 1.0)):
            if k < len(found) and found[k] <= NOTHING[k // 2] ** 2 * size * moved:
                found[k] = 0.0  # rounding of bodies that bear nothing there
        return cls(np.append(found, np.zeros(4 - len(found))))

    def __add__(self, other: Norms) -> Norms:
        return Norms(self.squares + other.squares)

    @property
    def errors(self) -> tuple[float, float]:
        """Relative errors of traction and jump; nan: not known."""
        of_t, t, of_w, w = (float(root) for root in np.sqrt(self.squares))
        found = of_t / t if t else math.nan, of_w / w if w else math.nan
        return found[0] * (found[0] > NOTHING[1]), found[1] * (found[1] > NOTHING[1])


def field_of_ends(model: InterfaceModel, one: SeamLayer) -> float:
    """The share of tractions, in L2, that free ends bring about farther away than `NEAR_ENDS`, of which no law on S knows.

    It falls over a length that grows with lmbda/mu. The numbers are those of pressed layers between rigid faces with nu
    from 0.2 to 0.45, to 30 %; a layer whose pressure flows along S has most of it.
    """
    rim, sublayers = model.reductions[one.name].free, [a for sample in one.samples for a in sublayers_of(sample)]
    if one.flows or not len(rim.vertices) or not sublayers:
        return 0.0
    assert one.thin
    areas, length = Areas(one.sheet, model.kinematics), max(a.length for a in sublayers)
    at = 0.8 * length * math.exp(-NEAR_ENDS / math.sqrt(0.2 + length**2))
    return at * math.sqrt(float(one.thin.eps) * areas.length(rim) / areas.total)
