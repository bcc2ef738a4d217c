"""A bar over a surface that softens, for paths by arc length: its laws, its opening and its compliance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import ufl

from forms.traction import TractionLaw
from tests.arc_length_run import HEIGHT, E, Trilinear

C = HEIGHT / E  # compliance of the bar
STEEP = Trilinear(k=7.0, fall=5.0, w_1=0.11, w_2=0.23, k_T=1.9)
SHARP = Trilinear(k=40.0, fall=400.0, w_1=0.02, w_2=0.0217, k_T=1.9)  # falls back along its rise, but for 2 degrees
FAR = 1.5  # beyond the snap-back of both


def openings(history) -> np.ndarray:
    """Mean displacement of the bar's lower side, which is its opening."""
    model = history.model
    x = model.V.tabulate_dof_coordinates()
    lower = np.flatnonzero(np.isclose(x[:, 1], 0.0))
    return np.array([state.u.x.array.reshape(-1, 2)[lower, 1].mean() for state in history])


def sigma(law, w):
    return law.sigma(w, lambda a, b, x, y: np.where(a < b, x, y))


@dataclass(frozen=True)
class Cohesive(TractionLaw):
    """k [u] exp(-[u]^2/w_0^2): nothing is left of it far beyond w_0."""

    k: float
    w_0: float
    softens: ClassVar = True

    def traction(self, step):
        return self.k * step.mid * ufl.exp(-ufl.inner(step.mid, step.mid) / self.w_0**2)


@dataclass(frozen=True)
class Undeclared(Cohesive):
    softens: ClassVar = False
