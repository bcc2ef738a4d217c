"""Bodies on softening interfaces, whose equilibrium paths turn back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import ufl

from forms import LinearElastic
from forms.traction import TractionLaw
from geometry import block
from tests.own_laws import layer_of
from thinlayer import ArcLength, Structure

E, HEIGHT, WIDTH = 2.3, 1.7, 0.85


def opening(step):
    """[u].n."""
    return ufl.dot(step.w, step.n)


def across_and_along(w, normal, k_T, step):
    """Traction with the given one across S, and springs k_T along it."""
    return normal * step.n + k_T * (step.mid - w * step.n)


def energy_along(k_T, step):
    along = step.w - opening(step) * step.n
    return k_T * ufl.inner(along, along) / 2


@dataclass(frozen=True)
class Trilinear(TractionLaw):
    """Across S: k w up to w_1, falling by `fall` per length from there to w_2, then rising with k again."""

    k: float
    fall: float
    w_1: float
    w_2: float
    k_T: float

    def sigma(self, w, choose):
        """Traction at an opening w; choose(a, b, x, y) is x where a < b, else y."""
        low = self.k * self.w_1 - self.fall * (self.w_2 - self.w_1)
        falling, rising = self.k * self.w_1 - self.fall * (w - self.w_1), low + self.k * (w - self.w_2)
        return choose(w, self.w_1, self.k * w, choose(w, self.w_2, falling, rising))

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, self.sigma(w, chosen), self.k_T, step)

    def energy(self, step):
        w = opening(step)
        a, b, length, peak = w - self.w_1, w - self.w_2, self.w_2 - self.w_1, self.k * self.w_1
        at_1 = peak * self.w_1 / 2
        at_2 = at_1 + peak * length - self.fall * length**2 / 2
        falling = at_1 + peak * a - self.fall * a**2 / 2
        rising = at_2 + (peak - self.fall * length) * b + self.k * b**2 / 2
        normal = chosen(w, self.w_1, self.k * w**2 / 2, chosen(w, self.w_2, falling, rising))
        return normal + energy_along(self.k_T, step)


def chosen(a, b, x, y):
    return ufl.conditional(ufl.lt(a, b), x, y)


@dataclass(frozen=True)
class Damage(TractionLaw):
    """k w exp(-m/w_0) across S, with the largest opening m so far: unloading leads to the origin."""

    k: float
    w_0: float
    k_T: float
    internal: ClassVar = {"most": ()}

    def _most(self, w, step):
        return ufl.max_value(w, step.q["most"])

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, self.k * w * ufl.exp(-self._most(w, step) / self.w_0), self.k_T, step)

    def evolve(self, step):
        return {"most": self._most(ufl.dot(step.w, step.n), step)}

    def energy(self, step):
        return self.k * ufl.exp(-step.q["most"] / self.w_0) * opening(step) ** 2 / 2 + energy_along(self.k_T, step)


def bar(law, support=lambda x, t: t, traction=None):
    """A strip on rollers, nu = 0, whose end is moved or pulled: t(end) = w + sigma(w) HEIGHT/E."""
    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    loads = {"TOP": traction} if traction else {}
    if not traction:
        supports = {"TOP": {"y": support}} | supports
    body = LinearElastic.young(E, 0.0)
    return Structure(strip, body=body, supports=supports, tractions=loads, element="Q1").interface(layer_of(law, 0.1))


def tilted(law, cells=8):
    """A block whose top is lifted more on one side than on the other."""
    joint = block(1.0, 0.5, 1 / cells, cell="quadrilateral", structured=True)
    supports = {"TOP": {"x": 0.0, "y": lambda x, t: t * (1 + 0.6 * x[0])}}
    body = LinearElastic.young(E, 0.2)
    return Structure(joint, body=body, supports=supports, element="Q1").interface(layer_of(law, 0.1))


KINKED = Trilinear(k=70.0, fall=7.0, w_1=0.011, w_2=0.12, k_T=30.0)
DAMAGED = Damage(k=70.0, w_0=0.03, k_T=30.0)
PATH = ArcLength(end=0.2, first=0.02)
SHORT = ArcLength(end=0.14, first=0.04)


# ---------------------------------------------------------------- bars that snap back
C = HEIGHT / E  # compliance of the bar
STEEP = Trilinear(k=7.0, fall=5.0, w_1=0.11, w_2=0.23, k_T=1.9)
SHARP = Trilinear(k=40.0, fall=400.0, w_1=0.02, w_2=0.0217, k_T=1.9)  # falls back along its rise, but for 2 degrees
FAR = 1.5  # beyond the snap-back of both


def openings(history) -> np.ndarray:
    """Mean displacement of the bar's lower side, which is its opening."""
    lower = np.flatnonzero(np.isclose(history.model.V.tabulate_dof_coordinates()[:, 1], 0.0))
    return np.array([state.u.x.array.reshape(-1, 2)[lower, 1].mean() for state in history])


def sigma(law, w):
    return law.sigma(w, lambda a, b, x, y: np.where(a < b, x, y))


@dataclass(frozen=True)
class Fading(TractionLaw):
    """k [u] exp(-[u]^2/w_0^2): nothing is left of it far beyond w_0."""

    k: float
    w_0: float
    softens: ClassVar = True

    def traction(self, step):
        return self.k * step.mid * ufl.exp(-ufl.inner(step.mid, step.mid) / self.w_0**2)


@dataclass(frozen=True)
class Undeclared(Fading):
    softens: ClassVar = False
